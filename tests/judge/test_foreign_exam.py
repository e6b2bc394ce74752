import cv2
import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from scripts import foreign_exam
from scripts.foreign import grabs
from scripts.foreign.export import export
from scripts.foreign.making import Maker, photographed
from scripts.foreign.worlds import SEEDS, TIMES, World
from simgrab.dataset import stored
from simgrab.errors import RendererError
from simgrab.instrument.detect import WEIGHTS
from simgrab.model import scenes
from simgrab.model.scenario import Mesh
from simgrab.world.camera.optics import to_linear
from simgrab.world.frames import FrameGenerator
from simgrab.world.scenery.grabs.from_file import from_file
from simgrab.world.scenery.model import GRAB, PLACE
from tests.conftest import SMALL

SIZE = 480, 270


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


def fake(job):
    """Render the same light everywhere."""
    with np.load(job["scene"]) as file:
        width, height = file["camera"][:2].astype(int)
        assert {PLACE, GRAB} <= set(file["groups"].ravel())
    np.save(job["out"], np.full((height, width, 3), 0.2, np.float16))


def test_of_simgrabs_own_light_a_picture_is_simgrabs_own():
    changes = SMALL | {
        "camera.distortion": {"k1": -0.1}, "image.shadow_map_px": 0, "display.layout": "two-by-four",
        "optics.recompress_quality": 60, "optics.exposure": {"model": "auto"},
    }  # fmt: skip
    with FrameGenerator(scenes.load("quay-day", changes)) as generator:
        light = to_linear(generator.scene(0).draw(generator.project(0)).rgb)
        made = photographed(generator, light)
        (own,) = stored.make(generator, 0).files.values()
    np.testing.assert_array_equal(*(cv2.imdecode(np.frombuffer(data, np.uint8), 1) for data in (made, own)))


class SmallWorld(World):
    """A world that is quick to render."""

    def scenario(self, size):
        assert size == SIZE
        return scenes.load("quay-day", SMALL | {"frames": 1, "display.layout": "none", "image.shadow_map_px": 0})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A world whose making was interrupted after one geometry, and then went on."""
    root = tmp_path_factory.mktemp("exam")
    world, traced = SmallWorld("tune", 1), []

    def killed(job):
        if traced:
            raise RendererError("killed")
        traced.append(job)
        fake(job)

    with pytest.raises(RendererError, match="killed"):
        Maker(root / "worlds", SIZE, 1, 1, killed).make(world)
    assert not foreign_exam.complete(root / "worlds" / world.name)
    maker = Maker(root / "worlds", SIZE, 1, 1, lambda job: traced.append(job) or fake(job))
    maker.make(world)
    maker.make(world)
    assert len(traced) == 2  # one for each geometry
    return root


@pytest.mark.skipif(not (WEIGHTS / "coarse.onnx").exists(), reason="no detector's weights are bundled")
def test_the_command_scores_what_is_there(folder):
    asked = ["--out", str(folder), "--worlds", "2", "--detector", "bundled", "--size"]
    done = CliRunner().invoke(foreign_exam.main, [*asked, "480x270"])
    assert done.exit_code == 0, done.output
    scores = msgspec.json.decode((folder / "scores-tune.json").read_bytes())
    assert scores["worlds"] == 1
    assert scores["incomplete"] == ["tune-0000"]
    assert {"mujoco", "cycles", "mujoco-grab", "grab"} <= scores["detectors"]["bundled"].keys()
    assert all(figures["labelled"] == 1 for figures in scores["detectors"]["bundled"].values())
    assert (folder / "sheet-tune-mujoco.jpg").exists()
    assert "cycles" in done.output
    other = CliRunner().invoke(foreign_exam.main, [*asked, "960x540"])
    assert other.exit_code == 2
    assert "choose another --out" in other.output
