"""Every assumption that can be turned up: its unit, the value at which it holds, and what a value does."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Annotated, Any

import msgspec

from simgrab.errors import StressError
from simgrab.lab.stress import laws
from simgrab.lab.stress.laws import LAWS
from simgrab.lab.stress.situation import KNOWN_OFFSET_SD_M, Situation
from simgrab.model import scenes
from simgrab.model.distributions import HalfNormal
from simgrab.model.geometry import STANDARD_GRAVITY, Distortion, vertical_direction
from simgrab.model.scenario import Dynamic

MOST = 1e9
Value = Annotated[float, msgspec.Meta(ge=-MOST, le=MOST)] | str
DEG = math.pi / 180
_MIDDLE_ROPE_M = 21.5
# A grab of 10.5 t with Cd·A = 10 m² in air of 1.2 kg/m³, and a jib of 25 m.
_LEAN_PER_WIND2 = 0.5 * 1.2 * 10.0 / (10_500 * STANDARD_GRAVITY)  # rad per (m/s)²
_LEAN_PER_RPM2 = (2 * math.pi / 60) ** 2 * 25.0 / STANDARD_GRAVITY
_PITCH_PER_M = 2 * DEG  # of a camera bolted to the fly-jib that luffs

# Fields of a situation that physics, and a mount that moves, take the place of.
_OF_SWING = {"law", "sigma", "kappa", "towards", "axial", "flatness", "unevenness", "lean", "correlation", "memory_s",
             "rope_m"}  # fmt: skip
_OF_CAMERA = {"luffing", "levelling", "tremble"}
# A pendulum of 20 m swings only if it is damped less: critically at √(L/g).
_LEAST_MEMORY_S = 1.5
EXCLUSIVE = (
    {"memory", "ar1", "alpha-law", "alpha-student", "alpha-bursts"},
    {"memory", "ar1", "gamma-towards", "gamma-across", "gamma-axial"},
    {"memory", "gamma-alpha"},
    {"rope", "rope-range"},
)
"""Axes of which only one may be stated where one is turned up, since it would overwrite another."""

Change = Callable[[Situation, Any], dict[str, Any]]


@dataclass(frozen=True)
class Axis:
    """One assumption."""

    # name, unit, description: `unit` is empty for names and pure numbers; `description` is one line for the report
    name: str
    unit: str
    description: str
    holds: Value | None  # value at which the assumption holds, a name where values are names; None where it always does
    change: Change = lambda _situation, _value: {}  # situation and value → fields of the situation that change
    # low, high: between which values lie that are numbers
    low: float = -math.inf
    high: float = math.inf
    # scenario key that does the same, through which every fidelity reaches the axis; empty where only the geometric
    # fidelity does; then `change` is not used
    key: str = ""

    def apply(self, situation: Situation, value: Value) -> Situation:
        """Turn the assumption up; raises `StressError` where a value cannot be."""
        if isinstance(value, str) and not isinstance(self.holds, str):
            raise StressError(f"{self.name}: takes numbers, got {value!r}")
        if not isinstance(value, str) and not self.low <= value <= self.high:
            raise StressError(f"{self.name}: must lie in [{self.low:g}, {self.high:g}], got {value:g}")
        return replace(situation, **self.change(situation, value))

    def overridden(self, situation: Situation, value: Value) -> str:
        """Name what of a situation takes the place of the axis; empty if nothing does."""
        sets = {"sigma"} if self.key.startswith("swing.") else set() if self.key else set(self.change(situation, value))
        if situation.motion and sets & _OF_SWING:
            return f"the physics of {situation.motion!r} makes the swing and the rope's length"
        if situation.mount != "fixed" and sets & _OF_CAMERA:
            return f"the mount {situation.mount!r} moves the camera"
        return ""


def _field(
    name: str, unit: str, description: str, field: str, low: float = -math.inf, high: float = math.inf, *,
    scale: float = 1.0, **also: object,
) -> Axis:  # fmt: skip
    """Make an axis that sets a field of a situation, and ``also`` others where its value is not 0."""
    return Axis(name, unit, description, 0.0, lambda _, v: {field: scale * v} | (also if v else {}), low, high)


def _law(_: Situation, name: Value) -> dict[str, Any]:
    if name not in LAWS:
        raise StressError(f"alpha-law: unknown distribution {name!r}; one of: {', '.join(LAWS)}")
    return {"law": LAWS[str(name)]}


def _memory(_: Situation, value: float) -> dict[str, Any]:
    if 0 < value < _LEAST_MEMORY_S:
        raise StressError(f"memory: must be 0, or {_LEAST_MEMORY_S:g} or more: damped more, a pendulum does not swing")
    return {"memory_s": value}


def _motion(_: Situation, name: Value) -> dict[str, Any]:
    if name == "independent":
        return {}
    if name not in scenes.names() or not _moves(str(name)):
        moving = filter(_moves, scenes.names())
        raise StressError(f"motion: no moving scene {name!r}; one of: independent, {', '.join(moving)}")
    return {"motion": name}


@functools.cache
def _moves(scene: str) -> bool:
    return isinstance(scenes.load(scene).swing, Dynamic)


def _mount(situation: Situation, name: Value) -> dict[str, Any]:
    if name not in ("fixed", "levelled", "rigid"):
        raise StressError(f"mount: unknown mount {name!r}; one of: fixed, levelled, rigid")
    return {} if name == "fixed" else {"motion": situation.motion or "work-cycles", "mount": name}


def _leaning(part: int, scale: Callable[[float], float]) -> Change:
    """Lean the rope along (0) or across (1) the tilt, by ``scale(value)`` rad."""
    return lambda s, v: {"lean": tuple(lean + scale(v) if i == part else lean for i, lean in enumerate(s.lean))}


def _offset(*way: float) -> Change:
    """Move the camera. The instrument gets the unmoved position, with the displacement as its uncertainty."""

    def change(situation: Situation, value: float) -> dict[str, Any]:
        offset = tuple(old + step * value for old, step in zip(situation.offset, way, strict=True))
        sd = max(KNOWN_OFFSET_SD_M, *map(abs, offset))
        return {"offset": offset, "nominal": msgspec.structs.replace(situation.nominal, offset_sd_m=sd)}

    return change


def _offset_known(situation: Situation, value: float) -> dict[str, Any]:
    """Move the camera along the tilt; the instrument gets the position."""
    (x, y, z), a = situation.nominal.offset_m, situation.azimuth
    there = (x + value * math.cos(a), y + value * math.sin(a), z)
    return {"nominal": msgspec.structs.replace(situation.nominal, offset_m=there)}


def _focal(situation: Situation, value: float) -> dict[str, Any]:
    focal_px = situation.nominal.focal_length_px * (1 + value / 100)
    return {"nominal": msgspec.structs.replace(situation.nominal, focal_length_px=focal_px)}


def _principal(along: float, across: float) -> Change:
    """Move the principal point along and across the tilt's direction in the picture, clockwise from its x axis."""

    def change(situation: Situation, value: float) -> dict[str, Any]:
        lens, direction = situation.lens, float(vertical_direction(situation.azimuth, situation.roll))
        a, b, c, s = along * value, across * value, math.cos(direction), math.sin(direction)
        return {"lens": replace(lens, cx_px=lens.cx_px + a * c - b * s, cy_px=lens.cy_px + a * s + b * c)}

    return change


_ALL = (
    # What the paper assumes of the swing
    Axis("alpha-law", "", "distribution of α", "half-normal", _law),
    Axis("alpha-student", "", "tail of α: 1/degrees of freedom of Student's t", 0.0,
         lambda _, v: {"law": laws.student(1 / v)} if v else {}, 0, 0.45),
    Axis("alpha-bursts", "", "share of idle frames, the others swinging five times as far", 0.0,
         lambda _, v: {"law": laws.bursts(v)} if v else {}, 0, 0.99),
    _field("gamma-towards", "κ", "swing prefers the direction of the tilt (von Mises)", "kappa", 0, 100),
    _field("gamma-across", "κ", "swing prefers one side of the tilt (von Mises)", "kappa", 0, 100,
           towards=math.pi / 2),
    _field("gamma-axial", "κ", "swing prefers the line of the tilt, both ways (axial von Mises)", "kappa", 0, 100,
           axial=True),
    _field("gamma-ellipse", "", "flatness of the ellipse of the swing, long along the tilt", "flatness", 0, 1),
    _field("gamma-alpha", "", "swing towards the tilt is larger: α grows with 1 + c·cosγ", "unevenness", -1, 1),
    Axis("ar1", "", "correlation of successive frames, half-normal α", 0.0,
         lambda _, v: {"law": laws.of(HalfNormal()), "correlation": v}, 0, 0.9999),
    Axis("memory", "s", "decay time (1/e) of a forced pendulum's swing, Rayleigh-distributed α", 0.0, _memory, 0),
    Axis("motion", "", "motion of the grab: simulated physics in place of independent frames", "independent", _motion),
    Axis("lean-along", "deg", "mean lean of the rope along the tilt", 0.0, _leaning(0, lambda v: v * DEG)),
    Axis("lean-across", "deg", "mean lean of the rope across the tilt", 0.0, _leaning(1, lambda v: v * DEG)),
    Axis("wind", "m/s", "steady wind along the tilt: the grab leans by drag over weight", 0.0,
         _leaning(0, lambda v: _LEAN_PER_WIND2 * v * v)),
    Axis("slewing", "rpm", "steady slewing at 25 m: the grab leans outboard along the tilt", 0.0,
         _leaning(0, lambda v: _LEAN_PER_RPM2 * v * v)),
    Axis("sigma", "deg", "σ, the size of the swing", 2.0, key="swing.alpha.sigma_deg"),
    # What it assumes of the camera
    Axis("beta", "deg", "β, the tilt of the camera", 5.0, key="camera.beta_deg"),
    Axis("offset-along", "m", "camera beside the rope exit, along the tilt", 0.0, _offset(1, 0, 0), -3, 3),
    Axis("offset-across", "m", "camera beside the rope exit, across the tilt", 0.0, _offset(0, 1, 0), -3, 3),
    Axis("offset-below", "m", "camera below the rope exit", 0.0, _offset(0, 0, -1), -3, 3),
    Axis("offset-known", "m", "camera beside the rope exit along the tilt, with the offset stated in its file", 0.0,
         _offset_known, -3, 3),
    Axis("mount", "", "what the camera hangs on while the crane works in cycles", "fixed", _mount),
    _field("luffing", "m", "range of luffing, with which a rigid camera pitches 2° a metre", "luffing", 0,
           scale=_PITCH_PER_M),
    _field("levelling", "m/s²", "sideways acceleration of the jib that a levelled camera mistakes for gravity",
           "levelling", 0, scale=1 / STANDARD_GRAVITY),
    _field("vibration", "deg", "vibration of the camera, each component", "tremble", 0, scale=DEG),
    Axis("focal", "%", "focal length stated too long", 0.0, _focal, -50, 50),
    Axis("principal-along", "px", "principal point off, along the tilt", 0.0, _principal(1, 0)),
    Axis("principal-across", "px", "principal point off, across the tilt", 0.0, _principal(0, 1)),
    Axis("distortion", "k1", "lens distortion ignored", 0.0,
         lambda s, v: {"lens": replace(s.lens, distortion=Distortion(k1=v))}, -1, 1),
    Axis("roll", "deg", "camera rolled, unknown to the instrument", 0.0, lambda s, v: {"roll": s.roll + DEG * v}),
    # What it assumes of the record
    Axis("n", "frames", "n, the number of frames", None, key="frames"),
    _field("noise", "px", "Gaussian noise of each pixel coordinate", "noise_px", 0),
    _field("noise-heavy", "px", "noise of Student's t with 3 degrees of freedom", "heavy_px", 0),
    _field("noise-slow", "px", "noise with a correlation time of 10 s", "slow_px", 0),
    _field("outliers", "", "share of frames with a false detection, uniform over the picture", "outliers", 0, 1),
    _field("box-centre", "", "from the grab's centre (0) to the centre of its box (1)", "box_centre", 0, 1),
    _field("missing", "", "share of frames without a detection", "missing", 0, 1),
    _field("missing-far", "", "share missed at α = 10°, the hazard growing with α", "missing_far", 0, 0.999),
    Axis("edge", "", "1: grabs outside the image are missed", 0.0, lambda _, v: {"bounded": bool(v)}, 0, 1),
    # The rope, of which the paper makes no use
    Axis("rope", "m", "rope of one length", None, lambda _, v: {"rope_m": (v, v)}, 6, 45),
    Axis("rope-range", "m", "range of the rope's length about 21.5 m", None,
         lambda _, v: {"rope_m": (_MIDDLE_ROPE_M - v / 2, _MIDDLE_ROPE_M + v / 2)}, 0, 27),
    _field("rope-bias", "m", "rope length reported too long", "rope_bias_m"),
    _field("rope-lag", "s", "rope length reported late, with a hoist cycle of 75 s", "rope_lag_s", 0, hoisting=True),
    _field("rope-misread", "", "share of frames whose rope length is misread", "rope_misread", 0, 1),
    # The judge's own check
    _field("planted", "deg", "tilt that is hidden from the truth: a fault that must be detected", "planted",
           scale=DEG),
)  # fmt: skip

AXES: Mapping[str, Axis] = MappingProxyType({axis.name: axis for axis in _ALL})
"""Axis by name."""
