"""Silhouettes by pyrender, in a process of its own, because pyrender closes the EGL display of every other user."""

from __future__ import annotations

import functools
import os
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgrab.errors import RendererError, WorkerError
from simgrab.judge.audit.second_renderer.interface import Shapes
from simgrab.model.geometry import Array
from simgrab.runtime.processes import Pool
from simgrab.world.camera.lens import Window

NEAR_M, FAR_M = 0.1, 100.0
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


class PyrenderProcess:
    """Rasterises with pyrender's OpenGL."""

    package = "pyrender"

    def __init__(self) -> None:
        self._pool = Pool(1, setup=functools.partial(_start, {}))
        self._ask("load", {})
        self.name = f"pyrender {version('pyrender')}"

    def load(self, shapes: Shapes) -> None:
        """Replace the shapes; see `SecondRenderer.load`."""
        self._pool.setup = functools.partial(_start, dict(shapes))  # of a process in place of one that died
        self._ask("load", dict(shapes))

    def silhouette(
        self, camera_from_shape: Mapping[str, Array], f: float, cx: float, cy: float, window: Window, supersampling: int
    ) -> NDArray[np.bool_]:
        """Render a silhouette; see `SecondRenderer.silhouette`."""
        return self._ask("render", dict(camera_from_shape), f, cx, cy, window, supersampling)

    def close(self) -> None:
        """End the process."""
        self._pool.close()

    def _ask(self, method: str, *arguments: Any) -> Any:
        try:
            (answer,) = self._pool.map(functools.partial(_call, method), [arguments], name=lambda _: "pyrender")
        except WorkerError:
            self.close()
            raise RendererError("the process of pyrender ended unexpectedly") from None
        except RendererError:
            self.close()
            raise
        return answer


_rasteriser: Any = None


def _call(method: str, arguments: tuple[Any, ...]) -> Any:
    return getattr(_rasteriser, method)(*arguments)


def _start(shapes: Shapes) -> None:
    """Open the renderer in this process, try it, and load shapes."""
    global _rasteriser
    os.environ["PYOPENGL_PLATFORM"] = "osmesa" if os.environ.get("MUJOCO_GL") == "osmesa" else "egl"
    os.environ["PYGLET_HEADLESS"] = "1"  # pyrender imports a viewer, which else wants X11
    try:
        _rasteriser = _Rasteriser()
        square = np.array([(-1.0, -1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, 1.0), (-1.0, 1.0, 1.0)])
        _rasteriser.load({"square": (square, np.array([(0, 1, 2), (0, 2, 3)]))})
        if not _rasteriser.render({"square": np.eye(4)}, 1.0, 0.0, 0.0, (-1, -1, 1, 1), 4).all():
            raise RendererError("a square is not rendered whole")
    except RendererError:
        raise
    except Exception as problem:  # whatever a missing library or driver makes it raise
        raise RendererError(f"{type(problem).__name__}: {problem}") from None
    _rasteriser.load(shapes)


class _Rasteriser:
    """pyrender with an exact frustum; its own IntrinsicsCamera divides by width − 1."""

    def __init__(self) -> None:
        import pyrender

        class WindowCamera(pyrender.Camera):  # type: ignore[misc]
            def __init__(self) -> None:
                super().__init__(znear=NEAR_M, zfar=FAR_M)
                self.matrix = np.eye(4)

            def get_projection_matrix(self, width: int | None = None, height: int | None = None) -> Array:  # noqa: ARG002
                return self.matrix

        self._pyrender = pyrender
        self._meshes: dict[str, Any] = {}
        self._camera = WindowCamera()
        self._renderer = pyrender.OffscreenRenderer(64, 64)

    def load(self, shapes: Shapes) -> None:
        import trimesh

        # With both sides of each face: where it renders depth alone, pyrender culls back faces whatever its flags are.
        self._meshes = {
            name: self._pyrender.Mesh.from_trimesh(
                trimesh.Trimesh(v, np.concatenate([f, f[:, ::-1]]), process=False), smooth=False
            )
            for name, (v, f) in shapes.items()
        }

    def render(
        self, poses: dict[str, Array], f: float, cx: float, cy: float, window: Window, samples: int
    ) -> NDArray[np.bool_]:
        x0, y0, x1, y1 = window
        self._camera.matrix = projection(f, cx - x0, cy - y0, x1 - x0, y1 - y0)
        scene = self._pyrender.Scene()
        scene.add(self._camera, pose=np.eye(4))
        white = {}
        for name, camera_from_shape in poses.items():
            white[scene.add(self._meshes[name], pose=OPENGL_FROM_OPENCV @ camera_from_shape)] = (255, 255, 255)
        self._renderer.viewport_width, self._renderer.viewport_height = (x1 - x0) * samples, (y1 - y0) * samples
        # SEG switches multisampling off, whose depth is sampled up to 3/8 of a sample beside its centre.
        kind = self._pyrender.RenderFlags
        return np.asarray(self._renderer.render(scene, flags=kind.DEPTH_ONLY | kind.SEG, seg_node_map=white) > 0)


def projection(f: float, cx: float, cy: float, width: float, height: float) -> Array:
    """OpenGL projection matrix of a pinhole whose picture is width × height px."""
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[0, 2] = 2 * f / width, 1 - 2 * cx / width
    matrix[1, 1], matrix[1, 2] = 2 * f / height, 2 * cy / height - 1
    matrix[2, 2], matrix[2, 3] = -(FAR_M + NEAR_M) / (FAR_M - NEAR_M), -2 * FAR_M * NEAR_M / (FAR_M - NEAR_M)
    matrix[3, 2] = -1
    return matrix
