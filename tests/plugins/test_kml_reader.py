"""reader.kml: times and places of gx:Track and of placemarks with a time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fuzz import log_files

import recon
import recon_readers.kml
from recon import Streams
from recon.errors import ReadFailed
from recon.parameters import NoParams
from recon.rows import warnings_of
from recon.tables import time_ns, vector


def read(folder: Path, text: bytes | str) -> Streams:
    path = folder / "track.kml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return recon_readers.kml.read(path, NoParams())


def test_a_drive_comes_back_as_it_was_written(tmp_path: Path) -> None:
    gnss, truth = read(tmp_path, log_files.kml())["gnss"], log_files.gnss()
    np.testing.assert_array_equal(time_ns(gnss), time_ns(truth))
    for name, half_digit in (("lat", 0.51e-9), ("lon", 0.51e-9), ("height", 0.51e-3)):
        np.testing.assert_allclose(vector(gnss, name), vector(truth, name), rtol=0, atol=half_digit)


def test_what_our_exporter_writes_is_read(tmp_path: Path) -> None:
    kept = {"gnss": log_files.gnss()}
    recon.run(recon.Pipeline.of("keep"), recon.Recording(kept), tmp_path / "run", exports=["kml"])
    gnss = recon.read(tmp_path / "run" / "exports" / "kml" / "track.kml")["gnss"]
    np.testing.assert_array_equal(time_ns(gnss), time_ns(kept["gnss"]))
    np.testing.assert_allclose(vector(gnss, "lat"), vector(kept["gnss"], "lat"), rtol=0, atol=1e-8)


def test_placemarks_with_a_time_are_points(tmp_path: Path) -> None:
    places = "".join(
        f"<Placemark><TimeStamp><when>2025-10-08T10:00:0{n}Z</when></TimeStamp>"
        f"<Point><coordinates>11.3,44.5{n},0</coordinates></Point></Placemark>"
        for n in range(3)
    )
    gnss = read(tmp_path, f"<kml>{places}</kml>")["gnss"]
    assert vector(gnss, "lat").tolist() == [44.50, 44.51, 44.52]
    assert "height" not in gnss.column_names  # on the ground, where the altitude means nothing


@pytest.mark.parametrize("view", ["LookAt", "Camera"])
def test_the_view_of_a_placemark_tells_neither_its_time_nor_its_height(tmp_path: Path, view: str) -> None:
    seen = "<gx:TimeStamp><when>2020-01-01T00:00:00Z</when></gx:TimeStamp><altitudeMode>absolute</altitudeMode>"
    places = "".join(
        f"<Placemark><{view}>{seen}</{view}><TimeStamp><when>2025-10-08T10:00:0{n}Z</when></TimeStamp>"
        f"<Point><coordinates>11.3,44.5{n},0</coordinates></Point></Placemark>"
        for n in range(3)
    )
    gnss = read(tmp_path, f'<kml xmlns:gx="x">{places}</kml>')["gnss"]
    assert np.diff(time_ns(gnss)).tolist() == [10**9, 10**9]
    assert str(gnss["time"][0]).startswith("2025-10-08 10:00:00")
    assert "height" not in gnss.column_names


def test_heights_of_several_tracks_count_as_what_is_around_them_says(tmp_path: Path) -> None:
    """As apps write a recording with pauses; the last track is its own."""
    tracks = "".join(
        f"<gx:Track>{mode}<when>2020-01-01T00:00:0{second}Z</when><gx:coord>11 44 5{second}</gx:coord></gx:Track>"
        for second, mode in enumerate(("", "", "<altitudeMode>clampToGround</altitudeMode>", ""))
    )
    together = f"<gx:MultiTrack><altitudeMode>absolute</altitudeMode><gx:interpolate>1</gx:interpolate>{tracks}"
    alone = "<gx:Track><when>2020-01-01T00:00:09Z</when><gx:coord>11 44 59</gx:coord></gx:Track>"
    places = f"<Placemark>{together}</gx:MultiTrack></Placemark><Placemark>{alone}</Placemark>"
    streams = read(tmp_path, f'<kml xmlns:gx="http://www.google.com/kml/ext/2.2">{places}</kml>')
    heights = vector(streams["gnss"], "height", gaps=True)
    np.testing.assert_array_equal(heights, [50.0, 51.0, np.nan, 53.0, np.nan])
    (row,) = [row for row in streams["metrics"].to_pylist() if row["name"] == "heights_left_out"]
    assert (row["value"], row["note"].partition(":")[0]) == (2.0, "of 5 points")


def test_times_and_places_that_alternate_are_paired(tmp_path: Path) -> None:
    pairs = "".join(f"<when>2025-10-08T10:00:0{n}Z</when><gx:coord>11 4{n} 0</gx:coord>" for n in range(4))
    gnss = read(tmp_path, f'<kml xmlns:gx="x"><Placemark><gx:Track>{pairs}</gx:Track></Placemark></kml>')["gnss"]
    assert vector(gnss, "lat").tolist() == [40.0, 41.0, 42.0, 43.0]


def test_a_file_that_was_cut_is_read_as_far_as_it_is_whole(tmp_path: Path) -> None:
    text = log_files.kml()
    streams = read(tmp_path, text[: text.index(b"<gx:coord>") + 500])
    assert 5 < streams["gnss"].num_rows < log_files.GNSS_ROWS
    assert "what comes behind is not read" in warnings_of(streams["metrics"])[0]


def test_a_line_without_times_is_no_recording(tmp_path: Path) -> None:
    line = "<kml><Placemark><LineString><coordinates>1,2,3 4,5,6</coordinates></LineString></Placemark></kml>"
    with pytest.raises(ReadFailed, match="no point in it has a time, 1 lines are drawn") as caught:
        read(tmp_path, line)
    assert "gx:Track" in caught.value.hint


@pytest.mark.parametrize(
    ("coord", "told"),
    [
        ("11.05 44.49 53.8", [11.05, 44.49]),
        ("11,05 44,49 53,8", [11.05, 44.49]),
        ("-11,05 -44,49 0", [-11.05, -44.49]),
        ("11.05,44.49,53.8", [11.05, 44.49]),
        ("11,44,53", [11.0, 44.0]),
    ],
)
def test_places_are_parted_by_blanks_or_commas_and_commas_may_be_those_of_decimals(
    tmp_path: Path, coord: str, told: list[float]
) -> None:
    track = f"<when>2024-05-01T08:00:00Z</when><when>2024-05-01T08:00:01Z</when>{f'<coord>{coord}</coord>' * 2}"
    path = tmp_path / "a.kml"
    path.write_text(f"<kml><Placemark><Track>{track}</Track></Placemark></kml>")
    gnss = recon.read(path)["gnss"]
    assert [vector(gnss, name)[0] for name in ("lon", "lat")] == told


def test_places_that_are_no_numbers_are_counted(tmp_path: Path) -> None:
    whens = "".join(f"<when>2024-05-01T08:00:0{second}Z</when>" for second in range(3))
    coords = "".join(f"<coord>{text}</coord>" for text in ("11.05 44.49 1", "here there 1", "1 1,0 5,4 4,4 9"))
    path = tmp_path / "a.kml"
    path.write_text(f"<kml><Placemark><Track>{whens}{coords}</Track></Placemark></kml>")
    recording = recon.read(path)
    assert recording["gnss"].num_rows == 1
    assert warnings_of(recording["metrics"]) == ["2 texts of points are no numbers, and are left out"]
