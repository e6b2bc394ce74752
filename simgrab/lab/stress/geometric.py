"""The geometric fidelity: from a situation to pixels, without pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from simgrab.errors import StressError
from simgrab.lab.stress import swings
from simgrab.lab.stress.records import PROBE_ALPHA, PROBES, Records
from simgrab.lab.stress.situation import KEYS as KEYS
from simgrab.lab.stress.situation import Situation
from simgrab.lab.stress.study import situation as prepare
from simgrab.lab.stress.swings import Draws, ReplicatedMotion
from simgrab.model.geometry import Array, camera_rotation, grab_centre, grab_rotation, lean, rotation_z, to_camera

__all__ = ["KEYS", "draw", "made_with", "prepare", "show", "together"]

FRAMES_AT_ONCE = 1 << 18
"""Frames that are drawn together, which bounds the memory."""
MOST_TRIALS, MOST_SLOW_TRIALS = 500, 4
_SLOW_S = 10.0
_WAYS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2
_GRAB_M = np.array([2.9, 2.4, 3.4])  # the closed grab's box, of which A is the centre
_MOST_YAW = math.radians(15.0)


def draw(situation: Situation, seed: int, trials: Sequence[int]) -> Records:
    """Draw replications by their numbers, on which alone they depend; raises `StressError` if they are all the same."""
    draws, probes = Draws(seed, trials, situation.frames), Draws(seed, trials, PROBES)
    motion = swings.draw(situation, draws)
    ring = swings.ring(probes, motion, PROBE_ALPHA, situation.azimuth)
    pixels = _missed(situation, draws, motion, _seen(situation, draws, motion))
    rope = swings.reported_rope(situation, draws, motion.rope)
    if situation.motion and len(trials) > 1 and not np.ptp(motion.alpha, axis=0).any():
        raise StressError(f"motion: {situation.motion!r} varies nothing at this rate: all replications are the same")
    return Records(
        pixels=pixels,
        rope=rope,
        time=np.arange(situation.frames) / situation.rate_hz,
        calibration=situation.nominal,
        alpha=motion.alpha,
        beta=situation.beta,
        sigma=motion.sigma,
        azimuth=situation.azimuth,
        probe_pixels=_seen(situation, probes, ring, "probe."),
        probe_rope=np.maximum(ring.rope + situation.rope_bias_m, 0.1),
    )


def together(situation: Situation) -> int:
    """Return how many replications may be drawn together."""
    if situation.motion:
        return MOST_SLOW_TRIALS
    return int(np.clip(FRAMES_AT_ONCE // situation.frames, 1, MOST_TRIALS))


def show(situation: Situation, seed: int, trial: int) -> tuple[Records, None]:
    """Draw one replication, of which there is no picture."""
    return draw(situation, seed, [trial]), None


def made_with() -> str:
    """Name what else than study and package the numbers depend on: nothing."""
    return ""


def _seen(situation: Situation, draws: Draws, motion: ReplicatedMotion, prefix: str = "") -> Array:
    """Pixels (M, n, 2) at which the grab is found."""
    rotation = _rotation(situation, draws, motion, prefix)
    offset = rotation_z(situation.azimuth) @ np.array(situation.offset) + situation.nominal.offset_m
    centre = grab_centre(motion.alpha, motion.azimuth, motion.rope)
    pixels = situation.lens.project(to_camera(centre, rotation, offset))
    if situation.box_centre:
        yaw = _MOST_YAW * (2 * draws.uniform(f"{prefix}yaw") - 1)
        pose = grab_rotation(motion.alpha, motion.azimuth, yaw)
        low, high = np.full_like(pixels, np.inf), np.full_like(pixels, -np.inf)
        for way in _WAYS * _GRAB_M:
            corner = situation.lens.project(to_camera(centre + pose @ way, rotation, offset))
            low, high = np.minimum(low, corner), np.maximum(high, corner)
        pixels = pixels + situation.box_centre * ((low + high) / 2 - pixels)
    return _noisy(situation, draws, pixels, prefix)


def _rotation(s: Situation, draws: Draws, motion: ReplicatedMotion, prefix: str) -> Array:
    """Camera to jib, shape (3, 3), or (M, n, 3, 3) where it moves."""
    if motion.tilt is not None:
        return camera_rotation(motion.tilt[:, 0] + s.planted, motion.tilt[:, 1], motion.tilt[:, 2])
    rest = camera_rotation(s.beta + s.planted, s.azimuth, s.roll)
    if not (s.luffing or s.levelling or s.tremble):
        return rest
    x, y = s.tremble * draws.normal(f"{prefix}tremble", 2).swapaxes(0, 1)
    if s.luffing:
        x = x + s.luffing * (draws.uniform(f"{prefix}luffing") - 0.5)
    if s.levelling:
        state = draws.uniform(f"{prefix}levelling")
        y = y + s.levelling * ((state < 0.25).astype(float) - (state > 0.75))
    return lean(np.arctan(np.hypot(x, y)), np.arctan2(y, x)) @ rest


def _noisy(s: Situation, draws: Draws, pixels: Array, prefix: str) -> Array:
    if s.noise_px:
        pixels = pixels + s.noise_px * draws.normal(f"{prefix}noise", 2).swapaxes(1, 2)
    if s.heavy_px:
        heavy = draws.of(f"{prefix}noise.heavy", lambda rng: rng.standard_t(3, (draws.frames, 2)))
        pixels = pixels + s.heavy_px * heavy
    if s.slow_px:
        keep = 0.0 if prefix else math.exp(-1 / (_SLOW_S * s.rate_hz))
        pixels = pixels + s.slow_px * draws.wandering(f"{prefix}noise.slow", keep).swapaxes(1, 2)
    if s.outliers and not prefix:  # what an alarm makes of the wrong thing is another question
        u, v = s.lens.width_px * draws.uniform("outlier.u"), s.lens.height_px * draws.uniform("outlier.v")
        pixels = np.where((draws.uniform("outlier") < s.outliers)[..., None], np.stack([u, v], -1), pixels)
    return pixels


def _missed(s: Situation, draws: Draws, motion: ReplicatedMotion, pixels: Array) -> Array:
    gone = np.zeros(motion.alpha.shape, bool)
    if s.missing:
        gone |= draws.uniform("missing") < s.missing
    if s.missing_far:
        hazard = -math.log(1 - s.missing_far) * motion.alpha / PROBE_ALPHA
        gone |= draws.uniform("missing.far") < -np.expm1(-hazard)
    if s.bounded:
        inside = (pixels >= 0) & (pixels < (s.lens.width_px, s.lens.height_px))
        gone |= ~inside.all(axis=-1)
    return np.where(gone[..., None], np.nan, pixels) if gone.any() else pixels
