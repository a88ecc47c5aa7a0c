# SPDX-License-Identifier: GPL-3.0-or-later
"""A page as a headless Chromium finds it: what its console says, and which of its pictures are there.

Chromium is spoken to over two pipes (--remote-debugging-pipe): JSON messages, each ended by a zero byte.
"""

import fcntl
import json
import os
import select
import shutil
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

NAMES = ("chromium-headless-shell", "chromium", "google-chrome")
CHROMIUM = next((path for path in map(shutil.which, NAMES) if path), None)
OPTIONS = ["--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe"]
PATIENCE_S = 120.0
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="there is no Chromium here; on Debian: apt-get install chromium-headless-shell"
)
# Pictures (files and drawings) with their descriptions, and whether they have a size.
PICTURES = """JSON.stringify([
  ...[...document.images].map(i => [i.alt, i.complete && i.naturalWidth > 1 && i.getBoundingClientRect().width > 1]),
  ...[...document.querySelectorAll('svg')].map(s => [s.getAttribute('aria-label'), s.getBBox().width > 1])])"""


@dataclass(frozen=True)
class Opened:
    """`errors`: those of the console, the network and scripts. `pictures`: whether each is there, by its name.
    `text`: visible text. `wide`: by how many pixels the page is wider than its window."""

    errors: list[str]
    pictures: list[tuple[str, bool]]
    text: str
    wide: int


def opened(page: Path | str, folder: Path, width: int = 1280) -> Opened:
    """Open a page, a file or an address, in a window of that width. `folder`: for what Chromium keeps."""
    with _chromium(folder, width) as ask:
        target = ask("Target.createTarget", url="about:blank")["targetId"]
        session = ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            ask(f"{domain}.enable", session)
        ask("Page.navigate", session, url=page if isinstance(page, str) else page.resolve().as_uri())
        ask.until("Page.loadEventFired")

        def value(script: str):
            return ask("Runtime.evaluate", session, expression=script)["result"]["value"]

        pictures = [tuple(pair) for pair in json.loads(value(PICTURES))]
        wide = value("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        complaints = [said for said in map(_complaint, ask.events) if said]
        return Opened(complaints, pictures, value("document.body.innerText"), wide)


def _complaint(event: dict) -> str:
    """Return the complaint of an event, or ""."""
    method, params = event["method"], event["params"]
    if method == "Runtime.exceptionThrown":
        return params["exceptionDetails"].get("exception", {}).get("description", params["exceptionDetails"]["text"])
    if method == "Network.loadingFailed":
        return f"{params['type']}: {params['errorText']}"
    if method == "Runtime.consoleAPICalled" and params["type"] in ("error", "assert"):
        return " ".join(str(argument.get("value")) for argument in params["args"])
    entry = params.get("entry", {})
    return f"{entry['text']} {entry.get('url', '')}" if entry.get("level") == "error" else ""


class _Pipe:
    """Calls to Chromium; events that come meanwhile are kept."""

    def __init__(self, read: int, write: int):
        self._read, self._write, self._rest, self._number, self.events = read, write, b"", 0, []

    def __call__(self, method: str, session: str | None = None, **params) -> dict:
        self._number += 1
        call = {"id": self._number, "method": method, "params": params} | ({"sessionId": session} if session else {})
        os.write(self._write, json.dumps(call).encode() + b"\0")
        while True:
            message = self._next()
            if message.get("id") == self._number:
                assert "result" in message, f"{method}: {message}"
                return message["result"]

    def until(self, method: str) -> None:
        while not any(event["method"] == method for event in self.events):
            self._next()

    def _next(self) -> dict:
        end = time.monotonic() + PATIENCE_S
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._read], [], [], max(0.0, end - time.monotonic()))
            part = os.read(self._read, 1 << 16) if ready else b""
            assert part, "Chromium says nothing more"
            self._rest += part
        text, self._rest = self._rest.split(b"\0", 1)
        message = json.loads(text)
        if "method" in message:
            self.events.append(message)
        return message


@contextmanager
def _chromium(folder: Path, width: int):
    theirs_in, ours_out = os.pipe()
    ours_in, theirs_out = os.pipe()
    high = [fcntl.fcntl(fd, fcntl.F_DUPFD, 10) for fd in (theirs_in, theirs_out)]  # 3 and 4 are to be theirs
    become = f"import os, sys; os.dup2({high[0]}, 3); os.dup2({high[1]}, 4); os.execv(sys.argv[1], sys.argv[1:])"
    command = [sys.executable, "-ISc", become, CHROMIUM, *OPTIONS, f"--user-data-dir={folder}"]
    command.append(f"--window-size={width},900")
    process = subprocess.Popen(command, pass_fds=high, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    for fd in (theirs_in, theirs_out, *high):
        os.close(fd)
    try:
        yield _Pipe(ours_in, ours_out)
    finally:
        process.terminate()
        process.wait(PATIENCE_S)
        os.close(ours_in)
        os.close(ours_out)
