"""Grabs made by code of its own: nothing of simgrab's meshes. Metres, z up, closed; A is at half the height."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
import trimesh
from numpy.random import Generator
from trimesh import Trimesh
from trimesh.creation import box, cylinder, extrude_polygon, icosphere
from trimesh.visual.material import PBRMaterial

from simgrab.model.geometry import Array
from simgrab.model.scenario.grab import Jaw

Point = Sequence[float]
Paints = dict[str, PBRMaterial]
PLATE_M = 0.025
PAINTS_HSV = ((0.03, 0.85), (0.10, 0.9), (0.16, 0.75), (0.33, 0.5), (0.55, 0.6), (0.62, 0.75), (0.0, 0.0), (0.95, 0.7))


class Pieces(list[tuple[Trimesh, str]]):
    """Parts that move together, each with the name of its paint."""

    def block(self, paint: str, a: Point, b: Point) -> None:
        """Add a box between two corners."""
        self.append((box(bounds=np.array([np.minimum(a, b), np.maximum(a, b)])), paint))

    def bar(self, paint: str, start: Point, end: Point, radius: float, sections: int = 14) -> None:
        """Add a round bar."""
        self.append((cylinder(radius=radius, segment=np.array([start, end]), sections=sections), paint))

    def wheel(self, paint: str, centre: Point, radius: float, width: float, axis: int) -> None:
        """Add a wheel about an axis, 0 to 2."""
        half = np.zeros(3)
        half[axis] = width / 2
        self.bar(paint, tuple(np.subtract(centre, half)), tuple(np.add(centre, half)), radius, 24)

    def beam(self, paint: str, start: Point, end: Point, width: float, height: float) -> None:
        """Add a rectangular tube's outside from point to point; its width stays level."""
        a, b = np.asarray(start, float), np.asarray(end, float)
        along = b - a
        length = float(np.linalg.norm(along))
        along /= length
        side = np.cross((0.0, 0.0, 1.0), along)
        side = np.array((0.0, 1.0, 0.0)) if np.linalg.norm(side) < 1e-6 else side / np.linalg.norm(side)
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([along, side, np.cross(along, side)])
        pose[:3, 3] = (a + b) / 2
        self.append((box((length, width, height), transform=pose), paint))

    def plate(self, paint: str, outline: Any, y: float, thickness: float = PLATE_M, side: int = 1) -> None:
        """Add an upright plate: its outline in (x, z), mirrored at x = 0 for side −1, its middle at y."""
        shape = outline if hasattr(outline, "exterior") else shapely.Polygon(outline)
        self.append((_upright(shapely.affinity.scale(shape, side, 1, origin=(0, 0)), y, thickness), paint))


Grab = tuple[dict[str, Pieces], dict[str, Any]]
"""Pieces by node, and the other keys of ``[grab] model = "mesh"``."""


def write(path: Path, kind: str, rng: Generator) -> dict[str, Any]:
    """Write a grab as GLB: a "frame" of plates with two shells, "tines", or two shells on "levers" that cross.

    Returns
    -------
    dict
        The other keys of ``[grab] model = "mesh"``.
    """
    made = {"frame": _framed, "tines": _tined, "levers": _levered}[kind](rng)
    scene, paints = trimesh.Scene(), _paints(rng)
    nodes, keys = made
    for node, pieces in nodes.items():
        scene.graph.update(frame_to=node, frame_from=scene.graph.base_frame, matrix=np.eye(4))
        for paint in dict.fromkeys(name for _, name in pieces):
            some = (piece for piece, name in pieces if name == paint)
            mesh = trimesh.util.concatenate([Trimesh(one.vertices, one.faces, process=False) for one in some])
            mesh.visual = trimesh.visual.TextureVisuals(material=paints[paint])
            scene.add_geometry(mesh, node_name=f"{node}-{paint}", geom_name=f"{node}-{paint}", parent_node_name=node)
    path.write_bytes(trimesh.exchange.gltf.export_glb(scene, include_normals=False))
    return keys | {"up": "z"}


def _paints(rng: Generator) -> Paints:
    hue, saturation = PAINTS_HSV[int(rng.integers(len(PAINTS_HSV)))]
    value = float(rng.uniform(0.25, 0.85))
    other, grey = float(rng.uniform(0, 1)), float(rng.uniform(0.03, 0.25))
    kinds = {
        "paint": (*colorsys.hsv_to_rgb(hue, saturation, value), 0.0, 0.5),
        "second": (*colorsys.hsv_to_rgb(other, 0.6 * rng.random(), rng.uniform(0.15, 0.7)), 0.0, 0.6),
        "steel": (grey + 0.1, grey + 0.09, grey + 0.08, 1.0, 0.45),
        "worn": (0.16, 0.10, 0.07, 0.3, 0.8),
        "black": (0.02, 0.02, 0.022, 0.0, 0.7),
        "stripe": (0.75, 0.6, 0.05, 0.0, 0.5),
    }
    return {
        name: PBRMaterial(name=name, baseColorFactor=[r, g, b, 1.0], metallicFactor=metal, roughnessFactor=rough)
        for name, (r, g, b, metal, rough) in kinds.items()
    }


def _upright(shape: Any, y: float, thickness: float) -> Trimesh:
    turn = np.array([(1, 0, 0, 0), (0, 0, -1, y + thickness / 2), (0, 1, 0, 0), (0, 0, 0, 1)], float)
    return extrude_polygon(shape, thickness).apply_transform(turn)


def _shell(side: int, hinge: tuple[float, float], reach: float, bottom: float, length: float, rng: Generator) -> Pieces:
    """Make a half shell of bent plate with side plates, ribs and a lip.

    Parameters
    ----------
    side : int
        −1 or 1: which side of x = 0.
    hinge : tuple of 2 floats
        Its x and z.
    reach, bottom, length : float
        How far its back is from x = 0, z of its lip, and its extent along y.
    """
    x0, top = hinge[0], hinge[1]
    deep = top - bottom
    corners = [(0.012, bottom), (0.45 * reach, bottom + 0.02), (0.86 * reach, bottom + 0.28 * deep)]
    corners += [(reach, bottom + 0.72 * deep), (0.93 * reach, top + 0.10)]
    curve = _rounded(np.array(corners), int(rng.integers(1, 3)))
    back = shapely.LineString(curve).buffer(PLATE_M / 2, cap_style="flat", join_style="mitre")
    end = shapely.Polygon([*curve, (x0 + 0.16, top + 0.16), (x0 - 0.05, top), (0.012, 0.6 * bottom + 0.4 * top)])
    pieces = Pieces()
    pieces.plate("paint", back, 0.0, length, side)
    for y in (-length / 2, length / 2):
        pieces.plate("paint", end.buffer(0), y, side=side)
        pieces.wheel("steel", (side * x0, y, top), 0.13, 0.09, 1)
    ribs, depth = int(rng.integers(2, 6)), float(rng.uniform(0.05, 0.11))
    outer = shapely.LineString(curve[1:]).buffer(depth, cap_style="flat", single_sided=False)
    rib = outer.difference(end.buffer(0.01))
    parts = [rib] if rib.geom_type == "Polygon" else list(rib.geoms)
    for y in np.linspace(-0.4 * length, 0.4 * length, ribs):
        for part in parts:
            if part.area > 1e-3:
                pieces.plate("second", part, float(y), 0.03, side)
    lip = [(0.012, bottom - 0.03), (0.012, bottom + 0.10), (0.42 * reach, bottom + 0.07), (0.42 * reach, bottom - 0.01)]
    pieces.plate("worn", lip, 0.0, length * 1.02, side)
    if rng.random() < 0.5:
        for y in np.linspace(-0.45 * length, 0.45 * length, int(rng.integers(3, 8))):
            tooth = (0.012 * side, y - 0.05, bottom - 0.16), (0.13 * side, y + 0.05, bottom + 0.05)
            pieces.block("steel", *tooth)
    pieces.block(
        "second", (side * 0.90 * reach, -length / 2, top + 0.04), (side * 1.02 * reach, length / 2, top + 0.15)
    )
    return pieces


def _rounded(corners: Array, times: int) -> Array:
    """Cut the corners of an open line so many times (Chaikin 1974)."""
    for _ in range(times):
        a, b = corners[:-1], corners[1:]
        cut = np.stack([0.75 * a + 0.25 * b, 0.25 * a + 0.75 * b], axis=1).reshape(-1, 2)
        corners = np.concatenate([corners[:1], cut, corners[-1:]])
    return corners


def _head(z0: float, z1: float, half_x: float, half_y: float, ends: Sequence[Point], rng: Generator) -> Pieces:
    """Make a head: a box of rolled sections with sheaves between, sockets for the ropes, and striped edges."""
    pieces, middle = Pieces(), (z0 + z1) / 2
    for y in (-half_y, half_y):
        pieces.block("paint", (-half_x, y - 0.06, z0), (half_x, y + 0.06, z0 + 0.05))
        pieces.block("paint", (-half_x, y - 0.06, z1 - 0.05), (half_x, y + 0.06, z1))
        pieces.block("paint", (-half_x, y - 0.015, z0), (half_x, y + 0.015, z1))
        for x in np.linspace(-half_x, half_x, 4):
            pieces.block("second", (x - 0.012, y - 0.06, z0), (x + 0.012, y + 0.06, z1))
    for x in (-half_x, half_x):
        pieces.block("paint", (x - 0.05, -half_y, z0), (x + 0.05, half_y, z1 - 0.04))
        pieces.block("stripe", (x - 0.055, -0.3 * half_y, z0 + 0.08), (x + 0.055, 0.3 * half_y, z1 - 0.1))
    for x in np.linspace(-0.45 * half_x, 0.45 * half_x, int(rng.integers(2, 5))):
        pieces.wheel("steel", (float(x), 0.0, middle), 0.48 * (z1 - z0) + 0.1, 0.07, 0)
    pieces.bar("worn", (-half_x, 0.0, middle), (half_x, 0.0, middle), 0.07)
    if rng.random() < 0.6:  # a deck of chequered plate, with a hole for the sheaves on either side
        for y0, y1 in ((-half_y, -0.35 * half_y), (0.35 * half_y, half_y)):
            pieces.block("second", (-half_x, y0, z1 - 0.02), (half_x, y1, z1 + 0.005))
    for x, y, z in ends:
        pieces.bar("steel", (x, y, z1 - 0.05), (x, y, z), 0.055)
        pieces.block("worn", (x - 0.09, y - 0.09, z1 - 0.06), (x + 0.09, y + 0.09, z1 + 0.03))
    return pieces


def _ends(ropes: int, z: float, x: float, y: float) -> tuple[Point, ...]:
    if ropes == 1:
        return ((0.0, 0.0, z),)
    if ropes == 2:
        return (0.0, y, z), (0.0, -y, z)
    return (x, y, z), (-x, y, z), (-x, -y, z), (x, -y, z)


def _keys(ropes: int, ends: tuple[Point, ...], height: float, kg: float, jaws: list[dict[str, Any]]) -> dict[str, Any]:
    made = tuple(Jaw(**jaw) for jaw in jaws)
    return {"ropes": ropes, "rope_ends_m": ends, "centre_m": (0.0, 0.0, height / 2), "mass_kg": kg, "jaws": made}


def _jaw(node: str, hinge: Any, open_deg: float, lips: tuple[Point, ...] = ()) -> dict[str, Any]:
    made = {"node": node, "hinge_m": tuple(map(float, hinge)), "axis": (0.0, 1.0, 0.0), "open_deg": open_deg}
    return made | ({"lips_m": lips} if lips else {})


def _framed(rng: Generator) -> Grab:
    """Make a clamshell whose shells turn on pins of a stiff frame of plates, worked by hydraulic rams."""
    height, reach = float(rng.uniform(2.7, 3.5)), float(rng.uniform(1.15, 1.55))
    length, pin = float(rng.uniform(1.6, 2.5)), 0.16
    hinge_z, head_z = float(rng.uniform(0.40, 0.48)) * height, height - float(rng.uniform(0.45, 0.65))
    half_x, half_y = float(rng.uniform(0.5, 0.8)), float(rng.uniform(0.55, 0.8))
    ends = _ends(4, height, 0.35, 0.45)
    head = _head(head_z, height - 0.06, half_x, half_y, ends, rng)
    half = [(0.30, hinge_z - 0.18), (0.34, hinge_z + 0.15), (0.8 * half_x, head_z + 0.05)]
    (a, b, c), (d, e, f) = half, [(-x, z) for x, z in half]
    hole = shapely.Point(0, (hinge_z + head_z) / 2).buffer(0.16)
    for y in (-0.42 * length, 0.42 * length):
        head.plate("paint", shapely.Polygon([d, a, b, c, f, e]).difference(hole), y, 0.04)
    head.beam("second", (0, -0.42 * length, hinge_z + 0.02), (0, 0.42 * length, hinge_z + 0.02), 0.22, 0.22)
    head.beam("second", (0, -half_y, head_z + 0.1), (0, half_y, head_z + 0.1), 0.3, 0.12)
    nodes, jaws, lips = {"head": head}, list[dict[str, Any]](), ((0.0, -length / 2, 0.03), (0.0, length / 2, 0.03))
    opening = float(rng.uniform(42, 58))
    for name, side in (("left", -1), ("right", 1)):
        nodes[name] = _shell(side, (pin, hinge_z), reach, 0.03, length, rng)
        jaws.append(_jaw(name, (side * pin, 0.0, hinge_z), -side * opening, lips))
    for side, y in ((-1, -0.3), (-1, 0.3), (1, -0.3), (1, 0.3)):
        hinge = np.array((side * pin, y * length, hinge_z))
        top = np.array((side * 0.7 * half_x, y * length, head_z + 0.02))
        foot = np.array((side * 0.93 * reach, y * length, hinge_z + 0.08))
        cos, sin = np.cos(np.radians(-side * opening)), np.sin(np.radians(-side * opening))
        arm = foot - hinge
        moved = hinge + (cos * arm[0] + sin * arm[2], 0.0, -sin * arm[0] + cos * arm[2])
        before, after = foot - top, moved - top
        name, half_way = f"ram{len(nodes)}", tuple(map(float, top + 0.55 * before))
        nodes[name] = ram = Pieces()
        ram.bar("black", tuple(map(float, top)), half_way, 0.085)
        ram.bar("steel", half_way, tuple(map(float, foot)), 0.05)
        angle = float(np.degrees(np.arctan2(after[0], after[2]) - np.arctan2(before[0], before[2])))
        jaws.append(_jaw(name, top, (angle + 180) % 360 - 180 or 0.1))
    return nodes, _keys(4, ends, height, float(rng.uniform(7000, 11000)), jaws)


def _levered(rng: Generator) -> Grab:
    """Make a grab whose shells hang on pairs of plate levers that cross at a pin."""
    height, reach = float(rng.uniform(2.8, 3.6)), float(rng.uniform(1.25, 1.7))
    length, pin_z = float(rng.uniform(1.5, 2.2)), float(rng.uniform(0.46, 0.54)) * height
    head_z = height - 0.5
    ends = _ends(4, height, 0.30, 0.40)
    head = _head(head_z, height - 0.05, 0.55, 0.55, ends, rng)
    for x, y in ((-0.4, -0.45), (0.4, -0.45), (-0.4, 0.45), (0.4, 0.45)):
        head.bar("steel", (x, y, head_z + 0.05), (0.25 * x, y, pin_z), 0.045)
    head.bar("worn", (0.0, -0.6 * length, pin_z), (0.0, 0.6 * length, pin_z), 0.11)
    nodes, jaws, lips = {"head": head}, list[dict[str, Any]](), ((0.0, -length / 2, 0.03), (0.0, length / 2, 0.03))
    opening, up = float(rng.uniform(35, 50)), head_z - 0.12
    for name, side in (("left", -1), ("right", 1)):
        nodes[name] = pieces = _shell(side, (0.2, 0.62 * pin_z), reach, 0.03, length, rng)
        lever = [(0.85 * reach, 0.55 * pin_z), (1.0 * reach, 0.72 * pin_z), (0.12, pin_z + 0.16)]
        lever += [(-0.80 * reach, up + 0.1), (-0.92 * reach, up - 0.12), (-0.10, pin_z - 0.16)]
        for y in (-0.36, 0.36):
            pieces.plate("second", lever, (y + 0.035 * side) * length, 0.05, side)
        along = (-side * 0.86 * reach, -0.4 * length, up), (-side * 0.86 * reach, 0.4 * length, up)
        pieces.beam("paint", *along, 0.2, 0.2)
        jaws.append(_jaw(name, (0.0, 0.0, pin_z), -side * opening, lips))
    return nodes, _keys(4, ends, height, float(rng.uniform(7000, 12000)), jaws)


def _tined(rng: Generator) -> Grab:
    """Make an orange-peel grab of bent tines round a hub, worked by hydraulic rams."""
    height, reach = float(rng.uniform(2.3, 3.1)), float(rng.uniform(1.1, 1.5))
    tines, ropes = int(rng.integers(4, 7)), int(rng.choice([1, 2, 4]))
    hub_z, hub_r = float(rng.uniform(0.55, 0.66)) * height, float(rng.uniform(0.45, 0.6))
    ends, head = _ends(ropes, height, 0.25, 0.35), Pieces()
    head.bar("second", (0, 0, hub_z - 0.2), (0, 0, height - 0.25), 0.30, 28)
    head.bar("paint", (0, 0, hub_z - 0.15), (0, 0, hub_z + 0.08), hub_r, 28)
    head.bar("paint", (0, 0, height - 0.42), (0, 0, height - 0.2), 0.75 * hub_r, 28)
    head.bar("stripe", (0, 0, height - 0.2), (0, 0, height - 0.12), 0.5 * hub_r, 28)
    for x, y, z in ends:
        head.bar("steel", (x, y, height - 0.3), (x, y, z), 0.06)
    nodes, jaws = {"head": head}, list[dict[str, Any]]()
    opening = float(rng.uniform(40, 55))
    shut = float(rng.uniform(0.35, 0.95))  # share of the gap between tines that their plates fill
    bent = [(hub_r, hub_z), (0.95 * reach, 0.78 * hub_z), (reach, 0.45 * hub_z), (0.66 * reach, 0.15 * hub_z)]
    profile = shapely.LineString(_rounded(np.array([*bent, (0.05, 0.02)]), 2))
    for i in range(tines):
        turn = trimesh.transformations.rotation_matrix(2 * np.pi * i / tines, (0, 0, 1))
        tine, ram = Pieces(), Pieces()
        tine.plate("paint", profile.buffer(0.09, cap_style="flat"), 0.0, 0.09)
        blade = _upright(profile.buffer(0.014, cap_style="flat"), 0.0, 1.0)
        half = np.tan(np.pi / tines) * np.abs(blade.vertices[:, 0]) * shut + 0.04
        blade.vertices[:, 1] = np.sign(blade.vertices[:, 1]) * half
        tine.append((blade, "second"))
        tine.append((icosphere(1, 0.12).apply_translation((0.13, 0, 0.1)), "worn"))
        tine.wheel("steel", (hub_r, 0.0, hub_z), 0.11, 0.24, 1)
        arm = (0.3, 0.0, height - 0.5), (0.88 * reach, 0.0, 0.85 * hub_z)
        half_way = tuple(float(v) for v in 0.6 * np.array(arm[0]) + 0.4 * np.array(arm[1]))
        ram.bar("black", arm[0], half_way, 0.075)
        ram.bar("steel", half_way, arm[1], 0.045)
        axis = tuple(map(float, turn[:3, :3] @ (0.0, 1.0, 0.0)))
        for name, pieces, hinge, angle in (
            (f"tine{i}", tine, (hub_r, 0.0, hub_z), -opening), (f"ram{i}", ram, arm[0], -0.45 * opening),
        ):  # fmt: skip
            nodes[name] = Pieces((piece.apply_transform(turn), paint) for piece, paint in pieces)
            jaws.append(_jaw(name, turn[:3, :3] @ hinge, angle) | {"axis": axis})
    return nodes, _keys(ropes, ends, height, float(rng.uniform(4000, 9000)), jaws)
