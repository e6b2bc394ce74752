"""The swing where the camera levels itself: picture, rope length and one inertial sensor in the camera's housing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import scipy

from simgrab.errors import RecordError
from simgrab.instrument.estimate import intervals as iv
from simgrab.instrument.estimate.chain import state_covariances
from simgrab.instrument.estimate.frames import Frames, interpolated, mount_from_camera, tilt_of
from simgrab.instrument.estimate.inertial.fit import ROUNDS, InertialFit, InertialPriors, NodeData, Path, fit
from simgrab.instrument.estimate.inertial.model import (
    ACCELEROMETER,
    ATTITUDE,
    CROSS,
    DAMPING,
    GYROSCOPE,
    LONGER,
    MOMENTUM,
    OFFSET,
    PARAMETERS,
    REACH,
    STATE,
    SWING,
    VELOCITY,
    WIND,
    ImuLinks,
    heading,
)
from simgrab.instrument.estimate.inertial.preintegration import Preintegrated, preintegrate, rotation
from simgrab.instrument.estimate.inertial.readings import ImuReadings
from simgrab.instrument.estimate.motion import EstimatedMotion, PathEstimator
from simgrab.instrument.estimate.pendulum import THIN_S, Nodes
from simgrab.instrument.estimate.rope_aware import RopeAware
from simgrab.instrument.estimate.strengths import FAST, NOISE, SLOW
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import STANDARD_GRAVITY, Array, lean, rotation_z
from simgrab.model.records.estimates import Estimates

LEVELLING_S = 30.0  # in which the first guess of the attitude follows the accelerometer
START_SD = 0.3  # of the first s and p
HEADING_SD = 1e-3  # rad: the level frame's heading is the first node's
SMOOTH_FRAMES = 3.0  # standard deviation of the filter of the first guess of the swings
MOST_EXCESS = 1.0  # m/s², of the mean specific force over g
FREE = 0.5  # least weight of a step in which the grab counts as swinging freely
CUT_S = 60.0  # a record with a longer step between frames is refused
GAP_S = 0.1  # and one whose sensor is silent for longer
MOST_NOT_FREE = 0.3  # and one in more of which the grab does not swing as the sensor says
# Factor on the intervals of α for what the model leaves out, such as the grab's own changing shape; chosen on working
# cycles, whose intervals cover 60 to 100 % of the frames without it.
WIDENING = 1.4
SLEWING = 4e-3  # rad/s: a jib that turns faster slews
REST_S = 0.2  # readings about the vertical are averaged over so long before their most frequent value is sought


@dataclass(frozen=True, eq=False)
class FilterStart:
    """A fitted record, from which later frames can be filtered.

    Attributes
    ----------
    data : NodeData
    fit : InertialFit
    priors : InertialPriors
    rest : float
        Reading of the gyroscope about the optical axis while the jib stands, rad/s.
    excess : float
        See `ImuReadings.excess`.
    """

    data: NodeData
    fit: InertialFit
    priors: InertialPriors
    rest: float
    excess: float


@dataclass(frozen=True)
class InertialFusion(PathEstimator):
    """Attitude of the camera from an inertial sensor in its housing, and a pendulum that the same sensor drives.

    A camera that levels itself follows apparent gravity as the grab does, so pictures cannot separate the two motions.
    The gyroscope measures the camera's rotation, and the accelerometer the acceleration of the rope exit. Attitude,
    biases, camera offset, pendulum and wind are at their common posterior mode (an iterated extended Kalman smoother);
    the strengths of wind and pixel noise maximise the likelihood. Steady wind keeps its direction over the ground while
    the jib slews, which distinguishes it from tilt. Mounts of any kind are treated alike.

    Attributes
    ----------
    imu : ImuReadings or None
        Readings over the whole record. Without them there is no estimate.
    damping, damping_sd : float
        Prior of the damping ratio.
    reach_sd_m : float
        Prior of the reach: |OA| and the reach, times the lean of the ropes, displace the grab. Half of a normal
        distribution below 0. It is 0 if grab and ropes are in line, and minus the height of the rope ends above A if
        the grab's head stays level.
    longer_m, longer_sd_m : float
        Prior of the length of the equivalent simple pendulum minus |OA| and the reach.
    wind_sd : float
        Prior standard deviation of the steady lean by wind, rad per axis.
    tilt_sd : float
        Prior standard deviation of the tilt, rad per axis.
    gyroscope_sd, vertical_sd : float
        Prior standard deviations of the gyroscope's bias about its mean over the record, and, about the vertical, about
        its most frequent reading, which is that of a jib at rest; rad/s.
    accelerometer_sd : float
        Prior standard deviation of the accelerometer's bias, m/s².
    cross_sd : float
        Prior standard deviation of the gyroscope's scale error and misalignments.

    Notes
    -----
    β is the tilt of the mean attitude. Diagnostics: ``forcing`` (white acceleration, m²/s³ per axis), ``lean_sd``
    (gusts, rad per axis), ``wind`` (steady lean, rad), ``noise_px``, ``damping``, ``longer_m``, ``reach_m`` (0 or
    negative), ``gyroscope_bias`` (largest, rad/s), ``not_free`` (share of the record in which the grab does not swing
    freely), ``rounds``.

    The pendulum is after Schaper et al. (2014), who have the sensor on the rope; preintegration after Forster et al.
    (2017).
    """

    name: ClassVar[str] = "inertial-fusion"
    parameters: ClassVar[int] = 21
    needs_imu: ClassVar[bool] = True

    imu: ImuReadings | None = None
    damping: float = 0.005
    damping_sd: float = 0.005
    longer_m: float = 0.4
    longer_sd_m: float = 0.5
    reach_sd_m: float = 1.5
    wind_sd: float = 0.006
    tilt_sd: float = 0.35
    gyroscope_sd: float = 0.02
    vertical_sd: float = 0.003
    accelerometer_sd: float = 0.4
    cross_sd: float = 0.01

    @property
    def readings(self) -> ImuReadings:
        """The sensor's readings; raises `RecordError` where there are none."""
        if self.imu is None:
            raise RecordError(f"{self.name} needs the readings of an inertial sensor in the camera's housing")
        return self.imu

    def _conclude(self, frames: Frames, calibration: Calibration) -> Estimates:
        if len(frames.count) != 1:
            raise RecordError(f"{self.name} takes one record at a time: the sensor's readings belong to one")
        return super()._conclude(frames, calibration)

    def _motion(self, frames: Frames, calibration: Calibration) -> EstimatedMotion | str:
        begun = self.start(frames, calibration, self.readings)
        return begun if isinstance(begun, str) else self._found(begun, calibration)

    def start(self, frames: Frames, calibration: Calibration, imu: ImuReadings) -> FilterStart | str:
        """Fit one record; returns the reason if that is impossible."""
        assert frames.time is not None
        assert frames.rope_length is not None
        time, length = frames.time, float(frames.rope_length.mean())
        if reason := self.unfit(time, imu):
            return reason
        excess = imu.between(time[0] - 1, time[-1] + 1).excess
        if abs(excess) > MOST_EXCESS:
            force = excess + STANDARD_GRAVITY
            return f"the mean specific force is {force:.2f} m/s²; at rest it is 9.81: is the accelerometer in m/s²?"
        imu = imu.without_excess(excess)
        rough = RopeAware().fit(frames, calibration)
        level = lean(*(float(angle) for angle in (a[0] for a in tilt_of(rough.down))))
        turn = mount_from_camera(calibration)
        priors = self._priors(calibration, imu)
        rates = imu.rate @ (turn @ imu.camera_from_sensor).T
        rest = _at_rest(imu.time, rates[:, 2])

        def at(some: slice) -> NodeData:
            nodes = Nodes.of(frames, some)
            summed = preintegrate(nodes.time, imu, turn)
            links = ImuLinks.of(summed, nodes.rope, length)
            turning = np.abs(summed.rate[:, 2] - rest)
            resting = np.maximum(np.append(turning, 0), np.append(0, turning)) < SLEWING
            return NodeData(**vars(nodes), resting=resting, links=links, focal_px=calibration.focal_length_px)

        every = max(min(int(THIN_S / np.median(np.diff(time))), len(time) // self.parameters), 1)
        try:
            few = slice(None, None, every)
            thin = at(few if frames.places()[0][few].sum() >= self.parameters else slice(None))
            first = self._first(thin, level, rough.offset[0], np.array([*rates[:, :2].mean(axis=0), rest]))
            found = fit(thin, first, first, priors)
            whole = at(slice(None))
            path = _refined(found.path, thin, whole)
            found = fit(whole, replace(path, state=_like(path, first)), path, priors, 0)
        except np.linalg.LinAlgError:
            return "pictures and sensor do not fit: are they of the same record?"
        if not found.converged:
            return f"not converged in {ROUNDS} rounds"
        odd = float(np.mean(found.path.weight < FREE))
        if odd > MOST_NOT_FREE:
            return f"for {100 * odd:.0f} % of the record the pictures contradict the sensor: is it of this record?"
        return FilterStart(whole, found, priors, rest, excess)

    def unfit(self, time: Array, imu: ImuReadings) -> str:
        """Return why readings do not cover frames at times (n,), or frames are too far apart; empty if they do."""
        pause = np.diff(time)
        if len(pause) and pause.max() > CUT_S:
            return f"no frame for {pause.max():.1f} s at {time[pause.argmax()]:.1f} s; at most {CUT_S:g} s"
        if imu.time[0] > time[0] + GAP_S or imu.time[-1] < time[-1] - GAP_S:
            return (
                f"the sensor's readings last from {imu.time[0]:.2f} to {imu.time[-1]:.2f} s, and the frames from "
                f"{time[0]:.2f} to {time[-1]:.2f} s"
            )
        begin = max(int(np.searchsorted(imu.time, time[0], side="right")) - 1, 0)
        inside = imu.time[begin : int(np.searchsorted(imu.time, time[-1])) + 1]
        silent = np.diff(inside)
        if silent.max(initial=0.0) > GAP_S:
            return f"the sensor is silent for {silent.max():.2f} s at {inside[silent.argmax()]:.2f} s"
        return ""

    def _priors(self, calibration: Calibration, imu: ImuReadings) -> InertialPriors:
        mean, sd = np.zeros(PARAMETERS), np.empty(PARAMETERS)
        mean[OFFSET], mean[DAMPING], mean[LONGER] = calibration.offset_m, self.damping, self.longer_m
        # The offset's height scales the whole path: it is taken as it is, and widens the intervals.
        sd[OFFSET] = [max(calibration.offset_sd_m, 1e-4)] * 2 + [1e-6]
        sd[DAMPING], sd[LONGER], sd[REACH] = self.damping_sd, self.longer_sd_m, self.reach_sd_m
        sd[CROSS], sd[WIND] = self.cross_sd, self.wind_sd
        first = np.full(STATE, np.inf)
        first[ATTITUDE] = self.tilt_sd, self.tilt_sd, HEADING_SD
        first[GYROSCOPE] = self.gyroscope_sd, self.gyroscope_sd, self.vertical_sd
        first[ACCELEROMETER] = self.accelerometer_sd
        first[SWING] = first[MOMENTUM] = START_SD
        # The densities are the maker's; aliasing, rounding and the model's own errors come on top.
        walk = np.zeros(STATE)
        walk[ATTITUDE] = 1.2 * imu.gyroscope_noise_density + 5e-5
        walk[VELOCITY] = 1.2 * imu.accelerometer_noise_density + 2e-3
        walk[GYROSCOPE] = 1.2 * imu.gyroscope_random_walk + 1e-6
        walk[ACCELEROMETER] = 1.2 * imu.accelerometer_random_walk + 1e-5
        return InertialPriors(mean, sd, first, walk)

    def _first(self, data: NodeData, level: Array, offset: Array, bias: Array) -> Path:
        """Guess a path: attitudes from the gyroscope with a bias (3,) and a tilt (3, 3), swings from the pixels."""
        k, summed = len(data.time), data.links.imu
        force_bias = np.average(summed.force, axis=0, weights=summed.step) - STANDARD_GRAVITY * level[2]
        attitude = np.empty((k, 3, 3))
        attitude[0] = level
        up = summed.force - force_bias
        up /= np.linalg.norm(up, axis=-1, keepdims=True)
        turns = summed.turn @ rotation(-bias * summed.step[:, None])
        for i in range(k - 1):
            towards = np.cross(up[i], attitude[i, 2])
            attitude[i + 1] = attitude[i] @ turns[i] @ rotation(towards * (summed.step[i] / LEVELLING_S))
        state, parameters = np.zeros((k, STATE)), np.zeros(PARAMETERS)
        state[:, GYROSCOPE], state[:, ACCELEROMETER] = bias, force_bias[:2]
        parameters[OFFSET], parameters[DAMPING], parameters[LONGER] = offset, self.damping, self.longer_m
        ray = np.concatenate([data.place, -np.ones((k, 1))], axis=-1)
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        grab = np.einsum("nij,nj->ni", attitude, ray) * data.rope[:, None]
        grab += np.einsum("nij,j->ni", rotation_z(heading(attitude)), offset)
        swing = grab[:, :2] / np.linalg.norm(grab, axis=-1, keepdims=True)
        known = np.flatnonzero(data.seen)
        bridged = interpolated(np.arange(k), known, swing[known])
        state[:, SWING] = scipy.ndimage.gaussian_filter1d(bridged, SMOOTH_FRAMES, axis=0)
        scale = (data.rope / data.links.length)[:, None] ** 2
        state[:, MOMENTUM] = np.gradient(state[:, SWING], data.time, axis=0) * scale
        strengths = np.log([1e-3, 1.5 / data.focal_px, 3e-3])
        return Path(attitude, state, parameters, strengths, np.ones(k - 1))

    def _found(self, begun: FilterStart, calibration: Calibration) -> EstimatedMotion:
        data, path, frame = begun.data, begun.fit.path, begun.data.frame
        covariance, s = state_covariances(begun.fit.minimum, STATE)[frame], path.state[frame, SWING]
        of_swing = covariance[:, SWING, SWING]
        down = -path.attitude[frame, 2].mean(axis=0)
        beta, azimuth = (float(angle) for angle in tilt_of(down / np.linalg.norm(down)))
        axis = np.array([-np.sin(azimuth), np.cos(azimuth)])  # about which β turns
        along, across = iv.split(covariance[:, :2, :2].mean(axis=0), axis)
        # An error of the offset's height makes all swings as much larger or smaller as it is a share of the rope.
        stretch = np.hypot(*s.T) * calibration.offset_sd_m / data.rope[frame]
        found = EstimatedMotion(
            beta=beta,
            azimuth=azimuth,
            tilt_variance=(along, across),
            swing=s,
            covariance=of_swing * WIDENING**2,
            sigma2_variance=0.0,
            offset=path.parameters[OFFSET],
            stretch_variance=(stretch * WIDENING) ** 2,
            diagnostics={
                "forcing": np.exp(path.strengths[FAST]),
                "lean_sd": np.exp(path.strengths[SLOW]),
                "wind": float(np.hypot(*path.parameters[WIND])),
                "noise_px": np.exp(path.strengths[NOISE]) * data.focal_px,
                "damping": path.parameters[DAMPING],
                "longer_m": path.parameters[LONGER],
                "reach_m": path.parameters[REACH],
                "gyroscope_bias": float(np.abs(path.state[:, GYROSCOPE]).max()),
                "not_free": float(np.mean(path.weight < FREE)),
                "rounds": begun.fit.rounds,
            },
        )
        of_sigma2 = 4 * np.mean(iv.split(of_swing, s)[0]) * np.mean(found.alpha) ** 2
        return replace(found, sigma2_variance=float(of_sigma2))


def _at_rest(time: Array, rate: Array) -> float:
    """Most frequent of some readings, s and rad/s (half-sample mode: Robertson & Cryer 1974)."""
    many = max(int(REST_S / np.median(np.diff(time))), 1)
    values = np.sort(np.convolve(rate, np.full(many, 1 / many), "valid")[::many])
    while len(values) > 3:
        half = (len(values) + 1) // 2
        first = int(np.argmin(values[half - 1 :] - values[: len(values) - half + 1]))
        values = values[first : first + half]
    return float(values.mean())


def _refined(path: Path, thin: NodeData, whole: NodeData) -> Path:
    """Transfer a path to more nodes; the gyroscope continues attitudes from the previous node."""
    last = np.clip(np.searchsorted(thin.time, whole.time, side="right") - 1, 0, len(thin.time) - 1)
    state = interpolated(whole.time, thin.time, path.state)
    attitude = np.empty((len(whole.time), 3, 3))
    summed: Preintegrated = whole.links.imu
    bias = state[:-1, GYROSCOPE] + path.parameters[CROSS] * summed.rate[:, 2:]
    turns = summed.turn @ rotation(-bias * summed.step[:, None])
    fresh = np.concatenate([[True], last[1:] > last[:-1]])
    for i in range(len(attitude)):
        attitude[i] = path.attitude[last[i]] if fresh[i] else attitude[i - 1] @ turns[i - 1]
    link = np.minimum(last[:-1], len(path.weight) - 1)
    return Path(attitude, state, path.parameters, path.strengths, path.weight[link])


def _like(path: Path, first: Path) -> Array:
    """States whose first node has the prior means of the biases."""
    state = path.state.copy()
    state[0, GYROSCOPE], state[0, ACCELEROMETER] = first.state[0, GYROSCOPE], first.state[0, ACCELEROMETER]
    return state
