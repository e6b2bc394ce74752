"""Detect the grab in image files, and write the detections as a table."""

from __future__ import annotations

import csv
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from simgrab.errors import DatasetError, DetectorError, SourceError
from simgrab.instrument.detect import BUNDLED, Detector
from simgrab.instrument.detect import detector as open_detector
from simgrab.instrument.detect.patches import Picture
from simgrab.instrument.source import PictureFiles, open_source
from simgrab.io import parquet
from simgrab.io.destination import check_file, writing
from simgrab.io.files import drafted
from simgrab.model.records import frame_files
from simgrab.model.records.observations import Detection
from simgrab.text import cell, encodable

Progress = Callable[[int, int], None]
TABLES = (".parquet", ".csv")


@dataclass(frozen=True)
class Detections:
    """Detections of a detector in image files.

    Attributes
    ----------
    detector : str
    files : tuple of Path
    detections : tuple of Detection
    seconds : tuple of float
        Time from decoded picture to detection.
    note : str
        Assumptions on the pictures; mostly empty.
    """

    detector: str
    files: tuple[Path, ...]
    detections: tuple[Detection, ...]
    seconds: tuple[float, ...]
    note: str = ""


def detect(
    source: str | Path, detector: str | Path | Detector = BUNDLED, progress: Progress | None = None
) -> Detections:
    """Detect the grab in a picture, a folder of pictures or a dataset, writing nothing.

    Parameters
    ----------
    source : str or path
        As `simgrab.instrument.source.open_source` takes it, except for videos and streams.
    detector : str, path or Detector
        ``"bundled"``, a folder that `simgrab train detector` wrote, a YOLO's ``.onnx`` file, or an open
        detector.
    progress : callable, optional
        Called with (pictures done, pictures in all).

    Returns
    -------
    Detections
        ``files`` and the detection of each. `simgrab.instrument.detect.pictures.rows` makes plain rows of them, and
        `simgrab.instrument.detect.pictures.save` writes a table.

    Raises
    ------
    SourceError, DatasetError, DetectorError
        If there is no picture, a picture cannot be read or used, or the detector cannot be opened.

    Examples
    --------
    >>> import simgrab
    >>> found = simgrab.detect("runs/quay-day")
    >>> len(found.detections), found.detections[0].status
    (6, 'found')
    """
    opened = open_source(source)
    if not isinstance(opened, PictureFiles):
        raise SourceError(f"{opened.name} is a video; simgrab run measures it")
    chosen = open_detector(detector) if isinstance(detector, str | Path) else detector
    return replace(_detect(opened.files, _whole(opened), chosen, progress), note=opened.note)


def detect_dataset(
    path: Path, rows: Sequence[frame_files.PictureRow], detector: Detector, progress: Progress | None = None
) -> Detections:
    """Detect the grab in a dataset's pictures, whose digests must be those of its labels; see `detect`."""
    files = [path / row.file for row in rows]
    return _detect(files, map(frame_files.picture, files, rows), detector, progress)


def _whole(source: PictureFiles) -> Iterator[Picture]:
    for frame in source:
        if frame.picture is None:
            raise SourceError(f"{source.name}: {frame.reason}")
        yield frame.picture


def _detect(
    files: Sequence[Path], seen: Iterable[Picture], detector: Detector, progress: Progress | None
) -> Detections:
    detections, seconds = [], []
    for path, picture in zip(files, seen, strict=True):
        start = time.perf_counter()
        try:
            detections.append(detector(picture))
        except DetectorError as problem:
            raise DetectorError(f"{path}: {problem}") from None
        seconds.append(time.perf_counter() - start)
        if progress:
            progress(len(detections), len(files))
    return Detections(detector.name, tuple(files), tuple(detections), tuple(seconds))


def rows(detections: Detections) -> list[dict[str, Any]]:
    """One plain row a picture; ``u_px, v_px`` is the grab centre, or the box centre if none is output."""
    return [
        {"file": encodable(path)} | _row(detection) | {"seconds": seconds}
        for path, detection, seconds in zip(detections.files, detections.detections, detections.seconds, strict=True)
    ]


def centre(detection: Detection) -> Any:
    """Grab centre of a detection, or the box centre where it has none, (2,), px; NaN where nothing was found."""
    if detection.centre is not None:
        return detection.centre
    return np.full(2, np.nan) if detection.box is None else (detection.box[:2] + detection.box[2:]) / 2


def _row(detection: Detection) -> dict[str, Any]:
    def spread(names: Sequence[str], values: Any) -> dict[str, float | None]:
        return dict.fromkeys(names) if values is None else dict(zip(names, map(float, values), strict=True))

    edges = ("x0", "y0", "x1", "y1")
    where = centre(detection) if detection.found else None
    return {
        "status": detection.status, "reason": encodable(detection.reason), "score": detection.score,
        **spread([f"box_{e}_px" for e in edges], detection.box),
        **spread(("u_px", "v_px"), where),
        **spread([f"box_{e}_sd_px" for e in edges], detection.box_sd_px),
        **spread(("u_sd_px", "v_sd_px"), detection.centre_sd_px),
        "picture_yaw_deg": None if detection.yaw is None else float(np.rad2deg(detection.yaw)),
        "picture_yaw_sd_deg": None if detection.yaw_sd is None else float(np.rad2deg(detection.yaw_sd)),
    }  # fmt: skip


def check_table(path: Path) -> None:
    """Refuse, before detection, a table that cannot be written.

    Raises
    ------
    DatasetError
    """
    if path.suffix.lower() not in TABLES:
        raise DatasetError(f"{path}: a table of detections ends in {' or '.join(TABLES)}")
    check_file(path, DatasetError)


def save(detections: Detections, path: str | Path) -> None:
    """Write the rows to ``.parquet`` or ``.csv``, which `simgrab estimate` reads.

    The file appears complete or not at all.

    Raises
    ------
    DatasetError
        If it cannot be written.
    """
    path = Path(path)
    check_table(path)
    table = rows(detections)
    with writing(path, DatasetError), drafted(path) as draft:
        if path.suffix.lower() == ".parquet":
            parquet.write(pa.Table.from_pylist(table), draft)
        else:
            with draft.open("w", newline="", encoding="utf-8") as file:
                writer = csv.DictWriter(file, table[0].keys())
                writer.writeheader()
                writer.writerows({key: cell(v) if isinstance(v, str) else v for key, v in row.items()} for row in table)
