"""Streams and what their reader told of them, as the arrays that the doctor looks at."""

from __future__ import annotations

import json
import re
from typing import Any, Final

import pyarrow as pa

from recon import has, meta, seconds, time_ns, vector
from recon.numerics.doctor import Claims, Gnss, Imu, Log
from recon.tables import matrix_or_nan, vector_or_nan

_FRD: Final = "logged along forward, right, down"
_REPEATING, _BACKWARDS = "rows_of_one_time", "rows_out_of_order"


def log_of(
    imu: pa.Table | None, gnss: pa.Table | None, gnss_2: pa.Table | None, reference: pa.Table | None, claims: Claims
) -> Log:
    """Times count from the first row of imu, else of gnss."""
    first = next(table for table in (imu, gnss) if table is not None and table.num_rows)
    start = int(time_ns(first)[0])
    others = {"gnss": gnss, "gnss_2": gnss_2, "reference": reference}
    heights = {
        name: (seconds(table, since=start), vector(table, "height", gaps=True))
        for name, table in others.items()
        if table is not None and has(table, "height")
    }
    return Log(_imu(imu, start), _gnss(gnss, start), claims, heights)


def _imu(table: pa.Table | None, start: int) -> Imu | None:
    if table is None or not table.num_rows:
        return None
    return Imu(seconds(table, since=start), matrix_or_nan(table, "accel"), matrix_or_nan(table, "gyro"))


def _gnss(table: pa.Table | None, start: int) -> Gnss | None:
    if table is None or not table.num_rows:
        return None
    columns = {name: vector_or_nan(table, name) for name in ("lat", "lon", "height", "speed", "course")}
    groups = {"vel_n": "vel", "pos_std": "pos_std", "vel_std": "vel_std"}
    vectors = {name: matrix_or_nan(table, group) for name, group in groups.items()}
    return Gnss(t_s=seconds(table, since=start), **columns, **vectors)


def claims_of(learnt: pa.Table | None, gnss: pa.Table | None, sensor_class: str) -> tuple[Claims, str]:
    """What the reader took for granted, by the rows that it wrote; and its key."""
    rows = learnt.to_pylist() if learnt is not None else []
    facts = meta(gnss) if gnss is not None else {}
    reader, given = _reader(rows)
    said: dict[str, Any] = _of_mapping(given.get("columns") or {})
    if reader == "reader.physycom":
        said |= {"speed_unit": given.get("speed_unit", "km/h"), "accel_unit": "g", "gyro_unit": "deg/s"}
    if any(_FRD in (row["note"] or "") for row in rows):
        said["axes"] = "FRD"
    claims = Claims(
        **said,
        heading_kind=str(facts.get("heading_kind", "")),
        height_datum=str(facts.get("height_datum", "")),
        sensor_class=sensor_class,
        dropped={
            "same time": sum(row["value"] or 0.0 for row in rows if row["name"] == _REPEATING),
            "backwards": sum(row["value"] or 0.0 for row in rows if row["name"] == _BACKWARDS),
        },
    )
    return claims, reader


def _reader(rows: list[dict[str, Any]]) -> tuple[str, dict[str, Any]]:
    """Key and parameters of the reader."""
    for row in rows:
        if row["name"] == "reader_parameters":
            return row["method"] or "", json.loads(row["note"] or "{}")
    return "", {}


def _of_mapping(columns: dict[str, Any]) -> dict[str, Any]:
    """Units, axes and sign of a mapping of reader.csv."""
    imu, gnss = columns.get("imu") or {}, columns.get("gnss") or {}
    accel, gyro, speed = imu.get("accel") or {}, imu.get("gyro") or {}, gnss.get("speed") or {}
    axes = accel.get("axes") or imu.get("axes") or ""
    said = {
        "axes": axes if re.fullmatch("[FBLRUD]{3}", axes) else "",
        "at_rest": accel.get("at_rest"),
        "accel_unit": accel.get("unit"),
        "gyro_unit": gyro.get("unit"),
        "speed_unit": speed.get("unit"),
    }
    return {key: value for key, value in said.items() if value}
