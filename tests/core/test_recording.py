from __future__ import annotations

import pickle

import pytest
from helpers import START_NS, STEP_NS, gnss_table, imu_table

from recon.recording import Recording
from recon.tables import with_meta

SECOND = 10**9


def test_a_recording_is_a_mapping_that_nobody_changes():
    streams = {"imu": imu_table()}
    recording = Recording(streams, {"sources": ["a.txt"]})
    streams["gnss"] = gnss_table()
    assert list(recording) == ["imu"]
    with pytest.raises(TypeError):
        recording.streams["gnss"] = gnss_table()
    updated = recording.updated({"imu": imu_table(2), "gnss": gnss_table()})
    assert (recording["imu"].num_rows, updated["imu"].num_rows, list(updated)) == (4, 2, ["imu", "gnss"])
    assert updated.meta == recording.meta


def test_a_recording_pickles_with_all_metadata():
    recording = Recording({"imu": with_meta(imu_table(), anchor={"lat": 44.5})}, {"sources": ["a.txt"]})
    again = pickle.loads(pickle.dumps(recording))
    assert again == recording
    assert again["imu"].schema.equals(recording["imu"].schema, check_metadata=True)
    assert again.meta == recording.meta


def test_the_span_covers_all_streams_and_is_none_without_rows():
    recording = Recording({"imu": imu_table(2, START_NS + SECOND), "gnss": gnss_table(2), "mag": imu_table(0)})
    assert recording.span_ns() == (START_NS, START_NS + SECOND + STEP_NS)
    assert Recording({"imu": imu_table(0)}).span_ns() is None


def test_html_escapes_names():
    assert "&lt;b&gt;" in Recording({"<b>": imu_table()})._repr_html_()


def test_it_is_printed_in_a_line():
    found = repr(Recording({"imu": imu_table()}))
    assert found.startswith("Recording(imu: ")
    assert "\n" not in found
