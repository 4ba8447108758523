"""A headless Chromium, driven by its DevTools protocol; websockets comes with viser."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PATH = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--enable-unsafe-swiftshader", "--use-gl=angle",
    "--use-angle=swiftshader", "--hide-scrollbars", "--no-first-run", "--disable-extensions", "--mute-audio",
    "--remote-debugging-port=0",
)  # fmt: skip

PREPARED = """addEventListener('DOMContentLoaded', () => {
  const style = document.createElement('style');
  style.textContent = '.mantine-Notifications-root { display: none }';
  document.head.append(style);
});
const context = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, options) {
  return context.call(this, kind, {...options, preserveDrawingBuffer: true});
};"""
"""Hides viser's warning that the browser draws without a GPU, and keeps what is drawn for ``Tab.canvas``."""


class Tab:
    """One page.

    Args:
        connection: to its DevTools.
    """

    def __init__(self, connection: Any):
        self._connection, self._last = connection, 0

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """One command of the protocol."""
        self._last += 1
        self._connection.send(json.dumps({"id": self._last, "method": method, "params": params}))
        while True:
            answer = json.loads(self._connection.recv(timeout=120))
            if answer.get("id") == self._last:
                assert "error" not in answer, answer
                return answer["result"]

    def run(self, script: str) -> Any:
        """The value of a JavaScript expression."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait(self, script: str, seconds: float = 60.0) -> Any:
        """The value of an expression as soon as it is true."""
        return wait(lambda: self.run(script), seconds, script)

    def text(self) -> str:
        """What can be read on the page."""
        return self.run("document.body ? document.body.innerText : ''")

    def reads(self, text: str, seconds: float = 60.0) -> None:
        """Wait until a text can be read on the page."""
        wait(lambda: text in self.text(), seconds, f"{text!r} on the page")

    def click(self, text: str) -> None:
        """Click the first button with this text."""
        self.wait(self.button(text))
        self.run(f"{self._button(text)}.click()")

    def button(self, text: str) -> str:
        """An expression that is true if there is such a button."""
        return f"!!({self._button(text)})"

    def _button(self, text: str) -> str:
        return (
            f"[...document.querySelectorAll('button')].find(b => b.innerText.trim() === {text!r})"
        )

    def click_tab(self, text: str) -> None:
        """Open the first tab with this text."""
        find = f"[...document.querySelectorAll('[role=tab]')].find(b => b.innerText.trim() === {text!r})"
        self.wait(f"!!({find})")
        self.run(f"{find}.scrollIntoView()")
        box = f"{find}.getBoundingClientRect()"
        x, y = (
            self.run(f"{box}.{a} + {box}.{b} / 2") for a, b in (("x", "width"), ("y", "height"))
        )
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def check(self, label: str) -> None:
        """Click the checkbox beside this text."""
        box = f"""[...document.querySelectorAll('input[type=checkbox]')].find(box => {{
          for (let at = box; at; at = at.parentElement) if (at.innerText && at.innerText.trim())
            return at.innerText.replace(/\\s+/g, ' ').trim() === {label!r};
          return false; }})"""
        self.wait(f"!!({box})")
        self.run(f"{box}.click()")

    def key(self, key: str, code: str) -> None:
        """Press a key."""
        for kind in ("rawKeyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=code)

    def canvas(self) -> bytes:
        """What is drawn on the largest canvas, .png; much faster than a screenshot where there is no GPU."""
        url = self.run(
            "[...document.querySelectorAll('canvas')].sort((a, b) => b.width - a.width)[0].toDataURL()"
        )
        return base64.b64decode(url.partition(",")[2])

    def picture(self, file: Path | None = None) -> bytes:
        """A screenshot, .png."""
        data = base64.b64decode(self.call("Page.captureScreenshot")["data"])
        if file is not None:
            file.write_bytes(data)
        return data


def wait(found: Callable[[], Any], seconds: float, what: str) -> Any:
    """What is found as soon as it is true."""
    deadline = time.monotonic() + seconds
    while not (value := found()):
        assert time.monotonic() < deadline, f"not within {seconds} s: {what}"
        time.sleep(0.1)
    return value


@contextmanager
def chromium(folder: Path, width: int = 1280, height: int = 800) -> Iterator[Callable[[str], Tab]]:
    """A browser, as a function that opens an address.

    Args:
        folder: for its profile.
        width: of the window [pixels].
        height: of the window [pixels].
    """
    from websockets.sync.client import connect

    assert PATH, "no Chromium"
    flags = (*FLAGS, f"--window-size={width},{height}", f"--user-data-dir={folder}", "about:blank")
    browser = subprocess.Popen([PATH, *flags], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    connections = []

    def open_page(address: str) -> Tab:
        connection = connect(f"{base}{target}", max_size=None, open_timeout=30)
        connections.append(connection)
        tab = Tab(connection)
        tab.call("Page.enable")
        tab.call("Page.addScriptToEvaluateOnNewDocument", source=PREPARED)
        tab.call("Page.navigate", url=address)
        return tab

    try:
        found = folder / "DevToolsActivePort"
        wait(lambda: found.is_file() and len(found.read_text().split()) == 2, 60, "a browser")
        port = found.read_text().split()[0]
        base = f"ws://127.0.0.1:{port}/devtools/page/"
        import urllib.request

        def pages() -> list[dict[str, Any]]:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
                return [page for page in json.load(answer) if page["type"] == "page"]

        target = wait(pages, 30, "a page")[0]["id"]
        yield open_page
    finally:
        for connection in connections:
            connection.close()
        browser.terminate()
        browser.wait(30)
