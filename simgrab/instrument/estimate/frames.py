"""The input of estimators: rays in the mount frame, one array per record.

The *mount frame* equals the jib frame if the camera hangs straight. Its z points back along the optical axis at the
camera; x and y are those of the picture, turned by the nominal roll. Tilting the camera by β towards an azimuth turns
it into the jib frame, so gravity, seen in it, is ``(−sinβ cos az, −sinβ sin az, −cosβ)``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simgrab.errors import RecordError
from simgrab.instrument.estimate.intervals import LEAN_BY_MOUNT
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array, camera_rotation

# Records are worked on in groups of about this many frames, which bounds the memory.
FRAMES_AT_ONCE = 1 << 16
LATEST_S = 1e12  # before or after 0: doubles resolve 0.1 ms there, and milliseconds since 1970 are no seconds


@dataclass(frozen=True)
class Frames:
    """M records of n frames."""

    rays: Array  # (M, 3, n), unit rays in the mount frame; zero where the frame is missing
    present: NDArray[np.bool_]  # (M, n)
    rope_length: Array | None  # (M, n), |OA|, m
    time: Array | None  # (n,), seconds
    # (M, n), variance of each ray across itself, per axis, rad², by the pixel and by a mount on which the camera
    # leans as the crane works; finite at missing frames too
    noise: Array

    @cached_property
    def count(self) -> Array:
        """How many frames of each record are present, (M,), as float."""
        return np.asarray(self.present.sum(axis=-1), float)

    def mean(self, values: Array) -> Array:
        """Mean over the frames present, shape (..., n) → (...); ``values`` must be finite at missing frames too."""
        if self.present.all():
            return np.asarray(values.mean(axis=-1))
        present = self.present if values.ndim == 2 else self.present[:, None]
        count = self.count.reshape(-1, *[1] * (values.ndim - 2))
        return np.asarray((values * present).sum(axis=-1) / np.maximum(count, 1))

    def places(self) -> Array:
        """Ray's x and y over the depth in the frames of the only record (n, 2); 0 where one is missing."""
        return (self.rays[0, :2] / np.where(self.present[0], -self.rays[0, 2], 1.0)).T

    def rows(self, keep: NDArray[np.bool_]) -> Frames:
        """Keep some of the records."""
        if keep.all():
            return self
        rope = None if self.rope_length is None else self.rope_length[keep]
        return Frames(self.rays[keep], self.present[keep], rope, self.time, self.noise[keep])


def interpolated(at: NDArray[Any], time: NDArray[Any], values: Array) -> Array:
    """Interpolate values (n, k) at increasing times (n,) linearly at other times (m,): shape (m, k)."""
    return np.stack([np.interp(at, time, column) for column in values.T], axis=-1)


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
    """Check shapes and values of a batch; raises `RecordError` with the row.

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
    """Yield rays of checked pixels (M, n, 2), as the picture has them, a few records at a time.

    Without times the frames are independent, and no mount leans.
    """
    lean = 0.0 if time is None else LEAN_BY_MOUNT.get(calibration.mount, 0.0)
    m, n = pixels.shape[:2]
    step = max(1, FRAMES_AT_ONCE // max(n, 1))
    for some in (slice(first, first + step) for first in range(0, max(m, 1), step)):
        towards = calibration.intrinsics.rays(pixels[some]) @ mount_from_camera(calibration).T
        rays = np.ascontiguousarray(towards.swapaxes(1, 2))
        present = np.isfinite(rays[:, 0])
        rays = np.where(present[:, None], rays, 0.0)
        length = None if rope is None else rope[some]
        noise = np.full(present.shape, lean**2)
        if pixel_sd is not None:
            noise += np.nan_to_num(pixel_sd[some] / calibration.focal_length_px) ** 2
        yield Frames(rays, present, length, time, noise)


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
    """Return rows (..., 3, 3), mount frame: where gravity moves as β grows, where as the azimuth grows, and gravity."""
    s, c = np.sin(azimuth), np.cos(azimuth)
    along = np.stack([-np.cos(beta) * c, -np.cos(beta) * s, np.sin(beta)], axis=-1)
    across = np.stack([s, -c, np.zeros_like(s)], axis=-1)
    return np.stack([along, across, gravity(beta, azimuth)], axis=-2)
