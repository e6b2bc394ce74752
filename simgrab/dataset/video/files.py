"""Where a scenario's clips lie, which of them are finished, and how they are taken up again.

Clips are made in a hidden folder beside where they will lie. A clip counts as finished once its manifest lies there,
which comes last.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from simgrab.dataset import manifest
from simgrab.dataset.folder import differ, differences, locked, writing
from simgrab.errors import DatasetError, ScenarioError
from simgrab.io.destination import check_file
from simgrab.io.parse import read_json
from simgrab.model.scenario import Scenario
from simgrab.world.extensions import Recipe

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
    """The clips of a scenario on disk.

    Parameters
    ----------
    recipe : Recipe
    path : Path
        The video, whose suffix selects the container. Where there are several clips each has its number in the
        name: ``swing.mp4`` becomes ``swing-000.mp4`` and so on.
    """

    recipe: Recipe
    path: Path

    @property
    def scenario(self) -> Scenario:
        """The recipe's scenario."""
        return self.recipe.scenario

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
    def count(self) -> int:
        """How many clips there are."""
        return self.scenario.clip.count(self.scenario.frames)

    @property
    def partial(self) -> Path:
        """Working folder; it exists while clips are unfinished."""
        return self.path.with_name(f".{self.path.name}.partial")

    def files(self, clip: int) -> dict[str, Path]:
        """Files of a clip, by suffix, in the order in which they are put in place."""
        video = self.path if self.count == 1 else self.path.with_stem(f"{self.path.stem}-{clip:03d}")
        return {self.path.suffix: video} | {side: video.with_suffix(side) for side in SIDES}

    def draft(self, clip: int, suffix: str) -> Path:
        """Where a file of a clip is made."""
        return self.partial / f"{clip:03d}{suffix}"

    def identity(self) -> dict[str, Any]:
        """Return what must be equal for two runs to make the same videos, except for the renderer."""
        core = manifest.identity(self.recipe)
        packages = core["packages"] | {"av": version("av")}
        return core | {"packages": packages, "container": self.container.name}

    def known(self, clip: int) -> dict[str, Any] | None:
        """Manifest of a clip, where there is one."""
        return _read(self.files(clip)[MANIFEST])

    def is_finished(self, clip: int) -> bool:
        """Whether every file of a clip is in place."""
        return all(path.exists() for path in self.files(clip).values())

    def rendered_by(self) -> str | None:
        """Fingerprint of the renderer of the finished clips; None where there are none."""
        manifests = (self.known(clip) for clip in range(self.count))
        return next((str(known["renderer"]["fingerprint"]) for known in manifests if known is not None), None)

    def unfinished(self, *, resume: bool) -> list[int]:
        """Clips that remain to be made.

        Raises
        ------
        DatasetError
            If something lies in the way that is not, with ``resume``, of the same scenario.
        """
        check_file(self.files(0)[self.path.suffix], DatasetError, "--video")
        begun = _read(self.partial / "identity.json")
        if begun is not None and resume:
            self._refuse_others(self.path, begun)
        remaining = []
        for clip in range(self.count):
            files, known = self.files(clip), self.known(clip)
            there = [path for path in files.values() if path.exists()]
            if not resume and (there or self.partial.exists()):
                advice = "" if begun is known is None else "continue with --resume, or "
                raise DatasetError(f"{(there or [self.partial])[0]} exists; {advice}choose another --video")
            if known is not None:
                self._refuse_others(files[MANIFEST], known)
            elif there and begun is None:
                raise DatasetError(f"{there[0]} is not of a video that simgrab made; choose another --video")
            if not self.is_finished(clip):
                remaining.append(clip)
        return remaining

    def _refuse_others(self, path: Path, known: dict[str, Any]) -> None:
        wanted = self.identity()
        if differ(known, wanted):
            raise DatasetError(
                f"{path} is of another video (its {differences(known, wanted)} differs); "
                "--resume needs the same scenario and packages, or choose another --video"
            )

    @contextmanager
    def claim(self) -> Iterator[None]:
        """Hold the place against a second writer. Left without an error, everything is finished."""
        with writing(self.path):
            self.partial.mkdir(parents=True, exist_ok=True)
        with locked(self.partial, self.path):
            draft = self.partial / "draft"
            draft.write_text(json.dumps(self.identity(), indent=1), encoding="utf-8")
            draft.replace(self.partial / "identity.json")
            yield
            shutil.rmtree(self.partial)

    def put_in_place(self, clip: int) -> None:
        """Move the drafts of a clip to where they will lie; the manifest makes it count."""
        for suffix, target in self.files(clip).items():
            self.draft(clip, suffix).replace(target)


def _read(path: Path) -> dict[str, Any] | None:
    try:
        data = read_json(path, DatasetError)
    except DatasetError:
        return None
    return data if isinstance(data, dict) and "scenario" in data else None
