"""From what is drawn to the picture that the camera gives: light, lens, sensor, display, coding."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from simgrab.scenario import AutoExposure, Dynamic, Scenario
from simgrab.world.moment import Moment
from simgrab.world.optics import ExposureControl, recompress, to_display
from simgrab.world.osd.draw import Overlay
from simgrab.world.render import Renderer, View

Picture = NDArray[np.uint8]


class Chain:
    """What happens to a picture after it is drawn.

    Parameters
    ----------
    scenario : Scenario
    renderer : Renderer
    moment_at : callable
        Gives the moment of a frame.
    """

    def __init__(self, scenario: Scenario, renderer: Renderer, moment_at: Callable[[int], Moment]) -> None:
        self._scenario, self._renderer, self._moment_at = scenario, renderer, moment_at
        layout = scenario.display.layout_in(scenario.camera.width_px, scenario.camera.height_px)
        self._overlay = Overlay(layout) if layout else None
        exposure = scenario.optics.exposure
        self._lags = isinstance(exposure, AutoExposure) and exposure.lag_s > 0 and isinstance(scenario.swing, Dynamic)
        self._control, self._metered = ExposureControl(scenario.optics, scenario.clip.frame_rate_hz), -1

    @property
    def needs_depth(self) -> bool:
        """Whether it wants a view of the whole picture with ids and depth."""
        return self._scenario.light.floodlights > 0

    def picture(self, frame: int, view: View | None) -> Picture:
        """Make a frame's picture, shape (height, width, 3).

        Parameters
        ----------
        frame : int
        view : View or None
            Of the whole picture at the instant of the labels, where `needs_depth`.
        """
        optics, moment = self._scenario.optics, self._moment_at(frame)
        drawn = self._drawn(moment)
        if view or not optics.off:
            light = self._light(drawn, moment, view)
            rgb = drawn if False else self._exposed(frame, light)
        else:
            rgb = drawn if drawn.dtype == np.uint8 else to_display(drawn)
        if self._overlay and moment.shown:
            rgb = self._overlay.blend(rgb, moment.shown)
        return recompress(rgb, optics.recompress_quality)
