"""Report whether this machine can render, with what, and on what the bytes of its datasets depend."""

from __future__ import annotations

import ctypes
import functools
import os
import platform
import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import scipy
import scipy.linalg  # loads its OpenBLAS

from simgrab._version import __version__
from simgrab.errors import RendererError
from simgrab.judge.audit.second_renderer import open_second_renderer
from simgrab.runtime.versions import PACKAGES, Fingerprint
from simgrab.world import gl


@dataclass(frozen=True)
class Rasterizer:
    """Mesa's llvmpipe, which compiles its code for the machine's CPU."""

    # mesa, llvm: versions
    mesa: str
    llvm: str
    vector_bits: int  # width of its vectors: 256 with AVX, 128 without; `LP_NATIVE_VECTOR_WIDTH` sets another


@dataclass(frozen=True)
class Diagnosis:
    """Result of `examine`."""

    backend: str  # `egl`, `osmesa`, `disabled`, or what `MUJOCO_GL` was set to
    # None where no context could be opened; then `problem` gives the reason and what to install
    renderer: Fingerprint | None
    problem: str
    second_renderer: str  # the second renderer that audits use here, with its version; empty where there is none
    second_problem: str  # why there is no second renderer, and what to install
    rasterizer: Rasterizer | None  # version of Mesa's software renderer; None where another driver renders
    # by library, the features of this CPU that it uses beyond its build's baseline: features that NumPy and OpenCV
    # dispatch to, code of Intel's IPP in OpenCV, kernels of the OpenBLAS in NumPy and SciPy; with other features,
    # results may differ in the last bit
    cpu_features: dict[str, tuple[str, ...]]
    # versions of simgrab, of the packages in a manifest, on which bytes depend, and of a few others
    versions: dict[str, str]


def examine() -> Diagnosis:
    """Open a small offscreen context, then the second renderer, and report."""
    renderer, problem = None, ""
    try:
        renderer = fingerprint()
    except RendererError as error:
        problem = str(error)
    second_renderer, second_problem = "", ""
    try:
        with open_second_renderer() as (_, second_renderer):
            pass
    except RendererError as error:
        second_problem = str(error)
    versions = {"simgrab": __version__, "python": platform.python_version()}
    for package in (*PACKAGES, "pyopengl", "pyrender", "embreex"):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed"
    return Diagnosis(
        backend=os.environ["MUJOCO_GL"],
        renderer=renderer,
        problem=problem,
        second_renderer=second_renderer,
        second_problem=second_problem,
        rasterizer=rasterizer(renderer) if renderer else None,
        cpu_features=cpu_features(),
        versions=versions,
    )


@functools.cache
def fingerprint() -> Fingerprint:
    """Open a small offscreen context, and name its renderer; raises `RendererError` where none can be opened."""
    import mujoco

    with gl.offscreen(mujoco.MjSpec().compile(), 64, 64):
        return gl.fingerprint()


def rasterizer(fingerprint: Fingerprint) -> Rasterizer | None:
    """Read Mesa's version, LLVM's and the vector width from the strings of OpenGL; None for another renderer."""
    llvm = re.search(r"\(LLVM ([\d.]+), (\d+) bits\)", fingerprint.renderer)
    mesa = re.search(r"Mesa (\S+)", fingerprint.version)
    return Rasterizer(mesa[1], llvm[1], int(llvm[2])) if llvm and mesa else None


def cpu_features() -> dict[str, tuple[str, ...]]:
    """Return the CPU features that libraries use, without those that environment variables disable; see `Diagnosis`."""
    return {
        "numpy": tuple(np.show_config("dicts")["SIMD Extensions"].get("found", ())),
        "opencv": tuple(
            name[1:] for name in cv2.getCPUFeaturesLine().split() if name.startswith("*") and not name.endswith("?")
        ),
        "ipp": (cv2.ipp.getIppVersion().split()[1],) if cv2.ipp.useIPP() else (),
        "openblas": tuple(kernel for package in (np, scipy) for kernel in _openblas_kernels(package)),
    }


def _openblas_kernels(package: ModuleType) -> Iterator[str]:
    """Yield the kernels that the OpenBLAS in a package's wheel has chosen, none where it has another BLAS."""
    for file in sorted(Path(package.__file__ or "").parent.parent.glob(f"{package.__name__}.libs/*openblas*")):
        library = ctypes.CDLL(str(file))
        for name in ("scipy_openblas_get_corename64_", "scipy_openblas_get_corename"):
            if kernel := getattr(library, name, None):
                kernel.restype = ctypes.c_char_p
                yield kernel().decode()
