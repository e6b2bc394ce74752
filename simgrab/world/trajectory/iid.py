"""Independent frames: poses of the grab, drawn from the scenario's distributions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simgrab.errors import ScenarioError
from simgrab.model import geometry
from simgrab.model.distributions import AnyDistribution
from simgrab.model.rng import stream
from simgrab.model.scenario import MOST_ALPHA_DEG, Iid, Scenario
from simgrab.world.scenery.grabs import design_of
from simgrab.world.trajectory.hanging import hung
from simgrab.world.trajectory.moment import GrabState, Moment, Tilt

CLOSED = np.radians(2.0)  # jaws wider than this hold nothing


def draw(scenario: Scenario, frame: int) -> Moment:
    """Draw one independent frame; every variable has its own stream, so frames can be made alone and in any order.

    Raises `ScenarioError` if an unbounded distribution draws an impossible value. The message names frame and key.
    """
    swing = scenario.swing
    assert isinstance(swing, Iid)

    def value(name: str, law: AnyDistribution) -> float:
        return float(law.sample(stream(scenario.seed, frame, f"swing.{name}")))

    alpha_deg = abs(value("alpha", swing.alpha.law)) * swing.alpha.scale_deg
    if alpha_deg > MOST_ALPHA_DEG:
        raise ScenarioError(
            "swing.alpha.sigma_deg", f"frame {frame} has alpha = {alpha_deg:.1f}°, above {MOST_ALPHA_DEG:g}°"
        )
    jaw = np.radians(value("jaw", swing.jaw_deg))
    design = design_of(scenario.grab)
    most, clamped = design.max_jaw, jaw > design.max_jaw > 0
    if clamped and "jaw_deg" not in swing.clamped:
        raise ScenarioError(
            "swing.jaw_deg",
            f"frame {frame} has a jaw angle of {np.degrees(jaw):.1f}°; at most {np.degrees(most):g}° is possible; "
            'swing.clamp = ["jaw_deg"] opens jaws as far as they go',
        )
    jaw = min(jaw, most)
    gamma = np.radians(value("gamma", swing.gamma_deg)) % (2 * np.pi)
    load = value("load", swing.load)
    tilt = Tilt.at_rest(scenario.camera)
    grab = GrabState(
        alpha=float(np.radians(alpha_deg)),
        azimuth=float((gamma + tilt.azimuth) % (2 * np.pi)),
        rope_length=value("rope_length", swing.rope_length_m),
        yaw=float(geometry.wrap(np.radians(value("yaw", swing.yaw_deg)))),
        jaw=float(jaw),
        load=load if jaw <= CLOSED and design.holds_cargo else 0.0,
    )
    grab = hung(grab, scenario.suspension, float(design.terminations[0, 2]))
    present = stream(scenario.seed, frame, "swing.absent").random() >= swing.absent
    moment = Moment(frame, grab, tilt, float(gamma), present=bool(present))
    return replace(moment, clamped=("jaw_deg",)) if clamped else moment
