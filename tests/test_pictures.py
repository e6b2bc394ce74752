"""Picture files: read whole or not at all, as OpenCV decodes them, and of a size within the limit."""

import contextlib
import os
import struct
import zlib

import cv2
import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import AppendingTiffWriter

from simgrab.errors import DatasetError, PictureError
from simgrab.instrument.source import open_source
from simgrab.io import photographs
from simgrab.io.pictures import MOST_BYTES, MOST_SCANS, MOST_SIDE, bits, of, read

KINDS = (".jpg", ".png", ".bmp", ".tiff", ".webp")


def rgb(width=48, height=36):
    noise = np.random.default_rng(0).integers(0, 256, (height, width, 3), np.uint8)
    return cv2.GaussianBlur(noise, (0, 0), 1.5)


def refused(path, data):
    path.write_bytes(data)
    with pytest.raises(PictureError) as error:
        read(path)
    assert str(error.value) == f"{path} cannot be read as an image: {error.value.reason}"
    return error.value.reason


def png(width, height):
    """A PNG header of any size, with too few pixels."""
    parts = {b"IHDR": struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0), b"IDAT": zlib.compress(b""), b"IEND": b""}
    chunks = (struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in parts.items())
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def saved(path, **options):
    Image.fromarray(rgb()).save(path, **options)
    return path


WHOLE = {
    "turned.jpg": {"exif": b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"},
    "progressive.jpg": {"progressive": True},
    "restarts.jpg": {"restart_marker_rows": 1},
    "plain.png": {}, "plain.bmp": {}, "plain.tif": {}, "lzw.tif": {"compression": "tiff_lzw"},
    "jpeg.tif": {"compression": "jpeg"}, "big.tif": {"big_tiff": True}, "lossy.webp": {},
    "lossless.webp": {"lossless": True},
}  # fmt: skip


@pytest.mark.parametrize("name", WHOLE)
def test_a_file_is_what_opencv_makes_of_it_or_is_refused_where_it_is_cut_off(tmp_path, name):
    path = saved(tmp_path / name, **WHOLE[name])
    np.testing.assert_array_equal(read(path), cv2.imread(str(path), cv2.IMREAD_COLOR_RGB))
    data = path.read_bytes()
    for end in range(16, len(data) - 8, len(data) // 60):
        assert "it is cut off or damaged" in refused(path, data[:end]), end


def test_what_a_camera_appends_to_a_jpeg_or_puts_before_its_picture_does_no_harm(tmp_path):
    whole, small = (cv2.imencode(".jpg", rgb(*size))[1].tobytes() for size in ((48, 36), (16, 12)))
    (tmp_path / "a.jpg").write_bytes(whole)
    thumbnail = b"\xff\xe1" + struct.pack(">H", 2 + len(small)) + small
    for data in (whole + b"GPS" * 100, whole[:2] + thumbnail + whole[2:]):
        (tmp_path / "b.jpg").write_bytes(data)
        np.testing.assert_array_equal(read(tmp_path / "b.jpg"), read(tmp_path / "a.jpg"))
    assert "cut off" in refused(tmp_path / "b.jpg", (whole[:2] + thumbnail + whole[2:])[:-100])


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "empty"),
        (b"no picture", "not a JPEG, PNG"),
        (b"GIF89a" + bytes(50), "not a JPEG, PNG"),
        (png(0, 5), "damaged"),
        (png(8, 8), "damaged"),
    ],
)
def test_what_is_no_picture_is_refused(tmp_path, data, reason):
    assert reason in refused(tmp_path / "a.png", data)


@pytest.mark.parametrize("name", ["plain.png", "lossless.webp", "plain.tif"])
def test_what_holds_several_pictures_is_refused_and_one_with_a_preview_is_not(tmp_path, name):
    more = {"save_all": True, "append_images": [Image.fromarray(rgb()[::-1])]}
    path = saved(tmp_path / name, **WHOLE[name] | more)
    assert refused(path, path.read_bytes()) == "it holds several pictures"
    Image.fromarray(rgb()).save(path, save_all=True, append_images=[], **WHOLE[name])
    np.testing.assert_array_equal(read(path), rgb())
    with AppendingTiffWriter(tmp_path / "b.tif", True) as file:
        saved(file, format="TIFF")
        file.newFrame()
        Image.fromarray(rgb(24, 18)).save(file, "TIFF", tiffinfo={254: 1})
    np.testing.assert_array_equal(read(tmp_path / "b.tif"), rgb())


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int32, np.int16])
def test_values_that_are_not_whole_numbers_of_16_bits_are_refused(tmp_path, kind, channels):
    refused(tmp_path / "a.tif", cv2.imencode(".tiff", rgb()[..., :channels].astype(kind))[1].tobytes())


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("kind", [".png", ".tiff"])
def test_pictures_of_16_bits_are_those_of_8(tmp_path, kind, channels):
    (tmp_path / "a").write_bytes(cv2.imencode(".png", rgb()[..., :channels])[1].tobytes())
    data = cv2.imencode(kind, rgb()[..., :channels].astype(np.uint16) * 257)[1].tobytes()
    (tmp_path / "b").write_bytes(data)
    shallow, deep = read(tmp_path / "a"), read(tmp_path / "b")
    assert deep.shape == (36, 48, 3)
    assert np.abs(shallow.astype(int) - deep).max() <= 1
    assert "cut off" in refused(tmp_path / "b", data[: len(data) // 2])


def test_a_picture_alone_that_may_be_of_fewer_bits_or_dark_is_refused(tmp_path):
    data = cv2.imencode(".png", rgb().astype(np.uint16) << 4)[1].tobytes()
    assert "it has fewer bits or is dark; store 8 bits" in refused(tmp_path / "a.png", data)
    np.testing.assert_array_equal(read(tmp_path / "a.png", 12), rgb()[..., ::-1])


def test_bits_that_a_file_states_are_believed_where_its_values_fit(tmp_path):
    def stating(path, picture, stated):
        data = cv2.imencode(".png", picture)[1].tobytes()
        chunk = b"sBIT" + bytes([stated] * 3)
        path.write_bytes(data[:33] + struct.pack(">I", 3) + chunk + struct.pack(">I", zlib.crc32(chunk)) + data[33:])
        return path

    dark = rgb().astype(np.uint16) // 2  # of 12 bits, of which no more than 8 are seen
    assert bits([stating(tmp_path / "a.png", dark, 12)]) == 12
    assert bits([stating(tmp_path / "b.png", dark << 8, 12)]) == 16  # scaled, as PNG asks for
    Image.fromarray(dark[..., 0]).save(tmp_path / "c.tif", tiffinfo={281: 4095})
    assert bits([tmp_path / "c.tif"]) == 12
    for absurd in (0, 4, 32, 200):
        assert bits([stating(tmp_path / "e.png", dark, absurd)]) == 8
    assert bits([saved(tmp_path / "d.png")]) is None
    assert bits([]) is None


@pytest.mark.parametrize("name", ["plain.png", "lzw.tif", "jpeg.tif", "turned.jpg", "lossy.webp"])
def test_a_damaged_picture_prints_nothing(tmp_path, name, capfd):
    path = saved(tmp_path / name, **WHOLE[name])
    data = path.read_bytes()
    for at in range(len(data) // 4, len(data) * 3 // 4, len(data) // 30):
        path.write_bytes(data[:at] + bytes([data[at] ^ 255]) + data[at + 1 :])
        if name == "plain.png":
            assert "damaged" in refused(path, path.read_bytes())
        else:
            with contextlib.suppress(PictureError):
                read(path)
    assert capfd.readouterr() == ("", "")


def test_damaged_exif_does_no_harm(tmp_path):
    exif = {"exif": b"Exif\0\0II*\0\x08\0\0\0\x09\0\x12\x01\x03\0"}  # of nine entries a part of one
    assert read(saved(tmp_path / "a.jpg", **exif)).shape == (36, 48, 3)


@pytest.mark.parametrize("size", [(50_000, 50_000), (10_001, 10_000), (MOST_SIDE + 1, 1), (1, 2**31 - 1)])
def test_a_picture_that_is_too_large_is_refused_by_its_header(tmp_path, size):
    reason = refused(tmp_path / "a.png", png(*size))
    assert reason.startswith(f"it has {size[0]} x {size[1]} px; the limit is ")


@pytest.mark.parametrize("kind", KINDS)
def test_every_kinds_header_states_its_size(tmp_path, kind, monkeypatch):
    monkeypatch.setattr("simgrab.io.pictures.MOST_SIDE", 40)
    assert "48 x 36 px" in refused(tmp_path / "a", cv2.imencode(kind, rgb())[1].tobytes())


def test_scans_of_a_jpeg_are_counted_before_it_is_decoded(tmp_path, monkeypatch):
    """Each takes time for every pixel of the picture, and a few bytes of the file."""
    data = saved(tmp_path / "a.jpg", progressive=True).read_bytes()
    scans = data.count(b"\xff\xda")
    assert scans > 5
    last, end = data.rindex(b"\xff\xda"), data.rindex(b"\xff\xd9")
    (tmp_path / "b.jpg").write_bytes(data[:end] + data[last:end] * (MOST_SCANS - scans) + data[end:])
    read(tmp_path / "b.jpg")
    monkeypatch.setattr("PIL.ImageFile.ImageFile.load", None)
    more = data[:end] + data[last:end] * (MOST_SCANS - scans + 1) + data[end:]
    assert refused(tmp_path / "b.jpg", more) == f"it has more than {MOST_SCANS} scans"


def test_what_is_no_file_or_too_long_is_refused(tmp_path):
    with pytest.raises(PictureError, match=r"none\.jpg cannot be read as an image: No such file"):
        read(tmp_path / "none.jpg")
    os.mkfifo(tmp_path / "pipe.jpg")  # which would be waited for
    for path, kind in ((tmp_path, "a folder"), (tmp_path / "pipe.jpg", "a pipe")):
        with pytest.raises(PictureError, match=f"cannot be read as an image: it is {kind}, not a file"):
            read(path)
    with (tmp_path / "long.jpg").open("wb") as file:
        file.truncate(MOST_BYTES + 1)
    with pytest.raises(PictureError, match="it is 763 MiB; the limit is 763 MiB"):
        read(tmp_path / "long.jpg")


def test_a_folder_has_the_same_pictures_for_every_command(tmp_path):
    """In the order of their numbers, without what macOS, Windows and a Synology NAS put beside them."""
    names = ["frame2.png", "frame10.PNG", "frame11.png"]
    for name in names:
        saved(tmp_path / name, format="PNG")
    for name in ("._frame2.png", ".DS_Store", ".hidden.png", "Thumbs.db", "desktop.ini", "notes.txt", "clip.mp4"):
        (tmp_path / name).write_bytes(b"\0\5\x16\7")
    for folder in ("@eaDir/frame2.png", ".thumbnails", "more", "folder.png"):
        (tmp_path / folder).mkdir(parents=True)
        saved(tmp_path / folder / "small.png")
    files = tuple(tmp_path / name for name in names)
    source = open_source(tmp_path)
    assert of(tmp_path) == source.files == files
    assert "hidden pictures are not read: 2, such as ." in source.note
    assert of(tmp_path, below=True) == (*files, *(tmp_path / folder / "small.png" for folder in ("folder.png", "more")))
    assert {name.split("/")[1] for name in photographs.read(tmp_path, DatasetError).files} == set(names)
    assert of(tmp_path / ".thumbnails") == (tmp_path / ".thumbnails/small.png",)
    (tmp_path / "gone.png").symlink_to("nothing")
    assert of(tmp_path) == (*files, tmp_path / "gone.png")
