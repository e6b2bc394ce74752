"""Path-trace exported scenes as a job file says; `scripts.foreign_exam` runs it by an interpreter that can import bpy.

bpy is licensed under the GPL: simgrab neither installs nor imports it, and measures with it where a user has it. The
file imports NumPy alone beside it. A job is JSON: a list of tables with the arguments of `render`, or one such table of
a scene of several frames, which are then rendered as `scripts.bench_scene.serve` is asked to.
"""

from __future__ import annotations

import functools
import json
import math
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from scripts.bench_blender import Blender
from scripts.bench_scene import Array, ExportedScene, serve
from scripts.foreign.surfaces import PLACE, Surfaces
from scripts.foreign.yard import Yard

NOTHING = 255
AGX_LEVEL = 0.16  # mean linear luminance that the AgX view transform is given


class Foreign(Blender):
    """A scene in linear light, in which some things are replaced. Of several frames, the first one is posed first.

    Parameters
    ----------
    scene : ExportedScene
    table : dict
        See `render`.
    """

    colours = "sRGB"

    def __init__(self, scene: ExportedScene, table: dict[str, Any]) -> None:
        self._table, self._replaced = table, frozenset(table["replaced"])
        self._rng = np.random.default_rng(table["seed"])
        self._surfaces: Surfaces | None = None
        self._carried: list[tuple[Any, Array]] = []
        self._tone: tuple[float, str] | None = None
        self._light: Array | None = None
        self._level: float | None = None
        super().__init__(scene, "cycles")
        self.pose(0)
        if "ground" in self._replaced:
            Yard(self._bpy, self._rng, table["photographs"]).build(
                scene.jib_from_camera, ground=table["ground_m"], ceiling=table["ceiling_m"]
            )

    def _prepare(self, engine: str) -> None:
        render, cycles = self._scene.render, self._scene.cycles
        render.engine = engine.upper()
        render.use_persistent_data = len(self._exported.jib_from_camera) > 1
        render.threads_mode, render.threads = "FIXED", self._table["threads"]
        cycles.device, cycles.seed = "CPU", 1
        cycles.use_adaptive_sampling, cycles.use_denoising, cycles.denoiser = False, True, "OPENIMAGEDENOISE"
        cycles.denoising_quality = cycles.denoising_prefilter = "FAST"
        cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 3, 1, 2
        cycles.transparent_max_bounces = 4
        cycles.caustics_reflective = cycles.caustics_refractive = False
        cycles.sample_clamp_indirect = 4.0

    def _chosen(self) -> Any:
        shown = self._exported.shown
        if "ground" in self._replaced:
            shown = shown & (self._exported.groups != PLACE)
        return np.flatnonzero(shown.any(axis=0))

    def _group(self, geom: int) -> int:
        """Group of a geom in the first frame that shows it."""
        return int(self._exported.groups[self._exported.shown[:, geom].argmax(), geom])

    def _material(self, geom: int) -> Any:
        scene = self._exported
        group, texture = self._group(geom), int(scene.texture[geom])
        colour = linear(np.clip(scene.colours[geom], 0.0, 1.0))
        if "textures" in self._replaced:
            if self._surfaces is None:
                self._surfaces = Surfaces(self._bpy, self._rng)
            if texture >= 0:
                colour = colour * linear(scene.textures[texture][::7, ::7] / 255).mean(axis=(0, 1))
            return self._surfaces.of(str(scene.names[geom]), group, tuple(map(float, colour)))
        material = super()._material(geom)
        tree = material.node_tree
        surface = next(node for node in tree.nodes if node.type == "BSDF_DIFFUSE")
        surface.inputs["Color"].default_value = (*colour, 1.0)
        for node in tree.nodes:
            if node.type == "VECT_MATH":
                node.inputs[1].default_value = colour
        return material

    def _add_lights(self) -> None:
        if "light" in self._replaced:
            self._scene.world = self._foreign_sky() if self._table["light"] == "sun" else self._foreign_night()
            return
        scene = self._exported
        even = linear(scene.ambient + scene.light_colours[1:].sum(axis=0))
        super()._add_lights()
        lights = [thing.data for thing in self._bpy.data.objects if thing.type == "LIGHT"]
        sun = linear(scene.ambient + scene.light_colours.sum(axis=0)) - even
        for number, light in enumerate(lights):
            light.color = tuple(sun) if number == 0 else (0.0, 0.0, 0.0)  # the even sky is the world's
            light.angle = math.radians(0.53)
        self._scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (*even, 1.0)

    def _foreign_sky(self) -> Any:
        rng, bpy = self._rng, self._bpy
        world = bpy.data.worlds.new("foreign sky")
        world.use_nodes = True
        tree = world.node_tree
        sky = tree.nodes.new("ShaderNodeTexSky")
        sky.sky_type = "MULTIPLE_SCATTERING"
        low, high = (3, 14) if self._table["dusk"] else (20, 65)
        sky.sun_elevation, sky.sun_rotation = math.radians(rng.uniform(low, high)), rng.uniform(0, 2 * math.pi)
        sky.air_density, sky.aerosol_density = rng.uniform(0.7, 2.0), rng.uniform(0.3, 4.0)
        sky.sun_intensity = rng.choice([1.0, 1.0, 0.25, 0.02])  # the last two are hazy and overcast
        background = tree.nodes["Background"]
        background.inputs["Strength"].default_value = 0.1
        tree.links.new(sky.outputs["Color"], background.inputs["Color"])
        return world

    def _foreign_night(self) -> Any:
        rng, bpy = self._rng, self._bpy
        world = bpy.data.worlds.new("foreign night")
        world.use_nodes = True
        world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.004, 0.005, 0.008, 1.0)
        tints = ((1.0, 0.62, 0.28), (1.0, 0.80, 0.55), (0.90, 0.95, 1.0), (1.0, 0.95, 0.88))
        camera = self._exported.jib_from_camera[0][:3, 3]
        tint = tints[int(rng.integers(len(tints)))]
        places = [
            camera + (rng.uniform(-2.5, 2.5), side * rng.uniform(1.0, 3.0), rng.uniform(0.2, 1.2)) for side in (-1, 1)
        ]
        for place in places:  # at the jib head, behind the camera
            lamp = self._lamp(
                place, (rng.uniform(-2, 2), rng.uniform(-2, 2), -25.0), 4000 * rng.uniform(0.6, 1.6), tint
            )
            self._carried.append((lamp, np.array(lamp.matrix_basis)))
        for _ in range(int(rng.integers(1, 4))):  # masts of the yard
            angle, far = rng.uniform(0, 2 * math.pi), rng.uniform(22, 45)
            place = np.array(
                (far * math.cos(angle), far * math.sin(angle), self._table["ground_m"] + rng.uniform(18, 30))
            )
            tint = tints[int(rng.integers(len(tints)))]
            self._lamp(place, (0.0, 0.0, self._table["ground_m"]), 20000 * rng.uniform(0.3, 1.2), tint)
        return world

    def _lamp(self, place: Array, towards: Sequence[float], watts: float, tint: tuple[float, float, float]) -> Any:
        import mathutils  # type: ignore[import-not-found]

        light = self._bpy.data.lights.new("lamp", "AREA")
        light.shape, light.size, light.size_y = "RECTANGLE", 0.9, 0.4
        light.energy, light.color, light.spread = watts, tint, math.radians(120)
        thing = self._bpy.data.objects.new("lamp", light)
        thing.location, thing.rotation_mode = place, "QUATERNION"
        thing.rotation_quaternion = mathutils.Vector(np.subtract(towards, place)).to_track_quat("-Z", "Y")
        self._scene.collection.objects.link(thing)
        return thing

    def pose(self, frame: int) -> None:
        """Put camera, geoms and the lamps of the jib head where they are in a frame."""
        import mathutils

        super().pose(frame)
        for lamp, first in self._carried:
            lamp.matrix_basis = mathutils.Matrix(np.array(self._table["jib_poses"][frame]) @ first)

    def render(self, frame: int) -> None:
        """See `scripts.bench_scene.SceneRenderer.render`."""
        self.pose(frame)
        if self._table["grain"]:
            self._scene.cycles.seed = frame + 1
        self._light = self.light(self._table["samples"])

    def save(self, path: str) -> None:
        """Write linear light of the frame rendered last as an array."""
        assert self._light is not None
        with Path(path).open("wb") as file:
            np.save(file, self._light.astype(np.float16))

    def light(self, samples: int) -> Array:
        """Render linear light, shape (height, width, 3). The foreign light comes through the AgX view transform."""
        self._scene.cycles.samples = samples
        self._bpy.ops.render.render()
        light = self._read("OPEN_EXR", "32", "Raw")
        if "light" not in self._replaced:
            return light
        if self._level is None or self._table["grain"]:
            self._level = float((light[4::8, 4::8] @ (0.2126, 0.7152, 0.0722)).mean())
        view = self._scene.view_settings
        if self._tone is None:  # that of all frames
            looks = ["None", "Medium High Contrast", "High Contrast"]
            self._tone = self._rng.uniform(0.7, 1.5), str(self._rng.choice(looks))
        view.exposure, view.look = math.log2(AGX_LEVEL * self._tone[0] / max(self._level, 1e-6)), self._tone[1]
        return linear(self._read("PNG", "16", "AgX"))

    def ids(self, finer: int, window: Sequence[int]) -> Any:
        """Render what each pixel of a window shows, one ray through its centre, shape (height, width) of the window.

        Parameters
        ----------
        finer : int
            Samples a pixel and direction.
        window : sequence of 4 ints
            x0, y0, x1, y1 in the finer picture.
        """
        scene, cycles, render = self._scene, self._scene.cycles, self._scene.render
        for geom, thing in self._geoms.items():
            thing.data.materials[0] = self._flat((self._group(geom) + 1) / 8)
        for thing in scene.objects:
            if thing.type == "LIGHT" or (thing.type == "MESH" and thing not in self._geoms.values()):
                thing.hide_render = True
        scene.world = None
        width, height = (finer * side for side in self._exported.size)
        x0, y0, x1, y1 = window
        render.resolution_percentage, render.use_border, render.use_crop_to_border = 100 * finer, True, False
        render.border_min_x, render.border_max_x = x0 / width, x1 / width
        render.border_min_y, render.border_max_y = 1 - y1 / height, 1 - y0 / height
        cycles.samples, cycles.use_denoising, cycles.max_bounces = 1, False, 0
        cycles.pixel_filter_type, cycles.filter_width = "BOX", 0.01
        scene.view_settings.exposure = 0.0
        self._bpy.ops.render.render()
        groups = np.rint(self._read("OPEN_EXR", "32", "Raw")[y0:y1, x0:x1, 0] * 8).astype(int) - 1
        return np.where(groups < 0, NOTHING, groups).astype(np.uint8)

    def _flat(self, level: float) -> Any:
        name = f"flat {level}"
        known = self._bpy.data.materials.get(name)
        if known:
            return known
        material = self._bpy.data.materials.new(name)
        material.use_nodes = True
        tree = material.node_tree
        tree.nodes.clear()
        emission, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
        emission.inputs["Color"].default_value = (level, level, level, 1.0)
        tree.links.new(emission.outputs["Emission"], output.inputs["Surface"])
        return material

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
        ``scene``: path of an `ExportedScene`. ``replaced``: of textures, ground and light. ``light``: sun or lamps;
        ``dusk``: whether the sun is low. ``ground_m``, ``ceiling_m``: z of the foreign yard, and of what is highest on
        it. ``photographs``: path of an archive of pictures for it. ``seed``, ``samples``, ``threads``. ``out``: where
        linear light goes as an array. ``ids``: where ids go as an array, or none; ``ids_finer`` and ``ids_window``.
        Of a scene of several frames, which is given in the jib frame of its first frame: ``jib_poses``, pose of each
        frame's jib frame in that one, shape (frames, 4, 4); ``grain``, whether each frame has noise of the path tracer
        of its own and an exposure by its own brightness, in place of those of the first.
    """
    made = Foreign(ExportedScene.load(Path(table["scene"])), table)
    if table["out"]:
        np.save(table["out"], made.light(table["samples"]).astype(np.float16))
    if table["ids"]:
        np.save(table["ids"], made.ids(table["ids_finer"], table["ids_window"]))


def main(path: Path) -> None:
    """Render a list of scenes; or serve the frames of one, of whose table ``out`` and ``ids`` are not needed."""
    job = json.loads(path.read_text())
    if isinstance(job, dict):
        serve(functools.partial(Foreign, table=job), Path(job["scene"]))
        return
    for each in job:
        render(each)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
