import json
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from msgspec import structs

from scripts import foreign_clips
from scripts.bench_renderers import exported
from scripts.foreign import camera, clip_scores, clips
from scripts.foreign.clips import CLIPS, DEFAULT, REPLACEABLE, Filmer, Setting
from scripts.foreign.worlds import CLIP_SEEDS, CONDITIONS, SEEDS
from simgrab.errors import RendererError
from simgrab.instrument.source import open_source
from simgrab.io import parquet
from simgrab.model.scenario import Dynamic, Mesh, Plain
from simgrab.world.camera.optics import to_linear
from simgrab.world.frames import FrameGenerator
from simgrab.world.scenery.model import PLACE

DAY, DUSK, NIGHT = CLIPS
SIZE = 480, 270
#: Three frames, of which the last two are of a slewed jib.
SETTING = Setting(SIZE, 45.0, 1 / 15, 1, DEFAULT)


def test_what_may_be_replaced_is_what_the_exam_replaces_with_everything_foreign():
    exam = CONDITIONS["all"]
    assert set(REPLACEABLE) == {"grab", "ground", *(exam.render or ()), *exam.camera}
    assert set(REPLACEABLE) - set(DEFAULT) == {"grab"}


def test_clips_have_worlds_of_their_own_at_three_times_and_not_all_move_calmly():
    assert {clip.time for clip in CLIPS} == {"day", "dusk", "night"}
    assert {clip.coder for clip in CLIPS} == set(camera.VIDEO_CODERS)
    assert {clip.hard for clip in CLIPS} == {True, False}
    assert all(abs(CLIP_SEEDS - seed) > 100_000 for seed in SEEDS.values())


def test_a_clip_is_one_world_with_physics_and_a_display(tmp_path):
    scenario = clips.scenario_of(NIGHT, SETTING, tmp_path)
    assert isinstance(scenario.swing, Dynamic)
    assert isinstance(scenario.place, Plain)
    assert scenario.display_layout is not None
    assert scenario.light.floodlights > 0
    assert scenario.clip.count(scenario.frames) == 1
    assert not isinstance(scenario.grab, Mesh)
    foreign = clips.scenario_of(NIGHT, Setting(SIZE, 45.0, 1 / 15, 1, REPLACEABLE), tmp_path)
    assert isinstance(foreign.grab, Mesh)
    assert structs.replace(foreign, grab=scenario.grab) == scenario


@pytest.fixture(scope="module")
def generator(tmp_path_factory):
    with FrameGenerator(clips.scenario_of(DAY, SETTING, tmp_path_factory.mktemp("grab"))) as generator:
        yield generator


def test_the_place_and_the_sun_stand_still_where_the_first_jib_frame_does(generator):
    poses = clips.jib_poses(generator)
    np.testing.assert_allclose(poses[0], np.eye(4), atol=1e-12)
    assert np.abs(poses[-1] - np.eye(4)).max() > 0.1  # the jib slews
    moving = exported(generator, range(generator.scenario.frames))
    still = clips.standing(moving, poses)
    place = moving.groups[0] == PLACE
    assert np.ptp(moving.jib_from_geom[:, place], axis=0).max() > 0.1
    np.testing.assert_allclose(np.ptp(still.jib_from_geom[:, place], axis=0), 0.0, atol=1e-9)
    first = exported(generator, range(1))
    np.testing.assert_allclose(still.light_directions, first.light_directions, atol=1e-9)
    # Seen from the camera nothing has moved.
    for frame, pose in enumerate(still.jib_from_camera):
        seen, expected = (
            np.linalg.inv(camera_pose) @ geoms
            for camera_pose, geoms in ((pose, still.jib_from_geom[frame]),
                                       (moving.jib_from_camera[frame], moving.jib_from_geom[frame]))
        )  # fmt: skip
        np.testing.assert_allclose(seen, expected, atol=1e-9)


@pytest.mark.parametrize("replaced", [DEFAULT, ("digits",)])
def test_the_camera_of_a_clip_is_one_and_its_noise_another_in_each_frame(generator, replaced):
    scene = generator.scene(0)
    buffers = scene.draw(scene.project(0), labelled=False)
    light = to_linear(np.ascontiguousarray(buffers.rgb))

    def picture(of, noise):
        return camera.before_coding(
            generator.scenario, buffers, light, replaced, np.random.default_rng(of), np.random.default_rng(noise)
        ).astype(float)

    one, again, other_noise, other_camera = picture(1, 1), picture(1, 1), picture(1, 2), picture(2, 1)
    np.testing.assert_array_equal(one, again)
    assert ("sensor" in replaced) == (one != other_noise).any()
    assert 3 * np.abs(one - other_noise).mean() < np.abs(one - other_camera).mean()


def tracers(after=None):
    """Make an opener of a path tracer that renders grey, brighter from frame to frame, and dies after so many."""
    seen = []

    class Grey:
        def __init__(self, table):
            with np.load(table["scene"]) as file:
                self.size = file["camera"][:2].astype(int)[::-1]
                assert len(file["jib_from_camera"]) == len(table["jib_poses"])
            assert table["ceiling_m"] > table["ground_m"]
            assert set(table["replaced"]) == {"textures", "ground", "light"}

        def render(self, frame):
            if len(seen) == after:
                raise RendererError("killed")
            seen.append(frame)

        def save(self, path):
            np.save(path, np.full((*self.size, 3), 0.1 + 0.1 * seen[-1], np.float16))

    @contextmanager
    def opened(table):
        assert Path(table["scene"]).exists()
        yield Grey(table)

    return opened, seen


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A clip that was interrupted after its first frame, and then went on."""
    root = tmp_path_factory.mktemp("clips")
    opened, seen = tracers(after=1)
    with pytest.raises(RendererError, match="killed"):
        Filmer(root, SETTING, 1, opened).film(DAY)
    where = root / "day"
    first = clips.frame_file(where, 0).read_bytes()
    assert clips.missing_frames(where, SETTING.frames) == [1, 2]
    assert not clips.video(where, clips.FOREIGN).exists()
    partial, _ = clip_scores.measure(root, DAY, SETTING, "bundled")
    (root / "partial.md").write_text(clip_scores.table({"day": partial}))
    opened, more = tracers()
    Filmer(root, SETTING, 1, opened).film(DAY)
    assert (seen, more) == ([0], [1, 2])
    assert clips.frame_file(where, 0).read_bytes() == first
    opened, none = tracers()
    Filmer(root, SETTING, 1, opened).film(DAY)
    assert none == []
    return root


def test_both_videos_show_the_labelled_frames_at_their_times(folder):
    where = folder / "day"
    truth = parquet.read_table(clips.video(where, clips.MUJOCO).with_suffix(".parquet"), ValueError).to_pylist()
    assert len(truth) == SETTING.frames
    for by in (clips.MUJOCO, clips.FOREIGN):
        frames = [frame for frame in open_source(clips.video(where, by)) if frame.picture is not None]
        assert [frame.picture.shape for frame in frames] == [(SIZE[1], SIZE[0], 3)] * SETTING.frames
        np.testing.assert_allclose([frame.time_s for frame in frames], [row["pts_s"] for row in truth], atol=4e-4)


def test_the_labels_are_those_of_the_frames_that_are_exported_for_blender(folder, generator):
    truth = parquet.read_table(clips.video(folder / "day", clips.MUJOCO).with_suffix(".parquet"), ValueError)
    for row in truth.to_pylist():
        moment = generator.project(row["frame"]).moment
        assert np.rad2deg(moment.grab.alpha) == pytest.approx(row["alpha_deg"])
        assert moment.grab.rope_length == pytest.approx(row["rope_length_m"])


def test_simgrabs_own_coder_is_used_where_the_coder_is_not_replaced(folder, tmp_path):
    scenario = clips.scenario_of(DAY, SETTING, tmp_path)
    for replaced, name in ((DEFAULT, "hevc"), ((), "h264")):
        path = tmp_path / f"{name}.mp4"
        clips.encode(path, DAY, scenario, folder / "day", replaced)
        found = cv2.VideoCapture(str(path))
        code = int(found.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").decode()
        assert code in {"hevc": ("hvc1", "hev1", "hevc"), "h264": ("avc1", "h264")}[name]


def test_the_table_states_what_is_missing(folder):
    text = (folder / "partial.md").read_text()
    assert "Not complete: day (2 of 3 frames by Blender are missing)." in text
    assert "| day | MuJoCo | 3 of 3 |" in text
    assert "|  | Blender | – |" in text


def test_the_command_scores_what_is_there(folder):
    asked = ["--out", str(folder), "--seconds", "45", "--rate", str(1 / 15), "--size", "480x270", "--samples", "1"]
    done = CliRunner().invoke(foreign_clips.main, asked)
    assert done.exit_code == 0, done.output
    scores = json.loads((folder / "scores.json").read_text())
    assert list(scores["clips"]) == ["day", "dusk", "night"]
    day = scores["clips"]["day"]
    assert (day["missing"], scores["clips"]["dusk"]["missing"]) == (0, 3)
    assert day["by"]["mujoco"]["evaluation"]["detection"]["recall"] == 1.0
    assert day["by"]["foreign"]["evaluation"]["detection"]["recall"] == 0.0  # it is grey
    assert len(day["by"]["mujoco"]["true_deg"]) == 3
    assert "Not complete: dusk (3 of 3 frames" in done.output
    assert "day (" not in done.output
    assert cv2.imread(str(folder / "sheet.jpg")).shape[0] == 2 * clip_scores.TILE_PX[1]
    other = CliRunner().invoke(foreign_clips.main, [*asked[:-1], "2"])
    assert other.exit_code == 2
    assert "choose another --out" in other.output
    wrong = CliRunner().invoke(foreign_clips.main, [*asked, "--replaced", "sun"])
    assert "sun: of grab, ground, textures, light" in wrong.output


def test_the_same_command_goes_on_and_another_setting_is_refused(tmp_path):
    options = ["--only", "day", "--out", str(tmp_path)]
    for _ in range(2):
        done = CliRunner().invoke(foreign_clips.main, options)
        assert done.exit_code == 0, done.output
    assert CliRunner().invoke(foreign_clips.main, [*options, "--samples", "2"]).exit_code == 2
