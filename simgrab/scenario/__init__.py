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
from simgrab.scenario.factor import Factor, OneOf
from simgrab.scenario.grab import Clamshell, FourRope, Grab, Jaw, Mesh, OrangePeel, Scissors
from simgrab.scenario.optics import AutoExposure, FixedExposure, Optics, Sensor
from simgrab.scenario.output import Clip, Display, Image, Labels, Shutter, Splits
from simgrab.scenario.size import resized
from simgrab.scenario.surroundings import Clutter, Hold, Jib, Light, Plain, Quay, Water
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
from simgrab.scenario.vary import Variant, variant, variants
from simgrab.scenario.weather import Weather
from simgrab.scenario.whole import Scenario, merged, schema

__all__ = [
    "MOST_ALPHA_DEG",
    "ROPE_LENGTH_RANGE_M",
    "Alpha",
    "AutoExposure",
    "Camera",
    "Cargo",
    "Clamshell",
    "Clip",
    "Clutter",
    "Cycles",
    "Display",
    "Dynamic",
    "Factor",
    "FixedExposure",
    "FixedMount",
    "Forcing",
    "FourRope",
    "Grab",
    "Hang",
    "Hold",
    "Iid",
    "Image",
    "Jaw",
    "Jib",
    "Labels",
    "Lens",
    "LensFocal",
    "LevelledMount",
    "Light",
    "Mesh",
    "OneOf",
    "Optics",
    "OrangePeel",
    "PixelFocal",
    "Plain",
    "Quay",
    "RigidMount",
    "Scenario",
    "Scissors",
    "Sensor",
    "SensorFocal",
    "Share",
    "Shutter",
    "Splits",
    "Start",
    "Strict",
    "Tagged",
    "Turn",
    "Variant",
    "Vibration",
    "Water",
    "Weather",
    "Wind",
    "merged",
    "resized",
    "schema",
    "variant",
    "variants",
]
