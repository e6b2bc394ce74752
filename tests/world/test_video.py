import hashlib
import json
import resource
import shutil
import subprocess
import tracemalloc
from itertools import pairwise
from pathlib import Path

import av
import cv2
import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
from commands import run
from conftest import SMALL, as_options, digests, small_scene
from test_dataset import stopping

import simgrab
from simgrab.dataset.manifest import identity
from simgrab.dataset.render import render
from simgrab.dataset.video.encode import Shot, encode_clip
from simgrab.dataset.video.files import VideoFiles
from simgrab.dataset.video.render import render_video
from simgrab.dataset.video.transmission import slots
from simgrab.errors import DatasetError, ScenarioError
from simgrab.model import scenes
from simgrab.model.scenario import Camera, Scenario
from simgrab.model.truth import Truth
from simgrab.world.frames import FrameGenerator

ROUGH = {
    "frames": 24,
    "clip.clip_frames": 10,
    "clip.drop_share": 0.2,
    "clip.repeat_share": 0.2,
    "clip.jitter_ms": 15.0,
}
OWN = ("sent", "pts_s", "repeated", "due_s", "rgb_sha256")


def decode(path):
    """Time stamp, s, and picture of every frame."""
    with av.open(str(path)) as file:
        return [
            (frame.time, frame.reformat(format="rgb24", src_colorspace="ITU709").to_ndarray())
            for frame in file.decode(video=0)
        ]


def table(path):
    return pq.read_table(path.with_suffix(".parquet")).to_pylist()


@pytest.fixture(scope="module")
def rough():
    """Three clips, the last of them shorter, of which frames are lost and repeated."""
    return scenes.load("quay-day", SMALL | ROUGH)


@pytest.fixture(scope="module")
def videos(rough, tmp_path_factory):
    """Folder of the rough scene's clips, ``swing-000.mp4`` and so on."""
    folder = tmp_path_factory.mktemp("videos")
    summary = render_video(rough, folder / "swing.mp4")
    assert (summary.clips, summary.made, summary.frames) == (3, 3, 24)
    assert summary.sent + summary.dropped == 24
    assert 0 < summary.repeated < summary.sent < 24
    return folder


def test_pictures_times_and_counts_agree_with_the_table(videos, rough):
    """Dropped and repeated frames included: of each there is at least one, or the test says nothing."""
    dropped = repeated = 0
    with FrameGenerator(rough) as generator:
        for clip in range(3):
            rows, pictures = table(videos / f"swing-{clip:03d}.mp4"), decode(videos / f"swing-{clip:03d}.mp4")
            span = rough.clip.span(clip, rough.frames)
            assert [row["pts_s"] for row in rows] == [time_s for time_s, _ in pictures]
            assert [row["sent"] for row in rows] == list(range(len(rows)))
            for row, (_, picture) in zip(rows, pictures, strict=True):
                assert (row["clip"], row["time_s"]) == (clip, (row["frame"] - span.start) / 9)
                assert row["due_s"] > row["time_s"] if row["repeated"] else row["due_s"] == row["time_s"]
                drawn = np.ascontiguousarray(generator.frame(row["frame"]).rgb)
                assert hashlib.sha256(drawn).hexdigest() == row["rgb_sha256"]
                assert cv2.PSNR(picture, drawn) > 30
            for (before, row), (earlier, later) in zip(pairwise(rows), pairwise(pictures), strict=True):
                if row["repeated"]:
                    assert {k: v for k, v in row.items() if k not in OWN} == {
                        k: v for k, v in before.items() if k not in OWN
                    }
                    assert cv2.PSNR(earlier[1], later[1]) > 38
                else:
                    assert cv2.PSNR(earlier[1], later[1]) < 30
            dues = {round(row["due_s"] * 9) for row in rows}
            assert max(dues) < len(span)
            dropped += len(span) - len(dues)
            repeated += sum(row["repeated"] for row in rows)
    assert dropped
    assert repeated


@pytest.mark.skipif(not shutil.which("ffprobe"), reason="ffprobe is not installed; PyAV's answer is tested")
@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_ffprobe_agrees(videos, rough, tmp_path, suffix):
    if suffix == ".mkv":
        render_video(rough, tmp_path / "swing.mkv")
    path = (tmp_path if suffix == ".mkv" else videos) / f"swing-000{suffix}"
    command = ["ffprobe", "-v", "error", "-of", "json", "-show_streams", "-show_frames", str(path)]
    found = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    stream = found["streams"][0]
    assert (stream["codec_name"], stream["width"], stream["height"]) == ("h264", 480, 270)
    assert (stream["color_space"], stream["color_range"], stream["has_b_frames"]) == ("bt709", "tv", 0)
    times = [float(frame["pts_time"]) for frame in found["frames"]]
    assert times == pytest.approx([row["pts_s"] for row in table(path)], abs=1e-6)


@pytest.mark.slow
def test_workers_manifest_and_command_line_give_the_same_bytes(videos, tmp_path):
    again = scenes.load(videos / "swing-001.manifest.json")
    render_video(again, tmp_path / "two" / "again.mp4", workers=2)
    assert digests(tmp_path / "two", "again") == digests(videos, "swing")
    command = ["render", "quay-day", *as_options(SMALL | ROUGH), "--quiet", "--workers", 1]
    assert run(*command, "--video", tmp_path / "cli" / "swing.mp4") == (0, "", "")
    assert digests(tmp_path / "cli") == digests(videos)


def test_a_clip_made_alone_is_the_same_and_no_two_are(videos, rough, tmp_path):
    folder = shutil.copytree(videos, tmp_path / "copy")
    for path in folder.glob("swing-001.*"):
        path.unlink()
    assert simgrab.render_video(rough, folder / "swing.mp4", resume=True).made == 1
    assert digests(folder) == digests(videos)
    assert len({hashlib.sha256(p.read_bytes()).hexdigest() for p in videos.glob("*.mp4")}) == 3
    assert simgrab.render_video(rough, folder / "swing.mp4", resume=True).made == 0
    assert digests(folder) == digests(videos)


def test_frames_and_video_come_from_one_run(videos, rough, tmp_path, monkeypatch):
    """Each frame is drawn once, and neither changes the other, interrupted or not."""
    drawn = []
    real = FrameGenerator.frame
    monkeypatch.setattr(FrameGenerator, "frame", lambda self, n, **full: drawn.append(n) or real(self, n, **full))
    summary = render(rough, tmp_path / "both" / "data", video=tmp_path / "both" / "swing.mp4")
    assert drawn == list(range(24))
    assert (summary.made, summary.video.made) == (24, 3)
    render(rough, tmp_path / "alone")
    assert digests(tmp_path / "both" / "data") == digests(tmp_path / "alone")
    assert digests(tmp_path / "both", "swing") == digests(videos, "swing")
    labels = {row["frame"]: row for row in pq.read_table(tmp_path / "alone" / "labels.parquet").to_pylist()}
    for row in table(videos / "swing-002.mp4"):
        known = labels[row["frame"]]
        assert {k: v for k, v in row.items() if k in known and k not in ("clip", "time_s")} == {
            k: v for k, v in known.items() if k in row and k not in ("clip", "time_s")
        }


@pytest.mark.slow
def test_dataset_and_video_are_taken_up_together(videos, rough, tmp_path):
    places = {"out": tmp_path / "data", "video": tmp_path / "swing.mp4"}
    with pytest.raises(KeyboardInterrupt):
        render(rough, **places, progress=stopping(13))
    with pytest.raises(DatasetError, match="--resume"):
        render(rough, **places)
    told = []
    summary = render(rough, **places, resume=True, progress=lambda *done: told.append(done))
    assert told[0] == (10, 24)  # the first clip was finished
    assert max(told) == (24, 24)
    assert 0 < summary.made < 24
    assert summary.video.made == 2
    assert digests(tmp_path, "swing") == digests(videos, "swing")


def test_one_clip_has_no_number(tmp_path):
    scenario = small_scene(frames=3, clip__clip_frames=3)
    render_video(scenario, tmp_path / "a.mp4")
    assert set(digests(tmp_path)) == {"a.mp4", "a.parquet", "a.camera.toml", "a.manifest.json"}
    rows = table(tmp_path / "a.mp4")
    assert [row["pts_s"] for row in rows] == [row["time_s"] for row in rows] == pytest.approx([0, 1 / 9, 2 / 9])
    known = json.loads((tmp_path / "a.manifest.json").read_text())
    for suffix, digest in known["files"].items():
        assert hashlib.sha256((tmp_path / f"a{suffix}").read_bytes()).hexdigest() == digest


@pytest.mark.parametrize(
    ("changes", "name", "message"),
    [
        ({"camera.width_px": 481}, "a.mp4", r"camera\.width_px.*even.*481"),
        ({"camera.height_px": 271}, "a.mp4", r"camera\.height_px.*even"),
        ({"clip.frame_rate_hz": 0}, "a.mp4", r"clip\.frame_rate_hz.*>= 0.01"),
        ({}, "a.avi", r"\.mp4, \.mkv"),
        ({}, "/proc/a.mp4", "cannot write to /proc/a.mp4"),
        ({}, "a file/a.mp4", "cannot write"),
        ({}, "mine.mp4", r"mine\.mp4 exists; choose another"),
        ({"camera.principal_offset_px": [9000.0, 0.0]}, "a.mp4", "the grab is outside the image"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_written(changes, name, message, tmp_path):
    (tmp_path / "a file").write_text("…")
    (tmp_path / "mine.mp4").write_text("…")
    (tmp_path / "manifest.json").write_text('{"simgrab": "of a dataset in the same folder"}')
    before = digests(tmp_path)
    with pytest.raises((ScenarioError, DatasetError), match=message):
        render_video(scenes.load("quay-day", SMALL | changes), tmp_path / name)
    assert digests(tmp_path) == before


def test_no_video_is_overwritten(videos, rough):
    before = digests(videos)
    with pytest.raises(DatasetError, match="--resume, or choose another --video"):
        render_video(rough, videos / "swing.mp4")
    other = msgspec.structs.replace(rough, seed=5)
    with pytest.raises(DatasetError, match="seed differs"):
        render_video(other, videos / "swing.mp4", resume=True)
    with pytest.raises(DatasetError, match="exists"):
        render(rough, videos / "data", video=videos / "swing.mp4")
    assert digests(videos) == before


def test_clips_of_two_renderers_are_never_made(videos, rough, tmp_path):
    folder = shutil.copytree(videos, tmp_path / "copy")
    (folder / "swing-002.mp4").unlink()
    known = json.loads((folder / "swing-000.manifest.json").read_text())
    for renderer, why in (("another", "was started with another"), (None, r"not a simgrab dataset .*renderer")):
        known["renderer"]["renderer"] = renderer
        (folder / "swing-000.manifest.json").write_text(json.dumps(known))
        with pytest.raises(DatasetError, match=why):
            render_video(rough, folder / "swing.mp4", resume=True)


def test_a_strangers_file_is_no_clip(rough, tmp_path):
    (tmp_path / "swing-002.mp4").write_text("…")
    with pytest.raises(DatasetError, match=r"swing-002\.mp4 does not belong to a video that simgrab made"):
        render_video(rough, tmp_path / "swing.mp4", resume=True)
    assert (tmp_path / "swing-002.mp4").read_text() == "…"


def test_two_writers_do_not_share_a_place(rough, tmp_path):
    videos = VideoFiles(rough, identity(rough), tmp_path / "swing.mp4")
    with videos.journal.opened(videos.identity), pytest.raises(DatasetError, match="another simgrab"):
        render_video(rough, tmp_path / "swing.mp4", resume=True)


@pytest.mark.slow
def test_a_full_disk_is_reported_and_survived(videos, rough, tmp_path, monkeypatch):
    real = VideoFiles.draft

    def draft(self, clip, suffix):
        return Path("/dev/full") if (clip, suffix) == (1, ".mp4") else real(self, clip, suffix)

    monkeypatch.setattr(VideoFiles, "draft", draft)
    with pytest.raises(DatasetError, match=r"no space left.*--resume"):
        render_video(rough, tmp_path / "swing.mp4")
    assert not list(tmp_path.glob("swing-001.*"))
    monkeypatch.undo()
    assert render_video(rough, tmp_path / "swing.mp4", resume=True).made == 2
    assert digests(tmp_path) == digests(videos)


@pytest.mark.slow
def test_others_stop_when_a_clip_fails(rough, tmp_path):
    """A clip may be long: nobody waits for it when the run has failed."""
    scenario = msgspec.structs.replace(
        rough, frames=800, clip=msgspec.structs.replace(rough.clip, clip_frames=400, drop_share=0.0)
    )
    (tmp_path / ".swing.mp4.partial" / "001.mp4").mkdir(parents=True)  # clip 1 cannot be written
    with pytest.raises(DatasetError, match="cannot write"):
        render_video(scenario, tmp_path / "swing.mp4", workers=2, resume=True)
    assert not (tmp_path / "swing-000.mp4").exists()  # which the other process would have ended with


def test_memory_does_not_grow_with_the_clip(tmp_path):
    """A fake source of tiny pictures, so that four thousand of them take no minute."""
    with FrameGenerator(small_scene(frames=1)) as generator:
        known, rendered_by = msgspec.json.encode(generator.frame(0).truth), generator.scene(0).renderer.fingerprint
    scenario = Scenario(frames=4000, camera=Camera(width_px=64, height_px=64))
    resident, traced = [], []

    def take(frame):
        if frame % 1000 == 999:
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            resident.append(pages * resource.getpagesize() / 1e6)
            traced.append(tracemalloc.get_traced_memory()[0] / 1e6)
        row = msgspec.json.decode(known, type=Truth)
        return Shot(np.full((64, 64, 3), frame % 256, np.uint8), msgspec.structs.replace(row, frame=frame), "train")

    videos = VideoFiles(scenario, identity(scenario), tmp_path / "long.mp4")
    tracemalloc.start()
    with videos.journal.opened(videos.identity):
        shots = ((slot, take(slot.frame)) for slot in slots(scenario, 0, videos.container.ticks_per_s))
        encode_clip(videos, 0, shots, rendered_by)
    tracemalloc.stop()
    assert pq.read_metadata(tmp_path / "long.parquet").num_rows == 4000
    assert resident[-1] - resident[0] < 5  # what libraries hold
    assert traced[-1] - traced[0] < 0.5  # what Python and NumPy hold; 3,000 rows of labels take twenty times that
