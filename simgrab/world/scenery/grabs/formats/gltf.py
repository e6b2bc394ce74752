"""glTF 2.0 and GLB.

trimesh 5.2 gets 70 of the tests' 88 cases right: no sparse or quantized accessors, morph targets, instances or hidden
nodes. pygltflib gives the JSON as classes, and reads no accessors.
"""

from __future__ import annotations

import base64
from collections import deque
from collections.abc import Iterator, Mapping
from typing import Any
from urllib.parse import unquote

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.transformations import quaternion_matrix

from simgrab.io import models
from simgrab.io.models import MOST_NODES, ModelFile
from simgrab.io.parse import Refuse, shown
from simgrab.model.geometry import Array
from simgrab.model.srgb import encoded
from simgrab.world.scenery.grabs.formats import gltf_extensions as extensions
from simgrab.world.scenery.grabs.formats.contents import Contents, Faces, Shape, some
from simgrab.world.scenery.grabs.formats.gltf_materials import Materials

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_PLAIN = "export it without compression"
_MOST_TARGETS, _MOST_JOINTS = 100, 16
"""Of morph targets that have an effect, and of joints of a vertex."""


def read(model: ModelFile, refuse: Refuse) -> Contents:
    """Read a glTF file or a GLB file."""
    content = models.gltf(model.format, model.data, refuse)
    for name in extensions.required(content.get("extensionsRequired", [])):
        if name in extensions.COMPRESSED:
            raise refuse(f"needs {name}: {_PLAIN}")
        if name in extensions.PICTURES:
            raise refuse(f"needs {name}: export it with textures in PNG or JPEG")
        raise refuse(f"needs the glTF extension {shown(name)}, which is not supported: export it without")
    version = str(content.get("asset", {}).get("version", "2.0"))
    if not version.startswith("2."):
        raise refuse(f"is of glTF {shown(version)}; export it as glTF 2.0")
    buffers = _Buffers(model, content, refuse)
    return _Scene(content, buffers, Materials(content, buffers.picture), refuse).contents()


class _Buffers:
    """What accessors give."""

    def __init__(self, model: ModelFile, content: Mapping[str, Any], refuse: Refuse) -> None:
        self._model, self._content, self._refuse = model, content, refuse
        self._wholes: dict[int, memoryview] = {}

    def read(self, index: int, widths: tuple[int, ...], count: int | None = None) -> NDArray[Any]:
        """Read an accessor, shape (n, width); normalized integers become fractions.

        Refuses one of another width, or of another count.
        """
        accessor = self._content["accessors"][index]
        kind, width = np.dtype(_COMPONENTS[accessor["componentType"]]), _WIDTHS[accessor["type"]]
        if width not in widths:
            raise self._refuse(f"accessor {index} is of type {accessor['type']}, which does not fit its use")
        if count is not None and accessor["count"] != count:
            raise self._refuse(f"accessor {index} has {accessor['count']} values for {count} vertices")
        if "bufferView" in accessor:
            rows = self._rows(accessor, kind, width, accessor["count"])
        else:
            rows = np.zeros((accessor["count"], width), kind)
        if "sparse" in accessor:
            sparse, rows = accessor["sparse"], rows.copy()
            some, places = sparse["count"], sparse["indices"]
            at = self._rows(places, np.dtype(_COMPONENTS[places["componentType"]]), 1, some).ravel()
            rows[at] = self._rows(sparse["values"], kind, width, some)
        if accessor.get("normalized") and kind.kind in "iu":
            return np.asarray(np.maximum(rows / float(np.iinfo(kind).max), -1.0))
        return rows

    def _rows(self, place: Mapping[str, Any], kind: np.dtype[Any], width: int, count: int) -> NDArray[Any]:
        view = self._content["bufferViews"][place["bufferView"]]
        data = self.view(place["bufferView"])
        stride, first = view.get("byteStride") or kind.itemsize * width, place.get("byteOffset", 0)
        if count and not 0 <= first <= len(data) - (count - 1) * stride - kind.itemsize * width:
            raise self._refuse("an accessor reaches beyond its buffer: it is cut off or damaged")
        return np.ndarray((count, width), kind, data, first, (stride, kind.itemsize)).copy()

    def view(self, index: int) -> memoryview:
        """Give the bytes of a buffer view."""
        view = self._content["bufferViews"][index]
        whole, first = self._whole(view["buffer"], view), view.get("byteOffset", 0)
        if not 0 <= first <= len(whole) - view["byteLength"]:
            raise self._refuse("a buffer view reaches beyond its buffer: it is cut off or damaged")
        return whole[first : first + view["byteLength"]]

    def _whole(self, number: int, view: Mapping[str, Any]) -> memoryview:
        if number in self._wholes:
            return self._wholes[number]
        uri = self._content["buffers"][number].get("uri")
        if uri is not None:
            whole = memoryview(self._of_uri(uri) or b"")
        elif number or self._model.format != "glb":
            kind = _compression(view)
            raise self._refuse(f"needs {kind}: {_PLAIN}" if kind else f"buffer {number} has no data")
        else:
            whole = memoryview(self._model.data)[28 + int.from_bytes(self._model.data[12:16], "little") :]
        return self._wholes.setdefault(number, whole)

    def picture(self, index: int) -> bytes | None:
        """Return the file of an image; None if it is missing."""
        image = self._content["images"][index]
        if "bufferView" in image:
            return bytes(self.view(image["bufferView"]))
        return self._of_uri(image["uri"]) if "uri" in image else None

    def _of_uri(self, uri: str) -> bytes | None:
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2])
        return self._model.referred(unquote(uri))


class _Scene:
    """The nodes of the scene that is shown, and their meshes."""

    def __init__(self, content: dict[str, Any], buffers: _Buffers, materials: Materials, refuse: Refuse) -> None:
        self._content, self._buffers, self._materials, self._refuse = content, buffers, materials, refuse
        self._nodes: list[dict[str, Any]] = content.get("nodes", [])
        self._meshes: list[dict[str, Any]] = content.get("meshes", [])
        self._names = _unique([str(node.get("name", number)) for number, node in enumerate(self._nodes)])
        self._doubts, self._unread = materials.doubts, materials.unread

    def contents(self) -> Contents:
        """Return all shapes, and notes on content that is not shown."""
        shown_nodes = list(self._walk())
        poses = {number: pose for number, pose, _ in shown_nodes}
        shapes: list[Shape] = []
        for number, pose, above in shown_nodes:
            shapes += self._of_node(number, pose, above, poses)
            if len(shapes) > 2 * MOST_NODES:
                raise self._refuse(f"shows more than {2 * MOST_NODES} primitives: join some")
        known = {*poses, *(one for node in self._nodes for one in _extension(node, "MSFT_lod").get("ids", []))}
        hidden = [self._names[i] for i, node in enumerate(self._nodes) if "mesh" in node and i not in known]
        if hidden:
            self._doubts[f"Hidden, or not in the scene that is shown: {some(hidden)}. Export them in that scene if "
                         "they are of the grab."] = None  # fmt: skip
        for key in ("animations", "cameras"):
            if self._content.get(key):
                self._unread[key] = None
        doubts, unread = extensions.remarks(extensions.used(self._content))
        return Contents(tuple(shapes), (*doubts, *self._doubts), tuple(dict.fromkeys([*unread, *self._unread])))

    def _walk(self) -> Iterator[tuple[int, Array, tuple[str, ...]]]:
        """Yield the shown nodes' numbers, with their poses and the names of all ancestors."""
        waiting = deque[tuple[int, Array, tuple[str, ...]]]((number, np.eye(4), ()) for number in self._roots())
        seen = set[int]()
        while waiting:
            number, above, names = waiting.popleft()
            node = self._nodes[number]
            if number in seen or number < 0 or _extension(node, "KHR_node_visibility").get("visible") is False:
                continue
            seen.add(number)
            pose = above @ _pose(node)
            yield number, pose, names
            waiting += [(child, pose, (self._names[number], *names)) for child in node.get("children", [])]

    def _roots(self) -> list[int]:
        scenes = self._content.get("scenes")
        if scenes:
            if len(scenes) > 1:
                self._unread[f"all of its {len(scenes)} scenes but one"] = None
            return list(scenes[self._content.get("scene", 0)].get("nodes", []))
        below = {child for node in self._nodes for child in node.get("children", [])}
        return [number for number in range(len(self._nodes)) if number not in below]

    def _of_node(self, number: int, pose: Array, above: tuple[str, ...], poses: Mapping[int, Array]) -> Iterator[Shape]:
        node = self._nodes[number]
        if "mesh" not in node:
            return
        mesh, name = self._meshes[node["mesh"]], self._names[number]
        places = self._instances(node)
        weights = node.get("weights", mesh.get("weights", []))
        for place, primitive in enumerate(mesh["primitives"]):
            made = self._triangles(primitive, weights)
            if made is None:
                continue
            vertices, faces = made
            if "skin" in node:
                skin = self._content["skins"][node["skin"]]
                vertices, pose = self._skinned(primitive, vertices, skin, poses), np.eye(4)
            surface, uv, colours = self._surface(primitive, len(vertices), faces)
            nodes = (name, *above) if len(mesh["primitives"]) == 1 else (f"{name}_{place}", name, *above)
            for i, instance in enumerate(places):
                own = nodes if len(places) == 1 else (f"{nodes[0]}_{i}", *nodes)
                yield Shape(own, vertices, faces, surface, uv, colours, pose @ instance)

    def _triangles(self, primitive: dict[str, Any], weights: list[float]) -> tuple[Array, Faces] | None:
        mode = primitive.get("mode", _TRIANGLES)
        if mode not in (_TRIANGLES, _STRIP, _FAN):
            self._unread["lines and points"] = None
            return None
        at = primitive["attributes"]["POSITION"]
        kind = _compression(primitive)
        if kind and not {"bufferView", "sparse"} & set(self._content["accessors"][at]):
            raise self._refuse(f"needs {kind}: {_PLAIN}")
        vertices = self._buffers.read(at, (3,)).astype(float)
        targets = [(w, target) for w, target in zip(weights, primitive.get("targets", []), strict=False) if w]
        if len(targets) > _MOST_TARGETS:
            raise self._refuse(f"has {len(targets)} morph targets at once; the limit is {_MOST_TARGETS}")
        for weight, target in targets:
            if "POSITION" in target:
                vertices += weight * self._buffers.read(target["POSITION"], (3,), len(vertices))
        if "indices" in primitive:
            corners = self._buffers.read(primitive["indices"], (1,)).ravel().astype(np.int64)
        else:
            corners = np.arange(len(vertices))
        if len(corners) and not 0 <= corners.min() <= corners.max() < len(vertices):
            raise self._refuse(f"a face names vertex {corners.max()} of {len(vertices)}")
        if mode == _TRIANGLES:
            faces = corners[: len(corners) // 3 * 3].reshape(-1, 3)
        elif len(corners) < 3:
            faces = np.empty((0, 3), np.int64)
        elif mode == _STRIP:
            faces = np.asarray(trimesh.util.triangle_strips_to_faces([corners]), np.int64)
        else:
            faces = np.stack([np.full(len(corners) - 2, corners[0]), corners[1:-1], corners[2:]], axis=1)
        return (vertices, faces) if len(faces) else None

    def _surface(self, primitive: dict[str, Any], count: int, faces: Faces) -> tuple[Any, Array | None, Array | None]:
        attributes = primitive["attributes"]
        material = self._materials[primitive["material"]] if "material" in primitive else None
        uv = colours = None
        if material is not None and material.surface.texture is not None:
            name = f"TEXCOORD_{material.uv_set}"
            if name in attributes:
                uv = material.placed(self._buffers.read(attributes[name], (2,), count).astype(float))
            else:
                self._doubts[f"A mesh has no {name}, which its texture needs: export texture coordinates."] = None
        if "COLOR_0" in attributes:
            levels = self._buffers.read(attributes["COLOR_0"], (3, 4), count)
            if levels.dtype.kind == "u":
                levels = levels / float(np.iinfo(levels.dtype).max)
            levels = np.clip(levels, 0.0, 1.0)
            if levels.shape[1] > 3 and material is not None and material.blends and levels[:, 3].min() < 1.0:
                self._doubts["Colours of vertices are partly transparent; they are shown opaque."] = None
            linear = levels[faces, :3].mean(axis=1) * (1.0 if material is None else material.factor)
            colours = np.asarray(encoded(linear))
        if any(name.startswith("COLOR_") and name != "COLOR_0" for name in attributes):
            self._unread["colours of vertices beyond COLOR_0"] = None
        return None if material is None else material.surface, uv, colours

    def _instances(self, node: Mapping[str, Any]) -> list[Array]:
        found = _extension(node, "EXT_mesh_gpu_instancing").get("attributes", {})
        widths = {"TRANSLATION": 3, "ROTATION": 4, "SCALE": 3}
        rows = {name: self._buffers.read(found[name], (width,)) for name, width in widths.items() if name in found}
        count = max(map(len, rows.values()), default=1)
        if count > MOST_NODES:
            raise self._refuse(f"shows {count} instances; the limit is {MOST_NODES}")
        return [_pose({name.lower(): values[i] for name, values in rows.items()}) for i in range(count)]

    def _skinned(
        self, primitive: Mapping[str, Any], vertices: Array, skin: Mapping[str, Any], poses: Mapping[int, Array]
    ) -> Array:
        """Place vertices by the joints in the file's rest pose."""
        joints = np.stack([poses.get(number, np.eye(4)) for number in skin["joints"]])
        if "inverseBindMatrices" in skin:
            bound = self._buffers.read(skin["inverseBindMatrices"], (16,))[: len(joints)].reshape(-1, 4, 4)
            joints = joints @ bound.swapaxes(1, 2)
        moved, total = np.zeros_like(vertices), np.zeros((len(vertices), 1))
        attributes, number = primitive["attributes"], 0
        while f"JOINTS_{number}" in attributes and number < _MOST_JOINTS // 4:
            which = self._buffers.read(attributes[f"JOINTS_{number}"], (4,), len(vertices)).astype(np.int64)
            shares = self._buffers.read(attributes[f"WEIGHTS_{number}"], (4,), len(vertices)).astype(float)
            for column in range(4):
                pose, share = joints[which[:, column]], shares[:, column, None]
                moved += share * (np.einsum("nij,nj->ni", pose[:, :3, :3], vertices) + pose[:, :3, 3])
                total += share
            number += 1
        return np.asarray(np.where(total > 0, moved / np.where(total > 0, total, 1.0), vertices))


def _extension(entry: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = entry.get("extensions", {}).get(name, {})
    return found if isinstance(found, dict) else {}


def _compression(entry: Mapping[str, Any]) -> str:
    """Return the extension by which the data of an entry are compressed; empty for none."""
    return min(extensions.COMPRESSED & set(entry.get("extensions", {})), default="")


def _pose(node: Mapping[str, Any]) -> Array:
    """Return the pose of a node in its parent."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    pose = np.eye(4)
    if "rotation" in node:
        x, y, z, w = (float(part) for part in node["rotation"])
        pose = np.array(quaternion_matrix([w, x, y, z]))
    pose[:3, :3] *= np.array(node.get("scale", (1, 1, 1)), float)
    pose[:3, 3] = np.array(node.get("translation", (0, 0, 0)), float)
    return pose


def _unique(names: list[str]) -> list[str]:
    """Give every node a unique name; the first of several equal ones keeps it."""
    taken, found = set(names), dict[str, None]()
    for name in names:
        own, number = name, 1
        while own in found or (own != name and own in taken):
            own, number = f"{name}_{number}", number + 1
        found[own] = None
    return list(found)
