"""Videos that break off anywhere give what they held, and say so."""

import io
import struct
import sys
import time
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from conftest import slow_but

from simgrab.dataset.video.coder import Coder
from simgrab.errors import SourceError
from simgrab.instrument.video import Video
from simgrab.io import containers
from simgrab.io.containers import Extent, extent
from simgrab.model.scenario import Camera, Clip

sys.path.insert(0, str(Path(__file__).parent))
from films import film

COUNT, SIZE, TICKS = 12, (128, 72), 90_000
NOT_SENT = 7


def element(identity, content):
    return identity + (len(content) | 1 << 56).to_bytes(8, "big") + content


@pytest.mark.parametrize("cropped", [False, True])
@pytest.mark.parametrize("last", [False, True])
def test_a_matroska_crops_where_its_tracks_say_so_and_not_where_other_bytes_look_so(cropped, last):
    crop = element(b"\x54\xaa", bytes([0, 8 * cropped]))
    tracks = element(b"\x16\x54\xae\x6b", element(b"\xae", element(b"\xe0", crop)))
    void = element(b"\xec", b"\x16\x54\xae\x6b" + b"\x54\xaa\x81\x05" * 9)
    cluster = element(b"\x1f\x43\xb6\x75", void)
    parts = [void, cluster, tracks] if last else [void, tracks, cluster]
    file = io.BytesIO(element(b"\x1a\x45\xdf\xa3", b"") + element(b"\x18\x53\x80\x67", b"".join(parts)))
    assert containers.crops(file, 64, 64) == cropped
    assert extent(file) == Extent(len(file.getvalue()), True)


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
    """Frames of a file; none where not even the first picture is there, if the error says so."""
    try:
        return list(Video(path))
    except SourceError as problem:
        reason = str(problem)
    assert reason.endswith("ends before its first image (the file is cut off)")
    return []


@pytest.mark.parametrize(("around", "stride"), slow_but([((0,), 9973), ((-1, 0, 1, 7, 8, 9, 60), 997)], ((0,), 9973)))
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
            with pytest.raises(SourceError, match="not a video that can be opened"):
                Video(tmp_path / "cut.mp4")
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
        assert extent(io.BytesIO(data)).whole
        (tmp_path / name).write_bytes(data[: len(data) // 2])
        assert not extent(io.BytesIO(data[: len(data) // 2])).whole
        frames = list(Video(tmp_path / name))
        assert sum(frame.picture is not None for frame in frames) >= 3, name
        assert frames[-1].reason == "the video is truncated here (the file is cut off)"


def box(kind, content=b"", length=None):
    return struct.pack(">I4s", 8 + len(content) if length is None else length, kind) + content


def sidx(first, count=0):
    """A segment index of no more references than none, which states that the media begin so many bytes after it."""
    return box(b"sidx", struct.pack(">IIIIIHH", 0, 1, 90_000, 0, first, 0, count))


def riff(length, content=b"AVI " + b"c" * 100):
    return b"RIFF" + struct.pack("<I", length) + content


HEAD, MEDIA = box(b"ftyp", b"isom") + box(b"moov", b"x" * 50), box(b"mdat", b"y" * 50)
MP4 = HEAD + MEDIA
LARGE = struct.pack(">I4sQ", 1, b"mdat", 66) + b"y" * 50
EXTENTS = {  # bytes, how many of them are the container's, whether it is whole
    "empty": (b"", 0, True),
    "a byte": (b"a", 1, True),
    "another format": (b"anything else", 13, True),
    "Matroska without a segment": (b"\x1a\x45\xdf\xa3", 4, True),
    "MP4": (MP4, len(MP4), True),
    "index at its end": (MEDIA + HEAD, len(MP4), True),
    "MP4 of large boxes": (HEAD + LARGE, len(HEAD + LARGE), True),
    "media up to the end": (HEAD + box(b"mdat", b"y" * 50, 0), len(MP4), True),
    "zero padding": (MP4 + bytes(1000), len(MP4), True),
    "GPS trailer": (MP4 + b"GPS 57.7N 11.9E" * 20, len(MP4), True),
    "a short tail": (MP4 + b"\0\0\0\x08mda", len(MP4), True),
    "boxes of a maker's own": (MP4 + box(b"gps ", b"z" * 90) + MEDIA, 2 * len(MEDIA) + len(HEAD) + 98, True),
    "no media": (HEAD, len(HEAD), False),
    "no index": (MEDIA, len(MEDIA), False),
    "media cut off": (MP4[:-1], len(MP4) - 1, False),
    "media of a large box cut off": ((HEAD + LARGE)[:-1], len(HEAD + LARGE) - 1, False),
    "in the header of a large box": ((HEAD + LARGE)[:-54], len(HEAD + LARGE) - 54, False),
    "fragment cut off": (MP4 + box(b"moof", b"z" * 50)[:-1], len(MP4), False),
    "as long as stated": (HEAD + sidx(len(MEDIA)) + MEDIA, len(MP4) + 32, True),
    "longer than stated": (HEAD + sidx(len(MEDIA)) + MEDIA + b"\0\0", len(MP4) + 32, True),
    "less than stated": (HEAD + sidx(len(MEDIA) + 1) + MEDIA, len(MP4) + 32, False),
    "less than stated, and a tail": (HEAD + sidx(len(MEDIA) + 99) + MEDIA + bytes(200), len(MP4) + 32, False),
    "references that are not there": (HEAD + sidx(10**6, 9) + MEDIA, len(MP4) + 32, True),
    "AVI": (riff(104), 112, True),
    "AVI that counts its header": (riff(112), 112, True),
    "AVI of a length not written": (riff(0), 112, True),
    "AVI of no stated length": (riff(0xFFFFFFFF), 112, True),
    "AVI cut off": (riff(114), 112, False),
    "two lists": (riff(104) + riff(104, b"AVIX" + b"c" * 100), 224, True),
    "second list cut off": (riff(104) + riff(200, b"AVIX" + b"c" * 100), 224, False),
}


@pytest.mark.parametrize("name", EXTENTS)
def test_how_far_a_file_goes_and_whether_it_is_whole(name):
    data, end, whole = EXTENTS[name]
    assert extent(io.BytesIO(data)) == Extent(end, whole)


def aperture(width, height):
    clap = box(b"clap", struct.pack(">8I", width, 1, height, 1, 0, 1, 0, 1))
    return box(b"ftyp", b"isom") + box(b"moov", b"x" * 9 + clap)


@pytest.mark.parametrize(
    ("data", "cropped"),
    [
        (aperture(128, 72), False),
        (aperture(128, 70), True),
        (MP4, False),
        (b"\x1a\x45\xdf\xa3" + bytes(9) + b"\x16\x54\xae\x6b\x54\xcc\x81\x10", False),  # no segment
        (b"", False),
    ],
)
def test_a_container_that_crops_pictures_is_known(data, cropped):
    assert containers.crops(io.BytesIO(data), 128, 72) == cropped


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


def test_how_much_is_read_of_boxes_is_bounded(tmp_path):
    with (tmp_path / "long.mp4").open("wb") as file:  # most of it takes no room on the disk
        file.write(HEAD + struct.pack(">I4sQ", 1, b"sidx", 40 * 2**30))
        file.truncate(len(HEAD) + 40 * 2**30)
    empty = HEAD + box(b"free") * 2**23
    for file, end in ((tmp_path / "long.mp4").open("rb"), len(HEAD) + 40 * 2**30), (io.BytesIO(empty), len(empty)):
        begun = time.process_time()
        with file:
            assert extent(file).end == end
        assert time.process_time() - begun < 1.5


def test_boxes_are_looked_at_once(own, monkeypatch):
    looked = []
    monkeypatch.setattr(containers, "extent", lambda file: looked.append(file) or extent(file))
    video = Video(own[0])
    assert len(list(video)) == len(list(video))
    assert len(looked) == 1
