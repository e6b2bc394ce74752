"""Named random streams.

Every draw comes from a stream keyed by (seed, index, name of the variable). A frame can therefore be made alone, in any
order and on any worker, and a new variable changes no other.
"""

from __future__ import annotations

import hashlib

import numpy as np


def stream(seed: int, index: int, name: str) -> np.random.Generator:
    """Open the stream of one variable of one frame or trial.

    Parameters
    ----------
    seed : int
        The scenario's seed, 0 or more. 0 is a seed like any other.
    index : int
        Frame or trial, 0 or more.
    name : str
        The variable, e.g. ``"swing.alpha"``.

    Returns
    -------
    numpy.random.Generator
        Philox, the counter-based generator of Salmon et al. (2011), positioned at the stream's start. The streams of
        one (seed, name) lie 2¹²⁸ draws apart.

    Examples
    --------
    >>> a, b = (stream(0, 812, "swing.alpha").random() for _ in range(2))
    >>> a == b
    True
    """
    if seed < 0 or index < 0:
        raise ValueError(f"seed and index must be 0 or more, got {seed} and {index}")
    return np.random.Generator(np.random.Philox(key=_key(seed, name, 16), counter=index << 128))


def derive(seed: int, name: str) -> int:
    """Derive the seed of a part. Its draws are independent of every other part and of ``seed`` itself.

    Parameters
    ----------
    seed : int
        Of the whole, 0 or more.
    name : str
        The part, e.g. a scene of a suite.

    Returns
    -------
    int
        Seed below 2⁵³, which JSON's numbers represent exactly.
    """
    return _key(seed, name, 8) >> 11


def _key(seed: int, name: str, size: int) -> int:
    return int.from_bytes(hashlib.blake2b(f"{seed}/{name}".encode(), digest_size=size).digest(), "little")
