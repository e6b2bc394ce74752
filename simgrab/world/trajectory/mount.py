"""How the camera's tilt moves: with the fly-jib, by gravity, or not at all."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import expm

from simgrab.model import geometry
from simgrab.model.geometry import Array
from simgrab.model.scenario import Camera, LevelledMount, RigidMount
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
            self._motion = np.array([[0.0, 1.0], [-w * w, -2 * self._mount.damping * w]])
            advance = expm(step * self._motion)
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

    def leaning(self, seconds: Array, gravity: Array, luffed: Array, luff_rate: Array) -> tuple[Array, Array]:
        """Lean and its rate at instants within the step that is next.

        Parameters
        ----------
        seconds : ndarray, shape (n,)
            Since the last step.
        gravity : ndarray, shape (3,)
            As for the step.
        luffed, luff_rate : ndarray, shape (n,)
            Growth of the radius at the instants, m, and its rate, m/s.

        Returns
        -------
        lean, rate : ndarray, shape (n, 2)
            Tangent of the angle, and its rate, 1/s.
        """
        lean, rate = np.zeros((len(seconds), 2)), np.zeros((len(seconds), 2))
        if isinstance(self._mount, LevelledMount):
            plumb = gravity[:2] / -gravity[2]
            state = _expm(self._motion, seconds) @ np.stack([self._lean - plumb, self._rate])
            lean, rate = plumb + state[:, 0], state[:, 1]
        elif isinstance(self._mount, RigidMount):
            slope = math.radians(self._mount.pitch_deg_per_m)
            lean[:, 0] = np.tan(slope * luffed)
            rate[:, 0] = slope * luff_rate * (1 + lean[:, 0] ** 2)
        return lean, rate

    def tilt(self, tremble: Array) -> Tilt:
        """Attitude of the camera, with a further small lean (2,) from vibration."""
        camera = self._camera
        angles = np.radians((camera.beta_deg, camera.tilt_azimuth_deg, camera.roll_deg))
        x, y = self._lean[0] + tremble[0], self._lean[1] + tremble[1]
        if not (x or y):
            return Tilt(*(float(a) for a in angles))
        leaning = geometry.lean(math.atan(math.hypot(x, y)), math.atan2(y, x))
        return Tilt.of(leaning @ geometry.camera_rotation(*angles), float(angles[1]))


def _expm(motion: Array, seconds: Array) -> Array:
    """exp(t M) of a 2 × 2 matrix for many t, shape (n, 2, 2): e^(ht) (cosh(st) I + sinh(st)/s (M − h I)).

    h is half the trace and s² = h² − det M. SciPy's `expm` takes a millisecond for each where cores are busy.
    """
    half = motion.trace() / 2
    square = complex(half**2 - np.linalg.det(motion))
    root = square**0.5
    even = np.cosh(root * seconds).real
    odd = (np.sinh(root * seconds) / root).real if abs(root) * seconds.max() > 1e-6 else seconds
    return np.asarray(
        np.exp(half * seconds)[:, None, None]
        * (even[:, None, None] * np.eye(2) + odd[:, None, None] * (motion - half * np.eye(2)))
    )
