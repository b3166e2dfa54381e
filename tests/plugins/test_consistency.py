from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from recon import RESIDUALS, Metric, build, matrix, replace, with_meta
from recon.rows import warnings_of
from recon.testing.drives import START_NS, drive
from recon_analyzers.consistency import ConsistencyParams, analyze_consistency

TRUTH = drive()["reference"]
ROWS = 2000


def residuals(values: np.ndarray, sigma: float = 1.0, accepted: np.ndarray | None = None, **names: str) -> pa.Table:
    """Residuals of one sensor and component at 10 Hz."""
    rows = len(values)
    return build(
        RESIDUALS,
        time=START_NS + 100_000_000 * np.arange(rows),
        sensor=pa.array([names.get("sensor", "gnss")] * rows),
        component=pa.array([names.get("component", "pos_e")] * rows),
        value=values,
        sigma=np.full(rows, sigma),
        weight=np.ones(rows),
        accepted=pa.array(np.ones(rows, dtype=bool) if accepted is None else accepted),
    )


def normal(seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(ROWS)


def learnt(
    residuals: pa.Table | None = None,
    trajectory: pa.Table = TRUTH,
    reference: pa.Table | None = None,
    tolerance: float = 0.1,
) -> tuple[dict[str, Metric], list[str]]:
    """Metrics by name, and the warnings."""
    params = ConsistencyParams(tolerance=tolerance)
    table = analyze_consistency(trajectory=trajectory, residuals=residuals, reference=reference, params=params)
    rows = [Metric(**row) for row in table["metrics"].to_pylist()]
    return {row.name: row for row in rows if row.name != "warning"}, warnings_of(table["metrics"])


def test_without_residuals_and_reference_it_says_that_there_are_none():
    found, warnings = learnt()
    assert set(found) == {"residuals", "nees"}
    assert (found["residuals"].value, found["residuals"].note) == (0.0, "there are none")
    assert found["nees"].note == "there is no reference"
    assert warnings == []
    assert learnt(residuals(np.empty(0)))[0]["residuals"].value == 0.0


def test_honest_residuals_lie_within_the_limits():
    found, warnings = learnt(residuals(0.3 * normal(), sigma=0.3), tolerance=0.0)
    square = found["residuals_square_gnss_pos_e"]
    assert square.low < square.value < square.high
    assert found["residuals_rms_gnss_pos_e"].value == pytest.approx(np.sqrt(square.value))
    # binomial: sigma of the share 0.5 % and 0.1 %; 4 of these
    assert found["residuals_beyond_2_sigma_gnss_pos_e"].value == pytest.approx(0.0455, abs=0.02)
    assert found["residuals_beyond_3_sigma_gnss_pos_e"].value == pytest.approx(0.0027, abs=0.005)
    assert warnings == []


def test_a_warning_tells_sigmas_that_are_too_small():
    (warning,) = learnt(residuals(normal(), sigma=0.5))[1]
    assert warning.startswith("the residuals of gnss_pos_e are ")
    assert "the sigmas are too small" in warning


def test_sigmas_that_are_too_large_are_a_metric_and_no_warning():
    found, warnings = learnt(residuals(normal(), sigma=2.0))
    square = found["residuals_square_gnss_pos_e"]
    assert square.value < square.low
    assert warnings == []


def test_the_attitude_of_another_body_is_not_held_against_the_sigmas():
    claim = replace(TRUTH, att_std=np.full((TRUTH.num_rows, 3), 1e-3))
    assert learnt(trajectory=claim, reference=TRUTH)[0]["nees_attitude"].value is not None
    found, (warning,) = learnt(trajectory=claim, reference=with_meta(TRUTH, body="camera"))
    assert found["nees_attitude"].value is None
    assert "that of its camera" in warning


def test_residuals_with_a_mean_are_told():
    (warning,) = learnt(residuals(normal() + 1.0))[1]
    assert "too small" in warning


def test_sigmas_wrong_by_less_than_the_tolerance_give_no_warning():
    slightly = residuals(1.08 * normal(), sigma=1.0)
    assert learnt(slightly, tolerance=0.2)[1] == []
    assert len(learnt(slightly, tolerance=0.0)[1]) == 1


def test_residuals_that_were_rejected_are_counted_and_not_judged():
    values, accepted = normal(), np.ones(ROWS, dtype=bool)
    values[::100], accepted[::100] = 50.0, False
    found, warnings = learnt(residuals(values, accepted=accepted))
    assert found["residuals_rejected_gnss_pos_e"].value == 20.0
    assert found["residuals_accepted_gnss_pos_e"].value == 1980.0
    assert warnings == []


def test_each_sensor_and_component_is_judged_by_itself():
    mixed = pa.concat_tables(
        [residuals(normal()), residuals(3.0 * normal(2), sensor="wheel", component="speed"), residuals(normal(3))]
    )
    found, (warning,) = learnt(mixed)
    assert "residuals_square_gnss_pos_e" in found
    assert warning.startswith("the residuals of wheel_speed are 3 times")


def test_residuals_without_a_sigma_are_said_to_be_so():
    found, warnings = learnt(residuals(normal(), sigma=np.nan))
    assert found["residuals_square_gnss_pos_e"].value is None
    assert warnings == []


def claimed(error: float, sigma: float, seed: int = 4) -> pa.Table:
    """The truth with white errors of `error` m along each axis, and a claim of `sigma` m."""
    pos = matrix(TRUTH, "pos")
    noise = error * np.random.default_rng(seed).standard_normal(pos.shape)
    return replace(TRUTH, pos=pos + noise, pos_std=np.full(pos.shape, sigma))


def test_honest_sigmas_of_a_trajectory_lie_within_the_limits():
    found, warnings = learnt(trajectory=claimed(0.5, 0.5), reference=TRUTH, tolerance=0.0)
    nees = found["nees_position"]
    assert nees.low < nees.value < nees.high
    # 3 * 6000 numbers: the share errs by 0.35 %; 4 of these
    assert found["coverage_position_1_sigma"].value == pytest.approx(0.6827, abs=0.015)
    assert found["nees_velocity"].value is None
    assert warnings == []


def test_a_trajectory_that_is_too_sure_of_itself_is_told():
    found, (warning,) = learnt(trajectory=claimed(0.5, 0.2), reference=TRUTH)
    assert found["nees_position"].value > found["nees_position"].high
    assert warning.startswith("the errors in position are 2.5 times as large as their sigmas say")


def test_errors_that_hardly_change_are_worth_few_samples():
    late = matrix(TRUTH, "pos") + 1.5
    found, warnings = learnt(trajectory=replace(TRUTH, pos=late, pos_std=np.ones(late.shape)), reference=TRUTH)
    assert found["nees_position"].value == pytest.approx(2.25, rel=1e-9)
    # three constants: 3 to 5 independent numbers, of which a mean square of 2.25 is nothing rare
    assert warnings == []


def test_a_reference_of_another_time_is_a_warning_and_no_end():
    found, (warning,) = learnt(residuals(normal()), reference=TRUTH.slice(0, 0))
    assert warning == "the errors of the trajectory are not known: the reference has no row"
    assert "residuals_square_gnss_pos_e" in found
