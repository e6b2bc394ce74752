"""The truth of a run's frames: rows of a rendered dataset, or of the truth table beside a rendered video."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from simgrab.dataset import datasets
from simgrab.errors import DatasetError, RunError, first_line
from simgrab.instrument.run.runs import Run
from simgrab.io import parquet
from simgrab.io.parse import cannot, read_json
from simgrab.model import label_arrays as labels
from simgrab.model.geometry import Array
from simgrab.model.truth import Row

_SAME_S = 5e-4  # time stamps are those of the table exactly, but for rounding


@dataclass(frozen=True, eq=False)
class Truths:
    """The truth of a run's n frames.

    Attributes
    ----------
    rows : tuple of n Row or None
        None for frames that were never sent.
    weather : tuple of n str
    least_visible_fraction : float
        Least visible fraction of a frame that counts as one with a grab.
    """

    rows: tuple[Row | None, ...]
    weather: tuple[str, ...]
    least_visible_fraction: float

    @property
    def alpha(self) -> Array:
        """True swing, rad, shape (n,); NaN if it is unknown or there is no grab."""
        known = [np.nan if row is None or not row.present else row.alpha_deg for row in self.rows]
        return np.deg2rad(np.array(known, float))

    @property
    def rope_length(self) -> Array:
        r"""True \|OA\|, m, shape (n,); NaN where it is not known."""
        return np.array([np.nan if row is None else row.rope_length_m for row in self.rows], float)

    @property
    def centre(self) -> Array:
        """Grab centre as the picture has it, px, shape (n, 2); NaN if it is unknown."""
        nothing = np.full(2, np.nan)
        return np.array([nothing if row is None else labels.centre(row) for row in self.rows]).reshape(-1, 2)

    @property
    def box_centre(self) -> Array:
        """Centre of the visible box, px, shape (n, 2); NaN where nothing is seen."""
        boxes = [None if row is None else labels.box(row) for row in self.rows]
        nothing = np.full(2, np.nan)
        return np.array([nothing if b is None else (b[:2] + b[2:]) / 2 for b in boxes]).reshape(-1, 2)

    @property
    def labelled(self) -> NDArray[np.bool_]:
        """Whether a detector ought to find a grab, shape (n,)."""
        least = self.least_visible_fraction
        return np.array([row is not None and labels.is_labelled(row, least) for row in self.rows], bool)


def of(run: Run, known: str | Path) -> Truths:
    """Find the truth of a run's frames.

    Parameters
    ----------
    run : Run
    known : path
        The dataset; for a run on a video, the video or its truth table.

    Raises
    ------
    DatasetError
        If ``known`` is neither a dataset nor a rendered video.
    RunError
        If ``known`` does not belong to the run's frames.
    """
    path = Path(known)
    found = _of_dataset(run, path) if path.is_dir() else _of_video(run, path.with_suffix(".parquet"))
    if not any(row is not None for row in found.rows):
        raise RunError(f"{known}: contains none of the frames of the run on {run.source}")
    first = next(row for row in found.rows if row is not None)
    camera = run.calibration
    if (first.width_px, first.height_px) != (camera.width_px, camera.height_px):
        raise RunError(
            f"{known}: pictures of {first.width_px}x{first.height_px} px; the run's are {camera.width_px}x"
            f"{camera.height_px}"
        )
    return found


def _of_dataset(run: Run, path: Path) -> Truths:
    dataset = datasets.read(path)
    at = match_names(run, [row.file for row in dataset.rows], dataset.data.labels_sha256, path)
    rows = tuple(None if i is None else dataset.rows[i] for i in at)
    weather = tuple("" if row is None else dataset.weather(row) for row in rows)
    return Truths(rows, weather, dataset.least_visible_fraction)


def match_names(run: Run, files: Sequence[str], labels_sha256: str, path: Path) -> list[int | None]:
    """Find the frames of a run among the picture files of a dataset, by their names.

    Parameters
    ----------
    run : Run
    files : sequence of str
        Picture files of the dataset, as its labels name them.
    labels_sha256 : str
        Digest of the dataset's labels.
    path : Path
        Folder of the dataset, for the message.

    Returns
    -------
    list of n int or None
        Index of each frame's file; None if the dataset has no file of that name; then all frames have None.

    Raises
    ------
    RunError
        If the dataset has only some of the run's frames, or its labels differ from those of the run.
    """
    by_name = {file: i for i, file in enumerate(files)} | {Path(file).name: i for i, file in enumerate(files)}
    found = [by_name.get(name) for name in run.names]
    strange = [name for name, at in zip(run.names, found, strict=True) if at is None]
    if 0 < len(strange) < len(found):
        lacks = f"it lacks {len(strange)} of the run's {len(found)} frames, such as {strange[0]}"
        raise RunError(f"{path}: does not belong to this run: {lacks}")
    if run.about.get("labels_sha256", labels_sha256) != labels_sha256:
        raise RunError(f"{path}: does not belong to this run, of {run.source}: its labels differ")
    return found


def _of_video(run: Run, path: Path) -> Truths:

    def refusal(why: str) -> DatasetError:
        return DatasetError(f"{path}: not the truth table of a video by simgrab render ({why})")

    plain = parquet.rows(parquet.read_table(path, refusal), refusal, cannot(path))
    manifest = read_json(path.with_suffix(".manifest.json"), refusal)
    try:
        table = [_row(row) for row in plain]
        stamps = np.array([row["pts_s"] for row in plain], float)
        if not plain:
            raise ValueError("it has no rows")
        scenario = msgspec.convert(manifest, datasets.Manifest).scenario
    except (ValueError, LookupError, TypeError) as problem:
        raise refusal(f"{type(problem).__name__}: {first_line(problem)}") from None
    if run.time is None:
        raise RunError(f"{path} belongs to a video, but the run on {run.source} has independent frames")
    nearest = _nearest(run.time, stamps)
    rows = tuple(
        table[k] if abs(stamps[k] - t) < _SAME_S and m.status != "lost" else None
        for k, t, m in zip(nearest.tolist(), run.time.tolist(), run.measurements, strict=True)
    )
    weather = tuple("" if row is None else scenario.name for row in rows)
    return Truths(rows, weather, scenario.labels.least_visible_fraction)


def _nearest(times: Array, stamps: Array) -> NDArray[np.int64]:
    """Index of the nearest of increasing time stamps, shape (n,)."""
    after = np.minimum(np.searchsorted(stamps, times), len(stamps) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(np.abs(times - stamps[before]) <= np.abs(stamps[after] - times), before, after)


def _row(plain: dict[str, Any]) -> Row:
    fields = set(Row.__struct_fields__)
    known = {key: value for key, value in plain.items() if key in fields}
    return msgspec.convert(known | {"file": "", "image_sha256": plain["rgb_sha256"]}, Row)
