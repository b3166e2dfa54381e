"""The reader of tables in the framework: its record, what it claims, what `recon inspect` proposes."""

from __future__ import annotations

from pathlib import Path

import pytest
from csv_logs import BOTH, IMU, ROWS, drive, params_of, read_text

import recon
from recon.check import check
from recon.cli import main
from recon.errors import DataError, ReadFailed, UnknownFormat
from recon.overrides import Override
from recon.pipeline import Pipeline
from recon.registry import Registry
from recon.tables import conform
from recon.yaml_nodes import load
from recon_readers.csv import declare_readers, sniff


def test_the_record_keeps_the_rules_of_its_role(tmp_path: Path) -> None:
    (reader,) = declare_readers()
    assert reader.faults() == []
    planned = reader.outputs({}, params_of(BOTH))
    for name, table in read_text(tmp_path, drive(), BOTH).items():
        assert conform(table, planned[name], stream=name, step="reader").num_rows == table.num_rows


def test_a_sensor_that_the_mapping_lacks_is_missed_before_any_file_is_read() -> None:
    mapping = load(IMU, "m.yaml").plain()
    override = Override.from_data("reader.csv.columns", mapping)
    _, problems = check(Pipeline.of("p", "reader.csv", "filter.gyro_offset"), Registry.installed(), [override])
    assert any("gyro" in problem.text for problem in problems)


@pytest.mark.parametrize("text", [ROWS, drive(), ROWS.partition("\n")[2]])
def test_no_text_is_claimed_for_sure(tmp_path: Path, text: str) -> None:
    found = sniff(tmp_path / "log.csv", text.encode())
    assert 0 < found.confidence < 0.5
    assert f"recon inspect {tmp_path / 'log.csv'}" in found.reason


@pytest.mark.parametrize("head", [b"", b"\x89MCAP0\r\n", b'{"a": 1}\n', b"hello\n", bytes(range(256))])
def test_what_is_no_delimited_text_is_disclaimed(tmp_path: Path, head: bytes) -> None:
    assert sniff(tmp_path / "log.csv", head).confidence == 0


def test_a_header_without_rows_is_told_by_this_reader_alone(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,ax,ay,az\n")
    with pytest.raises(ReadFailed) as caught:
        recon.read(path)
    reason, advice = caught.value.hint.splitlines()
    assert reason == "reader.csv: it holds a line of words, perhaps a header, and no row of numbers"
    assert advice.strip().startswith("check that it is the right file")


def test_auto_declines_an_unknown_text_and_takes_it_with_a_mapping(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(drive(), encoding="utf-8")
    with pytest.raises(UnknownFormat, match=rf"recon inspect \S*{path.name} > mapping.yaml' proposes"):
        recon.read(path)
    mapping = load(BOTH, "m.yaml").plain()
    assert recon.read(path, **{"reader.csv.columns": mapping})["imu"].num_rows == 400


def test_inspect_proposes_a_mapping_that_reads_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text(drive(), encoding="utf-8")
    assert main(["inspect", "log.csv"]) == 0
    proposed = capsys.readouterr().out
    assert "--set reader.csv.columns=@mapping.yaml" in proposed
    Path("mapping.yaml").write_text(proposed, encoding="utf-8")
    assert main(["inspect", "log.csv", "--set", "reader.csv.columns=@mapping.yaml"]) == 0
    shown = capsys.readouterr().out
    assert "imu: 400 rows" in shown
    assert "gnss: 20 rows" in shown
    assert "ax, ay, az, in m/s^2" in shown


def test_inspect_still_refuses_what_nobody_knows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "noise.bin").write_bytes(bytes(range(256)))
    assert main(["inspect", str(tmp_path / "noise.bin")]) == DataError.exit_code
    assert "no reader knows this file" in capsys.readouterr().err
