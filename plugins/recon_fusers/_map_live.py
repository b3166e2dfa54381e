"""fuser.map while the drive goes on: a window that follows the log, smoothed anew at every call.

What leaves the window is kept as the prior of its first knot (recon.numerics.smoothing.arrival), so every call costs
the same, however long the drive is. A row of the trajectory is given once, when `lag` has passed since: by then most of
what GNSS will say about it is known. Until speed and course tell the heading, nothing is given.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import astuple, dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pyarrow as pa

from recon import DataError, Streams, has, select_rows, time_ns
from recon.aiding import AidTrust, aids_of
from recon.driving import drive_of, measured, solve
from recon.fixes import Observed, about, observe
from recon.numerics.geodesy import Anchor
from recon.numerics.smoothing import Drive, Estimate, Model, Noise, Smoother, sigmas
from recon.numerics.smoothing.arrival import Arrival
from recon.numerics.smoothing.estimate import knots_of, part_of, with_covariances, with_stops_in_silence
from recon.numerics.smoothing.noise import likely_noise
from recon.numerics.smoothing.start import continued
from recon.numerics.smoothing.state import State
from recon.units import duration_text
from recon_fusers import _map_tables as tables
from recon_fusers.map import model_of, noise_of, trust_of

if TYPE_CHECKING:
    from recon_fusers.map import MapParams

_FIRST_S: Final = 60.0
"""s of the log from which the start is found."""
_AGAIN_S: Final = 5.0
"""s until it is tried again, where the start cannot be told yet."""
_WHOLE_S: Final = 300.0
"""s of the log that are smoothed as a whole before the window moves; of so many the noise is known well."""
_GROWS: Final = 1.5
"""Factor between the lengths of the log at which the noise is estimated again, until the window moves."""
_BEHIND_S: Final = 180.0
"""s of the window behind what is given next: what a burst of multipath said is weighed anew for so long. With half of
it velocities are a tenth worse."""
_MOVES_S: Final = 60.0
"""s by which the window moves at once."""
_HEADING: Final = np.radians(3.0)
"""Largest sigma of a heading with which it begins."""
_PAUSE_S: Final = 1800.0
"""s without the imu after which it starts anew; over shorter ones the drive is one."""
_TAKEN: Final = ("imu", "gnss", "wheel", "baro")
_FIXES_KEPT: Final = 5
"""Rows of GNSS that stay, however old: they tell which columns the receiver fills."""


@dataclass(frozen=True)
class _Held:
    """What is known of the window's first row: the state and its information, and the noise."""

    arrival: Arrival
    noise: Noise


class LiveMap:
    """Give it new rows by `advance`; it gives those of the trajectory that are final.

    lag : s, how long a row waits; saved : what `saved` gave, to go on from there
    """

    def __init__(self, params: MapParams, lag: float, saved: bytes | None = None) -> None:
        self.params, self.lag = params, lag
        self.streams: dict[str, pa.Table] = {}
        self.held: _Held | None = None
        self.guess: tuple[np.ndarray, State] | None = None
        self.given_ns = self.since_ns = int(np.iinfo(np.int64).min)
        self.try_at_ns = self.given_ns
        self.learn_at_s = _FIRST_S
        self.noise: Noise | None = None
        self.awaits = "rows of imu and gnss"
        self.unused: tuple[str, ...] = ()
        self.anchor: Anchor | None = None
        if saved is not None:
            self._restore(saved)

    def advance(self, new: Mapping[str, pa.Table]) -> Streams:
        """Take rows of imu, gnss, wheel and baro that follow those given before.

        returns : `trajectory`, rows that are final, and `latest`, one row, the newest that is known; {} before the
            start is found
        """
        before = self._end_before_pause(new["imu"]) if "imu" in new else {}
        for name in _TAKEN:
            if name in new:
                self._append(name, new[name])
        self._note_unused(new)
        return before or self._told(self.lag)

    def _note_unused(self, new: Mapping[str, pa.Table]) -> None:
        """Streams of other names, and the steering, whose model is fitted to a whole drive."""
        left = [name for name, table in new.items() if name not in _TAKEN and name != "events" and table.num_rows]
        if "wheel" in new and self.params.steering and has(new["wheel"], "steering_angle"):
            left.append("the steering angle of wheel")
        self.unused = tuple(dict.fromkeys([*self.unused, *left]))

    def finish(self) -> Streams:
        """The rest of `trajectory`, where no more rows will come."""
        told = dict(self._told(0.0))
        told.pop("latest", None)
        return told

    def _end_before_pause(self, imu: pa.Table) -> Streams:
        """The rest of `trajectory`, and a new start, where so long a pause follows that the box may have been moved."""
        old = self.streams.get("imu")
        if old is None or not old.num_rows or not imu.num_rows:
            return {}
        pause_ns = int(time_ns(imu)[0] - time_ns(old)[-1])
        if pause_ns < _PAUSE_S * 1e9:
            return {}
        told = self.finish()
        self.held = self.guess = None
        self._forget_before(int(time_ns(imu)[0]))
        self.awaits = f"a new start after a pause of {duration_text(pause_ns * 1e-9)}"
        return told

    def _model(self) -> Model:
        """Of a window: no clock runs away in so few minutes, and later ones have a delay of their own."""
        return replace(model_of(self.params, None, self.streams.get("baro")), clock=0.0)

    def _told(self, lag: float) -> Streams:
        """What is known `lag` s before the last row, and of the last row."""
        if not {"imu", "gnss"} <= self.streams.keys():
            return {}
        try:
            found, observed = self._begin() if self.held is None else self._go_on(self.held)
        except DataError as error:
            self.awaits = f"a drive that tells more: {'; '.join(filter(None, (error.message, error.hint)))}"
            return {}
        if found is None or observed is None:
            return {}
        imu = measured(self.streams["imu"])
        motion = tables.trajectory(found, observed, imu, self.streams["gnss"], self.params.output_rate)
        self.awaits = ""
        at = time_ns(motion)
        final = (at > self.given_ns) & (at <= at[-1] - round(lag * 1e9))
        if final.any():
            self.given_ns = int(at[final][-1])
        self._move_on(found, imu)
        return {"trajectory": select_rows(motion, final), "latest": motion.slice(motion.num_rows - 1)}

    def _append(self, name: str, new: pa.Table) -> None:
        """Rows that are later than those that are there."""
        old = self.streams.get(name)
        last = self.since_ns - 1 if old is None or not old.num_rows else int(time_ns(old)[-1])
        fresh = select_rows(new, time_ns(new) > last)
        self.streams[name] = fresh if old is None else pa.concat_tables([old, fresh.cast(old.schema)])

    def _window(self, fewest_fixes: int) -> tuple[Drive, Observed, int]:
        """The drive in the window; its axes keep the origin of the first, whatever has left it since."""
        imu = measured(self.streams["imu"])
        start_ns = int(time_ns(imu)[0]) if imu.num_rows else 0
        gnss = self.streams["gnss"] if self.anchor is None else about(self.streams["gnss"], self.anchor)
        observed = observe(gnss, start_ns, trust_of(self.params), self.params.reported_sigmas)
        drive = drive_of(imu, self.streams.get("wheel"), observed, start_ns, fewest_fixes=fewest_fixes)
        trust = AidTrust(self.params.baro_noise, self.params.baro_walk)
        aids, _ = aids_of(imu, self.streams.get("baro"), None, None, observed, start_ns, trust)
        return replace(drive, aids=aids), observed, start_ns

    def _begin(self) -> tuple[Estimate | None, Observed | None]:
        """The whole window at once, as fuser.map does; None where it does not tell enough yet."""
        at = time_ns(self.streams["imu"])
        length_s = float(at[-1] - at[0]) * 1e-9 if len(at) else 0.0
        if length_s < _FIRST_S:
            self.awaits = f"{_FIRST_S:.0f} s of the imu, of which {length_s:.0f} s are there"
            return None, None
        if at[-1] < self.try_at_ns:
            return None, None
        self._forget_before(int(at[-1]) - round(_WHOLE_S * 1e9))
        learn = self.noise is None or length_s >= self.learn_at_s
        drive, observed, _ = self._window(3)
        noise = noise_of(self.params, observed) if self.noise is None else self.noise
        found = solve(drive, self._model(), noise, learn and self.params.estimate_noise)
        if sigmas(found)[8, -1] > _HEADING:
            self.try_at_ns = int(at[-1]) + round(_AGAIN_S * 1e9)
            sigma = np.degrees(sigmas(found)[8, -1])
            self.awaits = f"the heading, known to {sigma:.0f} deg after {length_s:.0f} s: driving and turning tell it"
            return None, None
        if learn:
            self.noise, self.learn_at_s = found.solved.noise, _GROWS * length_s
        self.anchor = observed.anchor
        return found, observed

    def _go_on(self, held: _Held) -> tuple[Estimate | None, Observed | None]:
        drive, observed, start_ns = self._window(0)
        smoother = Smoother(drive, self._model(), held.arrival)
        knots_ns = start_ns + np.rint(drive.samples.knot_times * 1e9).astype(np.int64)
        state = held.arrival.state
        if self.guess is not None:
            before_ns, state = self.guess
            same = min(len(before_ns), len(knots_ns))
            same = int((np.abs(before_ns[:same] - knots_ns[:same]) < 1000).cumprod().sum())
            state = knots_of(state, slice(0, max(same, 1) - 1))
        try:
            solved = smoother.solve(continued(smoother, state), held.noise, "tls")
            found = with_stops_in_silence(smoother, solved)
        except np.linalg.LinAlgError:
            self.held = self.guess = None
            self.awaits = "a new start: the last minutes did not determine the way"
            return None, None
        self.guess = (knots_ns, found.solved.state)
        return found, observed

    def _move_on(self, found: Estimate, imu: pa.Table) -> None:
        """Let the window begin later where it is long enough, and keep what its beginning told."""
        samples = found.smoother.drive.samples
        knots = samples.knot_times
        if knots[-1] < (_WHOLE_S - _AGAIN_S if self.held is None else self.lag + _BEHIND_S + _MOVES_S):
            return
        logged = samples.row[:: samples.per_interval] >= 0
        may = np.flatnonzero(logged & (knots <= knots[-1] - self.lag - _BEHIND_S))
        if not len(may) or may[-1] < 2:
            return
        k = int(may[-1])
        first = slice(0, k)
        smoother = Smoother(part_of(found.smoother.drive, first), found.smoother.model, found.smoother.arrival)
        smoother.datum = found.smoother.datum
        smoother.move_stamps(found.solved.moved_lag - smoother.moved_lag)
        smoother.believe(found.smoother.still[: len(smoother.still)])
        try:
            part = with_covariances(smoother, smoother.about(knots_of(found.solved.state, first), found.solved.noise))
            noise = found.solved.noise if self.held is None else self._noise_of(found)
        except np.linalg.LinAlgError:
            return
        last = knots_of(part.solved.state, slice(k, k))
        arrival = Arrival.of(
            last, part.covariance[-1], part.cross[-1], part.covariance_common, smoother.free, part.solved.moved_lag
        )
        self.held = _Held(arrival, noise)
        start_ns = int(time_ns(imu)[0])
        knots_ns = start_ns + np.rint(knots * 1e9).astype(np.int64)
        self.guess = (knots_ns[k:], knots_of(found.solved.state, slice(k, len(knots) - 1)))
        self._forget_before(int(time_ns(imu)[samples.row[k * samples.per_interval]]))

    def _noise_of(self, found: Estimate) -> Noise:
        """What a window with a fix for every knot tells of the noise; that of GNSS positions is as slow as the window
        is long, and stays as it was learnt at the beginning.
        """
        solved = found.solved
        told = (solved.epochs.fix >= 0) & (solved.pos_weight > 0.5)
        if not self.params.estimate_noise or told.sum() < solved.state.knots:
            return solved.noise
        now, before = likely_noise(found.smoother, solved, found.smoother.still_noise), solved.noise
        return replace(now, drift=before.drift, drift_tau=before.drift_tau, position=before.position, bank=before.bank)

    def _forget_before(self, since_ns: int) -> None:
        self.since_ns = since_ns
        for name, table in self.streams.items():
            old = int(np.searchsorted(time_ns(table), since_ns))
            kept = old if name == "imu" else min(old, max(table.num_rows - _FIXES_KEPT, 0))
            self.streams[name] = table.slice(kept)

    def saved(self) -> bytes:
        """What `LiveMap` goes on from; b"" before the start is found. Rows from `since_ns` on are needed again."""
        if self.held is None or self.anchor is None:
            return b""
        arrival, noise = self.held.arrival, self.held.noise
        file = io.BytesIO()
        kept: dict[str, Any] = {
            **{f"state_{name}": value for name, value in vars(arrival.state).items()},
            **{f"noise_{name}": np.asarray(value) for name, value in vars(noise).items()},
            "information": arrival.information,
            "free": arrival.free,
            "moved_lag": arrival.moved_lag,
            "anchor": np.array(astuple(self.anchor)),
            "times_ns": np.array([self.since_ns, self.given_ns]),
        }
        np.savez(file, **kept)
        return file.getvalue()

    def _restore(self, saved: bytes) -> None:
        with np.load(io.BytesIO(saved), allow_pickle=False) as file:
            kept = {name: file[name] for name in file.files}
        state = State(**{f.name: kept[f"state_{f.name}"] for f in fields(State)})
        saved_sizes = {f.name: kept[f"noise_{f.name}"] for f in fields(Noise)}
        sizes: dict[str, Any] = {name: size if size.ndim else float(size) for name, size in saved_sizes.items()}
        noise = Noise(**sizes)
        arrival = Arrival(state, kept["information"], kept["free"], float(kept["moved_lag"]))
        self.held, self.anchor = _Held(arrival, noise), Anchor(*kept["anchor"].tolist())
        self.since_ns, self.given_ns = kept["times_ns"].tolist()
        self.awaits = "rows that come after those it knows"
