"""What a user might write: a randomiser, a trajectory and an image effect."""

from dataclasses import replace

import numpy as np

import simgrab


def sunny_or_grey(_scenario, rng):
    return {"light.sun": float(rng.uniform(0.1, 0.9)), "camera.beta_deg": 4.0}


def circle(scenario, frame, _rng):
    azimuth = 2 * np.pi * frame / scenario.frames
    grab = simgrab.GrabState(alpha=np.radians(3.0), azimuth=azimuth, rope_length=15.0, yaw=0.0, jaw=0.1, load=0.0)
    return simgrab.Moment.still(frame, grab, simgrab.Tilt.at_rest(scenario.camera))


def speckle(rgb, _moment, rng):
    dark = rng.random(rgb.shape[:2]) < 0.05
    return np.where(dark[..., None], 0, rgb).astype(np.uint8)


def invert(rgb, _moment, _rng):
    return 255 - rgb


def passing(scenario, frame, rng):
    """`circle` with times, as a clip has them."""
    jib = simgrab.JibState(slew=0.0, radius=30.0, luffed=0.0)
    return replace(circle(scenario, frame, rng), time=frame / scenario.clip.frame_rate_hz, jib=jib)
