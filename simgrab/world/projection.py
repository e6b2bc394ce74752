"""Project a moment's grab into the picture, from pose and camera, before anything is rendered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from simgrab.errors import ScenarioError
from simgrab.model.geometry import Array, Pose
from simgrab.model.scenario import Scenario
from simgrab.model.truth import KEYPOINT_NAMES
from simgrab.world.camera import shutter
from simgrab.world.camera.lens import Window
from simgrab.world.scenery.grabs.design import Design
from simgrab.world.scenery.plan import Plan
from simgrab.world.trajectory.moment import GrabState, Moment

NEAREST_DEPTH_M = 0.2


@dataclass(frozen=True, eq=False)
class Projection:
    """One frame's moment, and the grab's position in the picture."""

    nominal: Moment  # moment from the trajectory: the middle row's mid-exposure
    moment: Moment  # instant of the labels: the exposure of the row that shows the grab centre
    centre_camera: Array  # (3,), grab centre A, camera frame, m
    # (4,), tight box x0, y0, x1, y1 around the whole silhouette, px; None if the lens shows no part of it, or the
    # grab is absent
    amodal_box: Array | None
    # (4, 2), corners of the smallest rotated rectangle around the whole silhouette, px; None whenever the amodal box
    # is
    oriented_box: Array | None
    keypoints_camera: Array  # (10, 3), in the order of `simgrab.model.truth.KEYPOINT_NAMES`, camera frame, m

    @property
    def window(self) -> Window:
        """Window of whole pixels around the amodal box, with a margin of one pixel; empty without a box."""
        if self.amodal_box is None:
            return 0, 0, 0, 0
        x0, y0, x1, y1 = self.amodal_box
        return int(np.floor(x0)) - 1, int(np.floor(y0)) - 1, int(np.ceil(x1)) + 1, int(np.ceil(y1)) + 1

    def meets(self, width_px: int, height_px: int) -> bool:
        """Whether the window and the picture share a pixel."""
        x0, y0, x1, y1 = self.window
        return max(x0, 0) < min(x1, width_px) and max(y0, 0) < min(y1, height_px)


def project(scenario: Scenario, plan: Plan, nominal: Moment) -> Projection:
    """Project a frame's moment.

    Raises `ScenarioError` if the state is impossible. The message names frame and key.
    """
    moment = shutter.exposed(scenario, nominal)
    frame, state = moment.frame, moment.grab
    pose = state.jib_from_grab
    points = pose.apply(plan.grab_points(state))
    plan.check_clearance(moment, points)
    camera = scenario.camera
    jib_from_camera = Pose(moment.tilt.jib_from_camera, np.asarray(camera.offset_m))
    outline = jib_from_camera.local(points)
    if outline[:, 2].min() < NEAREST_DEPTH_M:
        raise ScenarioError(
            "swing", f"frame {frame}: the grab reaches the camera or passes behind it "
            f"(alpha {np.degrees(state.alpha):.1f}°, rope {state.rope_length:.2f} m)",
        )  # fmt: skip
    amodal, oriented = None, None
    if moment.present:
        pixels = camera.intrinsics.project(outline)
        pixels = pixels[np.isfinite(pixels).all(axis=1)]
        if len(pixels):
            amodal = np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])
            oriented = cv2.boxPoints(cv2.minAreaRect(pixels.astype(np.float32)))
    centre, keypoints = (jib_from_camera.local(each) for each in (pose.translation, _keypoints(plan.grab, state)))
    return Projection(nominal, moment, centre, amodal, oriented, keypoints)


def _keypoints(grab: Design, state: GrabState) -> Array:
    """Keypoints in the jib frame, shape (10, 3), in the order of `KEYPOINT_NAMES`; NaN if missing."""
    frames = grab.frames(state.jaw)
    lips = [frames[body][:3, :3] @ p + frames[body][:3, 3] for body, points in grab.lips.items() for p in points]
    in_grab = np.concatenate([np.zeros((1, 3)), _four(grab.terminations), _four(lips)])
    points = np.insert(state.jib_from_grab.apply(in_grab), 1, 0.0, axis=0)  # the rope exit is O
    assert len(points) == len(KEYPOINT_NAMES)
    return points


def _four(points: Sequence[Array] | Array) -> Array:
    """Fill up to four points, shape (4, 3), with NaN."""
    found = np.full((4, 3), np.nan)
    found[: len(points)] = np.reshape(np.asarray(points), (-1, 3))
    return found
