"""A real Chromium without a window, driven by its DevTools protocol; without a GPU it draws in software."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import shutil
import signal
import subprocess
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from urllib.request import urlopen

from websockets.sync.client import connect

from cell.clock import perf_s
from tests.wire_helpers import pause

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_FLAGS = (
    "--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--disable-dev-shm-usage", "--hide-scrollbars", "--remote-debugging-port=0",
)  # fmt: skip
_START = 60.0


def find() -> str:
    """Path of a browser, empty without one."""
    return next((path for name in NAMES if (path := shutil.which(name))), "")


class Browser:
    """One page in one browser, as a context manager.

    Args:
        size: width and height [px]. sharpness: device pixels per pixel; few are quickly drawn.
        nice: how far it stands back.
    """

    def __init__(
        self, url: str, size: tuple[int, int] = (1100, 700), *, sharpness: float = 1.0, nice: int = 5
    ) -> None:
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        flags = [*_FLAGS, f"--window-size={size[0]},{size[1]}", f"--user-data-dir={self._folder.name}"]
        self._process = subprocess.Popen(
            ["nice", "-n", str(nice), find(), *flags, "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        self._number = 0
        try:
            self._socket = connect(self._address(), max_size=None, open_timeout=_START)
            self.call(
                "Emulation.setDeviceMetricsOverride",
                width=size[0], height=size[1], deviceScaleFactor=sharpness, mobile=False,
            )  # fmt: skip
            self.call("Page.navigate", url=url)
        except BaseException:
            self.close()
            raise

    def call(self, method: str, **parameters: Any) -> Any:
        """One command of the protocol."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=_START))
            if answer.get("id") == self._number:
                assert "error" not in answer, answer
                return answer["result"]

    def run(self, script: str) -> Any:
        """Value of a JavaScript expression in the page."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def buttons(self) -> dict[str, bool]:
        """Text of every visible button, and whether it can be clicked."""
        found: dict[str, bool] = self.run(
            "Object.fromEntries([...document.querySelectorAll('button')].filter(b => b.offsetParent)"
            ".map(b => [b.textContent.trim(), !b.disabled]))"
        )
        return found

    def click(self, text: str) -> None:
        """Click the button with this text."""
        clicked = self.run(
            "(() => { const b = [...document.querySelectorAll('button')]"
            f".find(b => b.textContent.trim() === {json.dumps(text)} && !b.disabled);"
            " if (b) b.click(); return !!b; })()"
        )
        assert clicked, f"no button {text!r} in {self.buttons()}"

    def text(self) -> str:
        """All that can be read."""
        return str(self.run('document.body?.innerText ?? ""'))

    def wait(self, script: str, seconds: float = _START) -> None:
        """Until a JavaScript expression is true."""
        end = perf_s() + seconds
        while not self.run(script):
            assert perf_s() < end, f"waited in vain for {script}; the page says: {self.text()[:2000]}"
            pause(0.1)

    def wait_for_button(self, text: str, seconds: float = _START) -> None:
        """Until there is a button with this text that can be clicked."""
        self.wait(
            "[...document.querySelectorAll('button')].some(b => !b.disabled && b.offsetParent &&"
            f" b.textContent.trim() === {json.dumps(text)})",
            seconds,
        )

    def wait_for_text(self, text: str, seconds: float = _START) -> None:
        self.wait(f"(document.body?.innerText ?? '').includes({json.dumps(text)})", seconds)

    def picture(self, path: Path) -> None:
        """Write what is seen as PNG."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))

    def freeze(self) -> None:
        """Stop every process of this browser where it is."""
        os.killpg(self._process.pid, signal.SIGSTOP)

    def close(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._folder.cleanup()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _address(self) -> str:
        """Of the page's end of the protocol."""
        told, end = Path(self._folder.name) / "DevToolsActivePort", perf_s() + _START
        while not (told.is_file() and "\n" in told.read_text()):
            assert self._process.poll() is None and perf_s() < end, "the browser does not start"
            pause(0.05)
        port = told.read_text().split("\n")[0]
        while True:
            with urlopen(f"http://127.0.0.1:{port}/json/list", timeout=_START) as answer:
                pages = [p for p in json.load(answer) if p["type"] == "page"]
            if pages:
                return str(pages[0]["webSocketDebuggerUrl"])
            assert perf_s() < end, "the browser opens no page"
            pause(0.05)
