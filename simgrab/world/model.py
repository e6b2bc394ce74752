"""From a scenario to a MuJoCo model: the grab on its ropes, the jib head above it, the place below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from simgrab.errors import ScenarioError
from simgrab.geometry import Array
from simgrab.rng import stream
from simgrab.scenario import Dynamic, Hang, Hold, Light, Scenario
from simgrab.world import places
from simgrab.world.clearance import HeightMap, check_camera
from simgrab.world.meshes import grab, jib, linkage, ropes
from simgrab.world.meshes.part import Part, add_parts
from simgrab.world.moment import GrabState, Moment
from simgrab.world.parked import parked_grabs

# Geom groups tell what a pixel belongs to.
PLACE, JIB, ROPE, GRAB, HIDDEN = 0, 1, 2, 3, 5
STEEL, FALLS = "steel", "falls"

NEAR_M, FAR_M = 0.1, 200.0
SHADOW_HALF_WIDTH_SHARE = 0.8  # of the depth below O: the picture sees a little less at h = 1645 px
SHADOW_LIGHT_DISTANCE_M = 40.0  # the shadow map's depth range starts here; farther out it shows acne
CLEARANCE_M = 0.3
DRAWN_SKY = 1.0  # at night, so that eight bits keep the darkness
GRAB_REACH_M, TRAVEL_M = 16.0, 48.0  # heights are known so far from O: with swing alone, and what the crane's moves add
COVER_SPACING_M, COVER_DEPTH_M = 0.15, 0.05


@dataclass(frozen=True, eq=False)
class World:
    """A compiled model and what it takes to pose it.

    Attributes
    ----------
    model : mujoco.MjModel
        World frame = jib frame.
    shapes : dict of str to trimesh.Trimesh
        Steel of each grab body, in the body's frame, and each cargo heap (``cargo_0`` …), in the grab frame.
    outline : dict of str to ndarray, shape (N, 3)
        Points of each shape among which the outermost of every picture are.
    switches : dict of str to ndarray
        Geoms that come and go with the state, by the stem of their name: ``cargo_2``, ``rope_0/15``; and those that
        only an absent grab lacks: its steel and the falls inside it.
    ground : HeightMap
        What stands below the grab.
    """

    model: mujoco.MjModel
    shapes: dict[str, trimesh.Trimesh]
    outline: dict[str, Array]
    switches: dict[str, NDArray[np.int64]]
    ground: HeightMap

    def grab_points(self, state: GrabState) -> Array:
        """Points (N, 3), grab frame, that cover the grab and what it holds."""
        placed = placed_shapes(state.jaw, state.load)
        return np.concatenate([self.outline[s] @ at[:3, :3].T + at[:3, 3] for s, at in placed.items()])

    def check_clearance(self, moment: Moment, points_jib: Array) -> None:
        """Refuse a frame whose grab would stand in the ground or in the cargo heap."""
        jib, rope = moment.jib, moment.grab.rope_length
        if jib:
            place_from_jib = np.linalg.inv(jib.jib_from_place)
            points_jib = points_jib @ place_from_jib[:3, :3].T + place_from_jib[:3, 3]
        gap = self.ground.gap(points_jib)
        if gap < CLEARANCE_M:
            raise ScenarioError(
                "swing.work" if jib else "swing.rope_length_m",
                f"frame {moment.frame} has {rope:.2f} m of rope, which lowers the grab into what is below it; "
                f"at most {rope - CLEARANCE_M + gap:.2f} m there",
            )

    def pose(self, data: mujoco.MjData, moment: Moment) -> None:
        """Set ``data`` to the moment and ``model``'s geom groups to what it shows: right cargo heap, right ropes."""
        model, state = self.model, moment.grab
        if moment.jib:
            place = moment.jib.jib_from_place
            data.mocap_pos[self._mocap("place")] = place[:3, 3]
            data.mocap_quat[self._mocap("place")] = (np.cos(moment.jib.slew / 2), 0, 0, -np.sin(moment.jib.slew / 2))
        half = state.alpha / 2
        data.joint("swing").qpos = (
            np.cos(half),
            np.sin(half) * np.sin(state.azimuth),
            -np.sin(half) * np.cos(state.azimuth),
            0.0,
        )
        data.joint("hoist").qpos = -state.rope_length
        data.joint("yaw").qpos = state.yaw
        for name, position in grab.joint_positions(state.jaw).items():
            data.joint(name).qpos = position
        shown = cargo_level(state.load) if moment.present else None
        for level in range(len(grab.CARGO_LEVELS)):
            self._show(f"cargo_{level}", level == shown, GRAB)
        self._show(STEEL, moment.present, GRAB)
        self._show(FALLS, moment.present, ROPE)
        self._hang_ropes(data, moment)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
        self._shine(data, moment)

    def _shine(self, data: mujoco.MjData, moment: Moment) -> None:
        """Keep the sun where it stands over the place, and its shadows where the camera looks."""
        if moment.jib:
            sun = self.model.light("sun").id
            direction = moment.jib.jib_from_place[:3, :3] @ self.model.light_dir[sun]
            centre = self.model.light_pos[sun] + SHADOW_LIGHT_DISTANCE_M * self.model.light_dir[sun]
            data.light_xdir[sun] = direction
            data.light_xpos[sun] = centre - SHADOW_LIGHT_DISTANCE_M * direction

    def _mocap(self, body: str) -> int:
        return int(self.model.body(body).mocapid[0])

    def _hang_ropes(self, data: mujoco.MjData, moment: Moment) -> None:
        """Draw each rope straight from its termination to its exit, with the shortest mesh that reaches."""
        pose = moment.grab.jib_from_grab
        ends = grab.ROPE_TERMINATIONS @ pose[:3, :3].T + pose[:3, 3]
        for rope, (end, top) in enumerate(zip(ends, ropes.ROPE_EXITS, strict=True)):
            needed = float(np.linalg.norm(top - end))
            shown = next((c for c in ropes.ROPE_CLASSES_M if c >= needed), ropes.ROPE_CLASSES_M[-1])
            mocap = self._mocap(f"rope_{rope}")
            data.mocap_pos[mocap] = end
            data.mocap_quat[mocap] = _turn_up_to((top - end) / needed)
            for length in ropes.ROPE_CLASSES_M:
                self._show(f"rope_{rope}/{length}", moment.present and length == shown, ROPE)

    def _show(self, stem: str, shown: bool, group: int) -> None:
        self.model.geom_group[self.switches[stem]] = group if shown else HIDDEN


def cargo_level(load: float) -> int | None:
    """Index of the heap that stands for a fill, None when empty."""
    if load <= 0:
        return None
    return int(np.abs(np.array(grab.CARGO_LEVELS) - load).argmin())


def placed_shapes(jaw: float, load: float) -> dict[str, Array]:
    """Shapes that the grab shows, each with ``grab_from_shape``, shape (4, 4)."""
    placed = dict(grab.body_frames(jaw))
    level = cargo_level(load)
    return placed if level is None else placed | {f"cargo_{level}": np.eye(4)}


def build(scenario: Scenario, number: int = 0) -> World:
    """Build the world of a scenario.

    Parameters
    ----------
    scenario : Scenario
        That varies no more.
    number : int
        Which of the worlds of one seed: what is random about place and grab, such as stains, differs between them.

    Returns
    -------
    World
    """
    spec = mujoco.MjSpec()
    _set_visuals(spec, scenario)
    place = places.build(
        scenario.place, head_height=scenario.jib.head_height_m, rng=stream(scenario.seed, number, "place")
    )
    place += parked_grabs(
        scenario.clutter.other_grabs,
        place,
        head_height=scenario.jib.head_height_m,
        rng=stream(scenario.seed, number, "clutter.grabs"),
    )
    ground = spec.worldbody.add_body(name="place", mocap=True)
    add_parts(spec, ground, place, group=PLACE, prefix="place")
    steel = jib.jib_parts()
    check_camera(np.array(scenario.camera.offset_m), trimesh.util.concatenate([part.mesh for part in steel]))
    add_parts(spec, spec.worldbody, steel, group=JIB, prefix="jib")
    look = scenario.grab
    parts = grab.grab_parts(
        paint=look.paint_rgb,
        wear=look.wear,
        residue=look.residue,
        cargo=look.cargo,
        rng=stream(scenario.seed, number, "grab"),
    )
    heaps = grab.cargo_parts(look.cargo, stream(scenario.seed, number, "cargo"))
    _add_grab(spec, parts, heaps)
    _add_ropes(spec)
    model = spec.compile()
    shapes = {body: trimesh.util.concatenate([p.mesh for p in own]) for body, own in parts.items()}
    straight = scenario.camera.intrinsics.distortion.is_null
    shapes |= {f"cargo_{level}": heap.mesh for level, heap in enumerate(heaps)}
    return World(
        model=model,
        shapes=shapes,
        outline={name: _cover(mesh, straight=straight) for name, mesh in shapes.items()},
        switches=_switches(model),
        ground=HeightMap.of((part.mesh for part in place), _reach(scenario)),
    )


def _reach(scenario: Scenario) -> float:
    """How far from where O is at first the grab may come, m."""
    if not isinstance(scenario.swing, Dynamic) or isinstance(scenario.swing.work, Hang):
        return GRAB_REACH_M
    return GRAB_REACH_M + TRAVEL_M


def _set_visuals(spec: mujoco.MjSpec, scenario: Scenario) -> None:
    # Clipping planes, fog and the shadow box scale with the extent: fix it, so that no object moves them.
    depth = scenario.jib.head_height_m + (scenario.place.depth_m if isinstance(scenario.place, Hold) else 0.0)
    centre = np.array([0.0, 0.0, -depth])
    spec.stat.extent, spec.stat.center = 1.0, centre
    visual = spec.visual
    visual.map.znear, visual.map.zfar, visual.map.shadowclip = NEAR_M, FAR_M, SHADOW_HALF_WIDTH_SHARE * depth
    visual.quality.offsamples = scenario.image.samples
    visual.quality.shadowsize = scenario.image.shadow_map_px
    visual.headlight.active = 0
    _add_lights(spec, scenario.light, centre, shadows=scenario.image.shadow_map_px > 0)


def _add_lights(spec: mujoco.MjSpec, light: Light, centre: Array, *, shadows: bool) -> None:
    sky = DRAWN_SKY if light.floodlights else light.sky  # `simgrab.world.lamps` takes it down to what there is
    elevation, azimuth = np.radians(light.sun_elevation_deg), np.radians(light.sun_azimuth_deg)
    to_sun = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    warm, cool = np.array([1.0, 0.965, 0.9]), np.array([0.92, 0.97, 1.06])
    directional = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    spec.worldbody.add_light(
        name="sun", type=directional, dir=-to_sun, pos=centre + SHADOW_LIGHT_DISTANCE_M * to_sun, castshadow=shadows,
        diffuse=light.sun * warm, specular=0.4 * light.sun * warm, ambient=np.zeros(3),
    )  # fmt: skip
    # Ambient light belongs here: MuJoCo takes that of a light with shadows away where it does not reach.
    spec.worldbody.add_light(
        name="sky", type=directional, dir=(0, 0, -1), castshadow=False,
        diffuse=0.35 * sky * cool, specular=np.zeros(3), ambient=0.5 * sky * cool,
    )  # fmt: skip


def _add_grab(spec: mujoco.MjSpec, parts: dict[str, list[Part]], heaps: Sequence[Part]) -> None:
    hinge, slide, ball = (getattr(mujoco.mjtJoint, f"mjJNT_{kind}") for kind in ("HINGE", "SLIDE", "BALL"))
    rope_line = spec.worldbody.add_body(name="rope_line", mass=1e-3, inertia=(1e-3, 1e-3, 1e-3), explicitinertial=True)
    rope_line.add_joint(name="swing", type=ball)
    rope_line.add_joint(name="hoist", type=slide, axis=(0, 0, 1))
    head = rope_line.add_body(name="head")  # MuJoCo wants a body of its own for a hinge after a ball
    head.add_joint(name="yaw", type=hinge, axis=(0, 0, 1))
    bodies = {"head": head}
    for name in grab.BODIES[1:]:
        bodies[name] = bodies[linkage.PARENTS[name]].add_body(name=name, pos=linkage.pins[name])
        kind, axis = (slide, (0, 0, 1)) if name == "beam" else (hinge, (0, 1, 0))
        bodies[name].add_joint(name=name, type=kind, axis=axis)
    for name, body in bodies.items():
        add_parts(spec, body, parts[name], group=GRAB, prefix=name)
        _set_inertia(body, parts[name], grab.MASSES_KG[name])
    for level, heap in enumerate(heaps):
        add_parts(spec, head, [heap], group=HIDDEN, prefix=f"cargo_{level}")
    # The inner falls run down inside the closed shells, so their full length may be drawn whatever the jaws do.
    for k, (top, bottom) in enumerate(grab.REEVING):
        drop = bottom + grab.body_frames(grab.MAX_JAW)["beam"][:3, 3] - top
        fall = ropes.rope_part(float(np.linalg.norm(drop)), f"fall_{k}")
        turn = trimesh.geometry.align_vectors([0, 0, 1], -drop)
        turn[:3, 3] = top + drop
        add_parts(spec, head, [fall.moved(turn)], group=ROPE, prefix=f"fall_{k}")


def _set_inertia(body: mujoco.MjsBody, parts: Sequence[Part], mass: float) -> None:
    """Spread a body's mass evenly over the volume of its parts."""
    solid = trimesh.util.concatenate([p.mesh for p in parts])
    solid.density = mass / solid.volume
    inertia = solid.moment_inertia
    body.explicitinertial = True
    body.mass = mass
    body.ipos = solid.center_mass
    body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def _add_ropes(spec: mujoco.MjSpec) -> None:
    for rope in range(len(ropes.ROPE_EXITS)):
        body = spec.worldbody.add_body(name=f"rope_{rope}", mocap=True)
        for length in ropes.ROPE_CLASSES_M:
            part = ropes.rope_part(length, f"rope_{rope}_{length}")
            add_parts(spec, body, [part], group=HIDDEN, prefix=f"rope_{rope}/{length}")


def _turn_up_to(direction: Array) -> Array:
    """Quaternion of the shortest turn from +z to a unit direction that does not point down."""
    quaternion = np.array([1 + direction[2], -direction[1], direction[0], 0.0])
    return np.asarray(quaternion / np.linalg.norm(quaternion))


def _switches(model: mujoco.MjModel) -> dict[str, NDArray[np.int64]]:
    """See `World.switches`; ropes outside the grab and its heaps are hidden at first."""
    found: dict[str, list[int]] = {}
    always = {GRAB: STEEL, ROPE: FALLS}
    for geom in range(model.ngeom):
        group = int(model.geom_group[geom])
        if group == HIDDEN:
            found.setdefault(model.geom(geom).name.rpartition("/")[0], []).append(geom)
        elif group in always:
            found.setdefault(always[group], []).append(geom)
    return {stem: np.array(geoms) for stem, geoms in found.items()}


def _cover(mesh: trimesh.Trimesh, *, straight: bool) -> Array:
    """Points of a mesh, shape (N, 3), among which the outermost of every picture are.

    A lens that draws straight lines straight shows corners of the convex hull outermost. One that bends them may show
    a point along an edge, so the surface near the hull is covered at `COVER_SPACING_M`.
    """
    hull = mesh.convex_hull
    if straight:
        return np.asarray(hull.vertices)
    points = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, max_edge=COVER_SPACING_M, max_iter=20)[0]
    points = np.unique(points.round(6), axis=0)
    normals, on_plane = np.asarray(hull.face_normals), np.asarray(hull.triangles)[:, 0]
    outside = np.full(len(points), -np.inf)
    for normal, offset in zip(normals, np.einsum("ij,ij->i", normals, on_plane), strict=True):
        np.maximum(outside, points @ normal - offset, out=outside)
    return np.asarray(points[outside > -COVER_DEPTH_M])
