"""Make a clip: take its pictures in order, send them, and note what each shows."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import av
import msgspec
import numpy as np
from numpy.typing import NDArray

from simgrab.dataset import manifest, tables
from simgrab.dataset.folder import writing
from simgrab.dataset.pool import Tick
from simgrab.dataset.stored import split
from simgrab.dataset.video.coder import Coder
from simgrab.dataset.video.files import MANIFEST, VideoFiles
from simgrab.dataset.video.table import Table
from simgrab.dataset.video.transmission import Slot, slots
from simgrab.io import files
from simgrab.model.truth import Truth
from simgrab.world.extensions import Recipe
from simgrab.world.frames import Frame
from simgrab.world.gl import Fingerprint


@dataclass(frozen=True, eq=False)
class Shot:
    """A picture, shape (height, width, 3), its truth and its split."""

    rgb: NDArray[np.uint8]
    truth: Truth
    split: str

    @classmethod
    def of(cls, frame: Frame, recipe: Recipe) -> Shot:
        """Take what a video needs of a frame."""
        return cls(frame.rgb, frame.truth, split(recipe, frame.truth.frame))


def encode_clip(
    videos: VideoFiles,
    clip: int,
    take: Callable[[int], Shot],
    rendered_by: Fingerprint,
    *,
    tick: Tick,
    also: Callable[[int], bool],
) -> None:
    """Make a clip and put its files in place.

    Only one picture is kept at a time, whatever the clip's length.

    Parameters
    ----------
    videos : VideoFiles
    clip : int
    take : callable
        Gives the shot of a frame. Called once for each frame that the video shows, in order.
    rendered_by : Fingerprint
    tick : callable
        Called after every frame of the clip, shown or not.
    also : callable
        Whether a frame is to be taken even where the video does not show it.
    """
    scenario, container = videos.scenario, videos.container
    core = videos.identity() | {"clip": clip}
    video, table = videos.draft(clip, videos.path.suffix), videos.draft(clip, ".parquet")
    sent, shown, clamped = 0, None, Counter[str]()
    with (
        writing(videos.path),
        Coder(video, container.name, container.ticks_per_s, scenario.camera, scenario.clip) as coder,
        Table(table, core) as rows,
    ):
        for slot in slots(scenario, clip, container.ticks_per_s):
            shot = take(slot.frame) if slot.shows_frame or also(slot.frame) else None
            if slot.shows_frame:
                assert shot is not None
                shown = replace(shot, truth=_timed(shot.truth, clip, slot))
                clamped.update(filter(None, shot.truth.clamped.split("+")))
            if slot.pts is not None:
                assert shown is not None  # a clip's first frame is always sent
                coder.send(shown.rgb, slot.pts)
                due, pts_s = slot.time_s, slot.pts / container.ticks_per_s
                rows.add(
                    shown.truth, split=shown.split, rgb_sha256=hashlib.sha256(shown.rgb.data).hexdigest(),
                    sent=sent, pts_s=pts_s, repeated=slot.repeated, due_s=due,
                )  # fmt: skip
                sent += 1
            tick()
    with writing(videos.path):
        videos.draft(clip, ".camera.toml").write_text(tables.calibration_of(scenario).to_toml(), encoding="utf-8")
        for name, data in tables.grabs(scenario).items():  # the same beside every clip
            copy = videos.path.parent / name
            copy.parent.mkdir(parents=True, exist_ok=True)
            files.write(copy, data)
        if scenario.swing.clamped:
            core |= {"clamped": {key: clamped[key] for key in scenario.swing.clamped}}
        whole = manifest.compose(core | {"coder": _coder(coder.x264)}, rendered_by, _digests(videos, clip))
        videos.draft(clip, MANIFEST).write_bytes(whole)
        videos.put_in_place(clip)


def _timed(truth: Truth, clip: int, slot: Slot) -> Truth:
    """Rows of independent frames know neither clip nor time; within a video they have both."""
    if truth.time_s is not None:
        return truth
    return msgspec.structs.replace(truth, clip=clip, time_s=slot.time_s)


def _coder(x264: str) -> dict[str, str]:
    libraries = {name: ".".join(map(str, av.library_versions[name])) for name in ("libavcodec", "libavformat")}
    return libraries | {"x264": x264}


def _digests(videos: VideoFiles, clip: int) -> dict[str, str]:
    """By suffix, so that the manifest is the same whatever the video is called."""
    digests = {}
    for suffix in videos.files(clip):
        if suffix != MANIFEST:
            with videos.draft(clip, suffix).open("rb") as handle:
                digests[suffix] = hashlib.file_digest(handle, "sha256").hexdigest()
    return digests
