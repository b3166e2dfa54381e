"""`recon view`: the real viewer, on addresses of this machine alone, and gone when recon is."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from urllib.request import urlopen

import psutil
import pytest

import recon
from recon.cli import main


@pytest.fixture
def finished(tmp_path: Path) -> Path:
    recon.run(recon.Pipeline.of("drive", "simulator.drive"), out=tmp_path / "run")
    return tmp_path / "run"


def no_display() -> dict[str, str]:
    """The environment, with nothing to open a window on."""
    return {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}


def view(*words: str | Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "recon", "view", *words]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, env=no_display() | {"BROWSER": "true"}, text=True, **pipes)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux can be without a display")
def test_without_a_display_the_browser_is_proposed(finished):
    process = view(finished)
    told, complaint = process.communicate(timeout=60)
    assert process.returncode == 3
    assert "error: the Rerun viewer ended with exit code 1\n  where there is no display, add --web\n" in complaint
    assert told.splitlines()[0] == str(finished / "exports" / "rerun" / "run.rrd")
    assert (finished / "exports" / "rerun" / "run.rrd").is_file()


def listening(process: psutil.Process) -> set[tuple[str, int]]:
    """Addresses on which the viewers of a process can be reached."""
    try:
        found = [c.laddr for child in process.children() for c in child.net_connections("tcp") if c.status == "LISTEN"]
    except psutil.NoSuchProcess:
        return set()
    return {(address.ip, address.port) for address in found}


def is_page(address: tuple[str, int]) -> bool:
    try:
        with urlopen(f"http://{address[0]}:{address[1]}", timeout=5) as answer:
            return b"rerun" in answer.read().lower()
    except OSError:
        return False


CLOSED = "the viewer is closed"


@pytest.mark.parametrize(
    ("closing", "code", "told"),
    [("SIGINT", 0, CLOSED), ("SIGTERM", 143, f"terminated; {CLOSED}"), ("SIGHUP", 129, f"terminated; {CLOSED}")],
)
@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no signals to a single process")
def test_the_browser_shows_a_page_that_only_this_machine_can_reach_until_it_is_closed(finished, closing, code, told):
    process = view(finished, "--web")
    try:
        this, end = psutil.Process(process.pid), time.monotonic() + 60.0
        while len(addresses := listening(this)) < 2 and process.poll() is None and time.monotonic() < end:
            time.sleep(0.1)
        viewers = this.children()
        assert {ip for ip, _ in addresses} == {"127.0.0.1"}
        assert any(is_page(address) for address in addresses)
    finally:
        process.send_signal(signal.Signals[closing])
        _, complaint = process.communicate(timeout=60)
    assert process.returncode == code
    assert complaint.splitlines()[-1].startswith(told)
    _, alive = psutil.wait_procs(viewers, timeout=10)
    assert viewers
    assert not alive


def test_a_file_that_is_there_is_shown_as_it_is(finished):
    (path,) = recon.api.export(recon.open(finished), ["rerun"])
    before = path.stat()
    view(finished).communicate(timeout=60)
    assert (path.stat().st_ino, path.stat().st_mtime_ns) == (before.st_ino, before.st_mtime_ns)


def test_a_folder_without_a_run_is_refused(tmp_path, capsys):
    assert main(["view", str(tmp_path)]) == 4
    assert "this is no finished run" in capsys.readouterr().err


def test_without_the_viewer_one_sentence_says_what_to_install(finished):
    """Python finds no package of a name that stands for None."""
    program = "import sys; sys.modules['rerun_cli'] = None; from recon.cli import main; main(['view', 'run'])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=finished)
    assert done.stderr == 'error: recon view needs rerun-sdk\n  pip install "recon-dynamics[rerun]"\n'
