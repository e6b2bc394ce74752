"""A rival that measures balls on the rope with several cameras, after Tysse."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np

from simgrab.errors import RecordError
from simgrab.instrument.contract import Picture
from simgrab.lab.rivals.contract import Series, Swing
from simgrab.lab.rivals.side import LeanReadings, SideView, filtered
from simgrab.model.geometry import Array

HUES, LEAST_SATURATION, LEAST_VALUE = (50, 70), 140, 40  # of green balls, in OpenCV's units
LEAST_PX, LEAST_ROUND = 8, 0.55  # area of a ball, and its share of the smallest circle around it
PIXEL_SD = 0.3  # of a ball's centre
TOGETHER_S = 0.01  # pictures that differ by less are of one instant
FEWEST_VIEWS = 2
MOST_LEAN = np.radians(30.0)  # beyond, the two spots are not both balls


def balls(picture: Picture) -> Array | None:
    """Find two balls by their colour: middles of the two largest round spots, the upper first.

    Parameters
    ----------
    picture : ndarray of uint8, shape (height, width, 3)
        RGB.

    Returns
    -------
    ndarray, shape (2, 2), or None
        (0, 0) is the outer corner of the top-left pixel.
    """
    hsv = cv2.cvtColor(picture, cv2.COLOR_RGB2HSV)
    mask = cv2.inRange(hsv, (HUES[0], LEAST_SATURATION, LEAST_VALUE), (HUES[1], 255, 255))
    spots = []
    for edge in cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]:
        inside = cv2.drawContours(np.zeros_like(mask), [edge], -1, 1, -1)
        m = cv2.moments(inside, binaryImage=True)
        radius = cv2.minEnclosingCircle(edge)[1] + 0.5
        if m["m00"] >= LEAST_PX and m["m00"] > LEAST_ROUND * np.pi * radius**2:
            spots.append((m["m00"], m["m10"] / m["m00"] + 0.5, m["m01"] / m["m00"] + 0.5))
    if len(spots) < 2:
        return None
    two = np.array(sorted(spots)[-2:])[:, 1:]
    return np.asarray(two[np.argsort(two[:, 1])])


def meet(centres: Array, rays: Array, focal_px: Array) -> tuple[Array, Array]:
    """Point next to rays from several cameras, by linear least squares, and its covariance.

    Parameters
    ----------
    centres, rays : ndarray, shape (n, 3)
        Of the cameras, and directions from them.
    focal_px : ndarray, shape (n,)

    Returns
    -------
    point : ndarray, shape (3,)
    covariance : ndarray, shape (3, 3)
        For centres that are known to `PIXEL_SD`.
    """
    unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    off = np.eye(3) - unit[:, :, None] * unit[:, None, :]  # takes the part along the ray away
    weight = np.ones(len(rays))
    for _ in range(2):  # first as if all were equally far
        normal = np.einsum("n,nij->ij", weight, off)
        point = np.linalg.solve(normal, np.einsum("n,nij,nj->i", weight, off, centres))
        far = np.linalg.norm(point - centres, axis=1)
        weight = (focal_px / (PIXEL_SD * far)) ** 2
    return point, np.linalg.inv(np.einsum("n,nij->ij", weight, off))


def tysse(views: Sequence[SideView], rope: Series, time: Array) -> Swing:
    """Line through two balls on the rope, triangulated by several cameras, filtered by a pendulum.

    After Tysse et al. (2020). Known: three cameras on the crane's king, two balls on the cable, an extended Kalman
    filter of two angles and their rates, and a length by least squares. Filled in: spots of the balls' colour, the
    upper one in a picture as the upper ball, rays that meet by least squares, a linear filter of the leans' tangents,
    and the hoist encoder's length.

    Parameters
    ----------
    views : sequence of SideView
        Two or more cameras with one clock, that of ``time``.
    rope : Series
        Rope lengths, |OA|, m.
    time : ndarray, shape (n,)
        s.

    Returns
    -------
    Swing
        Without angles while fewer than two cameras see both balls for more than a second.

    Raises
    ------
    RecordError
        For fewer than two cameras.
    """
    if len(views) < FEWEST_VIEWS:
        raise RecordError(f"two or more cameras are needed, got {len(views)}")
    shots = sorted(
        ((frame.time_s, i, None if frame.picture is None else balls(frame.picture))
         for i, view in enumerate(views) for frame in view.frames if frame.time_s is not None),
        key=lambda shot: shot[:2],
    )  # fmt: skip
    stamps = np.array([shot[0] for shot in shots])
    first = np.flatnonzero(np.diff(stamps, prepend=-np.inf) > TOGETHER_S)
    rows, values = np.zeros((len(first), 2, 2)), np.full((len(first), 2), np.nan)
    for i, (begin, end) in enumerate(pairwise([*first, len(shots)])):
        seen = [(views[k], two) for _, k, two in shots[begin:end] if two is not None]
        if len(seen) >= FEWEST_VIEWS:
            rows[i], values[i] = _line(seen)
    source = "both balls were not seen"
    return filtered([LeanReadings(source, stamps[first], rows, values, 1.0)], rope, time)


def _line(seen: Sequence[tuple[SideView, Array]]) -> tuple[Array, Array]:
    """Return readings of unit variance: rows (2, 2) and values (2,), NaN where the spots are no balls on a rope."""
    centres, focal = np.array([view.centre for view, _ in seen]), np.array([view.focal_px for view, _ in seen])
    rays = np.array([view.rays(two) for view, two in seen])
    (upper, of_upper), (lower, of_lower) = (meet(centres, rays[:, k], focal) for k in range(2))
    way = lower - upper
    if -way[2] < np.linalg.norm(way) * np.cos(MOST_LEAN):
        return np.zeros((2, 2)), np.full(2, np.nan)
    tangents = way[:2] / -way[2]
    slope = np.column_stack([np.eye(2), tangents]) / -way[2]
    whiten = np.linalg.inv(np.linalg.cholesky(slope @ (of_upper + of_lower) @ slope.T))
    return whiten, whiten @ tangents
