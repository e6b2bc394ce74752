"""The tilt as the centre about which a pendulum swings, which less than one period already shows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from simgrab.instrument.estimate import intervals as iv
from simgrab.instrument.estimate.chain import state_covariances
from simgrab.instrument.estimate.contract import Estimator, Solution
from simgrab.instrument.estimate.frames import Frames, tilt_of
from simgrab.instrument.estimate.pendulum import DAMPING, OFFSET, STATE, STIFFNESS, TILT
from simgrab.instrument.estimate.pendulum_fit import FAST, NOISE, SLOW, Fit, Nodes, Priors, first_path, fit, nodes_of
from simgrab.instrument.estimate.rope_aware import RopeAware
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array
from simgrab.model.records.estimates import Estimates, Intervals


@dataclass(frozen=True)
class PendulumSmoother(Estimator):
    """Extended Kalman filter and Rauch–Tung–Striebel pass, iterated, over a spherical pendulum of changing length.

    Unknown are the path, the tilt, the offset (with the calibration's prior), damping and stiffness (with priors that
    leave room for a rigid grab), fast and slow forcing, and the noise of the pixels. The strengths of the last three
    maximise the likelihood of the record; the rest is at its posterior mode. Pixel errors follow Student's t, so that
    an outlier has little weight.

    Attributes
    ----------
    degrees : float
        Of Student's t distribution of pixel errors.
    damping, damping_sd : float
        Prior of the damping ratio.
    stiffness_sd : float
        Prior standard deviation of the relative error of gravity over length.
    tilt_sd : float
        Prior standard deviation of the tilt per axis, rad.
    memory_s : float
        Correlation time of the slow forcing: gusts, and the jib's own motion.
    node_s, cut_s : float
        Longer steps than the first are divided; gaps longer than the second are not bridged.
    thin_s : float
        Records of more than `thin_frames` are thinned to such steps for the search of the strengths.
    thin_frames : int
    searches, rounds : int
        At most so many linearisations search for the strengths, and so many there are.

    Notes
    -----
    Frames without a pixel get an α too. σ is that of this record; only blocks show how well it represents others.
    Diagnostics: ``forcing`` (white acceleration, m²/s³ per axis), ``lean_sd`` (slow forcing, rad per axis),
    ``noise_px``, ``damping``, ``stiffness``, ``rounds``, ``outliers`` (frames that lost nine tenths of their weight).
    """

    name: ClassVar[str] = "pendulum-smoother"
    parameters: ClassVar[int] = 8  # tilt and horizontal offset, and the first position and velocity, two each
    needs_rope: ClassVar[bool] = True
    needs_time: ClassVar[bool] = True

    degrees: float = 4.0
    damping: float = 0.005
    damping_sd: float = 0.005
    stiffness_sd: float = 0.003
    tilt_sd: float = 0.35
    memory_s: float = 10.0
    node_s: float = 0.35
    cut_s: float = 20.0
    thin_s: float = 0.3
    thin_frames: int = 500
    searches: int = 10
    rounds: int = 30

    def _solve(self, frames: Frames, calibration: Calibration) -> Solution:
        raise NotImplementedError  # not a sum over frames: `_conclude` does it all

    def _conclude(self, frames: Frames, calibration: Calibration) -> Estimates:
        records = [
            self._one(frames.rows(np.arange(len(frames.count)) == i), calibration) for i in range(len(frames.count))
        ]
        table = {key: np.array([r[key] for r in records]) for key in records[0]}
        offset = table.pop("offset")
        posterior = Intervals(
            "posterior", self.intervals.level, table.pop("beta_ends"), table.pop("sigma_ends"), table.pop("alpha_ends"),
            None, "sigma is that of this record",
        )  # fmt: skip
        beta, azimuth, sigma, alpha = (table.pop(key) for key in ("beta", "azimuth", "sigma", "alpha"))
        reason = table.pop("reason")
        return Estimates(
            self.name, np.array([not r for r in reason], bool), reason.astype(str), frames.count.astype(np.int64),
            beta, azimuth, sigma, alpha, offset, (posterior, self._blocks(frames, sigma, alpha)), table,
        )  # fmt: skip

    def _one(self, frames: Frames, calibration: Calibration) -> dict[str, Any]:
        assert frames.rope_length is not None
        assert frames.time is not None
        seen = np.ones(frames.time.shape, bool) if frames.present is None else frames.present[0]
        ray = frames.rays[0]
        place = (ray[:2] / np.where(seen, -ray[2], 1.0)).T
        rough = RopeAware().fit(frames, calibration)
        beta, azimuth = tilt_of(rough.down[0])
        mean = np.array([0.0, 0.0, *calibration.offset_m, self.damping, 0.0])
        sd = np.array(
            [self.tilt_sd] * 2 + [max(calibration.offset_sd_m, 1e-4)] * 3 + [self.damping_sd, self.stiffness_sd]
        )
        priors = Priors(mean, sd, self.degrees, self.memory_s, self.node_s, self.cut_s)
        start = np.array([beta * np.cos(azimuth), beta * np.sin(azimuth), *rough.offset[0], self.damping, 0.0])
        swing = rough.swing[0].T
        try:
            nodes, found = self._fit(frames.time, frames.rope_length[0], place, seen, swing, start, priors, calibration)
        except np.linalg.LinAlgError:
            return self._nothing(len(seen), "the record's equations are singular")
        if not found.settled:
            return self._nothing(len(seen), f"not converged in {self.rounds} rounds")
        return self._found(nodes, found, calibration.focal_length_px)

    def _fit(
        self, time: Array, rope: Array, place: Array, seen: NDArray[np.bool_], swing: Array, start: Array,
        priors: Priors, calibration: Calibration,
    ) -> tuple[Nodes, Fit]:  # fmt: skip
        """Fit a thinned record for the strengths where it is long, then the whole one."""
        f = calibration.focal_length_px
        nodes = nodes_of(time, rope, place, seen, priors)
        whole = np.zeros((len(nodes.time), 2))
        whole[nodes.frame] = swing
        strengths = np.log([1e-3, 3 / f, 1e-3])
        every = int(self.thin_s / np.median(np.diff(time)))
        some = slice(None, None, every)
        if len(time) <= self.thin_frames or every < 2 or np.sum(seen[some]) < self.parameters:
            path = first_path(nodes, whole)
            return nodes, fit(nodes, path, start, strengths, priors, f, self.searches, self.rounds)
        thin, rough = self._thin(time[some], rope[some], place[some], seen[some], swing[some], start, priors, f)
        path = np.stack([np.interp(nodes.time, thin.time, column) for column in rough.path.T], axis=-1)
        return nodes, fit(nodes, path, rough.parameters, rough.strengths, priors, f, 0, self.rounds)

    def _thin(
        self, time: Array, rope: Array, place: Array, seen: NDArray[np.bool_], swing: Array, start: Array,
        priors: Priors, f: float,
    ) -> tuple[Nodes, Fit]:  # fmt: skip
        nodes = nodes_of(time, rope, place, seen, priors)
        whole = np.zeros((len(nodes.time), 2))
        whole[nodes.frame] = swing
        strengths = np.log([1e-3, 3 / f, 1e-3])
        return nodes, fit(nodes, first_path(nodes, whole), start, strengths, priors, f, self.searches, self.rounds)

    def _found(self, nodes: Nodes, found: Fit, f: float) -> dict[str, Any]:
        tilt, covariance = found.parameters[TILT], found.minimum.covariance[TILT, TILT]
        beta = float(np.hypot(*tilt))
        quantile = iv.student(self.intervals.level, np.inf)
        along, across = _split(covariance, tilt)
        s = found.path[nodes.frame, :2]
        alpha = np.arcsin(np.minimum(np.hypot(s[:, 0], s[:, 1]), 1.0))
        sigma2 = float(np.mean(alpha**2))
        of_swing = state_covariances(found.minimum, STATE)[nodes.frame, :2, :2]
        gain = found.minimum.gain.reshape(-1, STATE, len(found.parameters))[nodes.frame, :2]
        slope = 2 * np.mean(np.einsum("ni,nij->nj", s, gain), axis=0)
        var_sigma = float(slope @ found.minimum.covariance @ slope) / max(4 * sigma2, 1e-300)
        return {
            "reason": "",
            "beta": beta,
            "azimuth": float(np.arctan2(tilt[1], tilt[0]) % (2 * np.pi)),
            "sigma": np.sqrt(sigma2),
            "alpha": alpha,
            "offset": found.parameters[OFFSET],
            "beta_ends": iv.radial(np.array(beta), along, across, quantile),
            "sigma_ends": iv.radial(np.array(np.sqrt(sigma2)), np.array(var_sigma), across, quantile),
            "alpha_ends": iv.radial(alpha, *_split(of_swing, s), quantile),
            "forcing": np.exp(found.strengths[FAST]),
            "lean_sd": np.exp(found.strengths[SLOW]),
            "noise_px": np.exp(found.strengths[NOISE]) * f,
            "damping": found.parameters[DAMPING],
            "stiffness": found.parameters[STIFFNESS],
            "rounds": found.rounds,
            "outliers": int(np.sum(nodes.seen & (found.weight < 0.1 * (1 + 2 / self.degrees)))),
        }

    def _nothing(self, n: int, reason: str) -> dict[str, Any]:
        names = ("beta", "azimuth", "sigma", "forcing", "lean_sd", "noise_px", "damping", "stiffness")
        shapes = {"alpha": (n,), "offset": (3,), "beta_ends": (2,), "sigma_ends": (2,), "alpha_ends": (n, 2)}
        empty = {name: np.full(shape, np.nan) for name, shape in shapes.items()}
        return {"reason": reason, **dict.fromkeys(names, np.nan), **empty, "rounds": self.rounds, "outliers": 0}

    def _blocks(self, frames: Frames, sigma: Array, alpha: Array) -> Intervals:
        """σ of a distribution, by blocks; the tilt's uncertainty is the posterior's."""
        assert frames.time is not None
        level, settings = self.intervals.level, self.intervals
        block, blocks = iv.block_of(frames.time, settings)
        if blocks < settings.min_blocks:
            return Intervals("blocks", level, None, None, None, blocks, iv.too_few(blocks, settings))
        influence = (alpha**2 - sigma[:, None] ** 2)[:, None]
        variance = iv.block_covariance(influence, np.full(len(sigma), float(len(block))), block, blocks)[:, 0, 0]
        ends = iv.of_scale(sigma, variance, np.zeros(len(sigma)), np.full(len(sigma), iv.student(level, blocks - 1)))
        return Intervals(
            "blocks", level, None, ends, None, blocks, "of sigma alone; for beta and alpha see the posterior"
        )


def _split(covariance: Array, towards: Array) -> tuple[Array, Array]:
    """Variance (...) along and across a direction (..., 2), from a covariance (..., 2, 2)."""
    unit = towards / np.maximum(np.linalg.norm(towards, axis=-1, keepdims=True), 1e-300)
    along = np.einsum("...i,...ij,...j->...", unit, covariance, unit)
    return along, np.trace(covariance, axis1=-2, axis2=-1) - along
