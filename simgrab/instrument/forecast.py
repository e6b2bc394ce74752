"""The next seconds of a swing: a Kalman filter of the pendulum up to a frame, and sampled paths from there on."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from simgrab.instrument.alarm import DANGER, exceeding
from simgrab.instrument.estimate import pendulum
from simgrab.instrument.estimate.chain import update
from simgrab.instrument.estimate.pendulum import DEGREES, GRAVITY, MEMORY_S, NODE_S, Links
from simgrab.model.geometry import Array
from simgrab.model.rng import stream

HORIZON_S = 6.0  # of a warning: half a period of 35 m of rope
PATHS = 64
CUT_S = 5.0  # a longer silence begins the filter again
SETTLED_S = 1.0  # from its first place until swing and forcing are separated: before, forecasts err three times as much
STATE, TURN = 7, 6  # state of the pendulum, and the jib's turning rate
LENGTH = 15.0  # m, that scales p
FIXED = np.zeros(pendulum.PARAMETERS)
FIXED[pendulum.DAMPING] = 0.005
FAST = 2e-3  # m²/s³, white acceleration: gusts
SLOW = 0.03  # rad, forcing that lasts: a jib head that speeds up at 0.3 m/s²
TURNING = 0.05  # rad/s, standard deviation of a turning rate that nobody reports: 0.5 rpm
REPORTED, PLANNED = 0.5, 0.3  # share of both left where a controller reports the jib's motion, and also its setpoints
STEPS = round(HORIZON_S / NODE_S)
MIDDLES_S: Array = np.linspace(0, HORIZON_S, 2 * STEPS + 1)[1::2]  # of the steps of a forecast
STOP_S = 10.0  # mean time until the operator stops a drive that moves
SWING = 0.07  # rad per axis, standard deviation of the amplitude at first
HOIST_S = 0.7  # over which the hoist's speed is averaged
AS_FORCING = np.array([-1 / GRAVITY, -1 / GRAVITY, 1.0])  # of an acceleration of O
UNSEEN = 1e6  # variance of a place that was not seen


@dataclass(frozen=True, eq=False)
class State:
    """What frames so far say of the swings of k records."""

    mean: Array  # (k, 7), state of `simgrab.instrument.estimate.pendulum`, and the jib's turning rate, rad/s
    covariance: Array  # (k, 7, 7)
    rope: Array  # (k,), |OA|, m, NaN before the first frame
    hoist: Array  # (k,), rate of `rope`, m/s
    # (k, 3), forcing, rad, and turning rate that a controller reports, which add to those of `mean`; NaN where it
    # does not
    reported: Array
    planned: Array  # (k, 18, 17, 3), the same in the next seconds, as `Controller.jib_motion` gives it

    @classmethod
    def before(cls, records: int) -> State:
        """Know nothing."""
        mean, covariance, hoist = np.zeros((records, STATE)), np.zeros((records, STATE, STATE)), np.zeros(records)
        unknown = (np.broadcast_to(np.nan, shape) for shape in ((records, 3), (records, STEPS + 1, STEPS, 3)))
        return cls(mean, covariance, hoist * np.nan, hoist, *unknown)


@dataclass(frozen=True, eq=False)
class Forecast:
    """Next seconds of k records; NaN where there is no state."""

    warning: Array  # (k,), probability that α exceeds 10° within `HORIZON_S`, now included
    peak: Array  # (k,), median of α at the next turning point, rad
    peak_low: Array  # (k,), ends of its 95 % interval
    peak_high: Array  # (k,)
    peak_in_s: Array  # (k,), median time to it, s, at most `HORIZON_S`


class Forecaster:
    """Filter the swings of k records with common frame times. A state rests on no later frames.

    The axes are those of the jib and turn with it. Slow forcing stands for wind and for unknown acceleration of the jib
    head.

    Attributes
    ----------
    state : State
    error : ndarray, shape (k, 2)
        Last place seen less the one expected, rad; 0 where nothing was seen.
    error_sd : ndarray, shape (k,)
        Its expected standard deviation per axis.
    begun : float
        Time of the first place since the filter began, s.
    """

    def __init__(self, records: int = 1) -> None:
        self.state, self._time, self.begun = State.before(records), -np.inf, np.inf
        self.error, self.error_sd = np.zeros((records, 2)), np.full(records, np.inf)

    def step(
        self, time: float, swing: Array, sd: Array | float, rope: Array, reported: Array | None = None,
        planned: Array | None = None,
    ) -> State:  # fmt: skip
        """Process a frame.

        Parameters
        ----------
        time : float
            s, later than the frame before.
        swing : ndarray, shape (k, 2)
            Horizontal part of the unit direction OA, jib frame; NaN where nothing was seen.
        sd : ndarray, shape (k,), or float
            Its standard deviation per axis from the pixel alone, rad.
        rope : ndarray, shape (k,)
            |OA|, m; NaN where it is not known.
        reported : ndarray, shape (k, 3), optional
            What the crane's controller reports: acceleration of O, jib frame, m/s², and slewing rate,
            counter-clockwise, rad/s. NaN where it reports nothing.
        planned : ndarray, shape (k, 18, 17, 3), optional
            The same in the middles of the next 17 steps, if the drives are stopped in each of them, and last if not.
        """
        last, seconds, nothing = self.state, time - self._time, State.before(len(rope))
        if seconds > CUT_S:
            last, self.begun = nothing, np.inf
        rope = np.where(np.isfinite(rope), rope, last.rope)
        seen = np.isfinite(swing).all(axis=-1) & np.isfinite(rope)
        self.begun = min(self.begun, time) if seen.any() else self.begun
        first = np.isnan(last.rope)
        forced = nothing.reported if reported is None else reported * AS_FORCING
        plan = nothing.planned if planned is None else planned * AS_FORCING
        begins_or_ends = np.isnan(last.reported).any(axis=-1) != np.isnan(forced).any(axis=-1)
        mean, covariance, hoist = last.mean.copy(), last.covariance, last.hoist
        mean[begins_or_ends, 4:] += (np.nan_to_num(last.reported) - np.nan_to_num(forced))[begins_or_ends]
        if not first.all():
            before, after = (np.where(first, LENGTH, r) for r in (last.rope, rope))
            hoist = hoist + (1 - np.exp(-seconds / HOIST_S)) * ((after - before) / seconds - hoist)
            ropes = np.linspace(before, after, max(int(np.ceil(seconds / NODE_S - 1e-9)), 1) + 1)
            unknown = np.where(np.isnan(forced).any(axis=-1), 1.0, np.where(_complete(plan), PLANNED, REPORTED))
            mean, covariance = _predicted(mean, covariance, np.nan_to_num(forced), unknown, ropes, seconds)
        mean[first], hoist[first] = 0, 0
        of_p = SWING * np.sqrt(GRAVITY) * np.where(seen, rope, 0.0) ** 1.5 / LENGTH**2
        one = np.ones_like(of_p)
        sds = np.stack([one, one, of_p, of_p, SLOW * one, SLOW * one, TURNING * one], axis=-1)
        covariance[first] = (sds[:, None] * sds[..., None] * np.eye(STATE))[first]
        error = np.where(seen[:, None], swing - mean[:, :2], 0)
        noise = np.where(seen, np.square(sd), UNSEEN)[:, None, None] * np.eye(2)
        expected = covariance[:, :2, :2] + noise
        self.error, self.error_sd = error, np.sqrt(expected.trace(axis1=1, axis2=2) / 2)
        solved = np.linalg.solve(expected, error[..., None])[..., 0]
        noise = noise * ((DEGREES + np.vecdot(error, solved)) / (DEGREES + 2))[:, None, None]
        change, covariance = update(covariance, np.eye(2, STATE), error, noise)
        rope = np.where(first & ~seen, np.nan, rope)
        self._time, self.state = time, State(mean + change, covariance, rope, hoist, forced, plan)
        return self.state

    def shift(self, by: Array) -> None:
        """Move places and forcing by (k, 2), rad, because the tilt was estimated again; NaN moves nothing."""
        mean = self.state.mean.copy()
        mean[:, :6] += np.nan_to_num(by)[:, [0, 1, 0, 1, 0, 1]] * np.repeat([1.0, 0.0, 1.0], 2)
        self.state = replace(self.state, mean=mean)


Parts = TypeVar("Parts", State, Forecast)


def joined(parts: Sequence[Parts]) -> Parts:
    """Put states or forecasts of several records together, one after another."""
    columns = zip(*(vars(part).values() for part in parts), strict=True)
    return type(parts[0])(*map(np.concatenate, columns))


def forecast(state: State, tilt_sd: Array) -> Forecast:
    """Sample `PATHS` paths from each state, with the same draws every time.

    Parameters
    ----------
    tilt_sd : ndarray, shape (k,)
        Standard deviation of the part of α's error that does not change, from tilt and offset, rad.
    """
    known = np.isfinite(state.rope)
    half = stream(0, 0, "forecast").standard_normal((PATHS // 2, STATE * (STEPS + 1) + 1))
    drawn = np.concatenate([half, -half])
    draws, of_tilt = drawn[:, :-1].reshape(PATHS, STEPS + 1, STATE), drawn[:, -1]
    x = state.mean[:, None] + draws[:, 0] @ np.linalg.cholesky(state.covariance + 1e-14 * np.eye(STATE)).mT
    x = np.where(known[:, None, None], x, 0.0).reshape(-1, STATE)
    forced, unknown = _forced(state)
    ahead = np.linspace(0, HORIZON_S, STEPS + 1)
    rope = np.where(known, state.rope, LENGTH)[:, None]
    # The hoist's speed is expected to last as long as the slow forcing.
    ropes = np.maximum(rope + state.hoist[:, None] * MEMORY_S * -np.expm1(-ahead / MEMORY_S), rope / 2)
    steps = np.full(len(rope), ahead[1])
    links = [Links(steps, *ends, LENGTH) for ends in itertools.pairwise(ropes.T)]
    roots = np.linalg.cholesky([_noise(one, unknown) for one in links])
    sines = [np.hypot(x[:, 0], x[:, 1])]
    for i, (one, root) in enumerate(zip(links, roots, strict=True)):
        x = _advance(x, forced[:, i], _repeated(one, PATHS)) + (draws[:, i + 1] @ root.mT).reshape(x.shape)
        sines.append(np.hypot(x[:, 0], x[:, 1]))
    alpha = np.arcsin(np.minimum(sines, 1.0)).T.reshape(len(rope), PATHS, -1)
    most, peak, place = _peaks(alpha)
    tilt_sd = np.broadcast_to(tilt_sd, known.shape)[:, None]
    low, middle, high = np.quantile(np.abs(peak + tilt_sd * of_tilt), [0.025, 0.5, 0.975], axis=-1)
    found = exceeding(most, tilt_sd, DANGER).mean(axis=-1), middle, low, high, np.median(place, axis=-1) * ahead[1]
    return Forecast(*(np.where(known, values, np.nan) for values in found))


def _complete(planned: Array) -> NDArray[np.bool_]:
    """Whether the next seconds are known, (k,)."""
    return np.asarray(np.isfinite(planned).all(axis=(1, 2, 3)))


def _forced(state: State) -> tuple[Array, Array]:
    """Return the reported forcing and turning rate on all paths (k · 64, 17, 3), and what share (k,) is unknown.

    Drives are stopped after an exponentially distributed time. Without setpoints, what is reported now fades.
    """
    complete = _complete(state.planned)
    shares = (stream(0, 0, "stops").permutation(PATHS) + 0.5) / PATHS
    step = np.minimum(-STOP_S * np.log1p(-shares) / HORIZON_S * STEPS, STEPS).astype(np.int64)
    fading = np.nan_to_num(state.reported)[:, None, None] * np.exp(-MIDDLES_S / MEMORY_S)[:, None]
    forced = np.where(complete[:, None, None, None], state.planned[:, step], fading)
    return forced.reshape(-1, STEPS, 3), np.where(complete, PLANNED, 1.0)


def _repeated(links: Links, times: int) -> Links:
    step, before, after = (np.repeat(a, times) for a in (links.step, links.before, links.after))
    return Links(step, before, after, links.length)


def _predicted(
    mean: Array, covariance: Array, forced: Array, unknown: Array, ropes: Array, seconds: float
) -> tuple[Array, Array]:  # fmt: skip
    """Mean and covariance after the steps between rope lengths (parts + 1, k)."""
    h = np.full(ropes.shape[1], seconds / (len(ropes) - 1))
    changes = np.concatenate([np.zeros((1, STATE)), 1e-6 * np.eye(STATE), -1e-6 * np.eye(STATE)])
    forced = np.repeat(forced, len(changes), axis=0)
    for before, after in itertools.pairwise(ropes):
        links = Links(h, before, after, LENGTH)
        x = (mean[:, None] + changes).reshape(-1, STATE)
        moved = _advance(x, forced, _repeated(links, len(changes))).reshape(-1, len(changes), STATE)
        carry = ((moved[:, 1 : STATE + 1] - moved[:, STATE + 1 :]) / 2e-6).mT
        covariance = carry @ covariance @ carry.mT + _noise(links, unknown)
        mean = moved[:, 0]
    return mean, covariance


def _noise(links: Links, unknown: Array) -> Array:
    """Covariance (k, 7, 7) that a step adds; of the slow forcing a share (k,) is unknown."""
    slow = links.slow * np.reshape(unknown, (-1, 1, 1)) ** 2
    added = pendulum.of_axes(links.fast * FAST, 0, STATE) + pendulum.of_axes(slow * SLOW**2, 4, STATE)
    added[:, TURN, TURN] = slow[:, 0, 0] * TURNING**2
    return added


def _advance(x: Array, forced: Array, links: Links) -> Array:
    """States (k, 7) after one step, in axes that have turned with the jib; reported forcing (k, 3) adds to theirs."""
    whole = x.copy()
    whole[:, 4:] += forced
    moved, turn = pendulum.advance(whole[:, :TURN], FIXED, links), np.exp(-1j * whole[:, TURN] * links.step)
    fade = np.exp(-links.step / MEMORY_S)[:, None]
    moved[:, 4:] = x[:, 4:TURN] * fade
    turned = pendulum.paired(moved) * turn[:, None]
    return np.column_stack([turned.view(np.float64), x[:, TURN:] * fade])


def _peaks(alpha: Array) -> tuple[Array, Array, Array]:
    """Greatest α of paths (..., n), and height and place, in steps, of the first turning point.

    They are those of parabolas through three nodes. A path without a turning point ends at its peak.
    """
    left, here, right = alpha[..., :-2], alpha[..., 1:-1], alpha[..., 2:]
    is_top = (here > left) & (here >= right)
    bend = np.where(is_top, 2 * here - left - right, 1.0)
    shift = (right - left) / (2 * bend)
    height = np.where(is_top, here + bend * shift**2 / 2, 0.0)
    first, some = np.argmax(is_top, axis=-1)[..., None], is_top.any(axis=-1)
    at = (first + 1 + np.take_along_axis(shift, first, -1))[..., 0]
    peak = np.where(some, np.take_along_axis(height, first, -1)[..., 0], alpha[..., -1])
    most = np.maximum(height.max(axis=-1), alpha[..., [0, -1]].max(axis=-1))
    return most, peak, np.where(some, at, alpha.shape[-1] - 1.0)
