"""STEP files become GLB files."""

import importlib.util
import io

import numpy as np
import pytest
import trimesh
from commands import run

from simgrab.errors import ScenarioError
from simgrab.io import step
from simgrab.model.scenario import Mesh

pytest.importorskip("cascadio")


def step_file(mesh, unit):
    """Write a mesh as a faceted solid (ISO 10303-42) of a length unit, the prefix of a metre."""
    lines = []

    def add(text):
        lines.append(text)
        return f"#{len(lines)}"

    def listed(some):
        return f"({','.join(some)})"

    def at(kind, numbers):
        return add(f"{kind}('',({','.join(f'{x:.6f}' for x in numbers)}))")

    context = add("APPLICATION_CONTEXT('automotive design')")
    mechanical = add(f"PRODUCT_CONTEXT('',{context},'mechanical')")
    product = add(f"PRODUCT('Grab','Grab','',({mechanical}))")
    formation = add(f"PRODUCT_DEFINITION_FORMATION('','',{product})")
    design = add(f"PRODUCT_DEFINITION_CONTEXT('part definition',{context},'design')")
    definition = add(f"PRODUCT_DEFINITION('design','',{formation},{design})")
    shape = add(f"PRODUCT_DEFINITION_SHAPE('','',{definition})")
    length = add(f"(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT({unit},.METRE.))")
    angle = add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
    solid_angle = add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
    error = add(f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-05),{length},'','')")
    space = add(
        f"(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({error}))"
        f"GLOBAL_UNIT_ASSIGNED_CONTEXT({listed([length, angle, solid_angle])})REPRESENTATION_CONTEXT('',''))"
    )
    points = [at("CARTESIAN_POINT", vertex) for vertex in mesh.vertices]
    faces = []
    for face, normal in zip(mesh.faces, mesh.face_normals, strict=True):
        loop = add(f"POLY_LOOP('',{listed(points[i] for i in face)})")
        along = mesh.vertices[face[1]] - mesh.vertices[face[0]]
        axes = [at("DIRECTION", normal), at("DIRECTION", along / np.linalg.norm(along))]
        placed = add(f"AXIS2_PLACEMENT_3D('',{points[face[0]]},{axes[0]},{axes[1]})")
        plane, bound = add(f"PLANE('',{placed})"), add(f"FACE_OUTER_BOUND('',{loop},.T.)")
        faces.append(add(f"FACE_SURFACE('',({bound}),{plane},.T.)"))
    shell = add(f"CLOSED_SHELL('',{listed(faces)})")
    brep = add(f"FACETED_BREP('',{shell})")
    solid = add(f"FACETED_BREP_SHAPE_REPRESENTATION('',({brep}),{space})")
    add(f"SHAPE_DEFINITION_REPRESENTATION({shape},{solid})")
    head = (
        "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\n"
        "FILE_NAME('grab','2026-01-01T00:00:00',(''),(''),'','','');\n"
        "FILE_SCHEMA(('AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }'));\nENDSEC;\nDATA;\n"
    )
    body = "\n".join(f"#{number}={line};" for number, line in enumerate(lines, 1))
    return f"{head}{body}\nENDSEC;\nEND-ISO-10303-21;\n"


def refuse(problem):
    return ScenarioError("file", problem)


@pytest.fixture
def drawing(tmp_path):
    """A box of 2 x 1.5 x 3 m that stands on its origin, drawn in millimetres."""
    mesh = trimesh.creation.box((2000, 1500, 3000))
    mesh.apply_translation((0, 0, 1500))
    path = tmp_path / "our-grab.STEP"
    path.write_text(step_file(mesh, ".MILLI."))
    return path


def test_a_step_file_becomes_a_glb_in_metres_that_is_a_grab(drawing, tmp_path):
    target = tmp_path / "our-grab.glb"
    assert run("grab", "convert", drawing, "--out", target)[0] == 0
    scene = trimesh.load_scene(io.BytesIO(target.read_bytes()), file_type="glb")
    np.testing.assert_allclose(scene.bounds, [[-1, 0, -0.75], [1, 3, 0.75]], atol=1e-6)  # glTF has y up
    assert any("Grab" in name for name in scene.graph.nodes)
    from simgrab.world.scenery.grabs.from_file import from_file

    points = np.concatenate([part.mesh.vertices for body in from_file(Mesh.of(target)).bodies for part in body.parts])
    np.testing.assert_allclose(np.ptp(points, axis=0), [2, 1.5, 3], atol=1e-6)


def test_units_are_those_of_the_file(tmp_path):
    path = tmp_path / "a.stp"
    path.write_text(step_file(trimesh.creation.box((2, 1.5, 3)), "$"))
    scene = trimesh.load_scene(io.BytesIO(step.glb(path, refuse)), file_type="glb")
    np.testing.assert_allclose(scene.extents, [2, 3, 1.5], atol=1e-6)


def test_what_cannot_be_converted_is_refused_in_a_line(drawing, tmp_path):
    (tmp_path / "taken.glb").write_bytes(b"mine")
    assert "exists; choose another --out" in run("grab", "convert", drawing, "--out", tmp_path / "taken.glb")[2]
    assert (tmp_path / "taken.glb").read_bytes() == b"mine"
    whole = drawing.read_text()
    for content, message in (
        ("solid nothing", "is not a STEP file"), (whole[:3000], "is damaged"),
        (whole.replace("FACETED_BREP('',", "FACETED_BREP('',#999999,"), "shows no surface|is damaged"),
    ):  # fmt: skip
        drawing.write_text(content)
        with pytest.raises(ScenarioError, match=message):
            step.glb(drawing, refuse)
    with pytest.raises(ScenarioError, match="convert it by `simgrab grab convert`"):
        Mesh.of(drawing)


@pytest.mark.parametrize(("module", "name", "value", "message"), [
    (step, "MOST_SECONDS", 0.001, "takes longer than"),
    (step, "MOST_MEMORY", 2**20, "damaged, or too large"),
    (importlib.util, "find_spec", lambda _: None, r"simgrab\[step\]"),
])  # fmt: skip
def test_time_and_memory_are_limited(drawing, monkeypatch, module, name, value, message):
    monkeypatch.setattr(module, name, value)
    with pytest.raises(ScenarioError, match=message):
        step.glb(drawing, refuse)
