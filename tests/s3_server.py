"""An S3 server on this machine, which can be made to fail as networks and stores do."""

import contextlib
import io
import socket
import threading

import moto.server
import s3fs
from moto.moto_api._internal.models import moto_api_backend
from werkzeug.serving import make_server

BUCKET = "frames"


class Faulty:
    """moto's server behind faults.

    Attributes
    ----------
    errors_every, cut_every, lost_every : int
        Every so many requests that write, the server answers 500, stores half of what was sent, or closes the
        connection when half of it has come; 0 for never.
    dead_after : int or None
        Requests that write, after which each one is answered 500.
    reads_fail : int
        Requests that read, of which so many next ones are answered 503.
    """

    def __init__(self):
        self._app = moto.server.DomainDispatcherApplication(moto.server.create_backend_app)
        self._lock = threading.Lock()
        self.errors_every = self.cut_every = self.lost_every = self.writes = 0
        self.dead_after = None
        self.reads_fail = 0

    def __call__(self, environ, start_response):
        """Answer a request."""
        if environ["REQUEST_METHOD"] in ("PUT", "POST"):
            with self._lock:
                self.writes += 1
                number = self.writes
            length = int(environ.get("CONTENT_LENGTH") or 0)
            if self.lost_every and number % self.lost_every == 0:
                environ["wsgi.input"].read(length // 2)
                environ["werkzeug.socket"].shutdown(socket.SHUT_RDWR)
                raise ConnectionAbortedError
            if (self.dead_after is not None and number > self.dead_after) or (
                self.errors_every and number % self.errors_every == 0
            ):
                environ["wsgi.input"].read(length)
                start_response("500 Internal Server Error", [("Content-Type", "text/xml")])
                return [b"<Error><Code>InternalError</Code><Message>injected</Message></Error>"]
            if self.cut_every and number % self.cut_every == 0 and length > 1:
                half = environ["wsgi.input"].read(length)[: length // 2]
                for key in [key for key in environ if key.startswith("HTTP_X_AMZ_") and "SHA" not in key]:
                    del environ[key]  # checksums, which would tell
                environ.pop("HTTP_CONTENT_MD5", None)
                environ |= {"wsgi.input": io.BytesIO(half), "CONTENT_LENGTH": str(len(half))}
        elif self.reads_fail:
            self.reads_fail -= 1
            start_response("503 Service Unavailable", [("Content-Type", "text/xml")])
            return [b""]
        return self._app(environ, start_response)


@contextlib.contextmanager
def s3(monkeypatch):
    """Start a server with an empty bucket; gives its faults. The environment leads to it, also that of processes."""
    app = Faulty()
    server = make_server("127.0.0.1", 0, app, threaded=True)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    settings = {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{server.server_port}",
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_MAX_ATTEMPTS": "1",  # simgrab's own are tested, and those of s3fs
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_REQUEST_CHECKSUM_CALCULATION": "when_required",
    }
    for name, value in settings.items():
        monkeypatch.setenv(name, value)
    for name in ("HTTP_PROXY", "http_proxy", "ALL_PROXY", "all_proxy"):
        monkeypatch.delenv(name, raising=False)
    try:
        s3fs.S3FileSystem.clear_instance_cache()
        moto_api_backend.reset()
        s3fs.S3FileSystem().mkdir(BUCKET)
        yield app
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
        s3fs.S3FileSystem.clear_instance_cache()


def contents(prefix):
    """Objects below a prefix of the bucket, by name."""
    system = s3fs.S3FileSystem(use_listings_cache=False)
    base = f"{BUCKET}/{prefix}"
    return {path.removeprefix(f"{base}/"): system.cat_file(path) for path in system.find(base)}


def folder_contents(folder):
    """Files of a folder, by name."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
