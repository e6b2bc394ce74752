"""A grab's design, which the rest of simgrab uses: rigid bodies on joints, ropes, cargo, mass.

Grab frame: origin A, fixed in the head's steel, on the ropes' common axis at half the height of the closed grab; z up
along the ropes, x across the closing line of the jaws, y along it. The bodies' frames are parallel to it when the grab
is closed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import shapely
import trimesh

from simgrab.model.geometry import Array
from simgrab.world.scenery.grabs.weight import Mass, Weight, spread, together
from simgrab.world.scenery.meshes.part import Part
from simgrab.world.scenery.meshes.shapes import join

#: Fills of the closed grab for which there is a heap.
CARGO_LEVELS = (0.25, 0.5, 0.75, 1.0)
NO_ROPES = np.zeros((0, 2, 3))
AIR_DRAG = 1.3  # drag coefficient of a body of plates and bars


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body of a grab."""

    name: str
    mass_kg: float
    # watertight, in the body's frame; a material's name is that of a field of `simgrab.world.scenery.meshes.paint`'s
    # `Finish`, which paints it; a material of any other name is drawn unchanged
    parts: Sequence[Part]
    # body to which it is hinged, or in which it slides; empty for the first one, the head, whose frame is the grab
    # frame
    parent: str = ""
    pin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # origin of the frame in the parent's when the grab is closed, m
    # unit vector that it turns about or slides along, in its own frame
    axis: tuple[float, float, float] = (0.0, 1.0, 0.0)
    slides: bool = False
    own_solid: trimesh.Trimesh | None = None  # solids over which the mass is spread, if parts are not closed

    @cached_property
    def steel(self) -> trimesh.Trimesh:
        """All parts as one mesh."""
        return join(part.mesh for part in self.parts)

    @property
    def solid(self) -> trimesh.Trimesh:
        """Closed surfaces, which may overlap, over which the mass is spread evenly."""
        return self.steel if self.own_solid is None else self.own_solid


Heaps = Callable[[str, np.random.Generator], Sequence[Part]]


def no_heaps(_cargo: str, _rng: np.random.Generator) -> Sequence[Part]:
    """Make no cargo: the heaps of a grab that holds none."""
    return ()


@dataclass(frozen=True, eq=False)
class Design:
    """A kind and size of grab.

    Attributes
    ----------
    bodies : sequence of Body
        The head first; parents come before their children.
    positions : callable
        Returns joint positions, by name of the body, for an opening of the jaws, rad: in rad for a hinge, m for a
        slide; all are 0 for an opening of 0.
    max_jaw : float
        Widest opening, rad; 0 where nothing moves.
    terminations : ndarray, shape (n, 3)
        Ends of the ropes in the head, grab frame, m: 1, 2 or 4 of them, seen from above counter-clockwise from
        (+x, +y).
    closing : sequence of int
        Indices of the ropes that close the jaws; the others hold the head. Empty if the jaws have their own drive.
    falls : ndarray, shape (k, 2, 3)
        Pieces of the closing ropes inside the grab: one end in the frame of ``falls_from``, the other in that of
        ``falls_to``.
    leads : ndarray, shape (m, 2, 3)
        Pieces of the closing ropes between the head and the falls, one each: one end in the head's frame, the other in
        that of ``falls_from``. None if the falls begin in the head.
    falls_from, falls_to : str
        Names of bodies. Falls from the first one, the head, are drawn; others are among the bodies' parts.
    lips : mapping of str to ndarray, shape (n, 3)
        Ends of the cutting edges, by body and in its frame, in the order of the keypoints ``lip_…``; four at most in
        all.
    heaps : callable
        Cargo in the closed grab, by its name and random numbers: a part in the grab frame for each of `CARGO_LEVELS`,
        or none for a grab that holds no cargo.
    cargo_kg : float
        Mass of a full load.
    drag_area_m2 : float, optional
        Cd·A, m²; by default computed from the closed grab's outline.
    """

    bodies: Sequence[Body]
    positions: Callable[[float], Mapping[str, float]]
    max_jaw: float
    terminations: Array
    closing: Sequence[int] = ()
    falls: Array = field(default_factory=lambda: NO_ROPES)
    leads: Array = field(default_factory=lambda: NO_ROPES)
    falls_from: str = "head"
    falls_to: str = "beam"
    lips: Mapping[str, Array] = field(default_factory=dict)
    heaps: Heaps = no_heaps
    cargo_kg: float = 0.0
    drag_area_m2: float | None = None

    @cached_property
    def holds_cargo(self) -> bool:
        """Whether the closed grab holds cargo."""
        return len(self.heaps("coal", np.random.default_rng(0))) > 0

    @property
    def mass_kg(self) -> float:
        """Of the empty grab."""
        return sum(body.mass_kg for body in self.bodies)

    def frames(self, jaw: float) -> dict[str, Array]:
        """Return ``grab_from_body``, shape (4, 4), of every body, for an opening of the jaws, rad."""
        if not 0.0 <= jaw <= self.max_jaw:
            raise ValueError(f"jaw is {jaw!r} rad; it must lie in [0, {self.max_jaw:.4f}]")
        positions = self.positions(jaw)
        found: dict[str, Array] = {}
        for body in self.bodies:
            local = np.eye(4)
            local[:3, 3] = body.pin
            if body.slides:
                local[:3, 3] += positions[body.name] * np.array(body.axis)
            elif body.parent:
                local[:3, :3] = _turn(body.axis, positions[body.name])
            found[body.name] = found[body.parent] @ local if body.parent else local
        return found

    def points(self, jaw: float) -> dict[str, Array]:
        """Return the steel's vertices (n, 3) of every body, grab frame, m, for an opening of the jaws, rad."""
        frames = self.frames(jaw)
        return {b.name: trimesh.transform_points(b.steel.vertices, frames[b.name]) for b in self.bodies}

    def closing_rope_m(self, jaw: float) -> float:
        """Length that each closing rope pays out, in addition to a holding rope, to open the jaws by an angle, rad."""
        if not len(self.falls) or not self.closing:
            return 0.0
        opened, closed = (self._falls_m(self.frames(j)) for j in (jaw, 0.0))
        return float(opened - closed) / len(self.closing)

    def _falls_m(self, frames: Mapping[str, Array]) -> float:
        """Length of all falls and leads."""
        pieces = [(self.falls, self.falls_from, self.falls_to), (self.leads, self.bodies[0].name, self.falls_from)]
        total = 0.0
        for ends, *bodies in pieces:
            if len(ends):
                first, last = (trimesh.transform_points(ends[:, k], frames[body]) for k, body in enumerate(bodies))
                total += float(np.linalg.norm(last - first, axis=1).sum())
        return total

    def mass_of(self, jaw: float, load: float) -> Mass:
        """Mass, its centre and moments of inertia at an opening of the jaws, rad, and a fill, 0 to 1."""
        return self._weight.at(jaw, load)

    @cached_property
    def _weight(self) -> Weight:
        solids = {body.name: spread(body.solid, body.mass_kg) for body in self.bodies}
        jaws, loads = [], []
        for jaw in np.linspace(0.0, self.max_jaw, 5).tolist() if self.max_jaw else [0.0]:
            frames = self.frames(jaw)
            mass, centre, inertia = together([(solid, frames[name]) for name, solid in solids.items()])
            jaws.append((jaw, float(centre[2]), *np.diag(inertia).tolist()))
        for fill, heap in zip(CARGO_LEVELS, self.heaps("coal", np.random.default_rng(0)), strict=False):
            solid = spread(heap.mesh, 1.0)
            loads.append((fill, float(solid.center_mass[2]), *np.diag(solid.moment_inertia).tolist()))
        return Weight(mass, self.cargo_kg if loads else 0.0, jaws, loads)

    @cached_property
    def depth_m(self) -> float:
        """How far the grab reaches below A, at most, m."""
        openings = [self.points(jaw).values() for jaw in np.linspace(0.0, self.max_jaw, 7)]
        return -min(float(of_body[:, 2].min()) for bodies in openings for of_body in bodies)

    @cached_property
    def cd_a_m2(self) -> float:
        """Drag coefficient times the area that the closed grab shows to the wind, the mean over all directions, m²."""
        if self.drag_area_m2 is not None:
            return self.drag_area_m2
        points = np.concatenate(list(self.points(0.0).values()))
        # The mean outline of a convex body upright, over all horizontal directions, by eight of them.
        azimuths = np.arange(8) * np.pi / 8
        views = (points @ [[np.cos(a), 0.0], [np.sin(a), 0.0], [0.0, 1.0]] for a in azimuths)
        return AIR_DRAG * float(np.mean([shapely.convex_hull(shapely.MultiPoint(view)).area for view in views]))


def _turn(axis: Sequence[float], angle: float) -> Array:
    """Rotation matrix about a unit vector."""
    a, c, s = np.array(axis), np.cos(angle), np.sin(angle)
    cross = np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])
    return np.asarray(c * np.eye(3) + (1.0 - c) * np.outer(a, a) + s * cross)
