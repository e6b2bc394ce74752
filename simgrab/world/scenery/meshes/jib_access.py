"""Equipment of the jib head: platform, hand rails, camera bracket, floodlights. Jib frame."""

from __future__ import annotations

import numpy as np
import shapely
import trimesh

from simgrab.world.scenery.meshes import shapes
from simgrab.world.scenery.meshes.shapes import block, circle, hull, join, prism, rod

_X = (-1.75, 0.30)
_Y = (0.74, 1.44)
_DECK_Z = 0.13
_LAMP = (0.95, 1.45, -1.18)  # and its mirror image: outside the camera's view unless it is tilted or moved

#: Where the two floodlights shine from, jib frame, metres, shape (2, 3).
FLOODLIGHTS = np.array([_LAMP, (_LAMP[0], -_LAMP[1], _LAMP[2])]) - (0.0, 0.0, 0.06)


def platform_frame() -> trimesh.Trimesh:
    """Return the platform's edge beams, consoles and hand rails; it stands on the +y side."""
    (x0, x1), (y0, y1) = _X, _Y
    z0, z1 = _DECK_Z - 0.06, _DECK_Z + 0.04
    edges = [
        block((x0, y0, z0), (x1, y0 + 0.02, z1)),
        block((x0, y1 - 0.02, z0), (x1, y1, z1 + 0.08)),
        block((x0, y0, z0), (x0 + 0.02, y1, z1)),
        block((x1 - 0.02, y0, z0), (x1, y1, z1 + 0.08)),
    ]
    consoles = [block((x, 0.60, z0), (x + 0.05, y1, z0 + 0.045)) for x in (-1.38, -0.70, -0.35)]
    posts = [(x, y1 - 0.01) for x in np.linspace(x0 + 0.02, x1 - 0.02, 4)] + [(x1 - 0.02, y0 + 0.02)]
    uprights = [rod((x, y, _DECK_Z), (x, y, _DECK_Z + 1.1), 0.021, 8) for x, y in posts]
    rails = []
    for height in (0.55, 1.1):
        z = _DECK_Z + height
        rails.append(rod((x0 + 0.02, y1 - 0.01, z), (x1 - 0.02, y1 - 0.01, z), 0.021, 8))
        rails.append(rod((x1 - 0.02, y0 + 0.02, z), (x1 - 0.02, y1 - 0.01, z), 0.021, 8))
    return join([*edges, *consoles, *uprights, *rails])


def platform_grating() -> trimesh.Trimesh:
    """Return the bearing bars and cross bars of the deck: light falls through."""
    (x0, x1), (y0, y1) = _X, _Y
    bearing = [block((x0, y, _DECK_Z), (x1, y + 0.005, _DECK_Z + 0.03), 0.001) for y in np.arange(y0 + 0.04, y1, 0.04)]
    cross = [
        block((x, y0, _DECK_Z + 0.02), (x + 0.006, y1, _DECK_Z + 0.029), 0.001) for x in np.arange(x0 + 0.1, x1, 0.1)
    ]
    return join([*bearing, *cross])


def bracket() -> trimesh.Trimesh:
    """Return the camera's bracket under the outer cheek plate."""
    plate = block((-0.10, 0.622, 0.10), (0.10, 0.634, 0.42), 0.003)
    shelf = block((-0.09, 0.56, 0.055), (0.09, 0.634, 0.067), 0.003)
    knee = prism(shapely.Polygon([(0.63, 0.06), (0.63, 0.16), (0.575, 0.066)]), -0.006, 0.006, "x")
    return join([plate, shelf, *(knee.copy().apply_translation((x, 0, 0)) for x in (-0.07, 0.07))])


def floodlights() -> trimesh.Trimesh:
    """Return two floodlights: outrigger, drop tube, yoke, and a finned housing that looks down and outwards."""
    x, y, z = _LAMP
    outrigger = rod((-1.30, 0.70, 0.22), (x, y, 0.30), 0.038)
    strut = rod((-0.2, y - 0.02, _DECK_Z + 0.1), (-0.2, y - 0.25, 0.27), 0.02, 8)
    drop = rod((x, y, 0.34), (x, y, z + 0.13), 0.027)
    yoke = prism(hull(circle(x, z + 0.12, 0.05), circle(x, z, 0.03)), y - 0.15, y - 0.14)
    arch = block((x - 0.03, y - 0.15, z + 0.11), (x + 0.03, y + 0.15, z + 0.12), 0.003)
    fins = [
        block((x + o, y - 0.10, z + 0.03), (x + o + 0.006, y + 0.10, z + 0.085), 0.001)
        for o in np.arange(-0.063, 0.07, 0.021)
    ]
    one = join([outrigger, strut, drop, yoke, yoke.copy().apply_translation((0, 0.29, 0)), arch, _housing(), *fins])
    return shapes.mirrored_y(one)


def lenses() -> trimesh.Trimesh:
    """Return the floodlights' glass."""
    x, y, z = _LAMP
    return shapes.mirrored_y(block((x - 0.09, y - 0.122, z - 0.068), (x + 0.09, y + 0.122, z - 0.056), 0.004))


def _housing() -> trimesh.Trimesh:
    """Return a housing that widens downwards."""
    x, y, z = _LAMP
    rings = [(0.07, 0.10, 0.04), (0.10, 0.135, -0.02), (0.10, 0.135, -0.06)]
    return shapes.convex([(x + sx * a, y + sy * b, z + c) for a, b, c in rings for sx in (-1, 1) for sy in (-1, 1)])
