"""Draw the true swing of many replications, each from streams of its own."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from simgrab.lab.stress.situation import Situation
from simgrab.model import scenes
from simgrab.model.geometry import STANDARD_GRAVITY, Array
from simgrab.model.rng import stream

CYCLE_S = 75.0  # of a working crane
_FORCED_ROPE_M = 20.0


@dataclass(frozen=True)
class Draws:
    """The streams of M replications of n frames: one for each replication and variable, whatever else is drawn."""

    seed: int
    trials: Sequence[int]
    frames: int

    def of(self, name: str, sample: Callable[[np.random.Generator], Array]) -> Array:
        """Sample a variable, shape (M, ...)."""
        return np.stack([sample(stream(self.seed, trial, f"stress.{name}")) for trial in self.trials])

    def uniform(self, name: str) -> Array:
        """Uniform on [0, 1), shape (M, n)."""
        return self.of(name, lambda rng: rng.random(self.frames))

    def normal(self, name: str, components: int = 1) -> Array:
        """Draw standard normals, shape (M, components, n)."""
        return self.of(name, lambda rng: rng.normal(size=(components, self.frames)))

    def wandering(self, name: str, keep: float) -> Array:
        """Stationary normal noise of variance 1 and correlation ``keep`` from frame to frame, shape (M, 2, n)."""
        noise = self.normal(name, 2)
        noise[..., 1:] *= math.sqrt(1 - keep * keep)
        return np.asarray(lfilter([1.0], [1.0, -keep], noise))


@dataclass(frozen=True)
class ReplicatedMotion:
    """The truth of M replications of n frames, rad and m, jib frame."""

    alpha: Array  # (M, n)
    azimuth: Array  # (M, n)
    rope: Array  # (M, n)
    tilt: Array | None  # (M, 3, n), β, azimuth and roll of the camera, where physics moves it
    sigma: Array  # (M,), √E[α²]; of physics, whose expectation nobody knows, the record's own


def draw(situation: Situation, draws: Draws) -> ReplicatedMotion:
    """Draw the truth of replications."""
    if situation.motion:
        return _physics(situation, draws)
    x, y = _vectors(situation, draws)
    if situation.flatness:
        minor = 1 - situation.flatness
        size = math.sqrt(2 / (1 + minor * minor))
        x, y = size * x, size * minor * y
    if any(situation.lean):
        x, y = x + situation.lean[0], y + situation.lean[1]
    sigma = math.hypot(situation.sigma, *situation.lean)
    azimuth = np.arctan2(y, x) + situation.azimuth
    return ReplicatedMotion(np.hypot(x, y), azimuth, _rope(situation, draws, 0.0), None, np.full(len(x), sigma))


def ring(draws: Draws, motion: ReplicatedMotion, alpha: float, azimuth: float) -> ReplicatedMotion:
    """Swing by ``alpha``, rad, evenly all around, from ``azimuth`` on, at ropes and attitudes of the replications.

    ``draws`` are of the same replications, with as many frames as there are to be swings.
    """
    shape = (len(draws.trials), draws.frames)
    some = (draws.uniform("probe.frame") * motion.rope.shape[1]).astype(np.int64)
    around = np.broadcast_to(2 * np.pi * np.arange(draws.frames) / draws.frames + azimuth, shape)
    tilt = None if motion.tilt is None else np.take_along_axis(motion.tilt, some[:, None], axis=2)
    rope = np.take_along_axis(motion.rope, some, axis=1)
    return ReplicatedMotion(np.full(shape, alpha), around, rope, tilt, motion.sigma)


def _vectors(s: Situation, draws: Draws) -> tuple[Array, Array]:
    """Swing along and across the tilt, shape (M, n) each, of length α."""
    if s.memory_s:
        both = _forced(draws, s.memory_s, 1 / s.rate_hz) * (s.sigma / math.sqrt(2))
        return both[:, 0], both[:, 1]
    if s.correlation:  # α = σ|Z| with Z of first order, and γ whose unit vector has the same correlation
        alpha = s.sigma * np.abs(draws.wandering("alpha", s.correlation)[:, 0])
        steps = draws.normal("gamma.steps")[:, 0] * math.sqrt(-2 * math.log(s.correlation))
        steps[:, 0] = 2 * np.pi * draws.uniform("gamma")[:, 0]
        gamma = np.cumsum(steps, axis=-1)
    else:
        scale = s.sigma / s.law.rms
        alpha = np.abs(draws.of("alpha", lambda rng: s.law.sample(rng, draws.frames))) * scale
        gamma = _direction(s, draws)
    if s.unevenness:
        alpha = alpha * (1 + s.unevenness * np.cos(gamma)) / math.sqrt(1 + s.unevenness**2 / 2)
    return alpha * np.cos(gamma), alpha * np.sin(gamma)


def _direction(s: Situation, draws: Draws) -> Array:
    if not s.kappa:
        return 2 * np.pi * draws.uniform("gamma")
    gamma = draws.of("gamma", lambda rng: rng.vonmises(0.0, s.kappa, draws.frames))
    if s.axial:
        gamma = gamma / 2 + np.pi * (draws.uniform("gamma.side") < 0.5)
    return gamma + s.towards


def _forced(draws: Draws, memory_s: float, step_s: float) -> Array:
    """Linear pendulum of 20 m under white noise, exactly sampled; each component has variance 1; (M, 2, n)."""
    omega = math.sqrt(STANDARD_GRAVITY / _FORCED_ROPE_M)
    # State: place, and velocity over ω. Both have variance 1 and are independent.
    advance = expm(step_s * np.array([[0.0, omega], [-omega, -2 / memory_s]]))
    (a, b), (c, d) = advance.tolist()
    (p, _), (q, r) = np.linalg.cholesky(np.eye(2) - advance @ advance.T).tolist()
    noise = draws.normal("forcing", 4)
    place, rate = noise[:, 0:2, 0].copy(), noise[:, 2:4, 0].copy()
    path = np.empty((len(place), 2, draws.frames))
    for k in range(draws.frames):
        path[..., k] = place
        if k + 1 < draws.frames:
            u, v = noise[:, 0:2, k + 1], noise[:, 2:4, k + 1]
            place, rate = a * place + b * rate + p * u, c * place + d * rate + (q * u + r * v)
    return path


def _rope(situation: Situation, draws: Draws, late_s: float) -> Array:
    low, high = situation.rope_m
    if low == high:
        return np.full((len(draws.trials), draws.frames), low)
    if situation.hoisting:
        phase = draws.of("rope.phase", lambda rng: rng.random(1))
        turn = (np.arange(draws.frames) / situation.rate_hz - late_s) / CYCLE_S + phase
        share = np.abs(2 * (turn % 1.0) - 1)
    else:
        share = draws.uniform("rope")
    return np.asarray(low + (high - low) * share)


def reported_rope(situation: Situation, draws: Draws, rope: Array) -> Array:
    """Length of the rope as reported to the instrument, shape (M, n), from the true one."""
    late_s, (low, high) = situation.rope_lag_s, situation.rope_m
    if late_s and not situation.motion:
        rope = _rope(situation, draws, late_s)
    elif late_s:
        rope = np.concatenate([rope[:, :1].repeat(late := round(late_s * situation.rate_hz), 1), rope], axis=1)
        rope = rope[:, : rope.shape[1] - late]
    if situation.rope_misread:
        anything = low + (high - low) * draws.uniform("rope.misread")
        rope = np.where(draws.uniform("rope.misread.when") < situation.rope_misread, anything, rope)
    return np.maximum(rope + situation.rope_bias_m, 0.1) if situation.rope_bias_m else rope


def _physics(situation: Situation, draws: Draws) -> ReplicatedMotion:
    """Let the world move grab and camera: replication k is a part of clip k of the scene, from a random time on."""
    from simgrab.world.trajectory.clip import ClipMotion

    most = round(CYCLE_S * situation.rate_hz)
    first = (most * draws.of("motion.start", lambda rng: rng.random(1))[:, 0]).astype(int).tolist()
    frames = most + draws.frames
    scenario = scenes.load(
        situation.motion,
        {
            "seed": draws.seed,
            "frames": frames * (max(draws.trials) + 1),
            "clip.clip_frames": frames,
            "clip.frame_rate_hz": situation.rate_hz,
            "camera.beta_deg": math.degrees(situation.beta),
            "camera.tilt_azimuth_deg": math.degrees(situation.azimuth),
            "camera.roll_deg": math.degrees(situation.roll),
            "camera.mount": {"model": situation.mount},
            "display.layout": "none",
            "shutter": {"exposure_s": 0.0, "rolling_s": 0.0},
        },
    )
    rows = np.array(
        [
            [
                (m.grab.alpha, m.grab.azimuth, m.grab.rope_length, m.tilt.beta, m.tilt.azimuth, m.tilt.roll)
                for m in itertools.islice(ClipMotion(scenario, trial), begin, begin + draws.frames)
            ]
            for trial, begin in zip(draws.trials, first, strict=True)
        ]
    )
    alpha, azimuth, rope = np.moveaxis(rows[..., :3], -1, 0)
    tilt = None if situation.mount == "fixed" else np.ascontiguousarray(rows[..., 3:].swapaxes(1, 2))
    return ReplicatedMotion(alpha, azimuth, rope, tilt, np.sqrt(np.mean(alpha**2, axis=-1)))
