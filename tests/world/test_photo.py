"""A place that is a photograph: the same labels, the photograph's own pixels, and refusals of what is none."""

import io
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from PIL import Image

import simgrab
from simgrab.dataset.notices import notices
from simgrab.errors import ScenarioError
from simgrab.io.photographs import Sequence as Photographs
from simgrab.io.photographs import read
from simgrab.model import scenes
from simgrab.model.scenario import Scenario
from simgrab.world import gl
from simgrab.world.extensions import Recipe
from simgrab.world.frames import FrameGenerator
from simgrab.world.scenery.model import PLACE

SIZE = (320, 180)
SMALL = {
    "camera.width_px": SIZE[0], "camera.height_px": SIZE[1],
    "camera.focal": {"model": "pixels", "focal_length_px": 274},
    "frames": 3, "image.format": "png", "image.shadow_map_px": 1024,
}  # fmt: skip


def photograph(seed: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Random colours, from 40 to 220."""
    return np.random.default_rng(seed).integers(40, 220, (size[1], size[0], 3), np.uint8)


def scene(folder: Path, file: str = "yard.png", **changes: object) -> Scenario:
    """Scene whose place is a file of its folder."""
    (folder / "scene.toml").write_text(f'base = "quay-day"\n[place]\nmodel = "photo"\nfile = "{file}"\n', "utf-8")
    return scenes.load(folder / "scene.toml", SMALL | changes)


@pytest.fixture
def yard(tmp_path: Path) -> Path:
    """Folder with one photograph of the picture's size."""
    Image.fromarray(photograph(1)).save(tmp_path / "yard.png")
    return tmp_path


def test_labels_are_those_of_a_plain_place_and_pixels_are_the_photographs(yard: Path) -> None:
    shown = list(simgrab.frames(scene(yard), (0, 1)))
    plain = list(simgrab.frames(scenes.load(yard / "scene.toml", SMALL | {"place": {"model": "plain"}}), (0, 1)))
    for ours, theirs in zip(shown, plain, strict=True):
        assert ours.truth == theirs.truth
        assert ours.ids is not None
        assert np.array_equal(ours.ids, theirs.ids)
        assert np.array_equal(ours.depth, theirs.depth)
        other = cv2.dilate((ours.ids != PLACE).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        share = ours.rgb[~other].astype(float) / photograph(1)[~other]
        lit = np.abs(ours.rgb[~other].astype(int) - photograph(1)[~other]).max(axis=1) <= 1
        assert 0.6 < lit.mean() < 1.0  # the rest lies in shadow
        assert 0.4 < np.median(share[~lit]) < 0.75


def test_a_lens_shows_the_photograph_as_it_is(yard: Path) -> None:
    smooth = cv2.GaussianBlur(photograph(1), (0, 0), 4)
    Image.fromarray(smooth).save(yard / "yard.png")
    (frame,) = simgrab.frames(scene(yard, **{"camera.distortion.k1": -0.2, "light.sun": 0.0}), (0,))
    assert frame.ids is not None
    other = cv2.dilate((frame.ids != PLACE).astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    assert np.abs(frame.rgb[~other].astype(int) - smooth[~other]).max() <= 2


def test_a_folder_is_drawn_from_by_seed(tmp_path: Path) -> None:
    (tmp_path / "yards").mkdir()
    for i, level in enumerate((60, 120, 180)):
        Image.fromarray(np.full((90, 160, 3), level, np.uint8)).save(tmp_path / "yards" / f"{i}.png")
    (tmp_path / "yards" / "notes.txt").write_text("not shown", "utf-8")
    many = scene(tmp_path, "yards", frames=12, **{"light.sun": 0.0})
    levels = [int(np.median(frame.rgb)) for frame in simgrab.frames(many)]
    assert {60, 120, 180} == set(levels)
    assert levels[7] == int(np.median(next(iter(simgrab.frames(many, (7,)))).rgb))


@pytest.mark.parametrize("varies", [False, True])
def test_a_photograph_is_in_one_split(tmp_path: Path, varies: bool) -> None:
    (tmp_path / "yards").mkdir()
    for i in range(12):
        Image.fromarray(np.full((90, 160, 3), 60 + 10 * i, np.uint8)).save(tmp_path / "yards" / f"{i}.png")
    changes = {"splits": {"train": 0.5, "val": 0.25, "test": 0.25}, "light.sun": 0.0, "frames": 60, "image.samples": 0,
               "image.shadow_map_px": 0, "jib.head": "none"}  # fmt: skip
    if varies:
        changes |= {"clip.clip_frames": 3, "vary": {"camera.beta_deg": {"dist": "uniform", "low": 1.0, "high": 5.0}}}
    shown: dict[str, set[int]] = {"train": set(), "val": set(), "test": set()}
    for seed in (1, 2):
        made = Recipe(scene(tmp_path, "yards", seed=seed, **changes))
        for frame in simgrab.frames(made.scenario, buffers=False):
            shown[made.split(frame.truth.frame)].add(int(np.median(frame.rgb)))
    assert all(shown.values())
    assert sum(map(len, shown.values())) == len(set.union(*shown.values())) == 12


def by_name(folder: Path, names: Sequence[str], shares: dict[str, float]) -> dict[str, set[str]]:
    """Names of the photographs of each split, in a new folder of these."""
    folder.mkdir()
    for name in names:
        Image.fromarray(photograph(1, (32, 32))).save(folder / name)
    own = Photographs(read(folder, AssertionError), AssertionError).shared_out(shares)
    return {split: {sorted(names)[number] for number in numbers} for split, numbers in own.items()}


def test_no_photograph_moves_to_another_split_as_a_folder_grows(tmp_path: Path) -> None:
    names, shares = [f"{i:03d}.png" for i in range(300)], {"train": 0.8, "val": 0.1, "test": 0.1}
    few, many = (by_name(tmp_path / str(count), names[:count], shares) for count in (60, 300))
    for split, share in shares.items():
        assert few[split] == many[split] & set(names[:60])
        assert len(many[split]) == pytest.approx(300 * share, abs=4 * (300 * share * (1 - share)) ** 0.5)
    names = [name for name in names if name not in many["val"]]
    short = by_name(tmp_path / "short", names, shares)
    assert len(short["val"]) == 1
    assert {split: own - short["val"] for split, own in short.items()} == {
        split: own - short["val"] - many["val"] for split, own in many.items()
    }
    assert all(map(len, by_name(tmp_path / "three", names[:3], shares).values()))


def split_lines(scenario: Scenario) -> list[str]:
    return [line for line in notices(Recipe(scenario)) if "photograph" in line]


def test_too_few_photographs_for_the_splits_are_named(yard: Path) -> None:
    (yard / "yards").mkdir()
    for i in range(3):
        Image.fromarray(photograph(i)).save(yard / "yards" / f"{i}.png")
    (yard / "yard.mp4").write_bytes(video(grey(60, 120)))
    (line,) = split_lines(scene(yard, frames=40))
    assert line.startswith("splits: yard.png: 1 photograph for 3 splits")
    (line,) = split_lines(scene(yard, "yard.mp4", frames=40))
    assert "a video for 3 splits" in line
    assert not split_lines(scene(yard, "yards", frames=40))
    assert not split_lines(scene(yard, frames=1))
    assert not split_lines(scene(yard, frames=40, splits={"train": 0.0, "val": 0.0, "test": 1.0}))
    photos = [{"model": "photo", "file": str(yard / name)} for name in ("yards", "yard.png", "yard.mp4")]
    for key, values in (
        ("place", photos), ("light.sun+place", [{"light.sun": 0.5, "place": photo} for photo in photos]),
    ):  # fmt: skip
        varied = {"clip.clip_frames": 4, "vary": {key: {"dist": "one-of", "values": values}}}
        (yard / "varied.toml").write_text('base = "quay-day"\n', "utf-8")
        lines = split_lines(scenes.load(yard / "varied.toml", SMALL | varied | {"frames": 40}))
        assert [line.split(": ")[1] for line in lines] == ["yard.png", "yard.mp4"]
        assert not split_lines(scenes.load(yard / "varied.toml", SMALL | varied | {"frames": 4}))


def test_a_dataset_holds_the_photographs_and_is_made_again(yard: Path) -> None:
    made = scene(yard, frames=1)
    simgrab.render(made, yard / "out", workers=1)
    (yard / "yard.png").unlink()
    again = scenes.load(yard / "out" / "manifest.json")
    assert again.digest() == made.digest()
    assert again.place == made.place


def test_a_dataset_over_a_hundred_photographs_is_read_again(tmp_path: Path) -> None:
    (tmp_path / "photographs").mkdir()
    for i in range(100):
        Image.fromarray(photograph(i, (32, 32))).save(tmp_path / f"photographs/{i:03d}.png")
    scenario = scene(tmp_path, "photographs", frames=1)
    simgrab.render(scenario, tmp_path / "data")
    assert simgrab.open(tmp_path / "data").scenario == scenario


def video(frames: list[np.ndarray], codec: str = "libx264", turned: int = 0, **options: str) -> bytes:
    """Frames of one size."""
    data = io.BytesIO()
    with av.open(data, "w", format="mp4") as container:
        stream = container.add_stream(codec, rate=10, options=options)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "rgb24" if codec.endswith("rgb") else "yuv420p"
        stream.set_display_rotation(turned)
        for rgb in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(rgb, format="rgb24")))
        container.mux(stream.encode())
    return data.getvalue()


def grey(*levels: int) -> list[np.ndarray]:
    return [np.full((90, 160, 3), level, np.uint8) for level in levels]


def test_a_video_goes_on_frame_by_frame_and_repeats(tmp_path: Path) -> None:
    (tmp_path / "yard.mp4").write_bytes(video(grey(60, 120, 180)))
    moving = scene(tmp_path, "yard.mp4", frames=5, **{"light.sun": 0.0})
    levels = [float(np.median(frame.rgb)) for frame in simgrab.frames(moving, (0, 1, 2, 3, 1))]
    assert np.allclose(levels, [60, 120, 180, 60, 120], atol=3)


def test_a_photograph_and_a_video_are_shown_as_players_show_them(tmp_path: Path) -> None:
    rgb, exif = np.kron(photograph(2, (32, 64)), np.ones((2, 2, 1), np.uint8)), Image.Exif()
    exif[0x112] = 6  # to be turned by 90° clockwise
    Image.fromarray(rgb).save(tmp_path / "turned.png", exif=exif)
    (tmp_path / "turned.mp4").write_bytes(video([rgb], "libx264rgb", -90, qp="0"))
    for name in ("turned.png", "turned.mp4"):
        shown = Photographs(read(tmp_path / name, AssertionError), AssertionError)[0]
        np.testing.assert_array_equal(shown, np.rot90(rgb, -1), name)
    cv2.imwrite(str(tmp_path / "deep.png"), rgb[..., 0].astype(np.uint16) * 16)
    with pytest.raises(ScenarioError, match=r"16-bit values .*; store 8 bits"):
        scene(tmp_path, "deep.png")


def png(picture: Image.Image) -> bytes:
    data = io.BytesIO()
    picture.save(data, "PNG")
    return data.getvalue()


WHOLE = png(Image.fromarray(photograph(1)))


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("yard.png", WHOLE[:2000], "cut off"),
        ("yard.png", png(Image.new("1", (10_000, 10_000))), "at most 40 million"),
        ("yard.png", b"hello", "not a JPEG"),
        ("yard.txt", WHOLE, r"must be a folder, or end in one of \.jpg"),
        ("yard.mp4", video(grey(60, 120))[:300], "not a video that can be opened"),
        ("yard.mp4", b"", "not a video that can be opened"),
        ("yard.mp4", b"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:6,\nother.ts\n", "playlists are not followed"),
    ],
)
def test_what_is_no_photograph_is_refused(tmp_path: Path, name: str, content: bytes, problem: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ScenarioError) as refused:
        scene(tmp_path, name)
    assert re.search(problem, str(refused.value))
    assert "\n" not in str(refused.value)
    assert str(refused.value).startswith("place.file")


def test_files_outside_the_scenes_folder_are_read_and_nothing_but_pictures(yard: Path) -> None:
    (yard / "inner").mkdir()
    for file, name in (("../yard.png", "yard.png"), (str(yard / "yard.png"), "yard.png"), ("..", yard.name)):
        assert scene(yard / "inner", file).place.file == name
    for file in ("/etc/hostname", "/", "../inner", "../b\\u0000.png"):
        with pytest.raises(ScenarioError, match=r"place\.file"):
            scene(yard / "inner", file)
    with pytest.raises(ScenarioError, match=r"read by simgrab\.load"):
        scenes.convert({"place": {"model": "photo", "file": "yard.png"}}, Scenario)
    (yard / "inner" / "loop.png").symlink_to("loop.png")
    with pytest.raises(ScenarioError, match=r"loop\.png: Too many levels of symbolic links"):
        scene(yard, "inner")
    with pytest.raises(ScenarioError, match=r"floodlights"):
        scene(yard, **{"light.sun": 0.0, "light.floodlights": 0.5})


SUNS = [(25.0, 135.0), (35.0, 60.0), (57.7, -131.27), (75.0, 30.0)]  # elevation and azimuth, degrees
WIDE = {
    "camera.focal": {"model": "pixels", "focal_length_px": 172}, "image.shadow_map_px": 4096, "jib.head": "none",
}  # fmt: skip


def without_grab(scenario: Scenario) -> np.ndarray:
    """Picture of what stands still."""
    with FrameGenerator(scenario) as generator:
        moment = replace(generator.project(0).moment, present=False)
        return generator.scene(0).renderer.rgb(moment)


@pytest.mark.parametrize(("elevation", "azimuth"), SUNS)
@pytest.mark.parametrize("reuse", ["0", "1"])
def test_level_ground_casts_no_shadow_on_itself(
    yard: Path, elevation: float, azimuth: float, reuse: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(gl.REUSE, reuse)
    sun = {"light.sun_elevation_deg": elevation, "light.sun_azimuth_deg": azimuth}
    rgb = without_grab(scene(yard, **WIDE, **sun))
    assert np.abs(rgb.astype(int) - photograph(1)).max() <= 1
    dim = sun | {"light.sun": 0.3, "light.sky": 0.5}  # without a shadow map, light beyond 1 is cut off
    whole, flat = (
        without_grab(scenes.load("quay-day", SMALL | WIDE | dim | {"place": {"model": "plain"}} | more))
        for more in ({}, {"image.shadow_map_px": 0})
    )
    assert np.abs(whole.astype(int) - flat).max() <= 1
