"""Labels: what is known of a frame, computed from pose and camera; the rendered ids only say what is seen of it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab import geometry
from simgrab.errors import ScenarioError
from simgrab.geometry import Array
from simgrab.labels.truth import KEYPOINT_NAMES, Truth
from simgrab.scenario import Scenario, Variant
from simgrab.world.camera.lens import Window
from simgrab.world.camera.renderer import Renderer, View
from simgrab.world.camera.weather import hidden_fraction
from simgrab.world.scenery.meshes import grab
from simgrab.world.scenery.model import GRAB, ROPE
from simgrab.world.scenery.plan import Plan
from simgrab.world.trajectory.moment import GrabState, Moment

NEAREST_DEPTH_M = 0.2
KEYPOINT_TOLERANCE_M = 0.12  # a keypoint on a surface is seen if nothing lies this much nearer,
ROPE_TOLERANCE_M = 1.0  # but for a rope over a termination: the one that ends there, seen nearly end on


@dataclass(frozen=True, eq=False)
class Aim:
    """What is known of a frame before it is drawn.

    Attributes
    ----------
    moment : Moment
    centre_camera : ndarray, shape (3,)
        Grab centre A, camera frame, m.
    outline_px : ndarray, shape (N, 2)
        Pixels, as the picture has them, of points that cover the grab; those that the lens shows, maybe none, and none
        of a grab that is absent.
    keypoints_camera : ndarray, shape (10, 3)
        In the order of `simgrab.labels.truth.KEYPOINT_NAMES`, camera frame, m.
    """

    moment: Moment
    centre_camera: Array
    outline_px: Array
    keypoints_camera: Array

    @property
    def amodal_box(self) -> Array | None:
        """Tight box x0, y0, x1, y1 around the whole silhouette, px; None where the lens shows nothing of it."""
        if not len(self.outline_px):
            return None
        return np.concatenate([self.outline_px.min(axis=0), self.outline_px.max(axis=0)])

    @property
    def window(self) -> Window:
        """Whole pixels that hold the amodal box, with a pixel of margin; empty where there is none."""
        if self.amodal_box is None:
            return 0, 0, 0, 0
        x0, y0, x1, y1 = self.amodal_box
        return int(np.floor(x0)) - 1, int(np.floor(y0)) - 1, int(np.ceil(x1)) + 1, int(np.ceil(y1)) + 1

    def meets(self, width_px: int, height_px: int) -> bool:
        """Whether the window and the picture share a pixel."""
        x0, y0, x1, y1 = self.window
        return max(x0, 0) < min(x1, width_px) and max(y0, 0) < min(y1, height_px)


@dataclass(frozen=True, eq=False)
class Sight:
    """What is seen of the grab in one frame.

    Attributes
    ----------
    visible : View
        Ids and depth in the part of the aim's window that lies in the picture.
    visible_fraction, in_frame_fraction : float
        See `simgrab.labels.truth.Truth`.
    """

    visible: View
    visible_fraction: float
    in_frame_fraction: float

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Pixels of the grab within ``visible.window``."""
        return self.visible.ids == GRAB

    @property
    def box(self) -> Window | None:
        """Tight box of the visible grab in the picture, half open."""
        mask = self.mask
        if not mask.any():
            return None
        x, y = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
        x0, y0 = self.visible.window[:2]
        return x0 + int(x[0]), y0 + int(y[0]), x0 + int(x[-1]) + 1, y0 + int(y[-1]) + 1


def aim(scenario: Scenario, plan: Plan, moment: Moment) -> Aim:
    """Project a frame's moment.

    Raises
    ------
    ScenarioError
        If the state cannot be: naming frame and key.
    """
    frame, state = moment.frame, moment.grab
    pose = state.jib_from_grab
    points = plan.grab_points(state) @ pose[:3, :3].T + pose[:3, 3]
    plan.check_clearance(moment, points)
    camera, rotation = scenario.camera, moment.tilt.jib_from_camera

    def to_camera(points_jib: Array) -> Array:
        return geometry.to_camera(points_jib, rotation, camera.offset_m)

    outline = to_camera(points)
    if outline[:, 2].min() < NEAREST_DEPTH_M:
        raise ScenarioError(
            "swing", f"frame {frame}: the grab reaches the camera or passes behind it "
            f"(alpha {np.degrees(state.alpha):.1f}°, rope {state.rope_length:.2f} m)",
        )  # fmt: skip
    return Aim(
        moment,
        to_camera(pose[:3, 3]),
        _finite(camera.intrinsics.project(outline)) if moment.present else np.zeros((0, 2)),
        to_camera(_keypoints(state)),
    )


def _keypoints(state: GrabState) -> Array:
    """Keypoints in the jib frame, shape (10, 3), in the order of `KEYPOINT_NAMES`."""
    frames, pose = grab.body_frames(state.jaw), state.jib_from_grab
    lips = [frames[body][:3, :3] @ p + frames[body][:3, 3] for body in grab.LIP_CORNERS for p in grab.LIP_CORNERS[body]]
    in_grab = np.concatenate([np.zeros((1, 3)), grab.ROPE_TERMINATIONS, np.array(lips)])
    in_jib = in_grab @ pose[:3, :3].T + pose[:3, 3]
    points = np.insert(in_jib, 1, 0.0, axis=0)  # the rope exit is O
    assert len(points) == len(KEYPOINT_NAMES)
    return points


def see(renderer: Renderer, aimed: Aim, full: View | None = None) -> Sight:
    """Look at the posed grab: alone, for its whole silhouette, and among everything else, for what is visible of it.

    ``full`` is a view of the whole picture, where one was drawn already.
    """
    k = renderer.intrinsics
    x0, y0, x1, y1 = aimed.window
    inner = max(x0, 0), max(y0, 0), min(x1, k.width_px), min(y1, k.height_px)
    if not aimed.meets(k.width_px, k.height_px):
        nothing = np.zeros((0, 0))
        return Sight(View((0, 0, 0, 0), nothing.astype(np.uint8), nothing.astype(np.float32)), 0.0, 0.0)
    whole = renderer.look(aimed.window, grab_only=True).ids == GRAB
    visible = full.crop(inner) if full else renderer.look(inner)
    total = max(int(whole.sum()), 1)
    inside = whole[inner[1] - y0 : inner[3] - y0, inner[0] - x0 : inner[2] - x0]
    return Sight(visible, int((visible.ids == GRAB).sum()) / total, int(inside.sum()) / total)


def label(
    variant: Variant,
    aimed: Aim,
    sight: Sight,
    veil: NDArray[np.float32] | None = None,
    *,
    split: str,
    file: str,
    image_sha256: str,
) -> Truth:
    """Compose the row of labels of one frame; ``veil`` (height, width) is the light that weather keeps back."""
    scenario, moment = variant.scenario, aimed.moment
    state, tilt = moment.grab, moment.tilt
    camera, k, jib, shown = scenario.camera, scenario.camera.intrinsics, moment.jib, moment.shown
    ideal, pixel = k.ideal(aimed.centre_camera), k.project(aimed.centre_camera)
    m, theta = k.polar(ideal, geometry.vertical_direction(tilt.azimuth, tilt.roll))
    camera_pose = np.column_stack([tilt.jib_from_camera, camera.offset_m])
    amodal: tuple[float | None, ...] = (None,) * 4
    oriented = None
    if aimed.amodal_box is not None:
        amodal = _floats(aimed.amodal_box)
        oriented = _floats(cv2.boxPoints(cv2.minAreaRect(aimed.outline_px.astype(np.float32))))
    box = sight.box or (None, None, None, None)
    return Truth(
        frame=moment.frame,
        split=split,
        file=file,
        seed=scenario.seed,
        variant=variant.number,
        varied=variant.varied,
        clip=moment.clip,
        time_s=moment.time,
        alpha_deg=_degrees(state.alpha),
        gamma_deg=_degrees(moment.gamma) % 360.0,
        beta_deg=_degrees(tilt.beta),
        tilt_azimuth_deg=_degrees(tilt.azimuth) % 360.0,
        roll_deg=_degrees(geometry.wrap(tilt.roll)),
        offset_x_m=camera.offset_x_m,
        offset_y_m=camera.offset_y_m,
        offset_z_m=camera.offset_z_m,
        rope_length_m=state.rope_length,
        slew_deg=_degrees(jib.slew) if jib else 0.0,
        radius_m=jib.radius if jib else None,
        apparent_gravity=moment.apparent_gravity,
        yaw_deg=_degrees(state.yaw),
        jaw_deg=_degrees(state.jaw),
        load=state.load,
        present=moment.present,
        distance_m=float(np.linalg.norm(aimed.centre_camera)),
        width_px=k.width_px,
        height_px=k.height_px,
        fx_px=k.f_px,
        fy_px=k.f_px,
        cx_px=k.cx_px,
        cy_px=k.cy_px,
        k1=k.distortion.k1,
        k2=k.distortion.k2,
        p1=k.distortion.p1,
        p2=k.distortion.p2,
        k3=k.distortion.k3,
        jib_from_camera=_floats(camera_pose),
        jib_from_grab=_floats(state.jib_from_grab[:3]),
        grab_u_px=_number(pixel[0]),
        grab_v_px=_number(pixel[1]),
        ideal_u_px=_number(ideal[0]),
        ideal_v_px=_number(ideal[1]),
        m_px=_number(m),
        theta_deg=_number(np.degrees(theta)),
        box_x0_px=box[0],
        box_y0_px=box[1],
        box_x1_px=box[2],
        box_y1_px=box[3],
        amodal_x0_px=amodal[0],
        amodal_y0_px=amodal[1],
        amodal_x1_px=amodal[2],
        amodal_y1_px=amodal[3],
        visible_fraction=sight.visible_fraction,
        in_frame_fraction=sight.in_frame_fraction,
        weather_hidden_fraction=_hidden(sight, veil),
        oriented_box=oriented,
        keypoints=_floats(_see_keypoints(scenario, aimed, sight)),
        rope_text=shown.rope_text if shown else None,
        rope_text_below=shown.rope_text_below if shown else None,
        torn_row_px=shown.torn_row_px if shown else None,
        clock_text=shown.clock_text if shown else None,
        image_sha256=image_sha256,
    )


def _see_keypoints(scenario: Scenario, aimed: Aim, sight: Sight) -> Array:
    """u, v and visibility of each keypoint, shape (10, 3); zeros where it is out of the picture, as COCO has it."""
    k = scenario.camera.intrinsics
    rows = np.zeros((len(KEYPOINT_NAMES), 3))
    if not aimed.moment.present:
        return rows
    pixels = k.project(aimed.keypoints_camera)
    x0, y0, x1, y1 = sight.visible.window
    for i, ((u, v), depth) in enumerate(zip(pixels, aimed.keypoints_camera[:, 2], strict=True)):
        if not (0 <= u < k.width_px and 0 <= v < k.height_px):  # NaN is outside too
            continue
        inside = x0 <= u < x1 and y0 <= v < y1
        rows[i] = u, v, 1
        if inside:
            at = int(v) - y0, int(u) - x0
            own_rope = KEYPOINT_NAMES[i].startswith("termination") and sight.visible.ids[at] == ROPE
            tolerance = ROPE_TOLERANCE_M if own_rope else KEYPOINT_TOLERANCE_M
            rows[i, 2] += sight.visible.depth[at] > depth - tolerance
    return rows


def _hidden(sight: Sight, veil: NDArray[np.float32] | None) -> float:
    """Share of the light of the visible grab that weather keeps from the camera."""
    if veil is None:
        return 0.0
    x0, y0, x1, y1 = sight.visible.window
    return hidden_fraction(veil[y0:y1, x0:x1], sight.mask)


def _finite(points: Array) -> Array:
    return np.asarray(points[np.isfinite(points).all(axis=1)])


def _degrees(angle: float | Array) -> float:
    return float(np.degrees(angle))


def _floats(values: Array) -> tuple[float, ...]:
    return tuple(float(v) for v in np.ravel(values))


def _number(value: float | Array) -> float | None:
    return float(value) if np.isfinite(value) else None
