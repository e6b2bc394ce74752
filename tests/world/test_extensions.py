"""A user's own randomiser, trajectory and image effects."""

import hashlib
import importlib.metadata
import json
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from commands import run
from conftest import as_options, digests, small_scene
from world import user_functions
from world.user_functions import circle, invert, passing, speckle, sunny_or_grey

import simgrab
from simgrab.errors import DatasetError, ExtensionError, ScenarioError
from simgrab.world.extensions import Extensions, Recipe
from simgrab.world.trajectory.trajectory import Trajectory

SCENE = small_scene(frames=4, image__format="png", clip__clip_frames=2)
SOURCE = hashlib.sha256(Path(user_functions.__file__).read_bytes()).hexdigest()
FUNCTIONS = {"randomiser": sunny_or_grey, "trajectory": circle, "effects": [speckle, invert]}


def frames(scene=SCENE, **functions):
    return list(simgrab.frames(scene, buffers=False, **functions))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "made"
    simgrab.render(SCENE, path, **FUNCTIONS)
    return path


def test_a_randomiser_changes_the_keys_that_it_returns_for_each_clip():
    found = frames(randomiser=sunny_or_grey)
    assert [frame.truth.beta_deg for frame in found] == [pytest.approx(4.0)] * 4
    suns = [json.loads(frame.truth.varied)["light.sun"] for frame in found]
    assert suns[0] == suns[1] != suns[2] == suns[3]
    assert [frame.truth.variant for frame in found] == [0, 0, 1, 1]


def test_a_trajectory_takes_the_place_of_the_swing():
    for index, frame in enumerate(frames(trajectory=circle)):
        truth = frame.truth
        assert (truth.alpha_deg, truth.rope_length_m) == (pytest.approx(3.0), 15.0)
        assert truth.gamma_deg == pytest.approx((90.0 * index - truth.tilt_azimuth_deg) % 360.0)
        assert frame.mask.any()


def test_effects_change_the_picture_in_turn_and_no_label():
    plain, both, reversed_ = frames(), frames(effects=[speckle, invert]), frames(effects=[invert, speckle])
    for one, other, third in zip(plain, both, reversed_, strict=True):
        changed = other.rgb != 255 - one.rgb
        assert 0.04 < changed.any(axis=-1).mean() < 0.06
        assert (other.rgb[changed] == 255).all()
        assert (third.rgb[third.rgb != 255 - one.rgb] == 0).all()
        assert other.truth == one.truth


def test_a_dataset_with_functions_is_what_its_frames_are_and_says_so(made):
    data = simgrab.open(made)
    for frame, kept in zip(frames(**FUNCTIONS), data, strict=True):
        np.testing.assert_array_equal(frame.rgb, kept.rgb)
    stated = json.loads((made / "manifest.json").read_text())["extensions"]
    names = ["sunny_or_grey", "circle", "speckle", "invert"]
    roles = ["randomiser", "trajectory", "effect", "effect"]
    assert stated["functions"] == [
        {"role": role, "name": f"world.user_functions:{name}", "source_sha256": SOURCE}
        for role, name in zip(roles, names, strict=True)
    ]
    assert "cannot promise" in stated["note"]


def test_two_workers_make_the_same_dataset_with_functions(made, tmp_path):
    simgrab.render(SCENE, tmp_path / "two", workers=2, **FUNCTIONS)
    assert digests(tmp_path / "two") == digests(made)


def test_a_dataset_is_resumed_and_audited_with_the_same_functions_alone(made):
    with pytest.raises(DatasetError, match="another dataset"):
        simgrab.render(SCENE, made, resume=True)
    assert simgrab.render(SCENE, made, resume=True, **FUNCTIONS).made == 0
    with pytest.raises(ExtensionError, match=r"a user's functions \(randomiser world.user_functions:sunny_or_grey"):
        simgrab.audit(made)
    assert [proof.findings for proof in simgrab.audit(made, **FUNCTIONS).proofs if proof.status == "failed"] == []


def writes(rgb, _moment, _rng):
    rgb[0] = 0
    return rgb


def changed(**fields):
    """A trajectory whose moments have other values in some fields."""
    return lambda scenario, frame, rng: replace(circle(scenario, frame, rng), **fields)


def far(scenario, frame, rng):
    moment = circle(scenario, frame, rng)
    return simgrab.Moment.still(frame, simgrab.GrabState(np.nan, 0.0, 15.0, 0.0, 0.0, 0.0), moment.tilt)


JIB = simgrab.JibState(0.0, 30.0, 0.0)
BAD = [
    ({"effects": [lambda rgb, *_: rgb[:10]]}, r"effect .*lambda.* returned uint8 of shape \(10, 480, 3\)"),
    ({"effects": [writes]}, "effect .*:writes raised ValueError: .*read-only"),
    ({"effects": [lambda *_: None]}, "effect .*lambda.* returned NoneType"),
    ({"effects": [partial(int, "x")]}, "effect builtins:int raised"),
    ({"effects": [3]}, "effect: must be a function or the name of an entry point, got int"),
    ({"effects": "mist"}, "effects must be a list"),
    ({"effects": ["mist"]}, "no effect 'mist' in the entry points simgrab.effects; installed: none"),
    ({"trajectory": far}, "trajectory .*:far, frame 0: alpha is nan, not within"),
    ({"trajectory": lambda *_: 3}, "must return a Moment, got int"),
    ({"trajectory": lambda s, f, r: circle(s, f + 1, r)}, "got that of frame 1"),
    ({"trajectory": changed(time=0.0)}, "time and jib must be given together"),
    ({"trajectory": changed(time=3.0, jib=JIB)}, "time is 3, not within"),
    ({"trajectory": lambda s, f, r: replace(circle(s, f, r), ahead=circle(s, f, r))}, "with ahead needs a time"),
    ({"trajectory": changed(grab=None)}, "no attribute"),
    ({"randomiser": lambda *_: 3}, "must return a mapping"),
    ({"randomiser": lambda *_: 1 / 0}, "randomiser .* raised ZeroDivisionError: division by zero"),
]


def used(scene=SCENE, *, randomiser=None, trajectory=None, effects=()):
    """Call what a frame would call, without a world to render."""
    given = Extensions.of(randomiser, trajectory, effects)
    scene = Recipe(scene, given).variant(0).scenario
    moment = Trajectory(scene, given).at(0)
    return given.apply(np.zeros((scene.camera.height_px, scene.camera.width_px, 3), np.uint8), moment, scene)


@pytest.mark.parametrize(("functions", "message"), BAD)
def test_functions_that_do_not_work_are_named_in_one_line(functions, message):
    with pytest.raises(ExtensionError, match=message) as problem:
        used(**functions)
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize(("change", "key"), [
    ({"camera.beta_deg": 500}, "camera.beta_deg"), ({"seed": 3}, "seed"), ({"x.y": 1}, "x"),
    ({"display.layout": "none"}, "display.layout"), ({"light.sun": object()}, ""),
])  # fmt: skip
def test_a_randomiser_is_checked_as_strictly_as_a_scene_file(change, key):
    with pytest.raises(ScenarioError) as problem:
        used(randomiser=lambda *_: change)
    assert problem.value.key == key


def test_installed_packages_offer_functions_by_name(monkeypatch, tmp_path):
    offered = {"speckle": ("speckle", "effects"), "circle": ("circle", "trajectories"), "gone": ("nothing", "effects")}
    points = importlib.metadata.EntryPoints(
        importlib.metadata.EntryPoint(name, f"world.user_functions:{function}", f"simgrab.{group}")
        for name, (function, group) in offered.items()
    )
    monkeypatch.setattr("simgrab.world.extensions.entry_points", lambda group: points.select(group=group))
    assert Extensions.of(None, "circle", ["speckle"]) == Extensions(None, circle, (speckle,))
    with pytest.raises(ExtensionError, match=r"effect 'gone' .* cannot be imported: AttributeError"):
        Extensions.of(None, None, ["gone"])
    with pytest.raises(ExtensionError, match="installed: gone, speckle"):
        Extensions.of(None, None, ["fog"])
    small = ["quay-day", *as_options({"camera.width_px": 320, "camera.height_px": 180, "place": {"model": "plain"}})]
    render = ["render", *small, "--frames", "2", "--quiet", "--effect", "speckle"]
    assert run(*render, "--out", tmp_path / "a")[0] == 0
    again = ["render", tmp_path / "a" / "manifest.json", "--quiet", "--out"]
    assert "a user's functions (effect world.user_functions:speckle)" in run(*again, tmp_path / "b")[2]
    assert run(*again, tmp_path / "c", "--effect", "speckle")[0] == 0
    assert digests(tmp_path / "a") == digests(tmp_path / "c")


def numpy_circle(scenario, frame, rng):
    """As users write it: NumPy's numbers, and a gamma and a text of their own that contradict the poses."""
    moment = circle(scenario, frame, rng)
    grab = replace(moment.grab, rope_length=np.float64(15.0), load=np.float32(0.0))
    due = np.float64(frame % 2) / scenario.clip.frame_rate_hz
    return replace(moment, grab=grab, gamma=3.0, time=due, jib=JIB, present=np.bool_(True), clip=7, shown="20.15")


def test_moments_of_numpy_numbers_are_stored_and_gamma_and_text_follow_from_the_poses(tmp_path):
    scene = small_scene(frames=2, clip__clip_frames=2, display__layout="four-point-four")
    simgrab.render(scene, tmp_path / "out", trajectory=numpy_circle)
    for index, frame in enumerate(simgrab.open(tmp_path / "out")):
        truth = frame.truth
        assert (truth.clip, truth.time_s) == (0, pytest.approx(index / 9))
        assert truth.gamma_deg == pytest.approx((180.0 * index - truth.tilt_azimuth_deg) % 360.0)
        assert truth.rope_text == "12.50 12.95"


def lent(buffer, rgb, _moment, _rng):
    """An effect that uses its buffer again."""
    np.copyto(buffer, rgb)
    return buffer


def test_frames_share_no_pixels_with_an_effect():
    buffer = np.zeros((270, 480, 3), np.uint8)
    plain, lending = frames(), frames(effects=[partial(lent, buffer), lambda rgb, *_: rgb])
    for one, other in zip(plain, lending, strict=True):
        np.testing.assert_array_equal(one.rgb, other.rgb)
        assert other.rgb.flags.writeable
    assert buffer.flags.writeable


def test_partials_are_distinguished_and_lambdas_are_not_resumed(tmp_path):
    one, other, same = (Extensions.of(None, None, [partial(lent, k)]).describe() for k in (1, 2, 1))
    assert one == same != other
    with pytest.raises(ExtensionError, match="cannot be identified"):
        simgrab.render(SCENE, tmp_path / "out", resume=True, effects=[lambda rgb, *_: rgb])
    with pytest.raises(ExtensionError, match="cannot be sent to worker processes"):
        simgrab.render(SCENE, tmp_path / "out", workers=2, effects=[lambda rgb, *_: rgb])


def test_a_manifest_is_not_rendered_without_its_functions(made, tmp_path):
    with pytest.raises(ExtensionError, match="a user's functions"):
        simgrab.frames(made / "manifest.json")
    (tmp_path / "manifest.json").write_text('{"extensions": {"functions": 5}}')
    with pytest.raises(ExtensionError, match="a user's functions"):
        Extensions().refuse_others(tmp_path / "manifest.json")
    assert len(simgrab.FrameDataset(made / "manifest.json", **FUNCTIONS)) == 4


def test_an_exposure_lags_along_a_trajectory_with_time():
    lagging = small_scene(frames=3, optics__exposure={"model": "auto", "lag_s": 30.0})
    prompt = small_scene(frames=3, optics__exposure={"model": "auto", "lag_s": 0.0})
    found = frames(lagging, trajectory=passing)
    np.testing.assert_array_equal(found[2].rgb, next(simgrab.frames(lagging, [2], trajectory=passing)).rgb)
    differs = [(a.rgb != b.rgb).any() for a, b in zip(found, frames(prompt, trajectory=passing), strict=True)]
    assert differs == [False, True, True]


@pytest.mark.slow
def test_a_function_of_a_script_has_the_name_by_which_another_script_imports_it(tmp_path):
    (tmp_path / "looks.py").write_text(
        "import sys, simgrab\n"
        "def invert(rgb, moment, rng):\n    return 255 - rgb\n"
        "if __name__ == '__main__':\n"
        "    plain = {'frames': 1, 'place': {'model': 'plain'}}\n"
        "    simgrab.render(simgrab.load('quay-day', plain, size=(160, 90)), 'first', effects=[invert])\n"
    )
    again = "import looks, simgrab; simgrab.render('first/manifest.json', 'again', effects=[looks.invert])"
    for command in (["looks.py"], ["-c", again]):
        subprocess.run([sys.executable, *command], cwd=tmp_path, check=True, timeout=120)
    first, second = ((tmp_path / name / "labels.parquet").read_bytes() for name in ("first", "again"))
    assert first == second


def test_generators_left_open_end_silently():
    code = (
        "import simgrab; plain = {'frames': 2, 'place': {'model': 'plain'}}\n"
        "scene = simgrab.load('quay-day', plain, size=(160, 90))\n"
        "dataset = simgrab.FrameDataset(scene); dataset[0]; frames = simgrab.frames(scene); next(frames)"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")
