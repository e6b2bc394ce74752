"""A suite: the scenes that a pipeline measures, and the limits of its metrics, as strict TOML."""

from __future__ import annotations

import copy
import json
import math
import re
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec

from simgrab.errors import ScenarioError, SuiteError
from simgrab.io import resources
from simgrab.io.parse import is_file, read_toml
from simgrab.io.resources import SCENES
from simgrab.io.strict import Checked, convert
from simgrab.judge.check.metrics import COUNTS, unknown
from simgrab.model import scenes
from simgrab.model.rng import derive
from simgrab.model.scenario import Scenario, vary
from simgrab.text import printable

Meta = msgspec.Meta
T = TypeVar("T", bound=msgspec.Struct)
Seed = Annotated[int, Meta(ge=0, le=2**53)]
FOLDER = SCENES / "suites"
CAMERA = ("camera.", "display.")  # inputs of an instrument, which may therefore not vary within a scene
_SHARE = re.compile(r"\d+(\.\d+)? ?%")
OWN_KEYS = ("frames", "seed")  # of a scenario, which the suite sets at a place of their own


class Limit(Checked, frozen=True):
    """Limits of one metric. The bounds determine which direction is worse: towards the nearest of them.

    Attributes
    ----------
    lower, upper : float or None
        In the metric's own unit.
    slack : float or str
        A metric may always be worse than the baseline by this much, or by a share of it, such as ``"20 %"``.
    """

    error = SuiteError

    lower: float | None = None
    upper: float | None = None
    slack: Annotated[float, Meta(ge=0)] | str = 0.0

    def check(self) -> None:  # noqa: D102
        if self.lower is None and self.upper is None:
            raise ValueError("a limit needs lower, upper or both")
        if self.lower is not None and self.upper is not None and self.lower > self.upper:
            raise ValueError(f"lower ({self.lower:g}) must not be above upper ({self.upper:g})")
        if isinstance(self.slack, str) and not _SHARE.fullmatch(self.slack):
            raise ValueError(f"slack: must be a number or a share such as '20 %', got {self.slack!r}")

    def allows(self, reference: float) -> float:
        """By how much a metric may be worse than a value of the baseline."""
        if isinstance(self.slack, str):
            return float(self.slack.rstrip(" %")) / 100 * abs(reference)
        return self.slack

    def excess(self, value: float) -> float:
        """By how much a value lies beyond the limits; 0 or negative within them."""
        below = -math.inf if self.lower is None else self.lower - value
        return max(below, -math.inf if self.upper is None else value - self.upper)

    def holds(self, value: float) -> bool:
        """Whether a value lies within the limits."""
        return self.excess(value) <= 0

    def __str__(self) -> str:
        ends = [f"{sign} {end:g}" for sign, end in (("≥", self.lower), ("≤", self.upper)) if end is not None]
        return ", ".join(ends)


class SuiteScene(Checked, frozen=True):
    """One record of a suite.

    Attributes
    ----------
    scene : str
        A bundled scene, or a scene file beside the suite.
    frames : int or None
        Number of frames; None for the scene's own.
    seed : int or None
        Seed of the scene under the suite's own seed; None to derive it from the suite's seed and the scene's name.
    size : str or None
        Size of the pictures as ``640x360``, px, which then show the same view; None for the suite's.
    changes : dict
        Dotted keys of the scenario; they override the suite's.
    limits : dict of str to Limit
        Limits by metric; they override the suite's.
    golden : tuple of int
        Frames whose pictures must stay as they were recorded.
    """

    error = SuiteError

    scene: str
    frames: Annotated[int, Meta(ge=1, le=10_000_000)] | None = None
    seed: Seed | None = None
    size: str | None = None
    changes: dict[str, Any] = msgspec.field(default_factory=dict)
    limits: dict[str, Limit] = msgspec.field(default_factory=dict)
    golden: Annotated[tuple[Annotated[int, Meta(ge=0)], ...], Meta(max_length=1000)] = ()


class Suite(Checked, frozen=True):
    """The scenes that a pipeline measures, and the limits of its metrics.

    Attributes
    ----------
    name, description : str
    instrument : str
        ``bundled``, or a factory as ``package.module:factory``.
    seed : int
        Seed from which each scene's seed is derived, so that no two scenes share their draws.
    seeds : int
        Number of seeds, from `seed` on, over which a baseline is recorded.
    baseline : str
        Folder of the records, relative to the suite, by default ``baselines/NAME``; `load` makes it a full path.
    least_ssim : float
        SSIM that every tile of golden frames must reach with another renderer (`simgrab.judge.check.golden`).
    size, changes, limits : str or None, dict, dict
        Of every scene, as in `SuiteScene`; without a size, each scene has its own.
    scenes : dict of str to SuiteScene
    """

    error = SuiteError

    name: Annotated[str, Meta(pattern=r"^[a-z0-9][a-z0-9_-]*\Z", max_length=64)]
    scenes: dict[str, SuiteScene]
    description: str = ""
    instrument: str = "bundled"
    seed: Seed = 0
    seeds: Annotated[int, Meta(ge=1, le=1000)] = 10
    baseline: str = ""
    least_ssim: Annotated[float, Meta(ge=0, le=1)] = 0.8
    size: str | None = None
    changes: dict[str, Any] = msgspec.field(default_factory=dict)
    limits: dict[str, Limit] = msgspec.field(default_factory=dict)

    def check(self) -> None:  # noqa: D102
        if not self.scenes:
            raise ValueError("a suite needs scenes: [scenes.NAME] with scene, frames and limits")
        for name in self.scenes:  # which names files as well
            if not re.fullmatch(r"\w[\w .-]{0,63}", name):
                raise ValueError(f"scenes.{printable(name)}: use at most 64 letters, digits, '-', '_', '.' and blanks")
        places = {"limits": self.limits} | {
            f"scenes.{name}.limits": scene.limits for name, scene in self.scenes.items()
        }
        for place, limits in places.items():
            if problem := next(filter(None, map(unknown, limits)), ""):
                raise ValueError(f"{place}: {problem}")

    def limits_of(self, name: str) -> dict[str, Limit]:
        """Limits of a scene by metric."""
        return self.limits | self.scenes[name].limits

    def shares_of_counts(self) -> list[str]:
        """List the limits on counts that only a share can have: those between 0 and 1."""
        found = {
            f"{metric} {limit}": None
            for name in self.scenes
            for metric, limit in self.limits_of(name).items()
            if metric.rpartition(".")[2] in COUNTS and any(0 < end < 1 for end in (limit.lower, limit.upper) if end)
        }
        return list(found)

    def scenario(self, name: str, seed: int | None = None) -> Scenario:
        """Scenario of a scene, with the suite's seed or another; raises `SuiteError` for an invalid change."""
        scene = self.scenes[name]
        changes = self.changes | scene.changes
        for key in OWN_KEYS:
            if key in changes:
                place = f"scenes.{name}.{key}" + (" or at the top of the suite" if key == "seed" else "")
                raise SuiteError(f"scenes.{name}.changes.{key}: set {place} instead")
        seed = self.seed if seed is None else seed
        own = scene.seed if seed == self.seed else None
        changes["seed"] = derive(seed, name) if own is None else own
        if scene.frames is not None:
            changes["frames"] = scene.frames
        size = scene.size or self.size
        try:
            scenario = scenes.load(scene.scene, changes, size=scenes.parse_size(size) if size else None)
        except ScenarioError as problem:
            raise SuiteError(f"scenes.{name}: {_at_fault(scene.scene)}{problem}") from None
        varied = [part for key in scenario.vary for part in key.split("+") if part.startswith(CAMERA)]
        if varied:
            stands = scenes.load(scene.scene, changes).to_dict()  # a focal length in pixels is of the scene's own size
            stated = ", ".join(f'"{key}" = {json.dumps(vary.at(stands, key))}' for key in varied)
            raise SuiteError(
                f"scenes.{name}: {', '.join(varied)} vary, and a suite needs one camera; fix their values, for "
                f"instance by scenes.{name}.changes = {{ {stated} }}"
            )
        beyond = [frame for frame in scene.golden if frame >= scenario.frames]
        if beyond:
            raise SuiteError(f"scenes.{name}.golden: there is no frame {beyond[0]}; the scene has {scenario.frames}")
        return scenario


def names() -> list[str]:
    """Names of the bundled suites."""
    return resources.names(FOLDER)


def load(suite: str | Path) -> Suite:
    """Read a bundled suite by name, or a TOML file, and check that each of its scenes is valid.

    Raises `SuiteError` with one line that names file and key.
    """
    path = resources.find(suite, FOLDER, "suite", "suites", SuiteError)
    found = _placed(convert(read_toml(path, SuiteError, "suite"), Suite, SuiteError, path), path.parent)
    try:
        for name in found.scenes:
            found.scenario(name)
    except SuiteError as problem:
        raise SuiteError(f"{path}: {problem}") from None
    return found


def _at_fault(scene: str) -> str:
    """Begin a message with a scene's file, if a key of it is invalid; else empty."""
    try:
        scenes.load(scene)
    except ScenarioError as problem:
        return f"{scene}: " if problem.key and is_file(scene, SuiteError) else ""
    return ""


def _placed(suite: Suite, folder: Path) -> Suite:
    """Resolve a path that a suite names relative to itself."""
    placed = {
        name: _with(scene, scene=str(folder / scene.scene)) if is_file(folder / scene.scene, SuiteError) else scene
        for name, scene in suite.scenes.items()
    }
    baseline = folder / (suite.baseline or f"baselines/{suite.name}")
    return _with(suite, scenes=placed, baseline=str(baseline))


def _with(struct: T, **paths: Any) -> T:
    """Copy a struct with other values, unchecked: a folder's name need not be the text that a file holds."""
    result = copy.copy(struct)
    for name, value in paths.items():
        msgspec.structs.force_setattr(result, name, value)
    return result
