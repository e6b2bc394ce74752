"""Sound files of every kind, made by simgrab itself."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import av
import numpy as np
from PIL import Image

from simgrab.instrument.contract import Frame, Measurement
from simgrab.instrument.estimate.follow import Known
from simgrab.instrument.run import runs
from simgrab.instrument.run.run import measure
from simgrab.instrument.source import camera_beside, fitting, open_source
from simgrab.model import calibration, scenes
from simgrab.model.calibration import Calibration

DATASET, VIDEO, RUN, RUN_OF_VIDEO = "dataset", "swing.mp4", "run", "run-of-video"
TILT, RECORD = "tilt.toml", "record.csv"
CAMERA = f"{DATASET}/camera.toml"
WIDTH, HEIGHT = 480, 270
_SMALL = {
    "camera.width_px": WIDTH, "camera.height_px": HEIGHT, "camera.focal": {"model": "pixels", "focal_length_px": 411.2},
    "image.samples": 0, "image.shadow_map_px": 0, "place": {"model": "plain"}, "display.layout": "two-by-four",
}  # fmt: skip
FRAMES, FILMED = 6, 12
#: Format, suffix, Pillow's mode and options of pictures.
PICTURES: tuple[tuple[str, str, str, dict[str, Any]], ...] = (
    ("JPEG", ".jpg", "RGB", {}), ("JPEG", ".jpeg", "L", {"progressive": True}), ("JPEG", ".JPG", "CMYK", {}),
    ("PNG", ".png", "RGB", {}), ("PNG", ".png", "P", {}), ("PNG", ".png", "LA", {}), ("PNG", ".png", "I;16", {}),
    ("PNG", ".png", "1", {}), ("BMP", ".bmp", "RGB", {}), ("WEBP", ".webp", "RGBA", {"lossless": True}),
    ("WEBP", ".webp", "RGB", {"quality": 10}), ("TIFF", ".tif", "RGB", {}), ("TIFF", ".tiff", "F", {}),
    ("TIFF", ".tif", "RGB", {"compression": "tiff_lzw"}), ("TIFF", ".tif", "YCbCr", {"compression": "jpeg"}),
    ("GIF", ".png", "RGB", {}), ("JPEG2000", ".jpg", "RGB", {}), ("TGA", ".bmp", "RGB", {}),
)  # fmt: skip
#: Container, suffix, codec and pixel format of videos.
VIDEOS = (
    ("mp4", ".mp4", "libx264", "yuv444p"), ("mp4", ".mp4", "mjpeg", "yuvj420p"), ("mov", ".mov", "mpeg4", "yuv420p"),
    ("matroska", ".mkv", "ffv1", "bgra"), ("matroska", ".mkv", "ffv1", "yuv420p10le"),
    ("webm", ".webm", "libvpx-vp9", "yuva420p"), ("avi", ".avi", "mjpeg", "yuvj422p"),
    ("avi", ".avi", "rawvideo", "bgr24"), ("mjpeg", ".mjpeg", "mjpeg", "yuvj420p"),
    ("mpegts", ".ts", "libx264", "yuv420p"), ("flv", ".flv", "flv", "yuv420p"), ("gif", ".gif", "gif", "rgb8"),
    ("h264", ".h264", "libx264", "yuv420p"), ("nut", ".nut", "ffv1", "rgb48le"),
)  # fmt: skip
#: Texts that FFmpeg takes for films, some of which name other files.
PLAYLISTS = (
    (".mp4", b"ffconcat version 1.0\nfile '/etc/hostname'\n"),
    (".m3u8", b"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n/etc/hostname\n#EXT-X-ENDLIST\n"),
    (".m3u8", b"#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:9/x.ts\n#EXT-X-ENDLIST\n"),
    (".sdp", b"v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 9 RTP/AVP 96\n"),
    (".mp4", b"<?xml version='1.0'?><MPD xmlns='urn:mpeg:dash:schema:mpd:2011'></MPD>"),
    (".y4m", b"YUV4MPEG2 W64 H64 F25:1 C420\nFRAME\n" + b"\x80" * 6144),
)


class _Steady:
    """An instrument that returns a measurement of every status, without using the picture."""

    name = "steady"

    def __call__(self, frames: Iterable[Frame], calibration: Calibration) -> Sequence[Measurement]:  # noqa: ARG002
        """Measure a record."""
        return [self._one(i, frame) for i, frame in enumerate(frames)]

    def _one(self, i: int, frame: Frame) -> Measurement:
        if frame.picture is None:
            return Measurement(status="lost", reason=frame.reason)
        if i % 4 == 3:
            return Measurement(status="missed", reason="no grab found")
        return Measurement(
            status="ok", alpha=0.18, alpha_low=0.17, alpha_high=0.2, danger=0.9, box=(100.0, 80.0, 190.0, 160.0),
            score=0.9,
            centre=(145.0 + i, 120.0 - i), centre_sd=(1.0, 1.0), rope_text="1500 1600", rope_status="read",
            rope_length_m=15.0,
        )  # fmt: skip


def make(folder: Path) -> Path:
    """Render a small dataset and a video into a new folder, and measure them; returns the folder."""
    from simgrab.dataset.render import render
    from simgrab.dataset.video.render import render_video

    render(scenes.load("quay-day", _SMALL | {"frames": FRAMES}), folder / DATASET)
    render_video(scenes.load("free-swing", _SMALL | {"frames": FILMED}), folder / VIDEO)
    for source, run in ((DATASET, RUN), (VIDEO, RUN_OF_VIDEO)):
        _measured(folder / source, folder / run)
    covariance = tuple(tuple(row) for row in np.diag([1e-4, 1e-4, 1e-2, 1e-2]).tolist())
    tilt = Known("rope-aware", FRAMES, 3.0, 10.0, (0.0, 0.6, -0.3), covariance)
    (folder / TILT).write_text(tilt.to_toml(), encoding="utf-8")
    (folder / RECORD).write_text(_record(), encoding="utf-8")
    return folder


def _measured(source: Path, out: Path) -> None:
    camera = calibration.load(camera_beside(source))
    opened = open_source(source)
    found = measure(fitting(iter(opened), camera), camera, _Steady(), source=opened.name)
    out.mkdir()
    runs.save(found, out)


def _record() -> str:
    """Write a swing of 3° on a rope that is hoisted."""
    time = np.arange(40) / 9.0
    phase, size = np.sqrt(9.81 / 15) * time, 411.2 * np.deg2rad(3)
    u, v = size * np.cos(phase) + WIDTH / 2 + 5, size * 0.5 * np.sin(phase) + HEIGHT / 2
    columns = zip(u, v, 15 + 3 * np.cos(time / 2), time, strict=True)
    rows = "".join(f"{u:.2f},{v:.2f},{rope:.2f},{t:.3f}\n" for u, v, rope, t in columns)
    return f"u_px,v_px,rope_length_m,time_s\n{rows}"


def pictures() -> Iterator[tuple[str, bytes]]:
    """Suffix and content of small pictures in several formats, each with a direction of its top, and of a large one."""
    grey = np.random.default_rng(0).integers(0, 256, (33, 64), np.uint8)
    for number, (kind, suffix, mode, options) in enumerate(PICTURES):
        out, exif = io.BytesIO(), Image.Exif()
        exif[0x0112] = number % 10  # of which 1 to 8 exist
        tagged = {"exif": exif} if kind in ("JPEG", "PNG", "WEBP") else {}
        Image.fromarray(grey).convert(mode).save(out, kind, **options, **tagged)
        yield suffix, out.getvalue()
    out = io.BytesIO()
    Image.new("1", (20_000, 4_000)).save(out, "PNG")
    yield ".png", out.getvalue()


def videos() -> Iterator[tuple[str, bytes]]:
    """Suffix and content of short films in several formats, every third with gaps between its time stamps."""
    for number, (container, suffix, codec, pixels) in enumerate(VIDEOS):
        out = io.BytesIO()
        with av.open(out, "w", format=container, container_options={"fflags": "+bitexact"}) as file:
            stream: Any = file.add_stream(codec, rate=25)
            stream.width, stream.height, stream.pix_fmt = 64, 64, pixels
            for i in range(8):
                grey = np.full((64, 64, 3), 30 * i, np.uint8)
                frame = av.VideoFrame.from_ndarray(grey, format="rgb24").reformat(format=pixels)
                frame.pts = i if number % 3 else i**3
                file.mux(stream.encode(frame))
            file.mux(stream.encode(None))
        yield suffix, out.getvalue()
    yield from PLAYLISTS
