"""What the viewer of Rerun draws of a file."""

from __future__ import annotations

import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from exporter_tables import SECOND, START_NS, fixes, happened
from matplotlib.image import imread
from rerun.experimental import ViewerClient
from rerun_files import export, moving

from recon.cli.view import _viewer
from recon.manifest import RunInfo

TRAJECTORY_BLUE, GNSS_ORANGE, STANDSTILL_GREY = (0x56, 0xB4, 0xE9), (0xE6, 0x9F, 0x00), (0x80, 0x80, 0x80)
MAP, BODY = np.s_[60:450, :640], np.s_[480:860, :640]
PLOTS, EVENTS = np.s_[60:720, 650:1240], np.s_[750:860, 650:]
"""Parts of the picture, where no notice of the viewer lies over it."""


@pytest.fixture(scope="module")
def viewer() -> Iterator[ViewerClient]:
    """A viewer without a window, that only this machine can reach."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    options = ["--headless", "--bind", "127.0.0.1", "--port", str(port), "--window-size", "1600x900"]
    process = subprocess.Popen([_viewer(), *options], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        yield _connected(process, port)
    finally:
        process.terminate()
        process.communicate()


def _connected(process: subprocess.Popen[str], port: int) -> ViewerClient:
    end = time.monotonic() + 30.0
    while process.poll() is None and time.monotonic() < end:
        try:
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            client.get_state()
        except (RuntimeError, ConnectionError, ValueError):
            time.sleep(0.2)
        else:
            return client
    told = process.communicate()[1] if process.poll() is not None else ""
    if "graphics adapter" in told:
        pytest.skip("there is no Vulkan driver: Debian's is mesa-vulkan-drivers")
    raise AssertionError(f"the viewer did not start: {told}")


def picture(viewer: ViewerClient, folder: Path, until: Callable[[np.ndarray], bool]) -> np.ndarray:
    """(900, 1600, 3) of 0 to 255, as soon as it shows what it should: the viewer loads and draws bit by bit."""
    path, end = folder / "shot.png", time.monotonic() + 60.0
    while time.monotonic() < end:
        viewer.save_screenshot(str(path))
        pixels = np.rint(imread(path)[..., :3] * 255)
        if until(pixels):
            return pixels
        time.sleep(0.3)
    raise AssertionError(f"{path} does not show what it should")


def near(pixels: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    """Pixels of a colour, but for what smooth edges and a transparent dot make of it."""
    return np.abs(pixels - color).max(axis=-1) < 24


def dot(pixels: np.ndarray) -> tuple[int, int] | None:
    """Row and column of a large dot of the trajectory's colour, None where there is none: its line is no 9 px wide."""
    windows = np.lib.stride_tricks.sliding_window_view(near(pixels, TRAJECTORY_BLUE), (9, 9))
    row, column = np.unravel_index(windows.sum(axis=(2, 3)).argmax(), windows.shape[:2])
    return (int(row), int(column)) if windows[row, column].mean() > 0.9 else None


def test_the_viewer_opens_with_map_body_plots_and_events(tmp_path, viewer):
    """To the left the map above the body, to the right the plots above the events."""
    t_s = np.arange(601) / 10
    speed = 5.0 + np.sin(t_s)
    path = export(
        tmp_path,
        RunInfo("screenshot"),
        trajectory=moving(601, vel=np.outer(speed, (0.6, 0.8, 0.0))),
        gnss=fixes(np.arange(60), lat=44.5 + 1e-5 * np.arange(60), speed=np.full(60, 5.0)),
        events=happened((10, 30)),
    )
    viewer.open(str(path))
    least = (
        (PLOTS, TRAJECTORY_BLUE, 2000),
        (PLOTS, GNSS_ORANGE, 100),
        (MAP, TRAJECTORY_BLUE, 200),
        (MAP, GNSS_ORANGE, 30),
        (BODY, TRAJECTORY_BLUE, 300),
        (EVENTS, STANDSTILL_GREY, 1000),
    )
    picture(viewer, tmp_path, until=lambda pixels: all(near(pixels[at], color).sum() > n for at, color, n in least))
    shown = [view for view in viewer.get_state().views if view.visible]
    assert {view.view_class for view in shown} >= {"Map", "3D", "TimeSeries"}
    assert [view.reports for view in shown if view.reports] == []


def test_the_body_moves_with_the_clock(tmp_path, viewer):
    """The drive goes north and east: on the map up and to the right."""
    path = export(tmp_path, RunInfo("clock"), trajectory=moving(601))
    viewer.open(str(path))
    places = []
    for t_s in (1, 59):
        viewer.set_time("time", timestamp=np.datetime64(START_NS + t_s * SECOND, "ns"))
        pixels = picture(viewer, tmp_path, until=lambda pixels: dot(pixels[MAP]) not in (None, *places))
        places.append(dot(pixels[MAP]))
    (first_row, first_column), (last_row, last_column) = places
    assert last_row < first_row - 20
    assert last_column > first_column + 20
