"""exporter.rerun: numbers that read back, and streams brought to one anchor.

Plotted numbers, places on the map and times are doubles and integers in the file, so they read back exactly; positions
in space and quaternions are of single precision, which is within 2^-24 of each number.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from exporter_tables import SECOND, START_NS, drive, fixes, happened
from rerun.chunk import RrdReader
from rerun_files import export, moving

import recon
from recon.api import export as export_run
from recon.cli.view import _viewer
from recon.comparison import overlay
from recon.errors import NothingToExport
from recon.manifest import RunInfo
from recon.numerics.geodesy import Anchor, geodetic_to_enu
from recon.numerics.rotation import from_euler
from recon.rows import Metric, metrics
from recon.schema import FRAMES, IMU, TRAJECTORY
from recon.tables import build, matrix, replace, time_ns, vector, with_meta
from recon_exporters import rerun as module

SINGLE = 2.0**-24
TENTHS = np.arange(0, 301) / 10
ANCHOR = {"lat": 44.5, "lon": 11.3, "height": 100.0}


def chunks(path: Path, entity: str, *, static: bool = False) -> list[pa.RecordBatch]:
    found = RrdReader(str(path)).stream()
    return [c.to_record_batch() for c in found if c.entity_path == entity and c.is_static is static]


def entities(path: Path) -> set[str]:
    return {chunk.entity_path for chunk in RrdReader(str(path)).stream()}


def values(path: Path, entity: str, component: str, *, static: bool = False) -> np.ndarray:
    """All values of a component, the rows below each other."""
    column = pa.chunked_array([batch[component] for batch in chunks(path, entity, static=static)])
    return np.array(column.combine_chunks().flatten().to_pylist())


def when(path: Path, entity: str) -> np.ndarray:
    """(n,) ns since 1970."""
    column = pa.chunked_array([batch["time"] for batch in chunks(path, entity)])
    return np.asarray(column.cast(pa.int64()).combine_chunks())


def names(path: Path, plot: str) -> list[str]:
    """Of the curves of a plot."""
    found = sorted(entity for entity in entities(path) if entity.startswith(f"/plots/{plot}/"))
    kinds = ("SeriesLines:names", "SeriesPoints:names")
    batches = [batch for entity in found for batch in chunks(path, entity, static=True)]
    return [batch[kind][0].as_py()[0] for batch in batches for kind in kinds if kind in batch.schema.names]


def test_the_record_keeps_the_rules_of_its_role():
    (record,) = module.declare_exporters()
    assert record.faults() == []


def test_plotted_numbers_and_their_times_are_those_of_the_streams(tmp_path):
    table = moving()
    path = export(tmp_path, trajectory=table, gnss=fixes([0, 1, 2], speed=np.array([4.0, 5.0, 6.0])))
    assert np.array_equal(values(path, "/plots/accel_x/0", "Scalars:scalars"), vector(table, "accel_x"))
    assert np.array_equal(when(path, "/plots/accel_x/0"), time_ns(table))
    assert values(path, "/plots/speed/1", "Scalars:scalars").tolist() == [4.0, 5.0, 6.0]
    assert names(path, "speed") == ["trajectory", "gnss"]


def test_all_numbers_of_a_sensor_are_there_with_angles_in_degrees(tmp_path):
    rng = np.random.default_rng(4)
    accel, gyro = rng.normal(size=(2, 50, 3))
    table = build(IMU, time=START_NS + SECOND * np.arange(50), accel=accel, gyro=gyro)
    path = export(tmp_path, imu=table)
    assert np.array_equal(values(path, "/sensors/imu/accel", "Scalars:scalars").reshape(-1, 3), accel)
    assert np.array_equal(values(path, "/sensors/imu/gyro", "Scalars:scalars").reshape(-1, 3), np.degrees(gyro))
    assert not [entity for entity in entities(path) if entity.startswith(("/map", "/world/"))]


def test_a_crash_test_shows_the_axes_that_it_measured(tmp_path):
    accel = np.column_stack((np.arange(5.0), np.full(5, np.nan), -np.arange(5.0)))
    path = export(tmp_path, imu=build(IMU, time=START_NS + np.arange(5), accel=accel))
    assert np.array_equal(values(path, "/sensors/imu/accel", "Scalars:scalars").reshape(-1, 2), accel[:, [0, 2]])
    (style,) = chunks(path, "/sensors/imu/accel", static=True)
    assert style["SeriesLines:names"][0].as_py() == ["accel_x", "accel_z"]
    assert style["SeriesLines:colors"][0].as_py() == [0xD55E00FF, 0x56B4E9FF]


def test_rows_without_a_number_are_left_out(tmp_path):
    accel = np.ones((5, 3))
    accel[2, 0] = np.nan
    path = export(tmp_path, imu=build(IMU, time=START_NS + np.arange(5), accel=accel, gyro=np.zeros((5, 3))))
    assert (when(path, "/sensors/imu/accel") - START_NS).tolist() == [0, 1, 3, 4]


def test_places_on_the_map_are_exact(tmp_path):
    table, gnss = moving(), fixes(np.arange(30))
    path = export(tmp_path, trajectory=table, gnss=gnss)
    for name, stream in (("trajectory", table), ("gnss", gnss)):
        wanted = np.column_stack((vector(stream, "lat"), vector(stream, "lon")))
        assert np.array_equal(values(path, f"/map/{name}/now", "GeoPoints:positions"), wanted)
        assert np.array_equal(when(path, f"/map/{name}/now"), time_ns(stream))


def test_poses_are_of_single_precision_with_the_scalar_last(tmp_path):
    angles = np.random.default_rng(5).uniform(-1.5, 1.5, size=(3, 301))
    table = moving(q=from_euler(*angles))
    path = export(tmp_path, trajectory=table)
    body = "/world/trajectory/body"
    position, q = matrix(table, "pos"), matrix(table, "q")
    assert np.all(np.abs(values(path, body, "Transform3D:translation") - position) <= SINGLE * np.abs(position))
    assert np.abs(values(path, body, "Transform3D:quaternion") - q[:, [1, 2, 3, 0]]).max() <= SINGLE
    assert np.array_equal(when(path, body), time_ns(table))


def test_streams_of_different_anchors_are_brought_to_the_first(tmp_path):
    """Both tables hold the same places on the Earth; the second counts from another one."""
    other = {"lat": 44.51, "lon": 11.31, "height": 90.0}
    table = moving()
    lat, lon, height = (vector(table, name) for name in ("lat", "lon", "height"))
    first, second = (
        with_meta(replace(table, pos=geodetic_to_enu(lat, lon, height, Anchor(**anchor))), anchor=anchor, earth="wgs84")
        for anchor in (ANCHOR, other)
    )
    path = export(tmp_path, trajectory=first, reference=second, gnss=fixes([0, 1]))
    bodies = [values(path, f"/world/{name}/body", "Transform3D:translation") for name in ("trajectory", "reference")]
    # Positions below 100 m are doubles of 1e-8 m about the centre of the Earth, then rounded to single precision.
    assert np.abs(bodies[0] - bodies[1]).max() <= 2 * (100.0 * SINGLE + 1e-8)
    # The fixes lie 1 deg north; their heights count from mean sea level, so they are drawn at that of the anchor.
    wanted = geodetic_to_enu([45.5, 45.50001], [11.3, 11.30002], 100.0, Anchor(**ANCHOR))
    found = values(path, "/world/gnss", "Points3D:positions", static=True)
    assert np.all(np.abs(found - wanted) <= 2 * SINGLE * np.abs(wanted).max())


def test_a_stream_without_a_place_is_told_of_and_left_out_of_space(tmp_path):
    table = with_meta(moving(), anchor=ANCHOR)
    lost = drive(TENTHS, lat=None, lon=None, height=None)
    path = export(tmp_path, trajectory=table, reference=lost)
    assert not [entity for entity in entities(path) if entity.startswith(("/world/reference", "/map/reference"))]
    (text,) = values(path, "/about", "TextDocument:text", static=True)
    assert "not in space" in text
    assert text.rstrip().endswith("reference")


def test_no_line_is_drawn_across_a_gap(tmp_path):
    """30 s apart: with points every 0.1 s that is more than ten steps and more than 2 s."""
    t_s = np.concatenate((np.arange(0, 10, 0.1), np.arange(40, 50, 0.1)))
    path = export(tmp_path, trajectory=drive(t_s))
    for entity, component in (
        ("/world/trajectory/path", "LineStrips3D:strips"),
        ("/map/trajectory/path", "GeoLineStrings:line_strings"),
    ):
        (batch,) = chunks(path, entity, static=True)
        assert [len(strip) for strip in batch[component][0].as_py()] == [100, 100]


def test_lines_have_ten_points_a_second_and_bodies_every_row(tmp_path):
    path = export(tmp_path, trajectory=drive(np.arange(1001) / 100))
    (batch,) = chunks(path, "/world/trajectory/path", static=True)
    assert [len(strip) for strip in batch["LineStrips3D:strips"][0].as_py()] == [101]
    assert len(when(path, "/world/trajectory/body")) == 1001


def test_a_rate_thins_streams_and_leaves_events_alone(tmp_path):
    path = export(tmp_path, rate=1.0, trajectory=moving(), events=happened((0, 1), (0.2, 0.3), (5, 6)))
    assert len(when(path, "/world/trajectory/body")) == 31
    assert len(when(path, "/events_as_text")) == 3


def test_the_sensor_has_axes_of_its_own_where_its_mounting_is_known(tmp_path):
    q = from_euler(0.3, 0.2, 0.1)
    found = metrics([Metric(f"mount_q{axis}", float(part)) for axis, part in zip("wxyz", q, strict=True)])
    path = export(tmp_path, trajectory=moving(), metrics=found)
    (read,) = values(path, "/world/trajectory/body/sensor", "Transform3D:quaternion", static=True)
    assert np.abs(read - q[[1, 2, 3, 0]]).max() <= SINGLE
    (folder := tmp_path / "without").mkdir()
    assert "/world/trajectory/body/sensor" not in entities(export(folder, trajectory=moving()))


def test_events_have_lanes_and_texts(tmp_path):
    """Those from 1 to 3 and from 2 to 4 overlap; the one without a length is 1/500 of the 30 s in its lane."""
    table = happened((1, 3), (2, 4), (20, 20), note="told", value=2.5, unit="m")
    path = export(tmp_path, trajectory=moving(), events=table)
    lane = (when(path, "/events/standstill") - START_NS) / SECOND
    assert lane.tolist() == [1.0, 4.0, 20.0, 20.06]
    assert values(path, "/events/standstill", "StateChange:state").tolist() == ["standstill", ""] * 2
    texts = values(path, "/events_as_text", "TextLog:text").tolist()
    assert texts[1] == "2024-05-01T08:00:02.000Z standstill, 2.000 s long; 2.5 m; told"
    assert np.array_equal(when(path, "/events_as_text"), time_ns(table))


def test_several_runs_are_drawn_under_their_names(tmp_path):
    first, second = (with_meta(moving(), run=name) for name in ("a/thesis", "b/thesis"))
    path = export(tmp_path, trajectory=first, trajectory_2=second)
    assert names(path, "accel_x") == ["a/thesis", "b/thesis"]
    assert {r"/world/a\/thesis/body", r"/world/b\/thesis/body"} <= entities(path)


def content(path: Path) -> dict[tuple[str, bool], list[Any]]:
    """All columns of all chunks but the identifiers of rows."""
    found: dict[tuple[str, bool], list[Any]] = {}
    for chunk in RrdReader(str(path)).stream():
        batch = chunk.to_record_batch()
        columns = {name: batch[name].to_pylist() for name in batch.schema.names if not name.startswith("rerun.")}
        found.setdefault((chunk.entity_path, chunk.is_static), []).append(columns)
    return found


def test_equal_streams_give_equal_files_but_for_the_identifiers_of_rows(tmp_path):
    table = moving()
    in_chunks = pa.concat_tables([table.slice(0, 100), table.slice(100)])
    (tmp_path / "again").mkdir()
    first, again = export(tmp_path, trajectory=table), export(tmp_path / "again", trajectory=in_chunks)
    assert content(first) == content(again)
    done = subprocess.run([_viewer(), "rrd", "compare", "--unordered", first, again], check=False, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()


def test_a_file_is_dated_by_the_run_and_not_by_its_export(tmp_path):
    path = export(tmp_path, trajectory=moving())
    column = "RecordingInfo:start_time"
    told = [batch[column] for batch in chunks(path, "/__properties", static=True) if column in batch.schema.names]
    assert [batch.flatten().cast(pa.int64()).to_pylist() for batch in told] == [[START_NS]]


def test_pictures_beside_the_log_are_taken_and_no_others(tmp_path):
    log = tmp_path / "log"
    (log / "camera").mkdir(parents=True)
    (log / "camera" / "1.jpg").write_bytes(b"first picture")
    (log / "camera" / "notes.txt").write_bytes(b"no picture")
    (tmp_path / "secret.jpg").write_bytes(b"not of this log")
    files = ["camera/1.jpg", "camera/2.jpg", "camera/notes.txt", "../secret.jpg", None]
    rows = np.arange(len(files))
    table = build(FRAMES, time=START_NS + rows, index=rows, file=pa.array(files, pa.string()))
    about = RunInfo("run", {"environment": {"inputs": [str(log)]}})
    path = export(tmp_path, about, trajectory=moving(), frames=table)
    (batch,) = chunks(path, "/camera/frames")
    assert bytes(batch["EncodedImage:blob"][0].as_py()[0]) == b"first picture"
    assert when(path, "/camera/frames").tolist() == [START_NS]


def test_streams_without_a_row_are_refused(tmp_path):
    with pytest.raises(NothingToExport, match="nothing to draw"):
        export(tmp_path, trajectory=build(TRAJECTORY, time=np.zeros(0, dtype=np.int64)))
    assert list(tmp_path.iterdir()) == []


def test_the_program_of_rerun_finds_the_file_whole(tmp_path):
    path = export(tmp_path, trajectory=moving(), gnss=fixes(np.arange(30)), events=happened((1, 2)))
    done = subprocess.run([_viewer(), "rrd", "verify", path], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["drive=d2", "Fahrt \u00fc/2.1", "a" * 300])
def test_a_run_of_any_name_is_written_without_a_word_of_rerun(tmp_path, capfd, name):
    export(tmp_path, RunInfo(name), trajectory=moving())
    assert capfd.readouterr() == ("", "")


def test_without_the_package_one_sentence_says_what_to_install():
    lines = (
        "import sys",
        "sys.modules['rerun'] = None",
        "from recon.errors import PluginError",
        "from recon.manifest import RunInfo",
        "from recon.testing.drives import drive",
        "from recon_exporters.rerun import RerunParams, rerun",
        "try: rerun(streams=drive(), folder=None, about=RunInfo(''), params=RerunParams())",
        "except PluginError as error: sys.stdout.write(str(error))",
    )
    program = "\n".join(lines)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == 'exporter.rerun needs rerun-sdk\n  pip install "recon-dynamics[rerun]"'


def test_a_real_drive_and_a_crash_become_whole_files(tmp_path, logs):
    drives = {"drive": logs / "comma2k19_example" / "seg40", "crash": logs / "physycom_crash" / "crash_01.txt"}
    runs = [recon.run("best_accuracy", source, tmp_path / name) for name, source in drives.items()]
    for run in runs:
        (path,) = export_run(run, ["rerun"])
        table = run.trajectory.table
        assert np.array_equal(values(path, "/plots/accel_z/0", "Scalars:scalars"), vector(table, "accel_z"))
        assert len(when(path, "/world/trajectory/body")) == table.num_rows
        assert len([entity for entity in entities(path) if entity.startswith("/plots/residuals_")])
        assert ("/map/trajectory/now" in entities(path)) is (run is runs[0])  # the crash has no place on the Earth
    (folder := tmp_path / "overlay").mkdir()
    both = export(folder, **overlay(runs))
    assert names(both, "speed")[:2] == ["drive", "crash"]
