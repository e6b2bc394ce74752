"""The swing frame by frame with an inertial sensor: fits of the last minutes, and from there on the camera's attitude.

Every few seconds a thread smooths the readings again, and now and then fits the tilt. Its result is used from a fixed
time after that on, so that a run repeats; until then the gyroscope turns the camera on.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from simgrab.instrument.estimate import intervals as iv
from simgrab.instrument.estimate.chain import state_covariances
from simgrab.instrument.estimate.contract import Estimator
from simgrab.instrument.estimate.frames import groups
from simgrab.instrument.estimate.inertial.sensed import Sensed, sensed, unfit
from simgrab.instrument.estimate.pendulum import CLOCK, SCALE, STATE, TILT, camera, looked_along, of_tilt
from simgrab.instrument.estimate.pendulum_smoother import PendulumSmoother
from simgrab.instrument.estimate.strengths import NOISE
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array

WARM_UP_S, AGAIN_S, MOST_S = 60.0, 10.0, 180.0  # how much is fitted first, how soon again, and at most
FITS = 12  # every so many times the tilt is fitted too
LOST_S, LEAST_AGREE = 20.0, 0.1  # share of the pixels that moves as a grab can; if it is less, they show none
MOST_FORCE = 20.0  # m/s², that ropes and cargo give a grab
PAUSE_S = 60.0  # between frames, after which a run starts again
LEAN_SD = 1.5e-3  # rad, chosen, of what the sensor reports of the camera's lean since the last fit
LEAN = slice(STATE, STATE + 2)  # of a state: the error of the sensor's lean
NOTHING = np.nan, (np.nan, np.nan)
Kept = tuple[float, tuple[float, float], float]


@dataclass(frozen=True, eq=False)
class _Tilt:
    """Parameters of a fit, the lean's drift (2,), the pixels' noise, and the times of the first and the last frame.

    ``covariance`` (8, 8) is that of tilt, scale, and drift.
    """

    parameters: Array
    drift: Array
    covariance: Array
    noise: float
    first: float
    last: float


class InertialTracker:
    """Swing of each frame from the frames before it.

    Parameters
    ----------
    smoother : PendulumSmoother
        Estimator with the readings; only readings before a frame are used for it.
    calibration : Calibration

    Attributes
    ----------
    waiting : str
        Why there is no swing yet; empty once there is one.
    direction : ndarray, shape (2,)
        Horizontal part of the unit direction OA in the last frame, level frame; NaN without a swing.
    """

    def __init__(self, smoother: Estimator, calibration: Calibration) -> None:
        assert isinstance(smoother, PendulumSmoother)
        assert smoother.imu is not None
        self.smoother, self.calibration, self._imu = smoother, calibration, smoother.imu
        self.waiting, self.direction, self._last = "", np.full(2, np.nan), np.nan
        self._thread = ThreadPoolExecutor(1)
        self._due: float
        self._restart("")

    def step(self, time: float, pixel: tuple[float, float] | None, rope: float) -> tuple[float, tuple[float, float]]:
        """Process a frame.

        Parameters
        ----------
        time : float
            s, later than the frame before.
        pixel : tuple of 2 floats, or None
            Grab centre as the picture has it.
        rope : float
            |OA|, m; NaN where it is not known.

        Returns
        -------
        alpha : float
            rad; NaN while there is none, or no pixel or rope length.
        ends : tuple of 2 floats
            Ends of its 95 % interval.
        """
        before, self._last = time if np.isnan(self._last) else self._last, time
        if time - before > PAUSE_S:
            self._restart(f"no frame for {time - before:.1f} s; at most {PAUSE_S:g} s")
        elif reason := unfit(np.array([before, time]), self._imu):
            self._restart(reason)
        elif self._lost(time):
            self._restart(f"for {LOST_S:.0f} s hardly a pixel agreed with the sensor")
        if not np.isfinite(rope):
            pixel = None
        if pixel is not None:
            self._kept.append((time, pixel, rope))
        if self._kept and np.isnan(self._due):
            self._due = self._kept[0][0] + WARM_UP_S
        if self._kept and time >= self._due:
            self._exchange(time)
        self.direction = np.full(2, np.nan)
        if self._now is None:
            past = time - self._kept[0][0] if self._kept else 0.0
            self.waiting = f"no tilt yet: {past:.0f} s of {WARM_UP_S:.0f}" + f" ({self._refused})" * bool(self._refused)
            return NOTHING
        self.waiting = ""
        return NOTHING if pixel is None else self._swing(time, pixel, rope)

    def _restart(self, reason: str) -> None:
        self._refused, self._jobs, self._due = reason, 0, np.nan
        self._now: tuple[Sensed, _Tilt] | None = None
        self._next: Future[tuple[Sensed, _Tilt] | str] | None = None
        self._kept: list[Kept] = []
        self._places: list[tuple[float, Array]] = []
        self._agree: list[tuple[float, bool]] = []

    def _exchange(self, time: float) -> None:
        """Take over what the thread found, and give it the record so far."""
        self._take()
        self._due = time + AGAIN_S
        fits = self._jobs % FITS == 0
        tilt = None if fits or self._now is None else self._now[1]
        first = time - MOST_S if tilt is None else tilt.first
        self._kept = [frame for frame in self._kept if frame[0] >= first]
        if len(self._kept) < self.smoother.parameters:
            return
        self._jobs += 1
        self._next = self._thread.submit(self._job, list(self._kept), tilt, time)
        if self._now is None:  # there is no swing without it
            self._take()

    def _take(self) -> None:
        if self._next is None:
            return
        found, self._next, self._refused = self._next.result(), None, ""
        if isinstance(found, str):
            self._now, self._jobs, self._refused = None, 0, found
        else:
            self._now = found

    def _job(self, kept: list[Kept], tilt: _Tilt | None, now: float) -> tuple[Sensed, _Tilt] | str:
        """Smooth the readings of a record, and fit it if there is no tilt."""
        time, pixels, rope = (np.array(column) for column in zip(*kept, strict=True))
        imu = self._imu.between(time[0], now)
        if tilt is not None:
            return sensed(imu, self.calibration), tilt
        (frames,) = groups(pixels[None], rope[None], time, self.calibration)
        solved = self.smoother.solve(frames, self.calibration, imu)
        if isinstance(solved, str):
            return solved
        assert solved.sensed is not None
        fit = solved.fit
        parameters, size = fit.parameters.copy(), fit.path.shape[1]
        parameters[CLOCK] = 0.0
        last = state_covariances(fit.minimum, size)[-1, LEAN, LEAN]
        gain = fit.minimum.gain.reshape(-1, size, len(parameters))[-1, LEAN]
        both, some = fit.minimum.covariance, np.r_[TILT, SCALE]
        crossed = -gain @ both[:, some]
        covariance = np.block([[both[np.ix_(some, some)], crossed.T], [crossed, last]])
        return solved.sensed, _Tilt(
            parameters, fit.path[-1, LEAN], covariance, float(np.exp(fit.strengths[NOISE])), *time[[0, -1]].tolist()
        )

    def _swing(self, time: float, pixel: tuple[float, float], rope: float) -> tuple[float, tuple[float, float]]:
        assert self._now is not None
        motion, tilt = self._now
        if time > motion.motion.time[-1]:
            motion = motion.later(self._imu, time, self.calibration)
            self._now = motion, tilt
        (frames,) = groups(np.array([[pixel]]), None, None, self.calibration)
        turn, offset = camera(tilt.parameters, np.array([time]), motion.motion, tilt.drift)
        (self.direction,) = looked_along(turn, frames.places(), np.array([rope]), offset)
        sine = float(np.hypot(*self.direction))
        self._compare(time, rope * self.direction, rope * tilt.noise)
        by = np.hstack([of_tilt(motion.motion.at(np.array([time]))[0, 4:])[:, np.r_[TILT, SCALE]], np.eye(2)])
        since = max(time - tilt.last, 0.0) * motion.motion.drifts[0][0] ** 2
        own = np.eye(2) * (tilt.noise**2 + LEAN_SD**2 + since)
        along, across = iv.split(by @ tilt.covariance @ by.T + own, self.direction)
        along = along + (sine * self.calibration.offset_sd_m / rope) ** 2
        alpha = float(np.arcsin(min(sine, 1.0)))
        quantile = iv.student(iv.LEVEL, np.inf)
        low, high = iv.radial(np.array(alpha), along, across, quantile)
        return alpha, (float(low), float(high))

    def _compare(self, time: float, place: Array, noise: float) -> None:
        """Note whether a grab can have moved by way of the last three places (2,), m, which pixels err by a noise."""
        self._places = [*self._places[-2:], (time, place)]
        if len(self._places) == 3:
            times, places = (np.array(column) for column in zip(*self._places, strict=True))
            step = np.diff(times)
            turn = np.hypot(*np.diff(np.diff(places, axis=0) / step[:, None], axis=0)[0])
            agrees = turn < MOST_FORCE * step.mean() + 4 * noise * np.sum(1 / step)
            self._agree.append((time, bool(agrees)))

    def _lost(self, time: float) -> bool:
        """Whether hardly a pixel of the last `LOST_S` moved as a grab can."""
        if not self._agree or self._agree[0][0] > time - LOST_S:
            return False
        self._agree = [one for one in self._agree if one[0] > time - LOST_S - 1]
        return bool(self._agree) and float(np.mean([agrees for _, agrees in self._agree])) < LEAST_AGREE
