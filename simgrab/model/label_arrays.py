"""A frame's truth as arrays."""

from __future__ import annotations

import math

import numpy as np

from simgrab.model.geometry import Array, Distortion, Intrinsics, Pose, vertical_direction
from simgrab.model.truth import Boxed, Truth

_STEP_M = 0.05  # along the grab's x axis, to see its direction in the picture


def box(row: Truth | Boxed) -> Array | None:
    """Visible box x0, y0, x1, y1, px; None if the grab is not visible."""
    corners = (row.box_x0_px, row.box_y0_px, row.box_x1_px, row.box_y1_px)
    return None if corners[0] is None else np.array(corners, float)


def pose(values: tuple[float, ...]) -> Pose:
    """Make a pose from the 12 values of a column."""
    return Pose.from_matrix(np.reshape(values, (3, 4)))


def is_labelled(row: Truth, least_visible_fraction: float) -> bool:
    """Whether detection labels contain a box for a row: at least this fraction of the grab is visible."""
    return row.box_x0_px is not None and row.visible_fraction >= least_visible_fraction


def centre(row: Truth | Boxed) -> Array:
    """Grab centre A as the picture has it, px; NaN if the lens does not show it, or if only boxes are known."""
    if isinstance(row, Boxed):
        return np.full(2, np.nan)
    return np.array([np.nan if x is None else x for x in (row.grab_u_px, row.grab_v_px)])


def yaw(row: Truth | Boxed) -> float:
    """Direction of the grab's x axis in the picture at A, clockwise from the picture's x axis, rad, in [0, π).

    NaN where boxes alone are known.
    """
    if isinstance(row, Boxed):
        return math.nan
    camera, grab = pose(row.jib_from_camera), pose(row.jib_from_grab)
    points = grab.translation + np.array([[-_STEP_M], [_STEP_M]]) * grab.rotation[:, 0]
    ends = intrinsics(row).project(camera.local(points))
    across, down = ends[1] - ends[0]
    return float(np.arctan2(down, across) % np.pi)


def intrinsics(row: Truth) -> Intrinsics:
    """Give a frame's pinhole and its lens."""
    lens = Distortion(row.k1, row.k2, row.p1, row.p2, row.k3)
    return Intrinsics(row.width_px, row.height_px, row.fx_px, row.cx_px, row.cy_px, lens)


def vertical(row: Truth) -> Array:
    """Give G', the image of the vertical, px as the picture has it, shape (2,); NaN beyond the fold of the lens."""
    k, axis = intrinsics(row), vertical_direction(*np.radians((row.tilt_azimuth_deg, row.roll_deg)))
    return k.distort(k.from_polar(k.f_px * np.tan(np.radians(row.beta_deg)), 0.0, axis))


def half_turn(angle: float) -> float:
    """Wrap the difference of two directions, which half a turn leaves alike, into [−π/2, π/2)."""
    return (angle + math.pi / 2) % math.pi - math.pi / 2


class Labelled:
    """A frame with its truth, as arrays. Pixels are continuous; poses are in metres, in the jib frame."""

    truth: Truth

    @property
    def box(self) -> Array | None:
        """Visible box x0, y0, x1, y1, px, shape (4,), half open; None if the grab is not visible."""
        return box(self.truth)

    @property
    def amodal_box(self) -> Array | None:
        """Box of the whole silhouette, hidden parts included, px, shape (4,); None if the lens shows no part of it."""
        row = self.truth
        corners = (row.amodal_x0_px, row.amodal_y0_px, row.amodal_x1_px, row.amodal_y1_px)
        return None if corners[0] is None else np.array(corners, float)

    @property
    def keypoints(self) -> Array:
        """Points u, v, visibility, shape (10, 3), in the order of `simgrab.model.truth.KEYPOINT_NAMES`."""
        return np.reshape(self.truth.keypoints, (-1, 3))

    @property
    def intrinsics(self) -> Intrinsics:
        """The frame's pinhole and its lens."""
        return intrinsics(self.truth)

    @property
    def jib_from_camera(self) -> Array:
        """Pose of the camera, shape (4, 4)."""
        return pose(self.truth.jib_from_camera).as_matrix()

    @property
    def jib_from_grab(self) -> Array:
        """Pose of the grab, shape (4, 4)."""
        return pose(self.truth.jib_from_grab).as_matrix()
