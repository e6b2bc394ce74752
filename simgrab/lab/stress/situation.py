"""Everything that one replication is drawn from: the truth, how it is observed, and what the instrument gets."""

from __future__ import annotations

import math
from dataclasses import dataclass

from simgrab.errors import StressError
from simgrab.lab.stress import laws
from simgrab.lab.stress.laws import Law
from simgrab.model.calibration import Calibration
from simgrab.model.distributions import Constant, Uniform
from simgrab.model.geometry import Intrinsics
from simgrab.model.scenario import Iid, Scenario

# The instrument knows where its camera is, unless an axis changes that.
KNOWN_OFFSET_SD_M = 1e-3

KEYS = (
    "frames", "clip.frame_rate_hz", "camera.width_px", "camera.height_px", "camera.focal", "camera.principal_offset_px",
    "camera.distortion", "camera.beta_deg", "camera.tilt_azimuth_deg", "camera.roll_deg", "camera.offset_x_m",
    "camera.offset_y_m", "camera.offset_z_m", "swing.alpha", "swing.rope_length_m",
)  # fmt: skip
"""Keys of a scenario, or tables of keys, that a situation is read from; no other changes it."""


@dataclass(frozen=True)
class Situation:
    """What one replication is drawn from: angles in radians, lengths in metres, γ from the direction of the tilt."""

    frames: int  # n
    rate_hz: float
    nominal: Calibration  # what the estimators get
    law: Law  # of α
    sigma: float  # √E[α²]
    beta: float  # attitude of the camera
    azimuth: float
    roll: float
    lens: Intrinsics  # the true one
    rope_m: tuple[float, float]  # between which its length is uniform
    kappa: float = 0.0  # concentration of the von Mises distribution of γ; 0 is uniform
    towards: float = 0.0  # and its mean direction
    axial: bool = False  # whether the opposite direction is as likely
    flatness: float = 0.0  # 1 − minor/major axis of the ellipse into which the swing is squeezed across the tilt
    unevenness: float = 0.0  # c, where α grows by the factor 1 + c·cosγ
    lean: tuple[float, float] = (0.0, 0.0)  # mean swing along and across the tilt: wind, slewing
    correlation: float = 0.0  # of successive frames
    memory_s: float = 0.0  # in which a swing dies down by e, as a forced pendulum's; 0 for independent frames
    motion: str = ""  # scene whose physics moves the grab; empty for independent frames
    mount: str = "fixed"  # with which it moves the camera
    luffing: float = 0.0  # range over which a rigid mount pitches outboard, uniformly
    # Sideways lean of a levelled camera in the quarter of the time when the jib speeds up, and back when it brakes.
    levelling: float = 0.0
    tremble: float = 0.0  # standard deviation of each component of the tilt
    planted: float = 0.0  # tilt that the truth conceals: a fault that the judge must find
    # Camera centre minus rope exit along and across the tilt and up, beyond what the calibration states.
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    hoisting: bool = False  # whether the rope goes up and down steadily, in 75 s, and not at random
    rope_bias_m: float = 0.0  # of the reported length, and its delay
    rope_lag_s: float = 0.0
    rope_misread: float = 0.0  # share of frames with any length in between
    noise_px: float = 0.0  # standard deviation per coordinate of Gaussian noise
    heavy_px: float = 0.0  # scale of Student's noise with 3 degrees of freedom
    slow_px: float = 0.0  # standard deviation of noise that wanders within 10 s
    outliers: float = 0.0  # share of the frames in which something else in the picture is taken for the grab
    box_centre: float = 0.0  # how far from the grab's centre (0) to the centre of its box (1)
    missing: float = 0.0  # share of frames without a detection
    missing_far: float = 0.0  # share missed at α = 10°, the hazard growing with α from 0 at rest
    bounded: bool = False  # whether what lies outside of the picture is missed


def of(scenario: Scenario) -> Situation:
    """Read a situation without any violation from a scenario with independent frames; raises `StressError`."""
    swing, camera = scenario.swing, scenario.camera
    if not isinstance(swing, Iid):
        raise StressError('base: a study starts from independent frames; physics comes with the axis "motion"')
    if swing.gamma_deg != Uniform(0.0, 360.0):
        raise StressError("swing.gamma_deg: a study starts from a uniform direction; see the axes gamma-…")
    if not isinstance(swing.rope_length_m, Uniform | Constant):
        raise StressError("swing.rope_length_m: a study takes a uniform or a constant length")
    k, d = camera.intrinsics, camera.distortion
    nominal = Calibration(
        width_px=k.width_px, height_px=k.height_px, focal_length_px=k.f_px, cx_px=k.cx_px, cy_px=k.cy_px,
        k1=d.k1, k2=d.k2, p1=d.p1, p2=d.p2, k3=d.k3,
        offset_m=camera.offset_m, offset_sd_m=KNOWN_OFFSET_SD_M, roll_deg=camera.roll_deg,
    )  # fmt: skip
    degrees = swing.alpha.sigma_deg, camera.beta_deg, camera.tilt_azimuth_deg, camera.roll_deg
    sigma, beta, azimuth, roll = map(math.radians, degrees)
    return Situation(
        scenario.frames, scenario.clip.frame_rate_hz, nominal, laws.of(swing.alpha.law), sigma, beta, azimuth, roll,
        camera.intrinsics, swing.rope_length_m.support(),
    )  # fmt: skip
