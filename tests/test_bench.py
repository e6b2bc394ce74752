"""Results of benchmarks: kept whole, compared, and taken of the same scene."""

import importlib
import itertools
import re
import sys

import cv2
import msgspec
import numpy as np
import pytest
from conftest import SMALL

from scripts import bench, bench_results, bench_world
from scripts.bench_compare import compare, ratio
from scripts.bench_measure import in_turns, milliseconds, ratios, single
from scripts.bench_renderers import RenderProcess, exported
from scripts.bench_results import Quantity, Results
from scripts.bench_scene import ExportedScene
from simgrab.errors import RendererError
from simgrab.model import scenes
from simgrab.world.frames import FrameGenerator
from simgrab.world.scenery.model import GRAB

FRAME = Quantity("frame", "ms", (130.0, 134.0, 150.0, 141.0))
RESULTS = Results(
    verb="render",
    options={"pairs": 4},
    commit="0" * 40,
    date="2026-11-24T02:00:00+00:00",
    machine={"cpu": "EPYC", "cores": "2"},
    versions={"mujoco": "4.0.0", "numpy": "2.4.6"},
    quantities=(FRAME, Quantity("memory", "MB", (300.0,)), Quantity("growth", "MB", (0.0, -1.0))),
)


def changed(**fields):
    return msgspec.structs.replace(RESULTS, **fields)


def scaled(quantity, factor):
    return msgspec.structs.replace(quantity, samples=tuple(factor * s for s in quantity.samples))


def test_a_file_holds_every_sample(tmp_path):
    RESULTS.save(tmp_path / "a.json")
    assert bench_results.load(tmp_path / "a.json") == RESULTS


def test_arrays_of_numbers_are_kept_too(tmp_path):
    seconds = np.array([0.25, 0.5])
    made = milliseconds("x", seconds), ratios("y", seconds, seconds[::-1]), single("z", np.float64(3.0), "MB")
    changed(quantities=made).save(tmp_path / "a.json")
    assert [q.samples for q in bench_results.load(tmp_path / "a.json").quantities] == [(250, 500), (0.5, 2), (3,)]


@pytest.mark.parametrize("verb", bench.VERBS)
def test_each_verb_is_a_function_of_its_name(verb):
    assert callable(getattr(importlib.import_module(f"scripts.bench_{verb}"), verb))


def test_a_verb_keeps_what_it_measured_and_on_what(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(bench_world, "world", lambda: iter([FRAME]))
    assert bench.main(["world", "--json", str(tmp_path / "new" / "a.json")]) == 0
    results = bench_results.load(tmp_path / "new" / "a.json")
    assert (results.verb, results.options, results.quantities) == ("world", {}, (FRAME,))
    assert {"cpu", "cores", "memory", "opengl", "system"} <= {key for key, value in results.machine.items() if value}
    assert {"python", "simgrab", "mujoco", "numpy", "opencv-python-headless"} <= results.versions.keys()
    assert re.fullmatch(r"[0-9a-f]{40}\+?|unknown", results.commit)
    assert "137.5 ms (median of 4" in capsys.readouterr().out


def test_the_ratio_is_that_of_medians_and_lies_in_its_interval():
    middle, low, high = ratio(FRAME, scaled(FRAME, 2.0))
    assert middle == pytest.approx(2.0)
    assert low < 2.0 < high
    backwards = ratio(scaled(FRAME, 2.0), FRAME)
    assert backwards[0] == pytest.approx(0.5)


def test_the_interval_holds_the_true_ratio_as_often_as_it_says():
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(200):
        one, other = (Quantity("x", "ms", tuple(s * np.exp(0.2 * rng.normal(size=25)))) for s in (100.0, 80.0))
        _, low, high = ratio(one, other)
        held += low <= 0.8 <= high
    assert 180 <= held <= 199  # 95 % of 200, and a percentile bootstrap of a median holds it a little too often


def test_the_comparison_states_ratio_spread_and_what_has_none():
    other = changed(quantities=(*(scaled(q, 0.5) for q in RESULTS.quantities), Quantity("peak", "MB", (1.0,))))
    lines = list(compare(RESULTS, other))
    (frame,), (memory,), (growth,) = ([x for x in lines if x.startswith(q.name)] for q in RESULTS.quantities)
    assert re.search(r"137\.5 +68\.75  0\.500 \(0\.\d{3}–0\.\d{3}; n = 4 and 4\)  ms", frame)
    assert "0.500 (no spread: one sample)" in memory
    assert "no ratio" in growth
    assert lines[-1] == "only in B: peak"
    assert not any("different" in line for line in lines)


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"machine": {"cpu": "Xeon", "cores": "2"}}, "different machines: cpu: EPYC in A, Xeon in B"),
        ({"versions": {"mujoco": "4.0.0"}}, "different versions: numpy: 2.4.6 in A, absent in B"),
        ({"options": {"pairs": 9}}, "different options: pairs: 4 in A, 9 in B"),
        ({"quantities": (msgspec.structs.replace(FRAME, by="Blender 5.0.1"),)},
         "different programs: frame:  in A, Blender 5.0.1 in B"),
    ],
)  # fmt: skip
def test_what_differs_between_the_runs_is_named(fields, expected):
    assert [line for line in compare(RESULTS, changed(**fields)) if "different" in line] == [expected]


BAD = {
    "no JSON": (lambda data: data[:40], "not valid JSON"),
    "a list": (lambda _: b"[]", "must be a table"),
    "no samples": (lambda data: data.replace(b"[300.0]", b"[]"), "quantities.1.samples"),
    "text for a sample": (lambda data: data.replace(b"300.0", b'"fast"'), "quantities.1.samples.0"),
    "no number": (lambda data: data.replace(b"300.0", b"NaN"), "must be a finite number"),
    "an unknown key": (lambda data: data.replace(b'"verb"', b'"work"'), "work"),
    "no machine": (lambda data: data.replace(b'"machine"', b'"MACHINE"'), "MACHINE"),
    "one quantity twice": (lambda data: data.replace(b'"memory"', b'"frame"'), "more than one 'frame'"),
    "in another unit": (lambda data: data.replace(b'"ms"', b'"s"'), "'frame' is in ms in A and in s in B"),
    "nothing in common": (lambda data: re.sub(rb'"name":"', b'"name":"x ', data), "nothing to compare"),
}


@pytest.mark.parametrize("bad", BAD)
def test_bad_files_are_refused_in_one_line(bad, tmp_path, capsys):
    spoil, expected = BAD[bad]
    a, b = tmp_path / "a.json", tmp_path / "b.json"
    RESULTS.save(a)
    b.write_bytes(spoil(msgspec.json.encode(RESULTS)))
    assert bench.main(["--compare", str(a), str(b)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert expected in line


def test_files_that_are_not_there_and_folders_are_refused(tmp_path, capsys):
    for path in (tmp_path, tmp_path / "none.json"):
        assert bench.main(["--compare", str(path), str(path)]) == 2
        assert str(path) in capsys.readouterr().err
    assert bench.main(["world", "--json", str(tmp_path)]) == 2


@pytest.mark.parametrize("arguments", [[], ["--compare", "a", "b", "world"], ["renderers", "--size", "big"],
                                       ["render", "--pairs", "0"]])  # fmt: skip
def test_arguments_without_a_meaning_are_refused(arguments, capsys):
    with pytest.raises(SystemExit, match="2"):
        bench.main(arguments)
    assert "error:" in capsys.readouterr().err


def test_acts_take_turns_and_warm_up_untimed():
    calls = []
    acts = {name: lambda item, name=name: calls.append((name, item)) for name in ("a", "b", "slow")}
    took = in_turns(acts, range(5), 2, {"slow": 1})
    turns = [(name, item) for item in range(5) for name in acts if name != "slow" or item == 2]
    assert calls == turns
    assert {name: len(seconds) for name, seconds in took.items()} == {"a": 3, "b": 3, "slow": 1}


@pytest.fixture(scope="module")
def made():
    """Export of three frames, the model, the frames, and the group of each geom in them."""
    with FrameGenerator(scenes.load("quay-day", SMALL)) as generator:
        scene = exported(generator, range(3))
        model = generator.scene(0).world.model
        made = [generator.frame(number) for number in range(3)]
        groups = []
        for number in range(3):
            generator.scene(number).renderer.pose(generator.project(number).moment)
            groups.append(model.geom_group.copy())
    return scene, model, made, groups


def test_an_export_keeps_every_triangle(made, tmp_path):
    scene, model, _, _ = made
    scene.save(tmp_path / "scene.npz")
    again = ExportedScene.load(tmp_path / "scene.npz")
    assert sum(len(again.mesh(geom)[1]) for geom in range(model.ngeom)) == model.mesh_facenum[model.geom_dataid].sum()
    for geom, mesh in itertools.islice(enumerate(model.geom_dataid), 0, None, 7):
        vertices, faces = again.mesh(geom)
        first, start, count = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
        expected = model.mesh_vert[first + model.mesh_face[start : start + count]]
        np.testing.assert_array_equal(vertices[faces][..., :3], expected)


def test_an_exported_grab_fills_the_box_of_the_labels(made):
    scene, _, frames, groups = made
    _, _, f, cx, cy = scene.camera
    for frame, (truth, group) in enumerate(zip((one.truth for one in frames), groups, strict=True)):
        points = [
            (scene.jib_from_geom[frame, geom] @ np.c_[v[:, :3], np.ones(len(v))].T)[:3].T
            for geom in np.flatnonzero(group == GRAB)
            for v in [scene.mesh(geom)[0]]
        ]
        assert scene.shown[frame, group == GRAB].all()
        pose = scene.jib_from_camera[frame]
        x, y, z = ((np.concatenate(points) - pose[:3, 3]) @ pose[:3, :3]).T
        u, v = f * x / z + cx, f * y / z + cy
        box = truth.amodal_x0_px, truth.amodal_y0_px, truth.amodal_x1_px, truth.amodal_y1_px
        np.testing.assert_allclose((u.min(), v.min(), u.max(), v.max()), box, atol=1.0)


def outlines(rgb):
    grey = cv2.GaussianBlur(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 1.0)
    return np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1))


def test_pyrender_shows_an_export_as_simgrab_shows_the_scene(made, tmp_path):
    pytest.importorskip("pyrender")
    scene, _, frames, _ = made
    scene.save(tmp_path / "scene.npz")
    with RenderProcess([sys.executable, "-m", "scripts.bench_pyrender", str(tmp_path / "scene.npz")]) as process:
        assert process.by.startswith("pyrender ")
        for number, frame in enumerate(frames):
            process.render(number)
            process.save(tmp_path / "picture.png")
            theirs = cv2.cvtColor(cv2.imread(str(tmp_path / "picture.png")), cv2.COLOR_BGR2RGB)
            (dx, dy), _ = cv2.phaseCorrelate(outlines(frame.rgb), outlines(theirs))
            assert np.hypot(dx, dy) < 0.5


def test_a_renderer_that_ends_is_reported_with_its_reason(tmp_path):
    with pytest.raises(RendererError, match=r"ended: no bpy here"):
        RenderProcess([sys.executable, "-c", "raise SystemExit('no bpy here')"])
    with pytest.raises(RendererError, match="cannot run"):
        RenderProcess([str(tmp_path / "python"), "-m", "scripts.bench_blender"])
