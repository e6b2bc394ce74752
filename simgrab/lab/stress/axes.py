"""Every assumption that can be turned up: its unit, the value at which it holds, and what a value does."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from simgrab.lab.stress import parameters
from simgrab.lab.stress.parameters import DEG, Parameter, Value
from simgrab.lab.stress.situation import Situation
from simgrab.model.geometry import STANDARD_GRAVITY

# A grab of 10.5 t with Cd·A = 10 m² in air of 1.2 kg/m³, and a jib of 25 m.
_LEAN_PER_WIND2 = 0.5 * 1.2 * 10.0 / (10_500 * STANDARD_GRAVITY)  # rad per (m/s)²
_LEAN_PER_RPM2 = (2 * math.pi / 60) ** 2 * 25.0 / STANDARD_GRAVITY
_PITCH_PER_M = 2 * DEG  # of a camera bolted to the fly-jib that luffs


@dataclass(frozen=True)
class Axis:
    """One assumption.

    Attributes
    ----------
    name, unit, description : str
        ``unit`` is empty for names and pure numbers; ``description`` is one line for the report.
    holds : float or str or None
        Value at which the assumption holds; None where it always does.
    apply : callable
        Situation and value → situation.
    key : str
        Scenario key that does the same, through which every fidelity reaches the axis; empty where only the geometric
        fidelity does. Then `apply` is not used.
    """

    name: str
    unit: str
    description: str
    holds: Value | None
    apply: Parameter
    key: str = ""


def _field(
    name: str, unit: str, description: str, part: str, field: str, *,
    scale: float = 1.0, low: float = -math.inf, high: float = math.inf, holds: float = 0.0, **also: object,
) -> Axis:  # fmt: skip
    """Make an axis that sets one field of a situation, and ``also`` others of the same part."""

    def apply(situation: Situation, value: Value) -> Situation:
        number = parameters.number(name, value, low, high)
        return situation.having(part, **{field: scale * number}, **(also if number != holds else {}))

    return Axis(name, unit, description, holds, apply)


def _keyed(name: str, unit: str, description: str, key: str, holds: float | None) -> Axis:
    return Axis(name, unit, description, holds, lambda situation, _: situation, key)


def _ar_of(name: str, description: str, towards: float, axial: bool = False) -> Axis:
    return _field(name, "κ", description, "swing", "kappa", low=0, high=100, towards=towards, axial=axial)


_ALL = (
    # What the paper assumes of the swing
    Axis("alpha-law", "", "distribution of α", "half-normal", parameters.law),
    Axis("alpha-student", "", "tail of α: 1/degrees of freedom of Student's t", 0.0, parameters.student),
    Axis("alpha-bursts", "", "share of idle frames, the others swinging five times as far", 0.0, parameters.bursts),
    _ar_of("gamma-towards", "swing prefers the direction of the tilt (von Mises)", 0.0),
    _ar_of("gamma-across", "swing prefers one side of the tilt (von Mises)", math.pi / 2),
    _ar_of("gamma-axial", "swing prefers the line of the tilt, both ways (axial von Mises)", 0.0, axial=True),
    _field("gamma-ellipse", "", "flatness of the ellipse of the swing, long along the tilt", "swing", "flatness",
           low=0, high=1),
    _field("gamma-alpha", "", "swing towards the tilt is larger: α grows with 1 + c·cosγ", "swing", "unevenness",
           low=-1, high=1),
    Axis("ar1", "", "correlation of successive frames, half-normal α", 0.0, parameters.correlated),
    _field("memory", "s", "decay time (1/e) of a forced pendulum's swing", "swing", "memory_s", low=0),
    Axis("motion", "", "motion of the grab: simulated physics in place of independent frames", "independent",
         parameters.motion),
    Axis("lean-along", "deg", "mean lean of the rope along the tilt", 0.0,
         parameters.leaning("lean-along", 0, lambda v: v * DEG)),
    Axis("lean-across", "deg", "mean lean of the rope across the tilt", 0.0,
         parameters.leaning("lean-across", 1, lambda v: v * DEG)),
    Axis("wind", "m/s", "steady wind along the tilt: the grab leans by drag over weight", 0.0,
         parameters.leaning("wind", 0, lambda v: _LEAN_PER_WIND2 * v * v)),
    Axis("slewing", "rpm", "steady slewing at 25 m: the grab leans outboard along the tilt", 0.0,
         parameters.leaning("slewing", 0, lambda v: _LEAN_PER_RPM2 * v * v)),
    _keyed("sigma", "deg", "σ, the size of the swing", "swing.alpha.sigma_deg", 2.0),
    # What it assumes of the camera
    _keyed("beta", "deg", "β, the tilt of the camera", "camera.beta_deg", 5.0),
    Axis("offset-along", "m", "camera beside the rope exit, along the tilt", 0.0, parameters.offset("offset-along", 0)),
    Axis("offset-across", "m", "camera beside the rope exit, across the tilt", 0.0,
         parameters.offset("offset-across", 1)),
    Axis("offset-below", "m", "camera below the rope exit", 0.0, parameters.offset("offset-below", 2, -1)),
    Axis("offset-known", "m", "camera beside the rope exit along the tilt, with the offset stated in its file", 0.0,
         parameters.nominal),
    Axis("mount", "", "what the camera hangs on while the crane works in cycles", "fixed", parameters.mount),
    _field("luffing", "m", "range of luffing, with which a rigid camera pitches 2° a metre", "attitude", "luffing",
           scale=_PITCH_PER_M, low=0),
    _field("levelling", "m/s²", "sideways acceleration of the jib that a levelled camera mistakes for gravity",
           "attitude", "levelling", scale=1 / STANDARD_GRAVITY, low=0),
    _field("vibration", "deg", "vibration of the camera, each component", "attitude", "tremble", scale=DEG, low=0),
    Axis("focal", "%", "focal length stated too long", 0.0, parameters.focal),
    Axis("principal-along", "px", "principal point off, along the tilt", 0.0,
         parameters.principal("principal-along", 0)),
    Axis("principal-across", "px", "principal point off, across the tilt", 0.0,
         parameters.principal("principal-across", 1)),
    Axis("distortion", "k1", "lens distortion ignored", 0.0, parameters.distortion),
    Axis("roll", "deg", "camera rolled, unknown to the instrument", 0.0, parameters.roll),
    # What it assumes of the record
    _keyed("n", "frames", "n, the number of frames", "frames", None),
    _field("noise", "px", "Gaussian noise of each pixel coordinate", "observation", "noise_px", low=0),
    _field("noise-heavy", "px", "noise of Student's t with 3 degrees of freedom", "observation", "heavy_px", low=0),
    _field("noise-slow", "px", "noise with a correlation time of 10 s", "observation", "slow_px", low=0),
    _field("outliers", "", "share of frames with a false detection in place of the grab", "observation", "outliers",
           low=0, high=1),
    _field("box-centre", "", "from the grab's centre (0) to the centre of its box (1)", "observation", "box_centre",
           low=0, high=1),
    _field("missing", "", "share of frames without a detection", "observation", "missing", low=0, high=1),
    _field("missing-far", "", "share missed at α = 10°, the hazard growing with α", "observation", "missing_far",
           low=0, high=0.999),
    Axis("edge", "", "1: grabs outside the image are missed", 0.0,
         lambda s, v: s.having("observation", bounded=bool(parameters.number("edge", v, 0, 1)))),
    # The rope, of which the paper makes no use
    Axis("rope", "m", "rope of one length", None, parameters.rope),
    Axis("rope-range", "m", "range of the rope's length about 21.5 m", None, parameters.rope_range),
    _field("rope-bias", "m", "rope length reported too long", "rope", "bias_m"),
    _field("rope-lag", "s", "rope length reported late, with a hoist cycle of 75 s", "rope", "lag_s", low=0,
           hoisting=True),
    _field("rope-misread", "", "share of frames whose rope length is misread", "rope", "misread", low=0, high=1),
    # The judge's own check
    _field("planted", "deg", "tilt that is hidden from the truth: a fault that must be detected", "attitude", "planted",
           scale=DEG),
)  # fmt: skip

AXES: Mapping[str, Axis] = MappingProxyType({axis.name: axis for axis in _ALL})
"""Axis by name."""
