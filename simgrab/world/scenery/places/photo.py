"""Level ground that shows a photograph: where the renderer draws it, the picture is the photograph's."""

from __future__ import annotations

from simgrab.world.scenery.meshes.part import Material, Part
from simgrab.world.scenery.places.plain import slab

MATERIAL = "photograph"


def photo(*, head_height: float) -> list[Part]:
    """Build the ground, of the same shape as `simgrab.world.scenery.places.plain.plain`."""
    return [Part("photograph", slab(head_height), Material(MATERIAL, specular=0.0))]
