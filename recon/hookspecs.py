"""What a plugin module can declare: one hook for each role.

A module holds one or more functions marked `@hookimpl` that yield records. It is named in its distribution's
metadata, in the group `recon.plugins`, under "<role>.<name>":

    [project.entry-points."recon.plugins"]
    "filter.clip" = "my_package.clip"

pluggy finds and declares; it never executes. Each docstring below is a complete module.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import pluggy

from recon.stages import (
    Aligner,
    Analyzer,
    Detector,
    Executor,
    Exporter,
    Filter,
    Fuser,
    Integrator,
    Reader,
    Simulator,
)

PROJECT: Final = "recon"

hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@hookspec
def declare_readers() -> Iterable[Reader]:
    """Readers turn one file or folder into streams. Times rise; nothing is resampled; units are SI.

    from recon import GNSS, Params, Reader, Sniff, build, hookimpl
    import numpy as np

    def read_dat(path, params):
        t_s, speed = np.loadtxt(path, unpack=True, ndmin=2)
        return {"gnss": build(GNSS, time=(t_s * 1e9).astype(np.int64), speed=speed)}

    def sniff(path, head):
        return Sniff(0.9 if head.startswith(b"# my logger") else 0.0, "first line")

    @hookimpl
    def declare_readers():
        yield Reader(name="dat", summary="Speed log of my logger.", run=read_dat, sniff=sniff,
                     writes={"gnss": GNSS.only(maybe=["speed"])})
    """
    return ()


@hookspec
def declare_simulators() -> Iterable[Simulator]:
    """Simulators make a recording from parameters. The same seed gives the same recording.

    from recon import IMU, Params, Simulator, build, hookimpl, setting
    import numpy as np

    class Still(Params):
        rows: int = setting(100, gt=0, doc="Number of samples at 100 Hz.")

    def still(params):
        t_ns = np.arange(params.rows) * 10_000_000
        accel = np.tile([0.0, 0.0, 9.80665], (params.rows, 1))
        return {"imu": build(IMU, time=t_ns, accel=accel, gyro=np.zeros((params.rows, 3)))}

    @hookimpl
    def declare_simulators():
        yield Simulator(name="still", summary="A box at rest.", params=Still, run=still, writes={"imu": IMU})
    """
    return ()


@hookspec
def declare_filters() -> Iterable[Filter]:
    """Filters return a stream that they read: fewer rows, other values, other times only with `resamples`.

    from recon import IMU, SAME, Filter, Params, hookimpl, matrix, quantity, replace

    class Clip(Params):
        limit: float = quantity(50.0, "m/s^2", gt=0, doc="Largest magnitude that is let through.")

    def clip(*, imu, params):
        return {"imu": replace(imu, accel=matrix(imu, "accel").clip(-params.limit, params.limit))}

    @hookimpl
    def declare_filters():
        yield Filter(name="clip", summary="Limits the accelerations of imu.", params=Clip, run=clip,
                     reads={"imu": IMU.need("accel")}, writes={"imu": SAME})
    """
    return ()


@hookspec
def declare_detectors() -> Iterable[Detector]:
    """Detectors return `events`: inside the span of what they read, sorted, without overlap within a kind.

    from recon import EVENTS, GNSS, Detector, Event, events, hookimpl, time_ns, vector

    def fastest(*, gnss, params):
        row = vector(gnss, "speed").argmax()
        t_ns = int(time_ns(gnss)[row])
        return {"events": events([Event(t_ns, t_ns, "fastest")])}

    @hookimpl
    def declare_detectors():
        yield Detector(name="fastest", summary="The moment of the highest speed.", run=fastest,
                       reads={"gnss": GNSS.need("speed")}, writes={"events": EVENTS})
    """
    return ()


@hookspec
def declare_aligners() -> Iterable[Aligner]:
    """Aligners turn vectors into another frame, or shift clocks. What they found goes into `metrics`.

    from recon import IMU, Aligner, Change, Metric, hookimpl, matrix, metrics, replace

    def flip(*, imu, params):
        turned = {group: matrix(imu, group) * [-1.0, -1.0, 1.0] for group in ("accel", "gyro")}
        return {"imu": replace(imu, **turned), "metrics": metrics([Metric("yaw", 180.0, "deg")])}

    @hookimpl
    def declare_aligners():
        yield Aligner(name="flip", summary="The box looks backwards.", run=flip,
                      reads={"imu": IMU.need("accel", "gyro", frame="level")},
                      writes={"imu": Change(frames={"accel": "vehicle", "gyro": "vehicle"})})
    """
    return ()


@hookspec
def declare_integrators() -> Iterable[Integrator]:
    """Integrators turn rates into attitude, or accelerations into motion. Quaternions are of unit length.

    from recon import ATTITUDE, IMU, Integrator, build, hookimpl, seconds, time_ns, vector
    from recon.numerics.integration import cumulative
    import numpy as np

    def yaw_only(*, imu, params):
        half = cumulative(seconds(imu), vector(imu, "gyro_z"), "trapezoid") / 2
        zero = np.zeros_like(half)
        q = np.column_stack([np.cos(half), zero, zero, np.sin(half)])
        return {"attitude": build(ATTITUDE, time=time_ns(imu), q=q)}

    @hookimpl
    def declare_integrators():
        yield Integrator(name="yaw_only", summary="Heading from the vertical gyroscope.", run=yaw_only,
                         reads={"imu": IMU.need("gyro", frame="vehicle")}, writes={"attitude": ATTITUDE})
    """
    return ()


@hookspec
def declare_fusers() -> Iterable[Fuser]:
    """Fusers combine sensors into `trajectory`.

    from recon import GNSS, SAME, TRAJECTORY, Fuser, hookimpl, matrix, replace, time_ns
    import numpy as np

    def follow(*, trajectory, gnss, params):
        t, t_fix, pos = time_ns(trajectory), time_ns(gnss), matrix(gnss, "pos")
        pos = np.column_stack([np.interp(t, t_fix, pos[:, axis]) for axis in range(3)])
        return {"trajectory": replace(trajectory, pos=pos)}

    @hookimpl
    def declare_fusers():
        yield Fuser(name="follow", summary="Position from GNSS alone.", run=follow,
                    reads={"trajectory": TRAJECTORY.need("pos"), "gnss": GNSS.need("pos")},
                    writes={"trajectory": SAME})
    """
    return ()


@hookspec
def declare_analyzers() -> Iterable[Analyzer]:
    """Analyzers add `metrics`, `events` or streams of a new name, and replace none.

    from recon import TRAJECTORY, Analyzer, Metric, hookimpl, matrix, metrics
    import numpy as np

    def top_speed(*, trajectory, params):
        speed = np.linalg.norm(matrix(trajectory, "vel"), axis=1)
        return {"metrics": metrics([Metric("top_speed", float(speed.max()), "m/s")])}

    @hookimpl
    def declare_analyzers():
        yield Analyzer(name="top_speed", summary="The highest speed.", run=top_speed,
                       reads={"trajectory": TRAJECTORY.need("vel")})
    """
    return ()


@hookspec
def declare_exporters() -> Iterable[Exporter]:
    """Exporters write files, only inside `folder`, and return their paths. Where a drive holds nothing of what they
    show they raise NothingToExport: any other error fails the drive in a fleet.

    from recon import TRAJECTORY, Exporter, hookimpl, matrix
    import numpy as np

    def npy(*, trajectory, folder, about, params):
        np.save(folder / "positions.npy", matrix(trajectory, "pos"))
        return [folder / "positions.npy"]

    @hookimpl
    def declare_exporters():
        yield Exporter(name="npy", summary="Positions as a NumPy file.", run=npy,
                       reads={"trajectory": TRAJECTORY.need("pos")})
    """
    return ()


@hookspec
def declare_executors() -> Iterable[Executor]:
    """Executors run the jobs of a batch: every job once, in any order; a job that dies takes no other with it.

    from recon import Executor, hookimpl

    def one_by_one(jobs, params):
        for job in jobs:
            yield job.run()

    @hookimpl
    def declare_executors():
        yield Executor(name="one_by_one", summary="One job after the other.", run=one_by_one)
    """
    return ()
