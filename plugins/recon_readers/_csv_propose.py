"""A mapping for `reader.csv` guessed from header words and ranges of values, as YAML to be checked and saved.

Every guess stands with its reason; one that the values cannot settle is marked `check`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from recon.errors import ReadFailed
from recon.yaml_scalars import reads_as_text
from recon_readers._csv_guesses import (
    Group,
    axes_of,
    gnss_groups,
    named_vectors,
    other_groups,
    time_for,
    unnamed_vectors,
)
from recon_readers._csv_looks import Look, TimeLook, look_at, time_looks
from recon_readers._csv_sheet import Sheet
from recon_readers._csv_text import Form, open_sheet

_SAMPLE_BYTES: Final = 4_000_000


@dataclass
class Proposal:
    """A stream while it is put together.

    time : where its times come from; facts : lines of YAML that belong to the whole stream, each with its reason
    """

    time: TimeLook
    facts: list[tuple[str, str]] = field(default_factory=list)
    groups: list[Group] = field(default_factory=list)


def propose(paths: Sequence[Path]) -> str | None:
    """The mapping as YAML; None where a file is no delimited text or nothing in it can be told."""
    files = [(path, _of_file(path)) for path in paths]
    if any(not streams for _, streams in files):
        return None
    shown = " ".join(in_shell(path) for path in paths)
    lines = [
        "# A mapping for reader.csv, guessed from header and values. Check it, above all where it says 'check',",
        "# save it as mapping.yaml and use it:",
        f"#   recon inspect {shown} --set reader.csv.columns=@mapping.yaml",
    ]
    names = list(dict.fromkeys(name for _, streams in files for name in streams))
    for name in names:
        holders = [(path, streams[name]) for path, streams in files if name in streams]
        lines += _stream_lines(name, holders, several=len(files) > 1)
    for path, streams in files:
        unused = _unused(path, streams)
        lines += [f"# not used of {path.name}: {unused}"] * bool(unused)
    return "\n".join(_one_line(line) for line in lines)


def _one_line(line: str) -> str:
    """Without what YAML does not allow in a comment."""
    return "".join(character if character.isprintable() else "?" for character in line)


def in_shell(path: Path) -> str:
    """A path as it is typed on a command line: in quotes where it holds more than letters, digits, . / and -."""
    return f'"{path}"' if re.search(r"[^\w./-]", str(path)) else str(path)


def _of_file(path: Path) -> dict[str, Proposal]:
    """The streams that a file seems to hold, by name."""
    try:
        sheet = _sample(open_sheet(path, Form()))
        looks = look_at(sheet)
    except ReadFailed:
        return {}
    times = time_looks(looks)
    if not times:
        return {}
    taken = {look.index for time in times for look in time.columns}
    free = [look for look in looks if look.values is not None and look.index not in taken]
    streams: dict[str, Proposal] = {}
    vectors = named_vectors(free, path) if sheet.names else unnamed_vectors(free)
    for group in vectors:
        stream = "mag" if group.name == "mag" else "imu"
        found = streams.setdefault(stream, Proposal(time_for(group.looks, times)))
        found.groups.append(group)
    axes = [fact for group in vectors if group.name == "accel" for fact in axes_of(group)]
    for stream in ("imu", "mag"):
        if stream in streams:
            streams[stream].facts += axes
    gnss = gnss_groups(free, times)
    if gnss:
        streams["gnss"] = Proposal(time_for(gnss[0].looks, times), [], gnss)
        if any(group.name == "height" for group in gnss):
            streams["gnss"].facts.append(("height_datum: mean_sea_level", "check: or ellipsoid"))
    for stream, group in other_groups(free).items():
        streams.setdefault(stream, Proposal(time_for(group.looks, times))).groups.append(group)
    return streams


def _sample(sheet: Sheet) -> Sheet:
    """The first megabytes; what they show suffices for a guess."""
    if sheet.end - sheet.start <= _SAMPLE_BYTES:
        return sheet
    begin = next(sheet.text.blocks(sheet.start, sheet.start + _SAMPLE_BYTES, quoted=sheet.text.quotes > 0))
    return replace(sheet, end=sheet.start + len(begin))


def _stream_lines(name: str, holders: Sequence[tuple[Path, Proposal]], *, several: bool) -> list[str]:
    """A stream, from one file or from several that hold a sensor each."""
    time = holders[0][1].time
    lines = ["", f"{name}:", _line(f"time: {{{_columns(time.columns)}, {time.yaml}}}", time.reason)]
    if several and len(holders) == 1:
        lines.append(f"  file: {json.dumps(holders[0][0].name)}")
    facts = dict(fact for _, found in holders for fact in found.facts)
    lines += [_line(text, reason) for text, reason in facts.items()]
    done: set[str] = set()
    for path, found in holders:
        for group in found.groups:
            if group.name in done:
                continue
            done.add(group.name)
            parts = [_columns(group.looks), *([group.keys] if group.keys else [])]
            parts += [f"file: {json.dumps(path.name)}"] * (len(holders) > 1)
            lines.append(_line(f"{group.name}: {{{', '.join(parts)}}}", group.reason))
    return lines


def _line(text: str, reason: str) -> str:
    return f"  {text}  # {reason}"


def _columns(looks: Sequence[Look]) -> str:
    names = [_name(look) for look in looks]
    return f"column: {names[0]}" if len(names) == 1 else f"columns: [{', '.join(names)}]"


def _name(look: Look) -> str:
    """A column as YAML: its word where the header has one."""
    if not look.title:
        return str(look.index + 1)
    plain = re.fullmatch(r"[A-Za-z_][\w.-]*", look.title, re.ASCII) and reads_as_text(look.title)
    return look.title if plain else json.dumps(look.title)


def _unused(path: Path, streams: dict[str, Proposal]) -> str:
    used = {look.index for found in streams.values() for group in found.groups for look in group.looks}
    used |= {look.index for found in streams.values() for look in found.time.columns}
    names = open_sheet(path, Form()).names
    return ", ".join(name for index, name in enumerate(names) if index not in used and name)
