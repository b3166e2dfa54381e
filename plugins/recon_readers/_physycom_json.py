"""GNSS records of physycom as JSON: an array of records, or an object whose keys gnss_record_* hold them.

    {"lat": 44.4997189, "lon": 11.3536798, "timestamp": 518716448.1001034, "speed": 4.9176, "alt": 45.0, "fix": 1}

lat, lon, timestamp and speed must be there; alt, heading and fix may be. A speed may be an object with its least,
largest and mean value since the last record; the mean is taken. Numbers stay text until Arrow turns them into
columns, so that times lose no digit.

Writers of JSON sort the keys of an object as texts (gnss_record_10 before gnss_record_2), so records of an object are
put in the order of their numbers.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from recon.errors import ReadFailed
from recon_readers._time_text import TIME_TYPE

KEYS: Final = {"timestamp": "time", "lat": "lat", "lon": "lon", "speed": "speed"}
OPTIONAL_KEYS: Final = {"alt": "height", "heading": "heading", "fix": "fix"}
_MEANS: Final = ("mean", "med", "media", "avg", "average", "ave")
_PREFIX: Final = "gnss_record_"
_SHOWN: Final = 30


def read_records(path: Path, text: bytes) -> pa.Table:
    """Records as columns named as in the streams: time as decimals in s, the others as doubles.

    Raises ReadFailed.
    """
    records = _ordered(path, _parsed(path, text))
    optional = {key: name for key, name in OPTIONAL_KEYS.items() if any(key in record for record in records)}
    columns = {}
    for key, name in {**KEYS, **optional}.items():
        values = [_number(path, index, record, key) for index, record in enumerate(records, start=1)]
        columns[name] = _column(path, key, values)
    return pa.table(columns)


def _parsed(path: Path, text: bytes) -> Any:
    try:
        return json.loads(text.rstrip(b"\0").decode("utf-8"), parse_float=str, parse_int=str, parse_constant=_blank)
    except json.JSONDecodeError as error:
        raise ReadFailed(
            path, f"this is no JSON: {error.msg}", line=error.lineno, column=error.colno, hint="write the file again"
        ) from error
    except UnicodeDecodeError as error:
        raise ReadFailed(path, "this is no UTF-8 text", hint="save it as UTF-8") from error
    except RecursionError as error:
        raise ReadFailed(path, "its brackets are nested too deeply", hint="write the file again") from error


def _blank(name: str) -> str | None:
    """NaN is a missing number; infinities are kept and refused later."""
    return None if name == "NaN" else name


def _ordered(path: Path, data: Any) -> Sequence[Mapping[str, Any]]:
    if isinstance(data, dict):
        keys = sorted((key for key in data if key.startswith(_PREFIX)), key=_number_in)
        data = [data[key] for key in keys]
    if not isinstance(data, list) or not data:
        raise ReadFailed(path, "it holds no GNSS records", hint="expected an array, or an object of gnss_record_* keys")
    for index, record in enumerate(data, start=1):
        if not isinstance(record, dict):
            raise ReadFailed(path, f"record {index} is no JSON object", hint="repair the record or delete it")
        for key in KEYS:
            if key not in record:
                raise ReadFailed(path, f"record {index} has no '{key}'", hint="repair the record or delete it")
    return data


def _number_in(key: str) -> tuple[int, str]:
    found = re.search(r"\d{1,18}$", key)
    return (int(found[0]) if found else -1, key)


def _number(path: Path, index: int, record: Mapping[str, Any], key: str) -> str | None:
    value = record.get(key)
    if key == "speed" and isinstance(value, dict):
        value = next((value[name] for name in _MEANS if name in value), value)
    if value is None or isinstance(value, str):
        return value or None
    shown = json.dumps(value)[:_SHOWN]
    raise ReadFailed(path, f"record {index}: {key} is {shown}, which is no number", hint="repair the record")


def _column(path: Path, key: str, values: list[str | None]) -> pa.Array:
    kind = TIME_TYPE if key == "timestamp" else pa.float64()
    texts = pa.array(values, pa.string())
    try:
        return texts.cast(kind)
    except pa.ArrowInvalid as error:
        for index, value in enumerate(values, start=1):
            if not _castable(value, kind):
                what = f"record {index}: {key} is {value[:_SHOWN]!r}, which is no number" if value else str(error)
                raise ReadFailed(path, what, hint="repair the record or delete it") from error
        raise ReadFailed(path, f"{key}: {error}", hint="repair the records") from error


def _castable(value: str | None, kind: pa.DataType) -> bool:
    try:
        pa.scalar(value, pa.string()).cast(kind)
    except pa.ArrowInvalid:
        return False
    return True
