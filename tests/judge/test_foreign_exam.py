import cv2
import msgspec
import numpy as np
import pytest
from click.testing import CliRunner
from msgspec import structs

from scripts import foreign_exam
from scripts.foreign import camera, grabs, making, scoring, surfaces, tables
from scripts.foreign.making import Agreement, Maker, picture, stored_mask
from scripts.foreign.worlds import BOTH, CONDITIONS, OWN, SEEDS, TIMES, World, beside
from simgrab.errors import RendererError
from simgrab.judge.evaluate.detection import Case
from simgrab.judge.evaluate.reading import Read
from simgrab.model import scenes
from simgrab.model.records.observations import Detection, Reading
from simgrab.model.scenario import Mesh, Plain
from simgrab.world.camera.optics import to_linear
from simgrab.world.frames import FrameGenerator
from simgrab.world.scenery.grabs.from_file import from_file
from simgrab.world.scenery.model import GRAB, PLACE, ROPE
from tests.conftest import SMALL

SIZE = 480, 270
PICTURES = ("cycles", "sensor", "coder")


def test_each_condition_replaces_one_thing_and_the_last_one_all():
    replaced = {
        name: ({"grab"} if one.replacement.grab else set()) | set(one.render or ()) | set(one.camera)
        for name, one in CONDITIONS.items()
    }
    single = set(CONDITIONS) - {"mujoco", "cycles", "all"}
    assert replaced["mujoco"] == replaced["cycles"] == set()
    assert all(replaced[name] == {name} for name in single)
    assert replaced["all"] == single
    assert {beside(one) for one in CONDITIONS.values()} == {"mujoco", "mujoco-grab", "mujoco-ground", "mujoco-both"}


def test_twelve_worlds_have_every_family_at_every_time_and_halves_share_none():
    worlds = [World("tune", number) for number in range(12)]
    assert {(one.family, one.time) for one in worlds} == {(one.family, time) for one in worlds for time in TIMES}
    empty = [World("tune", number) for number in range(48) if World("tune", number).empty]
    assert len(empty) == 12
    assert {(one.family, one.time) for one in empty} == {(one.family, one.time) for one in worlds}
    assert len({World(half, number).seed for half in SEEDS for number in range(10_000)}) == 20_000


def test_a_replacement_changes_grab_and_place_alone(tmp_path):
    world = World("tune", 0)
    own = world.scenario(SIZE)
    both = world.replaced(own, BOTH, tmp_path)
    assert isinstance(both.grab, Mesh)
    assert isinstance(both.place, Plain)
    assert both.camera == own.camera
    assert world.replaced(own, OWN, tmp_path) == own
    assert own.light.floodlights == 0 < World("tune", 8).scenario(SIZE).light.floodlights


@pytest.mark.parametrize("kind", ["frame", "tines", "levers"])
def test_a_grab_by_other_code_opens_outwards_on_ropes_that_end_on_top(tmp_path, kind):
    keys = grabs.write(tmp_path / "grab.glb", kind, np.random.default_rng(3))
    design = from_file(Mesh.of(tmp_path / "grab.glb", **keys))

    def widest(opening):
        frames = design.frames(opening)
        points = [
            body.steel.vertices @ frames[body.name][:3, :3].T + frames[body.name][:3, 3] for body in design.bodies
        ]
        return np.concatenate(points)

    closed, opened = widest(0.0), widest(design.max_jaw)
    size = np.ptp(closed, axis=0)
    assert (size > 1.4).all()
    assert (size < 4.2).all()
    assert np.ptp(opened[:, 0]) > np.ptp(closed[:, 0]) + 0.2
    assert (design.terminations[:, 2] >= closed[:, 2].max() - 0.05).all()


def test_masks_agree_within_a_pixel_or_say_how_far_not():
    ours = np.zeros((20, 20), bool)
    ours[5:12, 5:12] = True
    assert Agreement.of(ours, ours) == Agreement(49, 1.0, 0.0, 0)
    assert Agreement.of(ours, np.roll(ours, (1, 1), (0, 1))).beyond == 0
    far = Agreement.of(ours, np.roll(ours, 3, 0))
    assert far.farthest_px == 3
    assert far.beyond == 2 * 7 * 2


def test_masks_of_which_one_alone_shows_a_grab_are_counted_and_stored(tmp_path):
    ours, none = np.eye(20, dtype=bool), np.zeros((20, 20), bool)
    compared = [Agreement.of(ours, none), Agreement.of(none, ours), Agreement.of(ours, ours), Agreement.of(none, none)]
    worlds = [World("tune", number) for number in range(len(compared))]
    for world, one in zip(worlds, compared, strict=True):
        (tmp_path / world.name).mkdir()
        data = msgspec.json.encode(one)
        (tmp_path / world.name / "ids-own.json").write_bytes(data)
        assert msgspec.json.decode(data, type=Agreement) == one
    ids = scoring.agreement(tmp_path, worlds, ["own"])["own"]
    assert (ids["frames"], ids["one_sided"], ids["within_a_pixel"]) == (3, 2, 1)
    assert (ids["pixels"], ids["pixels_beyond"], ids["farthest_px"]) == (40, 40, 0.0)
    assert scoring.agreement(tmp_path, worlds[:1], ["own"])["own"]["farthest_px"] is None


def test_blender_has_simgrabs_groups():
    assert (surfaces.PLACE, surfaces.ROPE, surfaces.GRAB) == (PLACE, ROPE, GRAB)


@pytest.fixture(scope="module")
def rendered():
    changes = SMALL | {
        "camera.distortion": {"k1": -0.1}, "image.shadow_map_px": 0,
        "display.layout": "two-by-four",
        "optics.recompress_quality": 60, "optics.exposure": {"model": "auto"},
    }  # fmt: skip
    scenario = scenes.load("quay-day", changes)
    with FrameGenerator(scenario) as generator:
        scene = generator.scene(0)
        yield scenario, scene.draw(generator.project(0)), generator.frame(0).rgb


def test_with_nothing_replaced_a_picture_is_simgrabs_own(rendered):
    scenario, buffers, rgb = rendered
    file, suffix = camera.photographed(scenario, buffers, to_linear(buffers.rgb), (), np.random.default_rng(0))
    _, expected = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, scenario.image.quality])
    assert suffix == ".jpg"
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(file, np.uint8), 1), cv2.imdecode(expected, 1))


@pytest.mark.parametrize("replaced", ["light", "sensor", "digits", "coder"])
def test_what_is_replaced_changes_the_picture_and_not_where_things_are(rendered, replaced):
    scenario, buffers, rgb = rendered
    light = to_linear(buffers.rgb)
    file, _ = camera.photographed(scenario, buffers, light, (replaced,), np.random.default_rng(5))
    made = cv2.imdecode(np.frombuffer(file, np.uint8), 1)
    grey = [cv2.GaussianBlur(p[30:240].mean(axis=2), (0, 0), 2) for p in (made, rgb[..., ::-1])]
    (dx, dy), _ = cv2.phaseCorrelate(*(np.hypot(cv2.Sobel(g, -1, 1, 0), cv2.Sobel(g, -1, 0, 1)) for g in grey))
    assert np.hypot(dx, dy) < 0.3
    assert (made != rgb[..., ::-1]).any()


def test_another_sensor_keeps_red_red():
    light = np.full((64, 96, 3), 0.05, np.float32) + np.float32([0.2, 0, 0])
    one, same = (camera.foreign_sensor(light, np.random.default_rng(1)) for _ in range(2))
    np.testing.assert_array_equal(one, same)
    red, green, blue = one.mean(axis=(0, 1))
    assert red > 1.3 * max(green, blue)


@pytest.mark.parametrize("coder", camera.CODERS)
def test_every_coder_returns_much_the_same_picture(coder):
    ramp = np.repeat(np.linspace(20, 230, 96, dtype=np.uint8)[None, :, None], 64, axis=0) * np.ones(3, np.uint8)
    assert np.abs(camera.coded(ramp, coder, 1.0).astype(int) - ramp).mean() < 6


def fake():
    """A path tracer that renders even light, and ids of the grab everywhere."""
    calls = []

    def trace(jobs):
        calls.append(jobs)
        for job in jobs:
            with np.load(job["scene"]) as file:
                width, height = file["camera"][:2].astype(int)
                assert {PLACE, GRAB} <= set(file["groups"].ravel())
                assert len(file["jib_from_camera"]) == len(job["jib_poses"])  # lamps of the jib head move with it
            assert job["ceiling_m"] > job["ground_m"]
            np.save(job["out"], np.full((height, width, 3), 0.2, np.float16))
            if job["ids"]:
                x0, y0, x1, y1 = job["ids_window"]
                np.save(job["ids"], np.full((y1 - y0, x1 - x0), GRAB, np.uint8))

    return trace, calls


def killed_after(pictures):
    left = iter(range(pictures))

    def photographed(*arguments):
        if next(left, None) is None:
            raise RendererError("killed")
        return camera.photographed(*arguments)

    return photographed


class SmallWorld(World):
    """A world that is quick to render."""

    def scenario(self, size):
        assert size == SIZE
        return scenes.load("quay-day", SMALL | {"frames": 1, "display.layout": "none", "image.shadow_map_px": 0})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A world whose making was interrupted after one picture, and then went on."""
    root = tmp_path_factory.mktemp("exam")
    world = SmallWorld("tune", 1)
    where = root / "worlds" / world.name
    trace, calls = fake()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(making, "photographed", killed_after(1))
        with pytest.raises(RendererError, match="killed"):
            Maker(root, SIZE, 1, 1, trace).make(world, PICTURES)
    first = picture(where, PICTURES[0]).read_bytes()
    assert [picture(where, name) is not None for name in PICTURES] == [True, False, False]
    trace, more = fake()
    maker = Maker(root, SIZE, 1, 1, trace)
    maker.make(world, PICTURES)
    assert [len(jobs) for jobs in more] == [1]  # one light for both
    assert calls[0][0]["ids"]
    assert not more[0][0]["ids"]  # which were compared before
    assert picture(where, PICTURES[0]).read_bytes() == first
    maker.make(world, PICTURES)
    assert len(more) == 1
    return root


def test_an_interrupted_world_goes_on(folder):
    where = folder / "worlds" / "tune-0001"
    assert scoring.complete(where, PICTURES)
    assert not scoring.complete(where, ("all",))
    known = scoring.record(where, "own")
    assert stored_mask(known).shape == SIZE[::-1]
    assert known.truth.width_px == SIZE[0]
    found = msgspec.json.decode((where / "ids-own.json").read_bytes(), type=Agreement)
    assert found.pixels == stored_mask(known).sum()
    assert found.beyond > 0 < found.farthest_px  # the path tracer has the grab all over the window
    assert found.iou < 1


def test_the_command_scores_what_is_there(folder):
    asked = ["--out", str(folder), "--worlds", "2", "--conditions", ",".join(PICTURES), "--size", "480x270",
             "--detector", "any-grab", "--resamples", "2"]  # fmt: skip
    done = CliRunner().invoke(foreign_exam.main, asked)
    assert done.exit_code == 0, done.output
    scores = msgspec.json.decode((folder / "scores-tune.json").read_bytes())
    assert scores["worlds"] == 1
    assert scores["incomplete"] == ["tune-0000"]
    assert list(scores["detectors"]["any-grab"]) == list(PICTURES)
    assert (folder / "sheet-tune-mujoco.jpg").exists()
    assert "| `cycles` | Blender | " in (folder / "scores-tune.md").read_text()
    other = CliRunner().invoke(foreign_exam.main, [*asked[:6], "--size", "960x540"])
    assert other.exit_code == 2
    assert "choose another --out" in other.output


@pytest.fixture(scope="module")
def truth(folder):
    known = scoring.record(folder / "worlds" / "tune-0001", "own").truth
    box = {"box_x0_px": 100, "box_y0_px": 100, "box_x1_px": 200, "box_y1_px": 180}
    return structs.replace(known, present=True, grab_u_px=150.0, grab_v_px=150.0, **box)


def observed(truth, number, shift, name):
    """An observation whose box is shifted in every second world, and in which every digit is read right."""
    world = World("tune", number)
    box = np.array([100.0, 100.0, 200.0, 180.0]) + shift * (number % 2)
    detection = Detection("found", "", 0.9, box, box[:2] + 50, None, np.full(4, 2.0), np.full(2, 2.0))
    read = Read("", name, "2015 2100", "2015 2100", Reading("read", "", "2015", "2100", np.ones(8), 20.15, 21.0, 22.65))
    row = structs.replace(truth, variant=number)
    return scoring.Observation(world, {"any-grab": Case(row, True, world.time, detection, world.name)}, read)


@pytest.fixture(scope="module")
def found(truth):
    shifts = {"mujoco": 0.0, "mujoco-both": 0.0, "cycles": 4.0, "all": 8.0}
    return [{name: observed(truth, i, shift, name) for name, shift in shifts.items()} for i in range(8)]


def test_a_condition_is_compared_with_mujoco(found):
    row = scoring.by_condition(found, ("cycles",), "any-grab", 20)["cycles"]
    assert row["foreign"]["recall"] == row["mujoco"]["recall"] == 1.0
    low, high = row["difference"]["intervals"]["map50_95_less"]
    assert low <= row["difference"]["map50_95_less"] <= high <= 0
    assert row["foreign"]["coverage"]["box"] == 0.5
    assert row["mujoco"]["intervals"]["box"] == (1.0, 1.0)
    groups = scoring.by_group(found, ("cycles",), "any-grab", 1)
    assert set(groups["time"]) == set(TIMES[:2])
    assert groups["family"]["scissors"]["cycles"]["foreign"]["labelled"] == 2
    assert groups["family"]["scissors"]["cycles"]["foreign"]["centre"]["median_px"] == pytest.approx(4 * 2**0.5)


def test_the_report_states_figures_beside_mujoco_and_which_goals_are_met(found):
    names = ("cycles", "all")
    scores = {
        "worlds": 8, "incomplete": [], "detectors": {"any-grab": scoring.by_condition(found, names, "any-grab", 2)},
        "groups": {}, "digits": scoring.digits(found, names), "ids": {},
    }  # fmt: skip
    text = tables.report(scores)
    assert "| `cycles` | Blender | 8 of 8 (63.1 to 100.0 %) |" in text
    assert "| recall at least 97 % | 8 of 8 (63.1 to 100.0 %) | met |" in text
    (covered,) = (line for line in text.splitlines() if line.startswith("| 95 % intervals"))
    assert covered.endswith("| short |")
    (empty,) = (line for line in text.splitlines() if line.startswith("| boxes on at most"))
    assert empty.endswith("| not measured |")
    assert "| `cycles` | Blender | 64 of 64 (94.4 to 100.0 %) | 0 of 64 (0.0 to 5.6 %) |" in text
