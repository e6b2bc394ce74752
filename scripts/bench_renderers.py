"""Time a frame by simgrab and by other renderers of the same scene, in turns; see `scripts.bench`."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from scripts.bench_measure import in_turns, milliseconds, ratios
from scripts.bench_render import BARE, FINISHED, SCENE, WARM_UP, Bare, Finished, textured
from scripts.bench_results import Quantity
from scripts.bench_scene import ExportedScene
from simgrab.errors import RendererError
from simgrab.model import scenes
from simgrab.world.camera.lens import Lens, Window
from simgrab.world.frames import FrameGenerator
from simgrab.world.scenery.model import HIDDEN

ROOT = Path(__file__).parents[1]
PYRENDER = "pyrender: rgb, no shadows"
WORKBENCH, CYCLES = "Blender workbench: rgb, no shadows", "Blender Cycles, 16 samples: rgb"
MOST = {CYCLES: 3}  # frames: one takes as long as hundreds of the others


def renderers(frames: int, size: tuple[int, int], blender: str | None, pictures: Path | None) -> Iterator[Quantity]:
    """Measure a frame by simgrab, ``mujoco.Renderer``, pyrender and Blender: same meshes, textures, poses and camera.

    simgrab's frame is rendered with shadows, labelled, encoded and written; those of the others are rendered only.
    pyrender and Blender run in processes of their own, which are idle while it is another's turn.
    """
    scenario = scenes.load("quay-day", SCENE | {"frames": frames + WARM_UP}, size=size)
    with ExitStack() as stack:
        finished = stack.enter_context(Finished(scenario))
        bare = stack.enter_context(Bare(finished.generator))
        path = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "scene.npz"
        exported(finished.generator, range(scenario.frames)).save(path)
        commands = {PYRENDER: [sys.executable, "-m", "scripts.bench_pyrender", str(path)]}
        if blender:
            for name, engine in ((WORKBENCH, "workbench"), (CYCLES, "cycles")):
                commands[name] = [blender, "-m", "scripts.bench_blender", str(path), engine]
        others = {name: stack.enter_context(RenderProcess(command)) for name, command in commands.items()}
        acts = {FINISHED: finished.store, BARE: bare.render} | {name: one.render for name, one in others.items()}
        took = in_turns(acts, range(scenario.frames), WARM_UP, MOST)
        if pictures:
            _write_pictures(pictures, finished.generator, bare, others)
    for name, seconds in took.items():
        yield milliseconds(name, seconds, others[name].by if name in others else "")
    for name in list(took)[1:]:
        yield ratios(f"{name.partition(':')[0]} over simgrab", took[name], took[FINISHED])


class RenderProcess:
    """A process that renders an exported scene, as `scripts.bench_scene.serve` answers it."""

    def __init__(self, command: list[str]) -> None:
        self._name = command[2]
        with ExitStack() as stack:
            self._said = stack.enter_context(tempfile.TemporaryFile("w+", errors="replace"))
            try:
                self._process = subprocess.Popen(
                    command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._said, text=True
                )
            except OSError as problem:
                raise RendererError(f"cannot run {command[0]}: {problem.strerror}") from None
            stack.callback(self._process.communicate)
            stack.callback(self._process.kill)
            self.by: str = self._answer()
            self._stack = stack.pop_all()

    def __enter__(self) -> RenderProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def render(self, frame: int) -> None:
        """Render a frame, and wait for it."""
        self._ask(frame, "")

    def save(self, path: Path) -> None:
        """Write the frame rendered last."""
        self._ask(0, str(path.absolute()))

    def _ask(self, *request: Any) -> None:
        assert self._process.stdin
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            pass  # there will be no answer
        self._answer()

    def _answer(self) -> Any:
        assert self._process.stdout
        line = self._process.stdout.readline()
        if not line:
            self._said.seek(0)
            last = self._said.read().strip().rpartition("\n")[2]
            raise RendererError(f"{self._name} ended: {last or 'it said nothing'}")
        return json.loads(line)


def exported(generator: FrameGenerator, frames: range) -> ExportedScene:
    """Export what the frames show. Meshes whose corners agree in position, normal and texture share vertices."""
    import mujoco  # after simgrab.world, which chooses its OpenGL

    scene = generator.scene(frames[0])
    model, k = textured(generator), generator.scenario.camera.intrinsics
    cameras, poses, groups = [], [], []
    for frame in frames:
        moment = generator.project(frame).moment
        data = scene.renderer.pose(moment)
        cameras.append(_pose(moment.tilt.jib_from_camera, np.array(generator.scenario.camera.offset_m)))
        poses.append([_pose(data.geom(g).xmat.reshape(3, 3), data.geom(g).xpos) for g in range(model.ngeom)])
        groups.append(scene.world.model.geom_group.astype(np.int64))
    vertices, faces = zip(*(_mesh(model, int(mesh)) for mesh in model.geom_dataid), strict=True)
    material = model.geom_matid
    x0, y0, x1, y1 = source_window(generator)
    return ExportedScene(
        camera=np.array([x1 - x0, y1 - y0, k.f_px, k.cx_px - x0, k.cy_px - y0]),
        jib_from_camera=np.array(cameras),
        jib_from_geom=np.array(poses),
        shown=np.array(groups) != HIDDEN,
        groups=np.array(groups),
        names=np.array([model.geom(geom).name for geom in range(model.ngeom)]),
        vertices=np.concatenate(vertices),
        faces=np.concatenate(faces),
        vertex_ends=np.cumsum([len(v) for v in vertices]),
        face_ends=np.cumsum([len(f) for f in faces]),
        colours=np.array(model.mat_rgba[material, :3], float),
        texture=np.array(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB], np.int64),
        light_directions=np.array(data.light_xdir),
        light_colours=np.array(model.light_diffuse, float),
        ambient=np.array(model.light_ambient.sum(axis=0), float),
        textures=tuple(_texture(model, texture) for texture in range(model.ntex)),
    )


def source_window(generator: FrameGenerator) -> Window:
    """Window of the undistorted picture that the lens maps to the picture; without distortion the picture itself."""
    k = generator.scenario.camera.intrinsics
    full = (0, 0, k.width_px, k.height_px)
    return full if k.distortion.is_null else Lens(k).map(full).source


def _pose(turn: Any, place: Any) -> Any:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, place
    return pose


def _mesh(model: Any, mesh: int) -> tuple[Any, Any]:
    one = model.mesh(mesh)
    vertex, normal, uv = (int(getattr(model, f"mesh_{kind}adr")[mesh]) for kind in ("vert", "normal", "texcoord"))
    span = slice(int(one.faceadr[0]), int(one.faceadr[0]) + int(one.facenum[0]))
    corners = np.concatenate(
        [
            model.mesh_vert[vertex + model.mesh_face[span].ravel()],
            model.mesh_normal[normal + model.mesh_facenormal[span].ravel()],
            model.mesh_texcoord[uv + model.mesh_facetexcoord[span].ravel()],
        ],
        axis=1,
    )
    vertices, corner = np.unique(np.asarray(corners, np.float32), axis=0, return_inverse=True)
    return vertices, corner.reshape(-1, 3).astype(np.int32)


def _texture(model: Any, texture: int) -> Any:
    height, width, start = (int(a[texture]) for a in (model.tex_height, model.tex_width, model.tex_adr))
    return np.array(model.tex_data[start : start + 3 * height * width]).reshape(height, width, 3)


def _write_pictures(folder: Path, generator: FrameGenerator, bare: Bare, others: dict[str, RenderProcess]) -> None:
    """Write frame `WARM_UP` as each renders it, so that one can see that they show the same."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, rgb in (("simgrab", generator.frame(WARM_UP).rgb), ("mujoco", bare.render(WARM_UP))):
        cv2.imwrite(str(folder / f"{name}.png"), cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    for name, other in others.items():
        other.render(WARM_UP)
        stem = name.partition(":")[0].partition(",")[0].replace(" ", "-").lower()
        other.save(folder / f"{stem}.png")
