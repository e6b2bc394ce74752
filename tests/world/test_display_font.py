"""The display's font: the bundled one as before, a user's own file, and generated ones."""

import io
import itertools
from pathlib import Path

import numpy as np
import pytest
from conftest import SMALL
from fontTools.subset import Subsetter
from fontTools.ttLib import TTFont

import simgrab
from simgrab.errors import ScenarioError
from simgrab.io import fonts
from simgrab.model import layouts, scenes
from simgrab.model.scenario import BundledFont, Font, FontFile, GeneratedFont, Ink, Scenario, variants
from simgrab.world.camera import faces
from simgrab.world.camera.overlay import Overlay
from simgrab.world.trajectory.display import Shown

CLOCK = "2022年01月26日 星期三 14:05:37"
DIGITS = "0123456789"
LAYOUT = layouts.load("two-by-four").scaled(960, 540)
SHOWN = SMALL | {"display.layout": "two-by-four"}


def subset(characters: str = fonts.CHARACTERS) -> bytes:
    """Bundled font with only some characters."""
    font, out = TTFont(faces.BUNDLED), io.BytesIO()
    cutter = Subsetter()
    cutter.populate(text=characters)
    cutter.subset(font)
    font.save(out)
    return out.getvalue()


def scene(folder: Path, file: str = "own.ttf", **changes: object) -> Scenario:
    """Scene whose display's font is a file of its folder."""
    (folder / "scene.toml").write_text(
        f'base = "quay-day"\n[display.font]\nmodel = "file"\nfile = "{file}"\n', encoding="utf-8"
    )
    return scenes.load(folder / "scene.toml", SHOWN | changes)


def written(font: Font, text: str = "0123 4567", level: int = 120) -> np.ndarray:
    """A display over grey."""
    overlay = Overlay(LAYOUT, faces.face(font), faces.ink(font))
    return overlay.blend(np.full((540, 960, 3), level, np.uint8), Shown(CLOCK, text, text, None))


def glyphs(font: Font) -> list[np.ndarray]:
    """Masks of the ten digits."""
    face = faces.face(font)
    return [face.mask(digit, 100, (200, 200), (100.0, 150), 0) for digit in DIGITS]


def test_the_bundled_font_is_what_a_scene_without_the_key_shows() -> None:
    shown = Overlay(LAYOUT).blend(np.full((540, 960, 3), 120, np.uint8), Shown(CLOCK, "0123 4567", "0123 4567", None))
    np.testing.assert_array_equal(written(BundledFont()), shown)


def test_a_file_shows_its_own_glyphs_and_a_dataset_holds_it(tmp_path: Path) -> None:
    (tmp_path / "own.ttf").write_bytes(subset())
    own = scene(tmp_path, frames=1)
    np.testing.assert_array_equal(glyphs(own.display.font), glyphs(BundledFont()))
    simgrab.render(own, tmp_path / "out", workers=1)
    (tmp_path / "own.ttf").unlink()
    again = scenes.load(tmp_path / "out" / "manifest.json")
    assert (again.digest(), again.display.font) == (own.digest(), own.display.font)


@pytest.mark.parametrize("missing", ["7", "."])
def test_a_font_without_a_character_is_refused(tmp_path: Path, missing: str) -> None:
    (tmp_path / "own.ttf").write_bytes(subset(fonts.CHARACTERS.replace(missing, "")))
    with pytest.raises(ScenarioError, match=f"own.ttf: has no usable glyph for {missing}$") as caught:
        scene(tmp_path)
    assert caught.value.key == "display.font.file"


def test_what_is_no_font_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = subset()
    for data in (b"", b"\x00\x01\x00\x00 no font", whole[: len(whole) // 3], whole[: 2 * len(whole) // 3]):
        (tmp_path / "own.ttf").write_bytes(data)
        with pytest.raises(ScenarioError, match=r"own.ttf: (is damaged, or not a scalable font|has no usable glyph)"):
            scene(tmp_path)
    (tmp_path / "own.txt").write_bytes(whole)
    with pytest.raises(ScenarioError, match=r"must end in one of \.ttf, \.otf"):
        scene(tmp_path, "own.txt")
    with pytest.raises(ScenarioError, match=r"own\.ttf: No such file"):
        scene(tmp_path, "../own.ttf")
    with pytest.raises(ScenarioError, match=r"read by simgrab\.load"):
        FontFile(file="own.ttf")
    (tmp_path / "own.ttf").write_bytes(whole)
    monkeypatch.setattr(fonts, "MOST_BYTES", len(whole) - 1)
    with pytest.raises(ScenarioError, match="the limit is"):
        scene(tmp_path)


@pytest.mark.parametrize("style", ["strokes", "segments", "dots"])
def test_a_generated_font_has_ten_different_digits_the_same_every_time(style: str) -> None:
    for shape in np.random.default_rng(1).random(12).tolist():
        font = GeneratedFont(style=style, shape=shape)  # type: ignore[arg-type]
        first, other = glyphs(font), glyphs(GeneratedFont(style=style, shape=shape / 2))  # type: ignore[arg-type]
        np.testing.assert_array_equal(first, glyphs(font))
        assert not np.array_equal(first, other)
        for a, b in itertools.combinations(first, 2):
            assert ((a > 0) ^ (b > 0)).sum() > 100  # px; 100 px high


def test_generated_colours_can_be_distinguished() -> None:
    luma = np.array([0.299, 0.587, 0.114])
    for shape in np.random.default_rng(2).random(200).tolist():
        ink = faces.ink(GeneratedFont(shape=shape))
        assert abs(luma @ ink.fill_rgb - luma @ ink.outline_rgb) > 0.3
        assert ink.outline >= 0.02 or ink.plate >= 0.6


def test_ink_is_laid_on_over_a_plate() -> None:
    ink = Ink(fill_rgb=(1, 0, 0), outline_rgb=(0, 0, 1), plate_rgb=(0, 1, 0), plate=1.0)
    over = [written(BundledFont(ink=ink), level=level) for level in (0, 255)]
    x0, y0, x1, y1 = LAYOUT.cells[0]
    cell = over[0][y0:y1, x0:x1].reshape(-1, 3)
    assert {(255, 0, 0), (0, 255, 0)} <= set(map(tuple, cell.tolist()))
    assert (cell[:, 2] > 200).any()
    np.testing.assert_array_equal(cell, over[1][y0:y1, x0:x1].reshape(-1, 3))  # nothing shows through
    x2 = LAYOUT.cells[1][0]
    assert (over[0][y0:y1, x1:x2] == (0, 255, 0)).all()  # nor between cells


def test_without_a_shape_every_independent_frame_has_another_font() -> None:
    random = scenes.load("quay-day", SHOWN | {"display.font": {"model": "generated"}, "frames": 2})
    fixed = scenes.load("quay-day", SHOWN | {"display.font": {"model": "generated", "shape": 0.3}, "frames": 2})
    x0, y0, x1, y1 = random.display_layout.cells[0]  # type: ignore[union-attr]
    first, second = (frame.rgb[y0:y1, x0:x1] for frame in simgrab.frames(random))
    (alone,) = simgrab.frames(random, (1,))
    np.testing.assert_array_equal(second, alone.rgb[y0:y1, x0:x1])
    assert not np.array_equal(first, second)
    assert not np.array_equal(first, next(iter(simgrab.frames(fixed, (0,)))).rgb[y0:y1, x0:x1])


def test_every_clip_may_have_another_font() -> None:
    made = scenes.load("digits", {"frames": 8, "clip.clip_frames": 1, "vary": {
        "display.font": {"dist": "one-of", "values": [{"model": "generated"}, {"model": "bundled"}]},
        "display.font.shape": {"dist": "uniform", "low": 0.0, "high": 1.0},
    }})  # fmt: skip
    drawn = {one.scenario.display.font for one, _ in variants(made)}
    assert BundledFont() in drawn
    assert len(drawn) > 2
    assert not any(isinstance(font, GeneratedFont) and font.shape is None for font in drawn)


def test_a_file_varies_with_its_table() -> None:
    with pytest.raises(ScenarioError, match=r"use \[vary\.display\.font\]"):
        scenes.load("digits", {"vary": {"display.font.file": {"dist": "one-of", "values": ["a.ttf"]}}})
