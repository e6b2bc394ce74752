"""When each row of a picture sees the scene: exposure time and rolling shutter.

Things move linearly for the tens of milliseconds that a picture takes.
"""

from __future__ import annotations

import math

import numpy as np

from simgrab.model.geometry import Array, Pose
from simgrab.model.scenario import Scenario
from simgrab.world.trajectory.moment import Moment

LONGEST_STEP_PX = 1.5  # that anything moves between the instants that are rendered
MOST_INSTANTS = 24


def instants(shutter_s: float, readout_s: float, speed_px_s: float) -> Array:
    """Instants to render, s from the middle row's mid-exposure, close enough for what moves at a speed.

    Parameters
    ----------
    shutter_s : float
        Exposure time of a row.
    readout_s : float
        From the first row's exposure to the last's.
    speed_px_s : float
        Of the fastest thing in the picture.

    Returns
    -------
    ndarray, shape (n,)
        Increasing, symmetric about 0; a single 0 where nothing moves by a tenth of a pixel.
    """
    span = shutter_s + readout_s
    way = span * speed_px_s
    if way < 0.1:
        return np.zeros(1)
    count = min(math.ceil(way / LONGEST_STEP_PX) + 1, MOST_INSTANTS)
    return np.linspace(-span / 2, span / 2, max(count, 2))


def row_weights(height_px: int, shutter_s: float, readout_s: float, at: Array) -> Array:
    """Share of each instant in each row, shape (height_px, n): the scene goes linearly from instant to instant.

    Rows sum to 1. A row's exposure is centred on readout · ((row + ½)/height − ½).
    """
    if len(at) == 1:
        return np.ones((height_px, 1))
    step = at[1] - at[0]
    centre = (readout_s * ((np.arange(height_px) + 0.5) / height_px - 0.5))[:, None]
    if shutter_s < 1e-9:
        return np.asarray(np.maximum(1 - np.abs(centre - at) / step, 0.0))

    def integral(until: Array) -> Array:
        u = np.clip((until - at) / step, -1.0, 1.0)
        return np.asarray(step * (0.5 + u - u * np.abs(u) / 2))

    weights = integral(centre + shutter_s / 2) - integral(centre - shutter_s / 2)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def row_time(row_px: float, height_px: int, readout_s: float) -> float:
    """Mid-exposure of a row (px from the top), s from the middle row's."""
    return readout_s * (row_px / height_px - 0.5)


def exposed(scenario: Scenario, moment: Moment) -> Moment:
    """Go to the instant at which the row exposes that shows the grab centre: what the labels of the picture are of."""
    k, readout = scenario.camera.intrinsics, scenario.shutter.rolling_s
    seen = moment
    if readout and moment.ahead:
        for _ in range(3):  # each time a hundred times nearer
            row = float(k.project(_in_camera(scenario, seen, seen.grab.jib_from_grab.translation))[1])
            if not math.isfinite(row):
                return moment
            seen = moment.shifted(row_time(min(max(row, 0.0), k.height_px), k.height_px, readout))
    return seen


def speed_px_s(scenario: Scenario, moment: Moment) -> float:
    """Speed of the fastest thing in the picture: points of the grab and of the ground below."""
    if not moment.ahead:
        return 0.0
    assert moment.time is not None
    assert moment.ahead.time is not None
    here, there = (_marks(scenario, m) for m in (moment, moment.ahead))
    way = np.linalg.norm(there - here, axis=1)
    return float(np.nanmax(way, initial=0.0)) / (moment.ahead.time - moment.time)


def _marks(scenario: Scenario, moment: Moment) -> Array:
    """Pixels of the corners of a box about the grab and of a grid on the ground, shape (n, 2)."""
    assert moment.jib is not None
    corners = np.stack(np.meshgrid((-1.5, 1.5), (-1.2, 1.2), (-1.7, 1.7)), axis=-1).reshape(-1, 3)
    grid = np.stack(np.meshgrid((-10.0, 0.0, 10.0), (-6.0, 0.0, 6.0)), axis=-1).reshape(-1, 2)
    ground = np.column_stack([grid, np.full(len(grid), -scenario.jib.head_height_m)])
    points = np.concatenate([moment.grab.jib_from_grab.apply(corners), moment.jib.jib_from_place.apply(ground)])
    return scenario.camera.intrinsics.project(_in_camera(scenario, moment, points))


def _in_camera(scenario: Scenario, moment: Moment, points: Array) -> Array:
    return Pose(moment.tilt.jib_from_camera, np.asarray(scenario.camera.offset_m)).local(points)
