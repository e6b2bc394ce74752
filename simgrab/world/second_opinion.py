"""The grab alone, drawn by pyrender: a renderer that shares nothing with MuJoCo's but the shapes.

It runs in a process of its own, because pyrender closes the EGL display of whoever else uses it.
"""

from __future__ import annotations

import importlib.util
import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgrab.errors import RendererError

Array = NDArray[np.float64]
Shapes = dict[str, tuple[Array, NDArray[np.int64]]]

NEAR_M, FAR_M = 0.1, 100.0
_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def available() -> bool:
    """Whether pyrender is installed."""
    return importlib.util.find_spec("pyrender") is not None


INSTALL_HINT = "pip install 'simgrab[audit]' 'PyOpenGL>=3.1.10'"


class SecondOpinion:
    """Draws silhouettes of posed shapes in a process of its own. Use as a context manager.

    Parameters
    ----------
    shapes : dict of str to (vertices (V, 3), faces (F, 3))
        Each in its own frame, m.

    Raises
    ------
    RendererError
        If pyrender is missing or cannot draw here.
    """

    def __init__(self, shapes: Shapes) -> None:
        spawn = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(1, mp_context=spawn)
        problem = self._pool.submit(_start, shapes).result()
        if problem:
            self._pool.shutdown()
            raise RendererError(f"the second renderer cannot start: {problem}")

    def __enter__(self) -> SecondOpinion:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._pool.shutdown()

    def silhouette(
        self, camera_from_shape: dict[str, Array], f: float, cx: float, cy: float, window: tuple[int, int, int, int],
        supersampling: int,
    ) -> NDArray[np.bool_]:  # fmt: skip
        """Draw shapes through a window of an undistorted picture.

        Parameters
        ----------
        camera_from_shape : dict of str to ndarray, shape (4, 4)
            OpenCV camera frame. Shapes left out are not drawn.
        f, cx, cy : float
            Focal length and principal point, px; (0, 0) is the outer corner of the top-left pixel.
        window : tuple of 4 ints
            x0, y0, x1, y1, px, half open.
        supersampling : int
            Samples a pixel and direction.

        Returns
        -------
        ndarray of bool, shape ((y1 − y0)·supersampling, (x1 − x0)·supersampling)
        """
        job = self._pool.submit(_draw, camera_from_shape, f, cx, cy, window, supersampling)
        return job.result()


_drawer: Any = None


def _start(shapes: Shapes) -> str:
    """Open the renderer in this process; returns what went wrong, or nothing."""
    global _drawer
    os.environ["PYOPENGL_PLATFORM"] = "osmesa" if os.environ.get("MUJOCO_GL") == "osmesa" else "egl"
    os.environ["PYGLET_HEADLESS"] = "1"  # pyrender imports a viewer, which else wants X11
    try:
        _drawer = _Drawer(shapes)
    except Exception as problem:  # whatever a missing library or driver makes it raise
        return f"{type(problem).__name__}: {problem}"
    return ""


def _draw(
    poses: dict[str, Array], f: float, cx: float, cy: float, window: tuple[int, int, int, int], supersampling: int
) -> NDArray[np.bool_]:
    return _drawer.draw(poses, f, cx, cy, window, supersampling)


class _Drawer:
    """pyrender with an exact frustum; its own IntrinsicsCamera divides by width − 1."""

    def __init__(self, shapes: Shapes) -> None:
        import pyrender
        import trimesh

        class WindowCamera(pyrender.Camera):  # type: ignore[misc]
            def __init__(self) -> None:
                super().__init__(znear=NEAR_M, zfar=FAR_M)
                self.matrix = np.eye(4)

            def get_projection_matrix(self, width: int | None = None, height: int | None = None) -> Array:  # noqa: ARG002
                return self.matrix

        self._pyrender = pyrender
        self._meshes = {
            name: pyrender.Mesh.from_trimesh(trimesh.Trimesh(v, f, process=False), smooth=False)
            for name, (v, f) in shapes.items()
        }
        self._camera = WindowCamera()
        self._renderer = pyrender.OffscreenRenderer(64, 64)

    def draw(
        self, poses: dict[str, Array], f: float, cx: float, cy: float, window: tuple[int, int, int, int], samples: int
    ) -> NDArray[np.bool_]:
        x0, y0, x1, y1 = window
        width, height = (x1 - x0) * samples, (y1 - y0) * samples
        self._camera.matrix = _projection(f, cx - x0, cy - y0, x1 - x0, y1 - y0)
        scene = self._pyrender.Scene()
        scene.add(self._camera, pose=np.eye(4))
        for name, camera_from_shape in poses.items():
            scene.add(self._meshes[name], pose=_OPENGL_FROM_OPENCV @ camera_from_shape)
        self._renderer.viewport_width, self._renderer.viewport_height = width, height
        flags = self._pyrender.RenderFlags.DEPTH_ONLY | self._pyrender.RenderFlags.SKIP_CULL_FACES
        return np.asarray(self._renderer.render(scene, flags=flags) > 0)


def _projection(f: float, cx: float, cy: float, width: int, height: int) -> Array:
    """OpenGL projection matrix of a pinhole whose picture is width × height px."""
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[0, 2] = 2 * f / width, 1 - 2 * cx / width
    matrix[1, 1], matrix[1, 2] = 2 * f / height, 2 * cy / height - 1
    matrix[2, 2], matrix[2, 3] = -(FAR_M + NEAR_M) / (FAR_M - NEAR_M), -2 * FAR_M * NEAR_M / (FAR_M - NEAR_M)
    matrix[3, 2] = -1
    return matrix
