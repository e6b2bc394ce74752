"""Motion of jaws that hang on a sliding beam and on arms: a slider-crank on either side, in closed form.

The ropes hold the head. The beam slides below it along z; each jaw turns about a pin in the beam, and an arm, pinned to
the head and to the jaw, keeps its length. Opening therefore moves the beam.

All is in the plane of one jaw: x points from the ropes' axis towards the jaw, z up. An angle is a rotation about +y
(x towards −z), so that a jaw opens by a negative one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np


class LinkageState(NamedTuple):
    """Height of the jaws' pins in the grab frame, m; rotations of jaw and arm about +y from closed, rad."""

    beam_z: float
    jaw_angle: float
    arm_angle: float


@dataclass(frozen=True)
class _Pins:
    """Pins of a closed grab, (x, z), m, in the plane of one jaw."""

    hinge: tuple[float, float]  # the jaw's pin, grab frame
    head_pin: tuple[float, float]  # of the arm or cylinder, grab frame
    jaw_pin: tuple[float, float]  # its other pin, from the hinge

    def _span(self, jaw: float) -> tuple[float, float]:
        """Vector from the head's pin to the jaw's, if the jaw turns about a fixed hinge."""
        c, s = np.cos(jaw), np.sin(jaw)
        (hx, hz), (ax, az), (x, z) = self.hinge, self.head_pin, self.jaw_pin
        return float(hx + x * c - z * s - ax), float(hz + x * s + z * c - az)


class SliderCrank(_Pins):
    """A jaw hinged to the beam, with an arm to the head."""

    @cached_property
    def arm_m(self) -> float:
        """Length of the arm, between its pins."""
        return float(np.hypot(*self._span(0.0)))

    def at(self, jaw: float) -> LinkageState:
        """Solve for an opening of the jaw, rad; raises `ValueError` if the arm is too short for this opening."""
        x, z = self.jaw_pin
        reach, (x0, z0) = self._span(jaw)[0], self._span(0.0)
        if abs(reach) > self.arm_m:
            raise ValueError(f"the arm of {self.arm_m:.3f} m does not let the jaw open by {jaw:.4f} rad")
        drop = np.sqrt(self.arm_m**2 - reach**2)
        beam_z = self.head_pin[1] - drop - (x * np.sin(jaw) + z * np.cos(jaw))
        arm_angle = np.arctan2(x0, -z0) - np.arctan2(reach, drop)
        return LinkageState(float(beam_z), -float(jaw), float(arm_angle))


class Cylinder(_Pins):
    """A hydraulic cylinder between a head and a jaw that is hinged to it."""

    def length_m(self, jaw: float) -> float:
        """Distance between the pins at an opening, rad."""
        return float(np.hypot(*self._span(jaw)))

    def turn(self, jaw: float) -> float:
        """Turn of the cylinder about +y from closed, rad."""
        (x0, z0), (x, z) = self._span(0.0), self._span(jaw)
        return float(np.arctan2(x0, -z0) - np.arctan2(x, -z))

    def at(self, jaw: float) -> tuple[float, float]:
        """Turn of the cylinder about +y from closed, rad, and its extension, m."""
        return self.turn(jaw), self.length_m(jaw) - self.length_m(0.0)
