"""Which single mistake of a pipeline would explain the errors of its angles."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from simgrab.model.geometry import Array, Pose
from simgrab.model.truth import Row

MOST_LATE, FEWEST, ENOUGH = 50, 10, 24  # frames; enough for two mistakes at once
FOCAL = (0.6, 1.7)  # factors that a focal length explains; one of degrees for radians is far from them
NEAR = 0.25  # how far a factor may be from 0 of what is left out, or from -1 of what has the opposite sign
CLEARLY = 1.2  # times the next best explanation's error
NOTHING = 1e-6  # rad, below which errors are rounding
ROPE_SHARE = 0.25  # of the lengths' error, which a factor or a constant must leave at most


class Mistake(NamedTuple):
    """What explains errors of angles, or nothing that has a name, and the errors (n,), rad, that it leaves.

    ``fitted`` is the number of parameters that were fitted to these errors, and ``of_tilt`` whether they are of a tilt,
    which may be wrong because of something else.
    """

    text: str
    left: Array
    fitted: int = 0
    of_tilt: bool = False

    @property
    def rms(self) -> float:
        """Root mean square of what it leaves, rad, for a fit to any number of frames; infinite for too few."""
        some = self.left[np.isfinite(self.left)]
        if len(some) < min(FEWEST, len(self.left)):
            return math.inf
        return float(np.sqrt(np.sum(some**2) / max(len(some) - self.fitted, 1)))


def likely(measured: Array, true: Array, rows: Sequence[Row | None], time: Array | None) -> Mistake | None:
    """Find the mistake that leaves the least errors: at most half of them, and clearly less than any other.

    Parameters
    ----------
    measured, true : ndarray, shape (n,)
        Swing, rad, in the order of the frames; NaN where it is not known.
    rows : sequence of n Row or None
    time : ndarray, shape (n,), or None
        s; None for independent frames.
    """
    known = np.flatnonzero(np.isfinite(measured) & np.isfinite(true)).tolist()
    some = [row for row in (rows[i] for i in known) if row is not None]
    if len(some) < FEWEST:
        return None
    found = [_late("The measured angles", measured, true, time)]
    for one in _of_geometry(measured[known], true[known], some):
        left = np.full(len(true), np.nan)
        left[known] = one.left
        found.append(one._replace(left=left))
    best, second, *_ = sorted(found, key=lambda one: one.rms)
    as_it_is = Mistake("", measured - true).rms
    return best if best.text and best.rms < min(as_it_is / 2, second.rms / CLEARLY) else None


def _late(what: str, measured: Array, true: Array, time: Array | None) -> Mistake:
    """Compare with the truth of other frames."""
    most, found = min(MOST_LATE, len(true) // 3), dict[int, Mistake]()
    for n in (*range(-most, 0), *range(1, most + 1)):
        of_others = np.roll(true, n)
        of_others[slice(n) if n > 0 else slice(n, None)] = np.nan
        found[n] = Mistake("", measured - of_others)
    n = min(found, key=lambda n: found[n].rms)
    seconds = "" if time is None else f" ({abs(n) * float(np.median(np.diff(time))):.2f} s)"
    frames = f"{abs(n)} frame{'s' * (abs(n) > 1)}{seconds}"
    return found[n]._replace(text=f"{what} are those of {frames} {'before' if n > 0 else 'after'} theirs")


def _of_geometry(measured: Array, true: Array, rows: Sequence[Row]) -> list[Mistake]:
    """Explain by a tilt, a focal length, an offset or the lens's distortion, and by a constant.

    With one of the others wrong, the tilt may be right, or be estimated from the same record: only where that explains
    clearly more than a wrong tilt alone.
    """
    camera = Pose.from_matrix(np.reshape([row.jib_from_camera for row in rows], (-1, 3, 4)))
    grab = np.reshape([row.jib_from_grab for row in rows], (-1, 3, 4))[..., 3]
    swing, ray, axis = _level(grab), _level(grab - camera.translation), camera.rotation[:, :2, 2]

    def fitted(predict: Callable[[Array], Array], *start: float) -> tuple[Array, Array]:
        x = least_squares(lambda x: predict(x) - measured, start).x
        return x, measured - predict(x)

    def of(error: Array) -> Array:
        return np.arcsin(np.clip(np.linalg.norm(swing + error, axis=1), 0, 1))

    lean, left = fitted(of, 1e-3, 1e-3)
    tilt = axis.mean(axis=0)
    deg, part = np.degrees(np.linalg.norm(tilt)), np.linalg.norm(tilt) / 5
    signs = {
        1: f", as if the tilt of {deg:.1f}° were left out",
        2: f", as if the tilt of {deg:.1f}° had the opposite sign",
    }
    why = next((text for n, text in signs.items() if np.linalg.norm(lean + n * tilt) < part), "")
    wrong = f"with a camera tilt that is {np.degrees(np.linalg.norm(lean)):.2f}° wrong{why}"
    tilted = Mistake(wrong, left, 2, of_tilt=True)

    def least(*found: tuple[Array, Array], text: Callable[[float], str]) -> Mistake:
        """Take the explanation that leaves the least, by a factor alone, or with a tilt, of which more is asked."""
        named = [Mistake(text(float(x[0])), left, len(x)) for x, left in found]
        most = tilted.rms / CLEARLY**2 - NOTHING if len(true) >= ENOUGH else -math.inf
        return min((m for m in named if m.fitted == 1 or (m.text and m.rms < most)), key=lambda m: m.rms)

    def of_what(what: str, error: Array) -> Mistake:
        """Explain by a factor of what moves the swing (n, 2) by an error where it is left out."""

        def text(factor: float) -> str:
            how = (
                "left out" if abs(factor) < NEAR else "applied with the opposite sign" if abs(factor + 1) < NEAR else ""
            )
            return how and f"if {what} were {how}"

        return least(
            fitted(lambda x: of((1 - x[0]) * error), 0.0),
            fitted(lambda x: of((1 - x[0]) * error + x[1:]), 0.0, 1e-3, 1e-3),
            text=text,
        )

    f_px, across = rows[0].fx_px, float(np.linalg.norm(camera.translation[:, :2].mean(axis=0)))
    focal = least(
        fitted(lambda x: np.arctan(x[0] * np.tan(true)), 1.0),
        fitted(lambda x: of((x[0] - 1) * (ray - axis)), 1.0),
        fitted(lambda x: of((x[0] - 1) * (ray - axis) + x[1:]), 1.0, 1e-3, 1e-3),
        text=lambda x: (
            f"with a focal length of {f_px / x:.0f} px in place of {f_px:.0f} px" * (FOCAL[0] < x < FOCAL[1])
        ),
    )
    offset = of_what(
        f"the camera's offset of {across:.2f} m",
        -camera.translation[:, :2] / np.linalg.norm(grab, axis=1, keepdims=True),
    )
    found = [tilted, focal, offset]
    if offset.text and max(offset.rms, tilted.rms) < CLEARLY * min(offset.rms, tilted.rms):
        found = [tilted._replace(text=f"{offset.text}, or {tilted.text}"), focal]
    pixels = np.array([[row.grab_u_px, row.grab_v_px, row.ideal_u_px, row.ideal_v_px] for row in rows], float)
    if any(row.k1 or row.k2 for row in rows) and np.isfinite(pixels).all():
        middle = np.array([[row.cx_px, row.cy_px] for row in rows])
        flat = (pixels.reshape(-1, 2, 2) - middle[:, None]) / f_px
        bent, straight = np.moveaxis(np.concatenate([flat, np.ones_like(flat[..., :1])], axis=-1), 1, 0)
        bent, straight = (_level(np.einsum("nij,nj->ni", camera.rotation, rays)) for rays in (bent, straight))
        found.append(of_what("the lens's distortion", bent - straight))
    as_with = [one._replace(text=one.text and f"The angles are as {one.text}") for one in found]
    return [*as_with, Mistake("", measured - true - np.mean(measured - true))]


def _level(vectors: Array) -> Array:
    """Horizontal components of the directions of vectors (n, 3)."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))[:, :2]


def of_rope(read: Array, true: Array, time: Array | None = None) -> Mistake | None:
    r"""Find by which factor, constant or delay the lengths \|OA\| (n,), m, of a pipeline err; None if by none."""
    known = np.isfinite(read) & np.isfinite(true)
    if known.sum() < FEWEST:
        return None
    factor, constant = float(np.median(read[known] / true[known])), float(np.median((read - true)[known]))
    side = "long" if constant > 0 else "short"
    found = (
        Mistake(f"Rope lengths are {factor:.3g} times the true ones", read / (factor or 1.0) - true),
        Mistake(f"Rope lengths are {abs(constant):.2f} m too {side}", read - constant - true),
        *([_late("Rope lengths", read, true, time)] if time is not None else ()),
    )
    best = min(found, key=lambda one: one.rms)
    return best if best.rms < ROPE_SHARE * Mistake("", read - true).rms else None
