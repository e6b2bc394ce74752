"""Visible content of a model's file, for every format."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from simgrab.io.parse import shown
from simgrab.model.geometry import Array

Faces = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class FileMaterial:
    """A material."""

    rgb: tuple[float, float, float] = (1.0, 1.0, 1.0)  # display values (sRGB) in [0, 1], multiplied with the texture
    texture: bytes | None = field(default=None, repr=False)  # a picture's file
    # specular, shininess: as `Material` has them
    specular: float = 0.2
    shininess: float = 0.2


@dataclass(frozen=True, eq=False)
class Shape:
    """Triangles of one material, where one node shows them."""

    nodes: tuple[str, ...]  # names of the node and of all its ancestors
    vertices: Array  # (n, 3), in the file's unit and axes, before `pose`
    faces: Faces  # (m, 3)
    surface: FileMaterial | None = None  # None if the file gives it no colour
    uv: Array | None = None  # (n, 2), texture coordinates; v = 1 is the top of the picture
    # (m, 3), display values (sRGB) of the faces, in [0, 1], instead of the surface's `rgb`
    colours: Array | None = None
    pose: Array = field(default_factory=lambda: np.eye(4))  # (4, 4), pose of the node's frame in the file's


@dataclass(frozen=True, eq=False)
class Contents:
    """The content of a file, with notes on parts that are not shown."""

    shapes: tuple[Shape, ...]
    # sentences on content that is shown otherwise than the file means it, each with a remedy
    doubts: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()  # content that is left out without visible effect
    unit: str = ""  # unit that the file states in words; empty if it states none


def some(names: Iterable[str]) -> str:
    """List names: six of them, and how many more there are."""
    listed = [shown(name) for name in names]
    return ", ".join(listed[:6]) + (f" and {len(listed) - 6} more" if len(listed) > 6 else "")


_UNITS = {
    "millimetres": ("mm", "millimeter", "millimetre"), "centimetres": ("cm", "centimeter", "centimetre"),
    "inches": ("in", "inch", "inche"), "feet": ("ft", "foot", "feet"), "metres": ("m", "meter", "metre"),
}  # fmt: skip


def stated_unit(comments: str) -> str:
    """Find the unit that a file's comments state, such as ``# File units = millimeters``."""
    match = re.search(
        r"(?i)\bunits?\b ?(?:[=:]|(?:is |are )?in (?=[a-z])|is\b|are\b)? ?['\"]?([a-z]+)", " ".join(comments.split())
    )
    word = match[1].lower() if match else ""
    return next((unit for unit, names in _UNITS.items() if word in names or word.removesuffix("s") in names), "")
