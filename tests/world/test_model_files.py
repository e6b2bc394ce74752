"""Models of every kind: each feature of a format is read as its standard says, named by the check, or refused."""

from __future__ import annotations

import base64
import copy
import io
import json
import re
import struct

import numpy as np
import pytest
import trimesh
from PIL import Image

from simgrab.errors import ScenarioError
from simgrab.io import models
from simgrab.judge import own_grab
from simgrab.model.scenario import Mesh
from simgrab.world.scenery.grabs.formats.polygons import triangles
from simgrab.world.scenery.grabs.from_file import design, read

BLUE, SRGB_BLUE = (0.05, 0.2, 0.6), (63, 124, 203)  # linear, and its display values
BOX = trimesh.creation.box((2.0, 2.0, 2.0))
V, F = np.asarray(BOX.vertices, np.float32), np.asarray(BOX.faces, np.int64)
UV = np.linspace(0, 1, 16, dtype=np.float32).reshape(8, 2)


class Found:
    """What is read of files, of which the first is the model."""

    def __init__(self, folder, files, **keys):
        for name, data in files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(data.encode() if isinstance(data, str) else data)
        name = next(iter(files))
        self.keys = Mesh.of(folder / name, **{"up": "y" if "gl" in name else "z"} | keys)
        self.model = models.recall(self.keys.sha256, self.keys.file, None)
        self.reading = read(self.keys, self.model)
        self.parts = [part for piece in self.reading.pieces for part in piece.parts]

    @property
    def colours(self):
        """Display values of all materials; painted ones are white."""
        return {tuple(int(level) for level in np.rint(np.array(p.material.rgba[:3]) * 255)) for p in self.parts}

    @property
    def painted(self):
        return {part.material.name for part in self.parts} == {"body"}

    @property
    def textured(self):
        return {part.material.texture is not None for part in self.parts} == {True}

    @property
    def points(self):
        return np.concatenate([piece.vertices for piece in self.reading.pieces]) + self.reading.origin_m

    @property
    def size(self):
        return tuple(np.ptp(self.points, axis=0).round(4).tolist())

    @property
    def volume(self):
        return sum(float(piece.solid.volume) for piece in self.reading.pieces if piece.closed)

    @property
    def nodes(self):
        return [piece.nodes for piece in self.reading.pieces]

    @property
    def doubts(self):
        return " ".join(own_grab._doubts_of_file(self.keys, self.model, self.reading))

    @property
    def left_out(self):
        return "; ".join(self.reading.contents.unread)


def png(colour=(200, 100, 50), mode="RGB", size=(2, 2)):
    file = io.BytesIO()
    Image.new(mode, size, colour).save(file, "png")
    return file.getvalue()


# OBJ.

VERTICES = "".join(f"v {x} {y} {z}\n" for x, y, z in V)
FACES = "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in F)
BACK = "".join(f"f {a - 8} {b - 8} {c - 8}\n" for a, b, c in F)
QUADS = "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
MTL = "newmtl steel\nKd 0.2 0.4 0.8\n"
UVS = "vt 0 0\nvt 1 0\nvt 1 1\n"
UV_FACES = "".join(f"f {a + 1}/1 {b + 1}/2 {c + 1}/3\n" for a, b, c in F)
STEEL = (51, 102, 204)


def using(library, name="steel", faces=FACES, **files):
    """A box of a material, whose library is given."""
    named = {key.replace("_", "."): data for key, data in files.items()}
    return {"a.obj": f"mtllib a.mtl\n{VERTICES}{UVS}usemtl {name}\n{faces}", "a.mtl": library} | named


def textured(library, **files):
    return using(f"newmtl t\n{library}\n", "t", UV_FACES, **files)


def moved(text, by):
    return "".join(f"v {float(x) + by} {y} {z}\n" for _, x, y, z in (line.split() for line in text.splitlines()))


OBJ = {
    "absolute indices": ({"a.obj": VERTICES + FACES}, {"size": (2, 2, 2), "volume": 8, "painted": True}),
    "relative indices": ({"a.obj": VERTICES + BACK}, {"size": (2, 2, 2), "volume": 8}),
    "relative indices after each object": (
        {"a.obj": f"o A\n{VERTICES}{BACK}o B\n{moved(VERTICES, 3)}{BACK}"},
        {"size": (5, 2, 2), "volume": 16, "nodes": [("A",), ("B",)]},
    ),
    "mixed indices": (
        {"a.obj": VERTICES + "\n".join((FACES, BACK)[i % 2].splitlines()[i] for i in range(12))}, {"volume": 8},
    ),
    "faces before their vertices": ({"a.obj": FACES + VERTICES}, {"volume": 8}),
    "quads": ({"a.obj": VERTICES + QUADS}, {"volume": 8}),
    "quads and triangles": ({"a.obj": VERTICES + QUADS[:10] + FACES}, {"size": (2, 2, 2)}),
    "windows line ends and a byte order mark": (
        {"a.obj": b"\xef\xbb\xbf" + (VERTICES + FACES).replace("\n", "\r\n").encode()}, {"volume": 8},
    ),
    "old line ends": ({"a.obj": (VERTICES + FACES).replace("\n", "\r")}, {"volume": 8}),
    "tabs": ({"a.obj": (VERTICES + FACES).replace(" ", "\t ")}, {"volume": 8}),
    "continued lines": ({"a.obj": VERTICES + FACES.replace(" ", " \\\n")}, {"volume": 8}),
    "continued lines without a space": ({"a.obj": VERTICES + FACES.replace(" ", "\\\r\n")}, {"volume": 8}),
    "latin-1": ({"a.obj": ("o Greifer\xfc\n" + VERTICES + FACES).encode("latin-1")}, {"nodes": [("Greifer\xfc",)]}),
    "comments at ends and between": ({"a.obj": "# a\n" + VERTICES + "#\n" + FACES}, {"volume": 8}),
    "normals": ({"a.obj": VERTICES + "vn 0 0 1\n" + FACES.replace("f ", "f ").replace("\n", "\n")}, {"volume": 8}),
    "normals without texture coordinates": (
        {"a.obj": VERTICES + "vn 0 0 1\n" + "".join(f"f {a + 1}//1 {b + 1}//1 {c + 1}//-1\n" for a, b, c in F)},
        {"volume": 8, "painted": True},
    ),
    "texture coordinates without a material": ({"a.obj": VERTICES + UVS + UV_FACES}, {"painted": True}),
    "texture coordinates of three numbers": (
        {"a.obj": VERTICES + "vt 0 0 0\nvt 1\nvt 1 1\n" + UV_FACES},
        {"volume": 8},
    ),
    "smoothing groups": ({"a.obj": VERTICES + "s 1\n" + FACES + "s off\n"}, {"volume": 8, "doubts": ""}),
    "lines and points": ({"a.obj": VERTICES + FACES + "l 1 2\np 1\n"}, {"volume": 8, "left_out": "lines and points"}),
    "free-form surfaces": ({"a.obj": VERTICES + FACES + "vp 0.1 0.2\ncstype bezier\ncurv 0 1 1 2\n"},
                           {"volume": 8, "doubts~": "free-form .*'cstype', 'curv', 'vp'.* export"}),
    "lines of no kind": ({"a.obj": VERTICES + FACES + "wobble 3\n"}, {"doubts~": "not of the format: 'wobble'"}),
    "other files": (
        {"a.obj": VERTICES + FACES + "call ../secret.obj\n"},
        {"doubts~": "refers to other files by 'call'"},
    ),
    "colours of vertices": (
        {"a.obj": VERTICES.replace("\n", " 1 0.5 0\n") + FACES}, {"colours": {(255, 128, 0)}},
    ),
    "colours of vertices in bytes": (
        {"a.obj": VERTICES.replace("\n", " 255 128 0\n") + FACES}, {"colours": {(255, 128, 0)}},
    ),
    "colours of some vertices": ({"a.obj": VERTICES.replace("\n", " 1 0 0\n", 7) + FACES}, {"volume": 8}),
    "colours of ZBrush": ({"a.obj": VERTICES + "#MRGB ff0000ff\n" + FACES}, {"doubts~": "ZBrush"}),
    "weights of vertices": ({"a.obj": VERTICES.replace("\n", " 1.0\n") + FACES}, {"painted": True, "volume": 8}),
    "material": (using(MTL),
                 {"colours": {STEEL}, "nodes": [("steel",)], "doubts": ""}),
    "material stated before the object": (
        {"a.obj": f"mtllib a.mtl\nusemtl steel\no A\n{VERTICES}{FACES}", "a.mtl": MTL},
        {"colours": {STEEL}, "nodes": [("A_steel", "A")]},
    ),
    "group stated before the object": (
        {"a.obj": f"g part\no A\n{VERTICES}{FACES}"}, {"nodes": [("A_part", "part", "A")]},
    ),
    "groups without objects": (
        {"a.obj": f"{VERTICES}g One\n{FACES}g Two\n{FACES}"}, {"nodes": [("One",), ("Two",)]},
    ),
    "a material that comes back": (
        using(MTL + "newmtl red\nKd 1\n", faces=f"{QUADS[:10]}usemtl red\n{QUADS[10:20]}usemtl steel\n{QUADS[20:]}"),
        {"colours": {STEEL, (255, 255, 255)}, "nodes": [("steel",), ("red",)]},
    ),
    "missing library": ({"a.obj": f"mtllib gone\\sub\\x.mtl\n{VERTICES}usemtl steel\n{FACES}"},
                        {"painted": True, "volume": 8, "doubts~": "library .*x.mtl' is not in .* Put it beside"}),
    "library without the material": (
        using(MTL, "iron"), {"doubts~": "No material library has 'iron'"},
    ),
    "no library": ({"a.obj": f"{VERTICES}usemtl iron\n{FACES}"}, {"doubts~": "No material library has 'iron'"}),
    "empty library": ({"a.obj": f"mtllib a.mtl\n{VERTICES}{FACES}", "a.mtl": ""}, {"doubts~": "has no material"}),
    "library with spaces": ({"a.obj": f"mtllib my lib.mtl\n{VERTICES}usemtl steel\n{FACES}", "my lib.mtl": MTL},
                            {"colours": {STEEL}}),
    "library below, with backslashes": (
        {"a.obj": f"mtllib sub\\a.mtl\n{VERTICES}usemtl steel\n{FACES}", "sub/a.mtl": MTL}, {"colours": {STEEL}},
    ),
    "two libraries in a line": (
        {"a.obj": f"mtllib b.mtl a.mtl\n{VERTICES}usemtl steel\n{FACES}", "a.mtl": MTL, "b.mtl": "newmtl x\nKd 1\n"},
        {"colours": {STEEL}},
    ),
    "two lines of libraries": (
        {"a.obj": f"mtllib b.mtl\nmtllib a.mtl\n{VERTICES}usemtl steel\n{FACES}", "a.mtl": MTL,
         "b.mtl": "newmtl x\nKd 1 1 1\n"},
        {"colours": {STEEL}},
    ),
    "material with spaces": (using("newmtl old steel\nKd 0.2 0.4 0.8\n", "old steel"), {"colours": {STEEL}}),
    "one number of Kd": (using("newmtl g\nKd 0.4\n", "g"),
                         {"colours": {(102, 102, 102)}}),
    "spectral Kd": (using("newmtl g\nKd spectral a.rfl 1\n", "g"),
                    {"doubts~": "Kd 'spectral a.rfl 1' is not read: give red"}),
    "transparency": (using(MTL + "d 0.5\n"),
                     {"doubts~": "d 0.5 makes it transparent; it is shown opaque"}),
    "transparency the other way": (using(MTL + "Tr 0.5\nmap_d x.png\n"), {"doubts~": "Tr 0.5 makes .* map_d makes"}),
    "opaque": (using(MTL + "d 1.0\nTr 0\n"), {"doubts": ""}),
    "light": (using(MTL + "Ke 1 0 0\n"),
              {"doubts~": "emits light"}),
    "texture": (
        textured("Kd 1 1 1\nmap_Kd t.png", t_png=png()),
        {"textured": True, "colours": {(255, 255, 255)}, "doubts": ""},
    ),
    "texture and Kd": (
        textured("map_Kd t.png\nKd 0.4 0.4 0.4", t_png=png()),
        {"textured": True, "colours": {(102, 102, 102)}, "doubts~": "darkened by Kd 0.4 0.4 0.4"},
    ),
    "texture and black Kd": (
        textured("map_Kd t.png\nKd 0 0 0", t_png=png()),
        {"textured": True, "colours": {(255, 255, 255)}},
    ),
    "texture beside its library": (
        {"a.obj": f"mtllib m/a.mtl\n{VERTICES}{UVS}usemtl t\n{UV_FACES}", "m/a.mtl": "newmtl t\nmap_Kd ../m/my t.png\n",
         "m/my t.png": png()},
        {"textured": True, "doubts": ""},
    ),
    "texture without coordinates": (
        using("newmtl t\nKd 1 0 0\nmap_Kd t.png\n", "t", t_png=png()),
        {"colours": {(255, 0, 0)}, "doubts~": "'t': faces without texture coordinates"},
    ),
    "missing texture": (
        textured("Kd 1 0 0\nmap_Kd t.png"),
        {"colours": {(255, 0, 0)}, "doubts~": "The texture 't.png' is not in"},
    ),
    "texture of another machine": (
        textured("map_Kd C:\\tex\\t.png"),
        {"doubts~": "The texture 'C:.*t.png' is not in .* Put it beside"},
    ),
    "options of a texture that are not read": (
        textured("map_Kd -blendu on -mm 0.1 0.5 -clamp on t.png", t_png=png()),
        {"textured": True, "doubts~": "options -clamp, -mm of map_Kd are not read"},
    ),
    "maps of other kinds": (
        using(MTL + "map_Bump b.png\nnorm n.png\nmap_Ks s.png"),
        {"colours": {STEEL}, "left_out": "map_Bump; map_Ks; norm", "doubts": ""},
    ),
    "unit": (
        {"a.obj": "# File units = millimeters\n" + VERTICES + FACES},
        {"doubts~": r"in millimetres, but .*\(0.001\)"},
    ),
    "unit in words": ({"a.obj": "# All units are in millimetres\n" + VERTICES + FACES}, {"doubts~": "in millimetres"}),
    "unit that is used": ({"a.obj": "# units: m\n" + VERTICES + FACES}, {"doubts": ""}),
    "index beyond": ({"a.obj": VERTICES + "f 1 2 9\n"}, "a face names vertex 9 of 8"),
    "index before the first": ({"a.obj": VERTICES + "f 1 2 -9\n"}, "a vertex before the first of 8"),
    "index zero": ({"a.obj": VERTICES + "f 0 1 2\n"}, "a face names"),
    "texture index beyond": ({"a.obj": VERTICES + UVS + "f 1/1 2/2 3/4\n"}, "texture coordinate 4 of 3"),
    "no number": ({"a.obj": "v 0 0 x\n" + FACES}, "cannot read 'v 0 0 x'"),
    "points alone": ({"a.obj": VERTICES}, "shows no triangles"),
    "too many corners": ({"a.obj": VERTICES + "f" + " 1" * 5001}, "5001 corners; the limit is 5000: split it"),
    "too many triangles": (
        {"a.obj": VERTICES + ("\nf" + " 1 \\\n" * 4000) * 126}, "503748 triangles; the limit is",
    ),
    "a face of two corners": ({"a.obj": VERTICES + "f 1 2\n"}, "shows no triangles"),
}  # fmt: skip


def holds(found, expected):
    for name, value in expected.items():
        seen = getattr(found, name.rstrip("~"))
        if name.endswith("~"):
            assert re.search(value, seen), seen
        elif name == "volume":
            assert seen == pytest.approx(value, rel=1e-5)
        else:
            assert seen == value


def attacked(folder, files, expected, **keys):
    if isinstance(expected, str):
        with pytest.raises(ScenarioError, match=expected) as refused:
            Found(folder, files, **keys)
        assert "\n" not in str(refused.value)
    else:
        holds(Found(folder, files, **keys), expected)


@pytest.mark.parametrize("feature", OBJ)
def test_obj(feature, tmp_path):
    attacked(tmp_path, *OBJ[feature])


def test_the_placement_of_an_obj_texture(tmp_path):
    files = {
        "a.obj": f"mtllib a.mtl\n{VERTICES}vt 0.25 0.5\nusemtl t\n" + UV_FACES.replace("/2", "/1").replace("/3", "/-1"),
        "a.mtl": "newmtl t\nKd 1 1 1\nmap_Kd -s 2 3 1 -o 0.125 t.png\n", "t.png": png(),
    }  # fmt: skip
    found = Found(tmp_path, files)
    np.testing.assert_allclose(np.unique(found.parts[0].uv, axis=0), [(0.625, 1.5)])


def area(points, faces):
    a, b, c = (np.asarray(points)[faces[:, i]] for i in range(3))
    return np.cross(b - a, c - a).sum(axis=0) / 2


@pytest.mark.parametrize(
    "polygon",
    [
        [(0, 0), (2, 0), (2, 2), (1, 0.5)], [(2, 2), (1, 0.5), (0, 0), (2, 0)],
        [(0, 0), (3, 0), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)], [(0, 0), (1, 0), (2, 0), (2, 2), (0, 2)],
    ],
)  # fmt: skip
@pytest.mark.parametrize("turned", [1, -1])
def test_polygons_are_filled_and_not_beyond(polygon, turned):
    """The triangles cover the polygon once: their areas, each with its sign, are all of one sign."""
    points = np.column_stack([np.array(polygon, float)[::turned] + 4e6, np.full(len(polygon), 7.0)])
    faces, owners = triangles(points, np.array([len(points)]))
    x, y = points[:, 0] - 4e6, points[:, 1] - 4e6
    whole = (x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
    signed = np.array([area(points, face[None])[2] for face in faces])
    assert signed.sum() == pytest.approx(whole)
    assert (signed * turned >= -1e-9).all()
    assert set(owners) == {0}
    assert np.abs(np.cross(*(np.diff(points[faces], axis=1).swapaxes(0, 1)))).sum() / 2 == pytest.approx(abs(whole))


# PLY.


def ply(kind, vertex, face, rows, tail="", comments=""):
    head = f"ply\nformat {kind} 1.0\n{comments}element vertex {len(rows[0])}\n"
    head += "".join(f"property {one}\n" for one in vertex)
    head += f"element face {len(rows[1])}\n" + "".join(f"property {one}\n" for one in face) + tail + "end_header\n"
    if kind == "ascii":
        return (head + "".join(" ".join(map(str, row)) + "\n" for some in rows for row in flat(some))).encode()
    order = "<" if "little" in kind else ">"
    types = {"float": "f", "double": "d", "uchar": "B", "ushort": "H", "int": "i", "uint": "I"}
    packed = []
    for some, properties in zip(rows, (vertex, face), strict=False):
        for row in some:
            for value, stated in zip(row, properties, strict=True):
                words = stated.split()
                if words[0] == "list":
                    packed.append(
                        struct.pack(f"{order}{types[words[1]]}{len(value)}{types[words[2]]}", len(value), *value)
                    )
                else:
                    packed.append(struct.pack(order + types[words[0]], value))
    return head.encode() + b"".join(packed)


def flat(rows):
    for row in rows:
        yield [x for value in row for x in ((len(value), *value) if isinstance(value, tuple) else (value,))]


XYZ = ["float x", "float y", "float z"]
XYZST = [*XYZ, "float s", "float t"]
FRACTIONS = ["float red", "float green", "float blue"]
RGB = ["uchar red", "uchar green", "uchar blue"]
TEXTURE = "comment TextureFile t.png\n"
INDICES = ["list uchar int vertex_indices"]
PV = [tuple(map(float, row)) for row in V]
PF = [(tuple(map(int, row)),) for row in F]
PQ = [(tuple(int(x) - 1 for x in line.split()[1:]),) for line in QUADS.splitlines()]
MIXED = [*PQ[:5], ((1, 5, 7),), ((1, 7, 3),)]  # four and three corners
BY_CHANCE = [*PQ[:4], ((0, 2, 6),), ((0, 6, 4, 4, 4),), PQ[5]]  # as long as seven of four, with no area
KINDS = ("ascii", "binary_little_endian", "binary_big_endian")
SQUARE = [(x, y, z, u, v) for (x, y, z), (u, v) in zip(PV, UV.tolist(), strict=True)]

PLY = {
    "triangles": lambda k: ({"a.ply": ply(k, XYZ, INDICES, (PV, PF))}, {"volume": 8, "painted": True, "doubts": ""}),
    "vertex_index": lambda k: (
        {"a.ply": ply(k, XYZ, ["list uchar uint vertex_index"], (PV, PF))}, {"volume": 8},
    ),
    "quads": lambda k: ({"a.ply": ply(k, XYZ, INDICES, (PV, PQ))}, {"volume": 8}),
    "mixed polygons": lambda k: ({"a.ply": ply(k, XYZ, INDICES, (PV, MIXED))}, {"volume": 8}),
    "mixed polygons of the same total": lambda k: (
        {"a.ply": ply(k, XYZ, INDICES, (PV, BY_CHANCE))},
        {"size": (2, 2, 2)},
    ),
    "doubles": lambda k: ({"a.ply": ply(k, ["double x", "double y", "double z"], INDICES, (PV, PF))}, {"volume": 8}),
    "colours of vertices in bytes": lambda k: (
        {"a.ply": ply(k, [*XYZ, *RGB], INDICES, ([(*p, 200, 100, 50) for p in PV], PF))},
        {"colours": {(200, 100, 50)}, "doubts": ""},
    ),
    "colours of vertices as fractions": lambda k: (
        {"a.ply": ply(k, [*XYZ, *FRACTIONS], INDICES, ([(*p, 1, 0.5, 0) for p in PV], PF))},
        {"colours": {(255, 128, 0)}},
    ),
    "colours of 16 bits": lambda k: (
        {"a.ply": ply(k, [*XYZ, "ushort red", "ushort green", "ushort blue"], INDICES,
                      ([(*p, 65535, 32768, 0) for p in PV], PF))},
        {"colours": {(255, 128, 0)}},
    ),
    "colours of older names": lambda k: (
        {"a.ply": ply(k, [*XYZ, "uchar diffuse_red", "uchar diffuse_green", "uchar diffuse_blue"], INDICES,
                      ([(*p, 200, 100, 50) for p in PV], PF))},
        {"colours": {(200, 100, 50)}},
    ),
    "transparent colours": lambda k: (
        {"a.ply": ply(k, [*XYZ, "uchar red", "uchar green", "uchar blue", "uchar alpha"], INDICES,
                      ([(*p, 200, 100, 50, 128) for p in PV], PF))},
        {"colours": {(200, 100, 50)}, "doubts~": "vertex colours are partly transparent"},
    ),
    "colours of faces": lambda k: (
        {"a.ply": ply(k, XYZ, [*INDICES, *RGB],
                      (PV, [(*f, 255 * (i < 5), 10, 20) for i, f in enumerate(MIXED)]))},
        {"colours": {(255, 10, 20), (0, 10, 20)}, "volume": 8},
    ),
    "texture": lambda k: (
        {"a.ply": ply(k, XYZST, INDICES, (SQUARE, PF), comments=TEXTURE.replace("t.p", "my t.p")),
         "my t.png": png()},
        {"textured": True, "volume": 8, "doubts": ""},
    ),
    "texture of corners": lambda k: (
        {"a.ply": ply(k, XYZ, [*INDICES, "list uchar float texcoord"],
                      (PV, [(*f, (0.0, 0.0, 1.0, 0.0, 1.0, 1.0)) for f in PF]), comments=TEXTURE),
         "t.png": png()},
        {"textured": True},
    ),
    "two textures": lambda k: (
        {"a.ply": ply(k, XYZ, [*INDICES, "list uchar float texcoord", "int texnumber"],
                      (PV, [(*f, (0.0, 0.0, 1.0, 0.0, 1.0, 1.0), i % 2) for i, f in enumerate(PF)]),
                      comments="comment TextureFile t.png\ncomment TextureFile u.png\n"),
         "t.png": png(), "u.png": png((1, 2, 3))},
        {"textured": True},
    ),
    "missing texture": lambda k: (
        {"a.ply": ply(k, XYZST, INDICES, (SQUARE, PF), comments=TEXTURE)},
        {"painted": True, "doubts~": "The texture 't.png' is not in"},
    ),
    "texture coordinates alone": lambda k: (
        {"a.ply": ply(k, [*XYZ, "float s", "float t"], INDICES, (SQUARE, PF))}, {"painted": True},
    ),
    "texture without coordinates": lambda k: (
        {"a.ply": ply(k, XYZ, INDICES, (PV, PF), comments=TEXTURE), "t.png": png()},
        {"painted": True, "doubts~": "has no texture coordinates"},
    ),
    "other properties": lambda k: (
        {"a.ply": ply(k, [*XYZ, "float quality"], INDICES, ([(*p, 1.0) for p in PV], PF))},
        {"volume": 8, "left_out": "vertex property 'quality'"},
    ),
    "unit": lambda k: (
        {"a.ply": ply(k, XYZ, INDICES, (PV, PF), comments="comment unit: mm\n")},
        {"doubts~": "in millimetres"},
    ),
    "index beyond": lambda k: ({"a.ply": ply(k, XYZ, INDICES, (PV, [((0, 1, 8),)]))}, "a face names vertex 8 of 8"),
    "points alone": lambda k: ({"a.ply": ply(k, XYZ, INDICES, (PV, []))}, "shows no triangles"),
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("feature", PLY)
def test_ply(feature, kind, tmp_path):
    attacked(tmp_path, *PLY[feature](kind))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("element tristrips 1\nproperty list int int vertex_indices\nend_header\n" + VERTICES.replace("v ", "")
         + "14 0 1 2 3 -1 4 6 5 7 -1 0 4 1 5\n", {"size": (2, 2, 2)}),
        ("element face 0\nproperty list uchar int vertex_indices\nelement edge 1\nproperty int vertex1\n"
         "property int vertex2\nend_header\n" + VERTICES.replace("v ", "") + "0 1\n", "shows no triangles"),
        ("element face 12\nproperty list uchar int vertex_indices\nelement edge 1\nproperty int vertex1\n"
         "property int vertex2\nend_header\n" + VERTICES.replace("v ", "")
         + "".join(f"3 {a} {b} {c}\n" for a, b, c in F) + "0 1\n", {"volume": 8, "left_out": "element 'edge'"}),
        ("element face 12\nproperty list uchar int vertex_indices\nelement material 1\nproperty int ambient_red\n"
         "end_header\n" + VERTICES.replace("v ", "") + "".join(f"3 {a} {b} {c}\n" for a, b, c in F) + "9\n",
         {"doubts~": "element 'material' is not read"}),
        ("element face 12\nproperty list uchar int vertex_indices\nend_header\n1 2\n", "truncated"),
        ("element face 12\nproperty list uchar wide vertex_indices\nend_header\n1 2\n", "unknown type"),
    ],
)  # fmt: skip
def test_elements_of_ply(text, expected, tmp_path):
    head = "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
    attacked(tmp_path, {"a.ply": head + text}, expected)


# STL.


def stl(header=b"", attributes=None):
    data = np.zeros(len(F), [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    data["v"] = V[F]
    data["a"] = 0 if attributes is None else attributes
    return header.ljust(80, b" ") + struct.pack("<I", len(F)) + data.tobytes()


def solid(name, by=0.0):
    facets = "".join(
        "facet normal 0 0 0\n outer loop\n" + "".join(f"  vertex {x + by} {y} {z}\n" for x, y, z in V[face])
        + " endloop\nendfacet\n" for face in F
    )  # fmt: skip
    return f"solid {name}\n{facets}endsolid {name}\n"


STL = {
    "binary": (stl(), {"volume": 8, "painted": True, "doubts": ""}),
    "binary that begins with solid": (stl(b"solid"), {"volume": 8}),
    "text": (solid("a"), {"volume": 8, "nodes": [("a",)]}),
    "text without a name": (solid(""), {"nodes": [("geometry_0",)]}),
    "text in capitals with windows line ends": (
        solid("A").replace("\n", "\r\n").upper(),
        {"nodes": [("A",)], "volume": 8},
    ),
    "several solids": (solid("Head") + solid("Shell", 3.0), {"nodes": [("Head",), ("Shell",)], "volume": 16}),
    "names that hold keywords": (
        solid("my solid vertex normal") + solid("endsolid facet", 3.0),
        {"nodes": [("my solid vertex normal",), ("endsolid facet",)], "volume": 16},
    ),
    "no end": (solid("a").replace("endsolid a\n", ""), {"volume": 8}),
    "cut within a facet": (solid("a")[:-90], "truncated or damaged"),
    "colours of VisCAM": (stl(attributes=0x8000 | 31 << 10), {"colours": {(255, 0, 0)}}),
    "colours of Magics": (stl(b"COLOR=\x00\xff\x00\xff", 31), {"colours": {(255, 0, 0)}}),
    "one colour of Magics": (stl(b"COLOR=\x00\xff\x00\xff", 0x8000), {"colours": {(0, 255, 0)}}),
    "attributes that are no colours": (stl(attributes=7), {"painted": True}),
    "unit": (stl(b"exported, UNITS=mm"), {"doubts~": "in millimetres"}),
}  # fmt: skip


@pytest.mark.parametrize("feature", STL)
def test_stl(feature, tmp_path):
    data, expected = STL[feature]
    attacked(tmp_path, {"a.stl": data}, expected)


# glTF.

COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Gltf:
    """A glTF file in the making: a box with y up, whose attributes and JSON are changed."""

    def __init__(self):
        self.binary = b""
        self.content = {
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "name": "Box"}],
            "meshes": [{"primitives": [{"attributes": {}}]}], "accessors": [], "bufferViews": [], "buffers": [{}],
        }  # fmt: skip
        self.attributes["POSITION"] = self.add(V)
        self.primitive["indices"] = self.add(F.ravel().astype(np.uint16))

    @property
    def primitive(self):
        return self.content["meshes"][0]["primitives"][0]

    @property
    def attributes(self):
        return self.primitive["attributes"]

    @property
    def node(self):
        return self.content["nodes"][0]

    def view(self, data):
        self.content["bufferViews"].append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)})
        self.binary += data + bytes(-len(data) % 4)
        return len(self.content["bufferViews"]) - 1

    def add(self, values, **more):
        values = np.asarray(values)
        width = 1 if values.ndim == 1 else values.shape[1]
        self.content["accessors"].append({
            "bufferView": self.view(values.tobytes()), "componentType": COMPONENTS[values.dtype.str[1:]],
            "type": TYPES[width], "count": len(values),
        } | more)  # fmt: skip
        return len(self.content["accessors"]) - 1

    def material(self, **material):
        self.content.setdefault("materials", []).append(material)
        self.primitive["material"] = len(self.content["materials"]) - 1
        return self

    def texture(self, picture=None, mime="image/png", uv=UV, **more):
        self.content["images"] = [{"bufferView": self.view(picture or png()), "mimeType": mime}]
        self.content["textures"] = [{"source": 0} | more]
        if uv is not None:
            self.attributes["TEXCOORD_0"] = self.add(uv)
        return self

    def uses(self, *extensions, needs=False):
        self.content["extensionsUsed"] = list(extensions)
        if needs:
            self.content["extensionsRequired"] = list(extensions)
        return self

    def glb(self):
        content = copy.deepcopy(self.content)
        content["buffers"][0] = {"byteLength": len(self.binary)} | content["buffers"][0]
        text = json.dumps(content).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(self.binary), 0x4E4942)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks) + len(self.binary)) + chunks + self.binary


def attack(change):
    """Make a file by a function that changes one."""
    made = Gltf()
    return change(made) or made


def coloured(values, **more):
    def change(g):
        g.attributes["COLOR_0"] = g.add(np.tile(np.asarray(values), (8, 1)), **more)

    return change


def with_material(values, factor):
    def change(g):
        coloured(values)(g)
        g.material(pbrMetallicRoughness={"baseColorFactor": factor})

    return change


def sparse(g):
    g.content["accessors"][0].pop("bufferView")
    g.content["accessors"][0]["sparse"] = {
        "count": 8, "indices": {"bufferView": g.view(np.arange(8, dtype=np.uint8).tobytes()), "componentType": 5121},
        "values": {"bufferView": g.view(V.tobytes())},
    }  # fmt: skip


def sparse_over(g):
    """The last vertex is moved by 1 m along x."""
    g.content["accessors"][0]["sparse"] = {
        "count": 1, "indices": {"bufferView": g.view(np.array([7], "<u2").tobytes()), "componentType": 5123},
        "values": {"bufferView": g.view((V[7:] + [1, 0, 0]).astype("<f4").tobytes())},
    }  # fmt: skip


def strided(g):
    rows = np.concatenate([V, np.full((8, 2), 9, np.float32)], axis=1)
    g.attributes["POSITION"] = g.add(V)
    g.content["accessors"][-1]["bufferView"] = g.view(rows.tobytes())
    g.content["bufferViews"][-1]["byteStride"] = 20


def quantized(g, *, normalized):
    values = np.rint(V * 32767) if normalized else np.rint(V * 100)
    g.attributes["POSITION"] = g.add(values.astype(np.int16), normalized=normalized)
    g.node["scale"] = [1.0] * 3 if normalized else [0.01] * 3
    g.uses("KHR_mesh_quantization", needs=True)


def morphed(g):
    g.primitive["targets"] = [{"POSITION": g.add(V)}]
    g.content["meshes"][0]["weights"] = [0.5]


def morphed_by_node(g):
    morphed(g)
    g.node["weights"] = [1.0]


def skinned(g):
    """The joint lies 5 m up; the node's own pose is left out, as the standard says."""
    g.content["nodes"] += [{"translation": [0, 5, 0]}]
    g.content["scenes"][0]["nodes"] += [1]
    g.content["skins"] = [{"joints": [1]}]
    g.node.update(skin=0, translation=[100, 0, 0])
    g.attributes["JOINTS_0"] = g.add(np.zeros((8, 4), np.uint8))
    g.attributes["WEIGHTS_0"] = g.add(np.tile(np.array([255, 0, 0, 0], np.uint8), (8, 1)), normalized=True)


def mode(number, corners):
    def change(g):
        g.primitive["mode"] = number
        g.primitive["indices"] = g.add(np.array(corners, np.uint8))

    return change


def without_indices(g):
    g.attributes["POSITION"] = g.add(V[F.ravel()])
    del g.primitive["indices"]


def two_primitives(g):
    g.content["meshes"][0]["primitives"] *= 2


def instances(g):
    g.node["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {
        "TRANSLATION": g.add(np.array([[0, 0, 0], [3, 0, 0]], np.float32)),
    }}}  # fmt: skip
    g.uses("EXT_mesh_gpu_instancing", needs=True)


def hidden(g):
    g.content["nodes"] += [{"mesh": 0, "name": "Gone", "translation": [9, 0, 0],
                            "extensions": {"KHR_node_visibility": {"visible": False}}}]  # fmt: skip
    g.content["scenes"][0]["nodes"] += [1]
    g.uses("KHR_node_visibility")


def levels(g):
    g.content["nodes"] += [{"mesh": 0, "name": "Coarse"}]
    g.node["extensions"] = {"MSFT_lod": {"ids": [1]}}
    g.uses("MSFT_lod")


def camera(g):
    g.content["nodes"] = [{"camera": 0, "children": [1], "translation": [0, 7, 0]}, {"mesh": 0, "name": "Box"}]
    g.content["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}]


def other_scene(g):
    g.content["nodes"] += [{"mesh": 0, "name": "Elsewhere", "translation": [9, 0, 0]}]
    g.content["scenes"] += [{"nodes": [1]}]


def no_scene(g):
    del g.content["scene"], g.content["scenes"]


def twice(g):
    g.content["nodes"] = [{"name": "a", "mesh": 0}, {"name": "a", "mesh": 0, "translation": [3, 0, 0]}]
    g.content["scenes"][0]["nodes"] = [0, 1]


def mirrored(g):
    g.node["scale"] = [-1, 1, 1]


def matrix(g):
    g.node["matrix"] = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 3, 4, 5, 1]


def trs(g):
    half = 0.5**0.5
    g.node.update(translation=[3, 0, 0], rotation=[0, 0, half, half], scale=[2, 1, 1])


def base_colour(**texture):
    return {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0} | texture}}


def second_uv(g):
    g.texture().material(**base_colour(texCoord=1))
    g.attributes["TEXCOORD_1"] = g.add(UV)


def no_uv(g):
    g.texture(uv=None).material(**base_colour())


def webp(g):
    file = io.BytesIO()
    Image.new("RGB", (4, 4), (9, 99, 199)).save(file, "webp", lossless=True)
    g.texture(file.getvalue(), "image/webp").material(**base_colour())
    g.content["textures"] = [{"extensions": {"EXT_texture_webp": {"source": 0}}}]
    g.uses("EXT_texture_webp", needs=True)


def basisu(g, *, fallback=False, needs=False):
    g.texture(b"\xabKTX 20\xbb\r\n\x1a\n" + bytes(60), "image/ktx2").material(**base_colour())
    g.content["textures"] = [{"extensions": {"KHR_texture_basisu": {"source": 0}}}]
    if fallback:
        g.content["images"] += [{"bufferView": g.view(png()), "mimeType": "image/png"}]
        g.content["textures"][0]["source"] = 1
    g.uses("KHR_texture_basisu", needs=needs)


def broken_normal_map(g):
    g.texture(b"no picture").material(normalTexture={"index": 0}, pbrMetallicRoughness={"baseColorFactor": [*BLUE, 1]})


def gloss(g, **more):
    found = {"diffuseFactor": [*BLUE, 1.0], "glossinessFactor": 0.3} | more
    g.material(extensions={"KHR_materials_pbrSpecularGlossiness": found})
    g.uses("KHR_materials_pbrSpecularGlossiness")


def compressed(name, *, needs, data):
    def change(g):
        g.primitive["extensions"] = {name: {"bufferView": 0, "attributes": {"POSITION": 0}}}
        if not data:
            g.content["accessors"][0].pop("bufferView")
        g.uses(name, needs=needs)

    return change


def meshopt(*, data):
    def change(g):
        g.content["bufferViews"][0]["extensions"] = {"EXT_meshopt_compression": {"buffer": 0}}
        if not data:
            g.content["buffers"] += [{"byteLength": 96, "extensions": {"EXT_meshopt_compression": {"fallback": True}}}]
            g.content["bufferViews"][0]["buffer"] = 1
        g.uses("EXT_meshopt_compression")

    return change


def simple(*, material=None, **content):
    def change(g):
        if material is not None:
            g.material(**material)
        g.content.update(content)

    return change


def blend(mode, alpha):
    return simple(
        material={"name": "glass", "alphaMode": mode, "pbrMetallicRoughness": {"baseColorFactor": [*BLUE, alpha]}}
    )


def extended(name, needs=False):
    return lambda g: g.uses(name, needs=needs)


FACTOR = {"pbrMetallicRoughness": {"baseColorFactor": [*BLUE, 1.0]}}
ONE = {"colours": {SRGB_BLUE}, "doubts": ""}
GLTF = {
    "plain": (simple(), {"volume": 8, "painted": True, "doubts": "", "nodes": [("Box",)]}),
    "no normals, no material": (simple(), {"painted": True}),
    "factor": (simple(material=FACTOR), ONE),
    "specular and glossiness": (gloss, ONE),
    "specular and glossiness, with a texture": (
        lambda g: (g.texture(), gloss(g, diffuseTexture={"index": 0}))[1], ONE | {"textured": True}),
    "material without a colour": (simple(material={}), {"colours": {(255, 255, 255)}, "painted": False}),
    "colours, float": (coloured(np.float32(BLUE)), ONE),
    "colours, float with alpha": (coloured(np.float32([*BLUE, 1.0])), ONE),
    "colours, 16 bits": (
        coloured(np.rint(np.array(BLUE) * 65535).astype(np.uint16)[[0, 1, 2, 2]], normalized=True),
        ONE,
    ),
    "colours, bytes": (coloured(np.array([0, 51, 153, 255], np.uint8), normalized=True), {"colours": {(0, 124, 203)}}),
    "colours, not marked as fractions": (coloured(np.array([0, 51, 153, 255], np.uint8)), {"colours": {(0, 124, 203)}}),
    "colours times a factor": (with_material(np.float32([0.1, 0.4, 1.0]), [0.5, 0.5, 0.6, 1.0]), ONE),
    "colours and a plain material": (with_material(np.float32(BLUE), [1.0] * 4), ONE),
    "colours times a factor and a texture": (
        lambda g: (with_material(np.float32([0.1, 0.4, 1.0]), [0.5, 0.5, 0.6, 1.0])(g), g.texture(),
                   g.content["materials"][0]["pbrMetallicRoughness"].update(baseColorTexture={"index": 0}))[2],
        ONE | {"textured": True}),
    "second colours": (
        lambda g: g.attributes.update(COLOR_1=g.add(V)),
        {"left_out": "colours of vertices beyond COLOR_0"},
    ),
    "texture": (lambda g: g.texture().material(**base_colour()), {"textured": True, "doubts": ""}),
    "texture, second coordinates": (second_uv, {"textured": True, "doubts": ""}),
    "texture without coordinates": (no_uv, {"doubts~": "has no TEXCOORD_0, which its texture needs"}),
    "texture, WebP": (webp, {"textured": True, "doubts": ""}),
    "texture, KTX2 alone": (basisu, {"doubts~": "its texture is KTX2, which is not read: export it as PNG"}),
    "texture, KTX2 and PNG": (lambda g: basisu(g, fallback=True), {"textured": True, "doubts": ""}),
    "texture, KTX2, required": (
        lambda g: basisu(g, needs=True),
        "needs KHR_texture_basisu: export it with textures in PNG",
    ),
    "normal map that is broken": (broken_normal_map, ONE | {"left_out": "normalTexture"}),
    "light": (simple(material=FACTOR | {"emissiveFactor": [1, 0, 0]}), {"doubts~": "emits light"}),
    "blended and transparent": (blend("BLEND", 0.5), {"doubts~": "'glass' is partly transparent"}),
    "blended and opaque": (blend("BLEND", 1.0), ONE),
    "opaque with an alpha": (blend("OPAQUE", 0.5), ONE),
    "masked": (blend("MASK", 0.2), {"doubts~": "alphaMode MASK"}),
    "masked by a texture": (
        lambda g: g.texture(png((1, 2, 3, 0), "RGBA")).material(alphaMode="MASK", **base_colour()),
        {"doubts~": "alphaMode MASK"}),
    "double sided": (simple(material=FACTOR | {"doubleSided": True}), ONE),
    "sparse": (sparse, {"volume": 8}),
    "sparse over others": (sparse_over, {"size": (3, 2, 2)}),
    "strided": (strided, {"volume": 8}),
    "quantized, fractions": (lambda g: quantized(g, normalized=True), {"size": (2, 2, 2), "doubts": ""}),
    "quantized, whole numbers": (lambda g: quantized(g, normalized=False), {"size": (2, 2, 2), "doubts": ""}),
    "morph target": (morphed, {"size": (3, 3, 3)}),
    "morph target of a node": (morphed_by_node, {"size": (4, 4, 4)}),
    "skin": (skinned, {"volume": 8}),
    "strip": (mode(5, [0, 1, 2, 3, 6, 7, 4, 5, 0, 1]), {"size": (2, 2, 2)}),
    "fan": (mode(6, [0, 1, 3, 2, 6, 4, 5, 1]), {"size": (2, 2, 2)}),
    "lines alone": (mode(1, [0, 1]), "shows no triangles"),
    "points beside": (
        lambda g: g.content["meshes"][0]["primitives"].append({"attributes": {"POSITION": 0}, "mode": 0}),
        {"volume": 8, "left_out": "lines and points"}),
    "without indices": (without_indices, {"volume": 8}),
    "two primitives": (two_primitives, {"nodes": [("Box_0", "Box"), ("Box_1", "Box")]}),
    "instances": (instances, {"size": (5, 2, 2), "volume": 16, "nodes": [("Box_0", "Box"), ("Box_1", "Box")]}),
    "hidden node": (hidden, {"size": (2, 2, 2), "doubts~": "Hidden, or not in the scene that is shown: 'Gone'"}),
    "levels of detail": (levels, {"nodes": [("Box",)], "doubts": ""}),
    "camera with a child": (camera, {"volume": 8, "nodes": [("Box", "0")], "left_out": "cameras"}),
    "scene that is not shown": (other_scene, {"size": (2, 2, 2), "doubts~": "'Elsewhere'"}),
    "no scene": (no_scene, {"volume": 8}),
    "equal names": (twice, {"nodes": [("a",), ("a_1",)], "size": (5, 2, 2)}),
    "mirrored": (mirrored, {"volume": 8}),
    "matrix": (matrix, {"volume": 8}),
    "translation, rotation, scale": (trs, {"size": (2, 2, 4), "volume": 16}),
    "animations": (simple(animations=[{"channels": [], "samplers": []}]), {"left_out": "animations"}),
    "Draco, required": (compressed("KHR_draco_mesh_compression", needs=True, data=True), "without compression"),
    "Draco and plain": (compressed("KHR_draco_mesh_compression", needs=False, data=True), {"volume": 8, "doubts": ""}),
    "Draco without saying so": (
        compressed("KHR_draco_mesh_compression", needs=False, data=False),
        "without compression",
    ),
    "meshopt and plain": (meshopt(data=True), {"volume": 8, "doubts": ""}),
    "meshopt without saying so": (meshopt(data=False), "needs EXT_meshopt_compression: export it without compression"),
    "unknown, required": (
        extended("ACME_shape", needs=True),
        "needs the glTF extension 'ACME_shape'.* export it without",
    ),
    "used and not listed": (
        lambda g: g.node.update(extensions={"ACME_shape": {}}), {"doubts~": "uses the extension 'ACME_shape'"}),
    "unknown, used": (extended("ACME_shape"), {"doubts~": "uses the extension 'ACME_shape', which is unknown"}),
    "version 1": (simple(asset={"version": "1.0"}), "is of glTF '1.0'"),
    "index beyond": (mode(4, [0, 1, 8]), "a face names vertex 8 of 8"),
    "accessor beyond": (lambda g: g.content["accessors"][0].update(byteOffset=40), "truncated or damaged"),
    "too few colours": (lambda g: g.attributes.update(COLOR_0=g.add(V[:3])), "has 3 values for 8 vertices"),
    "material that is not there": (lambda g: g.primitive.update(material=3), "not a valid GLB"),
} | {
    f"{name}, used": (extended(name), {"volume": 8, "left_out~": name})
    for name in ("KHR_lights_punctual", "KHR_materials_clearcoat", "KHR_materials_specular", "KHR_materials_unlit",
                 "KHR_materials_variants", "KHR_xmp_json_ld", "EXT_instance_features", "EXT_mesh_features",
                 "EXT_structural_metadata", "KHR_materials_ior", "KHR_materials_sheen", "KHR_materials_iridescence",
                 "KHR_materials_anisotropy", "KHR_materials_dispersion", "KHR_animation_pointer")
} | {
    f"{name}, used": (extended(name), {"volume": 8, "doubts~": f"It uses {name}: .*(give|export|apply)"})
    for name in ("KHR_materials_transmission", "KHR_materials_volume", "KHR_materials_emissive_strength",
                 "KHR_materials_diffuse_transmission", "CESIUM_RTC")
}  # fmt: skip


@pytest.mark.parametrize("feature", GLTF)
def test_gltf(feature, tmp_path):
    change, expected = GLTF[feature]
    attacked(tmp_path, {"a.glb": attack(change).glb()}, expected)


def test_where_a_skin_and_a_camera_put_their_parts(tmp_path):
    for change, middle in ((skinned, (0, 0, 5)), (camera, (0, 0, 7)), (matrix, (3, -5, 4))):
        points = Found(tmp_path, {"a.glb": attack(change).glb()}).points
        np.testing.assert_allclose((points.min(axis=0) + points.max(axis=0)) / 2, middle, atol=1e-6)


@pytest.mark.parametrize(
    ("transform", "uv"),
    [
        ({"offset": [0.1, 0.2]}, (0.35, 0.3)), ({"scale": [2, 0.5]}, (0.5, 0.75)),
        ({"rotation": np.pi / 2}, (0.5, 1.25)),  # (u, v) to (v, -u), with v down
        ({"offset": [0.5, 0.0], "rotation": np.pi / 2, "scale": [2, 1]}, (1.0, 1.5)),
    ],
)  # fmt: skip
def test_the_placement_of_a_gltf_texture(transform, uv, tmp_path):
    """The texture coordinates of all corners are (0.25, 0.5), v down; ours point up."""
    made = Gltf().texture(uv=np.tile(np.float32([0.25, 0.5]), (8, 1)))
    made.material(**base_colour(extensions={"KHR_texture_transform": transform})).uses(
        "KHR_texture_transform", needs=True
    )
    found = Found(tmp_path, {"a.glb": made.glb()})
    np.testing.assert_allclose(np.unique(found.parts[0].uv.round(6), axis=0), [uv], atol=1e-6)
    assert found.doubts == ""


def test_texture_coordinates_of_whole_numbers(tmp_path):
    made = Gltf().texture(uv=None).material(**base_colour())
    made.attributes["TEXCOORD_0"] = made.add(np.tile(np.array([51, 204], np.uint8), (8, 1)), normalized=True)
    uv = np.unique(Found(tmp_path, {"a.glb": made.glb()}).parts[0].uv, axis=0)
    np.testing.assert_allclose(uv, [(0.2, 0.2)])


@pytest.mark.parametrize("uri", ["data.bin", "my%20data.bin", ""])
def test_buffers_of_gltf(uri, tmp_path):
    made = Gltf()
    data = f"data:application/octet-stream;base64,{base64.b64encode(made.binary).decode()}"
    made.content["buffers"] = [{"byteLength": len(made.binary), "uri": uri or data}]
    files = {"a.gltf": json.dumps(made.content)} | ({uri.replace("%20", " "): made.binary} if uri else {})
    holds(Found(tmp_path, files), {"volume": 8})


def test_a_picture_of_gltf_that_is_not_there(tmp_path):
    made = Gltf().texture().material(**base_colour())
    made.content["images"] = [{"uri": "gone.png"}]
    assert "The texture 'gone.png' is not in" in Found(tmp_path, {"a.glb": made.glb()}).doubts


def test_nothing_of_a_file_depends_on_chance(tmp_path):
    data = attack(two_primitives).glb()
    first, second = (Found(tmp_path, {"a.glb": data}) for _ in range(2))
    assert [part.name for part in first.parts] == [part.name for part in second.parts]


def test_pictures_of_16_bits_are_not_clipped(tmp_path):
    file = io.BytesIO()
    Image.fromarray(np.full((2, 2), 32768, np.uint16)).save(file, "png")
    found = Found(tmp_path, {"a.glb": Gltf().texture(file.getvalue()).material(**base_colour()).glb()})
    assert found.parts[0].material.texture[0, 0].tolist() == [128] * 3


# Where a model lies, and how it stands.

TEE = trimesh.util.concatenate([
    trimesh.creation.box((2.0, 1.0, 0.5)).apply_translation((0, 0, 1.5)), trimesh.creation.box((0.5, 0.5, 2.5)),
])  # fmt: skip


def stands(folder, axis, name, **keys):
    """The T of `TEE` in a file whose vertical axis is given."""
    points = np.asarray(TEE.vertices) @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]) if axis == "y" else TEE.vertices
    mesh = trimesh.Trimesh(points, TEE.faces, process=False)
    return Found(folder, {name: mesh.export(file_type=name[2:])}, **keys)


@pytest.mark.parametrize("name", ["a.obj", "a.glb", "a.stl", "a.ply"])
@pytest.mark.parametrize("up", ["y", "z"])
def test_the_check_names_the_axis_that_fits(name, up, tmp_path):
    usual = "y" if name == "a.glb" else "z"
    found = stands(tmp_path, up, name, up="auto")
    assert ("point up" in found.doubts) == (up != usual)
    if up != usual:
        assert f"{up} seems to point up: " in found.doubts
        assert f'give grab.up="{up}"' in found.doubts.replace("Give", "give")
    right = stands(tmp_path, up, name, up=up)
    assert right.size == (2, 1, 3)
    assert right.doubts == ""


def test_the_check_asks_where_the_axes_are_alike(tmp_path):
    for files, said in (({"a.glb": Gltf().glb()}, "y or z"), ({"a.obj": VERTICES + FACES}, "z or y")):
        assert f"not clear whether {said} points up" in Found(tmp_path, files, up="auto").doubts


def test_a_model_far_from_the_origin_is_the_model_at_the_origin(tmp_path):
    """Eastings and northings: its points are stated from the file's origin, like its vertices."""
    place = np.array([468_000.123, 4_012_345.677, 12.1])
    ends = [(x, y, 1.75) for x in (-0.3, 0.3) for y in (-0.3, 0.3)]
    text = "".join("v {} {} {}\n".format(*row) for row in TEE.vertices)
    far_text = "".join("v {} {} {}\n".format(*row) for row in TEE.vertices + place)
    faces = "".join("f {} {} {}\n".format(*(face + 1)) for face in TEE.faces)
    near = Found(tmp_path, {"a.obj": text + faces}, rope_ends_m=tuple(ends))
    far = Found(tmp_path, {"b.obj": far_text + faces}, rope_ends_m=tuple(tuple(place + end) for end in ends))
    for one in ("size", "doubts"):
        assert getattr(near, one) == getattr(far, one)
    ours, theirs = design(near.keys, near.reading), design(far.keys, far.reading)
    np.testing.assert_allclose(ours.terminations, theirs.terminations, atol=1e-6)
    mass, other = ours.mass_of(0.0, 0.0), theirs.mass_of(0.0, 0.0)
    assert (mass.mass, mass.centre_z, *mass.inertia) == pytest.approx(
        (other.mass, other.centre_z, *other.inertia), rel=1e-6
    )
    facts = dict(own_grab._facts(far.keys, far.model, far.reading, theirs))
    assert facts["centre A"].startswith("(468000.123, 4012345.677, 12.")


def test_numbers_of_32_bits_far_from_the_origin_are_named(tmp_path):
    mesh = TEE.copy().apply_translation((468_000.0, 4_012_345.0, 0.0))
    found = Found(tmp_path, {"a.stl": mesh.export(file_type="stl")})
    assert "have steps of 0.25 m: move it to the origin" in found.doubts


def test_what_is_painted_has_no_doubts_of_colours(tmp_path):
    files, _ = OBJ["transparency"]
    assert Found(tmp_path, files, finish="paint").doubts == ""


def test_a_sheet_whose_back_is_a_second_surface_is_a_plate(tmp_path):
    """Exporters double open surfaces, so that they are seen from both sides."""
    found = Found(tmp_path, {"a.obj": VERTICES + "f 1 2 4 3\nf 1 3 4 2\nf 1 5 6 2\nf 1 2 6 5\n"})
    (piece,) = found.reading.pieces
    assert not piece.closed
    assert float(piece.solid.volume) == pytest.approx(2 * 4 * 0.012, rel=1e-6)


@pytest.mark.parametrize(
    "name", ["../secret.png", "sub/../../secret.png", "{outer}/secret.png", "link.png", "..\\secret.png"]
)
@pytest.mark.parametrize("kind", ["obj", "ply", "glb"])
def test_a_model_reads_no_file_outside_its_folder(kind, name, tmp_path):
    """A picture there is left out, and named."""
    name = name.format(outer=tmp_path)
    (tmp_path / "secret.png").write_bytes(png())
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "link.png").symlink_to(tmp_path / "secret.png")
    gltf = Gltf().texture().material(**base_colour())
    gltf.content["images"] = [{"uri": name}]
    files = {
        "obj": lambda: textured(f"map_Kd {name}"), "glb": lambda: {"a.glb": gltf.glb()},
        "ply": lambda: {"a.ply": ply("ascii", XYZST, INDICES, (SQUARE, PF), comments=f"comment TextureFile {name}\n")},
    }[kind]()  # fmt: skip
    found = Found(tmp_path / "own", files)
    assert set(found.model.files) == set(files)
    assert not found.textured
    assert "is not in the model's folder: it is left out" in found.doubts
