"""The rendered fidelity: a replication is a record of pictures, measured by the bundled detector and reader."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from simgrab.errors import StressError
from simgrab.lab.stress import estimators, study, swings
from simgrab.lab.stress.parameters import Value
from simgrab.lab.stress.records import PROBE_ALPHA, PROBES, Picture, Records
from simgrab.lab.stress.study import BASE, Study
from simgrab.lab.stress.swings import Draws, Motion
from simgrab.model.geometry import Array, camera_rotation, grab_centre, to_camera
from simgrab.model.scenario import Iid, Scenario

if TYPE_CHECKING:
    from simgrab.lab.stress.watch import Watched

KEYS = (
    BASE, "frames", "camera", "swing", "grab", "jib", "place", "clutter", "light", "optics", "weather", "image",
    "shutter", "clip.frame_rate_hz", "display",
)  # fmt: skip
"""Keys of a scenario, or tables of keys, that pictures and their times depend on; and the scene itself."""

# `simgrab.lab.stress.watch` is imported late: geometric studies do without OpenGL and onnxruntime.


def settle(chosen: Study, point: tuple[Value, ...]) -> Scenario:
    """Make the scene at a point of a study.

    Raises
    ------
    StressError
        If there is none, or an estimator would miss what it takes.
    """
    scenario = study.scenario(chosen, point)
    if scenario.vary:
        raise StressError(f"{BASE}: {scenario.name!r} varies {next(iter(scenario.vary))}; the base scene must not vary")
    lacks = {
        "needs_rope": "the rope's length, and the scene shows no display to read it from (display.layout)"
        if scenario.display_layout is None else "",
        "needs_time": "times, and the scene's frames are independent (swing.model)"
        if isinstance(scenario.swing, Iid) else "",
    }  # fmt: skip
    for name in chosen.estimators:
        estimator = estimators.find(name)
        for need, why in lacks.items():
            if why and getattr(estimator, need, False):
                raise StressError(f"estimators: {name!r} takes {why}")
    return scenario


def together(scenario: Scenario) -> int:  # noqa: ARG001
    """Return how many replications may be rendered together: one, so that an interrupted run loses little."""
    return 1


def draw(scenario: Scenario, seed: int, trials: Sequence[int]) -> Records:
    """Render and measure. Replication k is the scene under a seed of its own, in a world of its own.

    Parameters
    ----------
    scenario : Scenario
    seed : int
    trials : sequence of int
        Numbers of the replications.
    """
    from simgrab.lab.stress.watch import watch

    return _records(scenario, seed, trials, [watch(scenario, seed, trial) for trial in trials])


def show(scenario: Scenario, seed: int, trial: int) -> tuple[Records, Picture]:
    """Draw one replication, and a sheet of the frames in which the grab is found worst (BGR)."""
    from simgrab.lab.stress.watch import sheet, watch

    watched = watch(scenario, seed, trial)
    return _records(scenario, seed, [trial], [watched]), sheet(watched)


def made_with() -> str:
    """Name renderer, detector and reader."""
    from simgrab.lab.stress.watch import made_with

    return made_with()


def _records(scenario: Scenario, seed: int, trials: Sequence[int], watched: Sequence[Watched]) -> Records:
    camera, swing = scenario.camera, scenario.swing
    truth = np.stack([one.truth for one in watched])  # (M, 6, n)
    alpha, azimuth, rope = np.moveaxis(truth[:, :3], 1, 0)
    # Of physics, whose expectation nobody knows, the record's own.
    sigma = (
        np.full(len(trials), math.radians(swing.alpha.sigma_deg))
        if isinstance(swing, Iid)
        else np.sqrt(np.mean(alpha**2, axis=-1))
    )
    motion = Motion(alpha, azimuth, rope, truth[:, 3:], sigma)
    ring = swings.ring(Draws(seed, trials, PROBES), motion, PROBE_ALPHA, math.radians(camera.tilt_azimuth_deg))
    return Records(
        pixels=np.stack([one.seen.pixels for one in watched]),
        rope=np.stack([one.seen.rope.length for one in watched]),
        time=watched[0].seen.time,
        calibration=watched[0].calibration,
        alpha=np.where([one.present for one in watched], alpha, np.nan),
        beta=math.radians(camera.beta_deg),
        sigma=sigma,
        azimuth=math.radians(camera.tilt_azimuth_deg),
        probe_pixels=_projected(scenario, ring),
        probe_rope=ring.rope,
        pixel_sd=np.stack([one.seen.pixel_sd for one in watched]),
    )


def _projected(scenario: Scenario, motion: Motion) -> Array:
    """Where the scene's camera has the grab centre, px, shape (M, n, 2)."""
    assert motion.tilt is not None
    rotation = camera_rotation(*motion.tilt.swapaxes(0, 1))
    centre = grab_centre(motion.alpha, motion.azimuth, motion.rope)
    return scenario.camera.intrinsics.project(to_camera(centre, rotation, scenario.camera.offset_m))
