"""Logs of ArduPilot: DataFlash from the autopilot (.bin), MAVLink telemetry from a ground station (.tlog).

    .bin    IMU GPS GPA MAG BARO                        each instance; m/s^2, rad/s, mgauss, Pa
            XKF1 or NKF1 or EKF1, ORGN                  the on-board estimate as reference, core 0
    .tlog   HIGHRES_IMU; RAW_IMU of ArduPilot, SCALED_IMU, 2, 3     m/s^2 or mg, rad/s or mrad/s, gauss or mgauss
            GPS_RAW_INT, SCALED_PRESSURE; GLOBAL_POSITION_INT and ATTITUDE as reference

Vectors are logged along forward, right, down and given along forward, left, up; heights are above mean sea level.
Times count from the boot of the autopilot. UTC of a .bin is what the receiver says, GPS week and time less the leap
seconds of that day; of a .tlog what SYSTEM_TIME says, else the clock of the ground station. In both it is the median of
the differences to the boot clock, so that the receiver's or the radio's delay remains in it. Where a .tlog goes on over
a restart of the autopilot, each start has its own. Only what the sender of most messages sent is read, no gimbal's.

pymavlink makes an object of every message and ends at the first kind that it does not know; here both formats are read
as columns, and a damaged place is passed over.

References: ArduPilot, AP_Logger/LogStructure.h; mavlink.io, common.xml; IS-GPS-200, 20.3.3.5.2.4.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from recon.hookspecs import hookimpl
from recon.parameters import NoParams
from recon.stages import EVERYTHING, Reader, Sniff, Wanted
from recon.tables import Streams
from recon_readers import _dataflash, _mavlink
from recon_readers._ardupilot_flash import from_flash
from recon_readers._ardupilot_telemetry import from_telemetry
from recon_readers._autopilot import WRITES, Log


def read(path: Path, params: NoParams, wanted: Wanted = EVERYTHING) -> Streams:
    """The streams imu, gnss, mag, baro and reference, each sensor's own, as far as they are there and wanted.

    Raises ReadFailed, NothingUsable where the log holds none.
    """
    with path.open("rb") as file:
        flash = file.read(2) == _dataflash.HEAD
    log = Log(path, wanted, {"format": "ArduPilot DataFlash" if flash else "MAVLink tlog"})
    return from_flash(log) if flash else from_telemetry(log)


def sniff(path: Path, head: bytes) -> Sniff:
    """A FMT message at the start, or times of reception with frames of MAVLink behind them."""
    if head.startswith(_dataflash.HEAD):
        known = head[2:3] == bytes([_dataflash.FMT])
        return Sniff(0.95 if known else 0.6, "DataFlash log of ArduPilot")
    if head.startswith(b"FMT, 128, 89"):
        return Sniff(0.3, "DataFlash log as text: give the .bin that it was made from")
    at = 0
    for _ in range(3):
        frame = _mavlink.frame_at(head, at)
        if frame is None:
            return Sniff(0.0, "neither DataFlash nor MAVLink")
        at = _mavlink.end_of(head, at, *frame[2:])
    return Sniff(0.95, "MAVLink telemetry log")


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of logs of ArduPilot."""
    yield Reader(
        name="ardupilot",
        summary="Logs of ArduPilot, DataFlash and telemetry: IMU, GNSS, magnetometer, barometer, on-board estimate.",
        run=read,
        version=2,
        sniff=sniff,
        selective=True,
        writes=WRITES,
        references=("ArduPilot, AP_Logger/LogStructure.h", "mavlink.io, common.xml", "IS-GPS-200, 20.3.3.5.2.4"),
    )
