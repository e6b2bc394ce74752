"""Everything that one replication is drawn from: the truth, how it is observed, and what the instrument gets."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from simgrab.errors import StressError
from simgrab.model.calibration import Calibration
from simgrab.model.distributions import Constant, Distribution, Uniform
from simgrab.model.geometry import Distortion, Intrinsics
from simgrab.model.scenario import Camera, Iid, Scenario

# The instrument knows where its camera is, unless an axis changes that.
KNOWN_OFFSET_SD_M = 1e-3

KEYS = (
    "frames", "clip.frame_rate_hz", "camera.width_px", "camera.height_px", "camera.focal", "camera.principal_offset_px",
    "camera.distortion", "camera.beta_deg", "camera.tilt_azimuth_deg", "camera.roll_deg", "camera.offset_x_m",
    "camera.offset_y_m", "camera.offset_z_m", "swing.alpha", "swing.rope_length_m",
)  # fmt: skip
"""Keys of a scenario, or tables of keys, that a situation is read from; no other changes it."""


@dataclass(frozen=True)
class Swing:
    """The swing about the vertical. γ is measured from the direction of the tilt.

    Attributes
    ----------
    law : Distribution
        Of α; only its shape matters.
    sigma : float
        √E[α²], rad.
    kappa, towards : float
        Concentration and mean direction (rad) of the von Mises distribution of γ; 0 is uniform.
    axial : bool
        Whether the opposite direction is as likely.
    flatness : float
        1 − minor/major axis of the ellipse into which the swing is squeezed across the tilt.
    unevenness : float
        c, where α grows by the factor 1 + c·cosγ.
    lean : tuple of 2 floats
        Mean swing along and across the tilt, rad: wind, slewing.
    correlation : float
        Of successive frames.
    memory_s : float
        Time in which a swing dies down by e, as a forced pendulum's; 0 for independent frames.
    motion, mount : str
        Scene whose physics moves the grab, and the mount it moves the camera with; empty for independent frames.
    """

    law: Distribution
    sigma: float
    kappa: float = 0.0
    towards: float = 0.0
    axial: bool = False
    flatness: float = 0.0
    unevenness: float = 0.0
    lean: tuple[float, float] = (0.0, 0.0)
    correlation: float = 0.0
    memory_s: float = 0.0
    motion: str = ""
    mount: str = "fixed"


@dataclass(frozen=True)
class Attitude:
    """The camera's attitude, rad, and what moves it within a record.

    Attributes
    ----------
    beta, azimuth, roll : float
    luffing : float
        Range over which a rigid mount pitches outboard, uniformly.
    levelling : float
        Sideways lean of a levelled camera in the quarter of the time when the jib speeds up, and back when it brakes.
    tremble : float
        Standard deviation of each component of the tilt.
    planted : float
        Tilt that the truth conceals: a fault that the judge must find.
    """

    beta: float
    azimuth: float
    roll: float
    luffing: float = 0.0
    levelling: float = 0.0
    tremble: float = 0.0
    planted: float = 0.0


@dataclass(frozen=True)
class Rope:
    """Its length, m, and what the display makes of it.

    Attributes
    ----------
    low, high : float
        Uniform in between.
    hoisting : bool
        Whether it goes up and down steadily, in 75 s, and not at random.
    bias_m, lag_s, misread : float
        Of the reported length: error, delay, and share of frames with any length in between.
    """

    low: float
    high: float
    hoisting: bool = False
    bias_m: float = 0.0
    lag_s: float = 0.0
    misread: float = 0.0


@dataclass(frozen=True)
class Observation:
    """Errors of the observed pixels.

    Attributes
    ----------
    noise_px, heavy_px, slow_px : float
        Standard deviation per coordinate of Gaussian noise, scale of Student's with 3 degrees of freedom, and standard
        deviation of noise that wanders within 10 s.
    outliers : float
        Share of the frames in which something else in the picture is taken for the grab.
    box_centre : float
        How far from the grab's centre (0) to the centre of its box (1).
    missing : float
        Share of frames without a detection.
    missing_far : float
        Share of those at α = 10° that are missed, the hazard growing with α from 0 at rest.
    bounded : bool
        Whether what lies outside of the picture is missed.
    """

    noise_px: float = 0.0
    heavy_px: float = 0.0
    slow_px: float = 0.0
    outliers: float = 0.0
    box_centre: float = 0.0
    missing: float = 0.0
    missing_far: float = 0.0
    bounded: bool = False


@dataclass(frozen=True)
class Situation:
    """What one replication is drawn from.

    Attributes
    ----------
    frames : int
        n.
    rate_hz : float
    swing : Swing
    attitude : Attitude
    lens : Intrinsics
        The true one.
    offset : tuple of 3 floats
        Camera centre minus rope exit along and across the tilt and up, m, beyond what the calibration states.
    rope : Rope
    observation : Observation
    nominal : Calibration
        What the estimators get.
    """

    frames: int
    rate_hz: float
    swing: Swing
    attitude: Attitude
    lens: Intrinsics
    offset: tuple[float, float, float]
    rope: Rope
    observation: Observation
    nominal: Calibration

    @staticmethod
    def of(scenario: Scenario) -> Situation:
        """Read a situation without any violation from a scenario with independent frames."""
        swing, camera = scenario.swing, scenario.camera
        if not isinstance(swing, Iid):
            raise StressError('base: a study starts from independent frames; physics comes with the axis "motion"')
        if swing.gamma_deg != Uniform(0.0, 360.0):
            raise StressError("swing.gamma_deg: a study starts from a uniform direction; see the axes gamma-…")
        rope = swing.rope_length_m
        if not isinstance(rope, Uniform | Constant):
            raise StressError("swing.rope_length_m: a study takes a uniform or a constant length")
        low, high = rope.support()
        return Situation(
            frames=scenario.frames,
            rate_hz=scenario.clip.frame_rate_hz,
            swing=Swing(swing.alpha.law, math.radians(swing.alpha.sigma_deg)),
            attitude=Attitude(*map(math.radians, (camera.beta_deg, camera.tilt_azimuth_deg, camera.roll_deg))),
            lens=camera.intrinsics,
            offset=(0.0, 0.0, 0.0),
            rope=Rope(low, high),
            observation=Observation(),
            nominal=_nominal(camera),
        )

    def having(self, part: str = "", **changes: Any) -> Situation:
        """Change fields of one part, e.g. ``having("swing", sigma=0.1)``, or of the situation itself."""
        if not part:
            return replace(self, **changes)
        return replace(self, **{part: replace(getattr(self, part), **changes)})


def _nominal(camera: Camera) -> Calibration:
    k, d = camera.intrinsics, camera.distortion
    return Calibration(
        width_px=k.width_px, height_px=k.height_px, focal_length_px=k.f_px, cx_px=k.cx_px, cy_px=k.cy_px,
        k1=d.k1, k2=d.k2, p1=d.p1, p2=d.p2, k3=d.k3,
        offset_m=camera.offset_m, offset_sd_m=KNOWN_OFFSET_SD_M, roll_deg=camera.roll_deg,
    )  # fmt: skip


def shifted(lens: Intrinsics, along: float, across: float, direction: float) -> Intrinsics:
    """Move a principal point, px, along and across a direction in the picture (rad, clockwise from its x axis)."""
    c, s = math.cos(direction), math.sin(direction)
    return replace(lens, cx_px=lens.cx_px + along * c - across * s, cy_px=lens.cy_px + along * s + across * c)


def bent(lens: Intrinsics, k1: float) -> Intrinsics:
    """Give a lens another first coefficient of distortion."""
    return replace(lens, distortion=Distortion(k1=k1))
