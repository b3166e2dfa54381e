"""Each law of what a stage says of itself, broken by a stage that is right in everything else."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa
import pytest
from broken_laws import broken_laws
from plugin_files import install

from recon import IMU, SAME, Change, Column, Filter, Params, Registry, Schema, quantity, replace, setting
from recon.schema import Need


def keep(*, imu: pa.Table, params: Params) -> dict[str, pa.Table]:
    return {"imu": imu}


def with_jerk(*, imu: pa.Table, params: Params) -> dict[str, pa.Table]:
    return {"imu": replace(imu, jerk=pa.array([0.0] * imu.num_rows))}


def in_degrees(*, imu: pa.Table, gnss: pa.Table | None, params: Params) -> dict[str, pa.Table]:
    return {"imu": imu}


class Silent(Params):
    width: float = quantity(1.0, "s", doc="")


class UnitInName(Params):
    cutoff_hz: float = setting(12.0, doc="Frequency at which the gain is one half.")


class UnitInDoc(Params):
    cutoff: float = setting(12.0, doc="Frequency in Hz at which the gain is one half.")


class WrongDefault(Params):
    order: int = setting(0, gt=0, doc="Order of the filter.")


class Blob(Params):
    mask: bytes = setting(b"x", doc="No YAML holds bytes.")


def stage(run=keep, **declared) -> Filter:
    return Filter(
        **{
            "name": "keep",
            "summary": "Keeps what it is given.",
            "run": run,
            "reads": {"imu": IMU.need("accel", "gyro")},
            "writes": {"imu": SAME},
            **declared,
        }
    )


def test_a_right_stage_breaks_no_law():
    assert broken_laws(stage()) == {}


def jerk_in(unit: str) -> Filter:
    return stage(with_jerk, writes={"imu": Change(adds=(Column("jerk", unit),))})


@pytest.mark.parametrize("unit", ["m/s^3", "", "cd"])
def test_a_column_in_si_or_in_a_unit_that_recon_does_not_know_breaks_no_law(unit: str):
    assert broken_laws(jerk_in(unit)) == {}


@pytest.mark.parametrize(
    ("wrong", "law", "words"),
    [
        (stage(summary="Keeps\nit."), "summary_is_one_sentence", "the summary must be one sentence"),
        (stage(summary="Keeps it"), "summary_is_one_sentence", "with its full stop: 'Keeps it'"),
        (stage(params=Silent), "parameters_have_docs_and_units", "'width' says nothing of itself"),
        (stage(params=UnitInName), "parameters_have_docs_and_units", "'cutoff_hz' names its unit, hz, in words"),
        (stage(params=UnitInDoc), "parameters_have_docs_and_units", "'cutoff' names its unit, Hz, in words"),
        (stage(params=Blob), "parameters_survive_yaml", "cannot be written as YAML: YAML cannot hold b'x'"),
        (jerk_in("km/h/s"), "canonical_columns_have_canonical_units", "imu.jerk is declared in km/h/s; it must be in"),
        (
            stage(
                in_degrees, reads={"imu": IMU.need("accel"), "gnss": Need((Column("speed", "km/h"),), optional=True)}
            ),
            "canonical_columns_have_canonical_units",
            "gnss.speed is declared in km/h; it must be in m/s",
        ),
        (stage(lambda *, imu, params: {"imu": imu}), "it_can_be_sent_to_another_process", "must stand at the top"),
    ],
)
def test_a_wrong_declaration_breaks_its_law(wrong: Filter, law: str, words: str):
    broken = broken_laws(wrong)
    assert words in broken[law]


def test_a_default_outside_its_limits_breaks_its_law():
    broken = broken_laws(stage(params=WrongDefault))
    assert broken.keys() == {"defaults_are_valid", "parameters_survive_yaml"}
    assert (
        "a default is refused when it is written out: filter.keep: order: must be greater than 0"
        in (broken["defaults_are_valid"])
    )


MODULE = """
import {package}
from recon import IMU, SAME, Filter, hookimpl

def keep(*, imu, params):
    return {{"imu": imu}}

def made(name):
    return Filter(name=name, summary="Keeps.", run=keep, reads={{"imu": IMU.need("accel")}}, writes={{"imu": SAME}})

@hookimpl
def declare_filters():
    yield from map(made, {names})
"""


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    sys.modules.pop("strange_filters", None)


def installed(folder: Path, package: str, *names: str) -> Registry:
    module = MODULE.format(package=package, names=names)
    install(folder, "strange", modules={"strange_filters.py": module}, points={"filter.keep": "strange_filters"})
    return Registry.installed()


def test_an_installed_stage_breaks_no_law(plugin: Path):
    assert broken_laws("filter.keep", registry=installed(plugin, "numpy", "keep")) == {}


def test_a_stage_without_an_entry_point_breaks_its_law(plugin: Path):
    broken = broken_laws("filter.keep", registry=installed(plugin, "numpy", "keep", "lost"))
    assert broken.keys() == {"name_equals_entry_point"}
    assert "strange_filters declares filter.lost, which no entry point names" in broken["name_equals_entry_point"]


def test_a_heavy_import_breaks_its_law(plugin: Path):
    broken = broken_laws("filter.keep", registry=installed(plugin, "scipy.signal", "keep"))
    assert broken.keys() == {"import_loads_no_heavy_package"}
    assert "loads scipy.signal: import it inside the function" in broken["import_loads_no_heavy_package"]


def test_a_module_that_needs_what_is_not_there_breaks_its_law(plugin: Path):
    registry = installed(plugin, "numpy", "keep")
    registry.get("filter.keep")
    (plugin / "strange_filters.py").write_text("import no_such_package", encoding="utf-8")
    broken = broken_laws("filter.keep", registry=registry)
    assert "cannot be imported in a fresh process" in broken["import_loads_no_heavy_package"]


def test_a_schema_of_an_own_stream_is_held_to_si():
    own = Schema((IMU["time"], Column("heat", "degC")))
    assert "heat" in broken_laws(stage(writes={"imu": SAME, "heat": own}))["canonical_columns_have_canonical_units"]
