"""Modules of the kinds of sensors, each imported only for a scene that has one."""

from __future__ import annotations

import pkgutil
from typing import Any

from simgrab.errors import ScenarioError

DEVICES = {
    "imu": "simgrab.world.sensors.imu:ImuDevice",
    "inclinometer": "simgrab.world.sensors.inclinometer:InclinometerDevice",
    "slew-encoder": "simgrab.world.sensors.encoders:EncoderDevice",
    "luff-encoder": "simgrab.world.sensors.encoders:EncoderDevice",
    "hoist-encoder": "simgrab.world.sensors.encoders:EncoderDevice",
    "controller": "simgrab.world.sensors.encoders:ControllerDevice",
    "lidar": "simgrab.lab.sensors.lidar:LidarDevice",
    "camera": "simgrab.lab.sensors.camera:CameraDevice",
}
"""From the ``model`` of a sensor to a `simgrab.world.sensors.device.Device`, which takes sensor and setting."""
ROPE_WAVES = "simgrab.lab.sensors.waves:RopeWaves"
"""What gives the ropes' waves to `simgrab.world.sensors.motion.motions`; it takes scenario and course."""


def implementation(target: str, key: str) -> Any:
    """Import the implementation of a kind, for a key of the scenario.

    Raises `ScenarioError` if this installation lacks it. The message names the key.
    """
    try:
        return pkgutil.resolve_name(target)
    except ModuleNotFoundError as error:
        module = target.partition(":")[0]
        if not f"{module}.".startswith(f"{error.name}."):
            raise
        raise ScenarioError(key, f"needs {module}, which is not installed") from None
