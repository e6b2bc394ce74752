"""What becomes of the extensions of glTF: those of Khronos's registry, and those that are found in files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
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

UNREAD: Mapping[str, str] = {
    "KHR_lights_punctual": "lights", "EXT_lights_ies": "lights", "EXT_lights_image_based": "lights",
    "EXT_lights_area": "lights", "KHR_environment_map": "lights", "KHR_animation_pointer": "animations",
    "KHR_materials_clearcoat": "gloss (clearcoat)", "KHR_materials_sheen": "gloss (sheen)",
    "KHR_materials_iridescence": "gloss (iridescence)", "KHR_materials_anisotropy": "gloss (anisotropy)",
    "KHR_materials_dispersion": "gloss (dispersion)", "KHR_materials_ior": "gloss (ior)",
    "KHR_materials_specular": "gloss (specular)", "KHR_materials_unlit": "unlit (it is lit as all else)",
    "KHR_materials_variants": "variants of materials (the default is shown)",
    "KHR_xmp": "metadata", "KHR_xmp_json_ld": "metadata", "EXT_mesh_features": "metadata",
    "EXT_instance_features": "metadata", "EXT_structural_metadata": "metadata", "EXT_mesh_manifold": "metadata",
    "EXT_primitive_voxels": "metadata", "AGI_articulations": "articulations", "AGI_stk_metadata": "metadata",
    "CESIUM_primitive_outline": "outlines", "EXT_mesh_primitive_edge_visibility": "outlines",
    "FB_geometry_metadata": "metadata", "NV_materials_mdl": "gloss (MDL)",
    "ADOBE_materials_clearcoat_specular": "gloss (clearcoat)", "ADOBE_materials_clearcoat_tint": "gloss (clearcoat)",
    "ADOBE_materials_thin_transparency": "transparency", "GRIFFEL_bim_data": "metadata", "KHR_audio": "sound",
    "KHR_audio_emitter": "sound", "MSFT_audio_emitter": "sound", "MSFT_packing_normalRoughnessMetallic": "gloss",
    "MSFT_packing_occlusionRoughnessMetallic": "gloss", "KHR_interactivity": "behaviour",
    "KHR_node_hoverability": "behaviour", "KHR_node_selectability": "behaviour", "KHR_physics_rigid_bodies": "physics",
    "KHR_implicit_shapes": "physics", "OMI_collider": "physics", "OMI_physics_body": "physics",
    "OMI_physics_shape": "physics", "VRMC_vrm": "metadata", "VRM": "metadata", "MOZ_hubs_components": "behaviour",
    "EXT_texture_procedurals": "procedural textures", "GODOT_single_root": "metadata",
}  # fmt: skip
"""Without effect on the shape, and with little on its colours."""

DOUBTS: Mapping[str, str] = {
    "KHR_materials_transmission": "glass is shown opaque: give such parts their colour as baseColorFactor",
    "KHR_materials_volume": "glass is shown opaque: give such parts their colour as baseColorFactor",
    "KHR_materials_volume_scatter": "it is shown opaque: give such parts their colour as baseColorFactor",
    "KHR_materials_subsurface": "it is shown opaque: give such parts their colour as baseColorFactor",
    "KHR_materials_diffuse_transmission": "it is shown opaque: give such parts their colour as baseColorFactor",
    "KHR_materials_emissive_strength": "light that it emits is not shown: give its colour as baseColorFactor",
    "CESIUM_RTC": "the place that it states is not added: apply it before the export",
    "KHR_gaussian_splatting": "splats are not shown: export triangles",
    "KHR_techniques_webgl": "shaders are not run: export materials of glTF 2.0",
    "KHR_materials_common": "materials of glTF 1.0 are not read: export those of glTF 2.0",
}
"""What is shown otherwise than the file means it, with its cure."""


def required(needed: object) -> list[str]:
    """Give those of a list of required extensions without which the shape would be wrong, or all that is unknown."""
    names = [str(name) for name in needed] if isinstance(needed, list) else [str(needed)]
    looks = ("KHR_materials_", "KHR_lights_", "KHR_xmp")
    return [name for name in names if name not in READ and name not in UNREAD and not name.startswith(looks)]


def used(content: Mapping[str, Any]) -> list[str]:
    """Give all extensions that a file uses, whether it lists them or not."""
    stated = content.get("extensionsUsed", [])
    names = dict.fromkeys(map(str, stated if isinstance(stated, list) else [stated]))
    waiting: list[Any] = [content]
    while waiting:
        value = waiting.pop()
        if isinstance(value, dict):
            found = value.get("extensions")
            names |= dict.fromkeys(found if isinstance(found, dict) else ())
            waiting += [inner for key, inner in value.items() if key != "extras"]
        elif isinstance(value, list):
            waiting += value
    return list(names)


def remarks(names: Iterable[str]) -> tuple[list[str], list[str]]:
    """Give doubts, and what is left out, for the extensions that a file uses."""
    doubts, unread = [], []
    for name in names:
        if name in DOUBTS:
            doubts.append(f"It uses {name}: {DOUBTS[name]}.")
        elif name in UNREAD:
            unread.append(f"{name}: {UNREAD[name]}")
        elif name not in READ | COMPRESSED | set(PICTURES):
            doubts.append(f"It uses the extension {shown(name)}, which is unknown here: what it changes is not shown. "
                          "Export without it.")  # fmt: skip
    return doubts, unread
