"""A user's own grab from a file: what is read, how it moves, what is refused."""

import io
import json
import pickle
import re
import resource
import shutil
import struct
import time
import tomllib
from pathlib import Path

import msgspec
import numpy as np
import pytest
import trimesh
from commands import run
from gltf_files import Gltf, base_colour
from msgspec.structs import replace
from PIL import Image
from scipy.spatial.transform import Rotation
from trimesh.transformations import translation_matrix

import simgrab
from simgrab.dataset.export import export
from simgrab.dataset.notices import notices
from simgrab.dataset.render import render
from simgrab.errors import ScenarioError
from simgrab.io import models
from simgrab.judge import own_grab
from simgrab.judge.audit.audit import audit
from simgrab.model import scenes
from simgrab.model.scenario import Jaw, Mesh
from simgrab.model.scenario.grab import Clamshell, OrangePeel, Scissors
from simgrab.world.extensions import Recipe
from simgrab.world.scenery.grabs import design_of
from simgrab.world.scenery.grabs.loose import loose

YELLOW = (230, 180, 20, 255)


def texture() -> Image.Image:
    picture = np.full((64, 64, 3), YELLOW[:3], np.uint8)
    picture[::8] = (20, 20, 20)
    return Image.fromarray(picture)


def tongs() -> trimesh.Scene:
    """A beam with two hooks below it, z up, metres: 2.4 × 0.6 × 1.6."""
    made = trimesh.Scene()
    beam = trimesh.creation.box((2.4, 0.6, 0.4))
    beam.apply_translation((0, 0, 1.4))
    uv = np.asarray(beam.vertices)[:, :2]
    made.add_geometry(beam, node_name="Beam", geom_name="Beam")
    beam.visual = trimesh.visual.TextureVisuals(uv, trimesh.visual.material.PBRMaterial(
        name="paint", baseColorTexture=texture(), metallicFactor=0.0, roughnessFactor=0.6))  # fmt: skip
    for name, side in (("HookLeft", -1), ("HookRight", 1)):
        leg = trimesh.creation.box((0.2, 0.5, 1.2))
        leg.apply_translation((side * 0.9, 0, 0.6))
        leg.visual = trimesh.visual.TextureVisuals(
            material=trimesh.visual.material.PBRMaterial(name=name, baseColorFactor=YELLOW)
        )
        made.add_geometry(leg, node_name=name, geom_name=name)
    return made


def boxes(*stated) -> trimesh.Scene:
    """Boxes of a name, sides and a place, and the name of the node that they are below, if any."""
    scene = trimesh.Scene()
    for name, sides, place, *parent in stated:
        place, parent = translation_matrix(place), parent[0] if parent else None
        scene.add_geometry(trimesh.creation.box(sides), name, name, parent_node_name=parent, transform=place)
    return scene


def checked(file, changes=None):
    """What the check says of a file."""
    return own_grab.check(own_grab.scene_of(file, changes))


def y_up(scene):
    """A scene or a mesh with y up."""
    turned = scene.copy()
    turned.apply_transform([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    return turned


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The tongs in five formats."""
    folder = tmp_path_factory.mktemp("tongs")
    y_up(tongs()).export(folder / "a.glb")
    (folder / "gltf").mkdir()
    for name, data in trimesh.exchange.gltf.export_gltf(y_up(tongs())).items():
        (folder / "gltf" / ("a.gltf" if name == "model.gltf" else name)).write_bytes(data)
    (folder / "obj").mkdir()
    tongs().export(folder / "obj" / "a.obj", mtl_name="a.mtl")
    tongs().to_mesh().export(folder / "a.ply")
    tongs().to_mesh().export(folder / "a.stl")
    return {
        "glb": folder / "a.glb", "gltf": folder / "gltf" / "a.gltf", "obj": folder / "obj" / "a.obj",
        "ply": folder / "a.ply", "stl": folder / "a.stl",
    }  # fmt: skip


JAWS = (
    Jaw(node="HookLeft", hinge_m=(-0.9, 0.0, 1.2), open_deg=20.0, lips_m=((-0.8, 0.2, 0.0),)),
    Jaw(node="HookRight", hinge_m=(0.9, 0.0, 1.2), open_deg=-30.0),
)


@pytest.mark.parametrize("kind", ["glb", "gltf", "obj", "ply", "stl"])
def test_every_format_gives_the_same_grab(files, kind):
    design = design_of(Mesh.of(files[kind]))
    low, high = (f(np.concatenate(list(design.points(0.0).values())), axis=0) for f in (np.min, np.max))
    np.testing.assert_allclose(low, (-1.2, -0.3, -0.8), atol=1e-6)
    np.testing.assert_allclose(high, (1.2, 0.3, 0.8), atol=1e-6)
    steel = 2.4 * 0.6 * 0.4 + 2 * 0.2 * 0.5 * 1.2
    assert design.mass_of(0.0, 0.0).mass == pytest.approx(7850 * steel, rel=1e-6)
    materials = {part.material.name: part.material for body in design.bodies for part in body.parts}
    if kind in ("glb", "gltf", "obj"):
        textures = [m.texture for m in materials.values() if m.texture is not None]
        assert [t.shape for t in textures] == [(64, 64, 3)]
        assert tuple(textures[0][1, 1]) == YELLOW[:3]
        plain = np.array(YELLOW[:3]) / 255
        shown = plain if kind == "obj" else [0.954, 0.857, 0.310]  # glTF's factors are linear
        assert any(np.allclose(m.rgba[:3], shown, atol=0.01) for m in materials.values())
    if kind == "stl":
        assert set(materials) == {"body"}  # painted as ours are


def test_mass_properties_are_those_of_the_shape(files):
    mass = design_of(Mesh.of(files["glb"], mass_kg=1000.0)).mass_of(0.0, 0.0)
    beam, leg = 2.4 * 0.6 * 0.4, 0.2 * 0.5 * 1.2
    shares = np.array([beam, leg, leg]) / (beam + 2 * leg)
    heights = np.array([1.4, 0.6, 0.6]) - 0.8
    assert mass.mass == pytest.approx(1000.0)
    assert mass.centre_z == pytest.approx(shares @ heights)
    about_z = 1000 * (shares[0] * (2.4**2 + 0.6**2) / 12 + 2 * shares[1] * ((0.2**2 + 0.5**2) / 12 + 0.9**2))
    assert mass.inertia[2] == pytest.approx(about_z)


@pytest.mark.parametrize(
    ("up", "matrix"),
    [
        ("z", np.eye(3)), ("-z", np.diag([1, -1, -1])), ("y", [[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
        ("-y", [[1, 0, 0], [0, 0, -1], [0, 1, 0]]), ("x", [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]),
        ("-x", [[0, 0, -1], [0, 1, 0], [1, 0, 0]]),
    ],
)  # fmt: skip
def test_the_axis_that_points_up_and_the_unit(tmp_path, up, matrix):
    """``matrix`` takes z up to the file's axes."""
    lying = tongs().to_mesh()
    lying.apply_transform(np.block([[1000 * np.asarray(matrix, float), np.zeros((3, 1))], [np.zeros(3), 1.0]]))
    lying.export(tmp_path / "a.stl")
    design = design_of(Mesh.of(tmp_path / "a.stl", up=up, scale=0.001))
    points = design.points(0.0)["head"]
    np.testing.assert_allclose(np.ptp(points, axis=0), (2.4, 0.6, 1.6), atol=1e-5)
    top = points[points[:, 2] > 0.79]
    assert np.ptp(top[:, 0]) == pytest.approx(2.4, abs=1e-5)  # the beam, not the hooks


def test_jaws_turn_about_their_hinges_in_proportion(files):
    design = design_of(Mesh.of(files["glb"], jaws=JAWS))
    assert [body.name for body in design.bodies] == ["head", "jaw_0", "jaw_1"]
    assert np.degrees(design.max_jaw) == pytest.approx(30.0)
    closed, half = design.points(0.0), design.points(design.max_jaw / 2)
    np.testing.assert_array_equal(closed["head"], half["head"])
    for name, hinge, degrees in (("jaw_0", (-0.9, 0, 0.4), 10.0), ("jaw_1", (0.9, 0, 0.4), -15.0)):
        a = np.radians(degrees)
        turn = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
        np.testing.assert_allclose(half[name], (closed[name] - hinge) @ turn.T + hinge, atol=1e-12)
    np.testing.assert_allclose(design.lips["jaw_0"], [(0.1, 0.2, -1.2)], atol=1e-12)


def test_a_jaw_below_a_jaw_moves_with_it(tmp_path):
    small, aside = (0.5, 0.5, 0.5), (1, 0, 0)
    scene = boxes(("beam", small, (0, 0, 0)), ("Arm", small, aside), ("Tip", small, aside, "Arm"))
    scene.export(tmp_path / "a.glb")
    jaws = tuple(
        Jaw(node=n, hinge_m=(x, 0.0, 0.0), axis=(0, 0, 1), open_deg=40.0) for n, x in (("Tip", 1.6), ("Arm", 0.4))
    )
    design = design_of(Mesh.of(tmp_path / "a.glb", up="z", jaws=jaws, centre_m=(0, 0, 0), ropes=1,
                               rope_ends_m=((0, 0, 1),)))  # fmt: skip
    frames = design.frames(design.max_jaw)
    a = np.radians(40.0)
    np.testing.assert_allclose(frames["jaw_1"][:3, 3], (0.4, 0, 0), atol=1e-12)
    np.testing.assert_allclose(frames["jaw_0"][:3, 3], (0.4 + 1.2 * np.cos(a), 1.2 * np.sin(a), 0), atol=1e-12)
    np.testing.assert_allclose(frames["jaw_0"][:2, 0], (np.cos(2 * a), np.sin(2 * a)), atol=1e-12)


@pytest.mark.parametrize("kind", ["glb", "obj", "ply", "stl"])
def test_mass_is_that_of_the_steel_however_the_file_splits_it(tmp_path, kind):
    """An L of two boxes that share an edge, one of them inside out, as a soup of triangles."""
    boxes = [trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1, 1, 0.5))]
    boxes[1].apply_translation((1, 0, 0.75))
    boxes[1].invert()
    soup = trimesh.util.concatenate(boxes)
    soup.unmerge_vertices()
    (y_up(soup) if kind == "glb" else soup).export(tmp_path / f"a.{kind}")
    keys = Mesh.of(tmp_path / f"a.{kind}", ropes=1, rope_ends_m=((0, 0, 1.0),))
    mass = design_of(keys).mass_of(0.0, 0.0)
    assert mass.mass == pytest.approx(7850 * 1.5, rel=1e-6)
    assert mass.centre_z == pytest.approx((1.0 * 0 + 0.5 * 0.75) / 1.5 - 0.25, abs=1e-6)
    parts = np.concatenate([p.mesh.triangles for b in design_of(keys).bodies for p in b.parts])
    assert np.einsum("ij,ij->", parts[:, 0], np.cross(parts[:, 1], parts[:, 2])) / 6 == pytest.approx(1.5)  # outwards


@pytest.mark.parametrize("reversed_faces", [[0], [3, 7, 8], range(2, 12)])
def test_reversed_faces_of_a_closed_piece_are_put_right(tmp_path, reversed_faces):
    """The mass is that of solid steel, not of plates, and every face looks outwards."""
    box = trimesh.creation.box((1, 1, 2))
    box.faces[reversed_faces] = box.faces[reversed_faces][:, ::-1]
    box.export(tmp_path / "a.ply")
    body = design_of(Mesh.of(tmp_path / "a.ply")).bodies[0]
    assert body.mass_kg == pytest.approx(7850 * 2, rel=1e-6)
    assert len(body.steel.faces) == 12  # seen from one side
    assert body.steel.volume == pytest.approx(2)
    assert not any("holes" in doubt for doubt in checked(tmp_path / "a.ply").doubts)


@pytest.mark.parametrize("opened", [False, True])
def test_solids_that_touch_in_one_mesh_are_solid(tmp_path, opened):
    """The edges of the sides where two boxes meet have four faces each; a third box stands apart."""
    cubes = [trimesh.creation.box((1, 1, 1)) for _ in range(3)]
    for place, cube in enumerate(cubes):
        cube.apply_translation((1.0 * place + (place > 1) / 4, 0, 0))
    if opened:
        cubes[2].update_faces(np.arange(12) > 0)
    trimesh.util.concatenate(cubes).export(tmp_path / "a.stl")
    found = checked(tmp_path / "a.stl")
    mass = design_of(Mesh.of(tmp_path / "a.stl")).bodies[0].mass_kg
    assert mass == pytest.approx(7850 * (2 + 5.5 * 0.012 if opened else 3), rel=1e-6)
    stated = "2 separate ones, of which 1 are closed" if opened else "2 separate ones, all closed"
    assert dict(found.facts)["surfaces"].startswith(stated)
    assert dict(found.facts)["triangles"] == ("35" if opened else "36")  # of the file
    assert any("taken as hollow" in doubt for doubt in found.doubts) == opened


def test_jaws_slide(files):
    jaws = (JAWS[0], Jaw(node="HookRight", axis=(2.0, 0.0, 0.0), stroke_m=0.4))
    design = design_of(Mesh.of(files["glb"], jaws=jaws))
    moved = design.points(design.max_jaw)["jaw_1"] - design.points(0.0)["jaw_1"]
    np.testing.assert_allclose(moved, np.broadcast_to((0.4, 0, 0), moved.shape), atol=1e-12)


def test_ropes_end_where_they_are_said_to_and_the_centre_lies_below(files):
    ends = ((0.6, -0.1, 1.7), (0.4, 0.3, 1.7), (0.2, 0.1, 1.7), (0.4, -0.3, 1.7))
    design = design_of(Mesh.of(files["glb"], rope_ends_m=ends))
    np.testing.assert_allclose(design.terminations[:, :2].mean(axis=0), 0.0, atol=1e-12)
    around = np.unwrap(np.arctan2(design.terminations[:, 1], design.terminations[:, 0]))
    assert np.all(np.diff(around) > 0)  # counter-clockwise, so that ropes do not cross
    assert design.points(0.0)["head"][:, 0].min() == pytest.approx(-1.6)
    given = design_of(Mesh.of(files["glb"], rope_ends_m=ends, centre_m=(0.4, 0.0, 0.5)))
    np.testing.assert_allclose(given.terminations[:, 2], 1.2, atol=1e-12)


def test_open_surfaces_are_seen_from_both_sides(tmp_path):
    sheet = trimesh.creation.box((2, 2, 2))
    sheet.update_faces(np.arange(len(sheet.faces)) > 1)
    sheet.export(tmp_path / "a.stl")
    body = design_of(Mesh.of(tmp_path / "a.stl")).bodies[0]
    assert len(body.steel.faces) == 20
    assert body.steel.area_faces @ body.steel.face_normals == pytest.approx(np.zeros(3))
    assert body.mass_kg == pytest.approx(7850 * 0.012 * 20.0)
    assert body.solid.center_mass[2] == pytest.approx(body.steel.triangles_center[:10] @ [0, 0, 1] @ np.full(10, 0.1))


def test_a_dataset_keeps_a_copy_and_is_made_again_from_it(files, tmp_path):
    scene = tmp_path / "scene.toml"
    shutil.copytree(files["obj"].parent, tmp_path / "obj")
    scene.write_text(
        'base = "quay-day"\nframes = 3\nplace.model = "plain"\n'
        '[grab]\nmodel = "mesh"\nfile = "obj/a.obj"\n[swing]\nclamp = true',
        "utf-8",
    )
    scenario = scenes.load(scene, size=(320, 180))
    render(scenario, tmp_path / "one", workers=2)
    manifest = json.loads((tmp_path / "one" / "manifest.json").read_text())
    (copy,) = {name.rpartition("/")[0] for name in manifest["files"] if name.startswith("grabs/")}
    assert {p.name for p in (tmp_path / "one" / copy).iterdir()} == {p.name for p in files["obj"].parent.iterdir()}
    assert str(tmp_path) not in json.dumps(manifest)
    (tmp_path / "obj" / "a.obj").unlink()  # what was named is gone, the copy is not
    models._known.clear()
    assert not audit(tmp_path / "one").findings
    render(tmp_path / "one" / "manifest.json", tmp_path / "two", workers=1)
    for name in manifest["files"]:
        assert (tmp_path / "two" / name).read_bytes() == (tmp_path / "one" / name).read_bytes()
    next((tmp_path / "one" / copy).glob("*.png")).write_bytes(b"")
    with pytest.raises(ScenarioError, match=r"grab\.sha256"):
        scenes.load(tmp_path / "one" / "manifest.json")


def test_several_own_grabs_vary_within_a_dataset(files, tmp_path):
    values = [{"model": "mesh", "file": str(files[kind])} for kind in ("glb", "stl")] + [{"model": "four-rope"}]
    changes = {
        "vary": {"grab": {"dist": "one-of", "values": values}}, "clip.clip_frames": 1, "frames": 4, "swing.clamp": True,
        "place": {"model": "plain"},
    }  # fmt: skip
    scenario = scenes.load("quay-day", changes, size=(320, 180))
    assert [model.name for model in scenario.models] == ["a.glb", "a.stl"]
    render(scenario, tmp_path / "out", workers=1)
    assert len(list((tmp_path / "out" / "grabs").iterdir())) == 2
    assert not audit(tmp_path / "out").findings


def test_what_a_file_is_now_must_be_what_it_was(tmp_path):
    path = tmp_path / "a.stl"
    trimesh.creation.box((1.9, 2, 2)).export(path)
    scene = tmp_path / "scene.toml"
    scene.write_text(f'[grab]\nmodel = "mesh"\nfile = "a.stl"\nsha256 = "{"0" * 64}"', "utf-8")
    with pytest.raises(ScenarioError, match="different content"):
        scenes.load(scene)
    keys = Mesh.of(path)
    path.unlink()  # what was read is kept
    assert design_of(keys).bodies[0].steel.volume == pytest.approx(1.9 * 4)
    with pytest.raises(ScenarioError, match="not known here"):
        design_of(replace(keys, sha256="0" * 64))


def test_no_table_opens_a_file_by_itself(tmp_path):
    """A stranger's scene may hold any table, wherever tables may be."""
    (tmp_path / "own").mkdir()
    for path in (tmp_path / "secret.stl", tmp_path / "own" / "a.stl"):
        trimesh.creation.box((2, 2, 2)).export(path)
    secret = str(tmp_path / "secret.stl")
    with pytest.raises(ScenarioError, match=r"is read by simgrab\.load"):
        Mesh(file=secret)
    scene, head = (
        tmp_path / "own" / "scene.toml",
        'clip = { clip_frames = 1 }\n[grab]\nmodel = "mesh"\nfile = "a.stl"\n',
    )
    for text, said in (
        (f'[vary.grab]\ndist = "one-of"\nvalues = [{{ file = "{secret}", sha256 = "" }}]', r"is read by simgrab\.load"),
        (f'[vary.grab]\ndist = "one-of"\nvalues = [{{ model = "mesh", file = "{secret}" }}]', "outside of"),
        (f'[vary."grab.file"]\ndist = "one-of"\nvalues = ["{secret}"]', "varies with its table"),
        (f'[vary."grab.file+grab.scale"]\ndist = "one-of"\nvalues = [{{ "grab.file" = "{secret}", "grab.scale" = 1 }}]',
         "varies with its table"),
    ):  # fmt: skip
        scene.write_text(head + text, "utf-8")
        with pytest.raises(ScenarioError, match=said):
            scenes.load(scene, within=tmp_path / "own")


def test_equal_files_of_two_names_keep_their_names(files, tmp_path):
    for name in ("a.stl", "z.stl"):
        (tmp_path / name).write_bytes(files["stl"].read_bytes())
    first, _ = map(with_grab, [tmp_path / name for name in ("a.stl", "z.stl")])
    render(first, tmp_path / "out", workers=1)
    assert scenes.load(tmp_path / "out" / "manifest.json").grab.file == "a.stl"


def test_another_process_and_machine_know_the_model(files, tmp_path):
    path = tmp_path / "a.stl"
    path.write_bytes(files["stl"].read_bytes())
    values = [{"model": "mesh", "file": str(file)} for file in (path, files["obj"])]
    changes = {"vary": {"grab": {"dist": "one-of", "values": values}}, "clip.clip_frames": 1}
    scenario = scenes.load("quay-day", changes)
    sent = pickle.dumps(scenario)
    path.unlink()
    models._known.clear()
    received = pickle.loads(sent)
    assert received == scenario
    assert [one.name for one in received.models] == ["a.stl", "a.obj"]


def with_grab(file):
    changes = {"grab": {"model": "mesh", "file": str(file)}, "frames": 2, "swing.clamp": True, "place.model": "plain"}
    return scenes.load("quay-day", changes, size=(320, 180))


@pytest.fixture(scope="module")
def sharded(files, tmp_path_factory):
    scenario, url = with_grab(files["obj"]), tmp_path_factory.mktemp("data").as_uri() + "/shards"
    render(scenario, url, workers=1)
    return scenario, url


@pytest.mark.parametrize("kind", ["yolo", "simgrab", "webdataset"])
def test_exports_and_shards_keep_the_copy(sharded, tmp_path, kind):
    scenario, url = sharded
    models._known.clear()
    export(url, f"file://{tmp_path}/out", format=kind)
    models._known.clear()
    found = simgrab.open(tmp_path / "out") if kind == "simgrab" else simgrab.open(url)
    assert found.scenario.models[0].sha256 == scenario.grab.sha256
    models._known.clear()
    again = scenes.load(tmp_path / "out" / "manifest.json")
    assert again.models[0].files == scenario.models[0].files
    card = (tmp_path / "out" / "README.md").read_text()
    assert "license: other\n" in card
    assert again.models[0].name in card


def test_a_video_keeps_the_copy(files, tmp_path):
    simgrab.render_video(with_grab(files["glb"]), tmp_path / "a.mp4", workers=1)
    models._known.clear()
    assert scenes.load(tmp_path / "a.manifest.json").models[0].name == "a.glb"


# What is wrong with a file, and what is said of it.


def box_stl(first: float = 1.0) -> bytes:
    """A box, of whose first vertex a coordinate is given."""
    data = bytearray(trimesh.creation.box((2, 2, 2)).export(file_type="stl"))
    struct.pack_into("<f", data, 96, first)
    return bytes(data)


def png_bomb() -> bytes:
    """A PNG of 30,000 × 30,000 px in few bytes."""
    file = io.BytesIO()
    Image.new("1", (30_000, 30_000)).save(file, "png")
    return file.getvalue()


def textured(picture: bytes) -> bytes:
    return Gltf().texture(picture).material(**base_colour()).glb()


def tetra(count: int = 3, **content: object) -> bytes:
    """A glTF file whose buffer is not there."""
    made = Gltf()
    made.content["accessors"][0]["count"] = made.content["accessors"][1]["count"] = count
    return json.dumps(made.content | content).encode()


def web(uri: str) -> bytes:
    return tetra(buffers=[{"byteLength": 36, "uri": uri}])


EMPTY = {"attributes": {"POSITION": 0}}
HOSTILE = {
    "empty.glb": (b"", "not a GLB file"),
    "truncated.glb": (trimesh.exchange.gltf.export_glb(y_up(tongs()))[:900], "truncated"),
    "cut.glb": (trimesh.exchange.gltf.export_glb(y_up(tongs()))[:-400], "truncated"),
    "truncated.stl": (box_stl()[:-30], "truncated"),
    "nan.stl": (box_stl(float("nan")), "not finite"),
    "infinite.stl": (box_stl(float("inf")), "not finite"),
    "far.stl": (box_stl(1e30), "check scale"),
    "flat.stl": (trimesh.Trimesh([(0, 0, 0), (1, 0, 0), (2, 0, 0)], [(0, 1, 2)], process=False).export(file_type="stl"),
                 "shows no triangles"),
    "counted.stl": (bytes(80) + struct.pack("<I", 10_000_000) + bytes(50), "truncated"),
    "many.stl": (bytes(80) + struct.pack("<I", 600_000) + bytes(50 * 600_000), "600000 triangles"),
    "counted.ply": (b"ply\nformat binary_little_endian 1.0\nelement vertex 10000000000\nproperty float x\n"
                    b"element face 3\nproperty list uchar int vertex_indices\nend_header\n",
                    "states 10000000000 vertices"),
    "words.ply": (b"ply\nformat ascii 1.0\nelement vertex many\nend_header\n", "number of elements"),
    "truncated.ply": (tongs().to_mesh().export(file_type="ply")[:700], "truncated"),
    "many.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"f 1 2 3\n" * 3_000_000, "3000000 triangles"),
    "lines.obj": (b"ab\n" * 5_000_000, "lines"),
    "large.obj": (bytes(70_000_000), "64"),
    "outside.obj": (b"mtllib ../../etc/passwd\nv 0 0 0\nv 1 0 0\nv 0 1 1\nf 1 2 3\n", "outside its folder"),
    "absolute.obj": (b"mtllib /etc/passwd\nv 0 0 0\nv 1 0 0\nv 0 1 1\nf 1 2 3\n", "outside its folder"),
    "web.gltf": (web("https://example.org/a.bin"), "not a file of its folder"),
    "passwd.gltf": (web("..%2f..%2fetc/passwd"), "outside its folder"),
    "deep.gltf": (b"[" * 200_000, "not valid JSON"),
    "crowd.gltf": (tetra(900_000, nodes=[{"mesh": 0}] * 1000), "300000000 triangles"),
    "empty.gltf": (tetra(0, nodes=[{"mesh": 0}] * 1000, meshes=[{"primitives": [EMPTY] * 2000}]), "states 2000000"),
    "counted.gltf": (tetra(10**12), "triangles or more"),
    "minus.gltf": (tetra(-3), "number of elements"),
    "bomb.glb": (lambda: textured(png_bomb()), "texture|px"),
    "notapicture.glb": (textured(b"\x89PNG\r\n\x1a\n" + bytes(40)), "texture cannot be read"),
    "grab.fbx": (b"Kaydara", "must end in one of"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused_in_one_line_within_memory(name, tmp_path):
    data, said = HOSTILE[name]
    (tmp_path / name).write_bytes(data() if callable(data) else data)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ScenarioError, match=said) as caught:
        design_of(Mesh.of(tmp_path / name))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1_000_000  # KiB


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"rope_ends_m": ((0, 0, 2),)}, "1 points for 4 ropes"),
        ({"ropes": 1, "rope_ends_m": ((0, 0, -2),)}, "above the grab's centre"),
        ({"ropes": 1, "rope_ends_m": ((0, 0, 2400),)}, r"rope_ends_m: \(0, 0, 2400\) lies 23.* m from"),
        ({"jaws": ({"node": "HookLeft", "open_deg": 5, "hinge_m": (-900, 0, 1200)},)}, r"0\.hinge_m: .* in metres"),
        ({"ropes": 1, "rope_ends_m": ((0.5, 0, 2),), "centre_m": (0, 0, 0.5)}, "0.50 m beside"),
        ({"jaws": ({"node": "Hook", "open_deg": 5},)}, "no node 'Hook'; it has 'Beam', 'HookLeft'"),
        ({"jaws": ({"node": "HookLeft"},)}, "either open_deg or stroke_m"),
        ({"jaws": ({"node": "HookLeft", "stroke_m": 0.3},)}, "at least one jaw needs open_deg"),
        ({"jaws": ({"node": "HookLeft", "open_deg": 5, "axis": (0, 0, 0)},)}, "must be a direction"),
        (
            {"jaws": tuple({"node": n, "open_deg": 5} for n in ("Beam", "HookLeft", "HookRight"))},
            "every part belongs to a jaw",
        ),
        ({"jaws": ({"node": "HookLeft", "open_deg": 5},) * 2}, "the same node"),
        ({"lips_m": ((0, 0, 0),) * 5}, "length"),
        ({"scale": 1000.0}, r"grab\.scale: .*2\.4e\+03 × 600.*it would fit in metres \(scale = 1\)"),
    ],
)  # fmt: skip
def test_what_cannot_be_together_is_refused(files, keys, said):
    with pytest.raises(ScenarioError, match=said):
        design_of(scenes.load("quay-day", {"grab": {"model": "mesh", "file": str(files["glb"]), **keys}}).grab)


def test_the_check_shows_what_was_understood_and_what_may_be_wrong(files, tmp_path):
    status, *printed = run("grab", "check", files["glb"], "--out", tmp_path / "out")
    assert status == 0
    assert "HookLeft" in "".join(printed)
    assert "no keypoints" in "".join(printed)
    page = (tmp_path / "out" / own_grab.PAGE).read_text(encoding="utf-8")
    assert "data:image/jpeg" in page
    picture = np.asarray(Image.open(tmp_path / "out" / own_grab.PICTURE))
    yellow = np.abs(picture.astype(float) @ [1, -1.28, 0]).clip(0, 255) < 30
    assert (yellow & (picture[..., 2] < 90) & (picture[..., 0] > 120)).mean() > 0.01


def test_the_tines_of_the_docs_open_outwards(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "grabs.md").read_text(encoding="utf-8")
    (text,) = (block for block in re.findall(r"```toml\n(.*?)```", page, re.DOTALL) if "Tine1" in block)
    scene = boxes(("Head", (1.2, 1.2, 0.8), (0, 0, 2.4)))
    for jaw in tomllib.loads(text)["grab"]["jaws"]:
        tine = trimesh.creation.cylinder(0.1, segment=[jaw["hinge_m"], *jaw["lips_m"]])
        scene.add_geometry(tine, jaw["node"], jaw["node"])
    y_up(scene).export(tmp_path / "our-tines.glb")
    (tmp_path / "tines.toml").write_text(text)
    assert not re.search("inwards|lips_m|hinge|vertical", " ".join(checked(tmp_path / "tines.toml").doubts))


def test_the_check_names_the_grab_whose_page_it_replaces(files, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first, second = (run("grab", "check", files[kind])[1].splitlines()[-1] for kind in ("stl", "ply"))
    assert first == "page: a-check/grab.html"
    assert second == "page: a-check/grab.html, in place of that of a.stl"


@pytest.mark.parametrize(
    ("left", "doubt"),
    [
        ({}, ""),
        ({"open_deg": -20.0}, "lower end of 'HookLeft' moves inwards as it opens"),
        ({"hinge_m": (-4.0, 0.0, 1.2)}, r"hinge of 'HookLeft' lies 3\.0. m from its own steel"),
        ({"hinge_m": (0.0, 0.0, 1.4)}, r"hinge of 'HookLeft' lies 0\.8. m from its own steel"),  # in the beam
        ({"hinge_m": (-0.9, 9.0, 1.3)}, ""),  # on the same axis, a little higher
        ({"axis": (0.0, 0.0, 1.0)}, "axis of 'HookLeft', .*, is vertical"),
        ({"axis": (0.0, 0.0, -1.0)}, "axis of 'HookLeft', .*, is vertical"),
        ({"lips_m": ((-0.8, 0.2, 0.0), (-0.4, 0.2, 0.1))}, r"lips_m of 'HookLeft' lies 0\.40 m from its steel"),
    ],
)
def test_the_check_doubts_jaws_that_close_as_they_open_and_what_lies_in_the_air(files, left, doubt):
    jaws = [msgspec.to_builtins(jaw) for jaw in (replace(JAWS[0], **left), JAWS[1])]
    doubts = " ".join(checked(files["glb"], {"grab.jaws": jaws, "swing.clamp": True}).doubts)
    about_jaws = re.findall("inwards|hinge|vertical|point of lips_m|apart|touches", doubts)
    assert re.search(doubt, doubts) and len(set(about_jaws)) == 1 if doubt else not about_jaws


@pytest.mark.parametrize("stated", [False, True])
def test_the_check_doubts_assumed_rope_ends_beside_the_steel(tmp_path, stated):
    """Stated ones may be the middle of a ring."""
    boxes(("Head", (1, 1, 0.1), (0, 0, 0)), ("Mast", (0.1, 0.1, 1), (0, 0, 0.5))).export(tmp_path / "a.glb")
    ends = [(x, y, 1.0) for x, y in ((0.1, 0.175), (-0.1, 0.175), (-0.1, -0.175), (0.1, -0.175))]
    doubts = checked(tmp_path / "a.glb", {"grab.up": "z"} | ({"grab.rope_ends_m": ends} if stated else {})).doubts
    assert any("Ropes end up to 0.13 m from any steel: give rope_ends_m" in doubt for doubt in doubts) != stated


@pytest.mark.parametrize("shown_open", [False, True])
@pytest.mark.parametrize("grab", [Clamshell(), OrangePeel(), OrangePeel(tines=3, shells="open"), Scissors()])
def test_the_check_doubts_a_file_that_shows_the_grab_open(tmp_path, grab, shown_open):
    """Bundled grabs as files: closed, they are sound."""
    made = design_of(grab)
    closed, opened = made.frames(0.0), made.frames(made.max_jaw)
    scene, jaws = trimesh.Scene(), []
    for body in made.bodies:
        pose = (opened if shown_open else closed)[body.name]
        scene.add_geometry(body.steel, node_name=body.name, transform=pose)
        if body.name.startswith(("shell", "tine")):
            turn = Rotation.from_matrix((opened[body.name] @ np.linalg.inv(closed[body.name]))[:3, :3])
            degrees = float(np.degrees(turn.as_rotvec() @ body.axis))
            jaws.append({"node": body.name, "hinge_m": pose[:3, 3].tolist(), "axis": body.axis, "open_deg": degrees})
    scene.export(tmp_path / "a.glb")
    ends = {"grab.ropes": len(made.terminations), "grab.rope_ends_m": made.terminations.tolist()}
    changes = ends | {"grab.up": "z", "grab.jaws": jaws, "swing.clamp": True}
    doubts = " ".join(checked(tmp_path / "a.glb", changes).doubts)
    assert ("does the file show the grab open" in doubts) == shown_open
    assert not re.search("hinge|vertical|inwards|touches", doubts)


@pytest.mark.parametrize("kind", ["glb", "stl"])
@pytest.mark.parametrize("away", [0.0, 0.15, 0.5, 2.5, 7.0, 40.0])
def test_steel_that_touches_nothing_is_named(tmp_path, kind, away):
    """A block beside the tongs, as a node or among the triangles of all."""
    scene = tongs()
    block = translation_matrix((1.3 + away, 0, 1.4))
    scene.add_geometry(trimesh.creation.box((0.2, 0.2, 0.2)), node_name="Mass_1", transform=block)
    (scene if kind == "glb" else scene.to_mesh()).export(tmp_path / f"a.{kind}")
    node = "'Mass_1'" if kind == "glb" else "a part of '.*'"
    said = rf"^(grab.file: )?{node} at \({1.3 + away:.2f}, 0.00, 1.40\) m touches nothing.* {away:.2f} m away"
    try:
        scene = own_grab.scene_of(tmp_path / f"a.{kind}", {"grab.up": "z"})
        found = own_grab.check(scene).doubts
        assert found[0] in own_grab.remarks(scene.grab) or away < 0.25
    except ScenarioError as refusal:
        found = [str(refusal)]
        assert found[0].endswith("would be 42.6 × 0.6 × 1.6 m with it, and 2.4 × 0.6 × 1.6 m without")
    assert bool(re.search(said, found[0])) == (away > 0.25)
    assert (away == 40.0) == found[0].startswith("grab.file")


def test_a_long_thin_bar_is_one_piece_and_hostile_crowds_are_quick():
    rng = np.random.default_rng(0)
    bar = trimesh.creation.box((1e-4, 1e-4, 9.0)).triangles
    plate = trimesh.creation.box((9.0, 9.0, 0.01)).triangles + [0, 0, 4.5]
    assert loose([("bar", bar), ("plate", plate)], np.zeros(3))[0] == []
    crowd = 10 ** rng.uniform(-2, 7, (100_000, 1, 1)) * rng.normal(size=(100_000, 1, 3)) + rng.normal(size=(1, 3, 3))
    start = time.process_time()
    assert len(loose([("crowd", crowd)], np.zeros(3))[0]) <= 24
    assert time.process_time() - start < 20


@pytest.mark.parametrize("hollow", [False, True])
def test_the_check_doubts_a_solid_piece_that_has_most_of_the_mass(tmp_path, hollow):
    scene = boxes(("Head", (1, 1, 1.5), (0, 0, 2)), ("Plate", (2.5, 1, 0.1), (0, 0, 0)))
    if hollow:
        scene.geometry["Head"].update_faces(np.arange(12) > 0)
    scene.export(tmp_path / "a.glb")
    found = checked(tmp_path / "a.glb", {"grab.up": "z"})
    assert ("of Head, 1.00 × 1.00 × 1.50 m, is taken as solid steel, 86%" in " ".join(found.doubts)) != hollow
    assert dict(found.facts)["hangs as"].startswith("one-body")


def test_the_check_says_how_many_nodes_it_does_not_list(tmp_path):
    boxes(*((f"N{i:02d}", (1, 1, 0.1), (0, 0, i / 8)) for i in range(23))).export(tmp_path / "many.glb")
    nodes = dict(checked(tmp_path / "many.glb", {"grab.up": "z"}).facts)["nodes"]
    assert nodes == ", ".join(f"N{i:02d}" for i in range(20)) + ", and 3 more"


def test_the_check_gives_points_as_keys_take_them_and_every_node_that_a_jaw_can_name(tmp_path):
    """What is printed can be given again: nothing moves."""
    low = [("Rod", (1, 0.6, 1), (0, -0.2, 0), "Jaw"), ("Shell", (1, 0.6, 1), (0, -0.8, 0), "Jaw")]
    scene = boxes(("Head", (1, 1, 1), (0.2, 3, 0)), *low)
    scene.graph.update(frame_from="world", frame_to="Jaw", matrix=translation_matrix((0.2, 2, 0)))
    scene.export(tmp_path / "a.glb")
    found = dict(checked(tmp_path / "a.glb").facts)
    assert found["nodes"] == "Jaw (Rod, Shell), Head, Rod, Shell"
    ends = json.loads(re.search(r"rope_ends_m = (\[\[.*?\]\])", found["ropes"])[1])
    assert np.mean(ends, axis=0) == pytest.approx((0.2, 0.0, 3.5), abs=2e-3)
    assert dict(checked(tmp_path / "a.glb", {"grab.rope_ends_m": ends}).facts)["centre A"] == found["centre A"]


def test_the_check_doubts_what_lies_on_its_side_or_has_an_implausible_size(tmp_path):
    trimesh.creation.box((3.0, 3.0, 0.5)).export(tmp_path / "a.stl")
    assert any("check up" in doubt for doubt in checked(tmp_path / "a.stl").doubts)
    aside = trimesh.util.concatenate([trimesh.creation.box((3, 1, 0.2)), trimesh.creation.box((0.5, 1, 2))])
    aside.vertices[8:, 0] += 1.2
    aside.export(tmp_path / "b.stl")
    askew = checked(tmp_path / "b.stl", {"grab.scale": 0.3}).doubts
    assert any("hang askew" in doubt for doubt in askew)
    large = own_grab.remarks(own_grab.scene_of(tmp_path / "b.stl", {"grab.scale": 3.0}).grab)
    assert all(any("check scale" in doubt for doubt in doubts) for doubts in (askew, large))


def test_render_states_size_and_which_axis_seems_to_point_up(tmp_path):
    body = trimesh.util.concatenate([trimesh.creation.box((2.4, 2.0, 0.6)), trimesh.creation.box((0.5, 0.5, 1.6))])
    body.vertices[8:, 2] += 1.1
    body.export(tmp_path / "a.glb")
    command = ["render", "--frames=1", "--size=160x90", "--set=place.model=plain", f"--out={tmp_path / 'out'}"]
    status, _, noted = run(*command, "--set", f"grab={{model='mesh', file='{tmp_path / 'a.glb'}'}}")
    assert status == 0
    assert "grab.file: z seems to point up" in noted
    assert "grab.file: taken as 2.40 × 2.20 × 2.00 m (x, y, z up), with grab.scale = 1\n" in noted


def test_a_grab_from_a_file_holds_no_load(files):
    mesh = {"model": "mesh", "file": str(files["glb"])}
    hang = {"grab": mesh, "swing": {"model": "dynamic", "work": {"model": "hang", "load": 0.5}}}
    with pytest.raises(ScenarioError, match=r"swing.work.load: must be 0, as a grab from a file holds no load"):
        scenes.load("quay-day", hang)
    work = scenes.load("work-cycles", {"grab": mesh})
    (line,) = (line for line in notices(Recipe(work)) if "load" in line)
    assert "holds no load: its mass is grab.mass_kg" in line
