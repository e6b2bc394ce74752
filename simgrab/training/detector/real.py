"""Real frames beside rendered ones: what is learned from, what is judged by, and how a detector does on the latter."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from simgrab.dataset import boxed
from simgrab.errors import DatasetError, TrainingError
from simgrab.instrument.detect.grab import GrabDetector
from simgrab.judge.evaluate.boxed import score
from simgrab.model.rng import stream
from simgrab.training.detector import cache, evaluate

SHARE = 0.2  # of the frames learned from: real ones count several times until they are so many
MOST_TIMES = 16


@dataclass(frozen=True, eq=False)
class Real:
    """Real frames."""

    train: tuple[cache.BoxedFrame, ...]  # to learn from
    val: tuple[cache.BoxedFrame, ...]  # for the presence threshold and the factors of deviations
    held_out: tuple[cache.BoxedFrame, ...]  # to judge by
    summary: tuple[str, ...] = ()  # a line for each dataset

    def repeated(self, rendered: int) -> list[cache.TrainingFrame]:
        """Give frames to learn from, each as often as makes them `SHARE` of all, beside so many rendered ones."""
        return [*self.train] * self._times(rendered)

    def _times(self, rendered: int) -> int:
        wanted = SHARE / (1 - SHARE) * rendered / max(len(self.train), 1)
        return int(np.clip(round(wanted), 1, MOST_TIMES))

    def learned(self, rendered: int) -> dict[str, Any]:
        """Describe what was learned from, for a card; empty where that is nothing."""
        if not self.train:
            return {}
        return {
            "frames": len(self.train), "videos": len(by_video(self.train)), "times": self._times(rendered),
            "labels_sha256": digest(self.train),
        }  # fmt: skip

    def figures(self, out: Path, start: str | Path | None, watch: cache.Watch) -> dict[str, Any]:
        """Judge a detector, and the one that it began with: ``real``, ``real_by_video`` and ``real_before``."""
        found = self._judged(out, "detecting in real images", watch)
        result = {"real_by_video": found.pop("by_video")}
        if start is not None:
            before = self._judged(Path(start), "detecting in real images with the first weights", watch)
            result["real_before"] = {key: value for key, value in before.items() if key != "by_video"}
        return {"real": found} | result

    def _judged(self, folder: Path, name: str, watch: cache.Watch) -> dict[str, Any]:
        seen = evaluate.watch(GrabDetector(folder), self.held_out, watch(name))
        return score([frame.row for frame in self.held_out], [one.detection for one in seen])

    def some(self, count: int, seed: int) -> Real:
        """Keep some frames to learn from, whole videos first, and none for the threshold.

        Fewer frames are always among more: videos are taken in a random order, and in it the frames of each.

        Raises `TrainingError` if there are fewer.
        """
        if count > len(self.train):
            raise TrainingError(f"{count} real frames are asked for, and there are {len(self.train)} to learn from")
        videos = list(by_video(self.train).values())
        ordered = [
            videos[number][i]
            for number in stream(seed, 0, "real.videos").permutation(len(videos))
            for i in stream(seed, int(number), "real.frames").permutation(len(videos[number]))
        ]
        return replace(self, train=tuple(ordered[:count]), val=())


def by_video(frames: Sequence[cache.BoxedFrame]) -> dict[str, list[cache.BoxedFrame]]:
    """Group frames by video, by its name."""
    found: dict[str, list[cache.BoxedFrame]] = {}
    for frame in frames:
        found.setdefault(frame.row.video, []).append(frame)
    return dict(sorted(found.items()))


def digest(*some: Sequence[cache.BoxedFrame]) -> str:
    """SHA-256 of frames' labels, and through them of their pictures."""
    return hashlib.sha256(msgspec.json.encode([[frame.row for frame in frames] for frames in some])).hexdigest()


def read(also: Sequence[str | Path], held_out: Sequence[str | Path], grab_classes: Collection[str]) -> Real:
    """Read real frames: of ``also`` the split test is to judge by, and all of ``held_out``.

    Raises `DatasetError` if a dataset cannot be read, nothing is left to judge by, or a picture is both learned from
    and judged by.
    """
    also, held_out = (list(dict.fromkeys(map(Path, paths))) for paths in (also, held_out))  # each counts once
    sets = boxed.read_all([*also, *held_out], grab_classes)
    known, apart = sets[: len(also)], sets[len(also) :]

    def frames(split: str) -> tuple[cache.BoxedFrame, ...]:
        return tuple(frame for one in known for frame in cache.boxed(one.split(split)))

    train, val = frames("train"), frames("val")
    judged = (*frames("test"), *(frame for one in apart for frame in cache.boxed(one)))
    if not judged:
        raise DatasetError(
            f"{', '.join(map(str, also))}: {'each has' if len(also) > 1 else 'it has'} one video alone, and none is "
            "left to judge by; add frames of another video, or name a dataset of such by --real"
        )
    learned = {frame.row.image_sha256 for frame in (*train, *val)}
    for frame in judged:
        if frame.labelled and frame.row.image_sha256 in learned:  # two cameras may show the same nothing
            raise DatasetError(f"{frame.file} is both learned from and judged by; keep whole videos apart")
    lines = *(one.summary for one in known), *(f"{one.counts}, all to judge by" for one in apart)
    return Real(train, val, judged, lines)
