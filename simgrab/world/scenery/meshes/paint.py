"""What the grab's steel looks like: paint, what wears it off, and the dust on it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from functools import cache, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from simgrab.world.scenery import textures
from simgrab.world.scenery.meshes.part import Material, Paint, Part, Texture

Picture = NDArray[np.float64]
Colour = tuple[float, float, float]

TILE_M = 1.7

_DUST = {
    "coal": (0.10, 0.10, 0.105),
    "ore": (0.36, 0.20, 0.14),
    "grain": (0.74, 0.62, 0.40),
    "bauxite": (0.58, 0.34, 0.22),
    "sulphur": (0.80, 0.72, 0.26),
}
_COATS = {
    "body": (TILE_M, 0.25), "hazard": (0.8, 0.25), "plate": (1.0, 0.3), "dark": (0.6, 0.35), "shell": (1.0, 0.25),
    "lining": (1.0, 0.3), "lip": (0.9, 0.6),
}  # fmt: skip
"""Side of a tile, m, and specular share of each of `Finish`'s materials."""
_SIZE = 512


@dataclass(frozen=True)
class Finish:
    """The grab's materials."""

    # body, hazard: painted profiles; striped warning paint
    body: Material
    hazard: Material
    plate: Material  # the number plate; UVs span it once
    dark: Material  # greasy pins and sheaves
    shell: Material  # the shells' painted outside, which wears towards the lip; v runs from lip to rim
    # lining, lip: the shells' scoured inside (UVs as `shell`); the bright cutting edges
    lining: Material
    lip: Material

    def on(self, parts: Iterable[Part]) -> list[Part]:
        """Paint parts whose materials have the name of a field; the others stay as they are."""
        slots = {field.name: getattr(self, field.name) for field in fields(self)}
        return [replace(part, material=slots.get(part.material.name, part.material)) for part in parts]


#: Materials that are not mixed yet, with the names of the fields.
BARE = Finish(**{field.name: Material(field.name) for field in fields(Finish)})


def finish(paint: Colour, wear: float, residue: float, cargo: str, rng: np.random.Generator) -> Finish:
    """Mix the grab's materials.

    Parameters
    ----------
    paint : tuple of 3 floats
        Red, green and blue in [0, 1].
    wear : float
        Share of the paint that is worn off, in [0, 1]; on the shells it grows towards the lips.
    residue : float
        Amount of cargo dust on the steel, in [0, 1].
    cargo : str
        "coal", "ore", "grain", "bauxite" or "sulphur".
    rng : numpy.random.Generator
        Generator that shifts the masks, so that wear differs between grabs.
    """
    shift = rng.integers(_SIZE, size=2)

    def texture(name: str) -> Paint:
        return lambda: _mixed(paint, wear, residue, cargo, (int(shift[0]), int(shift[1])))[name]

    return Finish(**{
        name: Material(f"grab_{name}", texture=texture(name), tile_m=tile_m, specular=specular,
                       shininess=0.3)
        for name, (tile_m, specular) in _COATS.items()
    })  # fmt: skip


@lru_cache(maxsize=8)  # of many worlds, one after the other, the grab looks the same
def _mixed(paint: Colour, wear: float, residue: float, cargo: str, shift: tuple[int, int]) -> dict[str, Texture]:
    """Paint the materials' textures, by the names of `Finish`."""
    masks = np.roll(_picture("wear"), shift, axis=(0, 1))
    lost, tone, dust = masks[..., 0], masks[..., 1], masks[..., 2]
    rust, bright, grease = (_picture(name) for name in ("rust", "worn_steel", "grease"))
    colour = np.array(_DUST[cargo])
    height = np.linspace(1.0, 0.0, _SIZE)[:, None]  # 1 at the rim, 0 at the lip
    ground = np.clip((0.10 + 0.45 * wear - height) / 0.12, 0.0, 1.0)  # what the cargo keeps bright
    local = np.clip(wear * (0.35 + 1.6 * (1.0 - height) ** 2) + 0.9 * ground, 0.0, 1.0)

    def dusty(picture: Picture, stick: float = 1.0) -> Picture:
        """Cover a picture: a thin film everywhere, thick patches where the mask says."""
        patch = _step(dust, 1.0 - 0.75 * residue * stick, 0.15)
        cover = np.clip(0.3 * residue * stick + 0.65 * patch * min(1.0, 2 * residue), 0.0, 0.92)[..., None]
        return (1.0 - cover) * picture + cover * colour * (0.85 + 0.3 * dust[..., None])

    painted = _paint(np.array(paint), tone)
    rubbed = np.clip(1.15 - 0.9 * height - 0.5 * tone, 0, 1)[..., None]
    pictures = {
        "body": dusty(_worn(painted, lost, wear, rust, bright)),
        "hazard": dusty(_worn(_paint(_stripes(), tone), lost, wear, rust, bright)),
        "plate": dusty(_plate() * (0.85 + 0.15 * tone[..., None]), 0.5),
        "dark": dusty(grease, 0.6),
        "shell": dusty(_worn(painted, lost, local, rust, bright)),
        "lining": dusty(0.8 * (rubbed * bright + (1 - rubbed) * rust), 1.3),
        "lip": dusty(1.12 * bright, 0.4),
    }
    return {name: _texture(picture) for name, picture in pictures.items()}


def _worn(painted: Picture, lost: Picture, wear: Picture | float, rust: Picture, bright: Picture) -> Picture:
    """Lay paint over steel except a share ``wear``, where steel is bright if worn first, and rusted elsewhere."""
    bare = _step(lost, wear, 0.03, below=True)
    faded = _step(lost, wear + 0.06, 0.06, below=True)[..., None]  # rust creeps under the edge and stains
    scoured = np.clip((wear - 0.45) / 0.4, 0.0, 1.0) * _step(lost, 0.8 * wear, 0.3, below=True)
    steel = (1 - scoured[..., None]) * rust + scoured[..., None] * bright
    stained = painted * (1 - 0.35 * faded) + rust * 0.35 * faded
    return stained * (1 - bare[..., None]) + steel * bare[..., None]


def _paint(colour: Picture, tone: Picture) -> Picture:
    """Old paint: faded in blotches, streaked with grime."""
    shade = (0.80 + 0.24 * tone)[..., None]
    grey = np.broadcast_to(np.asarray(colour).mean(axis=-1, keepdims=True), np.shape(colour))
    return np.asarray((0.92 * np.asarray(colour) + 0.08 * grey) * shade)


def _stripes() -> Picture:
    """Yellow and black at 45°, four pairs to the tile."""
    i, j = np.indices((_SIZE, _SIZE))
    yellow = (((i + j) * 4 / _SIZE) % 1.0 < 0.5)[..., None]
    return np.where(yellow, (0.86, 0.68, 0.08), (0.07, 0.07, 0.07))


def _plate() -> Picture:
    """Black on white: the grab's number and its two masses."""
    image = np.full((_SIZE, _SIZE), 225, np.uint8)
    cv2.rectangle(image, (8, 18), (_SIZE - 9, _SIZE - 19), 20, 8)
    lines = (("G7", (30, 395), 7.5, 40), ("10.5 t", (330, 220), 1.6, 10), ("24 t", (330, 400), 1.6, 10))
    for text, at, scale, thick in lines:
        cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, 25, thick, cv2.LINE_AA)
    return np.repeat(image[..., None], 3, axis=2) / 255.0


@cache
def _picture(name: str) -> Picture:
    """Return a bundled texture, in [0, 1]; do not write to it."""
    picture = np.asarray(textures.load(name, _SIZE), float) / 255.0
    picture.setflags(write=False)
    return picture


def _step(value: Picture, edge: Picture | float, width: float, *, below: bool = False) -> Picture:
    """Smooth step from 0 to 1 as ``value`` rises past ``edge`` (falls below it); exact at edges outside [0, 1]."""
    rise = np.clip((value - edge) / width + 0.5, 0.0, 1.0)
    if below:
        return np.asarray(np.where(np.asarray(edge) <= 0.0, 0.0, 1.0 - rise))
    return np.asarray(np.where(np.asarray(edge) >= 1.0, 0.0, rise))


def _texture(picture: Picture) -> Texture:
    texture = np.clip(np.rint(picture * 255.0), 0, 255).astype(np.uint8)
    texture.setflags(write=False)
    return texture
