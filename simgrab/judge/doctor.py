"""Find out whether this machine can render, with what, and what the bytes of its datasets depend on."""

from __future__ import annotations

import os
import platform
import re
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from simgrab._version import __version__
from simgrab.errors import RendererError
from simgrab.judge.audit.second_renderer import open_second_renderer
from simgrab.world import gl
from simgrab.world.output.manifest import PACKAGES


@dataclass(frozen=True)
class Rasterizer:
    """Mesa's llvmpipe, which compiles its code for the machine's CPU.

    Attributes
    ----------
    mesa, llvm : str
        Versions.
    vector_bits : int
        Width of its vectors: 256 with AVX, 128 without; ``LP_NATIVE_VECTOR_WIDTH`` sets another.
    """

    mesa: str
    llvm: str
    vector_bits: int


@dataclass(frozen=True)
class Diagnosis:
    """What `examine` found.

    Attributes
    ----------
    backend : str
        ``egl``, ``osmesa``, ``disabled``, or what ``MUJOCO_GL`` was set to.
    renderer : Fingerprint or None
        None where no context could be opened; then ``problem`` says why and what to install.
    second_renderer : str
        The second renderer that audits use here, with its version; empty where there is none.
    second_problem : str
        Why there is none and what to install.
    rasterizer : Rasterizer or None
        Of Mesa's software renderer; None where another driver renders.
    cpu_features : tuple of str
        CPU features that NumPy dispatches to, beyond those that it was built for. Its sums and transcendental functions
        may differ in the last bit from those of another machine.
    versions : dict of str to str
        Of simgrab, of the packages in a manifest, on which bytes depend, and of a few others.
    """

    backend: str
    renderer: gl.Fingerprint | None
    problem: str
    second_renderer: str
    second_problem: str
    rasterizer: Rasterizer | None
    cpu_features: tuple[str, ...]
    versions: dict[str, str]

    @property
    def healthy(self) -> bool:
        """Whether frames can be drawn."""
        return self.renderer is not None


def examine() -> Diagnosis:
    """Open a small offscreen context, then the second renderer, and report."""
    renderer, problem = None, ""
    try:
        renderer = _open_context()
    except RendererError as error:
        problem = str(error)
    second_renderer, second_problem = "", ""
    try:
        with open_second_renderer() as choice:
            second_renderer = choice.note
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


def rasterizer(fingerprint: gl.Fingerprint) -> Rasterizer | None:
    """Read Mesa's version, LLVM's and the vector width from the strings of OpenGL; None where they are another's."""
    llvm = re.search(r"\(LLVM ([\d.]+), (\d+) bits\)", fingerprint.renderer)
    mesa = re.search(r"Mesa (\S+)", fingerprint.version)
    return Rasterizer(mesa[1], llvm[1], int(llvm[2])) if llvm and mesa else None


def cpu_features() -> tuple[str, ...]:
    """Return the CPU features that NumPy dispatches to here, without what ``NPY_DISABLE_CPU_FEATURES`` takes away."""
    return tuple(np.show_config("dicts")["SIMD Extensions"].get("found", ()))


def _open_context() -> gl.Fingerprint:
    import mujoco

    with gl.offscreen(mujoco.MjSpec().compile(), 64, 64):
        return gl.fingerprint()
