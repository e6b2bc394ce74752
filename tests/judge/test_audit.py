"""An audit fails, and names what is wrong, whatever is altered; and it sees faults planted in the code itself."""

import hashlib
import json
import shutil

import cv2
import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from conftest import altered, slow_but, small_scene
from seconds import SECOND_RENDERERS

import simgrab
from simgrab.dataset import datasets, manifest
from simgrab.dataset.export import export
from simgrab.dataset.render import render
from simgrab.errors import DatasetError
from simgrab.judge.audit import identities
from simgrab.judge.audit.audit import audit
from simgrab.judge.audit.proof import Proof
from simgrab.judge.audit.second_renderer import choice, install_hint
from simgrab.model import geometry
from simgrab.model.scenario import DoublePendulum, FourRopes, OneBody
from simgrab.model.truth import columns
from simgrab.world.camera.renderer import Renderer
from simgrab.world.frames import FrameGenerator
from simgrab.world.trajectory.hanging import hung
from simgrab.world.trajectory.moment import GrabState


@pytest.fixture(params=SECOND_RENDERERS)
def second_renderer(request, monkeypatch):
    """Audits in this test have this second renderer alone."""
    monkeypatch.setattr(choice, "RENDERERS", (request.param,))
    return request.param


@pytest.mark.parametrize("name", slow_but(["dataset", "crooked_dataset"], "crooked_dataset"))
def test_a_fresh_dataset_passes(name, second_renderer, request):
    report = audit(request.getfixturevalue(name))
    assert report.status == "passed", report.findings
    assert all(proof.checked for proof in report.proofs)
    assert second_renderer.package in report.proofs[-1].renderer
    assert report.proofs[-1].note.endswith(report.proofs[-1].renderer)
    assert not any(proof.renderer for proof in report.proofs[:-1])


def alter(path, column, frame):
    """Change one cell a little and write the table back with its metadata."""
    table = pq.read_table(path / "labels.parquet")
    rows = table.to_pylist()
    match rows[frame][column]:
        case None:
            value = "2000" if pa.types.is_string(table.schema.field(column).type) else 1
        case str(text):
            value = "test" if text in ("train", "val") else text[::-1] or "2000"
        case [first, *others]:
            value = [first + 1e-3, *others]
        case bool(flag):
            value = not flag
        case number:
            value = number + (1 if isinstance(number, int) else 1e-3)
    rows[frame][column] = value
    pq.write_table(pa.Table.from_pylist(rows, schema=table.schema), path / "labels.parquet")


@pytest.fixture
def drawn_once(scene, monkeypatch):
    """Audits in this test share one generator, which draws each frame once."""
    made = {}

    class Once(FrameGenerator):
        def frame(self, frame, **options):
            if frame not in made:
                made[frame] = super().frame(frame, **options)
            return made[frame]

        def __exit__(self, *_):
            pass

    generator = Once(scene)
    monkeypatch.setattr("simgrab.judge.audit.audit.FrameGenerator", lambda _: generator)
    monkeypatch.setattr("simgrab.judge.audit.silhouettes.compare", lambda *_: Proof("not drawn here", 1))
    yield
    generator.close()


@pytest.mark.usefixtures("drawn_once")
def test_every_altered_column_is_named(copy):
    """One altered cell, in every column in turn: a finding names frame and column."""
    original = (copy / "labels.parquet").read_bytes()
    for column in columns():
        alter(copy, column, 2)
        report = audit(copy)
        assert report.status == "failed", column
        where = [f.where for f in report.findings]
        assert any(w.endswith(column) and (column == "frame" or "frame 2" in w) for w in where), (column, where)
        (copy / "labels.parquet").write_bytes(original)


@pytest.mark.usefixtures("drawn_once")
def test_pictures_and_labels_that_no_row_knows_are_named(copy):
    file = next((copy / "images").rglob("*.jpg"))
    shutil.copy(file, file.with_name("000900.jpg"))
    (copy / "labels" / "train" / "000900.txt").write_text("0 0.5 0.5 0.9 0.9")
    named = [f.where for f in audit(copy).findings]
    assert str(file.with_name("000900.jpg").relative_to(copy)) in named
    assert "labels/train/000900.txt" in named


@pytest.mark.usefixtures("drawn_once")
@pytest.mark.parametrize(("column", "value"), [("amodal_x0_px", None), ("jaw_deg", 100.0), ("load", 1e9)])
def test_gross_values_are_findings_too(copy, column, value):
    altered(copy, column, lambda values: [*values[:2], value, *values[3:]])
    report = audit(copy)
    assert report.status == "failed"
    assert any(f.where == f"frame 2, {column}" for f in report.findings)


@pytest.mark.usefixtures("drawn_once")
def test_altered_pictures_are_named(copy):
    file = next((copy / "images").rglob("*.jpg"))
    picture = cv2.imread(str(file))
    picture[10:20, 10:20] = 0
    cv2.imwrite(str(file), picture)
    other = sorted((copy / "images").rglob("*.jpg"))[-1]
    other.unlink()
    findings = [str(f) for f in audit(copy).findings]
    assert any(str(file.relative_to(copy)) in f for f in findings)
    assert any(str(other.relative_to(copy)) in f and "missing" in f for f in findings)


@pytest.mark.usefixtures("drawn_once")
def test_every_altered_manifest_field_is_named(copy):
    def leaves(node, path=()):
        if isinstance(node, dict):
            for key, value in node.items():
                yield from leaves(value, (*path, key))
        else:
            yield path

    known = json.loads((copy / "manifest.json").read_text())
    for leaf in leaves(known):
        if leaf[0] == "scenario" and leaf[-1] not in ("beta_deg", "seed", "name", "sigma_deg"):
            continue  # the others go the same way; some alterations make no scenario at all
        changed = json.loads(json.dumps(known))
        node = changed
        for key in leaf[:-1]:
            node = node[key]
        node[leaf[-1]] = node[leaf[-1]] + 1 if isinstance(node[leaf[-1]], int | float) else "altered"
        (copy / "manifest.json").write_text(json.dumps(changed))
        report = audit(copy)
        assert report.status == "failed", leaf
        named = [f.where for f in report.findings]
        assert any(leaf[0] in w or leaf[-1] in w for w in named), (leaf, named)


@pytest.mark.usefixtures("drawn_once")
@pytest.mark.parametrize(
    "kind",
    ["data.yaml", "labels/**/*.txt", "annotations/instances_train.json", "images/train/metadata.csv", "preview.jpg",
     "camera.toml"],
)  # fmt: skip
def test_altered_exports_are_named(copy, kind):
    target = next(copy.glob(kind))
    target.write_bytes(target.read_bytes() + b"\n0 0.5 0.5 0.1 0.1")
    findings = [str(f) for f in audit(copy).findings]
    assert any(target.name in f for f in findings), findings


METADATA = "images/train/metadata.csv"


def list_again(path, change):
    """Change the files that a manifest lists, and its digest with them."""
    known = json.loads((path / "manifest.json").read_text())
    known["files"] = change(known["files"])
    known["manifest_digest"] = manifest.digest(known)
    (path / "manifest.json").write_text(json.dumps(known))


@pytest.mark.usefixtures("drawn_once")
def test_altered_metadata_is_named_by_frame_whatever_the_manifest_holds(copy):
    """By its digest alone a file that was altered together with the manifest would pass."""
    target = copy / METADATA
    lines = target.read_text().splitlines(keepends=True)
    lines[2] = lines[2].replace("True", "False", 1)
    target.write_text("".join(lines))
    list_again(copy, lambda files: {**files, METADATA: hashlib.sha256(target.read_bytes()).hexdigest()})
    frame = int(lines[2].split(".")[0])
    assert [f.where for f in audit(copy).findings] == [f"frame {frame}, {METADATA}"]


@pytest.mark.usefixtures("drawn_once")
def test_metadata_that_the_manifest_does_not_list_is_refused(copy):
    list_again(copy, lambda files: {name: digest for name, digest in files.items() if name != METADATA})
    assert [f.where for f in audit(copy).findings] == ["manifest.json, files"]


def test_without_a_second_renderer_the_audit_is_incomplete(dataset, monkeypatch):
    monkeypatch.setattr(choice, "RENDERERS", ())
    report = audit(dataset)
    assert report.status == "incomplete"
    assert report.proofs[-1].status == "not made"
    assert report.proofs[-1].note == f"no second renderer is installed; {install_hint()}"
    assert not report.proofs[-1].renderer


def test_half_a_dataset_is_not_audited(tmp_path, copy):
    with pytest.raises(DatasetError, match="no simgrab dataset"):
        audit(tmp_path / "nothing")
    (copy / "manifest.json").unlink()
    (copy / ".partial").mkdir()
    with pytest.raises(DatasetError, match="unfinished"):
        audit(copy)


SLANTED = {"camera__tilt_azimuth_deg": 40.0, "camera__beta_deg": 6.0, "swing__alpha__sigma_deg": 6.0, "frames": 2}


def planted(monkeypatch, tmp_path, target, fault, **changes):
    """Render and audit with the same faulty code, and return which proofs failed."""
    monkeypatch.setattr(target, fault)
    render(small_scene(**SLANTED, **changes), tmp_path / "planted")
    report = audit(tmp_path / "planted")
    return {proof.claim: proof.findings for proof in report.proofs if proof.status == "failed"}


def test_a_wrong_sign_of_gamma_is_caught(monkeypatch, tmp_path):
    right = geometry.grab_centre
    failed = planted(monkeypatch, tmp_path, "simgrab.model.geometry.grab_centre", lambda a, phi, r: right(a, -phi, r))
    assert "poses agree with angles, rope length and offset" in failed


@pytest.mark.slow
def test_a_swapped_tilt_axis_is_caught(monkeypatch, tmp_path):
    right = geometry.camera_rotation
    failed = planted(
        monkeypatch, tmp_path, "simgrab.model.geometry.camera_rotation",
        lambda beta, azimuth, roll: right(beta, np.pi / 2 - np.asarray(azimuth), roll),
    )  # fmt: skip
    assert {
        "eqs (1) and (2) of the paper hold, seen from the camera",
        "poses agree with angles, rope length and offset",
    } <= set(failed)


@pytest.mark.usefixtures("second_renderer")
def test_a_half_pixel_shift_of_the_labels_is_caught(monkeypatch, tmp_path):
    right = geometry.Intrinsics._to_pixels
    failed = planted(
        monkeypatch, tmp_path, "simgrab.model.geometry.Intrinsics._to_pixels", lambda self, xy: right(self, xy) + 0.5
    )
    assert "the grab centre lies where an independent projection puts it" in failed
    assert "a second renderer renders the same silhouette" in failed


@pytest.mark.slow
@pytest.mark.usefixtures("second_renderer")
def test_a_half_pixel_shift_of_the_picture_is_caught(monkeypatch, tmp_path):
    right = Renderer.aim

    def shifted(self, window, scene, finer=1):
        rect = right(self, window, scene, finer)
        for eye in scene.camera:
            eye.frustum_center += 0.5 * eye.frustum_near / self.intrinsics.f_px
        return rect

    failed = planted(monkeypatch, tmp_path, "simgrab.world.camera.renderer.Renderer.aim", shifted)
    assert list(failed) == ["a second renderer renders the same silhouette"]


def test_identities_refuse_small_errors(dataset):
    rows = datasets.read(dataset).rows
    assert identities.paper_identities(rows).status == "passed"

    def poses(rows):
        return identities.poses(rows, lambda _: (OneBody(), 0.0))

    for column, error, proof in (
        ("theta_deg", 1e-3, identities.paper_identities),
        ("m_px", 1e-4, identities.paper_identities),
        ("grab_u_px", 1e-5, identities.projections),
        ("ideal_v_px", 1e-5, identities.projections),
        ("yaw_deg", 1e-6, poses),
        ("roll_deg", 1e-6, poses),
    ):
        bent = [msgspec.structs.replace(r, **{column: getattr(r, column) + error}) for r in rows]
        assert proof(bent).status == "failed", column


def test_poses_follow_the_suspension(dataset):
    """Rows whose heads lean by 0.2 of their ropes pass as such, fail as others, and pass where the head is free."""
    rows = []
    for row in datasets.read(dataset).rows:
        alpha, azimuth, yaw = np.radians((row.alpha_deg, row.gamma_deg + row.tilt_azimuth_deg, row.yaw_deg))
        state = hung(GrabState(alpha, azimuth, row.rope_length_m, yaw, 0.0, 0.0), FourRopes(tilt_ratio=0.2), 1.64)
        pose = tuple(np.asarray(state.jib_from_grab)[:3].ravel().tolist())
        rows.append(msgspec.structs.replace(row, jib_from_grab=pose))

    def status(suspension, rows=rows):
        return identities.poses(rows, lambda _: (suspension, 1.64)).status

    assert status(FourRopes(tilt_ratio=0.2)) == status(DoublePendulum()) == "passed"
    assert status(OneBody()) == status(FourRopes(tilt_ratio=0.21)) == "failed"
    turned = [msgspec.structs.replace(row, yaw_deg=row.yaw_deg + 1e-6) for row in rows]
    assert status(FourRopes(tilt_ratio=0.2), turned) == status(DoublePendulum(), turned) == "failed"


@pytest.mark.slow
def test_an_exported_part_passes_and_lacks_no_row(dataset, tmp_path):
    export(simgrab.open(dataset)[1:5:2], tmp_path / "part", format="simgrab", part=True)
    report = audit(tmp_path / "part")
    assert report.status == "passed", report.findings
    table = pq.read_table(tmp_path / "part" / "labels.parquet")
    pq.write_table(table.slice(1), tmp_path / "part" / "labels.parquet")
    assert any("missing" in finding.what for finding in audit(tmp_path / "part").findings)
