"""Tilt and swing from pixels: six estimators under one contract, and the paper's check by the width of the grab."""

from __future__ import annotations

from types import MappingProxyType

from simgrab.instrument.estimate.contract import Estimator
from simgrab.instrument.estimate.geometric_median import GeometricMedian
from simgrab.instrument.estimate.grab_width import GrabWidth
from simgrab.instrument.estimate.inertial.estimator import InertialFusion
from simgrab.instrument.estimate.intervals import IntervalSettings
from simgrab.instrument.estimate.mean_ray import MeanRay
from simgrab.instrument.estimate.paper_iteration import PaperIteration
from simgrab.instrument.estimate.pendulum_smoother import PendulumSmoother
from simgrab.instrument.estimate.rope_aware import RopeAware
from simgrab.instrument.estimate.zero_tilt import ZeroTilt

ESTIMATORS = MappingProxyType(
    {
        kind.name: kind
        for kind in (PaperIteration, MeanRay, GeometricMedian, RopeAware, PendulumSmoother, ZeroTilt)
    }
)  # fmt: skip
"""Name on the command line → class; each can be made without arguments."""

DEFAULT = MeanRay.name

__all__ = [
    "DEFAULT",
    "ESTIMATORS",
    "Estimator",
    "GeometricMedian",
    "GrabWidth",
    "InertialFusion",
    "IntervalSettings",
    "MeanRay",
    "PaperIteration",
    "PendulumSmoother",
    "RopeAware",
    "ZeroTilt",
]
