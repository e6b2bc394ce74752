"""What environment variables do: nothing, or they are ignored and named, or the refusal names them."""

import importlib
import json
import os
import subprocess
import sys
import types

import pytest
from conftest import SMALL

from simgrab.runtime import environment
from simgrab.world import gl, llvm

LIBRARIES = {"libOpenGL.so.0", "libOSMesa.so.8"}


@pytest.fixture
def machine(monkeypatch):
    """A machine with EGL and OSMesa, of which a test takes away."""
    there = {"egl", *LIBRARIES}
    monkeypatch.setattr(gl, "_loads", lambda library: library in there)
    monkeypatch.setattr(gl, "_egl_devices", lambda: (["egl"] if "egl" in there else [], None))
    for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM", "MUJOCO_EGL_DEVICE_ID"):
        monkeypatch.setenv(name, "")
    return there


@pytest.mark.parametrize(
    ("given", "lacking", "backend", "ignored"),
    [
        ({}, "", "egl", ""),
        ({}, "egl", "osmesa", ""),
        ({}, "libOpenGL.so.0", "osmesa", ""),
        ({"MUJOCO_GL": " OSMesa "}, "", "osmesa", ""),
        ({"MUJOCO_GL": "osmesa"}, "libOSMesa.so.8", "egl", "MUJOCO_GL=osmesa (not available)"),
        ({"MUJOCO_GL": "egl"}, "egl", "osmesa", "MUJOCO_GL=egl (not available)"),
        ({"MUJOCO_GL": "glfw"}, "", "egl", "MUJOCO_GL=glfw"),
        ({"MUJOCO_GL": "no\nsuch"}, "", "egl", r"MUJOCO_GL=no\nsuch"),
        ({"PYOPENGL_PLATFORM": "osmesa"}, "", "egl", "PYOPENGL_PLATFORM=osmesa"),
        ({"PYOPENGL_PLATFORM": "Egl"}, "", "egl", ""),
        ({"PYOPENGL_PLATFORM": "egl", "MUJOCO_GL": "osmesa"}, "", "osmesa", "PYOPENGL_PLATFORM=egl"),
        ({"LP_NO_RAST": "1", "PYOPENGL_PLATFORM": "glx"}, "", "egl", "LP_NO_RAST=1, PYOPENGL_PLATFORM=glx"),
        ({"LP_NATIVE_VECTOR_WIDTH": "512"}, "", "egl", "LP_NATIVE_VECTOR_WIDTH=512"),
        ({"LP_NATIVE_VECTOR_WIDTH": "128"}, "", "egl", ""),
        ({"MUJOCO_EGL_DEVICE_ID": " "}, "", "egl", ""),
    ],
)
def test_the_backend_is_one_that_is_there_and_what_is_ignored_is_named_once(
    machine, monkeypatch, caplog, given, lacking, backend, ignored
):
    machine.discard(lacking)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    assert gl.choose() == backend
    assert os.environ["MUJOCO_GL"] == os.environ["PYOPENGL_PLATFORM"] == backend
    assert gl.choose() == backend  # as in a worker process, which inherits the environment
    expected = [f"simgrab ignores {ignored}: it renders by {backend}, and as without"] if ignored else []
    assert caplog.messages == expected
    assert not os.environ.get("MUJOCO_EGL_DEVICE_ID", "none").isspace()


def test_without_any_backend_the_refusal_names_what_is_set_and_what_to_install(machine, monkeypatch, caplog):
    import mujoco

    from simgrab.errors import RendererError

    machine.clear()
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_FILENAMES", "/none")
    assert gl.choose() == "disabled"
    assert "PYOPENGL_PLATFORM" not in os.environ
    words = r"OSMesa is not installed\); unset .*__EGL_VENDOR_LIBRARY_FILENAMES=/none, or .*apt-get install"
    with pytest.raises(RendererError, match=words), gl.offscreen(mujoco.MjSpec().compile(), 8, 8):
        pass
    assert caplog.messages == []


@pytest.mark.parametrize(("name", "value", "taken"), [
    ("OPENCV_IO_MAX_IMAGE_PIXELS", "abc", True), ("OPENCV_IO_MAX_IMAGE_PIXELS", "", True),
    ("OPENCV_IO_MAX_IMAGE_PIXELS", "1000", True), ("OPENCV_IO_MAX_IMAGE_PIXELS", str(2**40), False),
    ("OPENCV_IO_MAX_IMAGE_PIXELS", str(2**64), True), ("OPENCV_IO_MAX_IMAGE_HEIGHT", "1MB", False),
    ("OPENCV_FOR_THREADS_NUM", "two", True), ("OPENCV_FOR_THREADS_NUM", "2", False),
    ("OPENCV_THREAD_POOL_ACTIVE_WAIT_MAIN", "x", True), ("NUMPY_MADVISE_HUGEPAGE", "on", True),
    ("OPENCV_FFMPEG_CAPTURE_OPTIONS", "rtsp_transport;udp", False),
])  # fmt: skip
def test_numbers_with_which_opencv_ends_the_process_are_ignored(monkeypatch, caplog, name, value, taken):
    monkeypatch.setenv(name, value)
    environment.take_out_numbers()
    assert (name not in os.environ) == taken == any(f"{name}={value}" in line for line in caplog.messages)


def test_triton_finds_its_own_llvm_when_it_is_imported_after_mesa(monkeypatch, tmp_path):
    (tmp_path / "triton" / "_C").mkdir(parents=True)
    (tmp_path / "triton" / "__init__.py").touch()
    (tmp_path / "triton" / "_C" / "libtriton.so").touch()
    loaded = []
    monkeypatch.setattr(llvm, "ctypes", types.SimpleNamespace(CDLL=lambda path, mode: loaded.append((path, mode))))
    monkeypatch.setattr(sys, "meta_path", [f for f in sys.meta_path if not isinstance(f, llvm._Finder)])
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(sys.modules, "triton", None)  # at the end there is again what is there now
    del sys.modules["triton"]
    before = len(sys.meta_path)
    llvm.keep_apart()
    llvm.keep_apart()
    assert (len(sys.meta_path), loaded) == (before + 1, [])
    importlib.import_module("triton")
    del sys.modules["triton"]
    importlib.import_module("triton")
    assert loaded == [(str(tmp_path / "triton" / "_C" / "libtriton.so"), os.RTLD_NOW | os.RTLD_DEEPBIND)]


# Forks itself for every environment, before OpenGL is loaded, and renders a small frame there.
RENDER = """
import ctypes, hashlib, json, logging, os, sys
for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM", "MUJOCO_EGL_DEVICE_ID"):
    os.environ.pop(name, None)
import cv2, scipy.spatial, simgrab
load = ctypes.CDLL

def absent(name, *rest):
    if str(name).startswith(("libEGL", "libGL", "libOpenGL", "libOSMesa")):
        raise OSError(name)
    return load(name, *rest)

ctypes.CDLL = absent
from simgrab.world import gl
from simgrab.world.frames import FrameGenerator
ctypes.CDLL = load
del os.environ["MUJOCO_GL"]

def render():
    said = []
    handler = logging.Handler()
    handler.emit = lambda record: said.append(record.getMessage())
    logging.getLogger("simgrab").addHandler(handler)
    try:
        gl.choose()
        with FrameGenerator(simgrab.load("quay-day", json.loads(sys.argv[1]))) as generator:
            frame = generator.frame(0, full=True)
            drawn = frame.rgb.tobytes() + frame.ids.tobytes() + frame.depth.tobytes()
            found = hashlib.sha256(drawn).hexdigest() + generator.scene(0).renderer.fingerprint.digest
    except simgrab.errors.SimgrabError as problem:
        found = str(problem)
    assert not {"torch", "triton"} & set(sys.modules)
    return [found, said]

for variables in json.loads(sys.argv[2]):
    read, write = os.pipe()
    child = os.fork()
    if not child:
        os.environ.update(variables)
        os.write(write, json.dumps(render()).encode())
        os._exit(0)
    os.close(write)
    with os.fdopen(read) as answer:
        print(answer.read() or "null", flush=True)
    os.waitpid(child, 0)
"""
SIZE = SMALL | {"camera.width_px": 240, "camera.height_px": 136, "frames": 2} | {
    "camera.focal": {"model": "pixels", "focal_length_px": 205.6}
}  # fmt: skip
REFUSED, IGNORED, SAME = "refused", "ignored", "same"
FEW = [
    ({"MUJOCO_EGL_DEVICE_ID": "first"}, REFUSED),
    ({"LP_NO_RAST": "1", "MUJOCO_GL": "glx", "PYOPENGL_PLATFORM": "glx"}, IGNORED),
]
MANY = [
    *(({name: value}, REFUSED) for name, value in (
        ("MUJOCO_EGL_DEVICE_ID", "3"), ("MUJOCO_EGL_DEVICE_ID", "-1"), ("GALLIUM_DRIVER", "none"),
        ("LIBGL_DRIVERS_PATH", "/none"),
    )),
    ({
        "LP_PERF": "no_mipmap,no_depth", "DRAW_USE_LLVM": "0", "GALLIUM_DDEBUG": "flush", "GALLIUM_NOOP": "1",
        "GALLIUM_TESTS": "1", "GALLIVM_PERF": "brilinear", "LP_NATIVE_VECTOR_WIDTH": "512", "MESA_MVP_DP4": "1",
        "MESA_EXTENSION_OVERRIDE": "-GL_ARB_clip_control", "MESA_GL_VERSION_OVERRIDE": "2.1",
        "PYOPENGL_ERROR_CHECKING": "0", "PYOPENGL_ERROR_ON_COPY": "1", "PYOPENGL_CONTEXT_CHECKING": "1",
    }, IGNORED),
    ({
        "CUDA_VISIBLE_DEVICES": "", "DISPLAY": ":9", "WAYLAND_DISPLAY": "none", "XDG_SESSION_TYPE": "wayland",
        "EGL_PLATFORM": "x11", "DRI_PRIME": "1", "LP_NUM_THREADS": "many", "LIBGL_ALWAYS_SOFTWARE": "1",
        "MESA_DEBUG": "silent", "MESA_GLSL_VERSION_OVERRIDE": "330", "MESA_GLSL": "nopt", "ST_DEBUG": "",
        "PYOPENGL_USE_ACCELERATE": "0", "PYOPENGL_STORE_POINTERS": "0", "PYOPENGL_ARRAY_SIZE_CHECKING": "0",
    }, SAME),
]  # fmt: skip


@pytest.mark.parametrize("cases", [FEW, pytest.param(MANY, marks=pytest.mark.slow)], ids=["few", "many"])
def test_no_variable_changes_a_picture_unsaid(cases):
    environments = json.dumps([{}, *(variables for variables, _ in cases)])
    command = [sys.executable, "-c", RENDER, json.dumps(SIZE), environments]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    (plain, said), *others = map(json.loads, done.stdout.splitlines())
    assert (len(plain), said) == (64 + 16, [])  # a picture, and nothing said
    found = {}
    for (variables, _), answer in zip(cases, others, strict=True):
        picture, said = answer or ("died", [])
        named = all(f"{name}={value}" in "".join([picture, *said]) for name, value in variables.items())
        kind = IGNORED if picture == plain and named and len(said) == 1 else REFUSED if named and not said else "wrong"
        found[str(variables)] = SAME if picture == plain and not said else kind
    assert found == {str(variables): kind for variables, kind in cases}


@pytest.mark.skipif(not gl._loads("libOSMesa.so.8"), reason="OSMesa is not installed")
def test_osmesa_renders_what_egl_renders_and_a_renderer_left_open_ends_quietly():
    code = (
        "import hashlib, json, os, simgrab, sys\n"
        "os.environ |= {'MUJOCO_GL': sys.argv[2], 'PYOPENGL_PLATFORM': ''}\n"
        "generator = simgrab.frames(simgrab.load('quay-day', json.loads(sys.argv[1])))\n"
        "print(hashlib.sha256(next(generator).rgb.tobytes()).hexdigest(), os.environ['MUJOCO_GL'])"
    )
    done = [subprocess.run([sys.executable, "-c", code, json.dumps(SIZE), name], capture_output=True, text=True)
            for name in gl.BACKENDS]  # fmt: skip
    (one, by), (other, then) = (run.stdout.split() for run in done)
    assert (one, by, then) == (other, *gl.BACKENDS)
    assert [run.stderr for run in done] == ["", ""]


def test_every_ignored_variable_is_taken_out(monkeypatch):
    for name in environment._DRAWING:
        monkeypatch.setenv(name, "1")
    assert set(environment.take_out_drawing()) == environment._DRAWING
    assert not environment._DRAWING & set(os.environ)
