"""Scissors grabs: two levers cross at a pivot, with a shell below and a sheave block above on each.

The ropes hold a yoke, from which links run to the levers' upper ends; closing ropes draw these together, and the shells
with them. Proportions are those of no one maker's grab: the levers are about as long below the pivot as the shells are
wide, so that little rope force closes them.

All is drawn closed, with the lips at z = 0; the outer shell is at +x, and its lever's upper end at −x.
"""

from __future__ import annotations

import numpy as np
import shapely

from simgrab.model.geometry import Array
from simgrab.model.scenario.grab import Scissors
from simgrab.world.scenery.grabs import kit
from simgrab.world.scenery.grabs.design import Design
from simgrab.world.scenery.grabs.shells import HALF_TURN, Shells
from simgrab.world.scenery.grabs.slider_crank import SliderCrank
from simgrab.world.scenery.meshes import shapes
from simgrab.world.scenery.meshes.paint import BARE
from simgrab.world.scenery.meshes.part import Part
from simgrab.world.scenery.meshes.shapes import block, circle, hull, join, pin, prism, rod

MAX_JAW = np.radians(40.0)

# In units of `Scale`.
_PIVOT = (0.0, 1.62)
_HANDLE = (-0.48, 0.76)  # from the pivot
_HEAD_PIN = (-0.40, 2.96)
_YOKE = (3.02, 3.20)
_LEVER_Y = (0.50, -0.38)  # of the outer lever's two plates; the inner's are half a turn away
_ROPE_Y = (-0.15, -0.05, 0.05, 0.15)


def scissors(keys: Scissors) -> Design:
    """Return the design of a scissors grab."""
    return _Scissors(keys).design()


class _Scissors(Shells):
    def __init__(self, keys: Scissors) -> None:
        super().__init__(keys, _PIVOT)
        # The wider the shells for their height, the higher do they swing: longer links keep them below the yoke.
        raised = 0.3 * max(0.0, self.scale.x - self.scale.z)
        self.yoke = tuple(z * self.scale.z + raised for z in _YOKE)
        self.handle_pin = self.scale.at(*_HANDLE)
        self.head_pin = _HEAD_PIN[0] * self.scale.x, _HEAD_PIN[1] * self.scale.z + raised
        self.handle = self.handle_pin[0], self.hinge[1] + self.handle_pin[1]
        self.crank = SliderCrank(self.hinge, self.head_pin, self.handle_pin)
        self.max_jaw = kit.widest(self._clear, MAX_JAW)
        self.lever_y = tuple(y * self.scale.y for y in _LEVER_Y)
        beside = 0.05 + 0.03 * self.scale.mean
        self.link_y = max(self.lever_y) + beside, min(self.lever_y) - beside
        self.rope_y = tuple(y * self.scale.y for y in _ROPE_Y)
        self.block_r = 0.09 * self.scale.mean

    def _clear(self, jaw: float) -> None:
        """Raise `ValueError` where the outer shell's rim comes up to the yoke."""
        state = self.crank.at(jaw)
        x, z = self.curve[-1] - self.hinge
        # Positive angles lift what is at +x.
        rim = state.beam_z + z * np.cos(jaw) + (x + self.plate) * np.sin(jaw)
        if rim > self.yoke[0] - 0.06 * self.scale.mean:
            raise ValueError("the shell meets the yoke")

    def design(self) -> Design:
        hz, (gx, gz) = self.hinge[1], self.handle_pin
        bodies = [
            kit.body("head", self._yoke()),
            kit.body("pivot", kit.placed(self._pivot(), (0.0, 0.0, hz)), "head", (0.0, 0.0, hz), (0.0, 0.0, 1.0),
                     slides=True),
            *self.pair("shell", [*self.shell(), *self._lever()], "pivot", (0.0, 0.0), self.hinge),
            *self.pair("link", self._link(), "head", self.head_pin, self.head_pin),
            *(
                kit.body(f"reeving_{side}", [part.moved(turn) for part in self._reeving()], f"shell_{side}",
                         (sign * gx, 0.0, gz))
                for side, sign, turn in (("outer", 1.0, np.eye(4)), ("inner", -1.0, HALF_TURN))
            ),
        ]  # fmt: skip

        def positions(jaw: float) -> dict[str, float]:
            state = self.crank.at(jaw)
            return {
                "pivot": state.beam_z - hz, "shell_outer": state.jaw_angle, "shell_inner": -state.jaw_angle,
                "link_outer": state.arm_angle, "link_inner": -state.arm_angle,
                "reeving_outer": -state.jaw_angle, "reeving_inner": state.jaw_angle,
            }  # fmt: skip

        ropes = self._ends()
        falls = np.array([[(gx, y, gz), (-gx, y, gz)] for y in self.rope_y])
        # From its guide in the yoke, a closing rope comes down to the outer lever's block.
        closing = kit.closing(len(ropes))
        leads = np.array([[ropes[i] - (0.0, 0.0, 0.43), (gx, float(np.sign(ropes[i][1])) * self.rope_y[-1], gz)]
                          for i in closing])  # fmt: skip
        rough = Design(bodies, positions, self.max_jaw, ropes, closing, falls, leads, "shell_outer", "shell_inner",
                       self.lips(), self.heaps())  # fmt: skip
        return kit.standing(rough, self.keys.volume_m3)

    def _lever(self) -> list[Part]:
        """Return the outer lever: two plates from the shell's rim past the pivot to the block at their upper end."""
        s, m, (px, pz), (ax, az) = self.scale, self.scale.mean, self.hinge, self.handle
        w, top = self.curve[-1]
        thick = 0.015 + 0.010 * m
        foot = shapely.box(0.52 * w, 0.86 * top, 0.94 * w, 0.97 * top)
        upper = hull(circle(px, pz, 0.12 * m), circle(ax, az, 0.08 * m))
        plate = shapely.union_all([hull(circle(px, pz, 0.13 * m), foot), upper])
        hole = shapely.Polygon([(0.22 * w, 0.66 * pz + 0.34 * top), (0.62 * w, 1.02 * top), (0.78 * w, 1.02 * top)])
        plates = prism(plate.difference(hole.buffer(0.02 * m)), -thick, thick)
        tie = rod((0.86 * w, -self.half_y + self.plate, 0.98 * top), (0.86 * w, self.half_y - self.plate, 0.98 * top),
                  0.045 * m, 12)  # fmt: skip
        bosses = join([pin(px, pz, -2 * thick, 2 * thick, 0.10 * m), pin(ax, az, -2 * thick, 2 * thick, 0.07 * m)])
        low, high = min(self.lever_y), max(self.lever_y)
        shaft = pin(ax, az, low - 0.09 - 2 * thick, high + 0.09 + 2 * thick, 0.035 * m)
        sheaves = join(shapes.sheave((ax, y, az), self.block_r, 0.017) for y in self.rope_y)
        parts = [
            Part("levers", shapes.at_y(plates, *self.lever_y), BARE.body),
            Part("tie", tie, BARE.body),
            Part("bosses", shapes.at_y(bosses, *self.lever_y), BARE.body),
            Part("block_pin", shaft, BARE.dark),
            Part("block", sheaves, BARE.dark),
        ]
        if self.keys.plate_work > 0.5:
            web = hull(circle(px, pz, 0.06 * m), circle(ax, az, 0.05 * m))
            stiff = prism(web, -0.08 * s.mean, -thick)
            parts.append(Part("stiffeners", shapes.at_y(stiff, high), BARE.body))
        return parts

    def _link(self) -> list[Part]:
        """Return two links from the yoke to the outer lever's upper end, outside its plates."""
        m = self.scale.mean
        eye, thick = 0.05 * m + 0.01, 0.010 + 0.006 * m
        bar = prism(kit.link(self.handle, self.head_pin, eye, 0.6), -thick, thick)
        return [Part("links", shapes.at_y(bar, *self.link_y), BARE.body)]

    def _reeving(self) -> list[Part]:
        """Return the ropes between the blocks, from the outer lever's to half-way in the open grab."""
        at = self.crank.at(self.max_jaw).jaw_angle
        x, z = self.handle_pin
        half = abs(x * np.cos(at) + z * np.sin(at))
        places = [(y, side * self.block_r) for y in self.rope_y for side in (-1, 1)]
        ropes = join(rod((0.0, y, z), (half, y, z), 0.016, 8) for y, z in places)
        return [Part("falls", ropes, BARE.dark)]

    def _pivot(self) -> list[Part]:
        m, (x, z) = self.scale.mean, self.hinge
        reach = max(abs(y) for y in self.lever_y) + 0.10
        shaft = pin(x, z, -reach, reach, 0.07 * m, 0.03)
        collar = pin(x, z, -0.22 * self.scale.y, 0.22 * self.scale.y, 0.11 * m)
        coat = BARE.hazard if self.keys.markings else BARE.body
        return [Part("shaft", shaft, BARE.dark), Part("collar", collar, coat)]

    # The yoke.

    def _ends(self) -> Array:
        s = self.scale
        return kit.ends_over(self.keys.ropes, 0.20 * s.x, 0.38 * s.y, self.yoke[1], s.mean)

    def _yoke(self) -> list[Part]:
        keys, s, m = self.keys, self.scale, self.scale.mean
        low, high = self.yoke
        x, reach = abs(self.head_pin[0]), max(self.link_y[0], -self.link_y[1]) + 0.08
        across = [block((side * x - 0.07 * s.x, -reach, low), (side * x + 0.07 * s.x, reach, high), 0.01)
                  for side in (-1, 1)]  # fmt: skip
        wide, places = 0.08 * s.y, (-0.38 * s.y, 0.38 * s.y)
        along = [block((-x, y - wide, low + 0.01), (x, y + wide, high - 0.004), 0.008) for y in places]
        eye, apart = 0.05 * m + 0.03, 0.014 + 0.008 * m
        foot = shapely.box(-x - 0.06 * s.x, low, -x + 0.06 * s.x, low + 0.03)
        lug = prism(hull(circle(-x, self.head_pin[1], eye), foot), -0.010, 0.010)
        one = shapes.at_y(lug, *(y + side * 2.2 * apart for y in self.link_y for side in (-1, 1)))
        pins = shapes.at_y(pin(*self.head_pin, -3.2 * apart, 3.2 * apart, 0.6 * eye), *self.link_y)
        parts = [
            Part("head_body", join([*across, *along]), BARE.body),
            Part("head_lugs", join([one, shapes.half_turn(one)]), BARE.body),
            Part("head_pins", join([pins, shapes.half_turn(pins)]), BARE.dark),
        ]
        parts += kit.holders(self._ends(), True, 0.43, 0.43)
        if keys.markings:
            ends = (-0.18 * s.x, -0.46 * s.y, high - 0.006), (0.18 * s.x, -0.36 * s.y, high + 0.010)
            plate = kit.plate_part("number", *ends)
            half, at = 0.072 * s.x, [(side * x, end * 0.85 * reach) for side in (-1, 1) for end in (-1, 1)]
            belts = [block((a - half, b - 0.06, low + 0.02), (a + half, b + 0.06, high + 0.003)) for a, b in at]
            parts += [plate, Part("belts", join(belts), BARE.hazard)]
        corners = [(sx * x, sy * reach) for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
        return parts + kit.access(keys, corners, high, 0.5, (0.46 * s.y + 0.05, low - 0.5 * s.z, high))
