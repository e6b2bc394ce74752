"""Render a moment with MuJoCo's camera, meshes and lights: rgb, ids, depth and silhouette, in exact pixel geometry."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from simgrab.errors import ScenarioError
from simgrab.model.geometry import Array, Intrinsics, Pose
from simgrab.model.scenario import Camera, Photo, Scenario
from simgrab.world import gl
from simgrab.world.camera import changes, geoms
from simgrab.world.camera.background import Background
from simgrab.world.camera.geoms import Geom
from simgrab.world.camera.lens import Lens, Window
from simgrab.world.scenery.model import FAR_M, GRAB, NEAR_M, NOTHING, ROPE, World
from simgrab.world.scenery.places.plain import PHOTOGRAPH
from simgrab.world.trajectory.moment import Moment, Tilt

if TYPE_CHECKING:
    from simgrab.world.camera.passes import Target

LARGEST_BUFFER_PX = 8192
LENS_SAMPLES = 3  # ids are rendered so much finer before a lens bends them, which takes the nearest
_KEPT_AIMS = 2
ROPE_PIECES = 12  # a rope is cut into, so that what it may change in a picture follows it


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


@dataclass(eq=False)
class _Aim:
    """A camera, and what was drawn through it that stays as it is: what stands still."""

    camera: Camera
    smooth: bool  # whether pictures are antialiased
    shadowed: bool  # whether the sun casts shadows
    lens: Lens | None
    full: Window  # the whole picture,
    drawn: Window  # and what is drawn for it of the undistorted one
    centre: Array  # of the camera, jib frame, m, shape (3,)
    rest: Tilt
    target: Target | None = None
    still: tuple[NDArray[np.uint8], NDArray[np.float32]] | None = None
    backdrop: tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.int32] | None] | None = None
    photograph: int = -1

    @classmethod
    def of(cls, scenario: Scenario) -> _Aim:
        """Take the camera of a scenario; raises `ScenarioError` where its lens sees too much."""
        camera, image = scenario.camera, scenario.image
        lens = None if camera.intrinsics.distortion.is_null else Lens(camera.intrinsics)
        full: Window = (0, 0, camera.width_px, camera.height_px)
        aim = cls(
            camera, image.samples > 0, image.shadow_map_px > 0 and scenario.light.sun > 0, lens, full,
            lens.map(full).source if lens else full, np.array(camera.offset_m), Tilt.at_rest(camera),
        )  # fmt: skip
        if max(aim.size) > LARGEST_BUFFER_PX:
            raise ScenarioError(
                "camera.distortion",
                f"this lens sees {aim.size[0]}x{aim.size[1]} px of undistorted picture, too many",
            )
        return aim

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of what is drawn, px."""
        return self.drawn[2] - self.drawn[0], self.drawn[3] - self.drawn[1]


class Renderer:
    """Renders moments of one world through one camera. It owns an OpenGL context: close it.

    For moments in which camera and crane are as the scenario has them at first (no slewing, no luffing, no shaking),
    what they show is drawn once, and then only what grab, ropes and their shadows may change. Single pixels at edges of
    shadows may differ from those of a picture that is drawn whole, as the environment variable ``SIMGRAB_REUSE=0`` has
    every picture drawn; the fingerprint says which it was.

    ``split`` gives the split of a frame, whose photographs alone it shows. A ``station`` gives rotation (3, 3) and
    centre (3,) of the camera in the jib frame at a moment, in place of the scenario's.

    Attributes
    ----------
    data : mujoco.MjData
        The state that was rendered last.
    fingerprint : Fingerprint
        Of OpenGL, MuJoCo and the render passes.
    """

    def __init__(
        self, world: World, scenario: Scenario, split: Callable[[int], str],
        station: Callable[[Moment], tuple[Array, Array]] | None = None,
    ) -> None:  # fmt: skip
        self.world = world
        self._image = scenario.image
        self._station = station
        self._reuses = station is None and gl.reuses()
        self._rotation = np.eye(3)
        self._posed: Moment | None = None
        self._shade_kept = False
        self._aim = _Aim.of(scenario)
        model = world.model
        self._lights_alone = mujoco.MjvOption()
        self._lights_alone.geomgroup[:] = 0
        self._abstract = mujoco.MjvCamera()
        with ExitStack() as stack:
            self._buffer = stack.enter_context(gl.offscreen(model, 1, 1))  # the passes have framebuffers of their own
            from simgrab.world.camera.passes import Passes  # PyOpenGL takes the platform that MuJoCo chose

            self._prepare(model)
            self._background = Background(scenario, split) if isinstance(scenario.place, Photo) else None
            self._background_shown = -1
            screen = PHOTOGRAPH if self._background else ""
            self._passes = Passes(model, world.textures, self._buffer, self._aim.size, screen)
            self._aim.target, self._aims = self._passes.target, [self._aim]
            self.fingerprint = gl.fingerprint()
            self._stack = stack.pop_all()

    def _prepare(self, model: mujoco.MjModel) -> None:
        """Make what MuJoCo and the render passes need of a model."""
        self.data, self._scene = mujoco.MjData(model), mujoco.MjvScene(model, maxgeom=1)
        self._boxes = geoms.boxes(model)

    def takes(self, scenario: Scenario) -> bool:
        """Whether `revise` can go on with a scenario; if not, it needs a renderer of its own."""
        own, new = self._image, scenario.image
        smooth = new.samples in (0, own.samples) and new.shadow_map_px == own.shadow_map_px
        return smooth and isinstance(scenario.place, Photo) == (self._background is not None)

    def revise(self, world: World, old: Scenario, new: Scenario, split: Callable[[int], str]) -> None:
        """Go on from one scenario to another, in the same OpenGL context.

        The world has the same model and other lights, or a model of its own.

        Raises
        ------
        ScenarioError
            If the lens sees too much; then nothing has changed.
        """
        smooth, same = new.image.samples > 0, world.model is self.world.model
        if not same or old.light != new.light:
            aim, others = _Aim.of(new), list[_Aim]()
            self._shade_kept = False
            if same:
                world.relight(new)
            else:
                self._buffer.load(world.model)
                self._passes.load(world.model, world.textures)
                self._prepare(world.model)
        else:
            known = [one for one in self._aims if (one.camera, one.smooth) == (new.camera, smooth)]
            aim = known[0] if known else _Aim.of(new)
            # Beside it, that of the other size stays: small pictures and large ones take turns.
            others = [one for one in self._aims if (one.size, one.smooth) != (aim.size, smooth)]
        self._use(aim, [aim, *others][:_KEPT_AIMS])
        if self._background:
            self._background, self._background_shown = Background(new, split), -1
        self.world, self._posed = world, None

    def _use(self, aim: _Aim, kept: list[_Aim]) -> None:
        """Take a camera, with framebuffers of its size, and free those of others that are not kept."""
        self._buffer.make_current()
        spare = [one for one in self._aims if all(one is not other for other in kept)]
        for one in spare:
            if one.target and aim.target is None and one.smooth == aim.smooth and one.target.holds(aim.size):
                aim.target = one.target
            elif one.target is not None:
                self._passes.free(one.target)
        aim.target = aim.target or self._passes.made(aim.size, smooth=aim.smooth)
        self._aims, self._aim, self._passes.target = kept, aim, aim.target

    def close(self) -> None:
        """Free the OpenGL context."""
        self._stack.close()

    def pose(self, moment: Moment) -> mujoco.MjData:
        """Pose world and camera as at a moment, which every rendering does first; returns the state."""
        if moment is not self._posed:
            self._posed = None  # posing may fail
            if self._station:
                self._rotation, self._aim.centre = self._station(moment)
            else:
                self._rotation = moment.tilt.jib_from_camera
            self.world.pose(self.data, moment)
            self._posed = moment
        return self.data

    def rgb(self, moment: Moment) -> NDArray[np.uint8]:
        """Render the picture as the lens shows it, shape (height, width, 3)."""
        self._gather(moment)
        if self._background:
            self._show(self._background, moment.frame)
        return self._draw_rgb(moment)

    @property
    def intrinsics(self) -> Intrinsics:
        """The pinhole and its lens."""
        return self._aim.camera.intrinsics

    @property
    def full(self) -> Window:
        """The whole picture."""
        return self._aim.full

    def _show(self, background: Background, frame: int) -> None:
        """Put the photograph of a frame where the ground is."""
        number = background.number(frame)
        if number != self._background_shown:
            self._passes.show(background.picture(number, self._aim.drawn))
            self._background_shown = number
        if number != self._aim.photograph:
            self._aim.photograph, self._aim.backdrop = number, None

    @property
    def has_lens(self) -> bool:
        """Whether a lens distorts the picture, so that ids are rendered finer for labels."""
        return self._aim.lens is not None

    def view(self, moment: Moment, window: Window | None = None, finer: int = LENS_SAMPLES) -> View:
        """Render ids and depth through a window, which may reach beyond the picture; the whole picture unless given.

        What a lens bends is rendered so much ``finer``: as labels need it unless given. With 1 the lens may move edges
        by half a pixel.
        """
        self._gather(moment)
        window, lens = window or self.full, self._aim.lens
        if window == self.full and (finer == 1 or not lens):
            ids, depth = self._draw_whole(moment)
            if lens:
                bent = lens.map(window)
                ids = bent.resample(ids, cv2.INTER_NEAREST, NOTHING)
                depth = bent.resample(depth, cv2.INTER_NEAREST, FAR_M)
            return View(window, ids, depth)
        ids, buffer = self._draw_through(window, self._passes.identify, finer)
        return View(window, ids, _metres(buffer))  # of the few pixels that are left

    def silhouette(self, moment: Moment, window: Window, samples: int = 0) -> NDArray[np.bool_]:
        """Render the grab and what it holds through a window, as if nothing were in front of it.

        The window may reach beyond the picture. Each pixel has so many samples each way: one, as `view` has it, unless
        given; shape (h·samples, w·samples).
        """
        self._gather(moment, grab_only=True)
        if samples and self._aim.lens is None:
            x0, y0, x1, y1 = (samples * v for v in window)
            return self._draw_tiles((x0, y0, x1, y1), samples, self._passes.identify)[0] == GRAB
        ids, _ = self._draw_through(window, self._passes.identify, samples or LENS_SAMPLES, enlarged=samples > 0)
        return ids == GRAB

    def grab_views(self, moment: Moment, window: Window) -> tuple[NDArray[np.bool_], View]:
        """`silhouette` and `view` of one window, which take one drawing of the grab."""
        self._gather(moment)
        alone, ids, buffer = self._draw_through(window, self._passes.identify_grab_first)
        return alone == GRAB, View(window, ids, _metres(buffer))

    def _gather(self, moment: Moment, *, grab_only: bool = False) -> None:
        """Pose the world, and list what is drawn of it."""
        self.pose(moment)
        self._buffer.make_current()
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(
            self.world.model, self.data, self._lights_alone, None, self._abstract, everything, self._scene
        )
        self._geoms = geoms.shown(self.world.model, self.data, self._boxes, grab_only=grab_only)

    @property
    def _pinhole(self) -> tuple[float, Array]:
        """Focal length and centre of what is drawn of the picture, px, rows counted from the bottom."""
        k, (x0, _, _, y1) = self.intrinsics, self._aim.drawn
        return k.f_px, np.array([k.cx_px - x0, y1 - k.cy_px])

    def _rectangles(self, points: Array) -> Array:
        """Rectangles of hulls of points, jib frame, in what is drawn of the picture, rows counted from the bottom."""
        seen = (points - self._aim.centre) @ self._rotation * (1, -1, 1)
        return changes.rectangles(seen, *self._pinhole, NEAR_M)

    def _at_rest(self, moment: Moment) -> bool:
        """Whether camera and crane are as the scenario has them at rest. It depends on the moment alone."""
        crane = moment.jib is None or not (moment.jib.slew or moment.jib.luffed)
        return self._reuses and crane and moment.tilt == self._aim.rest

    def _still_buffers(self) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Ids and depth of what stands still."""
        if self._aim.still is None:
            stand = [geom for geom in self._geoms if not geom.moves]
            rect = self.aim(self._aim.drawn, self._scene)
            ids, buffer = self._passes.identify(self._scene, rect, stand, keep=True)
            self._aim.still = ids, _metres(buffer)
        return self._aim.still

    def _still_rgb(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.int32] | None]:
        """Picture of what stands still, as drawn and through the lens; each pixel's cell of the shadow map, if any."""
        if self._aim.backdrop is None:
            scene, passes, cells = self._scene, self._passes, None
            stand = [geom for geom in self._geoms if not geom.moves]
            if self._aim.shadowed:
                jib_from_camera = Pose(self._rotation, self._aim.centre).as_matrix()
                # Rows counted from the bottom make the camera's y point upwards.
                upwards = passes.map_from_jib(scene) @ jib_from_camera @ np.diag([1.0, -1.0, 1.0, 1.0])
                cells = changes.receivers(self._still_buffers()[1], upwards, *self._pinhole)
                if not self._shade_kept:  # it is the same for every camera
                    passes.shade(scene, self._casters(stand), keep=True)
                    self._shade_kept = True
                passes.shade_over(scene, [], (0.0, 0.0, 0.0, 0.0))
            rect = self.aim(self._aim.drawn, scene)
            rgb = passes.colour(scene, rect, stand, shadowed=self._aim.shadowed, keep=True)
            lens, upright = self._aim.lens, rgb[::-1]
            seen = lens.map(self.full).resample(upright, cv2.INTER_CUBIC) if lens else upright
            self._aim.backdrop = rgb, seen, cells
        return self._aim.backdrop

    def _casters(self, listed: list[Geom]) -> list[Geom]:
        """Geoms that cast shadows."""
        return [geom for geom in listed if geom.number in self.world.casters]

    def _moving_boxes(self) -> Array:
        """Corners of boxes that hold grab and ropes, jib frame, shape (n, 8, 3)."""
        ropes, grab = (
            np.array([geom.corners for geom in self._geoms if geom.group == group]).reshape(-1, 8, 3)
            for group in (ROPE, GRAB)
        )
        return np.concatenate([grab, changes.cut(ropes, ROPE_PIECES)])

    def _covered(self, boxes: Array) -> NDArray[np.bool_]:
        """Tiles of what is drawn that boxes may cover."""
        return changes.tiles(self._rectangles(boxes), *self._aim.size)

    def _geoms_in(self, window: tuple[float, float, float, float]) -> list[Geom]:
        """Geoms that may be seen in a window of what is drawn, rows counted from the bottom."""
        rects = self._rectangles(np.array([geom.corners for geom in self._geoms]).reshape(-1, 8, 3))
        met = ((rects[:, :2] < window[2:]) & (rects[:, 2:] > window[:2])).all(axis=1)
        return [self._geoms[i] for i in np.flatnonzero(met)]

    def aim(self, window: Window, scene: mujoco.MjvScene, finer: int = 1) -> mujoco.MjrRect:
        """Point both eyes of a scene along the camera, through a window of the undistorted picture.

        With ``finer`` the picture, and so the window, has that many pixels for each of the camera's, both ways.
        """
        k, (x0, y0, x1, y1) = self.intrinsics, window
        scale, cx, cy = NEAR_M / (k.f_px * finer), k.cx_px * finer, k.cy_px * finer
        for eye in scene.camera:
            eye.pos = self._aim.centre
            eye.forward, eye.up = self._rotation[:, 2], -self._rotation[:, 1]
            eye.orthographic = 0
            eye.frustum_near, eye.frustum_far = NEAR_M, FAR_M
            eye.frustum_center = scale * ((x0 + x1) / 2 - cx)
            eye.frustum_width = scale * (x1 - x0) / 2
            eye.frustum_top, eye.frustum_bottom = scale * (cy - y0), scale * (cy - y1)
        return mujoco.MjrRect(0, 0, x1 - x0, y1 - y0)

    def _draw_rgb(self, moment: Moment) -> NDArray[np.uint8]:
        """Draw the picture as the lens shows it."""
        scene, passes, lens = self._scene, self._passes, self._aim.lens
        bent = lens.map(self.full) if lens else None
        if not self._at_rest(moment):
            if self._aim.shadowed:
                passes.shade(scene, self._casters(self._geoms))
            rect = self.aim(self._aim.drawn, scene)
            rgb = passes.colour(scene, rect, self._geoms, shadowed=self._aim.shadowed)[::-1]
            return bent.resample(rgb, cv2.INTER_CUBIC) if bent else rgb
        (backdrop, seen, receivers), boxes = self._still_rgb(), self._moving_boxes()
        grid = self._covered(boxes)
        rgb, redrawn, moving = backdrop.copy(), [], [geom for geom in self._geoms if geom.moves]
        if receivers is not None:
            cells = changes.marked(boxes, passes.map_from_jib(scene))
            darker = changes.tiles_of(cells.ravel()[receivers])
            redrawn = [
                (window, [geom for geom in self._geoms_in(window) if not geom.moves])
                for window in changes.windows(darker, *self._aim.size, changes.PASS_PX)
            ]
            grid |= darker
            passes.shade_over(scene, moving, changes.extent(cells))
        rect, windows = self.aim(self._aim.drawn, scene), changes.windows(grid, *self._aim.size, changes.COPY_PX)
        for (x0, y0, x1, y1), part in passes.colour_over(
            scene, rect, moving, windows, redrawn, shadowed=self._aim.shadowed
        ):
            rgb[y0:y1, x0:x1] = part
        if bent is None:
            return rgb[::-1]
        height = len(rgb)
        upright = [(x0, height - y1, x1, height - y0) for x0, y0, x1, y1 in windows]
        return bent.resample_over(seen, rgb[::-1], upright, cv2.INTER_CUBIC)

    def _draw_whole(self, moment: Moment) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Ids and depth of the undistorted picture."""
        scene, passes = self._scene, self._passes
        if not self._at_rest(moment):
            ids, buffer = passes.identify(scene, self.aim(self._aim.drawn, scene), self._geoms)
            return ids[::-1], _metres(buffer)[::-1]
        still_ids, still_depth = self._still_buffers()
        ids, depth = still_ids.copy(), still_depth.copy()
        grid = self._covered(self._moving_boxes())
        rect, windows = self.aim(self._aim.drawn, scene), changes.windows(grid, *self._aim.size, changes.COPY_PX)
        moving = [geom for geom in self._geoms if geom.moves]
        for (x0, y0, x1, y1), own, buffer in passes.identify_over(scene, rect, moving, windows):
            ids[y0:y1, x0:x1], depth[y0:y1, x0:x1] = own, _metres(buffer)
        return ids[::-1], depth[::-1]

    def _draw_through(
        self, window: Window, draw: Callable[..., tuple[NDArray[Any], ...]], finer: int = LENS_SAMPLES, *,
        enlarged: bool = False,
    ) -> list[NDArray[Any]]:  # fmt: skip
        """Draw buffers of a window of the picture, ids first; behind a lens finer, as `Lens` maps them."""
        if self._aim.lens is None:
            return self._draw_tiles(window, 1, draw)
        lens = self._aim.lens.map(window, finer, enlarged=enlarged)
        drawn = self._draw_tiles(lens.source, finer, draw)
        return [lens.resample(one, cv2.INTER_NEAREST, NOTHING if one.dtype == np.uint8 else 0.0) for one in drawn]

    def _draw_tiles(
        self, window: Window, finer: int, draw: Callable[..., tuple[NDArray[Any], ...]]
    ) -> list[NDArray[Any]]:
        """Draw buffers of a window of the undistorted picture, in tiles that fit the framebuffer."""
        x0, y0, x1, y1 = window
        found = list[NDArray[Any]]()
        for y in range(y0, y1, self._aim.size[1]):
            for x in range(x0, x1, self._aim.size[0]):
                tile = (x, y, min(x + self._aim.size[0], x1), min(y + self._aim.size[1], y1))
                at = np.s_[y - y0 : tile[3] - y0, x - x0 : tile[2] - x0]
                rect, (left, top, right, bottom) = self.aim(tile, self._scene, finer), (v / finer for v in tile)
                near, _, _, low = self._aim.drawn
                some = self._geoms_in((left - near, low - bottom, right - near, low - top))
                parts = draw(self._scene, rect, some)
                found = found or [np.empty((y1 - y0, x1 - x0), part.dtype) for part in parts]
                for whole, part in zip(found, parts, strict=True):
                    whole[at] = part[::-1]
        return found


def _metres(buffer: NDArray[np.float32]) -> NDArray[np.float32]:
    """Distance along the optical axis from MuJoCo's reversed depth buffer: 1 at the near plane, 0 at the far one."""
    depth = buffer.astype(float)
    depth *= FAR_M - NEAR_M
    depth += NEAR_M
    return np.divide(NEAR_M * FAR_M, depth, out=depth).astype(np.float32)
