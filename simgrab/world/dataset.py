"""Render a scenario into a dataset on disk."""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from simgrab.errors import DatasetError
from simgrab.records import Truth
from simgrab.scenario import Scenario
from simgrab.world import crew, export, frames, manifest, preview
from simgrab.world.crew import Progress, Tick, Work
from simgrab.world.folder import MANIFEST, Folder, writing
from simgrab.world.frames import Studio
from simgrab.world.gl import Fingerprint
from simgrab.world.plan import Plan
from simgrab.world.video.files import Reels
from simgrab.world.video.render import Filming, VideoSummary, render_video


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
    video : VideoSummary or None
        Where there is one beside the dataset.
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
    video: VideoSummary | None = None


def render(
    scenario: Scenario,
    out: str | Path,
    *,
    video: str | Path | None = None,
    workers: int = 1,
    resume: bool = False,
    progress: Progress | None = None,
    checking: Progress | None = None,
) -> Summary:
    """Render a scenario's frames and labels into a folder.

    The same scenario gives the same bytes whatever the number of workers, and however often it was interrupted.

    Parameters
    ----------
    scenario : Scenario
        See `simgrab.scenes.load`.
    out : str or Path
        New or empty folder; with ``resume`` also one that an interrupted run of the same scenario left.
    video : str or Path, optional
        Makes a video of the same frames as well, each drawn once; see `simgrab.world.video.render.render_video`.
    workers : int
        Processes that draw; with a video, each draws a clip at a time.
    resume : bool
        Go on with an unfinished dataset.
    progress : callable, optional
        Called with (frames done, frames in all).
    checking : callable, optional
        Called before that, where there are many worlds, with (worlds that were found possible, worlds in all).

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
    crew.check(workers)
    folder = Folder(Path(out))
    plan = None if folder.begun else crew.vetted(scenario, workers, checking)
    reels = Reels(scenario, Path(video)) if video is not None else None
    clips = reels.unfinished(resume=resume) if reels else []
    made = 0
    if folder.open(manifest.identity(scenario), resume=resume):
        with folder.lock(), reels.claim() if reels and clips else nullcontext():
            done = folder.done()
            missing = [frame for frame in range(scenario.frames) if frame not in done]
            if reels and clips:
                drawn = _film(reels, clips, folder, plan, missing, workers, progress)
            else:
                report = crew.report(progress, len(done), scenario.frames)
                work: Work[Fingerprint] = functools.partial(_store_clip if scenario.vary else _store, folder)
                items = sorted(set(map(scenario.clip.of, missing))) if scenario.vary else missing
                drawn = crew.share(scenario, plan, items, work, workers=workers, progress=report)
            drawn_by = _one(drawn, folder.record(min(done)).drawn_by if done else None, folder.path)
            with writing(folder.path):
                _finish(folder, scenario, drawn_by)
        made = len(missing)
    if reels is None:
        return _summary(folder.path, scenario, made)
    # Makes the video where only that remains; else finds it finished.
    filmed = render_video(scenario, reels.path, workers=workers, resume=True, progress=progress)
    return replace(_summary(folder.path, scenario, made), video=replace(filmed, made=len(clips)))


def _store(folder: Folder, studio: Studio, frame: int, tick: Tick) -> Fingerprint:
    made = studio.make(frame)
    folder.store(made)
    tick()
    return made.record.drawn_by


def _store_clip(folder: Folder, studio: Studio, clip: int, tick: Tick) -> Fingerprint:
    """Make the missing frames of a clip, whose world is built once."""
    for frame in studio.scenario.clip.span(clip, studio.scenario.frames):
        if not folder.has(frame):
            drawn_by = _store(folder, studio, frame, tick)
    return drawn_by


def _film(
    reels: Reels,
    unfinished: Sequence[int],
    folder: Folder,
    plan: Plan | None,
    missing: Sequence[int],
    workers: int,
    progress: Progress | None,
) -> Iterator[Fingerprint]:
    """Film unfinished clips and store missing frames, each drawn once."""
    scenario, clip = reels.scenario, reels.scenario.clip
    filmed = set(unfinished)
    clips = sorted(filmed.union(map(clip.of, missing)))
    left = sum(len(clip.span(c, scenario.frames)) for c in unfinished)
    left += sum(clip.of(frame) not in filmed for frame in missing)
    report = crew.report(progress, scenario.frames - left, scenario.frames)
    return crew.share(scenario, plan, clips, Filming(reels, folder), workers=workers, progress=report)


def _one(drawn: Iterable[Fingerprint], first: Fingerprint | None, path: Path) -> Fingerprint:
    """Work through what is drawn, which one renderer must have drawn all of; returns that."""
    for fingerprint in drawn:
        first = first or fingerprint
        if fingerprint != first:
            raise DatasetError(
                f"{path} was begun with {first.renderer}, MuJoCo {first.mujoco}; this is "
                f"{fingerprint.renderer}, MuJoCo {fingerprint.mujoco}: choose another --out"
            )
    assert first is not None
    return first


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
    digests = {name: hashlib.sha256(data).hexdigest() for name, data in tables.items()}
    whole = manifest.compose(core, drawn_by, digests)
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
