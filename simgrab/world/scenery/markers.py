"""Marks on grab and ropes: their shapes, pictures and points."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import trimesh

from simgrab.model.geometry import Array
from simgrab.model.scenario import AprilTag, Circles, Markers, Target
from simgrab.world.scenery.grabs.design import Design
from simgrab.world.scenery.meshes.part import Material, Part, Texture

THICKNESS_M, ARM_M = 0.02, 0.08
TAG_CELLS, TAG_BLACK_CELLS = 10, 8  # of family 36h11 with its white margin, and without
CIRCLES_APART, CIRCLE_DIAMETER = 0.5, 0.3  # of the plate's edge
_CELL_PX, _PLATE_PX = 64, 1024
_GREY = Material("marker_arm", (0.35, 0.36, 0.38, 1.0))


def marked(design: Design, markers: Markers) -> Design:
    """Mount plate and target on a grab's head; its mass stays unchanged."""
    parts: list[Part] = []
    ends = np.array([0.0, 0.0, float(design.terminations[0, 2])])
    if markers.plate:
        parts += _mounted(_plate(markers.plate), ends, np.array(markers.plate.position_m))
    if markers.target:
        parts += _mounted(_disc(markers.target), ends, np.array(markers.target.position_m))
    if not parts:
        return design
    head, *others = design.bodies
    marked_head = replace(head, parts=[*head.parts, *parts], own_solid=head.solid)
    return replace(design, bodies=[marked_head, *others])


def mark_points(plate: Circles | AprilTag, end_height: float) -> Array:
    """Return the reference points of a plate, grab frame, m, shape (4, 3).

    Parameters
    ----------
    end_height : float
        Height of the rope ends in the grab's frame, m.

    Returns
    -------
    ndarray, shape (4, 3)
        Centres of the circles, or corners of the tag's black square, in OpenCV's order: clockwise seen from above,
        from the one at (+x, +y).
    """
    half = plate.size_m / 2 * (CIRCLES_APART if isinstance(plate, Circles) else 1.0)
    corners = half * np.array([(1, 1, 0), (1, -1, 0), (-1, -1, 0), (-1, 1, 0)])
    return np.asarray(corners + plate.position_m + (0.0, 0.0, end_height))


def balls_of(markers: Markers) -> list[tuple[float, Part]]:
    """Return the balls: distance from O, m, towards the middle of the rope ends; shape about the ball's centre."""
    balls = markers.balls
    if balls is None:
        return []
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=balls.diameter_m / 2)
    material = Material("marker_ball", (*balls.rgb, 1.0), emission=0.2)
    return [(distance, Part(f"ball_{i}", mesh, material)) for i, distance in enumerate(balls.distances_m)]


def plate_picture(plate: Circles | AprilTag) -> Texture:
    """Render the picture on a plate, shape (n, n, 3): its top is along the grab's x, its left along y."""
    if isinstance(plate, AprilTag):
        family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        black = cv2.aruco.generateImageMarker(family, plate.tag, TAG_BLACK_CELLS * _CELL_PX)
        picture = np.pad(black, (TAG_CELLS - TAG_BLACK_CELLS) // 2 * _CELL_PX, constant_values=255)
    else:
        picture = np.full((_PLATE_PX, _PLATE_PX), 255, np.uint8)
        at = (0.5 + np.array([-0.5, 0.5]) * CIRCLES_APART) * _PLATE_PX
        rows, columns = np.mgrid[:_PLATE_PX, :_PLATE_PX] + 0.5
        for x in at:
            for y in at:
                picture[np.hypot(columns - x, rows - y) <= CIRCLE_DIAMETER / 2 * _PLATE_PX] = 0
    return np.repeat(np.asarray(picture, np.uint8)[:, :, None], 3, axis=2)


def _plate(plate: Circles | AprilTag) -> Part:
    """Plate whose upper face is at z = 0."""
    edge = plate.size_m * (TAG_CELLS / TAG_BLACK_CELLS if isinstance(plate, AprilTag) else 1.0)
    mesh = trimesh.creation.box((edge, edge, THICKNESS_M))
    mesh.apply_translation((0.0, 0.0, -THICKNESS_M / 2))
    x, y = np.asarray(mesh.vertices)[:, 0], np.asarray(mesh.vertices)[:, 1]
    uv = np.column_stack([0.5 - y / edge, 0.5 + x / edge])
    return Part("plate", mesh, Material("marker_plate", texture=plate_picture(plate), specular=0.05), uv)


def _disc(target: Target) -> Part:
    mesh = trimesh.creation.cylinder(target.diameter_m / 2, THICKNESS_M, sections=64)
    mesh.apply_translation((0.0, 0.0, -THICKNESS_M / 2))
    return Part("target", mesh, Material("marker_target", (*target.rgb, 1.0), specular=0.0, emission=0.5))


def _mounted(part: Part, ends: Array, position: Array) -> list[Part]:
    """Put a part at its place, with an arm from below T to below it."""
    lower = np.array([0.0, 0.0, -THICKNESS_M - ARM_M / 2])
    begin, end = ends + lower, ends + position + lower
    moved = part.moved(trimesh.transformations.translation_matrix(ends + position))
    if np.linalg.norm(end - begin) < ARM_M:
        return [moved]
    arm = trimesh.creation.cylinder(ARM_M / 2, segment=(begin, end), sections=12)
    return [moved, Part(f"{part.name}_arm", arm, _GREY)]
