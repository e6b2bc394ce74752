"""Dimensions of a grab that is put together at random, and the random choices of its parts."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from simgrab.model.geometry import Array
from simgrab.model.scenario.grab import Assembled
from simgrab.world.scenery.grabs import kit
from simgrab.world.scenery.meshes import shapes
from simgrab.world.scenery.meshes.paint import BARE
from simgrab.world.scenery.meshes.part import Material, Part

CURVE_POINTS = 17  # of a jaw's inside
_UNIT_M3 = 6.0  # ``volume_m3`` of a grab of size 1
# Shares of the numbers of jaws: none for a closed vessel, two for shells or tongs, more for tines.
_JAWS = {0: 0.12, 2: 0.46, 3: 0.09, 4: 0.12, 5: 0.07, 6: 0.09, 8: 0.05}


class Chance:
    """Random choices of one grab, in the order in which they are asked for."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self._colours: tuple[Material, ...] = ()

    def share(self, low: float, high: float) -> float:
        """Draw a number, every one alike."""
        return float(self.rng.uniform(low, high))

    def ratio(self, low: float, high: float) -> float:
        """Draw a number, every ratio to another one alike."""
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def happens(self, share: float) -> bool:
        """Draw whether something is, with a probability."""
        return bool(self.rng.random() < share)

    def draw_colours(self) -> None:
        """Draw two colours of the grab's own, before its parts are."""
        self._colours = tuple(self._colour(name) for name in ("second", "third"))

    def _colour(self, name: str) -> Material:
        rgb = colorsys.hsv_to_rgb(self.rng.random(), self.share(0.0, 0.9), self.share(0.05, 0.9))
        return Material(f"assembled_{name}", rgba=(*rgb, 1.0), specular=0.2, shininess=0.3)

    def coat(self, usual: Material = BARE.body) -> Material:
        """Draw the usual material, or at times another one."""
        others = (BARE.body, BARE.shell, BARE.dark, BARE.lip, BARE.lining, BARE.hazard, *self._colours)
        return others[self.rng.integers(len(others))] if self.happens(0.3) else usual

    def part(self, name: str, mesh: trimesh.Trimesh, usual: Material = BARE.body) -> Part:
        """Make a part of a material like `coat`'s."""
        return Part(name, mesh, self.coat(usual))


@dataclass(frozen=True, eq=False)
class Dimensions:
    """Sizes of the closed grab, which stands on z = 0; x is radial in the plane of a jaw."""

    size: float  # of everything, relative to a grab of 6 m³
    count: int  # number of jaws; 0 for a closed vessel
    # half, half_y: half the width of jaws or vessel along x and y, m
    half: float
    half_y: float
    depth: float  # height of jaws or vessel, m
    hinge: tuple[float, float]  # of a jaw, (r, z), m
    head_z: tuple[float, float]  # where the head begins and ends, m
    head_half: tuple[float, float]  # half the head's width along x and y, m
    plates: bool  # whether jaws are of plates, which hold cargo, or of bars
    curve: Array  # (17, 2), inside of a jaw from its lip to its rim, (r, z), m
    jaw_y: tuple[float, ...]  # where two jaws have their levers along y, m

    @classmethod
    def draw(cls, keys: Assembled, chance: Chance) -> Dimensions:
        """Draw them."""
        u = float(np.cbrt(keys.volume_m3 / _UNIT_M3))
        count = int(chance.rng.choice(list(_JAWS), p=list(_JAWS.values())))
        half = u * chance.ratio(0.75, 1.5)
        half_y = half * (chance.ratio(0.45, 1.7) if count in (0, 2) else 1.0)
        depth = u * chance.ratio(0.6, 1.9)
        hinge = half * chance.share(0.03, 0.45), depth * chance.share(0.8, 1.4)
        low = max(depth, hinge[1]) + u * chance.ratio(0.06, 1.7)
        head_z = low, low + u * chance.ratio(0.07, 0.6)
        head_half = half * chance.ratio(0.22, 1.0), half_y * chance.ratio(0.22, 1.0)
        chance.draw_colours()
        plates = chance.happens(0.7)
        curve = _curve(half, depth, chance)
        # A single lever stands at one end: datasets that were rendered show it there.
        jaw_y = tuple(np.linspace(-1, 1, int(chance.rng.integers(1, 4))) * 0.8 * half_y)
        return cls(u, count, half, half_y, depth, hinge, head_z, head_half, plates, curve, jaw_y)

    def turned(self, outline: Sequence[tuple[float, float]], sides: int) -> trimesh.Trimesh:
        """Turn a closed outline (r, z), m, about the axis, and stretch it along y by ``half_y`` over ``half``.

        Of four sides, each faces an axis.
        """
        mesh = shapes.turned(outline, sides)
        if sides == 4:
            mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 4, (0, 0, 1)))
            mesh.apply_scale((2**0.5, 2**0.5, 1.0))
        mesh.apply_scale((1.0, self.half_y / self.half, 1.0))
        return shapes.solid(mesh.vertices, mesh.faces)


def _curve(half: float, depth: float, chance: Chance) -> Array:
    """Draw the inside of a jaw, a Bézier curve."""
    points = [
        (0.0, 0.0), (chance.share(0.2, 1.0) * half, chance.share(0.0, 0.35) * depth),
        (chance.share(0.7, 1.2) * half, chance.share(0.2, 0.8) * depth), (chance.share(0.6, 1.05) * half, depth),
    ]  # fmt: skip
    return kit.curve(points, CURVE_POINTS)
