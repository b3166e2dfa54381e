"""Files for people in a seal: made again where their exporter repeats itself, else named."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest
from forged_seals import contents_of, forge

from recon import api, evidence
from recon.cli import main
from recon.errors import Difference
from recon.overrides import Override
from recon.registry import Registry
from recon.stages import Exporter

PAGE = "exports/report/report.html"
TOLD = "exports/report/export.json"
OF_CSV = "exports/csv/export.json"


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


def drawn(*, folder, about, params):
    """An exporter that gives other bytes each time."""
    (folder / "lot.txt").write_text(os.urandom(8).hex())
    return [folder / "lot.txt"]


def test_an_exporter_that_never_repeats_itself_is_named_and_its_files_are_sealed(place, tmp_path):
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
    registry = Registry.installed().with_records(Exporter(name="lot", summary="A lot.", run=drawn))
    run = Path(shutil.copytree(place / "run", tmp_path / "run"))
    api.export(api.open(run), ["lot"], registry)
    with pytest.raises(Difference, match=r"not sealed, .* exports/lot/lot\.txt does not follow from the results"):
        evidence.seal(run, tmp_path / "with.zip", exports=True, registry=registry)
    assert not (tmp_path / "with.zip").exists()
