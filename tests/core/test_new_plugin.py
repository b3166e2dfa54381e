"""`recon new-plugin`: each template installs, is listed, keeps its laws; broken, it is told what is wrong in words."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import pytest
from plugin_files import install

from recon.cli import main
from recon.stages import ROLES

ALL = list(ROLES)


def python(*arguments: str, cwd: Path, site: Path) -> subprocess.CompletedProcess[str]:
    """Another process that finds what is installed in a folder."""
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), *filter(None, sys.path)])}
    return subprocess.run(
        [sys.executable, *arguments], cwd=cwd, env=env, capture_output=True, text=True, encoding="utf-8", check=False
    )


def laws(*folders: str, cwd: Path, site: Path, only: Iterable[str] = ()) -> dict[str, dict[str, str]]:
    """What pytest tells of each stage: by stage, for each law the message of its failure, "" where it holds.

    only : names of laws, where not all are of interest
    """
    report = cwd / "report.xml"
    options = ["-p", "no:cacheprovider", f"--junitxml={report}", "-k", " or ".join(only)]
    done = python("-m", "pytest", *options, *folders, cwd=cwd, site=site)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    told: dict[str, dict[str, str]] = {}
    for case in ElementTree.parse(report).iter("testcase"):
        stage, _, law = case.attrib["name"].partition("[")[2].removesuffix("]").rpartition("-")
        failures = [found.attrib["message"] for found in case if found.tag in ("failure", "error", "skipped")]
        told.setdefault(stage, {})[law] = "".join(failures)
    return told


# --- as it is generated ---------------------------------------------------------------------------------------------


class Made(NamedTuple):
    """Where the new plugins are, where they are installed, and what their tests gave."""

    folder: Path
    site: Path
    told: Mapping[str, Mapping[str, str]]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """A plugin of every role, installed by pip, its tests run."""
    folder = tmp_path_factory.mktemp("plugins")
    places = [folder / f"recon-my_{role}" for role in ALL]
    for role, place in zip(ALL, places, strict=True):
        assert main(["new-plugin", role, f"my_{role}", "--dir", str(place)]) == 0
    site = folder / "site"
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "install"]
    offline = ["--no-deps", "--no-build-isolation", "--target", str(site)]
    subprocess.run([*pip, *offline, *map(str, places)], check=True)
    told = laws(*(place.name for place in places), cwd=folder, site=site)
    return Made(folder, site, told)


def test_every_role_has_a_template(made: Made) -> None:
    assert set(made.told) == {f"{role}.my_{role}" for role in ALL}


def test_what_is_installed_is_listed(made: Made) -> None:
    listed = python("-m", "recon", "plugins", cwd=made.folder, site=made.site).stdout
    for role in ALL:
        (line,) = [line for line in listed.splitlines() if line.startswith(f"{role}.my_{role} ")]
        assert f" recon-my_{role} 0.1.0 " in line
        assert "BROKEN" not in line


@pytest.mark.parametrize("role", ALL)
def test_its_tests_pass_unmodified(made: Made, role: str) -> None:
    found = made.told[f"{role}.my_{role}"]
    assert len(found) > 10
    assert {law: message for law, message in found.items() if message} == {}


@pytest.mark.parametrize("time", ["1e30", "9e999999", "-1e30", "nan", "inf"])
def test_the_reader_of_the_template_refuses_times_beyond_any_clock(tmp_path: Path, time: str) -> None:
    from recon.errors import ReadFailed
    from recon.templates.plugin.reader import HEADER, ReadParams, read

    log = tmp_path / "log.txt"
    log.write_text("\n".join([*HEADER, f"{time},36.5", ""]), encoding="utf-8")
    with pytest.raises(ReadFailed, match="is not a time and a speed"):
        read(path=log, params=ReadParams())


@pytest.mark.parametrize("role", ALL)
def test_what_is_generated_has_no_placeholder_left(made: Made, role: str) -> None:
    for path in (made.folder / f"recon-my_{role}").rglob("*"):
        assert path.is_dir() or path.suffix == ".pyc" or "$" not in path.read_text(encoding="utf-8"), path


def test_it_asks_for_this_recon_or_a_newer_one(made: Made) -> None:
    project = tomllib.loads((made.folder / "recon-my_filter" / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["dependencies"] == ["recon-dynamics>=0.1.0"]


# --- refusals -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("role", "name", "message"),
    [
        ("filter", "Lowpass", "'Lowpass' cannot be the name of a stage; write a word of lower-case letters"),
        ("filter", "low-pass", "'low-pass' cannot be the name of a stage"),
        ("filter", "2nd", "'2nd' cannot be the name of a stage"),
        ("filter", "../evil", "'../evil' cannot be the name of a stage"),
        ("filter", "class", "'class' cannot be the name of a stage"),
        ("filter", "resample", "there is a stage 'filter.resample' already, of recon-dynamics 0.1.0; choose another"),
        ("filter", "filters", "there is a module 'recon_filters' already; choose another name"),
        ("fliter", "mine", "there is no template of the role 'fliter'; did you mean 'filter'?"),
    ],
)
def test_a_role_or_name_that_cannot_be_is_refused_in_a_sentence(
    role: str, name: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new-plugin", role, name]) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_there_is_left_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new-plugin", "filter", "mine"]) == 0
    (tmp_path / "recon-mine" / "recon_mine.py").write_text("edited", encoding="utf-8")
    assert main(["new-plugin", "filter", "mine"]) == 2
    assert capsys.readouterr().err == "error: recon-mine is there already; name another place with --dir\n"
    assert (tmp_path / "recon-mine" / "recon_mine.py").read_text(encoding="utf-8") == "edited"
    assert [path.name for path in tmp_path.iterdir()] == ["recon-mine"]


# --- broken ---------------------------------------------------------------------------------------------------------


class Break(NamedTuple):
    """A mistake that an author may make: what stands in the template, what in its place, which law tells it how."""

    role: str
    kind: str
    text: str
    wrong: str
    law: str
    message: str


BREAKS = [
    Break(
        "reader",
        "backward_times",
        "time=t_ns,",
        "time=t_ns[::-1].copy(),",
        "times_rise",
        "stream 'gnss': time does not rise at row 1",
    ),
    Break(
        "reader",
        "wrong_unit",
        'writes={"gnss": GNSS.only("speed")}',
        'writes={"gnss": type(GNSS)((GNSS["time"], type(GNSS["time"])("speed", unit="km/h")))}',
        "canonical_columns_have_canonical_units",
        "gnss.speed is declared in km/h; it must be in m/s",
    ),
    Break(
        "simulator",
        "wrong_unit",
        "zero, zero, rate * one",
        "zero, zero, np.degrees(rate) * one",
        "the_truth_is_the_integral_of_its_rates",
        "the attitude changes by [0.    0.    0.004], but the integral of the angular rate is ",
    ),
    Break(
        "filter",
        "mutates_input",
        "    share =",
        '    imu["accel_x"].chunk(0).to_numpy()[0] = 0.0\n    share =',
        "inputs_stay_unchanged",
        "it writes into its input",
    ),
    Break(
        "filter",
        "forgets_column",
        'for group in ("accel", "gyro")})}',
        'for group in ("accel", "gyro")}).drop_columns("gyro_z")}',
        "output_matches_plan",
        "did not return ['gyro_z'], which it declares",
    ),
    Break(
        "detector",
        "raises_on_one_row",
        "runs(speed > params.limit)",
        "runs(speed > params.limit + speed[1])",
        "one_row_gives_a_result_or_a_data_error",
        "'gnss' of one row raised step detector.raises_on_one_row_detector: IndexError",
    ),
    Break(
        "aligner",
        "forgets_column",
        ', gyro=rotate(rot_ls, matrix(imu, "gyro"))',
        "",
        "turned_vectors_keep_their_angles",
        "imu.accel and imu.gyro were not turned by one rotation",
    ),
    Break(
        "integrator",
        "wrong_unit",
        'gyro = matrix(imu, "gyro")',
        'gyro = np.degrees(matrix(imu, "gyro"))',
        "the_error_falls_with_the_order_when_the_step_is_halved",
        "order 2 is declared",
    ),
    Break(
        "fuser",
        "backward_times",
        "replace(trajectory, pos=moved",
        "replace(trajectory.take(np.arange(len(t_s))[::-1]), pos=moved",
        "times_rise",
        "stream 'trajectory': time does not rise at row 1",
    ),
    Break(
        "fuser",
        "wrong_unit",
        "pos_std=np.hypot(",
        "pos_std=100.0 * np.hypot(",
        "the_error_is_as_large_as_its_sigma_says",
        "the error of pos_e is 0.02 times its sigma",
    ),
    Break(
        "analyzer",
        "raises_on_one_row",
        "speed.max()",
        "speed[1:].max()",
        "one_row_gives_a_result_or_a_data_error",
        "'trajectory' of one row raised step analyzer.raises_on_one_row_analyzer: ValueError",
    ),
    Break(
        "exporter",
        "wrong_unit",
        'matrix(trajectory, "pos", gaps=True)',
        'matrix(trajectory, "pos", gaps=True) / 1e3',
        "files_read_back_to_the_same_numbers",
        "trajectory.pos_e reads back with another value in row 1: ",
    ),
]


@pytest.fixture(scope="module")
def told_of_broken(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Mapping[str, str]]:
    """What the laws tell of all broken plugins, by stage."""
    folder = tmp_path_factory.mktemp("broken")
    names = []
    for broken in BREAKS:
        name = f"{broken.kind}_{broken.role}"
        place = folder / f"recon-{name}"
        assert main(["new-plugin", broken.role, name, "--dir", str(place)]) == 0
        text = (place / f"recon_{name}.py").read_text(encoding="utf-8")
        assert text.count(broken.text) == 1, f"the template of {broken.role} has changed"
        module = {f"recon_{name}.py": text.replace(broken.text, broken.wrong)}
        install(folder / "site", place.name, modules=module, points={f"{broken.role}.{name}": f"recon_{name}"})
        names.append(place.name)
    return laws(*names, cwd=folder, site=folder / "site", only={broken.law for broken in BREAKS})


@pytest.mark.parametrize("broken", BREAKS, ids=lambda broken: f"{broken.role}-{broken.kind}")
def test_a_mistake_breaks_a_law_that_says_what_is_wrong(broken: Break, told_of_broken) -> None:
    found = told_of_broken[f"{broken.role}.{broken.kind}_{broken.role}"]
    assert broken.message in found[broken.law]
