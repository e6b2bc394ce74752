"""Path-trace an exported scene as a job says; `scripts.foreign_exam` runs it by an interpreter that can import bpy.

bpy is licensed under the GPL: simgrab neither installs nor imports it, and measures with it where a user has it. The
file imports NumPy alone beside it. A job is JSON: the argument of `render`.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
BLENDER_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
SENSOR_MM = 36.0


class Traced:
    """An exported scene in Blender; ``threads`` are the path tracer's."""

    def __init__(self, scene: Mapping[str, Any], threads: int) -> None:
        import bpy  # type: ignore[import-not-found]

        bpy.ops.wm.read_factory_settings(use_empty=True)
        self._bpy, self._exported, self._scene = bpy, scene, bpy.context.scene
        self._images: dict[int, Any] = {}
        for geom in np.flatnonzero(scene["shown"]):
            self._add_object(int(geom))
        self._add_lights()
        self._add_camera()
        self._prepare(threads)

    def _prepare(self, threads: int) -> None:
        render, cycles = self._scene.render, self._scene.cycles
        width, height = self._exported["camera"][:2]
        render.resolution_x, render.resolution_y, render.resolution_percentage = int(width), int(height), 100
        render.engine = "CYCLES"
        render.use_persistent_data = False
        render.threads_mode, render.threads = "FIXED", threads
        cycles.device, cycles.seed = "CPU", 1
        cycles.use_adaptive_sampling, cycles.use_denoising, cycles.denoiser = False, True, "OPENIMAGEDENOISE"
        cycles.denoising_quality = cycles.denoising_prefilter = "FAST"
        cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 3, 1, 2
        cycles.transparent_max_bounces = 4
        cycles.caustics_reflective = cycles.caustics_refractive = False
        cycles.sample_clamp_indirect = 4.0

    def _add_object(self, geom: int) -> None:
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

    def _material(self, geom: int) -> Any:
        scene = self._exported
        texture, colour = int(scene["texture"][geom]), linear(np.clip(scene["colours"][geom], 0.0, 1.0))
        material = self._bpy.data.materials.new(f"geom {geom}")
        material.use_nodes = True
        tree = material.node_tree
        tree.nodes.clear()
        surface = tree.nodes.new("ShaderNodeBsdfDiffuse")
        tree.links.new(surface.outputs["BSDF"], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
        surface.inputs["Color"].default_value = (*colour, 1.0)
        if texture >= 0:
            if texture not in self._images:
                self._images[texture] = self._image(f"texture {texture}", scene[f"texture_{texture}"])
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
        """Add simgrab's sun; what its other lights give evenly is the sky's."""
        import mathutils

        world = self._bpy.data.worlds.new("sky")
        world.use_nodes = True
        background, scene = world.node_tree.nodes["Background"], self._exported
        even, full = (linear(scene["ambient"] + scene["light_colours"][first:].sum(axis=0)) for first in (1, 0))
        light = self._bpy.data.lights.new("sun", "SUN")
        light.energy, light.color, light.use_shadow, light.angle = np.pi, tuple(full - even), True, math.radians(0.53)
        thing = self._bpy.data.objects.new(light.name, light)
        thing.rotation_mode = "QUATERNION"
        thing.rotation_quaternion = mathutils.Vector(scene["light_directions"][0]).to_track_quat("-Z", "Y")
        self._scene.collection.objects.link(thing)
        background.inputs["Color"].default_value = (*even, 1.0)
        self._scene.world = world

    def _image(self, name: str, picture: Any) -> Any:
        """Make Blender's image of RGB, uint8 of shape (height, width, 3), the first row the bottom."""
        height, width = picture.shape[:2]
        made = self._bpy.data.images.new(name, width, height)
        made.colorspace_settings.name = "sRGB"
        rgba = np.ones((height, width, 4), np.float32)
        rgba[..., :3] = picture / np.float32(255)
        made.pixels.foreach_set(rgba.ravel())
        return made

    def light(self, samples: int) -> Array:
        """Render linear light, shape (height, width, 3), the first row the top."""
        self._scene.cycles.samples = samples
        self._bpy.ops.render.render()
        settings = self._scene.render.image_settings
        settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGB"
        self._scene.view_settings.view_transform = "Raw"
        with tempfile.TemporaryDirectory() as folder:
            path = str(Path(folder) / "picture")
            self._bpy.data.images["Render Result"].save_render(path)
            image = self._bpy.data.images.load(path)
            image.colorspace_settings.name = "Non-Color"
            width, height = image.size  # which reads the file
            values = np.empty(width * height * image.channels, np.float32)
            image.pixels.foreach_get(values)
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
        ``scene``: path of what `scripts.foreign.export.export` returns, as NumPy's archive. ``samples``, ``threads``.
        ``out``: where linear light goes as an array.
    """
    with np.load(table["scene"]) as file:
        made = Traced(dict(file), table["threads"])
    np.save(table["out"], made.light(table["samples"]).astype(np.float16))


if __name__ == "__main__":
    render(json.loads(Path(sys.argv[1]).read_text()))
