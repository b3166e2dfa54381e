"""`recon` in a process of its own: signals, pipes, terminals, full disks, and what it imports."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Mapping
from pathlib import Path

import pytest
from cli_box import PIPELINE, Cli, entries, spawn

import recon


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no signals to a single process")
@pytest.mark.parametrize(
    ("words", "sent", "code", "told"),
    [
        (["run", "slow.yaml", "drive.txt"], "SIGINT", 130, "interrupted; nothing was written\n"),
        (["-v", "run", "slow.yaml", "drive.txt"], "SIGINT", 130, "interrupted; nothing was written\n"),
        (["run", "slow.yaml", "drive.txt"], "SIGTERM", 143, "terminated; nothing was written\n"),
        (["run", "slow.yaml", "drive.txt"], "SIGHUP", 129, "terminated; nothing was written\n"),
    ],
)
def test_a_stopped_run_is_one_line_and_leaves_nothing(
    words: list[str], sent: str, code: int, told: str, tmp_path: Path, environment: Mapping[str, str]
) -> None:
    before = entries(tmp_path)
    with spawn(*words, cwd=tmp_path, env=environment, stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        while "filter.wait" not in process.stderr.readline():
            assert process.poll() is None, "it ended before the step began"
        process.send_signal(signal.Signals[sent])
        assert process.stderr.read() == told
        assert process.wait() == code
    assert entries(tmp_path) == before


def test_a_run_whose_terminal_is_gone_leaves_nothing(tmp_path: Path, environment: Mapping[str, str]) -> None:
    pty = pytest.importorskip("pty", reason="there are no pseudo-terminals here")
    before = entries(tmp_path)
    child, terminal = pty.fork()
    if not child:
        os.chdir(tmp_path)
        os.execve(sys.executable, [sys.executable, "-m", "recon", "run", "slow.yaml", "drive.txt"], dict(environment))
    shown = b""
    while b"filter.wait" not in shown:
        shown += os.read(terminal, 4096)
    os.close(terminal)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 129
    assert entries(tmp_path) == before


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGHUP")
def test_a_run_that_was_told_to_outlive_its_terminal_does(tmp_path: Path, environment: Mapping[str, str]) -> None:
    (tmp_path / "brief.yaml").write_text(PIPELINE + "    params: {time: 1 s}\n")
    program = "import os, signal, sys; signal.signal(signal.SIGHUP, signal.SIG_IGN); os.execv(sys.executable, sys.argv)"
    words = [sys.executable, "-c", program, "-m", "recon", "run", "brief.yaml", "drive.txt"]
    with subprocess.Popen(words, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        while "filter.wait" not in process.stderr.readline():
            assert process.poll() is None, "it ended before the step began"
        process.send_signal(signal.SIGHUP)
        process.communicate()
    assert process.returncode == 0
    assert recon.open(tmp_path / "drive-box").recording["imu"].num_rows == 100


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no signals to a single process")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_after_the_end_does_not_spoil_what_is_done(name: str, environment: Mapping[str, str]) -> None:
    program = f"""
        import os, signal, sys
        from recon.cli import main
        sys.argv = ["recon", "--version"]
        code = main()
        os.kill(os.getpid(), signal.{name})
        sys.exit(code)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, env=environment, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, f"recon {recon.__version__}\n", "")


def test_a_caller_in_the_same_process_keeps_his_signals(cli: Cli) -> None:
    numbers = [number for number in signal.Signals if number.name in ("SIGINT", "SIGTERM", "SIGHUP")]
    before = [signal.getsignal(number) for number in numbers]
    cli("run", "box.yaml", "drive.txt")
    assert [signal.getsignal(number) for number in numbers] == before


def test_the_command_hears_ctrl_c_before_anything_slow_is_imported() -> None:
    program = "import sys; import recon.cli; sys.exit(f'{[*sys.modules]}' if 'recon.errors' in sys.modules else 0)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no SIGINT to a single process")
def test_ctrl_c_in_an_export_says_that_the_run_is_complete(tmp_path: Path, environment: Mapping[str, str]) -> None:
    (tmp_path / "box.yaml").write_text(PIPELINE)
    words = ["run", "box.yaml", "drive.txt", "--export", "late"]
    with spawn(*words, cwd=tmp_path, env=environment, stderr=subprocess.PIPE) as process:
        while not any((tmp_path / "drive-box").glob("exports/.late.partial-*")):
            assert process.poll() is None, "it ended before the export began"
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate()
    assert process.returncode == 130
    rest = "'recon export drive-box late' makes what is missing"
    assert err.endswith(f"interrupted; the run is complete: drive-box; {rest}\n")
    assert recon.open(tmp_path / "drive-box").recording["imu"].num_rows == 100
    assert not (tmp_path / "drive-box" / "exports").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="a pipe is broken otherwise on Windows")
def test_a_reader_that_goes_away_is_not_complained_of(tmp_path: Path, environment: Mapping[str, str]) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        with spawn("plugins", cwd=tmp_path, env=environment, stdout=writing, stderr=subprocess.PIPE) as process:
            _, err = process.communicate()
    finally:
        os.close(writing)
    assert (process.returncode, err) == (141, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device that is always full")
def test_output_to_a_full_disk_is_an_error(tmp_path: Path, environment: Mapping[str, str]) -> None:
    with (
        Path("/dev/full").open("w") as full,
        spawn("plugins", cwd=tmp_path, env=environment, stdout=full.fileno(), stderr=subprocess.PIPE) as process,
    ):
        _, err = process.communicate()
    assert process.returncode == 8
    assert err == "error: the output could not be written: No space left on device\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no device that is always full")
def test_a_run_whose_report_cannot_be_written_says_that_it_is_complete(
    tmp_path: Path, environment: Mapping[str, str]
) -> None:
    (tmp_path / "box.yaml").write_text(PIPELINE)
    words = ["run", "box.yaml", "drive.txt"]
    buffered = {key: value for key, value in environment.items() if key != "PYTHONUNBUFFERED"}
    with (
        Path("/dev/full").open("w") as full,
        spawn(*words, cwd=tmp_path, env=buffered, stdout=full.fileno(), stderr=subprocess.PIPE) as process,
    ):
        _, err = process.communicate()
    assert process.returncode == 8
    assert err.splitlines()[-2:] == [
        "error: the output could not be written: No space left on device",
        "  the run is complete: drive-box",
    ]


def test_a_console_of_few_characters_shows_what_it_can(tmp_path: Path, environment: Mapping[str, str]) -> None:
    narrow = {**environment, "PYTHONIOENCODING": "cp1252"}
    (tmp_path / "\u03a9.yaml").write_text("steps: [{use: simulator.still}]")
    with spawn("validate", "\u03a9.yaml", cwd=tmp_path, env=narrow, stdout=subprocess.PIPE) as process:
        out, _ = process.communicate()
    assert (process.returncode, out) == (0, "?.yaml: pipeline '?' is valid, 1 step\n")


def test_a_live_display_shows_the_steps_on_a_terminal(tmp_path: Path, environment: Mapping[str, str]) -> None:
    pty = pytest.importorskip("pty", reason="there are no pseudo-terminals here")
    (tmp_path / "brief.yaml").write_text(PIPELINE + "    params: {time: 0.5 s}\n")
    ours, theirs = pty.openpty()
    env = {**environment, "TERM": "xterm", "COLUMNS": "80"}
    with spawn(
        "run", "brief.yaml", "drive.txt", cwd=tmp_path, env=env, stdout=subprocess.PIPE, stderr=theirs
    ) as process:
        out, _ = process.communicate()
    os.close(theirs)
    shown = b""
    try:
        while part := os.read(ours, 4096):
            shown += part
    except OSError:  # how Linux ends a terminal that nobody holds any more
        pass
    os.close(ours)
    assert process.returncode == 0
    assert b"1/2" in shown
    assert b"filter.wait" in shown
    assert "result" in out


@pytest.mark.parametrize(
    ("words", "unwanted"),
    [
        (["--help"], "numpy pyarrow pydantic yaml scipy rich.live mcap pyquaternion recon.pipeline recon.registry"),
        (
            ["validate", "thesis"],
            "scipy rich.live mcap zstandard pyquaternion pyarrow.parquet recon.api recon.trajectory",
        ),
        (["validate", "thesis"], "recon_readers.physycom recon_simulators recon_exporters recon.batch recon.runner"),
    ],
)
def test_a_verb_imports_only_what_it_needs(words: list[str], unwanted: str) -> None:
    program = f"""
        import sys
        from recon.cli import main
        assert main({words}) == 0
        found = [name for name in {unwanted.split()} if name in sys.modules]
        sys.exit(f"imported: {{found}}" if found else 0)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, encoding="utf-8", check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
