"""Who may ask a page that is served on this machine, and what the browser is told of its answers."""

import importlib.util
import re
import socket
import stat
import urllib.parse
import webbrowser
from pathlib import Path

import pytest
from http_requests import ask

from simgrab.errors import ServerError
from simgrab.pages.server import guard, local


class Counting:
    """An application that answers every request, and counts those that reach it."""

    def __init__(self):
        self.reached = []

    async def __call__(self, scope, receive, send):
        body, more = b"", True
        while more:
            message = await receive()
            body += message.get("body", b"")
            more = message.get("more_body", False)
        self.reached.append((scope["method"], scope["path"], len(body)))
        headers = [(b"content-type", b"text/plain"), (b"content-security-policy", b"default-src *")]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        await send({"type": "http.response.body", "body": b"reached"})


@pytest.fixture(scope="module")
def served():
    app = Counting()
    with local.serving(app) as address:
        yield app, address


@pytest.fixture
def reached(served):
    served[0].reached.clear()
    return served[0].reached


@pytest.fixture
def address(served):
    return served[1]


def test_a_request_with_the_token_is_answered(address, reached):
    assert ask(address, "/api/x").body == b"reached"
    cookie = f"a=b; simgrab-{address.port}={address.token}"
    assert ask(address, "/api/x", token=None, headers={"Cookie": cookie}).status == 200
    assert ask(address, "/api/x", "POST", body=b"{}").status == 200
    assert reached == [("GET", "/api/x", 0), ("GET", "/api/x", 0), ("POST", "/api/x", 2)]


@pytest.mark.parametrize("token", [None, "", "wrong", "ä"])
@pytest.mark.parametrize("path", ["/", "/static/base.css", "/api/summary", "/?token=wrong", "/?token=", "/x?token={}"])
def test_nothing_is_answered_without_the_token(address, reached, token, path):
    path = path.format(address.token)
    answer = ask(address, path, token=token)
    assert answer.status == 403
    assert address.token.encode() not in answer.body
    cookie = f"simgrab-{address.port}={token}; simgrab-1={address.token}"  # that of another port counts for nothing
    assert ask(address, path, token=None, headers={"Cookie": cookie.encode()}).status == 403
    assert reached == []


def test_the_address_with_the_token_gives_a_cookie_that_only_this_page_sends(address, reached):
    answer = ask(address, f"/?token={address.token}", token=None)
    assert answer.status == 200
    cookie, *rules = answer.headers["set-cookie"].split("; ")
    assert cookie == f"simgrab-{address.port}={address.token}"
    assert sorted(map(str.lower, rules)) == ["httponly", "path=/", "samesite=strict"]
    assert address.token.encode() not in answer.body
    assert ask(address, "/", token=None, headers={"Cookie": cookie}).status == 200
    assert reached == [("GET", "/", 0)]


def test_tokens_are_long_and_differ():
    with local.serving(Counting()) as one, local.serving(Counting()) as other:
        assert one.token != other.token
        assert len(one.token) >= 43  # 32 bytes


@pytest.mark.parametrize(
    "host", [None, "", "evil.example", "127.0.0.1", "evil.example:{}", "localhost.evil:{}", "[::1]:{}"]
)
def test_a_request_for_another_host_is_refused(address, reached, host):
    headers = {"Host": None if host is None else host.format(address.port)}
    for path in ("/", f"/?token={address.token}"):
        answer = ask(address, path, headers=headers)
        assert answer.status in (400, 421)
        assert "set-cookie" not in answer.headers
    assert reached == []


def test_this_host_has_two_names(address):
    for name in ("localhost", "127.0.0.1"):
        origin = f"{name}:{address.port}"
        assert ask(address, "/", "POST", headers={"Host": origin, "Origin": f"http://{origin}"}, body=b"").status == 200


@pytest.mark.parametrize("origin", [None, "null", "", "http://evil.example", "http://127.0.0.1", "https://127.0.0.1:{}",
                                    "http://127.0.0.1:{}.evil", "http://localhost:{}"])  # fmt: skip
def test_only_this_page_changes_something(address, reached, origin):
    headers = {"Origin": None if origin is None else origin.format(address.port)}
    assert ask(address, "/api/export", "POST", headers=headers, body=b"{}").status == 403
    assert reached == []


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_what_another_page_asks_for_is_refused(address, reached, site):
    assert ask(address, "/api/frames/0/tile", headers={"Sec-Fetch-Site": site}).status == 403
    assert reached == []
    for site in ("same-origin", "none"):
        assert ask(address, "/api/frames/0/tile", headers={"Sec-Fetch-Site": site}).status == 200


@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH", "OPTIONS", "TRACE"])
def test_other_methods_are_refused(address, reached, method):
    assert ask(address, "/", method).status == 405
    assert reached == []


def test_a_body_is_limited(address, reached):
    most = guard.MOST_BODY_BYTES
    assert ask(address, "/x", "POST", body=b"a" * most).status == 200
    assert reached == [("POST", "/x", most)]
    assert ask(address, "/x", "POST", body=b"a" * (most + 1)).status == 413
    assert ask(address, "/x", "POST", headers={"Content-Length": str(10**15)}).status == 413
    assert ask(address, "/x", "POST", chunks=[b"a" * 2**18] * 9).status == 413
    assert ask(address, "/x", headers={"Content-Length": str(10**15)}).status == 413
    assert len(reached) == 1


def test_every_answer_forbids_what_the_page_does_not_need(address):
    answers = [ask(address, "/"), ask(address, "/", token=None), ask(address, "/", headers={"Host": "a"}),
               ask(address, f"/?token={address.token}", token=None)]  # fmt: skip
    for answer in answers:
        policy = dict(part.strip().split(" ", 1) for part in answer.headers["content-security-policy"].split(";"))
        assert policy["default-src"] == "'none'"
        assert policy["script-src"] == "'self'"  # so neither inline nor evaluated
        assert policy["frame-ancestors"] == "'none'"
        assert policy["require-trusted-types-for"] == "'script'"
        assert not {"unsafe", "http", "*", "data:"} & set(" ".join(policy.values()).replace("-", " ").split())
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["cross-origin-resource-policy"] == "same-origin"
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert answer.headers["cache-control"] == "no-store"
        assert len(answer.pairs) == len(answer.headers)  # each once: the application's own are dropped


def test_it_listens_on_one_address_of_this_machine(address):
    socket.create_connection(("127.0.0.1", address.port), timeout=5).close()
    with pytest.raises(OSError, match="refused"):  # which 0.0.0.0 would take too
        socket.create_connection(("127.0.0.2", address.port), timeout=5)


def test_a_websocket_is_not_opened(address):
    headers = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
               "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA=="}  # fmt: skip
    assert ask(address, "/", headers=headers).status != 101


def test_a_port_that_is_taken_is_named(address):
    with (
        pytest.raises(ServerError, match=f"port {address.port} .*choose another --port"),
        local.serving(Counting(), address.port),
    ):
        pass


def test_a_missing_extra_is_named(monkeypatch):
    local.check_installed()
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "uvicorn" else found(name))
    with pytest.raises(ServerError, match=r"pip install 'simgrab\[studio\]'"):
        local.check_installed()


def test_the_token_is_in_no_command_line(monkeypatch):
    """A browser is started with a file that only this user can read."""
    started = []

    def note(url):
        path = Path(urllib.parse.urlsplit(url).path)
        started.append((url, path.read_text(encoding="utf-8"), stat.S_IMODE(path.parent.stat().st_mode)))

    monkeypatch.setattr(webbrowser, "open", note)
    monkeypatch.setenv("DISPLAY", ":9")
    address = local.Address(1234, "secret")
    with local.opened(address):
        ((url, text, mode),) = started
        assert "secret" not in url
        assert address.url in text
        assert mode == 0o700
    assert not Path(urllib.parse.urlsplit(url).path).exists()
    with local.opened(address, wanted=False):
        assert len(started) == 1


def test_files_of_pages_hold_no_script_of_their_own_and_load_nothing_from_elsewhere():
    for path in Path(guard.__file__).parents[1].glob("*/static/*.*"):
        name, text = path.name, path.read_text(encoding="utf-8")
        forbidden = r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|eval\(|Function\(|style=|https://"
        assert not re.search(forbidden, text), name
        addresses = {word for word in text.replace('"', " ").split() if "http:" in word}
        assert addresses <= {"http://www.w3.org/2000/svg"}, name
        if name.endswith(".html"):
            assert text.count("<script") == text.count('<script src="/static/')
            assert not re.search(r"\son\w+=", text)
