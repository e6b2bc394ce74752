"""Choose this machine's second renderer."""

from __future__ import annotations

import importlib.util
import platform
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from simgrab.errors import RendererError
from simgrab.judge.audit.second_renderer.embree_rays import EmbreeRays
from simgrab.judge.audit.second_renderer.interface import SecondRenderer
from simgrab.judge.audit.second_renderer.pyrender_process import PyrenderProcess
from simgrab.world.gl import PYOPENGL_HINT

RENDERERS: tuple[type[SecondRenderer], ...] = (PyrenderProcess, EmbreeRays)  # the first that works is used


def embree_has_wheels() -> bool:
    """Whether `simgrab[audit]` brings embreex on this machine; the same as the marker in pyproject.toml."""
    return sys.platform != "linux" or platform.machine() == "x86_64"


def install_hint() -> str:
    """Return how to install a second renderer on this machine."""
    if embree_has_wheels():
        return "pip install 'simgrab[audit]'"
    return (
        f"embreex has no wheels for Linux on {platform.machine()}: pip install pyrender, and after it {PYOPENGL_HINT}"
    )


@contextmanager
def open_second_renderer() -> Iterator[tuple[SecondRenderer, str]]:
    """Open the first of `RENDERERS` that is installed and works; close it afterwards.

    With it comes a note: its name, and why a preferred renderer that is installed was not used.

    Raises `RendererError` if none is installed, or none works, with what to install.
    """
    problems = []
    for kind in RENDERERS:
        if importlib.util.find_spec(kind.package) is None:
            continue
        try:
            renderer = kind()
        except RendererError as problem:
            problems.append(f"{kind.package} cannot start ({' '.join(str(problem.args[0]).split())})")
            continue
        try:
            yield renderer, "; ".join([renderer.name, *problems])
        finally:
            renderer.close()
        return
    raise RendererError("; ".join([*(problems or ["no second renderer is installed"]), install_hint()]))
