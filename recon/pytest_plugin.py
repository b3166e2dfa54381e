"""What pytest loads of recon by itself, by the entry point `pytest11`: it makes tests of a contract's laws.

It imports nothing, so that whoever has recon installed does not pay for it in every test run. The mark that
`recon.testing.contract` leaves on a test function brings all that is needed. At the end it prints one line for each
stage.
"""

from __future__ import annotations

from collections import Counter
from typing import Any, Final

MARK: Final = "recon_contract"
"""Attribute of a test function that holds its contract."""

_PROPERTY: Final = "recon_law"


def pytest_generate_tests(metafunc: Any) -> None:
    """One test for each law."""
    contract = getattr(metafunc.function, MARK, None)
    if contract is not None:
        laws = contract.laws()
        metafunc.parametrize("law", laws, ids=[law.id for law in laws])


def pytest_collection_modifyitems(items: list[Any]) -> None:
    """Let the report of a test say which stage it was about; it may come from another process."""
    for item in items:
        if getattr(item.function if hasattr(item, "function") else None, MARK, None) is not None:
            law = item.callspec.params["law"]
            item.user_properties.append((_PROPERTY, [law.subject.stage.key, bool(law.expected_failure)]))


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """How many laws each stage was held to, so that a shrinking number is seen."""
    counts: dict[str, Counter[str]] = {}
    for outcome in ("passed", "failed"):
        for report in terminalreporter.stats.get(outcome, []):
            for name, value in report.user_properties:
                if name == _PROPERTY and report.when == "call":
                    stage, expected = value
                    kind = "expected" if expected and outcome == "passed" else outcome
                    counts.setdefault(stage, Counter())[kind] += 1
    if counts:
        terminalreporter.section("laws")
    for stage, found in sorted(counts.items()):
        terminalreporter.write_line(
            f"{stage}: {found.total()} laws run, {found['passed']} held, "
            f"{found['expected']} expected to fail, {found['failed']} broken"
        )
