"""Places of a scenario's clips, which of them are finished, and how they are resumed.

Clips are made in a hidden folder beside their final place. A clip is finished once its manifest is in place; the
manifest is moved last.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pyarrow.compute as pc

from simgrab.dataset.datasets import named
from simgrab.dataset.summary import VideoSummary
from simgrab.errors import DatasetError, ScenarioError
from simgrab.io import parquet
from simgrab.io.destination import check_file
from simgrab.io.journal import IDENTITY, Journal
from simgrab.io.stores import Store
from simgrab.model.scenario import Scenario
from simgrab.runtime.versions import Fingerprint

MANIFEST = ".manifest.json"
SIDES = (".parquet", ".camera.toml", MANIFEST)  # what lies beside the video, the manifest last


@dataclass(frozen=True)
class Container:
    """A file format: FFmpeg's name of it, and the resolution of its time stamps."""

    name: str
    ticks_per_s: int


CONTAINERS = {".mp4": Container("mp4", 90_000), ".mkv": Container("matroska", 1000)}


@dataclass(frozen=True)
class VideoFiles:
    """The clips of a scenario on disk; ``core`` is `simgrab.dataset.manifest.identity`.

    The suffix of ``path`` selects the container. Where there are several clips each has its number in the name:
    ``swing.mp4`` becomes ``swing-000.mp4`` and so on.
    """

    scenario: Scenario
    core: dict[str, Any]
    path: Path

    def __post_init__(self) -> None:
        if self.path.suffix not in CONTAINERS:
            raise DatasetError(f"{self.path}: a video's name must end in one of {', '.join(CONTAINERS)}")
        camera = self.scenario.camera
        for key, size in (("width_px", camera.width_px), ("height_px", camera.height_px)):
            if size % 2:
                raise ScenarioError(f"camera.{key}", f"must be even: video has colour at half resolution; got {size}")

    @property
    def container(self) -> Container:
        """The file format."""
        return CONTAINERS[self.path.suffix]

    @property
    def journal(self) -> Journal:
        """Owner and identity of the clips. Their manifests show which clips are finished."""
        partial, whole = f".{self.path.name}.partial", self.files(0)[MANIFEST].name
        return Journal(
            Store(str(self.path.parent), drafts=partial), partial, f"{partial}/{IDENTITY}", whole, kind="video",
            option="--video", name=str(self.path),
        )  # fmt: skip

    @property
    def partial(self) -> Path:
        """Working folder; it exists while clips are unfinished."""
        return self.path.with_name(self.journal.partial)

    def files(self, clip: int) -> dict[str, Path]:
        """Files of a clip, by suffix, in the order in which they are put in place."""
        video = self.path if self.scenario.clip_count == 1 else self.path.with_stem(f"{self.path.stem}-{clip:03d}")
        return {self.path.suffix: video} | {side: video.with_suffix(side) for side in SIDES}

    def draft(self, clip: int, suffix: str) -> Path:
        """Path at which a file of a clip is made."""
        return self.partial / f"{clip:03d}{suffix}"

    @cached_property
    def identity(self) -> dict[str, Any]:
        """Data that must be equal for two runs to make the same videos; the renderer is compared apart."""
        packages = self.core["packages"] | {"av": version("av")}
        return self.core | {"packages": packages, "container": self.container.name}

    def known(self, clip: int) -> dict[str, Any] | None:
        """Manifest of a clip, if it exists."""
        return self.journal.known(self.files(clip)[MANIFEST].name)

    def is_finished(self, clip: int) -> bool:
        """Whether every file of a clip is in place."""
        return all(path.exists() for path in self.files(clip).values())

    def rendered_by(self) -> Fingerprint | None:
        """Return the renderer of the finished clips; None if there are none."""
        manifests = (self.known(clip) for clip in range(self.scenario.clip_count))
        return next((named(known, self.path).renderer for known in manifests if known is not None), None)

    def unfinished(self, *, resume: bool) -> list[int]:
        """Clips that remain to be made.

        Raises `DatasetError` if the place is taken; with ``resume``, only if by something other than the same
        scenario's clips.
        """
        check_file(self.files(0)[self.path.suffix], DatasetError, "--video")
        journal, remaining = self.journal, []
        begun = journal.known(journal.claim)
        if begun is not None and resume:
            journal.refuse_other(begun, self.identity)
        for clip in range(self.scenario.clip_count):
            files, known = self.files(clip), self.known(clip)
            there = [path for path in files.values() if path.exists()]
            if not resume and (there or self.partial.exists()):
                advice = "" if begun is known is None else "continue with --resume, or "
                raise DatasetError(f"{(there or [self.partial])[0]} exists; {advice}choose another --video")
            if known is not None:
                journal.refuse_other(known, self.identity)
            elif there and begun is None:
                raise DatasetError(f"{there[0]} does not belong to a video that simgrab made; choose another --video")
            if not self.is_finished(clip):
                remaining.append(clip)
        return remaining

    def put_in_place(self, clip: int) -> None:
        """Move the drafts of a clip to their final place. The manifest comes last and marks the clip as finished."""
        for suffix, target in self.files(clip).items():
            self.draft(clip, suffix).replace(target)

    def summary(self, made: int) -> VideoSummary:
        """Sum up finished clips; ``made`` of them were made in this run."""
        scenario, sent, repeated, size = self.scenario, 0, 0, 0
        clamped, rendered_by = Counter[str](), self.rendered_by()
        assert rendered_by is not None
        for clip in range(self.scenario.clip_count):
            files = self.files(clip)
            column = parquet.read_table(files[".parquet"], DatasetError, columns=["repeated"])["repeated"]
            sent, repeated = sent + len(column), repeated + pc.sum(column).as_py()
            clamped.update((self.known(clip) or {}).get("clamped", {}))
            size += files[self.path.suffix].stat().st_size
        return VideoSummary(
            path=self.path,
            clips=self.scenario.clip_count,
            made=made,
            frames=scenario.frames,
            sent=sent,
            repeated=repeated,
            dropped=scenario.frames - sent,
            mbit_s=size * 8e-6 / (scenario.frames / scenario.clip.frame_rate_hz),
            clamped=dict(clamped) or None,
            fingerprint=rendered_by.digest,
        )
