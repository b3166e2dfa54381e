"""Where the axes of a box point, and whether all of them may do so at once.

The axes of a real box are right-handed: with forward f, left l, up u and the gyroscope's up k, all in the axes of the
log (recon.numerics.doctor.motion), l = u x f and k = u, however the box is mounted. What mistakes make of that:

    mistake                              l . (u x f)    k and u
    none                                 +1             the same
    acceleration of the other sign       -1             opposite
    one axis of the accelerometer        -1             mirrored along that axis
    one axis of the gyroscope            +1             mirrored along that axis
    both left-handed (two axes swapped)  -1             the same

A mistake along an axis that lies level, or a box that also lies on its head, may look like another one: the one is
taken after which the box is turned least from x forward, y left, z up.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from recon.numerics.doctor.finding import SURE, Finding, Floats, confidence_of, confirmed, contradicted, unknown
from recon.numerics.doctor.log import Claims, Imu
from recon.numerics.doctor.motion import Motion

_AXES: Final = "xyz"
_LINED_UP: Final = np.cos(np.radians(18.0))
"""An axis nearer than that to a direction of the vehicle is meant to point there."""
_LIKE: Final = 0.8
"""Cosine of directions that are the same."""
_TORN: Final = 0.8
"""At most so sure where another mistake would leave the box less than a quarter turn further."""
_DOWN: Final = {"F": "B", "B": "F", "L": "R", "R": "L", "U": "D", "D": "U"}


@dataclass(frozen=True)
class Axes:
    """What was made of the axes.

    mistake : "", "inverted" (all of the accelerometer), "accel_x" ..., "gyro_x" ..., "gyro", "left-handed", "swap x y"
    rot_sv : (3, 3) columns forward, left, up in the axes of the log after the mistake is set right, None where not told
    up : (3,) that of the accelerometer, after the mistake; handed : is the handedness known?
    rival : the mistake that fits nearly as well, "" where none does
    """

    mistake: str
    rot_sv: Floats | None
    up: Floats
    handed: bool
    sure: float
    rival: str = ""

    @property
    def lined_up(self) -> bool:
        """Does every axis point along a direction of the vehicle?"""
        return self.rot_sv is not None and _lined_up(self.rot_sv)


def axes_of(imu: Imu, motion: Motion | None) -> Axes | None:
    """None where no gravity is felt."""
    whole = imu.accel[np.isfinite(imu.accel).all(axis=1)]
    rest = np.median(whole, axis=0) if len(whole) else np.zeros(3)
    up = motion.up.unit if motion and motion.up else rest / max(float(np.linalg.norm(rest)), 1e-9)
    if not np.isfinite(up).all() or np.linalg.norm(up) < 0.5:
        return None
    if motion is None or motion.forward is None or not motion.forward.told:
        return Axes("", None, up, False, 0.0)
    forward = motion.forward.unit
    forward = forward - up * (up @ forward)
    forward = forward / np.linalg.norm(forward)
    left, turn = motion.left, motion.turn
    hand = float(left.unit @ np.cross(up, forward)) if left is not None and left.told else 0.0
    seen = np.column_stack([forward, np.cross(up, forward) * (np.sign(hand) or 1.0), up])
    same = turn.unit if turn is not None and turn.told else None
    sure = 0.0 if left is None else confidence_of(left.length / left.sigma / 2.0)
    if abs(hand) < 0.5 or same is None:
        return Axes("", seen if abs(hand) < 0.5 or hand > 0.0 else None, up, abs(hand) >= 0.5, sure)
    mistake, rival = _mistake(seen, same, hand)
    right = _set_right(mistake, seen)
    sure = min(sure, _TORN) if rival else sure
    return Axes(mistake, right if np.linalg.det(right) > 0.0 else None, right[:, 2], True, sure, rival)


def _mistake(seen: Floats, turn: Floats, hand: float) -> tuple[str, str]:
    """The one that leaves the box turned least among those that fit, see the table of the module, and its rival."""
    up = seen[:, 2]
    fits: list[str] = []
    if hand > 0.0:
        if turn @ up > _LIKE:
            return "", ""
        fits = [f"gyro_{axis}" for i, axis in enumerate(_AXES) if turn @ _mirror(up, i) > _LIKE]
        if turn @ up < -_LIKE and np.abs(up).max() < _LINED_UP:
            return "gyro", ""
        fits.sort(key=lambda one: -float(turn @ _mirror(up, _AXES.index(one[-1]))))
        return fits[0] if fits else "gyro", ""
    if turn @ up < -_LIKE:
        fits.append("inverted")
    fits += [f"accel_{axis}" for i, axis in enumerate(_AXES) if turn @ _mirror(up, i) > _LIKE]
    if turn @ up > _LIKE:
        fits += [f"swap {a} {b}" for a, b in combinations(_AXES, 2)]
        if not _lined_up(seen):
            return "left-handed", ""
    if "inverted" in fits and not _lined_up(seen):
        return "inverted", ""
    fits.sort(key=lambda one: _unlikely(one, seen))
    near = len(fits) > 1 and _unlikely(fits[1], seen) - _unlikely(fits[0], seen) < 0.5 * np.pi
    return fits[0] if fits else "left-handed", fits[1] if near else ""


def _unlikely(mistake: str, seen: Floats) -> float:
    """By how much the box would be turned, rad, and half a quarter turn more for a mistake of a single axis."""
    return _turned(_set_right(mistake, seen)) + (0.0 if mistake == "inverted" else 0.25 * np.pi)


def _mirror(v: Floats, axis: int) -> Floats:
    return np.asarray(np.where(np.arange(3) == axis, -v, v))


def _set_right(mistake: str, seen: Floats) -> Floats:
    """Columns (3, 3) as they are without the mistake."""
    if mistake == "inverted":
        return -seen
    if mistake.startswith("accel_"):
        return np.column_stack([_mirror(column, _AXES.index(mistake[-1])) for column in seen.T])
    if mistake.startswith("swap"):
        _, a, b = mistake.split()
        order = [{a: b, b: a}.get(axis, axis) for axis in _AXES]
        return np.asarray(seen[[_AXES.index(axis) for axis in order]])
    return seen


def _turned(rot: Floats) -> float:
    """Angle of a rotation, rad; a quarter turn about the vertical before one on the head."""
    return float(np.arccos(np.clip(0.5 * (np.trace(rot) - 1.0), -1.0, 1.0))) + (0.5 if rot[2, 2] < 0.0 else 0.0)


def _lined_up(rot_sv: Floats) -> bool:
    """Does every axis point along a direction of the vehicle?"""
    return bool((np.abs(rot_sv).max(axis=0) > _LINED_UP).all())


def letters_of(rot_sv: Floats, claimed: str = "") -> str:
    """Where x, y, z of the file point, such as FLU, of a box that is lined up; those of `claimed` were turned."""
    names = "".join(
        ("FLU", "BRD")[int(row[int(np.abs(row).argmax())] < 0.0)][int(np.abs(row).argmax())] for row in rot_sv
    )
    return in_file(names, claimed)


def in_file(names: str, claimed: str) -> str:
    """Where x, y, z of a file point, of whose axes the reader has made others that point to `names`.

    claimed : where the reader takes those of the file to point, "" where it turned nothing
    """
    if not claimed or set(claimed) - set("FBLRUD"):
        return names
    along = {"F": names[0], "L": names[1], "U": names[2]}
    return "".join(along[one] if one in along else _DOWN[along[_DOWN[one]]] for one in claimed)


def gravity_sign(axes: Axes | None, claims: Claims) -> Finding:
    """Does the accelerometer at rest show +g upwards?"""
    code = "gravity_sign"
    if axes is None:
        return unknown(code, "The accelerometer feels no gravity.")
    if not axes.handed:
        text = (
            "Which sign gravity has is only told by bends that GNSS sees (speed and course, above 9 km/h): a box with "
            "the wrong sign looks like one that lies on its head and faces backwards."
        )
        return unknown(code, text)
    other = {"up": "down", "down": "up"}.get(claims.at_rest, "up")
    if axes.mistake == "inverted":
        text = (
            f"Every acceleration has the wrong sign: in bends and when braking the box feels the opposite of what the "
            f"drive does. At rest the axis that points up shows {'-g' if other == 'down' else '+g'} in this file "
            f"(phones from Apple do so), not {'+g' if other == 'down' else '-g'}.{_or_else(axes)}"
        )
        return contradicted(code, other, text, axes.sure)
    show = "+g" if claims.at_rest == "up" else "-g"
    text = f"At rest the axis that points up shows {show}: bends and braking push the right way."
    return confirmed(code, claims.at_rest, text, axes.sure)


def _or_else(axes: Axes) -> str:
    """The rival in words."""
    if not axes.rival:
        return ""
    kind, _, axis = axes.rival.partition("_")
    other = {"inverted": "every acceleration has the wrong sign", "accel": f"only {axis} of the accelerometer has"}
    what = other.get(kind, f"axes are swapped ({axes.rival.removeprefix('swap ')})")
    return f" It may also be that {what}, in a box that is mounted otherwise: how is it mounted?"


def forward_axis(axes: Axes | None) -> Finding:
    """Is x forward, in a box that is lined up with the vehicle?"""
    code = "forward_axis"
    if axes is None or axes.rot_sv is None:
        text = "Too few or too small changes of speed to tell which way is forward, or GNSS tells none."
        return unknown(code, text)
    forward = axes.rot_sv[:, 0]
    numbers = {f"forward_{axis}": float(part) for axis, part in zip(_AXES, forward, strict=True)}
    axis = int(np.abs(forward).argmax())
    value = f"{'-' if forward[axis] < 0 else '+'}{_AXES[axis]}"
    if abs(forward[axis]) < _LINED_UP or np.abs(axes.up).max() < _LINED_UP:
        text = (
            "The box is mounted at an angle: forward lies between its axes, so no axis is meant to be it. That is "
            "fine: best_accuracy and aligner.mount find the angle."
        )
        return confirmed(code, "oblique", text, **numbers)
    if value == "+x":
        return confirmed(code, value, "When the vehicle speeds up, x of the box feels it: x points forward.", **numbers)
    text = (
        f"When the vehicle speeds up, {value} feels it, not +x: the box is mounted turned, or its x axis points "
        "elsewhere than is meant. best_accuracy and thesis find that themselves; whoever reads x as forward is wrong."
    )
    return contradicted(code, value, text, **numbers)


def handedness(axes: Axes | None, claims: Claims) -> Finding:
    """Are the axes right-handed, with z up if the box is lined up, and as the reader takes them?"""
    code = "axes"
    if axes is None:
        return unknown(code, "The accelerometer feels no gravity.")
    if axes.mistake == "left-handed" or axes.mistake.startswith("swap"):
        which = axes.mistake.removeprefix("swap ").replace(" ", " and ")
        what = "Two of them are swapped, or one has the wrong sign"
        text = (
            "The axes are left-handed: hold thumb, index and middle finger of the right hand along x, y, z and they do "
            f"not fit. {what if axes.mistake == 'left-handed' else f'It looks as if {which} were swapped'}; a left "
            "turn pushes to the wrong side."
        )
        return contradicted(code, axes.mistake, text, axes.sure)
    axis = int(np.abs(axes.up).argmax())
    upright = f"{'-' if axes.up[axis] < 0 else '+'}{_AXES[axis]}"
    lined = abs(axes.up[axis]) > _LINED_UP
    whole = axes.lined_up
    value = letters_of(axes.rot_sv, claims.axes) if whole and axes.rot_sv is not None else f"{upright} up"
    tilt = {"up_x": float(axes.up[0]), "up_y": float(axes.up[1]), "up_z": float(axes.up[2])}
    if lined and upright != "+z":
        turned = " after the reader turned them" if claims.axes else ""
        text = f"Gravity is felt along {upright}, not +z{turned}: {upright} of the box points up." + _lies(upright)
        return contradicted(code, value, text, _TORN if axes.rival else SURE, **tilt)
    if not whole:
        what = "right-handed" if axes.handed else "not told: too few bends to see whether they are right-handed"
        text = f"Gravity is felt along {upright}; the axes are {what}." if lined else f"The axes are {what}."
        where = f"{upright} up" if lined else "oblique"
        return confirmed(code, where, text, **tilt) if axes.handed or lined else unknown(code, text, **tilt)
    if claims.axes and set(claims.axes) <= set("FBLRUD") and value != claims.axes:
        text = f"The axes are said to point {claims.axes} and point {value} (F forward, L left, U up, and so on)."
        return contradicted(code, value, text, **tilt)
    text = f"x, y, z of the file point {value} (F forward, B back, L left, R right, U up, D down)."
    return confirmed(code, value, text, **tilt)


def _lies(upright: str) -> str:
    if upright == "-z":
        return (
            " The box lies on its head, its axes are forward, right, down as aviation counts them, or the file counts "
            "gravity the other way round (see gravity_sign)."
        )
    return " The box stands on its side, or its axes are others than x forward, y left, z up."


def inverted_axis(axes: Axes | None) -> Finding:
    """Has one axis of one sensor the wrong sign?"""
    code = "inverted_axis"
    if axes is None or not axes.handed:
        return unknown(code, "Only bends that GNSS sees (speed and course) tell whether one axis has the wrong sign.")
    if axes.mistake.startswith(("accel_", "gyro")):
        sensor, _, axis = axes.mistake.partition("_")
        name = {"accel": "accelerometer", "gyro": "gyroscope"}[sensor]
        what = f"{axis} of the {name} has" if axis else f"all axes of the {name} have"
        text = (
            f"{what} the wrong sign: it shows the opposite of what the drive does in bends. (If the same axis of "
            f"the other sensor is wrong as well, the axes of the box are left-handed.){_or_else(axes)}"
        )
        return contradicted(code, axes.mistake, text, axes.sure)
    text = "No axis shows the opposite of what the drive does, as far as bends, braking and gravity tell."
    return confirmed(code, None, text, axes.sure)
