"""Rows of the fixes and of the wheels: zero at the truth, Jacobians against differences, weights as told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from smoothing_drives import Linearised, Log, dense, derivatives, linearised

from recon.numerics.smoothing.measurements import (
    COMMON,
    BodyModel,
    Fixes,
    Measured,
    add_measured,
    body_rows,
    lag_at,
    position_rows,
    velocity_rows,
)
from recon.numerics.smoothing.normal import Normal
from recon.numerics.smoothing.soa import mv
from recon.numerics.smoothing.state import (
    CLOCK,
    COMMON_SIZE,
    KNOT_SIZE,
    LAG,
    LEVER,
    MOUNT,
    PITCH,
    POSITION,
    ROTATION,
    SLIP,
    VELOCITY,
    VELOCITY_LAG,
    WHEEL,
    State,
)

LIVELY = Log(seconds=30.0, kind="nonstop", rest_s=3.0, imu_hz=100.0, lag=0.05, velocity_lag=-0.03)
# Central differences of a step of 1e-5: rounding of positions of 100 m, 1e-14 / 1e-5 x 100, and the step squared.
DIFFERENCE = 1e-7
# The velocity at an epoch depends on those of both knots by way of the Coriolis acceleration, which is left out: 2 w T.
CORIOLIS = 4.0 * 7.3e-5


@pytest.fixture(scope="module", params=[0.0, 1.0], ids=["at the truth", "off"])
def drive(request: pytest.FixtureRequest) -> Linearised:
    return linearised(LIVELY, request.param)


def plain(fixes: Fixes) -> Fixes:
    """Sigmas of one, so that rows are derivatives in m and m/s."""
    one = np.ones_like(fixes.pos_n)
    return replace(fixes, pos_sigma=one, vel_sigma=one)


def turned_axes(fixes: Fixes) -> Fixes:
    """Velocities along and across the course, as receivers report it."""
    east, north = fixes.vel[:2] / np.hypot(fixes.vel[0], fixes.vel[1])
    none, one = np.zeros_like(east), np.ones_like(east)
    rows = np.array([[east, north, none], [-north, east, none], [none, none, one]])
    return replace(fixes, vel_rows=rows, vel=mv(rows, fixes.vel))


def speeds(fixes: Fixes) -> Fixes:
    """Nothing but the speed over ground."""
    return replace(
        fixes,
        vel=np.stack([np.hypot(fixes.vel[0], fixes.vel[1]), *np.zeros((2, len(fixes.t_s)))]),
        vel_sigma=np.stack([np.ones(len(fixes.t_s)), *np.full((2, len(fixes.t_s)), np.inf)]),
        speed_only=np.ones(len(fixes.t_s), bool),
    )


def wheels(drive: Linearised, speed: float = 10.0) -> BodyModel:
    """Every epoch at a sigma of one, whatever the speed of turning."""
    count = len(drive.smoother.epochs.t_s)
    return BodyModel(0.0, 1.0, np.ones(count, bool), np.zeros(count, bool), np.full(count, speed))


def spread_out(drive: Linearised, rows: Measured, hermite: np.ndarray, drift: bool) -> np.ndarray:
    """The chain rule from epochs to knots, written out: (E, 3, 18 N + COMMON_SIZE)."""
    knots, u = drive.state.knots, drive.inside.u
    whole = np.zeros((len(u), 3, KNOT_SIZE * knots + COMMON_SIZE))
    for e, k in enumerate(drive.smoother.epochs.interval):
        for first, share, pos, vel in (
            (KNOT_SIZE * k, 1.0 - u[e], hermite[0, e], hermite[1, e]),
            (KNOT_SIZE * (k + 1), u[e], hermite[2, e], hermite[3, e]),
        ):
            along, turn = rows.along[..., e], rows.turn[..., e]
            parts = [along * share * drift, turn * share, along * vel, along * pos]
            whole[e, :, first : first + 12] = np.concatenate(parts, axis=1)
        whole[e, :, KNOT_SIZE * knots : KNOT_SIZE * knots + COMMON.stop] = rows.common[..., e]
    return whole


def position_weights(drive: Linearised) -> np.ndarray:
    return drive.inside.value + lag_at(drive.state, drive.smoother.epochs) * drive.inside.slope


def differences(drive: Linearised, rows: Callable[[State], Measured]) -> np.ndarray:
    return derivatives(lambda x: rows(x).residual.T, drive.state)


def of_knots(drive: Linearised, jacobian: np.ndarray, columns: slice) -> np.ndarray:
    """Columns of all knots: (E, 3, N, 3)."""
    count = KNOT_SIZE * drive.state.knots
    return jacobian[..., :count].reshape(*jacobian.shape[:2], drive.state.knots, KNOT_SIZE)[..., columns]


def of_common(drive: Linearised, jacobian: np.ndarray) -> np.ndarray:
    return jacobian[..., KNOT_SIZE * drive.state.knots :]


def no_cubic_follows(drive: Linearised) -> tuple[np.ndarray, np.ndarray]:
    """What a tilt of the knot before moves at the epochs beyond the cubic through both ends: (E,) m, m/s per rad."""
    k, inc, inside = drive.smoother.epochs.interval, drive.increments, drive.inside
    off = [
        part - weights[2] * inc.position[:, k] - weights[3] * inc.velocity[:, k]
        for part, weights in ((inside.pos, inside.value), (inside.vel, inside.slope))
    ]
    return np.linalg.norm(off[0], axis=0), np.linalg.norm(off[1], axis=0)


def turn_of(drive: Linearised) -> float:
    """Largest misclosure of the rotation, the Earth's turn included: rad."""
    return float(np.linalg.norm(drive.ends(drive.state).turn_n, axis=0).max())


def test_position_rows_are_the_derivatives(drive):
    fixes, epochs = plain(drive.sim.drive.fixes), drive.smoother.epochs
    bridge = np.zeros((3, len(epochs.t_s)))

    def rows(state: State) -> Measured:
        return position_rows(drive.here(state), state, fixes, epochs, bridge)

    found = spread_out(drive, rows(drive.state), position_weights(drive), True)
    off = np.abs(found - differences(drive, rows))
    # The Coriolis acceleration moves the velocity, which the lag multiplies.
    allowed = DIFFERENCE + CORIOLIS * abs(LIVELY.lag)
    for columns in (slice(0, 3), VELOCITY, POSITION, slice(12, 18)):
        assert of_knots(drive, off, columns).max() < allowed
    assert of_common(drive, off).max() < DIFFERENCE
    pos, vel = no_cubic_follows(drive)
    beyond = (pos + abs(LIVELY.lag) * vel)[:, None, None, None]
    # A turn is spread evenly by a share of it; what is left out is half the misclosure (BCH), in front of the lever.
    spread = 0.5 * turn_of(drive) * float(np.linalg.norm(LIVELY.lever_v))
    assert (of_knots(drive, off, ROTATION) < 1.001 * beyond + spread + DIFFERENCE).all()


@pytest.mark.parametrize("axes", [plain, lambda f: turned_axes(plain(f)), speeds], ids=["vector", "course", "speed"])
def test_velocity_rows_are_the_derivatives(drive, axes):
    fixes, epochs = axes(drive.sim.drive.fixes), drive.smoother.epochs

    def rows(state: State) -> Measured:
        return velocity_rows(drive.here(state), state, fixes, epochs)

    moving = np.hypot(*drive.here(drive.state).vel[:2]) > 3.0
    assert moving.sum() > 10
    off = np.abs(spread_out(drive, rows(drive.state), drive.inside.slope, False) - differences(drive, rows))[moving]
    lever = float(np.linalg.norm(LIVELY.lever_v))
    rate, force = np.abs(drive.here(drive.state).rate).max(), np.abs(drive.here(drive.state).force_n).max()
    # The direction of a speed turns with the velocity: across lie the swing of the lever and what the lags add.
    across = (lever * rate + 0.1 * force) / 3.0 if axes is speeds else 0.0
    assert of_knots(drive, off, VELOCITY).max() < DIFFERENCE + CORIOLIS + across
    assert of_knots(drive, off, POSITION).max() < DIFFERENCE + 1e-6 + across
    # Biases change the swing by the lever, and the force by the lags; both are left out.
    assert of_knots(drive, off, slice(12, 15)).max() < 1.001 * lever
    assert of_knots(drive, off, slice(15, 18)).max() < 0.02 + DIFFERENCE
    assert of_common(drive, off).max() < DIFFERENCE
    beyond = no_cubic_follows(drive)[1][moving][:, None, None, None]
    # A tilt turns the specific force as well, which the lags multiply, and takes the swing with it.
    assert (of_knots(drive, off, ROTATION) < 1.001 * beyond * (1.0 + across) + 0.02 * 15.0 + across).all()


def test_body_rows_are_the_derivatives(drive):
    epochs, model = drive.smoother.epochs, wheels(drive)
    rigid = replace(drive, state=drive.state.with_common(SLIP, 0.0).with_common(PITCH, 0.0))

    def rows(state: State) -> Measured:
        return body_rows(drive.here(state), state, epochs, model, (1.0, 1.0), robust=False)

    here = rigid.here(rigid.state)
    moving = np.linalg.norm(here.vel, axis=0) > 3.0
    off = np.abs(spread_out(rigid, rows(rigid.state), rigid.inside.slope, False) - differences(rigid, rows))[moving]
    assert of_knots(rigid, off, VELOCITY).max() < DIFFERENCE + CORIOLIS
    assert of_knots(rigid, off, POSITION).max() < DIFFERENCE + 1e-6
    assert of_knots(rigid, off, slice(12, 15)).max() < 1.001 * float(np.linalg.norm(LIVELY.rear_v))
    assert of_common(rigid, off).max() < DIFFERENCE
    # A turn is spread evenly by a share of it; what is left out is half the misclosure (BCH), in front of the velocity.
    beyond = no_cubic_follows(rigid)[1][moving][:, None, None, None]
    spread = 0.5 * turn_of(rigid) * np.linalg.norm(here.vel, axis=0)[moving][:, None, None, None]
    assert (of_knots(rigid, off, ROTATION) < 1.001 * beyond + spread + DIFFERENCE).all()


def test_slip_pitch_and_the_scale_of_the_wheels_are_exact(drive):
    epochs, model = drive.smoother.epochs, wheels(drive)

    def rows(state: State) -> Measured:
        return body_rows(drive.here(state), state, epochs, model, (1.0, 1.0), robust=False)

    moving = np.linalg.norm(drive.here(drive.state).vel, axis=0) > 3.0
    found = spread_out(drive, rows(drive.state), drive.inside.slope, False)
    off = np.abs(of_common(drive, found - differences(drive, rows)))[moving]
    assert off[..., [SLIP, PITCH, WHEEL]].max() < DIFFERENCE


def test_the_truth_leaves_no_residual():
    drive = linearised(replace(LIVELY, quiet=True))
    epochs, here, state = drive.smoother.epochs, drive.here(drive.state), drive.state
    live = epochs.fix >= 0
    # Beyond the first order in the lags, 0.05 and 0.02 s: a t^2 / 2 with 5 m/s^2, j t^2 / 2 with 10 m/s^3; and the mean
    # rate and force over 0.1 s instead of those of the moment: curvature of 10 rad/s^3 times (0.03 s)^2.
    position = position_rows(here, state, plain(drive.sim.drive.fixes), epochs, np.zeros((3, len(live))))
    assert np.abs(position.residual[:, live]).max() < 5.0 * 0.05**2 / 2.0 + 2.0 * 0.05 * 0.5
    velocity = velocity_rows(here, state, plain(drive.sim.drive.fixes), epochs)
    assert np.abs(velocity.residual[:, live]).max() < 10.0 * 0.02**2 + 1.5 * 0.01 + 0.02 * 0.2
    body = body_rows(here, state, epochs, wheels(drive), (1.0, 1.0), robust=False)
    rolling = np.linalg.norm(here.vel, axis=0) > 1.0
    assert np.abs(body.residual[1:, rolling]).max() < 1.3 * 0.01


def test_weights_are_those_of_the_sigmas_the_bridge_and_the_share():
    drive = linearised(LIVELY, 1.0)
    fixes, epochs = drive.sim.drive.fixes, drive.smoother.epochs
    here, live = drive.here(drive.state), epochs.fix >= 0
    none = np.zeros((3, len(epochs.t_s)))
    unit = position_rows(here, drive.state, plain(fixes), epochs, none).residual
    told = replace(fixes, pos_sigma=np.full_like(fixes.pos_n, 3.0), share=np.full(len(fixes.t_s), 0.25))
    found = position_rows(here, drive.state, told, epochs, none + 16.0).residual
    assert_allclose(found[:, live], unit[:, live] / 5.0 * 0.5, rtol=1e-12)
    assert not found[:, ~live].any()
    velocity = velocity_rows(here, drive.state, replace(told, vel_sigma=np.full_like(fixes.vel, 3.0)), epochs).residual
    unit = velocity_rows(here, drive.state, plain(fixes), epochs).residual
    assert_allclose(velocity[:, live], unit[:, live] / 3.0 * 0.5, rtol=1e-12)


def test_what_is_not_measured_has_no_weight():
    drive = linearised(LIVELY)
    fixes, epochs = plain(drive.sim.drive.fixes), drive.smoother.epochs
    sigma = np.ones_like(fixes.pos_n)
    sigma[2] = np.inf
    blind = replace(fixes, pos_sigma=sigma, vel_sigma=sigma)
    here = drive.here(drive.state)
    for rows in (
        position_rows(here, drive.state, blind, epochs, np.zeros((3, len(epochs.t_s)))),
        velocity_rows(here, drive.state, blind, epochs),
    ):
        for part in (rows.residual, rows.turn, rows.along, rows.common):
            assert not part[2].any()
            assert part[:2].any()


def test_wheels_say_nothing_below_walking_pace_nor_where_they_are_not_used():
    drive = linearised(LIVELY)
    epochs, here = drive.smoother.epochs, drive.here(drive.state)
    speed = np.linalg.norm(here.vel, axis=0)
    model = replace(wheels(drive), on=np.arange(len(speed)) % 2 == 0, wheel_speed=np.full(len(speed), np.nan))
    rows = body_rows(here, drive.state, epochs, model, (1.0, 1.0), robust=False)
    used = model.on & (speed > 1.0) & epochs.live
    assert not rows.residual[:, ~used].any()
    assert not rows.residual[0].any()
    assert (rows.residual[1:, used] != 0.0).all()


def test_what_moved_in_a_state_before_keeps_its_constraint():
    drive = linearised(LIVELY, 1.0)
    epochs, here, model = drive.smoother.epochs, drive.here(drive.state), wheels(drive)
    creeping = replace(here, vel=0.01 * here.vel)
    dropped, kept = (
        body_rows(creeping, drive.state, epochs, body, (1.0, 1.0), robust=False).residual[1:]
        for body in (model, model.kept_on(here))
    )
    moved = np.linalg.norm(here.vel, axis=0) > 1.0
    assert not dropped.any()
    assert (kept[:, moved] != 0.0).all()
    assert not kept[:, ~moved].any()


def test_slip_is_doubted_where_the_car_turns_fast():
    drive = linearised(LIVELY, 1.0)
    epochs, here = drive.smoother.epochs, drive.here(drive.state)
    stiff, soft = (
        body_rows(here, drive.state, epochs, replace(wheels(drive), slip=slip), (0.1, 0.1), robust=False).residual
        for slip in (0.0, 0.04)
    )
    seen = stiff[1] != 0.0
    ratio = soft[1, seen] / stiff[1, seen]
    turning = np.abs(drive.state.rot_vs[2] @ here.rate)[seen]
    assert ratio[turning.argmax()] < 0.8
    assert ratio.max() > 0.99
    assert_array_equal(soft[2], stiff[2])


def test_a_wheel_that_jumps_aside_is_taken_back_by_cauchy():
    drive = linearised(LIVELY, 1.0)
    epochs, here = drive.smoother.epochs, drive.here(drive.state)
    model = wheels(drive)
    hard, soft = (
        body_rows(here, drive.state, epochs, model, (1e-3, 1e-3), robust).residual for robust in (False, True)
    )
    squared = (hard[1:] ** 2).sum(axis=0)
    assert squared.max() > 100.0
    assert_allclose((soft[1:] ** 2).sum(axis=0), squared / (1.0 + squared / 9.0), rtol=1e-12)


def test_weights_of_whole_fixes_or_of_components_multiply_squares():
    rng = np.random.default_rng(1)
    rows = Measured(rng.normal(size=(3, 4)), *rng.normal(size=(2, 3, 3, 4)), rng.normal(size=(3, COMMON.stop, 4)))
    weight = np.array([0.0, 0.25, 1.0, 4.0])
    found = rows.weighted(weight)
    assert_allclose(found.residual, rows.residual * [0.0, 0.5, 1.0, 2.0], rtol=1e-15)
    assert_allclose(found.common, rows.common * [0.0, 0.5, 1.0, 2.0], rtol=1e-15)
    across = rows.weighted(np.array([1.0, 1.0, 0.0])[:, None])
    assert_array_equal(across.turn[:2], rows.turn[:2])
    assert not across.along[2].any()


def test_the_normal_equations_are_those_of_all_rows_together():
    drive = linearised(replace(LIVELY, gnss_hz=2.0), 1.0)
    fixes, epochs, here, state = drive.sim.drive.fixes, drive.smoother.epochs, drive.here(drive.state), drive.state
    rows = [
        position_rows(here, state, fixes, epochs, np.zeros((3, len(epochs.t_s)))),
        velocity_rows(here, state, fixes, epochs),
        body_rows(here, state, epochs, wheels(drive), (1.0, 1.0), robust=False),
    ]
    normal = Normal(state.knots)
    add_measured(normal, drive.inside, epochs.slots, *rows, lag=lag_at(state, epochs))
    whole = [
        spread_out(drive, part, position_weights(drive) if index == 0 else drive.inside.slope, index == 0)
        for index, part in enumerate(rows)
    ]
    jacobian = np.concatenate(whole).reshape(-1, whole[0].shape[-1])
    residual = np.concatenate([part.residual.T.ravel() for part in rows])
    matrix, right = dense(normal)
    size = np.maximum(np.sqrt((jacobian**2).sum(axis=0)), 1.0)
    # Sums of some hundred products, relative to the sizes of the columns.
    assert_allclose((matrix - jacobian.T @ jacobian) / np.outer(size, size), 0.0, atol=1e-12)
    assert_allclose((right + jacobian.T @ residual) / size, 0.0, atol=1e-12 * np.linalg.norm(residual))
    assert normal.cost == pytest.approx(residual @ residual, rel=1e-12)
    alone = Normal(state.knots)
    for index in range(3):
        kinds = [part if index == number else None for number, part in enumerate(rows)]
        add_measured(alone, drive.inside, epochs.slots, *kinds, lag=lag_at(state, epochs))
    assert_allclose(dense(alone)[0] / np.outer(size, size), matrix / np.outer(size, size), atol=1e-12)


def test_the_unknowns_that_fixes_see_are_lever_and_lags_and_the_wheels_the_rest():
    drive = linearised(LIVELY, 1.0)
    fixes, epochs, here, state = drive.sim.drive.fixes, drive.smoother.epochs, drive.here(drive.state), drive.state
    position = position_rows(here, state, fixes, epochs, np.zeros((3, len(epochs.t_s)))).common
    body = body_rows(here, state, epochs, wheels(drive), (1.0, 1.0), robust=False).common
    seen = np.flatnonzero(np.abs(position).max(axis=(0, 2)))
    assert_array_equal(seen, [*range(LEVER.start, LEVER.stop), LAG, CLOCK])
    assert not body[:, [*range(LEVER.start, LEVER.stop), LAG, VELOCITY_LAG]].any()
    assert np.abs(body[:, MOUNT]).max() > 1.0
