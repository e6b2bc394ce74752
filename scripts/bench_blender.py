"""Render an exported scene with Blender; `scripts.bench_renderers` runs it by an interpreter that can import bpy.

bpy is licensed under the GPL: simgrab neither installs nor imports it, and measures it where a user has it.
"""

from __future__ import annotations

import functools
import sys
from pathlib import Path
from typing import Any

import numpy as np

from scripts.bench_scene import ExportedScene, serve

CYCLES_SAMPLES = 16
BLENDER_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
SENSOR_MM = 36.0


class Blender:
    """Renders with Cycles on the CPU or with workbench.

    Colours are taken as MuJoCo takes them, without conversion from and to linear light. Cycles neither adapts the
    number of samples nor denoises, and keeps what it prepared from one frame to the next; its sun casts shadows.
    Workbench is as by default, with textures.
    """

    colours = "Non-Color"

    def __init__(self, scene: ExportedScene, engine: str) -> None:
        import bpy  # type: ignore[import-not-found]

        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.by, self._bpy, self._exported = f"Blender {bpy.app.version_string}", bpy, scene
        self._scene = bpy.context.scene
        self._images: dict[int, Any] = {}
        self._geoms = {int(geom): self._object(int(geom)) for geom in self._chosen()}
        self._add_lights()
        self._camera = self._add_camera()
        self._scene.view_settings.view_transform = "Raw"
        render = self._scene.render
        render.resolution_x, render.resolution_y = scene.size
        render.resolution_percentage = 100
        self._prepare(engine)

    def _prepare(self, engine: str) -> None:
        render = self._scene.render
        render.use_persistent_data = True
        render.engine = {"cycles": "CYCLES", "workbench": "BLENDER_WORKBENCH"}[engine]
        self._scene.display.shading.color_type = "TEXTURE"
        if engine == "cycles":
            self._scene.cycles.samples = 1  # a frame that warms up: meshes and textures are prepared
            self._scene.cycles.use_adaptive_sampling = self._scene.cycles.use_denoising = False
            self.render(0)
            self._scene.cycles.samples = CYCLES_SAMPLES

    def render(self, frame: int) -> None:
        """See `SceneRenderer.render`."""
        self.pose(frame)
        self._bpy.ops.render.render()

    def pose(self, frame: int) -> None:
        """Put camera and geoms where they are in a frame."""
        import mathutils  # type: ignore[import-not-found]

        scene = self._exported
        self._camera.matrix_world = mathutils.Matrix(scene.jib_from_camera[frame] @ BLENDER_FROM_OPENCV)
        for geom, thing in self._geoms.items():
            thing.hide_render = not scene.shown[frame, geom]
            if scene.shown[frame, geom]:
                thing.matrix_world = mathutils.Matrix(scene.jib_from_geom[frame, geom])

    def save(self, path: str) -> None:
        """See `SceneRenderer.save`."""
        self._bpy.data.images["Render Result"].save_render(path)

    def _chosen(self) -> Any:
        """Geoms that any frame shows."""
        return np.flatnonzero(self._exported.shown.any(axis=0))

    def _image(self, number: int) -> Any:
        if number not in self._images:
            picture = self._exported.textures[number]
            self._images[number] = blender_image(self._bpy, f"texture {number}", picture, self.colours)
        return self._images[number]

    def _object(self, geom: int) -> Any:
        vertices, faces = self._exported.mesh(geom)
        a, b, c = faces.T
        faces = faces[(a != b) & (b != c) & (c != a)]  # Blender crashes where two corners are the same
        name = f"geom {geom}"
        mesh = self._bpy.data.meshes.new(name)
        mesh.from_pydata(vertices[:, :3].tolist(), [], faces.tolist())
        corners = vertices[faces.ravel()]
        mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", corners[:, 6:].ravel())
        mesh.normals_split_custom_set(corners[:, 3:6].tolist())
        mesh.materials.append(self._material(geom))
        thing = self._bpy.data.objects.new(name, mesh)
        self._scene.collection.objects.link(thing)
        return thing

    def _material(self, geom: int) -> Any:
        colour, picture = (*self._exported.colours[geom], 1.0), self._exported.texture[geom]
        material = self._bpy.data.materials.new(f"geom {geom}")
        material.diffuse_color, material.use_nodes = colour, True
        tree = material.node_tree
        tree.nodes.clear()
        surface, output = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeOutputMaterial")
        tree.links.new(surface.outputs["BSDF"], output.inputs["Surface"])
        surface.inputs["Color"].default_value = colour
        if picture >= 0:
            texture, product = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeVectorMath")
            texture.image, product.operation = self._image(int(picture)), "MULTIPLY"
            product.inputs[1].default_value = colour[:3]
            tree.links.new(texture.outputs["Color"], product.inputs[0])
            tree.links.new(product.outputs["Vector"], surface.inputs["Color"])
            tree.nodes.active = texture  # which workbench shows
        return material

    def _add_lights(self) -> None:
        import mathutils

        bpy, scene = self._bpy, self._exported
        for number, (direction, colour) in enumerate(zip(scene.light_directions, scene.light_colours, strict=True)):
            light = bpy.data.lights.new(f"light {number}", "SUN")
            light.energy, light.color, light.use_shadow = np.pi, colour, number == 0
            thing = bpy.data.objects.new(light.name, light)
            thing.rotation_mode = "QUATERNION"
            thing.rotation_quaternion = mathutils.Vector(direction).to_track_quat("-Z", "Y")
            self._scene.collection.objects.link(thing)
        world = bpy.data.worlds.new("sky")
        world.use_nodes = True
        world.node_tree.nodes["Background"].inputs["Color"].default_value = (*scene.ambient, 1.0)
        self._scene.world = world

    def _add_camera(self) -> Any:
        width, height, f, cx, cy = self._exported.camera
        lens = self._bpy.data.cameras.new("camera")
        lens.sensor_fit, lens.sensor_width, lens.lens = "HORIZONTAL", SENSOR_MM, f * SENSOR_MM / width
        lens.shift_x, lens.shift_y = (width / 2 - cx) / width, (cy - height / 2) / width
        lens.clip_start, lens.clip_end = 0.1, 500.0
        thing = self._bpy.data.objects.new("camera", lens)
        self._scene.collection.objects.link(thing)
        self._scene.camera = thing
        return thing


def blender_image(bpy: Any, name: str, picture: Any, colours: str) -> Any:
    """Make Blender's image of a picture.

    Parameters
    ----------
    bpy : module
    name : str
    picture : ndarray of uint8, shape (height, width, 3)
        RGB, the first row the bottom.
    colours : str
        Its colour space: "sRGB" or "Non-Color".
    """
    height, width = picture.shape[:2]
    made = bpy.data.images.new(name, width, height)
    made.colorspace_settings.name = colours
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = picture / np.float32(255)
    made.pixels.foreach_set(rgba.ravel())
    return made


if __name__ == "__main__":
    serve(functools.partial(Blender, engine=sys.argv[2]), Path(sys.argv[1]))
