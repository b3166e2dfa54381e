"""What is the same though its bytes are not: numbers, versions, another processor's rounding."""

from __future__ import annotations

import json

import numpy as np
import pyarrow as pa
import pytest
from forged_seals import ELSEWHERE, IMU, edited_stream, forge, otherwise_computed
from hypothesis import given, settings
from hypothesis import strategies as st

import recon
from recon import evidence
from recon.cli import main
from recon.evidence.sameness import kinships, unlike, unlike_data, unlike_numbers


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
