"""Records of the world's own motion without its pictures: what a perfect detector and reader would say, and noise."""

import json
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.signal import lfilter

from simgrab.dataset.tables import calibration_of
from simgrab.instrument.controller import Controller
from simgrab.instrument.observation import Observation
from simgrab.model import scenes
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import to_camera
from simgrab.world.trajectory.trajectory import Trajectory


@dataclass(frozen=True)
class Swinging:
    """A record of n frames: true times, pixels (n, 2), rope lengths, swings and their directions (rad), and the camera.

    ``jib`` (n, 2) holds slew angle, rad, and radius, m.
    """

    time: np.ndarray
    pixels: np.ndarray
    rope: np.ndarray
    alpha: np.ndarray
    direction: np.ndarray
    beta: np.ndarray
    jib: np.ndarray
    calibration: Calibration

    def rms_deg(self, found):
        """RMS error of an estimate's α, where there is one."""
        return float(np.degrees(np.sqrt(np.nanmean((found.alpha - self.alpha) ** 2))))

    def covered(self, found):
        """Share of the frames of which the first intervals of an estimate hold the true α."""
        low, high = found.intervals[0].alpha.T
        return np.mean((low <= self.alpha) & (self.alpha <= high))

    def wandering(self):
        """Pixels with errors of 4 px that last for 10 s, beside those of 0.3 px in each frame."""
        rng, stay = np.random.default_rng(3), np.exp(-1 / 90)  # at 9 frames a second
        lasting = lfilter([1.0], [1.0, -stay], rng.normal(0, 4.0 * np.sqrt(1 - stay**2), self.pixels.shape), axis=0)
        return self.pixels + lasting + rng.normal(0, 0.3, self.pixels.shape)

    def observations(self, noise_px=0.0, seed=0):
        pixels = self.pixels + np.random.default_rng(seed).normal(0, noise_px, self.pixels.shape)
        sd = (max(noise_px, 0.1),) * 2
        layout, constant = self.calibration.digit_layout, self.calibration.display_constant_m
        texts = [layout.text(r - constant, 20.0) for r in self.rope]
        return [
            Observation(time, centre=(u, v), centre_sd=sd, box=(u - 40, v - 40, u + 40, v + 40), score=0.9,
                     rope_text=text, rope_status="read", hoist_m=layout.lengths(text)[0])
            for time, (u, v), text in zip(self.time.tolist(), pixels.tolist(), texts, strict=True)
        ]  # fmt: skip


@dataclass
class Feed:
    """A controller that is followed: it writes every so many seconds, and reports the ``latest_s`` up to then."""

    data: Controller
    states_rope: bool = True
    states_radius: bool = False
    states_motion: bool = False
    every_s: float = 0.0
    latest_s: float = 20.0
    problem: str = ""
    news: str = ""

    def poll(self, now):
        data, until = self.data, now // self.every_s * self.every_s if self.every_s else now
        some = (data.time <= until) & (data.time > now - self.latest_s)
        names = "time", "slew", "radius", "rope", "slew_setpoint", "radius_setpoint"
        columns = {name: getattr(data, name) for name in names}
        known = {name: values[some] for name, values in columns.items() if values is not None}
        return replace(data, **known) if some.sum() > 1 else None


def nobody(_picture):
    """A detector, or a reader, of records that are measured already."""
    raise AssertionError("no picture is to be looked at")


@cache
def _made(scene, changes):
    scenario = scenes.load(scene, {"display.layout": "two-by-four"} | json.loads(changes))
    story, camera = Trajectory(scenario), scenario.camera
    moments = [story.at(frame) for frame in range(scenario.frames)]
    centres = np.array([m.grab.jib_from_grab.translation for m in moments])
    rotations = np.array([m.tilt.jib_from_camera for m in moments])
    return Swinging(
        np.array([m.time for m in moments]),
        camera.intrinsics.project(to_camera(centres, rotations, np.asarray(camera.offset_m))),
        np.array([m.grab.rope_length for m in moments]),
        np.array([m.grab.alpha for m in moments]),
        np.arctan2(centres[:, 1], centres[:, 0]),
        np.array([m.tilt.beta for m in moments]),
        np.array([(m.jib.slew, m.jib.radius) for m in moments]),
        calibration_of(scenario),
    )


def record(scene="work-cycles", fixed=True, **changes):
    """Let a crane work; ``camera__beta_deg=3.0`` changes a key. By default the camera keeps its attitude."""
    changes = {key.replace("__", "."): value for key, value in changes.items()}
    if fixed:
        changes["camera.mount"] = {"model": "fixed"}
    return _made(scene, json.dumps(changes, sort_keys=True))
