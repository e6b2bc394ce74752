"""STL: binary with the colours of Magics or VisCAM, or text of one or several solids.

trimesh 5.2 fails on names that hold keywords of the format, and on a text without its end.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from simgrab.io.models import ModelFile
from simgrab.io.parse import Refuse
from simgrab.model.geometry import Array
from simgrab.world.scenery.grabs.formats.contents import Contents, Shape, stated_unit

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_SOLID = re.compile(r"(?ims)^[ \t]*solid\b[ \t]*([^\r\n]*)(.*?)(?=^[ \t]*endsolid\b|^[ \t]*solid\b|\Z)")
_VERTEX = re.compile(r"(?i)\bvertex\s+(\S+)\s+(\S+)\s+(\S+)")


def read(model: ModelFile, refuse: Refuse) -> Contents:
    """Read an STL file."""
    data = model.data
    if len(data) == 84 + 50 * int.from_bytes(data[80:84], "little"):
        facets = np.frombuffer(data, _FACET, offset=84)
        shape = _shape("geometry_0", facets["corners"].reshape(-1, 3), _colours(data[:80], facets["attribute"]))
        return Contents((shape,), unit=stated_unit(data[:80].decode("latin-1")))
    text = data.decode("utf-8", errors="replace")
    found: dict[str, list[tuple[str, ...]]] = {}
    for name, body in _SOLID.findall(text):
        found.setdefault(name.strip() or "geometry_0", []).extend(_VERTEX.findall(body))
    facets_stated = len(re.findall(r"(?i)\bfacet\s+normal\b", text))
    if sum(map(len, found.values())) != 3 * facets_stated or any(len(corners) % 3 for corners in found.values()):
        raise refuse("has facets without three vertices, or outside of a solid: it is cut off or damaged")
    shapes = [_shape(name, np.array(corners, float), None) for name, corners in found.items() if corners]
    return Contents(tuple(shapes))


def _shape(name: str, corners: Array, colours: Array | None) -> Shape:
    return Shape((name,), corners, np.arange(len(corners)).reshape(-1, 3), colours=colours)


def _colours(header: bytes, attributes: NDArray[np.uint16]) -> Array | None:
    """Read the colours of facets; None where none has one."""
    levels = np.stack([attributes & 31, attributes >> 5 & 31, attributes >> 10 & 31], axis=1) / 31.0
    _, magics, stated = header.partition(b"COLOR=")
    own = attributes < 2**15 if magics else attributes >= 2**15
    if magics:  # red lowest; facets without a colour of their own have the header's
        plain = np.frombuffer(stated.ljust(3, b"\xff")[:3], np.uint8) / 255.0
    else:  # VisCAM: blue lowest
        levels, plain = levels[:, ::-1], np.ones(3)
    return np.where(own[:, None], levels, plain) if magics or own.any() else None
