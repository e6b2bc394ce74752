"""Render a scenario into a dataset on disk."""

from __future__ import annotations

import functools
import hashlib
import json
from collections import Counter
from collections.abc import Generator, Iterable, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import msgspec
import numpy as np

from simgrab.errors import DatasetError
from simgrab.labels.truth import SPLITS, Row
from simgrab.records import frame_files
from simgrab.scenario import Scenario
from simgrab.utilities import pictures
from simgrab.utilities.parse import read_json
from simgrab.world.extensions import Effect, Motion, Randomiser, Recipe
from simgrab.world.frames import FrameGenerator
from simgrab.world.gl import Fingerprint
from simgrab.world.output import export, manifest, pool, preview, stored
from simgrab.world.output.folder import MANIFEST, Folder, writing
from simgrab.world.output.pool import Progress, Tick
from simgrab.world.output.video.files import VideoFiles
from simgrab.world.output.video.render import ClipWork, VideoSummary, render_clips


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
        Frames rendered in this run; the others were there already.
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
    scenario: Scenario | str | Path,
    out: str | Path,
    *,
    video: str | Path | None = None,
    workers: int = 1,
    resume: bool = False,
    progress: Progress | None = None,
    checking: Progress | None = None,
    randomiser: Randomiser | str | None = None,
    trajectory: Motion | str | None = None,
    effects: Sequence[Effect | str] = (),
) -> Summary:
    """Render a scenario's frames and labels into a folder.

    The same scenario gives the same bytes whatever the number of workers, and however often it was interrupted.

    Parameters
    ----------
    scenario : Scenario, str or Path
        A scenario, a bundled scene's name, or a scene file; see `simgrab.load`.
    out : str or Path
        New or empty folder; with ``resume`` also one that an interrupted run of the same scenario left.
    video : str or Path, optional
        Also makes a video of the same frames, each rendered once; see `simgrab.world.output.video.render.render_video`.
    workers : int
        Worker processes; with a video, each renders a clip at a time.
    resume : bool
        Go on with an unfinished dataset.
    progress : callable, optional
        Called with (frames done, frames in all).
    checking : callable, optional
        Called before that, where there are many worlds, with (worlds that were found possible, worlds in all).
    randomiser, trajectory, effects
        Functions of yours, as `simgrab.frames` takes them. The manifest names them, with digests of their source; for
        several workers they must be defined at the top of a module.

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
    ExtensionError
        If a function of yours cannot be found, raises, or returns what no frame can be.
    WorkerError
        If worker processes die of a frame or clip again and again.
    """
    recipe = Recipe.of(scenario, randomiser, trajectory, effects)
    pool.check(recipe, workers)
    scenario = recipe.scenario
    if resume:
        recipe.extensions.refuse_unknown()
    folder, identity = Folder(Path(out)), manifest.identity(recipe)
    folder.check(identity, resume=resume)  # before it takes time to find out whether the scenario can be
    videos = VideoFiles(recipe, Path(video)) if video is not None else None
    clips = videos.unfinished(resume=resume) if videos else []
    known = None if folder.begun else pool.vetted(recipe, workers, checking)
    made = 0
    if folder.open(identity, resume=resume):
        with folder.lock(), videos.claim() if videos and clips else nullcontext():
            done = folder.done()
            missing = [frame for frame in range(scenario.frames) if frame not in done]
            if videos and clips:
                drawn = _film(videos, clips, folder, known, missing, workers, progress)
            else:
                drawn = _draw(folder, recipe, known, missing, workers, progress)
            with closing(drawn):
                rendered_by = _one(drawn, folder.record(min(done)).rendered_by if done else None, folder.path)
            with writing(folder.path):
                _finish(folder, recipe, rendered_by)
        made = len(missing)
    if videos is None:
        return _summary(folder.path, scenario, made)
    # Makes the video where only that remains; else finds it finished.
    summary = render_clips(recipe, videos.path, workers=workers, resume=True, progress=progress)
    return replace(_summary(folder.path, scenario, made), video=replace(summary, made=len(clips)))


def _draw(
    folder: Folder, recipe: Recipe, known: pool.Vetted | None, missing: Sequence[int], workers: int,
    progress: Progress | None,
) -> Generator[Fingerprint, None, None]:  # fmt: skip
    """Draw and store missing frames, clip by clip where each clip is a world of its own."""
    scenario = recipe.scenario
    work_on = functools.partial(pool.map_items, recipe, known, workers=workers)
    if not recipe.varies:
        report = pool.report(progress, scenario.frames - len(missing), scenario.frames)
        return work_on(missing, functools.partial(_store, folder), unit="frame", progress=report)
    clips = sorted(set(map(scenario.clip.of, missing)))
    report = pool.report(progress, scenario.frames - _frames_of(scenario, clips), scenario.frames)
    return work_on(clips, functools.partial(_store_clip, folder), unit="clip", progress=report)


def _frames_of(scenario: Scenario, clips: Iterable[int]) -> int:
    return sum(len(scenario.clip.span(clip, scenario.frames)) for clip in clips)


def _store(folder: Folder, generator: FrameGenerator, frame: int, tick: Tick) -> Fingerprint:
    made = stored.make(generator, frame)
    folder.store(made)
    tick()
    return made.record.rendered_by


def _store_clip(folder: Folder, generator: FrameGenerator, clip: int, tick: Tick) -> Fingerprint:
    """Make the missing frames of a clip, whose world is built once."""
    for frame in generator.scenario.clip.span(clip, generator.scenario.frames):
        if folder.has(frame):
            tick()
        else:
            _store(folder, generator, frame, tick)
    return folder.record(frame).rendered_by


def _film(
    videos: VideoFiles,
    unfinished: Sequence[int],
    folder: Folder,
    known: pool.Vetted | None,
    missing: Sequence[int],
    workers: int,
    progress: Progress | None,
) -> Generator[Fingerprint, None, None]:
    """Film unfinished clips and store missing frames, each rendered once."""
    scenario, clip = videos.scenario, videos.scenario.clip
    clips = sorted({*unfinished, *map(clip.of, missing)})
    report = pool.report(progress, scenario.frames - _frames_of(scenario, clips), scenario.frames)
    work = ClipWork(videos, folder)
    return pool.map_items(videos.recipe, known, clips, work, workers=workers, unit="clip", progress=report)


def _one(drawn: Iterable[Fingerprint], first: Fingerprint | None, path: Path) -> Fingerprint:
    """Exhaust the rendering; returns its renderer, which must be the same for all frames."""
    for fingerprint in drawn:
        first = first or fingerprint
        if fingerprint != first:
            raise DatasetError(f"{path} was started with {first}, and this is {fingerprint}: choose another --out")
    assert first is not None
    return first


def _finish(folder: Folder, recipe: Recipe, rendered_by: Fingerprint) -> None:
    """Write everything that depends on all frames; the manifest comes last."""
    scenario = recipe.scenario
    records = [folder.record(frame) for frame in range(scenario.frames)]
    rows = [record.truth for record in records]
    for row in rows:
        folder.write(f"labels/{row.split}/{row.frame:06d}.txt", export.yolo(row, scenario))
    for split in SPLITS:  # a split may be empty; a trainer still looks for its folder
        (folder.path / "images" / split).mkdir(parents=True, exist_ok=True)
    core = manifest.identity(recipe)
    tables = {
        "labels.parquet": export.parquet(rows, core),
        "data.yaml": export.yolo_yaml(rows),
        "camera.toml": export.calibration_of(scenario).to_toml().encode(),
        "preview.jpg": _preview(folder.path, rows),
        **{f"annotations/instances_{s}.json": export.coco(records, s, scenario) for s in SPLITS},
        **{export.metadata_name(s): export.metadata(rows, s) for s in export.filled(rows)},
    }
    for name, data in tables.items():
        folder.write(name, data)
    digests = {name: hashlib.sha256(data).hexdigest() for name, data in tables.items()}
    whole = manifest.compose(core, rendered_by, digests)
    folder.write(MANIFEST, json.dumps(whole, indent=1).encode())
    folder.close()


def _preview(path: Path, rows: Sequence[Row]) -> bytes:
    tiles = [
        preview.annotate(pictures.read(path / row.file, cv2.IMREAD_COLOR), row) for row in rows[: preview.MOST_TILES]
    ]
    return pictures.encode(preview.sheet(tiles), "jpeg", 90)


class _Seen(msgspec.Struct, frozen=True):
    split: str
    alpha_deg: float
    rope_length_m: float
    visible_fraction: float


def _summary(path: Path, scenario: Scenario, made: int) -> Summary:
    rows, _, _ = frame_files.read_rows(path, _Seen)
    alpha, rope = (np.array([getattr(row, name) for row in rows]) for name in ("alpha_deg", "rope_length_m"))
    splits = Counter(row.split for row in rows)
    least = max(scenario.labels.least_visible_fraction, 1e-12)
    written = read_json(path / MANIFEST, DatasetError)
    return Summary(
        path=path,
        frames=len(rows),
        labelled=sum(row.visible_fraction >= least for row in rows),
        splits={name: splits[name] for name in SPLITS},
        made=made,
        alpha_rms_deg=float(np.sqrt(np.mean(alpha**2))),
        alpha_max_deg=float(alpha.max()),
        beta_deg=scenario.camera.beta_deg,
        rope_length_m=(float(rope.min()), float(rope.max())),
        fingerprint=written["renderer"]["fingerprint"],
    )
