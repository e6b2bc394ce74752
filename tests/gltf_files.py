"""glTF files in the making, of a box whose attributes and JSON are changed."""

from __future__ import annotations

import copy
import io
import json
import struct

import numpy as np
import trimesh
from PIL import Image

BLUE, SRGB_BLUE = (0.05, 0.2, 0.6), (63, 124, 203)  # linear, and its display values
BOX = trimesh.creation.box((2.0, 2.0, 2.0))
V, F = np.asarray(BOX.vertices, np.float32), np.asarray(BOX.faces, np.int64)
UV = np.linspace(0, 1, 16, dtype=np.float32).reshape(8, 2)
COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


def png(colour=(200, 100, 50), mode="RGB", size=(2, 2)):
    file = io.BytesIO()
    Image.new(mode, size, colour).save(file, "png")
    return file.getvalue()


def base_colour(**texture):
    return {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0} | texture}}


class Gltf:
    """A glTF file in the making: a box with y up, whose attributes and JSON are changed."""

    def __init__(self):
        self.binary = b""
        self.content = {
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "name": "Box"}],
            "meshes": [{"primitives": [{"attributes": {}}]}], "accessors": [], "bufferViews": [], "buffers": [{}],
        }  # fmt: skip
        self.attributes["POSITION"] = self.add(V)
        self.primitive["indices"] = self.add(F.ravel().astype(np.uint16))

    @property
    def primitives(self):
        return self.content["meshes"][0]["primitives"]

    @property
    def primitive(self):
        return self.primitives[0]

    @property
    def attributes(self):
        return self.primitive["attributes"]

    @property
    def node(self):
        return self.content["nodes"][0]

    def view(self, data):
        self.content["bufferViews"].append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)})
        self.binary += data + bytes(-len(data) % 4)
        return len(self.content["bufferViews"]) - 1

    def add(self, values, **more):
        values = np.asarray(values)
        width = 1 if values.ndim == 1 else values.shape[1]
        self.content["accessors"].append({
            "bufferView": self.view(values.tobytes()), "componentType": COMPONENTS[values.dtype.str[1:]],
            "type": TYPES[width], "count": len(values),
        } | more)  # fmt: skip
        return len(self.content["accessors"]) - 1

    def material(self, **material):
        self.content.setdefault("materials", []).append(material)
        self.primitive["material"] = len(self.content["materials"]) - 1
        return self

    def texture(self, picture=None, mime="image/png", uv=UV, **more):
        self.content["images"] = [{"bufferView": self.view(picture or png()), "mimeType": mime}]
        self.content["textures"] = [{"source": 0} | more]
        if uv is not None:
            self.attributes["TEXCOORD_0"] = self.add(uv)
        return self

    def uses(self, *extensions, needs=False):
        self.content["extensionsUsed"] = list(extensions)
        if needs:
            self.content["extensionsRequired"] = list(extensions)
        return self

    def glb(self):
        content = copy.deepcopy(self.content)
        content["buffers"][0] = {"byteLength": len(self.binary)} | content["buffers"][0]
        text = json.dumps(content).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(self.binary), 0x4E4942)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks) + len(self.binary)) + chunks + self.binary

    def sparse(self):
        self.content["accessors"][0].pop("bufferView")
        self.replaces(np.arange(8), V)

    def sparse_over(self):
        """The last vertex is moved by 1 m along x."""
        self.replaces([7], V[7:] + [1, 0, 0])

    def replaces(self, rows, values):
        indices = {"bufferView": self.view(np.array(rows, "<u2").tobytes()), "componentType": 5123}
        values = {"bufferView": self.view(np.asarray(values, "<f4").tobytes())}
        self.content["accessors"][0]["sparse"] = {"count": len(rows), "indices": indices, "values": values}

    def strided(self):
        rows = np.concatenate([V, np.full((8, 2), 9, np.float32)], axis=1)
        self.attributes["POSITION"] = self.add(V)
        self.content["accessors"][-1]["bufferView"] = self.view(rows.tobytes())
        self.content["bufferViews"][-1]["byteStride"] = 20

    def quantized(self, *, normalized):
        values = np.rint(V * 32767) if normalized else np.rint(V * 100)
        self.attributes["POSITION"] = self.add(values.astype(np.int16), normalized=normalized)
        self.node["scale"] = [1.0] * 3 if normalized else [0.01] * 3
        self.uses("KHR_mesh_quantization", needs=True)

    def morphed(self, **node):
        self.primitive["targets"] = [{"POSITION": self.add(V)}]
        self.content["meshes"][0]["weights"] = [0.5]
        self.node.update(node)

    def skinned(self):
        """The joint lies 5 m up; the node's own pose is left out, as the standard says."""
        self.content["nodes"] += [{"translation": [0, 5, 0]}]
        self.content["scenes"][0]["nodes"] += [1]
        self.content["skins"] = [{"joints": [1]}]
        self.node.update(skin=0, translation=[100, 0, 0])
        self.attributes["JOINTS_0"] = self.add(np.zeros((8, 4), np.uint8))
        self.attributes["WEIGHTS_0"] = self.add(np.tile(np.array([255, 0, 0, 0], np.uint8), (8, 1)), normalized=True)

    def instances(self):
        self.node["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {
            "TRANSLATION": self.add(np.array([[0, 0, 0], [3, 0, 0]], np.float32)),
        }}}  # fmt: skip
        self.uses("EXT_mesh_gpu_instancing", needs=True)

    def hidden(self):
        self.content["nodes"] += [{"mesh": 0, "name": "Gone", "translation": [9, 0, 0],
                                "extensions": {"KHR_node_visibility": {"visible": False}}}]  # fmt: skip
        self.content["scenes"][0]["nodes"] += [1]
        self.uses("KHR_node_visibility")

    def levels(self):
        self.content["nodes"] += [{"mesh": 0, "name": "Coarse"}]
        self.node["extensions"] = {"MSFT_lod": {"ids": [1]}}
        self.uses("MSFT_lod")

    def camera(self):
        self.content["nodes"] = [{"camera": 0, "children": [1], "translation": [0, 7, 0]}, {"mesh": 0, "name": "Box"}]
        self.content["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}]

    def other_scene(self):
        self.content["nodes"] += [{"mesh": 0, "name": "Elsewhere", "translation": [9, 0, 0]}]
        self.content["scenes"] += [{"nodes": [1]}]

    def twice(self):
        self.content["nodes"] = [{"name": "a", "mesh": 0}, {"name": "a", "mesh": 0, "translation": [3, 0, 0]}]
        self.content["scenes"][0]["nodes"] = [0, 1]

    def nested(self):
        """Nodes in a chain whose end has its beginning among its children."""
        self.content["nodes"] = [{"children": [i + 1], "name": str(i)} for i in range(1999)]
        self.content["nodes"] += [{"mesh": 0, "children": [0], "name": "Box"}]

    def second_uv(self):
        self.texture().material(**base_colour(texCoord=1))
        self.attributes["TEXCOORD_1"] = self.add(UV)

    def webp(self):
        file = io.BytesIO()
        Image.new("RGB", (4, 4), (9, 99, 199)).save(file, "webp", lossless=True)
        self.texture(file.getvalue(), "image/webp").material(**base_colour())
        self.content["textures"] = [{"extensions": {"EXT_texture_webp": {"source": 0}}}]
        self.uses("EXT_texture_webp", needs=True)

    def basisu(self, *, fallback=False, needs=False):
        self.texture(b"\xabKTX 20\xbb\r\n\x1a\n" + bytes(60), "image/ktx2").material(**base_colour())
        self.content["textures"] = [{"extensions": {"KHR_texture_basisu": {"source": 0}}}]
        if fallback:
            self.content["images"] += [{"bufferView": self.view(png()), "mimeType": "image/png"}]
            self.content["textures"][0]["source"] = 1
        self.uses("KHR_texture_basisu", needs=needs)

    def gloss(self, **more):
        found = {"diffuseFactor": [*BLUE, 1.0], "glossinessFactor": 0.3} | more
        self.material(extensions={"KHR_materials_pbrSpecularGlossiness": found})
        return self.uses("KHR_materials_pbrSpecularGlossiness")

    def coloured(self, values, normalized=False, **material):
        self.attributes["COLOR_0"] = self.add(np.tile(values, (8, 1)), normalized=normalized)
        return self.material(pbrMetallicRoughness=material) if material else self

    def without_indices(self):
        self.attributes["POSITION"] = self.add(V[F.ravel()])
        del self.primitive["indices"]

    def mode(self, number, corners):
        self.primitive["mode"] = number
        self.primitive["indices"] = self.add(np.array(corners, np.uint8))

    def compressed(self, name, *, needs, data):
        self.primitive["extensions"] = {name: {"bufferView": 0, "attributes": {"POSITION": 0}}}
        if not data:
            self.content["accessors"][0].pop("bufferView")
        self.uses(name, needs=needs)

    def meshopt(self, *, data):
        extension = {"EXT_meshopt_compression": {"buffer": 0}}
        self.content["bufferViews"][0]["extensions"] = extension
        if not data:
            fallback = {"EXT_meshopt_compression": {"fallback": True}}
            self.content["buffers"] += [{"byteLength": 96, "extensions": fallback}]
            self.content["bufferViews"][0]["buffer"] = 1
        self.uses(*extension)
