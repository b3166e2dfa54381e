"""reader.gpx: points of tracks in UTC, as far as the file is whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fuzz import log_files

import recon
import recon_readers.gpx
from recon import Streams
from recon.errors import ReadFailed
from recon.rows import warnings_of
from recon.tables import meta, time_ns, vector
from recon_readers.gpx import GpxParams


def read(folder: Path, text: bytes | str, **params: object) -> Streams:
    path = folder / "track.gpx"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return recon_readers.gpx.read(path, GpxParams(**params))


def track(*points: str) -> str:
    return f'<gpx xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>{"".join(points)}</trkseg></trk></gpx>'


def point(second: int, inside: str = "", lat: str = "44.5") -> str:
    return f'<trkpt lat="{lat}" lon="11.3"><time>2025-10-08T10:00:{second:02d}Z</time>{inside}</trkpt>'


def test_a_drive_comes_back_as_it_was_written(tmp_path: Path) -> None:
    gnss, truth = read(tmp_path, log_files.gpx())["gnss"], log_files.gnss()
    np.testing.assert_array_equal(time_ns(gnss), time_ns(truth))
    for name, half_digit in (("lat", 0.51e-9), ("lon", 0.51e-9), ("height", 0.51e-3), ("speed", 0.51e-4)):
        np.testing.assert_allclose(vector(gnss, name), vector(truth, name), rtol=0, atol=half_digit)
    np.testing.assert_allclose(vector(gnss, "course"), vector(truth, "course"), rtol=0, atol=np.radians(0.51e-3))
    assert set(vector(gnss, "fix")) == {3.0}


def test_what_our_exporter_writes_is_read(tmp_path: Path) -> None:
    kept = {"gnss": log_files.gnss()}
    recon.run(recon.Pipeline.of("keep"), recon.Recording(kept), tmp_path / "run", exports=["gpx"])
    gnss = recon.read(tmp_path / "run" / "exports" / "gpx" / "track.gpx")["gnss"]
    np.testing.assert_array_equal(time_ns(gnss), time_ns(kept["gnss"]))
    np.testing.assert_allclose(vector(gnss, "speed"), vector(kept["gnss"], "speed"), rtol=0, atol=1e-3)


def test_speed_and_course_of_extensions_are_read(tmp_path: Path) -> None:
    garmin = (
        '<extensions><g:TrackPointExtension xmlns:g="http://www.garmin.com/xmlschemas/TrackPointExtension/v2">'
        "<g:speed>3.5</g:speed><g:course>90</g:course></g:TrackPointExtension></extensions>"
    )
    gnss = read(tmp_path, track(point(0, garmin), point(1)))["gnss"]
    assert vector(gnss, "speed", gaps=True)[0] == 3.5
    assert vector(gnss, "course", gaps=True)[0] == pytest.approx(np.pi / 2)
    assert np.isnan(vector(gnss, "speed", gaps=True)[1])


def test_the_datum_of_elevations_is_not_guessed(tmp_path: Path) -> None:
    text = track(point(0, "<ele>45</ele>"))
    assert "height_datum" not in meta(read(tmp_path, text)["gnss"])
    assert meta(read(tmp_path, text, height_datum="mean_sea_level")["gnss"])["height_datum"] == "mean_sea_level"


def test_a_file_that_was_cut_is_read_as_far_as_it_is_whole(tmp_path: Path) -> None:
    text = log_files.gpx()
    streams = read(tmp_path, text[: text.index(b"<trkpt", len(text) // 2) + 70])
    assert 0 < streams["gnss"].num_rows < log_files.GNSS_ROWS
    assert streams["gnss"].num_rows == text[: len(text) // 2].count(b"<trkpt")
    assert "what comes behind is not read" in warnings_of(streams["metrics"])[0]


def test_points_with_damaged_numbers_or_times_are_left_out(tmp_path: Path) -> None:
    points = [point(0), point(1, lat="4x.5"), point(2).replace("10:00", "99:00"), point(3, lat="1e999"), point(4)]
    assert read(tmp_path, track(*points))["gnss"].num_rows == 2


def test_a_route_is_no_recording(tmp_path: Path) -> None:
    with pytest.raises(ReadFailed, match="its 1 points of tracks have no times") as caught:
        read(tmp_path, track('<trkpt lat="1" lon="2"></trkpt>'))
    assert "a planned route" in caught.value.hint
    with pytest.raises(ReadFailed, match="it holds no point of a track, only 1 waypoints"):
        read(tmp_path, '<gpx><wpt lat="1" lon="2"></wpt></gpx>')


def test_entities_are_refused_before_they_grow(tmp_path: Path) -> None:
    bomb = '<!DOCTYPE gpx [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;">]>' + track(point(0, "<name>&b;</name>"))
    with pytest.raises(ReadFailed, match="it declares entities"):
        read(tmp_path, bomb)


@pytest.mark.parametrize(
    ("file", "rows", "first"),
    [
        ("around-visnjan-with-car.gpx", 104, "2020-12-18T06:15:50"),
        ("Ride-WK7Y25.gpx", 798, "2025-02-16T13:17:35.284"),
        ("Polar_Walking_Kart_export.GPX", 902, "2023-09-16T12:15:37.001"),
        ("track_with_speed.gpx", 3, "2009-03-02T14:05:52"),
        ("gpx1.1_with_all_fields.gpx", 1, "2013-01-01T12:00:04"),
    ],
)
def test_real_tracks(logs: Path, file: str, rows: int, first: str) -> None:
    gnss = recon.read(logs / "formats" / "gpx" / file)["gnss"]
    assert gnss.num_rows == rows
    assert time_ns(gnss)[0] == np.datetime64(first, "ns").astype(np.int64)


def test_real_files_without_a_track_say_so(logs: Path) -> None:
    for file in ("gpx1.1_with_extensions.gpx", "gpx_with_garmin_extension.gpx"):
        with pytest.raises(ReadFailed, match="only 1 waypoints and points of routes"):
            recon.read(logs / "formats" / "gpx" / file)


def test_texts_that_are_no_numbers_are_counted(tmp_path: Path) -> None:
    points = "".join(
        f'<trkpt lat="44.5" lon="11.3"><ele>{ele}</ele><time>2024-05-01T08:00:0{second}Z</time></trkpt>'
        for second, ele in enumerate(("53.8", "53,8", "", "NaN"))
    )
    path = tmp_path / "a.gpx"
    path.write_text(f"<gpx><trk><trkseg>{points}</trkseg></trk></gpx>")
    recording = recon.read(path)
    assert recording["gnss"]["height"].null_count == 3
    assert warnings_of(recording["metrics"]) == ["1 texts of points are no numbers, and are left out"]
