"""Images of the stream frames as grey pixels, one after the other: files in a folder, or frames of a video in it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Grey = NDArray[np.uint8]

_VIDEOS: Final = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm")
"""Endings."""


def pictures(folder: Path, files: Sequence[str], numbers: Sequence[int]) -> Iterator[Grey | None]:
    """Grey images (h, w), None where one cannot be read.

    files : relative to the folder; numbers : of the frame in its file, where that is a video, rising
    """
    import cv2  # slow import: only when used

    video = _Video("")
    for file, number in zip(files, numbers, strict=True):
        path = folder / file
        if path.suffix.lower() in _VIDEOS:
            if video.path != str(path):
                video = _Video(str(path))
            yield video.frame(number)
        else:
            data = np.fromfile(path, dtype=np.uint8) if path.is_file() else np.zeros(0, np.uint8)
            yield cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if len(data) else None  # type: ignore[misc]


class _Video:
    """Frames of a video, forwards."""

    def __init__(self, path: str) -> None:
        import cv2

        self.path = path
        self._stream: Any = cv2.VideoCapture(path) if path else None
        self._next = 0

    def frame(self, number: int) -> Grey | None:
        """The frame of a number that is above all asked before; None where there is none."""
        import cv2

        while self._next < number and self._stream.grab():
            self._next += 1
        if self._next != number:
            return None
        there, image = self._stream.read()
        self._next += there
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8) if there else None
