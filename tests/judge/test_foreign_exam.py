import cv2
import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from scripts import foreign_exam
from scripts.foreign import camera, grabs, making, scoring
from scripts.foreign.export import export
from scripts.foreign.making import Maker, picture
from scripts.foreign.worlds import CONDITIONS, SEEDS, TIMES, World
from simgrab.errors import RendererError
from simgrab.model import scenes
from simgrab.model.scenario import Mesh
from simgrab.world.camera.optics import to_linear
from simgrab.world.frames import FrameGenerator
from simgrab.world.scenery.grabs.from_file import from_file
from simgrab.world.scenery.model import GRAB, PLACE
from tests.conftest import SMALL

SIZE = 480, 270
PICTURES = ("cycles", "sensor", "digits")


def test_each_condition_replaces_one_thing_and_the_last_one_all():
    replaced = {name: ({"grab"} if one.grab else set()) | set(one.camera) for name, one in CONDITIONS.items()}
    single = set(CONDITIONS) - {"mujoco", "cycles", "all"}
    assert replaced["mujoco"] == replaced["cycles"] == set()
    assert all(replaced[name] == {name} for name in single)
    assert replaced["all"] == single
    assert {one.beside for one in CONDITIONS.values()} == {"mujoco", "mujoco-grab"}


def test_twelve_worlds_have_every_family_at_every_time_and_halves_share_none():
    worlds = [World("tune", number) for number in range(12)]
    assert {(one.family, one.time) for one in worlds} == {(one.family, time) for one in worlds for time in TIMES}
    empty = [World("tune", number) for number in range(48) if World("tune", number).empty]
    assert len(empty) == 12
    assert {(one.family, one.time) for one in empty} == {(one.family, one.time) for one in worlds}
    assert len({World(half, number).seed for half in SEEDS for number in range(10_000)}) == 20_000


def test_another_grab_changes_the_grab_alone(tmp_path):
    world = World("tune", 0)
    own = world.scenario(SIZE)
    other = world.with_other_grab(own, tmp_path)
    assert isinstance(other.grab, Mesh)
    assert (other.camera, other.place, other.light) == (own.camera, own.place, own.light)
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


def test_an_exported_grab_fills_the_box_of_the_labels():
    with FrameGenerator(scenes.load("quay-day", SMALL)) as generator:
        scene, truth = export(generator), generator.frame(0).truth
    vertices = np.split(scene["vertices"][:, :3], scene["vertices_ends"])
    points = np.concatenate(
        [
            vertices[geom] @ scene["jib_from_geom"][geom, :3, :3].T + scene["jib_from_geom"][geom, :3, 3]
            for geom in np.flatnonzero(scene["groups"] == GRAB)
        ]
    )
    _, _, f, cx, cy = scene["camera"]
    pose = scene["jib_from_camera"]
    x, y, z = ((points - pose[:3, 3]) @ pose[:3, :3]).T
    u, v = f * x / z + cx, f * y / z + cy
    box = truth.amodal_x0_px, truth.amodal_y0_px, truth.amodal_x1_px, truth.amodal_y1_px
    np.testing.assert_allclose((u.min(), v.min(), u.max(), v.max()), box, atol=1.0)
    assert len(vertices) == len(np.split(scene["faces"], scene["faces_ends"])) == len(scene["names"]) + 1


def test_with_nothing_replaced_a_picture_is_simgrabs_own(rendered):
    scenario, buffers, rgb = rendered
    file = camera.photographed(scenario, buffers, to_linear(buffers.rgb), (), np.random.default_rng(0))
    _, expected = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, scenario.image.quality])
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(file, np.uint8), 1), cv2.imdecode(expected, 1))


@pytest.mark.parametrize("replaced", ["sensor", "digits"])
def test_what_is_replaced_changes_the_picture_and_not_where_things_are(rendered, replaced):
    scenario, buffers, rgb = rendered
    light = to_linear(buffers.rgb)
    file = camera.photographed(scenario, buffers, light, (replaced,), np.random.default_rng(5))
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


def fake():
    """A path tracer that renders even light."""
    calls = []

    def trace(job):
        calls.append(job)
        with np.load(job["scene"]) as file:
            width, height = file["camera"][:2].astype(int)
            assert {PLACE, GRAB} <= set(file["groups"].ravel())
        np.save(job["out"], np.full((height, width, 3), 0.2, np.float16))

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
    trace, _ = fake()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(making, "photographed", killed_after(1))
        with pytest.raises(RendererError, match="killed"):
            Maker(root, SIZE, 1, 1, trace).make(world, PICTURES)
    first = picture(where, PICTURES[0]).read_bytes()
    assert [picture(where, name) is not None for name in PICTURES] == [True, False, False]
    trace, more = fake()
    maker = Maker(root, SIZE, 1, 1, trace)
    maker.make(world, PICTURES)
    assert len(more) == 1  # one light for both
    assert picture(where, PICTURES[0]).read_bytes() == first
    maker.make(world, PICTURES)
    assert len(more) == 1
    return root


def test_an_interrupted_world_goes_on(folder):
    where = folder / "worlds" / "tune-0001"
    assert scoring.complete(where, PICTURES)
    assert not scoring.complete(where, ("all",))
    assert scoring.record(where, "own").truth.width_px == SIZE[0]


def test_the_command_scores_what_is_there(folder):
    asked = ["--out", str(folder), "--worlds", "2", "--conditions", ",".join(PICTURES), "--size", "480x270",
             "--detector", "any-grab"]  # fmt: skip
    done = CliRunner().invoke(foreign_exam.main, asked)
    assert done.exit_code == 0, done.output
    scores = msgspec.json.decode((folder / "scores-tune.json").read_bytes())
    assert scores["worlds"] == 1
    assert scores["incomplete"] == ["tune-0000"]
    assert {*PICTURES, "mujoco"} <= scores["detectors"]["any-grab"].keys()
    assert all(figures["labelled"] == 1 for figures in scores["detectors"]["any-grab"].values())
    assert (folder / "sheet-tune-mujoco.jpg").exists()
    assert "cycles" in done.output
    other = CliRunner().invoke(foreign_exam.main, [*asked[:6], "--size", "960x540"])
    assert other.exit_code == 2
    assert "choose another --out" in other.output
