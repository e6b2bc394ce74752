"""The pipeline of `answers`, sound and with faults that a regression gate must see."""

from __future__ import annotations

import dataclasses
import math

import msgspec
from answers import Answers, KnowingDetector, KnowingReader

from simgrab.instrument.estimate import RopeAware
from simgrab.instrument.estimate.follow import follow, known
from simgrab.instrument.pipeline import Pipeline


@dataclasses.dataclass(frozen=True)
class Mirrored(RopeAware):
    """Takes γ for minus γ: the tilt leans to the other side of the jib."""

    def estimate(self, pixels, calibration, **given):
        found = super().estimate(pixels, calibration, **given)
        wrong = dataclasses.replace(found, tilt_azimuth=-found.tilt_azimuth % (2 * math.pi))
        alpha, *_ = follow(known(wrong, calibration), pixels, calibration, rope_length=given["rope_length"])
        return dataclasses.replace(wrong, alpha=alpha)


@dataclasses.dataclass(frozen=True)
class LongLens(RopeAware):
    """Believes in a wrong focal length."""

    times: float = 1.05

    def estimate(self, pixels, calibration, **known):
        longer = msgspec.structs.replace(calibration, focal_length_px=self.times * calibration.focal_length_px)
        return super().estimate(pixels, longer, **known)


def pipeline(shift_px=0.0, takes="", **parts):
    """What makes a pipeline that looks its answers up in a folder of datasets."""

    def make(folder):
        answers = Answers(folder)
        return Pipeline(KnowingDetector(answers, shift_px=shift_px), KnowingReader(answers, takes), **parts)

    return make


sound, shifted = pipeline(), pipeline(shift_px=2.0)
FAULTS = {
    "detector 2 px to the right": shifted,
    "3 read as 8": pipeline(takes="38"),
    "h 5 % off": pipeline(estimator=LongLens()),
    "sign of gamma": pipeline(estimator=Mirrored()),
}
