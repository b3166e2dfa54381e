"""Seals that were forged, all hashes in the file made to fit: running them again finds it."""

from __future__ import annotations

import hashlib
import json

import pytest
from forged_seals import IMU, contents_of, edited_stream, forge, pack

from recon import evidence
from recon.errors import Difference


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
