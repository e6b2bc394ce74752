"""Which part of a picture the grab can change, by itself and by its shadow."""

from __future__ import annotations

from collections.abc import Iterator
from functools import reduce

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.model.geometry import Array

Window = tuple[int, int, int, int]  # x0, y0, x1, y1 in pixels of the picture, half open; may reach beyond it

TILE_PX = 32
MARGIN_PX = 2
CELLS = 512  # of a shadow map in each direction, to say where shadows may change
MOST_BLOCKS = 150  # beyond which merging blocks would take longer than drawing all of them
PASS_PX = 50_000.0  # another pass over the geoms costs as much as so many pixels
COPY_PX = 20_000.0  # and another copy of what was drawn before
NEARER = 12.0  # the lowest piece of a rope is so much longer than the highest
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)


def corners(low: Array, high: Array) -> Array:
    """Corners of boxes, shapes (n, 3) and (n, 3) to (n, 8, 3)."""
    return low[:, None] + _CORNERS * (high - low)[:, None]


def cut(boxes: Array, pieces: int) -> Array:
    """Cut boxes, shape (n, 8, 3) as `corners` gives them, across their third axis: shape (n·pieces, 8, 3).

    Pieces are shorter towards the end where the axis is largest: ropes come near the camera there.
    """
    bottom, top = boxes[:, 0::2], boxes[:, 1::2]
    at = 1 - (np.geomspace(1, NEARER, pieces + 1) - 1)[::-1] / (NEARER - 1)
    levels = bottom[:, None] + at[:, None, None] * (top - bottom)[:, None]
    parts = np.stack([levels[:, :-1], levels[:, 1:]], axis=3)
    return np.asarray(parts.reshape(-1, 8, 3))


def marked(boxes: Array, map_from_jib: Array) -> NDArray[np.bool_]:
    """Cells of a shadow map that boxes (n, 8, 3) may darken, shape (`CELLS`, `CELLS`).

    ``map_from_jib`` (4, 4) leads to coordinates from 0 to 1 across the map.
    """
    at = (boxes @ map_from_jib[:2, :3].T + map_from_jib[:2, 3]) * CELLS
    low, high = np.floor(at.min(axis=1)).astype(int) - 1, np.ceil(at.max(axis=1)).astype(int) + 1
    cells = np.zeros((CELLS, CELLS), bool)
    for (u0, v0), (u1, v1) in zip(low.clip(0, CELLS).tolist(), high.clip(0, CELLS).tolist(), strict=True):
        cells[v0:v1, u0:u1] = True
    return cells


def extent(cells: NDArray[np.bool_]) -> tuple[float, float, float, float]:
    """Left, bottom, right and top of the cells that are set, as shares of the map; nothing where none is."""
    across, up = np.flatnonzero(cells.any(axis=0)), np.flatnonzero(cells.any(axis=1))
    if not len(across):
        return 0.0, 0.0, 0.0, 0.0
    return float(across[0]) / CELLS, float(up[0]) / CELLS, float(across[-1] + 1) / CELLS, float(up[-1] + 1) / CELLS


def receivers(
    depth: NDArray[np.float32], map_from_camera: Array, focal_px: float, centre_px: Array
) -> NDArray[np.int32]:
    """Cell of a shadow map, as a flat index into `marked`, in which each pixel of a picture lies.

    Depth is along the optical axis, m, and ``map_from_camera`` (4, 4) leads to coordinates from 0 to 1 across the map.
    """
    height, width = depth.shape
    x = ((np.arange(width) + 0.5 - centre_px[0]) / focal_px).astype(np.float32)
    y = ((np.arange(height) + 0.5 - centre_px[1]) / focal_px).astype(np.float32)
    found = []
    for row in map_from_camera[:2].astype(np.float32):
        per_depth = row[0] * x + (row[1] * y + row[2])[:, None]
        found.append(((per_depth * depth + row[3]) * CELLS).clip(0, CELLS - 1).astype(np.int32))
    return np.asarray(found[1] * CELLS + found[0])


def tiles_of(pixels: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tiles of a picture in which, or within a pixel of which, any pixel is set, shape (rows, columns)."""
    near = np.asarray(cv2.dilate(pixels.view(np.uint8), np.ones((3, 3), np.uint8)))
    height, width = near.shape
    rows = np.pad(near, ((0, -height % TILE_PX), (0, -width % TILE_PX))).reshape(-1, TILE_PX, width + -width % TILE_PX)
    across = np.bitwise_or.reduce(rows, axis=1)
    return np.asarray(reduce(np.bitwise_or, (across[:, i::TILE_PX] for i in range(TILE_PX))), bool)


def rectangles(points: Array, focal_px: float, centre_px: Array, near_m: float) -> Array:
    """Bounding rectangles x0, y0, x1, y1, px, (n, 4), of what hulls of points (n, k, 3), camera frame, m, show.

    They are of the undistorted picture, and empty (x0 > x1) where a hull shows nothing: it does not where it is nearer
    than the near plane.
    """
    if not len(points):
        return np.zeros((0, 4))
    near = near_m * (1 - 1e-3)
    result = np.empty((len(points), 4))
    depth = points[..., 2]
    ahead = (depth >= near).all(axis=1)
    result[ahead] = _bounds(points[ahead], focal_px, centre_px)
    for i in np.flatnonzero(~ahead):
        result[i] = _clipped(points[i], near, focal_px, centre_px)
    return result + (-MARGIN_PX, -MARGIN_PX, MARGIN_PX, MARGIN_PX)


def _bounds(points: Array, focal_px: float, centre_px: Array) -> Array:
    pixels = focal_px * points[..., :2] / points[..., 2:] + centre_px
    return np.concatenate([pixels.min(axis=-2), pixels.max(axis=-2)], axis=-1)


def _clipped(points: Array, near: float, focal_px: float, centre_px: Array) -> Array:
    """Bounding rectangle of a hull that the near plane cuts: of the points before it, and of all edges' cuts."""
    front, back = points[points[:, 2] >= near], points[points[:, 2] < near]
    if not len(front):
        return np.array([np.inf, np.inf, -np.inf, -np.inf])
    share = (front[:, None, 2] - near) / (front[:, None, 2] - back[None, :, 2])
    cuts = front[:, None] + share[..., None] * (back[None] - front[:, None])
    cuts[..., 2] = near
    return _bounds(np.concatenate([front, cuts.reshape(-1, 3)]), focal_px, centre_px)


def tiles(rects: Array, width_px: int, height_px: int) -> NDArray[np.bool_]:
    """Tiles of a picture that rectangles meet, shape (rows, columns)."""
    grid = np.zeros((-(-height_px // TILE_PX), -(-width_px // TILE_PX)), bool)
    rows, columns = grid.shape
    limit = np.array([columns, rows, columns, rows]) * TILE_PX
    for x0, y0, x1, y1 in np.clip(rects, 0, limit).tolist():
        if x0 < x1 and y0 < y1:
            low, high = int(y0) // TILE_PX, -(-int(np.ceil(y1)) // TILE_PX)
            grid[low:high, int(x0) // TILE_PX : -(-int(np.ceil(x1)) // TILE_PX)] = True
    return grid


def windows(grid: NDArray[np.bool_], width_px: int, height_px: int, apart_px: float) -> list[Window]:
    """Cover the tiles of a grid by a few windows of the picture, which may overlap.

    Two windows become one where that adds fewer than ``apart_px`` pixels.
    """
    found = np.array(list(_blocks(grid)), float).reshape(-1, 4)
    if len(found) > MOST_BLOCKS:
        found = np.array([[*found[:, :2].min(axis=0), *found[:, 2:].max(axis=0)]])
    more, kept = _joint(found, found), np.ones(len(found), bool)
    np.fill_diagonal(more, np.inf)
    while kept.sum() > 1:
        i, j = np.unravel_index(int(more.argmin()), more.shape)
        if more[i, j] > apart_px / TILE_PX**2:
            break
        found[i] = *np.minimum(found[i, :2], found[j, :2]), *np.maximum(found[i, 2:], found[j, 2:])
        kept[j], more[j], more[:, j] = False, np.inf, np.inf
        more[i] = more[:, i] = np.where(kept, _joint(found[i : i + 1], found)[0], np.inf)
        more[i, i] = np.inf
    limit = (width_px, height_px, width_px, height_px)
    return [tuple(edges) for edges in np.minimum(found[kept] * TILE_PX, limit).astype(int).tolist()]


def _joint(some: Array, others: Array) -> Array:
    """Tiles that windows of shapes (n, 4) and (m, 4) cover together beyond those that each does: shape (n, m)."""
    low = np.minimum(some[:, None, :2], others[None, :, :2])
    high = np.maximum(some[:, None, 2:], others[None, :, 2:])
    areas, more = ((v[:, 2:] - v[:, :2]).prod(axis=1) for v in (some, others))
    return np.asarray((high - low).prod(axis=2) - areas[:, None] - more[None])


def _blocks(grid: NDArray[np.bool_]) -> Iterator[tuple[int, int, int, int]]:
    """Cover the tiles of a grid by rectangles of tiles that do not overlap."""
    begun: dict[tuple[int, int], int] = {}
    rows, at = np.nonzero(np.diff(np.pad(grid, ((0, 1), (1, 1))), axis=1))  # the last row is empty: all runs end there
    edges = np.split(at, np.searchsorted(rows, np.arange(1, len(grid) + 1)))
    for number, ends in enumerate(map(np.ndarray.tolist, edges)):
        runs = set(zip(ends[0::2], ends[1::2], strict=True))
        for run in sorted(begun.keys() - runs):
            yield run[0], begun.pop(run), run[1], number
        begun |= dict.fromkeys(runs - begun.keys(), number)
