"""Render a scenario into videos, each frame rendered once, beside a dataset or without one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import pyarrow.compute as pc

from simgrab.dataset import pool, stored
from simgrab.dataset.folder import Folder
from simgrab.dataset.pool import Progress, Tick
from simgrab.dataset.video.encode import Shot, encode_clip
from simgrab.dataset.video.files import VideoFiles
from simgrab.errors import DatasetError, ScenarioError
from simgrab.io import parquet
from simgrab.model.scenario import Scenario
from simgrab.world.extensions import Effect, Motion, Randomiser, Recipe
from simgrab.world.frames import FrameGenerator
from simgrab.world.gl import Fingerprint


@dataclass(frozen=True)
class VideoSummary:
    """What finished videos hold.

    Attributes
    ----------
    path : Path
    clips, made : int
        Clips, and those made in this run; the others were there already.
    frames, sent, repeated, dropped : int
        Frames that the camera took, pictures in the videos, those among them that were sent again, and frames of which
        nothing was sent.
    mbit_s : float
        Size of the videos over the time that they show.
    clamped : dict of str to int, or None
        Frames in the videos by key of the swing that was replaced by the nearest possible value; None without
        ``swing.clamp``.
    fingerprint : str
    """

    path: Path
    clips: int
    made: int
    frames: int
    sent: int
    repeated: int
    dropped: int
    mbit_s: float
    clamped: dict[str, int] | None
    fingerprint: str


def render_video(
    scenario: Scenario | str | Path,
    path: str | Path,
    *,
    workers: int = 1,
    resume: bool = False,
    progress: Progress | None = None,
    checking: Progress | None = None,
    randomiser: Randomiser | str | None = None,
    trajectory: Motion | str | None = None,
    effects: Sequence[Effect | str] = (),
) -> VideoSummary:
    """Render a scenario into an H.264 video with a truth table beside it, or one of each for every clip.

    The same scenario gives the same bytes whatever the number of workers, and however often it was interrupted.

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
    progress : callable, optional
        Called with (frames done, frames in all).
    checking : callable, optional
        Called before that, where there are many worlds, with (worlds that were found possible, worlds in all).
    randomiser, trajectory, effects
        Functions of yours, as `simgrab.frames` takes them; see `simgrab.render`.

    Returns
    -------
    VideoSummary

    Raises
    ------
    ScenarioError
        If a frame cannot be, the camera never sees the grab, or the picture's size is odd; before anything is written.
    DatasetError
        If something else lies there, or it cannot be written.
    RendererError
        If there is no offscreen OpenGL.
    ExtensionError
        If a function of yours cannot be found, raises, or returns what no frame can be.
    WorkerError
        If worker processes die of a frame or clip again and again.
    """
    recipe = Recipe.of(scenario, randomiser, trajectory, effects)
    if recipe.scenario.sensors:
        raise ScenarioError("sensors", "are written beside a dataset: render one together with the video (--out)")
    if resume:
        recipe.extensions.refuse_unknown()
    return render_clips(recipe, path, workers=workers, resume=resume, progress=progress, checking=checking)


def render_clips(
    recipe: Recipe,
    path: str | Path,
    *,
    workers: int = 1,
    resume: bool = False,
    progress: Progress | None = None,
    checking: Progress | None = None,
) -> VideoSummary:
    """Render a recipe into videos; see `render_video`."""
    pool.check(recipe, workers)
    scenario, videos = recipe.scenario, VideoFiles(recipe, Path(path))
    clips = videos.unfinished(resume=resume)
    if clips or videos.partial.exists():
        known = pool.vetted(recipe, workers, checking)
        ahead = scenario.frames - sum(len(scenario.span(clip)) for clip in clips)
        report = pool.report(progress, ahead, scenario.frames)
        work = ClipWork(videos, None)
        with (
            videos.claim(),
            closing(
                pool.map_items(
                    recipe, known, clips, work, workers=workers, unit="clip", frames=scenario.span, progress=report
                )
            ) as summary,
        ):
            for _ in summary:
                pass
    return _summary(videos, len(clips))


@dataclass(frozen=True)
class ClipWork:
    """Work on one clip: encode it, and store its frames in a dataset, where either is unfinished.

    Parameters
    ----------
    videos : VideoFiles
    folder : Folder or None
        Of the dataset, if there is one.
    """

    videos: VideoFiles
    folder: Folder | None

    def __call__(self, generator: FrameGenerator, clip: int, tick: Tick) -> Fingerprint:
        """Make the clip's frames, each once."""
        span = generator.scenario.span(clip)
        rendered_by = generator.scene(span.start).renderer.fingerprint
        if not self.videos.is_finished(clip):
            self._refuse_other_renderers(rendered_by)
            encode_clip(
                self.videos, clip, lambda frame: self._take(generator, frame), rendered_by, tick=tick, also=self._lacks
            )
            return rendered_by
        for frame in span:
            if self._lacks(frame):
                self._take(generator, frame)
            tick()
        return rendered_by

    def _lacks(self, frame: int) -> bool:
        return self.folder is not None and not self.folder.has(frame)

    def _take(self, generator: FrameGenerator, number: int) -> Shot:
        frame = generator.frame(number, full=generator.scenario.image.stores_buffers)
        if self.folder is not None and self._lacks(number):
            self.folder.store(stored.encoded(generator, frame))
        return Shot.of(frame, generator.recipe)

    def _refuse_other_renderers(self, rendered_by: Fingerprint) -> None:
        begun_by = self.videos.rendered_by()
        if begun_by not in (None, rendered_by.digest):
            raise DatasetError(
                f"{self.videos.path} was started with another renderer than {rendered_by}: choose another --video"
            )


def _summary(videos: VideoFiles, made: int) -> VideoSummary:
    scenario = videos.scenario
    sent = repeated = size = 0
    clamped = Counter[str]()
    for clip in range(videos.count):
        files = videos.files(clip)
        column = parquet.read_table(files[".parquet"], DatasetError, columns=["repeated"])["repeated"]
        sent += len(column)
        repeated += pc.sum(column).as_py()
        clamped.update((videos.known(clip) or {}).get("clamped", {}))
        size += files[videos.path.suffix].stat().st_size
    return VideoSummary(
        path=videos.path,
        clips=videos.count,
        made=made,
        frames=scenario.frames,
        sent=sent,
        repeated=repeated,
        dropped=scenario.frames - sent,
        mbit_s=size * 8e-6 / (scenario.frames / scenario.clip.frame_rate_hz),
        clamped=dict(clamped) or None,
        fingerprint=str(videos.rendered_by()),
    )
