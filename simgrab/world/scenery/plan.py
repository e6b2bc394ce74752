"""Plan the world of a scenario: shapes and paint, and the space in which the grab may hang without collision."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache

import numpy as np
import trimesh
from numpy.typing import NDArray

from simgrab.errors import ScenarioError
from simgrab.model.geometry import Array
from simgrab.model.rng import stream
from simgrab.model.scenario import Draws, Dynamic, Hang, Scenario, Variant
from simgrab.world.scenery import places
from simgrab.world.scenery.clearance import HeightMap, check_camera
from simgrab.world.scenery.grabs import design_of
from simgrab.world.scenery.grabs.design import CARGO_LEVELS, Design
from simgrab.world.scenery.markers import balls_of, marked
from simgrab.world.scenery.meshes import jib
from simgrab.world.scenery.meshes.paint import finish
from simgrab.world.scenery.meshes.part import Part
from simgrab.world.scenery.meshes.ropes import Ropes
from simgrab.world.scenery.parked import parked_grabs
from simgrab.world.trajectory.hanging import hung
from simgrab.world.trajectory.moment import GrabState, Moment

FIRST = Draws()
CLEARANCE_M = 0.3
MOST_LIFTS = 20  # a shorter rope swings the grab over other ground
GRAB_REACH_M, TRAVEL_M = 16.0, 48.0  # heights are known so far from O: with swing alone, and what the crane's moves add
COVER_SPACING_M, COVER_DEPTH_M = 0.15, 0.05


@dataclass(frozen=True, eq=False)
class Plan:
    """The parts of a world, not built yet."""

    scenario: Scenario  # in which nothing varies
    draws: Draws  # keys of random details, such as stains
    grab: Design
    ropes: Ropes
    place: tuple[Part, ...]  # surroundings below the jib, in the place's frame
    jib: Sequence[Part]  # the jib head, in the jib frame
    bodies: Mapping[str, Sequence[Part]]  # the grab, each body in its own frame
    heaps: Sequence[Part]  # cargo in the grab, one heap for each of `CARGO_LEVELS` or none, in the grab's frame

    @cached_property
    def shapes(self) -> dict[str, trimesh.Trimesh]:
        """Steel of each grab body, in the body's frame, and each cargo heap (``cargo_0`` …), in the grab frame."""
        bodies = {body.name: body.steel for body in self.grab.bodies}
        return bodies | {f"cargo_{level}": heap.mesh for level, heap in enumerate(self.heaps)}

    @cached_property
    def outline(self) -> Callable[[str], Array]:
        """Points (N, 3) of a shape, by its name; in every picture the outermost points are among them."""
        straight, shapes = self.scenario.camera.intrinsics.distortion.is_null, self.shapes

        @cache  # computed on first use: frames of a clip seldom show the heaps of all levels
        def points(name: str) -> Array:
            corners, triangles = np.asarray(shapes[name].vertices), np.asarray(shapes[name].faces)
            return _cover(corners.tobytes(), triangles.tobytes(), straight=straight)

        return points

    @cached_property
    def ground(self) -> HeightMap:
        """Height map of the surroundings below the grab."""
        swing = self.scenario.swing
        travels = isinstance(swing, Dynamic) and not isinstance(swing.work, Hang)
        return _ground(self.place, GRAB_REACH_M + TRAVEL_M * travels)

    @cached_property
    def balls(self) -> list[tuple[float, Part]]:
        """Balls on the ropes, as `balls_of` gives them."""
        return balls_of(self.scenario.markers)

    def grab_points(self, state: GrabState) -> Array:
        """Points (N, 3), grab frame, that cover the grab and its load."""
        placed = placed_shapes(self.grab, state.jaw, state.load)
        return np.concatenate([self.outline(s) @ at[:3, :3].T + at[:3, 3] for s, at in placed.items()])

    def lifted(self, moment: Moment) -> Moment:
        """Shorten the rope of a moment until the grab is clear of the surroundings below."""
        points, clamped = self.grab_points(moment.grab), (*moment.clamped, "rope_length_m")
        for _ in range(MOST_LIFTS):
            missing = CLEARANCE_M - self._gap(moment, moment.grab.jib_from_grab.apply(points))
            if missing <= 0:
                break
            grab = replace(moment.grab, rope_length=moment.grab.rope_length - missing - 0.01)
            grab = hung(grab, self.scenario.suspension, float(self.grab.terminations[0, 2]))
            moment = replace(moment, grab=grab, clamped=clamped)
        return moment

    def _gap(self, moment: Moment, points_jib: Array) -> float:
        """Least height of points (N, 3) above the surroundings, m."""
        if moment.jib:
            points_jib = moment.jib.jib_from_place.local(points_jib)
        return self.ground.gap(points_jib)

    def check_clearance(self, moment: Moment, points_jib: Array) -> None:
        """Refuse a frame whose grab would stand in the ground or in the cargo heap."""
        jib, rope = moment.jib, moment.grab.rope_length
        gap = self._gap(moment, points_jib)
        if gap < CLEARANCE_M:
            drawn, most = math.ceil(100 * rope) / 100, math.floor(100 * (rope - CLEARANCE_M + gap)) / 100
            shorten = "" if jib else ', or let swing.clamp = ["rope_length_m"] shorten such ropes'
            raise ScenarioError(
                "swing.work" if jib else "swing.rope_length_m",
                f"frame {moment.frame}: a rope of {drawn:.2f} m lowers the grab into the ground or the cargo; "
                f"at most {most:.2f} m there; raise jib.head_height_m (up to 60), lower what is "
                f"below (place.fill of a hold, place.pile_height_m of a quay){shorten}",
            )


def draw_up(scenario: Scenario, draws: Draws = FIRST, place: tuple[Part, ...] | None = None) -> Plan:
    """Plan the world of a scenario.

    Parameters
    ----------
    scenario : Scenario
        Scenario in which nothing varies.
    draws : Draws
        Keys of random details, such as stains.
    place : tuple of Part, optional
        Place of another plan, if it is the same; see `replanned`.

    Raises
    ------
    ScenarioError
        If the camera would be in the jib's steel.
    """
    seed, look, head_height = scenario.seed, scenario.grab, scenario.jib.head_height_m
    grab = marked(design_of(look), scenario.markers)
    ropes = Ropes.of(scenario.jib, len(grab.terminations))
    _check_camera(scenario, ropes)
    if place is None:
        built = places.build(scenario.place, head_height=head_height, rng=stream(seed, draws.place, "place"))
        parked = stream(seed, draws.place, "clutter.grabs")
        place = (*built, *parked_grabs(scenario.clutter, built, head_height=head_height, rng=parked))

    mixed = finish(look.paint_rgb, look.wear, look.residue, look.cargo, stream(seed, draws.grab, "grab"))
    return Plan(
        scenario,
        draws,
        grab,
        ropes,
        place,
        () if scenario.jib.head == "none" else jib.jib_parts(ropes),
        {body.name: mixed.on(body.parts) for body in grab.bodies},
        grab.heaps(look.cargo, stream(seed, draws.grab, "cargo")),
    )


def replanned(plan: Plan, variant: Variant) -> Plan:
    """Plan the world of another variant, with the same parts or the same place where these do not change.

    Raises `ScenarioError` if the camera would be in the jib's steel.
    """
    old, new = plan.scenario, variant.scenario
    if plan.draws == variant.draws and old == new:
        return plan  # with what it has computed
    changed = {name for name in _OF_PARTS if getattr(old, name) != getattr(new, name)}
    if plan.draws == variant.draws and not changed:
        _check_camera(new, plan.ropes)
        return replace(plan, scenario=new)
    stands = plan.draws.place == variant.draws.place and old.jib.head_height_m == new.jib.head_height_m
    return draw_up(new, variant.draws, plan.place if stands and not changed & _OF_PLACE else None)


_OF_PLACE = {"seed", "place", "clutter"}
_OF_PARTS = _OF_PLACE | {"grab", "jib", "markers", "suspension"}


def _check_camera(scenario: Scenario, ropes: Ropes) -> None:
    if scenario.jib.head != "none":
        check_camera(np.array(scenario.camera.offset_m), jib.jib_steel(ropes))


def cargo_level(load: float) -> int | None:
    """Index of the heap that represents a fill; None for an empty grab."""
    if load <= 0:
        return None
    return int(np.abs(np.array(CARGO_LEVELS) - load).argmin())


def placed_shapes(grab: Design, jaw: float, load: float) -> dict[str, Array]:
    """Shapes that a grab shows, each with ``grab_from_shape``, shape (4, 4)."""
    placed = grab.frames(jaw)
    level = cargo_level(load)
    return placed if level is None else placed | {f"cargo_{level}": np.eye(4)}


@lru_cache(maxsize=1)  # many plans in a row have the same place
def _ground(place: tuple[Part, ...], reach_m: float) -> HeightMap:
    return HeightMap.of((part.mesh for part in place), reach_m)


@lru_cache(maxsize=64)  # the steel of a design is the same in every world
def _cover(vertices: bytes, faces: bytes, *, straight: bool) -> Array:
    """Points of a mesh, shape (N, 3); in every picture the outermost points are among them.

    Through a lens that keeps lines straight, the outermost points are corners of the convex hull. A lens that bends
    lines may show a point along an edge outermost, so the surface near the hull is covered at `COVER_SPACING_M`.
    """
    corners, triangles = np.frombuffer(vertices).reshape(-1, 3), np.frombuffer(faces, np.int64).reshape(-1, 3)
    hull = trimesh.Trimesh(corners, triangles, process=False).convex_hull
    if straight:
        return np.asarray(hull.vertices)
    normals, on_plane = np.asarray(hull.face_normals), np.asarray(hull.triangles)[:, 0]
    planes = list(zip(normals, np.einsum("ij,ij->i", normals, on_plane), strict=True))

    def outer(points: Array, depth: float) -> NDArray[np.bool_]:
        """Which points lie outside the hull or less than a depth inside: above one of its planes, sunk by the depth."""
        found, rest = np.zeros(len(points), bool), np.arange(len(points))
        for some in range(0, len(planes), 32):  # those found need no more planes
            below, far = points[rest], np.full(len(rest), -np.inf)
            for normal, offset in planes[some : some + 32]:
                np.maximum(far, below @ normal - offset, out=far)
            found[rest[far > -depth]] = True
            rest = rest[far <= -depth]
        return found

    # The distance is convex: no point of a triangle lies farther out than its outermost corner. Rounding moves less.
    near = outer(corners, COVER_DEPTH_M + 1e-6)[triangles].any(axis=1)
    points = _between(corners, triangles[near], COVER_SPACING_M).round(6)
    points = points[np.lexsort(points.T[::-1])]
    points = points[np.append(True, (points[1:] != points[:-1]).any(axis=1))]
    return points[outer(points, COVER_DEPTH_M)]


def _between(corners: Array, triangles: NDArray[np.int64], spacing: float) -> Array:
    """Points (N, 3): the corners, and middles of edges, as triangles are divided until no edge exceeds the spacing.

    They are those of trimesh 5.2's `subdivide_to_size`, some twice, since triangles do not share corners.
    """
    points, of = [corners], corners[triangles]
    while True:
        long = np.linalg.norm(of - np.roll(of, -1, axis=1), axis=2) > spacing
        of, long = of[long.any(axis=1)], long[long.any(axis=1)]
        if not len(of):
            return np.concatenate(points)
        count = long.sum(axis=1)
        first = np.where(count == 2, long.argmin(axis=1) + 1, long.argmax(axis=1))  # the long edges come first
        of = np.take_along_axis(of, ((first[:, None] + np.arange(3)) % 3)[..., None], axis=1)
        middles = (of + np.roll(of, -1, axis=1)) / 2
        points.append(middles[np.arange(3) < count[:, None]])
        # A triangle with one long edge leaves none. The quadrangle that two of them leave gets its shorter diagonal.
        (a, b, c), (p, q, _) = (each[count == 2].swapaxes(0, 1) for each in (of, middles))
        to_q = (((a - q) ** 2).sum(axis=1) <= ((p - c) ** 2).sum(axis=1))[:, None]
        pieces = [(p, b, q), (a, p, np.where(to_q, q, c)), (np.where(to_q, a, p), q, c)]
        (a, b, c), (p, q, r) = (each[count == 3].swapaxes(0, 1) for each in (of, middles))
        pieces += [(a, p, r), (p, b, q), (r, q, c), (p, q, r)]
        of = np.concatenate([np.stack(piece, axis=1) for piece in pieces])
