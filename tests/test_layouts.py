import itertools
import re
import tomllib

import msgspec
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from simgrab.errors import CalibrationError, LayoutError, ScenarioError
from simgrab.io.strict import convert
from simgrab.model import calibration, layouts, scenes
from simgrab.model.calibration import Calibration
from simgrab.model.layouts import CLOCK_PATTERN, Layout
from simgrab.model.scenario import Scenario

NAMES = ("four-point-four", "two-by-four")
BASE = msgspec.to_builtins(layouts.load("two-by-four"))
TOUCHING = convert(BASE | {"digit_width_px": 30, "hoist_px": [(x, 33) for x in range(1701, 1821, 30)]}, Layout)
BAD = {
    "eight digits": ({"hoist_px": BASE["hoist_px"][:3]}, "hoist_px: .*length >= 4"),
    "no ninth digit": ({"closing_px": [*BASE["closing_px"], (1876, 88)]}, "closing_px: .*length <= 4"),
    "outside": ({"width_px": 1871}, r"hoist_px.3 reaches \(1872, 76\), outside the picture of 1871 x 1080"),
    "above the picture": ({"hoist_px": [(1748, -1), *BASE["hoist_px"][1:]]}, r"hoist_px.0.1: .*>= 0"),
    "overlap": ({"digit_width_px": 33}, "hoist_px.0 and hoist_px.1 overlap"),
    "numbers overlap": ({"digit_height_px": 57}, "hoist_px.0 and closing_px.0 overlap"),
    "clock overlaps": ({"clock": {"x_px": 1100, "y_px": 32, "size_px": 44}}, "clock and hoist_px.0 overlap"),
    "clock outside": ({"clock": {"x_px": 32, "y_px": 1040, "size_px": 44}}, "clock reaches .* outside"),
    "order": ({"hoist_px": BASE["hoist_px"][::-1]}, "hoist_px: .*left to right"),
    "small": ({"digit_height_px": 7}, "digits of 28 x 7 px .* cannot be read: at least 5 x 8"),
    "small clock": ({"clock": {"x_px": 32, "y_px": 32, "size_px": 7}}, "clock 7 px high .* cannot be read"),
    "no room for a point": ({"point": True}, "point: a gap of 4 px"),
    "decimals": ({"decimals": 4}, "decimals: .*<= 3"),
    "unknown": ({"digit_with_px": 3}, "did you mean 'digit_width_px'"),
}


def test_the_bundled_layouts_read():
    assert tuple(layouts.names()) == NAMES
    for name in NAMES:
        layout = layouts.load(name)
        assert convert(tomllib.loads((layouts.FOLDER / f"{name}.toml").read_text()), Layout) == layout
        assert len(layout.cells) == 8
        assert len(layout.points) == (2 if layout.point else 0)
        assert len(layout.clock.cells) == len(CLOCK_PATTERN) == 24
    with pytest.raises(LayoutError, match=r"did you mean 'two-by-four'.*there are: four-point-four, two-by-four"):
        layouts.load("two-by-for")


@pytest.mark.parametrize("case", BAD)
def test_bad_layouts_are_refused_in_one_line(case):
    change, message = BAD[case]
    with pytest.raises(LayoutError, match=message) as caught:
        convert(BASE | change, Layout, LayoutError)
    assert "\n" not in str(caught.value)
    assert not str(caught.value).startswith(":")


def test_a_bad_file_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(layouts, "FOLDER", tmp_path)
    for name, text, message in (("a", "width_px = 3", "height_px: missing"), ("b", "width_px = [", "")):
        (tmp_path / f"{name}.toml").write_text(text)
        with pytest.raises(LayoutError, match=re.escape(f"{tmp_path / name}.toml: ") + message):
            layouts.load(name)


@given(st.sampled_from([*map(layouts.load, NAMES), TOUCHING]), st.integers(480, 4096), st.integers(270, 4096))
@example(TOUCHING, 960, 540)  # every corner falls halfway between pixels
def test_scaled_layouts_hold_together(layout, width, height):
    """Cells stay apart and inside, as `Layout` checks, equally large, and where the picture's scale puts them."""
    sx, sy = width / layout.width_px, height / layout.height_px
    scaled = layout.scaled(width, height)
    for cells, reference in ((scaled.cells, layout.cells), (scaled.points, layout.points)):
        if not reference:
            continue
        away = np.array(cells) - np.array(reference) * (sx, sy, sx, sy)
        assert np.abs(away).max() <= 2
        sizes = {(x1 - x0, y1 - y0) for x0, y0, x1, y1 in cells}
        assert len(sizes) == 1
        assert min(sizes.pop()) >= 1
    ends = sorted((x0, x1) for x0, y0, x1, _ in (*scaled.cells, *scaled.points) if y0 == scaled.hoist_px[0][1])
    assert all(left[1] <= right[0] for left, right in itertools.pairwise(ends))
    assert scaled.scaled(width, height) == scaled


def test_too_small_a_picture_is_refused_with_the_reason():
    with pytest.raises(LayoutError, match="digits of 4 x 7 px in an image of 320 x 180 px cannot be read"):
        layouts.load("two-by-four").scaled(320, 180)
    small = {"camera.width_px": 320, "camera.height_px": 180}
    assert scenes.load("quay-day", small).display.layout_in(320, 180) is None
    with pytest.raises(ScenarioError, match=r"display\.layout: digits of 4 x 7 px"):
        scenes.load("quay-day", small | {"display.layout": "two-by-four"})


@given(st.sampled_from(NAMES), st.integers(0, 9999), st.integers(0, 9999))
def test_text_and_lengths_are_each_others_inverse(name, hoist, closing):
    layout = layouts.load(name)
    text = layout.text(hoist / 100, closing / 100)
    assert layout.lengths(text) == (hoist / 100, closing / 100)
    assert layout.lengths(re.sub(r"\D", "", text)) == (hoist / 100, closing / 100)


def test_the_texts_form():
    two, four = layouts.load("two-by-four"), layouts.load("four-point-four")
    assert two.text(20.154, 8.996) == "2015 0900"
    assert four.text(20.154, 8.996) == "20.15 09.00"
    assert two.text(-0.3, 100.0) == "0000 9999"  # a counter stays at its end
    assert msgspec.structs.replace(two, decimals=1).text(20.15, 123.44) == "0202 1234"
    with pytest.raises(ValueError, match="8 digits"):
        two.lengths("2015 090")


def test_a_scenario_may_hold_a_layout_of_its_own():
    own = BASE | {"closing_px": [(x, y + 7) for x, y in BASE["closing_px"]]}
    scenario = scenes.load("quay-day", {"display.layout": own})
    assert scenario.display.layout_in(1920, 1080) == convert(own, Layout)
    assert convert(tomllib.loads(scenario.to_toml()), Scenario) == scenario
    assert scenario.digest() != scenes.load("quay-day", {"display.layout": BASE}).digest()
    with pytest.raises(ScenarioError, match=r"display\.layout\.hoist_px"):
        scenes.load("quay-day", {"display.layout": BASE | {"hoist_px": []}})


def test_the_camera_file_holds_the_layout_itself(tmp_path):
    plain = Calibration(960, 540, 800.0, 480.0, 270.0)
    shown = msgspec.structs.replace(plain, digit_layout=layouts.load("four-point-four").scaled(960, 540))
    for camera in (plain, shown):
        camera.save(tmp_path / "camera.toml")
        assert calibration.load(tmp_path / "camera.toml") == camera
    text = (tmp_path / "camera.toml").read_text().replace("digit_width_px = 14", "digit_width_px = 2")
    (tmp_path / "camera.toml").write_text(text)
    with pytest.raises(CalibrationError, match=r"camera\.toml: digit_layout: digits of 2 x 22 px"):
        calibration.load(tmp_path / "camera.toml")


def test_a_camera_file_may_name_a_bundled_layout(tmp_path):
    file = tmp_path / "camera.toml"
    Calibration(1920, 1080, 1600.0, 960.0, 540.0).save(file)
    plain = file.read_text()
    file.write_text(f'digit_layout = "two-by-four"\n{plain}')
    assert calibration.load(file).digit_layout == layouts.load("two-by-four")
    file.write_text(f'digit_layout = "twobyfour"\n{plain}')
    with pytest.raises(CalibrationError, match=r"camera\.toml: digit_layout: no layout 'twobyfour' \(did you mean"):
        calibration.load(file)
