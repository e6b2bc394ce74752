"""The tilt as the centre of a pendulum's motion, which less than one period is enough to show."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from simgrab.errors import RecordError
from simgrab.instrument.controller import Controller
from simgrab.instrument.estimate import intervals as iv
from simgrab.instrument.estimate.chain import state_covariances
from simgrab.instrument.estimate.contract import Estimator, joined
from simgrab.instrument.estimate.frames import Frames, interpolated, tilt_of
from simgrab.instrument.estimate.inertial.readings import ImuReadings
from simgrab.instrument.estimate.inertial.sensed import Sensed, sensed, unfit
from simgrab.instrument.estimate.jib import JibMotion
from simgrab.instrument.estimate.pendulum import (
    CLOCK,
    DAMPING,
    DEGREES,
    FOLLOWS,
    FREQUENCY,
    LEVELLING,
    LONGER,
    LUFFING,
    OFFSET,
    PARAMETERS,
    REACH,
    ROLL,
    SCALE,
    STATE,
    STIFFNESS,
    THIN_S,
    TILT,
    WIND,
    Nodes,
    camera,
    looked_along,
    of_tilt,
    sensed_lean,
)
from simgrab.instrument.estimate.pendulum_fit import FARTHEST, ROUNDS, PendulumFit, PendulumPriors, first_path, fit
from simgrab.instrument.estimate.rope_aware import BEYOND_GRAB, RopeAware
from simgrab.instrument.estimate.strengths import FAST, LEAST_NOISE_PX, NOISE, SLOW
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array, rotation_z, wrap
from simgrab.model.records.estimates import Estimates, Intervals

MOST_NOISE = 0.005  # rad, of a centre per coordinate, if it is also more than the swing: then the frames are no video
CUT_S = 20.0  # longer gaps are not bridged
TILT_SD = 0.35  # rad, of the tilt per axis
DAMPED, DAMPED_SD = 0.005, 0.005  # prior of the damping ratio
STIFFNESS_SD = 0.003  # of the relative error of gravity over length
LONGER_M, LONGER_SD_M = 0.4, 0.5  # prior of the length of the equivalent simple pendulum minus |OA|
# Prior of how a camera follows apparent gravity: the share, and logarithms of frequency (rad/s) and damping ratio.
FOLLOWING, FOLLOWING_SD = (0.5, np.log(np.pi), np.log(0.5)), (0.5, 0.7, 0.7)
LEAST_CLOCK_SD_S = 1e-3
MOST_NOT_FREE = 0.3  # of a record; if more does not swing freely, the sensor is of another one
FREE = 0.5  # least weight of a step in which the grab counts as swinging freely
MOST_WIND = 0.05  # rad, of the steady lean by wind where that is not stated, beside what gusts show:
STEADY = 4.0  # its standard deviation over that of gusts, whose turbulence is 10 to 25 %
# Standard deviation per axis of the lean by wind over its mean: with a turbulence of 20 %, and also as loads change.
GUSTS, LOADS = 0.32, 0.43
MOST_GUSTS = 2.5e-3  # rad: right data need no more slow forcing than `doubts.MOST_LEAN`
PITCH_SD = 0.03  # rad/m, of the pitch by luffing
AROUND_S = 1.0  # of a sensor's readings before the first and after the last frame
SENSOR_CLOCK_SD_S = 0.03
ROLL_SD, LEAST_SLEW = 0.3, 0.2  # rad: of a roll that is a guess, and by how much the jib must slew to show it
SENSOR_SCALE_SD = 0.01  # of scale and misalignment: cheap sensors have 1 %, and 0.4° (docs/sensors.md)
REACH_SD_M = 1.5  # of the reach; half of a normal distribution below 0
WANDER_S = 10.0  # for which a detector errs alike: jaws, yaw and light change in that time
SILENT_S = 2.0  # for which a controller may be silent at either end of the record
CLOCK_STEP_S, CLOCK_ROUNDS = 0.75, 3  # of the search of the controller's clock
SAMPLED_S = 0.02  # how exactly a clock can be known from readings at their rate
CLEARLY = 0.8  # ratio of twice the negative log posteriors below which the other clock does not count
NOT_CONVERGED = f"not converged in {ROUNDS} rounds"
THIN_FRAMES = 500  # longer records are thinned for the search of the strengths


@dataclass(frozen=True, eq=False)
class Solved:
    """A fitted record: nodes, fit, the jib's motion, the sensor's if there is one, and the offset of a fixed camera.

    It says too whether the camera's roll was estimated.
    """

    nodes: Nodes
    fit: PendulumFit
    jib: JibMotion
    sensed: Sensed | None
    fixed: Array
    rolls: bool = False


@dataclass(frozen=True)
class PendulumSmoother(Estimator):
    r"""Extended Kalman filter and Rauch–Tung–Striebel pass, iterated, over a spherical pendulum of changing length.

    A controller's readings drive the pendulum by the acceleration of O, and the camera's tilt is a constant and two
    motions of unknown size: a damped pendulum's, which follows apparent gravity, and a pitch with the radius. So one
    model holds for cameras that level themselves, are bolted to the fly-jib, or do not move. Steady wind keeps its
    direction over the ground while the jib slews, which distinguishes it from tilt.

    The unknowns are the path, the tilt, the offset (with the calibration's prior), damping and stiffness (with priors
    wide enough for a rigid grab), fast and slow forcing, and the noise of the pixels. The strengths of the last three
    maximise the likelihood of the record; the rest is at its posterior mode. Pixel errors follow Student's t, so that
    an outlier has little weight.

    Attributes
    ----------
    controller : Controller or None
        What the crane reports during the record. Slewing and luffing drive the pendulum, and they tilt the camera: β is
        its tilt where the jib rests at its mean radius. Its wind is used unless ``intervals`` state one.
    imu : ImuReadings or None
        Readings of an inertial sensor in the camera's housing. Its gyroscope measures how the camera turns, and its
        accelerometer the acceleration of O, in place of the controller; β is the camera's mean tilt.
    wander_px : float
        Standard deviation per coordinate of errors of the pixel that last for some seconds, beside those that change
        from frame to frame. `simgrab run` takes it from the detector.

    Notes
    -----
    Frames without a pixel get an α too. σ describes this record; only its blocks show how well it represents other
    records. Diagnostics: ``forcing`` (white acceleration, m²/s³ per axis), ``lean_sd`` (slow forcing, rad per axis),
    ``noise_px``, ``damping``, ``stiffness``, ``rounds``, ``offset_if_fixed_m`` (`RopeAware`'s), ``outliers`` (frames
    that lost nine tenths of their weight).
    With a controller also ``wind`` (steady lean, rad), ``longer_m``, ``clock_s`` and ``clock_sd_s`` (by which its clock
    is behind that of the pictures, and its standard deviation), of the camera ``follows`` (share of apparent gravity, 1
    if it levels itself and 0 if not), ``levelling_hz``, ``levelling_damping``, ``pitch_per_m`` (of luffing, rad) and
    ``pitch_sd_per_m`` (its standard deviation), ``radius_m`` (at which the tilt is as stated), ``not_free`` (share of
    the record in which the grab does not swing freely: digging), ``cost`` (minus the logarithm of the likelihood),
    ``roll``, ``roll_sd`` and ``roll_error`` (less the stated one; rad, where that is a guess) and, with a sensor,
    ``reach_m`` (0 or negative): |OA| and the reach, times the lean of the ropes, displace the grab; it
    is 0 if grab and ropes are in line, and minus the height of the rope ends above A if the grab's head stays level.
    """

    name: ClassVar[str] = "pendulum-smoother"
    needs_rope: ClassVar[bool] = True
    needs_time: ClassVar[bool] = True
    parameters: ClassVar[int] = 8  # tilt and horizontal offset, and the first position and velocity, two each

    controller: Controller | None = None
    imu: ImuReadings | None = None
    wander_px: float = 0.0

    @property
    def needs_imu(self) -> bool:
        """Whether readings of an inertial sensor are given."""
        return self.imu is not None

    def _conclude(self, frames: Frames, calibration: Calibration) -> Estimates:
        if self.imu is not None and len(frames.count) != 1:
            raise RecordError(f"{self.name} takes one record at a time: the sensor's readings belong to one")
        m, parts = len(frames.count), []
        for i in range(m):
            one = frames.rows(np.arange(m) == i)
            solved = self.solve(one, calibration)
            parts.append((np.array([i]), self._concluded(one, solved, calibration)))
        return joined(parts, m)

    def solve(self, frames: Frames, calibration: Calibration, imu: ImuReadings | None = None) -> Solved | str:
        """Fit one record, with some of the sensor's readings or all; returns the reason if that is impossible."""
        imu = imu or self.imu
        assert frames.time is not None
        rough = RopeAware().fit(frames, calibration)
        if not np.isfinite(rough.down).all():
            return BEYOND_GRAB
        beta, azimuth = tilt_of(rough.down[0])
        focal_px, offset_sd = calibration.focal_length_px, max(calibration.offset_sd_m, 1e-4)
        mean, sd = np.zeros(PARAMETERS), np.full(PARAMETERS, 1e-6)
        mean[OFFSET], mean[DAMPING] = calibration.offset_m, DAMPED
        sd[TILT], sd[OFFSET], sd[DAMPING], sd[STIFFNESS] = TILT_SD, offset_sd, DAMPED_SD, STIFFNESS_SD
        jib, motion = JibMotion.at_rest(), None
        steady, intervals = 0.0, self.in_wind(self.controller, frames.time).intervals
        if imu is not None or self.controller is not None:
            mean[LONGER], sd[LONGER] = LONGER_M, LONGER_SD_M
            if intervals.wind_m_s:
                sd[WIND] = np.sqrt(intervals.lean_variance)
            else:
                sd[WIND], steady = MOST_WIND, STEADY**-2.0
        if imu is not None:
            if reason := unfit(frames.time, imu):
                return reason
            motion = sensed(imu.between(frames.time[0] - AROUND_S, frames.time[-1] + AROUND_S), calibration)
            jib, sd[CLOCK], sd[REACH], sd[SCALE] = motion.motion, SENSOR_CLOCK_SD_S, REACH_SD_M, SENSOR_SCALE_SD
        elif self.controller is not None:
            (begin, end), (first, last) = self.controller.time[[0, -1]], frames.time[[0, -1]]
            if begin > first + SILENT_S or end < last - SILENT_S:
                return (
                    f"the controller reports from {begin:.1f} to {end:.1f} s, frames from {first:.1f} to {last:.1f} s"
                )
            jib = JibMotion.of(self.controller)
            mean[FOLLOWS], mean[FREQUENCY], mean[LEVELLING] = FOLLOWING
            sd[LUFFING], sd[CLOCK] = PITCH_SD, max(self.controller.clock_sd_s, LEAST_CLOCK_SD_S)
            sd[[FOLLOWS, FREQUENCY, LEVELLING]] = FOLLOWING_SD
            if "roll_deg" in calibration.assumed and np.ptp(jib.course[:, 0]) > LEAST_SLEW:
                sd[ROLL] = ROLL_SD
        if self.wander_px > 0:
            jib = jib.wandering(self.wander_px / focal_px, WANDER_S)
        start = mean.copy()
        if imu is None:
            start[TILT], start[OFFSET] = (beta * np.cos(azimuth), beta * np.sin(azimuth)), rough.offset[0]
        if self.controller is not None:  # a sensor's velocity drifts too much for the wind past it
            jib = replace(jib, controller=self.controller, wind_m_s=intervals.wind_m_s)
        loaded = self.controller is not None and self.controller.load is not None
        lean = np.sqrt(2 * intervals.lean_variance)
        gusts = min(lean * (GUSTS if loaded else LOADS), MOST_GUSTS)
        priors = PendulumPriors(mean, sd, focal_px, jib, steady, gusts)
        turn, offset = camera(start, frames.time, jib)
        assert frames.rope_length is not None
        swing = looked_along(turn, frames.places(), frames.rope_length[0], offset)
        try:
            nodes, found = self._fit(frames, swing, start, priors)
        except np.linalg.LinAlgError:
            return "the record's equations are singular"
        odd = float(np.mean(found.free < FREE))
        if imu is not None and odd > MOST_NOT_FREE:
            return f"for {100 * odd:.0f} % of the record the pictures contradict the sensor: is it of this record?"
        noise, moves = np.exp(found.strengths[NOISE]), found.path[nodes.frame, :2].std(axis=0).max()
        if found.converged and noise > max(MOST_NOISE, moves):
            off = f"{np.degrees(noise):.1f} deg"
            return f"the grab does not move like a pendulum, but {off} off in each frame: are these frames of a video?"
        rolls = bool(sd[ROLL] == ROLL_SD)
        return Solved(nodes, found, jib, motion, rough.offset[0], rolls) if found.converged else NOT_CONVERGED

    def _fit(self, frames: Frames, swing: Array, start: Array, priors: PendulumPriors) -> tuple[Nodes, PendulumFit]:
        """Fit the strengths to a thinned record if it is long, then fit the whole record."""
        assert frames.time is not None
        strengths = np.log([1e-3, 3 / priors.focal_px, 1e-3])
        every = int(THIN_S / np.median(np.diff(frames.time)))
        nodes = Nodes.of(frames, slice(None), CUT_S)
        size = STATE + 2 * len(priors.jib.drifts)
        if len(swing) > THIN_FRAMES and every > 1:
            some = slice(None, None, every)
            thin = Nodes.of(frames, some, CUT_S)
            if thin.seen.sum() >= self.parameters:
                path = first_path(thin, swing[some], size)
                rough = _on_time(thin, path, start, strengths, priors)
                path = interpolated(nodes.time, thin.time, rough.path)
                free = rough.free[np.searchsorted(thin.time[1:-1], nodes.time[1:])]
                return nodes, fit(nodes, path, rough.parameters, rough.strengths, priors, 0, free)
        return nodes, _on_time(nodes, first_path(nodes, swing, size), start, strengths, priors)

    def _concluded(self, frames: Frames, solved: Solved | str, calibration: Calibration) -> Estimates:
        """State one record's motion with its intervals by the posterior, and σ of a distribution by blocks."""
        if isinstance(solved, str):
            return self._refuse(frames, [solved])
        nodes, found, jib = solved.nodes, solved.fit, solved.jib
        course, minimum = jib.at(nodes.time).mean(axis=0), found.minimum
        tilt = found.parameters[TILT] + sensed_lean(found.parameters, course)
        beta, by_lean = np.hypot(*tilt)[None], of_tilt(course[4:])
        of_beta, across_tilt = iv.split(by_lean @ minimum.covariance @ by_lean.T, tilt)
        s = found.path[nodes.frame, :2]  # the horizontal part of the unit direction OA
        alpha = np.arcsin(np.minimum(np.hypot(*s.T), 1.0))
        sigma = np.sqrt(np.mean(alpha**2))[None]
        covariance = state_covariances(minimum, found.path.shape[1])[nodes.frame, :2, :2]
        if solved.sensed is not None:
            of_lean = np.interp(nodes.time[nodes.frame], jib.time, solved.sensed.variance)
            covariance = covariance + of_lean[:, None, None] * np.eye(2)
        if not jib.moves:
            covariance = covariance + iv.LEAN_BY_MOUNT.get(calibration.mount, 0.0) ** 2 * np.eye(2)
        along, across = iv.split(covariance, s)
        gain = minimum.gain.reshape(-1, found.path.shape[1], len(found.parameters))[nodes.frame, :2]
        # σ² = mean α² follows the parameters p by −2 mean sᵀ ∂s/∂p.
        slope = 2 * np.mean(np.einsum("ni,nij->nj", s, gain), axis=0)
        of_sigma = float(slope @ minimum.covariance @ slope) / np.maximum(4 * sigma**2, 1e-300)
        quantile = iv.student(iv.LEVEL, np.inf)
        posterior = Intervals(
            "posterior", iv.LEVEL, iv.radial(beta, of_beta, across_tilt, quantile),
            iv.radial(sigma, of_sigma, across_tilt, quantile), iv.radial(alpha, along, across, quantile)[None],
            None, "sigma is that of this record",
        )  # fmt: skip
        diagnostics = {
            "forcing": np.exp(found.strengths[FAST]),
            "lean_sd": np.exp(found.strengths[SLOW]),
            "noise_px": np.exp(found.strengths[NOISE]) * calibration.focal_length_px,
            "damping": found.parameters[DAMPING],
            "stiffness": found.parameters[STIFFNESS],
            "rounds": found.rounds,
            "offset_if_fixed_m": solved.fixed,
            "outliers": int(np.sum(nodes.seen & (found.weight < 0.1 * (1 + 2 / DEGREES)))),
        } | (_of_jib(found, jib) if jib.moves else {})
        if solved.rolls:
            diagnostics["roll_error"] = found.parameters[ROLL]
            diagnostics["roll"] = wrap(np.deg2rad(calibration.roll_deg) + found.parameters[ROLL])
            diagnostics["roll_sd"] = np.sqrt(minimum.covariance[ROLL, ROLL])
        swing = None
        if jib.moves:  # from the level frame to that of the jib
            heading = jib.at(nodes.time[nodes.frame] + found.parameters[CLOCK])[:, 0]
            swing = np.einsum("nij,nj->ni", rotation_z(-heading)[:, :2, :2], s)[None]
        return Estimates(
            self.name, np.ones(1, bool), np.array([""]), frames.count.astype(np.int64), beta,
            np.arctan2(tilt[1], tilt[0])[None] % (2 * np.pi), sigma, alpha[None], found.parameters[OFFSET][None],
            (posterior, self._by_blocks(frames, alpha, sigma)),
            {name: np.array([value]) for name, value in diagnostics.items()}, swing,
        )  # fmt: skip

    def _by_blocks(self, frames: Frames, alpha: Array, sigma: Array) -> Intervals:
        """σ of a distribution, by blocks; the tilt's uncertainty is the posterior's."""
        assert frames.time is not None
        block, blocks = iv.block_of(frames.time, self.intervals)
        ends, note = None, "of sigma alone; for beta and alpha see the posterior"
        if blocks < iv.MIN_BLOCKS:
            note = iv.too_few(blocks, self.intervals)
        else:
            influence = (alpha**2 - sigma**2)[None, None]
            variance = iv.block_covariance(influence, np.array([float(len(block))]), block, blocks)[:, 0, 0]
            ends = iv.of_scale(sigma, variance, np.zeros(1), iv.student(iv.LEVEL, np.array([blocks - 1.0])))
        return Intervals("blocks", iv.LEVEL, None, ends, None, blocks, note)


def _on_time(nodes: Nodes, path: Array, start: Array, strengths: Array, priors: PendulumPriors) -> PendulumFit:
    """Fit from the clock that fits best after a few steps: from a second off, the true one may not be reached.

    If another fits about alike by then, the more likely of their two fits counts. One that ends at a bound comes last:
    there pictures have no noise, as forces follow each pixel, or the equivalent pendulum is too short or too long.
    """
    reach = 2 * float(priors.sd[CLOCK])
    steps = int(reach / CLOCK_STEP_S)
    if priors.jib.sensed or not priors.jib.moves:
        return fit(nodes, path, start, strengths, priors)
    delays = np.outer(np.arange(-steps, steps + 1) * (reach / max(steps, 1)), np.arange(len(start)) == CLOCK)
    tried = [fit(nodes, path, start + delay, strengths, priors, 0, rounds=CLOCK_ROUNDS) for delay in delays]
    tried.sort(key=lambda one: one.minimum.value)
    best = tried[0]
    others = [one for one in tried if abs(one.parameters[CLOCK] - best.parameters[CLOCK]) > CLOCK_STEP_S / 2]
    likely = [best, *(one for one in others[:1] if CLEARLY * one.minimum.value < best.minimum.value)]
    found = [fit(nodes, one.path, one.parameters, strengths, priors) for one in likely]

    def at_a_bound(one: PendulumFit) -> bool:
        noise_px = np.exp(one.strengths[NOISE]) * priors.focal_px
        longer = abs(one.parameters[LONGER] - priors.mean[LONGER]) / priors.sd[LONGER]
        return bool(noise_px < 1.01 * LEAST_NOISE_PX or longer > 0.99 * FARTHEST.max())

    return min(found, key=lambda one: (at_a_bound(one), one.cost))


def _of_jib(found: PendulumFit, jib: JibMotion) -> dict[str, float]:
    p, variance = found.parameters, np.diag(found.minimum.covariance)
    return {
        "wind": float(np.hypot(*p[WIND])),
        "longer_m": p[LONGER],
        "reach_m": p[REACH],
        "clock_s": -p[CLOCK],
        "clock_sd_s": float(np.hypot(np.sqrt(variance[CLOCK]), SAMPLED_S)),
        "follows": p[FOLLOWS],
        "levelling_hz": np.exp(p[FREQUENCY]) / (2 * np.pi),
        "levelling_damping": np.exp(p[LEVELLING]),
        "pitch_per_m": p[LUFFING],
        "pitch_sd_per_m": float(np.sqrt(variance[LUFFING])),
        "radius_m": jib.radius_m,
        "not_free": float(np.mean(found.free < FREE)),
        "cost": found.cost,
    }
