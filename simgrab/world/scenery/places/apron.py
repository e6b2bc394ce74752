"""The quay apron: slabs, joints, lanes, rails, the edge with its kerb and wall.

Quay frame: x along the edge, y landward, z up from the quay surface; the vertical through the jib head is its origin.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
import trimesh

from simgrab.world.scenery.meshes.part import Material, Paint, Part
from simgrab.world.scenery.places import materials
from simgrab.world.scenery.places.canvas import Canvas, Picture, noise, shrunk, toned
from simgrab.world.scenery.places.shapes import bar, box, join, ladder, loft, outline, placed, profile, sheet
from simgrab.world.scenery.textures import load

SIZE = 48.0  # side of the painted square, metres
SLAB = 6.0
FAR = 120.0  # the plain apron goes on to here, metres
GROOVE = 0.17  # half width of a rail groove, metres
YELLOW, WHITE = (158, 138, 74), (170, 169, 163)


@dataclass(frozen=True)
class Apron:
    """A painted but unfinished apron."""

    canvas: Canvas
    far: Paint  # paints the apron before anything local was painted
    edge_y: float  # the quay's edge, metres in the quay frame; water lies at smaller y
    rails_y: tuple[float, float]  # crane rails


def slabs(pixels: int, rng: np.random.Generator) -> Paint:
    """Concrete slabs, each cut from another place of the concrete tile with a tone of its own."""
    tile = load("concrete")
    scale = pixels / SIZE * 12.0 / tile.shape[0]
    n = round(SIZE / SLAB)
    cuts = []
    for _ in range(n * n):
        at, turns = rng.integers(0, round(scale * tile.shape[0]), 2), int(rng.integers(4))
        tone = rng.normal(0.97, 0.045) * (0.86 if rng.random() < 0.08 else 1.0)
        cuts.append((at, turns, tone, rng.normal(0, 0.012)))
    uneven = noise(rng, cells=6)

    def paint() -> Picture:
        side = pixels // n
        wrapped = np.tile(shrunk(tile, scale), (2, 2, 1))
        picture = np.empty((pixels, pixels, 3), np.uint8)
        for number, (at, turns, tone, warmth) in enumerate(cuts):
            y, x = at % (wrapped.shape[0] - side)
            piece = np.rot90(wrapped[y : y + side, x : x + side], turns)
            gain = tone * np.array([1 + warmth, 1.0, 1 - warmth])
            row, column = divmod(number, n)
            window = np.s_[row * side : (row + 1) * side, column * side : (column + 1) * side]
            lut = np.clip(np.arange(256)[:, None] * gain, 0, 255).astype(np.uint8)
            picture[window] = cv2.LUT(np.ascontiguousarray(piece), lut[None])
        return toned(picture, uneven, 225, 60, 230)

    return paint


def joints(canvas: Canvas, rng: np.random.Generator) -> None:
    """Paint expansion joints (tar, sand, grass dust) around the slabs and saw cuts through some of them."""
    half = SIZE / 2
    for at in np.arange(-half + SLAB, half, SLAB):
        for along_x in (True, False):
            start, end = ((-half, at), (half, at)) if along_x else ((at, -half), (at, half))
            canvas.stripe(start, end, 0.045, (62, 60, 56), opacity=0.85, wear=0.12)
            side = np.array([0.0, 0.12]) if along_x else np.array([0.12, 0.0])
            a, b = np.array(start), np.array(end)
            canvas.grime([a - side, b - side, b + side, a + side], rng.uniform(0.05, 0.22), blur=0.10)
    for column in np.arange(-half, half, SLAB):
        for row in np.arange(-half, half, SLAB):
            if rng.random() < 0.35:
                cut = column + SLAB / 2
                canvas.stripe((cut, row), (cut, row + SLAB), 0.02, (80, 78, 73), opacity=0.7, wear=0.35)
            if rng.random() < 0.10:  # a patched corner
                w, d = rng.uniform(0.6, 2.2, 2)
                patch = np.array(outline(0, 0, w, d)) + (column, row)
                grey = int(rng.integers(84, 150))
                canvas.paint(patch, (grey, grey, grey - 4), opacity=0.55, wear=0.15)


def apron(edge_y: float, *, pixels: int, wear: float, rng: np.random.Generator) -> Apron:
    """Paint the apron that runs on along the quay: joints, rails' grooves, edge and lane lines, tracks, broad dirt."""
    canvas = Canvas(slabs(pixels, rng), SIZE, pixels, rng=rng)
    joints(canvas, rng)
    half = SIZE / 2
    rails = (edge_y + 2.6, edge_y + 13.1)
    for rail in rails:
        canvas.stripe((-half, rail), (half, rail), 0.9, (108, 104, 97), opacity=0.5, wear=0.1)
        for side in (-0.45, 0.45):
            canvas.stripe((-half, rail + side), (half, rail + side), 0.03, (66, 63, 58), opacity=0.8, wear=0.3)
        canvas.stripe((-half, rail), (half, rail), 2.6 * GROOVE, (58, 51, 45), opacity=0.75, wear=0.12)
        canvas.grime(outline(-half, rail - 0.3, half, rail + 0.3), 0.35, blur=0.2)
    worn = 0.30 + 0.45 * wear
    canvas.stripe((-half, edge_y + 1.35), (half, edge_y + 1.35), 0.15, YELLOW, wear=worn)
    for line in (rails[1] - 1.5, rails[1] + 2.6):
        canvas.stripe((-half, line), (half, line), 0.12, YELLOW, wear=worn)
    for lane in (rails[1] + 6.8, rails[1] + 11.0):
        for start in np.arange(-half, half, 6.0):
            canvas.stripe((start + 1, lane), (start + 4, lane), 0.12, WHITE, wear=worn + 0.08)
    way = np.linspace(-half, half, 25)
    for lane in (rails[0] + 5.0, rails[1] + 4.7, rails[1] + 8.9):
        for _ in range(3):
            drift = rng.normal(0, 0.5) + 0.25 * np.sin(way / 9 + rng.uniform(0, 6))
            canvas.tracks(np.stack([way, lane + drift], 1), 0.30 * (0.5 + wear), width=rng.uniform(0.35, 0.6))
    for _ in range(round(30 + 60 * wear)):
        canvas.blot(rng.uniform(-half + 2, half - 2, 2), rng.uniform(0.06, 0.7), rng.uniform(0.1, 0.5))
    for _ in range(8):
        canvas.blot(rng.uniform(-half + 4, half - 4, 2), rng.uniform(1.0, 3.0), rng.uniform(0.06, 0.2))
    canvas.mottle(0.25 + 0.35 * wear)
    return Apron(canvas, canvas.glance(1024), edge_y, rails)


def ground(apron: Apron, near: Material) -> list[Part]:
    """Sheets with rail grooves, 2 m deep: the finished picture ``near``, the far one around it."""
    half = SIZE / 2
    far = Material("apron far", texture=apron.far, specular=0.0)
    parts = []
    for i, (x0, x1) in enumerate(pairwise([-FAR, -3 * half, -half, half, 3 * half, FAR])):
        for j, (y0, y1) in enumerate(pairwise([apron.edge_y, half, 3 * half, FAR])):
            material = near if (i, j) == (2, 0) else far
            y, z = [y0], [0.0]
            for rail in apron.rails_y:
                if y0 < rail < y1:
                    y += [rail - GROOVE, rail - GROOVE + 0.004, rail + GROOVE - 0.004, rail + GROOVE]
                    z += [0.0, -0.07, -0.07, 0.0]
            y.append(y1)
            z.append(0.0)
            mesh = sheet([x0, x1], y, np.broadcast_to(z, (2, len(y))), bottom=-2.0)
            uv = apron.canvas.uv(mesh.vertices)
            parts.append(Part(f"apron {i}{j}", mesh, material, uv))
    return parts


def edge(apron: Apron, water_z: float, first: float) -> list[Part]:
    """Rails, kerb, quay wall, fenders, bollards and ladders.

    Parameters
    ----------
    water_z : float
        Water level in the quay frame, metres.
    first : float
        x of one fender, metres; the others follow every 8 m. Bollards stand at first + 4 m and then every 16 m.
    """
    y = apron.edge_y
    concrete = Material("wall concrete", rgba=(0.86, 0.85, 0.82, 1), texture=load("concrete"), tile_m=7.0, specular=0.0)
    rail, head = [], []
    for r in apron.rails_y:
        rail.append(box((-FAR, r - 0.06, -0.09), (FAR, r + 0.06, -0.006)))
        rail.append(box((-FAR, r - 0.13, -0.10), (FAR, r + 0.13, -0.062)))
        head.append(box((-FAR, r - 0.032, -0.03), (FAR, r + 0.032, 0.002)))
    kerb = [(0, -0.1), (0.34, -0.1), (0.34, 0.22), (0.28, 0.28), (0.06, 0.28), (0, 0.22)]
    kerbs = [profile(kerb, (x + 0.2, y, 0), (x + 7.8, y, 0)) for x in first + 8.0 * np.arange(-15, 15)]
    coping = box((-FAR, y - 0.06, -1.2), (FAR, y + 0.10, -0.004))
    wall = box((-FAR, y - 0.001, water_z - 3), (FAR, y + 1.5, -1.1))
    parts = [
        Part("crane rails", join(rail), materials.rusty("rail rust")),
        Part("rail heads", join(head), materials.plain("rail head", (0.52, 0.51, 0.50), specular=0.5)),
        Part("kerb", join(kerbs), materials.painted("kerb paint", (0.45, 0.40, 0.23), texture="concrete", tile_m=4.0)),
        Part("quay wall", join([coping, wall]), concrete),
    ]
    tyres, panels, posts, rungs = [], [], [], []
    for x in first + 8.0 * np.arange(-9, 10):
        panels.append(box((x - 0.7, y - 0.75, water_z + 0.2), (x + 0.7, y - 0.5, -0.35)))
        tyres += [bar((x, y - 0.52, z), (x, y + 0.02, z), 0.42, sides=14) for z in (water_z + 0.9, -0.95)]
        if round((x - first) / 8) % 2 == 0:
            posts.append(placed(bollard(), x + 4, y + 1.0))
        if round((x - first) / 8) % 5 == 1:
            rungs.append(ladder((x + 3, y - 0.16, water_z - 1), (x + 3, y - 0.16, -0.02)))
            rungs += [
                bar((x + 3 + s, y - 0.16, -0.4), (x + 3 + s, y + 0.02, -0.4), 0.02, sides=5) for s in (-0.22, 0.22)
            ]
    return [
        *parts,
        Part("fender rubber", join(tyres), materials.RUBBER),
        Part("fender panels", join(panels), materials.plain("fender panel", (0.13, 0.14, 0.15))),
        Part("bollards", join(posts), materials.painted("bollard paint", (0.36, 0.30, 0.16), tile_m=2.0)),
        Part("quay ladders", join(rungs), materials.SAFETY_YELLOW),
    ]


def bollard() -> trimesh.Trimesh:
    """Return a T-head mooring bollard on its base plate, 0.65 m high, foot at the origin."""
    base = bar((0, 0, -0.05), (0, 0, 0.05), 0.42, sides=16)
    ring = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    rings = [
        np.stack([rx * np.cos(ring) + lean, ry * np.sin(ring), np.full(16, z)], 1)
        for z, rx, ry, lean in (
            (0.0, 0.30, 0.30, 0), (0.08, 0.22, 0.22, 0), (0.36, 0.20, 0.20, 0), (0.46, 0.30, 0.42, -0.04),
            (0.56, 0.34, 0.50, -0.06), (0.63, 0.26, 0.42, -0.06), (0.65, 0.10, 0.24, -0.06)
        )
    ]  # fmt: skip
    return join([base, loft(rings)])
