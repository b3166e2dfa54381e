"""A seal holds in court: whatever an opposing expert may change is found, and equal runs give equal bytes."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import socket
import subprocess
import sys
import zipfile
from collections.abc import Callable
from functools import partial
from io import BytesIO
from pathlib import Path
from textwrap import dedent

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from evidence_runs import PIPELINE, older_arithmetic, write_log
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import recon
from recon import api, evidence
from recon.arithmetic import Arithmetic
from recon.cli import main
from recon.errors import ConfigError, DataError, Difference, PluginNotFound, ReadFailed, StageError, StorageError
from recon.evidence import archive, contents, replay
from recon.evidence.sameness import kinships, unlike, unlike_data, unlike_numbers
from recon.evidence.verification import check_bytes
from recon.overrides import Override
from recon.registry import Registry, Source
from recon.stages import Exporter


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with a log, the run of it, and its seal."""
    folder = tmp_path_factory.mktemp("evidence")
    write_log(folder / "drive.txt")
    recon.run(PIPELINE, folder / "drive.txt", folder / "run")
    evidence.seal(folder / "run", folder / "run.zip")
    return folder


@pytest.fixture
def sealed(place, tmp_path) -> Path:
    """A copy of the seal that a test may spoil."""
    return Path(shutil.copy(place / "run.zip", tmp_path / "run.zip"))


def contents_of(file: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(file) as opened:
        return {name: opened.read(name) for name in opened.namelist()}


def pack(files: dict[str, bytes], file: Path) -> Path:
    """The archive that recon would write of these files."""
    archive.write([archive.Entry(name, len(data), partial(BytesIO, data)) for name, data in files.items()], file)
    return file


def forge(file: Path, change: Callable[[dict[str, bytes]], None]) -> Path:
    """The seal with its contents changed, and all hashes made to fit: what somebody with recon's code can do."""
    files = contents_of(file)
    change(files)
    manifest = json.loads(files["manifest.json"])
    for number, entry in enumerate(manifest["inputs"], 1):
        told_of(entry, files[f"inputs/{number}/{entry['name']}"])
    for output in manifest["outputs"]:
        told_of(output, files[f"results/{output['file']}"])
    files["manifest.json"] = (json.dumps(manifest, indent=1, ensure_ascii=False) + "\n").encode()
    del files["SHA256SUMS"]
    lines = [f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in sorted(files.items())]
    return pack({**files, "SHA256SUMS": "".join(lines).encode()}, file)


def told_of(entry: dict, data: bytes) -> None:
    entry.update(bytes=len(data), sha256=hashlib.sha256(data).hexdigest())


def edited_stream(data: bytes, folder: Path, edit: Callable, **options) -> bytes:
    (folder / "a.parquet").write_bytes(data)
    table = edit(pq.read_table(folder / "a.parquet"))
    pq.write_table(table, folder / "b.parquet", **options)
    return (folder / "b.parquet").read_bytes()


def otherwise_computed(files: dict[str, bytes]) -> None:
    """Have a manifest tell of a processor that there is not."""
    manifest = json.loads(files["manifest.json"])
    manifest["environment"]["arithmetic"] = ELSEWHERE.as_data()
    files["manifest.json"] = json.dumps(manifest).encode()


IMU = "results/streams/imu.parquet"
PAGE = "exports/report/report.html"
TOLD = "exports/report/export.json"
OF_CSV = "exports/csv/export.json"
ELSEWHERE = Arithmetic(("openblas Abacus",), ("BEADS",), 1)


# --- what is as it was -----------------------------------------------------------------------------------------------


def test_a_seal_comes_out_again_byte_by_byte(place):
    found = evidence.verify(place / "run.zip")
    assert (found.agreement, found.inputs, found.notes) == ("same bytes", ("drive.txt",), ())
    assert found.sha256 == hashlib.sha256((place / "run.zip").read_bytes()).hexdigest()
    assert found.files == len(contents_of(place / "run.zip"))
    assert found.arithmetic == str(Arithmetic.used())


def test_equal_runs_in_other_places_give_equal_seals(place, tmp_path):
    elsewhere = tmp_path / "somewhere else"
    elsewhere.mkdir()
    shutil.copy(place / "drive.txt", elsewhere)
    recon.run(PIPELINE, elsewhere / "drive.txt", elsewhere / "another name")
    evidence.seal(elsewhere / "another name", elsewhere / "other.zip")
    assert (elsewhere / "other.zip").read_bytes() == (place / "run.zip").read_bytes()


def test_the_hashes_are_those_that_sha256sum_reads(place):
    files = contents_of(place / "run.zip")
    listed = dict(reversed(line.split("  ")) for line in files.pop("SHA256SUMS").decode().splitlines())
    assert listed == {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}


def test_the_log_and_the_results_are_in_it_as_they_were(place):
    files = contents_of(place / "run.zip")
    assert files["inputs/1/drive.txt"] == (place / "drive.txt").read_bytes()
    for output in json.loads((place / "run" / "manifest.json").read_text())["outputs"]:
        assert files[f"results/{output['file']}"] == (place / "run" / output["file"]).read_bytes()


def test_a_seal_tells_nothing_of_the_machine_that_it_was_made_on(place):
    """No folder, user, host or time of day; Parquet keeps its own texts uncompressed, so that bytes tell."""
    whole = b"".join(contents_of(place / "run.zip").values())
    for secret in (str(place), place.name, str(Path.home()), f'"{socket.gethostname()}"', '"host"', '"started"'):
        assert secret.encode() not in whole


def test_an_mcap_result_and_a_folder_as_input_are_sealed_too(tmp_path):
    recon.run(PIPELINE, write_log(tmp_path / "drive.txt"), tmp_path / "first")
    again = recon.Pipeline.of("again", "reader.parquet", "filter.moving_average")
    recon.run(again, tmp_path / "first", tmp_path / "second", store="mcap")
    evidence.seal(tmp_path / "second", tmp_path / "second.zip")
    names = contents_of(tmp_path / "second.zip")
    assert "results/streams.mcap" in names
    assert "inputs/1/first/manifest.json" in names
    assert evidence.verify(tmp_path / "second.zip").agreement == "same bytes"


def test_exports_are_taken_along_where_they_are_asked_for(place, tmp_path):
    run = Path(shutil.copytree(place / "run", tmp_path / "run"))
    api.export(api.open(run), ["csv"])
    evidence.seal(run, tmp_path / "with.zip", exports=True)
    assert any(name.startswith("exports/csv/") for name in contents_of(tmp_path / "with.zip"))
    assert evidence.verify(tmp_path / "with.zip").exports == {"csv": "same bytes"}
    evidence.seal(run, tmp_path / "without.zip")
    assert (tmp_path / "without.zip").read_bytes() == (place / "run.zip").read_bytes()


# --- what was changed ------------------------------------------------------------------------------------------------


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    share=st.floats(0.0, 1.0, exclude_max=True), flip=st.integers(1, 255), edge=st.sampled_from(["", "head", "tail"])
)
def test_a_changed_byte_anywhere_is_found(place, tmp_path, share, flip, edge):
    """Anywhere: half of the examples fall into the first header and the directory at the end."""
    data = bytearray((place / "run.zip").read_bytes())
    span = {"": range(len(data)), "head": range(60), "tail": range(len(data) - 1200, len(data))}[edge]
    data[span[int(share * len(span))]] ^= flip
    spoilt = tmp_path / "spoilt.zip"
    spoilt.write_bytes(data)
    with pytest.raises(Difference), archive.opened(spoilt) as entries:
        check_bytes(spoilt, entries)


def test_a_changed_byte_ends_with_exit_code_7_and_says_where(sealed, capsys):
    data = bytearray(sealed.read_bytes())
    data[data.index(b"ax\tay") + 1] ^= 1
    sealed.write_bytes(data)
    assert main(["verify", str(sealed)]) == 7
    assert "inputs/1/drive.txt was changed" in capsys.readouterr().err


@pytest.mark.parametrize("extra", [b"\0", b"PK\x05\x06" + bytes(18)])
def test_bytes_behind_the_archive_are_found(sealed, extra):
    sealed.write_bytes(sealed.read_bytes() + extra)
    with pytest.raises(Difference):
        evidence.verify(sealed)


def test_bytes_in_front_of_the_archive_are_found(sealed):
    sealed.write_bytes(b"#!/bin/sh\n" + sealed.read_bytes())
    with pytest.raises(Difference):
        evidence.verify(sealed)


@pytest.mark.parametrize("length", [0, 10, -1, -200])
def test_a_seal_that_is_cut_short_is_found(sealed, length):
    data = sealed.read_bytes()
    sealed.write_bytes(data[:length])
    with pytest.raises((Difference, ReadFailed)):
        evidence.verify(sealed)


def test_files_that_were_packed_anew_are_told_as_such(sealed):
    files = contents_of(sealed)
    with zipfile.ZipFile(sealed, "w") as other:
        for name, data in files.items():
            other.writestr(zipfile.ZipInfo(name, (2020, 1, 1, 0, 0, 0)), data)
    with pytest.raises(Difference, match="not as recon writes it, though all files in it are as listed"):
        evidence.verify(sealed)


def test_a_compressed_archive_is_no_seal(sealed):
    files = contents_of(sealed)
    with zipfile.ZipFile(sealed, "w", zipfile.ZIP_DEFLATED) as other:
        for name, data in files.items():
            other.writestr(name, data)
    with pytest.raises(Difference, match="compressed or encrypted"):
        evidence.verify(sealed)


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("name", ["manifest.json", "MANIFEST.json"])
def test_two_entries_of_one_name_are_found(sealed, name):
    with zipfile.ZipFile(sealed, "a") as other:
        other.writestr(name, "{}")
    with pytest.raises(Difference, match="a second file of that name"):
        evidence.verify(sealed)


@pytest.mark.parametrize(
    "name",
    ["../outside.txt", "/etc/outside.txt", "inputs/1/../../../outside.txt", "inputs\\1\\x", "inputs//x", "inputs/"],
)
def test_a_name_that_leads_out_of_the_archive_is_refused_and_nothing_is_written_there(sealed, name):
    before = sorted(sealed.parent.rglob("*"))
    with zipfile.ZipFile(sealed, "a") as other:
        other.writestr(name, "gotcha")
    with pytest.raises(Difference, match="its name"):
        evidence.verify(sealed)
    assert sorted(sealed.parent.rglob("*")) == before
    assert not (sealed.parent.parent / "outside.txt").exists()


def test_a_file_that_was_added_or_taken_away_is_found(sealed):
    files = contents_of(sealed)
    pack({**files, "inputs/1/second.txt": b"more"}, sealed)
    with pytest.raises(Difference, match="was added"):
        evidence.verify(sealed)
    pack({name: data for name, data in files.items() if name != IMU}, sealed)
    with pytest.raises(Difference, match=r"imu\.parquet is missing"):
        evidence.verify(sealed)
    pack({**files, "virus.exe": b"MZ"}, sealed)
    with pytest.raises(Difference, match="no such file"):
        evidence.verify(sealed)


def test_a_run_of_another_processor_comes_out_again_byte_by_byte(tmp_path):
    """A smoother makes more of how a processor rounds; so a replay computes as the processor of the run did."""
    text = """
        recon: 1
        name: short
        steps:
          - {use: simulator.drive, params: {duration: 1 min, imu_rate: 50 Hz}}
          - use: fuser.map
        """
    (tmp_path / "short.yaml").write_text(dedent(text))
    elsewhere = older_arithmetic(Arithmetic.used())
    command = [sys.executable, "-m", "recon", "run", str(tmp_path / "short.yaml"), "--out", str(tmp_path / "run")]
    subprocess.run(command, env=elsewhere.environment(), check=True, capture_output=True)
    here = recon.run(tmp_path / "short.yaml", out=tmp_path / "here")
    assert api.open(tmp_path / "run").manifest["outputs"] != here.manifest["outputs"]  # else any replay would do

    evidence.seal(tmp_path / "run", tmp_path / "run.zip")  # raises unless it comes out again byte by byte
    manifest = json.loads(contents_of(tmp_path / "run.zip")["manifest.json"])
    assert Arithmetic.from_data(manifest["environment"]["arithmetic"]) == elsewhere


def test_a_module_beside_the_seal_is_not_run(place, tmp_path, monkeypatch):
    """Who sends a seal may send a numpy.py with it, and have the seal ask for an arithmetic that takes a process."""
    monkeypatch.chdir(tmp_path)
    Path("numpy.py").write_text("open('ran', 'w').close()\n", encoding="utf-8")
    manifest = api.open(place / "run").manifest
    elsewhere = {**manifest["environment"], "arithmetic": older_arithmetic(Arithmetic.used()).as_data()}
    replay.run_again({**manifest, "environment": elsewhere}, [place / "drive.txt"], Path("again"), Registry.installed())
    assert not Path("ran").exists()


# --- what was forged, all hashes in the file made to fit -------------------------------------------------------------


def test_a_forged_seal_without_a_change_is_the_seal(sealed, place):
    """Else the tests below would find the forger, not the forgery."""
    assert forge(sealed, lambda files: None).read_bytes() == (place / "run.zip").read_bytes()


def test_a_swapped_log_is_found_by_running_it_again(sealed):
    def swap(files):
        files["inputs/1/drive.txt"] = files["inputs/1/drive.txt"].replace(b"3.00000", b"2.90000")

    with pytest.raises(Difference, match="run again, the result is another one"):
        evidence.verify(forge(sealed, swap))


def test_a_swapped_log_that_changes_no_result_is_found_by_the_hash_that_was_noted(sealed):
    noted = hashlib.sha256(sealed.read_bytes()).hexdigest()

    def swap(files):
        files["inputs/1/drive.txt"] += b"\n"

    forged = forge(sealed, swap)
    assert evidence.verify(forged).agreement == "same bytes"
    with pytest.raises(Difference, match="not the file that was noted"):
        evidence.verify(forged, sha256=noted)


@pytest.mark.parametrize(
    ("target", "before", "after"),
    [
        ("manifest.json", b'"window": 0.05', b'"window": 0.06'),
        ("manifest.json", b'"warnings": []', b'"warnings": ["the box was loose"]'),
        ("manifest.json", b'"stage_version": 1', b'"stage_version": 1, "params2": {}'),
    ],
)
def test_a_manifest_that_tells_something_else_is_found(sealed, target, before, after):
    def change(files):
        assert before in files[target]
        files[target] = files[target].replace(before, after, 1)

    with pytest.raises(Difference, match="run again, its manifest is another one"):
        evidence.verify(forge(sealed, change))


def test_a_pipeline_beside_that_of_the_manifest_is_found(sealed):
    def change(files):
        files["pipeline.yaml"] += b"# a note\n"

    with pytest.raises(Difference, match=r"pipeline\.yaml is not the pipeline that manifest\.json tells of"):
        evidence.verify(forge(sealed, change))


def test_another_page_that_says_how_to_check_is_found(sealed):
    def change(files):
        files["README.txt"] = files["README.txt"].replace(b"pip install recon-dynamics", b"pip install recon-of-mine")

    with pytest.raises(Difference, match=r"README\.txt is not the page that recon writes"):
        evidence.verify(forge(sealed, change))


# --- files for people ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def exported(place, tmp_path_factory) -> Path:
    """The seal of a run with two exports, one of them with a parameter, under a name of its own."""
    folder = tmp_path_factory.mktemp("exported")
    run = Path(shutil.copytree(place / "run", folder / "drive of June"))
    overrides = [Override.from_data("exporter.report.max_gap", "3 s")]
    api.export(api.open(run), ["csv", "report"], overrides=overrides)
    evidence.seal(run, folder / "run.zip", exports=True)
    return folder / "run.zip"


@pytest.fixture
def with_exports(exported, tmp_path) -> Path:
    """A copy that a test may spoil."""
    return Path(shutil.copy(exported, tmp_path / "run.zip"))


def test_exports_are_made_again_under_another_name_and_with_their_parameters(with_exports, capsys):
    told = json.loads(contents_of(with_exports)["exports/report/export.json"])
    assert (told["run"], told["export"]["params"]["max_gap"]) == ("drive of June", 3.0)
    assert main(["verify", str(with_exports)]) == 0
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert {"exports/csv same bytes", "exports/report same bytes"} <= set(lines)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda files: files.update({PAGE: files[PAGE].replace(b"June", b"July")}), f"{PAGE} does not follow from"),
        (lambda files: files.update({"exports/csv/more.csv": b"a"}), "more.csv is none of the files that the exporter"),
        (lambda files: files.pop(PAGE), f"{PAGE} is missing"),
        (
            lambda files: files.update({OF_CSV: files[OF_CSV].replace(b'"comma"', b'"tab"')}),
            r"exports/csv/\S+ does not follow from",
        ),
        (
            lambda files: files.update({TOLD: files[TOLD].replace(b'"max_gap"', b'"min_gap"')}),
            "exports/report cannot be made from the results: export.json tells parameters that exporter.report does",
        ),
    ],
    ids=["changed", "added", "gone", "parameter", "no parameter"],
)
def test_an_export_that_does_not_follow_from_the_results_is_found(with_exports, change, fault):
    with pytest.raises(Difference, match=fault) as found:
        evidence.verify(forge(with_exports, change))
    assert "so it was changed" in (found.value.hint or "")


def test_exports_of_other_code_are_told_and_are_no_difference(with_exports):
    """Another version of what draws a picture gives other bytes, and nobody changed them."""

    def older(files):
        files[PAGE] = files[PAGE].replace(b"June", b"July")
        versions = json.loads(files["versions.json"])
        versions["packages"]["numpy"] = "0.1"
        files["versions.json"] = json.dumps(versions).encode()

    found = evidence.verify(forge(with_exports, older))
    assert found.exports["csv"] == "same bytes"
    assert found.exports["report"].startswith(f"made again, with other bytes: {PAGE} does not follow")
    assert "since numpy was 0.1" in found.exports["report"]


@pytest.mark.parametrize(
    "data",
    [None, b"", b"[]", b"{}", b'{"run": "a", "export": []}', b'{"run": "a", "export": {"use": 3, "params": {}}}'],
)
def test_exports_that_nothing_tells_the_origin_of_are_named(with_exports, data):
    def forget(files):
        files.pop(TOLD) if data is None else files.update({TOLD: data})

    found = evidence.verify(forge(with_exports, forget)).exports
    assert found == {"csv": "same bytes", "report": "not checked: no export.json tells what made it"}


def test_an_exporter_that_never_repeats_itself_is_named_and_its_files_are_sealed(place, tmp_path):
    def drawn(*, folder, about, params):
        (folder / "lot.txt").write_text(os.urandom(8).hex())
        return [folder / "lot.txt"]

    lot = Exporter(name="lot", summary="A lot.", run=drawn, repeats=False)
    registry = Registry.installed().with_records(lot)
    run = Path(shutil.copytree(place / "run", tmp_path / "run"))
    api.export(api.open(run), ["lot"], registry)
    evidence.seal(run, tmp_path / "with.zip", exports=True, registry=registry)
    found = evidence.verify(tmp_path / "with.zip", registry=registry).exports
    assert found == {"lot": "not checked: exporter.lot never gives the same bytes"}
    (told,) = evidence.verify(tmp_path / "with.zip").exports.values()
    assert told.startswith("not checked: ")
    assert "lot" in told


def test_an_exporter_that_says_that_it_repeats_itself_and_does_not_is_found_when_it_is_sealed(place, tmp_path):
    def drawn(*, folder, about, params):
        (folder / "lot.txt").write_text(os.urandom(8).hex())
        return [folder / "lot.txt"]

    registry = Registry.installed().with_records(Exporter(name="lot", summary="A lot.", run=drawn))
    run = Path(shutil.copytree(place / "run", tmp_path / "run"))
    api.export(api.open(run), ["lot"], registry)
    with pytest.raises(Difference, match=r"not sealed, .* exports/lot/lot\.txt does not follow from the results"):
        evidence.seal(run, tmp_path / "with.zip", exports=True, registry=registry)
    assert not (tmp_path / "with.zip").exists()


def test_a_result_that_does_not_follow_from_the_log_is_found_with_its_place(sealed, tmp_path):
    def faster(table):
        index = table.column_names.index("accel_x")
        values = table["accel_x"].to_numpy().copy()
        values[203] *= 1.0 + 1e-8  # of the blow: noise may err by 1e-9 of the rms
        return table.set_column(index, table.schema.field(index), [values])

    forged = forge(sealed, lambda files: files.update({IMU: edited_stream(files[IMU], tmp_path, faster)}))
    with pytest.raises(Difference, match=r"imu\.accel_x, row 204: ") as caught:
        evidence.verify(forged)
    assert "are those of the seal, so it was changed after it was run" in caught.value.hint


def test_a_manifest_whose_inputs_lead_elsewhere_is_found(sealed):
    files = contents_of(sealed)
    manifest = json.loads(files["manifest.json"])
    manifest["inputs"][0]["name"] = "../../../etc/passwd"
    files["manifest.json"] = json.dumps(manifest).encode()
    del files["SHA256SUMS"]
    sums = "".join(f"{hashlib.sha256(d).hexdigest()}  {n}\n" for n, d in sorted(files.items()))
    with pytest.raises(Difference, match=r"not the file that manifest\.json tells of"):
        evidence.verify(pack({**files, "SHA256SUMS": sums.encode()}, sealed))


@pytest.mark.parametrize("data", [b"{", b"[]", b"{}", b"[" * 100_000, b'{"recon_manifest": 1}'])
def test_a_manifest_that_is_none_is_found(sealed, data):
    files = contents_of(sealed) | {"manifest.json": data}
    del files["SHA256SUMS"]
    sums = "".join(f"{hashlib.sha256(d).hexdigest()}  {n}\n" for n, d in sorted(files.items()))
    with pytest.raises(Difference, match="no run of recon"):
        evidence.verify(pack({**files, "SHA256SUMS": sums.encode()}, sealed))


@pytest.mark.parametrize("told", [{"packages": [], "code": 3}, {"packages": 1, "code": [None, {}]}, {}])
def test_versions_of_another_shape_say_nothing(sealed, told):
    def change(files):
        versions = {key: value for key, value in json.loads(files["versions.json"]).items() if key == "recon_seal"}
        files["versions.json"] = json.dumps({**versions, **told}).encode()

    assert evidence.verify(forge(sealed, change)).agreement == "same bytes"


# --- what is the same though its bytes are not -----------------------------------------------------------------------


def test_other_bytes_of_the_same_numbers_are_told_as_such(sealed, tmp_path):
    """As another version of pyarrow would write them, and as another processor would round them."""

    def rounded(table):
        index = table.column_names.index("accel_x")
        values = table["accel_x"].to_numpy() * (1.0 + 1e-12)
        return table.set_column(index, table.schema.field(index), [values])

    forged = forge(sealed, lambda f: f.update({IMU: edited_stream(f[IMU], tmp_path, rounded, compression="gzip")}))
    assert evidence.verify(forged).agreement == "same numbers"


def test_other_versions_are_told_and_are_no_difference(sealed):
    def older(files):
        for old, new in ((b'"stage_version": 1', b'"stage_version": 0'), (b'"recon": "', b'"recon": "0.')):
            files["manifest.json"] = files["manifest.json"].replace(old, new)
        versions = json.loads(files["versions.json"])
        versions["recon"], versions["packages"]["numpy"] = "0.0.1", "1.26.0"
        versions["code"][0]["sha256"] = "0" * 64
        files["versions.json"] = json.dumps(versions).encode()
        otherwise_computed(files)

    found = evidence.verify(forge(sealed, older))
    assert found.agreement == "same bytes"
    assert "recon was 0.0.1" in found.notes[0]
    assert any(note.startswith("numpy was 1.26.0") for note in found.notes)
    assert any(note.startswith("the code of recon is another one") for note in found.notes)
    assert any(note.startswith(f"it was computed by {ELSEWHERE}, which cannot be had here") for note in found.notes)


@settings(max_examples=60)
@given(st.floats(-1e12, 1e12), st.sampled_from([1e-12, 9e-10, 2e-9, 1e-3]))
def test_numbers_are_the_same_within_a_share_of_1e_9(value, share):
    again = value * (1.0 + share)
    apart = abs(again - value) > 1e-9 * max(abs(again), abs(value))
    assert bool(unlike_data({"a": [value]}, {"a": [again]}, "")) == apart


def test_missing_numbers_must_be_missing_again():
    nan, inf = np.nan, np.inf
    assert unlike_numbers(np.array([1.0, nan, inf]), np.array([1.0, nan, inf])) is None
    for other in ([1.0, 2.0, inf], [1.0, nan, -inf], [nan, nan, inf]):
        assert unlike_numbers(np.array([1.0, nan, inf]), np.array(other))


def test_a_difference_says_how_far_apart_and_what_it_means_in_sigmas():
    """What rounds otherwise moves a millionth of a sigma; who forges a number does not stop there."""
    one = recon.Recording({"metrics": recon.metrics([recon.Metric("delta_v", 12.0, "km/h", 0.1)])})
    other = recon.Recording({"metrics": recon.metrics([recon.Metric("delta_v", 12.0 + 1e-7, "km/h", 0.1)])})
    assert unlike(one, other).startswith("metrics.value, row 1 (delta_v): 12.0, and now 12.0000001, 8.3e-09 of its")
    (kinship,) = kinships(one, other)
    assert kinship.how == "rounded otherwise"
    assert kinship.sigmas == pytest.approx(1e-6, rel=1e-3)
    assert kinships(one, recon.Recording({})) == [("metrics", "other", None, None)]


def test_what_another_processor_rounds_otherwise_is_told_as_such_and_not_as_a_forgery(sealed, tmp_path, capsys):
    """Beyond 1e-9 it is exit 7 all the same, with how alike each stream is."""

    def rounded(table):
        index = table.column_names.index("accel_x")
        return table.set_column(index, table.schema.field(index), [table["accel_x"].to_numpy() * (1.0 + 1e-7)])

    def elsewhere(files):
        files[IMU] = edited_stream(files[IMU], tmp_path, rounded)
        otherwise_computed(files)

    forged = forge(sealed, elsewhere)
    assert main(["verify", str(forged)]) == 7
    told = capsys.readouterr().err
    assert "every number is within 1.0e-07 of its size of the sealed one" in told
    assert "the same bytes: gnss" in told
    assert "within 1.0e-07 of their size: imu" in told
    assert f"it was computed by {ELSEWHERE}, which cannot be had here" in told
    assert "it was changed" not in told
    assert main(["verify", str(forged), "--json"]) == 7
    streams = {stream["stream"]: stream["how"] for stream in json.loads(capsys.readouterr().out)["streams"]}
    assert streams["imu"] == "rounded otherwise"
    assert streams["gnss"] == "same bytes"


def test_the_first_list_that_is_unlike_is_named():
    def of(*lists):
        return recon.Recording({"a": pa.table({"root": pa.array(lists, pa.list_(pa.float32()))})})

    same = of([1.0, 2.0], [3.0])
    assert unlike(same, of([1.0, 2.0], [3.0])) == ""
    assert unlike(same, of([1.0, 2.0], [4.0])).startswith("a.root, row 2: 3.0, and now 4.0")
    assert unlike(same, of([1.0], [2.0, 3.0])) == "a.root, row 1: 2 numbers, and now 1"


# --- what cannot be sealed or verified -------------------------------------------------------------------------------


def test_a_log_that_was_changed_since_is_not_sealed(place, tmp_path):
    log = write_log(tmp_path / "drive.txt")
    recon.run(PIPELINE, log, tmp_path / "run")
    log.write_text(log.read_text().replace("3.00000", "2.00000"))
    with pytest.raises(DataError, match="is not what the run read"):
        evidence.seal(tmp_path / "run", tmp_path / "run.zip")
    evidence.seal(tmp_path / "run", tmp_path / "run.zip", [place / "drive.txt"])
    log.unlink()
    with pytest.raises(DataError, match="no longer there"):
        evidence.seal(tmp_path / "run", tmp_path / "other.zip")
    assert not (tmp_path / "other.zip").exists()


def test_a_result_that_was_changed_since_is_not_sealed(place, tmp_path):
    run = Path(shutil.copytree(place / "run", tmp_path / "run"))
    (run / "streams" / "imu.parquet").write_bytes((run / "streams" / "gnss.parquet").read_bytes())
    with pytest.raises(DataError, match="is not the file that the run left there"):
        evidence.seal(run, tmp_path / "run.zip")


def test_a_run_that_does_not_come_out_again_is_not_sealed(place, tmp_path):
    run = Path(shutil.copytree(place / "run", tmp_path / "run"))
    manifest = json.loads((run / "manifest.json").read_text())
    manifest["steps"][1]["metrics"][0]["value"] = 77.0
    (run / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(Difference, match="the run is not sealed, since it does not come out again"):
        evidence.seal(run, tmp_path / "run.zip")
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_a_seal_is_never_replaced(place):
    before = (place / "run.zip").read_bytes()
    with pytest.raises(ConfigError, match="never replaced"):
        evidence.seal(place / "run", place / "run.zip")
    assert (place / "run.zip").read_bytes() == before


def test_a_run_of_tables_in_memory_has_no_log_to_seal(place, tmp_path):
    recon.run(PIPELINE, recon.read(place / "drive.txt"), tmp_path / "run")
    with pytest.raises(DataError, match="made from tables in memory"):
        evidence.seal(tmp_path / "run", tmp_path / "run.zip")


def test_the_code_that_is_hashed_holds_its_data_and_what_python_makes_of_it_not(tmp_path, monkeypatch):
    """A limit in a data file changes results as a line of code does."""
    package = tmp_path / "stages_of_ours"
    (package / "__pycache__").mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "limits.yaml").write_text("a: 1")
    monkeypatch.syspath_prepend(str(tmp_path))

    def digest():
        source = Source("ours", "1.0", "stages_of_ours.one")
        return next(part["sha256"] for part in contents.versions_of([source])["code"] if part["package"] != "recon")

    before = digest()
    (package / "__pycache__" / "one.cpython-311.pyc").write_bytes(b"x")
    (package / "README.md").write_text("words")
    assert digest() == before
    (package / "limits.yaml").write_text("a: 2")
    assert digest() != before


def test_a_stage_that_is_not_installed_is_named_with_its_distribution(sealed):
    with pytest.raises(PluginNotFound, match=r"its stage 'filter\.moving_average' is not installed here") as caught:
        evidence.verify(sealed, registry=Registry.installed(block=["filter.moving_average"]))
    assert caught.value.hint == f"pip install recon-dynamics=={recon.__version__}"
    with pytest.raises(PluginNotFound, match=r"'reader\.physycom'"):
        evidence.verify(sealed, registry=Registry.installed(block=["reader.physycom"]))


def test_a_seal_of_a_newer_recon_is_told_as_such(sealed):
    def newer(files):
        files["versions.json"] = b'{"recon_seal": 2, "recon": "9.0"}'

    with pytest.raises(ReadFailed, match="newer recon"):
        evidence.verify(forge(sealed, newer))


def test_what_is_no_seal_is_refused(tmp_path):
    with pytest.raises(ReadFailed, match="it cannot be read"):
        evidence.verify(tmp_path / "absent.zip")
    (tmp_path / "photo.jpg").write_bytes(b"\xff\xd8\xff")
    with pytest.raises(ReadFailed, match="no zip archive"):
        evidence.verify(tmp_path / "photo.jpg")
    with zipfile.ZipFile(tmp_path / "other.zip", "w") as other:
        other.writestr("a.txt", "a")
    with pytest.raises(Difference, match="no whole seal"):
        evidence.verify(tmp_path / "other.zip")


def test_a_hash_that_is_none_is_a_wrong_option(sealed):
    with pytest.raises(ConfigError, match="is no SHA-256"):
        evidence.verify(sealed, sha256="abc")


@pytest.mark.parametrize("kind", ["disk", "memory"])
def test_a_machine_without_room_for_the_run_is_no_difference(sealed, monkeypatch, kind):
    def too_small(*given, **named):
        error = StorageError("no room") if kind == "disk" else StageError("filter.x", "no room")
        raise error from (None if kind == "disk" else MemoryError())

    monkeypatch.setattr(api, "execute", too_small)
    with pytest.raises(StorageError if kind == "disk" else StageError, match="no room"):
        evidence.verify(sealed)


VERIFIED_WITHOUT_ROOM = """
import resource, sys
from recon.cli import main
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
sys.exit(main(["verify", sys.argv[1]]))
"""
"""A limit on the size of files stands for a temporary folder that is full."""


@pytest.mark.skipif(os.name != "posix", reason="limits on the size of files are those of POSIX")
def test_a_temporary_folder_without_room_is_told_in_a_sentence(sealed):
    command = [sys.executable, "-c", VERIFIED_WITHOUT_ROOM, str(sealed)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 8, done.stderr
    assert "could not be written: file too large" in done.stderr


def test_verifying_leaves_nothing_behind_and_changes_nothing(sealed, monkeypatch, tmp_path):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(scratch))
    before = sealed.read_bytes()
    evidence.verify(sealed)
    assert list(scratch.iterdir()) == []
    assert sealed.read_bytes() == before


# --- the command line -----------------------------------------------------------------------------------------------


def test_the_command_line_seals_verifies_and_tells_the_hash(place, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["seal", str(place / "run")]) == 0
    told = capsys.readouterr().out
    digest = hashlib.sha256((tmp_path / "run.zip").read_bytes()).hexdigest()
    assert digest in told
    assert main(["verify", "run.zip", "--sha256", digest]) == 0
    assert "same bytes" in capsys.readouterr().out
    assert main(["verify", "run.zip", "--sha256", "0" * 64, "--json"]) == 7
    assert json.loads(capsys.readouterr().out)["agreement"] == ""
    assert main(["verify", "run.zip", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["agreement"] == "same bytes"


def test_the_page_in_the_archive_says_how_to_check_it(place):
    text = contents_of(place / "run.zip")[contents.README].decode()
    assert "sha256sum -c SHA256SUMS" in text
    assert "recon verify FILE" in text
