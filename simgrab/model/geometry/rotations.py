"""Rotations, poses and angles of the camera and of the swing."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
STANDARD_GRAVITY = 9.80665
"""m/s², by definition."""

# Columns: camera x, y, z in the jib frame, looking straight down with the picture's top outboard.
_STRAIGHT_DOWN = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def rotation_z(angle: ArrayLike) -> Array:
    """Rotation about z, shape (..., 3, 3), counter-clockwise seen from +z."""
    c, s = np.cos(np.asarray(angle, float)), np.sin(np.asarray(angle, float))
    o, i = np.zeros_like(c), np.ones_like(c)
    return np.stack([c, -s, o, s, c, o, o, o, i], axis=-1).reshape(*c.shape, 3, 3)


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


def to_camera(points_jib: ArrayLike, rotation: ArrayLike, offset: ArrayLike) -> Array:
    """Express jib-frame points (..., 3) in the camera frame, from ``jib_from_camera``'s rotation and offset."""
    delta = np.asarray(points_jib, float) - np.asarray(offset, float)
    return np.einsum("...ji,...j->...i", np.asarray(rotation, float), delta)


def on_ropes(camera: Array, ray: Array, rope: Array | float) -> Array:
    r"""Where rays (n, 3) from a camera (..., 3) meet the sphere about O whose radius is \|OA\|, ``rope`` (n,): (n, 3).

    Of a rope that is too short to be met, the place on the ray that is nearest to O.
    """
    ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    along = np.sum(ray * camera, axis=-1)
    reach = np.sqrt(np.maximum(along**2 + rope**2 - np.sum(camera**2, axis=-1), 0)) - along
    return np.asarray(camera + reach[:, None] * ray)


def vertical_direction(azimuth: ArrayLike, roll: ArrayLike) -> Array:
    """Direction C'G' in the picture, clockwise from its x axis, rad.

    G' is the vanishing point of gravity. Its direction from the principal point depends on tilt azimuth and roll alone,
    so it is defined at β = 0 too.
    """
    return np.asarray(np.pi / 2 - np.asarray(azimuth, float) - np.asarray(roll, float))


def wrap(angle: ArrayLike) -> Array:
    """Wrap angles into (−π, π]."""
    return np.asarray(np.pi - (np.pi - np.asarray(angle, float)) % (2 * np.pi))
