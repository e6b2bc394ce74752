import errno
import json
import subprocess
import sys

import click
import pytest
from click.testing import CliRunner
from conftest import SMALL, as_options

from simgrab import scenes
from simgrab.cli import cli, main
from simgrab.errors import SimgrabError


def run(*arguments):
    """Run the command line in this process: its exit status, what it printed, and what it complained of."""
    result = CliRunner().invoke(cli, [str(a) for a in arguments])
    if isinstance(result.exception, SimgrabError):
        return 2, result.stdout, f"simgrab: {result.exception}\n"
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


BAD = {
    "unknown key": (["--set", "camera.betta_deg=5"], "beta_deg"),
    "unknown option": (["--betta", "5"], "No such option"),
    "wrong unit": (["--set", "camera.offset_y_mm=600"], "offset_y_m"),
    "wrong type": (["--beta", "five"], "not a valid float"),
    "beta of 95": (["--beta", "95"], "<= 30"),
    "negative sigma": (["--sigma", "-2"], ">= 0"),
    "nan": (["--sigma", "nan"], "finite"),
    "infinite": (["--beta", "inf"], "finite"),
    "unknown scene": (["quay-dya"], "quay-day"),
    "no frames": (["--frames", "0"], ">= 1"),
    "negative seed": (["--seed", "-1"], ">= 0"),
    "no workers": (["--workers", "0"], "workers"),
    "unwritable": (["--out", "/proc/simgrab"], "/proc/simgrab"),
    "unwritable video": (["--video", "/proc/a.mp4", "--frames", "1"], "/proc/a.mp4"),
    "unknown kind of video": (["--video", "a.avi"], ".mp4, .mkv"),
    "frame rate of 0": (["--video", "a.mp4", "--set", "clip.frame_rate_hz=0"], "clip.frame_rate_hz"),
    "odd video": (["--video", "a.mp4", "--set", "camera.width_px=1919"], "even"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_ends_in_one_line_and_status_2(case):
    arguments, message = BAD[case]
    status, out, err = run("render", *arguments)
    assert status == 2
    assert message in err
    assert out == ""
    assert "Traceback" not in err
    assert len(err.strip().splitlines()) == 1 or "Usage:" in err  # click adds its usage


def test_the_process_itself_ends_with_status_2():
    done = subprocess.run(
        [sys.executable, "-m", "simgrab", "render", "--beta", "95"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr == "simgrab: camera.beta_deg: expected float <= 30.0, got 95.0\n"


def test_main_turns_errors_into_status_2(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["simgrab", "scenes", "show", "nowhere"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert capsys.readouterr().err.startswith("simgrab: no scene or file 'nowhere'")


@pytest.mark.parametrize(
    ("problem", "status", "line"),
    [
        (OSError(errno.ENOSPC, "No space left", "out/find.onnx"), 2, "out/find.onnx: No space left"),
        (OSError(errno.ENOSPC, "No space left"), 2, "No space left"),
        (OSError("no such thing"), 2, "no such thing"),
        (MemoryError(), 2, "out of memory (no more could be had)"),
        (BrokenPipeError(), 1, None),
    ],
)
def test_what_the_machine_refuses_ends_in_one_line(problem, status, line, monkeypatch, capsys):
    @click.command()
    def fails():
        raise problem

    monkeypatch.setattr(sys, "argv", ["simgrab"])
    with pytest.raises(SystemExit) as ended:
        main(fails)
    assert ended.value.code == status
    assert capsys.readouterr().err == (f"simgrab: {line}\n" if line else "")


def test_render_prints_a_summary(tmp_path):
    status, out, _ = run("render", *as_options(SMALL), "--frames", 2, "--out", tmp_path / "out", "--json")
    assert status == 0
    summary = json.loads(out)
    assert summary["frames"] == 2
    status, out, _ = run("audit", tmp_path / "out", "--json")
    assert status == 0
    assert json.loads(out)["status"] == "passed"
    status, out, _ = run("audit", tmp_path / "out", "--quiet")
    assert (status, out) == (0, "")
    (tmp_path / "out" / "data.yaml").write_text("train: elsewhere")
    status, out, _ = run("audit", tmp_path / "out")
    assert status == 1
    assert "data.yaml" in out
    status, _, err = run("audit", tmp_path)
    assert status == 2
    assert "no simgrab dataset" in err


def test_render_a_video_prints_a_summary(tmp_path):
    command = ["render", *as_options(SMALL), "--frames", 2, "--video", tmp_path / "a.mp4"]
    status, out, _ = run(*command, "--json")
    assert status == 0
    assert json.loads(out)["sent"] == 2
    assert "a.mp4 exists" in run(*command)[2]
    status, out, _ = run(*command, "--resume", "--out", tmp_path / "data")
    assert status == 0
    assert "preview.jpg" in out
    assert ".parquet" in out


def test_scenes_lists_shows_and_describes():
    status, out, _ = run("scenes")
    assert status == 0
    for name in scenes.names():
        assert f"{name} " in out
    assert set(json.loads(run("scenes", "--json")[1])) == set(scenes.names())
    assert "beta_deg = 5.0" in run("scenes", "show", "--beta", 5)[1]
    assert json.loads(run("scenes", "show", "--json")[1])["camera"]["beta_deg"] == 3.0
    assert "$defs" in json.loads(run("scenes", "schema")[1])


def test_doctor_reports():
    status, out, _ = run("doctor")
    assert status == 0
    assert "GL_RENDERER" in out
    found = json.loads(run("doctor", "--json")[1])
    assert found["renderer"]["fingerprint"]


def test_help_names_every_verb():
    out = run("--help")[1]
    for verb in ("audit", "doctor", "render", "scenes"):
        assert f"  {verb} " in out
        assert run(verb, "--help")[0] == 0
