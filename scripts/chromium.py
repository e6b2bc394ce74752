"""A headless Chromium, driven through a pipe in its DevTools protocol: to take pictures of pages and to time them."""

from __future__ import annotations

import base64
import contextlib
import fcntl
import json
import os
import select
import shutil
import signal
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

COMMAND = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
_LOW = 10  # file descriptors from here on are free of the child's own
_SECONDS = 60.0


class Page:
    """A page of a browser, which is written to and read from by file descriptors."""

    def __init__(self, sends: int, receives: int) -> None:
        self._sends, self._receives, self._left, self._count = sends, receives, b"", 0
        self._session: str | None = None
        self.console: list[str] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol, and give its result."""
        self._count += 1
        session = {} if self._session is None else {"sessionId": self._session}
        message = {"id": self._count, "method": method, "params": parameters} | session
        os.write(self._sends, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._count:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                result: dict[str, Any] = answer["result"]
                return result
            self._note(answer)

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._left:
            if not select.select([self._receives], [], [], _SECONDS)[0]:
                raise TimeoutError("Chromium does not answer")
            data = os.read(self._receives, 2**20)
            if not data:
                raise RuntimeError("Chromium has ended")
            self._left += data
        text, _, self._left = self._left.partition(b"\0")
        found: dict[str, Any] = json.loads(text)
        return found

    def _note(self, event: dict[str, Any]) -> None:
        """Keep what a page complains of."""
        given = event.get("params", {})
        if event.get("method") == "Log.entryAdded":
            self.console.append(given["entry"]["text"])
        elif event.get("method") == "Runtime.exceptionThrown":
            self.console.append(json.dumps(given["exceptionDetails"].get("exception", {}).get("description", "")))
        elif event.get("method") == "Runtime.consoleAPICalled" and given["type"] in ("error", "warning"):
            self.console.append(json.dumps(given["args"]))

    def look(self, width: int, height: int, *, dark: bool = False) -> None:
        """Set the size of the window, px, and whether the user likes it dark."""
        mobile = width < 500
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=mobile)
        value = "dark" if dark else "light"
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": value}])

    def open(self, url: str) -> None:
        """Go to an address."""
        self.call("Page.navigate", url=url)

    def evaluate(self, script: str) -> Any:
        """Evaluate an expression in the page, wait for a promise, and give its value."""
        found = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in found:
            raise RuntimeError(found["exceptionDetails"].get("exception", {}).get("description", script))
        return found["result"].get("value")

    def wait(self, script: str, seconds: float = _SECONDS) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            with contextlib.suppress(RuntimeError):  # the page is being replaced
                if self.evaluate(f"Boolean({script})"):
                    return
            time.sleep(0.02)
        raise TimeoutError(f"never true: {script}; {self.console}")

    def photograph(self, path: Path, *, quality: int = 85) -> None:
        """Save what the window shows, as PNG or JPEG by the name."""
        kind: dict[str, Any] = {"format": "png"} if path.suffix == ".png" else {"format": "jpeg", "quality": quality}
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", **kind)["data"]))


@contextlib.contextmanager
def page() -> Iterator[Page]:
    """Start Chromium with an empty profile and give a page of it."""
    if COMMAND is None:
        raise RuntimeError("there is no Chromium: apt-get install chromium")
    reads, sends = (fcntl.fcntl(end, fcntl.F_DUPFD, _LOW) for end in os.pipe())
    receives, writes = (fcntl.fcntl(end, fcntl.F_DUPFD, _LOW) for end in os.pipe())
    with tempfile.TemporaryDirectory(prefix="simgrab-chromium-", ignore_cleanup_errors=True) as profile:
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe", "--hide-scrollbars"]
        browser = os.posix_spawn(
            COMMAND, [COMMAND, *options, f"--user-data-dir={profile}"], os.environ,
            file_actions=[
                (os.POSIX_SPAWN_DUP2, reads, 3), (os.POSIX_SPAWN_DUP2, writes, 4),
                *((os.POSIX_SPAWN_OPEN, number, os.devnull, os.O_WRONLY, 0) for number in (1, 2)),
            ],
        )  # fmt: skip
        os.close(reads)
        os.close(writes)
        try:
            yield Page(sends, receives)
        finally:
            os.kill(browser, signal.SIGTERM)
            os.waitpid(browser, 0)
            os.close(sends)
            os.close(receives)
