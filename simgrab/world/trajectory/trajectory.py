"""The moments of a scenario, frame by frame."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import replace

from simgrab.model.scenario import Iid, Scenario
from simgrab.world.extensions import NO_EXTENSIONS, Extensions
from simgrab.world.scenery.grabs import design_of
from simgrab.world.scenery.plan import Plan
from simgrab.world.trajectory import iid as swing
from simgrab.world.trajectory.display import shown
from simgrab.world.trajectory.moment import Moment

REMEMBERED = 64  # cached frames, which may be requested again without restarting their clip


class Trajectory:
    """The moments of a scenario.

    Frames may be requested in any order. With dynamic swing, a clip runs from its beginning to the requested frame,
    so forward requests are cheap and backward ones are not. A user's own trajectory replaces the scenario's swing. The
    plan is required if ropes are to be shortened until the grab is clear of the surroundings.
    """

    def __init__(self, scenario: Scenario, extensions: Extensions = NO_EXTENSIONS, plan: Plan | None = None) -> None:
        self._scenario, self._extensions, self._plan = scenario, extensions, plan
        self._layout, self._grab = scenario.display_layout, design_of(scenario.grab)
        self._moments: Iterator[Moment] = iter(())
        self._recent: deque[Moment] = deque(maxlen=REMEMBERED)

    def at(self, frame: int) -> Moment:
        """Return one frame's moment.

        Raises `ScenarioError` if the frame is impossible. The message names frame and key.
        """
        if self._extensions.trajectory is not None:
            return self._with_display(self._extensions.moment(self._scenario, frame))
        if isinstance(self._scenario.swing, Iid):
            moment = swing.draw(self._scenario, frame)
            if "rope_length_m" in self._scenario.swing.clamped:
                assert self._plan is not None
                moment = self._plan.lifted(moment)
            return self._with_display(moment)
        # Physics alone needs it: SciPy's filters take a quarter of the time in which `render` is imported.
        from simgrab.world.trajectory.clip import ClipMotion

        recent = next((m for m in self._recent if m.frame == frame), None)
        if recent:
            return recent
        clip = self._scenario.clip.of(frame)
        if not self._recent or self._recent[-1].clip != clip or frame < self._recent[-1].frame:
            self._moments = iter(ClipMotion(self._scenario, clip))
            self._recent.clear()
        for moment in self._moments:
            self._recent.append(moment)
            if moment.frame == frame:
                return moment
        raise AssertionError("internal error: a clip's motion has no end")

    def _with_display(self, moment: Moment) -> Moment:
        """Add the display to an independent frame: its own lengths, and a clock from its index."""
        if not self._layout:
            return moment
        lengths = moment.grab.rope_length, moment.grab.rope_length + self._grab.closing_rope_m(moment.grab.jaw)
        time = moment.frame / self._scenario.clip.frame_rate_hz
        return replace(moment, shown=shown(self._scenario.display, self._layout, time, lambda _: lengths))
