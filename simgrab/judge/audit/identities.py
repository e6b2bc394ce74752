"""Check that the numbers of a label row agree, with other formulas and libraries than those that made them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from simgrab.judge.audit.proof import Findings, Proof
from simgrab.model.geometry import Array
from simgrab.model.scenario import DoublePendulum, FourRopes, OneBody, Suspension
from simgrab.model.truth import Truth

IDENTITY_TOLERANCE = 1e-9
PIXEL_TOLERANCE = 1e-6


def paper_identities(rows: Sequence[Truth]) -> Proof:
    """Check eqs (1) and (2) of the paper for every row.

    The equations use the swing as seen from the camera. Without an offset this is α and γ; with an offset it is the
    direction from the camera to A, computed from the stored poses.
    """
    found, worst = Findings(), 0.0
    for row in rows:
        camera, grab = _pose(row.jib_from_camera), _pose(row.jib_from_grab)
        if row.m_px is None or row.theta_deg is None:
            continue
        ray = grab[:, 3] - camera[:, 3]
        if any((row.offset_x_m, row.offset_y_m, row.offset_z_m)):
            alpha = np.arctan2(np.hypot(ray[0], ray[1]), -ray[2])
            gamma = np.arctan2(ray[1], ray[0]) - np.radians(row.tilt_azimuth_deg)
        else:
            alpha, gamma = np.radians((row.alpha_deg, row.gamma_deg))
        beta, theta, m, h = np.radians(row.beta_deg), np.radians(row.theta_deg), row.m_px, row.fx_px
        axis = np.cos(alpha) * np.cos(beta) + np.sin(alpha) * np.sin(beta) * np.cos(gamma)
        first = (m**2 + h**2) * axis**2 / h**2 - 1
        second = np.cos(alpha) - (m * np.sin(beta) * np.cos(theta) + h * np.cos(beta)) / np.sqrt(m**2 + h**2)
        worst = max(worst, abs(first), abs(second))
        found.expect(abs(first) <= IDENTITY_TOLERANCE, f"frame {row.frame}, m_px", f"eq. (1) is off by {first:.3g}")
        found.expect(
            abs(second) <= IDENTITY_TOLERANCE, f"frame {row.frame}, theta_deg", f"eq. (2) is off by {second:.3g}"
        )
    return found.proof("eqs (1) and (2) of the paper hold, seen from the camera", f"worst residual {worst:.1e}")


def poses(rows: Sequence[Truth], hanging: Callable[[Truth], tuple[Suspension, float]]) -> Proof:
    """Check stored poses against stored angles, lengths and offsets, by SciPy's rotations.

    ``hanging`` returns how a row's grab hangs, and the height of its rope ends in the grab's frame, m.
    """
    found, worst = Findings(), 0.0
    for row in rows:
        tilt, azimuth = row.beta_deg, row.tilt_azimuth_deg
        down = Rotation.from_matrix([[0, -1, 0], [-1, 0, 0], [0, 0, -1]])
        camera = Rotation.from_euler("ZYZ", [azimuth, -tilt, -azimuth], degrees=True) * down
        camera = camera * Rotation.from_euler("z", row.roll_deg, degrees=True)
        swing = row.gamma_deg + azimuth
        rope = Rotation.from_euler("ZYZ", [swing, -row.alpha_deg, -swing + row.yaw_deg], degrees=True)
        grab = _grab_attitude(row, rope, *hanging(row))
        expected = {
            "jib_from_camera": np.column_stack([camera.as_matrix(), (row.offset_x_m, row.offset_y_m, row.offset_z_m)]),
            "jib_from_grab": np.column_stack([grab.as_matrix(), rope.apply([0, 0, -row.rope_length_m])]),
        }
        for column, pose in expected.items():
            error = float(np.abs(_pose(getattr(row, column)) - pose).max())
            worst = max(worst, error)
            found.expect(error <= IDENTITY_TOLERANCE, f"frame {row.frame}, {column}", f"off by {error:.3g}")
    return found.proof("poses agree with angles, rope length and offset", f"worst {worst:.1e}")


def _grab_attitude(row: Truth, along: Rotation, suspension: Suspension, end_height: float) -> Rotation:
    """Attitude of a grab: ``along`` OA, as the ropes hold it, or about a stored free axis."""
    stored = _pose(row.jib_from_grab)
    match suspension:
        case OneBody():
            return along
        case FourRopes():  # its axis follows the middle of the rope ends
            leaning, ratio = stored[:, 3] + end_height * stored[:, 2], suspension.tilt_ratio
        case DoublePendulum():
            leaning, ratio = -stored[:, 2], 1.0
    lean, azimuth = np.arctan2(np.hypot(*leaning[:2]), -leaning[2]), np.arctan2(leaning[1], leaning[0])
    return Rotation.from_euler("ZYZ", [azimuth, -ratio * lean, -azimuth + np.radians(row.yaw_deg)])


def projections(rows: Sequence[Truth]) -> Proof:
    """Check stored pixels against OpenCV's projection of the stored grab pose through the stored camera."""
    found, worst = Findings(), 0.0
    for row in rows:
        camera, grab = _pose(row.jib_from_camera), _pose(row.jib_from_grab)
        point = camera[:, :3].T @ (grab[:, 3] - camera[:, 3])
        K = np.array([[row.fx_px, 0, row.cx_px], [0, row.fy_px, row.cy_px], [0, 0, 1]])
        for columns, lens in (
            (("grab_u_px", "grab_v_px"), (row.k1, row.k2, row.p1, row.p2, row.k3)),
            (("ideal_u_px", "ideal_v_px"), (0.0,) * 5),
        ):
            pixel = cv2.projectPoints(point[None], np.zeros(3), np.zeros(3), K, np.array(lens))[0].ravel()
            for column, value in zip(columns, pixel, strict=True):
                stored = getattr(row, column)
                if stored is None:  # the lens shows no such ray
                    continue
                worst = max(worst, abs(stored - value))
                found.expect(
                    abs(stored - value) <= PIXEL_TOLERANCE, f"frame {row.frame}, {column}",
                    f"{stored:.9g} px, but the stored pose projects to {value:.9g} px",
                )  # fmt: skip
    return found.proof("the grab centre lies where an independent projection puts it", f"worst {worst:.1e} px")


def _pose(values: Sequence[float]) -> Array:
    return np.reshape(np.asarray(values, float), (3, 4))
