"""A bulk carrier's hold seen down through its open hatch, with deck, quay and water around it."""

from __future__ import annotations

from functools import cache, partial

import cv2
import numpy as np
import trimesh

from simgrab.model.scenario import Hold
from simgrab.world.scenery.meshes.part import Material, Part
from simgrab.world.scenery.places import apron, materials, sea, ship
from simgrab.world.scenery.places.canvas import Canvas, Picture, Plane, shrunk, tiled
from simgrab.world.scenery.places.heap import CARGOES, Cargo, Field, cones, dug, roughened, warped
from simgrab.world.scenery.places.shapes import across, bar, box, join, ladder, outline, pose, prism, profile, sheet
from simgrab.world.scenery.textures import load

LENGTH, BREADTH = 26.0, 31.6  # of the hold, metres
SLOPE = (4.6, 4.4)  # lower wing tank: breadth and height, metres
STOOL = (1.3, 2.6)  # lower stool of the bulkheads
SIZE, PIXELS = 33.0, 2560


def hold(place: Hold, *, head_height: float, rng: np.random.Generator) -> list[Part]:
    """Return the ship, its hold and the heap, the quay and the water, in the jib frame."""
    cargo = CARGOES[place.cargo]
    deck_z = rng.uniform(2.6, 4.6)  # above the quay
    depth = place.depth_m + deck_z
    style = ship.looks(rng)
    water_z = -rng.uniform(2.6, 3.6)
    parts = [
        *ship.deck(style, cargo, is_open=True, wear=place.wear, rng=rng),
        *ship.topsides(style, is_open=True, rng=rng),
        *ship.hull(style, water_z - deck_z, rng=rng),
        *_walls(depth, place, rng),
        *_bottom(depth, place, cargo, rng),
    ]
    aside = rng.uniform(-1.2, 1.2)
    along = rng.uniform(-1.5, 1.5)
    placed = [p.moved(pose(along, aside, deck_z)) for p in parts]
    # The quay lies at the ship's side at smaller y, so its frame is turned half round.
    edge_y = ship.HALF_BEAM - aside + 0.95
    quay = apron.apron(edge_y, pixels=2048, wear=place.wear, rng=rng)
    shore = [
        *apron.ground(quay, Material("apron", texture=quay.canvas.finish(), specular=0.0)),
        *apron.edge(quay, water_z, rng.uniform(-3, 3)),
    ]
    placed += [p.moved(pose(0, 0, 0, np.pi)) for p in shore]
    bands = [(-edge_y - 0.5, aside - ship.HALF_BEAM), (aside + ship.HALF_BEAM, sea.FAR)]
    placed += sea.sea(water_z, 0.25, bands, (aside + ship.HALF_BEAM,), rng=rng)
    yaw = rng.normal(0, np.radians(4))
    return [p.moved(pose(0, 0, -head_height, yaw)) for p in placed]


def _shaded(texture: str, tint: tuple[float, float, float], blotch: Plane, *, soiled: float, cargo: Cargo) -> Picture:
    """Plating that goes dark with depth and is dusted by the cargo below the share ``soiled`` of its height."""
    rows, columns = 1024, 1024
    plates = load(texture).astype(np.float32) / 0.68 * np.array(tint, np.float32)
    down = np.linspace(0, 1, rows)[:, None]
    light = 1.15 - 0.35 * down
    dust = np.asarray(load(cargo.texture).reshape(-1, 3).mean(axis=0), np.float32)
    blotch = np.asarray(cv2.resize(blotch, (columns, rows), interpolation=cv2.INTER_CUBIC), np.float32)
    cover = np.clip((down - (1 - soiled)) * 5 + 1.6 * (blotch - 0.5), 0, 1) * 0.65 + 0.15 * blotch
    picture = (plates * (1 - cover[..., None]) + dust * 1.25 * cover[..., None]) * light[..., None]
    return np.asarray(np.clip(picture, 0, 255), np.uint8)


def _walls(depth: float, place: Hold, rng: np.random.Generator) -> list[Part]:
    """Corrugated bulkheads on stools, ship's sides with frames, wing tanks above and below, ladders."""
    half_l, half_b, floor = LENGTH / 2, BREADTH / 2, -depth
    tint = ((0.40, 0.38, 0.35), (0.38, 0.30, 0.26), (0.36, 0.36, 0.33))[int(rng.integers(3))]
    shaded = partial(
        _shaded, "hullplate", tint, rng.random((24, 40), dtype=np.float32), soiled=0.25 + 0.6 * place.fill,
        cargo=CARGOES[place.cargo],
    )  # fmt: skip
    plate = Material("hold plating", texture=cache(shaded), specular=0.02)
    bulkheads, sides, frames = [], [], []
    for s in (-1, 1):
        bulkheads.append(_corrugated(s * half_l, floor + STOOL[1] - 0.02, -0.05))
        out, foot, head = half_l + 0.6, half_l - STOOL[0], half_l - 0.35
        stool = [(out, floor - 0.05), (foot, floor - 0.05), (head, floor + STOOL[1]), (out, floor + STOOL[1])]
        bulkheads.append(across([(s * x, z) for x, z in stool], -half_b, half_b))
        sides.append(box((-half_l, s * half_b, floor), (half_l, s * (half_b + 0.1), -0.06)))
        foot, shell, knuckle = half_b - SLOPE[0], half_b + 0.05, floor + SLOPE[1]
        lower = [(shell, floor), (foot, floor - 0.04), (foot, floor + 0.02), (half_b - 0.02, knuckle), (shell, knuckle)]
        sides.append(_along([(s * y, z) for y, z in lower], half_l - 0.3))
        inner = ship.HATCH[1] / 2 + 0.4
        upper = [(half_b + 0.05, -5.4), (half_b + 0.05, -5.5), (inner, -1.25), (inner, -1.1)]
        sides.append(_along([(s * y, z) for y, z in upper], half_l))
        for x in np.arange(-half_l + 0.8, half_l - 0.5, 0.85):
            web, flange = s * (half_b - 0.38), s * (half_b - 0.36)
            frames.append(box((x - 0.012, s * half_b, knuckle - 0.3), (x + 0.012, web, -5.2)))
            frames.append(box((x - 0.08, flange, knuckle - 0.2), (x + 0.08, web, -5.25)))
    rungs = []
    for s, y in ((-1, 3.2), (1, -4.1)):
        at = s * (half_l - 0.75)
        rungs.append(ladder((at, y, floor + 1.2), (at, y, -0.6), side=(0, 1, 0)))
        for z in np.arange(floor + 3.5, -0.8, 2.4):
            rungs += [bar((at, y + d, z), (s * (half_l + 0.2), y + d, z), 0.02, sides=5) for d in (-0.22, 0.22)]
        rungs.append(box((at - 0.05, y + 0.3, floor + 7.0), (s * (half_l + 0.3), y + 1.4, floor + 7.06)))
    return [
        _hung("bulkheads", join(bulkheads), plate, floor, 1),
        _hung("hold sides", join(sides), plate, floor, 0),
        _hung("side frames", join(frames), plate, floor, 0),
        Part("hold ladders", join(rungs), materials.rusty("ladder rust")),
    ]


def _along(section: list[tuple[float, float]], half: float) -> trimesh.Trimesh:
    """Extrude a cross-section of (y, z) points along the ship."""
    return profile(section, (-half, 0, 0), (half, 0, 0))


def _corrugated(x: float, low: float, high: float) -> trimesh.Trimesh:
    """Vertical corrugations, 1.9 m apart and 0.8 m deep, across the whole hold."""
    pitch, deep = 1.9, 0.8
    line = []
    for i, y in enumerate(np.arange(-BREADTH / 2, BREADTH / 2 + pitch, pitch)):
        out = deep / 2 * (1 if i % 2 else -1)
        line += [(x + out, y - 0.32 * pitch), (x + out, y + 0.32 * pitch)]
    back = [(px + 0.04, py) for px, py in reversed(line)]
    return prism([*line, *back], low, high)


def _hung(name: str, mesh: trimesh.Trimesh, material: Material, floor: float, along: int) -> Part:
    """Give a wall its picture: once over the depth of the hold, repeating every 9 m along an axis."""
    v = mesh.vertices
    u = v[:, along] / 9.0
    uv = np.stack([u, 0.002 + 0.996 * np.clip((v[:, 2] - floor) / -floor, 0, 1)], 1)
    return Part(name, mesh, material, uv)


def _heap(place: Hold, cargo: Cargo, depth: float, x: Field, y: Field, rng: np.random.Generator) -> Field:
    """Height of the cargo above the tank top: remnants, slopes against the walls, pits; below 0 on bare plates."""
    slope = float(np.tan(cargo.repose))
    level = place.fill * (depth - 2.2)
    gx, gy = warped(x, y, rng)
    angle = rng.uniform(0, 2 * np.pi, 22)
    rim = np.array([LENGTH, BREADTH]) / 2 * np.clip(1.25 * np.stack([np.cos(angle), np.sin(angle)], 1), -1, 1)
    rim_z = np.minimum(level + rng.uniform(0.2, 2.6, 22), depth - 1.7)
    inner = rng.uniform(-9, 9, (2, 9)).T
    inner_z = np.minimum(level + rng.normal(0.0, 0.7, 9), depth - 1.9)
    tops = np.column_stack([np.vstack([rim, inner]), np.concatenate([rim_z, inner_z])])
    field = cones(gx, gy, tops, slope)
    field = np.maximum(field, level - rng.uniform(0.8, 1.4) if level > 1.5 else -0.4)
    pits = [
        [rng.uniform(-5.5, 5.5), rng.uniform(-5, 5), max(level - rng.uniform(0.8, 3.2), -0.5), rng.uniform(1.4, 2.6)]
        for _ in range(6)
    ]
    field = dug(gx, gy, field, np.array(pits), 0.8 * slope)
    return np.maximum(roughened(field, float(x[1] - x[0]), cargo.rough * 1.5, rng), -0.3)


def _bottom(depth: float, place: Hold, cargo: Cargo, rng: np.random.Generator) -> list[Part]:
    """Tank top and heap, both under one picture."""
    half_l, half_b = LENGTH / 2 + 0.2, BREADTH / 2 - 0.02
    x, y = np.linspace(-half_l, half_l, 132), np.linspace(-half_b, half_b, 158)
    field = _heap(place, cargo, depth, x, y, rng)
    tile = load("tanktop")
    scale = PIXELS / SIZE * 10.0 / tile.shape[0]

    canvas = Canvas(lambda: tiled(shrunk(tile, scale), PIXELS, PIXELS), SIZE, PIXELS, rng=rng)
    cover = np.clip((field + 0.30) / 0.32, 0, 1.3)[:, ::-1].T
    canvas.spill(cover, (-half_l, -half_b), (half_l, half_b))
    for s in (-1, 1):
        canvas.grime(outline(-half_l, s * half_b, half_l, s * (half_b - 5)), 0.5, blur=2.0)
        canvas.grime(outline(s * half_l, -half_b, s * (half_l - 1.6), half_b), 0.6, blur=0.9)
    for _ in range(24):
        canvas.blot(rng.uniform(-12, 12, 2), rng.uniform(0.3, 1.6), rng.uniform(0.1, 0.35))
    finished = canvas.finish(cargo)
    # The eye of the camera opens to the hold; the renderer knows no light between walls.
    picture = cache(lambda: np.asarray(cv2.convertScaleAbs(finished(), alpha=1.45), np.uint8))
    dim = 1.0 - 0.22 * (1 - place.fill)  # less sky reaches the bottom of an empty hold
    material = Material("hold bottom", rgba=(dim, dim, dim, 1.0), texture=picture, specular=0.02)
    floor = box((-half_l, -half_b, -depth - 0.3), (half_l, half_b, -depth))
    mound = sheet(x, y, field - depth, bottom=-depth - 0.4)
    return [
        Part("tank top", floor, material, canvas.uv(floor.vertices)),
        Part("hold cargo", mound, material, canvas.uv(mound.vertices)),
    ]
