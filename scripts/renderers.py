"""The same frames by simgrab and by other renderers, in turns; see `scripts.bench`.

Each builds a world where simgrab does, from the same meshes, textures, lights, poses and camera, without the lens.
simgrab's frame has shadows, weather and camera, and is labelled, encoded and written; others' are rendered only.
"""

from __future__ import annotations

import multiprocessing
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from trimesh.geometry import align_vectors

from scripts.bench_results import Quantity
from scripts.foreign.export import export
from scripts.foreign.making import Blender
from simgrab.dataset import stored
from simgrab.io.files import write
from simgrab.judge.audit.second_renderer.pyrender_process import OPENGL_FROM_OPENCV, projection
from simgrab.model import scenes
from simgrab.model.rng import stream
from simgrab.model.scenario import Scenario
from simgrab.world.frames import FrameGenerator

FINISHED, BARE = "simgrab: finished labelled frame", "mujoco.Renderer: rgb and segmentation"
BOXES = "mujoco.Renderer: rgb of 400 boxes, not antialiased"
PYRENDER, CYCLES = "pyrender: rgb and depth, no shadows", "Blender Cycles, 16 samples: rgb"
SAMPLES, WARM_UP = 16, 2
Timed = tuple[float, float]  # s and CPU s of a frame, its world included


def compared(
    scene: str, size: tuple[int, int] | None, frames: int, pyrender: bool, blender: str | None, traced: int
) -> Iterator[Quantity]:
    """Measure frames by simgrab, ``mujoco.Renderer`` and, where wanted, pyrender and Blender; worlds are included.

    A small scene by ``mujoco.Renderer``, with a shadow map of 2,048 px, is always the same, to compare runs by.

    The first two frames warm up. Blender, in a process for each of ``traced`` frames, is given all cores.
    """
    scenario = scenes.load(scene, {"frames": frames + WARM_UP}, size=size)
    with ExitStack() as stack:
        generator = stack.enter_context(FrameGenerator(scenario))
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        acts: dict[str, Callable[[int], Timed]] = {FINISHED: partial(_finished, generator, folder)}
        acts[BARE], acts[BOXES] = _bare(generator), _boxes(scenario)
        if pyrender:
            spawn = multiprocessing.get_context("spawn")
            pool = stack.enter_context(ProcessPoolExecutor(1, mp_context=spawn))
            acts[PYRENDER] = partial(_by_pyrender, generator, folder, pool)
        if blender:
            acts[CYCLES] = partial(_traced, generator, folder, Blender(blender))
        some = {WARM_UP + k * frames // traced for k in range(traced)} if blender else set[int]()
        took: dict[str, dict[int, Timed]] = {name: {} for name in acts}
        for frame in range(scenario.frames):
            for name, act in acts.items():
                if name != CYCLES or frame in some:
                    took[name][frame] = act(frame)
    for name, of in took.items():
        kept = {frame: taken for frame, taken in of.items() if frame >= WARM_UP}
        yield Quantity.ms(name, (taken[0] for taken in kept.values()))
        if name != CYCLES:
            yield Quantity.ms(f"{name}: CPU time", (taken[1] for taken in kept.values()))
        if name != FINISHED:
            ratios = [taken[0] / took[FINISHED][frame][0] for frame, taken in kept.items()]
            yield Quantity.of(f"{name}: over simgrab", "×", *ratios)


def _timed(act: Callable[[], Any]) -> Timed:
    start, cpu = time.perf_counter(), time.process_time()
    act()
    return time.perf_counter() - start, time.process_time() - cpu


def _finished(generator: FrameGenerator, folder: Path, frame: int) -> Timed:
    def finish() -> None:
        for name, data in stored.make(generator, frame).files.items():
            write(folder / name, data)

    return _timed(finish)


def _bare(generator: FrameGenerator) -> Callable[[int], Timed]:
    """Colours and then segmentation by ``mujoco.Renderer`` as documented; geoms and camera of the frame made last."""
    import mujoco

    from simgrab.world.scenery.model import HIDDEN, build

    of: Any = None
    model: Any = None
    renderer: Any = None
    option = mujoco.MjvOption()
    option.geomgroup[:] = 1
    option.geomgroup[HIDDEN] = 0

    def render(frame: int) -> None:
        nonlocal of, model, renderer
        scene, k = generator.scene(frame), generator.scenario.camera.intrinsics
        if of is not scene.world.model:
            if renderer:
                renderer.close()
            of, model = scene.world.model, build(scene.world.plan, textured=True).model  # simgrab uploads textures
            model.vis.global_.offwidth, model.vis.global_.offheight = k.width_px, k.height_px
            renderer = mujoco.Renderer(model, k.height_px, k.width_px, max_geom=model.ngeom + 16)
        model.geom_group[:] = scene.world.model.geom_group
        for choose in (renderer.disable_segmentation_rendering, renderer.enable_segmentation_rendering):
            choose()
            renderer.update_scene(scene.renderer.data, mujoco.MjvCamera(), option)
            scene.renderer.aim(scene.renderer.full, renderer.scene)
            renderer.render()

    return lambda frame: _timed(partial(render, frame))


def _boxes(scenario: Scenario) -> Callable[[int], Timed]:
    import mujoco

    k, rng, spec = scenario.camera.intrinsics, stream(0, 0, "boxes"), mujoco.MjSpec()
    spec.visual.global_.offwidth, spec.visual.global_.offheight = k.width_px, k.height_px
    spec.visual.quality.offsamples, spec.visual.quality.shadowsize = 0, 2048
    spec.worldbody.add_light(pos=[5, 5, 30], dir=[-0.2, -0.2, -1])
    spec.worldbody.add_camera(name="above", pos=[0, 0, 20], fovy=50)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[30, 30, 1])
    for x, y, side in rng.uniform((-15, -9, 0.2), (15, 9, 0.8), (400, 3)).tolist():
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[side] * 3, pos=[x, y, side])
    model = spec.compile()
    data, renderer = mujoco.MjData(model), mujoco.Renderer(model, k.height_px, k.width_px)
    mujoco.mj_forward(model, data)

    def render() -> None:
        renderer.update_scene(data, "above")
        renderer.render()

    return lambda _frame: _timed(render)


def _by_pyrender(generator: FrameGenerator, folder: Path, pool: ProcessPoolExecutor, frame: int) -> Timed:
    scene, path = export(generator, frame), folder / "scene.npz"
    np.savez(path, **scene)
    return pool.submit(_pyrendered, path, generator.recipe.variant_number(frame)).result()


_made: dict[str, Any] = {}  # pyrender's, in a process of its own


def _pyrendered(path: Path, variant: int) -> Timed:
    with np.load(path) as file:
        scene = dict(file)
    return _timed(partial(_render_by_pyrender, scene, variant))


def _render_by_pyrender(scene: dict[str, NDArray[Any]], variant: int) -> None:
    os.environ["PYGLET_HEADLESS"] = "1"  # pyrender imports a viewer, which else wants X11
    import pyrender

    width, height, f, cx, cy = scene["camera"]

    class Pinhole(pyrender.Camera):  # type: ignore[misc]
        """An exact frustum: pyrender's IntrinsicsCamera divides by width − 1."""

        def get_projection_matrix(self, width: int | None = None, height: int | None = None) -> Any:  # noqa: ARG002
            return self.matrix

    if _made.get("variant") != variant:
        if "renderer" in _made:
            _made["renderer"].delete()
        world = pyrender.Scene(bg_color=(0.0, 0.0, 0.0, 1.0), ambient_light=scene["ambient"])
        nodes = [world.add_node(node) or node for node in _nodes(scene)]
        for direction, colour in zip(scene["light_directions"], scene["light_colours"], strict=True):
            world.add(
                pyrender.DirectionalLight(color=colour, intensity=np.pi), pose=align_vectors((0, 0, -1), direction)
            )
        _made.update(
            variant=variant, world=world, nodes=nodes, camera=world.add(Pinhole()),
            renderer=pyrender.OffscreenRenderer(int(width), int(height)),
        )  # fmt: skip
    _made["camera"].camera.matrix = projection(f, cx, cy, width, height)
    _made["world"].set_pose(_made["camera"], scene["jib_from_camera"] @ OPENGL_FROM_OPENCV)
    for node, pose, shown in zip(_made["nodes"], scene["jib_from_geom"], scene["shown"], strict=True):
        _made["world"].set_pose(node, pose)
        node.mesh.is_visible = bool(shown)
    _made["renderer"].render(_made["world"])


def _nodes(scene: dict[str, NDArray[Any]]) -> Iterator[Any]:
    import pyrender

    textures = [
        pyrender.Texture(source=np.ascontiguousarray(scene[f"texture_{number}"][::-1]), source_channels="RGB")
        for number in range(sum(name.startswith("texture_") for name in scene))
    ]
    parts = (np.split(scene[part], scene[f"{part}_ends"][:-1]) for part in ("vertices", "faces"))
    for vertices, faces, colour, picture, pose in zip(
        *parts, scene["colours"], scene["texture"], scene["jib_from_geom"], strict=True
    ):
        material = pyrender.MetallicRoughnessMaterial(
            baseColorFactor=(*colour, 1.0), baseColorTexture=textures[picture] if picture >= 0 else None,
            metallicFactor=0.0, roughnessFactor=1.0,
        )  # fmt: skip
        primitive = pyrender.Primitive(
            positions=vertices[:, :3], normals=vertices[:, 3:6], texcoord_0=vertices[:, 6:], indices=faces,
            material=material, mode=4,
        )  # fmt: skip
        yield pyrender.Node(mesh=pyrender.Mesh([primitive]), matrix=pose)


def _traced(generator: FrameGenerator, folder: Path, blender: Blender, frame: int) -> Timed:
    path = folder / "traced.npz"
    np.savez(path, **export(generator, frame))
    job = {"scene": str(path), "samples": SAMPLES, "threads": os.cpu_count(), "out": str(folder / "light.npy")}
    return _timed(partial(blender, job))
