"""What the applications of all pages have: their files, answers as JSON, and errors in one line."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import msgspec
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from simgrab.errors import ScenarioError, SimgrabError, memory_problem, shortened
from simgrab.text import printable

_SHARED = Path(__file__).with_name("static")
_KINDS = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
Endpoint: TypeAlias = Callable[[Request], Response | Awaitable[Response]]


def application(
    folder: Path, index: str, read: Mapping[str, Endpoint], changed: Mapping[str, Endpoint], handlers: Any = None
) -> Starlette:
    """Make the ASGI application of a page.

    Parameters
    ----------
    folder : Path
        Of the page's files, each of which is named by its name alone.
    index : str
        The file at ``/``.
    read, changed : mapping of str to callable
        What answers GET and POST, by path. What it refuses by a `SimgrabError` is answered with the line.
    handlers : mapping of exception types to callable, optional
        What answers other errors.
    """
    paths = [path for place in (_SHARED, folder) for path in place.iterdir() if path.suffix in _KINDS]
    # Read once, by name, so that no path of a request is ever joined to one of the disk.
    files = {path.name: (path.read_bytes(), _KINDS[path.suffix]) for path in paths}

    def file(request: Request) -> Response:
        name = request.path_params.get("name", index)
        if name not in files:
            raise HTTPException(404)
        content, kind = files[name]
        return Response(content, media_type=kind)

    routes = [
        Route(path, endpoint, methods=[method])
        for method, endpoints in (("GET", {"/": file, "/static/{name}": file} | dict(read)), ("POST", changed))
        for path, endpoint in endpoints.items()
    ]
    refusals: Any = {SimgrabError: _refused, MemoryError: _refused, HTTPException: _unknown}
    made = Starlette(routes=routes, exception_handlers=refusals | (handlers or {}))
    made.router.redirect_slashes = False
    return made


def json(data: Any, status: int = 200) -> Response:
    """Answer with plain data or structs, as JSON."""
    return Response(msgspec.json.encode(data), status, media_type="application/json")


def _refused(_: Request, problem: Exception) -> Response:
    line = memory_problem(problem) or str(problem)
    if isinstance(problem, ScenarioError):
        about = {"key": printable(problem.key), "problem": shortened(printable(problem.problem))}
    else:
        about = {"key": "", "problem": line}
    return json({"error": line} | about, 422)


def _unknown(_: Request, problem: Exception) -> Response:
    assert isinstance(problem, HTTPException)
    return json({"error": printable(problem.detail)}, problem.status_code)
