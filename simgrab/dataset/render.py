"""Render a scenario into a dataset on disk."""

from __future__ import annotations

import functools
from collections.abc import Generator, Iterable, Sequence
from contextlib import closing, nullcontext
from dataclasses import replace
from itertools import groupby
from pathlib import Path

from simgrab.dataset import manifest, pool, preview, sensors, shards, stored, tables
from simgrab.dataset.datasets import MANIFEST
from simgrab.dataset.folder import Folder, finish, writing
from simgrab.dataset.pool import Progress, Tick
from simgrab.dataset.stored import StoredFrame
from simgrab.dataset.stores import is_url
from simgrab.dataset.summary import Seen, Summary, Tally
from simgrab.dataset.tables import Tables
from simgrab.dataset.video.files import VideoFiles
from simgrab.dataset.video.render import ClipWork, render_clips
from simgrab.errors import DatasetError
from simgrab.io import pictures
from simgrab.io.parse import read_json
from simgrab.model.records import frame_files
from simgrab.model.scenario import Scenario
from simgrab.model.truth import Row
from simgrab.world.extensions import Effect, Motion, Randomiser, Recipe
from simgrab.world.frames import FrameGenerator
from simgrab.world.gl import Fingerprint

MOST_FETCHED = 16
"""Frames that a task of a cluster makes for a folder, and sends here."""


def render(
    scenario: Scenario | str | Path,
    out: str | Path,
    *,
    video: str | Path | None = None,
    workers: int = 1,
    cluster: str | None = None,
    shard_frames: int | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    checking: Progress | None = None,
    randomiser: Randomiser | str | None = None,
    trajectory: Motion | str | None = None,
    effects: Sequence[Effect | str] = (),
) -> Summary:
    """Render a scenario's frames and labels into a folder, or into shards below a URL.

    The same scenario gives the same bytes whatever the number of workers, and however often it was interrupted. Where
    it has ``sensors``, what they report and the truth beside it are written too; see `simgrab.sensors`.

    Parameters
    ----------
    scenario : Scenario, str or Path
        A scenario, a bundled scene's name, or a scene file; see `simgrab.load`.
    out : str or Path
        New or empty folder; with ``resume`` also one that an interrupted run of the same scenario left. A URL such as
        ``s3://bucket/name`` or ``file:///data/name`` gets a dataset of shards; see `simgrab.dataset.shard_reader`.
    video : str or Path, optional
        Also makes a video of the same frames, each rendered once; see `simgrab.dataset.video.render.render_video`.
    workers : int
        Worker processes; with a video, each renders a clip at a time, and with shards a shard.
    cluster : str, optional
        Address of a Ray cluster that renders in place of worker processes: ``auto``, ``ray://host:10001`` or
        ``host:6379``.
    shard_frames : int, optional
        Frames of a shard, 256 unless given; rounded up to whole clips where each has a world of its own.
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
        If the folder or URL cannot be used.
    RendererError
        If there is no offscreen OpenGL.
    ExtensionError
        If a function of yours cannot be found, raises, or returns what no frame can be.
    WorkerError
        If worker processes die of a frame or clip again and again.
    ClusterError
        If there is no such cluster, or its nodes have other versions.
    """
    recipe = Recipe.of(scenario, randomiser, trajectory, effects)
    pool.check(recipe, workers, cluster)
    sensors.check(recipe)
    if resume:
        recipe.extensions.refuse_unknown()
    if video is not None and (cluster is not None or is_url(out)):
        raise DatasetError(
            "a video is rendered by this machine, beside a dataset in a folder: give neither cluster nor URL"
        )
    if is_url(out):
        return shards.render(
            recipe, str(out), workers=workers, cluster=cluster, resume=resume, shard_frames=shard_frames,
            progress=progress, checking=checking,
        )  # fmt: skip
    if shard_frames is not None:
        raise DatasetError(
            f"{out} is a folder, which has no shards; give a URL such as {Path(out).absolute().as_uri()}"
        )
    folder, videos = Folder(Path(out)), VideoFiles(recipe, Path(video)) if video is not None else None
    return _render(recipe, folder, videos, workers, cluster, progress, checking, resume=resume)


def _render(
    recipe: Recipe, folder: Folder, videos: VideoFiles | None, workers: int, cluster: str | None,
    progress: Progress | None, checking: Progress | None, *, resume: bool,
) -> Summary:  # fmt: skip
    """Render into a folder."""
    scenario, identity = recipe.scenario, manifest.identity(recipe)
    folder.check(identity, resume=resume)  # before it takes time to find out whether the scenario can be
    clips = videos.unfinished(resume=resume) if videos else []
    known = None if folder.begun else pool.vetted(recipe, workers, checking, cluster=cluster)
    made = 0
    if folder.open(identity, resume=resume):
        with folder.lock(), videos.claim() if videos and clips else nullcontext():
            done = folder.done()
            missing = [frame for frame in range(scenario.frames) if frame not in done]
            if videos and clips:
                drawn = _film(videos, clips, folder, known, missing, workers, progress)
            elif cluster is not None:
                drawn = _fetch(folder, recipe, known, missing, cluster, progress)
            else:
                drawn = _draw(folder, recipe, known, missing, workers, progress)
            with closing(drawn):
                rendered_by = _same(drawn, folder.record(min(done)).rendered_by if done else None, folder.path)
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
        return work_on(missing, functools.partial(_store, folder), unit="frame", frames=lambda n: (n,), progress=report)
    clips = sorted(set(map(scenario.clip.of, missing)))
    report = pool.report(progress, scenario.frames - _frames_of(scenario, clips), scenario.frames)
    work = functools.partial(_store_clip, folder)
    return work_on(clips, work, unit="clip", frames=scenario.span, progress=report)


def _fetch(
    folder: Folder, recipe: Recipe, known: pool.Vetted | None, missing: Sequence[int], cluster: str,
    progress: Progress | None,
) -> Generator[Fingerprint, None, None]:  # fmt: skip
    """Let a cluster render missing frames, and store them here: its machines need not share a file system."""
    scenario, each = recipe.scenario, MOST_FETCHED
    if recipe.varies and scenario.clip.clip_frames:
        each = min(each, scenario.clip.clip_frames)  # so that a task builds one world
    tasks = [tuple(group) for _, group in groupby(missing, key=lambda frame: frame // each)]
    report = pool.report(progress, scenario.frames - len(missing), scenario.frames)
    drawn = pool.map_items(
        recipe, known, tasks, _made, workers=1, cluster=cluster, unit="frames", frames=iter, progress=report
    )
    with closing(drawn):
        for frames in drawn:
            for frame in frames:
                folder.store(frame)
            yield frames[0].record.rendered_by


def _made(generator: FrameGenerator, frames: tuple[int, ...], tick: Tick) -> list[StoredFrame]:
    made = []
    for frame in frames:
        made.append(stored.make(generator, frame))
        tick()
    return made


def _frames_of(scenario: Scenario, clips: Iterable[int]) -> int:
    return sum(len(scenario.span(clip)) for clip in clips)


def _store(folder: Folder, generator: FrameGenerator, frame: int, tick: Tick) -> Fingerprint:
    made = stored.make(generator, frame)
    folder.store(made)
    tick()
    return made.record.rendered_by


def _store_clip(folder: Folder, generator: FrameGenerator, clip: int, tick: Tick) -> Fingerprint:
    """Make the missing frames of a clip, whose world is built once."""
    for frame in generator.scenario.span(clip):
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
    return pool.map_items(
        videos.recipe, known, clips, work, workers=workers, unit="clip", frames=scenario.span, progress=report
    )


def _same(drawn: Iterable[Fingerprint], first: Fingerprint | None, path: Path) -> Fingerprint:
    """Exhaust the rendering; returns its renderer, which must be the same for all frames."""
    for fingerprint in drawn:
        first = pool.same_renderer(fingerprint, first, path)
    assert first is not None
    return first


def _finish(folder: Folder, recipe: Recipe, rendered_by: Fingerprint) -> None:
    """Write everything that depends on all frames, one frame at a time; the manifest comes last."""
    scenario, core = recipe.scenario, manifest.identity(recipe)
    first, tally = list[Row](), Tally()
    with Tables(folder.writing, core, scenario) as written:
        for frame in range(scenario.frames):
            record = folder.record(frame)
            pool.same_renderer(record.rendered_by, rendered_by, folder.path)
            row = record.truth
            written.add(row, record.mask)
            folder.write(f"labels/{row.split}/{row.frame:06d}.txt", tables.yolo(row, scenario))
            tally += Tally.of([row], scenario)
            first += [row] * (len(first) < preview.MOST_TILES)
    tiles = ((pictures.read(folder.path / row.file)[..., ::-1], row) for row in first)
    others = sensors.write(recipe, folder.writing)
    core |= tally.stated(scenario)
    finish(folder, core, written.splits, preview.of(tiles), scenario, rendered_by, written=others)
    folder.close()


def _summary(path: Path, scenario: Scenario, made: int) -> Summary:
    rows, _, _ = frame_files.read_rows(path, Seen)
    written = read_json(path / MANIFEST, DatasetError)
    return Summary.of(path, Tally.of(rows, scenario), scenario, made, written["renderer"]["fingerprint"])
