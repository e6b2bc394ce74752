import errno
import functools
import importlib.util
import json
import os
import platform
import resource
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import av
import click
import cv2
import numpy as np
import pyarrow as pa
import pytest
from commands import run
from conftest import SMALL, as_options
from seconds import SECOND_RENDERERS

from simgrab import __version__
from simgrab.cli import cli, main, render
from simgrab.cli._progress import steps
from simgrab.cli._verbs import VERBS
from simgrab.errors import WorkerError
from simgrab.judge import doctor
from simgrab.judge.audit.second_renderer import choice, install_hint
from simgrab.model import scenes
from simgrab.runtime.versions import PACKAGES, Fingerprint


@pytest.fixture
def ended(monkeypatch, capsys):
    """Run a command as a process of its own does: its exit status, and what it printed to stderr."""

    def run_main(*arguments, command=cli):
        monkeypatch.setattr(sys, "argv", ["simgrab", *arguments])
        with pytest.raises(SystemExit) as end:
            main(command)
        return end.value.code, capsys.readouterr().err

    return run_main


@pytest.mark.parametrize(
    ("arguments", "begins", "ends"),
    [
        (["render", "--beta", "95"], "camera.beta_deg: must be a number <= 30.0", "got 95.0"),
        (["render", "--set", "camera.betta_deg=5"], "camera.betta_deg: unknown key (did you mean 'beta_deg'?)", ""),
        (["render", "--betta", "5"], "No such option", "; see simgrab render --help"),
        (["render", "--frames", "x"], "Invalid value for '--frames'", "; see simgrab render --help"),
        (["render", "quay-dya"], "no scene or file 'quay-dya' (did you mean 'quay-day'?)", ""),
        (["render", "--out", "/proc/simgrab"], "cannot write to /proc/simgrab", ""),
        (["render", "--size", "640"], "size must be WIDTHxHEIGHT in pixels, such as 640x360", "got '640'"),
        (["render", "--size", "640x"], "size must be WIDTHxHEIGHT in pixels, such as 640x360", "got '640x'"),
        (["render", "--video", "a.mp4", "--size", "641x361", "--quiet"], "camera.width_px: must be even", "got 641"),
        (["renders"], "No such command 'renders'", "; see simgrab --help"),
        (["export", "", "--format", "yolo", "--out", "a"], "Invalid value for 'DATASET': a path must not be empty", ""),
        (["estimate"], "Missing argument 'FILE'", "; see simgrab estimate --help"),
        (["detect", "--a\x1b[31m"], "No such option", "; see simgrab detect --help"),
    ],
)
def test_bad_input_ends_in_one_line_and_status_2(arguments, begins, ends, ended):
    status, said = ended(*arguments)
    assert status == 2
    assert said.startswith(f"simgrab: {begins}")
    assert said.endswith(f"{ends}\n")
    assert said[:-1].isprintable()


@pytest.mark.parametrize(
    ("problem", "status", "line"),
    [
        (OSError(errno.ENOSPC, "No space left", "out/coarse.onnx"), 2, "out/coarse.onnx: No space left"),
        (OSError(errno.ENOSPC, "No space left"), 2, "No space left"),
        (OSError("no such thing"), 2, "no such thing"),
        (MemoryError(), 2, "out of memory (allocation failed)"),
        (OSError(errno.ENAMETOOLONG, "Too long", "a" * 5000), 2, f"{'a' * 489} … {'a' * 488}: Too long"),
        (av.error.EOFError(1, "End of file"), 2, "FFmpeg failed: End of file"),
        (BrokenPipeError(), 1, None),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_what_the_machine_refuses_ends_in_one_line(problem, status, line, ended):
    @click.command()
    def fails():
        raise problem

    ends, said = ended(command=fails)
    assert ends == status
    assert said.lstrip("\n") == (f"simgrab: {line}\n" if line else "")  # click ends the line of a ^C


@pytest.mark.parametrize(
    ("stop", "line"),
    [
        (KeyboardInterrupt(), "interrupted{}"),
        (WorkerError("frame 3: it died"), "frame 3: it died{}; if memory is short, use fewer --workers"),
    ],
)
@pytest.mark.parametrize("begun", [True, False])
def test_what_can_be_taken_up_again_says_how(stop, line, begun, monkeypatch, ended, tmp_path):
    monkeypatch.chdir(tmp_path)

    def render(*_, **__):
        if begun:
            Path("out").mkdir()
        raise type(stop)(*stop.args)

    monkeypatch.setattr("simgrab.dataset.render.render", render)
    _, said = ended("render", "--frames", "1", "--out", "out")
    advice = "; run the same command with --resume to continue in out" if begun else "; nothing was written"
    assert said.strip().splitlines()[-1] == f"simgrab: {line.format(advice)}"


@pytest.mark.parametrize("stderr", ["a pipe", "a full disk"])
def test_what_cannot_be_printed_is_one_line_and_status_2(tmp_path, stderr):
    def limited():
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))

    kept = {key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"}
    kept["PYTHONDONTWRITEBYTECODE"] = "1"  # Python would cut off what it compiles, and leave it for all others
    with (tmp_path / "schema.json").open("w") as out, Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "simgrab", "scenes", "schema"], stdout=out, text=True, check=False, env=kept,
            stderr=subprocess.PIPE if stderr == "a pipe" else full, preexec_fn=limited,
        )  # fmt: skip
    assert done.returncode == 2
    if stderr == "a pipe":
        assert done.stderr == "simgrab: File too large\n"


def load_in_vain():
    try:
        raise ImportError("libx265.so: failed to map segment from shared object")
    except ImportError as problem:
        raise ImportError("numpy: IMPORTANT\nread this") from problem


WANT_OF_MEMORY = {
    "numpy": lambda: np.empty(2**57),
    "opencv": lambda: cv2.resize(np.zeros((9, 9), np.uint8), (2**30, 2**30)),
    "pyarrow": lambda: pa.allocate_buffer(2**60),
    "ffmpeg": lambda: av.error.err_check(-errno.ENOMEM),
    "library": load_in_vain,
    "thread": lambda: (_ for _ in ()).throw(RuntimeError("can't start new thread")),
}


@pytest.mark.parametrize("library", WANT_OF_MEMORY)
def test_want_of_memory_ends_in_one_line_whatever_the_library(library, ended):
    status, line = ended(command=lambda **_: WANT_OF_MEMORY[library]())
    assert status == 2
    assert line.startswith("simgrab: out of memory (")
    assert line.count("\n") == 1


def test_a_fault_of_simgrab_is_not_taken_for_want_of_memory():
    with pytest.raises(RuntimeError, match="a fault"):
        main(lambda **_: (_ for _ in ()).throw(RuntimeError("a fault")))


@pytest.mark.parametrize(
    "arguments",
    [
        ["render", "--workers", "0"], ["render", "--workers", "-1"], ["render", "--workers", "1000000000"],
        ["check", "smoke", "--workers", "0"], ["check", "smoke", "--seeds", "1000000000", "--update-baseline"],
        ["stress", "sigma", "--workers", "0"], ["stress", "sigma", "--frames", "1000000000"],
        ["stress", "sigma", "--replications", "1000000000"], ["stress", "sigma", "--seed", "-1"],
        ["stress", "--replay", "sigma", "1" * 6000], ["paper", "--replications", "1000000000"],
        ["run", "a.mp4", "--out", "b", "--rate", "nan"], ["run", "a.mp4", "--out", "b", "--rate", "inf"],
        ["run", "a.mp4", "--out", "b", "--wind-m-s", "nan"], ["grab", "convert", "a.step", "--tolerance-mm", "nan"],
        ["run", "a.mp4", "--out", "b", "--calibrate", "9" * 400], ["render", "--frames", "1" * 6000],
    ],
)  # fmt: skip
def test_absurd_options_are_refused(arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, err = run(*arguments)
    assert status == 2
    assert out == ""
    assert arguments[-2] in err
    assert not list(tmp_path.iterdir())


def test_no_file_takes_the_place_of_a_closed_stream(tmp_path):
    code = f"""
import os, subprocess, sys, click
from pathlib import Path
from simgrab.cli import main
@click.command()
def shows():
    with open({str(tmp_path / "file")!r}, "w") as file:
        os.write(2, b"of a library")
        subprocess.run([sys.executable, "-c", "import os; os.write(1, b'of a process')"], check=True)
    click.echo("of simgrab")
main(shows)
"""
    closed = functools.partial(os.closerange, 0, 3)
    done = subprocess.run([sys.executable, "-c", code], check=False, preexec_fn=closed)
    assert done.returncode == 0
    assert (tmp_path / "file").read_text() == ""


def test_render_prints_a_summary(tmp_path, monkeypatch):
    status, out, _ = run("render", *as_options(SMALL), "--frames", 2, "--out", tmp_path / "out", "--json")
    assert status == 0
    summary = json.loads(out)
    assert summary["frames"] == 2
    status, out, _ = run("audit", tmp_path / "out", "--json")
    assert status == 0
    found = json.loads(out)
    assert found["status"] == "passed"
    assert found["proofs"][-1]["renderer"] in found["proofs"][-1]["note"]
    status, out, _ = run("audit", tmp_path / "out", "--quiet")
    assert (status, out) == (0, "")
    with monkeypatch.context() as without:
        without.setattr(choice, "RENDERERS", ())
        status, out, _ = run("audit", tmp_path / "out")
        assert status == 3
        assert install_hint() in out
        (tmp_path / "out" / "data.yaml").write_text("train: elsewhere")
        status, out, _ = run("audit", tmp_path / "out")
        assert status == 1
        assert "data.yaml" in out
    status, _, err = run("audit", tmp_path)
    assert status == 2
    assert "no simgrab dataset" in err


def test_the_swing_that_is_drawn_stands_beside_that_of_the_frames():
    def expected(scene="quay-day", **changes):
        return render._expected(scenes.load(scene, changes), 200)

    assert expected() == " (sigma 2 ± 0.10)"
    assert expected(**{"swing.alpha.law": {"dist": "exponential"}}) == ""
    varied = {"swing.alpha.sigma_deg": {"dist": "uniform", "low": 1.0, "high": 2.0}}
    assert expected(vary=varied, **{"clip.clip_frames": 1}) == ""
    assert expected("work-cycles") == ""


def test_render_a_video_prints_a_summary(tmp_path):
    command = ["render", *as_options(SMALL), "--frames", 2, "--video", tmp_path / "a.mp4"]
    status, out, _ = run(*command, "--json")
    assert status == 0
    assert json.loads(out)["sent"] == 2
    assert "a.mp4 exists" in run(*command)[2]
    assert "nothing is begun" not in run(*command, "--resume")[2]
    assert "--resume: nothing is begun in" in run(*command[:-1], tmp_path / "b.mp4", "--resume")[2]
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
    assert run("scenes", "calm-day")[1] == run("scenes", "show", "calm-day")[1]
    assert json.loads(run("scenes", "show", "--json")[1])["camera"]["beta_deg"] == 3.0
    assert "$defs" in json.loads(run("scenes", "schema")[1])


def test_version():
    assert run("--version")[:2] == (0, f"simgrab, version {__version__}\n")
    done = subprocess.run([sys.executable, "-m", "simgrab", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"simgrab, version {version('simgrab')}\n"


def test_doctor_reports():
    status, out, _ = run("doctor")
    assert status == 0
    assert "GL_RENDERER" in out
    found = json.loads(run("doctor", "--json")[1])
    assert found["renderer"]["fingerprint"]
    assert f"second renderer  {found['second_renderer']}\n" in out
    for library, features in found["cpu_features"].items():
        assert f"{library + ' uses':<16} {' '.join(features) or 'nothing beyond its baseline'}\n" in out
    for package in PACKAGES:
        assert f"{package:<24} {version(package)}\n" in out


def test_doctor_reports_what_libraries_use_of_the_cpu():
    def report(**environment):
        command = [sys.executable, "-m", "simgrab", "doctor", "--json"]
        turned_down = ("NPY_DISABLE_CPU_FEATURES", "LP_NATIVE_VECTOR_WIDTH", "OPENCV_CPU_DISABLE")
        own = {name: value for name, value in os.environ.items() if name not in turned_down}
        return json.loads(subprocess.check_output(command, env=own | environment))

    usual = json.loads(run("doctor", "--json")[1])
    turned_down = report(
        NPY_DISABLE_CPU_FEATURES=" ".join(usual["cpu_features"]["numpy"]), LP_NATIVE_VECTOR_WIDTH="128",
        OPENCV_CPU_DISABLE=",".join(usual["cpu_features"]["opencv"]),
    )  # fmt: skip
    assert (turned_down["cpu_features"]["numpy"], turned_down["cpu_features"]["opencv"]) == ([], [])
    if usual["rasterizer"]:
        assert f"LLVM {usual['rasterizer']['llvm']}" in usual["renderer"]["renderer"]
        assert turned_down["rasterizer"] == usual["rasterizer"] | {"vector_bits": 128}


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the kernel is one for x86-64")
def test_doctor_names_the_kernels_of_openblas():
    code = "from simgrab.judge.doctor import cpu_features; print(*cpu_features()['openblas'])"
    said = subprocess.check_output([sys.executable, "-c", code], env=os.environ | {"OPENBLAS_CORETYPE": "Nehalem"})
    assert set(said.decode().split()) <= {"Nehalem"}


@pytest.mark.parametrize(
    ("renderer", "gl_version", "found"),
    [
        ("llvmpipe (LLVM 15.0.6, 256 bits)", "4.5 (Compatibility Profile) Mesa 22.3.6", ("22.3.6", "15.0.6", 256)),
        ("llvmpipe (LLVM 19.1.7, 128 bits)", "4.5 (Core Profile) Mesa 25.0.7-2", ("25.0.7-2", "19.1.7", 128)),
        ("Mesa Intel(R) UHD Graphics 620 (KBL GT2)", "4.6 (Compatibility Profile) Mesa 22.3.6", None),
        ("NVIDIA H200/PCIe/SSE2", "4.6.0 NVIDIA 570.86.10", None),
    ],
)
def test_a_rasterizer_is_read_from_what_opengl_calls_it(renderer, gl_version, found):
    rasterizer = doctor.rasterizer(Fingerprint(renderer, gl_version, "4.0.0", "1"))
    assert rasterizer == (found and doctor.Rasterizer(*found))


@pytest.mark.parametrize("kind", SECOND_RENDERERS)
def test_doctor_names_the_second_renderer(kind, monkeypatch):
    monkeypatch.setattr(choice, "RENDERERS", (kind,))
    found = json.loads(run("doctor", "--json")[1])
    assert f"{kind.package} {found['versions'][kind.package]}" in found["second_renderer"]
    assert not found["second_problem"]


def test_doctor_says_how_to_install_a_second_renderer(monkeypatch):
    monkeypatch.setattr(choice, "RENDERERS", ())
    status, out, _ = run("doctor")
    assert status == 0
    assert f"second renderer  none, audits stay incomplete: no second renderer is installed; {install_hint()}" in out


def test_every_command_is_in_the_list_and_one_of_an_absent_room_is_none(monkeypatch):
    listed = run("--help")[1]
    rooms = {verb: ".".join(where.split(".")[:2]) for verb, (where, _) in VERBS.items()}
    for verb in (verb for verb, room in rooms.items() if importlib.util.find_spec(room)):
        assert f"  {verb} " in listed
        assert run(verb, "--help")[0] == 0
    monkeypatch.setitem(VERBS, "doctor", ("simgrab.no_such_room.doctor:command", "Gone."))
    assert "doctor" not in run("--help")[1]
    assert "No such command 'doctor'" in run("doctor")[2]


def complete(kind, **words):
    done = subprocess.run(
        [sys.executable, "-c", "from simgrab.cli import main; main()"],
        env=os.environ | {"_SIMGRAB_COMPLETE": kind} | words,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout.splitlines()


@pytest.mark.parametrize(
    ("shell", "registers"),
    {
        "bash": "complete -o nosort -F",
        "zsh": "compdef _simgrab_completion simgrab",
        "fish": "complete --no-files",
    }.items(),
)
def test_the_documented_command_prints_a_completion_script(shell, registers):
    page = (Path(__file__).parents[2] / "docs" / "commands.md").read_text(encoding="utf-8")
    assert f"_SIMGRAB_COMPLETE={shell}_source simgrab" in page
    assert any(registers in line for line in complete(f"{shell}_source"))


def test_completion_offers_commands():
    assert complete("bash_complete", COMP_WORDS="simgrab re", COMP_CWORD="1") == ["plain,render"]


def test_render_says_what_a_user_may_not_expect(tmp_path):
    small = ["--frames=4", "--size=160x90", "--set=place.model=plain", "--set=image.samples=0"]
    ropes = ["--set", "swing.rope_length_m={dist='uniform', low=29, high=40}", "--set", "swing.clamp=['rope_length_m']"]
    rigid = ["--set", "camera.mount={model='rigid'}"]
    status, _, err = run("render", *small, *ropes, *rigid, "--video", tmp_path / "a.mkv")
    assert status == 0
    assert "swing.rope_length_m: 4 of 4 draws were impossible and were clamped" in err
    assert 'draws each frame on its own (swing.model = "iid")' in err
    assert "camera.mount is only stated" in err


@pytest.mark.parametrize("shown", [True, False])
def test_a_step_is_named_as_it_begins_where_no_bar_is_drawn(shown, capsys):
    with steps(shown=shown) as progress:
        progress("calm, seed 0", 0, 3)
        progress("calm, seed 0", 1, 3)
        assert capsys.readouterr().err == ("calm, seed 0 …\n" if shown else "")
