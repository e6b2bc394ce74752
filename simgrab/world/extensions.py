"""A user's own functions for making frames: a randomiser, a trajectory, image effects."""

from __future__ import annotations

import hashlib
import inspect
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from simgrab.errors import ExtensionError, ScenarioError, SimgrabError, first_line
from simgrab.model import scenes
from simgrab.model.rng import stream
from simgrab.model.scenario import Iid, Scenario, Variant, variant
from simgrab.runtime import modules
from simgrab.runtime.processes import pickled
from simgrab.world.trajectory.checked import checked
from simgrab.world.trajectory.moment import Moment

Picture: TypeAlias = NDArray[np.uint8]
Randomiser: TypeAlias = Callable[[Scenario, np.random.Generator], Mapping[str, Any]]
"""From a scenario to the keys that it changes for one clip, dotted, with their values."""
Motion: TypeAlias = Callable[[Scenario, int, np.random.Generator], Moment]
"""From a scenario and the number of a frame to its moment."""
Effect: TypeAlias = Callable[[Picture, Moment, np.random.Generator], Picture]
"""From a picture, RGB of shape (height, width, 3), and its moment to the picture that the frame gets."""

GROUPS = {"randomiser": "simgrab.randomisers", "trajectory": "simgrab.trajectories", "effect": "simgrab.effects"}
"""Entry points by which an installed package offers functions under a name."""
NOTE = (
    "These functions are not part of simgrab: the same bytes need the same functions and whatever they read, and "
    "simgrab cannot promise that what an effect shows agrees with the labels."
)
F = TypeVar("F", bound=Callable[..., Any])


@dataclass(frozen=True)
class Extensions:
    """The user's functions, which replace simgrab's own or run after them.

    Each draws only from the generator it is given, so that frames are the same in any order and on any worker.
    """

    randomiser: Randomiser | None = None  # called once for each clip, after `vary`
    trajectory: Motion | None = None  # replaces the scenario's swing
    effects: tuple[Effect, ...] = ()  # applied in turn to the finished picture

    @classmethod
    def of(
        cls, randomiser: Randomiser | str | None, trajectory: Motion | str | None, effects: Sequence[Effect | str]
    ) -> Extensions:
        """Collect functions, each given as an object or by the name of an entry point.

        Raises `ExtensionError` if no installed package offers the name, or the object cannot be called.
        """
        if not isinstance(effects, list | tuple):
            raise ExtensionError("effects must be a list of functions or names")
        return cls(
            None if randomiser is None else _find("randomiser", randomiser),
            None if trajectory is None else _find("trajectory", trajectory),
            tuple(_find("effect", effect) for effect in effects),
        )

    def describe(self) -> dict[str, Any] | None:
        """Return the manifest's description of the functions, with digests of their source; None if there are none."""
        effects = [("effect", effect) for effect in self.effects]
        given = [("randomiser", self.randomiser), ("trajectory", self.trajectory), *effects]
        functions = [{"role": role} | _identity(function) for role, function in given if function is not None]
        return {"functions": functions, "note": NOTE} if functions else None

    def moment(self, scenario: Scenario, frame: int) -> Moment:
        """Moment of a frame by the user's trajectory.

        Raises `ExtensionError` if the trajectory raises an error, or returns an impossible moment. The message names
        the frame.
        """
        assert self.trajectory is not None
        rng = stream(scenario.seed, frame, "trajectory")
        moment = _call("trajectory", self.trajectory, scenario, frame, rng)
        try:
            return checked(moment, scenario, frame)
        except (TypeError, ValueError, AttributeError) as problem:
            what = _named("trajectory", self.trajectory)
            raise ExtensionError(f"{what}, frame {frame}: {first_line(problem)}") from None

    def apply(self, rgb: Picture, moment: Moment, scenario: Scenario) -> Picture:
        """Apply the effects to a picture.

        Raises `ExtensionError` if an effect raises an error, or does not return a picture of the same size.
        """
        for number, effect in enumerate(self.effects):
            rng = stream(scenario.seed, moment.frame, f"effect.{number}")
            given = np.ascontiguousarray(rgb)[:]
            given.flags.writeable = False  # an effect that writes into its argument would change the frame before it
            returned = _call("effect", effect, given, moment, rng)
            result = np.array(returned)  # which it may use again
            if result.shape != rgb.shape or result.dtype != np.uint8:
                what = f"{result.dtype} of shape {result.shape}" if result.shape else type(returned).__name__
                raise ExtensionError(
                    f"{_named('effect', effect)} returned {what}; an image is uint8 of shape {rgb.shape}"
                )
            rgb = result
        return rgb

    def refuse_others(self, scene: str | Path) -> None:
        """Refuse a manifest of a dataset that was made with other functions.

        Raises
        ------
        ExtensionError
            The message names the manifest's functions.
        """
        manifest, path = scenes.manifest(scene), Path(scene)
        if manifest is None:
            return
        stated, own = manifest.get("extensions"), self.describe()
        if stated == own:
            return
        if stated is None:
            raise ExtensionError(f"{path} was made without a user's functions: leave them out")
        known = stated.get("functions") if isinstance(stated, dict) else None
        functions = [f for f in known if isinstance(f, dict)] if isinstance(known, list) else []
        names = [f"{f.get('role')} {f.get('name')}" for f in functions]
        raise ExtensionError(
            f"{path} was made with a user's functions ({', '.join(names)}); give the same, with the same source"
        )

    def refuse_unknown(self) -> None:
        """Refuse functions that cannot be compared with those of an earlier run.

        Raises
        ------
        ExtensionError
            The message names the first: a lambda, a closure, or an interactive function.
        """
        for function in (self.describe() or {"functions": []})["functions"]:
            if None in function.values():
                raise ExtensionError(
                    f"{function['role']} {function['name']} cannot be identified; to resume, define functions at "
                    "the top of a module"
                )


NO_EXTENSIONS = Extensions()


@dataclass(frozen=True)
class Recipe:
    """A scenario and the user's functions: everything on which the frames depend."""

    scenario: Scenario
    extensions: Extensions = NO_EXTENSIONS

    @classmethod
    def of(
        cls, scene: Scenario | str | Path, randomiser: Randomiser | str | None = None,
        trajectory: Motion | str | None = None, effects: Sequence[Effect | str] = (),
    ) -> Recipe:  # fmt: skip
        """Make a recipe from users' arguments; a manifest must have been made with the same functions."""
        extensions = Extensions.of(randomiser, trajectory, effects)
        if isinstance(scene, Scenario):
            return cls(scene, extensions)
        extensions.refuse_others(scene)
        return cls(scenes.load(scene), extensions)

    @property
    def varies(self) -> bool:
        """Whether each clip has its own world."""
        return bool(self.scenario.vary) or self.extensions.randomiser is not None

    def variant(self, frame: int) -> Variant:
        """Variant of a frame; see `simgrab.model.scenario.variant`.

        Raises
        ------
        ScenarioError
            If a drawn value is not valid.
        ExtensionError
            If the randomiser raises, or returns no mapping.
        """
        randomiser = self.extensions.randomiser
        if randomiser is None:
            return variant(self.scenario, frame)

        def change(drawn: Scenario) -> Mapping[str, Any]:
            rng = stream(self.scenario.seed, self.scenario.clip.of(frame), "randomiser")
            found = _call("randomiser", randomiser, drawn, rng)
            if not isinstance(found, Mapping) or not all(isinstance(key, str) for key in found):
                raise ExtensionError(
                    f"{_named('randomiser', randomiser)} must return a mapping from dotted keys to values"
                )
            fixed = next((key for key in found if f"{key}.".startswith("display.")), None)
            if fixed is not None:
                raise ScenarioError(fixed, "cannot vary by a randomiser: a dataset's readers take the scene's display")
            return found

        return variant(self.scenario, frame, change)

    def variant_number(self, frame: int) -> int:
        """Index of a frame's variant; 0 for all frames if nothing varies."""
        return self.scenario.clip.of(frame) if self.varies else 0

    def slowest_draw(self, frame: int) -> int:
        """Index of what a frame shows of the table that is drawn least often; 0 for all frames if nothing varies."""
        return self.scenario.slowest_draw(self.variant_number(frame)) if self.varies else 0

    def split(self, frame: int) -> str:
        """Draw a frame into train, val or test by the scenario's shares.

        Frames of one clip are alike, as are those that share any draw, and stay together.
        """
        scenario = self.scenario
        independent = isinstance(scenario.swing, Iid) and not self.varies and self.extensions.trajectory is None
        unit = frame if independent else scenario.slowest_draw(scenario.clip.of(frame))
        share = stream(scenario.seed, unit, "split").random()
        return "train" if share < scenario.splits.train else "val" if share < 1 - scenario.splits.test else "test"


def _find(role: str, given: F | str) -> F:
    if callable(given):
        return given
    if not isinstance(given, str):
        raise ExtensionError(f"{role}: must be a function or the name of an entry point, got {type(given).__name__}")
    group = GROUPS[role]
    points = entry_points(group=group)
    found = [point for point in points if point.name == given]
    if not found:
        there = ", ".join(sorted(points.names)) or "none"
        raise ExtensionError(f"no {role} {given!r} in the entry points {group}; installed: {there}")
    if len(found) > 1:
        raise ExtensionError(f"{role} {given!r} is offered twice, as {found[0].value} and as {found[1].value}")
    try:
        loaded = found[0].load()
    except Exception as problem:
        why = f"{type(problem).__name__}: {first_line(problem)}"
        raise ExtensionError(f"{role} {given!r} ({found[0].value}) cannot be imported: {why}") from None
    if not callable(loaded):
        raise ExtensionError(f"{role} {given!r} ({found[0].value}) is not a function")
    return loaded


def _call(role: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a user's function; raise its error in one line, with the traceback as cause."""
    try:
        return function(*arguments)
    except (SimgrabError, MemoryError):
        raise
    except Exception as problem:
        why = f"{type(problem).__name__}: {first_line(problem)}"
        raise ExtensionError(f"{_named(role, function)} raised {why}") from problem


def _named(role: str, function: Callable[..., Any]) -> str:
    return f"{role} {_identity(function)['name']}"


def _identity(function: Callable[..., Any]) -> dict[str, Any]:
    """Name of a function, and SHA-256 of its source file and of its state, if any: None if unknown."""
    inner = function
    while hasattr(inner, "func"):  # functools.partial
        inner = inner.func
    defined = inner if hasattr(inner, "__qualname__") else type(inner)
    module, digest = defined.__module__, modules.source_sha256(defined)
    file = getattr(sys.modules.get(module), "__file__", None)
    if module == "__main__" and file and Path(file).is_file():
        module = Path(file).stem  # by which another script imports it
    identity: dict[str, Any] = {"name": f"{module}:{defined.__qualname__}", "source_sha256": digest}
    if inspect.isfunction(function) and "<" not in defined.__qualname__:  # no lambda, closure, partial or instance
        return identity
    try:
        return identity | {"state_sha256": hashlib.sha256(pickled(function)).hexdigest()}
    except Exception:
        return identity | {"state_sha256": None}
