"""Render a scenario into a dataset on disk."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from itertools import chain, groupby, pairwise
from pathlib import Path
from typing import Any

from simgrab.dataset import manifest, pool, preview, price, record, sensors, shards, stored, tables
from simgrab.dataset.datasets import MANIFEST, named, read_manifest
from simgrab.dataset.pool import FrameNumbers, Progress, Tick, Work
from simgrab.dataset.price import Price
from simgrab.dataset.record import StoredFrame
from simgrab.dataset.shard_reader import table
from simgrab.dataset.shards import Done, Packed
from simgrab.dataset.summary import Summary, Tally, TallyColumns
from simgrab.dataset.tables import Contents
from simgrab.dataset.video.render import Clips, ClipWork
from simgrab.errors import DatasetError
from simgrab.io import pictures
from simgrab.io.journal import Journal
from simgrab.io.stores import Store, is_url
from simgrab.model.records import frame_files
from simgrab.model.scenario import Scenario
from simgrab.model.truth import Row
from simgrab.runtime.versions import Fingerprint
from simgrab.world.extensions import Effect, Motion, Randomiser, Recipe
from simgrab.world.frames import FrameGenerator

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
    priced: Callable[[Price], None] | None = None,
    randomiser: Randomiser | str | None = None,
    trajectory: Motion | str | None = None,
    effects: Sequence[Effect | str] = (),
) -> Summary:
    """Render a scenario's frames and labels into a folder, or into shards below a URL.

    The same scenario gives the same bytes for any number of workers and interruptions. If it has ``sensors``, their
    readings and the truth of them are written too; see `simgrab.sensors`.

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
        Called before that, if there are many worlds, with (worlds found possible, worlds in all).
    priced : callable, optional
        Called before the first frame with an estimate of time and size, which takes as long as some ten
        frames; not on a cluster.
    randomiser, trajectory, effects
        Functions of yours, as `simgrab.frames` takes them. The manifest names them, with digests of their source; for
        several workers they must be defined at the top of a module.

    Returns
    -------
    Summary

    Raises
    ------
    ScenarioError
        If a frame is impossible or the camera never sees the grab. Nothing has been written then.
    DatasetError
        If the folder or URL cannot be used.
    RendererError
        If there is no offscreen OpenGL.
    ExtensionError
        If a function of yours cannot be found, raises, or returns impossible values.
    WorkerError
        If worker processes die repeatedly at one frame or clip.
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
    if shard_frames is not None and not is_url(out):
        raise DatasetError(f"{out} is a folder; shards need a URL such as {Path(out).absolute().as_uri()}")
    videos = Clips(recipe, video) if video is not None else None
    output: _Folder | _Shards
    output = (
        _Shards(recipe, str(out), shard_frames) if is_url(out) else _Folder(recipe, Path(out), videos, cluster, workers)
    )
    made = pool.fill(
        output, recipe, workers=workers, cluster=cluster, resume=resume, progress=progress, checking=checking,
        before=functools.partial(price.announce, priced, files=True, video=video is not None),
    )  # fmt: skip
    summary = output.summary(made)
    if videos is None:
        return summary
    clips = len(videos.remaining)
    # Makes the video where only that remains; else finds it finished.
    pool.fill(videos, recipe, workers=workers, resume=True, progress=progress)
    return replace(summary, video=videos.videos.summary(clips))


class _Folder:
    """A dataset in a folder as an output of `pool.fill`: its units are frames, or clips where a video is made too.

    Frames that share a draw are made together where worlds vary, but for the last ones, of which each worker gets a
    part. A cluster, whose machines need not share a file system, sends frames here.
    """

    def __init__(self, recipe: Recipe, path: Path, videos: Clips | None, cluster: str | None, workers: int) -> None:
        self.journal, self._recipe, self._videos, self._cluster = Journal.of(path), recipe, videos, cluster
        self._workers = min(workers, recipe.scenario.clip_count)
        self._core = manifest.identity(recipe.scenario, recipe.extensions.describe())
        self._rendered_by: Fingerprint | None = None
        self._films = False

    @property
    def most(self) -> int:
        scenario = self._recipe.scenario
        return scenario.clip_count if self._films or self._recipe.varies else scenario.frames

    def check(self, *, resume: bool) -> bool:
        remaining = self.journal.check(self._core, resume=resume)
        self._films = self._videos is not None and self._videos.check(resume=resume)
        return remaining

    @contextmanager
    def opened(self) -> Iterator[list[FrameNumbers]]:
        with ExitStack() as stack:
            stack.enter_context(self.journal.opened(self._core))
            clips = stack.enter_context(self._videos.opened()) if self._videos and self._films else []
            units, frames = self.journal.units(), range(self._recipe.scenario.frames)
            done = [frame for frame in frames if record.unit(frame) in units]
            missing = [frame for frame in frames if record.unit(frame) not in units]
            if done:
                self._rendered_by = record.known(self.journal, done[0]).rendered_by
            yield self._clips(clips, missing) if self._films else self._groups(missing)

    def _clips(self, unfinished: list[FrameNumbers], missing: Sequence[int]) -> list[FrameNumbers]:
        scenario = self._recipe.scenario
        clips = {*map(scenario.clip.of, missing), *(scenario.clip.of(frames[0]) for frames in unfinished)}
        return [scenario.span(clip) for clip in sorted(clips)]

    def _groups(self, missing: Sequence[int]) -> list[FrameNumbers]:
        recipe, most = self._recipe, MOST_FETCHED if self._cluster is not None else 1

        def group(frame: int) -> object:
            return recipe.slowest_draw(frame), (frame // most if self._cluster or not recipe.varies else 0)

        groups: list[FrameNumbers] = [tuple(frames) for _, frames in groupby(missing, key=group)]
        over = len(groups) % self._workers if recipe.varies and self._cluster is None else 0
        if not over:
            return groups
        rest = tuple(chain.from_iterable(groups[-over:]))
        return [*groups[:-over], *_parts(rest, recipe.scenario, self._workers)]

    @property
    def work(self) -> Work[Any]:
        if self._films:
            assert self._videos is not None
            return ClipWork(self._videos.videos, self.journal)
        return functools.partial(_made, None if self._cluster is not None else self.journal)

    def take(self, made: Fingerprint | list[StoredFrame]) -> None:
        if isinstance(made, list):
            for frame in made:
                frame.keep(self.journal)
            made = made[0].record.rendered_by
        self._rendered_by = manifest.same_renderer(made, self._rendered_by, self.journal.folder)

    def finish(self) -> None:
        """Write the files that depend on all frames, one frame at a time; the manifest comes last."""
        scenario, store, core = self._recipe.scenario, self.journal.store, self._core
        rows, tally, shown = list[Row](), Tally(), set(preview.shown(scenario.frames))
        assert self._rendered_by is not None
        with store.guarded():
            with tables.tables_of(store, core, scenario) as add:
                for frame in range(scenario.frames):
                    known = record.known(self.journal, frame)
                    manifest.same_renderer(known.rendered_by, self._rendered_by, store.place)
                    add(known.truth, known.mask)
                    tally += Tally.of([known.truth], scenario)
                    rows += [known.truth] * (frame in shown)
            tiles = ((pictures.read(self.journal.folder / row.file)[..., ::-1], row) for row in rows)
            others = sensors.write(self._recipe, store.writing)
            core = core | tally.stated(scenario)
            digests = {name: store.sha256(name) for name in others}
            tables.finish(store, Contents(core, scenario, self._rendered_by, tiles, tally), digests)
            if self._videos and self._films:
                self._videos.finish()
            self.journal.close()

    def summary(self, made: int) -> Summary:
        path, scenario = self.journal.folder, self._recipe.scenario
        rows, _, _ = frame_files.read_rows(path, TallyColumns)
        known = named(read_manifest(self.journal.store), path)
        return Summary.of(path, Tally.of(rows, scenario), scenario, made, known.renderer.digest)


def _parts(frames: FrameNumbers, scenario: Scenario, most: int) -> list[FrameNumbers]:
    """Divide frames between clips into parts, about alike."""
    clips = [tuple(some) for _, some in groupby(frames, key=scenario.clip.of)]
    count = min(most, len(clips))
    ends = [len(clips) * k // count for k in range(count + 1)]
    return [tuple(chain.from_iterable(clips[begin:end])) for begin, end in pairwise(ends)]


def _made(journal: Journal | None, generator: FrameGenerator, frames: FrameNumbers, tick: Tick) -> Any:
    """Make frames. Returns their renderer once they are stored or, without a journal, the frames themselves."""
    made = []
    for frame in frames:
        one = stored.make(generator, frame)
        if journal is None:
            made.append(one)
        else:
            one.keep(journal)
        tick()
    return made or one.record.rendered_by


class _Shards:
    """A dataset of shards as an output of `pool.fill`, whose units are shards."""

    def __init__(self, recipe: Recipe, url: str, shard_frames: int | None) -> None:
        self._recipe, scenario = recipe, recipe.scenario
        self._core = manifest.identity(scenario, recipe.extensions.describe())
        self._frames = shards.frames_of(scenario, shard_frames, varies=recipe.varies)
        self._spans = shards.spans(scenario, self._frames)
        self.journal = Journal(Store(url), partial="", claim=shards.UNFINISHED, whole=MANIFEST)
        self._done: dict[int, Done] = {}
        self._rendered_by: Fingerprint | None = None
        self.work = functools.partial(_shard, self.journal, self._frames)

    @property
    def most(self) -> int:
        return len(self._spans)

    @property
    def _identity(self) -> dict[str, Any]:
        return self._core | {"shard_frames": self._frames}

    def check(self, *, resume: bool) -> bool:
        remaining = self.journal.check(self._identity, resume=resume)
        for one in shards.complete(self.journal.store, self._recipe.scenario, len(self._spans)):
            self.take(one)
        return remaining or len(self._done) < len(self._spans)

    @contextmanager
    def opened(self) -> Iterator[list[FrameNumbers]]:
        with self.journal.opened(self._identity):
            if self.journal.store.exists(MANIFEST):  # of a finished dataset that lost shards
                self.journal.store.remove(MANIFEST)
            yield [frames for number, frames in enumerate(self._spans) if number not in self._done]

    def take(self, made: Done) -> None:
        where = f"{self.journal.store.place}, {table(made.number)}"
        self._rendered_by = manifest.same_renderer(made.rendered_by, self._rendered_by, where)
        self._done[made.number] = made

    def finish(self) -> None:
        """Write the files that depend on all shards; the manifest comes last."""
        scenario, store = self._recipe.scenario, self.journal.store
        assert self._rendered_by is not None
        shards.check_claimed(self.journal, scenario)
        others = sensors.write(self._recipe, store.writing)
        shards.check_claimed(self.journal, scenario)
        there = store.sizes("labels")
        for number in range(len(self._spans)):
            if table(number) not in there:
                raise DatasetError(f"{store.place}: {table(number)} is gone; run it again with --resume")
        digests = {name: store.sha256(name) for name in others}
        known = [self._done[number] for number in range(len(self._spans))]
        shards.finish(store, self._core, self._frames, known, scenario, self._rendered_by, digests)
        self.journal.close()

    def summary(self, made: int) -> Summary:
        assert self._rendered_by is not None
        tally = functools.reduce(Tally.__add__, (self._done[number].tally for number in sorted(self._done)))
        place = self.journal.store.place
        return Summary.of(place, tally, self._recipe.scenario, made, self._rendered_by.digest)


def _shard(journal: Journal, frames_each: int, generator: FrameGenerator, frames: range, tick: Tick) -> Done:
    """Make a shard and write it."""
    scenario = generator.scenario

    def packed() -> Iterator[Packed]:
        for frame in frames:
            made = stored.make(generator, frame)
            row, mask = made.record.truth, made.record.mask
            yield Packed(row, mask if tables.is_labelled(row, scenario) else None, made.files)
            tick()

    rendered_by = generator.scene(frames[0]).renderer.fingerprint
    shards.check_claimed(journal, scenario)
    return shards.write(journal.store, frames.start // frames_each, packed(), scenario, rendered_by)
