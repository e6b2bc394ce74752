"""The sensor: shot noise, read noise and fixed pattern, in electrons.

At a level s of the picture (1 = white) a pixel holds N = s·F/a electrons, F being the full well at 0 dB and a the
amplification. Light brings a variance of N, reading one of r²; so the picture's variance is (a/F)·s + (a·r/F)², the
straight line of a photon transfer curve (Janesick, Photon Transfer, 2007). Shot noise is taken as normal, which holds
from some 20 electrons on; below, read noise hides it.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.random import Generator
from scipy.special import ndtri

from simgrab.model.rng import stream
from simgrab.model.scenario import Sensor
from simgrab.world.camera.optics.light import Light

# Normal quantiles of 65,536 equal shares: variance 1 − 2e-5, fourth moment 2.999, none beyond 4.32.
_QUANTILES = ndtri((np.arange(65536) + 0.5) / 65536).astype(np.float32)


def normals(shape: tuple[int, ...], rng: Generator) -> Light:
    """Independent standard normal numbers: 16 random bits pick a quantile, seven times as fast as NumPy's sampler."""
    count = int(np.prod(shape))
    # Unlike `random_raw`, `integers` lets other threads run.
    words = rng.integers(0, 2**64 - 1, -(-count // 4), np.uint64, endpoint=True)
    bits = words.astype("<u8", copy=False).view("<u2")[:count]
    return np.asarray(cv2.LUT(bits.reshape(shape[0], -1), _QUANTILES)).reshape(shape)


@lru_cache(maxsize=2)
def pattern(shape: tuple[int, ...], seed: int) -> Light:
    """How the pixels of a seed's camera differ in response: standard normal numbers, the same for every frame."""
    result = normals(shape, stream(seed, 0, "optics.fixed_pattern"))
    result.setflags(write=False)
    return result


def noisy(level: Light, sensor: Sensor, gain: float, rng: Generator) -> Light:
    """Add shot and read noise, which may bring the level below 0.

    Parameters
    ----------
    level : ndarray of float32, shape (height, width) or (height, width, 3)
        The picture without noise, gain included.
    sensor : Sensor
    gain : float
        Of the exposure. Above 1 it amplifies noise; below, the iris lets less light in and the noise is as at 1.
    rng : Generator
    """
    if sensor.full_well_e == 0:
        return level
    per_electron = max(gain, 1.0) / sensor.full_well_e
    noise = normals(level.shape, rng)
    deviation = cv2.addWeighted(level, per_electron, level, 0, (per_electron * sensor.read_noise_e) ** 2)
    cv2.sqrt(deviation, dst=deviation)
    cv2.multiply(noise, deviation, dst=noise)
    return np.asarray(cv2.add(level, noise, dst=noise))
