"""Units that cannot be right are told while a log is followed, and kept with its result."""

from __future__ import annotations

import numpy as np
import pytest

import recon
from recon.check import check
from recon.live.units import Units
from recon.pipeline import Pipeline
from recon.registry import Registry
from recon.tables import matrix, replace, select_rows, time_ns

DEG = np.pi / 180.0


@pytest.fixture(scope="module")
def drive():
    given = {"simulator.drive.duration": "150 s", "simulator.drive.imu_rate": "20 Hz", "simulator.drive.seed": 3}
    return recon.run("simulated_drive", **given).recording


def doubts_of(drive, registry, seconds=150, **factors):
    """Of a drive whose imu has groups times a factor, given in steps of ten seconds as a reader of csv takes them."""
    imu = drive["imu"]
    wrong = replace(imu, **{name: matrix(imu, name) * factor for name, factor in factors.items()})
    reader = check(Pipeline.of("any", "reader.auto"), registry)[0].steps[0]
    units = Units(reader, registry)
    begun = int(time_ns(imu)[0])
    for step in range(seconds // 10):
        here = {
            name: select_rows(table, (time_ns(table) - begun) // 10**10 == step)
            for name, table in {"imu": wrong, "gnss": drive["gnss"]}.items()
        }
        units.take(here, None)
    return units.doubts


@pytest.mark.parametrize(
    ("factors", "sentences"),
    [
        ({}, []),
        ({"accel": 1.0 / 9.80665}, ["accel_unit: The accelerometer feels 0.99"]),
        ({"gyro": 1.0 / DEG}, ["gyro_unit: The gyroscope turns 57"]),
        ({"accel": 1.0 / 9.80665, "gyro": 1e3}, ["accel_unit: The accelerometer", "gyro_unit: The gyroscope turns"]),
    ],
)
def test_each_wrong_unit_is_told_once(drive, factors, sentences):
    doubts = doubts_of(drive, Registry.installed(), **factors)
    assert len(doubts) == len(sentences)
    for doubt, sentence in zip(doubts, sentences, strict=True):
        assert doubt.startswith(sentence)
        assert doubt.endswith("'recon doctor' says what puts it right")


def test_what_is_said_once_is_not_believed_yet(drive):
    wrong = {"accel": 1.0 / 9.80665}
    assert doubts_of(drive, Registry.installed(), seconds=10, **wrong) == []
    assert len(doubts_of(drive, Registry.installed(), seconds=30, **wrong)) == 1


def test_without_the_doctor_nothing_is_doubted(drive):
    registry = Registry.installed(block=["analyzer.doctor"])
    assert doubts_of(drive, registry, gyro=1.0 / DEG) == []
