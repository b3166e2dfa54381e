"""Laws of aligners that declare `rotation`: they turn vectors, into the frame that they name, and do nothing else.

PYTEST_DONT_REWRITE: what a law says is a sentence already.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Final

import numpy as np
import pyarrow as pa

from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.rotation import from_euler, rotate
from recon.schema import Need, group_of
from recon.stages import Aligner
from recon.tables import Array, matrix, replace, schema_of, time_ns
from recon.testing.contract import law
from recon.testing.drives import ACCEL_BIAS_S, drive
from recon.testing.serving import serve
from recon.testing.subject import Subject

ROUNDING: Final = 1e-12
"""A product of two quaternions and a vector: some ten operations of 2e-16 each, with margin."""
TILT: Final = 2.0 * float(np.linalg.norm(ACCEL_BIAS_S)) / STANDARD_GRAVITY
"""rad. Gravity is seen through the accelerometer's bias, by which it leans |b| / g; twice that for the noise."""
YAW: Final = 2.0 * float(np.linalg.norm(ACCEL_BIAS_S)) / 2.0
"""rad. Forward is seen in accelerations of about 2 m/s^2 through the same bias; twice |b| / 2 for the noise."""


@law(Aligner, when=lambda stage: stage.rotation)
def turned_vectors_keep_their_length(subject: Subject) -> None:
    """A rotation changes the length of no vector, in no row."""
    inputs = subject.inputs()
    returned = _returned(subject, inputs)
    for name, group in _turned(subject, inputs):
        before, after = (np.linalg.norm(matrix(s[name], group, gaps=True), axis=1) for s in (inputs, returned))
        wrong = np.flatnonzero(np.abs(after - before) > ROUNDING * before)
        assert not len(wrong), (
            f"{name}.{group} in row {wrong[0]} had the length {before[wrong[0]]:g} and has {after[wrong[0]]:g}; "
            "its record declares rotation"
        )


@law(Aligner, when=lambda stage: stage.rotation)
def turned_vectors_keep_their_angles(subject: Subject) -> None:
    """All vectors of a row turn together: the angle between any two of them stays."""
    inputs = subject.inputs()
    returned = _returned(subject, inputs)
    groups: dict[str, list[str]] = {}
    for name, group in _turned(subject, inputs):
        groups.setdefault(name, []).append(group)
    for name, (first, *others) in groups.items():
        for other in others:
            before, after = (_cosines(streams[name], first, other) for streams in (inputs, returned))
            assert np.allclose(after, before, rtol=0.0, atol=ROUNDING, equal_nan=True), (
                f"{name}.{first} and {name}.{other} were not turned by one rotation: the angle between them changed"
            )


@law(Aligner, when=lambda stage: stage.rotation)
def the_result_is_in_another_frame_that_is_declared(subject: Subject) -> None:
    """`writes` names the frame into which the vectors were turned, and it is not the one in which they came."""
    inputs = subject.inputs()
    turned = _turned(subject, inputs)
    assert turned, "its record declares rotation, but `writes` changes the frame of no vector that it reads"


@law(Aligner, when=lambda stage: stage.rotation)
def the_result_agrees_with_the_truth_in_its_frame(subject: Subject) -> None:
    """Vectors of a drive are turned to where they truly point, as far as the noise of the sensors lets that be seen."""
    recording = drive()
    inputs = serve(recording, subject.stage.reads)
    _assert_same_directions(subject, _returned(subject, inputs), _in_target(subject, inputs), "is off the truth")


@law(Aligner, when=lambda stage: stage.rotation)
def what_is_aligned_already_stays(subject: Subject) -> None:
    """A box whose axes are those of the frame that is asked for is left as it is, but for the noise of the sensors."""
    aligned = _in_target(subject, serve(drive(), subject.stage.reads))
    _assert_same_directions(subject, _returned(subject, aligned), aligned, "was turned although it was aligned already")


def _returned(subject: Subject, inputs: Mapping[str, pa.Table]) -> dict[str, pa.Table]:
    """What the stage makes of its inputs: vectors are turned row by row, so no row may come or go."""
    returned = subject.run(inputs)
    for name, _ in _turned(subject, inputs):
        same = np.array_equal(time_ns(returned[name]), time_ns(inputs[name]))
        assert same, f"'{name}' came back with other rows; its record declares rotation, which changes none"
    return returned


def _assert_same_directions(
    subject: Subject, found: Mapping[str, pa.Table], expected: Mapping[str, pa.Table], fault: str
) -> None:
    """Compare the vectors of all rows: first the turn about the vertical, then, without it, the tilt that is left."""
    frames = _frames(subject, expected)
    for name, group in _turned(subject, expected):
        here, there = matrix(found[name], group), matrix(expected[name], group)
        yaw = _yaw_between(here, there)
        if frames[name][group] != "level":  # which leaves it open where x and y point
            assert abs(yaw) <= YAW, _words(name, group, fault, "about the vertical", yaw, YAW)
        left = rotate(from_euler(yaw, 0.0, 0.0), here) - there
        tilt = float(np.linalg.norm(left) / np.linalg.norm(there))
        assert tilt <= TILT, _words(name, group, fault, "away from the vertical", tilt, TILT)


def _yaw_between(here: Array, there: Array) -> float:
    """The angle in rad by which vectors (n, 3) must turn about z to meet others best."""
    x, y = here[:, 0], here[:, 1]
    return float(np.arctan2(x @ there[:, 1] - y @ there[:, 0], x @ there[:, 0] + y @ there[:, 1]))


def _words(name: str, group: str, fault: str, way: str, found: float, allowed: float) -> str:
    return (
        f"{name}.{group} {fault}, by {abs(np.degrees(found)):.2f} deg {way}; "
        f"the noise of the suite's sensors explains {np.degrees(allowed):.2f} deg"
    )


def _frames(subject: Subject, inputs: Mapping[str, pa.Table]) -> dict[str, dict[str, str]]:
    """Frame of each group by stream, as planned for what the stage returns."""
    outputs = subject.plan(inputs).steps[0].outputs
    return {name: {group_of(c.name): c.frame for c in schema.columns} for name, schema in outputs.items()}


def _turned(subject: Subject, inputs: Mapping[str, pa.Table]) -> list[tuple[str, str]]:
    """Streams and groups whose frame the stage changes."""
    return [
        (name, group)
        for name, planned in _frames(subject, inputs).items()
        if name in inputs
        for group, frame in {group_of(c.name): c.frame for c in schema_of(inputs[name]).columns}.items()
        if planned.get(group, frame) != frame
    ]


def _in_target(subject: Subject, inputs: Mapping[str, pa.Table]) -> dict[str, pa.Table]:
    """The inputs with the truth's vectors in the frames of the result, stamped as the stage wants to read them."""
    frames = _frames(subject, inputs)
    aligned = dict(inputs)
    for name, group in _turned(subject, inputs):
        columns = [c for c in subject.stage.reads[name].columns if group_of(c.name) == group]
        turned = Need(tuple(dataclasses.replace(c, frame=frames[name][group]) for c in columns))
        aligned[name] = replace(aligned[name], **{group: matrix(serve(drive(), {name: turned})[name], group)})
    return aligned


def _cosines(table: pa.Table, first: str, second: str) -> Array:
    """Cosine of the angle between two vectors, row by row: (n,), NaN where one has no length."""
    a, b = (matrix(table, group, gaps=True) for group in (first, second))
    lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    return np.asarray(np.einsum("ij,ij->i", a, b) / np.where(lengths > 0.0, lengths, np.nan))
