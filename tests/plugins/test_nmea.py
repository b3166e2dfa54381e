"""reader.nmea: sentences become rows of gnss in UTC; those that are damaged are left out and counted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fuzz import log_files

import recon
import recon_readers.nmea
from recon import Streams
from recon.errors import ReadFailed
from recon.rows import warnings_of
from recon.tables import matrix, meta, time_ns, vector
from recon_readers.nmea import NmeaParams


def read(folder: Path, *lines: str | bytes, rollovers: int = 0) -> Streams:
    path = folder / "log.nmea"
    path.write_bytes(b"\r\n".join(line if isinstance(line, bytes) else line.encode() for line in lines))
    return recon_readers.nmea.read(path, NmeaParams(rollovers=rollovers))


def told(streams: Streams, name: str) -> float:
    (row,) = [row for row in streams["metrics"].to_pylist() if row["name"] == name]
    return float(row["value"])


def rmc(clock: str, date: str = "081025", place: str = "4430.0,N,01120.0,E", status: str = "A") -> str:
    return log_files.sentence(f"GPRMC,{clock},{status},{place},10.0,90.0,{date},,,A")


def gga(clock: str, quality: int = 1) -> str:
    return log_files.sentence(f"GPGGA,{clock},4430.0,N,01120.0,E,{quality},08,1.0,45.5,M,44.0,M,,")


def test_a_drive_comes_back_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "drive.nmea"
    path.write_bytes(log_files.nmea())
    gnss, truth = recon.read(path)["gnss"], log_files.gnss()
    np.testing.assert_array_equal(time_ns(gnss), time_ns(truth))
    np.testing.assert_allclose(
        vector(gnss, "lat"), vector(truth, "lat"), rtol=0, atol=0.51e-6 / 60
    )  # 6 decimals of minutes
    np.testing.assert_allclose(vector(gnss, "lon"), vector(truth, "lon"), rtol=0, atol=0.51e-6 / 60)
    np.testing.assert_allclose(vector(gnss, "height"), vector(truth, "height"), rtol=0, atol=0.51e-3)
    np.testing.assert_allclose(vector(gnss, "speed"), vector(truth, "speed"), rtol=1e-8, atol=0.51e-4 * 0.5144445)
    np.testing.assert_allclose(vector(gnss, "course"), vector(truth, "course"), rtol=0, atol=np.radians(0.51e-3))
    assert matrix(gnss, "pos_std")[0].tolist() == [0.012, 0.021, 0.034]  # GST: latitude, longitude, height
    facts = meta(gnss)
    assert (facts["time_scale"], facts["clock"]) == ("UTC", "absolute")
    assert (facts["height_datum"], facts["heading_kind"]) == ("mean_sea_level", "course_true")


def test_wrong_and_missing_checksums_are_left_out_and_counted(tmp_path: Path) -> None:
    broken = rmc("100001.00").replace("4430", "4431")
    bare = rmc("100002.00").partition("*")[0]
    streams = read(tmp_path, rmc("100000.00"), broken, bare, rmc("100003.00"))
    assert streams["gnss"].num_rows == 2
    assert told(streams, "bad_checksums") == 2
    assert any("2 sentences with a wrong checksum" in text for text in warnings_of(streams["metrics"]))


def test_time_goes_on_over_midnight_before_the_date_changes(tmp_path: Path) -> None:
    streams = read(tmp_path, rmc("235959.50"), gga("235959.75"), gga("000000.00"), rmc("000000.25", "091025"))
    steps = np.diff(time_ns(streams["gnss"]))
    assert steps.tolist() == [250_000_000] * 3


def test_sentences_before_the_first_date_get_it(tmp_path: Path) -> None:
    streams = read(tmp_path, gga("235959.00"), gga("000000.00"), rmc("000001.00", "091025"))
    first = np.datetime64("2025-10-08T23:59:59", "ns").astype(np.int64)
    assert time_ns(streams["gnss"]).tolist() == [first, first + 10**9, first + 2 * 10**9]


def test_a_clock_that_is_not_set_yet_dates_nothing(tmp_path: Path) -> None:
    """As MTK3339 writes before its first fix; GGA comes more often than RMC."""
    unset = []
    for clock, date in (("235959.799", "050180"), ("000000.799", "060180")):
        unset += [log_files.sentence(f"GPRMC,{clock},V,,,,,0.00,0.00,{date},,,N"), NO_SPEED]
        unset.append(log_files.sentence(f"GPGGA,{clock},,,,,0,0,,,M,,M,,"))
    streams = read(tmp_path, *unset, gga("100000.00"), gga("100000.50"), rmc("100001.00"), gga("100001.50"))
    first = np.datetime64("2025-10-08T10:00:00", "ns").astype(np.int64)
    assert time_ns(streams["gnss"]).tolist() == (first + 500_000_000 * np.arange(4)).tolist()
    assert warnings_of(streams["metrics"]) == []


NO_SPEED = "$GPVTG,0.00,T,,M,0.00,N,0.00,K,N*32"


def test_a_speed_without_a_fix_is_none(tmp_path: Path) -> None:
    zero = rmc("100001.00", place=",,,", status="V")
    speed = vector(read(tmp_path, rmc("100000.00"), zero, NO_SPEED, rmc("100002.00"))["gnss"], "speed", gaps=True)
    assert speed.tolist() == [pytest.approx(10.0 * 1852 / 3600)] * 2


def test_sentences_of_one_system_beside_the_combined_one_take_no_fix_away(tmp_path: Path) -> None:
    """The example of Trimble's description of GNS: those of GPS and GLONASS tell the number of their satellites."""
    lines = (
        "$GNGNS,014035.00,4332.69262,S,17235.48549,E,RR,13,0.9,25.63,11.24,,*70",
        "$GPGNS,014035.00,,,,,,8,,,,1.0,23*76",
        "$GLGNS,014035.00,,,,,,5,,,,1.0,23*67",
        log_files.sentence("GNGSA,A,3,01,02,03,04,05,06,07,08,,,,,1.5,0.9,1.2"),
    )
    row = read(tmp_path, *lines, gga("014036.00"))["gnss"].to_pylist()[0]
    assert (row["fix"], row["satellites"], row["height"]) == (3, 13, 25.63)


@pytest.mark.parametrize("order", ["VTG GGA ZDA", "GGA VTG ZDA", "GGA ZDA VTG"])
def test_a_speed_belongs_to_its_time_wherever_its_sentence_stands(tmp_path: Path, order: str) -> None:
    """u-blox writes VTG before GGA; nothing but the places tells it from one that writes VTG last."""
    rng, seconds = np.random.default_rng(5), np.arange(60)
    speed = 10.0 + 6.0 * np.sin(seconds / 5.0)  # m/s, to the north
    north = 10.0 * seconds - 30.0 * np.cos(seconds / 5.0) + rng.normal(0.0, 0.3, 60)
    minutes, lines = 30.0 + north / 1852.0, []
    for at in range(60):
        made = {
            "GGA": f"GNGGA,1000{at:02d}.00,44{minutes[at]:09.6f},N,01120.0,E,1,08,1.0,45.5,M,44.0,M,,",
            "VTG": f"GNVTG,0.0,T,,M,{speed[at] * 3600 / 1852:.4f},N,,K,A",
            "ZDA": f"GNZDA,1000{at:02d}.00,08,10,2025,00,00",
        }
        lines += [log_files.sentence(made[kind]) for kind in order.split()]
    streams = read(tmp_path, *lines)
    told_speed = vector(streams["gnss"], "speed", gaps=True)
    first = 1 if order.startswith("VTG") else 0
    np.testing.assert_allclose(told_speed[first:], speed[first:], rtol=0, atol=1e-4)
    assert np.isnan(told_speed[:first]).all()


def test_a_rolled_over_week_is_suspected_and_put_right(tmp_path: Path) -> None:
    early = rmc("100000.00", "220206")  # 2025-10-08 less 1024 weeks
    assert time_ns(read(tmp_path, early, rollovers=1)["gnss"])[0] == np.datetime64("2025-10-08T10:00", "ns").astype(int)
    assert warnings_of(read(tmp_path, rmc("100000.00", "220299"))["metrics"]) == [
        "the receiver says 1999-02-22: if its week number has rolled over, set reader.nmea.rollovers to 1"
    ]


def test_without_a_date_times_count_from_midnight_and_it_is_said(tmp_path: Path) -> None:
    streams = read(tmp_path, gga("000001.5"))
    assert time_ns(streams["gnss"]).tolist() == [1_500_000_000]
    assert meta(streams["gnss"])["clock"] == "relative"
    assert "no sentence tells the date" in warnings_of(streams["metrics"])[0]


def test_zda_tells_the_date_too(tmp_path: Path) -> None:
    zda = log_files.sentence("GPZDA,100000.00,08,10,2025,00,00")
    assert time_ns(read(tmp_path, gga("100000.00"), zda)["gnss"])[0] == np.datetime64("2025-10-08T10:00", "ns").astype(
        int
    )


def test_what_the_receiver_calls_invalid_is_none(tmp_path: Path) -> None:
    streams = read(tmp_path, rmc("100000.00", status="V"), rmc("100001.00"), gga("100002.00", quality=0))
    assert streams["gnss"].num_rows == 1
    assert told(streams, "rows_without_value") == 2
    with pytest.raises(ReadFailed, match="none of its sentences holds a position: 1 RMC"):
        read(tmp_path, rmc("100000.00", status="V"))


def test_south_and_west_are_negative(tmp_path: Path) -> None:
    gnss = read(tmp_path, rmc("100000.00", place="3330.6,S,07040.2,W"))["gnss"]
    assert vector(gnss, "lat")[0] == pytest.approx(-33.51, abs=1e-12)
    assert vector(gnss, "lon")[0] == pytest.approx(-70.67, abs=1e-12)


def test_stamps_of_a_logger_commas_behind_and_binary_messages_between_do_no_harm(tmp_path: Path) -> None:
    lines = [b"NMEA," + rmc("100000.00").encode() + b",1699400577566", rmc("100001.00").encode() + b",,,,"]
    streams = read(tmp_path, *lines, b"\xb5\x62\x01$\x00\xff" + rmc("100002.00").encode())
    assert streams["gnss"].num_rows == 3


def test_blocks_give_what_the_whole_gives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "drive.nmea"
    path.write_bytes(log_files.nmea())
    whole = recon_readers.nmea.read(path, NmeaParams())
    for block in (997, 300):
        monkeypatch.setattr("recon_readers._nmea_sentences.BLOCK", block)
        parts = recon_readers.nmea.read(path, NmeaParams())
        assert parts["gnss"].equals(whole["gnss"])
        assert told(parts, "sentences_used") == told(whole, "sentences_used")


@pytest.mark.parametrize(
    ("file", "rows", "place"),
    [
        ("GPS-raw-data.txt", 419, (37.23, -80.42)),
        ("pixel6.nmea", 48, (37.43, -122.17)),
        ("data.log", 1, (-19.48, 24.18)),
    ],
)
def test_real_logs_agree_with_pynmeagps(logs: Path, file: str, rows: int, place: tuple[float, float]) -> None:
    pynmeagps = pytest.importorskip("pynmeagps")
    path = logs / "formats" / "nmea" / file
    gnss = recon.read(path)["gnss"]
    assert gnss.num_rows == rows
    assert (vector(gnss, "lat")[0], vector(gnss, "lon")[0]) == pytest.approx(place, abs=0.01)
    texts = [part for part in path.read_bytes().replace(b"NMEA,", b"").split() if b"GGA" in part and b"*" in part]
    parsed = [pynmeagps.NMEAReader.parse(text[: text.index(b"*") + 3] + b"\r\n") for text in texts]
    np.testing.assert_allclose(
        vector(gnss, "lat"), [part.lat for part in parsed], rtol=0, atol=1e-9
    )  # it rounds to 1e-10
    np.testing.assert_allclose(vector(gnss, "lon"), [part.lon for part in parsed], rtol=0, atol=1e-9)
    np.testing.assert_allclose(vector(gnss, "height"), [part.alt for part in parsed], rtol=0, atol=1e-9)


def test_a_real_log_without_a_fix_says_so(logs: Path) -> None:
    path = logs / "formats" / "ubx" / "2023-4-17_82912_serial-COM3.ubx"
    with pytest.raises(ReadFailed, match="none of its sentences holds a position: 90 RMC, 81 GGA") as caught:
        recon.read(path)
    assert "had the receiver a fix" in caught.value.hint


def test_sentences_in_a_column_of_a_table_leave_it_to_who_knows_its_columns(tmp_path: Path) -> None:
    """Logs of ROS topics keep the sentence beside what was read from it."""
    path = tmp_path / "gps.csv"
    sentence = "$GPGGA,180907.000,4220.2340,N,07105.3704,W,1,09,1.2,16.6,M,-33.8,M,,0000*55"
    path.write_text(f'stamp,latitude,raw\n1711303747.2,42.33,"{sentence}"\n', encoding="utf-8")
    assert 0.0 < recon_readers.nmea.sniff(path, path.read_bytes()).confidence < 0.5
