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
from typing import TYPE_CHECKING
from urllib.parse import parse_qs

from simgrab.pages.server.assets import ENTER

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

HOST = "127.0.0.1"
MOST_BODY_BYTES = 2 * 2**20
"""Of a request: a bit for each of 10 million rows, as base64, takes 1.6 MiB."""

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
    """An ASGI application that answers for another one, and lets through what may pass.

    Parameters
    ----------
    app : ASGI application
    port : int
        On which it is served.
    token : str
    """

    def __init__(self, app: ASGIApp, port: int, token: str) -> None:
        self._app, self._token = app, token.encode()
        self._hosts = {f"{name}:{port}".encode() for name in (HOST, "localhost")}
        self._cookie = f"simgrab-{port}".encode()  # a cookie is sent to every port of a host

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        if scope["type"] != "http":  # neither a WebSocket nor what starts and ends a server
            return
        try:
            if await self._enters(scope, send):
                return
            self._check(scope)
            body = await _body(scope, receive)
        except RefusedError as refusal:
            await _answer(send, refusal.status, f"simgrab: {refusal.line}\n".encode(), "text/plain; charset=utf-8")
            return
        await self._app(scope, _given(body, receive), _headed(send))

    async def _enters(self, scope: Scope, send: Send) -> bool:
        """Answer the address that holds the token: with the cookie, and a page that goes on without the token.

        The page goes on by itself, as a redirection would not: where another page led to it, a browser would not send
        the cookie with the redirected request.
        """
        given = parse_qs(scope["query_string"]).get(b"token", [])
        if scope["path"] != "/" or scope["method"] != "GET" or not given:
            return False
        self._check_host(scope)
        if not hmac.compare_digest(given[0], self._token):
            raise RefusedError(HTTPStatus.FORBIDDEN, "the address holds another token than the command printed")
        cookie = b"%s=%s; Path=/; HttpOnly; SameSite=Strict" % (self._cookie, self._token)
        await _answer(send, HTTPStatus.OK, ENTER, "text/html; charset=utf-8", [(b"set-cookie", cookie)])
        return True

    def _check(self, scope: Scope) -> None:
        self._check_host(scope)
        method = scope["method"]
        if method not in (*_READING, *_WRITING):
            raise RefusedError(HTTPStatus.METHOD_NOT_ALLOWED, f"{method} is not used here")
        if not self._has_token(scope):
            raise RefusedError(HTTPStatus.FORBIDDEN, "open the address that the command printed: it holds a token")
        if any(site not in (b"same-origin", b"none") for site in _values(scope, b"sec-fetch-site")):
            raise RefusedError(HTTPStatus.FORBIDDEN, "another page asked")
        host = _values(scope, b"host")[0]
        if method in _WRITING and _values(scope, b"origin") != [b"http://" + host]:
            raise RefusedError(HTTPStatus.FORBIDDEN, "only this page may change something: the Origin is another one")

    def _check_host(self, scope: Scope) -> None:
        hosts = _values(scope, b"host")
        if len(hosts) != 1 or hosts[0] not in self._hosts:
            raise RefusedError(HTTPStatus.MISDIRECTED_REQUEST, "the request is for another host")

    def _has_token(self, scope: Scope) -> bool:
        given = [value.removeprefix(b"Bearer ") for value in _values(scope, b"authorization")]
        for value in _values(scope, b"cookie"):
            pairs = (part.strip().partition(b"=") for part in value.split(b";"))
            given += [content for name, _, content in pairs if name == self._cookie]
        return any(hmac.compare_digest(one, self._token) for one in given)


def _values(scope: Scope, name: bytes) -> list[bytes]:
    return [value for key, value in scope["headers"] if key.lower() == name]


async def _body(scope: Scope, receive: Receive) -> bytes:
    """Read the body, of `MOST_BODY_BYTES` at most."""
    refusal = RefusedError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a request has at most {MOST_BODY_BYTES} bytes")
    stated = _values(scope, b"content-length")
    if any(not value.isdigit() or int(value) > MOST_BODY_BYTES for value in stated):
        raise refusal
    parts, size, more = list[bytes](), 0, True
    while more:
        message = await receive()
        part = message.get("body", b"")
        parts.append(part)
        size += len(part)
        more = message.get("more_body", False)
        if size > MOST_BODY_BYTES:
            raise refusal
    return b"".join(parts)


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
            headers = [(key, value) for key, value in message.get("headers", []) if key.decode() not in _HEADERS]
            headers += [(key.encode(), value.encode()) for key, value in _HEADERS.items()]
            if all(key != b"cache-control" for key, _ in headers):
                headers.append((b"cache-control", b"no-store"))
            message = {**message, "headers": headers}
        await send(message)

    return send_headed


async def _answer(
    send: Send, status: HTTPStatus, body: bytes, kind: str, more: list[tuple[bytes, bytes]] | None = None
) -> None:
    headers = [(b"content-type", kind.encode()), (b"content-length", b"%d" % len(body)), (b"connection", b"close")]
    sent = _headed(send)
    await sent({"type": "http.response.start", "status": status.value, "headers": headers + (more or [])})
    await sent({"type": "http.response.body", "body": body})
