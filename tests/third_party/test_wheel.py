"""recon as its users get it: built as a wheel, installed away from the checkout."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def python(*arguments: str, home: Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "PYTHONPATH": str(home)}
    return subprocess.run(
        [sys.executable, "-P", *arguments], cwd=cwd, env=env, capture_output=True, text=True, check=True
    )


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder into which the wheel is installed; its dependencies come from the environment of the tests."""
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "wheel", str(ROOT), "--no-deps", "--wheel-dir", str(folder)], check=True)
    (wheel,) = folder.glob("*.whl")
    subprocess.run([*pip, "install", "--no-deps", "--target", str(folder / "site"), str(wheel)], check=True)
    return folder / "site"


def test_the_wheel_holds_all_stages_and_pipelines(home: Path, tmp_path: Path) -> None:
    code = (
        "import recon; from recon.registry import Registry; from recon.pipeline import shipped;"
        "print(recon.__file__);"
        "registry = Registry.installed();"
        "print(*[registry.get(key).key for key in registry]);"
        "print(*[str(path) for path in shipped().values()])"
    )
    where, stages, pipelines = python("-c", code, home=home, cwd=tmp_path).stdout.splitlines()
    assert where.startswith(str(home))
    assert {"reader.physycom", "fuser.weighted_average", "exporter.csv"} <= set(stages.split())
    assert all(path.startswith(str(home)) for path in pipelines.split())
    assert {Path(path).stem for path in pipelines.split()} == {path.stem for path in ROOT.glob("pipelines/*.yaml")} - {
        "fleet"
    }
    assert {path.name for path in (home / "recon/pipelines").iterdir()} == {p.name for p in ROOT.glob("pipelines/*")}


def test_the_wheel_holds_the_templates_of_new_plugins(home: Path, tmp_path: Path) -> None:
    built, kept = ({path.name for path in (root / "recon/templates/plugin").glob("*.*")} for root in (home, ROOT))
    assert built == kept
    for role in ("filter", "reader", "exporter"):
        done = python("-m", "recon", "new-plugin", role, "mine", "--dir", role, home=home, cwd=tmp_path)
        assert "Traceback" not in done.stderr
        assert {"pyproject.toml", "README.md", "recon_mine.py", "tests"} == {
            p.name for p in (tmp_path / role).iterdir()
        }


def test_the_demo_runs_from_the_wheel(home: Path, tmp_path: Path) -> None:
    done = python("-m", "recon", "demo", "--out", "demo", home=home, cwd=tmp_path)
    assert (tmp_path / "demo" / "best_accuracy" / "manifest.json").is_file()
    assert "Traceback" not in done.stderr


def test_an_installed_recon_makes_its_own_wheel_again(home: Path, tmp_path: Path) -> None:
    """As the extension for Blender needs it: the same files, and pip takes it."""
    code = (
        "from importlib.metadata import distributions; from pathlib import Path;"
        "from recon.own_wheel import from_record;"
        f"(found,) = [d for d in distributions(path=[{str(home)!r}]) if d.name == 'recon-dynamics'];"
        "print(from_record(found, Path()))"
    )
    made = tmp_path / python("-c", code, home=home, cwd=tmp_path).stdout.strip()
    (built,) = home.parent.glob("*.whl")
    assert made.name == built.name
    with zipfile.ZipFile(made) as again, zipfile.ZipFile(built) as first:
        names = {name for name in first.namelist() if not name.endswith("RECORD")}
        assert {name for name in again.namelist() if not name.endswith("RECORD")} == names
        assert all(again.read(name) == first.read(name) for name in names)
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "install", "--no-deps", "--target", str(tmp_path / "site"), str(made)], check=True)
    assert (tmp_path / "site" / "recon" / "pipelines" / "thesis.yaml").is_file()
