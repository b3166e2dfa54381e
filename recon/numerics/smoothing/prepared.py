"""A drive made ready for the smoother: where it stands, where fixes and wheels hang between the knots.

What follows from the log alone, or from what is believed of the stamps of the fixes; nothing here depends on the state.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from recon.numerics.smoothing.arrival import Arrival
from recon.numerics.smoothing.disturbances import Disturbances
from recon.numerics.smoothing.earth import earth_rate_n
from recon.numerics.smoothing.epochs import place_epochs
from recon.numerics.smoothing.lag import UNKNOWN, find_lag
from recon.numerics.smoothing.measurements import BodyModel
from recon.numerics.smoothing.model import Drive, Model
from recon.numerics.smoothing.samples import Samples
from recon.numerics.smoothing.soa import Floats
from recon.numerics.smoothing.start import fix_motion
from recon.numerics.smoothing.stops import (
    SLOW,
    Mask,
    block_means,
    find_stops,
    still_noise,
    still_spans,
)

STALE_LAG: Final = 0.02
"""s; a lag beyond this moves the stamps, for velocity times lag is only its first order."""
_STANDING_WHEELS: Final = 0.1
"""m/s; while GNSS says that it moves, such wheels only say that something carries the vehicle."""


class Prepared:
    """A drive made ready: stops found, epochs placed.

    arrival : what is known of the first knot and of what is common, in place of the priors of the model
    moved_lag : s, what the stamps of the fixes are moved by, where it is known beforehand
    """

    def __init__(self, drive: Drive, model: Model, arrival: Arrival | None = None, moved_lag: float | None = None):
        self.drive, self.model, self.arrival = drive, model, arrival
        samples = drive.samples
        self.blocks = block_means(samples, max(1, round(0.1 * samples.per_interval / _typical(samples))))
        self.motion = motion = fix_motion(drive.fixes)
        self.moved_lag = self._first_lag() if moved_lag is None else moved_lag
        self.first_lag = self.moved_lag
        stops = find_stops(self.blocks, motion[0] + self.moved_lag, motion[1])
        self.still, self.quiet, self.alone = stops.told, stops.quiet & ~stops.told, stops.alone
        self.still_noise = still_noise(self.blocks, self.still)
        knots = samples.knot_times
        self.length = np.diff(knots)
        self.disturbed = Disturbances.of(samples, drive.impacts, self.model.wheels)
        self.earth_rate_n = earth_rate_n(drive.anchor.lat)
        self.knot_rate = samples.gyro_s[:: samples.per_interval].T
        self.aids = [aid.at(knots) for aid in drive.aids]
        self._stand()
        self._place()

    def _first_lag(self) -> float:
        """What the stamps of the fixes are moved by before anything else is known: s."""
        if self.arrival is not None:
            return self.arrival.moved_lag
        late = find_lag(self.blocks, *self.motion) if self.model.lag > 0.0 else UNKNOWN
        return -late.seconds if abs(late.seconds) > max(STALE_LAG, 3.0 * late.sigma) else 0.0

    def believe(self, standing: Mask) -> None:
        """From now on the vehicle stands in these of the `quiet` blocks: (B,)."""
        self.still, self.quiet = self.still | standing, self.quiet & ~standing
        self._stand()
        self._bind()

    def move_stamps(self, lag: float) -> None:
        """From now on the stamps of the fixes are moved by so much more, s."""
        self.moved_lag += lag
        self._place()

    def _stand(self) -> None:
        """The knots and intervals that lie in standstills."""
        knots = self.drive.samples.knot_times
        self.still_knots = still_spans(self.blocks, self.still, knots - 0.1, knots + 0.1)
        self.still_intervals = still_spans(self.blocks, self.still, knots[:-1], knots[1:])

    def _place(self) -> None:
        """Place the epochs, at fixes stamped as now believed."""
        self.epochs = place_epochs(self.drive.samples, self.blocks, self.drive.fixes.t_s + self.moved_lag)
        self._bind()

    def _bind(self) -> None:
        """The epochs at which the wheels bind."""
        drive, samples, t_s = self.drive, self.drive.samples, self.epochs.t_s
        step = np.clip(np.searchsorted(samples.t_s, t_s, side="right") - 1, 0, len(samples.filled) - 1)
        quiet = still_spans(self.blocks, self.still, t_s - 0.1, t_s + 0.1)
        speed = np.full(len(t_s), np.nan)
        if len(drive.wheel_t_s):
            speed = np.interp(t_s, drive.wheel_t_s, drive.wheel_speed)
            carried = (np.abs(speed) < _STANDING_WHEELS) & (np.interp(t_s, *self.motion[:2]) > SLOW)
            speed[carried] = np.nan
        self.body = BodyModel(
            slip=self.model.slip_growth,
            wheel_sigma=self.model.wheel_speed,
            on=self.epochs.live & ~quiet & ~samples.filled[step] & ~self._slipping(t_s),
            rolls=np.zeros(len(t_s), dtype=bool),
            wheel_speed=speed,
        )

    def _slipping(self, t_s: Floats) -> Mask:
        """Times at which wheels may slip: from an impact until the vehicle stands, or for as long as that may take."""
        slipping = np.zeros(len(t_s), dtype=bool)
        for impact in self.drive.impacts:
            stands = self.blocks.t_s[self.still & (self.blocks.t_s > impact.end_s)]
            until = min([impact.end_s + impact.slip_s, *stands[:1].tolist()])
            slipping |= (t_s >= impact.start_s) & (t_s <= until)
        return slipping


def _typical(samples: Samples) -> float:
    """Length of an interval of the log, s."""
    return float(np.median(np.diff(samples.knot_times)))
