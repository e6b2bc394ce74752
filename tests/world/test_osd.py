import itertools
import math
import tomllib
from datetime import datetime, timedelta

import numpy as np
import pytest
from conftest import slow_but
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, ImageDraw, ImageFont

from simgrab.dataset.tables import calibration_of
from simgrab.io.resources import ASSETS
from simgrab.model import layouts, scenes
from simgrab.model.layouts import CLOCK_PATTERN
from simgrab.model.scenario import Display
from simgrab.world.camera.overlay import Overlay
from simgrab.world.trajectory.display import Shown, clock_text, shown

FONT = ASSETS / "fonts" / "wqy-microhei-osd.ttf"
DIGITS = "0123456789"
LATIN = DIGITS + ":"
CHINESE = "年月日星期一二三四五六"
CLOCK = "2022年01月26日 星期三 14:05:37"
PICTURES = [(name, size) for name in layouts.names() for size in ((1920, 1080), (1280, 720))]


def drawn(character, width, height, size, ends):
    """A character with its outline in a cell, drawn by Pillow eight times as large and shrunk."""
    font = ImageFont.truetype(FONT, size)
    image = Image.new("RGBA", (8 * width, 8 * height), (0, 0, 0, 0))
    at = (4 * width, (8 * height - ends) // 2)
    black = {"stroke_width": size // 20, "stroke_fill": "black"}
    ImageDraw.Draw(image).text(at, character, "white", font, anchor="ms", **black)
    return np.asarray(image.reduce(8), float)


def likeness(*groups):
    """Pictures, over grey, of characters: groups of one size, each with width and height of its cells."""
    for size in range(640, 40, -1):
        font = ImageFont.truetype(FONT, size)
        boxes = [(font.getbbox(c, anchor="ms", stroke_width=size // 20), w, h) for cs, w, h in groups for c in cs]
        height = max(b[3] for b, _, _ in boxes) - min(b[1] for b, _, _ in boxes)
        if all(height <= 8 * h and 2 * max(-b[0], b[2]) <= 8 * w for b, w, h in boxes):
            break
    ends = min(b[1] for b, _, _ in boxes) + max(b[3] for b, _, _ in boxes)
    for characters, width, height in groups:
        for character in characters:
            rgba = drawn(character, width, height, size, ends)
            share = rgba[..., 3] / 255
            yield character, rgba[..., 0] * share + 120 * (1 - share)


def read(picture, cells, glyphs):
    """What cells of a picture show: each the nearest glyph of its size, over shifts of ±1 px."""
    shifts = list(itertools.product((-1, 0, 1), repeat=2))

    def nearest(x0, y0, x1, y1):
        crops = [picture[y0 + i : y1 + i, x0 + j : x1 + j].mean(axis=2) for i, j in shifts]
        alike = {c: g for c, g in glyphs.items() if g.shape == crops[0].shape}
        return min(alike, key=lambda c: min(np.abs(crop - alike[c]).sum() for crop in crops))

    return "".join(nearest(*cell) for cell in cells)


def random_times(count):
    rng = np.random.default_rng(5)
    return [datetime(1971, 1, 1) + timedelta(seconds=int(s)) for s in rng.integers(0, 8_000_000_000, count)]


def noisy(width, height):
    """Noise over a slope, with hard edges: nothing that a display's designer would choose."""
    rng = np.random.default_rng(3)
    slope = np.linspace(0, 255, width)[None, :, None] * rng.random((1, 1, 3))
    blocks = np.kron(rng.integers(0, 256, (height // 15, width // 20, 3)), np.ones((15, 20, 1)))
    return (0.4 * slope + 0.6 * blocks + rng.normal(0, 20, (height, width, 3))).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize(("name", "size"), slow_but(PICTURES, PICTURES[1]))
def test_digits_and_clock_read_back_exactly(name, size):
    layout = layouts.load(name).scaled(*size)
    overlay, rng = Overlay(layout), np.random.default_rng(1)
    rope = dict(likeness((DIGITS, layout.digit_width_px, layout.digit_height_px)))
    cells, high = layout.clock.cells, layout.clock.size_px
    clock = dict(likeness((LATIN, cells[0][2] - cells[0][0], high), (CHINESE, high, high)))
    inked = [c != " " for c in CLOCK_PATTERN]
    for moment in random_times(40):
        lengths = tuple(int(n) / 100 for n in rng.integers(0, 10_000, 2))
        text, words = layout.text(*lengths), clock_text(moment, 0.0)
        picture = overlay.blend(np.full((*size[::-1], 3), 120, np.uint8), Shown(words, text, text, None))
        assert layout.lengths(read(picture, layout.cells, rope)) == lengths
        assert read(picture, list(itertools.compress(cells, inked)), clock) == words.replace(" ", "")


@pytest.mark.parametrize(("name", "size"), [*PICTURES, ("four-point-four", (480, 270))])
def test_only_the_characters_cells_change(name, size):
    layout = layouts.load(name).scaled(*size)
    rgb = noisy(*size)
    before = rgb.copy()
    text = layout.text(20.15, 21.37)
    overlay, words = Overlay(layout), Shown(CLOCK, text, text, None)
    after = overlay.blend(rgb, words)
    np.testing.assert_array_equal(rgb, before)
    np.testing.assert_array_equal(after, Overlay(layout).blend(rgb, words))
    cells = dict.fromkeys((*layout.cells, *layout.points), True)
    cells |= {cell: c != " " for cell, c in zip(layout.clock.cells, CLOCK, strict=True)}
    for (x0, y0, x1, y1), inked in cells.items():
        assert (after != rgb)[y0:y1, x0:x1].any() == inked
        rgb[y0:y1, x0:x1] = after[y0:y1, x0:x1]
    np.testing.assert_array_equal(after, rgb)


def test_white_with_a_black_outline_all_round():
    """On white only the outline shows and on black only the fill; every white pixel's neighbours are inked."""
    layout = layouts.load("two-by-four")
    overlay, words = Overlay(layout), Shown(CLOCK, "2015 2137", "2015 2137", None)
    white, black = (overlay.blend(np.full((1080, 1920, 3), level, np.uint8), words) for level in (255, 0))
    assert (np.ptp(white, axis=2) == 0).all()
    ink = 255 - (white.astype(int) - black)[..., 0]  # 255 where nothing of the background is left
    filled = black[..., 0] > 250
    assert filled.sum() > 3000
    assert (white[ink == 255][:, 0] < 5).sum() > 3000
    for shift in itertools.product((-1, 0, 1), repeat=2):
        assert (ink[np.roll(filled, shift, axis=(0, 1))] > 250).all()


def test_a_picture_of_another_size_or_kind_is_refused():
    overlay, words = Overlay(layouts.load("two-by-four")), Shown(CLOCK, "2015 2137", "2015 2137", None)
    for picture in (np.zeros((720, 1280, 3), np.uint8), np.zeros((1080, 1920, 3))):
        with pytest.raises(ValueError, match=r"uint8 of shape \(1080, 1920, 3\)"):
            overlay.blend(picture, words)


@pytest.mark.parametrize("row", [0, 31, 32, 50, 76, 90, 1079])
def test_a_torn_picture_is_the_old_one_above_and_the_new_one_below(row):
    overlay, rgb = Overlay(layouts.load("two-by-four")), np.full((1080, 1920, 3), 120, np.uint8)
    old, new = "2015 2137", "1894 0266"
    torn = overlay.blend(rgb, Shown(CLOCK, old, new, row))
    above, below = (overlay.blend(rgb, Shown(CLOCK, text, text, None)) for text in (old, new))
    np.testing.assert_array_equal(torn[:row], above[:row])
    np.testing.assert_array_equal(torn[row:], below[row:])


def ramp(t):
    assert t >= 0
    return 12.5 + 1.1 * t, 14.5 + 0.7 * t


@given(
    time=st.floats(0, 60),
    lag=st.floats(0, 3),
    rate=st.floats(0.5, 20),
    readout=st.floats(0, 1),
    name=st.sampled_from(layouts.names()),
)
def test_each_row_shows_the_last_refresh_before_it_was_read_out(time, lag, rate, readout, name):
    """Row by row, against a controller that is run from its start."""
    layout = layouts.load(name)
    display = Display(layout=name, lag_s=lag, refresh_hz=rate, readout_s=readout / rate)

    def known(t):  # nothing that comes after the readout may be asked for
        assert t <= time + display.readout_s + 1e-9
        return ramp(t)

    seen = shown(display, layout, time, known)
    instants = np.arange(0, math.ceil(62 * rate)) / rate
    ends = time + np.arange(1, 1081) / 1080 * display.readout_s
    for cell, (i, (_, y0, _, y1)) in zip("hhhhcccc", enumerate(layout.cells), strict=True):
        for row in (y0, (y0 + y1) // 2, y1 - 1, seen.torn_row_px or y0):
            if not y0 <= row < y1 or np.abs(instants - ends[row]).min() < 1e-9:
                continue
            number = ramp(max(0.0, instants[instants < max(ends[row], 1e-12)][-1] - lag))["hc".index(cell)]
            digits = [c for c in layout.text(number - 2.5, number - 2.5) if c.isdigit()]
            text = seen.rope_text if seen.torn_row_px is None or row < seen.torn_row_px else seen.rope_text_below
            assert [c for c in text if c.isdigit()][i] == digits[i]


def test_a_tear_counts_only_where_it_is_seen():
    display = Display(layout="two-by-four", lag_s=0.0, refresh_hz=1.0, readout_s=0.1)
    old, new, half = "1000 1000", "1860 1970", "1000 1970"
    # Hoist digits in rows 32 to 76, closing digits in 88 to 132, of 1080.
    for row, hoist, expected in (
        (32, 21.1, (new, new, None)),  # the first digit row is new already
        (33, 21.1, (old, new, 33)),
        (80, 21.1, (old, new, 80)),  # between the numbers: the upper is old and the lower new
        (131, 21.1, (old, new, 131)),
        (132, 21.1, (old, old, None)),  # below the last digit
        (900, 21.1, (old, old, None)),
        (50, 12.5, (half, half, None)),  # only the closing rope's number changes: the tear above it is not seen
    ):
        time = 1.0 - 0.1 * (row + 0.5) / 1080
        seen = shown(
            display, layouts.load("two-by-four"), time, lambda t, h=hoist: (12.5, 12.5) if t < 0.5 else (h, 22.2)
        )
        assert (seen.rope_text, seen.rope_text_below, seen.torn_row_px) == expected


def test_frames_that_know_no_time_neither_lag_nor_tear():
    display = Display(layout="two-by-four", lag_s=5.0, refresh_hz=100.0, readout_s=0.01)
    for frame in range(50):
        seen = shown(display, layouts.load("two-by-four"), frame / 9, lambda _: (20.0, 21.5))
        assert (seen.rope_text, seen.rope_text_below, seen.torn_row_px) == ("1750 1900", "1750 1900", None)


def test_the_clock_agrees_with_python_and_rolls_over():
    for moment in random_times(300):
        text = clock_text(moment, 0.0)
        assert "一二三四五六日".index(text[14]) + 1 == moment.isoweekday()
        assert datetime.strptime(text[:11] + text[15:], "%Y年%m月%d日 %H:%M:%S") == moment
    assert clock_text(datetime(2022, 12, 31, 23, 59, 59), 1.0) == "2023年01月01日 星期日 00:00:00"
    assert clock_text(datetime(2024, 2, 28, 23, 59, 59), 1.5) == "2024年02月29日 星期四 00:00:00"
    assert clock_text(datetime(2023, 2, 28, 23, 59, 59), 1.5) == "2023年03月01日 星期三 00:00:00"
    assert clock_text(datetime(2022, 1, 26, 14, 5, 37), 0.999) == CLOCK


def test_the_font_has_every_character_and_nothing_else():
    from fontTools.ttLib import TTFont

    font = TTFont(FONT)
    assert set(font.getBestCmap()) == {ord(c) for c in f"{DIGITS}:. {CHINESE}"}
    assert "Apache License, Version 2.0" in font["name"].getDebugName(13)
    assert FONT.stat().st_size < 40_000


@pytest.mark.parametrize("mount", ["fixed", "levelled", "rigid"])
def test_the_camera_file_says_how_the_camera_hangs_and_what_the_display_is(mount):
    display = {"display.layout": "four-point-four", "display.constant_m": 1.25}
    scenario = scenes.load("quay-day", display | {"camera.mount": {"model": mount}})
    known = tomllib.loads(calibration_of(scenario).to_toml())
    assert (known["mount"], known["display_constant_m"]) == (mount, 1.25)
    assert known["digit_layout"]["hoist_px"][0] == [1536, 1004]
    assert "digit_layout" not in tomllib.loads(calibration_of(scenes.load("quay-day")).to_toml())
