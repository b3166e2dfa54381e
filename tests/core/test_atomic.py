"""recon.storage.atomic: a result is whole or not there, and what is no result is never replaced."""

from __future__ import annotations

import errno
import json
import os
import re
import stat
import sys
from contextlib import nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from recon.errors import ConfigError, StorageError
from recon.storage.atomic import MANIFEST, MARK, refuse_existing, staged_file, staged_folder

NOBODY = 65_534
needs_dev_full = pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full: no disk that is always full")


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def make_result(folder: Path) -> None:
    folder.mkdir()
    (folder / MANIFEST).write_text(json.dumps({MARK: 1, "outputs": [{"file": "old"}]}))
    (folder / "old").touch()


def test_a_staged_folder_appears_when_it_is_complete(tmp_path: Path) -> None:
    final = tmp_path / "deep" / "run"
    with staged_folder(final) as folder:
        (folder / "a.txt").write_text("a")
        assert not final.exists()
    assert names_in(final) == ["a.txt"]
    assert names_in(final.parent) == ["run"]


def fail_half_way(final: Path, overwrite: bool, error: type[BaseException]) -> None:
    with staged_folder(final, overwrite=overwrite) as folder:
        (folder / "half").write_text("x")
        raise error


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("overwrite", [False, True])
def test_a_failure_leaves_everything_as_it_was(tmp_path: Path, error: type[BaseException], overwrite: bool) -> None:
    final = tmp_path / "run"
    if overwrite:
        make_result(final)
    before = names_in(tmp_path)
    with pytest.raises(error):
        fail_half_way(final, overwrite, error)
    assert names_in(tmp_path) == before
    assert not overwrite or names_in(final) == [MANIFEST, "old"]


def test_an_old_result_is_replaced_as_a_whole(tmp_path: Path) -> None:
    make_result(tmp_path / "run")
    with staged_folder(tmp_path / "run", overwrite=True) as folder:
        (folder / "new").touch()
    assert names_in(tmp_path / "run") == ["new"]
    assert names_in(tmp_path) == ["run"]


def test_an_empty_folder_may_be_replaced(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    with staged_folder(tmp_path / "run", overwrite=True) as folder:
        (folder / "new").touch()
    assert names_in(tmp_path / "run") == ["new"]


def test_an_existing_result_is_refused_before_any_work(tmp_path: Path) -> None:
    make_result(tmp_path / "run")
    with pytest.raises(ConfigError, match=r"is there already.*--overwrite") as caught:
        refuse_existing(tmp_path / "run")
    assert caught.value.exit_code == 2


def test_what_is_no_result_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "thesis.tex").touch()
    (tmp_path / "file").touch()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / MANIFEST).write_text('{"name": "a web page"}')
    for name, strange in (("home", "thesis.tex was not"), ("file", "no result"), ("other", f"{MANIFEST} was not")):
        with pytest.raises(ConfigError, match=strange):
            refuse_existing(tmp_path / name, overwrite=True)


def test_a_result_that_holds_a_file_of_somebody_else_is_never_replaced(tmp_path: Path) -> None:
    make_result(tmp_path / "run")
    (tmp_path / "run" / "exports" / "csv").mkdir(parents=True)
    (tmp_path / "run" / "exports" / "csv" / "notes.txt").touch()
    with pytest.raises(ConfigError, match=r"notes\.txt was not written by recon"):
        refuse_existing(tmp_path / "run", overwrite=True)


def test_what_a_killed_export_left_behind_does_not_keep_a_result_from_being_replaced(tmp_path: Path) -> None:
    make_result(tmp_path / "run")
    left = tmp_path / "run" / "exports" / ".csv.partial-0a1b2c3d"
    left.mkdir(parents=True)
    (left / "imu.csv").touch()
    with staged_folder(tmp_path / "run", overwrite=True) as folder:
        (folder / "new").touch()
    assert names_in(tmp_path / "run") == ["new"]


def test_the_folder_in_which_the_user_stands_is_never_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_result(tmp_path / "run")
    (tmp_path / "run" / "deep").mkdir()
    monkeypatch.chdir(tmp_path / "run" / "deep")
    for name in (".", "..", str(tmp_path / "run")):
        with pytest.raises(ConfigError, match="folder that you are in"):
            refuse_existing(Path(name), overwrite=True)


@pytest.mark.parametrize("name", ["file/run", "x" * 300, "a\0b"])
def test_a_place_where_no_folder_can_be_is_refused_before_any_work(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="there cannot be a folder"):
        refuse_existing(tmp_path / name)


def test_a_result_that_appears_meanwhile_is_not_overwritten(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is there already"), staged_folder(tmp_path / "run"):
        make_result(tmp_path / "run")
    assert names_in(tmp_path / "run") == [MANIFEST, "old"]


@pytest.mark.skipif(os.name != "posix", reason="a link needs a privilege on Windows")
def test_a_linked_result_is_replaced_behind_its_link(tmp_path: Path) -> None:
    make_result(tmp_path / "real")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    with staged_folder(tmp_path / "link", overwrite=True) as folder:
        (folder / "new").touch()
    assert (tmp_path / "link").is_symlink()
    assert names_in(tmp_path / "real") == ["new"]


def interrupt_half_way(final: Path) -> None:
    with staged_file(final) as path:
        path.write_text("half")
        raise KeyboardInterrupt


def test_a_staged_file_replaces_the_old_one_only_when_complete(tmp_path: Path) -> None:
    final = tmp_path / "a.txt"
    final.write_text("old")
    with pytest.raises(KeyboardInterrupt):
        interrupt_half_way(final)
    assert final.read_text() == "old"
    with staged_file(final) as path:
        path.write_text("new")
    assert final.read_text() == "new"
    assert names_in(tmp_path) == ["a.txt"]


@needs_dev_full
def test_a_full_disk_says_so_and_how_much_is_free(tmp_path: Path) -> None:
    with (
        pytest.raises(StorageError, match=r"run could not be written: no space left") as caught,
        staged_folder(tmp_path / "run"),
    ):
        Path("/dev/full").write_text("x")
    assert re.match(r"make room \(\d+ MB are free there\)", caught.value.hint)
    assert caught.value.exit_code == 8
    assert names_in(tmp_path) == []


@needs_dev_full
def test_a_full_disk_under_pyarrow_says_so_too(tmp_path: Path) -> None:
    """The device is handed over open: by its path, pyarrow would remove it after the error."""
    with (
        pytest.raises(StorageError, match="no space left"),
        staged_file(tmp_path / "a"),
        pa.OSFile("/dev/full", "wb") as full,
    ):
        pq.write_table(pa.table({"a": range(40_000)}), full)


@pytest.mark.skipif(sys.platform != "linux", reason="needs a folder in which not even root may write: /sys of Linux")
def test_a_folder_that_may_not_be_written_gives_one_sentence() -> None:
    with (
        pytest.raises(StorageError, match=r"permission denied|operation not permitted|read-only"),
        staged_folder(Path("/sys/recon-run")),
    ):
        pytest.fail("the folder cannot exist")


@pytest.fixture
def place_of_nobody():
    """A folder of a user without rights, who is the one that runs until the end of the test."""
    if not hasattr(os, "seteuid"):
        pytest.skip("here is no user whose rights a process can take")
    with TemporaryDirectory() as folder:
        if os.geteuid() != 0:
            yield Path(folder)
            return
        os.chown(folder, NOBODY, NOBODY)
        os.seteuid(NOBODY)
        try:
            yield Path(folder)
        finally:
            os.seteuid(0)


def test_a_read_only_file_in_a_result_is_kept_for_a_user_who_is_no_administrator(place_of_nobody):
    with staged_folder(place_of_nobody / "run") as folder:
        (folder / "below").mkdir()
        (folder / "below" / "locked.txt").write_text("kept")
        (folder / "below" / "locked.txt").chmod(0o444)
        (folder / "link").symlink_to("nowhere")
    assert (place_of_nobody / "run" / "below" / "locked.txt").read_text() == "kept"
    with staged_file(place_of_nobody / "one.txt") as path:
        path.write_text("kept")
        path.chmod(0o444)
    assert (place_of_nobody / "one.txt").read_text() == "kept"
    with pytest.raises(PermissionError):
        (place_of_nobody / "one.txt").open("rb+")


def test_files_and_the_names_in_folders_reach_the_disk_before_a_result_counts(tmp_path, monkeypatch):
    synced = []

    def watched(opened):
        where = Path(f"/proc/self/fd/{opened}").resolve()
        synced.append((where.name, (tmp_path / "run").exists()))

    if not Path("/proc/self/fd").is_dir():
        pytest.skip("here no program is told which files it has open")
    monkeypatch.setattr(os, "fsync", watched)
    with staged_folder(tmp_path / "run") as folder:
        (folder / "below").mkdir()
        (folder / "below" / "a.txt").write_text("a")
        name = folder.name
    assert sorted(synced) == sorted([(name, False), ("below", False), ("a.txt", False)])


@pytest.mark.parametrize("number", [errno.EINVAL, errno.EIO])
def test_a_file_system_that_syncs_no_folders_does_for_a_result_and_a_disk_that_fails_does_not(
    tmp_path, monkeypatch, number
):
    def refused(opened):
        if stat.S_ISDIR(os.fstat(opened).st_mode):
            raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", refused)
    with nullcontext() if number == errno.EINVAL else pytest.raises(StorageError), staged_folder(tmp_path / "run"):
        pass
    assert (tmp_path / "run").exists() == (number == errno.EINVAL)
