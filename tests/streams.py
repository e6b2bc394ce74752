"""Servers of streams on this machine, each for one test."""

import base64
import http.server
import re
import socket
import struct
import threading
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import av


class _Plain(http.server.SimpleHTTPRequestHandler):
    """Serves whole files, as Python's own server does."""

    def log_message(self, *_):
        pass


class _Ranged(_Plain):
    """Serves parts of files as well."""

    def do_GET(self):
        try:
            data = Path(self.translate_path(self.path)).read_bytes()
        except OSError:
            return self.send_error(404)
        asked = re.match(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
        first, last = (int(asked[1]), int(asked[2] or len(data) - 1)) if asked else (0, len(data) - 1)
        self.send_response(206 if asked else 200)
        self.send_header("Accept-Ranges", "bytes")
        if asked:
            self.send_header("Content-Range", f"bytes {first}-{last}/{len(data)}")
        self.send_header("Content-Length", str(last + 1 - first))
        self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(data[first : last + 1])


@contextmanager
def over_http(folder, *, ranges=True):
    """URL of a server of a folder's files."""
    handler = partial(_Ranged if ranges else _Plain, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        server.handle_error = lambda *_: None  # a client may leave when it likes
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()


@contextmanager
def over_rtsp(path):
    """URL of a camera that sends a video of small pictures once, interleaved with its answers (RFC 2326, 10.12)."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"rtsp://127.0.0.1:{server.getsockname()[1]}/1"
        threading.Thread(target=_camera, args=(server, path, url), daemon=True).start()
        yield url


def _camera(server, path, url):
    """Answer one client; each part of a picture is a packet of its own (RFC 6184, 5.6)."""
    pictures, sets = _coded(path)
    fields = ",".join(base64.b64encode(part).decode() for part in sets)
    description = "\r\n".join([
        "v=0", "o=- 0 0 IN IP4 127.0.0.1", "s=-", "t=0 0", "m=video 0 RTP/AVP 96", "a=rtpmap:96 H264/90000",
        f"a=fmtp:96 packetization-mode=1;sprop-parameter-sets={fields}", "a=control:1", "",
    ])  # fmt: skip
    connection, _ = server.accept()
    with connection, connection.makefile("rb") as asked:
        while line := asked.readline().decode():
            headers = dict(h.split(": ", 1) for h in iter(lambda: asked.readline().decode().strip(), ""))
            verb, answer = line.split()[0], {"CSeq": headers["CSeq"], "Session": "1"}
            body = ""
            if verb == "DESCRIBE":
                answer |= {"Content-Type": "application/sdp", "Content-Base": url, "Content-Length": len(description)}
                body = description
            status = "200 OK"
            if verb == "SETUP" and "TCP" not in headers["Transport"]:
                status = "461 Unsupported Transport"
            elif verb == "SETUP":
                answer["Transport"] = "RTP/AVP/TCP;unicast;interleaved=0-1"
            text = "\r\n".join([f"RTSP/1.0 {status}", *(f"{k}: {v}" for k, v in answer.items()), "", body])
            connection.sendall(text.encode())
            if verb == "PLAY":
                number = 0
                for i, parts in enumerate(pictures):
                    for k, part in enumerate(parts):
                        last = k == len(parts) - 1
                        head = struct.pack(">BBHII", 0x80, 96 | last << 7, number, i * 10_000, 1)
                        connection.sendall(struct.pack(">cBH", b"$", 0, 12 + len(part)) + head + part)
                        number += 1
                return


def _coded(path):
    """Parts of each picture of an MP4, and its parameter sets."""
    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        config, at, sets = stream.codec_context.extradata, 6, []
        for _ in range(2):  # ISO/IEC 14496-15, 5.3.3.1: one sequence and one picture parameter set
            (length,) = struct.unpack_from(">H", config, at)
            sets.append(config[at + 2 : at + 2 + length])
            at += 3 + length
        pictures = [_parts(bytes(packet)) for packet in file.demux(stream) if packet.size]
    return pictures, sets


def _parts(data):
    parts = []
    while data:
        (length,) = struct.unpack_from(">I", data)
        parts.append(data[4 : 4 + length])
        data = data[4 + length :]
    return parts


@contextmanager
def over_tcp(*contents):
    """Answer one connection after another with bytes, or parts of them, and none after the last; yields the URL."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            for data in contents:
                connection, _ = server.accept()
                with connection:
                    for part in [data] if isinstance(data, bytes) else data:
                        connection.sendall(part)
            server.close()

        threading.Thread(target=serve, daemon=True).start()
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"
