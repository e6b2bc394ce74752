"""Materials that several places share."""

from __future__ import annotations

from simgrab.world.scenery.meshes.part import Material
from simgrab.world.scenery.textures import load

Rgb = tuple[float, float, float]


def dull(rgb: Rgb, share: float) -> Rgb:
    """Mix a colour with dust grey, leaving ``share`` of it."""
    r, g, b = (share * c + (1 - share) * 0.24 for c in rgb)
    return r, g, b


def plain(name: str, rgb: Rgb, *, specular: float = 0.1) -> Material:
    """Return one colour, for things of a few centimetres."""
    return Material(name, rgba=(*rgb, 1.0), specular=specular, shininess=0.3)


def painted(name: str, rgb: Rgb, *, tile_m: float = 6.0, texture: str = "deck", fine: bool = False) -> Material:
    """Return painted, weathered steel: the pale texture takes the colour. ``fine`` keeps its full resolution."""
    picture = load(texture, None if fine else 512)
    r, g, b = (min(1.0, c / 0.68) for c in rgb)  # 0.68 is the texture's own mean brightness
    return Material(name, rgba=(r, g, b, 1.0), texture=picture, tile_m=tile_m, specular=0.08, shininess=0.2)


def rusty(name: str) -> Material:
    """Bare rusty plate."""
    return Material(name, texture=load("tanktop", 512), tile_m=5.0, specular=0.05)


RUBBER = plain("rubber", (0.085, 0.085, 0.09), specular=0.05)  # tyres and fenders
GALVANISED = plain("galvanised", (0.47, 0.48, 0.48), specular=0.2)  # gratings, ladders, guard rails: dull zinc
GLASS = plain("glass", (0.07, 0.09, 0.10), specular=0.7)  # dark cab windows
SAFETY_YELLOW = plain("safety yellow", (0.62, 0.50, 0.13))  # faded, of rails and bollards
