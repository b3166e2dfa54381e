"""Are the sigmas of a result honest? Normalised residuals and errors, held against the chi-square distribution.

    z = value / sigma,    mean of z^2 = 1 for honest sigmas

of each sensor and component for the residuals that the fuser accepted, and, where there is a reference, of position,
velocity and attitude for the errors of the trajectory (NEES, normalised estimation error squared). Limits are those of
as many samples as the errors are worth that neighbours share (`recon.numerics.consistency`): residuals should be
independent in time, so that their mean counts as a fault; the errors of a trajectory never are.

A gate that rejects large residuals takes the tail off those that are left: at 3 sigma their mean square is 0.97.

References
    Bar-Shalom, Li, Kirubarajan (2001), "Estimation with applications to tracking and navigation", section 5.4.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from recon import (
    REFERENCE,
    RESIDUALS,
    TRAJECTORY,
    Analyzer,
    DataError,
    Metric,
    Params,
    Streams,
    hookimpl,
    metrics,
    setting,
    vector,
    warning,
)
from recon.evaluation import consistency_of, match
from recon.numerics.consistency import HONEST, Consistency, consistency

_SIGMAS = ("pos_std", "vel_std", "att_std")


class ConsistencyParams(Params):
    """Parameters of analyzer.consistency."""

    tolerance: float = setting(
        0.5, ge=0, doc="Sigmas that are too small by less than this share give no warning. Too large ones never do."
    )


def analyze_consistency(
    *, trajectory: pa.Table, residuals: pa.Table | None, reference: pa.Table | None, params: ConsistencyParams
) -> Streams:
    """What the residuals and the reference say of the sigmas, as metrics, and warnings where they are not honest.

    trajectory : pos m, and vel m/s, q, pos_std, vel_std, att_std where it has them
    residuals : value and sigma in the unit of the component; those that are not accepted are only counted
    reference : as trajectory
    """
    found = [*_of_residuals(residuals, params.tolerance), *_of_errors(trajectory, reference, params.tolerance)]
    return {"metrics": metrics(found)}


def _of_residuals(residuals: pa.Table | None, tolerance: float) -> Iterable[Metric]:
    if residuals is None or not residuals.num_rows:
        yield Metric("residuals", 0.0, note="there are none")
        return
    yield Metric("residuals", float(residuals.num_rows))
    for sensor, own in _parted(residuals, "sensor"):
        for component, rows in _parted(own, "component"):
            yield from _of_component(f"{sensor}_{component}", rows, tolerance)


def _parted(residuals: pa.Table, name: str) -> Iterable[tuple[str, pa.Table]]:
    """The rows of each value of a column, in the order of the values."""
    for value in sorted(residuals[name].unique().to_pylist()):
        yield value, residuals.filter(pc.equal(residuals[name], value))


def _of_component(name: str, residuals: pa.Table, tolerance: float) -> Iterable[Metric]:
    rejected = vector(residuals, "accepted", gaps=True) == 0.0
    yield Metric(f"residuals_accepted_{name}", float((~rejected).sum()))
    yield Metric(f"residuals_rejected_{name}", float(rejected.sum()))
    value, sigma = (vector(residuals, column, gaps=True)[~rejected, None] for column in ("value", "sigma"))
    found = consistency(value, sigma, white=True)
    if found is None:
        yield Metric(f"residuals_square_{name}", note="none that is accepted has a value and a sigma")
        return
    yield _test(f"residuals_square_{name}", found, "mean square of value / sigma")
    yield Metric(f"residuals_rms_{name}", float(np.sqrt(found.nees)), note="of value / sigma")
    for bound, share, normal in ((2, found.coverage[1], 4.55), (3, found.coverage[2], 0.27)):
        yield Metric(f"residuals_beyond_{bound}_sigma_{name}", 1.0 - share, note=f"normal are {normal} %")
    yield from _judge(f"the residuals of {name}", found, tolerance)


def _of_errors(trajectory: pa.Table, reference: pa.Table | None, tolerance: float) -> Iterable[Metric]:
    if reference is None:
        yield Metric("nees", note="there is no reference")
        return
    try:
        matched = match(trajectory, reference)
    except DataError as error:
        yield warning(f"the errors of the trajectory are not known: {error.message}")
        return
    yield from (warning(note) for note in matched.notes)
    for name, found in consistency_of(matched).items():
        if found is None:
            yield Metric(f"nees_{name}", note="the trajectory or the reference does not say")
            continue
        yield _test(f"nees_{name}", found, "NEES per degree of freedom")
        for bound, share in enumerate(found.coverage, start=1):
            yield Metric(f"coverage_{name}_{bound}_sigma", share, note="share of the errors within")
        yield from _judge(f"the errors in {name}", found, tolerance)


def _test(name: str, found: Consistency, what: str) -> Metric:
    """The mean square; low and high are the limits of honest ones, and the note says what they rest on."""
    low, high = found.limits
    worth = f"{found.count} values, correlated in time, count as {found.degrees:.0f}"
    note = f"{what}, 1 if honest; {worth}; {100.0 * HONEST:g} % of honest ones lie from {low:.3g} to {high:.3g}"
    return Metric(name, found.nees, low=low, high=high, method="chi-square", note=note)


def _judge(what: str, found: Consistency, tolerance: float) -> Iterable[Metric]:
    """A warning where sigmas are too small by more than the tolerance.

    Sigmas that are too large are told by the metrics alone: they make no result look better than it is.
    """
    ratio = float(np.sqrt(found.nees))
    if found.verdict != "too small" or ratio <= 1.0 + tolerance:
        return
    limits = f"their mean square is {found.nees:.3g}, where honest ones have {found.limits[1]:.3g} at most"
    yield warning(f"{what} are {ratio:.2g} times as large as their sigmas say: the sigmas are too small ({limits})")


@hookimpl
def declare_analyzers() -> Iterable[Analyzer]:
    """The analyzer `consistency`."""
    yield Analyzer(
        name="consistency",
        summary="Whether the sigmas are honest, by residuals and by a reference.",
        params=ConsistencyParams,
        run=analyze_consistency,
        reads={
            "trajectory": TRAJECTORY.need("pos", maybe=["vel", "q", *_SIGMAS]),
            "residuals": RESIDUALS.need("sensor", "component", "value", "sigma", "accepted", optional=True),
            "reference": REFERENCE.need("pos", maybe=["vel", "q", *_SIGMAS], optional=True),
        },
        references=("Bar-Shalom, Li, Kirubarajan 2001, section 5.4",),
    )
