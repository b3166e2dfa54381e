"""A file in windows is the file: whatever a window cuts, the next one begins with."""

from __future__ import annotations

from pathlib import Path

import pytest

from recon_readers._windows import walk_through


@pytest.mark.parametrize("size", [5, 7, 51, 64, 102, 4096])
def test_records_come_whole_whatever_the_size_of_a_window(tmp_path: Path, size: int) -> None:
    """Records of five bytes, and half a one at the end; 51 and 102 end windows where the file ends."""
    records = [f"{number:05d}".encode() for number in range(20)]
    (tmp_path / "log.bin").write_bytes(b"".join(records) + b"00")
    seen, ends = [], []

    def take(window: bytes, *, last: bool) -> int:
        whole = len(window) // 5 * 5
        seen.extend(window[at : at + 5] for at in range(0, whole, 5))
        ends.append(last)
        return whole

    walk_through(tmp_path / "log.bin", size, take)
    assert seen == records
    assert ends == [False] * (len(ends) - 1) + [True]
