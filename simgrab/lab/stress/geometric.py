"""The geometric fidelity: from a situation to pixels, without pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from simgrab.lab.stress import swings
from simgrab.lab.stress.records import PROBE_ALPHA, PROBES, Records
from simgrab.lab.stress.situation import Situation
from simgrab.lab.stress.swings import Draws, Motion
from simgrab.model.geometry import Array, camera_rotation, grab_centre, grab_rotation, lean, rotation_z, to_camera

FRAMES_AT_ONCE = 1 << 18
"""Frames that are drawn together, which bounds the memory."""
MOST_TRIALS, MOST_SLOW_TRIALS = 500, 4
_SLOW_S = 10.0
_WAYS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2
_GRAB_M = np.array([2.9, 2.4, 3.4])  # the closed grab's box, of which A is the centre
_MOST_YAW = math.radians(15.0)


def draw(situation: Situation, seed: int, trials: Sequence[int]) -> Records:
    """Draw replications. Each depends on its own number alone, and not on which others are drawn with it.

    Parameters
    ----------
    situation : Situation
    seed : int
    trials : sequence of int
        Numbers of the replications.
    """
    draws = Draws(seed, trials, situation.frames)
    motion = swings.draw(situation, draws)
    pixels = _missed(situation, draws, motion, _seen(situation, draws, motion))
    return Records(
        pixels=pixels,
        rope=swings.reported_rope(situation, draws, motion.rope),
        time=np.arange(situation.frames) / situation.rate_hz,
        calibration=situation.nominal,
        alpha=motion.alpha,
        beta=situation.attitude.beta,
        sigma=motion.sigma,
        azimuth=situation.attitude.azimuth,
        **_probed(situation, seed, trials, motion),
    )


def together(situation: Situation) -> int:
    """Return how many replications may be drawn together."""
    if situation.swing.motion:
        return MOST_SLOW_TRIALS
    return int(np.clip(FRAMES_AT_ONCE // situation.frames, 1, MOST_TRIALS))


def show(situation: Situation, seed: int, trial: int) -> tuple[Records, None]:
    """Draw one replication, of which there is no picture."""
    return draw(situation, seed, [trial]), None


def _probed(situation: Situation, seed: int, trials: Sequence[int], motion: Motion) -> dict[str, Array]:
    """Look at swings of the alarm's size, at ropes and attitudes that the record has."""
    draws = Draws(seed, trials, PROBES)
    ring = swings.ring(draws, motion, PROBE_ALPHA, situation.attitude.azimuth)
    return {
        "probe_pixels": _seen(situation, draws, ring, "probe."),
        "probe_rope": np.maximum(ring.rope + situation.rope.bias_m, 0.1),
    }


def _seen(situation: Situation, draws: Draws, motion: Motion, prefix: str = "") -> Array:
    """Pixels (M, n, 2) at which the grab is found."""
    rotation = _rotation(situation, draws, motion, prefix)
    offset = rotation_z(situation.attitude.azimuth) @ np.array(situation.offset) + situation.nominal.offset_m
    centre = grab_centre(motion.alpha, motion.azimuth, motion.rope)
    observation = situation.observation
    pixels = situation.lens.project(to_camera(centre, rotation, offset))
    if observation.box_centre:
        yaw = _MOST_YAW * (2 * draws.uniform(f"{prefix}yaw") - 1)
        pose = grab_rotation(motion.alpha, motion.azimuth, yaw)
        low, high = np.full_like(pixels, np.inf), np.full_like(pixels, -np.inf)
        for way in _WAYS * _GRAB_M:
            corner = situation.lens.project(to_camera(centre + pose @ way, rotation, offset))
            low, high = np.minimum(low, corner), np.maximum(high, corner)
        pixels = pixels + observation.box_centre * ((low + high) / 2 - pixels)
    return _noisy(situation, draws, pixels, prefix)


def _rotation(situation: Situation, draws: Draws, motion: Motion, prefix: str) -> Array:
    """Camera to jib, shape (3, 3), or (M, n, 3, 3) where it moves."""
    a = situation.attitude
    if motion.tilt is not None:
        return camera_rotation(motion.tilt[:, 0] + a.planted, motion.tilt[:, 1], motion.tilt[:, 2])
    rest = camera_rotation(a.beta + a.planted, a.azimuth, a.roll)
    if not (a.luffing or a.levelling or a.tremble):
        return rest
    x, y = a.tremble * draws.normal(f"{prefix}tremble", 2).swapaxes(0, 1)
    if a.luffing:
        x = x + a.luffing * (draws.uniform(f"{prefix}luffing") - 0.5)
    if a.levelling:
        state = draws.uniform(f"{prefix}levelling")
        y = y + a.levelling * ((state < 0.25).astype(float) - (state > 0.75))
    return lean(np.arctan(np.hypot(x, y)), np.arctan2(y, x)) @ rest


def _noisy(situation: Situation, draws: Draws, pixels: Array, prefix: str) -> Array:
    observation = situation.observation
    if observation.noise_px:
        pixels = pixels + observation.noise_px * draws.normal(f"{prefix}noise", 2).swapaxes(1, 2)
    if observation.heavy_px:
        heavy = draws.of(f"{prefix}noise.heavy", lambda rng: rng.standard_t(3, (draws.frames, 2)))
        pixels = pixels + observation.heavy_px * heavy
    if observation.slow_px:
        keep = 0.0 if prefix else math.exp(-1 / (_SLOW_S * situation.rate_hz))
        pixels = pixels + observation.slow_px * draws.wandering(f"{prefix}noise.slow", keep).swapaxes(1, 2)
    if observation.outliers and not prefix:  # what an alarm makes of the wrong thing is another question
        k = situation.lens
        anywhere = np.stack([k.width_px * draws.uniform("outlier.u"), k.height_px * draws.uniform("outlier.v")], -1)
        pixels = np.where((draws.uniform("outlier") < observation.outliers)[..., None], anywhere, pixels)
    return pixels


def _missed(situation: Situation, draws: Draws, motion: Motion, pixels: Array) -> Array:
    observation = situation.observation
    gone = np.zeros(motion.alpha.shape, bool)
    if observation.missing:
        gone |= draws.uniform("missing") < observation.missing
    if observation.missing_far:
        hazard = -math.log(1 - observation.missing_far) * motion.alpha / PROBE_ALPHA
        gone |= draws.uniform("missing.far") < -np.expm1(-hazard)
    if observation.bounded:
        k = situation.lens
        inside = (pixels >= 0) & (pixels < (k.width_px, k.height_px))
        gone |= ~inside.all(axis=-1)
    return np.where(gone[..., None], np.nan, pixels) if gone.any() else pixels
