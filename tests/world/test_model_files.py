"""Models of every kind: each feature of a format is read as its standard says, named by the check, or refused."""

import base64
import io
import json
import re
import struct
import time

import numpy as np
import pytest
import trimesh
from gltf_files import BLUE, SRGB_BLUE, UV, F, Gltf, V, base_colour, png
from PIL import Image

from simgrab.errors import ScenarioError
from simgrab.io import models
from simgrab.judge import own_grab
from simgrab.model.scenario import Mesh
from simgrab.world.scenery.grabs.formats.polygons import triangles
from simgrab.world.scenery.grabs.from_file import design, read


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
    def middle(self):
        return tuple(((self.points.min(axis=0) + self.points.max(axis=0)) / 2).round(4).tolist())

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


# OBJ.

VERTICES = "".join(f"v {x} {y} {z}\n" for x, y, z in V)
FACES = "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in F)
BACK = "".join(f"f {a - 8} {b - 8} {c - 8}\n" for a, b, c in F)
MIXED_FACES = "\n".join((FACES, BACK)[i % 2].splitlines()[i] for i in range(12))
NORMALS = "".join(f"f {a + 1}//1 {b + 1}//1 {c + 1}//-1\n" for a, b, c in F)
QUADS = "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
MTL = "newmtl steel\nKd 0.2 0.4 0.8\n"
UVS = "vt 0 0\nvt 1 0\nvt 1 1\n"
UV_FACES = "".join(f"f {a + 1}/1 {b + 1}/2 {c + 1}/3\n" for a, b, c in F)
STEEL = {"colours": {(51, 102, 204)}}
CLOSED, PAINTED, PLAIN, TEXTURED = {"volume": 8}, {"painted": True}, {"doubts": ""}, {"textured": True}
SOME_RED = {"colours": {(255, 0, 0), (255, 85, 85)}}  # where one of three corners is white
WHITE, RED, ORANGE = ({"colours": {rgb}} for rgb in ((255, 255, 255), (255, 0, 0), (255, 128, 0)))


def box(between="", faces=FACES, before="", vertices=VERTICES):
    return before + vertices + between + faces


def colours(rgb, count=-1):
    return VERTICES.replace("\n", f" {rgb}\n", count)


def using(library, name="steel", faces=FACES, mtllib="a.mtl", **files):
    """A box of a material, whose library is given."""
    named = {key.replace("_", "."): data for key, data in files.items()}
    libraries = {} if library is None else {mtllib.split()[-1].replace("\\", "/"): library}
    return {"a.obj": f"mtllib {mtllib}\n{VERTICES}{UVS}usemtl {name}\n{faces}"} | libraries | named


def textured(library, **files):
    return using(f"newmtl t\n{library}\n", "t", UV_FACES, **files)


def moved(text, by):
    return "".join(f"v {float(x) + by} {y} {z}\n" for _, x, y, z in (line.split() for line in text.splitlines()))


def says(doubt, **more):
    return {"doubts~": doubt} | more


def nodes(*names):
    return {"nodes": list(names)}


TWO_OBJECTS = (
    f"o A\n{VERTICES}{BACK}o B\n{moved(VERTICES, 3)}{BACK}",
    {"size": (5, 2, 2), "volume": 16} | nodes(("A",), ("B",)),
)
COMES_BACK = f"{QUADS[:10]}usemtl red\n{QUADS[10:20]}usemtl steel\n{QUADS[20:]}"
OWN_LIBRARY = using("newmtl t\nmap_Kd ../m/my t.png\n", "t", UV_FACES, "m/a.mtl") | {"m/my t.png": png()}
SPACED = using(None, mtllib="my lib.mtl") | {"my lib.mtl": MTL}
TWO_LINES = using(MTL, mtllib="b.mtl\nmtllib a.mtl", b_mtl="newmtl x\nKd 1 1 1\n")
BEFORE = {"a.obj": f"mtllib a.mtl\nusemtl steel\no A\n{VERTICES}{FACES}", "a.mtl": MTL}

OBJ = {
    "absolute indices": (box(), {"size": (2, 2, 2)} | CLOSED | PAINTED),
    "relative indices": (box(faces=BACK), {"size": (2, 2, 2)} | CLOSED),
    "relative indices after each object": TWO_OBJECTS,
    "mixed indices": (box(faces=MIXED_FACES), CLOSED),
    "faces before their vertices": (FACES + VERTICES, CLOSED),
    "quads": (box(faces=QUADS), CLOSED),
    "quads and triangles": (box(QUADS[:10]), {"size": (2, 2, 2)}),
    "windows line ends and a byte order mark": (b"\xef\xbb\xbf" + box().replace("\n", "\r\n").encode(), CLOSED),
    "old line ends": (box().replace("\n", "\r"), CLOSED),
    "tabs": (box().replace(" ", "\t "), CLOSED),
    "continued lines": (box(faces=FACES.replace(" ", " \\\n")), CLOSED),
    "continued lines without a space": (box(faces=FACES.replace(" ", "\\\r\n")), CLOSED),
    "latin-1": (("o Greifer\xfc\n" + box()).encode("latin-1"), nodes(("Greifer\xfc",))),
    "comments at ends and between": ("# a\n" + box("#\n"), CLOSED),
    "comments behind numbers": (using(MTL.replace("8\n", "8 # blue\n"), faces=FACES.replace("\n", " # face\n")),
                                STEEL | CLOSED | PLAIN),
    "normals": (box("vn 0 0 1\n"), CLOSED),
    "normals without texture coordinates": (box("vn 0 0 1\n", NORMALS), CLOSED | PAINTED),
    "texture coordinates without a material": (box(UVS, UV_FACES), PAINTED),
    "texture coordinates of three numbers": (box("vt 0 0 0\nvt 1\nvt 1 1\n", UV_FACES), CLOSED),
    "smoothing groups": (box("s 1\n") + "s off\n", CLOSED | PLAIN),
    "lines and points": (box() + "l 1 2\np 1\n", CLOSED | {"left_out": "lines and points"}),
    "free-form surfaces": (box() + "vp 0.1 0.2\ncstype bezier\ncurv 0 1 1 2\n",
                           says("free-form .*'cstype', 'curv', 'vp'.* export", **CLOSED)),
    "lines of no kind": (box() + "wobble 3\n", says("not of the format: 'wobble'")),
    "other files": (box() + "call ../secret.obj\n", says("refers to other files by 'call'")),
    "colours of vertices": (box(vertices=colours("1 0.5 0")), ORANGE),
    "colours of vertices in bytes": (box(vertices=colours("255 128 0")), ORANGE),
    "colours of some vertices": (box(vertices=colours("1 0 0", 7)), CLOSED | SOME_RED),
    "colours of some vertices in bytes": (box(vertices=colours("255 0 0", 7)), CLOSED | SOME_RED),
    "colours of ZBrush": (box("#MRGB ff0000ff\n"), says("ZBrush")),
    "weights of vertices": (box(vertices=colours("1.0")), PAINTED | CLOSED),
    "material": (using(MTL), STEEL | PLAIN | nodes(("steel",))),
    "material stated before the object": (BEFORE, STEEL | nodes(("A_steel", "A"))),
    "group stated before the object": ("g part\no A\n" + box(), nodes(("A_part", "part", "A"))),
    "groups without objects": (f"{VERTICES}g One\n{FACES}g Two\n{FACES}", nodes(("One",), ("Two",))),
    "a material that comes back": (using(MTL + "newmtl red\nKd 1\n", faces=COMES_BACK),
                                   {"colours": STEEL["colours"] | WHITE["colours"]} | nodes(("steel",), ("red",))),
    "missing library": (using(None, mtllib="gone\\sub\\x.mtl"),
                        says("library .*x.mtl' is not in .* Put it beside", **PAINTED, **CLOSED)),
    "library without the material": (using(MTL, "iron"), says("No material library has 'iron'")),
    "no library": (box("usemtl iron\n"), says("No material library has 'iron'")),
    "empty library": (using(""), says("has no material")),
    "library with spaces": (SPACED, STEEL),
    "library below, with backslashes": (using(MTL, mtllib="sub\\a.mtl"), STEEL),
    "two libraries in a line": (using(MTL, mtllib="b.mtl a.mtl", b_mtl="newmtl x\nKd 1\n"), STEEL),
    "two lines of libraries": (TWO_LINES, STEEL),
    "material with spaces": (using("newmtl old steel\nKd 0.2 0.4 0.8\n", "old steel"), STEEL),
    "one number of Kd": (using("newmtl g\nKd 0.4\n", "g"), {"colours": {(102, 102, 102)}}),
    "spectral Kd": (using("newmtl g\nKd spectral a.rfl 1\n", "g"), says("Kd 'spectral a.rfl 1' is not read: give red")),
    "transparency": (using(MTL + "d 0.5\n"), says("d 0.5 makes it transparent; it is shown opaque")),
    "transparency the other way": (using(MTL + "Tr 0.5\nmap_d x.png\n"), says("Tr 0.5 makes .* map_d makes")),
    "opaque": (using(MTL + "d 1.0\nTr 0\n"), PLAIN),
    "light": (using(MTL + "Ke 1 0 0\n"), says("emits light")),
    "texture": (textured("Kd 1 1 1\nmap_Kd t.png", t_png=png()), TEXTURED | WHITE | PLAIN),
    "texture and Kd": (textured("map_Kd t.png\nKd 0.4 0.4 0.4", t_png=png()),
                       says("darkened by Kd 0.4 0.4 0.4", colours={(102, 102, 102)}, **TEXTURED)),
    "texture and black Kd": (textured("map_Kd t.png\nKd 0 0 0", t_png=png()), TEXTURED | WHITE),
    "texture beside its library": (OWN_LIBRARY, TEXTURED | PLAIN),
    "texture without coordinates": (using("newmtl t\nKd 1 0 0\nmap_Kd t.png\n", "t", t_png=png()),
                                    says("'t': faces without texture coordinates", **RED)),
    "missing texture": (textured("Kd 1 0 0\nmap_Kd t.png"), says("The texture 't.png' is not in", **RED)),
    "texture of another machine": (textured("map_Kd C:\\tex\\t.png"),
                                   says("The texture 'C:.*t.png' is not in .* Put it beside")),
    "options of a texture that are not read": (textured("map_Kd -blendu on -mm 0.1 0.5 -clamp on t.png", t_png=png()),
                                               says("options -clamp, -mm of map_Kd are not read", **TEXTURED)),
    "maps of other kinds": (using(MTL + "map_Bump b.png\nnorm n.png\nmap_Ks s.png"),
                            STEEL | PLAIN | {"left_out": "map_Bump; map_Ks; norm"}),
    "unit": ("# File units = millimeters\n" + box(), says(r"in millimetres, but .*\(0.001\)")),
    "unit in words": ("# All units are in millimetres\n" + box(), says("in millimetres")),
    "unit that is used": ("# units: m\n" + box(), PLAIN),
    "index beyond": (VERTICES + "f 1 2 9\n", "a face names vertex 9 of 8"),
    "index before the first": (VERTICES + "f 1 2 -9\n", "cannot read 'f 1 2 -9'"),
    "index zero": (VERTICES + "f 0 1 2\n", "cannot read 'f 0 1 2'"),
    "texture index beyond": (VERTICES + UVS + "f 1/1 2/2 3/4\n", "texture coordinate 4 of 3"),
    "no number": ("v 0 0 x\n" + FACES, "cannot read 'v 0 0 x'"),
    "points alone": (VERTICES, "shows no triangles"),
    "too many corners": (VERTICES + "f" + " 1" * 5001, "5001 corners; the limit is 5000: split it"),
    "too many triangles": (VERTICES + ("\nf" + " 1 \\\n" * 4000) * 126, "503748 triangles; the limit is"),
    "a face of two corners": (VERTICES + "f 1 2\n", "shows no triangles"),
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


def attacked(folder, files, expected, name="a.obj"):
    files = files if isinstance(files, dict) else {name: files}
    if isinstance(expected, str):
        with pytest.raises(ScenarioError, match=expected) as refused:
            Found(folder, files)
        assert "\n" not in str(refused.value)
    else:
        holds(Found(folder, files), expected)


@pytest.mark.parametrize("feature", OBJ)
def test_obj(feature, tmp_path):
    attacked(tmp_path, *OBJ[feature])


def test_what_is_named_a_million_times_is_read_once(tmp_path):
    made, start = Gltf(), time.process_time()
    made.content["nodes"][0]["children"] = [0] * 10**6
    libraries = using(MTL + "#\n" * 10_000, mtllib="a.mtl" + "\nmtllib a.mtl" * 10_000)
    for files in ({"a.glb": made.glb()}, libraries):
        holds(Found(tmp_path, files), CLOSED)
        assert time.process_time() - start < 5


def test_the_placement_of_an_obj_texture(tmp_path):
    files = {
        "a.obj": f"mtllib a.mtl\n{VERTICES}vt 0.25 0.5\nusemtl t\n" + UV_FACES.replace("/2", "/1").replace("/3", "/-1"),
        "a.mtl": "newmtl t\nKd 1 1 1\nmap_Kd -s 2 3 1 -o 0.125 t.png\n", "t.png": png(),
    }  # fmt: skip
    found = Found(tmp_path, files)
    np.testing.assert_allclose(np.unique(found.parts[0].uv, axis=0), [(0.625, 1.5)])


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
    signed = np.cross(*np.diff(points[faces], axis=1).swapaxes(0, 1))[:, 2] / 2
    assert signed.sum() == pytest.approx(whole)
    assert (signed * turned >= -1e-9).all()
    assert set(owners) == {0}


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

CORNERS = ("list uchar float texcoord", (0.0, 0.0, 1.0, 0.0, 1.0, 1.0))
TWO_TEXTURES = TEXTURE + TEXTURE.replace("t.p", "u.p")
PICTURE = {"t.png": png()}
RGB_200 = {"colours": {(200, 100, 50)}}


def kinds(kind, *names):
    return [*XYZ, *(f"{kind} {name}" for name in names)]


def each(*values):
    return [(*point, *values) for point in PV]


FACE_COLOURS = [(*face, 255 * (i < 5), 10, 20) for i, face in enumerate(MIXED)]
TEXTURED_FACES = [(*face, CORNERS[1]) for face in PF]
TWICE_TEXTURED = [(*face, CORNERS[1], i % 2) for i, face in enumerate(PF)]

# Properties of vertices and faces, both, and what is expected; then comments and other files.
PLY = {
    "triangles": (XYZ, INDICES, PV, PF, CLOSED | PAINTED | PLAIN),
    "vertex_index": (XYZ, ["list uchar uint vertex_index"], PV, PF, CLOSED),
    "quads": (XYZ, INDICES, PV, PQ, CLOSED),
    "mixed polygons": (XYZ, INDICES, PV, MIXED, CLOSED),
    "mixed polygons of the same total": (XYZ, INDICES, PV, BY_CHANCE, {"size": (2, 2, 2)}),
    "doubles": (["double x", "double y", "double z"], INDICES, PV, PF, CLOSED),
    "colours of vertices in bytes": ([*XYZ, *RGB], INDICES, each(200, 100, 50), PF, RGB_200 | PLAIN),
    "colours of vertices as fractions": ([*XYZ, *FRACTIONS], INDICES, each(1, 0.5, 0), PF, ORANGE),
    "colours of 16 bits": (kinds("ushort", "red", "green", "blue"), INDICES, each(65535, 32768, 0), PF, ORANGE),
    "colours of older names": (kinds("uchar", "diffuse_red", "diffuse_green", "diffuse_blue"), INDICES,
                               each(200, 100, 50), PF, RGB_200),
    "transparent colours": (kinds("uchar", "red", "green", "blue", "alpha"), INDICES, each(200, 100, 50, 128), PF,
                            says("vertex colours are partly transparent", **RGB_200)),
    "colours of faces": (XYZ, [*INDICES, *RGB], PV, FACE_COLOURS, {"colours": {(255, 10, 20), (0, 10, 20)}} | CLOSED),
    "texture": (XYZST, INDICES, SQUARE, PF, TEXTURED | CLOSED | PLAIN, TEXTURE.replace("t.p", "my t.p"),
                {"my t.png": png()}),
    "texture of corners": (XYZ, [*INDICES, CORNERS[0]], PV, TEXTURED_FACES, TEXTURED, TEXTURE, PICTURE),
    "two textures": (XYZ, [*INDICES, CORNERS[0], "int texnumber"], PV, TWICE_TEXTURED, TEXTURED, TWO_TEXTURES,
                     PICTURE | {"u.png": png((1, 2, 3))}),
    "missing texture": (XYZST, INDICES, SQUARE, PF, says("The texture 't.png' is not in", **PAINTED), TEXTURE),
    "texture coordinates alone": (XYZST, INDICES, SQUARE, PF, PAINTED),
    "texture without coordinates": (XYZ, INDICES, PV, PF, says("has no texture coordinates", **PAINTED), TEXTURE,
                                    PICTURE),
    "other properties": (kinds("float", "quality"), INDICES, each(1.0), PF,
                         CLOSED | {"left_out": "vertex property 'quality'"}),
    "unit": (XYZ, INDICES, PV, PF, says("in millimetres"), "comment unit: mm\n"),
    "unit beside a texture": (XYZST, INDICES, SQUARE, PF, says("in millimetres"), TEXTURE + "comment unit: mm\n",
                              PICTURE),
    "index beyond": (XYZ, INDICES, PV, [((0, 1, 8),)], "a face names vertex 8 of 8"),
    "points alone": (XYZ, INDICES, PV, [], "shows no triangles"),
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("feature", PLY)
def test_ply(feature, kind, tmp_path):
    vertex, face, vertices, faces, expected, *more = PLY[feature]
    comments, files = more[0] if more else "", more[1] if more[1:] else {}
    attacked(tmp_path, {"a.ply": ply(kind, vertex, face, (vertices, faces), comments=comments)} | files, expected)


LISTS = "property list uchar int vertex_indices\n"
EDGE = "element edge 1\nproperty int vertex1\nproperty int vertex2\n"
ROWS, FACE_ROWS = VERTICES.replace("v ", ""), "".join(f"3 {a} {b} {c}\n" for a, b, c in F)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
         f"{ROWS}14 0 1 2 3 -1 4 6 5 7 -1 0 4 1 5\n", {"size": (2, 2, 2)}),
        (f"element face 0\n{LISTS}{EDGE}end_header\n{ROWS}0 1\n", "shows no triangles"),
        (f"element face 12\n{LISTS}{EDGE}end_header\n{ROWS}{FACE_ROWS}0 1\n",
         {"volume": 8, "left_out": "element 'edge'"}),
        (f"element face 12\n{LISTS}element material 1\nproperty int ambient_red\nend_header\n{ROWS}{FACE_ROWS}9\n",
         {"doubts~": "element 'material' is not read"}),
        (f"element face 12\n{LISTS}end_header\n1 2\n", "truncated"),
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


WINDOWS = solid("A").replace("\n", "\r\n").upper()
STL = {
    "binary": (stl(), CLOSED | PAINTED | PLAIN),
    "binary that begins with solid": (stl(b"solid"), CLOSED),
    "text": (solid("a"), CLOSED | nodes(("a",))),
    "text without a name": (solid(""), nodes(("geometry_0",))),
    "text in capitals with windows line ends": (WINDOWS, CLOSED | nodes(("A",))),
    "several solids": (solid("Head") + solid("Shell", 3.0), {"volume": 16} | nodes(("Head",), ("Shell",))),
    "names that hold keywords": (solid("my solid vertex normal") + solid("endsolid facet", 3.0),
                                 {"volume": 16} | nodes(("my solid vertex normal",), ("endsolid facet",))),
    "no end": (solid("a").replace("endsolid a\n", ""), CLOSED),
    "cut within a facet": (solid("a")[:-90], "cut off or damaged"),
    "colours of VisCAM": (stl(attributes=0x8000 | 31 << 10), RED),
    "colours of Magics": (stl(b"COLOR=\x00\xff\x00\xff", 31), RED),
    "one colour of Magics": (stl(b"COLOR=\x00\xff\x00\xff", 0x8000), {"colours": {(0, 255, 0)}}),
    "attributes that are no colours": (stl(attributes=7), PAINTED),
    "unit": (stl(b"exported, UNITS=mm"), says("in millimetres")),
}  # fmt: skip


@pytest.mark.parametrize("feature", STL)
def test_stl(feature, tmp_path):
    attacked(tmp_path, *STL[feature], name="a.stl")


# glTF.


def call(method, *values, **keys):
    return lambda g: method(g, *values, **keys)


def simple(*, material=None, node=(), **content):
    def change(g):
        if material is not None:
            g.material(**material)
        g.node.update(node)
        g.content.update(content)

    return change


def blend(mode, alpha):
    factor = {"baseColorFactor": [*BLUE, alpha]}
    return simple(material={"name": "glass", "alphaMode": mode, "pbrMetallicRoughness": factor})


def extended(name, needs=False):
    return call(Gltf.uses, name, needs=needs)


FACTOR = {"pbrMetallicRoughness": {"baseColorFactor": [*BLUE, 1.0]}}
ONE = {"colours": {SRGB_BLUE}} | PLAIN
TINT, TINT_FACTOR = np.float32([0.1, 0.4, 1.0]), [0.5, 0.5, 0.6, 1.0]
BYTES, BYTES_BLUE = np.array([0, 51, 153, 255], np.uint8), {"colours": {(0, 124, 203)}}
WORDS = np.rint(np.array(BLUE) * 65535).astype(np.uint16)[[0, 1, 2, 2]]
TURNED = {"translation": [3, 0, 0], "rotation": [0, 0, 0.5**0.5, 0.5**0.5], "scale": [2, 1, 1]}
MOVED = {"matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 3, 4, 5, 1]}
DRACO = "KHR_draco_mesh_compression"
TWO_BOXES = nodes(("Box_0", "Box"), ("Box_1", "Box"))
CLEAR = png((1, 2, 3, 0), "RGBA")
SECOND = {"left_out": "colours of vertices beyond COLOR_0"}
LINES = {"left_out": "lines and points"}
GLTF = {
    "plain": (simple(), CLOSED | PAINTED | PLAIN | nodes(("Box",))),
    "factor": (simple(material=FACTOR), ONE),
    "specular and glossiness": (Gltf.gloss, ONE),
    "gloss with a texture": (lambda g: g.texture().gloss(diffuseTexture={"index": 0}), ONE | TEXTURED),
    "material without a colour": (simple(material={}), WHITE | {"painted": False}),
    "colours, float": (call(Gltf.coloured, np.float32(BLUE)), ONE),
    "colours, float with alpha": (call(Gltf.coloured, np.float32([*BLUE, 1.0])), ONE),
    "colours, 16 bits": (call(Gltf.coloured, WORDS, normalized=True), ONE),
    "colours, bytes": (call(Gltf.coloured, BYTES, normalized=True), BYTES_BLUE),
    "colours, not marked as fractions": (call(Gltf.coloured, BYTES), BYTES_BLUE),
    "colours times a factor": (call(Gltf.coloured, TINT, baseColorFactor=TINT_FACTOR), ONE),
    "colours and a plain material": (call(Gltf.coloured, np.float32(BLUE), baseColorFactor=[1.0] * 4), ONE),
    "colours times a factor and a texture": (
        lambda g: g.texture().coloured(TINT, baseColorFactor=TINT_FACTOR, baseColorTexture={"index": 0}),
        ONE | TEXTURED),
    "second colours": (lambda g: g.attributes.update(COLOR_1=g.add(V)), SECOND),
    "texture": (lambda g: g.texture().material(**base_colour()), TEXTURED | PLAIN),
    "texture, second coordinates": (Gltf.second_uv, TEXTURED | PLAIN),
    "texture that is not there": (
        lambda g: g.texture().material(**base_colour()).content.update(images=[{"uri": "gone.png"}]),
        says("The texture 'gone.png' is not in")),
    "texture without coordinates": (lambda g: g.texture(uv=None).material(**base_colour()),
                                    says("has no TEXCOORD_0, which its texture needs")),
    "texture, WebP": (Gltf.webp, TEXTURED | PLAIN),
    "texture, KTX2 alone": (Gltf.basisu, says("its texture is KTX2, which is not read: export it as PNG")),
    "texture, KTX2 and PNG": (call(Gltf.basisu, fallback=True), TEXTURED | PLAIN),
    "texture, KTX2, required": (call(Gltf.basisu, needs=True), "needs KHR_texture_basisu: export it"),
    "normal map that is broken": (lambda g: g.texture(b"no picture").material(normalTexture={"index": 0}, **FACTOR),
                                  ONE | {"left_out": "normalTexture"}),
    "light": (simple(material=FACTOR | {"emissiveFactor": [1, 0, 0]}), says("emits light")),
    "blended and transparent": (blend("BLEND", 0.5), says("'glass' is partly transparent")),
    "blended and opaque": (blend("BLEND", 1.0), ONE),
    "opaque with an alpha": (blend("OPAQUE", 0.5), ONE),
    "masked": (blend("MASK", 0.2), says("alphaMode MASK")),
    "masked by a texture": (lambda g: g.texture(CLEAR).material(alphaMode="MASK", **base_colour()),
                            says("alphaMode MASK")),
    "double sided": (simple(material=FACTOR | {"doubleSided": True}), ONE),
    "sparse": (Gltf.sparse, CLOSED),
    "sparse over others": (Gltf.sparse_over, {"size": (3, 2, 2)}),
    "strided": (Gltf.strided, CLOSED),
    "quantized, fractions": (call(Gltf.quantized, normalized=True), {"size": (2, 2, 2)} | PLAIN),
    "quantized, whole numbers": (call(Gltf.quantized, normalized=False), {"size": (2, 2, 2)} | PLAIN),
    "morph target": (Gltf.morphed, {"size": (3, 3, 3)}),
    "morph target of a node": (call(Gltf.morphed, weights=[1.0]), {"size": (4, 4, 4)}),
    "skin": (Gltf.skinned, CLOSED | {"middle": (0, 0, 5)}),
    "strip": (call(Gltf.mode, 5, [0, 1, 2, 3, 6, 7, 4, 5, 0, 1]), {"size": (2, 2, 2)}),
    "fan": (call(Gltf.mode, 6, [0, 1, 3, 2, 6, 4, 5, 1]), {"size": (2, 2, 2)}),
    "lines alone": (call(Gltf.mode, 1, [0, 1]), "shows no triangles"),
    "points beside": (lambda g: g.primitives.append({"attributes": {"POSITION": 0}, "mode": 0}), CLOSED | LINES),
    "without indices": (Gltf.without_indices, CLOSED),
    "two primitives": (lambda g: g.primitives.append(g.primitive), TWO_BOXES),
    "instances": (Gltf.instances, {"size": (5, 2, 2), "volume": 16} | TWO_BOXES),
    "hidden node": (Gltf.hidden, says("Hidden, or not in the scene that is shown: 'Gone'", size=(2, 2, 2))),
    "levels of detail": (Gltf.levels, nodes(("Box",)) | PLAIN),
    "camera with a child": (Gltf.camera, CLOSED | nodes(("Box", "0")) | {"left_out": "cameras", "middle": (0, 0, 7)}),
    "scene that is not shown": (Gltf.other_scene, says("'Elsewhere'", size=(2, 2, 2))),
    "nodes in a long chain and a circle": (Gltf.nested, CLOSED),
    "no scene": (lambda g: [g.content.pop(key) for key in ("scene", "scenes")] and None, CLOSED),
    "equal names": (Gltf.twice, {"size": (5, 2, 2)} | nodes(("a",), ("a_1",))),
    "mirrored": (simple(node={"scale": [-1, 1, 1]}), CLOSED),
    "matrix": (simple(node=MOVED), CLOSED | {"middle": (3, -5, 4)}),
    "translation, rotation, scale": (simple(node=TURNED), {"size": (2, 2, 4), "volume": 16}),
    "animations": (simple(animations=[{"channels": [], "samplers": []}]), {"left_out": "animations"}),
    "Draco, required": (call(Gltf.compressed, DRACO, needs=True, data=True), "without compression"),
    "Draco and plain": (call(Gltf.compressed, DRACO, needs=False, data=True), CLOSED | PLAIN),
    "Draco without saying so": (call(Gltf.compressed, DRACO, needs=False, data=False), "without compression"),
    "meshopt and plain": (call(Gltf.meshopt, data=True), CLOSED | PLAIN),
    "meshopt without saying so": (call(Gltf.meshopt, data=False),
                                  "needs EXT_meshopt_compression: export it without compression"),
    "unknown, required": (extended("ACME_shape", needs=True), "needs the glTF extension 'ACME_shape'.* without"),
    "used and not listed": (simple(node={"extensions": {"ACME_shape": {}}}), says("uses the extension 'ACME_shape'")),
    "unknown, used": (extended("ACME_shape"), says("uses the extension 'ACME_shape', which is unknown")),
    "version 1": (simple(asset={"version": "1.0"}), "is of glTF '1.0'"),
    "index beyond": (call(Gltf.mode, 4, [0, 1, 8]), "a face names vertex 8 of 8"),
    "accessor beyond": (lambda g: g.content["accessors"][0].update(byteOffset=40), "cut off or damaged"),
    "too few colours": (lambda g: g.attributes.update(COLOR_0=g.add(V[:3])), "has 3 values for 8 vertices"),
    "material that is not there": (lambda g: g.primitive.update(material=3), "not a valid GLB"),
} | {
    f"{name}, used": (extended(name), CLOSED | {"left_out~": name})
    for name in ("KHR_lights_punctual", "KHR_materials_clearcoat", "KHR_materials_specular", "KHR_materials_unlit",
                 "KHR_materials_variants", "KHR_xmp_json_ld", "EXT_instance_features", "EXT_mesh_features",
                 "EXT_structural_metadata", "KHR_materials_ior", "KHR_materials_sheen", "KHR_materials_iridescence",
                 "KHR_materials_anisotropy", "KHR_materials_dispersion", "KHR_animation_pointer")
} | {
    f"{name}, used": (extended(name), says(f"It uses {name}: .*(give|export|apply)", **CLOSED))
    for name in ("KHR_materials_transmission", "KHR_materials_volume", "KHR_materials_emissive_strength",
                 "KHR_materials_diffuse_transmission", "CESIUM_RTC")
}  # fmt: skip


@pytest.mark.parametrize("feature", GLTF)
def test_gltf(feature, tmp_path):
    change, expected = GLTF[feature]
    made = Gltf()
    attacked(tmp_path, (change(made) or made).glb(), expected, name="a.glb")


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
