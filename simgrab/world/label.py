"""The truth of one frame, computed from pose and camera; the rendered ids only give the visible part of the grab."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from simgrab.model import geometry
from simgrab.model.geometry import Array
from simgrab.model.scenario import Scenario, Variant
from simgrab.model.truth import KEYPOINT_NAMES, Truth
from simgrab.world.camera.buffers import Buffers, Visibility
from simgrab.world.camera.weather import hidden_fraction
from simgrab.world.projection import Projection
from simgrab.world.scenery.model import ROPE

KEYPOINT_TOLERANCE_M = 0.12  # a keypoint on a surface is seen if nothing lies this much nearer,
ROPE_TOLERANCE_M = 1.0  # but for a rope over a termination: the one that ends there, seen nearly end on


def label(variant: Variant, buffers: Buffers, attenuation: NDArray[np.float32] | None = None) -> Truth:
    """Compose the truth of one frame.

    ``attenuation`` (height, width) is the share of the scene's light that weather keeps from the camera.
    """
    projection, visibility = buffers.projection, buffers.visibility
    scenario, moment = variant.scenario, projection.moment
    state, tilt = moment.grab, moment.tilt
    camera, k, jib, shown = scenario.camera, scenario.camera.intrinsics, moment.jib, moment.shown
    ideal, pixel = k.ideal(projection.centre_camera), k.project(projection.centre_camera)
    m, theta = k.polar(ideal, geometry.vertical_direction(tilt.azimuth, tilt.roll))
    camera_pose = np.column_stack([tilt.jib_from_camera, camera.offset_m])
    amodal = (None,) * 4 if projection.amodal_box is None else _floats(projection.amodal_box)
    oriented = None if projection.oriented_box is None else _floats(projection.oriented_box)
    box = visibility.box or (None, None, None, None)
    return Truth(
        frame=moment.frame,
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
        clamped="+".join(moment.clamped),
        present=moment.present,
        distance_m=float(np.linalg.norm(projection.centre_camera)),
        width_px=k.width_px,
        height_px=k.height_px,
        fx_px=k.f_px,
        fy_px=k.f_px,
        cx_px=k.cx_px,
        cy_px=k.cy_px,
        **asdict(k.distortion),
        jib_from_camera=_floats(camera_pose),
        jib_from_grab=_floats(state.jib_from_grab.as_matrix()[:3]),
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
        visible_fraction=visibility.visible_fraction,
        in_frame_fraction=visibility.in_frame_fraction,
        weather_hidden_fraction=_hidden(visibility, attenuation),
        oriented_box=oriented,
        keypoints=_floats(_keypoints(scenario, projection, visibility)),
        rope_text=shown.rope_text if shown else None,
        rope_text_below=shown.rope_text_below if shown else None,
        torn_row_px=shown.torn_row_px if shown else None,
        clock_text=shown.clock_text if shown else None,
    )


def _keypoints(scenario: Scenario, projection: Projection, visibility: Visibility) -> Array:
    """u, v and visibility of each keypoint, shape (10, 3); zeros outside the picture, as in COCO."""
    k = scenario.camera.intrinsics
    rows = np.zeros((len(KEYPOINT_NAMES), 3))
    if not projection.moment.present:
        return rows
    pixels = k.project(projection.keypoints_camera)
    x0, y0, x1, y1 = visibility.visible.window
    for i, ((u, v), depth) in enumerate(zip(pixels, projection.keypoints_camera[:, 2], strict=True)):
        if not (0 <= u < k.width_px and 0 <= v < k.height_px):  # NaN is outside too
            continue
        inside = x0 <= u < x1 and y0 <= v < y1
        rows[i] = u, v, 1
        if inside:
            at = int(v) - y0, int(u) - x0
            own_rope = KEYPOINT_NAMES[i].startswith("termination") and visibility.visible.ids[at] == ROPE
            tolerance = ROPE_TOLERANCE_M if own_rope else KEYPOINT_TOLERANCE_M
            rows[i, 2] += visibility.visible.depth[at] > depth - tolerance
    return rows


def _hidden(visibility: Visibility, attenuation: NDArray[np.float32] | None) -> float:
    """Share of the light of the visible grab that weather keeps from the camera."""
    if attenuation is None:
        return 0.0
    x0, y0, x1, y1 = visibility.visible.window
    return hidden_fraction(attenuation[y0:y1, x0:x1], visibility.visible.shows_grab)


def _degrees(angle: float | Array) -> float:
    return float(np.degrees(angle))


def _floats(values: Array) -> tuple[float, ...]:
    return tuple(float(v) for v in np.ravel(values))


def _number(value: float | Array) -> float | None:
    return float(value) if np.isfinite(value) else None
