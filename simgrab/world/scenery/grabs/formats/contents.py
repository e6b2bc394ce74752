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
    """A material.

    Attributes
    ----------
    rgb : tuple of 3 floats
        Display values (sRGB) in [0, 1], multiplied with the texture.
    texture : bytes or None
        A picture's file.
    specular, shininess : float
        As `Material` has them.
    """

    rgb: tuple[float, float, float] = (1.0, 1.0, 1.0)
    texture: bytes | None = field(default=None, repr=False)
    specular: float = 0.2
    shininess: float = 0.2


@dataclass(frozen=True, eq=False)
class Shape:
    """Triangles of one material, where one node shows them.

    Attributes
    ----------
    nodes : tuple of str
        Names of the node and of all its ancestors.
    vertices : ndarray, shape (n, 3)
        In the file's unit and axes, before ``pose``.
    faces : ndarray, shape (m, 3)
    surface : FileMaterial or None
        None if the file gives it no colour.
    uv : ndarray, shape (n, 2), or None
        Texture coordinates; v = 1 is the top of the picture.
    colours : ndarray, shape (m, 3), or None
        Display values (sRGB) of the faces, in [0, 1], instead of the surface's ``rgb``.
    pose : ndarray, shape (4, 4)
        Pose of the node's frame in the file's.
    """

    nodes: tuple[str, ...]
    vertices: Array
    faces: Faces
    surface: FileMaterial | None = None
    uv: Array | None = None
    colours: Array | None = None
    pose: Array = field(default_factory=lambda: np.eye(4))


@dataclass(frozen=True, eq=False)
class Contents:
    """The content of a file, with notes on parts that are not shown.

    Attributes
    ----------
    shapes : tuple of Shape
    doubts : tuple of str
        Sentences on content that is shown otherwise than the file means it, each with a remedy.
    unread : tuple of str
        Content that is left out without visible effect.
    unit : str
        Unit that the file states in words; empty if it states none.
    """

    shapes: tuple[Shape, ...]
    doubts: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()
    unit: str = ""


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
