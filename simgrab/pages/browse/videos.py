"""Pictures of a video, by row: decoded from the key frame before, and kept with those that were passed on the way."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import cv2

from simgrab.errors import PictureError
from simgrab.instrument.video import Video
from simgrab.io import pictures
from simgrab.pages.browse.pictures import LruCache

_SAME_S = 5e-3  # of time stamps, which a container may round
_QUALITY = 88


class VideoPictures:
    """Pictures of a video, by the times of its rows, s.

    Raises
    ------
    SourceError
        If it cannot be opened.
    """

    def __init__(self, path: Path, times_s: Sequence[float]) -> None:
        lasting = times_s[-1] - times_s[0] if times_s else 0.0
        # A video without time stamps has the rate by which it was measured.
        self._video, self._times = Video(path, (len(times_s) - 1) / lasting if lasting > 0 else None), times_s
        self._row_at = {round(time / _SAME_S): row for row, time in enumerate(times_s)}
        self._kept, self._turn = LruCache(), threading.Lock()

    def content(self, row: int) -> bytes:
        """Decode a row's picture, as JPEG.

        Raises `SimgrabError` if it cannot be read, or the video has none at that time.
        """
        found = self._kept.get(row)
        if found is not None:
            return found
        with self._turn:
            found = self._kept.get(row) or self._decoded(row)
        if found is None:
            raise PictureError(f"row {row}", f"the video has no image at {self._times[row]:.3f} s")
        return found

    def _decoded(self, row: int) -> bytes | None:
        """Decode up to a row, and keep what is passed."""
        with closing(self._video.from_time(max(self._times[row] - _SAME_S, 0.0))) as frames:
            for frame in frames:
                assert frame.time_s is not None
                passed = self._row_of(frame.time_s)
                if frame.picture is not None and passed is not None:
                    jpeg = pictures.encode(cv2.cvtColor(frame.picture, cv2.COLOR_RGB2BGR), "jpeg", _QUALITY)
                    self._kept.put(passed, jpeg)
                    if passed == row:
                        return jpeg
                if frame.time_s > self._times[row] + _SAME_S:
                    return None
        return None

    def _row_of(self, time_s: float) -> int | None:
        near = round(time_s / _SAME_S)
        return next((self._row_at[at] for at in (near, near - 1, near + 1) if at in self._row_at), None)
