"""Readings of the crane's controller, and how far its clock is from that of the pictures."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from simgrab.errors import RecordError
from simgrab.instrument.drive import Drive, of_point
from simgrab.model.geometry import Array

DELAY_S, DELAY_SD_S = 0.5, 12**-0.5
"""Of the display: lengths on it are 0 to 1 s old."""
STEP_S = 0.1  # of the search
MOST_SEARCH_S = 60.0
MOST_READINGS = 20_000  # of the display; more say no more of the clock
LEAST_READINGS = 20
SAME_M = 1e-3  # within which lengths are the controller's own: a display rounds to centimetres
LEAST_HOIST_M = 1.0  # that the rope's length must change by to show the clock
BLOCK_S = 20.0  # within which errors of readings depend on each other
MOST_MISFIT_M = 0.3
"""Two lengths of one rope differ by a constant, and by less than this: a display holds its value for some 0.2 s."""
MOST_CONSTANT_M = 0.5
RADIUS_M = 25.0  # where no radius is reported
RATE_S = 1.0  # in which the radius shows how fast it changes
LUFFING_M_S = 0.3  # how fast it may change unseen
LATEST_S = 20.0  # of readings that show the jib's motion
SPANS_S = (1.2, 2.0, 3.0)  # of them, for parabolas
LEAST_LATEST, OLDEST_S = 5, 0.5
MOST_ERROR = 0.08  # m/s², standard deviation: a quarter of what a forecast expects of a jib that nobody reports
LEAST_WIND_M_S = 2.0  # its lean is 0.01°
SLACK = 0.8  # of the empty grab's mass: with less on its ropes it stands
LENGTHS = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "ft": 0.3048}


class Radii(NamedTuple):
    """Radii of the rope exit and their standard deviations, m, each of shape (n,)."""

    value: Array
    sd: Array


@dataclass(frozen=True, eq=False)
class Controller:
    """Readings of the crane's controller on the clock of the pictures.

    A row of NaN stands in each gap too long to be bridged, so that linear interpolation gives NaN there.
    """

    time: Array  # (n,), s, increasing; 0 is the first frame; the stated lag is taken off
    # (n,), slewing angle, rad, unwrapped, counter-clockwise seen from above; its zero is arbitrary
    slew: Array | None = None
    radius: Array | None = None  # (n,), from the slewing axis to O, m
    rope: Array | None = None  # (n,), |OA|, m
    # slew_sd, radius_sd: standard deviation of one reading, rad, m, by resolution and jitter; 0 without readings
    slew_sd: float = 0.0
    radius_sd: float = 0.0
    clock_sd_s: float = 0.0  # standard deviation of what is still unknown of the clock's offset, s
    notes: tuple[str, ...] = ()  # readings that were refused, with their number and the reason, a line each
    hold_s: float = 0.0  # how long the rope's length is taken to stay after the last reading
    clock_from: str = "its description"  # what states the clock
    rope_unit: str = "m"  # of the rope's length as stated, a key of `LENGTHS`, for messages
    wind: Array | None = None  # (m, 2), times, s, and speeds, m/s; without NaN
    load: Array | None = None  # (k, 2), times, s, and hoisted masses of grab and cargo, kg; without NaN
    grab_kg: float = 0.0  # mass of the empty grab, with `load`
    slew_setpoint: Array | None = None  # (n,), speeds that are demanded of the drives, rad/s and m/s
    radius_setpoint: Array | None = None  # (n,)
    motion_late_s: float = 0.0  # how long after its time a reading of slew or radius is known
    # slew_still_sd, radius_still_sd: as `slew_sd` and `radius_sd`, of a jib at rest, to which jitter does no harm;
    # None if that is no less
    slew_still_sd: float | None = None
    radius_still_sd: float | None = None

    @property
    def reports_motion(self) -> bool:
        """Whether it reports slewing or luffing."""
        return self.slew is not None or self.radius is not None

    @property
    def stated_clock(self) -> ClockOffset:
        """The offset of its clock as its description states it."""
        return ClockOffset(0.0, self.clock_sd_s, self.clock_from)

    def rope_at(self, time: Array) -> Array:
        """Interpolate the rope's length at times (m,); NaN in gaps, and a reading's period or more outside of all."""
        assert self.rope is not None
        (first, last), period = self.time[[0, -1]], float(np.median(np.diff(self.time)))
        near = (time > first - period) & (time <= last + max(self.hold_s, period))
        return np.interp(np.where(near, np.clip(time, first, last), time), self.time, self.rope, np.nan, np.nan)

    def radii(self, time: Array, clock_sd_s: float | None = None, *, live: bool = False) -> Radii | None:
        """Return the radius at times (m,); None where it is not reported.

        Parameters
        ----------
        time : ndarray, shape (m,)
        clock_sd_s : float, optional
            In place of its own.
        live : bool
            Whether only readings count that are known by then, of which the last is carried on for a second at its
            rate; NaN before the first.
        """
        if self.radius is None:
            return None
        known = np.isfinite(self.radius)
        t, radius = self.time[known], self.radius[known]
        if not len(t):
            return None
        until = time - self.motion_late_s if live else np.full(len(time), np.inf)
        last = np.searchsorted(t, until, side="right") - 1
        after = np.minimum(np.searchsorted(t, time), last)
        before = np.clip(after - 1, 0, None)
        age = np.minimum(np.abs(time - t[before]), np.abs(time - t[after]))

        def at(moment: Array) -> Array:
            return np.interp(np.minimum(moment, t[last]), t, radius)

        begin = np.clip(time - RATE_S / 2, None, t[last] - RATE_S)
        rate = (at(begin + RATE_S) - at(begin)) / RATE_S
        value = at(time) + rate * np.clip(time - t[last], 0.0, RATE_S)
        clock = self.clock_sd_s if clock_sd_s is None else clock_sd_s
        sd = np.hypot(np.hypot(self.radius_sd, rate * clock), LUFFING_M_S * np.maximum(age - RATE_S, 0.0))
        return Radii(np.where(last < 0, np.nan, value), sd)

    def jib_motion(self, time: float, after_s: Array) -> tuple[Array, Array]:
        """Return the jib's motion at a time, and in the seconds after it.

        It is that of drives which follow their setpoints, if both are stated. Otherwise, or if a drive does not follow
        its setpoint, parabolas through the latest readings give the motion at the time alone.

        Parameters
        ----------
        after_s : ndarray, shape (m,)
            Seconds after it, from less to more.

        Returns
        -------
        ndarray, shape (3,)
            Acceleration of O outward and counter-clockwise, m/s², and slewing rate, rad/s. NaN if slew or radius is
            not reported, or readings are too few, too old or too coarse.
        ndarray, shape (m + 1, m, 3)
            The same later, if the drives are stopped at each of these times, and last if they are not. NaN without
            setpoints.
        """
        now, ahead = np.full(3, np.nan), np.full((len(after_s) + 1, len(after_s), 3), np.nan)
        if self.slew is None or self.radius is None:
            return now, ahead
        begin, end = np.searchsorted(self.time, [time - LATEST_S, time - self.motion_late_s], side="right")
        some = begin + np.flatnonzero(np.isfinite(self.slew[begin:end]) & np.isfinite(self.radius[begin:end]))
        if not len(some) or self.time[some[-1]] < time - OLDEST_S:
            return now, ahead
        t, slew, radius = self.time[some] - time, self.slew[some], self.radius[some]
        if self.slew_setpoint is not None and self.radius_setpoint is not None:
            setpoints = np.stack([self.slew_setpoint[some], self.radius_setpoint[some]])
            stated = slice(np.flatnonzero(np.append(True, np.isnan(setpoints).any(axis=0)))[-1], None)
            turning, luffing = (
                Drive.of(t[stated], values[stated], each[stated], sd)
                for values, each, sd in zip((slew, radius), setpoints, (self.slew_sd, self.radius_sd), strict=True)
            )
            if turning and luffing:
                now = of_point(turning.ahead(np.zeros(1)), luffing.ahead(np.zeros(1)))[0]
                return now, of_point(turning.stopped(after_s), luffing.stopped(after_s))
        return self._by_parabolas(t, slew, radius), ahead

    def _by_parabolas(self, t: Array, slew: Array, radius: Array) -> Array:
        """Motion (3,) now, from readings (n,) at times before it.

        They span the shortest of `SPANS_S` in which their deviations leave accelerations an error of at most
        `MOST_ERROR`.
        """
        for span in SPANS_S:
            some = t > -span
            if np.count_nonzero(some) < LEAST_LATEST or np.ptp(t[some]) < span / 2:
                continue
            powers = np.vander(t[some], 3)
            inverse = np.linalg.inv(powers.T @ powers)
            reading_sd = math.hypot(float(radius[-1]) * self.slew_sd, self.radius_sd)
            if 2 * math.sqrt(inverse[0, 0]) * reading_sd <= MOST_ERROR:
                fits = inverse @ powers.T @ np.column_stack([slew[some], radius[some]])
                turning, luffing = ((value, speed, 2 * half) for half, speed, value in fits.T)
                return of_point(turning, luffing)
        return np.full(3, np.nan)

    def wind_m_s(self, time: Array) -> float:
        """Root mean square of the wind at times (m,), m/s, as lean grows with its square, but `LEAST_WIND_M_S`."""
        assert self.wind is not None
        return max(float(np.sqrt(np.mean(np.interp(time, *self.wind.T) ** 2))), LEAST_WIND_M_S)

    def lightness(self, time: Array) -> Array:
        """One over the hoisted mass at times (m,), over its mean in that time: how much a grab leans in a wind.

        Readings of slack ropes, as the grab digs, count for nothing. 1 where there are no others.
        """
        if self.load is None:
            return np.ones(len(time))
        times, mass = self.load.T
        some = (mass >= SLACK * self.grab_kg) & (times >= np.min(time)) & (times <= np.max(time))
        light = 1 / mass[some]
        return np.interp(time, times[some], light / light.mean()) if some.any() else np.ones(len(time))

    def shifted(self, clock: ClockOffset) -> Controller:
        """Apply the offset of the clock."""
        wind, load = (None if one is None else one + (clock.offset_s, 0.0) for one in (self.wind, self.load))
        return replace(self, time=self.time + clock.offset_s, clock_sd_s=clock.sd_s, wind=wind, load=load)


@dataclass(frozen=True)
class ClockOffset:
    """What is added to the controller's times to get those of the pictures: positive if its clock is behind theirs."""

    offset_s: float
    sd_s: float
    source: str  # what determined it
    difference_m: float | None = None  # mean of the display's rope length less the controller's

    @property
    def interval_s(self) -> tuple[float, float]:
        """Interval of 95 %."""
        return self.offset_s - 1.96 * self.sd_s, self.offset_s + 1.96 * self.sd_s

    def by_swing(self, late_s: float | None, sd_s: float | None) -> ClockOffset | None:
        """Offset if the swing shows that this one is late by some seconds, with that one's standard deviation."""
        return None if late_s is None or sd_s is None else replace(self, offset_s=self.offset_s + late_s, sd_s=sd_s)

    @property
    def note(self) -> str:
        """A difference between the lengths that is too large to come from readings; mostly empty."""
        if self.difference_m is None or abs(self.difference_m) <= MOST_CONSTANT_M:
            return ""
        return (
            f"the display's rope length is {self.difference_m:+.2f} m from the controller's, which is used; one of "
            "rope.constant_m in the controller's TOML and display_constant_m in the camera TOML is wrong"
        )


WORDS_S = 0.005  # less is no difference in words
#: How a fault on a clock that is found in a live run begins.
CLOCK = "its clock is "


def in_words(
    offset_s: float, interval_s: Sequence[float], source: str, by_swing_s: Sequence[float] | None
) -> str:  # fmt: skip
    """State a clock's offset with its interval of 95 %, and that of the swing, if it shows one."""
    side, sign = ("ahead of", -1) if offset_s < 0 else ("behind", 1)
    low, high = sorted(sign * end for end in interval_s)
    said = f"{sign * offset_s:+.2f} s ({low:+.2f} to {high:+.2f}) {side} the pictures', from {source}"
    if abs(offset_s) < WORDS_S:
        said = f"that of the pictures ({low:+.2f} to {high:+.2f} s), from {source}"
    if by_swing_s is None:
        return said
    low, high = sorted(sign * end for end in by_swing_s)
    return f"{said}; {(low + high) / 2:+.2f} s ({low:+.2f} to {high:+.2f}) by the swing, which is used"


def _unit(misfit: Callable[[float], float], display: Array, stated: str) -> str:
    """Name the unit in which lengths, times a factor, follow the display's (n,); ``misfit`` is of the factor, m²."""
    least = min(MOST_MISFIT_M**2, float(np.var(display)) / 25)
    fitting = [unit for unit, scale in LENGTHS.items() if misfit(scale / LENGTHS[stated]) < least]
    return f"they follow in {fitting[0]}, not {stated}: see rope.unit" if len(fitting) == 1 else "is it another record?"


def clock_offset(controller: Controller, time: Array, display: Array) -> ClockOffset:
    """Estimate the offset of the controller's clock from the rope's length on the display.

    The display's length is the controller's of some time before, and a constant. That time, which minimises the squared
    differences, is the clock's offset and the display's delay (`DELAY_S`), or the offset alone where the lengths are
    the controller's own. It is combined with the stated offset of 0 ± ``clock_sd_s``.
    Its own lengths may have been shifted by a display's: they leave a standard deviation of `DELAY_SD_S` at least.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Of the frames, s.
    display : ndarray, shape (n,)
        |OA| from the display, m; NaN where there is no reading.

    Returns
    -------
    ClockOffset
        The stated one if lengths cannot show it.

    Raises
    ------
    RecordError
        If the times have no overlap, or the lengths do not follow each other.
    """
    stated = controller.stated_clock
    if not len(time):
        return stated
    reach = min(4 * controller.clock_sd_s, MOST_SEARCH_S)
    first, last = controller.time[[0, -1]]
    if time[-1] < first - reach or time[0] > last + reach:
        raise RecordError(
            f"the controller's data and the frames have no time in common: {first:.1f} to {last:.1f} s and "
            f"{time[0]:.1f} to {time[-1]:.1f} s; time.start in the controller's TOML is the time of the first frame"
        )
    known = np.flatnonzero(np.isfinite(display))
    known = known[:: len(known) // MOST_READINGS + 1]
    if controller.rope is None or len(known) < LEAST_READINGS:
        return stated
    t, length = time[known], display[known]

    def misfit(delay: float, scale: float = 1.0) -> tuple[float, Array]:
        error = length - scale * controller.rope_at(t - delay)
        both = np.isfinite(error)
        return (float(np.var(error[both])) if 2 * both.sum() >= len(t) else math.inf), error

    delays = np.arange(-reach, reach + 2 * DELAY_S + STEP_S / 2, STEP_S)
    squares = [misfit(delay)[0] for delay in delays]
    best = int(np.argmin(squares))
    if not math.isfinite(squares[best]):
        return stated
    delay, error = float(delays[best]), misfit(delays[best])[1]
    difference = float(np.nanmean(error))
    if squares[best] > MOST_MISFIT_M**2:
        unit = _unit(lambda scale: min(misfit(one, scale)[0] for one in delays), length, controller.rope_unit)
        raise RecordError(
            f"the controller's rope length does not follow the display's: they differ by "
            f"{math.sqrt(squares[best]):.1f} m beside a constant, with clocks up to {reach:g} s apart "
            f"(4 time.clock_sd_s); {unit}"
        )
    for _ in range(3):  # Gauss–Newton
        slope = (controller.rope_at(t - delay + STEP_S) - controller.rope_at(t - delay - STEP_S)) / (2 * STEP_S)
        error = misfit(delay)[1]
        both = np.isfinite(error) & np.isfinite(slope)
        slope, error = slope[both] - slope[both].mean(), error[both] - error[both].mean()
        information = float(slope @ slope)
        if np.ptp(controller.rope_at(t[both] - delay)) < LEAST_HOIST_M or not information:
            return replace(stated, difference_m=difference)
        delay -= float(np.clip(slope @ error / information, -STEP_S, STEP_S))
    sums = np.bincount(((t[both] - t[0]) / BLOCK_S).astype(np.int64), slope * error)
    own = float(np.std(error)) < SAME_M  # as in a run's angles.csv
    late, late_sd, source = (
        (0.0, 0.0, "its own lengths") if own else (DELAY_S, DELAY_SD_S, "the rope's length on the display")
    )
    variance = float(sums @ sums) / information**2 + late_sd**2
    weight = controller.clock_sd_s**2 / max(controller.clock_sd_s**2 + variance, 1e-300)
    sd = math.sqrt(weight * variance)
    if own:  # the run knew the clock no better than by a display
        sd = max(sd, min(DELAY_SD_S, controller.clock_sd_s))
    return ClockOffset(weight * (delay - late), sd, source, difference)
