"""What the rivals' methods take and give: readings of sensors in, a swing with its uncertainty out."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simgrab.errors import RecordError
from simgrab.instrument.contract import Measurement
from simgrab.instrument.estimate.frames import interpolated
from simgrab.instrument.estimate.inertial.readings import STAMP, ImuReadings, check_times, read_columns
from simgrab.model.geometry import Array

QUANTILE = 1.959964
"""Of the normal distribution, for 95 % intervals."""


@dataclass(frozen=True, eq=False)
class Series:
    """Readings of an encoder or an inclinometer.

    Attributes
    ----------
    time : ndarray, shape (n,)
        s, increasing.
    values : ndarray, shape (n, k)
        In SI units and radians.

    Raises
    ------
    RecordError
        For wrong shapes, values that are not finite, and times that do not increase; names the row, the first is 1.
    """

    time: Array
    values: Array

    def __post_init__(self) -> None:
        n = len(self.time)
        if n < 2 or self.time.shape != (n,) or self.values.ndim != 2 or len(self.values) != n:
            raise RecordError(
                f"time and values must have shapes (n,) and (n, k) with n of 2 or more, got {self.time.shape} and "
                f"{self.values.shape}"
            )
        check_times(self.time)
        for row in np.flatnonzero(~np.isfinite(self.values).all(axis=1))[:1]:
            raise RecordError(f"values, row {row + 1}: a finite number is needed")

    def at(self, time: Array) -> Array:
        """Values at times (m,) on lines between readings, shape (m, k); beyond the ends the last value holds."""
        return interpolated(time, self.time, self.values)


def read_series(folder: str | Path, *columns: str) -> Series:
    """Read columns of an encoder's or inclinometer's ``data.csv``; those in degrees become radians.

    Parameters
    ----------
    folder : str or path
        Such as a dataset's ``sensors/clip_000/hoist``.
    *columns : str
        With their units: ``"rope_length [m]"``, or ``"tilt_x [deg]"`` and ``"tilt_y [deg]"``.

    Raises
    ------
    RecordError
        In one line: the file, and the row or column.
    """
    where = Path(folder) / "data.csv"
    stamp, *values = read_columns(where, STAMP, *columns)
    values = [np.radians(v) if name.endswith("[deg]") else v for name, v in zip(columns, values, strict=True)]
    try:
        return Series(stamp / 1e9, np.stack(values, axis=-1))
    except RecordError as problem:
        raise RecordError(f"{where}: {problem}") from None


@dataclass(frozen=True, eq=False)
class Sensors:
    r"""Sensors of one clip, on one clock.

    Attributes
    ----------
    imus : mapping of str to ImuReadings
        By mount: ``"jib-head"``, ``"rope"``, ``"grab"``, ``"camera"``. Axes are those of the mount at rest, z up, and
        in the camera those of the camera frame; ``camera_from_sensor`` is not used.
    inclinometer : Series or None
        On the rope: angles of its x and y axes above level, rad.
    rope : Series or None
        Rope length, \|OA\|, m.
    target : Series or None
        The grab in the pictures of the camera at the jib head: angles (n, 2) of its ray from the optical axis along x
        and y of the jib frame, rad, as if the camera were level.
    offset_m : tuple of 3 floats
        Of that camera, as in a `simgrab.calibration.Calibration`.
    """

    imus: Mapping[str, ImuReadings] = field(default_factory=dict)
    inclinometer: Series | None = None
    rope: Series | None = None
    target: Series | None = None
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def imu(self, mount: str) -> ImuReadings:
        """Return the readings of the sensor on a mount; raises `RecordError` where there is none."""
        if mount not in self.imus:
            raise RecordError(f"an inertial sensor is needed on the mount {mount!r}; there are: {sorted(self.imus)}")
        return self.imus[mount]

    @property
    def lengths(self) -> Series:
        """Return rope lengths; raises `RecordError` where there are none, or such as no crane has."""
        if self.rope is None:
            raise RecordError("the rope length is needed")
        if not (self.rope.values > 0).all():
            row = int(np.argmin(self.rope.values[:, 0] > 0))
            raise RecordError(f"rope length, row {row + 1}: must be above 0 m, got {self.rope.values[row, 0]:g}")
        return self.rope


@dataclass(frozen=True, eq=False)
class Swing:
    """The swing at n instants.

    Attributes
    ----------
    alpha : ndarray, shape (n,)
        Angle between rope and gravity, rad; NaN where there is none.
    azimuth : ndarray, shape (n,)
        Of the swing, rad, counter-clockwise about the vertical seen from above, from the sensor's x axis.
    sd : ndarray, shape (n,)
        Standard deviation of α that the method states, rad; NaN where it states none.
    reason : ndarray of str, shape (n,)
        Why there is no angle; empty where there is one.
    """

    alpha: Array
    azimuth: Array
    sd: Array
    reason: NDArray[np.str_]

    @classmethod
    def none(cls, n: int, reason: str) -> Swing:
        """No angle at any of n instants."""
        nothing = np.full(n, np.nan)
        return cls(nothing, nothing, nothing, np.full(n, reason))

    @classmethod
    def of(cls, lean: Array, sd: Array | None = None, reason: NDArray[np.str_] | None = None) -> Swing:
        """Make one of leans (n, 2): angles along x and y, rad. Rows with a reason lose their angle."""
        n, (x, y) = len(lean), lean.T
        sd, reason = np.full(n, np.nan) if sd is None else sd, np.full(n, "") if reason is None else reason
        made = cls(np.hypot(x, y), np.arctan2(y, x) % (2 * np.pi), sd, reason)
        made = made.without(np.logical_not(np.isfinite(lean).all(axis=1)), "the method found no angle")
        return made.without(made.reason != "", "")

    def without(self, gone: NDArray[np.bool_], why: str) -> Swing:
        """Take the angles of some instants away; reasons that they have already stay."""
        alpha, azimuth, sd = (np.where(gone, np.nan, values) for values in (self.alpha, self.azimuth, self.sd))
        return Swing(alpha, azimuth, sd, np.where(gone & (self.reason == ""), why, self.reason))

    def measurements(self) -> list[Measurement]:
        """Return the swing as an instrument does."""
        found = []
        for alpha, sd, reason in zip(self.alpha.tolist(), self.sd.tolist(), self.reason.tolist(), strict=True):
            if reason:
                found.append(Measurement(status="refused", reason=reason))
                continue
            low, high = (None, None) if np.isnan(sd) else (max(alpha - QUANTILE * sd, 0.0), alpha + QUANTILE * sd)
            found.append(Measurement(status="ok", alpha=min(alpha, np.pi / 2), alpha_low=low, alpha_high=high))
        return found


Method = Callable[[Sensors, Array], Swing]
"""From sensors and n instants, s, to the swing at these."""


def refusing(method: Method) -> Method:
    """Turn a `RecordError` of a method into a swing without angles, whose reason is the error's text."""

    @functools.wraps(method)
    def guarded(sensors: Sensors, time: Array) -> Swing:
        instants = np.asarray(time, float)
        if instants.ndim != 1 or not np.isfinite(instants).all():
            raise RecordError(f"time must hold finite numbers in shape (n,), got shape {instants.shape}")
        try:
            return method(sensors, instants)
        except RecordError as problem:
            return Swing.none(len(instants), str(problem))

    return guarded
