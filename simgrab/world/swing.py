"""Independent frames: where the grab hangs in each, drawn from the scenario's laws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgrab import geometry
from simgrab.distributions import Law
from simgrab.errors import ScenarioError
from simgrab.geometry import Array
from simgrab.rng import stream
from simgrab.scenario import MOST_ALPHA_DEG, Scenario

CLOSED = np.radians(2.0)  # jaws wider than this hold nothing


@dataclass(frozen=True)
class GrabState:
    """Pose of the grab in the jib frame, rad and m, and what it holds.

    Attributes
    ----------
    alpha, gamma : float
        Swing angle, and its azimuth relative to the camera's tilt azimuth.
    azimuth : float
        Azimuth of the swing in the jib frame.
    rope_length : float
        |OA|.
    yaw, jaw : float
        Turn about the rope; opening of each shell.
    load : float
        Fill, 0 to 1.
    """

    alpha: float
    gamma: float
    azimuth: float
    rope_length: float
    yaw: float
    jaw: float
    load: float

    @property
    def jib_from_grab(self) -> Array:
        """Pose, shape (4, 4)."""
        pose = np.eye(4)
        pose[:3, :3] = geometry.grab_rotation(self.alpha, self.azimuth, self.yaw)
        pose[:3, 3] = geometry.grab_centre(self.alpha, self.azimuth, self.rope_length)
        return pose


def draw(scenario: Scenario, frame: int, *, most_jaw: float) -> GrabState:
    """Draw the state of one frame; every variable has its own stream, so frames can be made alone and in any order.

    Parameters
    ----------
    scenario : Scenario
    frame : int
    most_jaw : float
        Widest opening of the jaws, rad.

    Raises
    ------
    ScenarioError
        If a law without bounds draws what cannot be, naming frame and key.
    """
    swing = scenario.swing

    def value(name: str, law: Law) -> float:
        return float(law.sample(stream(scenario.seed, frame, f"swing.{name}")))

    alpha_deg = abs(value("alpha", swing.alpha.law)) * swing.alpha.scale_deg
    if alpha_deg > MOST_ALPHA_DEG:
        raise ScenarioError(
            "swing.alpha.sigma_deg", f"frame {frame} draws alpha = {alpha_deg:.1f}°, above {MOST_ALPHA_DEG:g}°"
        )
    jaw = np.radians(value("jaw", swing.jaw_deg))
    if jaw > most_jaw:
        raise ScenarioError(
            "swing.jaw_deg",
            f"frame {frame} draws {np.degrees(jaw):.1f}°; the jaws open to {np.degrees(most_jaw):g}° at most",
        )
    gamma = np.radians(value("gamma", swing.gamma_deg)) % (2 * np.pi)
    load = value("load", swing.load)
    return GrabState(
        alpha=float(np.radians(alpha_deg)),
        gamma=float(gamma),
        azimuth=float((gamma + np.radians(scenario.camera.tilt_azimuth_deg)) % (2 * np.pi)),
        rope_length=value("rope_length", swing.rope_length_m),
        yaw=float(geometry.wrap(np.radians(value("yaw", swing.yaw_deg)))),
        jaw=float(jaw),
        load=load if jaw <= CLOSED else 0.0,
    )


def split(scenario: Scenario, frame: int) -> str:
    """Draw a frame into train, val or test by the scenario's shares."""
    share = stream(scenario.seed, frame, "split").random()
    return "train" if share < scenario.splits.train else "val" if share < 1 - scenario.splits.test else "test"
