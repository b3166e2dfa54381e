"""Laws of integrators: nothing comes of nothing, and what they declare of their order is true.

PYTEST_DONT_REWRITE: what a law says is a sentence already.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
import pyarrow as pa

from recon.numerics.rotation import Floats, conjugate, multiply, to_rotvec
from recon.recording import Recording
from recon.stages import Aligner, Fuser, Integrator, Simulator
from recon.tables import has, matrix, seconds, time_ns
from recon.testing.contract import law
from recon.testing.drives import Conditions, drive
from recon.testing.motions import CIRCLE, STAND
from recon.testing.serving import serve
from recon.testing.subject import Subject

ROUNDING: Final = 1e-9
"""rad, m/s, m. Turning the ideal specific force at rest there and back leaves 1e-15 m/s^2 and rad/s, in 20 s 1e-13."""
STEPS_S: Final = (0.04, 0.02)
"""The swaying circle turns by up to 0.1 rad in the longer: the next power of the step matters little, and what is left
of the third power, some 1e-6, is far above rounding.
"""
SHARE: Final = 0.7
"""Of 2^order, for the next power of the step and the order of one step less at the ends of a record."""


def gives_motion(stage: Integrator) -> bool:
    """Attitude or trajectory of what moves, and not how an image differs from the one before."""
    return bool({"attitude", "trajectory"} & stage.writes.keys())


@law(Integrator, when=gives_motion)
def rest_stays_at_rest(subject: Subject) -> None:
    """From ideal sensors at rest no attitude changes and no motion comes."""
    recording = drive(Conditions(noise=0.0, motion=STAND))
    returned = subject.run(serve(recording, subject.stage.reads))
    for quantity, change in _changes(returned, coasting=0.0).items():
        largest = float(np.abs(change).max())
        assert largest <= ROUNDING, (
            f"of a box at rest with ideal sensors the {quantity} became {largest:g}, where it must stay 0"
        )


@law(Integrator, when=lambda stage: stage.order > 0)
def the_error_falls_with_the_order_when_the_step_is_halved(subject: Subject) -> None:
    """On a circle whose truth is a closed formula, half the step gives an error 2^order times smaller."""
    assert isinstance(subject.stage, Integrator)
    order = subject.stage.order
    coarse, fine = (_errors(subject, drive(Conditions(noise=0.0, motion=CIRCLE, step_s=step))) for step in STEPS_S)
    for quantity, error in coarse.items():
        assert fine[quantity] <= max(error / (SHARE * 2**order), ROUNDING), (
            f"with half the step the error of the {quantity} went from {error:.3g} to {fine[quantity]:.3g}, "
            f"by a factor of {error / fine[quantity]:.2f}; order {order} is declared, which means {2**order}"
        )


@law(Aligner, Fuser, Integrator, Simulator)
def quaternions_are_of_unit_length(subject: Subject) -> None:
    """Every attitude that is returned is a rotation."""
    for name, table in subject.run().items():
        if not has(table, "q"):
            continue
        error = np.abs(np.linalg.norm(matrix(table, "q", gaps=True), axis=1) - 1.0)
        worst = int(np.nanargmax(error))
        assert error[worst] <= ROUNDING, (
            f"a quaternion of '{name}' (row {worst}) differs from unit length by {error[worst]:.3g}; normalize it"
        )


def _errors(subject: Subject, recording: Recording) -> dict[str, float]:
    """Largest error by quantity of what the stage returns, against the truth, both since their start."""
    returned = subject.run(serve(recording, subject.stage.reads))
    truth = {"attitude": recording["attitude"], "trajectory": recording["reference"]}
    for name in returned.keys() & truth.keys():
        rows = np.searchsorted(time_ns(truth[name]), time_ns(returned[name]))
        truth[name] = truth[name].take(pa.array(rows))
    expected = _changes(truth)
    return {name: float(np.abs(change - expected[name]).max()) for name, change in _changes(returned).items()}


def _changes(streams: Mapping[str, pa.Table], coasting: float = 1.0) -> dict[str, Floats]:
    """What an integrator adds to where it starts: turns (n, 3) rad, velocity (n, 3) m/s, position (n, 3) m.

    The start, which only other sensors can tell, is taken off: a wrong one is not the integral's fault. So is the first
    velocity and the way that it makes, `coasting` times.
    """
    found: dict[str, Floats] = {}
    for name in sorted(streams.keys() & {"attitude", "trajectory"}):
        table = streams[name]
        if has(table, "q"):
            q = matrix(table, "q")
            found[f"attitude ({name})"] = to_rotvec(multiply(conjugate(q[:1]), q))
        if has(table, "vel") and has(table, "pos"):
            pos_n, vel_n = matrix(table, "pos"), matrix(table, "vel")
            found["velocity"] = vel_n - coasting * vel_n[0]
            found["position"] = pos_n - pos_n[0] - coasting * seconds(table)[:, None] * vel_n[0]
    assert found, (
        "an integrator must return 'attitude' with q, or 'trajectory' with pos and vel; it gave no value of them"
    )
    return found
