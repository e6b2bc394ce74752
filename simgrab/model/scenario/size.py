"""Resize a scenario's pictures without changing the view."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping
from typing import Any

import msgspec

from simgrab.io.strict import convert
from simgrab.model.scenario import vary
from simgrab.model.scenario.camera import Camera
from simgrab.model.scenario.factor import JOINT
from simgrab.model.scenario.whole import Scenario, merged


def resized(scenario: Scenario, width_px: int, height_px: int) -> Scenario:
    """Return the scenario with the same view at another size.

    The horizontal field of view stays. Everything in pixels scales with the width: the focal length, the offset of
    the principal point, defocus and chromatic error, and the laws by which these vary; the display's layout is fitted
    to the picture wherever it is rendered. A picture of another aspect ratio shows more or less above and below. What
    is physical stays, and so do the sensor's noise, antialiasing, shadow map and bit rate.

    Parameters
    ----------
    scenario : Scenario
    width_px, height_px : int
        Size of the pictures, each from 64 to 4096; a video needs even ones.

    Raises
    ------
    ScenarioError
        If the size is out of range, or too small for the focal length or the display.

    Examples
    --------
    >>> from simgrab import scenes
    >>> small = resized(scenes.load("quay-day"), 640, 360)
    >>> round(small.camera.intrinsics.f_px, 2), round(scenes.load("quay-day").camera.intrinsics.f_px / 3, 2)
    (548.27, 548.27)
    """
    change = _Change(scenario.camera, operator.index(width_px), operator.index(height_px))
    sharpens = any("optics.sharpening" in name for name in scenario.vary)  # else a default, which is not scaled
    data = msgspec.to_builtins(scenario) if sharpens else scenario.to_dict()
    factors = {name: change.factor(name, factor) for name, factor in data.pop("vary").items()}
    result = convert({**change.value("", data), "vary": factors}, Scenario)
    vary.check(result)
    return result


class _Change:
    """Change of each key of a scenario, as plain data."""

    def __init__(self, camera: Camera, width_px: int, height_px: int) -> None:
        self._camera = camera
        self._size = {"camera.width_px": width_px, "camera.height_px": height_px}
        scale = width_px / camera.width_px
        alike = width_px * camera.height_px == height_px * camera.width_px
        # A sensor read out whole: its diagonal spans another part of the same picture.
        diagonal = math.hypot(width_px, height_px) / math.hypot(camera.width_px, camera.height_px)
        self._scales = {
            "camera.focal.focal_length_px": scale,
            "camera.focal.pixels_per_mm": scale,
            "camera.focal.sensor_diagonal_mm": 1.0 if alike or not scale else diagonal / scale,
            "camera.principal_offset_px": scale,
            "optics.defocus_px": scale,
            "optics.chromatic_px": scale,
            "optics.sharpening.radius_px": scale,
        }

    def value(self, key: str, value: Any) -> Any:
        """Change the value of a dotted key."""
        if key in self._size:
            return self._size[key]
        if key in self._scales:
            return _scaled(value, self._scales[key])
        if key == "camera.focal":  # a varied one may leave out what its defaults scale
            value = msgspec.to_builtins(
                convert(merged(msgspec.to_builtins(self._camera), {"focal": value}), Camera).focal
            )
        if isinstance(value, Mapping):
            return {name: self.value(f"{key}.{name}" if key else name, inner) for name, inner in value.items()}
        return value

    def factor(self, name: str, factor: Mapping[str, Any]) -> dict[str, Any]:
        """Change what varies: a choice value by value, a law by its parameters."""
        if factor["dist"] != "one-of":
            return _scaled(factor, self._scales.get(name, 1.0))
        if JOINT in name:
            return {**factor, "values": [{k: self.value(k, v) for k, v in table.items()} for table in factor["values"]]}
        return {**factor, "values": [self.value(name, value) for value in factor["values"]]}


def _scaled(value: Any, scale: float) -> Any:
    """Multiply a number, a list of numbers, or a law."""
    if isinstance(value, Mapping):
        return {k: v if k in ("dist", "weights") or v is None else _scaled(v, scale) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_scaled(v, scale) for v in value]
    return value * scale
