"""Serve the page that edits a scene."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

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
