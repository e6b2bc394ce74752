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
from simgrab.judge.evaluate.alignment import SAME_S, begins, nearest, spacing
from simgrab.model import label_arrays as labels
from simgrab.model.calibration import scale_between
from simgrab.model.geometry import Array
from simgrab.model.truth import Row

_LEAST_READ = 0.5  # share of the frames whose display must be read to tell the time by it


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
    matched : str
        How frames were matched by time; empty where their names or time stamps are the same.
    """

    rows: tuple[Row | None, ...]
    weather: tuple[str, ...]
    least_visible_fraction: float
    matched: str = ""

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

    @property
    def absent(self) -> NDArray[np.bool_]:
        """Whether there is no grab, shape (n,)."""
        return np.array([row is not None and not row.present for row in self.rows], bool)


def of(run: Run, known: str | Path, start_s: float | None = None) -> Truths:
    """Find the truth of a run's frames.

    Parameters
    ----------
    run : Run
    known : path
        The dataset; for a run on a video, the video or its truth table. The run may be on a copy of the video that was
        re-encoded, cut or resampled: then its frames are matched by time.
    start_s : float, optional
        Time of the video at which the run's first frame lies; by default it is found (`alignment.begins`).

    Raises
    ------
    DatasetError
        If ``known`` is neither a dataset nor a rendered video.
    RunError
        If ``known`` does not belong to the run's frames.
    """
    path = Path(known)
    if path.is_dir() and start_s is not None:
        raise RunError(f"{known}: is a dataset, whose frames are found by their names; --start is of videos")
    found = _of_dataset(run, path) if path.is_dir() else _of_video(run, path.with_suffix(".parquet"), start_s)
    if not any(row is not None for row in found.rows):
        raise RunError(f"{known}: contains none of the frames of the run on {run.source}")
    return found


def _of_dataset(run: Run, path: Path) -> Truths:
    dataset = datasets.read(path)
    at = match_names(run, [row.file for row in dataset.rows], dataset.data.labels_sha256, path)
    scale = _scale(dataset.rows[0], run, path)
    rows = tuple(None if i is None else _scaled(dataset.rows[i], scale) for i in at)
    weather = tuple("" if row is None else dataset.weather(row) for row in rows)
    return Truths(rows, weather, dataset.least_visible_fraction)


def match_names(run: Run, files: Sequence[str], labels_sha256: str, path: Path) -> list[int | None]:
    """Find the frames of a run among the picture files of a dataset, by the names that its labels have for them.

    ``path`` is the dataset's folder, for messages.

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


@dataclass(frozen=True, eq=False)
class Film:
    """The truth of a rendered video.

    Attributes
    ----------
    rows : list of n Row
    stamps : ndarray, shape (n,)
        Time stamps of the pictures, s, increasing.
    scenario : ScenarioFacts
    """

    rows: list[Row]
    stamps: Array
    scenario: Any


def read_film(path: Path) -> Film:
    """Read the truth table beside a rendered video; raises `DatasetError`."""

    def refusal(why: str) -> DatasetError:
        return DatasetError(
            f"{path}: not the truth table of a video by simgrab render ({why}); for a copy, name the rendered video"
        )

    plain = parquet.rows(parquet.read_table(path, refusal), refusal, cannot(path))
    manifest = read_json(path.with_suffix(".manifest.json"), refusal)
    try:
        rows = [_row(row) for row in plain]
        stamps = np.array([row["pts_s"] for row in plain], float)
        if not plain:
            raise ValueError("it has no rows")
        if not (np.isfinite(stamps).all() and (np.diff(stamps) > 0).all()):
            raise ValueError("its time stamps do not increase")
        return Film(rows, stamps, msgspec.convert(manifest, datasets.Manifest).scenario)
    except (ValueError, LookupError, TypeError) as problem:
        raise refusal(f"{type(problem).__name__}: {first_line(problem)}") from None


def _of_video(run: Run, path: Path, start_s: float | None) -> Truths:
    film = read_film(path)
    stamps, scenario = film.stamps, film.scenario
    if run.time is None:
        raise RunError(f"{path} belongs to a video, but the run on {run.source} has independent frames")
    scale = _scale(film.rows[0], run, path)
    table = [_scaled(row, scale) for row in film.rows]
    sent = np.array([m.status != "lost" for m in run.measurements], bool)
    times, start, reach = run.time, float(stamps[0]), SAME_S
    exact = bool((np.abs(stamps[nearest(times, stamps)] - times) < SAME_S)[sent].all())
    if start_s is not None or (sent.any() and not (exact and sent.sum() == len(stamps))):
        known = Truths(tuple(table), (), 0.0)
        measured = _signs(run.pixels, [m.rope_text for m in run.measurements])[sent]
        true = _signs(known.centre, [row.rope_text for row in table])
        if not np.isfinite(measured[:, 2]).mean() > _LEAST_READ:
            measured, true = measured[:, :2], true[:, :2]
        part = bool(sent.any()) and np.ptp(times[sent]) < np.ptp(stamps) - 2 * spacing(stamps)
        alone = part and not np.isfinite(measured).all(axis=1).any()
        if alone:
            measured, true = run.alpha[sent, None], known.alpha[:, None]
        try:
            start = begins(times[sent], stamps, measured, true, alone=alone) if start_s is None else start_s
        except RunError as problem:
            raise RunError(
                f"{path}: cannot tell where in its video the run on {run.source} begins: {problem}; state it by --start"
            ) from None
    matched = ""
    if not exact or start != stamps[0]:
        reach = spacing(stamps) / 2 + SAME_S
    if reach > SAME_S or times[-1] < stamps[-1] - SAME_S:
        end = times[-1] + start
        matched = f"Frames are matched by time: the run covers {start:.2f} to {end:.2f} s of {stamps[-1]:.2f} s."
    if scale != 1:
        matched += (
            f" Its pictures are {scale:.4g} times as wide as those of the truth; figures in px are of its pictures."
        )
    at = nearest(times + start, stamps)
    near = np.abs(stamps[at] - times - start) < reach
    rows = tuple(table[k] if known and was_sent else None for k, known, was_sent in zip(at, near, sent, strict=True))
    weather = tuple("" if row is None else scenario.name for row in rows)
    return Truths(rows, weather, scenario.labels.least_visible_fraction, matched.strip())


def _scale(row: Row, run: Run, path: Path) -> float:
    """By how much the run's pictures are larger than those of the truth, of which they may be copies."""
    camera = run.calibration
    scale = scale_between((row.width_px, row.height_px), (camera.width_px, camera.height_px))
    if scale is None:
        raise RunError(
            f"{path}: pictures of {row.width_px}x{row.height_px} px; the run's are {camera.width_px}x{camera.height_px}"
        )
    return scale


def _scaled(row: Row, scale: float) -> Row:
    """Labels of a picture that shows the same at another size."""
    if scale == 1:
        return row
    px = {name: scale * v for name in row.__struct_fields__ if name.endswith("_px") and (v := getattr(row, name))}
    px["keypoints"] = (np.reshape(row.keypoints, (-1, 3)) * [scale, scale, 1]).ravel().tolist()
    if row.oriented_box is not None:
        px["oriented_box"] = [scale * v for v in row.oriented_box]
    return msgspec.structs.replace(row, **px)


def _signs(pixels: Array, texts: Sequence[str | None]) -> Array:
    """Grab centre and the hoist rope's digits on the display, which show the time of n pictures, shape (n, 3)."""
    digits = [(text or "").replace(".", "").partition(" ")[0] for text in texts]
    return np.column_stack([pixels, [float(d) if d.isdecimal() else np.nan for d in digits]])


def _row(plain: dict[str, Any]) -> Row:
    fields = set(Row.__struct_fields__)
    known = {key: value for key, value in plain.items() if key in fields}
    return msgspec.convert(known | {"file": "", "image_sha256": plain["rgb_sha256"]}, Row)
