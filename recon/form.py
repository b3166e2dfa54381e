"""Takes the YAML of a pipeline or a batch file apart and collects what is wrong with its form."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from recon.problems import Problem, Where, did_you_mean
from recon.yaml_nodes import Node

_NAME: Final = re.compile(r"\w[\w.-]*")


def is_batch(root: Node) -> bool:
    """Is this a batch file, not a pipeline?"""
    return isinstance(root.value, Mapping) and "batch" in root.value


class Form:
    """One pass over a file. Every method gives what can be understood, and `problems` holds what cannot.

    A node of None stands for a key that is not there; a key without a value counts as not there.
    """

    def __init__(self) -> None:
        self.problems: list[Problem] = []

    def report(self, where: Where, code: str, text: str, hint: str = "") -> None:
        """Keep a problem."""
        self.problems.append(Problem(where, code, text, hint))

    def mapping(self, node: Node, what: str, known: Sequence[str], needs: Iterable[str] = ()) -> Mapping[str, Node]:
        """The entries of a mapping whose keys are known; `what` is how messages call it."""
        if not isinstance(node.value, Mapping):
            self.report(node.where, "bad-value", f"{what} must be a mapping", f"its keys are {', '.join(known)}")
            return {}
        for key in node.value:
            if key not in known:
                hint = did_you_mean(key, known) or f"its keys are {', '.join(known)}"
                self.report(node.where_of_key(key), "unknown-key", f"{what} has no key '{key}'", hint)
        for key in needs:
            if key not in node.value:
                self.report(node.where, "missing-key", f"{what} needs the key '{key}'")
        return {key: value for key, value in node.value.items() if key in known}

    def entries(self, node: Node | None, wanted: str, hint: str) -> Mapping[str, Node]:
        """The entries of a mapping of any keys; `wanted` is the sentence for anything else."""
        if node is None or node.value is None:
            return {}
        if not isinstance(node.value, Mapping):
            self.report(node.where, "bad-value", wanted, hint)
            return {}
        return node.value

    def text(self, node: Node | None, key: str) -> str:
        """A text, "" where there is none."""
        if node is None or node.value is None:
            return ""
        if not isinstance(node.value, str):
            self.report(node.where, "bad-value", f"{key} must be text", "put it in quotes")
            return ""
        return node.value

    def name(self, node: Node | None, key: str) -> str:
        """A text that serves as a name, also of a file; "" where there is none."""
        text = self.text(node, key)
        if node is not None and isinstance(node.value, str) and not _NAME.fullmatch(text):
            self.report(node.where, "bad-value", f"{key} is '{text}'", "use letters, digits, _, - and .")
        return text

    def choice(self, node: Node | None, key: str, choices: Sequence[str]) -> str:
        """One of a few words, the first where there is none."""
        chosen = self.text(node, key) or choices[0]
        if node is not None and chosen not in choices:
            self.report(node.where, "bad-value", f"{key} is '{chosen}'", f"write {' or '.join(choices)}")
        return chosen

    def items(self, node: Node | None, key: str, hint: str) -> tuple[Node, ...]:
        """The items of a list."""
        if node is None or node.value is None:
            return ()
        if not isinstance(node.value, tuple):
            self.report(node.where, "bad-value", f"{key} must be a list", hint)
            return ()
        return node.value

    def number_of_format(self, node: Node | None, known: int) -> None:
        """The number behind `recon:`."""
        if node is None or node.value is None or (node.value == known and type(node.value) is int):
            return
        shown = json.dumps(node.plain(), ensure_ascii=False)  # with the quotes, which make the difference
        self.report(node.where, "unknown-format", f"recon: {shown} is not known", f"write {known}")
