"""Which parts of footage stand still, by the differences of frames that follow each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgrab.match.footage.footage import LEAST_FRAMES, Footage, block_means

BLOCK_PX = 16
LAG = 8  # frames between which differences are taken: a coder copies a part of the noise from one to the next
_SIGMAS = 4.0
_BURST = 1.5  # of its usual variance, by which a block is taken to move
_SLACK = 0.15  # levels, by which a block's mean may change besides

Blocks = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class StillBlocks:
    """What stands still.

    Attributes
    ----------
    blocks : ndarray of bool, shape (pairs, rows, columns)
        Blocks of `BLOCK_PX` that stand still between two frames.
    squares : ndarray of float32, shape (pairs, rows, columns)
        Mean squares of each block's differences about their mean, levels².
    next_squares : ndarray of float32, shape (pairs, rows, columns)
        The same of the first frame of each pair and the one after it.
    """

    blocks: NDArray[np.bool_]
    squares: NDArray[np.float32]
    next_squares: NDArray[np.float32]

    def pixels(self, height: int, width: int) -> NDArray[np.bool_]:
        """Pixels of blocks that stand still nearly all the time, shape (height, width)."""
        whole = np.zeros((height, width), bool)
        fine = (self.blocks.mean(axis=0) > 0.9).repeat(BLOCK_PX, axis=0).repeat(BLOCK_PX, axis=1)
        whole[: fine.shape[0], : fine.shape[1]] = fine
        return whole


def still(footage: Footage) -> StillBlocks | None:
    """Find what stands still; None where there are too few frames."""
    rows, columns = (side // BLOCK_PX for side in footage.luma.shape[1:])
    if footage.frames < LEAST_FRAMES or not rows or not columns:
        return None
    luma = footage.luma[:, : rows * BLOCK_PX, : columns * BLOCK_PX]
    lag = min(LAG, footage.frames // 2)
    means, squares, following = list[Blocks](), list[Blocks](), list[Blocks]()
    for i in range(footage.frames - lag):
        first = luma[i].astype(np.float32)
        mean, square = _moments(luma[i + lag] - first)
        means.append(mean)
        squares.append(square)
        following.append(_moments(luma[i + 1] - first)[1])
    change, all_squares = np.stack(means), np.stack(squares)
    usual = np.median(all_squares, axis=0)
    stands = np.abs(change) <= _SIGMAS * np.sqrt(usual) / BLOCK_PX + _SLACK
    stands &= all_squares <= _BURST * usual + _SLACK
    return StillBlocks(stands, all_squares, np.stack(following))


def _moments(values: Blocks) -> tuple[Blocks, Blocks]:
    """Mean and mean square about it of each block."""
    mean = block_means(values, BLOCK_PX)
    return mean, block_means(values**2, BLOCK_PX) - mean**2
