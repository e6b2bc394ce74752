"""Render a scenario into videos, each frame rendered once, beside a dataset or without one."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from simgrab.dataset import pool, price, record, stored
from simgrab.dataset.manifest import identity, same_renderer
from simgrab.dataset.pool import FrameNumbers, Progress, Tick
from simgrab.dataset.price import Price
from simgrab.dataset.summary import VideoSummary
from simgrab.dataset.video.encode import Shot, encode_clip
from simgrab.dataset.video.files import VideoFiles
from simgrab.dataset.video.transmission import Slot, slots
from simgrab.errors import ScenarioError
from simgrab.io.journal import Journal
from simgrab.model.scenario import Scenario
from simgrab.runtime.versions import Fingerprint
from simgrab.world.extensions import Effect, Motion, Randomiser, Recipe
from simgrab.world.frames import FrameGenerator


def render_video(
    scenario: Scenario | str | Path,
    path: str | Path,
    *,
    workers: int = 1,
    resume: bool = False,
    progress: Progress | None = None,
    checking: Progress | None = None,
    priced: Callable[[Price], None] | None = None,
    randomiser: Randomiser | str | None = None,
    trajectory: Motion | str | None = None,
    effects: Sequence[Effect | str] = (),
) -> VideoSummary:
    """Render a scenario into an H.264 video with a truth table beside it, or one of each for every clip.

    The same scenario gives the same bytes for any number of workers and interruptions.

    Parameters
    ----------
    scenario : Scenario
        ``clip`` sets how frames become clips, and how coding and network change them.
    path : str or Path
        ``swing.mp4`` or ``.mkv``; beside it come ``swing.parquet``, ``swing.camera.toml`` and ``swing.manifest.json``.
        Several clips become ``swing-000.mp4`` and so on.
    workers : int
        Processes, each of which makes a clip at a time.
    resume : bool
        Go on where an interrupted run stopped; unfinished clips are rendered again.
    progress, checking, priced, randomiser, trajectory, effects
        As `simgrab.render` takes them.

    Returns
    -------
    VideoSummary

    Raises
    ------
    ScenarioError
        If a frame is impossible, the camera never sees the grab, or the picture's size is odd. Nothing has been written
        then.
    DatasetError
        If the path is taken, or cannot be written.
    RendererError, ExtensionError, WorkerError
        As by `simgrab.render`.
    """
    recipe = Recipe.of(scenario, randomiser, trajectory, effects)
    if recipe.scenario.sensors:
        raise ScenarioError("sensors", "need a dataset: render one together with the video (--out)")
    if resume:
        recipe.extensions.refuse_unknown()
    pool.check(recipe, workers)
    clips = Clips(recipe, path)
    pool.fill(
        clips, recipe, workers=workers, resume=resume, progress=progress, checking=checking,
        before=functools.partial(price.announce, priced, files=False, video=True),
    )  # fmt: skip
    return clips.videos.summary(len(clips.remaining))


class Clips:
    """Videos as an output of `pool.fill`, whose units are clips."""

    def __init__(self, recipe: Recipe, path: str | Path) -> None:
        core = identity(recipe.scenario, recipe.extensions.describe())
        self.videos, self.remaining = VideoFiles(recipe.scenario, core, Path(path)), list[int]()
        self.work = ClipWork(self.videos, None)

    @property
    def journal(self) -> Journal:  # noqa: D102
        return self.videos.journal

    @property
    def most(self) -> int:  # noqa: D102
        return self.videos.scenario.clip_count

    def check(self, *, resume: bool) -> bool:  # noqa: D102
        self.remaining = self.videos.unfinished(resume=resume)
        return bool(self.remaining) or self.videos.partial.exists()

    @contextmanager
    def opened(self) -> Iterator[list[FrameNumbers]]:  # noqa: D102
        with self.journal.opened(self.videos.identity):
            yield [self.videos.scenario.span(clip) for clip in self.remaining]

    def take(self, made: Fingerprint) -> None:
        """All is done where it was made."""

    def finish(self) -> None:  # noqa: D102
        self.journal.close()


@dataclass(frozen=True)
class ClipWork:
    """Work on one clip: encode it, and store its frames in the journal's dataset, whichever is unfinished."""

    videos: VideoFiles
    journal: Journal | None

    def __call__(self, generator: FrameGenerator, frames: FrameNumbers, tick: Tick) -> Fingerprint:
        """Make the clip's frames, each once."""
        clip = generator.scenario.clip.of(frames[0])
        rendered_by = generator.scene(frames[0]).renderer.fingerprint
        if not self.videos.is_finished(clip):
            same_renderer(rendered_by, self.videos.rendered_by(), self.videos.path)
            encode_clip(self.videos, clip, self._shots(generator, clip, tick), rendered_by)
            return rendered_by
        for frame in frames:
            if self._lacks(frame):
                self._take(generator, frame)
            tick()
        return rendered_by

    def _shots(self, generator: FrameGenerator, clip: int, tick: Tick) -> Iterator[tuple[Slot, Shot | None]]:
        for slot in slots(self.videos.scenario, clip, self.videos.container.ticks_per_s):
            yield slot, self._take(generator, slot.frame) if slot.shows_frame or self._lacks(slot.frame) else None
            tick()

    def _lacks(self, frame: int) -> bool:
        return self.journal is not None and not self.journal.has(record.unit(frame))

    def _take(self, generator: FrameGenerator, number: int) -> Shot:
        frame = generator.frame(number, full=generator.scenario.image.stores_buffers)
        if self.journal is not None and self._lacks(number):
            stored.encoded(generator, frame).keep(self.journal)
        return Shot(frame.rgb, frame.truth, generator.recipe.split(number))
