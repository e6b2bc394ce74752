"""Videos that break off anywhere give what they held, and say so."""

import contextlib
import struct

import av
import cv2
import numpy as np
import pytest
from conftest import slow_but
from films import film

from simgrab.dataset.video.coder import Coder
from simgrab.errors import SourceError
from simgrab.instrument.video import Video
from simgrab.model.scenario import Camera, Clip

COUNT, SIZE, TICKS = 12, (128, 72), 90_000
NOT_SENT = 7


def noise(i, size=SIZE):
    return np.random.default_rng(i).integers(0, 256, (size[1], size[0], 3), np.uint8)


def coded(path, name="mp4", ticks=TICKS):
    """A video by simgrab of 12 pictures with jittered time stamps, in three groups; gives the stamps."""
    jitter = np.random.default_rng(1).integers(0, ticks // 50, COUNT)
    pts = [round(ticks * i / 9) + int(jitter[i]) * (i > 0) for i in range(COUNT) if i != NOT_SENT]
    with Coder(path, name, ticks, Camera(width_px=SIZE[0], height_px=SIZE[1]), Clip(gop_frames=4)) as coder:
        for i, at in enumerate(pts):
            coder.send(noise(i), at)
    return pts


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    path = tmp_path_factory.mktemp("own") / "a.mp4"
    return path, coded(path)


def boxes(data):
    found, at = [], 0
    while at < len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        found.append((kind.decode(), at, at + length))
        at += length
    return found


def test_an_mp4_by_simgrab_is_in_fragments_with_the_time_stamps_it_was_given(own, tmp_path):
    path, pts = own
    kinds = [kind for kind, _, _ in boxes(path.read_bytes())]
    assert kinds == ["ftyp", "moov", "sidx", *["moof", "mdat"] * 3, "mfra"]
    with av.open(str(path)) as file:
        assert [frame.pts for frame in file.decode(video=0)] == pts
    coded(tmp_path / "b.mp4")
    assert (tmp_path / "b.mp4").read_bytes() == path.read_bytes()


def test_others_read_it(own):
    path, pts = own
    opened = cv2.VideoCapture(str(path))
    assert sum(iter(lambda: opened.read()[0], False)) == len(pts)


def test_how_many_frames_it_has_is_known_beforehand(own):
    path, _ = own
    assert Video(path).count == pytest.approx(COUNT, abs=1)  # the one that was not sent included


def measured(path):
    """Frames of a file; none where not even the first picture is there."""
    with contextlib.suppress(SourceError):
        return list(Video(path))
    return []


@pytest.mark.parametrize(("around", "stride"), slow_but([((0,), 9973), ((-1, 0, 1, 7, 8, 9, 60), 1999)], ((0,), 9973)))
def test_it_is_measured_up_to_wherever_it_breaks_off(own, tmp_path, around, stride):
    path, _ = own
    data, whole = path.read_bytes(), list(Video(path))
    parts = boxes(data)
    header, last = parts[1][2], parts[-1][1]
    ends = {end + off for _, _, end in parts[1:-1] for off in around}
    seen = []
    for end in sorted(ends | set(range(header, last, stride))):
        (tmp_path / "cut.mp4").write_bytes(data[:end])
        if end < header:
            assert not measured(tmp_path / "cut.mp4")
            continue
        frames = measured(tmp_path / "cut.mp4")
        given = [frame for frame in frames if frame.picture is not None]
        pictures = [frame for frame in whole if frame.picture is not None]
        for a, b in zip(given, pictures, strict=False):
            assert a.time_s == b.time_s
            np.testing.assert_array_equal(a.picture, b.picture)
        if frames and end < last:
            assert frames[-1].reason == "the video is truncated here (the file is cut off)"
            assert sum("is truncated" in frame.reason for frame in frames) == 1
        elif frames:  # every picture is there
            assert len(frames) == len(whole)
        seen.append(len(given))
    assert seen == sorted(seen)
    assert set(seen) == set(range(len(pictures) + 1))


def test_half_of_any_container_that_states_its_length_breaks_off(tmp_path):
    coded(tmp_path / "a.mkv", "matroska", 1000)
    film(tmp_path / "first.mp4", np.arange(COUNT) / 9, SIZE, options={"movflags": "faststart"}, draw=noise)
    film(tmp_path / "a.avi", np.arange(COUNT) / 9, SIZE, draw=noise)
    for name in ("a.mkv", "first.mp4", "a.avi"):
        data = (tmp_path / name).read_bytes()
        assert not any("truncated" in frame.reason for frame in Video(tmp_path / name))
        (tmp_path / name).write_bytes(data[: len(data) // 2])
        frames = list(Video(tmp_path / name))
        assert sum(frame.picture is not None for frame in frames) >= 3, name
        assert frames[-1].reason == "the video is truncated here (the file is cut off)"


@pytest.mark.parametrize("tail", [bytes(4096), b"GPS 57.7N 11.9E" * 50, b"\0\0\0"])
def test_what_is_appended_to_an_mp4_does_no_harm(own, tmp_path, tail):
    film(tmp_path / "plain.mp4", np.arange(COUNT) / 9, SIZE, draw=noise)
    (tmp_path / "own.mp4").write_bytes(own[0].read_bytes())
    for name in ("plain.mp4", "own.mp4"):
        frames = list(Video(tmp_path / name))
        with (tmp_path / name).open("ab") as file:
            file.write(tail)
        more = list(Video(tmp_path / name))
        assert [(frame.time_s, frame.reason) for frame in more] == [(frame.time_s, frame.reason) for frame in frames]
