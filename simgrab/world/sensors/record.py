"""Record the sensors of a clip."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simgrab.errors import ScenarioError
from simgrab.model.geometry import Array
from simgrab.model.scenario import MotionSensor, Scenario, Variant
from simgrab.world.extensions import Randomiser, Recipe
from simgrab.world.sensors.device import Device, SensorRows, Setting
from simgrab.world.sensors.errors import streams
from simgrab.world.sensors.motion import motions
from simgrab.world.sensors.table import DEVICES, implementation


@dataclass(frozen=True, eq=False)
class Recording:
    """Readings of a sensor in one clip, and their truth."""

    name: str
    sensor: MotionSensor  # the sensor's table in the scenario
    stamp_ns: NDArray[np.int64]  # (n,), time stamps of the sensor's own clock, ns since the clip began
    columns: tuple[str, ...]  # names of `values`, each with its unit in brackets
    values: Array  # (n, len(columns)), reported values
    truth_columns: tuple[str, ...]
    # (n, len(truth_columns)), truth of each sample; the first column is the true time, s since the clip began
    truth: Array
    body_from_sensor: Array | None  # (4, 4), nominal pose in the frame of its body, m; None for encoders

    def true(self, column: str) -> Array:
        """Return a column of the truth, shape (n,); raises KeyError with the names of all."""
        if column not in self.truth_columns:
            raise KeyError(f"no column {column!r}; there are: {', '.join(self.truth_columns)}")
        return self.truth[:, self.truth_columns.index(column)]


def sensors(
    scene: Scenario | str | Path, clip: int = 0, *, randomiser: Randomiser | str | None = None
) -> dict[str, Recording]:
    """Record the sensors of a scene during one clip, writing nothing.

    `simgrab.render` writes the same readings beside the frames of the clip.

    Parameters
    ----------
    scene : Scenario, str or path
        Scene with ``swing.model = "dynamic"`` and tables ``sensors.NAME``; any other is refused.
    clip : int
        Number of the clip, a negative one from the end.
    randomiser : callable or str, optional
        As `simgrab.frames` takes it.

    Returns
    -------
    dict of str to Recording
        By the sensors' names.

    Raises
    ------
    ScenarioError
        If the scene has no sensors or is impossible. The message names the key.
    ExtensionError
        If the randomiser cannot be found, raises an error, or returns impossible values.
    IndexError
        If there is no such clip.

    Examples
    --------
    >>> import simgrab
    >>> scene = simgrab.load("free-swing", {"frames": 18, "sensors.imu0": {"model": "imu", "mount": "rope"}})
    >>> imu = simgrab.sensors(scene)["imu0"]
    >>> imu.columns[3], imu.values.shape[1]
    ('a_RS_S_x [m s^-2]', 6)
    """
    recipe = Recipe.of(scene, randomiser)
    scenario = recipe.scenario
    if not scenario.sensors:
        raise ScenarioError("sensors", 'there are none; add one, such as imu0 = { model = "imu", mount = "grab" }')
    count, number = scenario.clip_count, operator.index(clip)
    if not -count <= number < count:
        raise IndexError(f"clip {number} is out of range: the scenario has {count} clips")
    number %= count
    variant = recipe.variant(scenario.span(number).start)
    one, devices = variant.scenario, devices_of(variant, number, recipe.split)
    taken: dict[str, list[SensorRows]] = {name: [] for name in devices}
    for name, rows in record(one, number, devices):
        taken[name].append(rows)
    return {
        name: Recording(
            name, one.sensors[name],
            np.concatenate([rows.stamp_ns for rows in taken[name]]),
            made.columns, np.concatenate([rows.values for rows in taken[name]]),
            made.truth_columns, np.concatenate([rows.truth for rows in taken[name]]),
            made.body_from_sensor,
        )
        for name, made in devices.items()
    }  # fmt: skip


def devices_of(variant: Variant, clip: int, split: Callable[[int], str], *, renders: bool = False) -> dict[str, Device]:
    """Set up the sensors of one clip, by name; with ``renders`` cameras render their pictures. Close them."""
    scenario, devices = variant.scenario, {}
    for name, sensor in scenario.sensors.items():
        opened = streams(scenario.seed, clip, name)
        setting = Setting(scenario, variant.draws, opened, scenario.span(clip), split, renders)
        kind = str(sensor.__struct_config__.tag)
        devices[name] = implementation(DEVICES[kind], f"sensors.{name}.model")(sensor, setting)
    return devices


def record(scenario: Scenario, clip: int, devices: dict[str, Device]) -> Iterator[tuple[str, SensorRows]]:
    """Record a clip with new devices; yields each one's name and rows, some seconds at a time, in order for each.

    The scenario has dynamic swing, and nothing varies in it.
    """
    due: dict[str, Array] = {}

    def instants(_begin: float, end: float) -> Array:
        due.update({name: made.instants(end) for name, made in devices.items()})
        return np.unique(np.concatenate(list(due.values())))

    for motion in motions(scenario, clip, instants):
        for name, made in devices.items():
            if len(due[name]):
                yield name, made.rows(motion[np.searchsorted(motion.time, due[name])])
