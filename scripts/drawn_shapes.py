"""Shapes that are drawn at random to hang from ropes in training: plain bodies, and what cranes lift."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np
import trimesh
from trimesh.creation import annulus, box, capsule, cone, cylinder, icosphere, torus
from trimesh.transformations import random_rotation_matrix, rotation_matrix, scale_matrix, translation_matrix

from scripts.hung_shape import Array, Model, beam, bounds, colour, move, paint, surface, tops

Rng = np.random.Generator
_CORNERS = np.array([(x, y, z) for z in (-0.5, 0.5) for x, y in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))])
_RING = [(i, (i + 1) % 4) for i in range(4)]
_EDGES = [*_RING, *((i + 4, j + 4) for i, j in _RING), *((i, i + 4) for i in range(4))]


def plain(rng: Rng) -> Model:
    """Draw one to six primitives that touch each other."""
    model = [primitive(rng)]
    for _ in range(int(rng.choice([0, 1, 2, 3, 5], p=[0.35, 0.2, 0.2, 0.15, 0.1]))):
        mesh = primitive(rng)
        mesh.apply_transform(random_rotation_matrix(rng.random(3)) @ scale_matrix(rng.uniform(0.3, 1.0)))
        base = surface(model, 50)
        mesh.apply_translation(base[rng.integers(len(base))] - mesh.centroid * rng.uniform(0.2, 1.0))
        model.append(mesh)
    colours = [colour(rng) for _ in range(3)]
    if rng.random() < 0.5:
        for mesh in model:
            paint(mesh, colours[rng.integers(3)])
    return model


def load(rng: Rng) -> Model:
    """Draw what cranes lift, and what it hangs from: frames, vessels, hooks, bundles and cargo."""
    return _LOADS[rng.integers(len(_LOADS))](rng)


def primitive(rng: Rng) -> trimesh.Trimesh:
    """Draw a box, a cylinder, a prism, a ball, a cone, a ring, a tube, a plate, a capsule or a bowl, about 1 wide."""
    a, b, c = np.exp(rng.uniform(np.log(0.25), 0, 3))
    sections = int(rng.choice([3, 4, 5, 6, 8, 24, 32]))
    makers: tuple[Callable[[], trimesh.Trimesh], ...] = (
        lambda: box((a, b, c)), lambda: cylinder(a / 2, height=b, sections=32),
        lambda: cylinder(a / 2, height=b, sections=sections), lambda: icosphere(3).apply_scale((a / 2, b / 2, c / 2)),
        lambda: cone(a / 2, height=b, sections=sections), lambda: torus(0.5, 0.4 * a, major_sections=40),
        lambda: annulus(0.5 * a * rng.uniform(0.5, 0.95), 0.5 * a, height=b),
        lambda: box((a, b, rng.uniform(0.03, 0.07))), lambda: capsule(height=b, radius=a / 4, count=[16, 16]),
        lambda: shell(sections, 0.5, rng.uniform(0.2, 0.5), b),
    )  # fmt: skip
    return makers[rng.integers(len(makers))]()


def shell(sides: int, top: float, bottom: float, height: float) -> trimesh.Trimesh:
    """Make the walls and the floor of a vessel that is open at the top, of radii ``top`` and ``bottom``."""
    angle = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    circle = np.stack([np.cos(angle), np.sin(angle)], 1)
    rings = [np.column_stack([r * circle, np.full(sides, z)]) for r, z in ((top, height), (bottom, 0.0))]
    i, j = np.arange(sides), (np.arange(sides) + 1) % sides
    floor = np.full(sides, 2 * sides)
    faces = [np.stack(f, 1) for f in ((i, i + sides, j), (j, i + sides, j + sides), (i + sides, floor, j + sides))]
    return trimesh.Trimesh(np.concatenate([*rings, [(0, 0, 0)]]), np.concatenate(faces), process=False)


def frame(corners: Array, pairs: Sequence[tuple[int, int]], radius: float, sections: int = 8) -> Model:
    """Make beams between corners."""
    return [beam(corners[i], corners[j], radius, sections) for i, j in pairs]


def _size(rng: Rng) -> Array:
    return np.asarray(np.exp(rng.uniform(np.log(0.4), 0, 3)))


def _cage(rng: Rng) -> Model:
    """Draw the edges of a box, with braces, or with something in it."""
    size, thin, sections = _size(rng), rng.uniform(0.01, 0.04), int(rng.choice([4, 8]))
    model = frame(_CORNERS * size, _EDGES, thin, sections)
    if rng.random() < 0.5:
        inner = plain(rng)
        move(inner, np.diag([*size / 2, 1.0]))
        return model + inner
    return model + frame(_CORNERS * size, [(0, 5), (1, 6), (2, 7), (3, 4)][: rng.integers(5)], thin * 0.7, sections)


def _stand(rng: Rng) -> Model:
    count, (x, _, z), thin = int(rng.choice([3, 4, 6])), _size(rng), rng.uniform(0.01, 0.04)
    angle = 2 * np.pi * np.arange(count) / count
    feet = np.column_stack([x / 2 * np.cos(angle), x / 2 * np.sin(angle), np.zeros(count)])
    middle = feet * 0.6 + [0, 0, 0.4 * z]
    return [
        *(beam(foot, np.array([0, 0, z]), thin) for foot in feet),
        *(beam(middle[i], middle[i - 1], thin) for i in range(count)),
    ]


def _spreader(rng: Rng) -> Model:
    """Draw a beam with cross-beams, in most cases with a load on two slings below."""
    y = rng.uniform(0.3, 1.0)
    bars = [box((1, 0.06, 0.1)), *(box((0.06, y, 0.06)).apply_translation([at, 0, 0]) for at in (-0.45, 0.45))]
    if rng.random() < 0.4:
        return bars
    below = load(rng)
    low, high = bounds(below)
    scale = 0.8 / (high - low).max()
    move(below, translation_matrix([0, 0, -0.3]) @ scale_matrix(scale)
         @ translation_matrix([*-(low + high)[:2] / 2, -high[2]]))  # fmt: skip
    upper = tops(below)
    slings = [beam(np.array([at, 0, 0]), upper[np.abs(upper[:, 0] - at).argmin()], 0.008) for at in (-0.4, 0.4)]
    return bars + below + slings


def _container(rng: Rng) -> Model:
    ribs = int(rng.integers(6, 20))
    return [
        box((1, 0.4, 0.42)), *frame(_CORNERS * [1.02, 0.42, 0.44], _EDGES, 0.015, 4),
        *(box((0.4 / ribs, 0.42, 0.36)).apply_translation([at, 0, 0]) for at in np.linspace(-0.47, 0.47, ribs)),
    ]  # fmt: skip


def _basket(rng: Rng) -> Model:
    """Draw posts and rails, in most cases with a floor."""
    (x, y, z), thin, posts = _size(rng), rng.uniform(0.006, 0.024), int(rng.integers(3, 9))
    corners = (_CORNERS * [x, y, z])[:4]
    feet = [corners[i] + (corners[j] - corners[i]) * t for i, j in _RING for t in np.arange(posts) / posts]
    rails = [frame(corners + [0, 0, z * h], _RING, thin) for h in np.linspace(0, 1, int(rng.integers(2, 6)))]
    floor = [box((x, y, 0.02)).apply_translation([0, 0, -z / 2])] if rng.random() < 0.7 else []
    return [*(beam(foot, foot + [0, 0, z], thin) for foot in feet), *itertools.chain(*rails), *floor]


def _vessel(rng: Rng) -> Model:
    """Draw a bucket or skip, with a rim, some with a bail or full."""
    (x, y, z), thin, sides = _size(rng), rng.uniform(0.01, 0.04), int(rng.choice([4, 4, 6, 8, 28]))
    wall = shell(sides, 0.5, rng.uniform(0.25, 0.5), z).apply_scale((x, y, 1))
    rim = np.asarray(wall.vertices[:sides])
    model = [wall, *(beam(rim[i], rim[i - 1], thin) for i in range(sides))]
    if rng.random() < 0.4:
        upright = translation_matrix([0, 0, z]) @ rotation_matrix(np.pi / 2, [1, 0, 0])
        model.append(torus(0.5 * x, thin, major_sections=32).apply_transform(upright))
    if rng.random() < 0.4:
        model.append(icosphere(2).apply_scale((0.42 * x, 0.42 * y, 0.15)).apply_translation([0, 0, 0.9 * z]))
    return model


def _magnet(rng: Rng) -> Model:
    """Draw a disc on three chains, in half of the cases with scrap."""
    angle, apex = 2 * np.pi * np.arange(3) / 3, np.array([0, 0, rng.uniform(0.4, 0.9)])
    feet = np.column_stack([0.35 * np.cos(angle), 0.35 * np.sin(angle), np.full(3, 0.1)])
    pieces = [plain(rng)[0].apply_scale(0.3) for _ in range(5 if rng.random() < 0.5 else 0)]
    return [
        cylinder(0.5, height=rng.uniform(0.1, 0.3), sections=36), cylinder(0.2, height=0.4),
        *(beam(foot, apex, 0.015) for foot in feet), torus(0.06, 0.02).apply_translation(apex),
        *(piece.apply_translation([*rng.uniform(-0.35, 0.35, 2), -0.2]) for piece in pieces),
    ]  # fmt: skip


def _bags(rng: Rng) -> Model:
    """Draw one, two or four big bags, each with four loops."""
    model = Model()
    for i in range(int(rng.choice([1, 1, 2, 4]))):
        ball, power = icosphere(3), rng.uniform(2.5, 6)
        ball.vertices /= (np.abs(ball.vertices) ** power).sum(axis=1, keepdims=True) ** (1 / power)
        at = np.array([i % 2, i // 2, 0.0])
        model.append(ball.apply_scale((0.5, 0.5, rng.uniform(0.4, 0.7))).apply_translation(at))
        corners, top = at + _CORNERS[4:] * [0.76, 0.76, 0.8], at + [0, 0, 0.95]
        model += [beam(corner, top, 0.02) for corner in corners]
    return model


def _bundle(rng: Rng) -> Model:
    """Draw logs, pipes or bars in a heap."""
    rows, radius, kind = int(rng.integers(2, 6)), rng.uniform(0.04, 0.12), rng.integers(4)
    model = Model()
    for row in range(rows):
        for k in range(rows - row):
            r, long = radius * (1 if kind else rng.uniform(0.7, 1)), rng.uniform(0.85, 1.0)
            one = (annulus(0.8 * r, r, height=long) if kind == 1 else box((1.7 * r, 1.7 * r, long)) if kind == 2
                   else cylinder(r, height=long, sections=14))  # fmt: skip
            one.apply_transform(rotation_matrix(np.pi / 2, [0, 1, 0]))
            model.append(one.apply_translation([rng.normal(0, 0.03), (2 * k + row) * radius, 1.74 * radius * row]))
    return model


def _pallet(rng: Rng) -> Model:
    """Draw boxes on a pallet; some are missing."""
    nx, ny, nz = rng.integers(1, 4, 3)
    side = (0.95 / nx, 0.95 / ny, 0.3)
    return [
        *(box((0.1, 1, 0.02)).apply_translation([at, 0, 0.08]) for at in np.linspace(-0.45, 0.45, 6)),
        *(box((1, 0.1, 0.08)).apply_translation([0, at, 0.03]) for at in (-0.45, 0, 0.45)),
        *(box(side).apply_translation([(i + 0.5) / nx - 0.5, (j + 0.5) / ny - 0.5, 0.24 + 0.3 * k])
          for i, j, k in np.ndindex(nx, ny, nz) if k == 0 or rng.random() < 0.85),
    ]  # fmt: skip


def _hook(_: Rng) -> Model:
    """Draw a block of three cheeks, with a hook."""
    cheeks = [cylinder(0.22, height=0.04, sections=28).apply_translation([0, 0, at]) for at in (-0.1, 0, 0.1)]
    move(cheeks, rotation_matrix(np.pi / 2, [1, 0, 0]))
    angle = np.linspace(0, 1.6 * np.pi, 12)
    bend = np.column_stack([0.14 * np.sin(angle), 0 * angle, -0.5 + 0.14 * np.cos(angle)])
    points = np.concatenate([[(0, 0, -0.15)], bend])
    return [*cheeks, box((0.12, 0.3, 0.3)), *(beam(p, q, 0.04) for p, q in itertools.pairwise(points))]


def _truss(rng: Rng) -> Model:
    """Draw three chords with laces."""
    bays, thin = int(rng.integers(3, 9)), rng.uniform(0.01, 0.04)
    chords = [
        np.array([[t, 0.15 * y, 0.15 * z] for t in np.linspace(-1, 1, bays + 1)])
        for y, z in ((1, 0), (-1, 0), (0, 1.7))
    ]
    laces = [
        beam(chords[i][k], chords[(i + 1) % 3][k + d], thin * 0.6)
        for i in range(3)
        for k in range(bays)
        for d in (0, 1)
    ]
    return [*(beam(chord[0], chord[-1], thin) for chord in chords), *laces]


def _reel(rng: Rng) -> Model:
    y = rng.uniform(0.4, 1.0)
    flanges = [cylinder(0.5, height=0.04, sections=36).apply_translation([0, 0, at]) for at in (-y / 2, y / 2)]
    return [*flanges, cylinder(rng.uniform(0.15, 0.45), height=y, sections=30)]


_LOADS: tuple[Callable[[Rng], Model], ...] = (
    _cage, _cage, _stand, _spreader, _container, _basket, _vessel, _vessel, _magnet, _bags, _bundle, _pallet, _hook,
    _truss, _reel,
)  # fmt: skip
