"""Straight edges of a picture, by its structure tensor, and how far what they show differs over the picture."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.model.rng import stream

Floats = NDArray[np.float32]
_STRAIGHT = 0.85  # coherence of the gradients about an edge


def straight_edges(
    picture: Floats, usable: NDArray[np.bool_], *, smooth_px: float, about_px: float, least: float, most: int
) -> tuple[NDArray[np.int64], Floats]:
    """Find the steepest places of straight edges.

    Parameters
    ----------
    picture : ndarray of float32, shape (height, width)
    usable : ndarray of bool, shape (height, width)
        Where edges may lie.
    smooth_px, about_px : float
        Standard deviations of what the picture, and what the products of its gradients, are smoothed by.
    least : float
        The gradient, a pixel, above which there is an edge.
    most : int
        Of the edges, the steepest first where there are more.

    Returns
    -------
    places : ndarray of int, shape (n, 2)
        Row and column.
    directions : ndarray of float32, shape (n, 2)
        Of the gradient, of length 1: x, y.
    """
    smooth = cv2.GaussianBlur(picture, (0, 0), smooth_px)
    gx, gy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0) / 8, cv2.Sobel(smooth, cv2.CV_32F, 0, 1) / 8
    size = np.hypot(gx, gy)
    jxx, jyy, jxy = (cv2.GaussianBlur(a, (0, 0), about_px) for a in (gx * gx, gy * gy, gx * gy))
    straight = np.hypot(jxx - jyy, 2 * jxy) / np.maximum(jxx + jyy, 1e-12)
    peak = size >= cv2.dilate(size, np.ones((5, 5), np.uint8)) * 0.999
    at = np.argwhere(usable & peak & (straight > _STRAIGHT) & (size > least))
    if len(at) > most:
        at = at[np.argsort(-size[at[:, 0], at[:, 1]], kind="stable")[:most]]
    row, column = at.T
    return at, np.stack([gx[row, column], gy[row, column]], axis=1) / size[row, column, None]


def away_from(hidden: NDArray[np.bool_], reach_px: int) -> NDArray[np.bool_]:
    """Pixels farther than ``reach_px`` from the border and from hidden ones, shape (height, width)."""
    kernel = np.ones((2 * reach_px + 1, 2 * reach_px + 1), np.uint8)
    return np.asarray(cv2.erode((~hidden).astype(np.uint8), kernel, borderValue=0) > 0)


def part_of(y: int, x: int, shape: tuple[int, ...]) -> int:
    """Give the number of the part, of 8 by 8 of the picture, that a pixel lies in."""
    return 8 * (8 * y // shape[0]) + 8 * x // shape[1]


def resampled_sd(
    values: NDArray[np.float64], parts: NDArray[np.int64], statistic: Callable[[NDArray[np.float64]], float],
    name: str, draws: int,
) -> float:  # fmt: skip
    """Give the standard deviation of a statistic by the bootstrap over parts of the picture, whose edges are alike.

    Parameters
    ----------
    values : ndarray, shape (n, ...)
        Of edges.
    parts : ndarray of int, shape (n,)
        See `part_of`.
    name : str
        Of the random stream.
    """
    rng, groups = stream(0, 0, name), [values[parts == part] for part in np.unique(parts)]
    picks = (rng.integers(len(groups), size=len(groups)) for _ in range(draws))
    return float(np.std([statistic(np.concatenate([groups[i] for i in some])) for some in picks]))
