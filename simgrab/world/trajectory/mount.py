"""Motion of the camera's tilt: with the fly-jib, by gravity, or none."""

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

    Levelled, it is a damped pendulum that follows apparent gravity, ẍ = −ω² (x − g_x/−g_z) − 2 ζ ω ẋ for either axis;
    rigid, it pitches with luffing. During an interval, s, apparent gravity is constant.
    """

    def __init__(self, camera: Camera, interval: float) -> None:
        self._mount = camera.mount
        self._state = np.zeros((2, 2))  # lean and its rate
        if isinstance(self._mount, LevelledMount):
            w = 2 * math.pi * self._mount.frequency_hz
            self._motion = np.array([[0.0, 1.0], [-w * w, -2 * self._mount.damping * w]])
            self._advance = expm(interval * self._motion).tolist()

    def advance(self, gravity: Array, luffed: Array) -> Array:
        """Advance by n intervals.

        Parameters
        ----------
        gravity : ndarray, shape (n, 3)
            Mean apparent gravity during each, jib frame, m/s².
        luffed : ndarray, shape (n + 1,)
            Growth of the radius at their ends, m.

        Returns
        -------
        ndarray, shape (n + 1, 2, 2)
            Lean and its rate, 1/s, at the intervals' ends.
        """
        states = np.zeros((len(luffed), 2, 2))
        if isinstance(self._mount, LevelledMount):
            (a, b), (c, d) = self._advance
            for axis in range(2):
                x, u = self._state[:, axis].tolist()
                leans = [(x, u)]
                for plumb in (gravity[:, axis] / -gravity[:, 2]).tolist():
                    off = x - plumb
                    x, u = plumb + a * off + b * u, c * off + d * u
                    leans.append((x, u))
                states[:, :, axis] = leans
            self._state = states[-1]
        elif isinstance(self._mount, RigidMount):
            slope = math.radians(self._mount.pitch_deg_per_m)
            states[:, 0, 0] = [math.tan(slope * out) for out in luffed.tolist()]
        return states

    def within(self, state: Array, seconds: Array, gravity: Array, luffed: Array, luff_rate: Array) -> Array:
        """Lean and its rate at n instants within intervals, shape (n, 2, 2).

        Parameters
        ----------
        state : ndarray, shape (n, 2, 2)
            State at the beginning of each instant's interval, as `advance` returns it.
        seconds : ndarray, shape (n,)
            Since then.
        gravity : ndarray, shape (n, 3)
            Gravity in the middle of that interval.
        luffed, luff_rate : ndarray, shape (n,)
            Growth of the radius at the instants, m, and its rate, m/s.
        """
        if isinstance(self._mount, LevelledMount):
            plumb = np.zeros_like(state)
            plumb[:, 0] = gravity[:, :2] / -gravity[:, 2:]
            return np.asarray(plumb + _expm(self._motion, seconds) @ (state - plumb))
        leans = np.zeros_like(state)
        if isinstance(self._mount, RigidMount):
            slope = math.radians(self._mount.pitch_deg_per_m)
            leans[:, 0, 0] = np.tan(slope * luffed)
            leans[:, 1, 0] = slope * luff_rate * (1 + leans[:, 0, 0] ** 2)
        return leans


def tilted(camera: Camera, lean: Array) -> Tilt:
    """Attitude of a camera that leans by a vector (2,) about its attitude at rest."""
    rest, (x, y) = Tilt.at_rest(camera), lean.tolist()
    if not (x or y):
        return rest
    leaning = geometry.lean(math.atan(math.hypot(x, y)), math.atan2(y, x))
    return Tilt.of(leaning @ rest.jib_from_camera, rest.azimuth)


def _expm(motion: Array, seconds: Array) -> Array:
    """exp(t M) of a 2 × 2 matrix for many t, shape (n, 2, 2): e^(ht) (cosh(st) I + sinh(st)/s (M − h I))."""
    # h is half the trace and s² = h² − det M. SciPy's `expm` takes a millisecond for each where cores are busy.
    half = motion.trace() / 2
    root = complex(half**2 - np.linalg.det(motion)) ** 0.5
    even = np.cosh(root * seconds).real
    odd = (np.sinh(root * seconds) / root).real if abs(root) * seconds.max(initial=0) > 1e-6 else seconds
    return np.asarray(
        np.exp(half * seconds)[:, None, None]
        * (even[:, None, None] * np.eye(2) + odd[:, None, None] * (motion - half * np.eye(2)))
    )
