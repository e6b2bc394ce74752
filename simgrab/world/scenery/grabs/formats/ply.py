"""PLY: text or binary of either byte order, with polygons or triangle strips, colours and textures.

trimesh 5.2 gets 60 of the tests' 66 cases right, but no polygons of mixed sizes in binary files; meshio 5.3 53.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from simgrab.io import models
from simgrab.io.models import MOST_FACES, ModelFile
from simgrab.io.parse import Refuse, shown
from simgrab.model.geometry import Array
from simgrab.world.scenery.grabs.formats.contents import Contents, Faces, FileMaterial, Shape, stated_unit
from simgrab.world.scenery.grabs.formats.polygons import check, triangles

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "int64": "i8", "uint64": "u8",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_COLOURS = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
_UV = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))
_ALPHA = ("alpha", "a", "diffuse_alpha")
_INDICES = ("vertex_indices", "vertex_index")
_SEEN = {"x", "y", "z", "nx", "ny", "nz", *_ALPHA, *_INDICES, "texcoord", "texnumber", *sum((*_COLOURS, *_UV), ())}

Column = NDArray[Any]
Lists = tuple[Column, Faces]
"""Values of all lists, one after the other, and how long each is."""


def read(model: ModelFile, refuse: Refuse) -> Contents:
    """Read a PLY file."""
    header = models.header(model.data)
    elements = _elements(model.data, header, refuse)
    vertex, face = elements.get("vertex", {}), elements.get("face", {})
    if not {"x", "y", "z"} <= set(vertex):
        raise refuse("has no vertices with x, y and z")
    vertices = np.stack([vertex[axis].astype(float) for axis in "xyz"], axis=1)
    lists = [name for name in face if isinstance(face[name], tuple)]
    named = [name for name in _INDICES if name in lists] or lists[:1]
    indices, sizes = face[named[0]] if named else (np.empty(0, int), np.empty(0, int))
    for strips in (strips for name, strips in elements.get("tristrips", {}).items() if name in _INDICES):
        if len(strips[0]) > 2 * MOST_FACES:
            raise refuse(f"has more than {MOST_FACES} triangles: simplify it")
        indices, sizes = _with_strips(indices.astype(np.int64), sizes, strips[0].astype(np.int64))
    check(sizes, refuse)
    indices = indices.astype(np.int64)
    if len(indices) and not 0 <= indices.min() <= indices.max() < len(vertices):
        raise refuse(f"a face names vertex {indices[(indices < 0) | (indices >= len(vertices))][0]} of {len(vertices)}")
    corners, polygons = triangles(vertices[indices], sizes)
    doubts = _doubts(model, elements)
    colours = _colours(face)
    if colours is not None and len(colours) == len(sizes):
        colours = colours[polygons]
    elif (own := _colours(vertex)) is not None:
        colours = own[indices[corners]].mean(axis=1)
    else:
        colours = None
    uv = _uv(vertex, face, indices)
    surfaces = [_textured(model, name) for name in models.textures(model.data)] if uv is not None else []
    comments = (words[1:] for words in header if words[:1] in (["comment"], ["obj_info"]))
    unit = stated_unit(" ".join(itertools.chain(*comments)))
    if not any(surfaces) or uv is None:
        return Contents((Shape(("geometry_0",), vertices, indices[corners], colours=colours),), *doubts, unit)
    numbers = face["texnumber"][polygons] if "texnumber" in face else np.zeros(len(corners), int)
    shapes = []
    for number in np.unique(numbers):
        own = corners[numbers == number].ravel()
        surface = surfaces[int(number)] if 0 <= number < len(surfaces) else None
        shapes.append(Shape(
            ("geometry_0",) if len(surfaces) == 1 else (f"geometry_0_{int(number)}", "geometry_0"),
            vertices[indices[own]], np.arange(len(own)).reshape(-1, 3), surface, None if surface is None else uv[own],
            None if surface is not None or colours is None else colours[numbers == number],
        ))  # fmt: skip
    return Contents(tuple(shapes), *doubts, unit)


def _textured(model: ModelFile, name: str) -> FileMaterial | None:
    """Give a surface with a texture of the model's folder; None where it is not there."""
    picture = model.referred(name)
    return None if picture is None else FileMaterial(texture=picture)


def _with_strips(indices: Faces, sizes: Faces, strips: Faces) -> tuple[Faces, Faces]:
    """Add the triangles of strips, which -1 separates."""
    runs = np.split(strips, np.flatnonzero(strips < 0))
    runs = [run[run >= 0] for run in runs]
    kept = [run for run in runs if len(run) > 2]
    if not kept:
        return indices, sizes
    added = trimesh.util.triangle_strips_to_faces(kept)
    return np.concatenate([indices, added.ravel()]), np.concatenate([sizes, np.full(len(added), 3)])


def _colours(element: dict[str, Any]) -> Array | None:
    """Read colours, in [0, 1]; None where the element has none."""
    names = next((names for names in _COLOURS if set(names) <= set(element)), None)
    if names is None:
        return None
    columns = [element[name] for name in names]
    kind = columns[0].dtype
    most = {"u2": 65535.0, "i2": 65535.0}.get(kind.str[1:], 255.0)
    if kind.kind == "f" and max(column.max(initial=0) for column in columns) <= 1.0:
        most = 1.0
    return np.clip(np.stack(columns, axis=1) / most, 0.0, 1.0)


def _uv(vertex: dict[str, Any], face: dict[str, Any], indices: Faces) -> Array | None:
    """Read texture coordinates of the corners of faces."""
    if "texcoord" in face and len(face["texcoord"][0]) == 2 * len(indices):
        return np.asarray(face["texcoord"][0], float).reshape(-1, 2)
    names = next((names for names in _UV if set(names) <= set(vertex)), None)
    if names is None:
        return None
    return np.asarray(np.stack([vertex[name].astype(float) for name in names], axis=1)[indices])


def _doubts(model: ModelFile, elements: dict[str, dict[str, Any]]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    doubts, unread = [], []
    for name, element in elements.items():
        alpha = next((element[name] for name in _ALPHA if name in element), None)
        if alpha is not None and len(alpha) and alpha.min() < (1.0 if alpha.dtype.kind == "f" else 255):
            doubts.append(f"Its {name} colours are partly transparent (alpha); it is shown opaque.")
        others = sorted(set(element) - _SEEN)
        if name in ("vertex", "face", "tristrips"):
            unread += [f"{name} property {shown(other)}" for other in others[:6]]
        elif name == "material":
            doubts.append("Its element 'material' is not read: give colours to its vertices or faces.")
        else:
            unread.append(f"element {shown(name)}")
    if models.textures(model.data) and not any({"texcoord", *sum(_UV, ())} & set(one) for one in elements.values()):
        doubts.append("It names a texture, but has no texture coordinates (s and t, or texcoord): export them too.")
    return tuple(doubts), tuple(unread)


def _elements(data: bytes, header: list[list[str]], refuse: Refuse) -> dict[str, dict[str, Any]]:
    """Read all elements: columns of numbers, and lists."""
    ending = data.find(b"end_header")
    start = data.find(b"\n", ending) + 1
    encoding = next((words[1] for words in header if words[:1] == ["format"] and len(words) > 1), "")
    if not data.startswith(b"ply") or ending < 0 or not start:
        raise refuse("is not a PLY file")
    stated: list[tuple[str, int, list[tuple[str, ...]]]] = []
    for words in header:
        if words[:1] == ["element"] and len(words) == 3:
            stated.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"] and stated:
            if not set(words[1:-1]) - {"list"} <= set(_TYPES) or len(words) != (5 if words[1] == "list" else 3):
                raise refuse(f"has a property of an unknown type: {shown(' '.join(words))}")
            stated[-1][2].append((words[-1], *(_TYPES[word] for word in words[1:-1] if word != "list")))
    if encoding == "ascii":
        try:
            content = np.fromstring(data[start:].decode("ascii", errors="replace"), sep=" ").tobytes()
        except ValueError:
            raise refuse("holds what is not a number") from None
        order, text = "=", "f8"
    elif encoding in ("binary_little_endian", "binary_big_endian"):
        content, order, text = data[start:], "<" if "little" in encoding else ">", ""
    else:
        raise refuse(f"has the format {shown(encoding)}, which is none of PLY's")
    elements, place = dict[str, dict[str, Any]](), 0
    try:
        for name, count, properties in stated:
            stored = [[np.dtype(order + (text or kind)) for kind in kinds] for _, *kinds in properties]
            columns, place = _columns(content, place, count, stored)
            if count:
                elements[name] = {
                    own: (column[0].astype(kinds[-1]), column[1])
                    if isinstance(column, tuple)
                    else column.astype(kinds[0])
                    for (own, *kinds), column in zip(properties, columns, strict=True)
                }
    except (ValueError, IndexError):
        raise refuse("is truncated, or its numbers do not fit its header") from None
    return elements


def _columns(data: bytes, place: int, count: int, types: list[list[np.dtype[Any]]]) -> tuple[list[Column | Lists], int]:
    """Read an element's properties, of one type or, for lists, of their lengths' and values'; and where they end."""
    if all(len(kinds) == 1 for kinds in types):
        row = np.dtype([(str(number), *kinds) for number, kinds in enumerate(types)])
        rows = np.frombuffer(data, row, count, place) if types and count else np.empty(0, row)
        return [rows[name] for name in row.names or ()], place + count * row.itemsize
    values: list[list[Column]] = [[] for _ in types]
    for _ in range(count):
        for (*lengths, kind), column in zip(types, values, strict=True):
            length = 1
            for counted in lengths:
                length = int(np.frombuffer(data, counted, 1, place)[0])
                place += counted.itemsize
            if length < 0:
                raise ValueError("a list of negative length")
            column.append(np.frombuffer(data, kind, length, place))
            place += length * kind.itemsize
    return [
        (np.concatenate(column), np.array([len(one) for one in column])) if len(kinds) == 2 else np.concatenate(column)
        for kinds, column in zip(types, values, strict=True)
    ] if count else [], place  # fmt: skip
