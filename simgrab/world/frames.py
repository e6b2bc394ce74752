"""Make the frames of a scenario: each alone, in any order, in any process, always the same."""

from __future__ import annotations

import operator
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from simgrab.model.label_arrays import Labelled
from simgrab.model.scenario import Scenario
from simgrab.model.truth import Truth
from simgrab.world.camera.renderer import View
from simgrab.world.extensions import Effect, Motion, Randomiser, Recipe
from simgrab.world.label import label
from simgrab.world.projection import Projection
from simgrab.world.scene import Planned, Scene
from simgrab.world.scenery.plan import Plan
from simgrab.world.trajectory.moment import Moment

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Frame(Labelled):
    """One frame: its picture, its truth and its buffers.

    Pixels are continuous: (0, 0) is the outer corner of the top-left pixel. Poses are in metres, in the jib frame.

    Attributes
    ----------
    rgb : ndarray of uint8, shape (height, width, 3)
        The picture before it is stored: PNG files hold the same, JPEG files nearly the same.
    truth : Truth
        The frame's truth, as in a dataset's row of labels.
    moment : Moment
        The instant of the labels, in SI units and radians.
    grab : View
        Ids and depth in the window of the grab's box, with a margin of one pixel.
    full : View or None
        Ids and depth of the whole picture, if requested.
    """

    rgb: NDArray[np.uint8]
    truth: Truth
    moment: Moment
    grab: View
    full: View | None

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Pixels of the visible grab, shape (height, width)."""
        mask = np.zeros(self.rgb.shape[:2], bool)
        x0, y0, x1, y1 = self.grab.window
        mask[y0:y1, x0:x1] = self.grab.shows_grab
        return mask

    @property
    def ids(self) -> NDArray[np.uint8] | None:
        """Id of each pixel, shape (height, width): 0 place, 1 jib head, 2 ropes, 3 grab, 255 nothing."""
        return self.full.ids if self.full else None

    @property
    def depth(self) -> NDArray[np.float32] | None:
        """Distance of each pixel along the optical axis, shape (height, width), m."""
        return self.full.depth if self.full else None


class FrameGenerator:
    """Makes the frames of a recipe. Use as a context manager: it owns an OpenGL context.

    It keeps one variant's world; if worlds vary, make the frames clip by clip.

    Parameters
    ----------
    recipe : Recipe or Scenario
    plan : Plan, optional
        Plan of the first variant, if it exists already.

    Attributes
    ----------
    projections : mapping of int to Projection
        Projections of frames that were projected already; none unless set.

    Examples
    --------
    >>> import simgrab
    >>> with FrameGenerator(simgrab.load("quay-day")) as generator:  # doctest: +SKIP
    ...     frame = generator.frame(812)
    """

    def __init__(self, recipe: Recipe | Scenario, plan: Plan | None = None) -> None:
        self.recipe = recipe if isinstance(recipe, Recipe) else Recipe(recipe)
        self.projections: Mapping[int, Projection] = {}
        self._revised = False
        self._planned = Planned(self.recipe.variant(0), self.recipe, plan) if plan else None
        self._scene: Scene | None = None

    @property
    def scenario(self) -> Scenario:
        """The recipe's scenario."""
        return self.recipe.scenario

    def __enter__(self) -> FrameGenerator:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Free the OpenGL context; the next frame opens another one."""
        if self._scene:
            self._scene.close()
            self._scene = None

    def revise(self, recipe: Recipe | Scenario) -> None:
        """Continue with another recipe.

        The world is kept if the new recipe has the same one. Frames are bit-identical to those of a new generator.
        """
        self.recipe = recipe if isinstance(recipe, Recipe) else Recipe(recipe)
        self.projections, self._revised = {}, True

    def planned(self, frame: int) -> Planned:
        """Return the plan and trajectory of a frame's variant: those of the frame before, or in their place."""
        if self._planned is None or self._revised or self._planned.variant.number != self.recipe.variant_number(frame):
            before = self._planned.plan if self._planned else None
            self._planned, self._revised = Planned(self.recipe.variant(frame), self.recipe, before), False
        return self._planned

    def scene(self, frame: int) -> Scene:
        """Return the world of a frame: the one of the frame before where it can stay, or in its place."""
        planned = self.planned(frame)
        if self._scene and self._scene.planned is not planned and not self._scene.revise(planned, self.recipe):
            self.close()  # before another is built, which may fail
        self._scene = self._scene or Scene(planned, self.recipe)
        return self._scene

    def project(self, frame: int) -> Projection:
        """Project a frame's moment.

        Raises
        ------
        ScenarioError
            If the frame is impossible. The message names frame and key.
        """
        return self.projections.get(frame) or self.planned(frame).project(frame)

    def frame(self, frame: int, *, full: bool = False) -> Frame:
        """Make one frame, with ``full`` also ids and depth of the whole picture.

        Raises
        ------
        ScenarioError, ExtensionError
            If the frame is impossible.
        """
        scene = self.scene(frame)
        buffers = scene.draw(self.project(frame), full=full)
        developed = scene.develop(buffers)
        truth = label(scene.planned.variant, buffers, developed.attenuation)
        moment = buffers.projection.moment
        rgb = np.ascontiguousarray(self.recipe.extensions.apply(developed.rgb, moment, scene.scenario))
        return Frame(rgb, truth, moment, buffers.visibility.visible, buffers.full if full else None)


def frames(
    scene: Scenario | str | Path,
    indices: Iterable[int] | None = None,
    *,
    buffers: bool = True,
    randomiser: Randomiser | str | None = None,
    trajectory: Motion | str | None = None,
    effects: Sequence[Effect | str] = (),
) -> Iterator[Frame]:
    """Make the frames of a scenario one after another, writing nothing.

    They are the frames that `simgrab.render` stores.

    Parameters
    ----------
    scene : Scenario, str or path
        A scenario, a bundled scene's name, or a scene file.
    indices : iterable of int, optional
        Numbers of the frames, negative ones from the end; all of them in order unless given. Keep the frames of one
        clip together: physics runs each clip from its beginning, and each clip may have its own world.
    buffers : bool
        Whether frames come with ``ids`` and ``depth``. It changes neither pixels nor truth.
    randomiser : callable or str, optional
        Called as ``randomiser(scenario, rng)`` once for each clip; returns dotted keys of the scenario with new values.
    trajectory : callable or str, optional
        Called as ``trajectory(scenario, frame, rng)``; returns the frame's `simgrab.Moment`, in place of ``swing``. A
        moment without one ahead shows no motion blur. The frames of one clip are in one split.
    effects : sequence of callable or str
        Each is called as ``effect(rgb, moment, rng)`` and returns a picture of the same size. Like the other two it may
        be the name of an entry point (``simgrab.randomisers``, ``simgrab.trajectories``, ``simgrab.effects``).

    Yields
    ------
    Frame

    Raises
    ------
    ScenarioError
        If the scene or a frame is impossible. The message names the key.
    ExtensionError
        If a function of yours cannot be found, raises, or returns impossible values.
    IndexError
        If there is no frame with a given number.
    RendererError
        If there is no offscreen OpenGL.

    Examples
    --------
    >>> import simgrab
    >>> scene = simgrab.load("quay-day", {"camera.width_px": 480, "camera.height_px": 270, "frames": 2})
    >>> for frame in simgrab.frames(scene):
    ...     print(frame.rgb.shape, frame.mask.any(), round(frame.truth.alpha_deg, 2), frame.depth.shape)
    (270, 480, 3) True 2.0 (270, 480)
    (270, 480, 3) True 1.43 (270, 480)
    """
    recipe = Recipe.of(scene, randomiser, trajectory, effects)
    numbers = range(recipe.scenario.frames) if indices is None else indices
    return _made(recipe, numbers, full=buffers)


def _made(recipe: Recipe, indices: Iterable[int], *, full: bool) -> Iterator[Frame]:
    with FrameGenerator(recipe) as generator:
        for index in indices:
            yield generator.frame(_checked(index, recipe.scenario.frames), full=full)


def _checked(index: int, count: int) -> int:
    number = operator.index(index)
    if not -count <= number < count:
        raise IndexError(f"frame {number} is out of range: the scenario has {count} frames")
    return number % count


class FrameDataset(Generic[T]):
    """The frames of a scenario by number, made on request: a map-style dataset for PyTorch's ``DataLoader``.

    It needs no torch, writes nothing and can be pickled; each process opens its own OpenGL context at its first frame.
    After that, workers must be started by ``multiprocessing_context="spawn"``, since OpenGL does not survive a fork.
    Where worlds vary (`clips` has more than one range) or the grab follows physics, request the frames of a clip in
    order: any other order builds the world, or runs the clip, again.

    Parameters
    ----------
    scene : Scenario, str or path
    transform : callable, optional
        Converts a `Frame` to the value of ``dataset[i]``, such as a dictionary of arrays, which a ``DataLoader`` can
        batch. By default the value is the frame itself.
    buffers : bool
        Whether frames come with ``ids`` and ``depth``.
    randomiser, trajectory, effects
        As `frames` takes them; to be pickled, functions must be defined at the top of a module.

    Examples
    --------
    >>> import simgrab
    >>> size = {"camera.width_px": 480, "camera.height_px": 270}
    >>> dataset = simgrab.FrameDataset(simgrab.load("quay-day", size), lambda frame: frame.box)
    >>> len(dataset), dataset[-1].shape
    (64, (4,))
    >>> dataset.close()
    """

    @overload
    def __init__(
        self: FrameDataset[Frame], scene: Scenario | str | Path, transform: None = None, *,
        buffers: bool = ..., randomiser: Randomiser | str | None = ..., trajectory: Motion | str | None = ...,
        effects: Sequence[Effect | str] = ...,
    ) -> None: ...  # fmt: skip

    @overload
    def __init__(
        self, scene: Scenario | str | Path, transform: Callable[[Frame], T], *,
        buffers: bool = ..., randomiser: Randomiser | str | None = ..., trajectory: Motion | str | None = ...,
        effects: Sequence[Effect | str] = ...,
    ) -> None: ...  # fmt: skip

    def __init__(
        self,
        scene: Scenario | str | Path,
        transform: Callable[[Frame], T] | None = None,
        *,
        buffers: bool = False,
        randomiser: Randomiser | str | None = None,
        trajectory: Motion | str | None = None,
        effects: Sequence[Effect | str] = (),
    ) -> None:
        self._recipe = Recipe.of(scene, randomiser, trajectory, effects)
        self._transform, self._full = transform, buffers
        self._generator: FrameGenerator | None = None
        self._parents: FrameGenerator | None = None
        self._process = 0

    @property
    def scenario(self) -> Scenario:
        """The scenario."""
        return self._recipe.scenario

    @property
    def clips(self) -> tuple[range, ...]:
        """Numbers of the frames of each clip."""
        scenario = self.scenario
        return tuple(map(scenario.span, range(scenario.clip_count)))

    def __len__(self) -> int:
        return self.scenario.frames

    def __getitem__(self, index: int) -> T:
        number = _checked(index, len(self))
        if self._generator is None or self._process != os.getpid():  # a fork's context is its parent's
            self._parents = self._generator  # kept, since freeing it would call OpenGL in the fork
            self._generator, self._process = FrameGenerator(self._recipe), os.getpid()
        frame = self._generator.frame(number, full=self._full)
        return self._transform(frame) if self._transform else frame  # type: ignore[return-value]  # T is Frame then

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_generator": None, "_parents": None, "_process": 0}

    def close(self) -> None:
        """Free this process's OpenGL context; the next frame opens another one."""
        if self._generator and self._process == os.getpid():
            self._generator.close()
        self._generator = None
