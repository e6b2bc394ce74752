"""Offscreen OpenGL: which backend MuJoCo uses, and which renderer made the pictures."""

from __future__ import annotations

import atexit
import ctypes
import importlib
import logging
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

from simgrab.errors import RendererError
from simgrab.runtime import environment
from simgrab.runtime.processes import PLACE
from simgrab.runtime.versions import Fingerprint
from simgrab.world import llvm

if TYPE_CHECKING:
    import mujoco

BACKENDS = ("egl", "osmesa")
INSTALL_HINT = "on Debian or Ubuntu: sudo apt-get install -y libegl1 libgl1 libgl1-mesa-dri"
LEAST_PYOPENGL = "3.1.10"  # as in pyproject.toml
PYOPENGL_HINT = f"pip install 'PyOpenGL>={LEAST_PYOPENGL}'"
PASSES = "1"  # version of `simgrab.world.camera.passes`: a change of a pixel there raises it
REUSE = "SIMGRAB_REUSE"  # environment variable: 0 draws every picture whole
LLVMPIPE_THREADS = "LP_NUM_THREADS"  # environment variable of Mesa's
_GL_OUT_OF_MEMORY = "0x505"
_EGL_EXTENSIONS = 0x3055

_log = logging.getLogger(__name__)


def choose() -> str:
    """Keep ``MUJOCO_GL`` if it names EGL or OSMesa; else set it to EGL if a device answers, or else to OSMesa.

    MuJoCo reads the variable when it is imported, so this runs when `simgrab.world` is. A variable that names something
    else, or would change pictures, is ignored, here and in worker processes, and a warning names it; see
    `simgrab.runtime.environment`. On a machine with several GPUs, worker processes take them in turn, unless
    ``MUJOCO_EGL_DEVICE_ID`` names one.

    Returns
    -------
    str
        ``egl``, ``osmesa``, or ``disabled`` if neither is installed, or if PyOpenGL is too old for EGL, so that `import
        mujoco` itself would fail; `offscreen` reports why.
    """
    os.environ.setdefault("EGL_LOG_LEVEL", "fatal")  # Mesa's warnings; what it cannot do comes as an error
    ignored = environment.take_out_drawing()
    backend = _backend(os.environ.get("MUJOCO_GL", "").strip().lower())
    for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM"):
        value = os.environ.get(name, "")
        asked = value.strip().lower()
        if asked not in ("", backend):
            ignored[name] = f"{value} (not available)" if name == "MUJOCO_GL" and asked in BACKENDS else value
    os.environ["MUJOCO_GL"] = os.environ["PYOPENGL_PLATFORM"] = backend
    if backend == "disabled":
        del os.environ["PYOPENGL_PLATFORM"]
    else:
        environment.ignore(ignored, f"it renders by {backend}, and as without")
    if backend == "egl":
        _choose_gpu()
    return backend


def _backend(asked: str) -> str:
    """Return the requested backend if it is available, else one that is."""
    for name in sorted(BACKENDS, key=lambda name: name != asked):
        if name == "osmesa" and _loads("libOSMesa.so.8"):
            return name
        # PyOpenGL wants a library of OpenGL beside EGL's.
        if name == "egl" and (_loads("libOpenGL.so.0") or _loads("libGL.so.1")) and _egl_devices()[0]:
            return "disabled" if _old_pyopengl() else name
    return "disabled"


def _old_pyopengl() -> str:
    """Return the version of PyOpenGL if it is too old for MuJoCo's EGL, else an empty text."""
    try:
        installed = version("PyOpenGL")
    except PackageNotFoundError:
        return ""
    numbers, least = ([int(n) for n in re.findall(r"\d+", v)] for v in (installed, LEAST_PYOPENGL))
    return installed if numbers < least else ""


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _choose_gpu() -> None:
    """Give a worker process one of several GPUs."""
    if not os.environ.get("MUJOCO_EGL_DEVICE_ID", "0").strip():
        del os.environ["MUJOCO_EGL_DEVICE_ID"]  # MuJoCo takes it for a number
    place = os.environ.get(PLACE, "")
    if place.isdigit() and "MUJOCO_EGL_DEVICE_ID" not in os.environ and len(found := gpus()) > 1:
        os.environ["MUJOCO_EGL_DEVICE_ID"] = str(found[int(place) % len(found)])


def gpus() -> list[int]:
    """Return the EGL devices that are not software, numbered as ``MUJOCO_EGL_DEVICE_ID`` does."""
    devices, egl = _egl_devices()
    describe = _egl_function(egl, b"eglQueryDeviceStringEXT", ctypes.c_char_p, ctypes.c_void_p, ctypes.c_int)
    if describe is None:
        return []
    texts = ((describe(device, _EGL_EXTENSIONS) or b"").split() for device in devices)
    return [number for number, text in enumerate(texts) if b"EGL_MESA_device_software" not in text]


def _egl_devices() -> tuple[list[int], Any]:
    """Return the handles of EGL's devices, and the library; without Mesa's driver, Debian's libegl1 lists none."""
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError:
        return [], None
    query = _egl_function(
        egl, b"eglQueryDevicesEXT", ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.POINTER(ctypes.c_int)
    )
    count = ctypes.c_int(0)
    if query is None or not query(0, None, ctypes.byref(count)):
        return [], egl
    handles = (ctypes.c_void_p * count.value)()
    query(count.value, handles, ctypes.byref(count))
    return [handle or 0 for handle in handles[: count.value]], egl


def _egl_function(egl: Any, name: bytes, result: Any, *arguments: Any) -> Any:
    """Return a function of an EGL extension; None if it is missing."""
    if egl is None:
        return None
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    address = egl.eglGetProcAddress(name)
    return ctypes.CFUNCTYPE(result, *arguments)(address) if address else None


def threads(number: int | None) -> dict[str, str]:
    """Environment variables that set the number of threads of software OpenGL, unless the user chose one."""
    if number is None or LLVMPIPE_THREADS in os.environ:
        return {}
    return {LLVMPIPE_THREADS: str(number if number > 1 else 0)}  # 0 draws in the thread that calls


def reuses() -> bool:
    """Whether the unchanged part of pictures is reused; see `simgrab.world.camera.renderer.Renderer`."""
    return os.environ.get(REUSE) != "0"


def fingerprint() -> Fingerprint:
    """Read the fingerprint of the current OpenGL context; call it while one is current."""
    import mujoco
    from OpenGL import GL

    names = [GL.glGetString(name) for name in (GL.GL_RENDERER, GL.GL_VERSION)]
    if any(name is None for name in names):
        raise RendererError("no current OpenGL context")
    return Fingerprint(
        names[0].decode(), names[1].decode(), mujoco.__version__, PASSES if reuses() else f"{PASSES} whole"
    )


@dataclass(eq=False)
class Offscreen:
    """An OpenGL context with an offscreen buffer, and a model's meshes in it."""

    window: Any
    context: mujoco.MjrContext

    def make_current(self) -> None:
        """Make this context current again after another renderer used the thread."""
        self.window.make_current()

    def load(self, model: mujoco.MjModel) -> None:
        """Put another model's meshes in the place of the present ones; textures and framebuffers of others stay."""
        self.make_current()
        model.vis.quality.offsamples = self.context.offSamples  # pictures without antialiasing do not use it
        before, self.context = self.context, _loaded(model, 1, 1)
        before.free()


def _loaded(model: mujoco.MjModel, width_px: int, height_px: int) -> mujoco.MjrContext:
    import mujoco

    model.vis.global_.offwidth, model.vis.global_.offheight = width_px, height_px
    with _out_of_memory_raises():
        context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
    context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR  # as drawn: the other way loses far digits
    return context


@contextmanager
def _out_of_memory_raises() -> Iterator[None]:
    """Raise an error if MuJoCo warns that OpenGL lacks memory for a model: rendering it could crash the process."""
    # Its other warnings are logged, and not written to a file in the working folder.
    import mujoco

    warnings: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(warnings.append)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
    for warning in warnings:
        if _GL_OUT_OF_MEMORY in warning:
            raise MemoryError(f"MuJoCo: {warning}")
        _log.warning("MuJoCo: %s", warning)


def _advice() -> str:
    """Return advice for a failure of OpenGL: variables to unset, or packages to install."""
    chosen = ", ".join(f"{name}={value}" for name, value in environment.choosing().items())
    if not chosen:
        return INSTALL_HINT
    advice = f"unset these environment variables, which may be why: {chosen}"
    return advice if os.environ["MUJOCO_GL"] != "disabled" else f"{advice}, or {INSTALL_HINT}"


_used_by: int | None = None  # process, of which a fork lacks the renderer's threads


@contextmanager
def offscreen(model: mujoco.MjModel, width_px: int, height_px: int) -> Iterator[Offscreen]:
    """Open an offscreen context for a model and make it current; free it afterwards.

    Raises
    ------
    RendererError
        If no context can be opened. The message states what to install.
    """
    import mujoco

    global _used_by
    if _used_by not in (None, os.getpid()):
        raise RendererError(
            "this process was forked while OpenGL was in use, so OpenGL would hang: start workers by "
            'multiprocessing\'s "spawn", as DataLoader(…, multiprocessing_context="spawn") does'
        )
    if os.environ["MUJOCO_GL"] == "disabled":
        why = f"(EGL lists no device, and OSMesa is not installed); {_advice()}"
        if old := _old_pyopengl():
            why = f"(PyOpenGL {old}, which pyrender asks for, is too old for MuJoCo); {PYOPENGL_HINT}"
        raise RendererError(f"no offscreen OpenGL {why}")
    llvm.keep_apart()
    _used_by = os.getpid()
    try:
        # By name, and not mujoco.GLContext, which was chosen when mujoco was first imported.
        platform = importlib.import_module(f"mujoco.{os.environ['MUJOCO_GL']}")
        window = platform.GLContext(width_px, height_px)
        if os.environ["MUJOCO_GL"] == "osmesa":
            atexit.register(window.free)  # later its __del__ would fail, for want of PyOpenGL
        window.make_current()
        try:
            buffer = Offscreen(window, _loaded(model, width_px, height_px))
        except BaseException:
            window.free()
            atexit.unregister(window.free)
            raise
    except (ImportError, AttributeError, ValueError, RuntimeError, mujoco.FatalError) as problem:
        raise RendererError(f"no offscreen OpenGL ({problem}); {_advice()}") from problem
    try:
        yield buffer
    finally:
        if not sys.is_finalizing():  # by then EGL itself is closed, and with it the context
            window.make_current()  # else what is freed would be another context's, whose names are the same numbers
            buffer.context.free()
            window.free()
            atexit.unregister(window.free)
