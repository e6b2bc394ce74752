"""A bulk carrier from above: hull, deck, hatch coamings, covers and fittings.

Ship frame: x along the ship, y across, z up from the deck; the origin is the middle of one hatch.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from itertools import pairwise

import cv2
import numpy as np
import shapely
import trimesh

from simgrab.world.scenery.meshes.part import Material, Part
from simgrab.world.scenery.places import fittings, materials
from simgrab.world.scenery.places.canvas import Canvas, Picture, Plane, cloud, noise, shrunk, tiled, toned
from simgrab.world.scenery.places.heap import Cargo
from simgrab.world.scenery.places.shapes import across, box, join, placed, prism, railing
from simgrab.world.scenery.textures import load

SIZE = 48.0  # side of the painted square of deck, metres
FAR = 100.0
_CUTS = (-FAR, -72.0, -24.0, 24.0, 72.0, FAR)  # between plates, along x
HATCH = (20.0, 15.4)  # clear opening, metres
PITCH = 29.0  # from hatch to hatch
HALF_BEAM = 16.0
COAMING = 1.45
DECKS = ((0.32, 0.21, 0.17), (0.22, 0.27, 0.22), (0.28, 0.205, 0.175))
HULLS = ((0.17, 0.18, 0.19), (0.17, 0.22, 0.28), (0.36, 0.20, 0.17), (0.20, 0.27, 0.24))


@dataclass(frozen=True)
class Looks:
    """Colours of one ship: deck, hull and fittings."""

    deck: materials.Rgb
    hull: materials.Rgb
    fittings: materials.Rgb


def looks(rng: np.random.Generator) -> Looks:
    """Draw a ship's colours."""
    buff = ((0.50, 0.46, 0.36), (0.55, 0.54, 0.50), (0.36, 0.36, 0.35))
    return Looks(DECKS[rng.integers(len(DECKS))], HULLS[rng.integers(len(HULLS))], buff[rng.integers(len(buff))])


def ring(grow: float, hatch: tuple[float, float] = HATCH) -> shapely.Polygon:
    """Outline of the hatch with rounded corners, ``grow`` metres outside its clear opening."""
    corner = 0.9
    core = shapely.box(-hatch[0] / 2 + corner, -hatch[1] / 2 + corner, hatch[0] / 2 - corner, hatch[1] / 2 - corner)
    return core.buffer(corner + grow, quad_segs=5)


def deck(
    style: Looks, cargo: Cargo | None, *, is_open: bool, wear: float, rng: np.random.Generator, pixels: int = 3072
) -> list[Part]:
    """Deck plates with dirt and spilt cargo; the hatch at the origin is cut out where it is open."""
    tile = load("deck")
    scale = pixels / SIZE * 8.0 / tile.shape[0]
    tint = np.array(style.deck) / 0.68
    uneven = noise(rng, cells=8, octaves=4)

    def base() -> Picture:
        small = (shrunk(tile, scale) * tint).astype(np.uint8)
        return toned(tiled(small, pixels, pixels), uneven, 215, 70, 220)

    canvas = Canvas(base, SIZE, pixels, rng=rng)
    for centre in (-PITCH, 0.0, PITCH):
        foot = np.array(ring(0.5).exterior.coords) + (centre, 0)
        canvas.grime(foot, 0.9, blur=0.35)
    for _ in range(round(25 + 50 * wear)):
        at = rng.uniform((-23, -HALF_BEAM), (23, HALF_BEAM))
        canvas.blot(at, rng.uniform(0.1, 0.9), rng.uniform(0.2, 0.7))
    for x in np.arange(-22, 22, 2.2):  # scuppers and fittings weep along the ship's sides
        for s in (-1, 1):
            canvas.blot((x + rng.normal(0, 0.5), s * (HALF_BEAM - 0.2)), 0.5, rng.uniform(0, 0.6))
    canvas.mottle(0.5 * wear + 0.2)
    for s in (-1, 1):  # a painted walkway
        for edge in (11.2, 12.2):
            canvas.stripe((-24, s * edge), (24, s * edge), 0.08, (150, 142, 110), wear=0.35 + 0.4 * wear)
    if cargo is not None and is_open:
        _scatter(canvas, wear, rng)
    plating = Material("deck plating", texture=canvas.finish(cargo), specular=0.03)
    parts = []
    for i, (x0, x1) in enumerate(pairwise(_CUTS)):
        plate = shapely.box(x0, -HALF_BEAM, x1, HALF_BEAM)
        if is_open and i == 2:
            plate = plate.difference(ring(0.0))
        mesh = prism(plate, -0.04, 0.0)
        parts.append(Part(f"deck {i}", mesh, plating, canvas.uv(mesh.vertices)))
    return parts


def _scatter(canvas: Canvas, wear: float, rng: np.random.Generator) -> None:
    """Cargo dropped from the grab, mostly beside the hatch on the side it passes."""
    n = 384
    y, x = np.meshgrid(np.linspace(24, -24, n), np.linspace(-24, 24, n), indexing="ij")
    beyond = np.maximum(np.maximum(np.abs(x) - HATCH[0] / 2, np.abs(y) - HATCH[1] / 2), 0)
    patchy = cloud((n, n), noise(rng, cells=12, octaves=4))
    towards = 0.55 + 0.45 * np.tanh(y / 4)
    cover = np.exp(-beyond / 2.2) * towards * np.clip((patchy - 0.42) * 3.2, 0, 1) * (0.4 + 0.7 * wear)
    cover[np.abs(y) > HALF_BEAM] = 0
    canvas.spill(cover, (-24, -24), (24, 24))


@cache
def coaming(*, is_open: bool) -> trimesh.Trimesh:
    """Hatch coaming about the origin with flange, stiffener and brackets; an open one reaches below the deck.

    It is made once, and the same mesh returned ever after: copy it before changing it.
    """
    foot = -1.3 if is_open else -0.02
    solids = [
        prism(ring(0.03).difference(ring(0.0)), foot, COAMING),
        prism(ring(0.38).difference(ring(0.03)), COAMING - 0.03, COAMING),
        prism(ring(0.16).difference(ring(0.03)), 0.70, 0.73),
        prism(ring(0.22).difference(ring(0.17)), COAMING - 0.001, COAMING + 0.07),
    ]
    line = ring(0.03).exterior
    top = COAMING - 0.04
    bracket = [(0.0, -0.02), (0.52, -0.02), (0.52, 0.04), (0.14, COAMING - 0.35), (0.32, top), (0.0, top)]
    plate = across(bracket, -0.009, 0.009)
    for at in np.arange(0.4, line.length, 1.05):
        p, q = (np.array(line.interpolate(at + d).coords[0]) for d in (-0.05, 0.05))
        along = (q - p) / np.linalg.norm(q - p)
        x, y = (p + q) / 2
        solids.append(placed(plate, x, y, yaw=np.arctan2(along[0], -along[1])))  # outwards: the ring runs clockwise
    return join(solids)


def topsides(style: Looks, *, is_open: bool, rng: np.random.Generator) -> list[Part]:
    """Coamings, covers, pipes, bitts, winches, ventilators and rails on the deck."""
    covers = []
    panel = fittings.cover(HATCH[0] + 0.6, HATCH[1] / 2 + 0.28)
    for x in (-PITCH, PITCH) if is_open else (-PITCH, 0.0, PITCH):
        for s in (-1, 1):
            covers.append(placed(panel, x, s * (HATCH[1] / 4 + 0.15), COAMING + 0.05))
    stand = HATCH[0] / 2 + 1.75
    if is_open:
        covers += [placed(fittings.folded(HATCH[1] + 0.5), s * stand, 0, 0.0) for s in (-1, 1)]
    closed = coaming(is_open=False)
    middle = coaming(is_open=True) if is_open else closed
    coamings = join([placed(closed, -PITCH, 0), middle, placed(closed, PITCH, 0)])
    frames, coils = [], []
    for s in (-1, 1):
        frame, coil = fittings.winch()
        at = (s * PITCH / 2 + 0.2, rng.uniform(10.0, 10.3) * float(rng.choice([-1, 1])))
        frames.append(placed(frame, *at, yaw=np.pi / 2))
        coils.append(placed(coil, *at, yaw=np.pi / 2))
    small = []
    for x in (-22.0, -18.2, -8.5, -3.0, 5.5, 9.5, 18.4, 22.0):
        for s in (-1, 1):
            kind = (fittings.bitts, fittings.ventilator, fittings.manhole, fittings.access_hatch)[int(rng.integers(4))]
            y = {"bitts": 14.0, "ventilator": 14.7, "manhole": 10.2, "access_hatch": 9.9}[kind.__name__]
            small.append(placed(kind(), x + rng.uniform(-0.8, 0.8), s * y))
    rails = [railing([(-40, s * (HALF_BEAM - 0.15), 0), (40, s * (HALF_BEAM - 0.15), 0)], spacing=1.6) for s in (-1, 1)]
    lines = [fittings.pipes(-45, 45, s * 12.75) for s in (-1, 1)]
    deck, dull = style.deck, materials.dull
    steel = materials.painted("coaming paint", dull(deck, 0.9), tile_m=8.0, texture="hullplate", fine=True)
    cover = materials.painted("cover paint", dull(deck, 0.85), tile_m=7.0, fine=True)
    pipe = materials.painted("pipe paint", dull(style.fittings, 0.8), tile_m=4.0)
    body = materials.painted("ship fittings", style.fittings, tile_m=5.0)
    return [
        Part("coamings", coamings, steel),
        Part("hatch covers", join(covers), cover),
        Part("deck pipes", join(lines), pipe),
        Part("deck fittings", join([*small, *frames]), body),
        Part("winch rope", join(coils), materials.plain("mooring rope", (0.42, 0.40, 0.33), specular=0.0)),
        Part("deck rails", join(rails), materials.plain("deck rail", (0.52, 0.51, 0.47))),
    ]


def hull(style: Looks, waterline: float, *, rng: np.random.Generator) -> list[Part]:
    """Ship's sides from the deck's edge down to 2 m under water; ``waterline`` is the water's z in the ship frame."""
    foot = waterline - 2.0
    patchy, scrape = noise(rng, cells=40, octaves=3), rng.random((160, 12), dtype=np.float32)
    side = cache(partial(_side_picture, style, foot, waterline, patchy, scrape))
    skin = Material("hull side", texture=side, specular=0.06)
    parts = []
    for s in (-1, 1):
        for i, (x0, x1) in enumerate(pairwise(_CUTS)):
            mesh = box((x0, s * HALF_BEAM, foot), (x1, s * (HALF_BEAM + 0.03), 0.22))
            share = mesh.vertices[:, 0] / SIZE + 0.5
            across_v = (mesh.vertices[:, 2] - foot) / (0.22 - foot)
            uv = np.stack([np.abs(share - 2 * np.round(share / 2)), 0.002 + 0.996 * across_v], 1)
            parts.append(Part(f"hull {s + 1}{i}", mesh, skin, uv))
    gunwale = join([box((-FAR, s * (HALF_BEAM - 0.02), 0.19), (FAR, s * (HALF_BEAM + 0.05), 0.23)) for s in (-1, 1)])
    return [*parts, Part("gunwale", gunwale, materials.painted("gunwale paint", style.hull))]


def _side_picture(style: Looks, foot: float, waterline: float, drawn: list[Plane], scrape: Plane) -> Picture:
    """Plates, boot-topping, slime at the waterline, fender scrapes and draught marks; 48 m long, foot to gunwale."""
    height = 0.22 - foot
    rows, columns = 512, 2048
    patchy = cloud((rows, columns), drawn)
    tile = cv2.resize(
        load("hullplate"), (round(columns * 10 / SIZE), round(rows * 10 / height)), interpolation=cv2.INTER_AREA
    )
    plates = tiled(tile, rows, columns).astype(np.float32) / 255
    level = 0.22 - (np.arange(rows) + 0.5) / rows * height - waterline  # metres above the water
    uneven = level[:, None] + 0.25 * (patchy - 0.5)
    red = np.array((0.38, 0.17, 0.14), np.float32)
    paint = np.where((uneven < 1.3)[..., None], red, np.array(style.hull, np.float32)) / 0.68
    picture = np.clip(plates * paint, 0, 1)
    slime = np.clip(1 - np.abs(uneven - 0.05) / 0.35, 0, 1)[..., None] * 0.75
    picture = picture * (1 - slime) + np.array((0.13, 0.14, 0.09), np.float32) * slime
    scrape = cv2.resize(scrape, (columns, rows), interpolation=cv2.INTER_CUBIC)
    scuffed = np.clip((scrape - 0.86) * 4, 0, 0.5)[..., None] * (level > 0.3)[:, None, None]
    picture = (picture * (1 - scuffed) + 0.45 * scuffed) * 255
    marks = np.zeros((rows, columns), np.uint8)
    for draught in range(round(max(0.2, level[-1]) * 5), int(level[0] * 5) - 2, 2):
        row = round((level[0] - draught / 5) / height * rows)
        scale = 0.2 / height * rows / 21
        cv2.putText(
            marks, str(40 + draught), (columns // 2 + 60, row), cv2.FONT_HERSHEY_SIMPLEX, scale, 255, 1, cv2.LINE_AA
        )
    alpha = marks[..., None] / 255 * 0.8
    return np.asarray(picture * (1 - alpha) + 190 * alpha, np.uint8)
