from itertools import pairwise

import av
import cv2
import numpy as np
import pytest

from simgrab.dataset.video.coder import Coder
from simgrab.model.scenario import Camera, Clip


def code(path, pictures, **clip):
    height, width = pictures[0].shape[:2]
    settings = Clip(**clip)
    with Coder(path, "mp4", 90_000, Camera(width_px=width, height_px=height), settings) as coder:
        for index, picture in enumerate(pictures):
            coder.send(picture, round(index * 90_000 / settings.frame_rate_hz))


def test_colours_are_bt709(tmp_path):
    """Y'CbCr of flat colours as ITU-R BT.709 has them; BT.601 would be 20 and more off."""
    for name, rgb in (("red", (255, 0, 0)), ("green", (0, 255, 0)), ("paint", (219, 133, 18)), ("white", (255,) * 3)):
        code(tmp_path / f"{name}.mp4", [np.full((64, 64, 3), rgb, np.uint8)])
        r, g, b = np.array(rgb) / 255
        y = 0.2126 * r + 0.7152 * g + 0.0722 * b
        expected = 16 + 219 * y, 128 + 224 * (b - y) / 1.8556, 128 + 224 * (r - y) / 1.5748
        with av.open(str(tmp_path / f"{name}.mp4")) as file:
            frame = next(file.decode(video=0))
            assert (frame.format.name, frame.colorspace, frame.color_range) == ("yuv420p", 1, 1)
            found = [np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)[16, 16] for plane in frame.planes]
        assert found == pytest.approx(expected, abs=2)


def test_bit_rate_and_key_frames_are_what_was_set(tmp_path):
    noise = np.random.default_rng(0).integers(0, 256, (60, 128, 160, 3), dtype=np.uint8)
    for rate in (0.5, 1.0):
        code(tmp_path / f"{rate}.mp4", list(noise), bit_rate_mbit_s=rate, gop_frames=25)
        with av.open(str(tmp_path / f"{rate}.mp4")) as file:
            packets = [packet for packet in file.demux(video=0) if packet.size]
        assert [i for i, packet in enumerate(packets) if packet.is_keyframe] == [0, 25, 50]
        assert sum(p.size for p in packets) * 8e-6 / (60 / 9) == pytest.approx(rate, rel=0.15)


def test_the_bit_rate_has_two_seconds_of_slack_and_no_more(tmp_path):
    """Long stretches with nothing to send earn no credit for what comes after."""
    noise = np.random.default_rng(0).integers(0, 256, (60, 128, 160, 3), dtype=np.uint8)
    code(tmp_path / "a.mp4", [np.zeros_like(noise[0])] * 60 + list(noise), bit_rate_mbit_s=1.0)
    with av.open(str(tmp_path / "a.mp4")) as file:
        mbit = np.cumsum([0, *(packet.size * 8e-6 for packet in file.demux(video=0) if packet.size)])
    for frames in (9, 18, 36, 60):
        assert (mbit[frames:] - mbit[:-frames]).max() < frames / 9 + 2


def moving(frames, width=640, height=352):
    """A textured ground that pans, before it a striped block that swings, seen with a little noise."""
    rng = np.random.default_rng(0)
    ground = cv2.GaussianBlur(rng.integers(0, 256, (height, 2 * width, 3), dtype=np.uint8), (0, 0), 1.5)
    ground = cv2.normalize(ground, None, 30, 220, cv2.NORM_MINMAX)
    block = np.full((60, 50, 3), (219, 133, 18), np.uint8)
    block[::6] = 40
    for frame in range(frames):
        picture = ground[:, 2 * frame : 2 * frame + width].copy()
        x, y = width // 2 + round(60 * np.sin(0.3 * frame)), 60 + round(20 * np.cos(0.2 * frame))
        picture[y : y + 60, x : x + 50] = block
        yield cv2.add(picture, rng.normal(0, 4, picture.shape), dtype=cv2.CV_8U)


def test_more_bits_show_more(tmp_path):
    """PSNR of luma, dB, of a picture too busy for any of the rates."""
    pictures, psnr = list(moving(40)), []
    luma = [16 + 219 / 255 * (picture @ (0.2126, 0.7152, 0.0722)) for picture in pictures]
    for rate in (0.5, 1.0, 2.0, 4.0):
        code(tmp_path / f"{rate}.mp4", pictures, bit_rate_mbit_s=rate, frame_rate_hz=25.0)
        with av.open(str(tmp_path / f"{rate}.mp4")) as file:
            planes = [frame.planes[0] for frame in file.decode(video=0)]
            shown = [np.frombuffer(p, np.uint8).reshape(-1, p.line_size)[:, : p.width] for p in planes]
        error = np.mean([(a - b) ** 2 for a, b in zip(shown, luma, strict=True)])
        psnr.append(10 * np.log10(255**2 / error))
    assert all(more - less > 0.8 for less, more in pairwise(psnr))
    assert 32 < psnr[0] < 36
    assert 38 < psnr[-1] < 42
