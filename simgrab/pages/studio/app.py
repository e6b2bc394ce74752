"""What the page asks for, and what it gets: see `Studio.app`."""

from __future__ import annotations

import asyncio
import functools
import struct
from pathlib import Path
from typing import Any, Literal

import msgspec
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response

from simgrab.errors import ScenarioError
from simgrab.io.parse import parse_json
from simgrab.model import layouts
from simgrab.model.scenario import Scenario, schema
from simgrab.model.scenario.base import unit_of
from simgrab.pages.server.application import application, json
from simgrab.pages.studio.commands import command
from simgrab.pages.studio.documents import Documents, ExistsError
from simgrab.pages.studio.measuring import Measuring
from simgrab.pages.studio.rendering import Rendering, Wish
from simgrab.pages.studio.turns import SupersededError
from simgrab.text import printable

STATIC = Path(__file__).with_name("static")
Side = Literal["a", "b"]


class Asked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A request about a scene, of which each uses a part."""

    scene: msgspec.Raw  # plain data, as JSON
    side: Side = "a"  # which of the scenes beside each other it is
    frame: int = 0
    small: bool = False  # whether a small picture will do
    # path, replace: where it is saved, and whether a scene file there is replaced
    path: str = ""
    replace: bool = False


class Studio:
    """Answers the page's requests about scenes."""

    def __init__(self, documents: Documents, rendering: Rendering) -> None:
        self._documents, self._rendering = documents, rendering
        self._measuring = Measuring()
        self._scenario = functools.lru_cache(_KEPT)(self._parsed)  # those of the requests before are known

    @property
    def app(self) -> Starlette:
        """The ASGI application. Scenes are sent whole."""
        asked = {
            "/api/frame": self.frame, "/api/measure": self.measure, "/api/toml": self.toml,
            "/api/command": self.command, "/api/save": self.save,
        }  # fmt: skip
        return application(
            STATIC, "studio.html", {"/api/start": self.start, "/api/open": self.open}, asked,
            {SupersededError: lambda _, __: json({"error": "superseded"}, 409)},
        )  # fmt: skip

    def start(self, _: Request) -> Response:
        """Give the scene to begin with, and what the controls are made of."""
        documents = self._documents
        whole = schema()
        for table in whole["$defs"].values():
            for key, value in table.get("properties", {}).items():
                value["unit"] = unit_of(key)
        return json({
            "scene": _plain(documents.start), "default": _plain(Scenario()), "schema": whole,
            "scenes": list(map(printable, documents.names())),
            "layouts": ["none", *layouts.names()], "root": printable(documents.root),
        })  # fmt: skip

    def open(self, request: Request) -> Response:
        """Give another scene, by its name."""
        return json(_plain(self._documents.open(request.query_params.get("scene", ""))))

    async def frame(self, request: Request) -> Response:
        """Render a frame: four bytes with the length of a JSON text, big-endian, that text, and a picture file."""
        asked, scenario = await self._asked(request)
        wish = Wish(scenario, asked.frame, asked.small)
        about, content = await asyncio.wrap_future(self._rendering.picture(asked.side, wish))
        text = msgspec.json.encode(about)
        return Response(struct.pack(">I", len(text)) + text + content, media_type="application/octet-stream")

    async def measure(self, request: Request) -> Response:
        """Give what the instrument makes of a frame."""
        asked, scenario = await self._asked(request)
        if not 0 <= asked.frame < scenario.frames:
            raise HTTPException(404)
        found = await run_in_threadpool(
            self._measuring.measure, scenario, asked.frame,
            lambda number: self._rendering.stored(asked.side, Wish(scenario, number)),
        )  # fmt: skip
        return json(found)

    async def toml(self, request: Request) -> Response:
        """Give the scene as a file."""
        _, scenario = await self._asked(request)
        return Response(self._documents.toml(scenario), media_type="text/plain; charset=utf-8")

    async def command(self, request: Request) -> Response:
        """Give the command that renders the same; null where there is none."""
        _, scenario = await self._asked(request)
        return json({"command": await run_in_threadpool(command, self._documents.origin, scenario)})

    async def save(self, request: Request) -> Response:
        """Save the scene below the folder."""
        asked, scenario = await self._asked(request)
        try:
            path = await run_in_threadpool(self._documents.save, scenario, asked.path, replace=asked.replace)
        except ExistsError as problem:
            return json({"error": str(problem), "exists": True}, 409)
        return json({"path": printable(path)})

    async def _asked(self, request: Request) -> tuple[Asked, Scenario]:
        """Read a request, and the scene in it."""
        try:
            asked = msgspec.json.decode(await request.body(), type=Asked)
        except (msgspec.MsgspecError, RecursionError) as problem:
            raise ScenarioError("", f"the request cannot be read: {printable(problem)}") from None
        return asked, await run_in_threadpool(self._scenario, bytes(asked.scene))

    def _parsed(self, text: bytes) -> Scenario:
        return self._documents.parse(parse_json(text, lambda line: ScenarioError("", line), "the scene"))


_KEPT = 4  # scenes: two of each side


def _plain(scenario: Scenario) -> dict[str, Any]:
    """Give a scene's plain data, those included that a file leaves out by default."""
    return dict(msgspec.to_builtins(scenario))
