"""Procedural materials of Blender's nodes: painted and rusty steel, concrete, bulk, water. Run by bpy's interpreter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

Rgb = Sequence[float]
#: Groups of geoms, as `simgrab.world.scenery.model` has them, which bpy's interpreter cannot import.
PLACE, ROPE, GRAB = 0, 2, 3
RUST: tuple[Rgb, ...] = ((0.09, 0.035, 0.016), (0.045, 0.02, 0.013), (0.14, 0.06, 0.025))
#: By words in a geom's name.
WATER = ("water", "sea")
LOOSE = ("coal", "ore", "grain", "bauxite", "sulphur", "cargo", "pile", "heap", "bulk")
MINERAL = ("yard", "concrete", "apron", "asphalt", "quay", "ground", "wall")


class Surfaces:
    """Makes materials.

    Parameters
    ----------
    bpy : module
    rng : numpy.random.Generator
    """

    def __init__(self, bpy: Any, rng: np.random.Generator) -> None:
        self._bpy, self._rng = bpy, rng
        self._wear, self._scale = float(rng.uniform(0.15, 0.8)), float(rng.uniform(0.8, 2.5))

    def of(self, name: str, group: int, colour: Rgb) -> Any:
        """Make the material of a geom by its name, group and mean linear colour."""
        word = name.lower()
        if group == ROPE:
            return self.wire()
        if any(w in word for w in WATER):
            return self.water(colour)
        if (group == PLACE and any(w in word for w in LOOSE)) or (group == GRAB and "cargo" in word):
            return self.loose(colour)
        if group == PLACE and any(w in word for w in MINERAL):
            return self.mineral(colour)
        return self.steel(colour)

    def steel(self, colour: Rgb) -> Any:
        """Painted steel, here and there rusty, with bare metal where it is scratched."""
        made, tree, shader, at = self._begin("steel")
        patches = self._noise(tree, at, self._scale * float(self._rng.uniform(0.4, 1.5)), 12.0, 0.72)
        edge = 0.70 - 0.17 * self._wear
        share = self._ramp(tree, patches, (edge, (0, 0, 0)), (edge + 0.10, (1, 1, 1)))
        fine = self._noise(tree, at, 14.0, 6.0, 0.7)
        dark, light = (tuple(min(max(c * f, 0.0), 1.0) for c in colour) for f in (0.72, 1.18))
        paint = self._ramp(tree, fine, (0.3, dark), (0.7, light))
        rust = self._ramp(tree, self._noise(tree, at, 22.0, 8.0, 0.8), (0.3, RUST[1]), (0.55, RUST[0]), (0.75, RUST[2]))
        self._into(tree, self._mix(tree, share, paint, rust), shader, "Base Color")
        scratches = self._ramp(tree, self._noise(tree, at, 5.0, 2.0, 0.5, 3.0), (0.68, (0, 0, 0)), (0.70, (1, 1, 1)))
        self._into(tree, scratches, shader, "Metallic")
        self._into(tree, self._ramp(tree, share, (0.0, (0.38,) * 3), (1.0, (0.88,) * 3)), shader, "Roughness")
        self._bump(tree, shader, self._mix(tree, share, fine, patches), 0.25, 0.02)
        return made

    def metal(self, colour: Rgb) -> Any:
        """Bare metal: galvanised or aluminium."""
        made, tree, shader, at = self._begin("metal")
        spangle = self._voronoi(tree, at, 9.0, "F1")
        dark, light = (tuple(min(c * f, 1.0) for c in colour) for f in (0.8, 1.1))
        self._into(tree, self._ramp(tree, spangle, (0.1, light), (0.7, dark)), shader, "Base Color")
        shader.inputs["Metallic"].default_value, shader.inputs["Roughness"].default_value = 1.0, 0.42
        return made

    def wire(self) -> Any:
        """Greased wire rope with a lay."""
        made, tree, shader, at = self._begin("wire")
        wave = tree.nodes.new("ShaderNodeTexWave")
        wave.bands_direction, wave.inputs["Scale"].default_value = "DIAGONAL", 12.0
        tree.links.new(at, wave.inputs["Vector"])
        self._into(tree, self._ramp(tree, wave.outputs["Fac"], (0.2, (0.01,) * 3), (0.8, (0.09, 0.085, 0.075))), shader,
                   "Base Color")  # fmt: skip
        shader.inputs["Metallic"].default_value, shader.inputs["Roughness"].default_value = 0.8, 0.4
        return made

    def mineral(self, colour: Rgb) -> Any:
        """Concrete or asphalt with stains and cracks."""
        made, tree, shader, at = self._begin("mineral")
        stains = self._noise(tree, at, float(self._rng.uniform(0.08, 0.25)), 9.0, 0.7)
        grain = self._noise(tree, at, 30.0, 4.0, 0.8)
        dark, light = (tuple(min(c * f, 1.0) for c in colour) for f in (0.5, 1.25))
        base = self._ramp(tree, stains, (0.3, dark), (0.52, colour), (0.75, light))
        speck = self._ramp(tree, grain, (0.3, (0.75,) * 3), (0.7, (1.0,) * 3))
        depth = float(self._rng.uniform(0.45, 1.0))
        cells = self._voronoi(tree, self._bent(tree, at), float(self._rng.uniform(0.1, 0.3)), "DISTANCE_TO_EDGE")
        cracks = self._ramp(tree, cells, (0.0, (depth,) * 3), (0.008, (1.0,) * 3))
        self._into(tree, self._product(tree, self._product(tree, base, speck), cracks), shader, "Base Color")
        self._into(tree, self._ramp(tree, stains, (0.35, (0.35,) * 3), (0.5, (0.9,) * 3)), shader, "Roughness")
        self._bump(tree, shader, grain, 0.3, 0.02)
        return made

    def loose(self, colour: Rgb) -> Any:
        """Bulk in lumps."""
        made, tree, shader, at = self._begin("loose")
        lumps = self._voronoi(tree, at, float(self._rng.uniform(4.0, 14.0)), "F1")
        large = self._noise(tree, at, 0.5, 6.0, 0.6)
        dark, light = (tuple(min(c * f, 1.0) for c in colour) for f in (0.55, 1.3))
        tint = self._ramp(tree, large, (0.3, dark), (0.7, light))
        shade = self._ramp(tree, lumps, (0.0, (1.1,) * 3), (0.8, (0.6,) * 3))
        self._into(tree, self._product(tree, tint, shade), shader, "Base Color")
        shader.inputs["Roughness"].default_value = 0.85
        self._bump(tree, shader, lumps, 0.9, 0.12, inverted=True)
        return made

    def water(self, colour: Rgb) -> Any:
        """Water with small waves."""
        made, tree, shader, at = self._begin("water")
        shader.inputs["Base Color"].default_value = (*(0.6 * c for c in colour), 1.0)
        shader.inputs["Roughness"].default_value, shader.inputs["IOR"].default_value = 0.08, 1.33
        waves = self._noise(tree, at, float(self._rng.uniform(0.5, 1.5)), 6.0, 0.55, 1.5)
        self._bump(tree, shader, waves, 0.8, 0.25)
        return made

    def photograph(self, image: Any, tint: Rgb, tile_m: float, *, wet: bool = False) -> Any:
        """Show a photograph, projected from three sides, with large stains that break its repetition."""
        made, tree, shader, at = self._begin("photograph")
        scaled = tree.nodes.new("ShaderNodeVectorMath")
        scaled.operation, scaled.inputs[1].default_value = "SCALE", (1, 1, 1)
        scaled.inputs["Scale"].default_value = 1 / tile_m
        tree.links.new(at, scaled.inputs[0])
        picture = tree.nodes.new("ShaderNodeTexImage")
        picture.image, picture.projection, picture.projection_blend = image, "BOX", 0.2
        tree.links.new(scaled.outputs["Vector"], picture.inputs["Vector"])
        stains = self._noise(tree, at, float(self._rng.uniform(0.05, 0.2)), 8.0, 0.65)
        shade = self._ramp(tree, stains, (0.3, tuple(0.55 * c for c in tint)), (0.7, tuple(1.2 * c for c in tint)))
        self._into(tree, self._product(tree, picture.outputs["Color"], shade), shader, "Base Color")
        low = 0.08 if wet else 0.7
        self._into(tree, self._ramp(tree, stains, (0.42, (low,) * 3), (0.5, (0.9,) * 3)), shader, "Roughness")
        self._bump(tree, shader, picture.outputs["Color"], 0.4, 0.03)
        return made

    def _begin(self, name: str) -> tuple[Any, Any, Any, Any]:
        material = self._bpy.data.materials.new(name)
        material.use_nodes = True
        tree = material.node_tree
        shader = tree.nodes["Principled BSDF"]
        return material, tree, shader, tree.nodes.new("ShaderNodeTexCoord").outputs["Object"]

    def _noise(self, tree: Any, at: Any, scale: float, detail: float, roughness: float, distortion: float = 0.0) -> Any:
        node = tree.nodes.new("ShaderNodeTexNoise")
        node.noise_dimensions = "4D"
        inputs = node.inputs
        inputs["W"].default_value, inputs["Scale"].default_value = float(self._rng.uniform(0, 100)), scale
        inputs["Detail"].default_value, inputs["Roughness"].default_value = detail, roughness
        inputs["Distortion"].default_value = distortion
        tree.links.new(at, inputs["Vector"])
        return node.outputs[0]

    def _bent(self, tree: Any, at: Any) -> Any:
        """Move coordinates about at random, so that lines between cells are not straight."""
        noise, added = tree.nodes.new("ShaderNodeTexNoise"), tree.nodes.new("ShaderNodeVectorMath")
        noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 0.4, 8.0
        added.operation, added.inputs[2].default_value = "MULTIPLY_ADD", (0, 0, 0)
        added.inputs[1].default_value = (2.0, 2.0, 2.0)
        tree.links.new(at, noise.inputs["Vector"])
        tree.links.new(noise.outputs["Color"], added.inputs[0])
        tree.links.new(at, added.inputs[2])
        return added.outputs["Vector"]

    def _voronoi(self, tree: Any, at: Any, scale: float, feature: str) -> Any:
        node = tree.nodes.new("ShaderNodeTexVoronoi")
        node.feature, node.inputs["Scale"].default_value = feature, scale
        tree.links.new(at, node.inputs["Vector"])
        return node.outputs["Distance"]

    def _ramp(self, tree: Any, factor: Any, *stops: tuple[float, Any]) -> Any:
        node = tree.nodes.new("ShaderNodeValToRGB")
        elements = node.color_ramp.elements
        while len(elements) < len(stops):
            elements.new(0.5)
        for element, (position, colour) in zip(elements, stops, strict=True):
            element.position, element.color = position, (*colour, 1.0)
        tree.links.new(factor, node.inputs["Fac"])
        return node.outputs["Color"]

    def _mix(self, tree: Any, share: Any, a: Any, b: Any) -> Any:
        return self._blend(tree, "MIX", share, a, b)

    def _product(self, tree: Any, a: Any, b: Any) -> Any:
        return self._blend(tree, "MULTIPLY", None, a, b)

    def _blend(self, tree: Any, kind: str, share: Any, a: Any, b: Any) -> Any:
        node = tree.nodes.new("ShaderNodeMixRGB")
        node.blend_type, node.inputs["Fac"].default_value = kind, 1.0
        if share is not None:
            tree.links.new(share, node.inputs["Fac"])
        tree.links.new(a, node.inputs["Color1"])
        tree.links.new(b, node.inputs["Color2"])
        return node.outputs["Color"]

    def _into(self, tree: Any, value: Any, shader: Any, name: str) -> None:
        tree.links.new(value, shader.inputs[name])

    def _bump(
        self, tree: Any, shader: Any, height: Any, strength: float, metres: float, *, inverted: bool = False
    ) -> None:
        node = tree.nodes.new("ShaderNodeBump")
        node.invert = inverted
        node.inputs["Strength"].default_value, node.inputs["Distance"].default_value = strength, metres
        tree.links.new(height, node.inputs["Height"])
        tree.links.new(node.outputs["Normal"], shader.inputs["Normal"])
