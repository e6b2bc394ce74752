"""Parked grabs of other cranes on the quay or a deck: they look like the labelled grab, but are not labelled."""

from __future__ import annotations

import colorsys
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from simgrab.model.geometry import rotation_z
from simgrab.model.scenario import Clutter, Mesh
from simgrab.world.scenery.clearance import CELL_M, HeightMap
from simgrab.world.scenery.grabs import design_of
from simgrab.world.scenery.grabs.design import Design
from simgrab.world.scenery.grabs.drawn import any_of
from simgrab.world.scenery.meshes.paint import finish
from simgrab.world.scenery.meshes.part import Part

NEAREST_M, FARTHEST_M = 8.5, 16.0  # from the vertical through O: out of the grab's way, yet mostly in view
ASIDE_M = 10.0  # the picture is wider across the jib than along it
FOOTPRINT_M = 1.9  # half its side
LEVEL_M = 0.25  # rails and joints are level enough
BELOW_QUAY_M = 0.5  # lower lie water and holds
TRIES = 200
MOST_JAW = np.radians(40.0)


def parked_grabs(
    clutter: Clutter, place: Sequence[Part], *, head_height: float, rng: np.random.Generator
) -> list[Part]:
    """Place grabs on level ground, each with its own shape, paint, jaws and yaw.

    Parameters
    ----------
    place : sequence of Part
        In the jib frame, as the result.
    head_height : float
        Rope exit above the quay's surface, m.
    """
    if not clutter.other_grabs:
        return []
    designs = [_design(clutter.kinds, rng) for _ in range(clutter.other_grabs)]
    ground = HeightMap.of((part.mesh for part in place), FARTHEST_M + 2 * FOOTPRINT_M)
    parts: list[Part] = []
    spots = _spots(ground, -head_height - BELOW_QUAY_M, rng)
    for number, (design, spot) in enumerate(zip(designs, spots, strict=False)):
        parts += _grab(number, design, spot, rng)
    return parts


def _design(kinds: Sequence[str | Mesh], rng: np.random.Generator) -> Design:
    """Draw a grab of one of the kinds; a single kind of fixed shape needs no draw."""
    kind = kinds[0 if len(kinds) == 1 else int(rng.choice(len(kinds)))]
    return design_of(kind if isinstance(kind, Mesh) else any_of(kind, rng, volume_m3=(3.0, 8.0)))


def _spots(ground: HeightMap, lowest: float, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Points (3,) to stand on, apart from each other."""
    taken: list[np.ndarray] = []
    for _ in range(TRIES):
        radius, azimuth = rng.uniform(NEAREST_M, FARTHEST_M), rng.uniform(0, 2 * np.pi)
        at = radius * np.array([np.cos(azimuth), np.sin(azimuth)])
        low, high = (np.floor((at + s * FOOTPRINT_M + ground.half_width) / CELL_M).astype(int) for s in (-1, 1))
        below = ground.top[low[1] : high[1] + 1, low[0] : high[0] + 1]
        level = below.min() >= lowest and below.max() - below.min() <= LEVEL_M
        apart = all(np.hypot(*(at - other[:2])) > 3 * FOOTPRINT_M for other in taken)
        if level and apart and abs(at[0]) < ASIDE_M:
            taken.append(np.array([*at, below.max()]))
            yield taken[-1]


def _grab(number: int, design: Design, spot: np.ndarray, rng: np.random.Generator) -> list[Part]:
    """One grab on a spot, in the jib frame; names and materials carry its number."""
    paint = colorsys.hsv_to_rgb(rng.random(), rng.uniform(0.2, 0.95), rng.uniform(0.25, 0.9))
    mixed = finish(paint, rng.random(), rng.random(), str(rng.choice(["coal", "ore", "grain"])), rng)
    bodies = {body.name: mixed.on(body.parts) for body in design.bodies}
    frames = design.frames(min(rng.uniform(0, MOST_JAW), design.max_jaw))
    lowest = min(part.moved(frames[body]).mesh.bounds[0, 2] for body, parts in bodies.items() for part in parts)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_z(rng.uniform(0, 2 * np.pi)), spot - (0.0, 0.0, lowest)
    return [
        replace(
            part.moved(pose @ frames[body], f"parked_{number}/{body}/{part.name}"),
            material=replace(part.material, name=f"parked_{number}/{part.material.name}"),
        )
        for body, parts in bodies.items()
        for part in parts
    ]
