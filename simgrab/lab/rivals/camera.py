"""Rivals that measure with the camera at the jib head, after Kawai and Matsuo, and by optical flow."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from simgrab.errors import RecordError
from simgrab.instrument.contract import Frame, Measurement
from simgrab.instrument.estimate import Estimator, PendulumSmoother, ZeroTilt
from simgrab.instrument.estimate.frames import groups
from simgrab.lab.rivals.contract import Series
from simgrab.lab.rivals.tracking import Place, Tracker, flow, template
from simgrab.model.calibration import Calibration
from simgrab.model.geometry import Array
from simgrab.model.records.estimates import Estimate


@dataclass(frozen=True, eq=False)
class Tracked:
    r"""A tracker and an estimator as an instrument (`simgrab.instrument.contract.Instrument`).

    Attributes
    ----------
    name : str
    tracker : Tracker
    estimator : Estimator
    rope : Series or None
        Rope lengths, \|OA\|, m, by the clock of the frames; only some estimators need them.
    """

    name: str
    tracker: Tracker
    estimator: Estimator
    rope: Series | None = None

    def __call__(self, frames: Iterable[Frame], calibration: Calibration) -> Sequence[Measurement]:
        """Measure a record."""
        return conclude(list(self.tracker(frames)), calibration, self.estimator, self.rope)


def conclude(
    places: Sequence[Place], calibration: Calibration, estimator: Estimator, rope: Series | None = None
) -> list[Measurement]:
    """From a target's places to swings; without them the reason is the place's, or the estimator's."""
    pixels = np.array([place.pixel or (np.nan, np.nan) for place in places], float).reshape(-1, 2)
    try:
        estimate = _estimate(places, pixels, calibration, estimator, rope)
        refusal = "" if estimate.ok else estimate.reason
    except RecordError as problem:
        estimate, refusal = None, str(problem)
    if estimate is None or estimate.alpha is None:
        alpha, ends = np.full(len(places), np.nan), None
    else:
        alpha, ends = estimate.alpha, _ends(estimate)
    return [_measurement(place, alpha, ends, i, refusal) for i, place in enumerate(places)]


def _estimate(
    places: Sequence[Place], pixels: Array, calibration: Calibration, estimator: Estimator, rope: Series | None
) -> Estimate:
    timed = [place.time for place in places if place.time is not None]
    time = np.array(timed) if len(timed) == len(places) and places else None
    length = None
    if estimator.needs_rope:
        if rope is None or time is None:
            raise RecordError(f"{estimator.name} needs rope lengths, and frames with times")
        length = rope.at(time)[:, 0]
    return estimator.estimate(pixels, calibration, rope_length=length, time=time)


def _ends(estimate: Estimate) -> Array | None:
    with_alpha = [interval.alpha for interval in estimate.intervals if interval.alpha is not None]
    return with_alpha[0] if with_alpha else None


def _measurement(place: Place, alpha: Array, ends: Array | None, i: int, refusal: str) -> Measurement:
    if place.status != "ok":
        return Measurement(status=place.status, reason=place.reason)
    if refusal or not np.isfinite(alpha[i]):
        return Measurement(status="refused", reason=refusal or "the estimator found no angle")
    low, high = (None, None) if ends is None or not np.isfinite(ends[i]).all() else map(float, ends[i])
    return Measurement(
        status="ok", alpha=min(float(alpha[i]), np.pi / 2), alpha_low=low, alpha_high=high, centre=place.pixel
    )


def target_angles(places: Sequence[Place], calibration: Calibration) -> Series:
    """Angles of a target's rays along x and y of the jib frame, as if the camera were level; for `Sensors.target`."""
    seen = [(place.time, place.pixel) for place in places if place.time is not None and place.pixel is not None]
    if len(seen) < 2:
        raise RecordError("the target was found in fewer than two pictures")
    pixels = np.array([pixel for _, pixel in seen], float)
    (frames,) = groups(pixels[None], None, None, calibration)
    return Series(np.array([time for time, _ in seen]), np.arctan2(frames.rays[0, :2], -frames.rays[0, 2]).T)


def kawai() -> Tracked:
    """Landmark found by template matching, and the angle of its ray from the optical axis.

    After Kawai et al. (2009). Known: a camera on the trolley, a landmark on the load, robust template matching. Filled
    in: normalised correlation refined by a parabola, the grab's own steel about its centre in the first picture as
    landmark, and the optical axis as vertical.
    """
    return Tracked("kawai", template(), ZeroTilt())


def matsuo() -> Tracked:
    """Target followed by a video tracker, and the angle of its ray from the optical axis.

    After Matsuo et al. (2004). Known: a commercial video tracker on a target. Filled in: a template that follows the
    picture by a tenth a frame, and the grab's own steel as target.
    """
    return Tracked("matsuo", template(update=0.1), ZeroTilt())


def optical_flow(rope: Series | None = None) -> Tracked:
    """Optical flow of the grab's corners, smoothed by a pendulum with unknown tilt (`PendulumSmoother`).

    After no single source: flow of Lucas and Kanade in pyramids, as OpenCV has it. It needs rope lengths.
    """
    return Tracked("optical-flow", flow(), PendulumSmoother(), rope)


CAMERA = {"kawai": kawai, "matsuo": matsuo, "optical-flow": optical_flow}
"""Name → factory of an instrument; each can be made without arguments."""
