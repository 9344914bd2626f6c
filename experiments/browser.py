"""Chromium without a window, driven through a pipe by the DevTools protocol; nothing has to be installed for it."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from ear_jax.files.replacing import replace_file

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
OPTIONS = (  # split where they are used
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --remote-debugging-pipe"
)
# Chromium reads from descriptor 3 and writes to 4.
START = """import fcntl, os, sys
pipes = [fcntl.fcntl(int(pipe), fcntl.F_DUPFD, 10) for pipe in sys.argv[1:3]]
for pipe, place in zip(pipes, (3, 4)): os.dup2(pipe, place)
os.execv(sys.argv[3], sys.argv[3:])"""
COMPLAINTS = ("Runtime.exceptionThrown", "Runtime.consoleAPICalled", "Log.entryAdded")


def chromium() -> str | None:
    """Returns the path of Chromium, if it is installed."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """One page in a Chromium of its own, with a fresh profile. A context manager."""

    def __init__(self, width: int = 1280, height: int = 800):
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        ours_in, self._write = os.pipe()
        self._read, theirs_out = os.pipe()
        path, profile = chromium(), f"--user-data-dir={self._profile.name}"
        words = [sys.executable, "-c", START, str(ours_in), str(theirs_out), str(path), *OPTIONS.split(), profile]
        quiet = subprocess.DEVNULL
        self._process = subprocess.Popen(words, pass_fds=(ours_in, theirs_out), stdout=quiet, stderr=quiet)
        os.close(ours_in)
        os.close(theirs_out)
        self._session: str | None = None
        self._number, self._text, self.events = 0, b"", []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")
        self.resize(width, height)

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait()
        os.close(self._write)
        os.close(self._read)
        self._profile.cleanup()

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Calls a method of the protocol and returns its result; `events` receives what is reported meanwhile."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while (answer := self._next()).get("id") != self._number:
            self.events.append(answer)
        assert "error" not in answer, answer["error"]
        return answer["result"]

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._text:
            part = os.read(self._read, 1 << 20)
            assert part, "Chromium has ended"
            self._text += part
        message, self._text = self._text.split(b"\0", 1)
        return json.loads(message)

    def resize(self, width: int, height: int, density: float = 1) -> None:
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=density,
            mobile=width < 500,
        )

    def prefer(self, **features: str) -> None:
        """Sets what the system prefers, as in `color_scheme="dark"`."""
        named = [{"name": f"prefers-{name.replace('_', '-')}", "value": value} for name, value in features.items()]
        self.call("Emulation.setEmulatedMedia", features=named)

    def run(self, script: str) -> Any:
        """Returns the value of an expression, or what its promise holds."""
        result = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def open(self, page: Path, ready: str, seconds: float = 60) -> None:
        """Opens a file and waits until an expression is true."""
        self.call("Page.navigate", url=page.resolve().as_uri())
        self.wait(ready, seconds)

    def wait(self, ready: str, seconds: float = 60) -> None:
        """Waits until an expression is true."""
        end = time.monotonic() + seconds
        while not self.run(f"Boolean({ready})"):
            assert time.monotonic() < end, f"{ready} did not become true; {self.complaints()}"
            time.sleep(0.05)

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """Sends mousePressed, mouseMoved or mouseReleased, with the left button."""
        held = 0 if kind == "mouseReleased" else 1
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=held, clickCount=1, **more)

    def key(self, key: str) -> None:
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, text=key if len(key) == 1 else "")

    def picture(self, path: Path) -> Path:
        with replace_file(path) as scratch:
            scratch.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))
        return path

    def complaints(self) -> list[Any]:
        """Lists errors, warnings and messages on the console."""
        self.run("1")
        return [event["params"] for event in self.events if event["method"] in COMPLAINTS]

    def requests(self) -> list[str]:
        """Lists the addresses asked for that are neither files nor in memory."""
        self.run("1")
        asked = [
            event["params"]["request"]["url"] for event in self.events if event["method"] == "Network.requestWillBeSent"
        ]
        return [address for address in asked if not address.startswith(("file:", "blob:", "data:", "about:"))]
