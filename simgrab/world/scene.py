"""One variant of a scenario: its plan and its moments, the built world, and the steps from a moment to a frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from simgrab.model.scenario import Variant
from simgrab.world.camera.buffers import NONE_VISIBLE, Buffers, observe
from simgrab.world.camera.optics import Exposure
from simgrab.world.camera.pipeline import Camera, Developed, exposed_rgb
from simgrab.world.camera.renderer import Renderer
from simgrab.world.extensions import Recipe
from simgrab.world.projection import Projection, project
from simgrab.world.scenery import model
from simgrab.world.scenery.plan import Plan, draw_up, replanned
from simgrab.world.trajectory.trajectory import Trajectory


class Planned:
    """The plan and the trajectory of one variant of a recipe, without pictures.

    Of a plan of another variant, what has not changed is reused.

    Raises
    ------
    ScenarioError
        If the camera is impossible.
    """

    def __init__(self, variant: Variant, recipe: Recipe, plan: Plan | None = None) -> None:
        self.variant, self.scenario = variant, variant.scenario
        self.plan = replanned(plan, variant) if plan else draw_up(self.scenario, variant.draws)
        self._trajectory = Trajectory(self.scenario, recipe.extensions, self.plan)

    def project(self, frame: int) -> Projection:
        """Project a frame's moment; raises `ScenarioError` if it is impossible."""
        return project(self.scenario, self.plan, self._trajectory.at(frame))


class Scene:
    """The world, renderer and camera of one variant of a recipe. It owns an OpenGL context: close it."""

    def __init__(self, planned: Planned, recipe: Recipe) -> None:
        self.planned, self.scenario = planned, planned.scenario
        self.world = model.build(planned.plan)
        self.renderer = Renderer(self.world, self.scenario, recipe.split)
        self.close: Callable[[], None] = self.renderer.close  # frees the OpenGL context
        self.camera = Camera(self.scenario)
        self._metered: tuple[int, Exposure] | None = None

    def revise(self, planned: Planned, recipe: Recipe) -> bool:
        """Become the scene of another variant, if the OpenGL context can stay; what has not changed is reused.

        Its frames are then bit-identical to those of a scene built for that variant. Returns whether it has changed; if
        not, it is as before.
        """
        new, plan, world = planned.scenario, planned.plan, self.world
        if not self.renderer.takes(new):
            return False
        world = replace(world, plan=plan) if plan.bodies is world.plan.bodies else model.build(plan)
        camera = Camera(new)
        self.renderer.revise(world, self.scenario, new, recipe.split)
        self.planned, self.scenario, self.world = planned, new, world
        self.camera, self._metered = camera, None
        return True

    def draw(self, projection: Projection, *, full: bool = False, labelled: bool = True) -> Buffers:
        """Render a frame's buffers, with ``full`` also ids and depth of the whole picture at the resolution of labels.

        Only a frame that gets labels needs the grab's visibility.
        """
        renderer, moment = self.renderer, projection.moment
        stored = self.scenario.image.stores_buffers  # the scenario alone decides what labels and effects are made of
        whole = renderer.view(moment) if full or stored else None
        view = whole if stored or (self.camera.wants_view and not renderer.has_lens) else None
        if view is None and self.camera.wants_view:
            view = renderer.view(moment, finer=1)  # without a lens the same as the whole view
        visibility = NONE_VISIBLE
        if labelled:
            visibility = observe(renderer, projection, None if renderer.has_lens and not stored else view)
        rgb = exposed_rgb(self.scenario, renderer, projection.nominal)
        return Buffers(projection, rgb, visibility, whole, view)

    def develop(self, buffers: Buffers) -> Developed:
        """Make the picture from a frame's buffers.

        An exposure that lags depends on the frames before: they are metered first, from the clip's beginning, unless
        the frame before was the last one developed.
        """
        nominal = buffers.projection.nominal
        if not self.camera.has_memory or nominal.time is None:
            return self.camera.develop(buffers)
        frame = nominal.frame
        developed = self.camera.develop(buffers, self._exposure_before(frame))
        assert developed.exposure is not None
        self._metered = frame, developed.exposure
        return developed

    def _exposure_before(self, frame: int) -> Exposure | None:
        clip = self.scenario.clip
        begin, before = self.scenario.span(clip.of(frame)).start, None
        if self._metered and begin <= self._metered[0] < frame:
            begin, before = self._metered[0] + 1, self._metered[1]
        for earlier in range(begin, frame):
            before = self.camera.meter(self.draw(self.planned.project(earlier), labelled=False), before)
        return before
