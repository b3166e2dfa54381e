"""What lies in a seal beside the log and the results: the list of hashes, versions, and a page that explains itself."""

from __future__ import annotations

import hashlib
import platform
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import recon
from recon.evidence.archive import Entry
from recon.registry import Source
from recon.requirement import FIRST_PARTY

NUMBER: Final = 1
"""Of the form of a seal: one with a higher number is refused, for a newer recon made it."""
MARK: Final = "recon_seal"
"""Key of that number in versions.json."""

SUMS: Final = "SHA256SUMS"
README: Final = "README.txt"
MANIFEST: Final = "manifest.json"
PIPELINE: Final = "pipeline.yaml"
VERSIONS: Final = "versions.json"
INPUTS: Final = "inputs"
RESULTS: Final = "results"
EXPORTS: Final = "exports"

_NO_CODE: Final = (".pyc", ".md", ".png")
_KEPT: Final = ("python", "packages", "arithmetic")
"""Of a manifest's environment; the rest tells the machine."""
_REQUIREMENT: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")

_CALLED: Final = "A sealed run of recon "
_TEXT: Final = f"""\
{_CALLED}{{version}}: what a vehicle did, computed from the log of its sensors.

inputs/         the log, byte by byte as it was read
pipeline.yaml   the steps that were run on it
manifest.json   each step with all its parameters and versions, what it learnt, and hashes of inputs and results
results/        the streams that came out, as Parquet or MCAP
exports/        files for people, if there are any; export.json tells what made them of results/
versions.json   Python, packages and hashes of the code that gave these bytes
SHA256SUMS      SHA-256 of every file but this list

To check that nothing was changed, without recon: unpack the archive and run there

    sha256sum -c SHA256SUMS

To run everything again and compare each number:

    pip install recon-dynamics=={{version}}
    recon verify FILE

What this can show, and what it cannot. A changed byte is found, and so is a result that does not follow from the log.
Files in exports/ are made again, too, where their exporter gives the same bytes twice. Of the others, which recon
verify names, nothing is known: who packs an archive anew can put numbers there that are not those of results/.
Who exchanges the log, runs everything again and seals that leaves a seal as good as this one: that this is the file
of that day is shown by its SHA-256 alone, noted where others could see it at the time.
"""


def readme() -> Entry:
    """The page that explains the archive."""
    return Entry.of_text(README, _TEXT.format(version=recon.__version__))


def is_seal(head: bytes) -> bool:
    """Does an archive that begins so look like a seal? That it is as it was sealed, only `verify` can tell.

    head : its first 100 bytes, or more
    """
    return head.startswith(b"PK") and f"{README}{_CALLED}".encode() in head[:100]


def sums(entries: Iterable[Entry]) -> Entry:
    """The list of hashes."""
    found = sorted((entry.name, entry.sha256()) for entry in entries)
    return Entry.of_text(SUMS, "".join(f"{digest}  {name}\n" for name, digest in found))


def anonymous(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """A manifest without what tells the analyst's machine or the time of day: equal runs have equal ones."""
    environment = manifest.get("environment", {})
    return {**manifest, "environment": {key: environment[key] for key in _KEPT if key in environment}}


def versions_of(sources: Iterable[Source], also: Iterable[str] = ()) -> dict[str, Any]:
    """What gives the numbers here: Python, packages, and hashes of the code of recon and of the stages' packages.

    sources : where the stages of a run come from; also : further distributions that decide its bytes
    """
    code = {"recon": (FIRST_PARTY, recon.__version__)}
    for source in sources:
        code.setdefault(source.module.partition(".")[0], (source.distribution, source.version))
    return {
        MARK: NUMBER,
        "recon": recon.__version__,
        "python": sys.version.split()[0],
        "platform": " ".join(filter(None, (platform.system(), platform.machine(), *platform.libc_ver()))),
        "code": [
            {"package": package, "distribution": name, "version": version, "sha256": _code_digest(package)}
            for package, (name, version) in sorted(code.items())
        ],
        "packages": dict(sorted(_needed([*(name for name, _ in code.values()), *also]).items())),
    }


def _code_digest(package: str) -> str:
    """SHA-256 over the names and contents of a package's code and data; "" where it has none on disk."""
    spec = find_spec(package) if package else None
    folders = [Path(place) for place in (spec.submodule_search_locations or ())] if spec else []
    files = sorted(
        (path.relative_to(folder).as_posix(), path)
        for folder in folders
        for path in folder.rglob("*")
        if path.is_file() and path.suffix not in _NO_CODE
    )
    if not files:
        return ""
    found = hashlib.sha256()
    for name, path in files:
        found.update(f"{name}\0{hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    return found.hexdigest()


def _needed(names: Sequence[str]) -> dict[str, str]:
    """Versions of distributions and of all that they need, as far as it is installed; extras are left out."""
    found: dict[str, str] = {}
    waiting, seen = [name.lower() for name in names], set()
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        try:
            about = distribution(name)
        except (PackageNotFoundError, ValueError):
            continue
        found[about.name.lower()] = about.version
        waiting += _requirements(about.requires or ())
    return found


def _requirements(lines: Iterable[str]) -> list[str]:
    """Names of what is needed, in lower case, without what only an extra needs."""
    wanted = (line for line in lines if "extra" not in line.partition(";")[2])
    return [match[0].lower() for line in wanted if (match := _REQUIREMENT.match(line))]


def same_recon(sealed: Mapping[str, Any], here: Mapping[str, Any]) -> bool:
    """Was it sealed by the very code of recon that runs here?"""
    told, runs = (_code_told(one).get(recon.__name__, {}).get("sha256") for one in (sealed, here))
    return bool(told == runs)


def changed_versions(sealed: Mapping[str, Any], here: Mapping[str, Any]) -> list[str]:
    """How what runs here differs from what was sealed, a sentence each."""
    found = [
        f"{name} was {sealed.get(key)}, here it is {here[key]}"
        for key, name in (("recon", "recon"), ("python", "Python"), ("platform", "the platform"))
        if sealed.get(key) != here[key]
    ]
    packages = _mapping(sealed.get("packages"))
    for name, version in here["packages"].items():
        if packages.get(name) not in (None, version) and name != FIRST_PARTY:
            found.append(f"{name} was {packages[name]}, here it is {version}")
    code = _code_told(sealed)
    for part in here["code"]:
        before = code.get(part["package"])
        if before is not None and before.get("sha256") != part["sha256"]:
            same = before.get("version") == part["version"]
            found.append(f"the code of {part['package']} is another one" + f", also of {part['version']}" * same)
    return found


def _code_told(versions: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """What versions tell of each package's code, by its name."""
    told = versions.get("code")
    return {str(part.get("package")): part for part in map(_mapping, told if isinstance(told, list) else ())}


def _mapping(data: object) -> Mapping[str, Any]:
    """The object that a seal tells; an empty one where it is something else, for anybody may have written it."""
    return data if isinstance(data, Mapping) else {}
