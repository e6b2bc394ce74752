"""A stage: the built world of one variant of a scenario, with a renderer before it."""

from __future__ import annotations

from collections.abc import Callable

from simgrab.scenario import Variant
from simgrab.world import label as truth
from simgrab.world.camera import shutter
from simgrab.world.camera.pipeline import Chain
from simgrab.world.camera.renderer import Renderer
from simgrab.world.scenery import model
from simgrab.world.scenery.plan import Plan, draw_up
from simgrab.world.trajectory.trajectory import Story


class Stage:
    """Everything that draws the frames of one variant. It owns an OpenGL context: close it.

    Parameters
    ----------
    variant : Variant
    plan : Plan, optional
        Of the same variant, where it was drawn up already.

    Attributes
    ----------
    variant : Variant
    scenario : Scenario
        Of the variant.
    world : World
    renderer : Renderer
    chain : Chain
    close : callable
        Frees the OpenGL context.
    """

    def __init__(self, variant: Variant, plan: Plan | None = None) -> None:
        self.variant, self.scenario = variant, variant.scenario
        self.world = model.build(self.scenario, plan or draw_up(self.scenario, variant.number))
        self.renderer = Renderer(self.world, self.scenario)
        self.close: Callable[[], None] = self.renderer.close
        self._story = Story(self.scenario)
        self.chain = Chain(self.scenario, self.renderer, self._story.at)

    def aim(self, frame: int) -> truth.Aim:
        """Pose the world and the camera as in one frame, at the instant of its labels."""
        moment = shutter.exposed(self.scenario, self._story.at(frame))
        aimed = truth.aim(self.scenario, self.world.plan, moment)
        self.renderer.pose(aimed.moment)
        return aimed
