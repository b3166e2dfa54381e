"""Seals taken apart, changed and packed again, as somebody with recon's code could do."""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Callable
from functools import partial
from io import BytesIO
from pathlib import Path

import pyarrow.parquet as pq

from recon.arithmetic import Arithmetic
from recon.evidence import archive

IMU = "results/streams/imu.parquet"
ELSEWHERE = Arithmetic(("openblas Abacus",), ("BEADS",), 1)


def contents_of(file: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(file) as opened:
        return {name: opened.read(name) for name in opened.namelist()}


def pack(files: dict[str, bytes], file: Path) -> Path:
    """The archive that recon would write of these files."""
    archive.write([archive.Entry(name, len(data), partial(BytesIO, data)) for name, data in files.items()], file)
    return file


def forge(file: Path, change: Callable[[dict[str, bytes]], None]) -> Path:
    """The seal with its contents changed, and all hashes made to fit: what somebody with recon's code can do."""
    files = contents_of(file)
    change(files)
    manifest = json.loads(files["manifest.json"])
    for number, entry in enumerate(manifest["inputs"], 1):
        told_of(entry, files[f"inputs/{number}/{entry['name']}"])
    for output in manifest["outputs"]:
        told_of(output, files[f"results/{output['file']}"])
    files["manifest.json"] = (json.dumps(manifest, indent=1, ensure_ascii=False) + "\n").encode()
    del files["SHA256SUMS"]
    lines = [f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in sorted(files.items())]
    return pack({**files, "SHA256SUMS": "".join(lines).encode()}, file)


def told_of(entry: dict, data: bytes) -> None:
    entry.update(bytes=len(data), sha256=hashlib.sha256(data).hexdigest())


def edited_stream(data: bytes, folder: Path, edit: Callable, **options) -> bytes:
    (folder / "a.parquet").write_bytes(data)
    table = edit(pq.read_table(folder / "a.parquet"))
    pq.write_table(table, folder / "b.parquet", **options)
    return (folder / "b.parquet").read_bytes()


def otherwise_computed(files: dict[str, bytes]) -> None:
    """Have a manifest tell of a processor that there is not."""
    manifest = json.loads(files["manifest.json"])
    manifest["environment"]["arithmetic"] = ELSEWHERE.as_data()
    files["manifest.json"] = json.dumps(manifest).encode()
