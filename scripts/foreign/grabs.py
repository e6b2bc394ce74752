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
Pieces = list[tuple[Trimesh, str]]  # each with the name of its paint
PLATE_M = 0.025
PAINTS_HSV = ((0.03, 0.85), (0.10, 0.9), (0.16, 0.75), (0.33, 0.5), (0.55, 0.6), (0.62, 0.75), (0.0, 0.0), (0.95, 0.7))


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
            mesh = trimesh.util.concatenate([_faceted(piece) for piece, name in pieces if name == paint])
            mesh.visual = trimesh.visual.TextureVisuals(material=paints[paint])
            scene.add_geometry(mesh, node_name=f"{node}-{paint}", geom_name=f"{node}-{paint}", parent_node_name=node)
    path.write_bytes(trimesh.exchange.gltf.export_glb(scene, include_normals=False))
    return keys | {"up": "z"}


def _faceted(mesh: Trimesh) -> Trimesh:
    return Trimesh(mesh.vertices, mesh.faces, process=False)


def _paints(rng: Generator) -> Paints:
    hue, saturation = PAINTS_HSV[int(rng.integers(len(PAINTS_HSV)))]
    value = float(rng.uniform(0.25, 0.85))
    other, grey = float(rng.uniform(0, 1)), float(rng.uniform(0.03, 0.25))
    kinds = {
        "paint": (*_rgb(hue, saturation, value), 0.0, 0.5),
        "second": (*_rgb(other, 0.6 * float(rng.random()), float(rng.uniform(0.15, 0.7))), 0.0, 0.6),
        "steel": (grey + 0.1, grey + 0.09, grey + 0.08, 1.0, 0.45),
        "worn": (0.16, 0.10, 0.07, 0.3, 0.8),
        "black": (0.02, 0.02, 0.022, 0.0, 0.7),
        "stripe": (0.75, 0.6, 0.05, 0.0, 0.5),
    }
    return {
        name: PBRMaterial(name=name, baseColorFactor=[r, g, b, 1.0], metallicFactor=metal, roughnessFactor=rough)
        for name, (r, g, b, metal, rough) in kinds.items()
    }


def _rgb(h: float, s: float, v: float) -> tuple[float, float, float]:
    return colorsys.hsv_to_rgb(h, s, v)


def _block(low: Point, high: Point) -> Trimesh:
    return box(bounds=np.array([low, high]))


def _bar(start: Point, end: Point, radius: float, sections: int = 14) -> Trimesh:
    return cylinder(radius=radius, segment=np.array([start, end]), sections=sections)


def _beam(start: Point, end: Point, width: float, height: float) -> Trimesh:
    """Return a rectangular tube's outside from point to point; its width stays level."""
    a, b = np.asarray(start, float), np.asarray(end, float)
    along = b - a
    length = float(np.linalg.norm(along))
    along /= length
    side = np.cross((0.0, 0.0, 1.0), along)
    side = np.array((0.0, 1.0, 0.0)) if np.linalg.norm(side) < 1e-6 else side / np.linalg.norm(side)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([along, side, np.cross(along, side)])
    pose[:3, 3] = (a + b) / 2
    return box((length, width, height), transform=pose)


def _plate(outline: Any, y: float, thickness: float = PLATE_M) -> Trimesh:
    """Stand a plate upright: its outline in (x, z), its middle at y."""
    mesh = extrude_polygon(shapely.Polygon(outline) if not hasattr(outline, "exterior") else outline, thickness)
    turn = np.array([(1, 0, 0, 0), (0, 0, -1, y + thickness / 2), (0, 1, 0, 0), (0, 0, 0, 1)], float)
    mesh.apply_transform(turn)
    return mesh


def _wheel(centre: Point, radius: float, width: float, axis: int) -> Trimesh:
    half = np.zeros(3)
    half[axis] = width / 2
    return _bar(tuple(np.subtract(centre, half)), tuple(np.add(centre, half)), radius, 24)


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
    corners = np.array(
        [
            (0.012, bottom),
            (0.45 * reach, bottom + 0.02),
            (0.86 * reach, bottom + 0.28 * (top - bottom)),
            (reach, bottom + 0.72 * (top - bottom)),
            (0.93 * reach, top + 0.10),
        ]
    )
    curve = _rounded(corners, int(rng.integers(1, 3)))
    back = shapely.LineString(curve).buffer(PLATE_M / 2, cap_style="flat", join_style="mitre")
    end = [*curve, (x0 + 0.16, top + 0.16), (x0 - 0.05, top), (0.012, 0.6 * bottom + 0.4 * top)]
    pieces: Pieces = [(_plate(_sided(back, side), 0.0, length), "paint")]
    for y in (-length / 2, length / 2):
        pieces.append((_plate(_sided(shapely.Polygon(end).buffer(0), side), y), "paint"))
        pieces.append((_wheel((side * x0, y, top), 0.13, 0.09, 1), "steel"))
    ribs = int(rng.integers(2, 6))
    depth = float(rng.uniform(0.05, 0.11))
    outer = shapely.LineString(curve[1:]).buffer(depth, cap_style="flat", single_sided=False)
    rib = outer.difference(shapely.Polygon(end).buffer(0.01))
    parts = [rib] if rib.geom_type == "Polygon" else list(rib.geoms)
    for y in np.linspace(-0.4 * length, 0.4 * length, ribs):
        pieces += [(_plate(_sided(part, side), float(y), 0.03), "second") for part in parts if part.area > 1e-3]
    lip = [(0.012, bottom - 0.03), (0.012, bottom + 0.10), (0.42 * reach, bottom + 0.07), (0.42 * reach, bottom - 0.01)]
    pieces.append((_plate(_sided(shapely.Polygon(lip), side), 0.0, length * 1.02), "worn"))
    if rng.random() < 0.5:
        for y in np.linspace(-0.45 * length, 0.45 * length, int(rng.integers(3, 8))):
            pieces.append(
                (
                    _block(
                        *_ordered(
                            (0.012 * side, float(y) - 0.05, bottom - 0.16),
                            (0.13 * side, float(y) + 0.05, bottom + 0.05),
                        )
                    ),
                    "steel",
                )
            )
    pieces.append(
        (
            _block(
                *_ordered((side * 0.90 * reach, -length / 2, top + 0.04), (side * 1.02 * reach, length / 2, top + 0.15))
            ),
            "second",
        )
    )
    return pieces


def _rounded(corners: Array, times: int) -> Array:
    """Cut the corners of an open line so many times (Chaikin 1974)."""
    for _ in range(times):
        a, b = corners[:-1], corners[1:]
        cut = np.stack([0.75 * a + 0.25 * b, 0.25 * a + 0.75 * b], axis=1).reshape(-1, 2)
        corners = np.concatenate([corners[:1], cut, corners[-1:]])
    return corners


def _ordered(a: Point, b: Point) -> tuple[Point, Point]:
    low, high = np.minimum(a, b), np.maximum(a, b)
    return tuple(map(float, low)), tuple(map(float, high))


def _sided(outline: Any, side: int) -> Any:
    return outline if side > 0 else shapely.affinity.scale(outline, -1, 1, origin=(0, 0))


def _head(z0: float, z1: float, half_x: float, half_y: float, ends: Sequence[Point], rng: Generator) -> Pieces:
    """Make a head: a box of rolled sections with sheaves between, sockets for the ropes, and striped edges."""
    pieces: Pieces = []
    for y in (-half_y, half_y):
        pieces.append((_block((-half_x, y - 0.06, z0), (half_x, y + 0.06, z0 + 0.05)), "paint"))
        pieces.append((_block((-half_x, y - 0.06, z1 - 0.05), (half_x, y + 0.06, z1)), "paint"))
        pieces.append((_block((-half_x, y - 0.015, z0), (half_x, y + 0.015, z1)), "paint"))
        for x in np.linspace(-half_x, half_x, 4):
            pieces.append((_block((float(x) - 0.012, y - 0.06, z0), (float(x) + 0.012, y + 0.06, z1)), "second"))
    for x in (-half_x, half_x):
        pieces.append((_block((x - 0.05, -half_y, z0), (x + 0.05, half_y, z1 - 0.04)), "paint"))
        pieces.append((_block((x - 0.055, -0.3 * half_y, z0 + 0.08), (x + 0.055, 0.3 * half_y, z1 - 0.1)), "stripe"))
    for x in np.linspace(-0.45 * half_x, 0.45 * half_x, int(rng.integers(2, 5))):
        pieces.append((_wheel((float(x), 0.0, (z0 + z1) / 2), 0.48 * (z1 - z0) + 0.1, 0.07, 0), "steel"))
    pieces.append((_bar((-half_x, 0.0, (z0 + z1) / 2), (half_x, 0.0, (z0 + z1) / 2), 0.07), "worn"))
    if rng.random() < 0.6:  # a deck of chequered plate, with a hole for the sheaves on either side
        for y0, y1 in ((-half_y, -0.35 * half_y), (0.35 * half_y, half_y)):
            pieces.append((_block((-half_x, y0, z1 - 0.02), (half_x, y1, z1 + 0.005)), "second"))
    for x, y, z in ends:
        pieces.append((_bar((x, y, z1 - 0.05), (x, y, z), 0.055), "steel"))
        pieces.append((_block((x - 0.09, y - 0.09, z1 - 0.06), (x + 0.09, y + 0.09, z1 + 0.03)), "worn"))
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


def _framed(rng: Generator) -> tuple[dict[str, Pieces], dict[str, Any]]:
    """Make a clamshell whose shells turn on pins of a stiff frame of plates, worked by hydraulic rams."""
    height, reach = float(rng.uniform(2.7, 3.5)), float(rng.uniform(1.15, 1.55))
    length, pin = float(rng.uniform(1.6, 2.5)), 0.16
    hinge_z, head_z = float(rng.uniform(0.40, 0.48)) * height, height - float(rng.uniform(0.45, 0.65))
    half_x, half_y = float(rng.uniform(0.5, 0.8)), float(rng.uniform(0.55, 0.8))
    ends = _ends(4, height, 0.35, 0.45)
    head = _head(head_z, height - 0.06, half_x, half_y, ends, rng)
    for y in (-0.42 * length, 0.42 * length):
        outline = [
            (-0.30, hinge_z - 0.18),
            (0.30, hinge_z - 0.18),
            (0.34, hinge_z + 0.15),
            (0.8 * half_x, head_z + 0.05),
            (-0.8 * half_x, head_z + 0.05),
            (-0.34, hinge_z + 0.15),
        ]
        hole = shapely.Point(0, (hinge_z + head_z) / 2).buffer(0.16)
        head.append((_plate(shapely.Polygon(outline).difference(hole), y, 0.04), "paint"))
    head.append((_beam((0, -0.42 * length, hinge_z + 0.02), (0, 0.42 * length, hinge_z + 0.02), 0.22, 0.22), "second"))
    head.append((_beam((0, -half_y, head_z + 0.1), (0, half_y, head_z + 0.1), 0.3, 0.12), "second"))
    nodes, jaws = {"head": head}, list[dict[str, Any]]()
    opening = float(rng.uniform(42, 58))
    for name, side in (("left", -1), ("right", 1)):
        nodes[name] = _shell(side, (pin, hinge_z), reach, 0.03, length, rng)
        jaws.append(
            {
                "node": name,
                "hinge_m": (side * pin, 0.0, hinge_z),
                "axis": (0.0, 1.0, 0.0),
                "open_deg": -side * opening,
                "lips_m": ((0.0, -length / 2, 0.03), (0.0, length / 2, 0.03)),
            }
        )
    for side, y in ((-1, -0.3), (-1, 0.3), (1, -0.3), (1, 0.3)):
        top = np.array((side * 0.7 * half_x, y * length, head_z + 0.02))
        foot = np.array((side * 0.93 * reach, y * length, hinge_z + 0.08))
        turn = np.radians(-side * opening)
        arm = foot - (side * pin, y * length, hinge_z)
        moved = np.array((side * pin, y * length, hinge_z)) + (
            np.cos(turn) * arm[0] + np.sin(turn) * arm[2],
            0.0,
            -np.sin(turn) * arm[0] + np.cos(turn) * arm[2],
        )
        before, after = foot - top, moved - top
        name = f"ram{len(nodes)}"
        half = tuple(map(float, top + 0.55 * before))
        nodes[name] = [
            (_bar(tuple(map(float, top)), half, 0.085), "black"),
            (_bar(half, tuple(map(float, foot)), 0.05), "steel"),
        ]
        angle = float(np.degrees(np.arctan2(after[0], after[2]) - np.arctan2(before[0], before[2])))
        angle = (angle + 180) % 360 - 180
        jaws.append(
            {"node": name, "hinge_m": tuple(map(float, top)), "axis": (0.0, 1.0, 0.0), "open_deg": angle or 0.1}
        )
    return nodes, _keys(4, ends, height, float(rng.uniform(7000, 11000)), jaws)


def _levered(rng: Generator) -> tuple[dict[str, Pieces], dict[str, Any]]:
    """Make a grab whose shells hang on pairs of plate levers that cross at a pin."""
    height, reach = float(rng.uniform(2.8, 3.6)), float(rng.uniform(1.25, 1.7))
    length, pin_z = float(rng.uniform(1.5, 2.2)), float(rng.uniform(0.46, 0.54)) * height
    head_z = height - 0.5
    ends = _ends(4, height, 0.30, 0.40)
    head = _head(head_z, height - 0.05, 0.55, 0.55, ends, rng)
    for x, y in ((-0.4, -0.45), (0.4, -0.45), (-0.4, 0.45), (0.4, 0.45)):
        head.append((_bar((x, y, head_z + 0.05), (0.25 * x, y, pin_z), 0.045), "steel"))
    head.append((_bar((0.0, -0.6 * length, pin_z), (0.0, 0.6 * length, pin_z), 0.11), "worn"))
    nodes, jaws = {"head": head}, list[dict[str, Any]]()
    opening = float(rng.uniform(35, 50))
    for name, side in (("left", -1), ("right", 1)):
        pieces = _shell(side, (0.2, 0.62 * pin_z), reach, 0.03, length, rng)
        up = head_z - 0.12
        lever = [
            (0.85 * reach, 0.55 * pin_z),
            (1.0 * reach, 0.72 * pin_z),
            (0.12, pin_z + 0.16),
            (-0.80 * reach, up + 0.1),
            (-0.92 * reach, up - 0.12),
            (-0.10, pin_z - 0.16),
        ]
        for y in (-0.36, 0.36):
            pieces.append((_plate(_sided(shapely.Polygon(lever), side), (y + 0.035 * side) * length, 0.05), "second"))
        pieces.append(
            (
                _beam((-side * 0.86 * reach, -0.4 * length, up), (-side * 0.86 * reach, 0.4 * length, up), 0.2, 0.2),
                "paint",
            )
        )
        nodes[name] = pieces
        jaws.append(
            {
                "node": name,
                "hinge_m": (0.0, 0.0, pin_z),
                "axis": (0.0, 1.0, 0.0),
                "open_deg": -side * opening,
                "lips_m": ((0.0, -length / 2, 0.03), (0.0, length / 2, 0.03)),
            }
        )
    return nodes, _keys(4, ends, height, float(rng.uniform(7000, 12000)), jaws)


def _tined(rng: Generator) -> tuple[dict[str, Pieces], dict[str, Any]]:
    """Make an orange-peel grab of bent tines round a hub, worked by hydraulic rams."""
    height, reach = float(rng.uniform(2.3, 3.1)), float(rng.uniform(1.1, 1.5))
    tines, ropes = int(rng.integers(4, 7)), int(rng.choice([1, 2, 4]))
    hub_z, hub_r = float(rng.uniform(0.55, 0.66)) * height, float(rng.uniform(0.45, 0.6))
    ends = _ends(ropes, height, 0.25, 0.35)
    head: Pieces = [
        (_bar((0, 0, hub_z - 0.2), (0, 0, height - 0.25), 0.30, 28), "second"),
        (_bar((0, 0, hub_z - 0.15), (0, 0, hub_z + 0.08), hub_r, 28), "paint"),
        (_bar((0, 0, height - 0.42), (0, 0, height - 0.2), 0.75 * hub_r, 28), "paint"),
        (_bar((0, 0, height - 0.2), (0, 0, height - 0.12), 0.5 * hub_r, 28), "stripe"),
    ]
    for x, y, z in ends:
        head.append((_bar((x, y, height - 0.3), (x, y, z), 0.06), "steel"))
    nodes, jaws = {"head": head}, list[dict[str, Any]]()
    opening = float(rng.uniform(40, 55))
    shut = float(rng.uniform(0.35, 0.95))  # share of the gap between tines that their plates fill
    for i in range(tines):
        angle = 2 * np.pi * i / tines
        turn = trimesh.transformations.rotation_matrix(angle, (0, 0, 1))
        profile = np.array(
            [
                (hub_r, hub_z),
                (0.95 * reach, 0.78 * hub_z),
                (reach, 0.45 * hub_z),
                (0.66 * reach, 0.15 * hub_z),
                (0.05, 0.02),
            ]
        )
        profile = _rounded(profile, 2)
        spine = shapely.LineString(profile).buffer(0.09, cap_style="flat")
        pieces: Pieces = [(_plate(spine, 0.0, 0.09), "paint")]
        blade = _plate(shapely.LineString(profile).buffer(0.014, cap_style="flat"), 0.0, 1.0)
        half = np.tan(np.pi / tines) * np.abs(blade.vertices[:, 0]) * shut + 0.04
        blade.vertices[:, 1] = np.sign(blade.vertices[:, 1]) * half
        pieces.append((blade, "second"))
        pieces.append((icosphere(1, 0.12).apply_translation((0.13, 0, 0.1)), "worn"))
        pieces.append((_wheel((hub_r, 0.0, hub_z), 0.11, 0.24, 1), "steel"))
        arm = (0.3, 0.0, height - 0.5), (0.88 * reach, 0.0, 0.85 * hub_z)
        half_way = tuple(float(v) for v in 0.6 * np.array(arm[0]) + 0.4 * np.array(arm[1]))
        ram: Pieces = [(_bar(arm[0], half_way, 0.075), "black"), (_bar(half_way, arm[1], 0.045), "steel")]
        name = f"tine{i}"
        nodes[name] = [(piece.apply_transform(turn), paint) for piece, paint in pieces]
        axis = tuple(map(float, turn[:3, :3] @ (0.0, 1.0, 0.0)))
        jaws.append(
            {
                "node": name,
                "hinge_m": tuple(map(float, turn[:3, :3] @ (hub_r, 0.0, hub_z))),
                "axis": axis,
                "open_deg": -opening,
            }
        )
        nodes[f"ram{i}"] = [(piece.apply_transform(turn), paint) for piece, paint in ram]
        jaws.append(
            {
                "node": f"ram{i}",
                "hinge_m": tuple(map(float, turn[:3, :3] @ arm[0])),
                "axis": axis,
                "open_deg": -0.45 * opening,
            }
        )
    return nodes, _keys(ropes, ends, height, float(rng.uniform(4000, 9000)), jaws)
