"""Level ground that shows a photograph: where the renderer draws it, the picture is the photograph's."""

from __future__ import annotations

import trimesh

from simgrab.world.scenery.meshes.part import Material, Part
from simgrab.world.scenery.places.plain import HALF_WIDTH_M, THICKNESS_M

MATERIAL = "photograph"


def photo(*, head_height: float) -> list[Part]:
    """Build the ground, of the same shape as `simgrab.world.scenery.places.plain.plain`."""
    slab = trimesh.creation.box((2 * HALF_WIDTH_M, 2 * HALF_WIDTH_M, THICKNESS_M))
    slab.apply_translation((0.0, 0.0, -head_height - THICKNESS_M / 2))
    return [Part("photograph", slab, Material(MATERIAL, specular=0.0))]
