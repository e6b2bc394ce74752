"""A struct made or changed in Python is checked as strictly as one from a file, with the same message."""

import json
import math
import re
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
import pytest

import simgrab
from simgrab.errors import CalibrationError, LayoutError, ScenarioError, SuiteError
from simgrab.instrument.estimate.follow import Known
from simgrab.io.strict import Checked, convert
from simgrab.io.strict import _fields as types_of
from simgrab.io.strict import _structs_of as structs_of
from simgrab.judge.check.suite import Limit, Suite
from simgrab.model import calibration, layouts, scenes
from simgrab.model.distributions import Constant, Uniform
from simgrab.model.scenario import Camera, Iid, Image, OneOf, Scenario, Vibration
from simgrab.model.scenario.whole import schema

CAMERA = calibration.Calibration(640, 480, 500.0, 320.0, 240.0)
LAYOUT = layouts.load("two-by-four")


class Inner(Checked, frozen=True):
    share: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.5
    kind: Literal["a", "b"] = "a"

    def check(self):
        if self.kind == "b" and self.share > 0.9:
            raise ValueError("share must not be above 0.9 with kind 'b'")


class Outer(Checked, frozen=True):
    inner: Inner = Inner()
    count: Annotated[int, msgspec.Meta(ge=0, le=9)] = 0
    pair: tuple[float, float] = (0.0, 0.0)
    table: dict[str, Inner] = msgspec.field(default_factory=dict)


BAD = [
    {"share": 2.0}, {"share": -0.1}, {"share": math.nan}, {"share": math.inf}, {"share": True}, {"share": "1"},
    {"share": None}, {"share": 10**400}, {"kind": "c"}, {"kind": 1}, {"share": 0.95, "kind": "b"},
]  # fmt: skip


@pytest.mark.parametrize("values", BAD)
def test_python_and_a_file_are_refused_alike(values):
    with pytest.raises(ScenarioError) as from_file:
        convert(values, Inner)
    with pytest.raises(ScenarioError) as from_python:
        Inner(**values)
    assert str(from_python.value) == str(from_file.value)
    with pytest.raises(ScenarioError) as changed:
        msgspec.structs.replace(Inner(), **values)
    assert str(changed.value) == str(from_file.value)


@pytest.mark.parametrize("values", BAD)
def test_a_struct_within_is_named_by_its_dotted_key(values):
    with pytest.raises(ScenarioError) as alone:
        convert(values, Inner)
    for place, data in (("inner", {"inner": values}), ("table.x", {"table": {"x": values}})):
        with pytest.raises(ScenarioError) as within:
            convert(data, Outer)
        assert within.value.key == ".".join(filter(None, (place, alone.value.key)))
        assert within.value.problem == alone.value.problem


def test_values_become_what_they_are_from_a_file():
    made = Outer(count=np.int64(3), pair=[1, np.float64(2)], inner={"share": 1})
    read = convert({"count": 3, "pair": [1, 2], "inner": {"share": 1}}, Outer)
    assert made == read
    assert msgspec.json.encode(made) == msgspec.json.encode(read)
    assert type(made.inner.share) is float
    assert Outer(pair=np.array([1.0, 2.0])).pair == (1.0, 2.0)
    with pytest.raises(ScenarioError, match=r"pair\.1: must be a finite number"):
        Outer(pair=np.array([1.0, np.nan]))


LOOP = {}
LOOP["again"] = LOOP


def test_a_camera_of_pictures_at_another_size_sees_the_same():
    for width, height in (
        (2 * CAMERA.width_px, 2 * CAMERA.height_px),
        (1000, round(1000 * CAMERA.height_px / CAMERA.width_px)),
    ):
        other = CAMERA.scaled(width, height)
        ends = np.array([[0, 0], [1, 1], [0.3, 0.8]])
        rays, others = (c.intrinsics.rays(ends * [c.width_px, c.width_px * 0.5625]) for c in (CAMERA, other))
        np.testing.assert_allclose(rays, others, atol=1e-12)


@pytest.mark.parametrize(
    ("make", "error", "key"),
    [
        (lambda: Scenario(frames=10**12), ScenarioError, "frames: must be a whole number <="),
        (lambda: Camera(mount=Vibration()), ScenarioError, "mount"),
        (lambda: Image(shadow_map_px=10**9), ScenarioError, "shadow_map_px: must be one of"),
        (lambda: Iid(rope_length_m="7"), ScenarioError, "rope_length_m: must be a number or a table such as { dist = "),
        (lambda: Iid(rope_length_m=1e300), ScenarioError, "rope_length_m: must be a number <="),
        (lambda: Uniform(2.0, 1.0), ScenarioError, "low must not exceed high"),
        (lambda: Uniform(-1e300, 1e300), ScenarioError, "low"),
        (lambda: OneOf(tuple(range(10_001))), ScenarioError, "values"),
        (lambda: OneOf((object(),)), ScenarioError, "values.0: <object"),
        (lambda: OneOf((LOOP,)), ScenarioError, "nested deeper than 64"),
        (lambda: CAMERA.scaled(CAMERA.width_px, CAMERA.height_px + 1), CalibrationError, "another shape"),
        (lambda: CAMERA.scaled(2 * CAMERA.width_px, CAMERA.height_px), CalibrationError, "another shape"),
        (lambda: OneOf(("\udcff",)), ScenarioError, "values.0: must be UTF-8"),
        (lambda: msgspec.structs.replace(CAMERA, focal_length_px=math.inf), CalibrationError, "focal_length_px"),
        (lambda: msgspec.structs.replace(LAYOUT, width_px=100), LayoutError, "outside the picture"),
        (lambda: Known("x", 1, 3.0, 0.0, None, ((1.0,), (1.0, 2.0))), CalibrationError, ""),
        (lambda: Limit(), SuiteError, "lower, upper or both"),
        (lambda: Suite("mine", {}), SuiteError, "a suite needs scenes"),
    ],
)
def test_impossible_structs_are_refused_in_one_line(make, error, key):
    with pytest.raises(error) as problem:
        make()
    assert key in str(problem.value)
    assert "\n" not in str(problem.value)


def test_what_would_take_years_is_refused():
    slow = {"frames": 10_000_000, "clip.frame_rate_hz": 0.01}
    with pytest.raises(ScenarioError, match="days of physics; at most 366"):
        scenes.load("work-cycles", slow)
    with pytest.raises(ScenarioError, match="days of physics"):
        scenes.load("work-cycles", {"frames": 10_000, "clip.clip_frames": 1, "swing.settle_s": 3600.0})
    laws = {
        f"weather.{key}": {"dist": "choice", "values": [0.0] * 9000} for key in ("wetness", "rain_mm_h", "snow_cover")
    }
    with pytest.raises(ScenarioError, match="27000 values in total; the limit is"):
        scenes.load("quay-day", {"clip.clip_frames": 2, "vary": laws})


def with_one(wrong, table):
    """Plain data of a table in which one key, of it or of a table in it, is wrong: for each such key."""
    about = table.__struct_config__
    tag = {about.tag_field: about.tag} if about.tag_field else {}
    for field in msgspec.structs.fields(table):
        yield tag | {field.name: wrong}
        for part in structs_of(types_of(table)[field.name]):
            yield from (tag | {field.name: inner} for inner in with_one(wrong, part))


@pytest.mark.parametrize("wrong", [50, 0.5, "x", [1, "x"], True, {"x": 1}], ids=str)
def test_every_key_says_what_it_wants_in_words_of_a_scene_file(wrong):
    told = {}
    for data in with_one(wrong, Scenario):
        try:
            convert(data, Scenario)
        except ScenarioError as problem:
            told[str(problem)] = problem.problem
    assert len(told) > 100
    of_msgspec = re.compile(r"xpected|\b(object|array|str|int|float|null)\b|`|\n")
    assert not [line for line, problem in told.items() if of_msgspec.search(problem)]


def test_no_text_ends_in_a_line_break_that_its_pattern_does_not_have():
    """Python's ``$`` also matches before one at the end; JSON schema has no other sign."""
    patterns = [line for path in Path(simgrab.__file__).parent.rglob("*.py") for line in path.read_text().splitlines()]
    patterns = [line for line in patterns if re.search(r"\bpattern=r?f?[\"']", line)]
    assert len(patterns) > 5
    assert [line for line in patterns if not re.search(r"\\Z[\"']", line)] == []
    with pytest.raises(ScenarioError, match="name: must be"):
        scenes.load("quay-day", {"name": "mine\n"})
    assert r"\\Z" not in json.dumps(schema())


def test_a_number_is_a_constant_distribution():
    for number in (20, 20.0):
        whole = {"dist": "constant", "value": number}
        for key in ("rope_length_m", "jaw_deg"):
            of_number, of_table = ({"swing": {"model": "iid", key: value}} for value in (number, whole))
            assert convert(of_number, Scenario) == convert(of_table, Scenario)
        varied, constant = (
            {"vary": {"camera.roll_deg": value}, "clip": {"clip_frames": 1}} for value in (number, whole)
        )
        assert convert(varied, Scenario) == convert(constant, Scenario)
        assert Iid(rope_length_m=np.float64(number)).rope_length_m == Constant(20.0)
    with pytest.raises(ScenarioError, match="got 50"):
        Scenario(swing=Iid(rope_length_m=50))
