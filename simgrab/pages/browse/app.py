"""What the page asks for, and what it gets: see `Browser.app`."""

from __future__ import annotations

import base64
import secrets
import threading
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response

from simgrab.errors import SimgrabError
from simgrab.pages.browse import pictures
from simgrab.pages.browse.columns import Column
from simgrab.pages.browse.exporting import FORMATS, Exports
from simgrab.pages.browse.subject import Subject, overlay
from simgrab.pages.outlines import outline
from simgrab.pages.server.application import Endpoint, application, json
from simgrab.text import printable

STATIC = Path(__file__).with_name("static")
MOST_OVERLAYS = 200
"""Of one request."""
MOST_SEARCHED = 200  # characters of a text
_KEPT = {"cache-control": "private, max-age=3600"}  # by the browser: its address names the session
_MOST_DIGITS = 9
_AT_ONCE = 4  # pictures and masks that are decoded: one may be large


class Wanted(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What is to be exported."""

    rows: str  # a bit for each row, the lowest of a byte first, as base64
    out: str  # new folder
    format: str


class Browser:
    """Answers the page's requests about a subject."""

    def __init__(self, subject: Subject) -> None:
        self.subject, self.exports = subject, Exports(subject)
        self._session, self._turn = secrets.token_hex(4), threading.BoundedSemaphore(_AT_ONCE)
        self._masks = threading.Lock()  # so that their file is searched once

    @property
    def app(self) -> Starlette:
        """The ASGI application. Frames and columns are named by numbers."""
        read: dict[str, Endpoint] = {
            "/api/summary": self.summary,
            "/api/columns/{column}": self.column,
            "/api/columns/{column}/matches": self.matches,
            "/api/overlays": self.overlays,
            "/api/frames/{row}": self.frame,
            "/api/frames/{row}/tile": self.tile,
            "/api/frames/{row}/picture": self.picture,
            "/api/export": lambda _: json(self.exports.state),
        }
        return application(STATIC, "index.html", read, {"/api/export": self.export})

    def summary(self, _: Request) -> Response:
        """Give what is browsed, and its columns."""
        s = self.subject
        names = [column.name for column in s.columns]
        return json({
            "name": printable(s.name), "kind": s.kind, "rows": len(s), "notes": [printable(note) for note in s.notes],
            "columns": [column.about() for column in s.columns], "session": self._session,
            "order": s.order, "shown": [name for name in s.shown if name in names],
            "formats": FORMATS if s.dataset is not None else (),
        })  # fmt: skip

    def column(self, request: Request) -> Response:
        """Give a column's numbers or codes."""
        column = self._column(request)
        if column.kind == "list":
            raise HTTPException(404)
        return Response(column.content(), media_type="application/octet-stream")

    def matches(self, request: Request) -> Response:
        """Give a bit for each row: whether its text contains another."""
        column = self._column(request)
        text = request.query_params.get("text", "")
        if column.kind != "text" or len(text) > MOST_SEARCHED:
            raise HTTPException(404)
        bits = np.packbits(column.matches(text), bitorder="little")
        return Response(bits.tobytes(), media_type="application/octet-stream")

    def _column(self, request: Request) -> Column:
        return self.subject.columns[_number(request.path_params["column"], len(self.subject.columns))]

    def _row(self, request: Request) -> int:
        return _number(request.path_params["row"], len(self.subject))

    def overlays(self, request: Request) -> Response:
        """Give what is drawn on some rows' pictures."""
        asked = request.query_params.get("rows", "").split(",")
        if len(asked) > MOST_OVERLAYS:
            raise HTTPException(404)
        masks = request.query_params.get("masks") == "1"
        return json([self._overlay(_number(text, len(self.subject)), masks=masks) for text in asked if text])

    def _overlay(self, row: int, *, masks: bool, width_px: int = pictures.TILE_WIDTH_PX) -> dict[str, Any]:
        return overlay(self.subject, row, self._outline(row, width_px) if masks else None)

    def _outline(self, row: int, width_px: int) -> list[list[float]] | None:
        """Trace a row's mask; None where there is none that fits the picture."""
        try:
            with self._masks:
                known, coded = self.subject.row(row), self.subject.mask(row)
            if known is None or coded is None:
                return None
            with self._turn:
                return outline(coded.decoded(known, f"row {row}"), width_px)
        except SimgrabError:
            return None

    def frame(self, request: Request) -> Response:
        """Give everything that is known of a row, in the order of the columns."""
        row = self._row(request)
        shown = self.subject.values(row).values()
        values = [printable(value) if isinstance(value, str) else value for value in shown]
        return json({"overlay": self._overlay(row, masks=True, width_px=1920), "values": values})

    def tile(self, request: Request) -> Response:
        """Give a row's picture, small."""
        row = self._row(request)
        with self._turn:
            return Response(pictures.tile(self.subject.content(row), f"row {row}"), 200, _KEPT, "image/jpeg")

    def picture(self, request: Request) -> Response:
        """Give a row's picture."""
        row = self._row(request)
        data, kind = pictures.shown(self.subject.content(row), f"row {row}")
        return Response(data, media_type=kind, headers=_KEPT)

    async def export(self, request: Request) -> Response:
        """Begin to export a selection."""
        try:
            wanted = msgspec.json.decode(await request.body(), type=Wanted)
            rows = _selected(wanted.rows, len(self.subject))
        except (msgspec.MsgspecError, ValueError) as problem:  # binascii's is a ValueError
            return json({"error": f"the request cannot be read: {printable(problem)}"}, 400)
        return json(self.exports.start(rows, wanted.out, wanted.format))


def _number(text: str, count: int) -> int:
    """Read the number of a row or column, of which there are so many."""
    if not (text.isascii() and text.isdigit() and len(text) <= _MOST_DIGITS and int(text) < count):
        raise HTTPException(404)
    return int(text)


def _selected(text: str, count: int) -> NDArray[np.int64]:
    """Read the rows whose bits are set."""
    data = base64.b64decode(text, validate=True)
    if len(data) != (count + 7) // 8:
        raise ValueError(f"{len(data)} bytes for {count} rows")
    return np.flatnonzero(np.unpackbits(np.frombuffer(data, np.uint8), count=count, bitorder="little")).astype(np.int64)
