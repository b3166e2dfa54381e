"""Recordings of phones: Sensor Logger, phyphox, GnssLogger; made ones whose truth is known, and real samples."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import phone_logs
import pytest

import recon
import recon_readers._phone_files
from recon.errors import DataError, ReadFailed
from recon.recording import Recording
from recon.rows import warnings_of
from recon.tables import matrix, meta, schema_of, time_ns, vector

LOG = phone_logs.logged()
"""Accelerometer at the times t, gyroscope 3 ms later: for each of 400 rows but the last."""


def save(folder: Path, files: Mapping[str, str]) -> Path:
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder


def read(path: Path, **params: object) -> Recording:
    together = {f"reader.{name}.together": True for name in ("sensor_logger", "phyphox", "gnsslogger")}
    return recon.read(path, **{**together, **params})


def assert_same_sensors(found: Recording, *, position: float = 1e-9, pauses: int = 0) -> None:
    """Nine digits were written; the gyroscope is read between its rows, but not across a pause."""
    np.testing.assert_allclose(matrix(found["imu"], "accel"), LOG.accel, atol=1e-8)
    gyro = matrix(found["imu"], "gyro", gaps=True)
    known = np.isfinite(gyro[:, 0])
    assert known.sum() == len(LOG.t_ns) - 1 - pauses  # the first row lies before the gyroscope's first
    since = (LOG.t_ns - LOG.t_ns[0]) * 1e-9
    between = np.column_stack([np.interp(since, since + 0.003, axis) for axis in LOG.gyro.T])
    np.testing.assert_allclose(gyro[known], between[known], atol=1e-7)
    np.testing.assert_allclose(matrix(found["mag"], "mag"), LOG.mag, atol=1e-14)
    for name in ("lat", "lon"):
        np.testing.assert_allclose(vector(found["gnss"], name), LOG.fix[name], atol=position)
    for name in ("height", "speed", "course"):
        np.testing.assert_allclose(vector(found["gnss"], name), LOG.fix[name], atol=1e-5)
    # 4.545 m hold 68 % of the fixes, 1.515 sigma of each axis
    np.testing.assert_allclose(vector(found["gnss"], "pos_std_e"), 3.0, atol=1e-6)
    np.testing.assert_allclose(vector(found["gnss"], "pos_std_u"), 3.0, atol=1e-6)


# --- Sensor Logger ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("platform", ["android", "ios"])
@pytest.mark.parametrize("total", [True, False])
def test_sensor_logger_gives_specific_force_of_either_phone(tmp_path: Path, platform: str, total: bool) -> None:
    found = read(save(tmp_path, phone_logs.sensor_logger(LOG, platform, total=total)))
    assert_same_sensors(found)
    assert np.array_equal(time_ns(found["imu"]), LOG.t_ns)
    assert schema_of(found["imu"])["accel_x"].quantity == "specific_force"
    assert meta(found["gnss"])["height_datum"] == "ellipsoid"
    np.testing.assert_allclose(vector(found["baro"], "pressure"), 100_725.0)


def test_sensor_logger_reads_its_zip_with_or_without_a_folder_in_it(tmp_path: Path) -> None:
    files = phone_logs.sensor_logger(LOG)
    for name, folder in (("flat.zip", ""), ("deep.zip", "2026-06-08_14-54-08")):
        path = tmp_path / name
        path.write_bytes(phone_logs.zipped(files, folder))
        assert_same_sensors(read(path))


def test_an_uncalibrated_accelerometer_of_an_iphone_counts_g_downwards(tmp_path: Path) -> None:
    files = phone_logs.sensor_logger(LOG, "ios")
    for name in ("Accelerometer.csv", "Gravity.csv", "TotalAcceleration.csv"):
        del files[name]
    files["AccelerometerUncalibrated.csv"] = phone_logs.uncalibrated_ios(LOG)
    found = read(save(tmp_path, files))
    np.testing.assert_allclose(matrix(found["imu"], "accel"), LOG.accel, atol=1e-7)


def test_standardised_iphones_have_the_signs_of_android(tmp_path: Path) -> None:
    files = phone_logs.sensor_logger(LOG, "android")
    files["Metadata.csv"] = "version,platform,standardisation\n3,ios,true\n"
    found = read(save(tmp_path, files))
    np.testing.assert_allclose(matrix(found["imu"], "accel"), LOG.accel, atol=1e-8)


def test_without_its_metadata_the_accelerometer_is_left_out_and_the_parameter_named(tmp_path: Path) -> None:
    files = phone_logs.sensor_logger(LOG)
    del files["Metadata.csv"]
    found = read(save(tmp_path, files))
    assert "accel_x" not in found["imu"].column_names
    assert any("reader.sensor_logger.platform" in note for note in warnings_of(found["metrics"]))
    assert "Mag" not in found
    again = read(tmp_path, **{"reader.sensor_logger.platform": "android"})
    np.testing.assert_allclose(matrix(again["imu"], "accel"), LOG.accel, atol=1e-8)


def test_acceleration_without_gravity_is_called_so(tmp_path: Path) -> None:
    files = phone_logs.sensor_logger(LOG)
    del files["Gravity.csv"], files["TotalAcceleration.csv"]
    found = read(save(tmp_path, files))
    assert schema_of(found["imu"])["accel_x"].quantity == "acceleration"
    assert any("without gravity" in note for note in warnings_of(found["metrics"]))


def test_negative_speed_and_accuracy_are_missing(tmp_path: Path) -> None:
    names = "time,seconds_elapsed,bearingAccuracy,speedAccuracy,verticalAccuracy,horizontalAccuracy"
    path = tmp_path / "Location.csv"
    path.write_text(
        f"{names},speed,bearing,altitude,longitude,latitude\n"
        "1700000000000000000,0,-1,-1,-1,5,-1,-1,100,11.3,44.5\n"
        "1700000001000000000,1,4,0.5,3,5,7.5,90,100,11.3,44.5\n",
        encoding="utf-8",
    )
    gnss = read(path)["gnss"]
    for name in ("speed", "course", "height"):
        values = vector(gnss, name, gaps=True)
        assert np.isnan(values[0])
        assert np.isfinite(values[1])


def test_rows_stay_as_they_were_logged_unless_asked_for(tmp_path: Path) -> None:
    save(tmp_path, phone_logs.sensor_logger(LOG))
    apart = {"reader.sensor_logger.together": False}
    imu = read(tmp_path, **apart)["imu"]
    assert imu.num_rows == 2 * len(LOG.t_ns)
    assert imu["accel_x"].null_count == imu["gyro_x"].null_count == len(LOG.t_ns)
    assert any("'together'" in note for note in warnings_of(read(tmp_path, **apart)["metrics"]))


# --- phyphox ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ",")])
@pytest.mark.parametrize("named", [True, False])
def test_phyphox_is_read_with_any_separator_and_decimal_mark(
    tmp_path: Path, separator: str, decimal: str, named: bool
) -> None:
    found = read(save(tmp_path, phone_logs.phyphox(LOG, separator, decimal, named=named)))
    assert_same_sensors(found, position=1e-8, pauses=1)
    # the clock was stopped for 100 s halfway; system times were written as doubles of seconds, to 0.24 us
    t_ns = time_ns(found["imu"])
    late = np.where(np.arange(len(t_ns)) > 0.55 * len(t_ns), 100_000_000_000, 0)[[0, -1]]
    assert np.abs((t_ns - LOG.t_ns)[[0, -1]] - late).max() < 1000


def test_phyphox_reads_its_zip(tmp_path: Path) -> None:
    path = tmp_path / "drive.zip"
    path.write_bytes(phone_logs.zipped(phone_logs.phyphox(LOG)))
    assert meta(read(path)["imu"])["format"] == "phyphox"


def test_a_table_beside_its_meta_folder_knows_the_date(tmp_path: Path) -> None:
    save(tmp_path, phone_logs.phyphox(LOG))
    assert meta(read(tmp_path / "Gyroscope.csv")["imu"])["clock"] == "absolute"
    (tmp_path / "meta" / "time.csv").unlink()
    assert meta(read(tmp_path / "Gyroscope.csv")["imu"])["clock"] == "relative"


# --- GnssLogger -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("corrected", [True, False])
def test_gnsslogger_gives_fixes_and_sensors(tmp_path: Path, corrected: bool) -> None:
    path = tmp_path / "log.txt"
    path.write_text(phone_logs.gnsslogger(LOG, corrected=corrected), encoding="utf-8")
    found = read(path)
    assert_same_sensors(found)
    # utcTimeMillis of the first row is cut to whole ms
    assert np.abs(time_ns(found["imu"]) - LOG.t_ns).max() <= 1_000_000
    assert np.array_equal(np.diff(time_ns(found["imu"])), np.diff(LOG.t_ns))


def test_gnsslogger_takes_the_fixes_of_one_provider(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    path.write_text(phone_logs.gnsslogger(LOG), encoding="utf-8")
    network = read(path, **{"reader.gnsslogger.provider": "NLP"})["gnss"]
    np.testing.assert_allclose(vector(network, "lat"), LOG.fix["lat"] + 0.01, atol=1e-6)


def test_raw_observations_alone_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    path.write_text("# Raw,utcTimeMillis,TimeNanos\n# Fix,Provider,Latitude\nRaw,1,2\n", encoding="utf-8")
    with pytest.raises(ReadFailed, match="neither fixes nor sensors"):
        read(path)


# --- real samples -----------------------------------------------------------------------------------------------------


def test_samples_of_sensor_logger(logs: Path) -> None:
    folder = logs / "formats" / "sensor_logger"
    place = read(folder)["gnss"]
    assert place.num_rows == 599
    assert time_ns(place)[0] == 1691185677581023000
    merged = read(folder / "2025-06-14_21-17-02.csv")
    size = np.linalg.norm(matrix(merged["imu"], "accel"), axis=1)
    assert 9.5 < np.median(size) < 10.2
    assert merged["gnss"].num_rows == 145


def test_samples_of_phyphox(logs: Path) -> None:
    folder = logs / "formats" / "phyphox"
    one = read(folder / "data" / "Acceleration without g 2024-01-20 17-52-51")["imu"]
    assert one.num_rows == 3273
    # started at 1.705765879357105E9 s, the first row 2.784654166E-2 s later
    assert abs(int(time_ns(one)[0]) - 1705765879384951542) < 300
    # downloaded into a folder of its own
    assert time_ns(read(folder / "data")["imu"])[0] == time_ns(one)[0]
    other = read(folder / "omar_jumping_hand_data.csv")["imu"]
    assert schema_of(other)["accel_z"].quantity == "acceleration"


@pytest.mark.parametrize(
    ("sample", "missing"),
    [
        ("phyphox/data", ["'gnss'", "imu.gyro_x", "imu.accel_x, accel_y, accel_z as specific_force"]),
        ("phyphox/omar_jumping_hand_data.csv", ["'gnss'", "imu.gyro_x"]),
        ("sensor_logger/Location_head600.csv", ["'imu'"]),
        ("gnsslogger/all_sensors.txt", ["'gnss'"]),
        ("gnsslogger/pixel6.txt", ["accel and gyro within 0.5 s at none of 20 times"]),
    ],
)
def test_a_run_on_a_sample_names_the_sensors_that_are_missing(logs: Path, sample: str, missing: list[str]) -> None:
    with pytest.raises(DataError) as caught:
        recon.run("smartphone", logs / "formats" / sample)
    for one in missing:
        assert one in str(caught.value)


def test_samples_of_gnsslogger(logs: Path) -> None:
    folder = logs / "formats" / "gnsslogger"
    found = read(folder / "pixel6.txt")
    assert found["gnss"].num_rows == 94
    size = np.linalg.norm(matrix(read(folder / "all_sensors.txt")["imu"], "accel"), axis=1)
    assert size == pytest.approx(9.898, abs=1e-3)


@pytest.mark.parametrize(
    ("sample", "lacks"),
    [
        ("sensor_logger", "imu"),
        ("phyphox/data/Acceleration without g 2024-01-20 17-52-51", "specific_force"),
        ("phyphox/omar_jumping_hand_data.csv", "specific_force"),
    ],
)
def test_a_run_names_what_the_sample_lacks(logs: Path, tmp_path: Path, sample: str, lacks: str) -> None:
    with pytest.raises(DataError, match=lacks):
        recon.run("best_accuracy", logs / "formats" / sample, out=tmp_path / "run")


# --- zips that mean harm ----------------------------------------------------------------------------------------------


def test_a_zip_that_would_unpack_to_more_than_a_gigabyte_is_refused_unread(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "bomb.zip"
    path.write_bytes(phone_logs.zipped(phone_logs.sensor_logger(LOG)))
    monkeypatch.setattr(recon_readers._phone_files, "LARGEST_UNPACKED", 5000)
    with pytest.raises(ReadFailed, match="would unpack to"):
        recon.read(path)


def test_paths_that_lead_out_of_a_zip_lead_nowhere(tmp_path: Path) -> None:
    files = {f"../{name}": text for name, text in phone_logs.sensor_logger(LOG).items()}
    path = tmp_path / "in" / "drive.zip"
    path.parent.mkdir()
    path.write_bytes(phone_logs.zipped(files))
    assert recon.read(path)["imu"].num_rows
    assert [file.name for file in tmp_path.iterdir()] == ["in"]


def test_a_table_of_phyphox_deep_in_a_folder_makes_it_no_recording(tmp_path: Path) -> None:
    (tmp_path / "logs" / "others").mkdir(parents=True)
    (tmp_path / "logs" / "notes.txt").write_text("hello")
    for name, text in phone_logs.phyphox(LOG).items():
        if "/" not in name:
            (tmp_path / "logs" / "others" / name).write_text(text, encoding="utf-8")
    with pytest.raises(ReadFailed, match="this is a folder"):
        recon.read(tmp_path / "logs")


def test_the_metadata_of_sensor_logger_alone_say_what_to_name(tmp_path: Path) -> None:
    path = tmp_path / "Metadata.csv"
    path.write_text("version,device name,recording epoch time,platform\n3,Pixel,1691185678576,android\n")
    with pytest.raises(ReadFailed, match=r"it tells of the phone .* and holds no measurement") as found:
        recon.read(path)
    assert found.value.hint == "name the folder that it is in, or one of the tables beside it"


def test_a_table_of_places_without_latitudes_is_refused(tmp_path: Path) -> None:
    for name, text in phone_logs.sensor_logger(phone_logs.logged()).items():
        (tmp_path / name).write_text(text.replace("latitude", "breadth"))
    with pytest.raises(ReadFailed, match=r"Location.csv:1: it has no column 'latitude'"):
        recon.read(tmp_path)


def test_sensors_of_gnsslogger_whose_columns_no_comment_names_are_told(tmp_path: Path) -> None:
    text = phone_logs.gnsslogger(phone_logs.logged())
    lines = [line for line in text.splitlines(keepends=True) if not line.startswith(("# Accel", "# UncalAccel"))]
    path = tmp_path / "gnss_log.txt"
    path.write_text("".join(lines))
    recording = recon.read(path)
    assert "accel_x" not in recording["imu"].column_names
    told = warnings_of(recording["metrics"])
    assert "no comment names the columns of Accel: its lines are left out" in told
