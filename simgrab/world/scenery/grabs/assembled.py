"""Grabs put together at random from parts of no kind: so many shapes that a detector learns grabs and not kinds.

Each has a head on ropes, something that joins it to what hangs below, and there a closed vessel, two shells, or tines
round the axis, of plates or of bars. Jaws turn about hinges in the head; struts between head and jaws follow them.

All is drawn closed, with the lowest point at z = 0, and a jaw in the plane (r, z) of its azimuth.
"""

from __future__ import annotations

import colorsys
import operator
from collections.abc import Callable, Sequence

import numpy as np
import shapely
import trimesh

from simgrab.geometry import Array
from simgrab.rng import stream
from simgrab.scenario.grab import Assembled
from simgrab.world.scenery.grabs import kit
from simgrab.world.scenery.grabs.design import CARGO_LEVELS, Body, Design, Heaps
from simgrab.world.scenery.grabs.shells import GAP_M, polygons
from simgrab.world.scenery.grabs.slider_crank import Cylinder
from simgrab.world.scenery.meshes import shapes
from simgrab.world.scenery.meshes.paint import BARE
from simgrab.world.scenery.meshes.part import Material, Part
from simgrab.world.scenery.meshes.shapes import block, circle, hull, join, pin, prism, rod

_UNIT_M3 = 6.0  # held by a grab of size 1
_CLEARANCE_M = 0.03
_SHAPES = 2**53  # as many as a number between 0 and 1 can tell apart
# How many jaws: none for a closed vessel, two for shells or tongs.
_JAWS = {0: 0.12, 2: 0.46, 3: 0.09, 4: 0.12, 5: 0.07, 6: 0.09, 8: 0.05}


def assembled(keys: Assembled) -> Design:
    """Return the design of a grab that is put together at random."""
    return _Assembly(keys).design()


class _Assembly:
    def __init__(self, keys: Assembled) -> None:
        self.keys = keys
        self.rng = stream(round(keys.shape * _SHAPES), 0, "assembled")
        self.size = u = float(np.cbrt(keys.volume_m3 / _UNIT_M3))
        self.count = int(self.rng.choice(list(_JAWS), p=list(_JAWS.values())))
        self.half = u * self._ratio(0.75, 1.5)
        self.half_y = self.half * (self._ratio(0.45, 1.7) if self.count in (0, 2) else 1.0)
        self.depth = u * self._ratio(0.6, 1.9)
        self.hinge = self.half * self._share(0.03, 0.45), self.depth * self._share(0.8, 1.4)
        low = max(self.depth, self.hinge[1]) + u * self._ratio(0.06, 1.7)
        self.head_z = low, low + u * self._ratio(0.07, 0.6)
        self.head_half = self.half * self._ratio(0.22, 1.0), self.half_y * self._ratio(0.22, 1.0)
        self.colours = tuple(self._colour(name) for name in ("second", "third"))
        self.plates = self._chance(0.7)
        self.curve = self._curve()
        self.jaw_y = tuple(np.linspace(-1, 1, int(self.rng.integers(1, 4))) * 0.8 * self.half_y)

    # Chance.

    def _share(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def _ratio(self, low: float, high: float) -> float:
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def _chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def _colour(self, name: str) -> Material:
        rgb = colorsys.hsv_to_rgb(self.rng.random(), self._share(0.0, 0.9), self._share(0.05, 0.9))
        return Material(f"assembled_{name}", rgba=(*rgb, 1.0), specular=0.2, shininess=0.3)

    def _coat(self, usual: Material = BARE.body) -> Material:
        """Give the usual material, or now and then another one."""
        others = (BARE.body, BARE.shell, BARE.dark, BARE.lip, BARE.lining, BARE.hazard, *self.colours)
        return others[self.rng.integers(len(others))] if self._chance(0.3) else usual

    def _part(self, name: str, mesh: trimesh.Trimesh, usual: Material = BARE.body) -> Part:
        return Part(name, mesh, self._coat(usual))

    # The whole.

    def design(self) -> Design:
        hx, hz = self.hinge
        head = [*self._middle(), *self._head()]
        bodies: list[Body] = []
        positions: dict[str, Callable[[float], float]] = {}
        lips: dict[str, Array] = {}
        if self.count:
            jaw, (strut, cylinder) = self._jaw(), self._strut()
            for k in range(self.count):
                azimuth = 2 * np.pi * k / self.count
                bodies.append(kit.hinged(f"jaw_{k}", jaw, "head", azimuth, (hx, hz), (hx, hz)))
                positions[f"jaw_{k}"] = operator.neg
                if strut and cylinder:
                    bodies.append(
                        kit.hinged(f"strut_{k}", strut, "head", azimuth, cylinder.head_pin, cylinder.head_pin)
                    )
                    positions[f"strut_{k}"] = cylinder.turn
            lips = self._lips()
        else:
            head += self._vessel()
        return kit.assembled(
            [kit.body("head", head), *bodies], lambda jaw: {name: at(jaw) for name, at in positions.items()},
            float(np.radians(self._share(25.0, 55.0))) if self.count else 0.0, self._ends(),
            volume_m3=self.keys.volume_m3, lips=lips, heaps=self._heaps(),
        )  # fmt: skip

    # What holds cargo.

    def _curve(self) -> Array:
        """Inside of a jaw from its lip to its rim, (r, z), ever farther out at first."""
        w, d = self.half, self.depth
        points = [
            (0.0, 0.0), (self._share(0.2, 1.0) * w, self._share(0.0, 0.35) * d),
            (self._share(0.7, 1.2) * w, self._share(0.2, 0.8) * d), (self._share(0.6, 1.05) * w, d),
        ]  # fmt: skip
        return kit.curve(points)

    def _band(
        self, inner: float, outer: float, low: float, high: float, first: int = 0, last: int | None = None
    ) -> trimesh.Trimesh:
        """Strip along the curve, between two offsets, from y = ``low`` to ``high``."""
        strip = kit.band(self.curve, inner, outer, first, last).buffer(0)
        return join(prism(piece, low, high) for piece in polygons(strip))

    def _jaw(self) -> list[Part]:
        parts = self._tine() if self.count > 2 else self._shell() if self.plates else self._tongs()
        return [*parts, self._lever()]

    def _shell(self) -> list[Part]:
        hl, t, line = self.half_y, 0.012 + 0.01 * self.size, self.curve
        parts = [self._part("back", self._band(0.0, t, -hl, hl), BARE.shell)]
        if self._chance(0.8):
            side = shapely.Polygon([*map(tuple, line), (GAP_M, self._share(0.5, 1.0) * self.depth)]).buffer(0)
            side = side.intersection(shapely.box(GAP_M, -9.0, 9.0, 9.0))
            parts.append(self._part("sides", shapes.mirrored_y(join(prism(p, hl - t, hl) for p in polygons(side))),
                                    BARE.shell))  # fmt: skip
        if self._chance(0.5):
            ribs = self._band(t - 0.003, t + self.size * self._share(0.03, 0.12), -0.015, 0.015, 2, 16)
            parts.append(self._part("ribs", shapes.at_y(ribs, *np.linspace(-0.9, 0.9, self.rng.integers(2, 9)) * hl)))
        if self._chance(0.5):
            first = int(self.rng.integers(3, 13))
            parts.append(self._part("belt", self._band(t - 0.003, t + 0.06 * self.size, -hl, hl, first, first + 3)))
        if self._chance(0.7):
            parts.append(self._part("lips", self._band(-0.008, t + 0.03, -hl - 0.01, hl + 0.01, 0, 4), BARE.lip))
        if self._chance(0.3):
            (w, top), inner = line[-1], self._share(0.3, 0.7)
            roof = shapely.LineString([(w, top), (inner * w, top + self._share(0.0, 0.3) * self.size)])
            parts.append(self._part("roof", prism(roof.buffer(t, cap_style="flat"), -hl, hl)))
        return parts

    def _tongs(self) -> list[Part]:
        """Curved bars side by side, joined across."""
        hl, wide = self.half_y, self.size * self._share(0.03, 0.10)
        bar = self._band(0.0, self.size * self._share(0.06, 0.22), -wide, wide)
        across = [rod((r, -hl, z), (r, hl, z), self.size * self._share(0.03, 0.08))
                  for r, z in self.curve[self.rng.integers(6, 17, self.rng.integers(1, 4))]]  # fmt: skip
        return [
            self._part("bars", shapes.at_y(bar, *np.linspace(-hl, hl, int(self.rng.integers(2, 7)))), BARE.shell),
            self._part("across", join(across)),
        ]

    def _tine(self) -> list[Part]:
        t, sector = 0.014 + 0.006 * self.size, np.pi / self.count
        wide, share = self.size * self._share(0.06, 0.2), self._share(0.4, 0.98)

        def half_angle(r: Array, z: Array) -> Array:  # noqa: ARG001
            closed = sector - np.arcsin(np.minimum(GAP_M / r, 0.5))
            if self.plates:
                return np.asarray(share * closed)
            return np.asarray(np.minimum(np.arcsin(np.minimum(wide / r, 1.0)), 0.9 * closed))

        around = np.linspace(-1, 1, 9)
        high = self.size * self._share(0.04, 0.16)
        half = self.size * self._share(0.02, 0.07)
        parts = [
            self._part("back", kit.petal(self.curve, 0.0, t, half_angle, around), BARE.shell),
            self._part("spine", self._band(t - 0.003, t + high, -half, half, 1), BARE.shell),
            self._part("tip", self._band(-0.004, t + 0.8 * high, -1.2 * half, 1.2 * half, 0, 5), BARE.lip),
        ]
        if self._chance(0.4):
            r, z = self.curve[self.rng.integers(8, 16)]
            reach = max(r * np.tan(0.7 * sector), 0.05)
            parts.append(self._part("belt", rod((r, -reach, z), (r, reach, z), 0.04 * self.size + 0.01)))
        return parts

    def _lever(self) -> Part:
        """Plates from the jaw's rim to its hinge, and at times beyond."""
        (hx, hz), line, u = self.hinge, self.curve, self.size
        eye = u * self._share(0.06, 0.16)
        foot = shapely.MultiPoint(line[[-1, -int(self.rng.integers(3, 9))]])
        plates = [hull(circle(hx, hz, eye), foot)]
        if self._chance(0.4):
            room = self.head_z[0] - hz
            end = hx + self._share(-1.2, 0.6) * self.half, hz + self._share(0.1, 0.9) * room
            plates.append(hull(circle(hx, hz, eye), circle(*end, 0.6 * eye)))
        thick = 0.015 + 0.015 * u
        plate = join(prism(piece, -thick, thick) for piece in polygons(shapely.union_all(plates)))
        at = self.jaw_y if self.count == 2 else (-0.05 * u, 0.05 * u)
        pins = pin(hx, hz, min(at) - 2 * thick, max(at) + 2 * thick, 0.5 * eye)
        return self._part("lever", join([shapes.at_y(plate, *at), pins]))

    def _strut(self) -> tuple[list[Part], Cylinder | None]:
        """Return cylinders or bars from the head to a jaw, and how they turn; none for some grabs."""
        hx, hz = self.hinge
        r, z = self.curve[self.rng.integers(8, 17)]
        start = self._share(0.0, 1.0) * self.head_half[0], self.head_z[0] + self._share(0.0, 0.05) * self.size
        wanted, radius, stem = self._chance(0.7), self.size * self._share(0.025, 0.09), self._share(0.4, 1.0)
        length = float(np.hypot(r - start[0], z - start[1]))
        if not wanted or length < 0.3:
            return [], None
        cylinder = Cylinder(self.hinge, start, (float(r - hx), float(z - hz)))
        a, b = np.array([start[0], 0.0, start[1]]), np.array([r, 0.0, z])
        middle = a + 0.6 * (b - a)
        one = join([rod(a, middle, radius, 12), rod(middle, b, stem * radius, 12)])
        at = self.jaw_y if self.count == 2 else (0.0,)
        return [self._part("strut", shapes.at_y(one, *at))], cylinder

    def _vessel(self) -> list[Part]:
        """Return a closed vessel: bowl, drum, cone, box, or anything between."""
        sides = int(self.rng.choice([4, 4, 6, 8, 16, 24]))
        heights = np.sort(self.rng.random(int(self.rng.integers(1, 5)))) * self.depth
        heights = np.concatenate([[0.0], heights, [self.depth]])
        heights = np.maximum.accumulate(heights + 0.01 * np.arange(len(heights)))
        radii = self.half * self.rng.uniform(0.35, 1.0, len(heights))
        parts = [self._part("vessel", self._turned([(0.01, 0.0), *zip(radii, heights, strict=True),
                                                     (0.01, float(heights[-1]))], sides), BARE.shell)]  # fmt: skip
        for i in range(int(self.rng.integers(0, 4))):
            z, high = self._share(0.05, 0.9) * self.depth, self.size * self._share(0.03, 0.15)
            r = float(np.interp(z + high / 2, heights, radii)) + self.size * self._share(0.01, 0.1)
            parts.append(self._part(f"ring_{i}", self._turned([(0.01, z), (r, z), (r, z + high), (0.01, z + high)],
                                                               sides), BARE.hazard))  # fmt: skip
        return parts

    def _turned(self, outline: Sequence[tuple[float, float]], sides: int) -> trimesh.Trimesh:
        """Turn an outline (r, z) about the axis, as wide along y as the vessel is; four sides stand square."""
        mesh = trimesh.creation.revolve(np.array([*outline, outline[0]], float), sections=sides)
        if mesh.volume < 0:
            mesh.invert()
        if sides == 4:
            mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 4, (0, 0, 1)))
            mesh.apply_scale((2**0.5, 2**0.5, 1.0))
        mesh.apply_scale((1.0, self.half_y / self.half, 1.0))
        return shapes.solid(mesh.vertices, mesh.faces)

    # What joins head and jaws.

    def _middle(self) -> list[Part]:
        (x, y), top, u = self.head_half, self.head_z[0] + 0.02 * self.size, self.size
        low = self.hinge[1] if self.count else self.depth - 0.02
        foot = (
            max(self.hinge[0], 0.08 * u),
            (max(map(abs, self.jaw_y)) if self.count == 2 else self.hinge[0]) + 0.08 * u,
        )
        beam = block((-foot[0], -foot[1], low - 0.09 * u), (foot[0], foot[1], low + 0.09 * u), 0.01)
        parts = [self._part("beam", beam)] if self.count else []
        match int(self.rng.integers(5)):
            case 0:
                radius = min(x, y) * self._share(0.2, 0.9)
                parts.append(self._part("column", rod((0, 0, low), (0, 0, top), radius, 20)))
            case 1:
                w, d = x * self._share(0.2, 0.9), y * self._share(0.2, 0.9)
                parts.append(self._part("column", block((-w, -d, low), (w, d, top), 0.02)))
            case 2:
                posts = [rod((sx * 0.8 * foot[0], sy * 0.8 * foot[1], low), (sx * 0.8 * x, sy * 0.8 * y, top),
                             self.size * 0.05) for sx in (-1, 1) for sy in (-1, 1)]  # fmt: skip
                parts.append(self._part("posts", join(posts)))
            case 3:
                side = hull(shapely.box(-foot[0], low - 0.05, foot[0], low + 0.05), shapely.box(-x, top - 0.05, x, top))
                plate = prism(side, -0.012 - 0.01 * u, 0.012 + 0.01 * u)
                parts.append(self._part("plates", shapes.at_y(plate, -0.7 * y, 0.7 * y)))
            case _:
                turns = np.arange(int(self.rng.integers(3, 7)))
                ends = [((0.9 * foot[0] * c, 0.9 * foot[1] * s, low), (0.9 * x * c, 0.9 * y * s, top))
                        for c, s in ((np.cos(a), np.sin(a)) for a in turns * 2 * np.pi / len(turns))]  # fmt: skip
                parts.append(self._part("bars", join(rod(a, b, u * 0.04) for a, b in ends)))
        return parts

    # The head.

    def _head(self) -> list[Part]:
        (x, y), (low, high), u = self.head_half, self.head_z, self.size
        parts = [self._part("body", self._body())]
        for i in range(int(self.rng.integers(0, 7))):
            parts.append(self._part(f"thing_{i}", self._thing(), BARE.dark))
        if self._chance(0.2):
            corners = [(sx * x, sy * y) for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
            parts.append(Part("rail", kit.rail(corners, high - 0.02, self._share(0.3, 0.8)), self._coat(BARE.hazard)))
        if self._chance(0.15):
            parts.append(Part("ladder", kit.ladder(0.0, 0.17, y + 0.06, low - 0.4 * u, high), self._coat(BARE.hazard)))
        if self._chance(0.4):
            wide = 0.4 * x
            parts.append(
                kit.plate_part("number", (-wide, -0.9 * y, high - 0.01), (wide, -0.9 * y + wide, high + 0.012))
            )
        ends = self._ends()
        if self.keys.ropes == 1:
            parts.append(Part("shackle", kit.shackle(high, self._shackle_r), BARE.dark))
            return parts
        for i, end in enumerate(ends):
            guided = i % 2 == 1 and self.keys.ropes > 1
            parts.append(Part(f"end_{i}", kit.guide(end, 0.44) if guided else kit.socket(end, 0.44), BARE.dark))
        return parts

    def _body(self) -> trimesh.Trimesh:
        (x, y), (low, high), u = self.head_half, self.head_z, self.size
        match int(self.rng.integers(6)):
            case 0:
                wide = u * self._share(0.05, 0.16)
                beams = [((-x - wide, sy * y - wide), (x + wide, sy * y + wide)) for sy in (-1, 1)]
                beams += [((sx * x - wide, -y), (sx * x + wide, y)) for sx in (-1, 0, 1)]
                return join(block((*a, low), (*b, high)) for a, b in beams)
            case 1:
                return block((-x, -y, low), (x, y, high), 0.02)
            case 2:
                ring = [(0.01, low), (x, low), (x * self._share(0.6, 1.0), high), (0.01, high)]
                return self._turned(ring, int(self.rng.choice([6, 8, 24])))
            case 3:
                slope = hull(shapely.box(-x, low, x, low + 0.05), shapely.box(-0.5 * x, high - 0.05, 0.5 * x, high))
                return prism(slope, -y, y)
            case 4:
                gap = self._share(0.3, 0.9) * y
                plates = [block((-x, s * gap - 0.03 * u, low), (x, s * gap + 0.03 * u, high)) for s in (-1, 1)]
                ties = [rod((sx * 0.8 * x, -gap, 0.5 * (low + high)), (sx * 0.8 * x, gap, 0.5 * (low + high)), 0.05 * u)
                        for sx in (-1, 1)]  # fmt: skip
                return join([*plates, *ties, block((-0.4 * x, -gap, low), (0.4 * x, gap, high))])
            case _:
                cross = [block((-x, -0.2 * y, low), (x, 0.2 * y, high)), block((-0.2 * x, -y, low), (0.2 * x, y, high))]
                return join(cross)

    def _thing(self) -> trimesh.Trimesh:
        """Return a box, a drum, a sheave or a lug, that stands on the head or hangs at its side."""
        (x, y), (low, high), u = self.head_half, self.head_z, self.size
        at = np.array([self._share(-0.9, 0.9) * x, self._share(-0.9, 0.9) * y, high if self._chance(0.75) else low])
        half = u * self.rng.uniform(0.04, 0.28, 3)
        match int(self.rng.integers(4)):
            case 0:
                return block((at - half).tolist(), (at + half).tolist(), 0.01)
            case 1:
                way = np.eye(3)[self.rng.integers(3)]
                return rod(at - half * way, at + half * way, float(half.min()), 14)
            case 2:
                return shapes.sheave((at[0], at[1], at[2]), float(u * self._share(0.1, 0.25)), 0.017)
            case _:
                lug = hull(circle(0, 0.6 * half[2], half[0] / 2), shapely.box(-half[0], -half[2], half[0], 0))
                return prism(lug, -0.02, 0.02).apply_translation(at)

    @property
    def _shackle_r(self) -> float:
        return 0.07 + 0.06 * self.size

    def _ends(self) -> Array:
        height = 5.4 * self._shackle_r if self.keys.ropes == 1 else 0.42
        half = min(0.5 * self.head_half[0], 0.5), min(0.6 * self.head_half[1], 0.8)
        return kit.ends(self.keys.ropes, *half, self.head_z[1] + height)

    # What tells where it is, and what it holds.

    def _lips(self) -> dict[str, Array]:
        """Return ends of two shells' edges, tips of four tines, or of all three, each in its body's frame."""
        (hx, hz), count = self.hinge, self.count
        if count == 2:
            outer = np.array([(GAP_M - hx, self.half_y, -hz), (GAP_M - hx, -self.half_y, -hz)])
            return {"jaw_0": outer, "jaw_1": (outer * (-1.0, -1.0, 1.0))[::-1]}
        picked = sorted({round(k * count / 4) for k in range(4)}) if count > 3 else range(3)
        turns = {k: 2 * np.pi * k / count for k in picked}
        r = 0.012 - hx
        return {f"jaw_{k}": np.array([(r * np.cos(a), r * np.sin(a), -hz)]) for k, a in turns.items()}

    def _heaps(self) -> Heaps:
        if not (self.count and self.plates):
            return lambda _cargo, _rng: ()
        u, v = np.meshgrid(np.linspace(-1, 1, 33), np.linspace(-1, 1, 33), indexing="ij")
        if self.count > 2:
            u, v = u * np.sqrt(1 - v**2 / 2), v * np.sqrt(1 - u**2 / 2)  # a square on a disc
        along = self.half_y - 0.06
        r, z = np.maximum.accumulate(self.curve[:, 0]), np.maximum.accumulate(self.curve[:, 1])

        def make(cargo: str, rng: np.random.Generator) -> list[Part]:
            made = []
            for level in CARGO_LEVELS:
                shoulder = self.depth * (0.3 + 0.55 * level)
                edge = float(np.interp(shoulder, z, r)) - 2.5 * _CLEARANCE_M
                x, y = edge * u, (along if self.count == 2 else edge) * v
                out = np.hypot(u, v) if self.count > 2 else np.maximum(np.abs(u), np.abs(v))
                rho = np.hypot(x, y) if self.count > 2 else np.abs(x)
                floor = np.interp(rho, r - _CLEARANCE_M, z) + _CLEARANCE_M
                rough = kit.lumps(rng, u.shape, kit.LUMPS_M.get(cargo, 0.0)) * (1 - out**4)
                crest = shoulder + 0.14 * self.depth * (1 - out**1.7) + rough
                low = np.minimum(floor, crest - 0.02)
                made.append(kit.heap(*(np.stack([x, y, at], axis=-1) for at in (crest, low))))
            return kit.heap_parts(made, cargo)

        return make
