"""What stands between a browser and a page of this machine: every request passes here first, and every answer.

Other pages in the same browser, and other users of the machine, can reach a port of 127.0.0.1. A request is answered
only if it

- names this address as its host, so that a domain that resolves to 127.0.0.1 reads nothing (DNS rebinding),
- holds the token, in the address once, then in a cookie, or in a header ``Authorization: Bearer``,
- comes from this page, where it changes something: its ``Origin`` is this address; and where the browser reports who
  asks (``Sec-Fetch-Site``), that is this page or the user,
- has a body within a limit.

Answers forbid the browser to run scripts that stand within a page, to load anything from elsewhere, to show the page
in a frame of another one, and to guess types.
"""

from __future__ import annotations

import hmac
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING

from starlette.datastructures import MutableHeaders
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response

from simgrab.pages.server import HOST

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

MOST_BODY_BYTES = 2 * 2**20
"""Of a request: a bit for each of 10 million rows, as base64, takes 1.6 MiB."""

_ENTER = (Path(__file__).parent / "static/enter.html").read_bytes()
_READING, _WRITING = ("GET", "HEAD"), ("POST",)
_HEADERS = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
    "require-trusted-types-for 'script'; trusted-types 'none'",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
}


class RefusedError(Exception):
    """A request that is not answered: the status, and one line that says why."""

    def __init__(self, status: HTTPStatus, line: str) -> None:
        super().__init__(status, line)
        self.status, self.line = status, line


class Guard:
    """An ASGI application that answers for another one, on its port, and lets through what may pass."""

    def __init__(self, app: ASGIApp, port: int, token: str) -> None:
        self._app, self._token = app, token
        self._hosts = [f"{name}:{port}" for name in (HOST, "localhost")]
        self._cookie = f"simgrab-{port}"  # a cookie is sent to every port of a host

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        if scope["type"] != "http":  # neither a WebSocket nor what starts and ends a server
            return
        request, answer = Request(scope, receive), self._app
        try:
            self._check_host(request)
            if scope["path"] == "/" and scope["method"] == "GET" and (given := request.query_params.getlist("token")):
                answer = self._entered(given[0])
            else:
                self._check(request)
                receive = _given(await _body(request), receive)
        except ClientDisconnect:
            return
        except RefusedError as refusal:
            answer = PlainTextResponse(f"simgrab: {refusal.line}\n", refusal.status, {"connection": "close"})
        await answer(scope, receive, _headed(send))

    def _entered(self, token: str) -> Response:
        """Answer the address that holds the token: with the cookie, and a page that goes on without the token.

        The page goes on by itself, as a redirection would not: where another page led to it, a browser would not send
        the cookie with the redirected request.
        """
        if not self._is_token(token):
            raise RefusedError(HTTPStatus.FORBIDDEN, "the address holds another token than the command printed")
        answer = HTMLResponse(_ENTER, headers={"connection": "close"})
        answer.set_cookie(self._cookie, self._token, httponly=True, samesite="strict")
        return answer

    def _check(self, request: Request) -> None:
        if request.method not in (*_READING, *_WRITING):
            raise RefusedError(HTTPStatus.METHOD_NOT_ALLOWED, f"{request.method} is not used here")
        given = [value.removeprefix("Bearer ") for value in request.headers.getlist("authorization")]
        if not any(map(self._is_token, [*given, request.cookies.get(self._cookie, "")])):
            raise RefusedError(HTTPStatus.FORBIDDEN, "open the address that the command printed: it holds a token")
        if any(site not in ("same-origin", "none") for site in request.headers.getlist("sec-fetch-site")):
            raise RefusedError(HTTPStatus.FORBIDDEN, "another page asked")
        origin = f"http://{request.headers['host']}"
        if request.method in _WRITING and request.headers.getlist("origin") != [origin]:
            raise RefusedError(HTTPStatus.FORBIDDEN, "only this page may change something: the Origin is another one")

    def _check_host(self, request: Request) -> None:
        hosts = request.headers.getlist("host")
        if len(hosts) != 1 or hosts[0] not in self._hosts:
            raise RefusedError(HTTPStatus.MISDIRECTED_REQUEST, "the request is for another host")

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), self._token.encode())


async def _body(request: Request) -> bytes:
    """Read the body, of `MOST_BODY_BYTES` at most."""
    refusal = RefusedError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a request has at most {MOST_BODY_BYTES} bytes")
    stated = request.headers.getlist("content-length")
    if any(not value.isdigit() or int(value) > MOST_BODY_BYTES for value in stated):
        raise refusal
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > MOST_BODY_BYTES:
            raise refusal
    return bytes(body)


def _given(body: bytes, receive: Receive) -> Receive:
    """Give the body that was read, and then whatever follows it: that the browser has gone."""
    left = [body]

    async def receive_body() -> Message:
        if left:
            return {"type": "http.request", "body": left.pop(), "more_body": False}
        return await receive()

    return receive_body


def _headed(send: Send) -> Send:
    """Add the headers that every answer has. An answer that does not allow it is not kept by the browser."""

    async def send_headed(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers.update(_HEADERS)
            headers.setdefault("cache-control", "no-store")
        await send(message)

    return send_headed
