"""Which laws a record breaks, of one module or of all, and in what words."""

from __future__ import annotations

from types import ModuleType

from recon.declaration import Stage
from recon.registry import Registry
from recon.testing import Case, Law, Subject
from recon.testing.contract import Contract


def broken(module: ModuleType, record: Stage) -> dict[str, str]:
    """First line of the message by name of those laws of a module that apply to a record and that it breaks.

    What follows the first line are the values by which pytest explains an assertion.
    """
    subject = Subject(record, Registry.of(record))
    messages = {}
    for law in vars(module).values():
        if isinstance(law, Law) and law.applies(record):
            try:
                law.holds(subject)
            except AssertionError as error:
                messages[law.name] = str(error).splitlines()[0]
    return messages


def broken_laws(stage: Stage | str, case: Case | None = None, registry: Registry | None = None) -> dict[str, str]:
    """The message by name of all laws that a stage breaks, by an AssertionError or any other.

    stage : a record, or the name of one that is installed or in the registry
    """
    key = stage if isinstance(stage, str) else stage.key
    known = registry or (Registry.of(stage) if isinstance(stage, Stage) else Registry.installed())
    found = {}
    for law in Contract((key,), (case or Case(),), registry=known).laws():
        try:
            law()
        except Exception as error:  # whatever a wrong stage leads to
            found[law.law.name] = str(error)
    return found
