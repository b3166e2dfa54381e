from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from helpers import clock, filter_of, gnss_table, imu_table, pipeline_of, source_of

import recon
from recon import api
from recon.errors import ConfigError, DataError, ReadFailed, StageError
from recon.parameters import Params, quantity
from recon.recording import Recording
from recon.registry import Registry
from recon.rows import Event, Metric, events, metrics, warning
from recon.schema import EVENTS, GNSS, KNOTS, TRAJECTORY
from recon.stages import Exporter, Filter, Reader
from recon.tables import build, matrix, vector


class Scale(Params):
    scale: float = quantity(1.0, "m/s", gt=0, doc="Speed of one count.")


def counts(path, params):
    speed = np.loadtxt(path, ndmin=1) * params.scale
    return {"gnss": build(GNSS, time=clock(len(speed)), speed=speed)}


def follow(*, gnss, params):
    speed = vector(gnss, "speed")
    zero = np.zeros_like(speed)
    vel = np.column_stack([speed, zero, zero])
    pos = np.cumsum(vel, axis=0) * 0.01
    q = np.column_stack([zero + 1.0, zero, zero, zero])
    return {
        "trajectory": build(TRAJECTORY, time=clock(len(speed)), pos=pos, vel=vel, q=q),
        "events": events([Event(int(clock(1)[0]), int(clock(2)[-1]), "standstill")]),
        "metrics": metrics([Metric("rows", float(len(speed))), warning("only a test")]),
    }


def lines(*, trajectory, folder, about, params):
    path = folder / "rows.txt"
    path.write_text(f"{about.name} {trajectory.num_rows} {about.warnings}", encoding="utf-8")
    return [path]


REGISTRY = Registry.of(
    Reader(name="counts", summary="Counts.", run=counts, params=Scale, writes={"gnss": GNSS.only("speed")}),
    Filter(
        name="follow",
        summary="Straight on.",
        run=follow,
        reads={"gnss": GNSS.need("speed")},
        writes={"trajectory": TRAJECTORY, "events": EVENTS},
    ),
    Exporter(name="lines", summary="Counts rows.", run=lines, reads={"trajectory": TRAJECTORY.need("pos")}),
    filter_of(lambda *, imu, params: 1 / 0, "broken"),
    source_of({"imu": imu_table()}),
)
FOLLOW = pipeline_of("use: reader.counts", "use: filter.follow", name="follow")


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "log.txt"
    path.write_text("0\n1\n2\n", encoding="utf-8")
    return path


def follow_run(source, out=None, **options):
    return recon.run(FOLLOW, source, out, registry=REGISTRY, **options)


def test_a_run_in_memory_has_recording_trajectory_events_metrics_and_manifest(log):
    run = follow_run(log)
    assert run.folder is None
    assert list(run.recording) == ["gnss", "trajectory", "events", "metrics"]
    assert run.trajectory.table is run.recording["trajectory"]
    assert run.events["kind"].to_pylist() == ["standstill"]
    assert run.metrics["name"].to_pylist() == ["rows", "warning"]
    assert run.warnings == ["only a test"]
    assert [entry["name"] for entry in run.manifest["inputs"]] == ["log.txt"]


def test_a_summary_holds_what_the_run_tells(log):
    # 0.01 s at 1 m/s and 2 m/s; the path begins at the first row
    assert follow_run(log).summary() == pytest.approx(
        {"distance": 0.03, "duration": 0.02, "top_speed": 2.0, "stops": 1, "warnings": 1}
    )


def test_html_holds_name_and_streams(log):
    html = follow_run(log)._repr_html_()
    assert "<b>follow</b>" in html
    assert "trajectory" in html


def test_a_run_is_printed_in_a_line(log):
    found = repr(follow_run(log))
    assert found.startswith("Run(pipeline 'follow', distance 0.03, duration 0.02, top_speed 2, stops 1, warnings 1, ")
    assert "trajectory: 3 rows" in found
    assert "\n" not in found


@pytest.mark.parametrize("store", ["parquet", "mcap"])
def test_a_kept_run_is_opened_with_the_same_numbers(log, tmp_path, store):
    run = follow_run(log, tmp_path / "out", store=store)
    again = recon.open(tmp_path / "out")
    assert again.folder == run.folder == tmp_path / "out"
    assert again.manifest["store"] == store
    assert set(again.recording) == set(run.recording)
    for name, table in run.recording.items():
        assert again.recording[name].equals(table)


def test_equal_runs_give_equal_files_and_manifests_outside_the_environment(log, tmp_path):
    first, second = (follow_run(log, tmp_path / name).manifest for name in ("one", "two"))
    assert first["outputs"]
    assert {**first, "environment": {}} == {**second, "environment": {}}


def test_overrides_are_named_by_step_and_parameter(log):
    run = follow_run(log, **{"reader.counts.scale": "3.6 km/h"})
    assert run.manifest["plan"][0]["params"] == {"scale": 1.0}
    with pytest.raises(ConfigError, match=r"override reader.counts.scale: error: .* a unit is missing"):
        follow_run(log, **{"reader.counts.scale": 2.0})


def test_a_recording_takes_the_place_of_the_file():
    run = follow_run(Recording({"gnss": gnss_table(5)}))
    assert len(run.trajectory) == 5
    assert run.manifest["inputs"] == []


def test_several_files_are_one_drive(log):
    other = log.with_name("other.txt")
    other.write_text("5\n6\n7\n", encoding="utf-8")
    assert "gnss_2" in follow_run([log, other]).recording


def test_the_trajectory_of_a_run_has_its_knots(log):
    run = follow_run(log)
    assert run.trajectory.knots is None
    known = build(KNOTS, time=clock(2))
    assert api.Run(Recording({**run.recording, "knots": known}), {}).trajectory.knots is known


def test_a_run_without_trajectory_says_what_it_has():
    run = recon.run(pipeline_of("use: simulator.made"), registry=REGISTRY)
    with pytest.raises(DataError, match="this run has no trajectory\n  its streams are imu"):
        _ = run.trajectory
    assert run.events is None


def test_every_problem_is_raised_together_and_nothing_is_left(log, tmp_path):
    pipeline = pipeline_of("{use: reader.counts, params: {scal: 1 m/s}}", "use: filter.folow")
    with pytest.raises(ConfigError) as caught:
        recon.run(pipeline, log, tmp_path / "out", registry=REGISTRY)
    assert len(caught.value.problems) == 2
    assert not (tmp_path / "out").exists()


def test_a_stage_that_fails_leaves_nothing_behind(tmp_path):
    pipeline = pipeline_of("use: simulator.made", "use: filter.broken")
    with pytest.raises(StageError):
        recon.run(pipeline, out=tmp_path / "out", registry=REGISTRY)
    assert list(tmp_path.iterdir()) == []


def test_an_output_that_is_there_is_refused_before_any_work(log, tmp_path):
    follow_run(log, tmp_path / "out")
    with pytest.raises(ConfigError, match="out is there already"):
        follow_run(tmp_path / "missing.txt", tmp_path / "out")
    follow_run(log, tmp_path / "out", overwrite=True, **{"reader.counts.scale": "2 m/s"})
    assert recon.open(tmp_path / "out").trajectory.speed.max() == 4.0


def test_an_unknown_store_is_refused_before_any_work(log, tmp_path):
    with pytest.raises(ConfigError, match="there is no store 'zip'"):
        follow_run(tmp_path / "missing.txt", tmp_path / "out", store="zip")


def test_exports_lie_in_folders_of_their_own(log, tmp_path):
    follow_run(log, tmp_path / "out", exports=["lines"])
    written = tmp_path / "out" / "exports" / "lines" / "rows.txt"
    assert written.read_text(encoding="utf-8") == "out 3 ['only a test']"


def test_an_export_is_made_later_from_the_files_alone(log, tmp_path):
    follow_run(log, tmp_path / "out")
    run = recon.open(tmp_path / "out")
    assert api.export(run, ["lines"], REGISTRY) == [tmp_path / "out" / "exports" / "lines" / "rows.txt"]


def test_an_export_needs_a_folder(log):
    with pytest.raises(ConfigError, match=r"exporter.lines needs a folder to write to"):
        follow_run(log, exports=["lines"])


def test_a_folder_that_is_no_run_is_not_opened(tmp_path):
    with pytest.raises(ReadFailed, match="this is no finished run"):
        recon.open(tmp_path)


def test_a_log_is_read_by_the_reader_that_knows_it(log, tmp_path):
    follow_run(log, tmp_path / "out")
    recording = recon.read(tmp_path / "out")
    assert matrix(recording["trajectory"], "vel").shape == (3, 3)


def test_every_public_name_is_there_and_imported_on_first_use():
    code = (
        "import sys, recon\n"
        "assert 'pyarrow' not in sys.modules and 'numpy' not in sys.modules\n"
        "missing = [name for name in recon.__all__ if not hasattr(recon, name)]\n"
        "assert not missing, missing\n"
        "assert dir(recon) == sorted(recon.__all__)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_name_that_is_not_public_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'recon' has no attribute 'rum'"):
        _ = recon.rum


def test_a_result_never_takes_the_place_of_what_it_is_made_from(log, tmp_path):
    raw = follow_run(log, tmp_path / "raw").folder
    for source, out in ((raw, raw), (raw / "streams" / "trajectory.parquet", raw)):
        with pytest.raises(ConfigError, match="lies in the output folder"):
            follow_run(source, out, overwrite=True)
    assert recon.open(raw).manifest


def test_an_export_has_a_manifest_that_lists_its_files(log, tmp_path):
    finished = follow_run(log, tmp_path / "run", exports="lines")
    (listed,) = json.loads((finished.folder / "exports" / "lines" / "export.json").read_text())["outputs"]
    assert (finished.folder / "exports" / "lines" / listed["file"]).stat().st_size == listed["bytes"]


def test_an_export_does_not_replace_files_of_somebody_else(log, tmp_path):
    finished = follow_run(log, tmp_path / "run", exports=["lines"])
    mine = finished.folder / "exports" / "lines" / "mine.txt"
    mine.touch()
    with pytest.raises(ConfigError, match=r"mine\.txt was not written by recon"):
        follow_run(log, finished.folder, exports=["lines"], overwrite=True)
    assert mine.exists()


def test_an_older_result_with_its_exports_may_be_replaced(log, tmp_path):
    first = follow_run(log, tmp_path / "run", exports=["lines"])
    again = follow_run(log, first.folder, overwrite=True)
    assert not (again.folder / "exports").exists()


def test_a_table_in_place_of_a_recording_is_told_so():
    with pytest.raises(DataError, match="a table is no recording"):
        follow_run(gnss_table())
