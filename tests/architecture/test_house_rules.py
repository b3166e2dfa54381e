"""The rules that keep the code one piece, read off its syntax trees and its metadata."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PLUGINS = ROOT / "plugins"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
POINTS = {
    name: module
    for name, module in PROJECT["project"]["entry-points"]["recon.plugins"].items()
    if not name.startswith("pipeline.")
}
SOURCES = sorted([*(ROOT / "recon").rglob("*.py"), *PLUGINS.rglob("*.py")])

SLOW = (
    "scipy.signal",
    "scipy.ndimage",
    "scipy.optimize",
    "mcap_ros2",
    "mcap_protobuf",
    "pyquaternion",
    "typer",
    "rich",
)
"""Imports above 50 ms, and those that only the command line needs."""

POSIX_ONLY = ("fcntl", "resource", "pwd", "grp", "termios", "tty", "pty")
POSIX_NAMES = ("fork", "getuid", "geteuid", "setsid", "killpg", "SIGKILL", "SIGHUP", "SIGALRM", "sysconf", "mkfifo")
POSIX_PATHS = re.compile(r"/(tmp|dev|proc|etc|usr|var|home|root|opt)(/|$)")
UNSAFE = ("eval", "exec", "compile", "__import__")


def module_of(path: Path) -> str:
    base = PLUGINS if path.is_relative_to(PLUGINS) else ROOT
    parts = path.relative_to(base).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def text_lines(path: Path) -> list[str]:
    return path.read_text(encoding="utf-8").splitlines()


def imports(path: Path) -> Iterator[tuple[int, str]]:
    """Line and full name of all that a file imports, wherever in it; `from a import b` counts as a and as a.b."""
    package = module_of(path) if path.name == "__init__.py" else module_of(path).rpartition(".")[0]
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            home = ".".join([*above, *([node.module] if node.module else [])])
            yield node.lineno, home
            yield from ((node.lineno, f"{home}.{alias.name}") for alias in node.names)


def inside(name: str, package: str) -> bool:
    return name == package or name.startswith(f"{package}.")


def found(path: Path, line: int, what: str) -> str:
    return f"{path.relative_to(ROOT).as_posix()}:{line}: {what}"


def wrong_imports(path: Path) -> list[str]:
    """Imports against the direction of the architecture."""
    own = module_of(path)
    package = own.partition(".")[0]
    wrong = []
    for line, name in imports(path):
        other = name.partition(".")[0]
        ours = other == "recon" or other.startswith("recon_")
        forbidden = (
            (inside(own, "recon.numerics") and ours and not inside(name, "recon.numerics"))
            or (package == "recon" and other.startswith("recon_"))
            or (package.startswith("recon_") and ours and other not in (package, "recon"))
            or (inside(name, "recon.testing") and not inside(own, "recon.testing"))
            or (package.startswith("recon_") and other == "recon" and re.search(r"\._[^_]", name))
            or (inside(name, "recon.cli") and not inside(own, "recon.cli") and own != "recon.__main__")
        )
        if forbidden:
            wrong.append(found(path, line, name))
    return wrong


def test_imports_point_one_way():
    assert [line for path in SOURCES for line in wrong_imports(path)] == []


@pytest.mark.parametrize(
    ("file", "text", "right"),
    [
        ("recon/numerics/a.py", "from recon.numerics import b", True),
        ("recon/numerics/a.py", "from . import b", True),
        ("recon/numerics/a.py", "from recon.schema import IMU", False),
        ("recon/numerics/a.py", "from .. import schema", False),
        ("recon/check.py", "def f():\n    import recon_filters.resample", False),
        ("recon/check.py", "from recon.testing import laws", False),
        ("recon/check.py", "from recon.cli import run", False),
        ("recon/testing/drives.py", "from recon.testing import laws", True),
        ("plugins/recon_filters/a.py", "from recon import IMU, __version__", True),
        ("plugins/recon_filters/a.py", "from recon_filters import _b", True),
        ("plugins/recon_filters/a.py", "from recon_fusers import b", False),
        ("plugins/recon_filters/a.py", "from recon.tables import _stamp", False),
    ],
)
def test_the_search_for_wrong_imports_finds_what_it_should(file, text, right, tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    monkeypatch.setattr(sys.modules[__name__], "PLUGINS", tmp_path / "plugins")
    path = tmp_path / file
    path.parent.mkdir(parents=True)
    path.write_text(text, encoding="utf-8")
    assert (wrong_imports(path) == []) is right


def calls_of(path: Path, *names: str) -> list[str]:
    return [
        found(path, node.lineno, node.func.id)
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in names
    ]


def test_only_the_command_line_prints_and_logs():
    quiet = [path for path in SOURCES if not inside(module_of(path), "recon.cli")]
    printed = [line for path in quiet for line in calls_of(path, "print", "input", "breakpoint")]
    logged = [found(path, line, name) for path in quiet for line, name in imports(path) if inside(name, "logging")]
    streams = [
        found(path, node.lineno, f"sys.{node.attr}")
        for path in quiet
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.Attribute) and node.attr in ("stdout", "stderr") and ast.unparse(node.value) == "sys"
    ]
    assert printed + logged + streams == []


def test_nothing_runs_text_or_bytes_as_code():
    called = [line for path in SOURCES for line in calls_of(path, *UNSAFE)]
    unsafe = ("pickle", "shelve", "marshal", "dill", "cloudpickle")
    imported = [
        found(path, line, name) for path in SOURCES for line, name in imports(path) if name.partition(".")[0] in unsafe
    ]
    assert called + imported == []


def guarded_lines(path: Path) -> set[int]:
    """Lines that only one kind of system reaches: under an if that asks for it, or in a try."""
    lines: set[int] = set()
    for node in ast.walk(tree_of(path)):
        asks = isinstance(node, ast.If) and re.search(r"sys\.platform|os\.name|hasattr", ast.unparse(node.test))
        if asks or isinstance(node, ast.Try):
            lines.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return lines


def posix_uses(path: Path) -> Iterator[tuple[int, str]]:
    for line, name in imports(path):
        if name.partition(".")[0] in POSIX_ONLY:
            yield line, name
    docstrings = {id(node.value) for node in ast.walk(tree_of(path)) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Attribute) and node.attr in POSIX_NAMES:
            yield node.lineno, ast.unparse(node)
        elif isinstance(node, ast.Constant) and id(node) not in docstrings and POSIX_PATHS.match(str(node.value)):
            yield node.lineno, repr(node.value)


def test_nothing_needs_posix():
    unguarded = [
        found(path, line, what)
        for path in SOURCES
        for line, what in posix_uses(path)
        if line not in guarded_lines(path)
    ]
    assert unguarded == []


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("import fcntl", 1),
        ("import os\nos.fork()", 1),
        ("import signal\nsignal.SIGKILL", 1),
        ("x = '/tmp/x'", 1),
        ("'/tmp/x is only told of'", 0),
        ("x = 'm/tmp'", 0),
        ("try:\n    import resource\nexcept ImportError:\n    resource = None", 0),
        ("import sys, os\nif sys.platform != 'win32':\n    os.getuid()", 0),
    ],
)
def test_the_search_for_posix_finds_what_it_should(text, count, tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    path = tmp_path / "sample.py"
    path.write_text(text, encoding="utf-8")
    assert sum(line not in guarded_lines(path) for line, _ in posix_uses(path)) == count


def test_modules_are_run_without_those_of_the_working_folder():
    """`python -m` looks there first: a numpy.py beside a log, or beside a seal, would be run. -P forbids it."""
    commands = [
        (found(path, node.lineno, ast.unparse(node)), {ast.unparse(part) for part in node.elts})
        for path in SOURCES
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.List)
    ]
    modules = [(place, words) for place, words in commands if {"sys.executable", "'-m'"} <= words]
    assert modules
    assert [place for place, words in modules if "'-P'" not in words] == []


def test_text_files_are_opened_with_their_encoding_and_ends_of_lines():
    """The defaults are others on Windows: a manifest of other bytes there has another hash."""
    bare = []
    for path in SOURCES:
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute | ast.Name):
                name = node.func.attr if isinstance(node.func, ast.Attribute) else node.func.id
                given = {keyword.arg for keyword in node.keywords}
                wanted = {"read_text": {"encoding"}, "write_text": {"encoding", "newline"}}
                if not wanted.get(name, set()) <= given:
                    bare.append(found(path, node.lineno, name))
    assert bare == []


def test_no_work_is_left_lying_about():
    marks = re.compile(r"\b(TODO|FIXME|XXX|HACK|NotImplementedError)\b")
    left = [
        found(path, number, line.strip())
        for path in SOURCES
        for number, line in enumerate(text_lines(path), start=1)
        if marks.search(line)
    ]
    assert left == []


def test_files_and_functions_can_be_read_without_scrolling_far():
    """The aim is 300 lines for a file, 40 for a function, 60 in numerics; beyond these limits something has to part."""
    long = [found(path, 1, f"{lines} lines") for path in SOURCES if (lines := len(text_lines(path))) > 340]
    long += [
        found(path, node.lineno, f"{node.name} has {lines} lines")
        for path in SOURCES
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.FunctionDef) and (lines := (node.end_lineno or 0) - node.lineno + 1) > 60
    ]
    assert long == []


# --- packaging ------------------------------------------------------------------------------------------------------


def stage_modules() -> set[str]:
    """Modules of the first-party plugins that declare something."""
    return {
        module_of(path)
        for path in PLUGINS.glob("recon_*/*.py")
        if not path.name.startswith("_")
        and any(isinstance(node, ast.FunctionDef) and node.name.startswith("declare_") for node in tree_of(path).body)
    }


def test_every_module_that_declares_a_stage_is_an_entry_point():
    assert stage_modules() == set(POINTS.values())


@pytest.mark.parametrize(("name", "module"), POINTS.items())
def test_every_entry_point_is_declared_by_its_module(name, module):
    role, _, stage = name.partition(".")
    assert module == f"recon_{role}s.{stage}"
    path = PLUGINS.joinpath(*module.split(".")).with_suffix(".py")
    declared = [node.name for node in tree_of(path).body if isinstance(node, ast.FunctionDef)]
    assert f"declare_{role}s" in declared


@pytest.mark.parametrize("name", POINTS)
def test_every_installed_stage_can_be_used(name):
    from recon.registry import Registry

    registry = Registry.installed()
    assert registry.get(name).key == name
    assert registry.source(name).distribution == "recon-dynamics"


def test_every_stage_and_parameter_says_what_it_is():
    from recon.registry import Registry

    registry = Registry.installed()
    silent = []
    for name in POINTS:
        stage = registry.get(name)
        if not stage.summary.endswith("."):
            silent.append(name)
        silent += [f"{name}: {info.name}" for info in stage.params.describe() if not info.doc]
    assert silent == []


def test_defaults_keep_the_limits_of_their_parameters():
    from recon.parameters import bind
    from recon.problems import Where
    from recon.registry import Registry
    from recon.yaml_nodes import Node

    registry = Registry.installed()
    for name in POINTS:
        stage = registry.get(name)
        if all(not info.is_required() for info in stage.params.model_fields.values()):
            node = Node.of(stage.params().as_text(), Where(name))
            assert bind(stage.params, node, name) == (stage.params(), [])


def test_the_wheel_holds_every_plugin_package():
    packages = {f"plugins/{path.name}" for path in PLUGINS.iterdir() if path.name.startswith("recon_")}
    assert set(PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]) == {"recon", *packages}
    assert all((ROOT / package / "__init__.py").is_file() for package in packages)


def test_plugin_folders_hold_packages_of_known_roles():
    from recon.stages import ROLES

    assert {path.name for path in PLUGINS.glob("recon_*")} <= {f"recon_{role}s" for role in ROLES}


# --- start-up -------------------------------------------------------------------------------------------------------


def loaded_by(code: str) -> set[str]:
    """Modules that a fresh interpreter has loaded after the code."""
    script = f"{code}\nimport sys\nsys.stdout.write(' '.join(sys.modules))"
    run = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True, cwd=ROOT.parent)
    return set(run.stdout.split())


def test_slow_imports_are_made_when_they_are_used():
    loaded = loaded_by("\n".join(f"import {module}" for module in {*POINTS.values(), "recon.api", "recon.batch"}))
    assert {name for name in loaded if any(inside(name, slow) for slow in SLOW)} == set()


def test_the_name_alone_loads_nothing():
    assert not {"numpy", "pyarrow", "pydantic", "yaml", "pluggy"} & loaded_by("import recon")


def test_a_check_imports_only_the_stages_that_it_uses():
    code = (
        "from recon.check import check\n"
        "from recon.pipeline import Pipeline\n"
        "from recon.registry import Registry\n"
        "check(Pipeline.of('p', 'reader.physycom', 'filter.moving_average'), Registry.installed())"
    )
    stages = loaded_by(code) & set(POINTS.values())
    assert stages == {"recon_readers.physycom", "recon_filters.moving_average"}
