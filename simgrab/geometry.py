"""The geometry of Yu, Wang & Wang (2025): rays, the tilted camera, and the swing angles they see.

Frames. The *jib frame* has its origin O at the rope exit, x horizontal and outboard, z up. The *camera frame* is
OpenCV's: x right, y down, z forward. Angles are radians, lengths metres, pixels continuous: (0, 0) is the outer corner
of the top-left pixel and pixel centres lie at +0.5. Everything is float64 and broadcasts over leading axes (frames).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# Columns: camera x, y, z in the jib frame, looking straight down with the picture's top outboard.
_STRAIGHT_DOWN = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])

# The paper's camera (section 4.3). 2202.907 px / 6.43 mm is 342.60; the printed figure is kept.
PAPER_PIXELS_PER_MM = 342.67
PAPER_FOCAL_LENGTH_MM = 4.8

_POINTS_AT_ONCE = 8192  # whose intermediate results a core's cache holds


def rotation_z(angle: ArrayLike) -> Array:
    """Rotation about z, shape (..., 3, 3), counter-clockwise seen from +z."""
    c, s = np.cos(np.asarray(angle, float)), np.sin(np.asarray(angle, float))
    o, i = np.zeros_like(c), np.ones_like(c)
    return np.stack([c, -s, o, s, c, o, o, o, i], axis=-1).reshape(*c.shape, 3, 3)


def rotation_y(angle: ArrayLike) -> Array:
    """Rotation about y, shape (..., 3, 3)."""
    c, s = np.cos(np.asarray(angle, float)), np.sin(np.asarray(angle, float))
    o, i = np.zeros_like(c), np.ones_like(c)
    return np.stack([c, o, s, o, i, o, -s, o, c], axis=-1).reshape(*c.shape, 3, 3)


def lean(angle: ArrayLike, azimuth: ArrayLike) -> Array:
    """Lean the downward vertical by ``angle`` towards ``azimuth`` φ: Rz(φ)·Ry(−angle)·Rz(−φ), shape (..., 3, 3)."""
    a, p = np.broadcast_arrays(np.asarray(angle, float), np.asarray(azimuth, float))
    s, v = np.sin(a), 2 * np.sin(a / 2) ** 2  # v = 1 − cos
    x, y = np.cos(p), np.sin(p)
    result = np.empty((*a.shape, 3, 3))
    result[..., 0, 0], result[..., 1, 1], result[..., 2, 2] = 1 - v * x * x, 1 - v * y * y, 1 - v
    result[..., 0, 1] = result[..., 1, 0] = -v * x * y
    result[..., 2, 0], result[..., 2, 1] = s * x, s * y
    result[..., 0, 2], result[..., 1, 2] = -s * x, -s * y
    return result


def camera_rotation(beta: ArrayLike, azimuth: ArrayLike, roll: ArrayLike) -> Array:
    """Rotation ``jib_from_camera`` of a camera tilted by β towards an azimuth and then rolled.

    Parameters
    ----------
    beta : array_like, shape (...)
        Angle between the optical axis and gravity, rad.
    azimuth : array_like, shape (...)
        Direction of the optical axis' horizontal part in the jib frame, counter-clockwise seen from above, rad.
    roll : array_like, shape (...)
        Turn about the optical axis, rad. With 0 the picture does not turn with the azimuth.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        Rz(azimuth)·Ry(−β)·Rz(−azimuth)·R0·Rz(roll), R0 looking straight down with the picture's top outboard.
    """
    return lean(beta, azimuth) @ _STRAIGHT_DOWN @ rotation_z(roll)


def grab_rotation(alpha: ArrayLike, azimuth: ArrayLike, yaw: ArrayLike) -> Array:
    """Rotation ``jib_from_grab``, shape (..., 3, 3): the grab leans with its rope, yawed about it (0 = x outboard)."""
    return lean(alpha, azimuth) @ rotation_z(yaw)


def grab_centre(alpha: ArrayLike, azimuth: ArrayLike, rope_length: ArrayLike) -> Array:
    """Grab centre A in the jib frame, from the swing.

    Parameters
    ----------
    alpha : array_like, shape (...)
        Swing angle between OA and gravity, rad.
    azimuth : array_like, shape (...)
        Direction of the swing in the jib frame: γ plus the camera's tilt azimuth, rad.
    rope_length : array_like, shape (...)
        |OA|, m.

    Returns
    -------
    ndarray, shape (..., 3)
        Metres, jib frame.
    """
    a, p, r = np.broadcast_arrays(*(np.asarray(v, float) for v in (alpha, azimuth, rope_length)))
    direction = np.stack([np.sin(a) * np.cos(p), np.sin(a) * np.sin(p), -np.cos(a)], axis=-1)
    return np.asarray(r[..., None] * direction)


def swing_of(centre: ArrayLike) -> tuple[Array, Array, Array]:
    """Swing (α, azimuth in [0, 2π), rope length) of a grab centre in the jib frame; the inverse of `grab_centre`.

    α comes from an arctangent, which keeps its accuracy at rest, where an arccosine loses half the digits.
    """
    c = np.asarray(centre, float)
    horizontal = np.hypot(c[..., 0], c[..., 1])
    return (
        np.arctan2(horizontal, -c[..., 2]),
        np.arctan2(c[..., 1], c[..., 0]) % (2 * np.pi),
        np.sqrt(horizontal**2 + c[..., 2] ** 2),
    )


@dataclass(frozen=True)
class Distortion:
    """Brown–Conrady lens distortion in OpenCV's order and signs, on normalised coordinates (x/z, y/z)."""

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    @property
    def is_null(self) -> bool:
        """Whether the lens draws straight lines straight."""
        return not (self.k1 or self.k2 or self.p1 or self.p2 or self.k3)

    def apply(self, xy: ArrayLike) -> Array:
        """Distort normalised points, shape (..., 2)."""
        return np.moveaxis(self._bend(*np.moveaxis(np.asarray(xy, float), -1, 0)), 0, -1)

    def _bend(self, x: Array, y: Array) -> Array:
        """`apply`, coordinate by coordinate; shape (2, ...)."""
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        return np.stack(
            [
                x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x),
                y * radial + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y,
            ]
        )

    @cached_property
    def fold_radius(self) -> float:
        """Normalised radius beyond which the radial part maps points back inwards; inf without a fold."""
        # Of 1/r², as a coefficient may be as small as a float can be, and all of them are finite this way round.
        roots = np.roots([1.0, 3 * self.k1, 5 * self.k2, 7 * self.k3])
        real = roots[np.isreal(roots) & (roots.real > 0)].real
        return 1 / math.sqrt(real.max()) if real.size else math.inf

    def _jacobian(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """∂x_d/∂x, ∂y_d/∂y and the (equal) mixed derivatives."""
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        slope = 2 * (self.k1 + r2 * (2 * self.k2 + 3 * r2 * self.k3))  # d(radial)/dx = slope·x
        return (
            radial + slope * x * x + 2 * self.p1 * y + 6 * self.p2 * x,
            radial + slope * y * y + 6 * self.p1 * y + 2 * self.p2 * x,
            slope * x * y + 2 * self.p1 * x + 2 * self.p2 * y,
        )

    def remove(self, xy: ArrayLike) -> Array:
        """Undistort normalised points, shape (..., 2), by Newton's method from the distorted point.

        Points beyond the fold of the lens, which no ray reaches, come back NaN.
        """
        target = np.asarray(xy, float)
        if self.is_null:
            return target.copy()
        flat = target.reshape(-1, 2)
        result = np.empty_like(flat)
        for start in range(0, len(flat), _POINTS_AT_ONCE):
            some = slice(start, start + _POINTS_AT_ONCE)
            result[some] = self._remove(np.ascontiguousarray(flat[some].T)).T
        return result.reshape(target.shape)

    def _remove(self, target: Array) -> Array:
        """`remove` of points of shape (2, N)."""
        point = target.copy()
        with np.errstate(all="ignore"):
            for _ in range(30):
                ex, ey = self._bend(*point) - target
                a, d, b = self._jacobian(*point)
                det = a * d - b * b
                point[0] -= (d * ex - b * ey) / det
                point[1] -= (a * ey - b * ex) / det
                if np.all((np.abs(ex) + np.abs(ey) < 1e-14) | ~np.isfinite(ex + ey)):
                    break
            a, d, b = self._jacobian(*point)
            residual = np.linalg.norm(self._bend(*point) - target, axis=0)
            # On the near side of the fold the map keeps orientation and stretches in every direction.
            good = (residual < 1e-9) & (a * d - b * b > 0) & (a + d > 0)
        return np.where(good, point, np.nan)


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole with square pixels (the paper's h = fx = fy), its principal point, and its lens.

    Attributes
    ----------
    width_px, height_px : int
        Size of the picture.
    f_px : float
        Focal length h, pixels.
    cx_px, cy_px : float
        Principal point; the image centre is (width/2, height/2).
    distortion : Distortion
    """

    width_px: int
    height_px: int
    f_px: float
    cx_px: float
    cy_px: float
    distortion: Distortion = Distortion()

    def ideal(self, points_camera: ArrayLike) -> Array:
        """Pixels without distortion of points (..., 3) in the camera frame; NaN behind the camera."""
        return self._to_pixels(self._normalised(points_camera))

    def project(self, points_camera: ArrayLike) -> Array:
        """Pixels, as the picture has them, of points (..., 3) in the camera frame; NaN where the lens shows none."""
        return self._to_pixels(self._bend(self._normalised(points_camera)))

    def undistort(self, pixels: ArrayLike) -> Array:
        """Ideal pixels (..., 2) of pixels as the picture has them; NaN beyond the fold of the lens."""
        return self._to_pixels(self.distortion.remove(self._from_pixels(pixels)))

    def distort(self, ideal_pixels: ArrayLike) -> Array:
        """Pixels (..., 2) as the picture has them, of ideal ones."""
        return self._to_pixels(self._bend(self._from_pixels(ideal_pixels)))

    def rays(self, pixels: ArrayLike) -> Array:
        """Return unit rays (..., 3), camera frame, through pixels (..., 2) as the picture has them."""
        xy = self.distortion.remove(self._from_pixels(pixels))
        ray = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
        return np.asarray(ray / np.linalg.norm(ray, axis=-1, keepdims=True))

    def polar(self, ideal_pixels: ArrayLike, axis: ArrayLike = 0.0) -> tuple[Array, Array]:
        """Polar coordinates (m, θ) of ideal pixels (..., 2) about the principal point.

        Parameters
        ----------
        ideal_pixels : array_like, shape (..., 2)
        axis : array_like, shape (...)
            Direction of θ = 0 in the picture, clockwise from its x axis, rad; see `vertical_direction`.

        Returns
        -------
        m : ndarray, shape (...)
            Pixels.
        theta : ndarray, shape (...)
            Clockwise in the picture, in (−π, π].
        """
        xy = np.asarray(ideal_pixels, float) - (self.cx_px, self.cy_px)
        return np.hypot(xy[..., 0], xy[..., 1]), wrap(np.arctan2(xy[..., 1], xy[..., 0]) - np.asarray(axis, float))

    def from_polar(self, m: ArrayLike, theta: ArrayLike, axis: ArrayLike = 0.0) -> Array:
        """Ideal pixels (..., 2) from (m, θ); the inverse of `polar`."""
        angle = np.asarray(theta, float) + np.asarray(axis, float)
        xy = np.asarray(m, float)[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return np.asarray(xy + (self.cx_px, self.cy_px))

    def _normalised(self, points_camera: ArrayLike) -> Array:
        p = np.asarray(points_camera, float)
        depth = np.where(p[..., 2:] > 0, p[..., 2:], np.nan)
        return np.asarray(p[..., :2] / depth)

    def _bend(self, xy: Array) -> Array:
        beyond = np.hypot(xy[..., 0], xy[..., 1]) > self.distortion.fold_radius
        return np.where(beyond[..., None], np.nan, self.distortion.apply(xy))

    def _to_pixels(self, xy: Array) -> Array:
        return np.asarray(self.f_px * xy + (self.cx_px, self.cy_px))

    def _from_pixels(self, pixels: ArrayLike) -> Array:
        return np.asarray((np.asarray(pixels, float) - (self.cx_px, self.cy_px)) / self.f_px)


def to_camera(points_jib: ArrayLike, rotation: ArrayLike, offset: ArrayLike) -> Array:
    """Express jib-frame points (..., 3) in the camera frame, from ``jib_from_camera``'s rotation and offset."""
    delta = np.asarray(points_jib, float) - np.asarray(offset, float)
    return np.einsum("...ji,...j->...i", np.asarray(rotation, float), delta)


def vertical_direction(azimuth: ArrayLike, roll: ArrayLike) -> Array:
    """Direction C'G' in the picture, clockwise from its x axis, rad.

    G' is the vanishing point of gravity. Its direction from the principal point depends on tilt azimuth and roll alone,
    so it is defined at β = 0 too.
    """
    return np.asarray(np.pi / 2 - np.asarray(azimuth, float) - np.asarray(roll, float))


def image_radius(alpha: ArrayLike, gamma: ArrayLike, beta: ArrayLike, h: float) -> Array:
    """Solve eq. (1) for m: image radius, px, of a grab with swing (α, γ) seen by a camera at O tilted by β."""
    cos_psi = _cos_axis_angle(alpha, gamma, beta)
    return np.asarray(h * np.sqrt(np.maximum(1 / cos_psi**2 - 1, 0.0)))


def eq1_residual(m: ArrayLike, alpha: ArrayLike, gamma: ArrayLike, beta: ArrayLike, h: ArrayLike) -> Array:
    """Relative residual of eq. (1): (m² + h²)(cosα cosβ + sinα sinβ cosγ)²/h² − 1. Zero when camera and O coincide."""
    m_, h_ = np.asarray(m, float), np.asarray(h, float)
    return np.asarray((m_**2 + h_**2) * _cos_axis_angle(alpha, gamma, beta) ** 2 / h_**2 - 1)


def eq2_cos_alpha(m: ArrayLike, theta: ArrayLike, beta: ArrayLike, h: ArrayLike) -> Array:
    """Eq. (2): cosα = (m sinβ cosθ + h cosβ) / √(m² + h²). Holds when camera and O coincide."""
    m_, h_, b = np.asarray(m, float), np.asarray(h, float), np.asarray(beta, float)
    return np.asarray((m_ * np.sin(b) * np.cos(theta) + h_ * np.cos(b)) / np.hypot(m_, h_))


def _cos_axis_angle(alpha: ArrayLike, gamma: ArrayLike, beta: ArrayLike) -> Array:
    a, g, b = (np.asarray(v, float) for v in (alpha, gamma, beta))
    return np.asarray(np.cos(a) * np.cos(b) + np.sin(a) * np.sin(b) * np.cos(g))


def wrap(angle: ArrayLike) -> Array:
    """Wrap angles into (−π, π]."""
    return np.asarray(np.pi - (np.pi - np.asarray(angle, float)) % (2 * np.pi))


def focal_length_px(focal_length_mm: float, pixels_per_mm: float) -> float:
    """Focal length in pixels from the lens; the paper's 4.8 mm at 342.67 px/mm give h = 1644.82 px."""
    return focal_length_mm * pixels_per_mm


def pixels_per_mm(width_px: int, height_px: int, sensor_diagonal_mm: float) -> float:
    """Pixel density d0 of a sensor read out whole, from its diagonal."""
    return math.hypot(width_px, height_px) / sensor_diagonal_mm
