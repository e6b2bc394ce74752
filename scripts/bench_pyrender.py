"""Render an exported scene with pyrender; `scripts.bench_renderers` runs it in a process of its own."""

from __future__ import annotations

import os
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scripts.bench_scene import Array, ExportedScene, serve
from simgrab.judge.audit.second_renderer.pyrender_process import OPENGL_FROM_OPENCV, projection

FAR_M = 200.0


class Pyrender:
    """Renders rgb and depth with pyrender's OpenGL, 4× antialiased as pyrender always does, without shadows."""

    def __init__(self, scene: ExportedScene) -> None:
        os.environ["PYOPENGL_PLATFORM"] = "osmesa" if os.environ.get("MUJOCO_GL") == "osmesa" else "egl"
        os.environ["PYGLET_HEADLESS"] = "1"  # pyrender imports a viewer, which else wants X11
        import pyrender

        class PinholeCamera(pyrender.Camera):  # type: ignore[misc]
            """An exact frustum: pyrender's IntrinsicsCamera divides by width − 1."""

            def get_projection_matrix(self, width: int | None = None, height: int | None = None) -> Array:  # noqa: ARG002
                w, h, f, cx, cy = scene.camera
                return projection(f, cx, cy, w, h, FAR_M)

        self.by = f"pyrender {version('pyrender')}"
        self._exported, self._pyrender = scene, pyrender
        self._scene = pyrender.Scene(bg_color=(0.0, 0.0, 0.0, 1.0), ambient_light=scene.ambient)
        self._textures = [
            pyrender.Texture(source=np.ascontiguousarray(picture[::-1]), source_channels="RGB")
            for picture in scene.textures
        ]
        self._geoms = [self._scene.add_node(node) or node for node in map(self._node, range(len(scene.colours)))]
        self._camera = self._scene.add(PinholeCamera())
        for direction, colour in zip(scene.light_directions, scene.light_colours, strict=True):
            light = pyrender.DirectionalLight(color=colour, intensity=np.pi)
            self._scene.add(light, pose=_looking_along(direction))
        self._renderer = pyrender.OffscreenRenderer(*scene.size)
        self._rgb: NDArray[np.uint8] | None = None

    def render(self, frame: int) -> None:
        """See `SceneRenderer.render`."""
        scene = self._exported
        self._scene.set_pose(self._camera, scene.jib_from_camera[frame] @ OPENGL_FROM_OPENCV)
        for node, pose, shown in zip(self._geoms, scene.jib_from_geom[frame], scene.shown[frame], strict=True):
            if shown and not np.array_equal(node.matrix, pose):
                self._scene.set_pose(node, pose)
            node.mesh.is_visible = bool(shown)
        self._rgb, _ = self._renderer.render(self._scene)

    def save(self, path: str) -> None:
        """See `SceneRenderer.save`."""
        import cv2

        assert self._rgb is not None
        cv2.imwrite(path, cv2.cvtColor(self._rgb, cv2.COLOR_RGB2BGR))

    def _node(self, geom: int) -> Any:
        pyrender, scene = self._pyrender, self._exported
        (vertices, faces), picture = scene.mesh(geom), scene.texture[geom]
        material = pyrender.MetallicRoughnessMaterial(
            baseColorFactor=(*scene.colours[geom], 1.0),
            baseColorTexture=self._textures[picture] if picture >= 0 else None,
            metallicFactor=0.0,
            roughnessFactor=1.0,
        )
        primitive = pyrender.Primitive(
            positions=vertices[:, :3], normals=vertices[:, 3:6], texcoord_0=vertices[:, 6:], indices=faces,
            material=material, mode=4,
        )  # fmt: skip
        return pyrender.Node(mesh=pyrender.Mesh([primitive]), matrix=scene.jib_from_geom[0, geom])


def _looking_along(direction: Array) -> Array:
    """Pose whose −z axis is a direction."""
    z = -direction / np.linalg.norm(direction)
    x = np.cross(z, np.eye(3)[np.abs(z).argmin()])
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    return pose


if __name__ == "__main__":
    serve(Pyrender, Path(sys.argv[1]))
