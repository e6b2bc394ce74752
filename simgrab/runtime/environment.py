"""Environment variables that libraries read when they are loaded: which are taken out, and named in a warning.

Guides of other tools have people set them, and they stay. With some numbers OpenCV and NumPy cannot work. A variable
that chooses a device or a driver of OpenGL is left to the user: the fingerprint shows which one renders. One that makes
the same driver render other pictures, or crash, would not be noticed, so it is taken out, here and for workers.
"""

from __future__ import annotations

import logging
import os
import re

from simgrab.errors import shortened
from simgrab.text import printable

MOST_PIXELS = 100_000_000  # of a picture: three times 8K; as RGB it takes 300 MB
MOST_SIDE = 16_384  # a detector pads a narrow strip to the net's aspect, and OpenCV warps no more than 32,766

_LEAST = {
    "OPENCV_IO_MAX_IMAGE_PIXELS": MOST_PIXELS, "OPENCV_IO_MAX_IMAGE_WIDTH": MOST_SIDE,
    "OPENCV_IO_MAX_IMAGE_HEIGHT": MOST_SIDE, "OPENCV_IO_MAX_IMAGE_PARAMS": 2,
}  # fmt: skip
_OF_NUMBERS = re.compile(r"OPENCV_\w*(_MAX_|_NUM$|_WAIT_|_GRANULARITY$|_LIMIT$|_DEPTH_)\w*|NUMPY_MADVISE_HUGEPAGE")
_NUMBER = re.compile(r"(\d+)(?:([KM])b)?", re.IGNORECASE)

VECTOR_WIDTH = "LP_NATIVE_VECTOR_WIDTH"
# Of Mesa and PyOpenGL, and of NVIDIA's driver.
_DRAWING = frozenset((
    "DRAW_USE_LLVM", "GALLIUM_DDEBUG", "GALLIUM_DUMP_VS", "GALLIUM_NOOP", "GALLIUM_NOSSE", "GALLIUM_OVERRIDE_CPU_CAPS",
    "GALLIUM_TESTS", "GALLIVM_PERF", "LP_NO_RAST", "LP_PERF", "MESA_EXTENSION_MAX_YEAR", "MESA_EXTENSION_OVERRIDE",
    "MESA_GL_VERSION_OVERRIDE", "MESA_MVP_DP4", "MESA_NO_ERROR", "MESA_SHADER_READ_PATH", "force_gl_renderer",
    "mesa_extension_override", "mesa_no_error",
    "PYOPENGL_CONTEXT_CHECKING", "PYOPENGL_ERROR_CHECKING", "PYOPENGL_ERROR_ON_COPY",
    "__GL_ALLOW_FXAA_USAGE", "__GL_FSAA_MODE", "__GL_LOG_MAX_ANISO", "__GL_SHARPEN_ENABLE",
))  # fmt: skip
_VECTOR_WIDTHS = ("", "128", "256")  # bits; llvmpipe crashes with others
# Of these depends which device and driver OpenGL finds, if any.
_CHOOSING = (
    "MUJOCO_EGL_DEVICE_ID", "__EGL_VENDOR_LIBRARY_FILENAMES", "__EGL_VENDOR_LIBRARY_DIRS", "LIBGL_DRIVERS_PATH",
    "LIBGL_ALWAYS_SOFTWARE", "GALLIUM_DRIVER", "MESA_LOADER_DRIVER_OVERRIDE",
)  # fmt: skip

_log = logging.getLogger(__name__)


def ignore(variables: dict[str, str], why: str) -> None:
    """Warn that variables are ignored, and why; they were removed from the environment."""
    if variables:
        names = ", ".join(f"{name}={value}" for name, value in variables.items())
        _log.warning("%s", shortened(printable(f"simgrab ignores {names}: {why}")))


def take_out_numbers() -> None:
    """Remove numbers with which OpenCV or NumPy would end the process at import, or refuse simgrab's files."""
    names = [name for name in os.environ if _OF_NUMBERS.fullmatch(name) and not _is_enough(name, os.environ[name])]
    ignore(_taken_out(names), "no numbers with which OpenCV and NumPy work")


def take_out_drawing() -> dict[str, str]:
    """Take out variables by which OpenGL would draw other pictures; return them."""
    odd = os.environ.get(VECTOR_WIDTH, "").strip() not in _VECTOR_WIDTHS
    return _taken_out([name for name in os.environ if name in _DRAWING or (odd and name == VECTOR_WIDTH)])


def choosing() -> dict[str, str]:
    """Return the variables that are set of those by which OpenGL chooses device and driver."""
    return {name: os.environ[name] for name in _CHOOSING if os.environ.get(name)}


def _taken_out(names: list[str]) -> dict[str, str]:
    return {name: os.environ.pop(name) for name in names}


def _is_enough(name: str, value: str) -> bool:
    number = _NUMBER.fullmatch(value)
    if number is None:
        return False
    factor = {None: 1, "k": 2**10, "m": 2**20}[number[2] and number[2].lower()]
    return _LEAST.get(name, 0) <= int(number[1]) * factor < 2**64
