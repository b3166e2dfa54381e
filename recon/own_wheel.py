"""The wheel of the recon that runs: built from its checkout, or put together again from its installed files.

An installed distribution lists its files in RECORD; a wheel is a zip of them with a RECORD of its own. What the
installer added (scripts, bytecode, INSTALLER, REQUESTED, direct_url.json) is left out.

Reference: PEP 427, PEP 376, PEP 610.
"""

from __future__ import annotations

import base64
import hashlib
import json
import subprocess
import sys
import zipfile
from importlib.metadata import Distribution, distribution
from pathlib import Path, PurePosixPath
from typing import Final
from urllib.parse import urlsplit
from urllib.request import url2pathname

from recon.errors import PluginError
from recon.requirement import FIRST_PARTY

_INSTALLERS: Final = ("RECORD", "INSTALLER", "REQUESTED", "direct_url.json")
_EPOCH: Final = (1980, 1, 1, 0, 0, 0)
"""Time of every file in the wheel, so that equal ones make equal wheels."""


def own_wheel(folder: Path) -> Path:
    """The wheel, in this folder. Raises PluginError where pip cannot build it."""
    found = distribution(FIRST_PARTY)
    checkout = _checkout(found)
    return from_record(found, folder) if checkout is None else _built(checkout, folder)


def from_record(found: Distribution, folder: Path) -> Path:
    """The wheel of an installed distribution."""
    version = found.version
    target = folder / f"{FIRST_PARTY.replace('-', '_')}-{version}-py3-none-any.whl"
    listed = [path for path in found.files or () if _belongs(path)]
    record = next(path for path in found.files or () if path.name == "RECORD")
    rows = []
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as wheel:
        for path in sorted(listed, key=str):
            content = Path(str(path.locate())).read_bytes()
            wheel.writestr(_entry(path), content, zipfile.ZIP_DEFLATED)
            digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
            rows.append(f"{path.as_posix()},sha256={digest},{len(content)}\n")
        wheel.writestr(_entry(record), "".join([*rows, f"{record.as_posix()},,\n"]), zipfile.ZIP_DEFLATED)
    return target


def pip(*words: str) -> None:
    """Run pip of this Python. Raises PluginError with its last word where it fails."""
    command = [sys.executable, "-P", "-m", "pip", "--disable-pip-version-check", *words]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode:
        said = [line.strip() for line in done.stderr.splitlines() if line.strip()]
        told = next((line for line in said if line.startswith("ERROR")), said[-1] if said else "it said nothing")
        raise PluginError(f"pip {words[0]} failed: {told}", f"the command was {' '.join(command)}")


def _checkout(found: Distribution) -> Path | None:
    """Folder of the source that is installed as it is, by pip install --editable."""
    told = next((path for path in found.files or () if path.name == "direct_url.json"), None)
    origin = json.loads(Path(str(told.locate())).read_text(encoding="utf-8")) if told is not None else {}
    if not origin.get("dir_info", {}).get("editable"):
        return None
    return Path(url2pathname(urlsplit(origin["url"]).path))


def _built(checkout: Path, folder: Path) -> Path:
    pip("wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder), str(checkout))
    return next(folder.glob(f"{FIRST_PARTY.replace('-', '_')}-*.whl"))


def _belongs(path: PurePosixPath) -> bool:
    return ".." not in path.parts and path.suffix != ".pyc" and path.name not in _INSTALLERS


def _entry(path: PurePosixPath) -> zipfile.ZipInfo:
    return zipfile.ZipInfo(path.as_posix(), _EPOCH)
