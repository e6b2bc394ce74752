"""Level ground: an empty yard, or one that shows a photograph where the renderer draws it."""

from __future__ import annotations

import trimesh

from simgrab.world.scenery import textures
from simgrab.world.scenery.meshes.part import Material, Part

HALF_WIDTH_M = 80.0
THICKNESS_M = 1.0
PHOTOGRAPH = "photograph"  # material of what shows one


def plain(*, head_height: float) -> list[Part]:
    """Build the yard: one concrete slab, its top ``head_height`` metres below the rope exit."""
    concrete = Material("yard", texture=textures.load("concrete"), tile_m=8.0, specular=0.05, shades=False)
    return [Part("yard", slab(head_height), concrete)]


def photo(*, head_height: float) -> list[Part]:
    """Build the ground that a photograph takes the place of."""
    return [Part("photograph", slab(head_height), Material(PHOTOGRAPH, specular=0.0, shades=False))]


def slab(head_height: float) -> trimesh.Trimesh:
    """Give level ground, its top ``head_height`` metres below the rope exit."""
    ground = trimesh.creation.box((2 * HALF_WIDTH_M, 2 * HALF_WIDTH_M, THICKNESS_M))
    ground.apply_translation((0.0, 0.0, -head_height - THICKNESS_M / 2))
    return ground
