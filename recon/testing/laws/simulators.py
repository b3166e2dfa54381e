"""Laws of simulators: the truth is one motion, the sensors see it, and the seed makes noise alone.

PYTEST_DONT_REWRITE: what a law says is a sentence already.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa

from recon.numerics.geodesy import STANDARD_GRAVITY, Anchor, geodetic_to_enu, local_axes_e, normal_gravity
from recon.numerics.integration import Rule, increments
from recon.numerics.rotation import Floats, conjugate, multiply, rotate, to_rotvec
from recon.schema import APPENDED
from recon.stages import Simulator
from recon.tables import has, matrix, meta, seconds, select_rows, time_ns, vector
from recon.testing.contract import law
from recon.testing.subject import Subject

ROUNDING: Final = 1e-9
"""Of a coordinate's largest value, and the s to which times are rounded."""
RATE: Final = 2e-4
"""rad/s: twice the rotation of the Earth, which a simulator may leave out."""
FORCE: Final = 0.01
"""m/s^2: what the models of gravity and the Coriolis force differ by; g of the place is known ten times better."""
PLACE: Final = 0.01
"""m and m/s: far above the rounding of degrees and times."""


@law(Simulator, when=lambda stage: "reference" in stage.writes)
def the_truth_is_the_integral_of_its_rates(subject: Subject) -> None:
    """From row to row position changes by the velocity, velocity by the acceleration, attitude by the angular rate.

    Where the truth knows its place on the Earth, its velocity is relative to east, north and up there.
    """
    truth = subject.run()["reference"]
    for step in _steps(truth):
        error = np.abs(step.change - step.area).max(axis=1)
        worst = int(error.argmax())
        assert error[worst] <= step.allowed, (
            f"from row {worst} to the next of 'reference' {step.name} changes by {np.round(step.change[worst], 9)}, "
            f"but the integral of {step.rate} is {np.round(step.area[worst], 9)}; "
            f"the step explains a difference of {step.allowed:.2g}"
        )


@law(Simulator, when=lambda stage: bool(stage.ideal))
def ideal_sensors_measure_the_truth(subject: Subject) -> None:
    """With the parameters of `ideal`, imu and gnss see what the truth says, however the box is mounted."""
    assert isinstance(subject.stage, Simulator)
    returned = subject.with_params(**subject.stage.ideal).run()
    truth = returned.get("reference")
    assert has(truth, "accel"), "its record says when its sensors are ideal, but it returns no 'reference' with accel"
    assert has(truth, "gyro"), "its record says when its sensors are ideal, but it returns no 'reference' with gyro"
    seen = [*_inertial_pairs(returned), *_satellite_pairs(returned)]
    assert seen, "its record says when its sensors are ideal, but it returns neither imu nor gnss"
    for name, found, expected, allowed in seen:
        error = float(np.abs(found - expected).max())
        assert error <= allowed, (
            f"of ideal sensors {name} is off the truth by up to {error:.3g}; {allowed:g} is allowed"
        )


@law(Simulator, when=lambda stage: "seed" in stage.params.model_fields)
def another_seed_gives_other_noise_on_the_same_truth(subject: Subject) -> None:
    """The seed touches the measurements and not the motion."""
    first, second = (subject.with_params(seed=seed).run() for seed in (1, 2))
    measured = [name for name in first if name not in (*APPENDED, "reference")]
    assert any(not first[name].equals(second.get(name)) for name in measured), (
        f"the seeds 1 and 2 gave the same {', '.join(measured)}; the seed must act"
    )
    if "reference" in first:
        assert first["reference"].equals(second["reference"]), (
            "the seeds 1 and 2 gave another 'reference'; the seed is that of the noise, not of the motion"
        )


class _Step(NamedTuple):
    """From row to row: change (n-1, k), and the area under its rate, which may differ by `allowed`."""

    name: str
    rate: str
    change: Floats
    area: Floats
    allowed: float


def _steps(truth: pa.Table) -> Iterator[_Step]:
    t_s, pos_n, vel_n = seconds(truth), matrix(truth, "pos"), matrix(truth, "vel")
    yield _step("the position", "the velocity", t_s, np.diff(pos_n, axis=0), _seen_from_anchor(vel_n, truth), pos_n)
    if has(truth, "accel") and has(truth, "q"):
        acc_n = rotate(matrix(truth, "q"), matrix(truth, "accel"))
        yield _step("the velocity", "the acceleration", t_s, np.diff(vel_n, axis=0), acc_n, vel_n)
    if has(truth, "gyro") and has(truth, "q"):
        gyro_v, q_nv = matrix(truth, "gyro"), matrix(truth, "q")
        turns = to_rotvec(multiply(conjugate(q_nv[:-1]), q_nv[1:]))
        coning = np.diff(t_s)[:, None] ** 2 / 12.0 * np.cross(gyro_v[:-1], gyro_v[1:])  # Bortz 1971
        yield _step("the attitude", "the angular rate", t_s, turns - coning, gyro_v, q_nv)


def _seen_from_anchor(vel_n: Floats, truth: pa.Table) -> Floats:
    """Velocities (n, 3) relative to the axes of their places, in the axes of the anchor; as they are without places."""
    anchor = meta(truth).get("anchor")
    if anchor is None or not has(truth, "lat") or not has(truth, "lon"):
        return vel_n
    axes_e = local_axes_e(vector(truth, "lat"), vector(truth, "lon"))
    return np.asarray(np.einsum("ijn,nj->ni", axes_e, vel_n) @ local_axes_e(anchor["lat"], anchor["lon"]))


def _step(name: str, rate: str, t_s: Floats, change: Floats, values: Floats, integral: Floats) -> _Step:
    """The area by parabolas; their largest correction to the trapezoid, itself the step's error, is allowed."""
    rules: tuple[Rule, Rule] = ("mean_parabola", "trapezoid")
    area, plain = (increments(t_s, values, rule) for rule in rules)
    rounding = ROUNDING * (np.abs(integral).max() + np.abs(values).max())
    return _Step(name, rate, change, area, float(np.abs(area - plain).max() + rounding))


_Pair = tuple[str, Floats, Floats, float]
"""Name, what was measured, what is true, and by how much the two may differ."""


def _inertial_pairs(returned: Mapping[str, pa.Table]) -> Iterator[_Pair]:
    """Lengths of the vectors and the angle between them, which no mounting changes."""
    if "imu" not in returned:
        return
    imu, truth = _together(returned["imu"], returned["reference"])
    gravity = np.zeros((truth.num_rows, 3))
    known = has(truth, "lat") and has(truth, "height")
    gravity[:, 2] = normal_gravity(vector(truth, "lat"), vector(truth, "height")) if known else STANDARD_GRAVITY
    force_v = matrix(truth, "accel") + rotate(conjugate(matrix(truth, "q")), gravity)
    accel, gyro, gyro_v = matrix(imu, "accel"), matrix(imu, "gyro"), matrix(truth, "gyro")
    yield "the magnitude of imu.accel", _length(accel), _length(force_v), FORCE
    yield "the magnitude of imu.gyro", _length(gyro), _length(gyro_v), RATE
    allowed = FORCE * float(_length(gyro_v).max()) + RATE * float(_length(force_v).max())
    yield "the product of imu.accel and imu.gyro", _dot(accel, gyro), _dot(force_v, gyro_v), allowed


def _satellite_pairs(returned: Mapping[str, pa.Table]) -> Iterator[_Pair]:
    if "gnss" not in returned:
        return
    gnss, truth = _together(returned["gnss"], returned["reference"])
    if has(gnss, "lat") and has(gnss, "height"):
        anchor = Anchor(*(float(vector(truth, name)[0]) for name in ("lat", "lon", "height")))
        yield "the place in gnss", _place(gnss, anchor), _place(truth, anchor), PLACE
    if has(gnss, "vel"):
        yield "gnss.vel", matrix(gnss, "vel"), matrix(truth, "vel"), PLACE
    if has(gnss, "speed"):
        yield "gnss.speed", vector(gnss, "speed"), _length(matrix(truth, "vel")[:, :2]), PLACE


def _place(table: pa.Table, anchor: Anchor) -> Floats:
    return geodetic_to_enu(vector(table, "lat"), vector(table, "lon"), vector(table, "height"), anchor)


def _together(measured: pa.Table, truth: pa.Table) -> tuple[pa.Table, pa.Table]:
    """The rows of both at the times that they share."""
    shared, rows, true_rows = np.intersect1d(time_ns(measured), time_ns(truth), return_indices=True)
    assert len(shared), "no measurement is at a time of 'reference', so that none can be compared with the truth"
    return select_rows(measured, rows), select_rows(truth, true_rows)


def _length(vectors: Floats) -> Floats:
    return np.asarray(np.linalg.norm(vectors, axis=1))


def _dot(first: Floats, second: Floats) -> Floats:
    return np.asarray(np.einsum("ij,ij->i", first, second))
