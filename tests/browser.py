"""Pages in headless Chromium: the document after its scripts ran, what the console said, and what it looks like."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

SECONDS = 120
_QUIET = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--enable-logging=stderr")


def opened(page: Path, profile: Path) -> tuple[str, list[str]]:
    """The document as text after its scripts ran, and the lines of its console."""
    run = _run(page, profile, "--dump-dom")
    return run.stdout, _console(run.stderr)


def seen(page: Path, profile: Path, width: int, height: int) -> np.ndarray:
    """A picture of the page: (height, width, 3) uint8."""
    from matplotlib.image import imread

    picture = profile.with_suffix(".png")
    _run(page, profile, f"--screenshot={picture}", f"--window-size={width},{height}")
    return np.rint(imread(picture)[..., :3] * 255).astype(np.uint8)


def printed(page: Path, profile: Path) -> bytes:
    """The page as PDF."""
    target = profile.with_suffix(".pdf")
    _run(page, profile, "--no-pdf-header-footer", f"--print-to-pdf={target}")
    return target.read_bytes()


def pixels(picture: np.ndarray, color: str, off: int = 40) -> int:
    """How many pixels are as good as of a colour #rrggbb."""
    wanted = np.array([int(color[at : at + 2], 16) for at in (1, 3, 5)])
    return int((np.abs(picture.astype(int) - wanted).max(axis=2) <= off).sum())


def _run(page: Path, profile: Path, *options: str) -> subprocess.CompletedProcess[str]:
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("there is no Chromium: apt-get install chromium")
    return subprocess.run(
        [program, *_QUIET, f"--user-data-dir={profile}", *options, page.as_uri()],
        check=True, capture_output=True, text=True, timeout=SECONDS,
    )  # fmt: skip


def _console(log: str) -> list[str]:
    return re.findall(r"CONSOLE[^\]]*\] (.*)", log)
