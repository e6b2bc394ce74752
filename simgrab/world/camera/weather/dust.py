"""Dust from digging and dumping: a Gaussian cloud that drifts with the wind, spreads and thins."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from simgrab.model.geometry import Array
from simgrab.model.rng import stream
from simgrab.model.scenario import Cargo
from simgrab.world.camera.row_blocks import enlarged
from simgrab.world.camera.weather import noise
from simgrab.world.camera.weather.layer import Layer, Maker
from simgrab.world.camera.weather.render_pass import Picture, RenderPass, Vector, ray_maps

SPREAD_M_S = 0.25  # growth of a cloud's standard deviation, about the turbulence near the ground
LONGEST_S = 6.0
BELOW_GRAB_M = 2.0  # where cargo leaves the jaws
SEEN = 3.5  # standard deviations
BILLOWS = 1.6  # thickest over thinnest lobe is exp of this
BILLOW_SPAN = 12.0  # standard deviations after which billows repeat
BILLOW_STEP = 4  # every fourth pixel will do
# Colour of a dense cloud, as a share of a white one's.
TINT: dict[Cargo, Vector] = {
    "coal": (0.2, 0.19, 0.18),
    "ore": (0.55, 0.33, 0.22),
    "grain": (0.82, 0.72, 0.52),
    "bauxite": (0.68, 0.42, 0.28),
    "sulphur": (0.86, 0.78, 0.36),
}


@dataclass(frozen=True, eq=False)
class Cloud:
    """A Gaussian cloud in the camera frame.

    Attributes
    ----------
    centre_m : ndarray, shape (3,)
    radius_m : float
        Standard deviation.
    thickness : float
        Optical thickness of the line through the middle.
    """

    centre_m: Array
    radius_m: float
    thickness: float


def cloud_of_frame(
    rendered: RenderPass, thickness: float, radius_m: float, wind_m_s: Array, *, seed: int, frame: int
) -> Cloud:
    """Return dust that the grab's jaws raised a random time ago."""
    age = stream(seed, frame, "weather.dust.age").uniform(0, LONGEST_S)
    return cloud(np.subtract(rendered.grab_m, (0.0, 0.0, BELOW_GRAB_M)), age, rendered, thickness, radius_m, wind_m_s)


def cloud(
    origin_m: Array, age_s: float, rendered: RenderPass, thickness: float, radius_m: float, wind_m_s: Array
) -> Cloud:
    """Return what has become of a puff. Its dust stays the same, so the thickness falls as the square of the radius."""
    radius = radius_m + SPREAD_M_S * age_s
    centre = (origin_m + wind_m_s * age_s - rendered.centre_m) @ rendered.jib_from_camera
    return Cloud(centre, radius, thickness * (radius_m / radius) ** 2)


def dust(of: Cloud, rendered: RenderPass, *, seed: int) -> Maker:
    """Return the cloud before the scene; its billows travel with it."""
    window = _window(of, rendered)
    if window is None:
        return lambda _: None
    rays, (inside, columns) = ray_maps(rendered.intrinsics), window
    lobes, width = _billows(of, rendered, window, seed), columns.stop - columns.start

    def block(rows: slice) -> Layer | None:
        some = slice(max(rows.start, inside.start), min(rows.stop, inside.stop))
        if some.start >= some.stop:
            return None
        at, length = (some, columns), rays.length[some, columns]
        thickness = column(of, rays.x[at], rays.y[at], length, rendered.depth[at] * length)
        within = slice(some.start - inside.start, some.stop - inside.start)
        thickness *= enlarged(lobes, BILLOW_STEP, within, width)
        keep = np.ones(rendered.depth[rows].shape, np.float32)
        keep[some.start - rows.start : some.stop - rows.start, columns] = cv2.exp(-thickness)
        return Layer(keep, 1 - keep)

    return block


def column(of: Cloud, x: Picture, y: Picture, length: Picture, distance: Picture) -> Picture:
    """Optical thickness of the cloud between camera and scene, in closed form.

    Along a ray that passes the middle at a, b beside it, the density is a Gaussian of the way: its integral from 0 to
    d is τ exp(−b²/2s²) (erf((d − a)/s√2) + erf(a/s√2)) / 2.

    Parameters
    ----------
    of : Cloud
    x, y, length : ndarray of float32, shape (h, w)
        As in `RayMaps`.
    distance : ndarray of float32, shape (h, w)
        To the scene, along the ray, m.
    """
    cx, cy, cz = (np.float32(c) for c in of.centre_m)
    along = (x * cx + y * cy + cz) / length
    beside = np.maximum(cx * cx + cy * cy + cz * cz - along * along, 0)
    root = np.float32(1 / (of.radius_m * np.sqrt(2)))
    inside = _erf((distance - along) * root) + _erf(along * root)
    return np.asarray(np.float32(of.thickness / 2) * cv2.exp(-beside * root * root) * inside)


def _erf(x: Picture) -> Picture:
    """Error function to 4e-4."""
    return np.tanh(x * (np.float32(1.128379) + np.float32(0.1009109) * x * x))


def _window(of: Cloud, rendered: RenderPass) -> tuple[slice, slice] | None:
    """Rows and columns that show the cloud; None where it is out of the picture."""
    k, reach = rendered.intrinsics, SEEN * of.radius_m
    height, width = rendered.depth.shape
    if of.centre_m[2] < 1.5 * reach:  # it wraps the camera
        return np.s_[0:height, 0:width]
    u, v = k.project(of.centre_m)
    # The outline of a sphere off the axis, generously.
    r = 1.5 * k.f_px * reach / (of.centre_m[2] - reach)
    if not np.isfinite(u + v) or u + r < 1 or v + r < 1 or u - r > width - 1 or v - r > height - 1:
        return None
    return np.s_[max(0, int(v - r)) : min(height, int(v + r)), max(0, int(u - r)) : min(width, int(u + r))]


def _billows(of: Cloud, rendered: RenderPass, window: tuple[slice, slice], seed: int) -> Picture:
    """Lobes of mean 1, at every fourth pixel of the window."""
    rays, coarse = ray_maps(rendered.intrinsics), tuple(slice(s.start, s.stop, BILLOW_STEP) for s in window)
    scale = np.float32(of.centre_m[2] / of.radius_m)
    cx, cy = (np.float32(c / of.radius_m) for c in of.centre_m[:2])
    pattern = noise.tile(seed, 0, "weather.dust.billows", 1.8)
    field = noise.look_up(pattern, rays.x[coarse] * scale - cx, rays.y[coarse] * scale - cy, BILLOW_SPAN)
    return np.asarray(cv2.exp(np.float32(BILLOWS) * field) * np.float32(BILLOWS / np.expm1(BILLOWS)))
