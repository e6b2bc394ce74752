"""A posed scene as arrays, and the loop by which a process renders it for `scripts.bench_renderers`.

It imports NumPy alone, because Blender's interpreter runs it too.
"""

from __future__ import annotations

import dataclasses
import json
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ExportedScene:
    """The triangles, colours and lights that MuJoCo renders, frame by frame. Metres, in the jib frame.

    Attributes
    ----------
    camera : ndarray, shape (5,)
        Width, height, focal length, and principal point from the picture's top left corner, px. Of a lens that
        distorts, the picture is the undistorted one behind it.
    jib_from_camera : ndarray, shape (frames, 4, 4)
        Camera: x right, y down, z forward.
    jib_from_geom : ndarray, shape (frames, geoms, 4, 4)
    shown : ndarray of bool, shape (frames, geoms)
    groups : ndarray of int, shape (frames, geoms)
        0 place, 1 jib head, 2 ropes, 3 grab.
    names : ndarray of str, shape (geoms,)
    vertices : ndarray of float32, shape (n, 8)
        Position, normal and texture coordinates, in the frame of a geom.
    faces : ndarray of int32, shape (m, 3)
    vertex_ends, face_ends : ndarray, shape (geoms,)
        Where each geom's vertices and faces end; its faces count from its own first vertex.
    colours : ndarray, shape (geoms, 3)
        Multiplied with the texture, if any.
    texture : ndarray of int, shape (geoms,)
        Index into ``textures``; −1 for none.
    light_directions, light_colours : ndarray, shape (lights, 3)
    ambient : ndarray, shape (3,)
    textures : tuple of ndarray of uint8, shape (height, width, 3)
        The first row is the lowest, at v = 0.
    """

    camera: Array
    jib_from_camera: Array
    jib_from_geom: Array
    shown: NDArray[np.bool_]
    groups: NDArray[np.int64]
    names: NDArray[np.str_]
    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    vertex_ends: NDArray[np.int64]
    face_ends: NDArray[np.int64]
    colours: Array
    texture: NDArray[np.int64]
    light_directions: Array
    light_colours: Array
    ambient: Array
    textures: tuple[NDArray[np.uint8], ...]

    def save(self, path: Path) -> None:
        """Write as a NumPy archive."""
        arrays = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        pictures = {f"texture_{number}": picture for number, picture in enumerate(arrays.pop("textures"))}
        np.savez(path, **arrays, **pictures)

    @classmethod
    def load(cls, path: Path) -> ExportedScene:
        """Read what `save` wrote."""
        with np.load(path) as file:
            count = sum(name.startswith("texture_") for name in file.files)
            arrays = {field.name: file[field.name] for field in dataclasses.fields(cls) if field.name != "textures"}
            return cls(**arrays, textures=tuple(file[f"texture_{number}"] for number in range(count)))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        return int(self.camera[0]), int(self.camera[1])

    def mesh(self, geom: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Vertices and faces of a geom."""
        vertices, faces = np.split(self.vertices, self.vertex_ends), np.split(self.faces, self.face_ends)
        return vertices[geom], faces[geom]


class SceneRenderer(Protocol):
    """What a process renders an exported scene with."""

    by: str

    def render(self, frame: int) -> object:
        """Render a frame at full size, and write nothing."""

    def save(self, path: str) -> None:
        """Write the frame rendered last as a PNG file."""


def serve(make: Callable[[ExportedScene], SceneRenderer], scene: Path) -> None:
    """Render what the lines of standard input ask for, and answer each with a line, until there is no other."""
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what libraries print is no answer
    renderer = make(ExportedScene.load(scene))
    print(json.dumps(renderer.by), file=answers)
    for line in sys.stdin:
        frame, picture = json.loads(line)
        if picture:
            renderer.save(picture)
        else:
            renderer.render(frame)
        print("null", file=answers)
