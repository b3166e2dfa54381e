"""Strict YAML to values that know their place.

A pipeline is read once, by people who look for mistakes, so this reads less than YAML offers and never guesses:
plain scalars follow the core schema of YAML 1.2.2 (section 10.3.2: `1e-3` is a number, `on`, `12:30` and `1_000` are
text), and duplicate keys, keys that are not text, anchors, aliases, merge keys, tags, several documents, numbers that
are not finite and control characters are problems. It is built on PyYAML's events, since neither PyYAML's values nor
its nodes keep what is needed to tell all of these apart.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias, TypeGuard

import yaml

from recon.errors import ConfigError
from recon.problems import Problem, Where
from recon.yaml_scalars import Scalar, plain_scalar

MOST_LEVELS = 50
MOST_BYTES = 4 * 2**20

Plain: TypeAlias = Scalar | list["Plain"] | dict[str, "Plain"]


@dataclass(frozen=True, slots=True)
class Node:
    """A value and where it was written.

    value : a scalar, a tuple of nodes, or a mapping of text to nodes in the order written; keys : for a mapping, the
    place of each key.
    """

    value: Scalar | tuple[Node, ...] | Mapping[str, Node]
    where: Where
    keys: Mapping[str, Where] = field(default_factory=dict)

    @classmethod
    def of(cls, data: object, where: Where) -> Node:
        """Wrap ordinary data, all of it at one place, such as a command-line option; NumPy's scalars and arrays count.

        Raises TypeError for the rest.
        """
        if hasattr(data, "tolist"):
            data = data.tolist()
        if data is None or isinstance(data, bool | int | float | str):
            return cls(data, where)
        if isinstance(data, list | tuple):
            return cls(tuple(cls.of(item, where) for item in data), where)
        if isinstance(data, Mapping) and all(isinstance(key, str) for key in data):
            return cls({key: cls.of(item, where) for key, item in data.items()}, where, dict.fromkeys(data, where))
        raise TypeError(f"YAML cannot hold {data!r}")

    def plain(self) -> Plain:
        """The value as ordinary Python data: scalars, lists and dictionaries."""
        if isinstance(self.value, tuple):
            return [node.plain() for node in self.value]
        if isinstance(self.value, Mapping):
            return {key: node.plain() for key, node in self.value.items()}
        return self.value

    def at(self, path: Sequence[str | int]) -> Node:
        """The node at a path of keys and indices, or the last one on the way to it that exists."""
        node = self
        for part in path:
            child = node._child(part)
            if child is None:
                break
            node = child
        return node

    def where_of_key(self, name: str) -> Where:
        """The place of a key, or of the whole node if it has no such key."""
        return self.keys.get(name, self.where)

    def _child(self, part: str | int) -> Node | None:
        if isinstance(self.value, Mapping) and isinstance(part, str):
            return self.value.get(part)
        if isinstance(self.value, tuple) and isinstance(part, int) and 0 <= part < len(self.value):
            return self.value[part]
        return None


def load_file(path: Path | str) -> Node:
    """Read a YAML file in UTF-8. Raises ConfigError with every problem found."""
    here = Where(str(path))
    try:
        if Path(path).is_dir():
            raise ConfigError([Problem(here, "file-unreadable", "this is a folder, not a file")])
        if Path(path).exists() and not Path(path).is_file():
            raise ConfigError([Problem(here, "file-unreadable", "this is a device or a pipe, not a file")])
        if Path(path).stat().st_size > MOST_BYTES:
            text = f"this file is larger than {MOST_BYTES // 2**20} MiB"
            raise ConfigError([Problem(here, "file-unreadable", text, "is it the right one?")])
        data = Path(path).read_bytes()
    except FileNotFoundError:
        raise ConfigError([Problem(here, "file-missing", "there is no such file")]) from None
    except (OSError, ValueError) as error:
        reason = (error.strerror or str(error)) if isinstance(error, OSError) else "its name holds a NUL"
        raise ConfigError([Problem(here, "file-unreadable", f"the file cannot be read: {reason}")]) from None
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        where = _place(str(path), error.object[: error.start].decode())
        wrong = f"byte 0x{error.object[error.start]:02x} is not UTF-8"
        raise ConfigError([Problem(where, "yaml-encoding", wrong, "save the file as UTF-8")]) from None
    return load(text, str(path))


def load(text: str, file: str) -> Node:
    """Read one YAML document; `file` names it in messages. Raises ConfigError with every problem found."""
    text = text.removeprefix("\ufeff")
    if found := _FORBIDDEN.search(text):
        where = _place(file, text[: found.start()])
        wrong = f"the character U+{ord(found[0]):04X} is not allowed"
        raise ConfigError([Problem(where, "yaml-character", wrong, "remove it, or write it as an escape in quotes")])
    composer = _Composer(text, file)
    try:
        root = composer.document()
    except yaml.MarkedYAMLError as error:
        raise ConfigError([*composer.problems, _syntax_problem(error, text, file)]) from None
    if composer.problems:
        raise ConfigError(composer.problems)
    return root


class _Composer:
    """Events to nodes; what is wrong but does not stop the reading is collected in `problems`."""

    def __init__(self, text: str, file: str) -> None:
        self.file = file
        self.problems: list[Problem] = []
        self.events: Iterator[yaml.Event] = yaml.parse(text, Loader=_LOADER)

    def document(self) -> Node:
        next(self.events)  # start of the stream
        if isinstance(next(self.events), yaml.StreamEndEvent):
            self.problems.append(Problem(Where(self.file), "yaml-empty", "there is nothing in this file"))
            return Node(None, Where(self.file))
        first = next(self.events)
        root = self._node(first, 0)
        if _is_plain(first) and first.value == "":
            self._report(first, "yaml-empty", "there is nothing in this document")
        next(self.events)  # end of the document
        if isinstance(event := next(self.events), yaml.DocumentStartEvent):
            self._report(event, "yaml-documents", "a second document begins here", "write each in a file of its own")
        return root

    def _node(self, event: yaml.Event, level: int) -> Node:
        """The node that begins with `event`; `level` counts the collections around it."""
        where = self._where(event)
        if isinstance(event, yaml.AliasEvent):
            self._report(event, "yaml-anchor", f"the alias *{event.anchor} is not supported", "repeat the value here")
            return Node(None, where)
        assert isinstance(event, yaml.ScalarEvent | yaml.CollectionStartEvent)
        if event.anchor is not None:
            self._report(event, "yaml-anchor", f"the anchor &{event.anchor} is not supported", "remove it")
        if event.tag is not None:
            self._report(event, "yaml-tag", "tags (!) are not supported", "remove it, or quote the text")
        if isinstance(event, yaml.ScalarEvent):
            return Node(self._scalar(event), where)
        if level == MOST_LEVELS:
            self._report(event, "yaml-depth", f"this is nested deeper than {MOST_LEVELS} levels")
            raise ConfigError(self.problems)
        if isinstance(event, yaml.SequenceStartEvent):
            return Node(tuple(self._items(level + 1)), where)
        return self._mapping(where, level + 1)

    def _items(self, level: int) -> Iterator[Node]:
        while not isinstance(event := next(self.events), yaml.SequenceEndEvent):
            yield self._node(event, level)

    def _mapping(self, where: Where, level: int) -> Node:
        nodes: dict[str, Node] = {}
        keys: dict[str, Where] = {}
        while not isinstance(event := next(self.events), yaml.MappingEndEvent):
            key = self._key(event, level)
            node = self._node(next(self.events), level)
            if key in nodes:
                notes = ((keys[key], f"'{key}' was first given here"),)
                self._report(event, "yaml-duplicate-key", f"'{key}' is given twice", "keep one of them", notes)
            elif key is not None:
                nodes[key], keys[key] = node, self._where(event)
        return Node(nodes, where, keys)

    def _key(self, event: yaml.Event, level: int) -> str | None:
        """The text of a key, None if it has none."""
        value = self._node(event, level).value
        if _is_plain(event) and event.value == "<<":
            self._report(event, "yaml-merge", "merge keys (<<) are not supported", "write the keys out")
            return None
        if isinstance(value, str):
            return value
        if not isinstance(event, yaml.AliasEvent):
            hint = f"write '{event.value}' in quotes" if isinstance(event, yaml.ScalarEvent) and event.value else ""
            self._report(event, "yaml-key", "a key must be text", hint)
        return None

    def _scalar(self, event: yaml.ScalarEvent) -> Scalar:
        text: str = event.value
        if not _is_plain(event):
            return text
        value = plain_scalar(text)
        if isinstance(value, float) and not math.isfinite(value):
            wrong = f"{text:.40} is not a finite number of 64 bits"
            self._report(event, "yaml-number", wrong, "quote it if it is meant as text")
        return value

    def _where(self, event: yaml.Event) -> Where:
        return _marked(self.file, event.start_mark)

    def _report(
        self, event: yaml.Event, code: str, text: str, hint: str = "", notes: tuple[tuple[Where, str], ...] = ()
    ) -> None:
        self.problems.append(Problem(self._where(event), code, text, hint, notes))


def _is_plain(event: yaml.Event) -> TypeGuard[yaml.ScalarEvent]:
    """A scalar without quotes and without a tag."""
    return isinstance(event, yaml.ScalarEvent) and bool(event.implicit[0])


# --- places and syntax errors ---------------------------------------------------------------------------------------

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

# All that YAML does not call printable, the three line breaks that only YAML 1.1 has, and the byte order mark.
_FORBIDDEN = re.compile("[^\t\n\r\x20-\x7e\xa0-\u2027\u202a-\ud7ff\ue000-\ufefe\uff00-\ufffd\U00010000-\U0010ffff]")

# words of PyYAML's message -> (whether the place is where the construct began, what is wrong, what to do)
_SYNTAX = {
    "found unexpected": (True, "this quote is never closed", ""),
    "quoted scalar": (True, "a backslash in this text begins no escape of YAML", "use single quotes"),
    "flow sequence": (True, "this '[' is never closed, or a ',' is missing behind one of its items", ""),
    "flow mapping": (True, "this '{' is never closed, or a ',' is missing behind one of its items", ""),
    "mapping values are not allowed": (
        False,
        "a ': ' is not expected here",
        "check the indentation, or quote the text",
    ),
    "expected ':'": (True, "a ': ' is missing behind this", ""),
    "parsing a block": (False, "this does not continue what comes before it", "check the indentation and the quotes"),
}


def _syntax_problem(error: yaml.MarkedYAMLError, text: str, file: str) -> Problem:
    """One plain sentence for an error of PyYAML, whose two parsers word theirs differently."""
    mark: Any = error.problem_mark or error.context_mark
    where = _marked(file, mark)
    message = f"{error.context or ''} {error.problem or ''}"
    character = text[mark.index : mark.index + 1]
    if "tab character" in message or ("cannot start any token" in message and character == "\t"):
        return Problem(where, "yaml-syntax", "a tab cannot indent a line", "use spaces")
    if "cannot start any token" in message:
        return Problem(where, "yaml-syntax", f"plain text cannot begin with '{character}'", "quote it")
    for words, (at_start, wrong, hint) in _SYNTAX.items():
        if words in message:
            begin = error.context_mark if at_start else None
            return Problem(_marked(file, begin) if begin else where, "yaml-syntax", wrong, hint)
    return Problem(where, "yaml-syntax", f"this is not YAML: {error.problem}")


def _marked(file: str, mark: Any) -> Where:
    """The place of a mark, which each of PyYAML's two parsers has a class of its own for."""
    return Where(file, mark.line + 1, mark.column + 1)


def _place(file: str, before: str) -> Where:
    """The place of what follows the text `before`."""
    lines = re.split(r"\r\n|\r|\n", before)
    return Where(file, len(lines), len(lines[-1]) + 1)
