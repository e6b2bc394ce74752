"""Render passes over the geoms of a MuJoCo scene: shadow map, colour, ids.

`mujoco.mjr_render` draws everything in three passes for a picture with shadows, all of it every time.
These passes use MuJoCo's meshes, textures, lights and camera, but light a picture in one pass, over a part of it, and
keep the shadows of what stands still. Ids and depth are MuJoCo's to the bit; colours differ by rounding.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray
from OpenGL import GL
from OpenGL.error import GLError
from OpenGL.GL.ARB import clip_control

from simgrab.errors import RendererError
from simgrab.model.geometry import Array
from simgrab.world.camera.geoms import Geom
from simgrab.world.camera.lens import Window
from simgrab.world.gl import Offscreen
from simgrab.world.scenery.model import FAR_M, GRAB, NEAR_M

_SEGMENT, _IDCOLOR = mujoco.mjtRndFlag.mjRND_SEGMENT, mujoco.mjtRndFlag.mjRND_IDCOLOR
_SHADOW = mujoco.mjtRndFlag.mjRND_SHADOW
_WHOLE_MAP: tuple[float, ...] = (0.0, 0.0, 1.0, 1.0)
_TEXTURE_FROM_CLIP = np.array([[0.5, 0, 0, 0.5], [0, 0.5, 0, 0.5], [0, 0, 1, 0], [0, 0, 0, 1]])

# Lighting as OpenGL's fixed pipeline has it: at the vertices, and clamped there. As in MuJoCo's two passes, the sun's
# share is left out where the shadow map says so.
_VERTEX = """#version 120
uniform mat4 shadow_from_eye;
uniform float shadowed;
varying vec3 base, sun;
varying vec4 at;
varying vec2 uv;

vec3 reflected(int i, vec3 normal, vec3 eye) {
    vec3 towards = normalize(gl_LightSource[i].position.xyz);
    float lambert = max(dot(normal, towards), 0.0);
    vec3 colour = gl_FrontMaterial.ambient.rgb * gl_LightSource[i].ambient.rgb;
    colour += lambert * gl_FrontMaterial.diffuse.rgb * gl_LightSource[i].diffuse.rgb;
    if (lambert > 0.0) {
        float gloss = pow(max(dot(normal, normalize(towards + eye)), 1e-6), gl_FrontMaterial.shininess);
        colour += gloss * gl_FrontMaterial.specular.rgb * gl_LightSource[i].specular.rgb;
    }
    return colour;
}

void main() {
    vec4 place = gl_ModelViewMatrix * gl_Vertex;
    vec3 normal = normalize(gl_NormalMatrix * gl_Normal);
    vec3 eye = -normalize(place.xyz);
    vec3 by_sun = reflected(0, normal, eye);
    base = clamp(gl_FrontMaterial.emission.rgb + reflected(1, normal, eye) + (1.0 - shadowed) * by_sun, 0.0, 1.0);
    sun = shadowed * clamp(by_sun, 0.0, 1.0);
    at = shadow_from_eye * place;
    uv = gl_MultiTexCoord0.xy;
    gl_Position = ftransform();
}
"""
_FRAGMENT = """#version 120
uniform sampler2D paint;
uniform sampler2DShadow shadow;
uniform float shadowed;
varying vec3 base, sun;
varying vec4 at;
varying vec2 uv;

void main() {
    vec3 light = base;
    if (shadowed > 0.5 && shadow2DProj(shadow, at).a >= 0.99) light += sun;
    gl_FragColor = vec4(texture2D(paint, uv).rgb * light, 1.0);
}
"""

# Where the ground shows a photograph, this stands in for its paint: what is left of all light that could fall on it
# darkens the photograph, pixel by pixel of the picture.
_PHOTOGRAPH_FRAGMENT = (
    _FRAGMENT.replace("uniform float shadowed;", "uniform float shadowed, screen;\nuniform vec2 size;")
    .replace("uniform sampler2D paint;", "uniform sampler2D paint, photograph;")
    .replace(
        "    gl_FragColor =",
        "    if (screen > 0.5)\n"
        "        gl_FragColor = vec4(texture2D(photograph, gl_FragCoord.xy / size).rgb * light / (base + sun), 1.0);\n"
        "    else gl_FragColor =",
    )
)


@dataclass(frozen=True)
class Target:
    """Framebuffers for windows of up to one size, by name.

    Those of ``ids`` and ``picture`` are drawn into, ``resolved`` takes the mean of samples, and ``kept_ids`` and
    ``kept_picture`` keep what stands still.
    """

    size: tuple[int, int]
    samples: int
    framebuffers: dict[str, int] = field(default_factory=dict)

    def holds(self, size: tuple[int, int]) -> bool:
        """Whether windows of another size fit."""
        return size[0] <= self.size[0] and size[1] <= self.size[1]

    def __getitem__(self, name: str) -> int:
        if name not in self.framebuffers:
            form, samples = (GL.GL_R8, 0) if name.endswith("ids") else (GL.GL_RGBA8, self.samples)
            made = _framebuffer(self.size, form, 0 if name == "resolved" else samples)
            self.framebuffers[name] = made
        return self.framebuffers[name]


class Passes:
    """Draws geoms of one model at a time. Call its methods while the buffer's OpenGL context is current.

    Parameters
    ----------
    model : mujoco.MjModel
        Whose geoms are opaque meshes.
    textures : mapping of str to ndarray of uint8, shape (h, w, 3)
        By the name of their material.
    buffer : Offscreen
        With the model's meshes.
    size : tuple of 2 ints
        Of the largest window that is drawn at once, px.
    screen : str
        Material whose geoms show the picture that `show` was given; none unless given.

    Attributes
    ----------
    target : Target
        In which it draws; another one may be put in its place.
    """

    def __init__(
        self, model: mujoco.MjModel, textures: Mapping[str, NDArray[np.uint8]], buffer: Offscreen,
        size: tuple[int, int], screen: str = "",
    ) -> None:  # fmt: skip
        if b"GL_ARB_clip_control" not in (GL.glGetString(GL.GL_EXTENSIONS) or b"").split():
            raise RendererError("this OpenGL lacks ARB_clip_control, which Mesa has since 10.5")
        self._buffer = buffer
        self._textures = dict[str, tuple[NDArray[np.uint8], int]]()
        self._painted: dict[int, int] = {}
        self._program = _program(_PHOTOGRAPH_FRAGMENT if screen else _FRAGMENT)
        self._screen_material, self._photograph = screen, 0
        self.load(model, textures)
        self._uniform = {
            name: GL.glGetUniformLocation(self._program, name)
            for name in ("shadow_from_eye", "shadowed", "paint", "shadow", "photograph", "screen", "size")
        }
        GL.glUseProgram(self._program)
        if screen:
            GL.glUniform1i(self._uniform["photograph"], 2)
        GL.glUniform1i(self._uniform["paint"], 0)
        GL.glUniform1i(self._uniform["shadow"], 1)
        GL.glUseProgram(0)
        self._white = _texture(np.full((1, 1, 3), 255, np.uint8))
        self.target = self.made(size)
        self._kept: int | None = None
        self._darkened = _WHOLE_MAP  # part of the shadow map that differs from the kept one

    def load(self, model: mujoco.MjModel, textures: Mapping[str, NDArray[np.uint8]]) -> None:
        """Draw geoms of another model, which the buffer has loaded; textures of the same arrays stay in OpenGL."""
        meshes = (np.asarray(model.geom_type) == mujoco.mjtGeom.mjGEOM_MESH).all()
        if not meshes or (np.asarray(model.mat_rgba)[:, 3] < 1).any():
            raise RendererError("every geom must be an opaque mesh")
        for display_list in self._painted.values():
            GL.glDeleteLists(display_list, 1)
        for material, (picture, texture) in list(self._textures.items()):
            if textures.get(material) is not picture:
                GL.glDeleteTextures([texture])
                del self._textures[material]
        self._model, self._pictures, self._painted = model, textures, {}
        self._screen = model.material(self._screen_material).id if self._screen_material else -1

    @property
    def _context(self) -> mujoco.MjrContext:
        return self._buffer.context

    def made(self, size: tuple[int, int], *, smooth: bool = True) -> Target:
        """Make framebuffers for windows of a size, with antialiasing or without; they are used as ``target``."""
        samples = self._context.offSamples if smooth else 0
        target = Target(size, samples)
        for name in ("ids", "picture", "resolved"):
            target[name]
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._context.offFBO)
        return target

    def free(self, target: Target) -> None:
        """Free framebuffers with colour, and what is attached to them."""
        for framebuffer in target.framebuffers.values():
            GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, framebuffer)
            name = GL.GL_FRAMEBUFFER_ATTACHMENT_OBJECT_NAME
            for point in (GL.GL_COLOR_ATTACHMENT0, GL.GL_DEPTH_ATTACHMENT):
                attached = int(GL.glGetFramebufferAttachmentParameteriv(GL.GL_FRAMEBUFFER, point, name))
                GL.glDeleteRenderbuffers(1, [attached])
            GL.glDeleteFramebuffers(1, [framebuffer])
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._context.offFBO)

    def show(self, picture: NDArray[np.uint8]) -> None:
        """Let geoms of the ``screen`` show a picture of the largest window's size, RGB, whose first row is the top."""
        if not self._photograph:
            self._photograph = int(GL.glGenTextures(1))
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._photograph)
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_MIN_FILTER, GL.GL_NEAREST)
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_MAG_FILTER, GL.GL_NEAREST)
        GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
        rows = np.ascontiguousarray(picture[::-1])
        form = GL.GL_RGB, GL.GL_UNSIGNED_BYTE
        GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, GL.GL_RGB, rows.shape[1], rows.shape[0], 0, *form, rows)
        GL.glBindTexture(GL.GL_TEXTURE_2D, 0)
        GL.glUseProgram(self._program)
        GL.glUniform2f(self._uniform["size"], rows.shape[1], rows.shape[0])
        GL.glUseProgram(0)

    def shade(self, scene: mujoco.MjvScene, geoms: Iterable[Geom], *, keep: bool = False) -> None:
        """Draw the shadow map of geoms, or the one that is kept for `shade_over`."""
        if keep and self._kept is None:
            self._kept = _framebuffer((self._context.shadowSize, self._context.shadowSize))
        self._cast(scene, self._kept if keep else self._context.shadowFBO, geoms, clear=True)
        self._darkened = _WHOLE_MAP

    def shade_over(self, scene: mujoco.MjvScene, moving: Iterable[Geom], part: tuple[float, ...]) -> None:
        """Add moving geoms to the shadow map that `shade` kept.

        They may darken a part of the map: left, bottom, right and top, from 0 to 1.
        """
        side = self._context.shadowSize
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._kept)
        GL.glBindFramebuffer(GL.GL_DRAW_FRAMEBUFFER, self._context.shadowFBO)
        for window in (self._darkened, part):
            x0, y0, x1, y1 = (min(max(round(edge * side), 0), side) for edge in window)
            if x0 < x1 and y0 < y1:
                GL.glBlitFramebuffer(x0, y0, x1, y1, x0, y0, x1, y1, GL.GL_DEPTH_BUFFER_BIT, GL.GL_NEAREST)
        self._cast(scene, self._context.shadowFBO, moving, clear=False)
        self._darkened = part

    def map_from_jib(self, scene: mujoco.MjvScene) -> Array:
        """From the jib frame to the shadow map of a scene's sun, whose coordinates go from 0 to 1: shape (4, 4)."""
        projection, view = self._sun_view(scene)
        return np.asarray(_TEXTURE_FROM_CLIP @ projection @ view)

    def _sun_view(self, scene: mujoco.MjvScene) -> tuple[Array, Array]:
        """Projection and view of the sun, shapes (4, 4), as MuJoCo has them: depth from 1 at the near plane to 0."""
        sun, half_width = scene.lights[self._model.light("sun").id], float(self._context.shadowClip)
        position, direction = np.array(sun.pos, float), np.array(sun.dir, float)
        up = np.cross(direction, (-1.0, 0.0, 0.0))
        if up @ up <= 0.01:
            up = np.cross(direction, (0.0, 1.0, 0.0))
        forward = direction / np.linalg.norm(direction)
        side = np.cross(forward, up)
        side /= np.linalg.norm(side)
        view = np.eye(4)
        view[:3, :3] = side, np.cross(side, forward), -forward
        view[:3, 3] = -view[:3, :3] @ position
        projection = np.diag([1 / half_width, 1 / half_width, 1 / (FAR_M - NEAR_M), 1.0])
        projection[2, 3] = FAR_M / (FAR_M - NEAR_M)
        return projection, view

    def _cast(self, scene: mujoco.MjvScene, framebuffer: int | None, geoms: Iterable[Geom], *, clear: bool) -> None:
        side, (projection, view) = self._context.shadowSize, self._sun_view(scene)
        GL.glPushAttrib(GL.GL_ALL_ATTRIB_BITS)
        _load(GL.GL_PROJECTION, projection)
        _load(GL.GL_MODELVIEW, view)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, framebuffer)
        GL.glDrawBuffer(GL.GL_NONE)
        clip = GL.glClipControl or clip_control.glClipControl  # OSMesa has it as a function of the extension alone
        clip(GL.GL_LOWER_LEFT, GL.GL_ZERO_TO_ONE)
        GL.glEnable(GL.GL_DEPTH_TEST)
        GL.glDepthFunc(GL.GL_GEQUAL)  # depth goes from 1 at the near plane to 0, as in MuJoCo
        GL.glDepthMask(GL.GL_TRUE)
        GL.glClearDepth(0.0)
        if clear:
            GL.glClear(GL.GL_DEPTH_BUFFER_BIT)
        GL.glViewport(1, 1, side - 2, side - 2)  # what lies outside is lit
        GL.glShadeModel(GL.GL_FLAT)
        GL.glDisable(GL.GL_LIGHTING)
        GL.glDisable(GL.GL_CULL_FACE)
        GL.glColorMask(0, 0, 0, 0)
        GL.glEnable(GL.GL_POLYGON_OFFSET_FILL)
        GL.glPolygonOffset(-1.5, -4.0)
        for geom in geoms:
            self._draw(geom, self._mesh(geom.number))
        GL.glPopAttrib()
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._context.offFBO)
        GL.glDrawBuffer(GL.GL_COLOR_ATTACHMENT0)

    def colour(
        self, scene: mujoco.MjvScene, rect: mujoco.MjrRect, geoms: Iterable[Geom], *, shadowed: bool, keep: bool = False
    ) -> NDArray[np.uint8]:
        """Draw a picture of geoms.

        Parameters
        ----------
        scene : mujoco.MjvScene
            With the camera to draw through.
        rect : mujoco.MjrRect
            The picture, whose rows are counted from the bottom, as everywhere here.
        geoms : iterable of Geom
        shadowed : bool
            Whether the shadow map keeps the sun from pixels.
        keep : bool
            Whether the picture is kept for `colour_over`.
        """
        name, whole = "kept_picture" if keep else "picture", (0, 0, rect.width, rect.height)
        self._colour(name, scene, rect, [(whole, geoms, True)], shadowed)
        return self._read(name, whole)

    def colour_over(
        self, scene: mujoco.MjvScene, rect: mujoco.MjrRect, moving: Sequence[Geom], windows: Sequence[Window],
        redrawn: Sequence[tuple[Window, Sequence[Geom]]], *, shadowed: bool,
    ) -> Iterator[tuple[Window, NDArray[np.uint8]]]:  # fmt: skip
        """Draw moving geoms over the picture that `colour` kept, and yield the windows of it that hold all they change.

        ``redrawn`` are parts of these where shadows change, with the geoms that stand still there.
        """
        self._copy("picture", windows)
        whole = (0, 0, rect.width, rect.height)
        steps = [(window, geoms, True) for window, geoms in redrawn] + [(whole, moving, False)]
        self._colour("picture", scene, rect, steps, shadowed)
        for window in windows:
            yield window, self._read("picture", window)

    def _colour(
        self, name: str, scene: mujoco.MjvScene, rect: mujoco.MjrRect,
        steps: Iterable[tuple[Window, Iterable[Geom], bool]], shadowed: bool,
    ) -> None:  # fmt: skip
        """Draw geoms into windows, one after another, each of which is cleared before or not."""
        self._set_up(scene, rect, segment=False)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self.target[name])
        GL.glDisable(GL.GL_COLOR_MATERIAL)
        GL.glDisable(GL.GL_LIGHTING)
        GL.glUseProgram(self._program)
        GL.glUniform1f(self._uniform["shadowed"], float(shadowed))
        if shadowed:
            eye_from_jib = np.array(GL.glGetFloatv(GL.GL_MODELVIEW_MATRIX), float).reshape(4, 4).T
            matrix = (self.map_from_jib(scene) @ np.linalg.inv(eye_from_jib)).astype(np.float32)
            GL.glUniformMatrix4fv(self._uniform["shadow_from_eye"], 1, True, matrix)
        GL.glActiveTexture(GL.GL_TEXTURE1)
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._context.shadowTex if shadowed else 0)
        if self._photograph:
            GL.glActiveTexture(GL.GL_TEXTURE2)
            GL.glBindTexture(GL.GL_TEXTURE_2D, self._photograph)
        GL.glActiveTexture(GL.GL_TEXTURE0)
        for window, geoms, clear in steps:
            with _scissors(window, self._program):
                if clear:
                    GL.glClear(GL.GL_COLOR_BUFFER_BIT | GL.GL_DEPTH_BUFFER_BIT)
                for geom in geoms:
                    if self._screen >= 0:
                        screen = self._model.geom_matid[geom.number] == self._screen
                        GL.glUniform1f(self._uniform["screen"], float(screen))
                    self._draw(geom, self._display_list(geom.number))
        GL.glBindTexture(GL.GL_TEXTURE_2D, 0)

    def _read(self, name: str, window: Window) -> NDArray[np.uint8]:
        """Read the mean of each pixel's samples."""
        x0, y0, x1, y1 = window
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self.target[name])
        GL.glBindFramebuffer(GL.GL_DRAW_FRAMEBUFFER, self.target["resolved"])
        GL.glBlitFramebuffer(*window, *window, GL.GL_COLOR_BUFFER_BIT, GL.GL_NEAREST)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self.target["resolved"])
        rgb = np.empty((y1 - y0, x1 - x0, 3), np.uint8)
        GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 1)
        GL.glReadPixels(x0, y0, x1 - x0, y1 - y0, GL.GL_RGB, GL.GL_UNSIGNED_BYTE, array=rgb)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._context.offFBO)
        return rgb

    def identify(
        self, scene: mujoco.MjvScene, rect: mujoco.MjrRect, geoms: Iterable[Geom], *, keep: bool = False
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Draw the ids and depth of geoms, and keep them for `identify_over` or not; see `colour`.

        Returns
        -------
        ids : ndarray of uint8, shape (h, w)
            Groups of the geoms, 255 where there is none.
        depth : ndarray of float32, shape (h, w)
            What the depth buffer has: 1 at the near plane, 0 at the far one.
        """
        name = "kept_ids" if keep else "ids"
        self._identify(name, scene, rect, geoms, clear=True)
        return self._read_ids(name, (0, 0, rect.width, rect.height))

    def identify_grab_first(
        self, scene: mujoco.MjvScene, rect: mujoco.MjrRect, geoms: Sequence[Geom]
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.float32]]:
        """Draw ids of the grab alone, and then ids and depth of all: it touches nothing that is listed before it."""
        whole = (0, 0, rect.width, rect.height)
        self._identify("ids", scene, rect, [geom for geom in geoms if geom.group == GRAB], clear=True)
        alone, _ = self._read_ids("ids", whole)
        self._identify("ids", scene, rect, [geom for geom in geoms if geom.group != GRAB], clear=False)
        return alone, *self._read_ids("ids", whole)

    def identify_over(
        self, scene: mujoco.MjvScene, rect: mujoco.MjrRect, moving: Iterable[Geom], windows: Sequence[Window]
    ) -> Iterator[tuple[Window, NDArray[np.uint8], NDArray[np.float32]]]:
        """Draw moving geoms over the ids and depth that `identify` kept; see `colour_over`.

        The model lists what stands still first, so each pixel is what it is when all are drawn at once.
        """
        self._copy("ids", windows)
        self._identify("ids", scene, rect, moving, clear=False)
        for window in windows:
            yield window, *self._read_ids("ids", window)

    def _identify(
        self, name: str, scene: mujoco.MjvScene, rect: mujoco.MjrRect, geoms: Iterable[Geom], *, clear: bool
    ) -> None:
        self._set_up(scene, rect, segment=True)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self.target[name])
        with _scissors((0, 0, rect.width, rect.height)):
            if clear:
                GL.glClear(GL.GL_COLOR_BUFFER_BIT | GL.GL_DEPTH_BUFFER_BIT)
            for geom in geoms:
                GL.glColor4ub(geom.group + 1, 0, 0, 255)
                self._draw(geom, self._mesh(geom.number))

    def _read_ids(self, name: str, window: Window) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        x, y, width, height = window[0], window[1], window[2] - window[0], window[3] - window[1]
        ids, depth = np.empty((height, width), np.uint8), np.empty((height, width), np.float32)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self.target[name])
        GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 1)
        GL.glReadPixels(x, y, width, height, GL.GL_RED, GL.GL_UNSIGNED_BYTE, array=ids)
        GL.glReadPixels(x, y, width, height, GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT, array=depth)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._context.offFBO)
        ids -= 1  # 0, which is nothing, becomes 255
        return ids, depth

    def _copy(self, name: str, windows: Iterable[Window]) -> None:
        """Copy colours and depth of what is kept in windows."""
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self.target[f"kept_{name}"])
        GL.glBindFramebuffer(GL.GL_DRAW_FRAMEBUFFER, self.target[name])
        both = GL.GL_COLOR_BUFFER_BIT | GL.GL_DEPTH_BUFFER_BIT
        for window in windows:
            GL.glBlitFramebuffer(*window, *window, both, GL.GL_NEAREST)

    def _set_up(self, scene: mujoco.MjvScene, rect: mujoco.MjrRect, *, segment: bool) -> None:
        """Let MuJoCo set camera, lights and OpenGL's state, by drawing a pixel without geoms in its own framebuffer."""
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._context.offFBO)  # MuJoCo draws into whatever is bound
        scene.flags[_SEGMENT] = scene.flags[_IDCOLOR] = int(segment)
        scene.flags[_SHADOW] = 0
        mujoco.mjr_render(mujoco.MjrRect(0, 0, 1, 1), scene, self._context)
        GL.glViewport(0, 0, rect.width, rect.height)

    def _draw(self, geom: Geom, display_list: int) -> None:
        GL.glPushMatrix()
        GL.glTranslatef(*geom.position)
        GL.glMultMatrixf(geom.turn)
        GL.glCallList(display_list)
        GL.glPopMatrix()

    def _mesh(self, number: int) -> int:
        """Display list that MuJoCo made of a geom's mesh."""
        return int(self._context.baseMesh + 2 * self._model.geom_dataid[number])

    def _display_list(self, number: int) -> int:
        """Display list of a geom's material, texture and mesh."""
        if number not in self._painted:
            model = self._model
            material = int(model.geom_matid[number])
            rgba = np.asarray(model.mat_rgba[material], np.float32)
            specular = np.array([*[model.mat_specular[material]] * 3, 1], np.float32)
            emission = np.array([*(model.mat_emission[material] * rgba[:3]), 1], np.float32)
            texture = self._texture(model.material(material).name)
            self._painted[number] = made = GL.glGenLists(1)
            GL.glNewList(made, GL.GL_COMPILE)
            GL.glMaterialfv(GL.GL_FRONT_AND_BACK, GL.GL_AMBIENT_AND_DIFFUSE, rgba)
            GL.glMaterialfv(GL.GL_FRONT_AND_BACK, GL.GL_EMISSION, emission)
            GL.glMaterialfv(GL.GL_FRONT_AND_BACK, GL.GL_SPECULAR, specular)
            GL.glMaterialf(GL.GL_FRONT_AND_BACK, GL.GL_SHININESS, 128.0 * float(model.mat_shininess[material]))
            GL.glBindTexture(GL.GL_TEXTURE_2D, texture)
            GL.glCallList(self._mesh(number))
            GL.glEndList()
        return self._painted[number]

    def _texture(self, material: str) -> int:
        """Texture of a material, uploaded when it is first drawn; white where it has none."""
        if material not in self._pictures:
            return self._white
        if material not in self._textures:
            picture = self._pictures[material]
            self._textures[material] = picture, _texture(picture[::-1])
        return self._textures[material][1]


@contextmanager
def _scissors(window: Window, program: int = 0) -> Iterator[None]:
    """Draw within a window alone, with a program or with OpenGL's own."""
    x0, y0, x1, y1 = window
    GL.glUseProgram(program)
    GL.glScissor(x0, y0, x1 - x0, y1 - y0)
    GL.glEnable(GL.GL_SCISSOR_TEST)
    try:
        yield
    finally:
        GL.glDisable(GL.GL_SCISSOR_TEST)
        GL.glUseProgram(0)


def _program(fragment: str) -> int:
    program = int(GL.glCreateProgram())
    for kind, source in ((GL.GL_VERTEX_SHADER, _VERTEX), (GL.GL_FRAGMENT_SHADER, fragment)):
        shader = GL.glCreateShader(kind)
        GL.glShaderSource(shader, source)
        GL.glCompileShader(shader)
        if not GL.glGetShaderiv(shader, GL.GL_COMPILE_STATUS):
            raise RendererError(f"OpenGL refuses a shader: {GL.glGetShaderInfoLog(shader)!r}")
        GL.glAttachShader(program, shader)
    GL.glLinkProgram(program)
    if not GL.glGetProgramiv(program, GL.GL_LINK_STATUS):
        raise RendererError(f"OpenGL refuses the shaders: {GL.glGetProgramInfoLog(program)!r}")
    return program


def _texture(picture: NDArray[np.uint8]) -> int:
    """Upload a texture, shape (h, w, 3), whose first row is the bottom, with its mipmaps, as MuJoCo does."""
    name = int(GL.glGenTextures(1))
    GL.glBindTexture(GL.GL_TEXTURE_2D, name)
    GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR_MIPMAP_LINEAR)
    GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
    with _out_of_memory_raises(f"a texture of {picture.shape[1]}x{picture.shape[0]} px"):
        for level, smaller in enumerate(_halved(picture)):
            size = smaller.shape[1::-1]
            GL.glTexImage2D(GL.GL_TEXTURE_2D, level, GL.GL_RGB, *size, 0, GL.GL_RGB, GL.GL_UNSIGNED_BYTE, smaller)
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_BASE_LEVEL, level)
        GL.glGenerateMipmap(GL.GL_TEXTURE_2D)  # the few that are left
    GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_BASE_LEVEL, 0)
    GL.glBindTexture(GL.GL_TEXTURE_2D, 0)
    return name


def _halved(picture: NDArray[np.uint8]) -> Iterator[NDArray[np.uint8]]:
    """Yield a picture, and halve it for as long as its sides are even."""
    # Means of two pixels are rounded up, first across and then up, as the software renderer has them, only faster.
    while True:
        yield np.ascontiguousarray(picture)
        height, width = picture.shape[:2]
        if height % 2 or width % 2:
            return
        for size in ((width // 2, height), (width // 2, height // 2)):
            picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR), np.uint8)


@contextmanager
def _out_of_memory_raises(what: str) -> Iterator[None]:
    try:
        yield
    except GLError as problem:
        if problem.err == GL.GL_OUT_OF_MEMORY:
            raise MemoryError(f"OpenGL has none for {what}") from None
        raise RendererError(f"this OpenGL does not make {what} ({problem.err:#x})") from None


def _framebuffer(size: tuple[int, int], colour: Any = None, samples: int = 0) -> int:
    """Make a framebuffer with depth, and with colour of a format or, for a shadow map, without."""
    framebuffer = int(GL.glGenFramebuffers(1))
    GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, framebuffer)
    if colour is None:
        _attach(GL.GL_DEPTH_STENCIL_ATTACHMENT, GL.GL_DEPTH24_STENCIL8, size, 0)  # as MuJoCo's shadow map
        GL.glDrawBuffer(GL.GL_NONE)
        GL.glReadBuffer(GL.GL_NONE)
    else:
        _attach(GL.GL_COLOR_ATTACHMENT0, colour, size, samples)
        _attach(GL.GL_DEPTH_ATTACHMENT, GL.GL_DEPTH_COMPONENT32F, size, samples)
    status = GL.glCheckFramebufferStatus(GL.GL_FRAMEBUFFER)
    if status != GL.GL_FRAMEBUFFER_COMPLETE:
        raise RendererError(f"this OpenGL cannot draw into a framebuffer of {size[0]}x{size[1]} px ({status:#x})")
    return framebuffer


def _attach(point: Any, form: Any, size: tuple[int, int], samples: int) -> None:
    renderbuffer = GL.glGenRenderbuffers(1)
    GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, renderbuffer)
    with _out_of_memory_raises(f"a framebuffer of {size[0]}x{size[1]} px"):
        GL.glRenderbufferStorageMultisample(GL.GL_RENDERBUFFER, samples, form, *size)
    GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, point, GL.GL_RENDERBUFFER, renderbuffer)


def _load(mode: Any, matrix: Array) -> None:
    GL.glMatrixMode(mode)
    GL.glLoadMatrixf(np.ascontiguousarray(matrix.T, np.float32))
