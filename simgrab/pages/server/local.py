"""Serve an application to the browser of this machine: on 127.0.0.1, behind a token that is drawn at each start."""

from __future__ import annotations

import contextlib
import errno
import html
import importlib.util
import os
import secrets
import socket
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from simgrab.errors import ServerError, first_line
from simgrab.pages.server import HOST

if TYPE_CHECKING:
    from starlette.types import ASGIApp

_NEEDED = ("starlette", "uvicorn")
_TOKEN_BYTES = 32
_WAITING = 64  # connections that are not yet accepted
_SECONDS_TO_START, _SECONDS_TO_END = 30.0, 5.0


@dataclass(frozen=True)
class Address:
    """Where a page is served."""

    port: int
    token: str

    @property
    def origin(self) -> str:
        """The address without the token."""
        return f"http://{HOST}:{self.port}"

    @property
    def url(self) -> str:
        """The address to open, which holds the token."""
        return f"{self.origin}/?token={self.token}"


def check_installed() -> None:
    """Refuse to go on where the extra is missing; raises `ServerError`."""
    if any(importlib.util.find_spec(name) is None for name in _NEEDED):
        raise ServerError(f"{' and '.join(_NEEDED)} are not installed: pip install 'simgrab[studio]'")


@contextlib.contextmanager
def serving(app: ASGIApp, port: int = 0) -> Iterator[Address]:
    """Serve an application until the context is left. Port 0 is one that is free.

    Raises `ServerError` if the port cannot be used.
    """
    import uvicorn

    from simgrab.pages.server.guard import Guard

    with contextlib.closing(_listening(port)) as listener:
        address = Address(listener.getsockname()[1], secrets.token_urlsafe(_TOKEN_BYTES))
        config = uvicorn.Config(
            Guard(app, address.port, address.token), http="h11", ws="none", lifespan="off", log_config=None,
            access_log=False, log_level="error", server_header=False, proxy_headers=False, timeout_graceful_shutdown=1,
        )  # fmt: skip
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, args=([listener],), daemon=True)
        thread.start()
        try:
            _wait_for(server, thread)
            yield address
        finally:
            server.should_exit = True
            thread.join(_SECONDS_TO_END)


def _listening(port: int) -> socket.socket:
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOST, port))
        listener.listen(_WAITING)
    except OSError as problem:
        listener.close()
        advice = "; choose another --port" if problem.errno in (errno.EADDRINUSE, errno.EACCES) else ""
        raise ServerError(f"port {port} of {HOST} cannot be used: {first_line(problem)}{advice}") from None
    return listener


def _wait_for(server: object, thread: threading.Thread) -> None:
    """Wait until the server answers."""
    step_s = 0.01
    for _ in range(round(_SECONDS_TO_START / step_s)):
        if getattr(server, "started", False):
            return
        if not thread.is_alive():
            break
        thread.join(step_s)
    raise ServerError("the server did not start")


@contextlib.contextmanager
def opened(address: Address, *, wanted: bool = True) -> Iterator[None]:
    """Open an address in the user's browser, where there is a desktop to show it on.

    The browser gets a file of this user that leads there: the token is in no command line, which other users can list.
    """
    if not (wanted and _has_desktop()):
        yield
        return
    with tempfile.TemporaryDirectory(prefix="simgrab-") as folder:  # which only this user may enter
        page = Path(folder) / "open.html"
        page.write_text(
            f'<!doctype html><meta charset="utf-8"><title>simgrab</title>'
            f'<meta http-equiv="refresh" content="0; url={html.escape(address.url)}">',
            encoding="utf-8",
        )
        with contextlib.suppress(webbrowser.Error, OSError):
            webbrowser.open(page.as_uri())
        yield


def _has_desktop() -> bool:
    """Whether a browser would open a window, rather than take over the terminal."""
    return sys.platform == "darwin" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))
