"""What is wrong with a pipeline, a batch file or an option: one record, rendered for people, programs and GitHub.

Every check collects problems instead of stopping at the first one; `recon.errors.ConfigError` carries them together.

    pipelines/bad.yaml:4:14: error: fuser.map has no parameter 'gyro_nois'; did you mean 'gyro_noise'?
        pipelines/bad.yaml:9:5: note: ...

The annotation line follows GitHub's "Workflow commands for GitHub Actions", section "Setting an error message".
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher

NEAR = 0.6
"""Smallest similarity (difflib ratio, 0 to 1) at which a word is offered as what was meant."""

NEAR_SHORT = 0.75
"""The same for words of fewer than SHORT letters, to which nearly everything is similar."""

SHORT = 3

MOST_QUOTED = 60
"""Characters of a value that a message shows; a longer word is not looked for among the known ones either."""

MOST_TEXT = 1000
"""Characters of a whole text or hint."""

MOST_CHOICES = 10
"""Longest list of choices that a message spells out."""


@dataclass(frozen=True, slots=True)
class Where:
    """A place in a text: `line` and `column` count from 1, and 0 says that there is none.

    `file` is the path as the user gave it, or for a command-line option its text, such as `--set fuser.map.x=1`.
    """

    file: str
    line: int = 0
    column: int = 0

    def __str__(self) -> str:
        return ":".join([self.file, *(str(number) for number in (self.line, self.column) if number)])


@dataclass(frozen=True, slots=True)
class Problem:
    """One finding.

    code : short kebab-case name of the kind of problem, stable between versions; text : what is wrong, without a full
    stop; hint : what to do, printed after a semicolon; notes : other places that explain it, each with a sentence.
    All of them are kept readable: what they quote is cut at MOST_QUOTED characters.
    """

    where: Where | None
    code: str
    text: str
    hint: str = ""
    notes: tuple[tuple[Where, str], ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "text", _readable(self.text))
        object.__setattr__(self, "hint", _readable(self.hint))
        object.__setattr__(self, "notes", tuple((where, _readable(text)) for where, text in self.notes))

    @property
    def sentence(self) -> str:
        """The text and, where there is one, the hint."""
        return f"{self.text}; {self.hint}" if self.hint else self.text

    def as_text(self) -> str:
        """`file:line:column: error: sentence`, then each note on a line of its own, indented by four spaces."""
        place = f"{self.where}: " if self.where else ""
        return "\n".join([f"{place}error: {self.sentence}", *self._note_lines()])

    def as_dict(self) -> dict[str, object]:
        """Ordinary data for JSON; a place that is not known is null."""
        return {
            **_place_dict(self.where),
            "code": self.code,
            "text": self.text,
            "hint": self.hint,
            "notes": [{**_place_dict(where), "text": text} for where, text in self.notes],
        }

    def as_github(self) -> str:
        """The line that GitHub Actions shows as an annotation of the file."""
        places = [("file", "file"), ("line", "line"), ("col", "column")]
        place = _place_dict(self.where)
        properties = [(name, place[key]) for name, key in places if place[key]] + [("title", self.code)]
        head = ",".join(f"{name}={_escape_property(str(value))}" for name, value in properties)
        return f"::error {head}::{_escape_message(chr(10).join([self.sentence, *self._note_lines()]))}"

    def _note_lines(self) -> list[str]:
        return [f"    {where}: note: {text}" for where, text in self.notes]


def shortened(text: str, most: int = MOST_QUOTED) -> str:
    """The text, its end replaced by `...` where it is longer than `most` characters."""
    return text if len(text) <= most else f"{text[:most]}..."


def did_you_mean(word: str, choices: Iterable[str]) -> str:
    """`did you mean 'x'?` for the choice nearest to `word`, or an empty text where none is near.

    Case and the difference of `-` and `_` do not count. A choice that continues the word, or a dotted name that ends
    with it (`map` of `fuser.map`), comes before one that only looks like it.
    """
    wanted = _folded(word)
    known = sorted(set(choices) - {word})
    if not 0 < len(wanted) <= MOST_QUOTED or not known:
        return ""
    closeness = {choice: _closeness(wanted, _folded(choice)) for choice in known}
    nearest = max(known, key=closeness.__getitem__)
    near = NEAR if len(wanted) >= SHORT else NEAR_SHORT
    return f"did you mean '{nearest}'?" if closeness[nearest] >= near else ""


def one_of(choices: Sequence[str]) -> str:
    """`'a', 'b' or 'c'`; a long list is cut and says how many there are."""
    quoted = [f"'{choice}'" for choice in choices]
    if len(quoted) > MOST_CHOICES:
        return f"{', '.join(quoted[:MOST_CHOICES])}, ... ({len(quoted)} in all)"
    return " or ".join(part for part in (", ".join(quoted[:-1]), *quoted[-1:]) if part)


_QUOTED = re.compile(r"(?<!\w)'([^']*)'(?!\w)")


def _readable(text: str) -> str:
    """Every quotation, and then the whole, at its greatest length; an apostrophe inside a word begins no quotation."""
    if len(text) <= MOST_QUOTED:
        return text
    return shortened(_QUOTED.sub(lambda found: f"'{shortened(found[1])}'", text), MOST_TEXT)


def _folded(word: str) -> str:
    return word.strip().casefold().replace("-", "_")


def _closeness(wanted: str, choice: str) -> float:
    """Similarity of two folded words, above 1 for a continuation or a last part, above 2 for the same word; of dotted
    names of one role only that of what follows it.
    """
    role, dot, name = wanted.partition(".")
    if dot and name and choice.startswith(role + dot):
        return _closeness(name, choice.removeprefix(role + dot))
    ratio = SequenceMatcher(None, wanted, choice, autojunk=False).ratio()
    if wanted == choice:
        return 2.0 + ratio
    continued = choice.startswith(wanted) and len(wanted) >= SHORT
    if continued or choice.endswith(f".{wanted}"):
        return 1.0 + ratio
    return ratio


def _place_dict(where: Where | None) -> dict[str, object]:
    if where is None:
        return {"file": None, "line": None, "column": None}
    return {"file": where.file, "line": where.line or None, "column": where.column or None}


def _escape_message(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _escape_property(text: str) -> str:
    return _escape_message(text).replace(":", "%3A").replace(",", "%2C")
