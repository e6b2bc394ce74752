"""Noise of the sensor, by the photon transfer curve of static pixels (Janesick, Photon Transfer, 2007).

In linear light, white being 1, a pixel's variance is k·s + r²: k is what an electron counts, r the read noise. A camera
shows luma of gamma-coded colours; with g the slope of the coding and w the weights of the colours, luma's variance is
Σ w²g²(k·s + r²). Both unknowns follow from a straight line over levels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from simgrab.match.footage.footage import Footage, block_means, slope, to_linear
from simgrab.match.footage.quantity import Quantity, positive, unknown
from simgrab.match.footage.still import BLOCK_PX, StillBlocks
from simgrab.model.rng import stream

Floats = NDArray[np.float64]

BINS = 24
DARKEST, BRIGHTEST = 12.0, 235.0  # levels between which noise is not clipped
ROUNDING = 1 / 12 + 0.04  # variance, levels², that rounding to integers adds to luma
LEAST_BLOCKS, LEAST_LEVELS = 60, 20.0
_RESAMPLES = 80
_ROUNDS = 12
_TUNE = 2.5  # robust deviations at which a block begins to count less
# A coder that predicts each frame from the one before lets noise correlate in time, and takes a part of it. Measured on
# videos of known noise (docs/results/match.md): the share lost is about this of the correlation, within so much.
LOST_ALWAYS, LOST, LOST_SD, LOST_SD_PER = 0.02, 0.8, 0.06, 0.35
MOST_CORRELATION = 0.45
LEAST_STEPS = 0.5  # deviation over the coder's step, below which even more is lost
# Dark noise reaches where the coding of light bends: variance grows by about this of its relative variance.
BENT = 1.2
TILT = 0.12  # relative error of variances per 100 levels, of which rain and snow make the most
DARK_QUANTILE = 0.1
CLEAR = 7.0  # deviations that a level must be above black


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise in linear light, white being 1."""

    gain: Quantity  # k: variance of shot noise per unit of light
    read: Quantity  # r: standard deviation of the read noise
    curve: Floats | None  # (2, n), photon transfer curve of luma: mean levels, and variances over time, levels²


def noise(footage: Footage, still: StillBlocks | None, hidden: NDArray[np.bool_]) -> Noise:
    """Measure noise; ``hidden``, shape (height, width), are pixels of the display."""
    if still is None:
        return _none("there are too few frames")
    blocks = _blocks(footage, still, hidden)
    if len(blocks.level) < LEAST_BLOCKS:
        return _none("too little of the picture stands still and is neither black nor white")
    curve, correlation = _curve(blocks), blocks.correlation
    typical = float(np.sqrt(np.median(blocks.variance)))
    if typical < 0.35:
        return _none(f"its standard deviation is at most {typical:.2f} levels, as little as rounding", curve)
    if footage.quantiser is not None and typical < LEAST_STEPS * footage.quantiser:
        return _none(f"coding in steps of {footage.quantiser:.1f} levels removes most of it", curve)
    if correlation > MOST_CORRELATION:
        return _none(f"coding removes it: {correlation:.0%} of a frame's noise is that of the frame before", curve)
    if np.ptp(np.quantile(blocks.level, (0.05, 0.95))) < LEAST_LEVELS:
        return _none("what stands still has too few different levels", curve)
    kept = 1 - LOST_ALWAYS - LOST * correlation
    gain, read = (value / kept for value in _fit(blocks))
    if gain <= 0:
        return _none("its variance does not grow with the light", curve)
    rng = stream(0, 0, "match.noise")
    drawn = np.array([_fit(blocks.resampled(rng).tilted(rng)) for _ in range(_RESAMPLES)]) / kept
    relative = (LOST_SD + LOST_SD_PER * correlation) / kept
    # Where it is darkest, a share of all of the variance that is lost is taken for read noise.
    darkest = gain * float(np.quantile(blocks.shot / blocks.read, DARK_QUANTILE))
    sd = np.hypot(drawn.std(axis=0), relative * np.array([gain, read + darkest]))
    ends = np.sqrt(np.maximum(read + 1.96 * np.array([-1, 1]) * sd[1], 0))
    return Noise(positive(gain, 1.96 * sd[0]), Quantity(float(np.sqrt(read)), float(ends[0]), float(ends[1])), curve)


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Static blocks, shape (n,): levels, variances, these per unit of k and of r², and the place of each."""

    level: Floats
    variance: Floats
    next_variance: Floats
    shot: Floats
    read: Floats
    place: NDArray[np.int64]

    @property
    def correlation(self) -> float:
        """Correlation of noise in frames that follow each other."""
        return float(np.clip(1 - np.median(self.next_variance) / np.median(self.variance), 0, 1))

    def resampled(self, rng: np.random.Generator) -> _Blocks:
        """Draw places with replacement."""
        count = int(self.place.max()) + 1
        order = np.argsort(self.place, kind="stable")
        starts = np.searchsorted(self.place[order], np.arange(count + 1))
        picks = [order[starts[i] : starts[i + 1]] for i in rng.integers(count, size=count)]
        at = np.concatenate(picks)
        return self if not len(at) else self.at(at)

    def tilted(self, rng: np.random.Generator) -> _Blocks:
        """Let variances err by a share that grows or falls with the level, as coders make them."""
        across = (self.level - np.median(self.level)) / 100
        return replace(self, variance=self.variance * np.exp(rng.normal(0, TILT) * across))

    def at(self, at: NDArray[np.int64]) -> _Blocks:
        """Keep some blocks."""
        return _Blocks(*(getattr(self, field)[at] for field in self.__dataclass_fields__))


def _blocks(footage: Footage, still: StillBlocks, hidden: NDArray[np.bool_]) -> _Blocks:
    rows, columns = still.blocks.shape[1:]
    h, w = rows * BLOCK_PX, columns * BLOCK_PX

    def mean(values: NDArray[Any]) -> Floats:
        return block_means(values.astype(float), BLOCK_PX)

    level = cv2.GaussianBlur(footage.mean[:h, :w], (0, 0), 1.5)
    within = mean((level > DARKEST) & (level < BRIGHTEST) & ~hidden[:h, :w]) == 1
    linear = to_linear(cv2.GaussianBlur(footage.mean_rgb[:h, :w], (0, 0), 1.5))
    weights = np.ones((1, 1, 1)) if footage.grey else np.array(footage.weights).reshape(1, 1, 3)
    light = linear[..., :1] if footage.grey else linear
    each = (weights * slope(light)) ** 2
    standing = still.blocks.sum(axis=0)
    # What moves once may change a block's neighbours too little to show.
    calm = cv2.erode(still.blocks.mean(axis=0).astype(np.float32), np.ones((3, 3), np.uint8), borderValue=1) > 0.75
    usable = within & calm & (standing >= 4)
    times = np.maximum(standing, 1)
    variance, following = (
        (squares * still.blocks).sum(axis=0, dtype=float) / times / 2 - ROUNDING
        for squares in (still.squares, still.next_squares)
    )
    usable &= (variance > 0.02) & (mean(level) > CLEAR * np.sqrt(np.maximum(variance, 0)))
    place = (np.arange(rows) // 4)[:, None] * (columns // 4 + 1) + np.arange(columns) // 4
    fields = (mean(level), variance, following, mean((each * light).sum(axis=2)), mean(each.sum(axis=2)), place)
    return _Blocks(*(np.asarray(field)[usable] for field in fields))


def _curve(blocks: _Blocks) -> Floats:
    """Median variances by level, shape (2, n)."""
    edges = np.linspace(DARKEST, BRIGHTEST, BINS + 1)
    which = np.digitize(blocks.level, edges) - 1
    some = [which == i for i in range(BINS) if (which == i).sum() >= 4]
    return np.array([[np.median(field[at]) for at in some] for field in (blocks.level, blocks.variance)])


def _fit(blocks: _Blocks) -> tuple[float, float]:
    """Fit k and r², neither below 0, by least squares of relative errors; blocks far off count little (Tukey's)."""
    design = np.stack([blocks.shot, blocks.read], axis=1) / blocks.variance[:, None]
    # Levels count alike, however many blocks show them.
    which = np.digitize(blocks.level, np.linspace(DARKEST, BRIGHTEST, BINS + 1))
    weight = base = 1 / np.sqrt(np.bincount(which)[which])
    gain = read = 0.0
    light, bent = blocks.shot / blocks.read, np.ones(len(weight))
    for _ in range(_ROUNDS):
        (gain, read), _ = nnls(design * (bent * weight)[:, None], weight)
        bent = 1 + BENT * np.minimum((gain * light + read) / light**2, 0.15)
        ratio = 1 / np.maximum(bent * (design @ (gain, read)), 1e-9) - 1  # measured over fitted variance
        scale = max(1.4826 * float(np.median(np.abs(ratio - np.median(ratio)))), 0.02)
        weight = base * np.sqrt(np.clip(1 - (ratio / (2 * _TUNE * scale)) ** 2, 0, None))
        if not weight.any():
            break
    return float(gain), float(read)


def _none(reason: str, curve: Floats | None = None) -> Noise:
    return Noise(unknown(reason), unknown(reason), curve)
