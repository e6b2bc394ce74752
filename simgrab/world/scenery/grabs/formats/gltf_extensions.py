"""Treatment of glTF's extensions: those of Khronos's registry, and others found in files."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from simgrab.io.parse import shown

READ = {
    "KHR_texture_transform", "KHR_mesh_quantization", "KHR_materials_pbrSpecularGlossiness", "EXT_texture_webp",
    "KHR_node_visibility", "EXT_mesh_gpu_instancing", "MSFT_lod",
}  # fmt: skip
"""Read as they are specified; of ``MSFT_lod``, the finest level."""

COMPRESSED = {"KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"}
"""Refused where a mesh has no other data."""

PICTURES = {"KHR_texture_basisu": "KTX2", "EXT_texture_avif": "AVIF", "MSFT_texture_dds": "DDS",
            "EXT_texture_video": "video"}  # fmt: skip
"""Textures in formats that are not read, where the material has no other."""

_UNREAD = re.compile(
    "KHR_lights_punctual|EXT_lights_.*|KHR_environment_map|KHR_animation_pointer"
    "|KHR_materials_(clearcoat|sheen|iridescence|anisotropy|dispersion|ior|specular|unlit|variants)"
    "|ADOBE_materials_.*|NV_materials_mdl|MSFT_packing_.*|EXT_texture_procedurals"
    "|KHR_xmp.*|EXT_(mesh|instance)_features|EXT_structural_metadata|EXT_mesh_manifold|EXT_primitive_voxels|AGI_.*"
    "|CESIUM_primitive_outline|EXT_mesh_primitive_edge_visibility|FB_geometry_metadata|GRIFFEL_bim_data|VRM.*"
    "|GODOT_single_root|KHR_audio.*|MSFT_audio_emitter|KHR_interactivity|KHR_node_(hover|select)ability"
    "|KHR_physics_rigid_bodies|KHR_implicit_shapes|OMI_.*|MOZ_hubs_components"
)
"""Without effect on the shape, and with little on its colours: lights, gloss, metadata, sound, behaviour, physics."""

_GLASS = "it is shown opaque: give such parts their colour as baseColorFactor"
DOUBTS: Mapping[str, str] = {
    "KHR_materials_transmission": _GLASS, "KHR_materials_volume": _GLASS, "KHR_materials_volume_scatter": _GLASS,
    "KHR_materials_subsurface": _GLASS, "KHR_materials_diffuse_transmission": _GLASS,
    "KHR_materials_emissive_strength": "light that it emits is not shown: give its colour as baseColorFactor",
    "CESIUM_RTC": "the place that it states is not added: apply it before the export",
    "KHR_gaussian_splatting": "splats are not shown: export triangles",
    "KHR_techniques_webgl": "shaders are not run: export materials of glTF 2.0",
    "KHR_materials_common": "materials of glTF 1.0 are not read: export those of glTF 2.0",
}  # fmt: skip
"""What is shown otherwise than the file means it, with its cure."""


def required(needed: object) -> list[str]:
    """Return the required extensions without which the shape would be wrong, and unknown ones."""
    shading = ("KHR_materials_", "KHR_lights_", "KHR_xmp")
    names = _listed(needed)
    return [name for name in names if name not in READ and not _UNREAD.fullmatch(name) and not name.startswith(shading)]


def used(content: Mapping[str, Any]) -> list[str]:
    """Give all extensions that a file uses, whether it lists them or not."""
    return list(dict.fromkeys([*_listed(content.get("extensionsUsed", [])), *_within(content)]))


def _listed(names: object) -> list[str]:
    return [str(name) for name in (names if isinstance(names, list) else [names])]


def _within(content: Any) -> Iterator[str]:
    waiting = [content]
    while waiting:
        value = waiting.pop()
        if isinstance(value, dict):
            found = value.get("extensions")
            yield from found if isinstance(found, dict) else ()
            waiting += [inner for key, inner in value.items() if key != "extras"]
        elif isinstance(value, list):
            waiting += value


def remarks(names: Iterable[str]) -> tuple[list[str], list[str]]:
    """Give doubts, and what is left out, for the extensions that a file uses."""
    doubts, unread = [], []
    for name in names:
        if name in DOUBTS:
            doubts.append(f"It uses {name}: {DOUBTS[name]}.")
        elif _UNREAD.fullmatch(name):
            unread.append(name)
        elif name not in READ | COMPRESSED | set(PICTURES):
            doubts.append(f"It uses the extension {shown(name)}, which is unknown here: what it changes is not shown. "
                          "Export without it.")  # fmt: skip
    return doubts, unread
