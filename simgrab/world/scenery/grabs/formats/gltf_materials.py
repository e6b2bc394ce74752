"""Materials of glTF: factors and colours of vertices are linear, textures are sRGB."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from PIL import Image

from simgrab.io.parse import shown
from simgrab.model.geometry import Array
from simgrab.model.srgb import encoded
from simgrab.world.scenery.grabs.formats import gltf_extensions as extensions
from simgrab.world.scenery.grabs.formats.contents import FileMaterial

_REPEAT = 10497
_OTHER_TEXTURES = ("normalTexture", "occlusionTexture", "metallicRoughnessTexture", "specularGlossinessTexture")


@dataclass(frozen=True, eq=False)
class GltfMaterial:
    """A material, and its use of texture coordinates."""

    surface: FileMaterial
    factor: Array  # (3,), linear
    uv_set: int  # number of `TEXCOORD_n`
    transform: Array  # (2, 3), transform of texture coordinates whose v points down
    blends: bool  # whether alpha is used

    def placed(self, uv: Array) -> Array:
        """Convert texture coordinates of the file, shape (n, 2), to simgrab's, whose v points up."""
        moved = uv @ self.transform[:, :2].T + self.transform[:, 2]
        return np.stack([moved[:, 0], 1.0 - moved[:, 1]], axis=1)


@dataclass
class Materials:
    """The materials of a file, each made when it is first used."""

    content: Mapping[str, Any]  # the file's JSON
    picture: Callable[[int], bytes | None]  # returns an image's file by its number; None if it is missing
    # doubts, unread: sentences on what is not shown, and names of what is left out, as keys in order
    doubts: dict[str, None] = field(default_factory=dict)
    unread: dict[str, None] = field(default_factory=dict)
    _made: dict[int, GltfMaterial] = field(default_factory=dict)

    def __getitem__(self, number: int) -> GltfMaterial:
        if number not in self._made:
            self._made[number] = self._make(number, self.content["materials"][number])
        return self._made[number]

    def _make(self, number: int, material: Mapping[str, Any]) -> GltfMaterial:
        name = f"Material {shown(str(material.get('name', number)))}"
        gloss = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness")
        pbr = material.get("pbrMetallicRoughness", {})
        for texture in _OTHER_TEXTURES:
            if texture in material or texture in pbr or texture in (gloss or {}):
                self.unread[texture] = None
        if gloss is None:
            factor, texture = pbr.get("baseColorFactor", [1.0] * 4), pbr.get("baseColorTexture")
            metal, rough = (_share(pbr.get(key, 1.0)) for key in ("metallicFactor", "roughnessFactor"))
        else:
            factor, texture = gloss.get("diffuseFactor", [1.0] * 4), gloss.get("diffuseTexture")
            metal = _share(max(gloss.get("specularFactor", [1.0])))
            rough = 1.0 - _share(gloss.get("glossinessFactor", 1.0))
        emitted = material.get("emissiveFactor", [0.0])
        if max(emitted) > 0:
            self.doubts[f"{name} emits light (emissiveFactor), which is not shown: give its colour as "
                        "baseColorFactor."] = None  # fmt: skip
        data = None if texture is None else self._texture(texture, name)
        blends = material.get("alphaMode", "OPAQUE") != "OPAQUE"
        if blends and ((len(factor) > 3 and factor[3] < 1.0) or (data is not None and _has_alpha(data))):
            self.doubts[f"{name} is partly transparent (alphaMode {material['alphaMode']}); it is shown opaque."] = None
        linear = np.clip(np.array(factor[:3], float), 0.0, 1.0)
        red, green, blue = (float(level) for level in encoded(linear))
        surface = FileMaterial((red, green, blue), data, 0.1 + 0.3 * metal, 1.0 - max(rough, 0.05))
        return GltfMaterial(surface, linear, *_placement(texture or {}), blends)

    def _texture(self, texture: Mapping[str, Any], name: str) -> bytes | None:
        """Give the picture of a texture; None, with a doubt, where it is in a format that is not read."""
        entry = self.content["textures"][texture["index"]]
        found = entry.get("extensions", {})
        source = found.get("EXT_texture_webp", {}).get("source", entry.get("source"))
        data = None if source is None else self.picture(source)
        kinds = [extensions.PICTURES[key] for key in found if key in extensions.PICTURES]
        kinds += ["KTX2"] if data is not None and data[1:4] == b"KTX" else []
        if kinds and (data is None or data[1:4] == b"KTX"):
            self.doubts[f"{name}: its texture is {kinds[0]}, which is not read: export it as PNG or JPEG."] = None
            return None
        sampler = self.content.get("samplers", [])[entry["sampler"]] if "sampler" in entry else {}
        if {sampler.get("wrapS", _REPEAT), sampler.get("wrapT", _REPEAT)} != {_REPEAT}:
            self.unread["wrapping of textures that is clamped or mirrored (they repeat)"] = None
        return data


def _share(value: float) -> float:
    return min(max(float(value), 0.0), 1.0)


def _has_alpha(picture: bytes) -> bool:
    try:
        with Image.open(io.BytesIO(picture), formats=("PNG", "WEBP")) as image:
            return "A" in image.getbands() or "transparency" in image.info
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return False


def _placement(texture: Mapping[str, Any]) -> tuple[int, Array]:
    """Return the set of texture coordinates, and their transform (KHR_texture_transform)."""
    moved = texture.get("extensions", {}).get("KHR_texture_transform", {})
    angle = float(moved.get("rotation", 0.0))
    cosine, sine = math.cos(angle), math.sin(angle)
    turn = np.array([[cosine, sine], [-sine, cosine]]) * np.array(moved.get("scale", (1.0, 1.0)), float)
    offset = np.array(moved.get("offset", (0.0, 0.0)), float)
    return int(moved.get("texCoord", texture.get("texCoord", 0))), np.column_stack([turn, offset])
