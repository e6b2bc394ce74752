"""Paths that are no UTF-8, and terminals that show ASCII alone: commands do the same, and what they say is shown."""

import json
import os
import subprocess
import sys

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from commands import run
from conftest import SMALL, as_options, slow_but

from simgrab.instrument.run import runs
from simgrab.model.calibration import Calibration

NAME = os.fsdecode(b"w\xff")
SMALLER = SMALL | {"frames": 2, "camera.width_px": 320, "camera.height_px": 180}
ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


def output_of(*arguments, status=0):
    """What a command prints."""
    ended, printed, problem = run(*arguments)
    assert ended == status, problem
    return printed


def simgrab(*arguments, **env):
    """Status, output and lines of errors of a process of its own."""
    command = [sys.executable, "-m", "simgrab", *map(os.fsencode, arguments)]
    plain = {key: value for key, value in os.environ.items() if key != "PYTHONIOENCODING"}
    done = subprocess.run(command, env=plain | env, capture_output=True)
    return done.returncode, done.stdout, done.stderr.decode().splitlines()


@pytest.mark.slow
def test_what_is_rendered_can_be_measured_and_compared(tmp_path):
    folder = tmp_path / NAME
    data, video, made = folder / "data", folder / "a.mp4", folder / "run"
    assert r"w\xff/data/preview.jpg" in output_of("render", *as_options(SMALLER), "--out", data, "--video", video)
    assert rf"audit of {tmp_path}/w\xff/data: " in output_of("audit", data)
    output_of("detect", data, "--out", folder / "found.parquet")
    with (folder / "found.parquet").open("rb") as file:
        assert all(r"/w\xff/data/images/" in row for row in pq.read_table(file)["file"].to_pylist())
    output_of("run", video, "--out", made, "--quiet", status=1)  # two frames are too few
    scores = json.loads(output_of("evaluate", made, video, "--json", "--page", folder / "page.html"))
    assert scores["run"]["source"] == rf"{tmp_path}/w\xff/a.mp4"
    output_of("run", data, "--out", folder / "other", "--quiet", status=1)
    output_of("evaluate", folder / "other", data)


def test_pictures_of_any_name_are_detected_and_run(tmp_path):
    pictures, names = tmp_path / "pictures", ["a\nb.jpg", r"\xff.jpg"]
    pictures.mkdir()
    for raw in (b"\xff.jpg", b"a\nb.jpg"):
        (pictures / os.fsdecode(raw)).write_bytes(cv2.imencode(".jpg", np.full((180, 320, 3), 90, np.uint8))[1])
    Calibration(320, 180, 300.0, 160.0, 90.0).save(tmp_path / "camera.toml")
    lines = output_of("detect", pictures, "--json").splitlines()
    assert [json.loads(line)["file"] for line in lines] == [f"{pictures}/{name}" for name in names]
    output_of("run", pictures, "--camera", tmp_path / "camera.toml", "--out", tmp_path / NAME, "--quiet", status=1)
    assert runs.load(tmp_path / NAME).names == tuple(names)
    for name in ("angles.csv", "report.html", "run.json"):
        (tmp_path / NAME / name).read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_locale_of_ascii_alone_changes_nothing(tmp_path):
    """Python then takes `ü雪` for bytes that are no text."""
    status, said, _ = simgrab("render", *as_options(SMALLER), "--frames", "1", "--out", str(tmp_path / "ü雪"), **ASCII)
    assert status == 0
    assert f"preview: {tmp_path}/ü雪/preview.jpg".encode() in said
    status, said, _ = simgrab("detect", str(tmp_path / "ü雪"), "--json", **ASCII)
    assert status == 0
    assert json.loads(said)["file"].startswith(f"{tmp_path}/ü雪/images/")


@pytest.mark.parametrize("env", [ASCII, *slow_but([{"PYTHONIOENCODING": "ascii"}])])
def test_messages_name_any_path_on_any_terminal(tmp_path, env):
    status, _, errors = simgrab("detect", str(tmp_path / NAME / "ü.mp4"), **env)
    assert status == 2
    shown = (r"w\xff/ü.mp4", r"w\xff/\xfc.mp4")
    assert errors in ([f"simgrab: {tmp_path}/{name}: there is no such file or folder"] for name in shown)


@pytest.mark.parametrize("env", [ASCII, *slow_but([{"PYTHONIOENCODING": "ascii"}])])
def test_lists_with_letters_beyond_ascii_are_printed_on_any_terminal(env):
    pytest.importorskip("simgrab.lab")
    status, said, errors = simgrab("stress", **env)
    assert (status, errors) == (0, [])
    assert b"gamma-towards" in said
