"""Findings on their way from analyzer.doctor to people and programs: as metrics, as JSON, as a pipeline that puts right
what can be put right.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from recon.findings import PREFIX
from recon.numerics.doctor import Claims, Finding
from recon.numerics.doctor.axes import in_file
from recon.numerics.doctor.units import ACCELERATIONS, RATES, SPEEDS, scale_of
from recon.pipeline import Pipeline, Step
from recon.problems import Where
from recon.rows import Metric
from recon.yaml_nodes import Node

_UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    "speed_unit": SPEEDS,
    "accel_unit": ACCELERATIONS,
    "gyro_unit": RATES,
}
_SWAPPED: Final = {"swap x y": "LFU", "swap x z": "ULF", "swap y z": "FUL"}
"""Where the axes point as they are called; two of them in the wrong place make them left-handed."""
_CLOCKS: Final = ("clock_drift", "leap_seconds", "time_zone", "gnss_velocity_lag", "gnss_position_lag")
_FURTHER_S: Final = 0.1
"""Sigma of the further delay of velocities that fuser.map begins with."""
Json = dict[str, Any]
Fix = dict[str, Json]
"""Parameters by stage."""


def as_data(one: Finding) -> Json:
    """One finding as JSON data: what `recon doctor --json` lists."""
    return {
        "code": one.code,
        "status": one.status,
        "value": one.value,
        "unit": one.unit,
        "confidence": round(one.confidence, 4),
        "statistic": {name: value for name, value in one.statistic.items() if np.isfinite(value)},
        "explanation": one.explanation,
        "yaml": one.yaml,
    }


def metric_of(one: Finding) -> Metric:
    """A finding as a row: its value where it is a number, its status as method, everything as JSON in the note, the
    picture as `evidence`.
    """
    data = as_data(one)
    if one.picture is not None:
        data["evidence"] = {
            "title": one.picture.title,
            "unit": one.picture.unit,
            "curves": [
                {"name": c.name, "points": c.points, "t_s": _rounded(c.t_s), "values": _rounded(c.values)}
                for c in one.picture.curves
            ],
        }
    value = float(one.value) if isinstance(one.value, float | int) else None
    return Metric(f"{PREFIX}{one.code}", value, one.unit, method=one.status, note=json.dumps(data, allow_nan=False))


def _rounded(values: Sequence[float] | np.ndarray) -> list[float]:
    return [float(f"{value:.6g}") for value in np.asarray(values)]


def fix_of(
    one: Finding,
    claims: Claims,
    reader: str,
    letters: str,
    position_lag: float | None = None,
    *,
    mistaken: bool = False,
) -> Fix:
    """Parameters by stage that put right what a finding contradicts; {} where nothing of ours does.

    reader : key of the reader, such as reader.physycom; letters : where x, y, z point, "" where not known
    mistaken : has one axis the wrong sign? It is put right in the axes that the reader gives, so these must stay
    position_lag : s, by which all stamps are shifted where it is known; fuser.map finds how much later velocities are
    """
    if one.status != "contradicted":
        return {}
    if one.code in _UNITS:
        return _fix_of_unit(one, claims, reader)
    if one.code in _CLOCKS:
        return _fix_of_clock(one, position_lag)
    value = one.value
    if one.code == "gravity_sign":
        if reader == "reader.csv":
            return {reader: {"columns": {"imu": {"accel": {"at_rest": value}}}}}
        return {"aligner.axes": {"at_rest": "down"}}
    if one.code == "inverted_axis":
        sensor, _, axis = str(value).partition("_")
        return {"aligner.axes": {"inverted": [f"{sensor}_{name}" for name in axis or "xyz"]}}
    if one.code == "axes" and value in _SWAPPED:
        return {"aligner.axes": {"axes": _SWAPPED[str(value)]}}
    if one.code in ("forward_axis", "axes") and letters:
        if reader == "reader.csv" and not mistaken:
            return {reader: {"columns": {"imu": {"axes": in_file(letters, claims.axes)}}}}
        return {"aligner.axes": {"axes": letters}}
    return {}


def _fix_of_clock(one: Finding, position_lag: float | None) -> Fix:
    """All stamps of GNSS shifted, or the further delay of its velocities, where that of its positions is known."""
    if one.code == "clock_drift":
        return {"aligner.time_offset": {"drift": one.value}} if isinstance(one.value, float) else {}
    late = float(one.value or 0.0)
    if one.code == "gnss_velocity_lag" and position_lag is not None:
        further = abs(late - position_lag)
        return {"fuser.map": {"gnss_velocity_delay": f"{further:.2g} s"}} if further > _FURTHER_S else {}
    return {"aligner.time_offset": {"shift": late * (3600.0 if one.code == "time_zone" else 1.0)}}


def needless(one: Finding, fix: Fix, position_lag: float | None) -> str:
    """Why nothing is offered for a delay of GNSS that is found; "" where something is, or for any other finding."""
    if one.status != "contradicted" or one.code != "gnss_velocity_lag" or fix or position_lag is None:
        return ""
    return (
        " Nothing has to be put right for fuser.map (best_accuracy, crash), which finds by itself how much later than "
        f"positions speeds are; for other pipelines shift GNSS: aligner.time_offset, shift {position_lag:.2g} s."
    )


def _fix_of_unit(one: Finding, claims: Claims, reader: str) -> Fix:
    """The unit in the mapping of a text, in the parameter of physycom; else the factor by which the imu is wrong."""
    value = str(one.value)
    if value == "gravity removed":
        return {}
    stream, group = {"speed_unit": ("gnss", "speed"), "accel_unit": ("imu", "accel"), "gyro_unit": ("imu", "gyro")}[
        one.code
    ]
    factor = scale_of(_UNITS[one.code], getattr(claims, one.code), value)
    if reader == "reader.csv":
        said = {"scale": factor} if value.startswith("times ") else {"unit": value}
        return {reader: {"columns": {stream: {group: said}}}}
    if one.code == "speed_unit":
        return {reader: {"speed_unit": value}} if reader == "reader.physycom" and value in ("km/h", "m/s") else {}
    return {"aligner.axes": {f"{group}_scale": float(f"{factor:.6g}")}}


def yaml_of(fix: Mapping[str, Json]) -> str:
    """Steps that a user may copy into his pipeline; "" without any."""
    import yaml

    steps = [{"use": stage, "params": _with_units(stage, params)} for stage, params in fix.items()]
    return str(yaml.safe_dump(steps, sort_keys=False, default_flow_style=None)) if steps else ""


def _with_units(stage: str, params: Json) -> Json:
    if stage != "aligner.time_offset":
        return params
    units = {"shift": "s", "drift": "us/s"}
    return {key: f"{value:.9g} {units[key]}" for key, value in params.items()}


def merged(fixes: Iterable[Mapping[str, Json]]) -> Fix:
    """All fixes together: shifts add up, lists are joined, mappings are merged."""
    found: Fix = {}
    for fix in fixes:
        for stage, params in fix.items():
            found[stage] = _laid_over(found.get(stage, {}), params)
    return found


def _laid_over(under: Json, over: Json) -> Json:
    made = dict(under)
    for key, value in over.items():
        if key not in made:
            made[key] = value
        elif isinstance(value, dict):
            made[key] = _laid_over(made[key], value)
        elif isinstance(value, list) or key == "shift":
            made[key] = made[key] + value
        else:
            made[key] = value
    return made


def fix_in(yaml_text: str) -> Fix:
    """Parameters by stage from what `yaml_of` wrote."""
    from recon.yaml_nodes import load

    steps: Any = load(yaml_text, "<doctor>").plain() if yaml_text else []
    found: Fix = {}
    for step in steps:
        timed = step["use"] == "aligner.time_offset"
        params = step["params"].items()
        found[step["use"]] = {key: float(str(value).split()[0]) if timed else value for key, value in params}
    return found


def repaired(fixes: Mapping[str, Json], readers: Mapping[str, Json]) -> Pipeline:
    """best_accuracy with what was found put right first.

    fixes : parameters by stage; readers : parameters that the readers were given, by reader
    """
    own = merged([readers, {name: params for name, params in fixes.items() if name.startswith("reader.")}])
    reader, *others = Pipeline.from_file("best_accuracy").steps
    stages = ("aligner.axes", "aligner.time_offset")
    steps = [_step(reader.use, own)]
    steps += [_step(stage, _with_units(stage, fixes[stage])) for stage in stages if stage in fixes]
    steps += [_step(step.use, fixes.get(step.use, {})) for step in others]
    about = "best_accuracy with what recon doctor found put right before it."
    return Pipeline("fixed", tuple(steps), about=about)


def _step(use: str, params: Mapping[str, Any]) -> Step:
    where = Where("<doctor>")
    return Step(use, use, Node.of(dict(params), where), where)
