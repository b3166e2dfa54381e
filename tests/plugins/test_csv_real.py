"""Real logs read by their mappings, and by those that are proposed for them."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from csv_logs import MAPPINGS, NS, params_of

from recon.rows import warnings_of
from recon.tables import matrix, time_ns
from recon.yaml_nodes import load_file
from recon_readers.csv import propose, read

REAL = [
    ("dresden_car", "balzer82_dresden/2014-03-26-000-Data.csv", {"imu": 10_800, "gnss": 2_121}),
    ("dresden_car", "balzer82_dresden/2014-02-14-data_from_karanchawla.csv", {"imu": 1_500, "gnss": 301}),
    ("dresden_motorbike", "balzer82_dresden/2016-08-09-Motorbike.csv", {"imu": 5_353, "gnss": 107, "mag": 2_765}),
    ("boston_car", "neu_boston_car/first_test/town_imu.csv", {"imu": 26_857, "mag": 26_857}),
    ("boston_car", "neu_boston_car/first_test/town_gps.csv", {"gnss": 664}),
    ("boston_car2", "neu_boston_car2/circle_data_0_imu.csv", {"imu": 2_530, "mag": 2_530}),
    ("boston_car2", "neu_boston_car2/circle_data_0_gps.csv", {"gnss": 66}),
    ("driver_behavior", "driver_behavior_br/17/acelerometro_terra.csv", {"imu": 20_675}),
    ("driver_behavior", "driver_behavior_br/17/campoMagnetico_terra.csv", {"mag": 20_675}),
    ("walk", "rtklibexplorer_walk/imu_1730_sf.csv", {"imu": 20_455}),
    ("walk", "rtklibexplorer_walk/gnss_1730_sf.pos", {"gnss": 536}),
    ("walk_raw", "rtklibexplorer_walk/imu_1730.csv", {"imu": 20_455}),
    ("urban", "sim_urban_gnssinssim/imu.csv", {"imu": 25_587, "mag": 25_587, "wheel": 25_587}),
    ("urban", "sim_urban_gnssinssim/gnss.csv", {"gnss": 2_049}),
    ("scooter", "accidetec_scooter/Crashtest.tsv", {"imu": 29_767}),
    ("phyphox", "formats/phyphox/data/Acceleration without g 2024-01-20 17-52-51/Raw Data.csv", {"imu": 3_273}),
    ("sensor_logger_location", "formats/sensor_logger/Location_head600.csv", {"gnss": 599}),
    (
        "sensor_logger_merged",
        "formats/sensor_logger/2025-06-11_20-34-24.csv",
        {"imu": 456, "gnss": 1_648, "mag": 448, "baro": 448},
    ),
]


@pytest.mark.parametrize(("mapping", "file", "rows"), REAL)
def test_a_real_log_is_read_by_its_mapping(logs: Path, mapping: str, file: str, rows: dict[str, int]) -> None:
    """Rows are those that the logs' README counts; of repeated GNSS those whose position differs from the last one."""
    params = params_of((MAPPINGS / f"{mapping}.yaml").read_text(encoding="utf-8"))
    streams = read(path=logs / file, params=params)
    assert {name: table.num_rows for name, table in streams.items() if name != "metrics"} == rows
    for table in (table for name, table in streams.items() if name != "metrics"):
        assert (np.diff(time_ns(table)) > 0).all()


@pytest.mark.parametrize("file", [file for _, file, _ in REAL])
def test_a_real_log_gets_a_proposal_that_reads_it(logs: Path, file: str) -> None:
    text = propose([logs / file])
    assert text is not None
    change = "\n  same_time: first\n  time:"
    streams = read(path=logs / file, params=params_of(text.replace("\n  time:", change)))
    assert {"imu", "gnss", "mag"} & set(streams)


def test_the_dresden_car_feels_gravity_upwards_and_turns_left_positive(logs: Path) -> None:
    params = params_of((MAPPINGS / "dresden_car.yaml").read_text(encoding="utf-8"))
    streams = read(path=logs / "balzer82_dresden" / "2014-03-26-000-Data.csv", params=params)
    assert warnings_of(streams["metrics"]) == []
    # The README: az about -9.6 as logged, so about +9.6 as specific force.
    assert np.median(matrix(streams["imu"], "accel")[:, 2]) == pytest.approx(9.6, abs=0.1)
    first = datetime(2014, 3, 26, 12, 38, 25, tzinfo=UTC).timestamp()
    assert time_ns(streams["imu"])[0] == int(first) * NS + 119_146_000


def test_mappings_are_all_used() -> None:
    assert {path.stem for path in MAPPINGS.iterdir()} == {mapping for mapping, _, _ in REAL}
    assert all(load_file(path).plain() for path in MAPPINGS.iterdir())
