"""A posed frame as arrays of triangles, colours and lights, which another renderer takes."""

from __future__ import annotations

from typing import Any

import numpy as np

from simgrab.model.geometry import Intrinsics
from simgrab.world.camera.lens import Lens, Window
from simgrab.world.frames import FrameGenerator
from simgrab.world.scenery.model import HIDDEN, build


def export(generator: FrameGenerator, frame: int = 0) -> dict[str, Any]:
    """Export what a frame shows. Metres, in the jib frame.

    Returns
    -------
    dict of str to ndarray
        ``camera``: width, height, focal length, and principal point from the picture's top left corner, px; of a lens
        that distorts, the picture is the undistorted one behind it. ``jib_from_camera``, shape (4, 4): x right, y down,
        z forward. Of each geom ``jib_from_geom``, shape (geoms, 4, 4); ``shown``; ``groups``: 0 place, 1 jib head,
        2 ropes, 3 grab; ``names``; ``colours``, multiplied with ``texture``, an index, −1 for none. ``vertices``,
        float32 of shape (n, 8): position, normal and texture coordinates, in the frame of a geom; ``faces``, which
        count from the geom's first vertex; ``vertices_ends`` and ``faces_ends``: where each geom's end.
        ``light_directions``, ``light_colours``, ``ambient``. ``texture_0`` and so on: the first row is the lowest.
    """
    import mujoco  # after simgrab.world, which chooses its OpenGL

    scene, moment = generator.scene(frame), generator.project(frame).moment
    camera = scene.scenario.camera
    k = camera.intrinsics
    model = build(scene.world.plan, textured=True).model  # simgrab uploads textures itself
    data = scene.renderer.pose(moment)
    groups = scene.world.model.geom_group.astype(np.int64)
    vertices, faces = zip(*(_mesh(model, int(mesh)) for mesh in model.geom_dataid), strict=True)
    x0, y0, x1, y1 = source_window(k)
    return {
        "camera": np.array([x1 - x0, y1 - y0, k.f_px, k.cx_px - x0, k.cy_px - y0]),
        "jib_from_camera": _pose(moment.tilt.jib_from_camera, np.array(camera.offset_m)),
        "jib_from_geom": np.array([_pose(g.xmat.reshape(3, 3), g.xpos) for g in map(data.geom, range(model.ngeom))]),
        "shown": groups != HIDDEN,
        "groups": groups,
        "names": np.array([model.geom(geom).name for geom in range(model.ngeom)]),
        "colours": np.array(model.mat_rgba[model.geom_matid, :3], float),
        "texture": np.array(model.mat_texid[model.geom_matid, mujoco.mjtTextureRole.mjTEXROLE_RGB], np.int64),
        "vertices": np.concatenate(vertices),
        "faces": np.concatenate(faces),
        "vertices_ends": np.cumsum([len(v) for v in vertices]),
        "faces_ends": np.cumsum([len(f) for f in faces]),
        "light_directions": np.array(data.light_xdir),
        "light_colours": np.array(model.light_diffuse, float),
        "ambient": np.array(model.light_ambient.sum(axis=0), float),
        **{f"texture_{number}": _texture(model, number) for number in range(model.ntex)},
    }


def source_window(k: Intrinsics) -> Window:
    """Window of the undistorted picture that the lens maps to the picture; without distortion the picture itself."""
    full = (0, 0, k.width_px, k.height_px)
    return full if k.distortion.is_null else Lens(k).map(full).source


def _pose(turn: Any, place: Any) -> Any:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, place
    return pose


def _mesh(model: Any, mesh: int) -> tuple[Any, Any]:
    """Vertices and faces; corners that agree in position, normal and texture share a vertex."""
    one = model.mesh(mesh)
    vertex, normal, uv = (int(getattr(model, f"mesh_{kind}adr")[mesh]) for kind in ("vert", "normal", "texcoord"))
    span = slice(int(one.faceadr[0]), int(one.faceadr[0]) + int(one.facenum[0]))
    parts = (
        model.mesh_vert[vertex + model.mesh_face[span].ravel()],
        model.mesh_normal[normal + model.mesh_facenormal[span].ravel()],
        model.mesh_texcoord[uv + model.mesh_facetexcoord[span].ravel()],
    )
    corners = np.asarray(np.concatenate(parts, axis=1), np.float32)
    vertices, corner = np.unique(corners, axis=0, return_inverse=True)
    return vertices, corner.reshape(-1, 3).astype(np.int32)


def _texture(model: Any, texture: int) -> Any:
    height, width, start = (int(a[texture]) for a in (model.tex_height, model.tex_width, model.tex_adr))
    return np.array(model.tex_data[start : start + 3 * height * width]).reshape(height, width, 3)
