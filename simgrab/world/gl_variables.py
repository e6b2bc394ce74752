"""Environment variables that OpenGL's libraries read: which are ignored, which are named where it fails.

Guides of other tools have people set them, and they stay. A variable that chooses a device or a driver is left to the
user: the fingerprint shows which one renders. One that makes the same driver render other pictures, or crash, would
not be noticed, so it is taken out of the environment, and of that of worker processes, before OpenGL is loaded.
"""

from __future__ import annotations

import os

VECTOR_WIDTH = "LP_NATIVE_VECTOR_WIDTH"

# Of Mesa and PyOpenGL, and of NVIDIA's driver.
_IGNORED = frozenset((
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


def take_out() -> dict[str, str]:
    """Take variables that change pictures out of the environment; return them."""
    names = [name for name in os.environ if name in _IGNORED]
    if os.environ.get(VECTOR_WIDTH, "").strip() not in _VECTOR_WIDTHS:
        names.append(VECTOR_WIDTH)
    return {name: os.environ.pop(name) for name in names}


def that_choose() -> dict[str, str]:
    """Return the variables that are set of those by which OpenGL chooses device and driver."""
    return {name: os.environ[name] for name in _CHOOSING if os.environ.get(name)}
