"""The inertial estimator frame by frame: a fit of the first minute, and from there an extended Kalman filter."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
import scipy

from simgrab.instrument.estimate import intervals as iv
from simgrab.instrument.estimate.chain import state_covariances, update
from simgrab.instrument.estimate.frames import groups, mount_from_camera
from simgrab.instrument.estimate.inertial.estimator import SLEWING, WIDENING, FilterStart, InertialFusion
from simgrab.instrument.estimate.inertial.fit import velocity_precision
from simgrab.instrument.estimate.inertial.model import (
    ATTITUDE,
    LEAN,
    PARAMETERS,
    REACH,
    STATE,
    SWING,
    VELOCITY,
    ImuLinks,
    advance,
    derivatives_of_advance,
    derivatives_of_place,
)
from simgrab.instrument.estimate.inertial.preintegration import preintegrate, rotation
from simgrab.instrument.estimate.inertial.readings import ImuReadings
from simgrab.instrument.estimate.pendulum import DEGREES, NODE_S, of_axes
from simgrab.instrument.estimate.strengths import FAST, NOISE, SLOW
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
    """Swing of each frame from the frames before it.

    Parameters
    ----------
    fusion : InertialFusion
        Estimator with the readings; only readings before a frame are used for it.
    calibration : Calibration

    Attributes
    ----------
    waiting : str
        Why there is no swing yet; empty once there is one.
    """

    fusion: InertialFusion
    calibration: Calibration
    waiting: str = field(init=False, default="")
    _kept: list[tuple[float, tuple[float, float], float]] = field(init=False, default_factory=list)
    _filter: _Filter | None = field(init=False, default=None)
    _due: float = field(init=False, default=WARM_UP_S)
    _refused: str = field(init=False, default="")

    @property
    def direction(self) -> Array:
        """Horizontal part of the unit direction OA in the last frame, level frame, shape (2,); NaN without a swing."""
        return np.full(2, np.nan) if self._filter is None else self._filter.direction

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
        filter_ = self._filter
        if filter_ is None:
            return self._collect(time, pixel, rope)
        reason = self.fusion.unfit(np.array([filter_.time, time]), self.fusion.readings.between(filter_.time, time))
        if reason or filter_.lost:
            self._refused = reason or f"for {LOST_S:.0f} s no pixel agreed with the sensor"
            self._filter, self._due, self._kept = None, WARM_UP_S, []
            return self._collect(time, pixel, rope)
        usable = pixel is not None and np.isfinite(rope)
        filter_.step(time, _place(pixel, self.calibration) if pixel is not None and usable else None, float(rope))
        return filter_.swing() if usable else NOTHING

    def _collect(
        self, time: float, pixel: tuple[float, float] | None, rope: float
    ) -> tuple[float, tuple[float, float]]:
        """Keep a frame for the first fit, and fit when the time has come."""
        if pixel is not None and np.isfinite(rope):
            self._kept.append((time, pixel, float(rope)))
        past = time - self._kept[0][0] if self._kept else 0.0
        if past >= self._due and self._kept[-1][0] == time:
            started = self._start()
            if isinstance(started, _Filter):
                self._filter, self.waiting, self._refused = started, "", ""
                return started.swing()
            self._refused = started
            self._kept = [frame for frame in self._kept if frame[0] >= time - MOST_START_S]
            past = time - self._kept[0][0]
            self._due = past + AGAIN_S
        self.waiting = f"no tilt yet: {past:.0f} s of {self._due:.0f}" + f" ({self._refused})" * bool(self._refused)
        return NOTHING

    def _start(self) -> _Filter | str:
        """Fit the record so far."""
        time, pixels, rope = (np.array(column) for column in zip(*self._kept, strict=True))
        (frames,) = groups(pixels[None], rope[None], time, self.calibration)
        begun = self.fusion.start(frames, self.calibration, self.fusion.readings.between(time[0] - 1, time[-1]))
        return begun if isinstance(begun, str) else _Filter(self.fusion, self.calibration, begun)


class _Filter:
    """State and parameters together, `ALL` numbers, and their covariance."""

    def __init__(self, fusion: InertialFusion, calibration: Calibration, begun: FilterStart) -> None:
        path, minimum = begun.fit.path, begun.fit.minimum
        self._imu: ImuReadings = fusion.readings.without_excess(begun.excess)
        self._fusion, self._priors, self._rest = fusion, begun.priors, begun.rest
        self._offset_sd = calibration.offset_sd_m
        self._mount_from_camera = mount_from_camera(calibration)
        self.time, self._rope = float(begun.data.time[-1]), float(begun.data.rope[-1])
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
        return self.time - self._disagrees_since > LOST_S

    @property
    def direction(self) -> Array:
        """Horizontal part of the unit direction OA, level frame."""
        return self._state[SWING]

    def swing(self) -> tuple[float, tuple[float, float]]:
        """Give α and the ends of its interval."""
        s = self._state[SWING]
        sine = float(np.hypot(*s))
        along, across = iv.split(self._covariance[SWING, SWING], s)
        along = along + (sine * self._offset_sd / self._rope) ** 2
        alpha = float(np.arcsin(min(sine, 1.0)))
        quantile = iv.student(self._fusion.intervals.level, np.inf) * WIDENING
        low, high = iv.radial(np.array(alpha), along, across, quantile)
        return alpha, (float(low), float(high))

    def step(self, time: float, place: Array | None, rope: float) -> None:
        """Advance to a frame, and update with its pixel if there is one."""
        rope = rope if np.isfinite(rope) else self._rope
        parts = max(int(np.ceil((time - self.time) / NODE_S - 1e-9)), 1)
        nodes = np.linspace(self.time, time, parts + 1)
        ropes = np.linspace(self._rope, rope, parts + 1)
        summed = preintegrate(nodes, self._imu.between(nodes[0] - 1, nodes[-1]), self._mount_from_camera)
        for i in range(parts):
            one = slice(i, i + 1)
            links = ImuLinks.of(summed.part(one), ropes[i : i + 2], self._length)
            self._predict(links, float(nodes[i]))
            self._stand(links)
        self.time, self._rope = time, rope
        if place is not None:
            self._see(place, time)

    def _predict(self, links: ImuLinks, now: float) -> None:
        attitude, state = self._attitude[None], self._state[None]
        ahead, moved = advance(attitude, state, self._parameters, links)
        _, by_state, by_parameter = derivatives_of_advance(
            np.concatenate([attitude, ahead]), np.concatenate([state, moved]), self._parameters, links
        )
        carry = np.block([[by_state[0], by_parameter[0]], [np.zeros((PARAMETERS, STATE)), np.eye(PARAMETERS)]])
        added = scipy.linalg.block_diag(self._noise(links, now), np.zeros((PARAMETERS, PARAMETERS)))
        self._covariance = carry @ self._covariance @ carry.T + added
        self._attitude, self._state = ahead[0], moved[0]

    def _noise(self, links: ImuLinks, now: float) -> Array:
        """Covariance (16, 16) that a step adds."""
        held = now < self._held_until
        fast = NOT_FREE_FAST if held else float(np.exp(self._strengths[FAST]))
        slow = NOT_FREE_SD if held else float(np.exp(self._strengths[SLOW]))
        of_pendulum = of_axes(links.fast * fast, SWING.start, STATE) + of_axes(links.slow * slow**2, LEAN.start, STATE)
        return np.asarray(of_pendulum[0] + np.diag(self._priors.walk**2 * links.step))

    def _stand(self, links: ImuLinks) -> None:
        """Update with the prior of the jib head's velocity, as the fit does."""
        velocity, resting = self._state[VELOCITY], np.abs(links.imu.rate[:, 2] - self._rest) < SLEWING
        precision = float(velocity_precision(velocity[None], resting, links.step)[0])
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
        if len(self._surprises) == SURPRISES and min(self._surprises) > SURPRISE:
            # So many outliers running are none: the grab does not swing freely.
            self._held_until = now + NOT_FREE_S
            loose = np.arange(SWING.start, LEAN.stop)
            self._covariance[loose, loose] += NOT_FREE_SD**2
        else:
            noise = noise * (DEGREES + surprise) / (DEGREES + 2)
        self._update(jacobian, error, noise)

    def _update(self, jacobian: Array, error: Array, noise: Array) -> None:
        change, self._covariance = update(self._covariance, jacobian, error, noise)
        beyond = self._parameters[REACH] + change[STATE + REACH]
        if beyond > 0:  # as the fit does
            change = change - beyond * self._covariance[STATE + REACH] / self._covariance[STATE + REACH, STATE + REACH]
        self._attitude = self._attitude @ rotation(change[ATTITUDE])
        self._state = self._state + change[:STATE]
        self._state[ATTITUDE] = 0
        self._parameters = self._parameters + change[STATE:]


def _place(pixel: tuple[float, float], calibration: Calibration) -> Array:
    (frames,) = groups(np.array([[pixel]]), None, None, calibration)
    return np.asarray(frames.places()[1][0])
