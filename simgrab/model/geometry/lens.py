"""The pinhole camera with its lens."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from simgrab.model.geometry.rotations import Array, wrap

_POINTS_AT_ONCE = 8192  # whose intermediate results a core's cache holds


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
        """Whether the lens maps straight lines to straight lines."""
        return not (self.k1 or self.k2 or self.p1 or self.p2 or self.k3)

    @property
    def is_radial(self) -> bool:
        """Terms that are 0 are left out: most lenses have k1 alone, and millions of pixels go through it."""
        return not (self.p1 or self.p2)

    def _radial(self, r2: Array) -> Array:
        """Factor by which the radial part moves points of a squared radius outwards."""
        return 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3) if self.k2 or self.k3 else self.k1)

    def apply(self, xy: ArrayLike) -> Array:
        """Distort normalised points, shape (..., 2)."""
        return np.moveaxis(self._bend(*np.moveaxis(np.asarray(xy, float), -1, 0)), 0, -1)

    def _bend(self, x: Array, y: Array) -> Array:
        """`apply`, coordinate by coordinate; shape (2, ...)."""
        r2 = x * x + y * y
        radial = self._radial(r2)
        if self.is_radial:
            return np.stack([x * radial, y * radial])
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
        radial = self._radial(r2)
        slope: Array | float = 2 * self.k1
        if self.k2 or self.k3:
            slope = 2 * (self.k1 + r2 * (2 * self.k2 + 3 * r2 * self.k3))  # d(radial)/dx = slope·x
        if self.is_radial:
            along = slope * x
            return radial + along * x, radial + slope * y * y, along * y
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
    """A pinhole with square pixels (the paper's h = fx = fy), its principal point, and its lens."""

    # width_px, height_px: size of the picture
    width_px: int
    height_px: int
    f_px: float  # focal length h, pixels
    # cx_px, cy_px: principal point; the image centre is (width/2, height/2)
    cx_px: float
    cy_px: float
    distortion: Distortion = Distortion()

    def ideal(self, points_camera: ArrayLike) -> Array:
        """Pixels without distortion of points (..., 3) in the camera frame; NaN behind the camera."""
        return self._to_pixels(self._normalised(points_camera))

    def project(self, points_camera: ArrayLike) -> Array:
        """Pixels, as the picture has them, of points (..., 3) in the camera frame; NaN if not shown."""
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

    def normalised_centres(self) -> Array:
        """Undistorted (x, y) at unit depth of all pixels' centres, shape (height, width, 2); NaN beyond the fold."""
        return _normalised_centres(self)

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


@lru_cache(maxsize=1)
def _normalised_centres(intrinsics: Intrinsics) -> Array:
    """`Intrinsics.normalised_centres`; the last camera's are kept."""
    w, h = intrinsics.width_px, intrinsics.height_px
    centred = (intrinsics.cx_px, intrinsics.cy_px) == (w / 2, h / 2) and intrinsics.distortion.is_radial
    columns, rows = ((w + 1) // 2, (h + 1) // 2) if centred else (w, h)  # the other quarters mirror the first one
    u, v = np.arange(columns) + 0.5, np.arange(rows) + 0.5
    found = np.empty((h, w, 2))
    found[:rows, :columns] = intrinsics.distortion.remove(intrinsics._from_pixels(np.stack(np.meshgrid(u, v), axis=-1)))
    found[:rows, columns:] = found[:rows, : w - columns][:, ::-1] * (-1, 1)
    found[rows:] = found[: h - rows][::-1] * (1, -1)
    found.setflags(write=False)
    return found


def pixels_per_mm(width_px: int, height_px: int, sensor_diagonal_mm: float) -> float:
    """Pixel density d0 of a sensor read out whole, from its diagonal."""
    return math.hypot(width_px, height_px) / sensor_diagonal_mm
