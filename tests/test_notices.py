"""What a scene states without effect, and which of its frames are alike, said before they are rendered."""

import numpy as np
import pytest
import trimesh

import simgrab
from simgrab.dataset.notices import notices
from simgrab.dataset.summary import Summary, Tally, TallyColumns, doubts
from simgrab.world.extensions import Recipe

SMALL = {
    "frames": 4, "seed": 3, "camera.width_px": 160, "camera.height_px": 90, "place.model": "plain", "image.samples": 0,
}  # fmt: skip
EMPTY = {"swing.absent": 0.5}
HANGS = {"clip.clip_frames": 2, "swing": {"model": "dynamic", "work": {"model": "hang"}}}
WIND = {"swing": HANGS["swing"] | {"wind": {"mean_m_s": 3.0}}}
VARIED = {"clip.clip_frames": 1, "vary": {"light.sun": {"dist": "uniform", "low": 0.5, "high": 1.0}}}
TRAIN = {"splits": {"train": 1.0, "val": 0.0, "test": 0.0}}


def recipe(*changes):
    return Recipe(simgrab.load("quay-day", SMALL | {key: value for change in changes for key, value in change.items()}))


@pytest.mark.parametrize(
    ("changes", "begins"),
    [
        ([{"camera.mount": {"model": "rigid"}}], "camera.mount is only stated in camera.toml"),
        ([{"camera.mount": {"model": "rigid"}}, HANGS, WIND, TRAIN], None),
        ([{"weather.wind_m_s": 9}], "weather.wind_m_s has no effect without rain, snow or dust"),
        ([{"weather.wind_m_s": 9, "weather.snow_mm_h": 1}], None),
        (
            [{"display.layout": "two-by-four", "camera.width_px": 480, "camera.height_px": 270}],
            "display: digits 11 px high",
        ),
        ([{"display.layout": "two-by-four", "camera.width_px": 640, "camera.height_px": 360}], None),
        ([EMPTY], "swing.absent: frames without the grab are one picture in each world of 4 frames"),
        ([EMPTY, VARIED, TRAIN], None),
        ([HANGS, TRAIN], "all 2 clips have the same motion"),
        ([HANGS, {"frames": 2}], None),
        ([HANGS, WIND, TRAIN], None),
        ([VARIED], "splits: a world has one split, and few worlds miss the stated shares: train 3 (stated 3.2), val 0"),
        ([VARIED, {"frames": 200}], None),
        ([{}], None),
        ([{"splits": {"train": 0.0, "val": 0.0, "test": 1.0}}], "splits: no frame is for training"),
    ],
)
def test_a_line_says_what_a_user_may_not_expect(changes, begins):
    found = notices(recipe(*changes))
    assert len(found) == (begins is not None)
    assert not begins or found[0].startswith(begins)


@pytest.mark.parametrize("load", [0.0, 0.5])
def test_a_load_that_a_grab_from_a_file_cannot_hold_is_named(tmp_path, load):
    trimesh.creation.cylinder(radius=1.2, height=2.6).export(tmp_path / "drum.glb")
    grab = {"grab": {"model": "mesh", "file": str(tmp_path / "drum.glb")}}
    assert len(notices(recipe(grab, {"swing.load": load, "frames": 2}))) == (load > 0)


@pytest.mark.parametrize("changes", [[EMPTY], [EMPTY, VARIED, TRAIN], [HANGS, TRAIN], [HANGS, WIND, TRAIN]])
def test_pictures_repeat_where_the_line_says_so(changes):
    made = recipe(*changes)
    frames = list(simgrab.frames(made.scenario, buffers=False))
    empty = [f.rgb.tobytes() for f in frames if not f.truth.present]
    second = frames[1].rgb, frames[3].rgb  # of either clip: the first is alike, since all begin at rest
    assert (len(empty) > 1) == (EMPTY in changes)
    repeat = len(set(empty)) < len(empty) if EMPTY in changes else np.array_equal(*second)
    assert repeat == bool(notices(made))


@pytest.mark.parametrize("below", [0, 2])
def test_grabs_that_are_seen_but_have_no_label_are_named(below):
    scenario = simgrab.load("quay-day")
    fractions = (0.0, *[0.05] * below, 0.2)
    rows = [TallyColumns("train", 1.0, 5.0, 20.0, "", fraction) for fraction in fractions]
    tally = Tally.of(rows[:1], scenario) + Tally.of(rows[1:], scenario)
    assert (tally.labelled, tally.below_least) == (1, below)
    found = doubts(Summary.of("runs/a", tally, scenario, len(rows), ""))
    assert len(found) == (below > 0)
    assert not below or "have no label: 2" in found[0]
