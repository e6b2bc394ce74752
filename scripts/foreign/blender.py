"""Path-trace exported scenes as a job file says; `scripts.foreign_exam` runs it by an interpreter that can import bpy.

bpy is licensed under the GPL: simgrab neither installs nor imports it, and measures with it where a user has it. The
file imports NumPy alone beside it. A job is JSON: a list of tables with the arguments of `render`.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scripts.foreign.surfaces import PLACE, Surfaces
from scripts.foreign.yard import Yard, blender_image

Array = NDArray[np.float64]
AGX_LEVEL = 0.16  # mean linear luminance that the AgX view transform is given
BLENDER_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
SENSOR_MM = 36.0
TINTS = ((1.0, 0.62, 0.28), (1.0, 0.80, 0.55), (0.90, 0.95, 1.0), (1.0, 0.95, 0.88))  # of lamps


class Foreign:
    """A scene in linear light, in which some things are replaced. See `render` for the parameters."""

    def __init__(self, scene: Mapping[str, Any], table: Mapping[str, Any]) -> None:
        import bpy  # type: ignore[import-not-found]

        bpy.ops.wm.read_factory_settings(use_empty=True)
        self._bpy, self._exported, self._table = bpy, scene, table
        self._replaced = frozenset(table["replaced"])
        self._rng = np.random.default_rng(table["seed"])
        self._surfaces: Surfaces | None = None
        self._scene = bpy.context.scene
        self._images: dict[int, Any] = {}
        shown = scene["shown"] & ((scene["groups"] != PLACE) | ("ground" not in self._replaced))
        self._geoms = {int(geom): self._object(int(geom)) for geom in np.flatnonzero(shown)}
        self._add_lights()
        self._add_camera()
        self._scene.view_settings.view_transform = "Raw"
        self._prepare()
        if "ground" in self._replaced:
            yard = Yard(bpy, self._rng, table["photographs"])
            yard.build(scene["jib_from_camera"], ground=table["ground_m"], ceiling=table["ceiling_m"])

    def _prepare(self) -> None:
        render, cycles = self._scene.render, self._scene.cycles
        width, height = self._exported["camera"][:2]
        render.resolution_x, render.resolution_y, render.resolution_percentage = int(width), int(height), 100
        render.engine = "CYCLES"
        render.use_persistent_data = False
        render.threads_mode, render.threads = "FIXED", self._table["threads"]
        cycles.device, cycles.seed = "CPU", 1
        cycles.use_adaptive_sampling, cycles.use_denoising, cycles.denoiser = False, True, "OPENIMAGEDENOISE"
        cycles.denoising_quality = cycles.denoising_prefilter = "FAST"
        cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 3, 1, 2
        cycles.transparent_max_bounces = 4
        cycles.caustics_reflective = cycles.caustics_refractive = False
        cycles.sample_clamp_indirect = 4.0

    def _object(self, geom: int) -> Any:
        import mathutils  # type: ignore[import-not-found]

        scene = self._exported
        vertices, faces = (np.split(scene[part], scene[f"{part}_ends"])[geom] for part in ("vertices", "faces"))
        a, b, c = faces.T
        faces = faces[(a != b) & (b != c) & (c != a)]  # Blender crashes where two corners are the same
        mesh = self._bpy.data.meshes.new(f"geom {geom}")
        mesh.from_pydata(vertices[:, :3].tolist(), [], faces.tolist())
        corners = vertices[faces.ravel()]
        mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", corners[:, 6:].ravel())
        mesh.normals_split_custom_set(corners[:, 3:6].tolist())
        mesh.materials.append(self._material(geom))
        thing = self._bpy.data.objects.new(mesh.name, mesh)
        thing.matrix_world = mathutils.Matrix(scene["jib_from_geom"][geom])
        self._scene.collection.objects.link(thing)
        return thing

    def _material(self, geom: int) -> Any:
        scene = self._exported
        texture, colour = int(scene["texture"][geom]), linear(np.clip(scene["colours"][geom], 0.0, 1.0))
        if "textures" in self._replaced:
            self._surfaces = self._surfaces or Surfaces(self._bpy, self._rng)
            if texture >= 0:
                colour = colour * linear(scene[f"texture_{texture}"][::7, ::7] / 255).mean(axis=(0, 1))
            name, group = str(scene["names"][geom]), int(scene["groups"][geom])
            return self._surfaces.of(name, group, tuple(map(float, colour)))
        material = self._bpy.data.materials.new(f"geom {geom}")
        material.use_nodes = True
        tree = material.node_tree
        tree.nodes.clear()
        surface = tree.nodes.new("ShaderNodeBsdfDiffuse")
        tree.links.new(surface.outputs["BSDF"], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
        surface.inputs["Color"].default_value = (*colour, 1.0)
        if texture >= 0:
            if texture not in self._images:
                self._images[texture] = blender_image(
                    self._bpy, f"texture {texture}", scene[f"texture_{texture}"], "sRGB"
                )
            picture, product = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeVectorMath")
            picture.image, product.operation = self._images[texture], "MULTIPLY"
            product.inputs[1].default_value = colour
            tree.links.new(picture.outputs["Color"], product.inputs[0])
            tree.links.new(product.outputs["Vector"], surface.inputs["Color"])
        return material

    def _add_camera(self) -> None:
        import mathutils

        width, height, f, cx, cy = self._exported["camera"]
        lens = self._bpy.data.cameras.new("camera")
        lens.sensor_fit, lens.sensor_width, lens.lens = "HORIZONTAL", SENSOR_MM, f * SENSOR_MM / width
        lens.shift_x, lens.shift_y = (width / 2 - cx) / width, (cy - height / 2) / width
        lens.clip_start, lens.clip_end = 0.1, 500.0
        thing = self._bpy.data.objects.new("camera", lens)
        thing.matrix_world = mathutils.Matrix(self._exported["jib_from_camera"] @ BLENDER_FROM_OPENCV)
        self._scene.collection.objects.link(thing)
        self._scene.camera = thing

    def _add_lights(self) -> None:
        world = self._bpy.data.worlds.new("sky")
        world.use_nodes = True
        background = world.node_tree.nodes["Background"]
        if "light" not in self._replaced:
            self._own_light(background)
        elif self._table["light"] == "sun":
            self._foreign_sky(world.node_tree, background)
        else:
            self._foreign_night(background)
        self._scene.world = world

    def _own_light(self, background: Any) -> None:
        """Simgrab's sun; what its other lights give evenly is the sky's."""
        scene = self._exported
        even, full = (linear(scene["ambient"] + scene["light_colours"][first:].sum(axis=0)) for first in (1, 0))
        light = self._bpy.data.lights.new("sun", "SUN")
        light.energy, light.color, light.use_shadow, light.angle = np.pi, tuple(full - even), True, math.radians(0.53)
        self._put(light, (0, 0, 0), scene["light_directions"][0])
        background.inputs["Color"].default_value = (*even, 1.0)

    def _foreign_sky(self, tree: Any, background: Any) -> None:
        rng, sky = self._rng, tree.nodes.new("ShaderNodeTexSky")
        sky.sky_type = "MULTIPLE_SCATTERING"
        low, high = (3, 14) if self._table["dusk"] else (20, 65)
        sky.sun_elevation, sky.sun_rotation = math.radians(rng.uniform(low, high)), rng.uniform(0, 2 * math.pi)
        sky.air_density, sky.aerosol_density = rng.uniform(0.7, 2.0), rng.uniform(0.3, 4.0)
        sky.sun_intensity = rng.choice([1.0, 1.0, 0.25, 0.02])  # the last two are hazy and overcast
        background.inputs["Strength"].default_value = 0.1
        tree.links.new(sky.outputs["Color"], background.inputs["Color"])

    def _foreign_night(self, background: Any) -> None:
        rng, ground = self._rng, self._table["ground_m"]
        background.inputs["Color"].default_value = (0.004, 0.005, 0.008, 1.0)
        camera = self._exported["jib_from_camera"][:3, 3]
        tint = TINTS[int(rng.integers(len(TINTS)))]
        places = [
            camera + (rng.uniform(-2.5, 2.5), side * rng.uniform(1.0, 3.0), rng.uniform(0.2, 1.2)) for side in (-1, 1)
        ]
        for place in places:  # at the jib head, behind the camera
            self._lamp(place, (rng.uniform(-2, 2), rng.uniform(-2, 2), -25.0), 4000 * rng.uniform(0.6, 1.6), tint)
        for _ in range(int(rng.integers(1, 4))):  # masts of the yard
            angle, far = rng.uniform(0, 2 * math.pi), rng.uniform(22, 45)
            place = np.array((far * math.cos(angle), far * math.sin(angle), ground + rng.uniform(18, 30)))
            tint = TINTS[int(rng.integers(len(TINTS)))]
            self._lamp(place, (0.0, 0.0, ground), 20000 * rng.uniform(0.3, 1.2), tint)

    def _lamp(self, place: Array, towards: Sequence[float], watts: float, tint: tuple[float, float, float]) -> None:
        light = self._bpy.data.lights.new("lamp", "AREA")
        light.shape, light.size, light.size_y = "RECTANGLE", 0.9, 0.4
        light.energy, light.color, light.spread = watts, tint, math.radians(120)
        self._put(light, place, np.subtract(towards, place))

    def _put(self, light: Any, place: Any, along: Any) -> None:
        import mathutils

        thing = self._bpy.data.objects.new(light.name, light)
        thing.location, thing.rotation_mode = place, "QUATERNION"
        thing.rotation_quaternion = mathutils.Vector(along).to_track_quat("-Z", "Y")
        self._scene.collection.objects.link(thing)

    def light(self, samples: int) -> Array:
        """Render linear light, shape (height, width, 3). The foreign light comes through the AgX view transform."""
        self._scene.cycles.samples = samples
        self._bpy.ops.render.render()
        light = self._read("OPEN_EXR", "32", "Raw")
        if "light" not in self._replaced:
            return light
        level = max(float((light[4::8, 4::8] @ (0.2126, 0.7152, 0.0722)).mean()), 1e-6)
        view = self._scene.view_settings
        view.exposure = math.log2(AGX_LEVEL * self._rng.uniform(0.7, 1.5) / level)
        view.look = str(self._rng.choice(["None", "Medium High Contrast", "High Contrast"]))
        return linear(self._read("PNG", "16", "AgX"))

    def _read(self, file_format: str, depth: str, view: str) -> Array:
        """Save what was rendered last, and read it as values of red, green and blue, the first row the top."""
        settings = self._scene.render.image_settings
        settings.file_format, settings.color_depth, settings.color_mode = file_format, depth, "RGB"
        self._scene.view_settings.view_transform = view
        with tempfile.TemporaryDirectory() as folder:
            path = str(Path(folder) / "picture")
            self._bpy.data.images["Render Result"].save_render(path)
            image = self._bpy.data.images.load(path)
            image.colorspace_settings.name = "Non-Color"
            width, height = image.size  # which reads the file
            values = np.empty(width * height * image.channels, np.float32)
            image.pixels.foreach_get(values)
        self._bpy.data.images.remove(image)
        return values.reshape(height, width, -1)[::-1, :, :3].astype(float)


def linear(values: Any) -> Any:
    """Turn display values of sRGB into linear light; above 1 the curve goes on."""
    values = np.asarray(values, float)
    return np.where(values <= 0.04045, values / 12.92, ((np.maximum(values, 0) + 0.055) / 1.055) ** 2.4)


def render(table: dict[str, Any]) -> None:
    """Render one scene.

    Parameters
    ----------
    table : dict
        ``scene``: path of what `scripts.foreign.export.export` returns, as NumPy's archive. ``replaced``: of textures,
        ground and light. ``light``: sun or lamps; ``dusk``: whether the sun is low. ``ground_m``, ``ceiling_m``: z of
        the foreign yard, and of what is highest on it. ``photographs``: path of an archive of pictures for it.
        ``seed``, ``samples``, ``threads``. ``out``: where linear light goes as an array.
    """
    with np.load(table["scene"]) as file:
        made = Foreign(dict(file), table)
    np.save(table["out"], made.light(table["samples"]).astype(np.float16))


if __name__ == "__main__":
    for job in json.loads(Path(sys.argv[1]).read_text()):
        render(job)
