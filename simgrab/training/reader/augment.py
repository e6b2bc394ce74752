"""What may happen to a digit between the display and the reader."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from simgrab.instrument.read.crops import Crops, Picture, entered
from simgrab.model.geometry import Array
from simgrab.training.reader.cells import SPARE_PX

JPEG_BLOCK_PX = 8
TORN = 0.3, 0.7  # of a box's height: torn there it is neither digit
# Of what is seen, over what the cell shows: cells that are drawn by hand are too large more often than too small.
SCALES = 0.9, 1.25
TIGHT, TIGHT_SCALES = 0.5, (0.96, 1.04)  # share of cells that fit their digits, and of these
# Share of cells in which the digit is small, as a wide font's is in a tall cell, and by how much what the cell shows
# shrinks in width and height.
SMALL, SMALL_SCALES = 0.25, ((1.0, 1.4), (1.0, 1.8))
GHOST = 0.05, 0.45  # share of an earlier digit that remains


def altered(box: Picture, rng: np.random.Generator) -> Crops:
    """Shift, scale, light, blur, disturb and compress a box out of a picture, and shape it for the net.

    Parameters
    ----------
    box : ndarray of uint8, shape (h, w)
        Grey, with `SPARE_PX` around what the reader would see.

    Returns
    -------
    ndarray of float32, shape (32, 32)
    """
    seen = _small(box, rng) if rng.random() < SMALL else _moved(box, rng)
    if rng.random() < 0.2:
        seen = _coarser(seen, rng)
    if rng.random() < 0.3:
        seen = np.asarray(cv2.GaussianBlur(seen, None, rng.uniform(0.3, 0.02 * len(seen) + 0.3)))
    seen = _lit(seen, rng)
    if rng.random() < 0.7:
        seen = _compressed(seen, int(rng.integers(8, 96)), rng)
    return entered(seen)


def plain(box: Picture) -> Crops:
    """Shape a box as the reader sees it."""
    return entered(np.ascontiguousarray(box[SPARE_PX:-SPARE_PX, SPARE_PX:-SPARE_PX]))


def torn(above: Picture, below: Picture, rng: np.random.Generator) -> Picture:
    """One box above a row and another, of the same size, from there on."""
    row = round(rng.uniform(*TORN) * len(above))
    return np.concatenate([above[:row], below[row:]])


def ghostly(box: Picture, earlier: Picture, rng: np.random.Generator) -> Picture:
    """Mix some of an earlier box of the same size into a box, as coders of a low bit rate leave it there."""
    share = rng.uniform(*GHOST)
    return np.asarray(cv2.addWeighted(box, 1 - share, earlier, share, 0))


def _small(box: Picture, rng: np.random.Generator) -> Picture:
    """Shrink what the cell shows, anywhere within it, and continue its border around."""
    seen = box[SPARE_PX:-SPARE_PX, SPARE_PX:-SPARE_PX]
    scale = np.array([rng.uniform(*limits) for limits in SMALL_SCALES])
    size = np.array(seen.shape[::-1])
    middle = (size - 1) / 2
    offset = middle - scale * middle + rng.uniform(-0.4, 0.4, 2) * (scale - 1) * size
    return _warped(seen, scale, offset, seen.shape[::-1])


def _moved(box: Picture, rng: np.random.Generator) -> Picture:
    """Shift by a pixel or so, in loose cells by more, and scale."""
    height, width = box.shape[0] - 2 * SPARE_PX, box.shape[1] - 2 * SPARE_PX
    shift = rng.normal(0, 0.6, 2).clip(-1.6, 1.6)
    if rng.random() < TIGHT:
        scale = rng.uniform(*TIGHT_SCALES, 2)
    else:
        scale = rng.uniform(*SCALES, 2)
        shift += rng.uniform(-0.5, 0.5, 2) * np.maximum(scale - 1, 0) * (width, height)
    middle = np.array([box.shape[1] - 1, box.shape[0] - 1]) / 2
    target = np.array([width - 1, height - 1]) / 2
    offset = middle + shift - scale * target
    if rng.random() < 0.3:  # as it lies on its pixels
        scale, offset = np.ones(2), SPARE_PX + shift.round()
    return _warped(box, scale, offset, (width, height))


def _warped(box: Picture, scale: Array, offset: Array, size: Sequence[int]) -> Picture:
    """Return a picture of a size, (w, h), that shows at each place what is at ``scale * place + offset`` of a box."""
    m, flags = np.column_stack([np.diag(scale), offset]), cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(box, m, size, flags=flags, borderMode=cv2.BORDER_REPLICATE))


def _coarser(box: Picture, rng: np.random.Generator) -> Picture:
    """As a stream of less resolution, enlarged again."""
    share = rng.uniform(max(0.5, 10 / min(box.shape)), 1.0) if min(box.shape) > 10 else 1.0
    small = cv2.resize(box, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.resize(small, box.shape[::-1], interpolation=cv2.INTER_LINEAR))


def _lit(box: Picture, rng: np.random.Generator) -> Picture:
    """Change brightness, contrast and gamma, and add noise."""
    level = (box / np.float32(255)) ** rng.uniform(0.7, 1.4)
    level = level * rng.uniform(0.55, 1.15) + rng.uniform(-0.12, 0.15)
    level += rng.normal(0, rng.uniform(0, 0.05), box.shape)
    return np.asarray((255 * level.clip(0, 1)).round(), np.uint8)


def _compressed(box: Picture, quality: int, rng: np.random.Generator) -> Picture:
    """Code as JPEG, on blocks that lie anyhow over the box."""
    x, y = rng.integers(0, JPEG_BLOCK_PX, 2)
    padded = cv2.copyMakeBorder(box, int(y), JPEG_BLOCK_PX, int(x), JPEG_BLOCK_PX, cv2.BORDER_REPLICATE)
    _, data = cv2.imencode(".jpg", padded, [cv2.IMWRITE_JPEG_QUALITY, quality])
    coded = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    return np.asarray(coded)[y : y + box.shape[0], x : x + box.shape[1]]
