"""Which single mistake of a pipeline would explain the errors of its angles."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares, minimize_scalar
from scipy.spatial.transform import Rotation

from simgrab.model.geometry import Array, Pose, camera_rotation, on_ropes, swing_of, wrap
from simgrab.model.truth import Row

MOST_LATE, FEWEST, ENOUGH = 50, 10, 24  # frames; enough for an offset and a tilt at once
FOCAL = (0.6, 1.7)  # factors that a focal length explains; one of degrees for radians is far from them
NEAR = 0.15  # how far a factor may be from 0 of what is left out, or from -1 of what has the opposite sign
CLEARLY, AS_GOOD = 1.2, 1.05  # times the next best explanation's error
LEAST_SWING = 0.2  # of the angle that the offset makes, below which the swing shows no direction
MOST_TILT = math.radians(8.0)  # by which a tilt is wrong beside something else, if in no usual way
LEAST_ROLL = math.radians(1.0)  # below which a roll is not named
MOST_OFFSET_M, SAME_M = 3.0, 0.01  # horizontally; among the frames of one camera
EXACT = 0.1  # of the errors, which an exchange of axes must leave at most: there are several to choose from
AXES = "x and y of the image were exchanged"
NOTHING = 1e-6  # rad, below which errors are rounding
LEAST_SHARE = 0.01  # of the errors, below which it does not matter which explanation leaves less
ROPE_SHARE = 0.25  # of the lengths' error, which a factor, a constant or a delay must leave at most
FITTED_S = 0.1  # how well a delay is found


class Mistake(NamedTuple):
    """What explains errors, or nothing that has a name, and the errors (n,) that it leaves, of angles in rad.

    ``fitted`` is the number of parameters that were fitted to these errors, ``of_tilt`` whether they are of a tilt,
    which may be wrong because of something else, ``any_offset`` whether of an offset that is wrong in no usual way, and
    ``own`` whether they are the display's own delay.
    """

    text: str
    left: Array
    fitted: int = 0
    of_tilt: bool = False
    any_offset: bool = False
    own: bool = False

    @property
    def alternatives(self) -> tuple[str, ...]:
        """The mistakes of which it may be one."""
        first, *others = self.text.split(", or ")
        beginning = "The angles are as " if first.startswith("The angles") else "Rope lengths are "
        return (first, *(f"{beginning}{other}" for other in others))

    @property
    def rms(self) -> float:
        """Root mean square of what it leaves, rad, over the frames beyond its parameters; infinite for too few."""
        some = self.left[np.isfinite(self.left)]
        if len(some) < min(FEWEST, len(self.left)):
            return math.inf
        return max(float(np.sqrt(np.sum(np.abs(some) ** 2) / max(len(some) - self.fitted, 1))), NOTHING)


def likely(
    measured: Array, true: Array, rows: Sequence[Row | None], time: Array | None, *, grab: Array | None = None,
    rope_known: bool = False,
) -> Mistake | None:  # fmt: skip
    """Find the mistake that leaves the least errors: at most half of them, and clearly less than any other.

    Parameters
    ----------
    measured, true : ndarray, shape (n,)
        Swing, rad, in the order of the frames; NaN where it is not known.
    rows : sequence of n Row or None
    time : ndarray, shape (n,), or None
        s; None for independent frames.
    grab : ndarray, shape (n, 3), optional
        Grab centres of these swings, m, jib frame, in place of the rows'.
    rope_known : bool
        Whether the rope lengths that these angles follow from are known to be right.
    """
    known = np.flatnonzero(np.isfinite(measured) & np.isfinite(true)).tolist()
    some = [row for row in (rows[i] for i in known) if row is not None]
    if len(some) < FEWEST:
        return None
    found = [_late("The measured angles", measured, true, time)]
    places = np.reshape([row.jib_from_grab for row in some], (-1, 3, 4))[..., 3] if grab is None else grab[known]
    for one in _of_geometry(measured[known], true[known], some, places, rope_known=rope_known):
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
        found[n] = Mistake("", measured - of_others, 1)
    n = min(found, key=lambda n: found[n].rms)
    seconds = "" if time is None else f" ({abs(n) * float(np.median(np.diff(time))):.2f} s)"
    frames = f"{abs(n)} frame{'s' * (abs(n) > 1)}{seconds}"
    return found[n]._replace(text=f"{what} are those of {frames} {'before' if n > 0 else 'after'} theirs")


def _of_geometry(
    measured: Array, true: Array, rows: Sequence[Row], grab: Array, *, rope_known: bool
) -> list[Mistake]:  # fmt: skip
    """Explain by a tilt, a roll, an exchange of x and y, a focal length, an offset, the lens, and by a constant."""
    camera = Pose.from_matrix(np.reshape([row.jib_from_camera for row in rows], (-1, 3, 4)))
    f_px, axis, offset = rows[0].fx_px, camera.rotation[:, :2, 2], camera.translation[:, :2]
    per_m = 1 / np.linalg.norm(grab, axis=1, keepdims=True)
    least = LEAST_SHARE * Mistake("", measured - true).rms
    fits = _Fits(measured, _level(grab), camera.translation * per_m, axis.mean(axis=0), least)

    def lens(factor: float) -> str:
        if not FOCAL[0] < factor < FOCAL[1]:
            return ""
        wrong = f"{100 * abs(1 / factor - 1):.1f} % too {'long' if factor < 1 else 'short'}"
        return f"with a focal length of {f_px / factor:.0f} px in place of {f_px:.0f} px ({wrong})"

    tilt = fits.tilt
    (factor,), left = fits.fit(lambda x: np.arctan(x[0] * np.tan(true)), 1.0)
    of_lens = fits.factor(_level(grab - camera.translation) - axis, lens)
    of_angle = Mistake(lens(factor), left, 1)
    focal = min(of_lens, of_angle, key=lambda one: one.rms)
    if focal.text and not focal.of_tilt and of_angle.rms < EXACT * Mistake("", measured - true).rms:
        focal = focal._replace(text=f"{focal.text}, or if multiplied by {factor:.2f}")
    shift = _of_offset(fits, offset, per_m, rope_known=rope_known)
    poses = [tilt, shift] if shift.any_offset else [shift, tilt]
    exchange = _exchanged(measured, camera, rows, grab)
    of_axes = AXES in exchange.text
    poses = poses if of_axes else [*poses, exchange]
    rolls = np.radians([row.roll_deg for row in rows])
    turn = fits.roll(float(rolls[0]))
    if np.abs(wrap(rolls - rolls[0])).max() < LEAST_ROLL:
        poses = [turn, *poses] if turn.text.startswith("if ") else [*poses, turn]
    poses = [exchange, *poses] if of_axes else poses
    most = CLEARLY * max(min(one.rms for one in poses), least)
    alike = [one for one in poses if one.rms < most]  # as on a rope of constant length
    if any(one is turn for one in alike) and shift.fitted > 2:  # a tilt beside an offset explains much
        alike = [one for one in alike if one is not shift]
    chosen = next((one for one in alike if one.of_tilt), alike[0])
    found = [chosen._replace(text=", or ".join(one.text for one in alike if one.text)), focal]
    found += [one for one in poses if one.rms >= most]
    bent, straight = (_along(camera, rows, of) for of in ("grab", "ideal"))
    if np.isfinite(bent).all() and np.abs(bent - straight).max() > NOTHING:
        found.append(fits.factor(straight - bent, _applied("the lens's distortion")))
    as_with = [one._replace(text=one.text and f"The angles are as {one.text}") for one in found]
    return [*as_with, Mistake("", measured - true - np.mean(measured - true), 1)]


def _exchanged(measured: Array, camera: Pose, rows: Sequence[Row], grab: Array) -> Mistake:
    """Explain by an exchange of x and y of the image or about the principal point, or of its sides.

    The tilt and the offset are applied, or left out as well.
    """
    local = np.einsum("nji,nj->ni", camera.rotation, grab - camera.translation)
    x, y = (local[:, :2] / local[:, 2:]).T
    rope, level = np.linalg.norm(grab, axis=1), camera_rotation(0.0, 0.0, np.radians([row.roll_deg for row in rows]))
    by = (rows[0].cx_px - rows[0].cy_px) / rows[0].fx_px
    exchanges = (
        (AXES, ((y, x), (y - by, x + by))),
        ("left and right of the image were exchanged", ((-x, y),)),
        ("top and bottom of the image were exchanged", ((x, -y),)),
        ("the image were turned upside down", ((-x, -y),)),
    )
    found, whole = [Mistake("", np.full(len(measured), np.nan))], Mistake("", measured - swing_of(grab)[0]).rms
    for rotation, tilt in ((camera.rotation, ""), (level, "tilt")):
        for place, offset in ((camera.translation, ""), (0 * camera.translation, "offset")):

            def left(of: tuple[Array, Array], place: Array = place, rotation: Array = rotation) -> Array:
                ray = np.column_stack([*of, np.ones(len(rows))])
                return measured - swing_of(on_ropes(place, np.einsum("nij,nj->ni", rotation, ray), rope))[0]

            out = " and the ".join(filter(None, (tilt, offset)))
            most = min(Mistake("", left((x, y))).rms / 2, EXACT * whole)  # where it changes little, it is not named
            for what, ways in exchanges:
                text = f"if {what}{f', and the {out} left out' if out else ''}"
                found += [one for way in ways if (one := Mistake(text, left(way))).rms < most]
    return min(found, key=lambda one: one.rms)


_UNMOVED = np.zeros(2)


@dataclass(frozen=True, eq=False)
class _Fits:
    """Explanations of measured swings (n,), rad, by what moves the direction of the true swing, jib x and y (n, 2).

    ``camera`` (n, 3) is where the camera is, in lengths of the rope, ``axis`` (2,) the mean of the optical axis. Errors
    of less than ``least``, rad, say nothing about which explanation is right.
    """

    measured: Array
    swing: Array
    camera: Array
    axis: Array
    least: float

    def fit(self, predict: Callable[[Array], Array], *start: float) -> tuple[Array, Array]:
        """Fit parameters; returns them and the errors (n,) that they leave."""
        x = least_squares(lambda x: predict(x) - self.measured, start, method="lm").x
        return x, self.measured - predict(x)

    def _moved(
        self, by: Array | float = 0.0, lean: Array = _UNMOVED, shift: Array = _UNMOVED, turn: Array = _UNMOVED
    ) -> Array:  # fmt: skip
        """Swings (n,), rad, as they follow from mistakes.

        Directions of which the horizontal parts are moved, a tilt that is wrong by (2,), rad, a camera that is
        taken to be elsewhere by (n, 2), in lengths of the rope, and one that is turned by a vector (3,), rad. The rope
        is as long as before.
        """
        level = self.swing + by
        grab = np.column_stack([level, -np.sqrt(np.maximum(1 - np.sum(level**2, axis=1), 0))])
        if lean.any() or shift.any() or turn.any():
            turned = turn if turn.any() else (lean[1], -lean[0], 0.0)
            camera = self.camera.copy()
            camera[:, :2] += shift
            grab = on_ropes(camera, (grab - self.camera) @ Rotation.from_rotvec(turned).as_matrix().T, 1.0)
        return swing_of(grab)[0]

    @cached_property
    def lean(self) -> tuple[Array, Array]:
        """By how much the tilt is wrong if nothing else is, (2,), rad, and the errors (n,) that this leaves."""
        return self.fit(lambda lean: self._moved(lean=lean), 1e-3, 1e-3)

    @property
    def tilt(self) -> Mistake:
        """Explain by a tilt that is wrong."""
        lean, left = self.lean
        return Mistake(self._wrong(lean), left, 2, of_tilt=True)

    def _wrong(self, lean: Array) -> str:
        tilt = float(np.linalg.norm(self.axis))
        used = self.axis + lean
        size, (azimuth, true) = np.degrees(np.linalg.norm(used)), map(_azimuth, (used, self.axis))
        text = f"with a camera tilt that is {np.degrees(np.linalg.norm(lean)):.2f}° wrong"
        for times, how in ((1, "were left out"), (2, "had the opposite sign")):
            if np.linalg.norm(lean + times * self.axis) < tilt / 5:
                return f"{text}, as if the tilt of {np.degrees(tilt):.1f}° {how}"
        place = f"in place of {np.degrees(tilt):.1f}° with {true}°"
        return f"{text}, {size:.1f}° with an azimuth of {azimuth}° {place}"

    def roll(self, roll: float) -> Mistake:
        """Explain by a roll, rad, that is wrong: the rays are turned about the optical axis."""
        axis = np.append(self.axis, -math.sqrt(1 - self.axis @ self.axis))
        fits = [self.fit(lambda x: self._moved(turn=x[0] * axis), start) for start in (-0.3, 0.3)]
        (by,), left = min(fits, key=lambda fit: float(fit[1] @ fit[1]))
        if abs(wrap(by)) < LEAST_ROLL:
            return Mistake("", left, 1)
        for times, how in ((1, "left out"), (2, "applied with the opposite sign")):
            whole = abs(wrap(times * roll))
            if whole > LEAST_ROLL and abs(wrap(by + times * roll)) < NEAR * whole:
                return Mistake(f"if the camera's roll of {math.degrees(roll):.1f}° were {how}", left, 1)
        used = math.degrees(wrap(roll + by))
        return Mistake(f"with a camera roll of {used:.1f}° in place of {math.degrees(roll):.1f}°", left, 1)

    def factor(
        self, unit: Array, text: Callable[[float], str], start: float = 0.5, *, of_camera: bool = False
    ) -> Mistake:  # fmt: skip
        """Explain by a factor, sought from ``start``, of what a unit (n, 2) moves."""
        return self.explain(
            lambda x: (x[0] - 1) * unit, np.full(1, start), np.ones(1), lambda x: text(float(x[0])), of_camera=of_camera
        )  # fmt: skip

    def explain(
        self, by: Callable[[Array], Array], start: Array, nothing: Array, text: Callable[[Array], str], *,
        of_camera: bool,
    ) -> Mistake:  # fmt: skip
        """Explain by parameters (k,) of what moves the swing, or the camera, alone or with a tilt that is estimated.

        The latter only if they have a text, there are enough frames for all parameters, and a wrong tilt alone
        explains far less, since more parameters leave less anyway. A tilt larger than they can cause, as in wind, is a
        mistake of its own, and named beside them. ``nothing`` are those that move nothing.
        """
        k = len(start)

        def moved(x: Array, lean: Array = _UNMOVED) -> Array:
            return self._moved(lean=lean, shift=by(x)) if of_camera else self._moved(by(x), lean)

        x, left = self.fit(moved, *start)
        alone = Mistake(text(x), left, k)
        starts = (*start, 1e-3, 1e-3), (*nothing, *self.lean[0])
        fits = [self.fit(lambda x: moved(x[:k], x[k:]), *start) for start in starts]
        x, left = min(fits, key=lambda fit: float(fit[1] @ fit[1]))
        beside = Mistake(text(x[:k]), left, k + 2)
        if np.linalg.norm(x[k:]) > 2 * np.sqrt(np.mean(np.sum(by(x[:k]) ** 2, axis=1))):
            wrong = self._wrong(x[k:])
            plausible = "as if" in wrong or np.linalg.norm(x[k:]) < MOST_TILT
            beside = Mistake(f"{beside.text}, and {wrong}" * bool(beside.text and plausible), left, k + 2, of_tilt=True)
        far = len(self.swing) >= ENOUGH and max(beside.rms, self.least) < self.tilt.rms / CLEARLY**2
        return beside if beside.text and far and AS_GOOD * beside.rms < alone.rms else alone


def _azimuth(vector: Array) -> int:
    """Whole degrees of a vector's (2,) azimuth."""
    return round(np.degrees(np.arctan2(vector[1], vector[0]))) % 360


def _applied(what: str) -> Callable[[float], str]:
    """Return the function that names a factor of something: 0 if it is left out, -1 if its sign is wrong."""

    def text(factor: float) -> str:
        for wrong, how in ((0.0, "left out"), (-1.0, "applied with the opposite sign")):
            if abs(factor - wrong) < NEAR:
                return f"if {what} were {how}"
        return ""

    return text


def _of_offset(fits: _Fits, offset: Array, per_m: Array, *, rope_known: bool) -> Mistake:
    """Explain by a horizontal offset of the camera (n, 2), m, that is wrong in a usual way, or in any.

    ``per_m`` (n, 1) is by how much 1 m moves the swing. Of a grab that hangs still, the direction does not follow from
    the angle, so only an offset that is left out or mirrored is named.
    """
    mean = np.round(offset.mean(axis=0), 6) + 0.0  # no -0.00
    across = np.linalg.norm(offset, axis=1).mean()

    def share(factor: float) -> str:  # on ropes taken to be too long, the camera seems to be nearer to the exit
        if not 1 / 5 < factor < 5:
            return ""
        ropes = "" if rope_known else f"with rope lengths that are {1 / factor:.3g} times the true ones, or "
        return f"{ropes}with {factor:.2f} times the camera's horizontal offset of {across:.2f} m"

    def exchanged(factor: float) -> str:
        return "if x and y of the camera's offset were exchanged" if abs(factor - 2) < NEAR else ""

    def other(by: Array) -> str:
        (x, y), (u, v) = mean, np.round(mean + by, 2) + 0.0
        text = f"with a horizontal camera offset of ({u:.2f}, {v:.2f}) m in place of ({x:.2f}, {y:.2f}) m"
        return text if max(abs(u), abs(v)) < MOST_OFFSET_M else ""

    applied = fits.factor(offset * per_m, _applied(f"the camera's horizontal offset of {across:.2f} m"), of_camera=True)
    if np.sqrt(np.mean(np.sum(fits.swing**2, axis=1))) < LEAST_SWING * across * per_m.mean():
        return applied
    swapped = fits.factor((offset[:, ::-1] - offset) * per_m, exchanged, 1.5, of_camera=True)
    found = [(applied, CLEARLY), (swapped, CLEARLY), (fits.factor(offset * per_m, share, of_camera=True), AS_GOOD)]
    if np.ptp(offset, axis=0).max() < SAME_M:
        least = fits.explain(lambda x: x * per_m, np.full(2, 1e-3), np.zeros(2), other, of_camera=True)
        tilt = ", and the tilt that is estimated with it" * bool(least.text and least.fitted > 2 and not least.of_tilt)
        found.append((least._replace(text=least.text + tilt, any_offset=True), AS_GOOD))
    best = min(one.rms for one, _ in found)
    fitting = [one for one, most in found if one.text and one.rms <= most * best]
    chosen = min(fitting, key=lambda one: one.fitted, default=found[-1][0])  # a tilt beside an offset explains much
    alike = [one for one in (applied, swapped) if one.text and one.rms < CLEARLY * chosen.rms]
    if not any(one is chosen for one in alike):
        return chosen
    return chosen._replace(text=", or ".join(one.text for one in alike))


def _along(camera: Pose, rows: Sequence[Row], of: str) -> Array:
    """Horizontal components (n, 2) of rays through the grab's centre, ``grab`` or ``ideal``: without distortion."""
    pixels = np.array([[getattr(row, f"{of}_u_px"), getattr(row, f"{of}_v_px")] for row in rows], float)
    middle = np.array([[row.cx_px, row.cy_px] for row in rows])
    rays = np.column_stack([(pixels - middle) / rows[0].fx_px, np.ones(len(rows))])
    return _level(np.einsum("nij,nj->ni", camera.rotation, rays))


def _level(vectors: Array) -> Array:
    """Horizontal components of the directions of vectors (n, 3)."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))[:, :2]


def of_centres(found: Array, true: Array, time: Array | None) -> Mistake | None:
    """Find whether pixels (n, 2) are those of other frames: then their errors are far smaller than here."""
    pixels, places = found @ [1, 1j], true @ [1, 1j]
    if (np.isfinite(pixels) & np.isfinite(places)).sum() < FEWEST:
        return None
    late = _late("The measured centres", pixels, places, time)
    return late if late.rms < Mistake("", pixels - places).rms / 2 else None


def of_rope(
    read: Array, true: Array, time: Array | None = None, *, ages_s: tuple[float, float] | None = None
) -> Mistake | None:  # fmt: skip
    r"""Find by which factor, constant or delay the lengths \|OA\| (n,), m, of a pipeline err; None if by none.

    ``ages_s`` are the least and the greatest age of lengths on the display, which are a part of a delay.
    """
    if (np.isfinite(read) & np.isfinite(true)).sum() < FEWEST:
        return None
    references = [true]
    if time is None:
        found = [_late("Rope lengths", read, true, None)]
    else:
        found = [_delayed(read, true, time, ages_s)]
        references += [_earlier(true, time, float(np.mean(ages_s)))] if ages_s else []
    for reference in references:
        factor, constant = float(np.nanmedian(read / reference)), float(np.nanmedian(read - reference))
        by_factor = Mistake(f"{factor:.3g} times the true ones", read / (factor or 1.0) - reference)
        side = "long" if constant > 0 else "short"
        by_constant = Mistake(f"{abs(constant):.2f} m too {side}", read - constant - reference)
        better, other = sorted((by_factor, by_constant), key=lambda one: one.rms)
        text = f"{better.text}, or {other.text}" if other.rms < CLEARLY * better.rms else better.text
        found.append(better._replace(text=f"Rope lengths are {text}"))
    best = min(found, key=lambda one: one.rms)
    right = min(Mistake("", read - reference).rms for reference in references)
    least = math.inf if best.own else right / CLEARLY
    return best if best.rms < min(ROPE_SHARE * Mistake("", read - true).rms, least) else None


def _earlier(true: Array, time: Array, by_s: float) -> Array:
    """Values (n,) at the frames' times less a delay; beyond the record its first or last."""
    known = np.isfinite(true)
    return np.interp(time - by_s, time[known], true[known])


def _delayed(read: Array, true: Array, time: Array, ages_s: tuple[float, float] | None) -> Mistake:
    """Explain rope lengths by a delay, s, unless it is the display's own."""
    step = float(np.median(np.diff(time)))
    most = min(MOST_LATE, len(time) // 3)

    def left(by_s: float) -> Mistake:
        return Mistake("", read - _earlier(true, time, by_s), 1)

    first = min(step * np.arange(-most, most + 1), key=lambda by_s: left(by_s).rms)
    by_s = float(minimize_scalar(lambda x: left(x).rms, bounds=(first - step, first + step), method="bounded").x)
    text = f"Rope lengths are {abs(by_s):.2f} s {'late' if by_s > 0 else 'early'}"
    if not ages_s or by_s < ages_s[0] - FITTED_S:
        return left(by_s)._replace(text=text)
    text += f", of which {ages_s[0]:g} to {ages_s[1]:g} s are the display's own delay"
    own = by_s < ages_s[1] + FITTED_S
    text += "" if own else f" and {by_s - ages_s[1]:.1f} to {by_s - ages_s[0]:.1f} s the pipeline's"
    return left(by_s)._replace(text=text, own=own)
