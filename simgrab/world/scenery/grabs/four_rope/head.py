"""The grab's head: welded frame, sheaves, rope sockets and the closing ropes' roller guides. Grab frame."""

from __future__ import annotations

import numpy as np
import shapely
import trimesh

from simgrab.world.scenery.grabs.four_rope.linkage import HEAD_PIN
from simgrab.world.scenery.grabs.four_rope.shells import ARM_Y
from simgrab.world.scenery.meshes import shapes
from simgrab.world.scenery.meshes.paint import Finish
from simgrab.world.scenery.meshes.part import Part
from simgrab.world.scenery.meshes.shapes import block, circle, disc, hull, join, pin, prism, rod, rounded

ROPE_X, ROPE_Y = 0.20, 0.50  # half the spread of the four ropes
TERMINATION_Z = 1.64
TOP_Z = 1.70
SHEAVE_RADIUS = 0.20  # pitch radius: the falls run at x = ±ROPE_X
SHEAVE_Z = 1.06
SHEAVE_Y = (ROPE_Y - 0.055, ROPE_Y + 0.055)

_DECK_Z = 1.30
_GIRDER_X = 0.40
_GIRDER_Z = (0.92, 1.28)
_HALF_Y = 1.06


def head_parts(look: Finish) -> list[Part]:
    """Return the head's parts in the grab frame."""
    return [
        Part("frame", _frame(), look.body),
        Part("deck", _deck(), look.body),
        Part("rope_beams", _rope_beams(), look.body),
        Part("fascia", _fascia(), look.hazard),
        Part("arm_lugs", _arm_lugs(), look.body),
        Part("fittings", join([_steps(), _eyes(), _guards()]), look.body),
        Part("sheaves", _sheaves(), look.dark),
        Part("sockets", join([_socket(ROPE_X, ROPE_Y), _socket(-ROPE_X, -ROPE_Y)]), look.dark),
        Part("guide_frames", join([_guide_frame(-ROPE_X, ROPE_Y), _guide_frame(ROPE_X, -ROPE_Y)]), look.body),
        Part("rollers", join([_rollers(-ROPE_X, ROPE_Y), _rollers(ROPE_X, -ROPE_Y)]), look.dark),
        Part("pins", _pins(), look.dark),
        *_plates(look),
    ]


def _frame() -> trimesh.Trimesh:
    """Return two flanged girders along y, cross girders at their ends and beside the sheaves."""
    z = sum(_GIRDER_Z) / 2
    height = _GIRDER_Z[1] - _GIRDER_Z[0]
    girder = shapes.i_section(height, 0.17, 0.03, 0.03)
    cross = shapes.i_section(height - 0.064, 0.14, 0.025, 0.025)
    along = [shapes.profile(girder, (x, -_HALF_Y + 0.02, z), (x, _HALF_Y - 0.02, z)) for x in (-_GIRDER_X, _GIRDER_X)]
    across = [
        shapes.profile(cross, (-_GIRDER_X, y, z), (_GIRDER_X, y, z)) for y in (-0.95, -0.70, -0.30, 0.30, 0.70, 0.95)
    ]
    web = prism(
        shapely.box(_GIRDER_X + 0.01, _GIRDER_Z[0] + 0.028, _GIRDER_X + 0.083, _GIRDER_Z[1] - 0.028), -0.008, 0.008
    )
    webs = [shapes.at_y(web, -0.72, -0.36, 0.0, 0.36, 0.72)]
    return join([*along, *across, *webs, *(shapes.half_turn(w) for w in webs)])


def _deck() -> trimesh.Trimesh:
    """Return the deck plate: open over the sheaves and the middle, corners cut, with a kerb."""
    outline = rounded(shapely.box(-0.50, -_HALF_Y, 0.50, _HALF_Y).intersection(_octagon(0.50, _HALF_Y, 0.14)), 0.02)
    openings = [rounded(shapely.box(-0.30, y - 0.14, 0.30, y + 0.14), 0.03) for y in (-ROPE_Y, ROPE_Y)]
    openings.append(rounded(shapely.box(-0.29, -0.245, 0.29, 0.245), 0.05))
    plate = outline.difference(shapely.union_all(openings))
    kerb = outline.difference(outline.buffer(-0.03))
    return join([prism(plate, _DECK_Z - 0.021, _DECK_Z, "z"), prism(kerb, _DECK_Z - 0.002, _DECK_Z + 0.05, "z")])


def _plates(look: Finish) -> list[Part]:
    """Return the number plates on the deck's ends, each read from its own end."""
    mesh = block((-0.21, 0.74, _DECK_Z - 0.002), (0.21, 0.90, _DECK_Z + 0.010), 0.002)
    p = np.asarray(mesh.vertices)
    plate = Part("plate", mesh, look.plate, np.stack([0.5 - p[:, 0] / 0.42, (0.90 - p[:, 1]) / 0.16], axis=1))
    return [plate, plate.moved(np.diag([-1.0, -1.0, 1.0, 1.0]), "plate_inner")]


def _octagon(half_x: float, half_y: float, cut: float) -> shapely.Polygon:
    corners = [(half_x, half_y - cut), (half_x - cut, half_y)]
    return hull(shapely.MultiPoint([(sx * x, sy * y) for x, y in corners for sx in (-1, 1) for sy in (-1, 1)]))


def _rope_beams() -> trimesh.Trimesh:
    """Return the two upstand plates per rope pair that carry the sockets' pins and the roller guides."""
    outline = rounded(
        shapely.Polygon([(-0.44, 1.28), (0.44, 1.28), (0.42, 1.36), (0.30, 1.46), (-0.30, 1.46), (-0.42, 1.36)]), 0.02
    )
    plate = prism(outline, -0.014, 0.014)
    flange = block((-0.43, -0.05, 1.285), (0.43, 0.05, 1.305))
    ends = block((-0.30, -0.11, 1.31), (-0.275, 0.11, 1.44))
    one = join(
        [
            *(plate.copy().apply_translation((0, o, 0)) for o in (-0.115, 0.115)),
            *(flange.copy().apply_translation((0, o, 0)) for o in (-0.14, 0.14)),
            ends,
            shapes.half_turn(ends),
        ]
    )
    return shapes.at_y(one, -ROPE_Y, ROPE_Y)


def _fascia() -> trimesh.Trimesh:
    """Return the striped warning plates on the head's ends and along its sides."""
    end = block((-0.33, _HALF_Y - 0.03, 0.98), (0.33, _HALF_Y - 0.012, 1.27), 0.004)
    side = block((_GIRDER_X + 0.084, -0.60, 1.06), (_GIRDER_X + 0.096, 0.60, 1.24), 0.003)
    band = block((-0.30, _HALF_Y - 0.115, _DECK_Z - 0.002), (0.30, _HALF_Y - 0.035, _DECK_Z + 0.010), 0.002)
    one = join([end, side, band])
    return join([one, shapes.half_turn(one)])


def _arm_lugs() -> trimesh.Trimesh:
    x, z = HEAD_PIN
    foot = shapely.box(_GIRDER_X - 0.02, 0.93, _GIRDER_X + 0.06, 1.27)
    lug = join([prism(hull(circle(x, z, 0.10), foot), -0.016, 0.016), pin(x, z, -0.023, 0.023, 0.072)])
    outer = shapes.at_y(lug, *(s * ARM_Y + o for s in (-1, 1) for o in (-0.09, 0.09)))
    return join([outer, shapes.half_turn(outer)])


def _pins() -> trimesh.Trimesh:
    x, z = HEAD_PIN
    arm = shapes.at_y(pin(x, z, -0.118, 0.118, 0.035, 0.018), -ARM_Y, ARM_Y)
    shaft = shapes.at_y(pin(0.0, SHEAVE_Z, -0.19, 0.19, 0.045, 0.02), -ROPE_Y, ROPE_Y)
    return join([arm, shapes.half_turn(arm), shaft])


def _sheaves() -> trimesh.Trimesh:
    return join(shapes.sheave((0.0, s * y, SHEAVE_Z), SHEAVE_RADIUS, 0.018) for s in (-1, 1) for y in SHEAVE_Y)


def _guards() -> trimesh.Trimesh:
    """Return the sheaves' bearing plates and the bars that keep the ropes in their grooves."""
    bearing = rounded(hull(circle(0.0, SHEAVE_Z, 0.11), shapely.box(-0.34, 1.18, 0.34, 1.27)), 0.02)
    plates = [prism(bearing, o - 0.01, o + 0.01) for o in (-0.15, 0.15)]
    bars = [rod((x, -0.15, 1.19), (x, 0.15, 1.19), 0.012, 8) for x in (-0.28, 0.28)]
    return shapes.at_y(join([*plates, *bars]), -ROPE_Y, ROPE_Y)


def _socket(x: float, y: float) -> trimesh.Trimesh:
    """Return a rope socket standing on its pin: fork, cone and collar, pulled straight up."""
    cone = [(0.004, 1.54), (0.058, 1.54), (0.062, 1.56), (0.040, 1.68), (0.030, TOP_Z), (0.004, TOP_Z)]
    body = trimesh.creation.revolve(np.array([*cone, cone[0]]), sections=12)
    body.apply_translation((x, y, 0.0))
    cheek = hull(circle(x, 1.41, 0.052), shapely.box(x - 0.045, 1.53, x + 0.045, 1.56))
    fork = [prism(cheek, y + o - 0.013, y + o + 0.013) for o in (-0.043, 0.043)]
    link = prism(hull(circle(x, 1.41, 0.055), shapely.box(x - 0.07, 1.30, x + 0.07, 1.32)), y - 0.027, y + 0.027)
    return join([body, *fork, link, pin(x, 1.41, y - 0.135, y + 0.135, 0.026, 0.012)])


def _guide_frame(x: float, y: float) -> trimesh.Trimesh:
    """Return the cage that holds four rollers round a closing rope, with a funnel on top."""
    plates = [block((x - 0.12, y + o - 0.008, 1.42), (x + 0.12, y + o + 0.008, 1.60), 0.003) for o in (-0.10, 0.10)]
    ends = [block((x + o - 0.008, y - 0.10, 1.42), (x + o + 0.008, y + 0.10, 1.60), 0.003) for o in (-0.112, 0.112)]
    funnel = [(0.045, 1.585), (0.115, 1.62), (0.125, 1.66), (0.118, 1.662), (0.108, 1.63), (0.035, 1.598)]
    mouth = trimesh.creation.revolve(np.array([*funnel, funnel[0]]), sections=16)
    shapes.outward(mouth)
    mouth.apply_translation((x, y, 0.0))
    return join([*plates, *ends, mouth])


def _rollers(x: float, y: float) -> trimesh.Trimesh:
    waist = [(0.010, -0.09), (0.036, -0.09), (0.026, 0.0), (0.036, 0.09), (0.010, 0.09)]
    along = [disc(waist, (x + o, y, 1.46), 10) for o in (-0.05, 0.05)]
    across = [
        shapes.quarter_turn(disc(waist, (0.0, -x, 0.0), 10)).apply_translation((0, y + o, 1.54)) for o in (-0.05, 0.05)
    ]
    return join([*along, *across])


def _steps() -> trimesh.Trimesh:
    """Return rungs up one end, and a hand rail hoop on either end of the deck."""
    rungs = [rod((-0.15, _HALF_Y + 0.055, z), (0.15, _HALF_Y + 0.055, z), 0.011, 8) for z in (1.02, 1.14)]
    legs = [rod((x, _HALF_Y - 0.02, z), (x, _HALF_Y + 0.055, z), 0.011, 8) for z in (1.02, 1.14) for x in (-0.15, 0.15)]
    hoop = [
        rod((-0.22, 0.93, 1.30), (-0.22, 0.93, 1.44), 0.014, 8),
        rod((0.22, 0.93, 1.30), (0.22, 0.93, 1.44), 0.014, 8),
        rod((-0.22, 0.93, 1.44), (0.22, 0.93, 1.44), 0.014, 8),
    ]
    one = join([*rungs, *legs, *hoop])
    return join([one, shapes.half_turn(one)])


def _eyes() -> trimesh.Trimesh:
    """Return four lifting eyes on the deck's corners."""
    lug = circle(0.0, 1.375, 0.05).union(shapely.box(-0.05, 1.29, 0.05, 1.375)).difference(circle(0.0, 1.375, 0.024))
    eye = prism(lug, -0.012, 0.012)
    return join(eye.copy().apply_translation((x, y, 0.0)) for x in (-0.36, 0.36) for y in (-0.84, 0.84))
