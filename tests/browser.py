"""A browser without a screen, as tests ask it: what stands on a page once its scripts have run."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="needs chromium, which draws pages: apt-get install chromium"
)
QUIET = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking"]
TEXT = """(() => {
  const text = node => (node.shadowRoot ? text(node.shadowRoot) : "") + [...node.childNodes].map(child =>
    child.nodeType === Node.TEXT_NODE ? child.data : /STYLE|SCRIPT/.test(child.nodeName) ? "" : text(child)).join(" ");
  return text(document.body).replace(/\\s+/g, " ");
})()"""
"""All words of a page, those of its components included."""


class Browser:
    """A page of its own, asked through a pair of pipes by the protocol of Chromium's developer tools; a context."""

    def __init__(self, folder: Path) -> None:
        theirs, self.asking = os.pipe()
        self.hearing, ours = os.pipe()
        options = [*QUIET, "--remote-debugging-pipe", "--window-size=1400,1200", f"--user-data-dir={folder}"]
        words = ["bash", "-c", f'exec "$@" 3<&{theirs} 4>&{ours}', "bash", str(CHROMIUM), *options]
        self.process = subprocess.Popen(
            words,
            pass_fds=(theirs, ours),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(theirs)
        os.close(ours)
        self.heard, self.count = b"", 0

    def __enter__(self) -> Browser:
        target = self._ask("Target.createTarget", {"url": "about:blank"})["targetId"]
        self.page = self._ask("Target.attachToTarget", {"targetId": target, "flatten": True})["sessionId"]
        return self

    def __exit__(self, *raised: object) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self.asking)
        os.close(self.hearing)

    def open(self, address: str) -> None:
        """Go to a page, anew even if only what follows # differs."""
        for place in ("about:blank", address):
            self._ask("Page.navigate", {"url": place}, self.page)

    def value(self, script: str) -> Any:
        """What an expression of JavaScript comes to; None while it can't be told."""
        told = self._ask("Runtime.evaluate", {"expression": script, "returnByValue": True}, self.page)
        return told["result"].get("value")

    def wait(self, address: str, shows: Callable[[str], object], seconds: float = 60) -> str:
        """All words of a page once they show what is looked for."""
        self.open(address)
        until, found = time.monotonic() + seconds, ""
        while not shows(found):
            assert time.monotonic() < until, found
            time.sleep(0.1)
            found = self.value(TEXT) or ""
        return found

    def _ask(self, method: str, params: dict[str, Any], session: str | None = None) -> dict[str, Any]:
        self.count += 1
        asked = {"id": self.count, "method": method, "params": params} | ({"sessionId": session} if session else {})
        os.write(self.asking, json.dumps(asked).encode() + b"\0")
        while (told := self._next()).get("id") != self.count:
            pass
        result: dict[str, Any] = told["result"]
        return result

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self.heard:
            part = os.read(self.hearing, 1 << 16)
            assert part, "the browser has ended"
            self.heard += part
        one, _, self.heard = self.heard.partition(b"\0")
        told: dict[str, Any] = json.loads(one)
        return told
