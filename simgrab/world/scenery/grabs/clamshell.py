"""Clamshell grabs of any size: rope-closed by a sliding beam and arms, single-rope, or hydraulic.

Plates, pins, sheaves and sockets have sizes of their own, which grow more slowly than the grab. The mass follows from
the drawn steel.

All is drawn closed, with the lips at z = 0; the outer shell is at +x.
"""

from __future__ import annotations

import numpy as np
import shapely
import trimesh

from simgrab.model.geometry import Array
from simgrab.model.scenario.grab import Clamshell
from simgrab.world.scenery.grabs import kit
from simgrab.world.scenery.grabs.design import Design
from simgrab.world.scenery.grabs.shells import GAP_M, HALF_TURN, Shells, polygons
from simgrab.world.scenery.grabs.slider_crank import Cylinder, SliderCrank
from simgrab.world.scenery.meshes import shapes
from simgrab.world.scenery.meshes.paint import BARE
from simgrab.world.scenery.meshes.part import Part
from simgrab.world.scenery.meshes.shapes import block, circle, hull, join, pin, prism, rod, rounded

MAX_JAW = np.radians(57.0)

# In units of `Scale`.
_HINGE = (0.123, 1.073)
_SHELL_PIN = (0.816, -0.024)  # from the hinge
_HEAD_PIN = (0.448, 1.652)
_CYLINDER_PIN = (0.20, 1.72)
_ARM_Y = 0.66
_GIRDER = (1.56, 1.78)


def clamshell(keys: Clamshell, *, ropes_m: tuple[float, float] | None = None) -> Design:
    """Return the design of a clamshell grab; ``ropes_m`` is half the spread of its ropes along x and y, if given."""
    return _Clam(keys, ropes_m).design()


class _Clam(Shells):
    keys: Clamshell

    def __init__(self, keys: Clamshell, ropes_m: tuple[float, float] | None) -> None:
        super().__init__(keys, _HINGE)
        s = self.scale
        self.head_pin, self.shell_pin = s.at(*_HEAD_PIN), s.at(*_SHELL_PIN)
        self.far_pin = self.hinge[0] + self.shell_pin[0], self.hinge[1] + self.shell_pin[1]
        self.arm_y = (-_ARM_Y * s.y, _ARM_Y * s.y) if keys.arms == 4 or keys.drive == "hydraulic" else (0.0,)
        self.beam_sheave_z, self.sheave_z = self.hinge[1] + 0.10 * s.z, 1.66 * s.z
        self.deck_z = _GIRDER[1] * s.z + 0.02
        self.sheave_r = 0.10 + 0.07 * s.mean
        self.sheave_y = tuple(side * 0.34 * s.y + o for side in (-1, 1) for o in (-0.055, 0.055))
        self.lugs_apart = 0.05 * s.mean + 0.02
        self.ropes_m = ropes_m or (max(0.9 * self.sheave_r, 0.14), 0.34 * s.y)

    def design(self) -> Design:
        design = self._hydraulic() if self.keys.drive == "hydraulic" else self._roped()
        return kit.standing(design, self.keys.volume_m3)

    def _roped(self) -> Design:
        crank = SliderCrank(self.hinge, self.head_pin, self.shell_pin)
        hx, hz = self.hinge
        beam = kit.placed(self._beam(), (0.0, 0.0, hz))
        bodies = [
            kit.body("head", self._head()),
            kit.body("beam", beam, "head", (0.0, 0.0, hz), (0.0, 0.0, 1.0), slides=True),
            *self.pair("shell", self._shell(), "beam", (hx, 0.0), self.hinge),
            *self.pair("arms", self._arms(), "head", self.head_pin, self.head_pin),
        ]

        def positions(jaw: float) -> dict[str, float]:
            state = crank.at(jaw)
            return {
                "beam": state.beam_z - hz,
                "shell_outer": state.jaw_angle, "shell_inner": -state.jaw_angle,
                "arms_outer": state.arm_angle, "arms_inner": -state.arm_angle,
            }  # fmt: skip

        ropes = self._ends()
        r = 0.9 * self.sheave_r
        falls = [((x, y, self.sheave_z), (x, y, self.beam_sheave_z - hz)) for y in self.sheave_y for x in (-r, r)]
        return Design(
            bodies, positions, kit.widest(crank.at, MAX_JAW), ropes, kit.closing(len(ropes)), np.array(falls),
            lips=self.lips(), heaps=self.heaps(),
        )  # fmt: skip

    def _hydraulic(self) -> Design:
        cylinder = Cylinder(self.hinge, self.scale.at(*_CYLINDER_PIN), self.shell_pin)
        start, end = np.array(cylinder.head_pin), np.array(self.far_pin)
        along = (end - start) / np.linalg.norm(end - start)
        axis = (float(along[0]), 0.0, float(along[1]))
        radius = 0.05 * self.scale.mean + 0.025
        barrel, piston = kit.cylinder_parts(cylinder, radius, (0.82, 0.75), 0.06, MAX_JAW, *self.arm_y)
        bodies = [
            kit.body("head", [*self._head(), self._column(), *self._beam()]),
            *self.pair("shell", self._shell(), "head", self.hinge, self.hinge),
            *self.pair("barrel", barrel, "head", cylinder.head_pin, cylinder.head_pin),
        ]
        own = kit.placed(piston, (start[0], 0.0, start[1]))
        bodies += [
            kit.body("piston_outer", own, "barrel_outer", axis=axis, slides=True),
            kit.body("piston_inner", [p.moved(HALF_TURN) for p in own], "barrel_inner",
                     axis=(-axis[0], 0.0, axis[2]), slides=True),
        ]  # fmt: skip

        def positions(jaw: float) -> dict[str, float]:
            angle, out = cylinder.at(jaw)
            return {
                "shell_outer": -jaw, "shell_inner": jaw, "barrel_outer": angle, "barrel_inner": -angle,
                "piston_outer": out, "piston_inner": out,
            }  # fmt: skip

        return Design(bodies, positions, float(MAX_JAW), self._ends(), lips=self.lips(), heaps=self.heaps())

    # The outer shell.

    def _shell(self) -> list[Part]:
        lugs, pins = Part("lugs", self._shell_lugs(), BARE.body), Part("pins", self._shell_pins(), BARE.dark)
        return [*self.shell(), lugs, pins]

    def outline(self) -> shapely.Polygon:
        """Return the side plate's outline, with the ear that hangs on the pin."""
        (hx, hz), (w, top) = self.hinge, self.curve[-1]
        foot = shapely.box(0.05 * w, 0.84 * top, 0.28 * w, 0.88 * top)
        ear = hull(circle(hx, hz, 0.08 * self.scale.mean + 0.02), foot)
        return shapely.union_all([super().outline(), ear]).intersection(shapely.box(GAP_M, -1.0, 9.0, 9.0))

    def _shell_lugs(self) -> trimesh.Trimesh:
        w, top = self.curve[-1]
        foot = shapely.Polygon([(w, 0.70 * top), (w, 0.97 * top), (0.80 * w, 0.96 * top), (0.88 * w, 0.80 * top)])
        ear = pin(*self.hinge, self.half_y - 0.05, self.half_y + 0.03, 0.06 * self.scale.mean + 0.02)
        return join([self._lugs(*self.far_pin, foot), shapes.mirrored_y(ear)])

    def _lugs(self, x: float, z: float, foot: shapely.Polygon) -> trimesh.Trimesh:
        """Lugs on either side of every arm, round a point and welded to ``foot``."""
        eye, apart = 0.05 * self.scale.mean + 0.03, self.lugs_apart
        lug = join([prism(hull(circle(x, z, eye), foot), -0.012, 0.012), pin(x, z, -0.02, 0.02, 0.7 * eye)])
        return shapes.at_y(lug, *(y + o for y in self.arm_y for o in (-apart, apart)))

    def _shell_pins(self) -> trimesh.Trimesh:
        m, (px, pz) = self.scale.mean, self.far_pin
        apart, radius = 0.05 * m + 0.035, 0.022 * m + 0.012
        hinge = shapes.mirrored_y(pin(*self.hinge, self.half_y - 0.10, self.half_y + 0.05, 0.03 * m + 0.02, 0.02))
        return join([hinge, shapes.at_y(pin(px, pz, -apart, apart, radius, 0.014), *self.arm_y)])

    # Arms or cylinders, closed.

    def _arms(self) -> list[Part]:
        m, start, end = self.scale.mean, self.head_pin, self.far_pin
        eye, half = 0.045 * m + 0.025, 0.035 * m + 0.012
        wide = 2.6 if self.keys.arms == 2 else 1.0
        bar = hull(circle(*start, 0.8 * eye), circle(*end, 0.8 * eye))
        web = kit.link(start, end, eye, 0.8)
        inner = hull(circle(*start, 0.45 * eye), circle(*end, 0.45 * eye))
        flange = bar.difference(inner)
        flanges = [prism(part, -half * wide, half * wide) for part in polygons(flange)]
        bosses = [pin(x, z, -half, half, 1.02 * eye) for x, z in (start, end)]
        arm = join([prism(web, -0.012, 0.012), *flanges, *bosses])
        parts = [Part("arms", shapes.at_y(arm, *self.arm_y), BARE.body)]
        if len(self.arm_y) == 2:
            x, z = (0.5 * (a + b) for a, b in zip(start, end, strict=True))
            parts.append(Part("tie", rod((x, self.arm_y[0], z), (x, self.arm_y[1], z), 0.03 * m + 0.012), BARE.body))
        return parts

    # Beam between the shells' pins, closed.

    def _beam(self) -> list[Part]:
        (hx, hz), s, m = self.hinge, self.scale, self.scale.mean
        web_x, end_y, t = 0.205 * s.x, self.half_y - 0.06, 0.010 + 0.008 * m
        low, high = hz - 0.10 * s.z, hz + 0.115 * s.z
        knee, below, above = hz + 0.08 * s.z, 0.75 * end_y, 0.7 * end_y
        side = [(-end_y, low + 0.03), (-below, low), (below, low), (end_y, low + 0.03)]
        side += [(end_y, knee), (above, high), (-above, high), (-end_y, knee)]
        web = prism(shapely.Polygon(side), web_x - t, web_x, "x")
        flange = block((web_x - 0.01, -above, high - 0.012), (web_x + 0.05 * s.x, above, high + 0.006))
        foot = block((web_x - 0.01, -below, low - 0.006), (web_x + 0.04 * s.x, below, low + 0.014))
        flank = join([web, flange, foot])
        belly = block((-web_x, -below, low), (web_x, below, low + t))
        eye = 0.07 * m + 0.03
        middle = shapely.box(-web_x, hz - 0.05 * s.z, web_x, knee)
        plate = rounded(hull(circle(-hx, hz, eye), circle(hx, hz, eye), middle), 0.02)
        ends = [prism(plate, end_y - 0.03, end_y), prism(plate, 0.86 * end_y, 0.86 * end_y + 0.02)]
        ends += [pin(x, hz, 0.84 * end_y, end_y + 0.006, 0.05 * m + 0.025) for x in (-hx, hx)]
        x, under = 1.2 * web_x, high - 0.015
        gable = shapely.Polygon([(-x, high), (0, high + 0.09 * s.z), (x, high), (x, under), (-x, under)])
        roof = prism(gable, -0.18 * s.y, 0.18 * s.y)
        parts = [
            Part("webs", join([flank, shapes.half_turn(flank), belly]), BARE.body),
            Part("roof", roof, BARE.body),
            Part("ends", shapes.mirrored_y(join(ends)), BARE.hazard if self.keys.markings else BARE.body),
        ]
        if self.keys.drive == "ropes":
            parts += self._sheaves(self.beam_sheave_z, 0.14)
        return parts

    # Head, closed.

    def _ends(self) -> Array:
        return kit.ends_over(self.keys.ropes, *self.ropes_m, self.deck_z, self.scale.mean)

    def _head(self) -> list[Part]:
        keys, s = self.keys, self.scale
        body = {"frame": self._frame, "block": self._block, "round": self._drum}[keys.head]()
        parts = [Part("head_body", body, BARE.body), Part("head_lugs", self._head_lugs(), BARE.body)]
        deck, half_x, half_y = self.deck_z, 0.36 * s.x, 0.72 * s.y
        if keys.ropes == 1:
            radius = kit.shackle_radius(s.mean)
            foot = block((-0.7 * radius, -0.7 * radius, deck - 0.05), (0.7 * radius, 0.7 * radius, deck + 0.01), 0.01)
            parts.append(Part("shackle", join([kit.shackle(deck, radius), foot]), BARE.dark))
        else:
            parts += kit.holders(self._ends(), keys.drive == "ropes", 0.41, 0.44)
        if keys.drive == "ropes":
            parts += self._sheaves(self.sheave_z, 0.15)
        else:
            tank = block((-0.30 * s.x, -0.62 * s.y, deck - 0.02), (0.30 * s.x, -0.44 * s.y, deck + 0.20 * s.z), 0.015)
            motor = rod((0.0, 0.44 * s.y, deck + 0.09 * s.z), (0.0, 0.64 * s.y, deck + 0.09 * s.z), 0.10 * s.mean, 16)
            parts += [Part("tank", tank, BARE.body), Part("motor", motor, BARE.dark)]
        if keys.markings:
            x, y = 0.9 * half_x, 0.6 * half_y
            if keys.head != "round":
                band = block((x, -y, deck - 0.14 * s.z), (x + 0.02, y, deck - 0.04 * s.z), 0.003)
                parts.append(Part("fascia", join([band, shapes.half_turn(band)]), BARE.hazard))
            edge = -(0.51 * s.y if keys.head == "round" else half_y - 0.03)
            corners = (-0.16 * s.x, edge, deck - 0.001), (0.16 * s.x, edge + 0.10 * s.y, deck + 0.010)
            plate = kit.plate_part("number", *corners)
            parts += [plate, plate.moved(HALF_TURN, "number_inner")]
        deck_corners = [(sx * half_x, sy * half_y) for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
        return parts + kit.access(keys, deck_corners, deck - 0.01, 0.55, (half_y + 0.06, deck - 0.35 * s.z, deck))

    def _sheaves(self, z: float, half: float) -> list[Part]:
        """Sheaves at a height, on shafts that reach ``half`` to either side."""
        wheels = join(shapes.sheave((0.0, y, z), self.sheave_r, 0.017) for y in self.sheave_y)
        shaft = pin(0.0, z, -half, half, 0.03 * self.scale.mean + 0.02, 0.02)
        shafts = shapes.at_y(shaft, -0.34 * self.scale.y, 0.34 * self.scale.y)
        return [Part("sheaves", wheels, BARE.dark), Part("shafts", shafts, BARE.dark)]

    def _deck(self, outline: shapely.Polygon) -> trimesh.Trimesh:
        """Return a deck with a kerb, open over the sheaves."""
        plate, z = outline, self.deck_z
        if self.keys.drive == "ropes":
            r, y = 1.2 * self.sheave_r, 0.34 * self.scale.y
            openings = [shapely.box(-r, side * y - 0.11, r, side * y + 0.11) for side in (-1, 1)]
            plate = outline.difference(shapely.union_all(openings))
        pieces = [prism(piece, z - 0.02, z, "z") for piece in shapely.get_parts(plate)]  # two of a narrow crown
        kerb = outline.difference(outline.buffer(-0.025))
        return join([*pieces, prism(kerb, z - 0.002, z + 0.04, "z")])

    def _frame(self) -> trimesh.Trimesh:
        """Two girders along y with cross girders, and a deck."""
        s = self.scale
        low, high = (z * s.z for z in _GIRDER)
        height, x, hy = high - low, 0.29 * s.x, 0.72 * s.y
        girder = shapes.i_section(height, 0.11 * s.x, 0.02 + 0.005 * s.mean, 0.02 + 0.005 * s.mean)
        cross = shapes.i_section(0.9 * height, 0.08 * s.x, 0.02, 0.02)
        z = (low + high) / 2
        along = [shapes.profile(girder, (side * x, -hy, z), (side * x, hy, z)) for side in (-1, 1)]
        across = [
            shapes.profile(cross, (-x, y, z), (x, y, z)) for y in np.array([-0.95, -0.70, -0.16, 0.16, 0.70, 0.95]) * hy
        ]
        corner = shapely.box(-0.36 * s.x, -hy, 0.36 * s.x, hy)
        return join([*along, *across, self._deck(rounded(corner, 0.10 * s.x))])

    def _block(self) -> trimesh.Trimesh:
        """Return a closed box with sloping ends."""
        s = self.scale
        low, high = _GIRDER[0] * s.z, self.deck_z - 0.019
        hy = 0.72 * s.y
        knee = low + 0.4 * (high - low)
        whole = shapely.box(-0.36 * s.x, -hy, 0.36 * s.x, hy)
        if self.keys.drive == "hydraulic":
            corners = ((0.30 * s.x, 0.80 * hy, low), (0.36 * s.x, hy, knee), (0.36 * s.x, hy, high))
            points = [(sx * x, sy * y, z) for x, y, z in corners for sx in (-1, 1) for sy in (-1, 1)]
            return join([shapes.convex(points), self._deck(whole)])
        outline = [(-0.8 * hy, low), (0.8 * hy, low), (hy, knee), (hy, high), (-hy, high), (-hy, knee)]
        sides = shapely.Polygon(outline)
        walls = [prism(sides, x - 0.02, x, "x") for x in (-0.34 * s.x, 0.36 * s.x)]
        ends = [block((-0.35 * s.x, y - 0.02, knee), (0.35 * s.x, y, high), 0.004) for y in (-hy + 0.02, hy)]
        middle = block((-0.35 * s.x, -0.18 * s.y, low), (0.35 * s.x, 0.18 * s.y, high), 0.01)
        return join([*walls, *ends, middle, self._deck(whole)])

    def _drum(self) -> trimesh.Trimesh:
        """Round crown on a cross beam that carries the arms."""
        s = self.scale
        low, high, hy = _GIRDER[0] * s.z, self.deck_z - 0.019, 0.72 * s.y
        outline = shapely.affinity.scale(circle(0.0, 0.0, 1.0, 8), 0.40 * s.x, 0.56 * s.y)
        ring = outline.difference(outline.buffer(-0.03))
        top, half, places = low + 0.6 * (high - low), 0.05 * s.x, (-0.26 * s.x, 0.26 * s.x)
        beam = [block((x - half, -hy, low), (x + half, hy, top), 0.01) for x in places]
        ties = [
            block((-0.30 * s.x, y - 0.03, low + 0.02), (0.30 * s.x, y + 0.03, low + 0.5 * (high - low)), 0.005)
            for y in (-0.95 * hy, 0.95 * hy)
        ]
        return join([prism(ring, low, high, "z"), *beam, *ties, self._deck(outline)])

    def _head_lugs(self) -> trimesh.Trimesh:
        s, m = self.scale, self.scale.mean
        x, z = self.head_pin if self.keys.drive == "ropes" else s.at(*_CYLINDER_PIN)
        low, high = (v * s.z for v in _GIRDER)
        foot = shapely.box(0.22 * s.x, low + 0.01, 0.32 * s.x, high - 0.01)
        reach = self.lugs_apart + 0.02
        bolts = shapes.at_y(pin(x, z, -reach, reach, 0.022 * m + 0.012, 0.014), *self.arm_y)
        one = join([self._lugs(x, z, foot), bolts])
        return join([one, shapes.half_turn(one)])

    def _column(self) -> Part:
        """Column of a hydraulic grab, from the head down to the shells' hinges."""
        s = self.scale
        low, high = self.hinge[1], _GIRDER[0] * s.z + 0.03
        walls = block((-0.18 * s.x, -0.52 * s.y, low), (0.18 * s.x, 0.52 * s.y, high), 0.015)
        return Part("column", walls, BARE.body)
