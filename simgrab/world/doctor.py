"""Find out whether this machine can draw, and with what."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

from simgrab import __version__
from simgrab.errors import RendererError
from simgrab.world import gl, second_opinion
from simgrab.world.manifest import PACKAGES


@dataclass(frozen=True)
class Diagnosis:
    """What `examine` found.

    Attributes
    ----------
    backend : str
        ``egl``, ``osmesa``, ``disabled``, or what ``MUJOCO_GL`` was set to.
    renderer : Fingerprint or None
        None where no context could be opened; then ``problem`` says why and what to install.
    second_renderer : bool
        Whether the audit's second renderer is installed.
    versions : dict of str to str
    """

    backend: str
    renderer: gl.Fingerprint | None
    problem: str
    second_renderer: bool
    versions: dict[str, str]

    @property
    def healthy(self) -> bool:
        """Whether frames can be drawn."""
        return self.renderer is not None


def examine() -> Diagnosis:
    """Open a small offscreen context and report."""
    renderer, problem = None, ""
    try:
        renderer = _open_context()
    except RendererError as error:
        problem = str(error)
    versions = {"simgrab": __version__, "python": platform.python_version()}
    for package in (*PACKAGES, "pyopengl", "pyrender"):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed"
    return Diagnosis(os.environ["MUJOCO_GL"], renderer, problem, second_opinion.available(), versions)


def _open_context() -> gl.Fingerprint:
    import mujoco

    with gl.offscreen(mujoco.MjSpec().compile(), 64, 64):
        return gl.fingerprint()
