"""Make a clip: take its pictures in order, send them, and note what each shows."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from contextlib import closing
from dataclasses import dataclass, replace

import av
import msgspec
import numpy as np
from numpy.typing import NDArray

from simgrab.dataset import manifest, tables
from simgrab.dataset.summary import Tally, clamped
from simgrab.dataset.tables import LabelWriter
from simgrab.dataset.video import table
from simgrab.dataset.video.coder import Coder
from simgrab.dataset.video.files import MANIFEST, VideoFiles
from simgrab.dataset.video.transmission import Slot
from simgrab.io import files
from simgrab.model.truth import Truth
from simgrab.runtime.versions import Fingerprint


@dataclass(frozen=True, eq=False)
class Shot:
    """A picture, shape (height, width, 3), its truth and its split."""

    rgb: NDArray[np.uint8]
    truth: Truth
    split: str


def encode_clip(
    videos: VideoFiles, clip: int, shots: Iterable[tuple[Slot, Shot | None]], rendered_by: Fingerprint
) -> None:
    """Make a clip of its slots, in order, each with a shot if it shows a frame, and put its files in place.

    Only one picture is kept at a time, whatever the clip's length.
    """
    scenario, container = videos.scenario, videos.container
    core = videos.identity | {"clip": clip}
    schema = tables.with_identity(table.schema(), core)
    sent, shown, tally = 0, None, Tally()
    with (
        videos.journal.store.guarded(),
        Coder(
            videos.draft(clip, videos.path.suffix), container.name, container.ticks_per_s, scenario.camera,
            scenario.clip,
        ) as coder,
        videos.draft(clip, ".parquet").open("wb") as file,
        closing(LabelWriter(file, schema, table.GROUP_ROWS)) as rows,
    ):  # fmt: skip
        for slot, shot in shots:
            if slot.shows_frame:
                assert shot is not None
                shown = replace(shot, truth=_timed(shot.truth, clip, slot))
                tally += Tally(clamped=clamped([shot.truth.clamped]))
            if slot.pts is not None:
                assert shown is not None  # a clip's first frame is always sent
                coder.send(shown.rgb, slot.pts)
                own = {
                    "sent": sent, "pts_s": slot.pts / container.ticks_per_s, "repeated": slot.repeated,
                    "due_s": slot.time_s, "rgb_sha256": hashlib.sha256(shown.rgb.data).hexdigest(),
                }  # fmt: skip
                rows.add(msgspec.structs.asdict(shown.truth) | {"split": shown.split} | own)
                sent += 1
    with videos.journal.store.guarded():
        for name, data in tables.beside(scenario).items():
            if name == "camera.toml":
                videos.draft(clip, ".camera.toml").write_bytes(data)
            else:  # the same beside every clip
                files.write(videos.path.parent / name, data)
        core |= tally.stated(scenario) | {"coder": _coder(coder.x264)}
        digests = {
            suffix: files.sha256(videos.draft(clip, suffix)) for suffix in videos.files(clip) if suffix != MANIFEST
        }
        videos.draft(clip, MANIFEST).write_bytes(manifest.compose(core, rendered_by, digests))
        videos.put_in_place(clip)


def _timed(truth: Truth, clip: int, slot: Slot) -> Truth:
    """Add clip and time to a row of an independent frame, which has neither outside of a video."""
    if truth.time_s is not None:
        return truth
    return msgspec.structs.replace(truth, clip=clip, time_s=slot.time_s)


def _coder(x264: str) -> dict[str, str]:
    libraries = {name: ".".join(map(str, av.library_versions[name])) for name in ("libavcodec", "libavformat")}
    return libraries | {"x264": x264}
