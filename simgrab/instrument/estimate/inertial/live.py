"""The inertial estimator frame by frame: a fit of the first minute, and from there an extended Kalman filter."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
import scipy

from simgrab.instrument.estimate import intervals as iv
from simgrab.instrument.estimate.chain import state_covariances
from simgrab.instrument.estimate.frames import check_record, groups, mount_from_camera
from simgrab.instrument.estimate.inertial.estimator import SLEWING, InertialFusion, Start
from simgrab.instrument.estimate.inertial.fit import (
    FAST,
    NOISE,
    SLOW,
    fast_covariance,
    sensor_variance,
    slow_variance,
    velocity_precision,
)
from simgrab.instrument.estimate.inertial.model import (
    ATTITUDE,
    LEAN,
    MOMENTUM,
    PARAMETERS,
    REACH,
    STATE,
    SWING,
    VELOCITY,
    Links,
    advance,
    derivatives_of_advance,
    derivatives_of_place,
)
from simgrab.instrument.estimate.inertial.preintegration import preintegrate, rotation
from simgrab.instrument.estimate.inertial.readings import ImuReadings
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array

WARM_UP_S, AGAIN_S, MOST_START_S = 60.0, 10.0, 180.0  # how much is fitted first, how soon again, and at most
LOST_S = 20.0  # without a pixel that agrees with its prediction
SURPRISE, SURPRISES = 13.8, 3  # squared innovation that one pixel in a thousand has; so many running are the grab's own
NOT_FREE_S = 10.0  # after which the grab counts as swinging freely again
NOT_FREE_FAST, NOT_FREE_SD = 0.05, 0.02  # m²/s³, rad: what moves a grab that does not swing freely
ALL = STATE + PARAMETERS
NOTHING = np.nan, (np.nan, np.nan)


@dataclass(eq=False)
class InertialTracker:
    """Swing of each frame from what came before it.

    Parameters
    ----------
    fusion : InertialFusion
        With the readings; of them only those before a frame are used for it.
    calibration : Calibration

    Attributes
    ----------
    waiting : str
        Why there is no swing yet; empty once there is.
    """

    fusion: InertialFusion
    calibration: Calibration
    waiting: str = field(init=False, default="")
    _time: list[float] = field(init=False, default_factory=list)
    _pixels: list[tuple[float, float]] = field(init=False, default_factory=list)
    _rope: list[float] = field(init=False, default_factory=list)
    _filter: _Filter | None = field(init=False, default=None)
    _due: float = field(init=False, default=WARM_UP_S)
    _last: float = field(init=False, default=0.0)
    _refused: str = field(init=False, default="")

    def step(self, time: float, pixel: tuple[float, float] | None, rope: float) -> tuple[float, tuple[float, float]]:
        """Take a frame.

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
            Of its 95 % interval.
        """
        if self._filter is None:
            return self._collect(time, pixel, rope)
        reason = self.fusion.unfit(np.array([self._last, time]), self.fusion.readings.between(self._last, time))
        if reason or self._filter.lost:
            reason = reason or f"for {LOST_S:.0f} s no pixel agreed with the sensor"
            self._filter, self._due, self._refused = None, WARM_UP_S, reason
            self._time, self._pixels, self._rope = [], [], []
            return self._collect(time, pixel, rope)
        self._last = time
        if pixel is None or not np.isfinite(rope):
            self._filter.step(time, None, float(rope))
            return NOTHING
        self._filter.step(time, _place(pixel, self.calibration), float(rope))
        return self._filter.swing()

    def _collect(
        self, time: float, pixel: tuple[float, float] | None, rope: float
    ) -> tuple[float, tuple[float, float]]:
        """Keep a frame for the first fit, and fit when that is due."""
        if pixel is not None and np.isfinite(rope):
            self._time.append(time)
            self._pixels.append(pixel)
            self._rope.append(float(rope))
        past = time - self._time[0] if self._time else 0.0
        if past >= self._due and self._time[-1] == time:
            started = self._start()
            if isinstance(started, _Filter):
                self._filter, self.waiting, self._refused, self._last = started, "", "", time
                return started.swing()
            self._refused = started
            old = int(np.searchsorted(self._time, time - MOST_START_S))
            del self._time[:old], self._pixels[:old], self._rope[:old]
            past = time - self._time[0]
            self._due = past + AGAIN_S
        self.waiting = f"no tilt yet: {past:.0f} s of {self._due:.0f}" + f" ({self._refused})" * bool(self._refused)
        return NOTHING

    def _start(self) -> _Filter | str:
        """Fit the record so far."""
        time = np.array(self._time)
        imu = self.fusion.readings.between(time[0] - 1, time[-1])
        uv, rope, times, _ = check_record(np.array(self._pixels)[None], np.array(self._rope), time, True)
        (frames,) = groups(uv, rope, times, self.calibration)
        begun = self.fusion.start(frames, self.calibration, imu)
        return begun if isinstance(begun, str) else _Filter(self.fusion, self.calibration, begun)


class _Filter:
    """State and parameters together, `ALL` numbers, and their covariance."""

    def __init__(self, fusion: InertialFusion, calibration: Calibration, begun: Start) -> None:
        path, minimum = begun.fit.path, begun.fit.minimum
        self._imu: ImuReadings = fusion.readings.without_excess(begun.excess)
        self._fusion, self._priors, self._rest = fusion, begun.priors, begun.rest
        self._offset_sd = calibration.offset_sd_m
        self._mount_from_camera = mount_from_camera(calibration)
        self._time, self._rope = float(begun.data.time[-1]), float(begun.data.rope[-1])
        self._length = begun.data.links.length
        self._attitude, self._state, self._parameters = path.attitude[-1], path.state[-1], path.parameters
        self._strengths = path.strengths
        last = state_covariances(minimum, STATE)[-1]
        crossed = -minimum.gain.reshape(-1, STATE, PARAMETERS)[-1] @ minimum.covariance
        self._covariance = np.block([[last, crossed], [crossed.T, minimum.covariance]])
        self._surprises: deque[float] = deque(maxlen=SURPRISES)
        self._held_until, self._disagrees_since = -np.inf, np.inf

    @property
    def lost(self) -> bool:
        """Whether no pixel has agreed with its prediction for so long that the state is wrong."""
        return self._time - self._disagrees_since > LOST_S

    def swing(self) -> tuple[float, tuple[float, float]]:
        """Give α and the ends of its interval."""
        s = self._state[SWING]
        sine = float(np.hypot(*s))
        unit = s / max(sine, 1e-300)
        of_swing = self._covariance[SWING, SWING]
        along = float(unit @ of_swing @ unit)
        across = float(np.trace(of_swing)) - along
        along += (sine * self._offset_sd / self._rope) ** 2
        alpha = float(np.arcsin(min(sine, 1.0)))
        quantile = iv.student(self._fusion.intervals.level, np.inf) * self._fusion.widening
        low, high = iv.radial(np.array(alpha), np.array(along), np.array(across), quantile)
        return alpha, (float(low), float(high))

    def step(self, time: float, place: Array | None, rope: float) -> None:
        """Go on to a frame, and take its pixel in where there is one."""
        rope = rope if np.isfinite(rope) else self._rope
        parts = max(int(np.ceil((time - self._time) / self._fusion.node_s - 1e-9)), 1)
        nodes = np.linspace(self._time, time, parts + 1)
        ropes = np.linspace(self._rope, rope, parts + 1)
        summed = preintegrate(nodes, self._imu.between(nodes[0] - 1, nodes[-1]), self._mount_from_camera)
        for i in range(parts):
            one = slice(i, i + 1)
            links = Links(summed.part(one), ropes[i : i + 1], ropes[i + 1 : i + 2], self._length, self._fusion.memory_s)
            self._predict(links, float(nodes[i]))
            self._stand(links)
        self._time, self._rope = time, rope
        if place is not None:
            self._see(place, time)

    def _predict(self, links: Links, now: float) -> None:
        attitude, state = self._attitude[None], self._state[None]
        ahead, moved = advance(attitude, state, self._parameters, links)
        _, by_state, by_parameter = derivatives_of_advance(
            np.concatenate([attitude, ahead]), np.concatenate([state, moved]), self._parameters, links
        )
        carry = np.block([[by_state[0], by_parameter[0]], [np.zeros((PARAMETERS, STATE)), np.eye(PARAMETERS)]])
        added = scipy.linalg.block_diag(self._noise(links, now), np.zeros((PARAMETERS, PARAMETERS)))
        self._covariance = carry @ self._covariance @ carry.T + added
        self._attitude, self._state = ahead[0], moved[0]

    def _noise(self, links: Links, now: float) -> Array:
        """Covariance (16, 16) of what a step adds."""
        held = now < self._held_until
        added = np.diag(sensor_variance(self._priors, links.imu.step)[0])
        fast = NOT_FREE_FAST if held else float(np.exp(self._strengths[FAST]))
        slow = NOT_FREE_SD if held else float(np.exp(self._strengths[SLOW]))
        of_s, both, of_p = (float(part[0]) for part in fast_covariance(links))
        added[SWING, SWING], added[MOMENTUM, MOMENTUM] = np.eye(2) * of_s * fast, np.eye(2) * of_p * fast
        added[SWING, MOMENTUM] = added[MOMENTUM, SWING] = np.eye(2) * both * fast
        added[LEAN, LEAN] = np.eye(2) * slow**2 * float(slow_variance(links)[0])
        return added

    def _stand(self, links: Links) -> None:
        """Take in what is known of the jib head's velocity, as the fit does."""
        velocity, resting = self._state[VELOCITY], np.abs(links.imu.rate[:, 2] - self._rest) < SLEWING
        precision = float(velocity_precision(velocity[None], resting, links.imu.step, self._priors)[0])
        jacobian = np.zeros((2, ALL))
        jacobian[:, VELOCITY] = np.eye(2)
        self._update(jacobian, -velocity, np.eye(2) / precision)

    def _see(self, place: Array, now: float) -> None:
        at, by_state, by_parameter = derivatives_of_place(
            self._attitude[None], self._state[None], self._parameters, np.array([self._rope])
        )
        jacobian, error = np.concatenate([by_state[0], by_parameter[0]], axis=-1), place - at[0]
        noise = np.eye(2) * float(np.exp(2 * self._strengths[NOISE]))
        surprise = float(error @ np.linalg.solve(jacobian @ self._covariance @ jacobian.T + noise, error))
        self._surprises.append(surprise)
        self._disagrees_since = min(self._disagrees_since, now) if surprise > SURPRISE else np.inf
        degrees = self._priors.degrees
        if len(self._surprises) == SURPRISES and min(self._surprises) > SURPRISE:
            # So many outliers running are none: the grab does not swing freely.
            self._held_until = now + NOT_FREE_S
            loose = np.arange(SWING.start, LEAN.stop)
            self._covariance[loose, loose] += NOT_FREE_SD**2
        else:
            noise = noise * (degrees + surprise) / (degrees + 2)
        self._update(jacobian, error, noise)

    def _update(self, jacobian: Array, error: Array, noise: Array) -> None:
        gain = np.linalg.solve(jacobian @ self._covariance @ jacobian.T + noise, jacobian @ self._covariance).T
        change = gain @ error
        kept = np.eye(ALL) - gain @ jacobian
        self._covariance = kept @ self._covariance @ kept.T + gain @ noise @ gain.T
        beyond = self._parameters[REACH] + change[STATE + REACH]
        if beyond > 0:  # as the fit does
            change = change - beyond * self._covariance[STATE + REACH] / self._covariance[STATE + REACH, STATE + REACH]
        self._attitude = self._attitude @ rotation(change[ATTITUDE])
        self._state = self._state + change[:STATE]
        self._state[ATTITUDE] = 0
        self._parameters = self._parameters + change[STATE:]


def _place(pixel: tuple[float, float], calibration: Calibration) -> Array:
    uv, _, _, _ = check_record(np.array([[pixel]]), None, None, False)
    (frames,) = groups(uv, None, None, calibration)
    ray = frames.rays[0, :, 0]
    return np.asarray(ray[:2] / -ray[2])
