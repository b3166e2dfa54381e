"""What a log's own data say of its units, axes, clocks, samples and receiver: every convention, confirmed or not.

A finding is a row of metrics, `finding_<code>`: its value where that is a number, its status (confirmed, contradicted,
unknown) as method, and everything, with the explanation, the YAML that puts it right and the curves that show it, as
JSON in the note. What is contradicted also warns. Codes, their statistics and what data cannot tell stand in the
README of this folder; the numerics in recon.numerics.doctor.

References
    Knapp, Carter (1976), "The generalized correlation method for estimation of time delay", IEEE T-ASSP 24(4).
    Wahba (1965), "A least squares estimate of satellite attitude", SIAM Review 7(3).
"""

from __future__ import annotations

from collections.abc import Iterable

import pyarrow as pa

from recon import GNSS, IMU, REFERENCE, Analyzer, NotEnoughData, Params, Streams, hookimpl, metrics, setting, warning
from recon.schema import METRICS
from recon.sensor_classes import CLASSES, SensorClass, typical


class DoctorParams(Params):
    """Parameters of analyzer.doctor."""

    sensor_class: SensorClass = setting("consumer_mems", doc="What kind of IMU it is said to be, for its noise.")


def examine_log(
    *,
    imu: pa.Table | None,
    gnss: pa.Table | None,
    gnss_2: pa.Table | None,
    reference: pa.Table | None,
    metrics: pa.Table | None,
    params: DoctorParams,
) -> Streams:
    """The findings. metrics : what the reader told. Raises NotEnoughData where neither imu nor gnss has a row."""
    if not any(table is not None and table.num_rows for table in (imu, gnss)):
        raise NotEnoughData("rows in imu or gnss", needed="1", found="0")
    return {"metrics": _findings(imu, gnss, gnss_2, reference, metrics, params)}


def _findings(
    imu: pa.Table | None,
    gnss: pa.Table | None,
    gnss_2: pa.Table | None,
    reference: pa.Table | None,
    learnt: pa.Table | None,
    params: DoctorParams,
) -> pa.Table:
    from dataclasses import replace

    from recon.doctor import fix_of, metric_of, needless, yaml_of  # slow import: only when used
    from recon.numerics.doctor import examine
    from recon_analyzers._doctor_log import claims_of, log_of

    claims, reader = claims_of(learnt, gnss, params.sensor_class)
    classes = [(name, typical(name, "gyro_noise"), typical(name, "accel_noise")) for name in CLASSES]
    found, letters = examine(log_of(imu, gnss, gnss_2, reference, claims), classes)
    lag = next((one.statistic.get("lag_s") for one in found if one.code == "gnss_position_lag"), None)
    mistaken = any(one.code == "inverted_axis" and one.status == "contradicted" for one in found)
    rows = []
    for one in found:
        fix = fix_of(one, claims, reader, letters, lag, mistaken=mistaken)
        told = replace(one, yaml=yaml_of(fix), explanation=one.explanation + needless(one, fix, lag))
        rows.append(metric_of(told))
        if one.status == "contradicted":
            rows.append(warning(f"{one.code}: {told.explanation}"))
    return metrics(rows)


@hookimpl
def declare_analyzers() -> Iterable[Analyzer]:
    """The analyzer `doctor`."""
    yield Analyzer(
        name="doctor",
        version=2,
        summary="Whether units, axes, clocks, samples and receiver are what they are taken for, by the data alone.",
        params=DoctorParams,
        run=examine_log,
        reads={
            "imu": IMU.need(maybe=["accel", "gyro"], optional=True),
            "gnss": GNSS.need(
                maybe=["lat", "lon", "height", "speed", "course", "vel", "pos_std", "vel_std"], optional=True
            ),
            "gnss_2": GNSS.need(maybe=["height"], optional=True),
            "reference": REFERENCE.need(maybe=["height"], optional=True),
            "metrics": METRICS.need("name", "value", "method", "note", optional=True),
        },
        references=("Knapp, Carter 1976", "Wahba 1965"),
    )
