"""A headless Chromium that tests drive through its debugging pipe: no port, no driver, no package."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu-sandbox", "--use-angle=swiftshader"),
    *("--enable-unsafe-swiftshader", "--hide-scrollbars", "--no-first-run", "--disable-extensions", "--mute-audio"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-default-browser-check"),
    *("--remote-debugging-pipe", "--disable-dev-shm-usage", "--force-color-profile=srgb"),
)


def find_browser() -> str | None:
    """The path of a Chromium, or None."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Page:
    """A tab. Failures in the page are kept in `errors`, what it logs in `logged`, addresses it asked for in `asked`."""

    def __init__(self, send: int, receive: int, process: subprocess.Popen):
        self._send, self._receive, self._process = send, receive, process
        self._number, self._buffer = 0, b""
        self.errors: list[str] = []
        self.logged: list[str] = []
        self.asked: list[str] = []
        target = self._call("Target.createTarget", url="about:blank")["targetId"]
        self._session = None
        self._session = self._call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self._call(f"{domain}.enable")

    def size(self, width: int, height: int, mobile: bool = False) -> None:
        """Make the tab so many CSS pixels large, a device pixel each."""
        self._call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=mobile)

    def open(self, address: str | Path) -> None:
        """Go to an address, or to a file."""
        if isinstance(address, Path):
            address = address.resolve().as_uri()
        answer = self._call("Page.navigate", url=address)
        if "errorText" in answer:
            raise AssertionError(f"{address}: {answer['errorText']}")

    def evaluate(self, expression: str, seconds: float = 60) -> Any:
        """The value of a JavaScript expression, awaited; AssertionError with what it threw."""
        answer = self._call(
            "Runtime.evaluate", seconds, expression=expression, awaitPromise=True, returnByValue=True, userGesture=True
        )
        if "exceptionDetails" in answer:
            details = answer["exceptionDetails"]
            raise AssertionError(details.get("exception", {}).get("description", details["text"]))
        return answer["result"].get("value")

    def wait(self, expression: str, seconds: float = 60) -> Any:
        """The value of an expression once it is true."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            with contextlib.suppress(AssertionError):
                if value := self.evaluate(expression):
                    return value
            time.sleep(0.1)
        raise AssertionError(f"{expression} was not true within {seconds} s; errors: {self.errors}; {self.logged[-5:]}")

    def screenshot(self, path: Path) -> Path:
        """A picture of the tab as PNG."""
        path.write_bytes(base64.b64decode(self._call("Page.captureScreenshot", format="png")["data"]))
        return path

    def input(self, method: str, **parameters: Any) -> None:
        """An event as the user makes it: `dispatchMouseEvent`, `dispatchKeyEvent`, `dispatchTouchEvent`."""
        self._call(f"Input.{method}", **parameters)

    def command(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Any command of the DevTools protocol."""
        return self._call(method, **parameters)

    def _call(self, method: str, seconds: float = 60, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if getattr(self, "_session", None):
            message["sessionId"] = self._session
        os.write(self._send, json.dumps(message).encode() + b"\0")
        end = time.monotonic() + seconds
        while True:
            answer = self._read(end, method)
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise AssertionError(f"{method}: {answer['error']['message']}")
                return answer["result"]
            self._notice(answer)

    def _notice(self, event: dict[str, Any]) -> None:
        method, values = event.get("method"), event.get("params", {})
        if method == "Runtime.exceptionThrown":
            details = values["exceptionDetails"]
            self.errors.append(details.get("exception", {}).get("description", details["text"]))
        elif method == "Runtime.consoleAPICalled":
            self.logged.append(" ".join(str(a.get("value", a.get("description"))) for a in values["args"]))
        elif method == "Log.entryAdded" and values["entry"]["level"] == "error":
            self.errors.append(values["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.asked.append(values["request"]["url"][:200])

    def _read(self, end: float, method: str) -> dict[str, Any]:
        import select

        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._receive], [], [], max(0.0, end - time.monotonic()))
            if not ready:
                raise AssertionError(f"the browser did not answer {method} in time")
            data = os.read(self._receive, 1 << 20)
            if not data:
                raise AssertionError(f"the browser ended with {self._process.poll()}")
            self._buffer += data
        line, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(line)


@contextlib.contextmanager
def opened_page(*flags: str, width: int = 512, height: int = 512) -> Iterator[Page]:
    """A tab of a new browser with a profile of its own, ended with the block."""
    path = find_browser()
    if path is None:
        raise FileNotFoundError("no Chromium here")
    to_browser, from_us = os.pipe()
    to_us, from_browser = os.pipe()
    folder = tempfile.mkdtemp(prefix="gavatar-browser-")

    def wire() -> None:  # the browser reads from 3 and writes to 4
        read, write = os.dup(to_browser), os.dup(from_browser)
        os.dup2(read, 3)
        os.dup2(write, 4)
        os.set_inheritable(3, True)
        os.set_inheritable(4, True)

    process = subprocess.Popen(
        [path, *FLAGS, f"--user-data-dir={folder}", *flags, "about:blank"],
        preexec_fn=wire, close_fds=False, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    os.close(to_browser)
    os.close(from_browser)
    try:
        page = Page(from_us, to_us, process)
        page.size(width, height)
        yield page
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, 9)  # its profile goes with it: there is nothing to save
        process.wait()
        os.close(from_us)
        os.close(to_us)
        shutil.rmtree(folder, ignore_errors=True)
