"""`recon new-plugin`: a distribution of one stage, with its test, for its author to edit.

The files lie in recon/templates/plugin. A stage's module there is Python that runs, so that whatever is asked of the
code of recon is asked of it too; the placeholders are those of string.Template.
"""

from __future__ import annotations

import keyword
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from recon import __version__
from recon.cli import _console as console
from recon.cli._options import bad_option
from recon.problems import did_you_mean, one_of

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

_NAME: Final = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")


def new_plugin(
    role: Annotated[str, typer.Argument(metavar="ROLE", help="reader, filter, detector, ...")],
    name: Annotated[str, typer.Argument(metavar="NAME", help="Of lower-case letters, digits and _.")],
    folder: Annotated[
        Path | None, typer.Option("--dir", metavar="DIR", help="The new folder; by default recon-NAME.")
    ] = None,
) -> None:
    """Begin a plugin: a folder to install, with a stage that works and a test of its laws.

    Example: recon new-plugin filter lowpass
    """
    from recon.storage import staged_folder

    _check_role(role)
    _check_name(role, name)
    target = folder or Path(f"recon-{name}")
    if target.exists():
        raise bad_option(f"{target} is there already", "name another place with --dir")
    with staged_folder(target) as place:
        for path, text in _files(role, name).items():
            file = place / path
            file.parent.mkdir(exist_ok=True)
            file.write_text(text, encoding="utf-8", newline="\n")
    further = [
        (f'pip install -e "{target}[test]"', "install it; what you edit then counts at once"),
        (f"recon plugins show {role}.{name}", "what it takes, reads and writes"),
        (f"pytest {target}", "hold it to the laws of its role"),
    ]
    console.write("\n".join([f"{target}: {role}.{name}, edit recon_{name}.py", "", "next", console.table(further)]))


def _files(role: str, name: str) -> dict[str, str]:
    """The new files, text by path."""
    from string import Template

    module = f"recon_{name}"
    own_test = f"test_{role}.py.in"
    templates = {
        "pyproject.toml": "pyproject.toml.in",
        "README.md": "README.md.in",
        f"{module}.py": f"{role}.py",
        f"tests/test_{name}.py": own_test if _template(own_test).is_file() else "test_contract.py.in",
    }
    if role == "reader":
        templates["tests/sample.txt"] = "sample.txt.in"
    values = {"role": role, "name": name, "module": module, "distribution": f"recon-{name}", "recon": __version__}
    return {
        path: Template(_template(file).read_text(encoding="utf-8")).substitute(values)
        for path, file in templates.items()
    }


def _template(file: str) -> Traversable:
    from importlib.resources import files

    return files("recon").joinpath("templates", "plugin", file)


def _check_role(role: str) -> None:
    from recon.stages import ROLES

    known = [known for known in ROLES if _template(f"{known}.py").is_file()]
    if role not in known:
        meant = "" if role in ROLES else did_you_mean(role, known)
        raise bad_option(f"there is no template of the role '{role}'", meant or f"there are {one_of(known)}")


def _check_name(role: str, name: str) -> None:
    """Raises ConfigError for a name that is no name, or is taken."""
    from importlib.util import find_spec

    from recon.registry import Registry

    if not _NAME.fullmatch(name) or keyword.iskeyword(name):
        wanted = "write a word of lower-case letters, digits and _, such as 'my_lowpass'"
        raise bad_option(f"'{name}' cannot be the name of a stage", wanted)
    registry = Registry.installed()
    if f"{role}.{name}" in registry:
        source = registry.source(f"{role}.{name}")
        raise bad_option(f"there is a stage '{role}.{name}' already, of {source}", "choose another name")
    if find_spec(f"recon_{name}") is not None:
        raise bad_option(f"there is a module 'recon_{name}' already", "choose another name")
