"""Open a scene and serve the page that edits it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from simgrab.errors import ScenarioError
from simgrab.pages.server import local
from simgrab.pages.server.local import Address
from simgrab.pages.studio.documents import Documents
from simgrab.pages.studio.rendering import Rendering, Wish


@contextlib.contextmanager
def serving(documents: Documents, port: int = 0) -> Iterator[Address]:
    """Serve the page over a scene until the context is left. The first frame is rendered before.

    Raises
    ------
    ServerError
        If the extra ``studio`` is not installed, or the port cannot be used.
    RendererError
        If there is no offscreen OpenGL.
    """
    local.check_installed()
    rendering = Rendering()
    try:
        first = rendering.picture("a", Wish(documents.start, 0))
        from simgrab.pages.studio.app import Studio

        with contextlib.suppress(ScenarioError):  # a frame that cannot be: the page shows why
            first.result()
        with local.serving(Studio(documents, rendering).app, port) as address:
            yield address
    finally:
        rendering.end()


def open(scene: str | Path = "quay-day", root: str | Path = ".") -> Documents:
    """Open a scene to edit it.

    Parameters
    ----------
    scene : str or Path
        A bundled scene's name, a scene file, or a dataset's ``manifest.json``.
    root : path
        Folder below which the page opens and saves scenes.

    Raises
    ------
    ScenarioError
        If it cannot be read.
    """
    return Documents(scene, Path(root))
