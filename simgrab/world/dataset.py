"""Render a scenario into a dataset on disk."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from simgrab.errors import DatasetError
from simgrab.records import Truth
from simgrab.scenario import Scenario
from simgrab.world import export, frames, manifest, model, preview
from simgrab.world.folder import MANIFEST, Folder, writing
from simgrab.world.gl import Fingerprint

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Summary:
    """What a finished dataset holds.

    Attributes
    ----------
    path : Path
    frames, labelled : int
        Frames, and those with a detection label.
    splits : dict of str to int
    made : int
        Frames drawn in this run; the others were there already.
    alpha_rms_deg, alpha_max_deg : float
        √mean α², and the largest α.
    beta_deg : float
    rope_length_m : tuple of 2 floats
        Shortest and longest.
    fingerprint : str
    """

    path: Path
    frames: int
    labelled: int
    splits: dict[str, int]
    made: int
    alpha_rms_deg: float
    alpha_max_deg: float
    beta_deg: float
    rope_length_m: tuple[float, float]
    fingerprint: str


def render(
    scenario: Scenario,
    out: str | Path,
    *,
    workers: int = 1,
    resume: bool = False,
    progress: Progress | None = None,
) -> Summary:
    """Render a scenario's frames and labels into a folder.

    The same scenario gives the same bytes whatever the number of workers, and however often it was interrupted.

    Parameters
    ----------
    scenario : Scenario
        See `simgrab.scenes.load`.
    out : str or Path
        New or empty folder; with ``resume`` also one that an interrupted run of the same scenario left.
    workers : int
        Processes that draw.
    resume : bool
        Go on with an unfinished dataset.
    progress : callable, optional
        Called with (frames done, frames in all).

    Returns
    -------
    Summary

    Raises
    ------
    ScenarioError
        If a frame cannot be, or the camera never sees the grab; before anything is written.
    DatasetError
        If the folder cannot be used.
    RendererError
        If there is no offscreen OpenGL.
    """
    if workers < 1:
        raise DatasetError(f"workers must be 1 or more, got {workers}")
    folder = Folder(Path(out))
    world = model.build(scenario)
    frames.check(scenario, world)
    if not folder.open(manifest.identity(scenario), resume=resume):
        return _summary(folder.path, scenario, 0)
    with folder.lock():
        done = folder.done()
        drawn_by = folder.record(min(done)).drawn_by if done else None
        missing = [frame for frame in range(scenario.frames) if frame not in done]
        if progress:
            progress(len(done), scenario.frames)
        made = frames.make_all(scenario, world, missing, workers, folder.store)
        for count, fingerprint in enumerate(made, len(done) + 1):
            drawn_by = drawn_by or fingerprint
            if fingerprint != drawn_by:
                raise DatasetError(
                    f"{folder.path} was begun with {drawn_by.renderer}, MuJoCo {drawn_by.mujoco}; this is "
                    f"{fingerprint.renderer}, MuJoCo {fingerprint.mujoco}: choose another --out"
                )
            if progress:
                progress(count, scenario.frames)
        assert drawn_by is not None
        with writing(folder.path):
            _finish(folder, scenario, drawn_by)
    return _summary(folder.path, scenario, len(missing))


def _finish(folder: Folder, scenario: Scenario, drawn_by: Fingerprint) -> None:
    """Write everything that depends on all frames; the manifest comes last."""
    records = [folder.record(frame) for frame in range(scenario.frames)]
    rows = [record.truth for record in records]
    for row in rows:
        folder.write(f"labels/{row.split}/{row.frame:06d}.txt", export.yolo(row, scenario))
    for split in export.SPLITS:  # a split may be empty; a trainer still looks for its folder
        (folder.path / "images" / split).mkdir(parents=True, exist_ok=True)
    core = manifest.identity(scenario)
    tables = {
        "labels.parquet": export.parquet(rows, core),
        "data.yaml": export.yolo_yaml(),
        "camera.toml": export.calibration_of(scenario).to_toml().encode(),
        "preview.jpg": _preview(folder.path, rows),
        **{f"annotations/instances_{s}.json": export.coco(records, s, scenario) for s in export.SPLITS},
    }
    for name, data in tables.items():
        folder.write(name, data)
    whole = manifest.compose(scenario, drawn_by, tables)
    folder.write(MANIFEST, json.dumps(whole, indent=1).encode())
    folder.close()


def _preview(path: Path, rows: Sequence[Truth]) -> bytes:
    tiles = [preview.annotate(_read(path / row.file), row) for row in rows[: preview.MOST_TILES]]
    return frames.encode(preview.sheet(tiles), "jpeg", 90)


def _read(path: Path) -> NDArray[np.uint8]:
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise DatasetError(f"{path} is missing or not a picture")
    return np.asarray(picture, np.uint8)


def _summary(path: Path, scenario: Scenario, made: int) -> Summary:
    table = pq.read_table(
        path / "labels.parquet",
        columns=["split", "alpha_deg", "rope_length_m", "box_x0_px", "visible_fraction", "in_frame_fraction"],
    )
    alpha, rope = (table[name].to_numpy() for name in ("alpha_deg", "rope_length_m"))
    split = table["split"].to_pylist()
    seen = table["visible_fraction"].to_numpy() >= max(scenario.labels.least_visible_fraction, 1e-12)
    written = json.loads((path / MANIFEST).read_text(encoding="utf-8"))
    return Summary(
        path=path,
        frames=table.num_rows,
        labelled=int(seen.sum()),
        splits={name: split.count(name) for name in export.SPLITS},
        made=made,
        alpha_rms_deg=float(np.sqrt(np.mean(alpha**2))),
        alpha_max_deg=float(alpha.max()),
        beta_deg=scenario.camera.beta_deg,
        rope_length_m=(float(rope.min()), float(rope.max())),
        fingerprint=written["renderer"]["fingerprint"],
    )
