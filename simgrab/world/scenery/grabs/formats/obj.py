"""Wavefront OBJ with its material libraries.

Of the 68 cases of the tests that state a shape or a refusal, trimesh 5.2 gets 60 right and tinyobjloader's pre-release
62; neither says what it leaves out.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace

import numpy as np

from simgrab.io import models
from simgrab.io.models import MOST_NODES, ModelFile
from simgrab.io.parse import Refuse, shown
from simgrab.model.geometry import Array
from simgrab.world.scenery.grabs.formats.contents import Contents, FileMaterial, Shape, some, stated_unit
from simgrab.world.scenery.grabs.formats.polygons import check, triangles

_FREE_FORM = {"vp", "cstype", "deg", "bmat", "step", "curv", "curv2", "surf", "parm", "trim", "hole", "scrv", "sp",
              "end", "con", "bzp", "bsp", "cdc", "cdp", "res", "stech", "ctech"}  # fmt: skip
_OTHER_FILES = {"call", "csh", "maplib", "usemap", "shadow_obj", "trace_obj"}
_SAID_NOTHING_OF = {"s", "mg", "vn", "lod", "bevel", "c_interp", "d_interp", "mtllib"}
_PLAIN_MAPS = {"map_ka", "map_ks", "map_ns", "map_bump", "bump", "disp", "decal", "refl", "norm", "map_pr", "map_pm",
               "map_ps", "map_ke", "map_aat"}  # fmt: skip

_Part = tuple[str, str, str]
"""Names of object, group and material; empty where there is none."""


@dataclass
class _Polygons:
    """Faces of one part: indices of positions and of texture coordinates, from 1, and how many each face has."""

    v: list[int] = field(default_factory=list)
    vt: list[int] = field(default_factory=list)
    sizes: list[int] = field(default_factory=list)


@dataclass
class _Text:
    """What the lines of a file state, up to one of them."""

    points: list[tuple[float, float, float]] = field(default_factory=list)
    uvs: list[tuple[float, float]] = field(default_factory=list)
    colours: dict[int, tuple[float, ...]] = field(default_factory=dict)
    parts: dict[_Part, _Polygons] = field(default_factory=dict)
    keywords: set[str] = field(default_factory=set)
    part: _Part = ("", "", "")

    def add(self, line: str) -> None:
        """Take the next line."""
        words = line.partition("#")[0].split()
        match words[0]:
            case "v":
                if len(words) >= 7:
                    self.colours[len(self.points)] = tuple(map(float, words[4:7]))
                self.points.append((float(words[1]), float(words[2]), float(words[3])))
            case "vt":
                self.uvs.append((float(words[1]), float(words[2]) if len(words) > 2 else 0.0))
            case "f" | "fo":
                self._add_face(words[1:])
            case "o":
                self.part = (line[1:].strip(), *self.part[1:])
            case "g":
                self.part = (self.part[0], line[1:].strip(), self.part[2])
            case "usemtl":
                self.part = (*self.part[:2], line[6:].strip())
            case keyword:
                self.keywords.add(keyword)

    def _add_face(self, corners: list[str]) -> None:
        """Add a face; it counts back from what is stated before it."""
        polygons = self.parts.setdefault(self.part, _Polygons())
        for corner in corners:
            v, _, rest = corner.partition("/")
            vt = rest.partition("/")[0]
            polygons.v.append(_absolute(int(v), len(self.points)))
            polygons.vt.append(_absolute(int(vt), len(self.uvs)) if vt else 0)
        polygons.sizes.append(len(corners))


@dataclass(frozen=True)
class _Material:
    """A material of a library, and what of it is not shown."""

    surface: FileMaterial
    offset: tuple[float, float]
    scale: tuple[float, float]
    doubts: list[str]
    unread: set[str]


def read(model: ModelFile, refuse: Refuse) -> Contents:
    """Read an OBJ file.

    Its nodes are its objects, its groups, and one for each object's and group's part of a material.
    """
    text = _Text()
    for line in models.lines(model.data):
        try:
            text.add(line)
        except (ValueError, IndexError, OverflowError):
            raise refuse(f"cannot read {shown(line)}") from None
    library, doubts = _libraries(model)
    shapes = _shapes(text, library, refuse)
    used = dict.fromkeys(name for *_, name in text.parts if name)
    known = {name: library[name] for name in used if name in library}
    unknown = [name for name in used if name not in library]
    if unknown and not model.missing:
        doubts.append(f"No material library has {some(unknown)}: its faces are painted by paint_rgb. Name the library "
                      "by mtllib.")  # fmt: skip
    doubts += [
        f"Material {shown(name)}: faces without texture coordinates (vt) show Kd in place of its texture."
        for name, material in known.items()
        if material.surface.texture is not None
        and any(not all(part.vt) for (*_, own), part in text.parts.items() if own == name)
    ]
    doubts += [f"Material {shown(name)}: {doubt}" for name, material in known.items() for doubt in material.doubts]
    doubts += _of_keywords(text.keywords)
    if b"#MRGB" in model.data:
        doubts.append("It has colours of ZBrush (#MRGB), which are not read: export them as v x y z r g b.")
    if text.colours and any(entry.surface.texture is not None for entry in library.values()):
        doubts.append("Colours of vertices are left out where there is a texture.")
    unread = sorted(set[str]().union(*(material.unread for material in known.values())))
    if text.keywords & {"l", "p"}:
        unread.append("lines and points")
    comments = re.findall(rb"(?m)^[ \t]*#([^\r\n]{0,200})", model.data[:20_000])
    return Contents(tuple(shapes), tuple(doubts), tuple(unread), stated_unit(b"\n".join(comments).decode("latin-1")))


def _absolute(index: int, count: int) -> int:
    """Count from 1 what an index names, which may count back from the last of ``count``."""
    number = index if index >= 0 else count + 1 + index
    if number < 1:
        raise ValueError("before the first")
    return number


def _shapes(text: _Text, library: dict[str, _Material], refuse: Refuse) -> list[Shape]:
    points, uvs = np.array(text.points, float).reshape(-1, 3), np.array(text.uvs, float).reshape(-1, 2)
    colours, parts = _levels(text.colours, len(points)), text.parts
    if len(parts) > MOST_NODES:
        raise refuse(f"has {len(parts)} groups and materials; the limit is {MOST_NODES}: join some")
    check(np.array([size for polygons in parts.values() for size in polygons.sizes], np.int64), refuse)
    shapes = []
    for (owner, group, material), polygons in parts.items():
        v, vt = np.array(polygons.v, np.int64) - 1, np.array(polygons.vt, np.int64) - 1
        for indices, count, what in ((v, len(points), "vertex"), (vt, len(uvs), "texture coordinate")):
            if len(wrong := indices[indices >= count]):
                raise refuse(f"a face names {what} {wrong[0] + 1} of {count}")
        corners, _ = triangles(points[v], np.array(polygons.sizes, np.int64))
        if not len(corners):
            continue
        entry = library.get(material)
        surface, uv = None if entry is None else entry.surface, None
        if entry is not None and entry.surface.texture is not None and (vt >= 0).any():
            pairs, inverse = np.unique(np.stack([v, vt], axis=1)[corners.ravel()], axis=0, return_inverse=True)
            used, faces = pairs[:, 0], inverse.reshape(-1, 3)
            uv = np.where(pairs[:, 1:] >= 0, uvs[pairs[:, 1]], 0.0) * entry.scale + entry.offset
        else:
            if surface is not None:
                surface = replace(surface, texture=None)
            used, inverse = np.unique(v[corners.ravel()], return_inverse=True)
            faces = inverse.reshape(-1, 3)
        own = None
        if colours is not None and uv is None:
            own = colours[used][faces].mean(axis=1) * ((1.0, 1.0, 1.0) if surface is None else surface.rgb)
        name = "_".join(part for part in (owner, group, material) if part) or "geometry"
        nodes = tuple(dict.fromkeys(node for node in (name, group, owner) if node))
        shapes.append(Shape(nodes, points[used], faces, surface, uv, own))
    return shapes


def _levels(colours: dict[int, tuple[float, ...]], count: int) -> Array | None:
    """Give the colours of vertices, in [0, 1]; white where only others have one."""
    if not colours:
        return None
    stated, levels = np.array(list(colours.values())), np.ones((count, 3))
    levels[list(colours)] = stated / (255.0 if stated.max() > 1.0 else 1.0)
    return np.clip(levels, 0.0, 1.0)


def _of_keywords(keywords: set[str]) -> list[str]:
    doubts = []
    if surfaces := keywords & _FREE_FORM:
        doubts.append(f"It has free-form curves or surfaces ({some(sorted(surfaces))}), which are not shown: export "
                      "them as triangles.")  # fmt: skip
    if others := keywords & _OTHER_FILES:
        doubts.append(f"It refers to other files by {some(sorted(others))}, which are not read: export one file.")
    known = _FREE_FORM | _OTHER_FILES | _SAID_NOTHING_OF | {"l", "p"}
    if unknown := sorted(keywords - known):
        doubts.append(f"It has lines that are not of the format: {some(unknown)}. They are not read.")
    return doubts


# Material libraries.


def _libraries(model: ModelFile) -> tuple[dict[str, _Material], list[str]]:
    """Read the materials of all libraries that the file names."""
    library: dict[str, _Material] = {}
    doubts = []
    for name in dict.fromkeys(models.libraries(model.data)):
        data = model.referred(name)
        if data is not None:
            found = _library(model, name, data)
            library = found | library
            doubts += [] if found else [f"The material library {shown(name)} has no material (newmtl)."]
    return library, doubts


def _library(model: ModelFile, file: str, data: bytes) -> dict[str, _Material]:
    stated: dict[str, dict[str, tuple[str, str]]] = {}  # by material and keyword in lower case: the line's two ends
    own: dict[str, tuple[str, str]] = {}
    for key, value in models.statements(data):
        if key.lower() == "newmtl":
            own = stated[value] = {}
        elif value or key.lower() not in ("map_kd", "map_d"):
            own[key.lower()] = key, value
    return {name: _material(model, file, lines) for name, lines in stated.items()}


def _material(model: ModelFile, file: str, lines: dict[str, tuple[str, str]]) -> _Material:
    """Make a material of its lines."""
    doubts, rgb, texture, scale, offset = list[str](), (1.0, 1.0, 1.0), None, (1.0, 1.0), (0.0, 0.0)
    if "kd" in lines:
        words = lines["kd"][1].partition("#")[0].split()
        levels = [min(max(level, 0.0), 1.0) for word in words if (level := _number(word)) is not None]
        if len(levels) == len(words) and len(levels) in (1, 3):  # one stands for all three
            rgb = (levels[0], levels[len(levels) // 2], levels[-1])
        else:
            doubts.append(f"Kd {shown(' '.join(words))} is not read: give red, green and blue.")
    if "map_kd" in lines:
        name, options = models.map_name(lines["map_kd"][1])
        texture = model.referred(name, file.replace("\\", "/"))
        scale, offset = (_pair(options.get(key, []), plain) for key, plain in (("-s", 1.0), ("-o", 0.0)))
        if ignored := sorted(set(options) & {"-clamp", "-mm", "-t", "-cc", "-imfchan", "-texres"}):
            doubts.append(f"options {', '.join(ignored)} of map_Kd are not read: put them into the picture.")
    for key in ("d", "tr"):
        word, value = lines.get(key, ("", ""))
        amount = _number(value.split()[-1]) if value else None
        if amount is not None and (amount < 1.0 if key == "d" else amount > 0.0):
            doubts.append(f"{word} {amount:g} makes it transparent; it is shown opaque.")
    if "map_d" in lines:
        doubts.append("map_d makes it partly transparent; it is shown opaque.")
    if any(_number(word) for word in lines.get("ke", ("", ""))[1].split()):
        doubts.append("it emits light (Ke), which is not shown: give its colour as Kd.")
    if texture is not None and max(rgb) == 0.0:  # the black that exporters write beside a texture
        rgb = (1.0, 1.0, 1.0)
    elif texture is not None and min(rgb) < 0.5:
        kd = " ".join(f"{level:.3g}" for level in rgb)
        doubts.append(f"its texture is darkened by Kd {kd}, as the format says: set Kd 1 1 1 if it is too dark.")
    unread = {word for key, (word, _) in lines.items() if key in _PLAIN_MAPS}
    return _Material(FileMaterial(rgb, texture), offset, scale, doubts, unread)


def _number(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None


def _pair(words: list[str], plain: float) -> tuple[float, float]:
    first, second = (plain if (value := _number(word)) is None else value for word in [*words, "", ""][:2])
    return first, second
