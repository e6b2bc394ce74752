"""Silhouettes by ray casting with Intel's Embree. It needs no OpenGL, and therefore no process of its own."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from simgrab.errors import RendererError
from simgrab.judge.audit.second_renderer.interface import Shapes
from simgrab.model.geometry import Array
from simgrab.world.camera.lens import Window

RAYS_AT_ONCE = 1 << 19  # 28 bytes each


class EmbreeRays:
    """Casts one ray through the centre of each sample of the exact pinhole.

    Embree computes in float32. Vertices are therefore moved into the camera's frame in float64 first. Then only
    distances from the camera are rounded, by up to 1e-6 m at 30 m, which is at most 1e-4 px.
    """

    package = "embreex"

    def __init__(self) -> None:
        try:
            import embreex
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except Exception as problem:  # whatever a missing library makes it raise
            raise RendererError(f"{type(problem).__name__}: {problem}") from problem
        self._scene, self._add = EmbreeScene, TriangleMesh
        self._shapes: Shapes = {}
        self.name = f"Embree ray casting (embreex {embreex.__version__})"

    def load(self, shapes: Shapes) -> None:
        """Replace the shapes; see `SecondRenderer.load`."""
        self._shapes = shapes

    def silhouette(
        self, camera_from_shape: Mapping[str, Array], f: float, cx: float, cy: float, window: Window, supersampling: int
    ) -> NDArray[np.bool_]:
        """Render a silhouette; see `SecondRenderer.silhouette`."""
        scene = self._scene()  # not robust=True, which takes 1.5 times as long: a closed shape stops each ray twice
        for name, pose in camera_from_shape.items():
            vertices, faces = self._shapes[name]
            self._add(scene, (vertices @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32), faces.astype(np.int32))
        x0, y0, x1, y1 = window
        x = (x0 + (np.arange((x1 - x0) * supersampling) + 0.5) / supersampling - cx) / f
        y = (y0 + (np.arange((y1 - y0) * supersampling) + 0.5) / supersampling - cy) / f
        mask = np.zeros((y.size, x.size), dtype=bool)
        rows = max(RAYS_AT_ONCE // x.size, 1)
        for top in range(0, y.size, rows):
            part = y[top : top + rows]
            rays = np.ones((part.size, x.size, 3), dtype=np.float32)
            rays[..., 0], rays[..., 1] = x, part[:, None]
            hit = scene.run(np.zeros((part.size * x.size, 3), np.float32), rays.reshape(-1, 3), query="OCCLUDED")
            mask[top : top + rows] = (hit != -1).reshape(part.size, x.size)
        return mask

    def close(self) -> None:
        """Free the shapes."""
        self._shapes = {}
