"""Requests with whatever headers, as no browser would send them."""

import http.client
import json
from dataclasses import dataclass


@dataclass
class Answer:
    status: int
    headers: dict
    body: bytes
    pairs: list  # headers as they came

    @property
    def json(self):
        return json.loads(self.body)


def ask(address, path, method="GET", *, token=True, headers=None, body=None, chunks=None):
    """Ask a served page; ``token``: True sends the right one as a header, a text another one, None none."""
    connection = http.client.HTTPConnection("127.0.0.1", address.port, timeout=20)
    connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
    given = {"Host": f"127.0.0.1:{address.port}"}
    if token is not None:
        given["Authorization"] = f"Bearer {address.token if token is True else token}"
    if method == "POST":
        given["Origin"] = address.origin
    if body is not None:
        given["Content-Length"] = str(len(body))
    if chunks is not None:
        given["Transfer-Encoding"] = "chunked"
    for name, value in (given | (headers or {})).items():
        if value is not None:
            connection.putheader(name, value)
    try:
        connection.endheaders()
        for part in chunks or ([] if body is None else [body]):
            connection.send(b"%x\r\n%b\r\n" % (len(part), part) if chunks is not None else part)
        if chunks is not None:
            connection.send(b"0\r\n\r\n")
    except (BrokenPipeError, ConnectionResetError):
        pass  # it answered before it had read everything
    try:
        answer = connection.getresponse()
        try:
            content = answer.read()
        except (http.client.IncompleteRead, ConnectionResetError):  # what was not read of the request resets it
            content = b""
        return Answer(answer.status, {k.lower(): v for k, v in answer.getheaders()}, content, answer.getheaders())
    finally:
        connection.close()
