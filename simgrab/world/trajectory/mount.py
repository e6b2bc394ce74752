"""How the camera's tilt moves: with the fly-jib, by gravity, or not at all."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import expm

from simgrab import geometry
from simgrab.geometry import Array
from simgrab.scenario import Camera, LevelledMount, RigidMount
from simgrab.world.trajectory.moment import Tilt


class Mount:
    """Lean of the camera about its rest attitude: a horizontal vector in the jib frame, the tangent of the angle.

    Parameters
    ----------
    camera : Camera
    step : float
        s.
    """

    def __init__(self, camera: Camera, step: float) -> None:
        self._camera, self._mount = camera, camera.mount
        self._lean, self._rate = (0.0, 0.0), (0.0, 0.0)
        if isinstance(self._mount, LevelledMount):
            w = 2 * math.pi * self._mount.frequency_hz
            advance = expm(step * np.array([[0.0, 1.0], [-w * w, -2 * self._mount.damping * w]]))
            self._advance = tuple(float(a) for a in advance.ravel())

    def step(self, gravity: Array, luffed: float) -> None:
        """Go on by one step.

        Parameters
        ----------
        gravity : ndarray, shape (3,)
            Mean apparent gravity during the step, jib frame, m/s².
        luffed : float
            Growth of the radius at its end, m.
        """
        if isinstance(self._mount, LevelledMount):
            a, b, c, d = self._advance
            pairs = []
            for axis in range(2):
                plumb = float(gravity[axis] / -gravity[2])
                off, rate = self._lean[axis] - plumb, self._rate[axis]
                pairs.append((plumb + a * off + b * rate, c * off + d * rate))
            (x, u), (y, v) = pairs
            self._lean, self._rate = (x, y), (u, v)
        elif isinstance(self._mount, RigidMount):
            self._lean = math.tan(math.radians(self._mount.pitch_deg_per_m) * luffed), 0.0

    def tilt(self, tremble: Array) -> Tilt:
        """Attitude of the camera, with a further small lean (2,) from vibration."""
        camera = self._camera
        angles = np.radians((camera.beta_deg, camera.tilt_azimuth_deg, camera.roll_deg))
        x, y = self._lean[0] + tremble[0], self._lean[1] + tremble[1]
        if not (x or y):
            return Tilt(*(float(a) for a in angles))
        leaning = geometry.lean(math.atan(math.hypot(x, y)), math.atan2(y, x))
        return Tilt.of(leaning @ geometry.camera_rotation(*angles), float(angles[1]))
