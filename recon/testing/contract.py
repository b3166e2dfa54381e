"""Which laws a stage must keep, and the decorator that makes a test of each.

    from recon.testing import contract

    @contract("filter.butter", "fuser.my_ekf")
    def test_contract(law):
        law()

The decorator only leaves a mark; `recon.pytest_plugin`, which pytest finds by entry point, makes the tests. So
nothing here needs pytest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from recon.declaration import Stage
from recon.errors import ReconError
from recon.problems import did_you_mean
from recon.pytest_plugin import MARK
from recon.registry import Registry
from recon.testing.subject import Case, Subject

Test = TypeVar("Test", bound=Callable[..., Any])


@dataclass(frozen=True)
class Law:
    """A property that stages keep: `holds` raises AssertionError, in words, where one does not.

    applies : to which stages, by their role and by what they declare of themselves, never by name
    """

    holds: Callable[[Subject], None]
    applies: Callable[[Stage], bool]

    @property
    def name(self) -> str:
        """The function's name, a sentence with underscores."""
        return self.holds.__name__


def law(
    *roles: type[Stage], when: Callable[[Any], bool] = lambda stage: True
) -> Callable[[Callable[[Subject], None]], Law]:
    """Declare a law for stages of the roles, all where none is named, for which `when` is true."""
    return lambda holds: Law(holds, lambda stage: isinstance(stage, roles or Stage) and when(stage))


def laws_of(stage: Stage) -> list[Law]:
    """The laws that a stage must keep, in a fixed order."""
    from recon.testing.laws import MODULES

    found = [value for module in MODULES for value in vars(module).values() if isinstance(value, Law)]
    return [one for one in found if one.applies(stage)]


@dataclass(frozen=True)
class BoundLaw:
    """A law about one stage in one case; calling it is the test.

    expected_failure : why it is known not to hold, "" where it must
    """

    law: Law
    subject: Subject
    expected_failure: str = ""

    @property
    def id(self) -> str:
        """Such as `filter.butter-same_input_twice_gives_same_output`."""
        case = f"[{self.subject.case.name}]" if self.subject.case.name else ""
        return f"{self.subject.stage.key}{case}-{self.law.name}"

    def __call__(self) -> None:
        """Raise AssertionError where the law is broken, or holds although it was expected not to.

        A law may also raise what the stage's run raises: it is broken then, too.
        """
        if not self.expected_failure:
            self.law.holds(self.subject)
            return
        try:
            self.law.holds(self.subject)
        except (AssertionError, ReconError):
            return
        raise AssertionError(f"{self.law.name} holds, but was expected to fail: {self.expected_failure}")


@dataclass(frozen=True)
class Contract:
    """What the decorator was given."""

    names: Sequence[str]
    cases: Sequence[Case] = ()
    expected_failures: Mapping[str, str] = field(default_factory=dict)
    registry: Registry | None = None

    def laws(self) -> list[BoundLaw]:
        """All laws of all stages in all cases. Raises PluginError, or ValueError for an unknown law."""
        registry = self.registry or Registry.installed()
        cases = self.cases or (Case(),)
        bound = [
            BoundLaw(one, Subject(stage, registry, case), self.expected_failures.get(one.name, ""))
            for stage in map(registry.get, self.names)
            for case in cases
            for one in laws_of(stage)
        ]
        for name in self.expected_failures:
            known = [one.law.name for one in bound]
            if name not in known:
                raise ValueError(
                    f"expected_failures names '{name}', which is no law of {self.names}; {did_you_mean(name, known)}"
                )
        return bound


def contract(
    *names: str,
    cases: Iterable[Case] = (),
    expected_failures: Mapping[str, str] | None = None,
    registry: Registry | None = None,
) -> Callable[[Test], Test]:
    """Make a test of every law that the named stages must keep; the test function gets it as `law` and calls it.

    cases : inputs of one's own beside the suite's; a reader needs at least one with a path
    expected_failures : law name to reason; strict: a law that holds after all fails, as does an unknown name
    registry : where the stages are; the installed ones by default
    """

    def mark(test: Test) -> Test:
        setattr(test, MARK, Contract(names, tuple(cases), dict(expected_failures or {}), registry))
        return test

    return mark
