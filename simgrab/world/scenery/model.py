"""Build a MuJoCo model from a plan: the grab on its ropes, the jib head above it, the place below."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from simgrab.model.geometry import Array
from simgrab.model.scenario import Hold, Light, Scenario
from simgrab.world.scenery.grabs.weight import spread
from simgrab.world.scenery.meshes import ropes
from simgrab.world.scenery.meshes.part import Material, Part, Texture, add_materials, add_parts
from simgrab.world.scenery.plan import Plan, cargo_level
from simgrab.world.trajectory.moment import Moment

# Geom groups identify what a pixel belongs to.
PLACE, JIB, ROPE, GRAB, HIDDEN = 0, 1, 2, 3, 5
NOTHING = 255  # id of a pixel, or an echo, that shows no geom
STEEL, FALLS = "steel", "falls"

NEAR_M, FAR_M = 0.1, 200.0
SHADOW_HALF_WIDTH_SHARE = 0.8  # of the depth below O: the picture sees a little less at h = 1645 px
SHADOW_LIGHT_DISTANCE_M = 40.0  # the shadow map's depth range starts here; farther out it shows acne
_OF_LIGHTS = (
    "light_pos", "light_dir", "light_pos0", "light_dir0", "light_ambient", "light_diffuse", "light_specular",
    "light_castshadow",
)  # fmt: skip
DRAWN_SKY = 1.0  # at night, so that eight bits keep the darkness


@dataclass(frozen=True, eq=False)
class World:
    """A compiled model and the data needed to pose it.

    Attributes
    ----------
    model : mujoco.MjModel
        World frame = jib frame.
    plan : Plan
        Plan of the model.
    switches : dict of str to ndarray
        Geoms shown only in some states, by the stem of their name: ``cargo_2``, ``rope_0/15``; and those that only an
        absent grab hides: its steel and the falls inside it.
    materials : dict of str to Material
        By their names.
    """

    model: mujoco.MjModel
    plan: Plan
    switches: dict[str, NDArray[np.int64]]
    materials: dict[str, Material]

    @cached_property
    def textures(self) -> dict[str, Texture]:
        """Textures (h, w, 3) by the name of their material; the first row is the top.

        The model itself has none: MuJoCo would copy a hundred megabytes several times.
        """
        pictures = {name: material.picture for name, material in self.materials.items()}
        return {name: picture for name, picture in pictures.items() if picture is not None}

    @cached_property
    def casters(self) -> frozenset[int]:
        """Geoms that cast shadows."""
        shades = [self.materials[self.model.material(number).name].shades for number in self.model.geom_matid]
        return frozenset(np.flatnonzero(shades).tolist())

    def pose(self, data: mujoco.MjData, moment: Moment) -> None:
        """Set ``data`` to the moment, and ``model``'s geom groups to its visible geoms: cargo heap and ropes."""
        model, state = self.model, moment.grab
        place, slew = (moment.jib.jib_from_place.translation, moment.jib.slew) if moment.jib else (np.zeros(3), 0.0)
        data.mocap_pos[self._mocap("place")] = place
        data.mocap_quat[self._mocap("place")] = (np.cos(slew / 2), 0, 0, -np.sin(slew / 2))
        lean, azimuth = state.head or (state.alpha, state.azimuth)
        half = lean / 2
        data.joint("swing").qpos = (np.cos(half), np.sin(half) * np.sin(azimuth), -np.sin(half) * np.cos(azimuth), 0.0)
        if state.head:  # the grab's axis does not go through O: its line hangs from beside it
            pose = state.jib_from_grab
            model.body_pos[model.body("rope_line").id] = pose.translation + state.rope_length * pose.rotation[:, 2]
        data.joint("hoist").qpos = -state.rope_length
        data.joint("yaw").qpos = state.yaw
        for name, position in self.plan.grab.positions(state.jaw).items():
            data.joint(name).qpos = position
        shown = cargo_level(state.load) if moment.present else None
        for level in range(len(self.plan.heaps)):
            self._show(f"cargo_{level}", level == shown, GRAB)
        self._show(STEEL, moment.present, GRAB)
        self._show(FALLS, moment.present, ROPE)
        self._hang_ropes(data, moment)
        self._hang_balls(data, moment)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
        self._shine(data, moment)

    def _shine(self, data: mujoco.MjData, moment: Moment) -> None:
        """Keep the sun fixed over the place, and its shadows in the camera's view."""
        if moment.jib:
            sun = self.model.light("sun").id
            direction = moment.jib.jib_from_place.rotation @ self.model.light_dir[sun]
            centre = self.model.light_pos[sun] + SHADOW_LIGHT_DISTANCE_M * self.model.light_dir[sun]
            data.light_xdir[sun] = direction
            data.light_xpos[sun] = centre - SHADOW_LIGHT_DISTANCE_M * direction

    def relight(self, scenario: Scenario) -> None:
        """Give the model the lights of another scenario with the same place and jib, as `build` would."""
        spec = mujoco.MjSpec()
        _add_lights(spec, scenario.light, _centre(scenario), shadows=_casts_shadows(scenario))
        lights = spec.compile()
        for name in _OF_LIGHTS:
            getattr(self.model, name)[:] = getattr(lights, name)

    def _mocap(self, body: str) -> int:
        return int(self.model.body(body).mocapid[0])

    def _hang_ropes(self, data: mujoco.MjData, moment: Moment) -> None:
        """Draw each rope straight from its termination to its exit, with the shortest mesh that reaches."""
        ends = moment.grab.jib_from_grab.apply(self.plan.grab.terminations)
        for rope, (end, top) in enumerate(zip(ends, self.plan.ropes.exits, strict=True)):
            needed = float(np.linalg.norm(top - end))
            shown = next((c for c in ropes.ROPE_CLASSES_M if c >= needed), ropes.ROPE_CLASSES_M[-1])
            mocap = self._mocap(f"rope_{rope}")
            data.mocap_pos[mocap] = end
            data.mocap_quat[mocap] = _turn_up_to((top - end) / needed)
            for length in ropes.ROPE_CLASSES_M:
                self._show(f"rope_{rope}/{length}", moment.present and length == shown, ROPE)

    def _hang_balls(self, data: mujoco.MjData, moment: Moment) -> None:
        """Put the balls on the line from O to the middle of the rope ends."""
        pose = moment.grab.jib_from_grab
        end = pose.translation + self.plan.grab.terminations[0, 2] * pose.rotation[:, 2]
        for number, (distance, _) in enumerate(self.plan.balls):
            data.mocap_pos[self._mocap(f"ball_{number}")] = distance / np.linalg.norm(end) * end
            self._show(f"ball_{number}", moment.present, ROPE)

    def _show(self, stem: str, shown: bool, group: int) -> None:
        self.model.geom_group[self.switches[stem]] = group if shown else HIDDEN


def build(plan: Plan, *, textured: bool = False) -> World:
    """Build a planned world.

    Parameters
    ----------
    plan : Plan
    textured : bool
        Whether the model includes the textures, for MuJoCo's own renderer.
    """
    spec = mujoco.MjSpec()
    _set_visuals(spec, plan.scenario)
    ground = spec.worldbody.add_body(name="place", mocap=True)
    add_parts(spec, ground, plan.place, group=PLACE, prefix="place")
    add_parts(spec, spec.worldbody, plan.jib, group=JIB, prefix="jib")
    _add_grab(spec, plan)
    rope = _add_ropes(spec, plan.ropes)
    balls = [part for _, part in plan.balls]
    for number, part in enumerate(balls):
        body = spec.worldbody.add_body(name=f"ball_{number}", mocap=True)
        add_parts(spec, body, [part], group=HIDDEN, prefix=f"ball_{number}")
    own = chain(plan.place, plan.jib, *plan.bodies.values(), plan.heaps, [rope], balls)
    materials = {part.material.name: part.material for part in own}
    add_materials(spec, materials.values(), textured=textured)
    model = spec.compile()
    return World(model, plan, _switches(model), materials)


def _set_visuals(spec: mujoco.MjSpec, scenario: Scenario) -> None:
    # Clipping planes, fog and the shadow box scale with the extent: fix it, so that no object moves them.
    centre = _centre(scenario)
    spec.stat.extent, spec.stat.center = 1.0, centre
    visual = spec.visual
    visual.map.znear, visual.map.zfar, visual.map.shadowclip = NEAR_M, FAR_M, -SHADOW_HALF_WIDTH_SHARE * centre[2]
    visual.quality.offsamples = scenario.image.samples
    visual.quality.shadowsize = scenario.image.shadow_map_px
    visual.headlight.active = 0
    _add_lights(spec, scenario.light, centre, shadows=_casts_shadows(scenario))


def _centre(scenario: Scenario) -> Array:
    """Point of the lowest ground straight below O, jib frame, m."""
    depth = scenario.jib.head_height_m + (scenario.place.depth_m if isinstance(scenario.place, Hold) else 0.0)
    return np.array([0.0, 0.0, -depth])


def _casts_shadows(scenario: Scenario) -> bool:
    # A shadow map takes half of a picture's time, even of a sun that is not there.
    return scenario.image.shadow_map_px > 0 and scenario.light.sun > 0


def _add_lights(spec: mujoco.MjSpec, light: Light, centre: Array, *, shadows: bool) -> None:
    sky = DRAWN_SKY if light.floodlights else light.sky  # `simgrab.world.camera.lamps` takes it down to what there is
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


def _add_grab(spec: mujoco.MjSpec, plan: Plan) -> None:
    design = plan.grab
    hinge, slide, ball = (getattr(mujoco.mjtJoint, f"mjJNT_{kind}") for kind in ("HINGE", "SLIDE", "BALL"))
    rope_line = spec.worldbody.add_body(name="rope_line", mass=1e-3, inertia=(1e-3, 1e-3, 1e-3), explicitinertial=True)
    rope_line.add_joint(name="swing", type=ball)
    rope_line.add_joint(name="hoist", type=slide, axis=(0, 0, 1))
    head = rope_line.add_body(name="head")  # MuJoCo wants a body of its own for a hinge after a ball
    head.add_joint(name="yaw", type=hinge, axis=(0, 0, 1))
    bodies = {design.bodies[0].name: head}
    for own in design.bodies[1:]:
        bodies[own.name] = bodies[own.parent].add_body(name=own.name, pos=own.pin)
        bodies[own.name].add_joint(name=own.name, type=slide if own.slides else hinge, axis=own.axis)
    for own in design.bodies:
        add_parts(spec, bodies[own.name], plan.bodies[own.name], group=GRAB, prefix=own.name)
        _set_inertia(bodies[own.name], own.solid, own.mass_kg)
    for level, heap in enumerate(plan.heaps):
        add_parts(spec, head, [heap], group=HIDDEN, prefix=f"cargo_{level}")
    # The inner falls run down inside the closed shells, so their full length may be drawn whatever the jaws do.
    drawn = design.falls if design.falls_from == design.bodies[0].name else ()
    for k, (top, bottom) in enumerate(drawn):
        drop = bottom + design.frames(design.max_jaw)[design.falls_to][:3, 3] - top
        fall = ropes.rope_part(float(np.linalg.norm(drop)), f"fall_{k}", plan.ropes.radius_m)
        turn = trimesh.geometry.align_vectors([0, 0, 1], -drop)
        turn[:3, 3] = top + drop
        add_parts(spec, head, [fall.moved(turn)], group=ROPE, prefix=f"fall_{k}")


def _set_inertia(body: mujoco.MjsBody, steel: trimesh.Trimesh, mass: float) -> None:
    """Spread a body's mass evenly over the volume of its steel."""
    solid = spread(steel, mass)
    inertia = solid.moment_inertia
    body.explicitinertial = True
    body.mass = mass
    body.ipos = solid.center_mass
    body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def _add_ropes(spec: mujoco.MjSpec, own: ropes.Ropes) -> Part:
    """Add ropes of all lengths, and return one of them."""
    for rope in range(len(own.exits)):
        body = spec.worldbody.add_body(name=f"rope_{rope}", mocap=True)
        for length in ropes.ROPE_CLASSES_M:
            part = ropes.rope_part(length, f"rope_{rope}_{length}", own.radius_m)
            add_parts(spec, body, [part], group=HIDDEN, prefix=f"rope_{rope}/{length}")
    return part


def _turn_up_to(direction: Array) -> Array:
    """Quaternion of the shortest turn from +z to a unit direction that does not point down."""
    quaternion = np.array([1 + direction[2], -direction[1], direction[0], 0.0])
    return np.asarray(quaternion / np.linalg.norm(quaternion))


def _switches(model: mujoco.MjModel) -> dict[str, NDArray[np.int64]]:
    """See `World.switches`; ropes outside the grab and its heaps are hidden at first."""
    found: dict[str, list[int]] = {STEEL: [], FALLS: []}
    always = {GRAB: STEEL, ROPE: FALLS}
    for geom, group in enumerate(model.geom_group.tolist()):
        stem = model.geom(geom).name.rpartition("/")[0] if group == HIDDEN else always.get(group)
        if stem:
            found.setdefault(stem, []).append(geom)
    return {stem: np.array(geoms, int) for stem, geoms in found.items()}
