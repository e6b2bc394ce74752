"""The second phase of the paper: once the tilt is known, α frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import tomli_w
from numpy.typing import ArrayLike, NDArray

from simgrab.errors import CalibrationError
from simgrab.instrument.controller import Radii
from simgrab.instrument.estimate import intervals as iv
from simgrab.instrument.estimate.contract import alpha_ends, angles_of
from simgrab.instrument.estimate.frames import Frames, check_record, gravity, groups
from simgrab.instrument.estimate.rope_aware import along_tilt, swings
from simgrab.io.parse import read_toml
from simgrab.io.strict import Checked, convert
from simgrab.model.calibration import Calibration, Metres
from simgrab.model.geometry import Array, lean, rotation_z
from simgrab.model.records.estimates import Estimate

Meta = msgspec.Meta
Entry = Annotated[float, Meta(ge=-1e6, le=1e6)]
Pitch = Annotated[float, Meta(ge=-20, le=20)]
WEAK_PRIOR_OFFSET, WEAK_PRIOR_IF_FIXED = "weak_prior_offset_m", "weak_prior_offset_if_fixed_m"  # diagnostics
FAR, FAR_IF_FIXED = 2.0, 3.0  # standard deviations
PITCHING = "", "rigid"  # mounts, if not stated
CLEAR_PITCH = 4.0  # standard deviations
LEAST_OFFSET_SD_M = 0.05  # with which a stated offset is tested: a stronger prior hides what frames show of it


class Known(Checked, frozen=True):
    """The result of a calibration that later frames need; ``tilt.toml`` of a run."""

    error = CalibrationError

    estimator: str  # estimator that found the tilt
    frames: Annotated[int, Meta(ge=1, le=2**53)]  # number of frames used
    beta_deg: Annotated[float, Meta(ge=0, lt=90)]
    tilt_azimuth_deg: Annotated[float, Meta(ge=-360, le=360)]
    # camera centre minus rope exit; None if the estimator ignores it, and takes the camera to be at the rope exit
    offset_m: tuple[Metres, Metres, Metres] | None
    # as `simgrab.model.records.estimates.Intervals.tilt`, (2, 2) or (4, 4), rad² and m², widened so that normal
    # quantiles apply
    covariance: tuple[tuple[Entry, ...], ...]
    # `offset_m` with the prior that tests it; None if its own prior does
    weak_prior_offset_m: tuple[Metres, Metres, Metres] | None = None
    # the camera's roll that azimuth and offsets were estimated with
    roll_deg: Annotated[float, Meta(ge=-360, le=360)] = 0.0
    # radius of the rope exit at which the tilt is as stated, of a camera that pitches with the jib
    radius_m: Annotated[float, Meta(ge=0, le=200)] | None = None
    # what a metre more of radius adds to (β cos azimuth, β sin azimuth)
    pitch_deg_per_m: tuple[Pitch, Pitch] = (0.0, 0.0)
    pitch_sd_deg_per_m: Annotated[float, Meta(ge=0, le=20)] = 0.0  # its standard deviation

    def check(self) -> None:  # noqa: D102
        shape = np.shape(self.covariance)
        wanted = (2, 2) if self.offset_m is None else (4, 4)
        if shape != wanted:
            raise ValueError(f"covariance must have the shape {wanted}, got {shape}")
        if (self.radius_m is None) == any(self.pitch_deg_per_m):
            raise ValueError("radius_m: is of a camera whose pitch_deg_per_m is not 0: give both or none")

    def rolled(self, roll_deg: float) -> Known:
        """Return what the same pictures show of a camera of another roll: pixels fix the tilt's direction less it."""
        by = self.roll_deg - roll_deg
        if not by:
            return self
        turn = rotation_z(np.deg2rad(by))
        offset, weak = (
            None if one is None else _components(turn @ one) for one in (self.offset_m, self.weak_prior_offset_m)
        )
        azimuth, pitch = (self.tilt_azimuth_deg + by) % 360, turn @ (*self.pitch_deg_per_m, 0.0)
        return msgspec.structs.replace(
            self, roll_deg=roll_deg, tilt_azimuth_deg=azimuth, offset_m=offset, weak_prior_offset_m=weak,
            pitch_deg_per_m=(float(pitch[0]), float(pitch[1])),
        )  # fmt: skip

    def on(self, mount: str) -> Known:
        """Return what it is of a camera on a mount: some cannot pitch."""
        if mount in PITCHING:
            return self
        return msgspec.structs.replace(self, radius_m=None, pitch_deg_per_m=(0.0, 0.0), pitch_sd_deg_per_m=0.0)

    def pitched(self, radii: Radii | None) -> NDArray[np.bool_] | None:
        """Of which of n radii the pitch follows: shape (n,); None of all if the tilt or the radii are not known."""
        return None if radii is None or self.radius_m is None else np.isfinite(radii.value)

    def to_toml(self) -> str:
        """Return the file's text."""
        data = msgspec.to_builtins(self)
        return tomli_w.dumps({key: value for key, value in data.items() if value is not None})


def known(estimate: Estimate, calibration: Calibration) -> Known:
    """Keep the parts of an estimate that later frames need: tilt, offset, and their covariance, with the stated roll.

    Of a camera that may be bolted to the jib, also how it pitches with the radius, if that is clear.
    The covariance is by blocks if there are enough of them, and by frames otherwise.
    """
    assert estimate.beta is not None
    assert estimate.tilt_azimuth is not None
    stated = [i for i in estimate.intervals if i.tilt is not None]
    best = next((i for i in stated if i.kind == "blocks"), stated[0] if stated else None)
    if best is None or best.tilt is None:
        covariance = _of_beta(estimate)
    else:  # the quantiles of frames to come are normal; those of a few blocks are not
        degrees = estimate.frames - 1 if best.blocks is None else best.blocks - 1
        covariance = best.tilt * (iv.student(best.level, degrees) / iv.student(best.level, np.inf)) ** 2
    shown = estimate.diagnostics
    estimated = calibration.roll_deg + float(np.rad2deg(shown.get("roll_error", 0.0)))
    pitch, pitch_sd = (float(np.rad2deg(shown.get(name, 0.0))) for name in ("pitch_per_m", "pitch_sd_per_m"))
    pitches = calibration.mount in PITCHING and abs(pitch) > CLEAR_PITCH * pitch_sd
    own = Known(
        estimate.estimator, estimate.frames, float(np.rad2deg(estimate.beta)), float(np.rad2deg(estimate.tilt_azimuth)),
        _components(estimate.offset), tuple(tuple(float(x) for x in row) for row in covariance),
        _components(shown.get(WEAK_PRIOR_OFFSET)), estimated,
    )  # fmt: skip
    if pitches:
        own = msgspec.structs.replace(
            own, radius_m=float(shown["radius_m"]), pitch_deg_per_m=(pitch, 0.0), pitch_sd_deg_per_m=pitch_sd
        )
    return own.rolled(calibration.roll_deg)  # by which later frames are turned


def _components(offset: Array | None) -> tuple[float, float, float] | None:
    return None if offset is None else (float(offset[0]), float(offset[1]), float(offset[2]))


def _of_beta(estimate: Estimate) -> Array:
    """Covariance of gravity from the interval of β alone, equal across the tilt; the offset is taken as exact."""
    ends = next((i.beta for i in estimate.intervals if i.beta is not None), None)
    sd = 0.0 if ends is None else float(ends[1] - ends[0]) / (2 * float(iv.student(iv.LEVEL, np.inf)))
    return np.diag([sd**2, sd**2, *([] if estimate.offset is None else [0.0, 0.0])])


def load(path: str | Path) -> Known:
    """Read a ``tilt.toml``; raises `CalibrationError` with one line that names file and key."""
    data = read_toml(path, CalibrationError, "calibration")
    return convert({"offset_m": None} | data, Known, CalibrationError, path)


def follow(
    tilt: Known,
    pixels: ArrayLike,
    calibration: Calibration,
    *,
    rope_length: ArrayLike | None = None,
    time: ArrayLike | None = None,
    pixel_sd: ArrayLike | None = None,
    radii: Radii | None = None,
) -> tuple[Array, Array, Array]:
    r"""Swing of each frame under a known tilt.

    Parameters
    ----------
    pixels : array_like, shape (n, 2)
        Grab centre as the picture has it; NaN where it was not found.
    rope_length : array_like, shape (n,), optional
        \|OA\|, m; required if the tilt comes with an offset.
    time : array_like, shape (n,), optional
        Seconds. Without it the frames are independent, and a camera is taken not to lean.
    pixel_sd : array_like, shape (n,), optional
        Standard deviation of each pixel coordinate, px.
    radii : Radii, optional
        By which a camera pitches if the tilt states how; it leans as on its mount where one is NaN.

    Returns
    -------
    alpha : ndarray, shape (n,)
        NaN where there is no pixel.
    ends : ndarray, shape (n, 2)
        Ends of its 95 % intervals.
    direction : ndarray, shape (n, 2)
        Horizontal part of the unit direction OA, jib frame.

    Raises
    ------
    RecordError
        For wrong shapes and impossible rope lengths.
    """
    uv, rope, t, sd = check_record(np.asarray(pixels, float)[None], rope_length, time, False, pixel_sd)
    covariance = np.array(tilt.covariance)[None]
    beta, azimuth = np.array([np.deg2rad(tilt.beta_deg)]), np.array([np.deg2rad(tilt.tilt_azimuth_deg)])
    pitched = tilt.pitched(radii)
    (frames,) = groups(uv, rope, t if pitched is None else None, calibration, sd)
    if pitched is not None:
        assert radii is not None
        frames = _as_of(tilt, frames, radii)
    lever = radial = None
    if tilt.offset_m is not None:
        assert rope is not None
        lever = 1 / rope
    with np.errstate(invalid="ignore"):  # no swing reaches a rope that is shorter than the offset
        across = swings(
            frames.rays, np.ones(1) if lever is None else lever, gravity(beta, azimuth),
            np.array([tilt.offset_m or (0.0, 0.0, 0.0)]),
        )  # fmt: skip
    if lever is not None:
        radial = np.sum(across**2, axis=1) * (calibration.offset_sd_m * lever) ** 2
    alpha, unit = angles_of(along_tilt(across, azimuth))
    quantile = iv.student(iv.LEVEL, np.array([np.inf]))
    ends = alpha_ends(alpha, unit, covariance, quantile, lever, frames.noise, radial)[0]
    seen = np.isfinite(uv[0]).all(axis=-1)
    some = seen[:, None]
    return np.where(seen, alpha[0], np.nan), np.where(some, ends, np.nan), np.where(some, across[0].T, np.nan)


def _as_of(tilt: Known, frames: Frames, radii: Radii) -> Frames:
    """Turn rays of a record to where a camera of the stated tilt would see them, with the pitch's error as noise."""
    assert tilt.radius_m is not None
    beta, azimuth = np.deg2rad(tilt.beta_deg), np.deg2rad(tilt.tilt_azimuth_deg)
    pitch = np.deg2rad(tilt.pitch_deg_per_m)
    further = np.nan_to_num(radii.value - tilt.radius_m)
    leans = beta * np.array([np.cos(azimuth), np.sin(azimuth)]) + np.outer(further, pitch)
    back = lean(beta, azimuth).T @ lean(np.hypot(*leans.T), np.arctan2(leans[:, 1], leans[:, 0]))
    off = np.hypot(np.deg2rad(tilt.pitch_sd_deg_per_m) * further, np.hypot(*pitch) * radii.sd)
    most = iv.LEAN_BY_MOUNT["rigid"]
    noise = np.where(np.isnan(radii.value), most, np.minimum(off, most)) ** 2
    return replace(frames, rays=np.einsum("nij,mjn->min", back, frames.rays), noise=noise + frames.noise)


def tested_offsets(estimate: Estimate) -> tuple[Array | None, Array | None]:
    """Offset of an estimate for `far_offset`, m, and the one if the camera does not move with the jib."""
    shown = estimate.diagnostics
    if WEAK_PRIOR_OFFSET in shown:
        return shown[WEAK_PRIOR_OFFSET], shown[WEAK_PRIOR_IF_FIXED]
    return estimate.offset, shown.get("offset_if_fixed_m")


def far_offset(
    found: Sequence[float] | Array | None,
    calibration: Calibration,
    *,
    by_motion: bool = False,
    fixed: Array | None = None,
) -> str:
    """Name an estimated offset, m, that is far from the stated one; empty if it is not, or was not estimated.

    Parameters
    ----------
    found : sequence of 3 floats or None
        Estimated with a prior of at least `LEAST_OFFSET_SD_M`.
    by_motion : bool
        Whether it was estimated with the controller's slewing and radius.
    fixed : ndarray, shape (3,), optional
        Estimate for a camera that does not pitch with the jib, where the other one allows for that.
    """
    if found is None:
        return ""
    if (far := _deviations(found, calibration)) > FAR:
        also = ", and the controller's slewing angle and radius, which it was estimated with" if by_motion else ""
        return (
            f"the camera offset is estimated as {_metres(found)}, {far:.1f} standard deviations of "
            f"{_sd_m(calibration):g} m from offset_m; are its axes and signs right, and the rope's length{also}?"
        )
    if fixed is None or not by_motion or calibration.mount == "rigid":
        return ""
    if (far := _deviations(fixed, calibration)) > FAR_IF_FIXED:
        unless = "" if calibration.mount else 'unless the camera pitches with the jib (mount = "rigid"), '
        return (
            f"{unless}the camera offset is {_metres(fixed)}, {far:.1f} standard deviations of "
            f"{_sd_m(calibration):g} m from offset_m: are its axes and signs right?"
        )
    return ""


def _deviations(found: Sequence[float] | Array, calibration: Calibration) -> float:
    """How far an offset is from the stated one, in standard deviations of its most different component."""
    off = max(abs(one - stated) for one, stated in zip(found, calibration.offset_m, strict=True))
    return float(off / _sd_m(calibration))


def _sd_m(calibration: Calibration) -> float:
    return max(calibration.offset_sd_m, LEAST_OFFSET_SD_M)


def _metres(offset: Sequence[float] | Array) -> str:
    return f"({', '.join(f'{one:.2f}' for one in offset)}) m"
