"""A rival that measures the lines of the ropes with cameras at the side, after Okubanjo."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from simgrab.errors import RecordError
from simgrab.instrument.contract import Picture
from simgrab.lab.rivals.contract import Series, Swing
from simgrab.lab.rivals.side import LeanReadings, SideView, filtered
from simgrab.model.geometry import Array

EDGES = (60, 180)  # thresholds of Canny's detector
VOTES, LEAST_SHARE, MOST_GAP_PX = 60, 0.25, 25  # of a line: votes, length over the picture's height, gap within
BAND_PX = 2.5  # edges so near a line are its own
FROM_EXIT_M = 0.8  # greatest distance of a rope from the rope exit O, across the view
MOST_LEAN = np.radians(25.0)
LIKE = np.radians(0.5)  # lines that lean so much as the median are averaged
LEAN_SD = np.radians(0.15)  # of one picture
PLANE_SD = np.radians(0.1)  # of the assumption that nothing swings along a single camera's axis


def rope_lines(picture: Picture) -> Array:
    """Find long lines: Canny's edges, a Hough transform, and a fit through the edges beside each.

    Parameters
    ----------
    picture : ndarray of uint8, shape (height, width, 3)
        RGB.

    Returns
    -------
    ndarray, shape (n, 4)
        Ends x0, y0, x1, y1 of each, px; (0, 0) is the outer corner of the top-left pixel.
    """
    edges = cv2.Canny(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), *EDGES)
    least = LEAST_SHARE * len(picture)
    found = cv2.HoughLinesP(edges, 1, np.pi / 720, VOTES, minLineLength=least, maxLineGap=MOST_GAP_PX)
    points = np.argwhere(edges)[:, ::-1].astype(np.float32)
    lines = np.empty((0 if found is None else len(found), 4))
    for i, (x0, y0, x1, y1) in enumerate([] if found is None else found.reshape(-1, 4).astype(float)):
        length = np.hypot(x1 - x0, y1 - y0)
        along = np.array([x1 - x0, y1 - y0]) / length
        place = points - (x0, y0)
        beside, at = np.abs(place @ (-along[1], along[0])), place @ along
        own = points[(beside < BAND_PX) & (at >= 0) & (at <= length)]
        vx, vy, x, y = cv2.fitLine(own, cv2.DIST_HUBER, 0, 0.01, 0.01).ravel()
        lines[i] = (x - vx * length / 2, y - vy * length / 2, x + vx * length / 2, y + vy * length / 2)
    return lines + 0.5  # OpenCV counts from pixel centres


def rope_plane(lines: Array, view: SideView) -> Array | None:
    """Plane of the ropes through the camera's centre: n with n_x t_x + n_y t_y = n_z for the tangents t of their lean.

    Parameters
    ----------
    lines : ndarray, shape (n, 4)
        As `rope_lines` returns them; those that do not pass the rope exit, or lean too much, are left out.

    Returns
    -------
    ndarray, shape (3,), or None
        With a unit horizontal part; None without ropes.
    """
    if not len(lines):
        return None
    normals = np.cross(view.rays(lines[:, :2]), view.rays(lines[:, 2:]))
    level = np.linalg.norm(normals[:, :2], axis=1)
    across = _axes(view)[0]
    normals = normals * (np.sign(normals[:, :2] @ across) / np.maximum(level, 1e-12))[:, None]
    far = normals @ view.centre / np.maximum(np.linalg.norm(normals, axis=1), 1e-12)
    lean = np.arctan(normals[:, 2])
    ropes = (level > 1e-9) & (np.abs(far) < FROM_EXIT_M) & (np.abs(lean) < MOST_LEAN)
    if not ropes.any():
        return None
    normals, lean = normals[ropes], lean[ropes]
    return np.asarray(normals[np.abs(lean - np.median(lean)) <= LIKE].mean(axis=0)) if len(lean) > 2 else normals[0]


def _axes(view: SideView) -> tuple[Array, Array]:
    """Horizontal directions (2,) across and along the optical axis; a camera that looks straight down has none."""
    ahead = view.rotation[:2, 2]
    norm = float(np.linalg.norm(ahead))
    if norm < 0.5:
        raise RecordError(f"{view.name}: a camera at the side is needed, and this one looks steeply down or up")
    along = ahead / norm
    return np.array([along[1], -along[0]]), along


def okubanjo(views: Sequence[SideView], rope: Series, time: Array) -> Swing:
    """Lean of the ropes' lines in the pictures of cameras at the side, filtered by a pendulum.

    After Okubanjo et al. (2018). Known: a web camera at the side, rope and load in its pictures, a Kalman filter.
    Filled in: Canny's edges and a Hough transform, lines that pass the rope exit, the median over ropes, and the Kalman
    filter [θ, θ̇] along x and y. The line's angle to the vertical of the picture holds for a level camera alone; the
    plane through line and camera centre takes its place. A single camera measures one plane: nothing is taken to swing
    along its axis. Two give the whole swing.

    Parameters
    ----------
    views : sequence of SideView
        One or more cameras, whose clock is that of ``time``.
    rope : Series
        Rope lengths, |OA|, m.
    time : ndarray, shape (n,)
        s.

    Returns
    -------
    Swing
        Without angles while a camera sees no ropes for more than a second.

    Raises
    ------
    RecordError
        Without cameras, or for one that looks steeply down or up.
    """
    if not views:
        raise RecordError("a camera at the side is needed")
    readings = [_read(view) for view in views]
    if len(views) == 1:
        at, along = readings[0], _axes(views[0])[1]
        n = len(at.time)
        readings.append(
            LeanReadings(at.source, at.time, np.tile(along, (n, 1, 1)), np.where(np.isfinite(at.values), 0.0, np.nan),
                     PLANE_SD)
        )  # fmt: skip
    return filtered(readings, rope, time)


def _read(view: SideView) -> LeanReadings:
    _axes(view)
    time, planes = [], []
    for frame in view.frames:
        if frame.time_s is not None:
            time.append(frame.time_s)
            plane = None if frame.picture is None else rope_plane(rope_lines(frame.picture), view)
            planes.append(np.full(3, np.nan) if plane is None else plane)
    found = np.reshape(planes, (-1, 3))
    return LeanReadings(
        f"{view.name}: ropes were not seen", np.array(time), np.nan_to_num(found[:, None, :2]), found[:, 2:], LEAN_SD
    )
