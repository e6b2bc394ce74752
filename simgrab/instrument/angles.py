"""Angles from observations: the tilt from some of the frames, the swing in all of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simgrab.instrument import alarm
from simgrab.instrument.contract import Measurement, Status
from simgrab.instrument.controller import Radii
from simgrab.instrument.estimate.follow import Known, follow
from simgrab.instrument.estimate.intervals import LEAN_BY_MOUNT
from simgrab.instrument.estimate.record import PixelRecord
from simgrab.instrument.forecast import SETTLED_S, Forecast, Forecaster, forecast, joined
from simgrab.instrument.observation import Observation
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array

UNSTATED_PX = 1.5  # standard deviation of a pixel whose detector states none
NORMAL = 1.96  # two-sided quantile, 95 %
AT_ONCE = 256  # frames whose forecasts are sampled together


@dataclass(frozen=True, kw_only=True)
class RecordArrays(PixelRecord):
    """A record of n frames as arrays, and what they were made from."""

    rope_length: Array  # (n,)
    observations: Sequence[Observation]
    jump: NDArray[np.bool_]  # (n,), frames with a length that the hoist cannot have reached

    def direction_sd(self, focal_px: float) -> Array:
        """Return the standard deviation of each direction per axis from the pixel alone, rad, shape (n,)."""
        return np.asarray(np.where(self.pixel_sd > 0, self.pixel_sd, UNSTATED_PX) / focal_px)


def arrays(
    observations: Sequence[Observation], rope_length: Array, jump: NDArray[np.bool_] | None = None
) -> RecordArrays:
    """Put observations into arrays, with the rope's lengths (n,), m, and which of them are jumps (n,), if any."""
    nothing = (np.nan, np.nan)
    timed = all(s.time_s is not None for s in observations)
    sd = np.array([s.centre_sd or (0.0, 0.0) for s in observations], float).reshape(-1, 2)
    return RecordArrays(
        pixels=np.array([s.centre or nothing for s in observations], float).reshape(-1, 2),
        pixel_sd=np.sqrt(np.mean(sd**2, axis=-1)),
        rope_length=rope_length,
        time=np.array([s.time_s for s in observations], float) if timed else None,
        observations=observations,
        jump=np.zeros(len(rope_length), bool) if jump is None else jump,
    )


def by_tilt(
    record: RecordArrays, tilt: Known, calibration: Calibration, radii: Radii | None = None
) -> tuple[Array, Array, Array]:
    """Swing (n,), its intervals (n, 2) and the horizontal part (n, 2) of the direction OA under a known tilt."""
    some = record.usable(rope=tilt.offset_m is not None)
    alpha, ends, direction = np.full(len(some), np.nan), *np.full((2, len(some), 2), np.nan)
    if some.any():
        alpha[some], ends[some], direction[some] = follow(
            tilt, record.pixels[some], calibration,
            rope_length=None if tilt.offset_m is None else record.rope_length[some],
            time=None if record.time is None else record.time[some], pixel_sd=record.pixel_sd[some],
            radii=None if radii is None else Radii(radii.value[some], radii.sd[some]),
        )  # fmt: skip
    return alpha, ends, direction


def without_lean(
    alpha: Array, ends: Array, calibration: Calibration, pitched: NDArray[np.bool_] | None = None
) -> Array:
    """Intervals (n, 2) without how a camera leans on its mount, which alarms and forecasts do not wait for.

    Those of ``pitched`` frames (n,) leave out the lean already.
    """
    lean = NORMAL * LEAN_BY_MOUNT.get(calibration.mount, 0.0)
    off = np.sqrt(np.maximum((ends - alpha[:, None]) ** 2 - lean**2, 0.0))
    less = np.where(np.isfinite(ends), alpha[:, None] + off * (-1.0, 1.0), np.nan)
    return np.asarray(less if pitched is None else np.where(pitched[:, None], ends, less))


def forecasts(
    forecaster: Forecaster, record: RecordArrays, swing: Array, alpha: Array, ends: Array, focal_px: float,
    motion: Sequence[Array] = (),
) -> Forecast | None:  # fmt: skip
    """Forecast from each frame and those before it; None for independent frames, NaN until the filter has settled.

    Parameters
    ----------
    forecaster : Forecaster
        Of one record, with its earlier frames.
    swing : ndarray, shape (n, 2)
        Horizontal part of the unit direction OA.
    alpha : ndarray, shape (n,)
        NaN where there is none.
    ends : ndarray, shape (n, 2)
        Its intervals.
    motion : sequence of ndarray
        Of the jib at a single frame, as `Controller.jib_motion` gives it.
    """
    if record.time is None or not len(alpha):
        return None
    assert not motion or len(alpha) == 1
    swing = np.where(np.isfinite(alpha)[:, None], swing, np.nan)
    sd = record.direction_sd(focal_px)
    rows = zip(record.time.tolist(), swing[:, None], sd, record.rope_length[:, None], strict=True)
    states, settled = [], []
    for time, *row in rows:
        states.append(forecaster.step(time, *row, *(one[None] for one in motion)))
        settled.append(time >= forecaster.begun + SETTLED_S)
    tilt_sd = alarm.deviation(alpha, np.where(np.isfinite(ends), ends, alpha[:, None])[:, 1])
    parts = [slice(i, i + AT_ONCE) for i in range(0, len(states), AT_ONCE)]
    found = joined([forecast(joined(states[part]), np.nan_to_num(tilt_sd[part])) for part in parts])
    return Forecast(*(np.where(settled, values, np.nan) for values in vars(found).values()))


def measurements(
    record: RecordArrays, alpha: Array, ends: Array, refused: str = "", ahead: Forecast | None = None,
    swing: Array | None = None, needs_rope: bool = True, firm: Array | None = None,
) -> tuple[Measurement, ...]:  # fmt: skip
    """Make a measurement of every frame: its swing, or why there is none.

    Parameters
    ----------
    alpha : ndarray, shape (n,)
        NaN where there is none.
    ends : ndarray, shape (n, 2)
    refused : str
        Reason for frames that lack an angle although no input was missing.
    swing : ndarray, shape (n, 2), optional
        Horizontal part of the unit direction OA, jib frame.
    needs_rope : bool
        Whether a frame without the rope's length lacks an input.
    firm : ndarray, shape (n, 2), optional
        Intervals for the probability of danger, by default ``ends``; see `without_lean`.
    """
    danger = alarm.probability(alpha, *(ends if firm is None else firm).T)
    direction = np.full(len(alpha), np.nan) if swing is None else np.arctan2(swing[:, 1], swing[:, 0])
    columns = {"alpha": alpha, "alpha_low": ends[:, 0], "alpha_high": ends[:, 1], "danger": danger}
    columns |= {"direction": direction} | ({} if ahead is None else vars(ahead))
    swings = [dict(zip(columns, row, strict=True)) for row in np.stack(list(columns.values()), axis=1).tolist()]
    found = []
    for s, angles, rope, jump in zip(
        record.observations, swings, record.rope_length.tolist(), record.jump, strict=True
    ):
        known = math.isfinite(rope)
        status, reason = _status(s, math.isfinite(angles["alpha"]), needs_rope and not known, jump, refused)
        found.append(Measurement(
            status=status, reason=reason, box=s.box, score=s.score, centre=s.centre, centre_sd=s.centre_sd,
            rope_text=s.rope_text, rope_status="jump" if jump else s.rope_status, rope_length_m=rope if known else None,
            **({name: value for name, value in angles.items() if math.isfinite(value)} if status == "ok" else {}),
        ))  # fmt: skip
    return tuple(found)


def _status(s: Observation, alpha: bool, lacks_rope: bool, jump: bool, refused: str) -> tuple[Status, str]:
    if s.lost:
        return "lost", s.lost
    if s.missed:
        return "missed", s.missed
    if alpha:
        return "ok", ""
    unread = "the hoist is too slow to have reached the length read" if jump else s.rope_reason
    if lacks_rope and (unread or not refused):
        return "unread", unread or "neither a display nor the controller states the rope's length"
    return "refused", refused or "no swing angle explains the pixel: the rope is shorter than the camera offset"
