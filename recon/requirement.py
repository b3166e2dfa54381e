"""Which recon a distribution asks for, in its own metadata: `Requires-Dist: recon-dynamics>=0.3`.

An installer sees to it, unless it is told not to or recon is put back to an older version later; then the sentence
"needs recon-dynamics>=0.3, this is 0.1.0" is worth more than the ImportError that would follow. For that lower bounds
suffice (>=, >, ~=, ==), compared by the numbers of the release: a pre-release counts as its release. Requirements with
an environment marker, extras among them, are left to the installer.

Reference: PEP 440, PEP 508.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, requires
from itertools import zip_longest
from typing import Final

FIRST_PARTY: Final = "recon-dynamics"

_NAME: Final = re.compile(r"\s*([A-Za-z0-9._-]*[A-Za-z0-9])\s*(?:\[[^\]]*\])?")
_LOWER: Final = re.compile(r"(>=|~=|===?|>)\s*v?(\d+(?:\.\d+)*)")


def canonical(distribution: str) -> str:
    """The name by which installers know a distribution: lower case, runs of - _ . as one -."""
    return re.sub(r"[-_.]+", "-", distribution).lower()


def requirements_of(distribution: str) -> list[str]:
    """What an installed distribution requires, as its metadata lists it; empty for one that is not installed."""
    try:
        return requires(distribution) or []
    except PackageNotFoundError:
        return []


def unmet(requires: Iterable[str], installed: str) -> str:
    """What of recon is needed and newer than `installed`, such as "recon-dynamics>=9"; "" where nothing is.

    requires : requirements as a distribution's metadata lists them
    """
    for requirement in requires:
        name = _NAME.match(requirement)
        if name is None or canonical(name[1]) != FIRST_PARTY or ";" in requirement:
            continue
        for operator, bound in _LOWER.findall(requirement[name.end() :]):
            missing = _compare(installed, bound)
            if missing < 0 or (missing == 0 and operator == ">"):
                return f"{FIRST_PARTY}{operator}{bound}"
    return ""


def _compare(one: str, other: str) -> int:
    """-1, 0 or 1 as the release of one version is older than, the same as or newer than that of the other."""
    for a, b in zip_longest(_release(one), _release(other), fillvalue=0):
        if a != b:
            return -1 if a < b else 1
    return 0


def _release(version: str) -> list[int]:
    numbers = re.match(r"v?(\d+(?:\.\d+)*)", version)
    return [int(part) for part in numbers[1].split(".")] if numbers else []
