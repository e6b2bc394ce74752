"""A frame is a value: the same in Python as in a dataset, in any order, in any process."""

import hashlib
import os
import pickle
import subprocess
import sys
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
from conftest import SMALL, small_scene

import simgrab
from simgrab.dataset.stored import DEPTH_MM
from simgrab.errors import ScenarioError
from simgrab.world.scenery.model import GRAB

PNG = {"image__format": "png", "image__ids": True, "image__depth": True}
MOVING = {
    "swing": {"model": "dynamic", "start": {"alpha_deg": 4.0}}, "shutter__exposure_s": 0.01, "shutter__rolling_s": 0.02,
    "optics__exposure": {"model": "auto", "lag_s": 1.0},
}  # fmt: skip
FOGGY = {"camera__distortion": {"k1": -0.28, "k2": 0.09}, "weather__visibility_m": 60.0}
SCENES = {
    "still": small_scene(frames=4, **PNG),
    "clip": small_scene(frames=4, **PNG, **MOVING, **FOGGY),
    "varied": small_scene(
        frames=4, clip__clip_frames=2, vary={"camera.beta_deg": {"dist": "uniform", "low": 1.0, "high": 5.0}}, **PNG
    ),
}


@pytest.fixture(scope="module", params=SCENES)
def stored(request, tmp_path_factory):
    scene, path = SCENES[request.param], tmp_path_factory.mktemp("frames") / "data"
    simgrab.render(scene, path)
    return scene, simgrab.open(path)


def test_frames_are_those_that_a_dataset_stores(stored):
    scene, data = stored
    assert len(data) == scene.frames
    for frame, kept in zip(simgrab.frames(scene), data, strict=True):
        np.testing.assert_array_equal(frame.rgb, kept.rgb)
        assert msgspec.structs.asdict(frame.truth).items() <= msgspec.structs.asdict(kept.truth).items()
        np.testing.assert_array_equal(frame.mask, kept.mask)
        np.testing.assert_array_equal(frame.mask, frame.ids == GRAB)
        y, x = np.nonzero(frame.mask)
        assert frame.box.tolist() == [x.min(), y.min(), x.max() + 1, y.max() + 1]
        assert np.median(frame.depth[frame.mask]) == pytest.approx(frame.truth.distance_m, abs=3)
        for mine, other in ((frame.box, kept.box), (frame.keypoints, kept.keypoints)):
            np.testing.assert_array_equal(mine, other)
        stem = f"{kept.truth.split}/{kept.truth.frame:06d}.png"
        ids, depth = (cv2.imread(str(data.path / k / stem), cv2.IMREAD_UNCHANGED) for k in ("ids", "depth"))
        np.testing.assert_array_equal(frame.ids, ids)
        np.testing.assert_array_equal((frame.depth * DEPTH_MM).clip(max=65535).round(), depth)
        assert depth.dtype == np.uint16
        assert kept.content.startswith(b"\x89PNG")


def test_any_frame_alone_is_the_frame_of_the_whole(stored):
    scene, data = stored
    order = [3, 0, -2, 3]
    for index, frame in zip(order, simgrab.frames(scene, order, buffers=False), strict=True):
        np.testing.assert_array_equal(frame.rgb, data[index].rgb)
        assert frame.truth.frame == index % scene.frames
        assert frame.ids is frame.depth is None


def test_a_frame_out_of_range_says_how_many_there_are():
    with pytest.raises(IndexError, match="frame 4 is out of range: the scenario has 4 frames"):
        next(simgrab.frames(SCENES["still"], [4]))
    with pytest.raises(ScenarioError, match="nowhere"):
        simgrab.frames("nowhere")


def test_iterating_writes_nothing(tmp_path):
    """In a folder and with a home that may not be written to; root may write there, so what lies there counts."""
    scene = f"simgrab.load('quay-day', {SMALL})"
    code = f"import simgrab; print(sum(f.mask.any() for f in simgrab.frames({scene}, [0, 1])))"
    folder, home = tmp_path / "here", tmp_path / "home"
    for path in (folder, home):
        path.mkdir(mode=0o500)
    environment = os.environ | {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache"), "TMPDIR": str(folder)}
    environment |= {"PYTHONPATH": str(Path(simgrab.__file__).parents[1]), "PYTHONDONTWRITEBYTECODE": "1"}
    environment["MESA_SHADER_CACHE_DISABLE"] = "true"  # the driver's own, in the user's cache folder
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, env=environment, capture_output=True, text=True)
    assert (done.stdout.strip(), done.returncode) == ("2", 0), done.stderr
    assert [*folder.iterdir(), *home.iterdir()] == []


def arrays(frame):
    return {"rgb": frame.rgb, "box": frame.box, "alpha_deg": frame.truth.alpha_deg}


def test_a_dataset_of_frames_goes_by_number_and_can_be_pickled(stored):
    scene, data = stored
    frames = simgrab.FrameDataset(scene, arrays)
    assert len(frames) == scene.frames
    np.testing.assert_array_equal(frames[-1]["rgb"], data[-1].rgb)
    again = pickle.loads(pickle.dumps(frames))
    np.testing.assert_array_equal(again[0]["rgb"], data[0].rgb)
    assert [len(clip) for clip in again.clips] == [2, 2] if scene.vary else [4]
    for dataset in (frames, again):
        dataset.close()
        dataset.close()
    with pytest.raises(IndexError):
        again[4]
    for index in (1.5, "1", slice(2)):
        with pytest.raises(TypeError):
            again[index]


LOADER = """
import hashlib
import torch.utils.data as data
import simgrab
from conftest import small_scene
from world.test_frames import PNG, arrays

if __name__ == "__main__":
    frames = simgrab.FrameDataset(small_scene(frames=4, **PNG), arrays)
    for start in ("fork", "spawn", "fork"):
        workers = 1 if start == "spawn" else 2
        for batch in data.DataLoader(frames, batch_size=2, num_workers=workers, multiprocessing_context=start):
            for rgb, alpha in zip(batch["rgb"], batch["alpha_deg"], strict=True):
                print(hashlib.sha256(rgb.numpy()).hexdigest(), repr(float(alpha)), flush=True)
        frames[0]
"""


@pytest.mark.slow
def test_a_data_loader_gives_the_same_frames(tmp_path):
    """But for a fork after OpenGL was used, which is refused, for it would hang."""
    pytest.importorskip("torch")
    (tmp_path / "loader.py").write_text(LOADER)
    tests = Path(__file__).parents[1]
    environment = os.environ | {"PYTHONPATH": f"{tests}:{tests.parent}"}
    command = [sys.executable, str(tmp_path / "loader.py")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert "this process was forked while OpenGL was in use" in done.stderr
    made = simgrab.frames(SCENES["still"], buffers=False)
    expected = [f"{hashlib.sha256(f.rgb).hexdigest()} {f.truth.alpha_deg!r}" for f in made]
    assert done.stdout.splitlines() == expected * 2


@pytest.mark.slow
def test_memory_stays_flat_over_a_hundred_frames():
    """Small pictures, so that they take no hour; of each 0.2 MB would stay if one stayed."""
    code = (
        "import resource, simgrab\n"
        "size = {'camera.width_px': 320, 'camera.height_px': 180, 'frames': 200, 'image.samples': 0,\n"
        "        'image.shadow_map_px': 0, 'place': {'model': 'plain'}}\n"
        "for i, frame in enumerate(simgrab.frames(simgrab.load('quay-day', size))):\n"
        "    if i in (100, 199):\n"
        "        pages = int(open('/proc/self/statm').read().split()[1])\n"
        "        print(pages * resource.getpagesize())\n"
    )
    environment = os.environ | {"PYTHONPATH": str(Path(simgrab.__file__).parents[1])}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    early, late = map(int, done.stdout.split())
    assert late - early < 7.5e6


def test_iterators_do_not_disturb_each_other_and_closing_one_leaves_another_as_it_is():
    """OpenGL's names are the same numbers in every context: what is freed must be the closed one's."""
    scenes = [SCENES["still"], SCENES["clip"]]
    alone = [[frame.rgb for frame in simgrab.frames(scene, buffers=False)] for scene in scenes]
    lasting, closed = (simgrab.frames(scene, buffers=False) for scene in scenes)
    for number in range(4):
        if number < 2:
            np.testing.assert_array_equal(next(closed).rgb, alone[1][number])
        elif number == 2:
            closed.close()
        np.testing.assert_array_equal(next(lasting).rgb, alone[0][number])


@pytest.mark.parametrize("kept", [False, True])
def test_asking_for_buffers_changes_neither_pixels_nor_truth(kept):
    """Behind a lens ids are rendered more finely for labels than for weather, unless the scenario stores them."""
    scene = small_scene(frames=2, image__format="png", image__depth=kept, **FOGGY)
    for plain, full in zip(simgrab.frames(scene, buffers=False), simgrab.frames(scene), strict=True):
        np.testing.assert_array_equal(plain.rgb, full.rgb)
        assert plain.truth == full.truth
        assert full.ids.shape == (270, 480)
