"""simgrab: frames of a swinging crane grab in which the swing is known because it was set.

>>> import simgrab
>>> scene = simgrab.load("quay-day", {"camera.beta_deg": 5.0})
>>> simgrab.render(scene, "runs/quay-day")  # doctest: +SKIP
>>> simgrab.audit("runs/quay-day").status  # doctest: +SKIP
'passed'
>>> simgrab.open("runs/quay-day")[0].picture.shape  # doctest: +SKIP
(1080, 1920, 3)
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from simgrab._version import __version__
from simgrab.runtime import environment

environment.take_out_numbers()  # must come before OpenCV is imported anywhere below

if TYPE_CHECKING:
    from simgrab.dataset.render import render as render
    from simgrab.dataset.shard_reader import open as open
    from simgrab.dataset.video.render import render_video as render_video
    from simgrab.instrument.detect.pictures import detect as detect
    from simgrab.instrument.estimate.measure import estimate as estimate
    from simgrab.instrument.run.run import run as run
    from simgrab.judge.audit.audit import audit as audit
    from simgrab.judge.check.gate import check as check
    from simgrab.judge.evaluate.evaluation import evaluate as evaluate
    from simgrab.lab.stress.laboratory import stress as stress
    from simgrab.model import calibration as calibration
    from simgrab.model import layouts as layouts
    from simgrab.model import scenes as scenes
    from simgrab.model.records.estimates import Estimate as Estimate
    from simgrab.model.records.estimates import Intervals as Intervals
    from simgrab.model.scenes import load as load
    from simgrab.world.frames import FrameDataset as FrameDataset
    from simgrab.world.frames import frames as frames
    from simgrab.world.sensors.record import sensors as sensors
    from simgrab.world.trajectory.moment import GrabState as GrabState
    from simgrab.world.trajectory.moment import JibState as JibState
    from simgrab.world.trajectory.moment import Moment as Moment
    from simgrab.world.trajectory.moment import Tilt as Tilt

# Imported when first asked for: `import simgrab` alone touches neither MuJoCo nor OpenGL.
_HOME = {
    "load": "simgrab.model.scenes",
    "frames": "simgrab.world.frames",
    "FrameDataset": "simgrab.world.frames",
    "GrabState": "simgrab.world.trajectory.moment",
    "JibState": "simgrab.world.trajectory.moment",
    "Moment": "simgrab.world.trajectory.moment",
    "Tilt": "simgrab.world.trajectory.moment",
    "render": "simgrab.dataset.render",
    "render_video": "simgrab.dataset.video.render",
    "sensors": "simgrab.world.sensors.record",
    "open": "simgrab.dataset.shard_reader",
    "audit": "simgrab.judge.audit.audit",
    "check": "simgrab.judge.check.gate",
    "run": "simgrab.instrument.run.run",
    "detect": "simgrab.instrument.detect.pictures",
    "estimate": "simgrab.instrument.estimate.measure",
    "evaluate": "simgrab.judge.evaluate.evaluation",
    "stress": "simgrab.lab.stress.laboratory",
    "Estimate": "simgrab.model.records.estimates",
    "Intervals": "simgrab.model.records.estimates",
}
_MODULES = ("calibration", "layouts", "scenes")
__all__ = ["__version__", *_HOME, *_MODULES]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return importlib.import_module(f"simgrab.model.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'simgrab' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
