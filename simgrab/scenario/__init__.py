"""A scenario: everything that can change a number or a pixel, as frozen typed structs."""

from simgrab.scenario.base import Cargo, Share, Strict, Tagged
from simgrab.scenario.camera import (
    Camera,
    FixedMount,
    Lens,
    LensFocal,
    LevelledMount,
    PixelFocal,
    RigidMount,
    SensorFocal,
    Vibration,
)
from simgrab.scenario.output import Clip, Display, Image, Labels, Splits
from simgrab.scenario.surroundings import Grab, Hold, Jib, Light, Plain, Quay, Water
from simgrab.scenario.swing import (
    MOST_ALPHA_DEG,
    ROPE_LENGTH_RANGE_M,
    Alpha,
    Cycles,
    Dynamic,
    Forcing,
    Hang,
    Iid,
    Start,
    Turn,
    Wind,
)
from simgrab.scenario.weather import Weather
from simgrab.scenario.whole import Scenario, merged, schema

__all__ = [
    "MOST_ALPHA_DEG",
    "ROPE_LENGTH_RANGE_M",
    "Alpha",
    "Camera",
    "Cargo",
    "Clip",
    "Cycles",
    "Display",
    "Dynamic",
    "FixedMount",
    "Forcing",
    "Grab",
    "Hang",
    "Hold",
    "Iid",
    "Image",
    "Jib",
    "Labels",
    "Lens",
    "LensFocal",
    "LevelledMount",
    "Light",
    "PixelFocal",
    "Plain",
    "Quay",
    "RigidMount",
    "Scenario",
    "SensorFocal",
    "Share",
    "Splits",
    "Start",
    "Strict",
    "Tagged",
    "Turn",
    "Vibration",
    "Water",
    "Weather",
    "Wind",
    "merged",
    "schema",
]
