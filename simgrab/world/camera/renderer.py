"""Render a moment with MuJoCo's classic renderer: rgb, ids, depth and silhouette, in exact pixel geometry."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from types import TracebackType

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from simgrab.errors import RendererError, ScenarioError
from simgrab.scenario import Scenario
from simgrab.world import gl
from simgrab.world.camera.lens import Lens, Window
from simgrab.world.scenery.model import FAR_M, GRAB, HIDDEN, NEAR_M, World
from simgrab.world.trajectory.moment import Moment

NOTHING = 255  # id of a pixel that shows no geom
LARGEST_BUFFER_PX = 8192
LENS_SAMPLES = 3  # ids are rendered so much finer before a lens bends them, which takes the nearest


@dataclass(frozen=True, eq=False)
class View:
    """Ids and depth in a window of the picture, shapes (h, w).

    Attributes
    ----------
    window : Window
    ids : ndarray of uint8
        Geom group of each pixel (`simgrab.world.scenery.model`), 255 where there is none.
    depth : ndarray of float32
        Distance along the optical axis, m.
    """

    window: Window
    ids: NDArray[np.uint8]
    depth: NDArray[np.float32]

    @property
    def shows_grab(self) -> NDArray[np.bool_]:
        """Pixels of the grab, shape (h, w)."""
        return self.ids == GRAB

    def crop(self, window: Window) -> View:
        """Cut a window out of this one, which must hold it."""
        x0, y0, x1, y1 = window
        at = np.s_[y0 - self.window[1] : y1 - self.window[1], x0 - self.window[0] : x1 - self.window[0]]
        return View(window, self.ids[at], self.depth[at])


class Renderer:
    """Renders moments of one world through one camera. Use as a context manager: it owns an OpenGL context.

    Parameters
    ----------
    world : World
    scenario : Scenario

    Attributes
    ----------
    data : mujoco.MjData
        The state that was rendered last.
    option : mujoco.MjvOption
        Which geom groups are rendered.
    full : Window
        The whole picture.
    fingerprint : Fingerprint
        Of OpenGL and MuJoCo.
    """

    def __init__(self, world: World, scenario: Scenario) -> None:
        camera = scenario.camera
        self.world, self.intrinsics = world, camera.intrinsics
        self._rotation = np.eye(3)
        self._posed: Moment | None = None
        self._centre = np.array(camera.offset_m)
        self.full: Window = (0, 0, camera.width_px, camera.height_px)
        self._lens = None if self.intrinsics.distortion.is_null else Lens(self.intrinsics)
        whole = self._lens.map(self.full) if self._lens else None
        drawn = whole.source if whole else self.full
        self._size = drawn[2] - drawn[0], drawn[3] - drawn[1]
        if max(self._size) > LARGEST_BUFFER_PX:
            raise ScenarioError(
                "camera.distortion",
                f"this lens sees {self._size[0]}x{self._size[1]} px of undistorted picture, too many",
            )
        model = world.model
        self.data = mujoco.MjData(model)
        self.option = mujoco.MjvOption()
        self.option.geomgroup[:] = 1
        self.option.geomgroup[HIDDEN] = 0
        self._grab_only = mujoco.MjvOption()
        self._grab_only.geomgroup[:] = 0
        self._grab_only.geomgroup[GRAB] = 1
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 16)
        self._abstract = mujoco.MjvCamera()
        self._stack = ExitStack()
        self._buffer = self._stack.enter_context(gl.offscreen(model, *self._size))
        self.fingerprint = gl.fingerprint()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Free the OpenGL context."""
        self._stack.close()

    def pose(self, moment: Moment) -> mujoco.MjData:
        """Pose world and camera as at a moment, which every rendering does first; returns the state."""
        if moment is not self._posed:
            self._posed = None  # posing may fail
            self._rotation = moment.tilt.jib_from_camera
            self.world.pose(self.data, moment)
            self._posed = moment
        return self.data

    def rgb(self, moment: Moment) -> NDArray[np.uint8]:
        """Render the picture as the lens shows it, shape (height, width, 3)."""
        self._gather(moment, self.option)
        if self._lens is None:
            return self._draw_rgb(self.full)
        lens = self._lens.map(self.full)
        return lens.resample(self._draw_rgb(lens.source), cv2.INTER_CUBIC)

    @property
    def has_lens(self) -> bool:
        """Whether a lens distorts the picture, so that a `coarse_view` differs from a `view`."""
        return self._lens is not None

    def view(self, moment: Moment, window: Window | None = None, *, grab_only: bool = False) -> View:
        """Render ids and depth through a window of the picture, as finely as labels need them.

        Parameters
        ----------
        moment : Moment
        window : Window, optional
            The whole picture unless given. It may reach beyond the picture.
        grab_only : bool
            Render the grab and what it holds as if nothing were in front of it.
        """
        self._gather(moment, self._grab_only if grab_only else self.option)
        return self._view(window or self.full, LENS_SAMPLES)

    def silhouette(self, moment: Moment, window: Window, samples: int) -> NDArray[np.bool_]:
        """Render the whole grab alone through a window, with so many samples a pixel and direction.

        Returns
        -------
        ndarray of bool, shape (h·samples, w·samples)
        """
        self._gather(moment, self._grab_only)
        if self._lens is None:
            x0, y0, x1, y1 = (samples * v for v in window)
            return self._draw_tiles((x0, y0, x1, y1), samples)[0] == GRAB
        lens = self._lens.map(window, samples, enlarged=True)
        return lens.resample(self._draw_tiles(lens.source, samples)[0], cv2.INTER_NEAREST, NOTHING) == GRAB

    def coarse_view(self, moment: Moment) -> View:
        """Render ids and depth of the whole picture; a lens may move its edges by half a pixel."""
        self._gather(moment, self.option)
        return self._view(self.full, 1)

    def _view(self, window: Window, finer: int) -> View:
        if self._lens is None:
            return View(window, *self._draw_tiles(window))
        lens = self._lens.map(window, finer)
        ids, depth = self._draw_tiles(lens.source, finer)
        return View(
            window,
            lens.resample(ids, cv2.INTER_NEAREST, NOTHING),
            lens.resample(depth, cv2.INTER_NEAREST, FAR_M),
        )

    def _gather(self, moment: Moment, option: mujoco.MjvOption) -> None:
        self.pose(moment)
        self._buffer.make_current()
        scene = self._scene
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self.world.model, self.data, option, None, self._abstract, everything, scene)
        if scene.status:
            raise RendererError("the scene holds more geoms than its buffer")

    def aim(self, window: Window, scene: mujoco.MjvScene, finer: int = 1) -> mujoco.MjrRect:
        """Point both eyes of a scene along the camera, through a window of the undistorted picture.

        With ``finer`` the picture, and so the window, has that many pixels for each of the camera's, both ways.
        """
        k, (x0, y0, x1, y1) = self.intrinsics, window
        scale, cx, cy = NEAR_M / (k.f_px * finer), k.cx_px * finer, k.cy_px * finer
        for eye in scene.camera:
            eye.pos = self._centre
            eye.forward, eye.up = self._rotation[:, 2], -self._rotation[:, 1]
            eye.orthographic = 0
            eye.frustum_near, eye.frustum_far = NEAR_M, FAR_M
            eye.frustum_center = scale * ((x0 + x1) / 2 - cx)
            eye.frustum_width = scale * (x1 - x0) / 2
            eye.frustum_top, eye.frustum_bottom = scale * (cy - y0), scale * (cy - y1)
        return mujoco.MjrRect(0, 0, x1 - x0, y1 - y0)

    def _draw_rgb(self, window: Window) -> NDArray[np.uint8]:
        flags = self._scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = 0
        rect = self.aim(window, self._scene)
        mujoco.mjr_render(rect, self._scene, self._buffer.context)
        rgb = np.empty((rect.height, rect.width, 3), np.uint8)
        mujoco.mjr_readPixels(rgb, None, rect, self._buffer.context)
        return rgb[::-1]

    def _draw_tiles(self, window: Window, finer: int = 1) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Ids and depth of a window of the undistorted picture, in tiles that fit the buffer."""
        x0, y0, x1, y1 = window
        ids = np.empty((y1 - y0, x1 - x0), np.uint8)
        depth = np.empty((y1 - y0, x1 - x0), np.float32)
        for y in range(y0, y1, self._size[1]):
            for x in range(x0, x1, self._size[0]):
                tile = (x, y, min(x + self._size[0], x1), min(y + self._size[1], y1))
                at = np.s_[y - y0 : tile[3] - y0, x - x0 : tile[2] - x0]
                ids[at], depth[at] = self._draw_ids(tile, finer)
        return ids, depth

    def _draw_ids(self, window: Window, finer: int) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        scene = self._scene
        scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = scene.flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = 1
        rect = self.aim(window, scene, finer)
        mujoco.mjr_render(rect, scene, self._buffer.context)
        colour = np.empty((rect.height, rect.width, 3), np.uint8)
        buffer = np.empty((rect.height, rect.width), np.float32)
        mujoco.mjr_readPixels(colour, buffer, rect, self._buffer.context)
        # The id colour is the geom's place in the scene plus one, least significant byte first.
        groups = self.world.model.geom_group
        lookup = np.array([NOTHING, *(groups[g.objid] for g in scene.geoms[: scene.ngeom])], np.uint8)
        place = colour[..., 0].astype(np.intp) | (colour[..., 1].astype(np.intp) << 8)
        return lookup[place][::-1], _metres(buffer)[::-1]


def _metres(buffer: NDArray[np.float32]) -> NDArray[np.float32]:
    """Distance along the optical axis from MuJoCo's reversed depth buffer: 1 at the near plane, 0 at the far one."""
    return np.asarray(NEAR_M * FAR_M / (NEAR_M + buffer.astype(float) * (FAR_M - NEAR_M)), np.float32)
