"""The extension of Blender as one file to install: recon with all that it needs, as wheels, and a panel.

    recon_dynamics/blender_manifest.toml, __init__.py     what Blender reads; 3.4 reads bl_info
    recon_dynamics/_blender/, _blender_extension/         builder of the scene, panel: modules of recon's own wheel
    recon_dynamics/wheels/                                recon and its requirements, for one platform

The wheel of NumPy is there and not in the manifest: Blender has a NumPy of its own that others in it rely on, and recon
runs beside Blender, in a process that finds the newer one.

Reference: https://docs.blender.org/manual/en/latest/advanced/extensions/
"""

from __future__ import annotations

import tempfile
import zipfile
from pathlib import Path, PurePosixPath
from typing import Final

from recon import __version__
from recon.own_wheel import own_wheel, pip
from recon.storage import staged_file

IDENTITY: Final = "recon_dynamics"
PLATFORMS: Final = {
    "linux-x64": ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux2014_x86_64"),
    "windows-x64": ("win_amd64",),
    "macos-arm64": ("macosx_12_0_arm64",),
}
"""Blender's name of a platform: tags of the wheels that run there."""
BESIDE_BLENDER: Final = ("numpy<2", "pyarrow<26")
"""Blender 5.0 has NumPy 1.26, which newer versions of Arrow refuse."""
PYTHON: Final = "3.11"
"""Of Blender 4.2 to 5.0."""
_PARTS: Final = ("_blender", "_blender_extension")
_MANIFEST: Final = """schema_version = "1.0.0"
id = "{identity}"
version = "{version}"
name = "recon: vehicle motion"
tagline = "Turns the log of a vehicle into an animated scene"
maintainer = "The authors of recon"
type = "add-on"
license = ["SPDX:Apache-2.0"]
blender_version_min = "4.2.0"
blender_version_max = "5.1.0"
platforms = ["{platform}"]
tags = ["Animation", "Import-Export", "Physics"]
wheels = [
{wheels}]

[permissions]
files = "Read logs, write results beside them"
"""
_ROOT: Final = '''"""recon in Blender: a panel in the sidebar of the 3D view, tab "recon"."""

bl_info = {{
    "name": "recon: vehicle motion",
    "description": "Turns the log of a vehicle into an animated scene",
    "author": "The authors of recon",
    "version": {version},
    "blender": (3, 4, 0),
    "location": "3D view, sidebar, tab recon",
    "category": "Animation",
}}

from ._blender_extension import register, unregister

__all__ = ["bl_info", "register", "unregister"]
'''


def build_extension(platform: str, folder: Path) -> Path:
    """Write the zip for a platform of PLATFORMS into the folder; its path.

    Raises PluginError where pip cannot get a wheel, StorageError where the zip cannot be written.
    """
    target = folder / f"{IDENTITY}-{__version__}-{platform}.zip"
    with staged_file(target) as partial, tempfile.TemporaryDirectory() as scratch:
        own = own_wheel(Path(scratch))
        tags = [word for tag in PLATFORMS[platform] for word in ("--platform", tag)]
        only = ("--only-binary", ":all:", "--implementation", "cp", "--python-version", PYTHON, *tags)
        pip("download", "--quiet", "--dest", scratch, *only, str(own), *BESIDE_BLENDER)
        _zip(Path(scratch), own, platform, partial)
    return target


def _zip(scratch: Path, own: Path, platform: str, file: Path) -> None:
    """Write the extension from the wheels in a folder, recon's own among them."""
    wheels = sorted(scratch.glob("*.whl"))
    named = "".join(f'    "./wheels/{wheel.name}",\n' for wheel in wheels if not wheel.name.startswith("numpy-"))
    texts = {
        "blender_manifest.toml": _MANIFEST.format(
            identity=IDENTITY, version=__version__, platform=platform, wheels=named
        ),
        "__init__.py": _ROOT.format(version=tuple(int(part) for part in __version__.split(".")[:3])),
    }
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as extension, zipfile.ZipFile(own) as modules:
        for name, text in texts.items():
            extension.writestr(f"{IDENTITY}/{name}", text)
        for name in modules.namelist():
            _, _, inside = name.partition("recon_exporters/")
            if PurePosixPath(inside).parts[:1] in [(part,) for part in _PARTS]:
                extension.writestr(f"{IDENTITY}/{inside}", modules.read(name))
        for wheel in wheels:
            extension.write(wheel, f"{IDENTITY}/wheels/{wheel.name}", zipfile.ZIP_STORED)
