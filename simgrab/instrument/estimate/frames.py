"""What an estimator works on: rays in the mount frame, one array per record.

The *mount frame* is the jib frame as it would be if the camera hung straight: the picture turned by the nominal roll
and looked at from above, z along the optical axis and pointing back at the camera. Tilting the camera by β towards
an azimuth turns it into the jib frame, so gravity, seen in it, is ``(−sinβ cos az, −sinβ sin az, −cosβ)``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simgrab.errors import RecordError
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array, camera_rotation

# Short records are worked on in groups of about this many frames, and what takes many passes over a long one goes by
# stretches of as many: this bounds the memory and keeps the arrays in cache.
FRAMES_AT_ONCE = 1 << 16
LATEST_S = 1e12  # before or after 0: doubles resolve 0.1 ms there, and milliseconds since 1970 are no seconds


@dataclass(frozen=True)
class Frames:
    r"""M records of n frames.

    Attributes
    ----------
    rays : ndarray, shape (M, 3, n)
        Unit rays in the mount frame; zero where the frame is missing.
    present : ndarray of bool, shape (M, n), or None
        None when no frame is missing.
    count : ndarray, shape (M,)
        Frames present, as float.
    rope_length : ndarray, shape (M, n), or None
        \|OA\|, m.
    time : ndarray, shape (n,), or None
        Seconds.
    noise : ndarray, shape (M, n), or None
        Variance of each ray across itself, per axis, rad²; finite at missing frames too.
    """

    rays: Array
    present: NDArray[np.bool_] | None
    count: Array
    rope_length: Array | None
    time: Array | None
    noise: Array | None = None

    def mean(self, values: Array) -> Array:
        """Mean over the frames present, shape (..., n) → (...); ``values`` must be finite at missing frames too."""
        if self.present is None:
            return np.asarray(values.mean(axis=-1))
        present = self.present if values.ndim == 2 else self.present[:, None]
        count = self.count.reshape(-1, *[1] * (values.ndim - 2))
        return np.asarray((values * present).sum(axis=-1) / np.maximum(count, 1))

    def median(self, values: Array) -> Array:
        """Median over the frames present, shape (M, n) → (M,)."""
        # A missing frame is put beyond all others. numpy.median takes eight times as long as the partition.
        seen = values if self.present is None else np.where(self.present, values, np.inf)
        k = self.count.astype(np.int64)
        middle = np.stack([(k - 1) // 2, k // 2], axis=-1)
        parted = np.partition(seen, np.unique(middle), axis=-1)
        return np.asarray(np.take_along_axis(parted, middle, axis=-1).mean(axis=-1))

    def rows(self, keep: NDArray[np.bool_]) -> Frames:
        """Keep some of the records."""
        if keep.all():
            return self
        return Frames(
            self.rays[keep],
            None if self.present is None else self.present[keep],
            self.count[keep],
            None if self.rope_length is None else self.rope_length[keep],
            self.time,
            None if self.noise is None else self.noise[keep],
        )


def mount_from_camera(calibration: Calibration) -> Array:
    """Rotation, shape (3, 3), from the camera frame to the mount frame."""
    return camera_rotation(0.0, 0.0, np.deg2rad(calibration.roll_deg))


def check_record(
    pixels: ArrayLike,
    rope_length: ArrayLike | None,
    time: ArrayLike | None,
    ordered: bool,
    pixel_sd: ArrayLike | None = None,
) -> tuple[Array, Array | None, Array | None, Array | None]:
    """Shapes and values of a batch; raises `RecordError` with the row.

    Parameters
    ----------
    pixels : array_like, shape (M, n, 2)
    rope_length : array_like, shape (n,) or (M, n), optional
    time : array_like, shape (n,), optional
    ordered : bool
        Whether the times must increase.
    pixel_sd : array_like, shape (n,) or (M, n), optional
    """
    uv = np.asarray(pixels, float)
    if uv.ndim != 3 or uv.shape[-1] != 2:
        raise RecordError(f"pixels must have shape (M, n, 2), got {uv.shape}")
    m, n = uv.shape[:2]
    rope = t = sd = None
    if rope_length is not None:
        rope = np.asarray(rope_length, float)
        if rope.shape not in {(n,), (m, n)}:
            raise RecordError(f"rope_length must have shape ({n},) or ({m}, {n}), got {rope.shape}")
        bad = np.argwhere(~(np.isfinite(rope) & (rope > 0)))
        if bad.size:
            raise RecordError(f"rope_length, row {bad[0][-1]}: must be above 0 m, got {rope[tuple(bad[0])]:g}")
        rope = np.broadcast_to(rope, (m, n))
    if time is not None:
        t = np.asarray(time, float)
        if t.shape != (n,):
            raise RecordError(f"time must have shape ({n},), got {t.shape}")
        for row in np.flatnonzero(~np.isfinite(t))[:1]:
            raise RecordError(f"time, row {row}: must be finite, got {t[row]:g}")
        for row in np.flatnonzero(np.abs(t) > LATEST_S)[:1]:
            raise RecordError(f"time, row {row}: must lie within {LATEST_S:g} s of 0, got {t[row]:g}")
        back = np.flatnonzero(np.diff(t) <= 0)
        if ordered and back.size:
            row = back[0] + 1
            raise RecordError(f"time, row {row}: must increase, got {t[row]:g} s after {t[row - 1]:g} s")
    if pixel_sd is not None:
        sd = np.asarray(pixel_sd, float)
        if sd.shape not in {(n,), (m, n)}:
            raise RecordError(f"pixel_sd must have shape ({n},) or ({m}, {n}), got {sd.shape}")
        sd = np.broadcast_to(sd, (m, n))
        bad = np.argwhere(np.isfinite(uv).all(axis=-1) & ~(np.isfinite(sd) & (sd >= 0)))
        if bad.size:
            raise RecordError(f"pixel_sd, row {bad[0][-1]}: must be 0 px or more, got {sd[tuple(bad[0])]:g}")
    return uv, rope, t, sd


def groups(
    pixels: Array,
    rope: Array | None,
    time: Array | None,
    calibration: Calibration,
    pixel_sd: Array | None = None,
) -> Iterator[Frames]:
    """Rays of checked pixels (M, n, 2), as the picture has them, a few records at a time."""
    m, n = pixels.shape[:2]
    step = max(1, FRAMES_AT_ONCE // max(n, 1))
    for first in range(0, m, step):
        some = slice(first, min(first + step, m))
        frames = _frames(pixels[some], None if rope is None else rope[some], time, calibration)
        if pixel_sd is not None:
            noise = np.nan_to_num(pixel_sd[some] / calibration.focal_length_px) ** 2
            frames = replace(frames, noise=noise)
        yield frames


def stretches(values: Array, frames: int = FRAMES_AT_ONCE) -> Iterator[slice]:
    """Slices of the last axis of an array (M, ..., n), of about so many frames of the M records together."""
    n = values.shape[-1]
    step = max(frames // len(values), 1)
    for first in range(0, n, step):
        yield slice(first, first + step)


def _frames(pixels: Array, rope: Array | None, time: Array | None, calibration: Calibration) -> Frames:
    camera = calibration.intrinsics
    m, n = pixels.shape[:2]
    xy = np.empty((m, 2, n))
    np.subtract(pixels.swapaxes(1, 2), np.array([[camera.cx_px], [camera.cy_px]]), out=xy)
    xy /= camera.f_px
    if not camera.distortion.is_null:
        xy = camera.distortion.remove(xy.swapaxes(1, 2)).swapaxes(1, 2)
    rays = np.empty((m, 3, n))
    np.matmul(mount_from_camera(calibration)[:2, :2], xy, out=rays[:, :2])
    length = xy[:, 0] * xy[:, 0]
    length += xy[:, 1] * xy[:, 1]
    length += 1
    np.sqrt(length, out=length)
    np.divide(-1, length, out=rays[:, 2])
    rays[:, 0] /= length
    rays[:, 1] /= length
    present = np.isfinite(length)
    if present.all():
        return Frames(rays, None, np.full(m, float(n)), rope, time)
    rays = np.where(present[:, None], rays, 0.0)
    return Frames(rays, present, present.sum(axis=-1).astype(float), rope, time)


def gravity(beta: ArrayLike, azimuth: ArrayLike) -> Array:
    """Direction of gravity in the mount frame, shape (..., 3)."""
    b, a = np.broadcast_arrays(np.asarray(beta, float), np.asarray(azimuth, float))
    return np.stack([-np.sin(b) * np.cos(a), -np.sin(b) * np.sin(a), -np.cos(b)], axis=-1)


def tilt_of(down: ArrayLike) -> tuple[Array, Array]:
    """Tilt (β, azimuth in [0, 2π)) of gravity ``down``, shape (..., 3), mount frame; inverse of `gravity`."""
    g = np.asarray(down, float)
    return (
        np.arctan2(np.hypot(g[..., 0], g[..., 1]), -g[..., 2]),
        np.arctan2(-g[..., 1], -g[..., 0]) % (2 * np.pi),
    )


def tangent_basis(beta: Array, azimuth: Array) -> Array:
    """Rows: where gravity moves as β grows and as the azimuth does, and gravity; shape (..., 3, 3), mount frame."""
    s, c = np.sin(azimuth), np.cos(azimuth)
    along = np.stack([-np.cos(beta) * c, -np.cos(beta) * s, np.sin(beta)], axis=-1)
    across = np.stack([s, -c, np.zeros_like(s)], axis=-1)
    return np.stack([along, across, gravity(beta, azimuth)], axis=-2)
