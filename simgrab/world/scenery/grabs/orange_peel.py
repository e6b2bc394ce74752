"""Orange-peel grabs: tines round a vertical axis, closed by ropes through a lower block or by hydraulic cylinders.

Proportions are those of no one maker's grab. The diameter of the closed grab is about four fifths of its height, and
the tines are as deep as they reach outwards, as pictures of rope and of hydraulic grabs show them. The mass follows
from the drawn steel: about 0.9 t for each m³ of rope grabs of 6 m³ with closed shells.

All is drawn in the plane of one tine, (r, z), with its tip at z = 0, and turned to the tine's azimuth.
"""

from __future__ import annotations

import numpy as np
import shapely
import trimesh

from simgrab.model.geometry import Array
from simgrab.model.scenario.grab import OrangePeel
from simgrab.world.scenery.grabs import kit
from simgrab.world.scenery.grabs.design import Body, Design, Heaps, no_heaps
from simgrab.world.scenery.grabs.kit import Scale
from simgrab.world.scenery.grabs.slider_crank import Cylinder, SliderCrank
from simgrab.world.scenery.meshes import shapes
from simgrab.world.scenery.meshes.paint import BARE
from simgrab.world.scenery.meshes.part import Part
from simgrab.world.scenery.meshes.shapes import circle, hull, join, pin, prism

MAX_JAW = np.radians(58.0)

# In units of `Scale`: the tine's inside from tip to rim, and pins.
_CURVE = ((0.0, 0.0), (0.62, 0.10), (1.02, 0.62), (0.97, 1.22))
_HINGE = (0.30, 1.52)  # above the rims, which therefore move outwards before they move inwards
_HEAD_PIN = (0.34, 2.36)
_JAW_PIN = (0.60, 0.10)  # from the hinge
_CYLINDER_HEAD_PIN = (0.26, 2.40)
_CROWN = (2.24, 2.46)
_SHEAVE_R = 0.15
_GAP_M = 0.005  # half the gap between closed tines
_CLEARANCE_M = 0.02


def orange_peel(keys: OrangePeel) -> Design:
    """Return the design of an orange-peel grab."""
    return _Peel(keys).design()


class _Peel:
    def __init__(self, keys: OrangePeel) -> None:
        self.keys = keys
        line = kit.curve(_CURVE, 60)
        self.scale = s = Scale.of(keys, float(np.trapezoid(np.pi * line[:, 0] ** 2, line[:, 1])), round_=True)
        self.curve = kit.curve([s.at(*point) for point in _CURVE])
        self.plate = 0.014 + 0.004 * s.mean
        self.azimuths = [(k + 0.5) * 2 * np.pi / keys.tines for k in range(keys.tines)]
        self.hinge, self.head_pin = s.at(*_HINGE), s.at(*_HEAD_PIN)
        self.jaw_pin = s.at(*_JAW_PIN)
        self.tine_pin = self.hinge[0] + self.jaw_pin[0], self.hinge[1] + self.jaw_pin[1]
        reach = 0.24 * s.x
        self.sheave_y = (-reach, -reach + 0.08, reach - 0.08, reach)
        self.sheave_r, self.sheave_z = _SHEAVE_R * min(s.x, s.z) * 0.9, _CROWN[0] * s.z + 0.02

    def design(self) -> Design:
        design = self._hydraulic() if self.keys.drive == "hydraulic" else self._roped()
        return kit.standing(design, self.keys.volume_m3)

    def _roped(self) -> Design:
        crank = SliderCrank(self.hinge, self.head_pin, self.jaw_pin)
        hx, hz = self.hinge
        beam = kit.placed(self._beam(), (0, 0, hz))
        bodies = [
            kit.body("head", self._head()),
            kit.body("beam", beam, "head", (0.0, 0.0, hz), (0.0, 0.0, 1.0), slides=True),
            *self._round("tine", self._tine(), "beam", (hx, 0.0), self.hinge),
            *self._round("rod", self._rod(), "head", self.head_pin, self.head_pin),
        ]
        count = self.keys.tines

        def positions(jaw: float) -> dict[str, float]:
            state = crank.at(jaw)
            turns = {f"tine_{k}": state.jaw_angle for k in range(count)}
            return {"beam": state.beam_z - hz} | turns | {f"rod_{k}": state.arm_angle for k in range(count)}

        ropes = self._ends()
        r, low = self.sheave_r, 0.11 * self.scale.z
        falls = [((x, y, self.sheave_z), (x, y, low)) for x in (-r, r) for y in self.sheave_y]
        return Design(
            bodies, positions, kit.widest(crank.at, MAX_JAW), ropes, kit.closing(len(ropes)), np.array(falls),
            lips=kit.tips("tine", self.azimuths, self.hinge), heaps=self._heaps(),
        )  # fmt: skip

    def _hydraulic(self) -> Design:
        cylinder = Cylinder(self.hinge, self.scale.at(*_CYLINDER_HEAD_PIN), self.jaw_pin)
        px, pz = cylinder.head_pin
        end = np.subtract(self.tine_pin, cylinder.head_pin)
        along = end / np.linalg.norm(end)
        bodies = [
            kit.body("head", [*self._head(), self._column(), *self._beam()]),
            *self._round("tine", self._tine(), "head", self.hinge, self.hinge),
        ]
        barrel, piston = kit.cylinder_parts(cylinder, 0.055 * self.scale.mean + 0.02, (0.8, 0.75), 0.05, MAX_JAW, 0.0)
        for k, azimuth in enumerate(self.azimuths):
            bodies.append(kit.hinged(f"barrel_{k}", barrel, "head", azimuth, (px, pz), (px, pz)))
            c, s = np.cos(azimuth), np.sin(azimuth)
            axis = (float(along[0] * c), float(along[0] * s), float(along[1]))
            own = kit.placed(kit.turned(piston, azimuth), (px * c, px * s, pz))
            bodies.append(kit.body(f"piston_{k}", own, f"barrel_{k}", (0.0, 0.0, 0.0), axis, slides=True))
        count = self.keys.tines

        def positions(jaw: float) -> dict[str, float]:
            angle, out = cylinder.at(jaw)
            turns = {f"tine_{k}": -jaw for k in range(count)} | {f"barrel_{k}": angle for k in range(count)}
            return turns | {f"piston_{k}": out for k in range(count)}

        lips = kit.tips("tine", self.azimuths, self.hinge)
        return Design(bodies, positions, float(MAX_JAW), self._ends(), lips=lips, heaps=self._heaps())

    def _round(
        self, name: str, parts: list[Part], parent: str, pin: tuple[float, float], origin: tuple[float, float]
    ) -> list[Body]:
        """Make a body for each tine, as `hinged` does."""
        return [kit.hinged(f"{name}_{k}", parts, parent, at, pin, origin) for k, at in enumerate(self.azimuths)]

    # The tine, in the plane y = 0.

    def _half_angle(self, r: Array, z: Array) -> Array:
        """Half of the angle that a tine's plate covers, by radius and height."""
        sector = np.pi / self.keys.tines - np.arcsin(np.minimum(_GAP_M / r, 0.5))
        if self.keys.shells == "closed":
            return np.asarray(sector)
        rise = np.clip(z / self.curve[-1, 1], 0.0, 1.0)
        if self.keys.shells == "half":
            return np.asarray(sector * (0.45 + 0.35 * rise))
        return np.asarray(np.minimum(np.arcsin(np.minimum(0.11 * self.scale.x / r, 1.0)), 0.8 * sector))

    def _patch(self, inner: float, outer: float, share: float = 1.0) -> trimesh.Trimesh:
        """Plate of revolution between two offsets of the curve."""
        around = np.linspace(-share, share, 9 if self.keys.tines > 4 else 13)
        return kit.petal(self.curve, inner, outer, self._half_angle, around)

    def _tine(self) -> list[Part]:
        keys, s, t = self.keys, self.scale, self.plate
        (hx, hz), (px, pz), top = self.hinge, self.tine_pin, float(self.curve[-1, 1])
        spine_h = (0.10 if keys.shells == "open" else 0.07) * s.mean
        half = 0.030 * s.mean + (0.02 if keys.shells == "open" else 0.0)
        eye, lug, thick = 0.075 * s.mean + 0.02, 0.06 * s.mean + 0.03, 0.02 + 0.006 * s.mean
        outside = kit.offset(self.curve, t)
        spine = kit.strip(self.curve, (t - 0.003, t + spine_h), (-half, half), 1)
        cheek = shapely.union_all(
            [
                hull(circle(hx, hz, eye), circle(px, pz, lug)),
                hull(circle(px, pz, lug), shapely.Point(outside[-1]), shapely.Point(outside[-6])),
                hull(circle(hx, hz, eye), shapely.Point(self.curve[-1]), shapely.Point(self.curve[-4])),
            ]
        )
        apart = 0.06 * s.mean + 0.02
        cheeks = [prism(cheek, o - thick / 2, o + thick / 2) for o in (-apart, apart)]
        cross = [
            pin(hx, hz, -apart - 0.03, apart + 0.03, 0.6 * eye),
            pin(px, pz, -apart - 0.03, apart + 0.03, 0.5 * lug, 0.012),
        ]
        tip = self._tip(spine_h, half)
        parts = [
            kit.wrap("back", self._patch(0.0, t), BARE.shell, top=top, around=2.4 * s.x),
            kit.wrap("lining", self._patch(-0.005, -0.0005, 0.97), BARE.lining, top=top, around=2.4 * s.x),
            kit.wrap("spine", spine, BARE.shell, top=top, around=2.4 * s.x),
            Part("cheeks", join(cheeks), BARE.body),
            Part("tip", tip, BARE.lip),
            Part("pins", join(cross), BARE.dark),
        ]
        if keys.shells != "open":
            parts.append(Part("rim", self._belt(-2, 0.05 * s.mean), BARE.body))
        if ribs := round(3 * keys.plate_work) if keys.shells != "open" else 0:
            places = np.linspace(4, 13, ribs + 2)[1:-1].round().astype(int)
            parts.append(Part("belts", join(self._belt(int(i), 0.035 * s.mean) for i in places), BARE.body))
        if keys.markings:
            mark = kit.strip(self.curve, (t + spine_h - 0.002, t + spine_h + 0.006), (-half, half), 10, 14)
            parts.append(Part("mark", mark, BARE.hazard))
        return parts

    def _belt(self, index: int, height: float) -> trimesh.Trimesh:
        """Flat bar across a tine's back at one of the curve's points."""
        t, line = self.plate, self.curve
        low, high = (kit.offset(line, d)[index] for d in (t - 0.003, t + height))
        angle = float(self._half_angle(np.maximum(line[index, :1], 0.012), line[index, 1:])[0]) * 0.96
        around = np.linspace(-angle, angle, 7)
        along = np.gradient(line, axis=0)[index]
        thick = (0.016 + 0.008 * self.scale.mean) * (along / np.linalg.norm(along))
        r, z = np.stack([low, low + thick, high, high + thick], axis=1)[..., None]
        edges = np.stack([r * np.cos(around), r * np.sin(around), np.broadcast_to(z, (4, 7))], axis=-1)
        return shapes.outward(kit.heap(edges[2:], edges[:2]))

    def _tip(self, height: float, half: float) -> trimesh.Trimesh:
        """Cast tip on the lower end of a tine; with teeth it is longer and pointed."""
        reach = 5 if self.keys.teeth else 4
        line = self.curve[: reach + 1]
        offsets = (-0.003, self.plate + height)
        lower, upper = (kit.offset(self.curve, distance)[: reach + 1] for distance in offsets)
        share = np.linspace(0.25 if self.keys.teeth else 0.5, 1.0, reach + 1)[:, None]
        upper = lower + (upper - lower) * share
        room = 0.8 * np.maximum(line[:, 0], 0.012) * np.tan(np.pi / self.keys.tines)
        width = np.minimum(half * (1.35 if self.keys.teeth else 1.2), room)
        low, high = (
            np.stack([np.stack([np.maximum(ring[:, 0], 0.012), side * width, np.maximum(ring[:, 1], floor)], axis=-1)
                      for side in (-1, 1)], axis=1)
            for ring, floor in ((lower, 0.0), (upper, 0.004))
        )  # fmt: skip
        return shapes.outward(kit.heap(high, low))

    def _rod(self) -> list[Part]:
        """Rod between head and tine, closed."""
        ends, s = (self.head_pin, self.tine_pin), self.scale.mean
        eye, half = 0.05 * s + 0.025, 0.022 * s + 0.012
        plate = prism(kit.link(*ends, eye, 0.6), -half, half)
        pins = join(pin(*end, -half - 0.03, half + 0.03, 0.5 * eye, 0.012) for end in ends)
        return [Part("rod", plate, BARE.body), Part("rod_pins", pins, BARE.dark)]

    # Head and lower block, round the axis.

    def _ends(self) -> Array:
        half = 0.17 * self.scale.x
        return kit.ends_over(self.keys.ropes, half, 1.4 * half, _CROWN[1] * self.scale.z, self.scale.mean)

    def _head(self) -> list[Part]:
        keys, s = self.keys, self.scale
        low, high = (z * s.z for z in _CROWN)
        radius, thick = 0.40 * s.x, 0.03 + 0.008 * s.mean
        sides = 4 if keys.tines == 4 else 24
        deck, reach = _ngon(radius, sides), 1.25 * self.sheave_r
        if keys.drive == "ropes":
            openings = [shapely.box(-reach, y - 0.035, reach, y + 0.035) for y in self.sheave_y]
            deck = deck.difference(shapely.union_all(openings))
        floor = _ngon(radius, sides).difference(_ngon(0.62 * radius, sides))
        ring = _ngon(0.93 * radius, sides).difference(_ngon(0.93 * radius - thick, sides))
        parts = [
            Part("deck", prism(deck, high - thick, high, "z"), BARE.body),
            Part("floor", prism(floor, low, low + thick, "z"), BARE.body),
            Part("drum", prism(ring, low, high, "z"), BARE.body),
            Part("head_lugs", self._lugs(), BARE.body),
        ]
        roped = keys.drive == "ropes"
        if keys.ropes == 1:
            parts.append(Part("shackle", kit.shackle(high, kit.shackle_radius(self.scale.mean)), BARE.dark))
        else:
            parts += kit.holders(self._ends(), roped, 0.40, 0.42)
        if roped:
            parts += self._sheaves(self.sheave_z, 0.30 * s.x)
        else:
            tank = prism(_ngon(0.30 * s.x, 16), high - 0.01, high + 0.16 * s.z, "z")
            motor = shapes.block((0.05 * s.x, -0.12 * s.x, high), (0.36 * s.x, 0.12 * s.x, high + 0.10 * s.z), 0.01)
            parts += [Part("tank", tank, BARE.body), Part("motor", motor, BARE.dark)]
        if keys.markings:
            at = 0.30 * radius
            if roped:
                edge = -radius * 0.86
                parts.append(kit.plate_part("number", (-0.8 * at, edge, high - 0.002),
                                            (0.8 * at, edge + 0.6 * at, high + 0.010)))  # fmt: skip
            belt = _ngon(0.93 * radius + 0.008, sides).difference(_ngon(0.93 * radius - 0.01, sides))
            low_edge, high_edge = (low + share * (high - low) for share in (0.3, 0.7))
            parts.append(Part("belt", prism(belt, low_edge, high_edge, "z"), BARE.hazard))
        corners = [(0.97 * radius * np.cos(a), 0.97 * radius * np.sin(a)) for a in np.arange(8) * np.pi / 4]
        return parts + kit.access(keys, corners, high, 0.5, (radius * 0.93 + 0.05, low - 0.05, high))

    def _lugs(self) -> trimesh.Trimesh:
        (ax, az), s = (self.head_pin if self.keys.drive == "ropes" else self.scale.at(*_CYLINDER_HEAD_PIN)), self.scale
        eye, apart, thick = 0.06 * s.mean + 0.03, 0.03 * s.mean + 0.03, 0.018 + 0.006 * s.mean
        low, high = (z * s.z for z in _CROWN)
        foot = shapely.box(0.30 * s.x, low + 0.02, 0.38 * s.x, high - 0.03)
        lug = hull(circle(ax, az, eye), foot)
        return self._at_tines(join(prism(lug, o - thick / 2, o + thick / 2) for o in (-apart, apart)))

    def _column(self) -> Part:
        """Column of a hydraulic grab, from the head down to the tines' hinges."""
        s = self.scale
        tube = prism(_ngon(0.17 * s.x, 20), _HINGE[1] * s.z, _CROWN[0] * s.z + 0.02, "z")
        return Part("column", tube, BARE.body)

    def _beam(self) -> list[Part]:
        """Lower block with the tines' hinges, where it is in the closed grab."""
        s, (hx, hz) = self.scale, self.hinge
        thick, radius = 0.03 + 0.008 * s.mean, 0.62 * hx
        hub = prism(_ngon(radius, 24), hz - 0.10 * s.z, hz + 0.08 * s.z, "z")
        eye, apart = 0.06 * s.mean + 0.02, 0.035 * s.mean + 0.008
        lug = hull(circle(hx, hz, eye), shapely.box(0.4 * hx, hz - 0.09 * s.z, 0.6 * hx, hz + 0.07 * s.z))
        lugs = self._at_tines(join(prism(lug, o - thick / 4, o + thick / 4) for o in (-apart, apart)))
        parts = [Part("hub", hub, BARE.body), Part("lugs", lugs, BARE.body)]
        if self.keys.drive == "ropes":
            z = hz + 0.11 * s.z
            foot = shapely.box(-0.5 * radius, hz, 0.5 * radius, hz + 0.05 * s.z)
            cheek = hull(circle(0.0, z, 0.6 * self.sheave_r), foot)
            places = (-0.29 * s.x, 0.29 * s.x, self.sheave_y[1] + 0.06, self.sheave_y[2] - 0.06)
            plates = join(prism(cheek, y - 0.008, y + 0.008) for y in places)
            parts += [*self._sheaves(z, 0.29 * s.x), Part("plates", plates, BARE.body)]
        return parts

    def _sheaves(self, z: float, half: float) -> list[Part]:
        """Sheaves at a height, on a shaft that reaches ``half`` to either side."""
        wheels = join(shapes.sheave((0.0, y, z), self.sheave_r, 0.016) for y in self.sheave_y)
        shaft = pin(0.0, z, -half, half, 0.04 + 0.01 * self.scale.mean)
        return [Part("sheaves", wheels, BARE.dark), Part("shaft", shaft, BARE.dark)]

    def _at_tines(self, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
        """Repeat a mesh at the azimuth of every tine."""
        part = Part("", mesh, BARE.body)
        return join(kit.turned([part], azimuth)[0].mesh for azimuth in self.azimuths)

    def _heaps(self) -> Heaps:
        if self.keys.shells == "open":
            return no_heaps
        line, top = self.curve, float(self.curve[-1, 1])
        grid = np.linspace(-1.0, 1.0, 41)
        u, v = np.meshgrid(grid, grid, indexing="ij")
        x, y = u * np.sqrt(1 - v**2 / 2), v * np.sqrt(1 - u**2 / 2)  # a square on a disc
        rho = np.minimum(np.hypot(x, y), 1.0)

        def form(level: float) -> tuple[Array, ...]:
            shoulder = top * (0.28 + 0.62 * level ** (1 / 1.5))
            edge = float(np.interp(shoulder, line[:, 1], line[:, 0])) - 2 * _CLEARANCE_M
            return edge * x, edge * y, edge * rho, shoulder + 0.16 * top * (1 - rho**1.7), 1 - rho**4

        return kit.heaps(line, _CLEARANCE_M, form)


def _ngon(radius: float, sides: int) -> shapely.Polygon:
    """Regular polygon round the axis, of this inner radius where it has few sides."""
    angle = (np.arange(sides) + 0.5) * 2 * np.pi / sides
    reach = radius / np.cos(np.pi / sides)
    return shapely.Polygon(np.stack([reach * np.cos(angle), reach * np.sin(angle)], axis=1))
