"""Find out whether this machine can draw, and with what."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

from simgrab._version import __version__
from simgrab.errors import RendererError
from simgrab.judge.audit.second_renderer import open_second_renderer
from simgrab.world import gl
from simgrab.world.output.manifest import PACKAGES


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
    versions : dict of str to str
    """

    backend: str
    renderer: gl.Fingerprint | None
    problem: str
    second_renderer: str
    second_problem: str
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
    return Diagnosis(os.environ["MUJOCO_GL"], renderer, problem, second_renderer, second_problem, versions)


def _open_context() -> gl.Fingerprint:
    import mujoco

    with gl.offscreen(mujoco.MjSpec().compile(), 64, 64):
        return gl.fingerprint()
