"""Two shells that meet at lips, of any size and profile, as clamshell and scissors grabs have them.

All is drawn closed, with the lips at z = 0; the outer shell is at +x.
"""

from __future__ import annotations

import numpy as np
import shapely
import trimesh

from simgrab.model.geometry import Array
from simgrab.model.scenario.grab import Clamshell, Scissors
from simgrab.world.scenery.grabs import kit
from simgrab.world.scenery.grabs.design import Body, Heaps
from simgrab.world.scenery.grabs.kit import Scale
from simgrab.world.scenery.meshes import shapes
from simgrab.world.scenery.meshes.paint import BARE
from simgrab.world.scenery.meshes.part import Part
from simgrab.world.scenery.meshes.shapes import join, prism, rounded

# In units of `Scale`: half the closed width, the depth of the shells and half the closed width again.
_CURVES = {
    "round": ((0.0, 0.0), (0.43, 0.08), (0.98, 0.28), (1.0, 1.0)),
    "angular": ((0.0, 0.0), (0.70, 0.02), (0.92, 0.35), (1.0, 1.0)),
}
_HALF_Y = 0.83
HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
GAP_M = 0.003
_CLEARANCE_M = 0.02


class Shells:
    """The shells of a grab.

    Parameters
    ----------
    keys : Clamshell or Scissors
    hinge : tuple of 2 floats
        Axis about which the outer shell turns, (x, z), in units of its proportions.

    Attributes
    ----------
    scale : Scale
    curve : ndarray, shape (n, 2)
        The shell's inside from lip to rim, (x, z), m.
    plate : float
        Thickness of the plates, m.
    half_y : float
        Half the length of the shells, plates included, m.
    hinge : tuple of 2 floats
        In m.
    """

    def __init__(self, keys: Clamshell | Scissors, hinge: tuple[float, float]) -> None:
        self.keys = keys
        line = kit.curve(_CURVES[keys.profile], 60)
        area = 2 * float(np.trapezoid(line[:, 0], line[:, 1]))
        self.scale = s = Scale.of(keys, area * 2 * _HALF_Y)
        self.curve = kit.curve([s.at(*point) for point in _CURVES[keys.profile]], 21)
        self.plate = 0.012 + 0.008 * s.mean
        self.half_y = _HALF_Y * s.y + self.plate
        self.hinge = s.at(*hinge)

    def pair(
        self, name: str, parts: list[Part], parent: str, pin: tuple[float, float], origin: tuple[float, float]
    ) -> list[Body]:
        """Make the outer body, drawn about (x, z), and the inner one, half a turn away."""
        own = kit.placed(parts, (origin[0], 0.0, origin[1]))
        other = [part.moved(HALF_TURN) for part in own]
        return [
            kit.body(f"{name}_outer", own, parent, (pin[0], 0.0, pin[1])),
            kit.body(f"{name}_inner", other, parent, (-pin[0], 0.0, pin[1])),
        ]

    def _wrap(self, name: str, mesh: trimesh.Trimesh, *, inside: bool = False) -> Part:
        material = BARE.lining if inside else BARE.shell
        return kit.wrap(name, mesh, material, top=float(self.curve[-1, 1]), around=2 * self.half_y)

    def shell(self) -> list[Part]:
        """Return plates, ribs and lips of the outer shell."""
        keys, t, hl, m = self.keys, self.plate, self.half_y, self.scale.mean
        rib = 0.03 + 0.03 * m
        inside = (-hl + t + 0.001, hl - t - 0.001)
        parts = [
            self._wrap("back", kit.strip(self.curve, (0.0, t), (-hl, hl))),
            self._wrap("lining", kit.strip(self.curve, (-0.006, -0.0005), inside), inside=True),
            self._wrap("sides", self._sides()),
            Part("rim", self._rim(), BARE.body),
            Part("lips", self._shell_lips(), BARE.lip),
        ]
        count = round(9 * keys.plate_work)
        if count:
            one = kit.strip(self.curve, (t - 0.003, t + rib), (-0.012, 0.012), 2, 20)
            parts.append(self._wrap("ribs", shapes.at_y(one, *np.linspace(-0.86 * hl, 0.86 * hl, count))))
        if keys.plate_work > 0.3:
            belt = kit.strip(self.curve, (t - 0.003, t + rib - 0.005), (-hl + 0.005, hl - 0.005), 12, 14)
            parts.append(Part("belt", belt, BARE.body))
        if keys.top == "closed":
            parts.append(Part("roof", self._roof(), BARE.body))
        if keys.markings:
            mark = kit.strip(self.curve, (t - 0.002, t + 0.004), (-0.95 * hl, -0.55 * hl), 15, 18)
            parts.append(Part("mark", mark, BARE.hazard))
        return parts

    def outline(self) -> shapely.Polygon:
        """Return the side plate's outline: back curve and upper edge."""
        w, top = self.curve[-1]
        hollow = [(0.86 * w, 0.99 * top), (0.66 * w, 0.90 * top), (0.40 * w, 0.87 * top), (0.22 * w, 0.99 * top)]
        hollow = [] if self.keys.top == "closed" else hollow
        return shapely.Polygon([*map(tuple, self.curve), *hollow, (GAP_M, 0.99 * top)])

    def _sides(self) -> trimesh.Trimesh:
        outline, t, hl, m = self.outline(), self.plate, self.half_y, self.scale.mean
        pieces = [prism(outline, hl - t, hl)]
        above = shapely.box(0.0, 0.1 * self.scale.z, 9, 9)
        frame = outline.difference(outline.buffer(-0.06 * m - 0.02)).intersection(above)
        pieces += [prism(part, hl - 0.001, hl + 0.016) for part in polygons(frame)]
        w, top = self.curve[-1]
        lines = [
            ((0.20 * w, 0.95 * top), (0.72 * w, 0.35 * top)),
            ((0.14 * w, 0.9 * top), (0.34 * w, 0.15 * top)),
            ((0.30 * w, 0.75 * top), (0.94 * w, 0.62 * top)),
        ]
        for line in lines[: round(3 * self.keys.plate_work)]:
            bar = shapely.LineString(line).buffer(0.012 + 0.004 * m, cap_style="flat").intersection(outline)
            pieces += [prism(part, hl - 0.004, hl + 0.03 + 0.02 * m) for part in polygons(bar)]
        return shapes.mirrored_y(join(pieces))

    def _rim(self) -> trimesh.Trimesh:
        w, top = self.curve[-1]
        deep, out = 0.08 * self.scale.mean + 0.04, 0.03 * self.scale.mean + 0.02
        section = rounded(shapely.box(w - 0.01, top - deep, w + self.plate + out, top), 0.01)
        return prism(section, -self.half_y, self.half_y)

    def _roof(self) -> trimesh.Trimesh:
        """Roof from the rim to beside the beam."""
        w, top = self.curve[-1]
        inner = 0.34 * w
        ridge = top + 0.25 * (w - inner) * 0.4
        edge = [(w, top - 0.002), (inner, ridge)]
        plate = shapely.LineString(edge).buffer(self.plate / 2, cap_style="flat")
        kerb = shapely.box(inner - 0.01, ridge - 0.02, inner + 0.02, ridge + 0.08)
        half = self.half_y - self.plate
        return join([prism(plate, -half, half), prism(kerb, -half, half)])

    def _shell_lips(self) -> trimesh.Trimesh:
        hl, m, keys = self.half_y, self.scale.mean, self.keys
        pieces = [kit.strip(self.curve, (-0.008, self.plate + 0.018), (-hl - 0.012, hl + 0.012), 0, 5)]
        edge = shapely.LineString([(0.03 * m, 0.05 * m), (0.03 * m, 0.86 * self.curve[-1, 1])])
        flank = edge.buffer(0.028 * m + 0.004, cap_style="flat")
        side = flank.intersection(shapely.box(GAP_M, 0, 9, 9))
        pieces.append(shapes.mirrored_y(prism(side, hl - self.plate - 0.006, hl + 0.02)))
        if keys.teeth:
            pitch = 2 * hl / keys.teeth
            outline = [(GAP_M, 0.10 * m), (GAP_M, -0.09 * m), (0.05 * m, -0.05 * m), (0.13 * m, 0.06 * m)]
            tooth, half = shapely.Polygon(outline), 0.17 * pitch
            # The other shell's teeth come between: half a turn takes y to −y.
            places = -hl + pitch * (np.arange(keys.teeth) + 0.25)
            pieces += [prism(tooth, y - half, y + half) for y in places]
        return join(pieces)

    def lips(self) -> dict[str, Array]:
        """Return the ends of the cutting edges, in the frames of bodies whose origin is the hinge."""
        return dict(zip(("shell_outer", "shell_inner"), edges(self.hinge, self.half_y), strict=True))

    def heaps(self) -> Heaps:
        """Return the function that makes heaps in the closed shells."""
        top = float(self.curve[-1, 1])
        half_y = self.half_y - self.plate - _CLEARANCE_M
        u, v = np.meshgrid(np.linspace(-1.0, 1.0, 41), np.linspace(-1.0, 1.0, 37), indexing="ij")
        heaped = 0.0 if self.keys.top == "closed" else 1.0

        def form(level: float) -> tuple[Array, ...]:
            shoulder = top * (0.30 + 0.52 * level)
            edge = float(np.interp(shoulder - 0.06 * top, self.curve[:, 1], self.curve[:, 0])) - 2.5 * _CLEARANCE_M
            dome = (0.06 + 0.08 * heaped) * top * (1 - np.abs(u) ** 1.6) * (1 - v**2)
            smooth = shoulder + dome - 0.05 * top * np.abs(v) ** 3
            return edge * u, half_y * v, np.abs(edge * u), smooth, (1 - u**4) * (1 - v**6)

        return kit.heaps(self.curve, _CLEARANCE_M, form)


def edges(hinge: tuple[float, float], half_y: float) -> tuple[Array, Array]:
    """Return the ends of the cutting edges of an outer and an inner shell, (2, 3) each, from their hinges."""
    (x, z), y = hinge, half_y
    outer = np.array([(GAP_M - x, y, -z), (GAP_M - x, -y, -z)])
    return outer, (outer * (-1.0, -1.0, 1.0))[::-1]


def polygons(shape: shapely.Geometry) -> list[shapely.Polygon]:
    """Return the parts of a shape that have an area."""
    parts = getattr(shape, "geoms", [shape])
    return [part for part in parts if isinstance(part, shapely.Polygon) and part.area > 1e-6]
