"""What the value of an axis does to a situation, where it does more than set one number."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Annotated

import msgspec

from simgrab.errors import StressError
from simgrab.lab.stress.laws import LAWS, Bursts, Student
from simgrab.lab.stress.situation import KNOWN_OFFSET_SD_M, Situation, bent, shifted
from simgrab.model import scenes
from simgrab.model.distributions import HalfNormal
from simgrab.model.geometry import vertical_direction
from simgrab.model.scenario import Dynamic

MOST = 1e9
Value = Annotated[float, msgspec.Meta(ge=-MOST, le=MOST)] | str
Parameter = Callable[[Situation, Value], Situation]
DEG = math.pi / 180
_MIDDLE_ROPE_M = 21.5


def number(name: str, value: Value, low: float = -math.inf, high: float = math.inf) -> float:
    """Refuse what is no number within bounds."""
    if isinstance(value, str):
        raise StressError(f"{name}: takes numbers, got {value!r}")
    if not low <= value <= high:
        raise StressError(f"{name}: must lie in [{low:g}, {high:g}], got {value:g}")
    return float(value)


def law(situation: Situation, value: Value) -> Situation:
    """Give α another distribution."""
    if value not in LAWS:
        raise StressError(f"alpha-law: unknown distribution {value!r}; one of: {', '.join(LAWS)}")
    return situation.having("swing", law=LAWS[str(value)])


def student(situation: Situation, value: Value) -> Situation:
    """Give α Student's t distribution, the tail being 1/degrees of freedom."""
    inverse = number("alpha-student", value, 0, 0.45)
    return situation.having("swing", law=Student(1 / inverse)) if inverse else situation


def bursts(situation: Situation, value: Value) -> Situation:
    """Idle for a share of the frames."""
    idle = number("alpha-bursts", value, 0, 0.99)
    return situation.having("swing", law=Bursts(idle)) if idle else situation


def correlated(situation: Situation, value: Value) -> Situation:
    """Make successive frames alike."""
    return situation.having("swing", law=HalfNormal(), correlation=number("ar1", value, 0, 0.9999))


def motion(situation: Situation, value: Value) -> Situation:
    """Let a scene's physics move the grab."""
    if value == "independent":
        return situation
    if value not in scenes.names() or not _moves(str(value)):
        moving = filter(_moves, scenes.names())
        raise StressError(f"motion: no moving scene {value!r}; one of: independent, {', '.join(moving)}")
    return situation.having("swing", motion=str(value))


@functools.cache
def _moves(scene: str) -> bool:
    return isinstance(scenes.load(scene).swing, Dynamic)


def mount(situation: Situation, value: Value) -> Situation:
    """Hang the camera on what moves while the crane works."""
    if value not in ("fixed", "levelled", "rigid"):
        raise StressError(f"mount: unknown mount {value!r}; one of: fixed, levelled, rigid")
    if value == "fixed":
        return situation
    return situation.having("swing", motion=situation.swing.motion or "work-cycles", mount=str(value))


def leaning(name: str, part: int, scale: Callable[[float], float]) -> Parameter:
    """Make what leans the rope along (0) or across (1) the tilt, by ``scale(value)`` rad."""

    def apply(situation: Situation, value: Value) -> Situation:
        lean = list(situation.swing.lean)
        lean[part] += scale(number(name, value))
        return situation.having("swing", lean=(lean[0], lean[1]))

    return apply


def offset(name: str, part: int, sign: float = 1.0) -> Parameter:
    """Move the camera. The instrument gets the unmoved position, with the displacement as its uncertainty."""

    def apply(situation: Situation, value: Value) -> Situation:
        metres = number(name, value, -3, 3)
        offset = list(situation.offset)
        offset[part] += sign * metres
        size = max(KNOWN_OFFSET_SD_M, *map(abs, offset))
        nominal = msgspec.structs.replace(situation.nominal, offset_sd_m=size)
        return situation.having(offset=(offset[0], offset[1], offset[2]), nominal=nominal)

    return apply


def nominal(situation: Situation, value: Value) -> Situation:
    """Move the camera along the tilt; the instrument gets the position."""
    a = situation.attitude.azimuth
    x, y, z = situation.nominal.offset_m
    metres = number("offset-known", value, -3, 3)
    nominal = (x + metres * math.cos(a), y + metres * math.sin(a), z)
    return situation.having(nominal=msgspec.structs.replace(situation.nominal, offset_m=nominal))


def rope_range(situation: Situation, value: Value) -> Situation:
    """Spread the length of the rope about 21.5 m."""
    half = number("rope-range", value, 0, 27) / 2
    return situation.having("rope", low=_MIDDLE_ROPE_M - half, high=_MIDDLE_ROPE_M + half)


def rope(situation: Situation, value: Value) -> Situation:
    """Give the rope one length."""
    metres = number("rope", value, 6, 45)
    return situation.having("rope", low=metres, high=metres)


def focal(situation: Situation, value: Value) -> Situation:
    """Give estimators a focal length that is too long by so many percent."""
    focal_px = situation.nominal.focal_length_px * (1 + number("focal", value, -50, 50) / 100)
    return situation.having(nominal=msgspec.structs.replace(situation.nominal, focal_length_px=focal_px))


def principal(name: str, part: int) -> Parameter:
    """Make what moves the principal point along (0) or across (1) the tilt."""

    def apply(situation: Situation, value: Value) -> Situation:
        direction = float(vertical_direction(situation.attitude.azimuth, situation.attitude.roll))
        shift = [0.0, 0.0]
        shift[part] = number(name, value)
        return situation.having(lens=shifted(situation.lens, shift[0], shift[1], direction))

    return apply


def distortion(situation: Situation, value: Value) -> Situation:
    """Distort the lens, unknown to the instrument."""
    return situation.having(lens=bent(situation.lens, number("distortion", value, -1, 1)))


def roll(situation: Situation, value: Value) -> Situation:
    """Roll the camera, unknown to the instrument."""
    return situation.having("attitude", roll=situation.attitude.roll + DEG * number("roll", value))
