"""Deck fittings of a bulk carrier: hatch covers, bitts, pipes, winches, ventilators.

Each is made once, and the same mesh returned ever after: copy it before changing it.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import trimesh

from simgrab.world.scenery.places.clutter import turned
from simgrab.world.scenery.places.shapes import across, bar, box, join, loft, placed, plates, rectangle


@cache
def cover(length: float, width: float) -> trimesh.Trimesh:
    """One hatch-cover panel lying flat about the origin, top at z = 0.85: edge skirt, lifting eyes, wheels."""
    top = [rectangle(length - by, width - by, z) for by, z in ((0.06, 0.0), (0.0, 0.06), (0.0, 0.72), (0.10, 0.80))]
    half, places = width / 2, np.arange(-length / 2 + 0.7, length / 2, 1.6)
    skirt = [box((x - 0.03, s * half, 0.05), (x + 0.03, s * (half + 0.10), 0.74)) for x in places for s in (-1, 1)]
    eye = turned([(0.16, 0.78), (0.14, 0.90), (0.07, 0.93)], sides=10)
    eyes = [placed(eye, x, y) for x in (-0.3 * length, 0.3 * length) for y in (-0.3 * width, 0.3 * width)]
    wheels = [
        bar((x, s * (half - 0.02), 0.18), (x, s * (half + 0.20), 0.18), 0.18, sides=12)
        for x in (-0.42 * length, 0.42 * length)
        for s in (-1, 1)
    ]
    return join([loft([*top, rectangle(0.6 * length, 0.5 * width, 0.85)]), *skirt, *eyes, *wheels])


@cache
def folded(width: float) -> trimesh.Trimesh:
    """Stand a pair of folding panels on edge: x across the fold, y along the hinge, 4.6 m high, foot at z = 0."""
    solids = []
    for x, lean in ((-0.55, 0.18), (0.55, -0.18)):
        panel = [(x - 0.30, 0.0), (x + 0.30, 0.0), (x + 0.30 + lean, 4.6), (x - 0.30 + lean, 4.6)]
        solids.append(across(panel, -width / 2, width / 2))
        foot = x + (0.33 if x > 0 else -0.33)
        rib = [(foot - 0.09, 0.1), (foot + 0.09, 0.1), (foot + lean + 0.09, 4.5), (foot + lean - 0.09, 4.5)]
        solids += plates(rib, np.arange(-width / 2 + 0.5, width / 2, 1.25), 0.02)
    solids += [bar((-0.45, y, 4.55), (0.45, y, 4.55), 0.10) for y in np.linspace(-0.4 * width, 0.4 * width, 4)]
    return join(solids)


@cache
def bitts() -> trimesh.Trimesh:
    """Double mooring bitts on a bed plate, 1.6 m long along x."""
    post = [(0.24, -0.02), (0.24, 0.08), (0.19, 0.12), (0.19, 0.70), (0.25, 0.74), (0.25, 0.80), (0.20, 0.83)]
    bed = box((-0.85, -0.32, -0.02), (0.85, 0.32, 0.06))
    return join([bed, *(placed(turned(post), x, 0) for x in (-0.5, 0.5))])


@cache
def ventilator() -> trimesh.Trimesh:
    """Mushroom ventilator, 1.3 m."""
    low, high = [(0.30, -0.02), (0.30, 0.06), (0.22, 0.10), (0.22, 0.95)], [(0.46, 0.98), (0.50, 1.08), (0.40, 1.22)]
    return turned([*low, *high, (0.15, 1.30)], sides=18)


@cache
def manhole() -> trimesh.Trimesh:
    """Make a raised oval access cover with its nuts."""
    angle = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    ring = [
        np.stack([r * 0.40 * np.cos(angle), r * 0.28 * np.sin(angle), np.full(20, z)], 1)
        for z, r in ((-0.02, 1.1), (0.10, 1.1), (0.105, 1.0), (0.14, 1.0))
    ]
    nuts = [
        bar((0.36 * np.cos(a), 0.24 * np.sin(a), 0.1), (0.36 * np.cos(a), 0.24 * np.sin(a), 0.17), 0.02, sides=6)
        for a in angle[::2]
    ]
    return join([loft(ring), *nuts])


@cache
def access_hatch() -> trimesh.Trimesh:
    """Hold access hatch: a small coaming with a domed lid and hinge, 1 m square."""
    lid = loft([rectangle(1.04, 1.04, 0.80), rectangle(1.08, 1.08, 0.90), rectangle(0.7, 0.7, 0.96)])
    return join([box((-0.45, -0.45, -0.02), (0.45, 0.45, 0.82)), lid, bar((-0.5, 0.55, 0.85), (0.5, 0.55, 0.85), 0.05)])


@cache
def winch() -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """Mooring winch along x, 3.4 m, and the rope on its drum."""
    frame = [box((x - 0.06, -0.55, -0.02), (x + 0.06, 0.55, 0.75)) for x in (-1.5, -0.2, 1.0)]
    frame += [bar((x, 0, 0.75), (x + 0.06, 0, 0.75), 0.62, sides=20) for x in (-1.35, -0.38, -0.08, 0.82)]
    frame += [bar((-1.9, 0, 0.75), (1.3, 0, 0.75), 0.09), bar((-1.95, 0, 0.75), (-1.6, 0, 0.75), 0.24, sides=14)]
    frame += [box((1.06, -0.4, 0.1), (1.6, 0.4, 1.1)), bar((1.3, 0.3, 0.5), (1.3, 1.0, 0.5), 0.22, sides=12)]
    frame.append(box((-1.75, -0.7, -0.02), (1.7, 0.75, 0.10)))
    wound = (
        [(0.46, -1.27), (0.50, -1.1), (0.48, -0.8), (0.50, -0.5), (0.46, -0.40)],
        [(0.40, 0.0), (0.43, 0.3), (0.40, 0.82)],
    )
    rope = [placed(turned(outline, lying=True), 0, 0, 0.75) for outline in wound]
    return join(frame), join(rope)


@cache
def pipes(x0: float, x1: float, y: float) -> trimesh.Trimesh:
    """Three pipes along the deck from x0 to x1, with flanges and supports."""
    solids = []
    for offset, radius in ((-0.25, 0.08), (0.0, 0.11), (0.28, 0.06)):
        solids.append(bar((x0, y + offset, 0.38), (x1, y + offset, 0.38), radius, sides=10))
        for x in np.arange(x0 + 2, x1, 6.0):
            solids.append(bar((x - 0.03, y + offset, 0.38), (x + 0.03, y + offset, 0.38), radius * 1.7, sides=12))
    for x in np.arange(x0 + 0.5, x1, 3.0):
        solids.append(box((x - 0.04, y - 0.42, 0.22), (x + 0.04, y + 0.42, 0.29)))
        solids += [box((x - 0.04, y + s - 0.04, -0.02), (x + 0.04, y + s + 0.04, 0.25)) for s in (-0.38, 0.38)]
    return join(solids)
