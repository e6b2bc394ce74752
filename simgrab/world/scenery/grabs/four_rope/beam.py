"""The grab's lower sheave beam, in its own frame: origin midway between the shells' pins."""

from __future__ import annotations

import shapely
import trimesh

from simgrab.world.scenery.grabs.four_rope.head import ROPE_Y, SHEAVE_RADIUS
from simgrab.world.scenery.grabs.four_rope.linkage import HINGE_X
from simgrab.world.scenery.meshes import shapes
from simgrab.world.scenery.meshes.paint import Finish
from simgrab.world.scenery.meshes.part import Part
from simgrab.world.scenery.meshes.shapes import block, circle, hull, join, pin, prism, rounded

SHEAVE_Z = 0.16
SHEAVE_Y = (ROPE_Y - 0.11, ROPE_Y, ROPE_Y + 0.11)
_END_Y = 1.09
_WEB_X = 0.285


def beam_parts(look: Finish) -> list[Part]:
    """Return the beam's parts in the beam's frame."""
    return [
        Part("webs", _webs(), look.body),
        Part("roofs", _roofs(), look.body),
        Part("ends", _ends(), look.hazard),
        Part("sheaves", _sheaves(), look.dark),
        Part("shafts", shapes.at_y(pin(0.0, SHEAVE_Z, -0.23, 0.23, 0.05, 0.03), -ROPE_Y, ROPE_Y), look.dark),
    ]


def _webs() -> trimesh.Trimesh:
    """Return flanged side plates, a belly plate, and bearing plates either side of the sheaves."""
    side = rounded(
        shapely.Polygon(
            [
                (-_END_Y, -0.12),
                (-0.85, -0.16),
                (0.85, -0.16),
                (_END_Y, -0.12),
                (_END_Y, 0.14),
                (0.80, 0.20),
                (-0.80, 0.20),
                (-_END_Y, 0.14),
            ]
        ),
        0.02,
    )
    web = prism(side, _WEB_X - 0.012, _WEB_X + 0.012, "x")
    top = block((_WEB_X - 0.012, -0.80, 0.19), (_WEB_X + 0.075, 0.80, 0.21))
    foot = block((_WEB_X - 0.012, -0.86, -0.17), (_WEB_X + 0.06, 0.86, -0.15))
    rib = prism(
        shapely.Polygon([(_WEB_X, -0.152), (_WEB_X + 0.055, -0.152), (_WEB_X + 0.07, 0.192), (_WEB_X, 0.192)]),
        -0.008,
        0.008,
    )
    flank = join([web, top, foot, shapes.at_y(rib, -0.74, -0.25, 0.25, 0.74)])
    belly = block((-_WEB_X, -0.86, -0.165), (_WEB_X, 0.86, -0.145))
    bearing = rounded(hull(circle(0.0, SHEAVE_Z, 0.10), shapely.box(-_WEB_X, -0.15, _WEB_X, 0.08)), 0.01)
    bearings = [
        prism(bearing, s * ROPE_Y + o - 0.011, s * ROPE_Y + o + 0.011) for s in (-1, 1) for o in (-0.185, 0.185)
    ]
    return join([flank, shapes.half_turn(flank), belly, *bearings])


def _roofs() -> trimesh.Trimesh:
    """Return the gabled covers that let cargo slide off: one between the sheave packs, one at either end."""
    gable = shapely.Polygon([(-0.345, 0.205), (0.0, 0.37), (0.345, 0.205), (0.345, 0.185), (-0.345, 0.185)])
    middle = prism(gable, -0.29, 0.29)
    low = shapely.Polygon([(-0.345, 0.205), (0.0, 0.33), (0.345, 0.205), (0.345, 0.185), (-0.345, 0.185)])
    end = prism(low, 0.71, 0.90)
    return join([middle, shapes.mirrored_y(end)])


def _ends() -> trimesh.Trimesh:
    """Return the end plates with the bosses that carry the shells' pins."""
    outline = rounded(
        hull(circle(-HINGE_X, 0.0, 0.125), circle(HINGE_X, 0.0, 0.125), shapely.box(-0.29, -0.1, 0.29, 0.16)), 0.03
    )
    plate = prism(outline, _END_Y - 0.035, _END_Y)
    inner = prism(outline, 0.93, 0.955)
    bosses = [pin(x, 0.0, 0.92, _END_Y + 0.008, 0.09) for x in (-HINGE_X, HINGE_X)]
    return shapes.mirrored_y(join([plate, inner, *bosses]))


def _sheaves() -> trimesh.Trimesh:
    return join(shapes.sheave((0.0, s * y, SHEAVE_Z), SHEAVE_RADIUS, 0.018) for s in (-1, 1) for y in SHEAVE_Y)
