"""Sources of frames: what they give, what they make of what is lost, and how they end on what is none."""

import gc
import os
import socket
import threading
import time
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from av.filter import Graph
from av.stream import Disposition
from films import SIZE, film, picture
from streams import over_http, over_rtsp, over_tcp

from simgrab.errors import SourceError
from simgrab.instrument import video
from simgrab.instrument.contract import Frame
from simgrab.instrument.pipeline import ahead
from simgrab.instrument.source import camera_beside, fitting, open_source, plain_name
from simgrab.instrument.video import Video
from simgrab.model.calibration import Calibration

RATE = 9.0


@pytest.fixture(autouse=True)
def _a_lost_stream_is_not_waited_for(monkeypatch):
    monkeypatch.setattr(video, "GIVE_UP_S", 0.0)


def even(n, rate=RATE):
    return np.arange(n) / rate


def coded(path, codec, pixels, stamp=None):
    """Write 20 pictures at 25 a second, or at these time stamps in ms."""
    with av.open(str(path), "w") as file:
        stream = file.add_stream(codec, rate=25)
        stream.width, stream.height = size = (128, 96)
        stream.pix_fmt = pixels
        if stamp:
            stream.time_base = stream.codec_context.time_base = Fraction(1, 1000)
        for i in range(20):
            frame = av.VideoFrame.from_ndarray(picture(i, size), format="rgb24")
            if stamp:
                frame.pts, frame.time_base = stamp(i), Fraction(1, 1000)
            file.mux(stream.encode(frame))
        file.mux(stream.encode(None))
    return path


def times_of(frames):
    return [frame.time_s for frame in frames]


def test_a_video_gives_its_pictures_at_their_times(tmp_path):
    source = open_source(film(tmp_path / "a.mp4", even(20)))
    frames = list(source)
    assert source.count == 20
    assert times_of(frames) == pytest.approx(even(20), abs=2e-4)
    for i, frame in enumerate(frames):
        assert frame.picture.shape == (SIZE[1], SIZE[0], 3)
        assert np.abs(frame.picture.astype(int) - picture(i)).mean() < 6
    assert times_of(source) == times_of(frames)  # again from the beginning


def corners(_, size):
    """A picture with no symmetry."""
    rgb = np.full((size[1], size[0], 3), 60, np.uint8)
    rgb[: size[1] // 3, : size[0] // 4] = (220, 40, 40)
    rgb[-(size[1] // 3) :, : size[0] // 2] = (40, 200, 60)
    return rgb


def turned(*how):
    return lambda stream: stream.set_display_rotation(*how)


def wide(aspect):
    def state(stream):
        stream.codec_context.sample_aspect_ratio = Fraction(aspect)

    return state


TURNS = {  # counterclockwise by degrees, then mirrored left to right, top to bottom: what a player makes of the picture
    (0, False, False): lambda p: p,
    (90, False, False): lambda p: np.rot90(p),
    (180, False, False): lambda p: np.rot90(p, 2),
    (270, False, False): lambda p: np.rot90(p, 3),
    (0, True, False): lambda p: p[:, ::-1],
    (0, False, True): lambda p: p[::-1],
    (90, True, False): lambda p: np.rot90(p)[:, ::-1],
    (90, False, True): lambda p: np.rot90(p)[::-1],
}


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv"])
def test_pictures_are_turned_as_their_file_states(tmp_path, name):
    upright = next(iter(open_source(film(tmp_path / name, even(1), draw=corners)))).picture
    for how, shown in TURNS.items():
        (frame,) = open_source(film(tmp_path / name, even(1), draw=corners, state=turned(*how)))
        np.testing.assert_array_equal(frame.picture, shown(upright), str(how))
        assert bool(frame.note) == any(how)
    with pytest.raises(SourceError, match=r"are to be turned by -?45°; only quarter turns are read"):
        list(open_source(film(tmp_path / name, even(1), state=turned(45, False, False))))


@pytest.mark.parametrize(("aspect", "size"), [("4/3", (85, 36)), ("3/4", (64, 48)), ("1", SIZE), ("64/64", SIZE)])
@pytest.mark.parametrize("name", ["a.mp4", "a.mkv", "a.ts", "a.h264"])
def test_pixels_are_made_square(tmp_path, name, aspect, size):
    (frame, *_) = open_source(film(tmp_path / name, even(3), draw=corners, state=wide(aspect)))
    plain = next(iter(open_source(film(tmp_path / name, even(3), draw=corners)))).picture
    assert frame.picture.shape[1::-1] == size
    assert np.abs(cv2.resize(plain, size, interpolation=cv2.INTER_LINEAR) - frame.picture.astype(int)).max() <= 1
    assert ("are made square: 64x36 px become" in frame.note) == (size != SIZE)


def test_pixels_are_made_square_before_the_picture_is_turned(tmp_path):
    def state(stream):
        wide("4/3")(stream)
        turned(90, False, False)(stream)

    (frame,) = open_source(film(tmp_path / "a.mp4", even(1), state=state))
    assert frame.picture.shape == (85, 64 - 28, 3)


def test_a_picture_that_becomes_too_large_is_refused(tmp_path):
    path = film(tmp_path / "a.mp4", even(1), (64, 600), state=wide("300"))
    with pytest.raises(SourceError, match="it has 19200 x 600 px; the limit is"):
        open_source(path)


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv", "a.ts"])
def test_time_counts_from_the_first_frame(tmp_path, name):
    path = film(tmp_path / name, 1.4 + even(20))
    with av.open(str(path)) as file:
        assert next(file.decode(video=0)).time >= 1.4 - 1e-3
    frames = list(open_source(path))
    assert times_of(frames) == pytest.approx(even(20), abs=2e-3)
    assert frames[0].time_s == 0
    for k in (0, 3, 12, 19):
        found = next(f for f in Video(path).from_time(times_of(frames)[k]) if f.time_s >= times_of(frames)[k] - 1e-6)
        np.testing.assert_array_equal(found.picture, frames[k].picture)


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv", "a.ts", "a.avi", "a.h264"])
def test_frames_that_are_coded_in_another_order_have_their_times(tmp_path, name):
    frames = list(open_source(coded(tmp_path / name, "libx264", "yuv420p")))
    assert times_of(frames) == pytest.approx(even(20, 25), abs=2e-3)
    levels = [frame.picture[20:40, 70:120].mean() for frame in frames]
    assert levels == sorted(levels)


def test_frames_without_time_stamps_have_the_rate_that_is_given_stated_or_assumed(tmp_path):
    raw = coded(tmp_path / "a.h264", "libx264", "yuv420p")  # states its rate beside each key frame
    absurd = film(tmp_path / "b.h264", even(6), coding={"tune": "psnr"})  # states its former time stamps' resolution
    jpegs(tmp_path / "a.mjpeg", count=6)
    assert times_of(open_source(raw)) == pytest.approx(even(20, 25))
    assert times_of(open_source(raw, rate_hz=12)) == pytest.approx(even(20, 12))
    pictures = b"".join(b"FRAME\n" + bytes([i] * 64 * 36) for i in range(6))
    (tmp_path / "b.y4m").write_bytes(b"YUV4MPEG2 W64 H36 F12:1 Cmono\n" + pictures)
    assert times_of(open_source(tmp_path / "b.y4m")) == pytest.approx(even(6, 12))
    for path in (tmp_path / "a.mjpeg", absurd):
        assumed, given = (list(open_source(path, rate_hz=rate)) for rate in (None, 12))
        assert times_of(assumed) == pytest.approx(even(6))
        assert times_of(given) == pytest.approx(even(6, 12))
        assert {frame.note for frame in assumed} == {"without time stamps, 9 frames/s are assumed (--rate)"}
        assert {frame.note for frame in given} == {""}
    with over_http(tmp_path) as url:
        assert times_of(open_source(f"{url}/a.mjpeg", rate_hz=12)) == pytest.approx(even(6, 12))


def test_the_stream_that_players_show_is_read(tmp_path):
    def two(path, *dispositions):
        with av.open(str(path), "w") as file:
            streams = []
            for size, disposition in zip(((128, 96), SIZE), dispositions, strict=True):
                stream = file.add_stream("mjpeg", rate=9)
                stream.width, stream.height, stream.pix_fmt = *size, "yuvj420p"
                stream.disposition = disposition
                streams.append((stream, size))
            for i in range(3):
                for stream, size in streams:
                    file.mux(stream.encode(av.VideoFrame.from_ndarray(picture(i, size), format="rgb24")))
        return next(iter(open_source(path)))

    none, default, cover = Disposition(0), Disposition.default, Disposition.attached_pic
    frame = two(tmp_path / "a.mkv", none, default)
    assert frame.picture.shape[1::-1] == SIZE
    assert frame.note == "of 2 video streams FFmpeg's #1 is read"
    frame = two(tmp_path / "b.mkv", none, none)
    assert frame.picture.shape[1::-1] == (128, 96)
    assert frame.note == "of 2 video streams FFmpeg's #0 is read"
    frame = two(tmp_path / "c.mp4", cover, default)
    assert frame.picture.shape[1::-1] == SIZE
    assert not frame.note
    with pytest.raises(SourceError, match=r"d\.mp4: it has no pictures"):
        two(tmp_path / "d.mp4", cover, cover)


@pytest.mark.parametrize("first", [0, 1])
def test_what_moves_is_read_of_the_first_field_and_what_stands_still_of_both(tmp_path, first):
    def at(moment):
        rgb = np.full((64, 64, 3), 60, np.uint8)
        rgb[:24:2] = 200  # stands still, in rows that are in one field alone
        rgb[32:, 4 + 6 * moment :][:, :12] = 220
        return rgb

    def woven(i, _):
        rgb = at(2 * i)
        rgb[1 - first :: 2] = at(2 * i + 1)[1 - first :: 2]
        return rgb

    def fields(frame):
        graph = Graph()
        source = graph.add_buffer(width=64, height=64, format=frame.format, time_base=Fraction(1, 9))
        order = graph.add("setfield", "bff" if first else "tff")
        graph.link_nodes(source, order, graph.add("buffersink")).configure()
        graph.push(frame)
        return graph.vpull()

    lossless = {"qp": "0", "x264-params": "tff=1", "tune": "psnr"}
    path = film(tmp_path / "a.mp4", even(4), (64, 64), None, woven, lossless, mark=fields)
    frames = list(open_source(path))
    with av.open(str(path)) as file:
        coded = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
    assert len(frames) == 4
    for i in (1, 2, 3):
        shown = frames[i].picture.astype(int)
        assert np.abs(shown[2:22] - coded[i][2:22]).max() <= 4
        bright = shown[34:62, :, 1] > 140
        assert (bright == (at(2 * i)[34:62, :, 1] > 140)).mean() > 0.98, i
        assert frames[i].note == "of interlaced pictures the first field is read where they move"


@pytest.mark.slow  # FFmpeg makes a table of colours, which takes seconds
def test_light_beyond_standard_range_is_brought_into_it(tmp_path):
    def pq(stream):
        codec = stream.codec_context
        codec.color_trc, codec.color_primaries, codec.colorspace = 16, 9, 9

    def white(_, size):  # of 203 cd/m2, which is diffuse white
        return np.full((size[1], size[0], 3), 148, np.uint8)

    (frame,) = open_source(film(tmp_path / "a.mp4", even(1), draw=white, state=pq))
    assert frame.picture.mean() > 190
    assert frame.note == "HDR (PQ) is brought to standard range"


@pytest.mark.parametrize(
    ("times", "lost"),
    [
        (even(30), [12, 20, 21, 22]),
        (np.maximum(even(60) + np.random.default_rng(0).uniform(-0.02, 0.02, 60), 0), []),  # jitter loses nothing
        (np.array([0, 1 / 9, 2 / 9, 50_000 + 1 / 9, 100_000]), [3]),  # an endless gap is one lost frame
    ],
)
def test_gaps_are_lost_frames(tmp_path, times, lost):
    frames = list(open_source(film(tmp_path / "a.mp4", np.delete(times, lost))))
    assert [i for i, f in enumerate(frames) if f.picture is None] == lost
    assert all(("without a picture" in f.reason) == (f.picture is None) for f in frames)
    assert times_of(frames) == pytest.approx(times - times[0], abs=2e-4)


def test_a_change_of_frame_rate_is_followed(tmp_path):
    times = np.concatenate([even(60), 60 / RATE + even(60, 4.5)])
    frames = list(open_source(film(tmp_path / "a.mp4", times)))
    lost = [f for f in frames if f.picture is None]
    assert len(frames) - len(lost) == 120
    assert len(lost) <= 16  # until the slower rate is believed
    assert np.diff(times_of(frames)).min() > 0


@pytest.mark.parametrize("stamp", [2**61, -(2**61)])
def test_time_stamps_beyond_what_doubles_resolve_count_as_missing(tmp_path, stamp):
    path = coded(tmp_path / "a.mkv", "mjpeg", "yuvj420p", lambda i: stamp + 40 * i)
    assert times_of(open_source(path)) == pytest.approx(even(20, 25))


def jpegs(path, head=b"", count=8):
    """JPEGs one after another, as cameras send them."""
    path.write_bytes(b"".join(head + cv2.imencode(".jpg", picture(i))[1].tobytes() for i in range(count)))
    return path


FORMATS = {
    "a.gif": lambda path: coded(path, "gif", "rgb8"),
    "a.wtv": lambda path: coded(path, "mpeg2video", "yuv420p"),
    "a.rm": lambda path: coded(path, "rv20", "yuv420p"),
    "a.mjpeg": jpegs,
    "one.mjpeg": lambda path: jpegs(path, count=1),
    "a.mjpg": lambda path: jpegs(path, b"\r\n--frame\r\nContent-Type: image/jpeg\r\n\r\n"),
}


@pytest.mark.parametrize("name", FORMATS)
def test_other_formats_are_read(tmp_path, name):
    frames = list(open_source(FORMATS[name](tmp_path / name)))
    assert len(frames) == (20 if "jp" not in name else 1 if "one" in name else 8)
    assert all(frame.picture is not None for frame in frames)
    if "jp" not in name:
        assert np.diff(times_of(frames)) == pytest.approx(np.full(19, 0.04), abs=1e-3)


def test_damaged_packets_do_not_end_a_video(tmp_path):
    rng = np.random.default_rng(1)
    path = film(tmp_path / "a.mkv", even(60), draw=lambda _, size: rng.integers(0, 255, (*size[::-1], 3), np.uint8))
    data = bytearray(path.read_bytes())
    for at in rng.integers(2000, len(data) - 2000, 12):
        data[at : at + 20] = rng.bytes(20)
    path.write_bytes(data)
    frames = list(open_source(path))
    assert len(frames) > 10
    assert all(frame.reason or frame.picture is not None for frame in frames)
    assert np.diff(times_of(frames)).min() > 0


def test_what_is_no_source(tmp_path):
    (tmp_path / "text.mp4").write_text("not a video")
    (tmp_path / "text.txt").write_text("a film of a terminal, for FFmpeg\n" * 50)
    (tmp_path / "empty.mp4").touch()
    (tmp_path / "folder").mkdir()
    for name in ("text.mp4", "text.txt", "empty.mp4", "folder", "missing"):
        with pytest.raises(SourceError, match=name):
            open_source(tmp_path / name)
    with pytest.raises(SourceError, match="127"):
        open_source("tcp://127.0.0.1:9")


def test_decoded_frames_are_released_at_once(tmp_path):
    source = iter(open_source(film(tmp_path / "a.ts", even(40))))
    gc.collect()
    gc.disable()
    try:
        for _ in range(35):
            next(source)
        assert sum(type(o) is av.VideoFrame for o in gc.get_objects()) < 10
    finally:
        gc.enable()


def test_what_cannot_be_a_source_is_named(tmp_path, monkeypatch):
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "socket"))
    os.mkfifo(tmp_path / "pipe.png")
    for path, reason in {
        "/dev/null": "it is a device, not a file or folder",
        tmp_path / "pipe.png": "it is a pipe, not a file or folder",
        tmp_path / "socket": "it is a socket, not a file or folder",
        tmp_path / ("a" * 300): r"cannot be read \(File name too long\)",
        "/dev/null/a.mp4": r"cannot be read \(Not a directory\)",
        "a\0.mp4": r"cannot be read \(embedded null byte\)",
    }.items():
        with pytest.raises(SourceError, match=reason):
            open_source(path)
        with pytest.raises(SourceError, match=reason):
            camera_beside(path)
    cv2.imwrite(str(tmp_path / "a.png"), picture(3))
    (tmp_path / "camera.toml").touch()
    monkeypatch.chdir(tmp_path)
    assert open_source(".").count == 2
    assert camera_beside(".").is_file()
    for ask in (open_source, camera_beside):
        with pytest.raises(SourceError, match="the source is empty"):
            ask("")

    def closed(_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", closed)
    with pytest.raises(SourceError, match=r"cannot be read \(Permission denied\)"):
        open_source(tmp_path)


def test_a_stream_is_read_once_and_gives_what_came_before_it_broke(tmp_path):
    data = film(tmp_path / "a.mkv", even(40)).read_bytes()
    with over_tcp(data[: len(data) * 3 // 4]) as url:
        source = open_source(url)
        frames = list(source)
    assert source.live
    seen = [f for f in frames if f.picture is not None]
    assert 20 <= len(seen) < 40
    with pytest.raises(SourceError, match="once"):
        list(source)


def other_files(folder, at):
    """Files that name others, of which FFmpeg would open the first; each with a video's name."""
    (folder / "list.m3u8").write_text(f"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:6,\n{at}\n#EXT-X-ENDLIST\n")
    (folder / "list.mp4").write_text(f"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:6,\n{at}\n#EXT-X-ENDLIST\n")
    for name in ("script.mp4", "script.txt"):
        (folder / name).write_text("ffconcat version 1.0\nfile secret.ts\n")
    (folder / "session.sdp").write_text("v=0\no=- 0 0 IN IP4 127.0.0.1\ns=-\nt=0 0\nm=video 9 RTP/AVP 96\n")
    (folder / "dash.mpd").write_text(
        '<?xml version="1.0"?><MPD xmlns="urn:mpeg:dash:schema:mpd:2011" type="static"><Period><AdaptationSet '
        f'mimeType="video/mp2t"><Representation id="1"><BaseURL>{at}</BaseURL></Representation></AdaptationSet>'
        "</Period></MPD>"
    )
    return ("list.m3u8", "list.mp4", "script.mp4", "script.txt", "session.sdp", "dash.mpd")


def test_a_file_that_names_others_is_refused(tmp_path):
    secret = film(tmp_path / "secret.ts", even(20))
    for name in other_files(tmp_path, f"file://{secret}"):
        with pytest.raises(SourceError, match=rf"{name}: not a video .*playlists are not followed"):
            open_source(tmp_path / name)
    with over_http(tmp_path) as url:
        for name in other_files(tmp_path, "secret.ts"):
            with pytest.raises(SourceError, match=rf"{name}: not a video that can be opened"):
                open_source(f"{url}/{name}")
        assert len(list(open_source(f"{url}/secret.ts"))) == 20


def test_a_stream_over_http_is_read(tmp_path):
    def draw(i, size):
        return np.random.default_rng(i).integers(0, 255, (*size[::-1], 3), np.uint8)

    noisy = {"size": (320, 240), "draw": draw}
    film(tmp_path / "a.mp4", even(12), **noisy)  # its index is at its end
    film(tmp_path / "first.mp4", even(12), options={"movflags": "faststart"}, **noisy)
    film(tmp_path / "a.mkv", even(12), **noisy)
    for ranges, names in ((True, ("a.mp4", "first.mp4", "a.mkv")), (False, ("first.mp4", "a.mkv"))):
        with over_http(tmp_path, ranges=ranges) as url:
            for name in names:
                source = open_source(f"{url}/{name}")
                frames = list(source)
                assert source.live
                assert times_of(frames) == pytest.approx(even(12), abs=2e-3)
                assert all(frame.picture is not None for frame in frames)
    with over_http(tmp_path, ranges=False) as url:
        with pytest.raises(SourceError, match=r"a\.mp4: the video ends before its first image .*byte ranges"):
            list(open_source(f"{url}/a.mp4"))
        with pytest.raises(SourceError, match=r"none\.mp4: not a video that can be opened .*404"):
            open_source(f"{url}/none.mp4")


def test_a_camera_over_rtsp_is_read(tmp_path):
    with over_rtsp(film(tmp_path / "a.mp4", even(30))) as url:
        frames = list(open_source(url))
    assert times_of(frames) == pytest.approx(even(30), abs=2e-3)
    assert np.abs(frames[7].picture.astype(int) - picture(7)).mean() < 6
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(SourceError, match=rf":{port}/1: not a video that can be opened \(Connection refused\)"):
        open_source(f"rtsp://127.0.0.1:{port}/1")


@pytest.mark.parametrize("url", ["file:///etc/hostname", "concat://a.mp4", "subfile://a.mp4", "data://a", "://"])
def test_a_url_of_anything_but_a_stream_is_refused(url):
    with pytest.raises(SourceError, match=r"a stream URL must begin with rtsp://.*; give a file by its path alone"):
        open_source(url)


def test_a_picture_alone_is_a_source(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), picture(3))
    (frame,) = open_source(tmp_path / "a.png")
    np.testing.assert_array_equal(frame.picture, picture(3)[..., ::-1])
    assert (frame.name, frame.time_s) == ("a.png", 0)


def test_pictures_that_are_cut_off_or_too_large_are_lost_with_the_reason(tmp_path):
    for i in range(3):
        cv2.imwrite(str(tmp_path / f"{i}.jpg"), picture(i))
    data = (tmp_path / "1.jpg").read_bytes()
    (tmp_path / "1.jpg").write_bytes(data[: len(data) // 2])
    at = data.index(b"\xff\xc0")
    (tmp_path / "2.jpg").write_bytes(data[: at + 5] + b"\xc3\x50" * 2 + data[at + 9 :])
    lost = [frame.reason for frame in open_source(tmp_path)]
    assert not lost[0]
    assert lost[1].startswith("1.jpg cannot be read as an image: it is cut off")
    assert lost[2].startswith("2.jpg cannot be read as an image: it has 50000 x 50000 px; the limit is 100 megapixels")


def test_a_video_whose_pictures_are_or_become_too_large(tmp_path, monkeypatch):
    before, after = jpegs(tmp_path / "a.mjpeg", count=4).read_bytes(), jpegs(tmp_path / "b.mjpeg").read_bytes()
    at = after.index(b"\xff\xc0")
    (tmp_path / "a.mjpeg").write_bytes(before + after[: at + 5] + b"\xc3\x50" * 2 + after[at + 9 :])
    frames = list(open_source(tmp_path / "a.mjpeg"))
    assert [i for i, frame in enumerate(frames) if frame.picture is None] == [4]
    monkeypatch.setattr("simgrab.io.pictures.MOST_PIXELS", 1000)
    with pytest.raises(SourceError, match=r"b\.mp4: it has 64 x 36 px; the limit is"):
        open_source(film(tmp_path / "b.mp4", even(3)))


def test_any_name_will_do(tmp_path):
    folder = tmp_path / os.fsdecode(b"\xff")
    folder.mkdir()
    (folder / os.fsdecode(b"\xfe.png")).write_bytes(cv2.imencode(".png", picture(0))[1].tobytes())
    source = open_source(folder)
    (frame,) = source
    assert (source.name, frame.name) == (f"{tmp_path}/\\xff", r"\xfe.png")
    assert frame.picture is not None
    assert len(list(open_source(film(folder / "a.mp4", even(5))))) == 5
    with pytest.raises(SourceError, match=r"\\xff/none\.mp4: there is no such"):
        open_source(folder / "none.mp4")


def test_a_folder_of_pictures_has_the_rate_it_is_given(tmp_path):
    for i in range(5):
        cv2.imwrite(str(tmp_path / f"{i}.png"), picture(i))
    assert times_of(open_source(tmp_path)) == pytest.approx(even(5))
    assert times_of(open_source(tmp_path, rate_hz=4.5)) == pytest.approx(even(5, 4.5))
    (tmp_path / "2.png").write_bytes(b"no picture")
    frames = list(open_source(tmp_path))
    assert [f.picture is None for f in frames] == [False, False, True, False, False]
    assert "2.png" in frames[2].reason
    assert frames[1].name == "1.png"
    cv2.imwrite(str(tmp_path / "10.png"), picture(0))
    assert [f.name for f in open_source(tmp_path)][-2:] == ["4.png", "10.png"]


def test_a_rate_is_refused_where_there_are_times(tmp_path, dataset):
    with pytest.raises(SourceError, match="has its own time stamps; --rate applies to image folders and to videos wi"):
        open_source(film(tmp_path / "a.mp4", even(3)), rate_hz=9)
    with pytest.raises(SourceError, match="is a dataset, whose labels contain the times; --rate applies to"):
        open_source(dataset, rate_hz=9)
    cv2.imwrite(str(tmp_path / "a.png"), picture(3))
    with pytest.raises(SourceError, match="this is one picture"):
        open_source(tmp_path / "a.png", rate_hz=12)


@pytest.mark.parametrize("ending", ["png", "tiff"])
@pytest.mark.parametrize("bits", [10, 12, 14, 16])
def test_fewer_bits_stored_in_16_are_scaled_alike_in_a_folder(tmp_path, bits, ending):
    bright = picture(29)
    for i, part in enumerate((1, 1, 8)):  # the last is dark
        cv2.imwrite(str(tmp_path / f"{i}.{ending}"), (bright.astype(np.uint16) + 40 << bits - 8) // part)
    one, _, dark = open_source(tmp_path)
    np.testing.assert_array_equal(one.picture, bright[..., ::-1] + 40)
    np.testing.assert_array_equal(dark.picture, (bright[..., ::-1].astype(int) + 40) // 8)
    noted = f"16-bit pictures are read as of {bits} bits: no greater value was found"
    assert one.note == dark.note == ("" if bits == 16 else noted)


def test_a_picture_of_more_bits_than_those_beside_it_is_lost(tmp_path):
    for i in range(40):
        bits = 16 if i == 7 else 12
        cv2.imwrite(str(tmp_path / f"{i}.png"), picture(i).astype(np.uint16) << bits - 8)
    lost = {i: frame.reason for i, frame in enumerate(open_source(tmp_path)) if frame.picture is None}
    assert list(lost) == [7]
    assert "above the 12 bits of other pictures in its folder" in lost[7]


def test_a_dataset_without_time_has_none(dataset):
    source = open_source(dataset)
    assert source.count == 6
    assert times_of(source) == [None] * 6


def test_pictures_of_another_size(tmp_path):
    camera = Calibration(*SIZE, 60.0, 32.0, 18.0)
    with pytest.raises(SourceError, match="8x8 px, but the camera file states 64x36"):
        list(fitting(iter(open_source(film(tmp_path / "a.mp4", even(3), (8, 8)))), camera))
    for i, size in enumerate([SIZE, (32, 18), SIZE]):
        cv2.imwrite(str(tmp_path / f"{i}.png"), picture(i, size))
    frames = list(fitting(iter(open_source(tmp_path)), camera))
    assert [f.picture is None for f in frames] == [False, True, False]
    assert "32x18" in frames[1].reason
    cv2.imwrite(str(tmp_path / "0.png"), picture(0, (8, 8)))
    with pytest.raises(SourceError, match=r"0\.png is an image of 8x8 px"):
        list(fitting(iter(open_source(tmp_path)), camera))


def test_the_camera_file_lies_in_or_beside_the_source(tmp_path, dataset):
    assert camera_beside(dataset) == dataset / "camera.toml"
    (tmp_path / "a.camera.toml").touch()
    assert camera_beside(tmp_path / "a.mp4") == tmp_path / "a.camera.toml"
    cv2.imwrite(str(tmp_path / "b.png"), picture(0))
    with pytest.raises(SourceError, match="there is no camera file in it or beside it; name one by --camera"):
        camera_beside(tmp_path / "b.png")
    with pytest.raises(SourceError, match="there is no such file or folder"):
        camera_beside(tmp_path / "b.mp4")
    (tmp_path / "matched").mkdir()
    for place in (tmp_path / "matched" / "camera.toml", tmp_path / "camera.toml"):
        place.touch()
        assert camera_beside(tmp_path / "b.png") == place
    assert camera_beside(tmp_path / "a.mp4") == tmp_path / "a.camera.toml"


def test_results_are_named_after_their_source_and_never_after_a_password(tmp_path):
    names = {"a/swing.mp4": "swing", str(tmp_path): tmp_path.name, "rtsp://me:secret@camera/live?key=secret": "live"}
    assert {source: plain_name(source) for source in names} == names
    assert plain_name("rtsp://me:secret@camera") == "stream"


def test_work_ahead_keeps_order_and_raises_where_it_happened():
    def items():
        yield from range(5)
        raise KeyError("here")

    it = ahead(items())
    assert [next(it) for _ in range(5)] == [0, 1, 2, 3, 4]
    with pytest.raises(KeyError):
        next(it)


def test_work_ahead_is_done_meanwhile_and_bounded():
    made = []

    def items():
        for i in range(20):
            made.append((i, threading.current_thread().name))
            yield Frame(None, float(i), "-")

    it = ahead(items(), most=3)
    assert next(it).time_s == 0
    time.sleep(0.05)
    assert len(made) == 4  # three wait, one is out
    assert {name for _, name in made} != {threading.current_thread().name}
    it.close()
    assert len(made) == 4
