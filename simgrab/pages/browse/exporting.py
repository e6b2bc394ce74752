"""Export of a selection, in a thread of its own: the page asks how far it is."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from simgrab.errors import DatasetError, SimgrabError, first_line, memory_problem
from simgrab.io.destination import check_new_folder
from simgrab.io.stores import is_url
from simgrab.pages.browse.subject import Subject
from simgrab.text import printable

FORMATS = ("simgrab", "yolo", "yolo-pose", "yolo-seg", "yolo-obb", "coco", "voc", "hf")
_SECONDS_TO_END = 10.0


class ExportState(msgspec.Struct, frozen=True):
    """How far an export is: ``none``, ``running``, ``done`` or ``failed``; frames; where to, and why it failed."""

    status: str = "none"
    done: int = 0
    total: int = 0
    out: str = ""
    problem: str = ""


class _Ended(Exception):  # noqa: N818
    """The command ends."""


class Exports:
    """Exports of a subject's rows, one at a time."""

    def __init__(self, subject: Subject) -> None:
        self._subject, self.state = subject, ExportState()
        self._lock, self._ends, self._thread = threading.Lock(), threading.Event(), threading.Thread()

    def start(self, rows: NDArray[np.int64], out: str, format: str) -> ExportState:
        """Begin an export of rows, shape (k,), into a new folder outside of what is browsed, in one of `FORMATS`.

        Raises `DatasetError` if one is running already, or this one is not possible.
        """
        with self._lock:
            if self.state.status == "running":
                raise DatasetError("another export is running")
            if format not in FORMATS:
                raise DatasetError(f"no format {format!r}; one of: {', '.join(FORMATS)}")
            if self._subject.dataset is None:
                raise DatasetError(f"{self._subject.name}: only frames of a finished dataset can be exported")
            if not len(rows):
                raise DatasetError("no frame is selected")
            path = self._checked(out, self._subject.dataset.path)
            self.state = ExportState("running", 0, len(rows), printable(path))
            self._thread = threading.Thread(target=self._export, args=(rows, path, format), daemon=True)
            self._thread.start()
            return self.state

    def end(self) -> None:
        """End what is running; nothing of it remains."""
        self._ends.set()
        if self._thread.is_alive():
            self._thread.join(_SECONDS_TO_END)

    def _checked(self, out: str, source: Path) -> Path:
        """Refuse a place that cannot be written, or lies in a folder that is browsed."""
        if not out.strip() or is_url(out):
            raise DatasetError("name a new folder to write")
        try:
            path = Path(os.path.abspath(Path(out).expanduser()))  # noqa: PTH100  # links are followed below
        except RuntimeError as problem:  # of a user that is not there
            raise DatasetError(f"{out}: {first_line(problem)}") from None
        check_new_folder(path, DatasetError, "folder")
        real = Path(os.path.realpath(path))
        for folder in (Path(self._subject.name), source):
            if real.is_relative_to(os.path.realpath(folder)):
                raise DatasetError(f"{path} is inside {folder}, in which nothing is written; choose another folder")
        return path

    def _export(self, rows: NDArray[np.int64], path: Path, format: str) -> None:
        from simgrab.dataset.export import export  # MuJoCo takes its time

        whole, labels = self._subject.dataset, self._subject.labels
        assert whole is not None
        assert labels is not None

        def progress(done: int, total: int) -> None:
            if self._ends.is_set():
                raise _Ended
            self.state = ExportState("running", done, total, printable(path))

        try:
            chosen = whole.with_rows(labels.table.take(pa.array(rows)).sort_by("frame"))
            export(chosen, path, format=format, progress=progress, part=True)
        except _Ended:
            return
        except Exception as problem:
            known = str(problem) if isinstance(problem, SimgrabError) else memory_problem(problem)
            line = printable(known or f"{type(problem).__name__}: {problem}")
            self.state = ExportState("failed", 0, 0, printable(path), line)
            if known is None:
                raise
        else:
            self.state = ExportState("done", len(rows), len(rows), printable(path))
