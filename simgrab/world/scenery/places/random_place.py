"""Level ground with random textures and random solids on it: domain randomisation (Tobin et al. 2017).

Ground and solids may have any colour, and any of the bundled textures, those of all cargoes included.
"""

from __future__ import annotations

import colorsys
from functools import cache, partial

import cv2
import numpy as np
import trimesh

from simgrab.model.geometry import Array
from simgrab.world.scenery import textures
from simgrab.world.scenery.meshes import shapes as steel
from simgrab.world.scenery.meshes.part import Material, Part, Texture
from simgrab.world.scenery.places import shapes
from simgrab.world.scenery.places.canvas import tiled
from simgrab.world.scenery.places.plain import slab

SPAN_M = 64.0  # of the ground's picture, which repeats
_PIXELS = 2048
_MOST_SOLIDS = 22
_NEAREST_M, _FARTHEST_M = 1.5, 17.0  # from the vertical through O
_NEAR_M, _LOW_M = 7.0, 1.6  # solids centred nearer than the first are no higher than the second: the grab hangs there
# Not what the folder holds: random draws count them.
_TEXTURES = (
    "bauxite", "coal", "concrete", "deck", "grain", "grease", "hullplate", "ore", "rope", "rust", "sulphur", "tanktop",
    "water", "wear", "worn_steel",
)  # fmt: skip


def random_place(*, head_height: float, rng: np.random.Generator) -> list[Part]:
    """Build the place, in the jib frame: level ground ``head_height`` metres below the rope exit, and what is on it."""
    paint = np.random.default_rng(rng.integers(2**63))  # its own stream: shapes are the same whatever is painted
    picture = cache(partial(_picture, *paint.spawn(1)))
    ground = Material("ground", texture=picture, tile_m=SPAN_M, specular=float(paint.uniform(0, 0.1)), shades=False)
    parts = [Part("ground", slab(0.0), ground)]
    parts += [_standing(number, rng, paint) for number in range(int(rng.integers(0, _MOST_SOLIDS + 1)))]
    return [part.moved(shapes.pose(0, 0, -head_height)) for part in parts]


# The ground.


def _picture(rng: np.random.Generator) -> Texture:
    """Paint tiles, or a colour, with lines, patches, letters and stains on it."""
    canvas = _tiled(rng) if rng.random() < 0.7 else np.full((_PIXELS, _PIXELS, 3), _rgb(rng), np.uint8)
    for _ in range(int(rng.integers(0, 60))):
        _mark(canvas, rng)
    if rng.random() < 0.6:
        cells = int(rng.integers(3, 40))
        uneven = cv2.resize(rng.uniform(0.5, 1.1, (cells, cells)).astype(np.float32), (_PIXELS, _PIXELS),
                            interpolation=cv2.INTER_CUBIC)  # fmt: skip
        canvas = cv2.multiply(
            canvas, np.repeat((uneven * 255).clip(0, 255).astype(np.uint8)[..., None], 3, 2), scale=1 / 255
        )
    return np.asarray(canvas, np.uint8)


def _tiled(rng: np.random.Generator) -> Texture:
    """Repeat a bundled texture at a random size and tint, or two of them beside each other."""
    layers = []
    for name in rng.choice(_TEXTURES, 2, replace=False):
        side = int(2 ** rng.uniform(6.5, 10.5))
        tile = cv2.resize(textures.load(str(name)), (side, side), interpolation=cv2.INTER_AREA)
        tint = rng.uniform(0.5, 1.3, 3) * rng.uniform(0.6, 1.3)
        tile = np.clip(tile * tint, 0, 255).astype(np.uint8)
        layers.append(tiled(tile, _PIXELS, _PIXELS))
    first, second = layers
    if rng.random() < 0.5:
        return first
    cells = int(rng.integers(2, 12))
    where = cv2.resize(rng.random((cells, cells)).astype(np.float32), (_PIXELS, _PIXELS), interpolation=cv2.INTER_CUBIC)
    share = np.clip((where - 0.5) * 10 + 0.5, 0, 1).astype(np.float32)
    return np.asarray(cv2.blendLinear(first, second, share, 1 - share))


def _mark(canvas: Texture, rng: np.random.Generator) -> None:
    """Paint one line, patch, ring or word."""
    at = rng.integers(0, _PIXELS, 2)
    size = int(2 ** rng.uniform(3.5, 9.0))
    colour, thick = _rgb(rng), int(rng.integers(1, 12))
    match int(rng.integers(5)):
        case 0:
            cv2.line(canvas, tuple(map(int, at)), tuple(map(int, at + rng.integers(-size, size + 1, 2))), colour, thick,
                     cv2.LINE_AA)  # fmt: skip
        case 1:
            angles = np.sort(rng.uniform(0, 2 * np.pi, int(rng.integers(3, 9))))
            reach = size / 2 * rng.uniform(0.3, 1.0, len(angles))[:, None]
            corners = at + reach * np.stack([np.cos(angles), np.sin(angles)], axis=1)
            cv2.fillPoly(canvas, [np.round(corners).astype(np.int32)], colour, cv2.LINE_AA)
        case 2:
            axes = tuple(int(v) for v in rng.integers(2, size + 2, 2))
            cv2.ellipse(canvas, tuple(map(int, at)), axes, rng.uniform(0, 180), 0, 360, colour,
                        -1 if rng.random() < 0.5 else thick, cv2.LINE_AA)  # fmt: skip
        case 3:
            for step in range(int(rng.integers(2, 12))):
                x, y = (int(v) for v in at + (step * thick * 3, 0))
                cv2.line(canvas, (x, y), (x, y + size), colour, thick, cv2.LINE_AA)
        case _:
            word = "".join(rng.choice(list("0123456789ABCHKLMT"), int(rng.integers(1, 5))))
            cv2.putText(
                canvas, word, tuple(map(int, at)), cv2.FONT_HERSHEY_SIMPLEX, size / 60, colour, thick, cv2.LINE_AA
            )


def _rgb(rng: np.random.Generator) -> tuple[int, int, int]:
    """Draw a colour, most often a dull one."""
    red, green, blue = colorsys.hsv_to_rgb(rng.random(), rng.uniform(0, 1) ** 2, rng.uniform(0.05, 0.95))
    return round(255 * red), round(255 * green), round(255 * blue)


# What stands on it.


def _standing(number: int, rng: np.random.Generator, paint: np.random.Generator) -> Part:
    radius, azimuth = rng.uniform(_NEAREST_M, _FARTHEST_M), rng.uniform(0, 2 * np.pi)
    size = np.exp(rng.uniform(np.log(0.25), np.log(4.5), 3))
    size[2] = min(size[2], _LOW_M if radius < _NEAR_M else np.inf)
    mesh = _solid(size, rng)
    pose = shapes.pose(radius * np.cos(azimuth), radius * np.sin(azimuth), 0.0, rng.uniform(0, 2 * np.pi))
    return Part(f"solid_{number}", mesh, _coat(number, paint)).moved(pose)


def _solid(size: Array, rng: np.random.Generator) -> trimesh.Trimesh:
    """Return a solid of about this size (x, y, z), m, that stands on z = 0."""
    x, y, z = (float(v) for v in size)
    match int(rng.integers(7)):
        case 0 | 1:
            return steel.block((-x / 2, -y / 2, 0), (x / 2, y / 2, z), 0.02)
        case 2:
            ring = [(0.01, 0), (x / 2, 0), (x / 2 * rng.uniform(0.3, 1.0), z), (0.01, z)]
            return steel.turned(ring, int(rng.choice([5, 6, 8, 20])))
        case 3:
            lies = min(x, z) / 2
            return shapes.bar((0, -y / 2, lies), (0, y / 2, lies), lies, sides=16)
        case 4:
            wide = rng.uniform(0.05, 0.25)
            beams = [steel.block((-x / 2, s * y / 2 - wide, 0), (x / 2, s * y / 2 + wide, z)) for s in (-1, 1)]
            beams += [steel.block((s * x / 2 - wide, -y / 2, 0), (s * x / 2 + wide, y / 2, z)) for s in (-1, 1)]
            return steel.join(beams)
        case 5:
            thin = 0.04 + 0.03 * rng.random()
            legs = [steel.rod((sx * x / 2, sy * y / 2, 0), (sx * x / 2, sy * y / 2, z), thin)
                    for sx in (-1, 1) for sy in (-1, 1)]  # fmt: skip
            braces = [steel.rod((-x / 2, s * y / 2, z * a), (x / 2, s * y / 2, z * b), thin)
                      for s in (-1, 1) for a, b in ((1, 1), (0.1, 0.9))]  # fmt: skip
            return steel.join([*legs, *braces])
        case _:
            points = rng.uniform(-0.5, 0.5, (14, 3)) * size
            return steel.convex(points - (0.0, 0.0, points[:, 2].min()))


def _coat(number: int, rng: np.random.Generator) -> Material:
    red, green, blue = (v / 255 for v in _rgb(rng))
    specular = rng.uniform(0, 0.5)
    if rng.random() < 0.5:
        return Material(f"solid_{number}", rgba=(red, green, blue, 1.0), specular=specular)
    picture = textures.load(str(rng.choice(_TEXTURES)), 256)
    red, green, blue = (0.4 + 0.6 * v for v in (red, green, blue))
    return Material(f"solid_{number}", rgba=(red, green, blue, 1.0), texture=picture,
                    tile_m=rng.uniform(1, 8), specular=specular)  # fmt: skip
