"""Whatever a user's text file holds, and whatever lies in its place, one line with the file and the reason answers."""

import codecs
import importlib.util
import json
import os
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from simgrab.dataset.tables import calibration_of
from simgrab.errors import ScenarioError, SimgrabError
from simgrab.instrument.estimate import follow
from simgrab.instrument.estimate.tables import MOST_HEADER_BYTES, read_record
from simgrab.io import parse
from simgrab.judge.check import baseline, golden, suite
from simgrab.model import calibration, layouts, scenes

CAMERA = calibration_of(scenes.load("quay-day"))
TILT = follow.Known("mean-ray", 9, 3.0, 0.0, None, ((1e-6, 0.0), (0.0, 1e-6)))
SUITE = {"name": "mine", "scenes": {"calm": {"scene": "quay-day", "frames": 4}}}
STUDY = {
    "name": "mine", "title": "x", "axes": [{"axis": "sigma", "values": [1.0]}], "estimators": ["mean-ray"],
}  # fmt: skip
BASELINE = {"suite": "mine", "instrument": "a", "simgrab": "0.1", "seeds": [1], "scenes": {}}

# By file: its name, how it is read, and a text that is good.
FILES = {
    "scene": ("scene.toml", scenes.load, scenes.load("quay-day").to_toml()),
    "manifest": ("manifest.json", scenes.load, json.dumps({"scenario": scenes.load("quay-day").to_dict()})),
    "camera": ("camera.toml", calibration.load, CAMERA.to_toml()),
    "layout": ("layout.toml", layouts.read, (layouts.FOLDER / "two-by-four.toml").read_text()),
    "suite": ("suite.toml", suite.load, tomli_w.dumps(SUITE)),
    "tilt": ("tilt.toml", follow.load, TILT.to_toml()),
    "baseline": (baseline.FILE, lambda path: baseline.load(path.parent), json.dumps(BASELINE)),
    "golden": (golden.FILE, lambda path: golden.load(path.parent), "{}"),
    "table": ("pixels.csv", lambda path: read_record(path, CAMERA), "u_px,v_px\n900,500\n910,510\n"),
    "parquet": ("pixels.parquet", lambda path: read_record(path, CAMERA), None),
}
if importlib.util.find_spec("simgrab.lab"):
    from simgrab.lab.stress import catalogue

    FILES["study"] = ("study.toml", catalogue.load, tomli_w.dumps(STUDY))
DEEP, DIGITS, LARGE = "[" * 100_000, "1" * 6000, "0x" + "f" * 6000


def text_of(name, value):
    return f'{{"a": {value}}}' if name.endswith(".json") else f"a = {value}"


BROKEN = {
    "deep": lambda name: text_of(name, DEEP).encode(),
    "deep by dots": lambda _: f"{'a.' * 500_000}b = 1".encode(),
    "many digits": lambda name: text_of(name, DIGITS).encode(),
    "large": lambda name: text_of(name, "1" * 400 if name.endswith(".json") else LARGE).encode(),
    "latin-1": lambda name: text_of(name, '"\xe4"').encode("latin-1"),
    "utf-16": lambda name: text_of(name, '"x"').encode("utf-16"),
    "NUL": lambda _: b"\0" * 100,
    "half": lambda _: b"{",
    "a list": lambda _: b"[]",
}


def refused(read, path, *, nameless=False):
    with pytest.raises(SimgrabError) as problem:
        read(path)
    line = str(problem.value)
    assert nameless or str(path) in line
    assert "\n" not in line
    assert len(line) < len(str(path)) + 1000
    return line


@pytest.mark.parametrize("what", BROKEN)
@pytest.mark.parametrize("kind", FILES)
def test_a_broken_file_is_answered_in_one_line(kind, what, tmp_path):
    name, read, _ = FILES[kind]
    path = tmp_path / name
    path.write_bytes(BROKEN[what](name))
    refused(read, path)


@pytest.mark.parametrize("kind", FILES)
def test_what_is_no_file_is_called_by_its_kind(kind, tmp_path):
    name, read, _ = FILES[kind]
    path = tmp_path / name
    path.mkdir()
    assert "folder" in refused(read, path)
    path.rmdir()
    os.mkfifo(path)
    assert "it is a pipe, not a file" in refused(read, path)
    path.unlink()
    path.symlink_to(tmp_path / "gone")
    assert "it is a link to" in refused(read, path)


@pytest.mark.parametrize("kind", sorted(FILES.keys() - {"parquet"}))
def test_a_large_file_is_refused_before_it_is_read(kind, tmp_path):
    name, read, _ = FILES[kind]
    path = tmp_path / name
    path.touch()
    os.truncate(path, 8 * 2**30)  # a hole takes no room on the disk, and more memory than there may be
    assert "the limit is" in refused(read, path)


def test_the_header_of_a_table_is_limited(tmp_path):
    path = tmp_path / "pixels.csv"
    for length, rows in ((MOST_HEADER_BYTES, 2), (MOST_HEADER_BYTES + 1, 0)):
        header = "u_px,v_px,".ljust(length, "x")
        path.write_text(f"{header}\n900,500,\n910,510,\n")
        if rows:
            assert len(read_record(path, CAMERA).pixels) == rows
        else:
            assert "its first line is not a header" in refused(lambda path: read_record(path, CAMERA), path)


@pytest.mark.parametrize("kind", sorted(FILES.keys() - {"parquet"}))
def test_a_byte_order_mark_is_skipped(kind, tmp_path):
    name, read, good = FILES[kind]
    path = tmp_path / name
    path.write_text(good, encoding="utf-8")
    plain = read(path)
    path.write_bytes(codecs.BOM_UTF8 + good.encode())
    again = read(path)
    assert repr(again) == repr(plain)


def test_a_table_of_json_has_no_key_twice(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{"scenario": {"seed": 1, "seed": 2}}')
    assert "duplicate key 'seed'" in refused(scenes.load, path)


@pytest.mark.parametrize("separator", [".", " . ", "\t.\t"])
@pytest.mark.parametrize("part", ["a", '"a b"', "'a b'", '"\\""', '"\'"', '""'])
def test_a_key_of_many_parts_is_refused_before_it_is_parsed(part, separator, monkeypatch):
    """The parser takes time by the square of its length."""
    key = separator.join([part] * 1000)
    parse.parse_toml(f"{separator.join([part] * 40)} = 1", SimgrabError, "x")
    monkeypatch.setattr("tomllib.loads", None)
    for text in (
        f"{key} = 1",
        f"b = 1\n  {key} = 1",
        f"[{key}]",
        f"[[{key}]]",
        f"v = {{{key} = 1}}",
        f"v = {{b = 1, {key} = 1}}",
    ):
        with pytest.raises(SimgrabError, match="nested deeper than 64"):
            parse.parse_toml(text, SimgrabError, "x")
    with pytest.raises(SimgrabError, match="nested deeper than 64"):
        parse.parse_value(f"{{{key} = 1}}", SimgrabError, "x")


def test_what_cannot_be_opened_leaves_no_descriptor(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    before = sorted(Path("/proc/self/fd").iterdir())
    for path in (tmp_path, tmp_path / "pipe", tmp_path / "none", "a\0b"):
        with pytest.raises(SimgrabError, match="cannot read"):
            parse.read_text(path, SimgrabError)
    assert sorted(Path("/proc/self/fd").iterdir()) == before


def test_a_file_that_grows_while_it_is_read_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "a"
    path.write_bytes(b"12345678")
    assert parse.read_bytes(path, SimgrabError, most_bytes=8) == b"12345678"
    about = path.stat()
    path.write_bytes(b"123456789")
    monkeypatch.setattr("os.fstat", lambda _: about)
    with pytest.raises(SimgrabError, match="it holds more than 8 bytes"):
        parse.read_bytes(path, SimgrabError, most_bytes=8)


def test_what_lies_at_a_path_is_found_or_refused_in_one_line(tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to("file")
    (tmp_path / "round").symlink_to("round")
    for name, file, folder in (("file", True, False), ("link", True, False), ("", False, True), ("none", False, False)):
        assert parse.is_file(tmp_path / name, SimgrabError) == file
        assert parse.is_dir(tmp_path / name, SimgrabError) == folder
    assert not parse.is_file(tmp_path / "file" / "inside", SimgrabError)
    for name, why in (("a" * 300, "File name too long"), ("a\0b", "null byte"), ("round", "symbolic links")):
        for ask in (parse.is_file, parse.is_dir):
            with pytest.raises(SimgrabError, match=why):
                ask(tmp_path / name, SimgrabError)


def test_levels_are_counted():
    def nested(levels):
        return "[" * levels + "]" * levels

    parse.parse_toml(f"a = {nested(parse.MOST_LEVELS - 1)}", ScenarioError, "")
    with pytest.raises(SimgrabError, match="nested deeper than 64"):
        parse.parse_json(nested(parse.MOST_LEVELS + 1), SimgrabError, "")


@pytest.mark.parametrize("kind", [kind for kind in ("scene", "camera", "tilt", "suite", "study") if kind in FILES])
@pytest.mark.parametrize("value", ["1e400", "-1e400", "nan", "true", "0x7fffffffffffffff"])
def test_numbers_that_are_none_are_refused_by_key(kind, value, tmp_path):
    name, read, _ = FILES[kind]
    key = {"scene": "frames", "camera": "focal_length_px", "tilt": "beta_deg", "suite": "seed", "study": "n"}[kind]
    path = tmp_path / name
    path.write_text(f"{key} = {value}")
    assert key in refused(read, path, nameless=kind == "scene")  # its keys may come from its base, or from --set


@pytest.mark.parametrize(
    ("assignment", "why"),
    [
        ('name="a"\nseed=7', "--set takes one value"),
        ("name=a\nb", "--set takes one value"),
        (f"seed={DIGITS}", "64 bits"),
        (f"seed={LARGE}", "64 bits"),
        (f"seed={DEEP}", "nested"),
        ("seed=1e400", "finite"),
        ("description=\udcff", "description: must be UTF-8 text"),
        ("camera.mount.model=\udcff", "camera.mount.model: must be UTF-8 text"),
        ("camera.\udcff=1", "a key must be UTF-8 text"),
        (f"{'a.' * 5000}b=1", "nested"),
        (f"camera.{'a.' * 5000}b=1", "nested"),
    ],
)
def test_set_takes_one_sound_value(assignment, why):
    with pytest.raises(ScenarioError, match=why) as problem:
        scenes.load("quay-day", scenes.parse_changes([assignment]))
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize(
    ("scenario", "why"),
    [
        ('{"description": "\\ud800"}', "scenario.description: must be UTF-8 text"),
        ('{"vary": {"\\udfff": 1}}', "a key must be UTF-8 text"),
        ('{"camera": [{"x": ["\\ud800\\ud800"]}]}', "scenario.camera.0.x.0: must be UTF-8 text"),
    ],
)
def test_half_a_pair_of_surrogates_is_no_text(scenario, why, tmp_path):
    path = tmp_path / "manifest.json"
    path.write_text(f'{{"scenario": {scenario}}}')
    assert why in refused(scenes.load, path)


def test_set_gives_no_key_twice():
    with pytest.raises(ScenarioError, match="frames: --set gives it twice"):
        scenes.parse_changes(["frames=3", "frames=5"])
    for first in ("vary=3", "vary={'a.b'=4}", "vary.'a.b'=4"):
        for both in ([first, "vary.'a.b'=5"], ["vary.'a.b'=5", first]):
            with pytest.raises(ScenarioError, match=r"vary.*: --set gives it twice"):
                scenes.parse_changes(both)


@pytest.mark.parametrize(("statuses", "expected"), [("read,jump,", [12.0, np.nan, np.nan]), (",,", None)])
def test_lengths_that_a_run_has_from_a_controller_are_not_those_of_a_display(tmp_path, statuses, expected):
    rows = zip((12.0, 12.5, 13.0), statuses.split(","), strict=True)
    path = tmp_path / "angles.csv"
    path.write_text("u_px,v_px,rope_length_m,rope_status\n" + "".join(f"900,500,{m},{status}\n" for m, status in rows))
    np.testing.assert_array_equal(read_record(path, CAMERA).rope_length, [12.0, 12.5, 13.0])
    found = read_record(path, CAMERA, displayed=True).rope_length
    assert found is None if expected is None else np.array_equal(found, expected, equal_nan=True)
