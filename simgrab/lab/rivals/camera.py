"""Rivals that measure with the camera at the jib head, after Kawai and Matsuo, and by optical flow."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from simgrab.errors import RecordError
from simgrab.instrument import angles
from simgrab.instrument.contract import Frame, Measurement
from simgrab.instrument.estimate import Estimator, PendulumSmoother, ZeroTilt
from simgrab.instrument.estimate.frames import groups
from simgrab.instrument.estimate.solve import stated_ends
from simgrab.instrument.observation import Observation
from simgrab.lab.rivals.contract import Series
from simgrab.lab.rivals.tracking import Tracker, flow, template
from simgrab.model.calibration import Calibration


@dataclass(frozen=True, eq=False)
class Tracked:
    r"""A tracker and an estimator as an instrument (`simgrab.instrument.contract.Instrument`).

    Rope lengths, \|OA\|, m, are by the clock of the frames; only some estimators need them.
    """

    name: str
    tracker: Tracker
    estimator: Estimator
    rope: Series | None = None

    def __call__(self, frames: Iterable[Frame], calibration: Calibration) -> Sequence[Measurement]:
        """Measure a record."""
        return conclude(list(self.tracker(frames)), calibration, self.estimator, self.rope)


def conclude(
    observations: Sequence[Observation], calibration: Calibration, estimator: Estimator, rope: Series | None = None
) -> Sequence[Measurement]:
    """From a target's centres to swings; without them the reason is the observation's, or the estimator's."""
    length = np.full(len(observations), np.nan)
    time = [one.time_s for one in observations if one.time_s is not None]
    if rope is not None and len(time) == len(observations):
        length = rope.at(np.array(time))[:, 0]
    record = angles.arrays(observations, length)
    alpha, ends = np.full(len(length), np.nan), np.full((len(length), 2), np.nan)
    if estimator.needs_rope and np.isnan(length).any():
        return angles.measurements(record, alpha, ends, f"{estimator.name} needs rope lengths, and frames with times")
    try:
        estimate = record.estimate(estimator, calibration)
    except RecordError as problem:
        return angles.measurements(record, alpha, ends, str(problem))
    if estimate.alpha is not None:
        alpha, ends = estimate.alpha, stated_ends(estimate)
    return angles.measurements(record, alpha, ends, estimate.reason or "the estimator found no angle")


def target_angles(observations: Sequence[Observation], calibration: Calibration) -> Series:
    """Angles of a target's rays along x and y of the jib frame, as if the camera were level; for `Sensors.target`."""
    seen = [(one.time_s, one.centre) for one in observations if one.time_s is not None and one.centre is not None]
    if len(seen) < 2:
        raise RecordError("the target was found in fewer than two pictures")
    pixels = np.array([centre for _, centre in seen], float)
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
