# SPDX-License-Identifier: GPL-3.0-or-later
"""One question to a child process that opens a file from outside, and its answer."""

import json
import os
import tempfile
import time
from collections.abc import Callable

from ..errors import TerrainError
from ..run import child, stopping
from ..run.stall import STALL_SECONDS, stalled_text
from .guard import VARIABLES

POLL_SECONDS = 0.02


def ask(module: str, request: dict, what: str):
    """What the `child_main` of a module answers; `what`: what it opens, in errors. Raises TerrainError, also where it
    takes too long or ends without an answer."""
    with tempfile.TemporaryFile() as said, tempfile.TemporaryFile() as errors, stopping.listening():
        try:
            streams = {"stdout": said, "stderr": errors}
            process = child.start(module, json.dumps(request), variables=VARIABLES, **streams)
        except OSError as reason:
            raise TerrainError(f"No Python process could be started for {what} ({reason}): try again.") from reason
        end = time.monotonic() + STALL_SECONDS
        try:
            while process.poll() is None:
                stopping.check()
                if time.monotonic() > end:
                    raise TerrainError(stalled_text(what))
                time.sleep(POLL_SECONDS)
        finally:
            process.kill()
            process.wait()
            process.stdin.close()
        said.seek(0)
        lines = said.read().decode(errors="replace").splitlines()
    answer = json.loads(lines[-1]) if process.returncode == 0 and lines else {}
    if "answer" not in answer:
        raise TerrainError(
            answer.get("error")
            or f"The process that reads {what} ended with code {process.returncode}: the file may be damaged, or "
            "memory may have run out."
        )
    return answer["answer"]


def answer(request: str, reply: Callable[[dict], object], what: Callable[[dict], str]) -> None:
    """In the child: answer one request on stdout. what: of a request, what is opened, in errors."""
    channel = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print goes to stderr
    asked = json.loads(request)
    try:
        said = {"answer": reply(asked)}
    except TerrainError as error:
        said = {"error": str(error)}
    except MemoryError:
        said = {"error": f"Reading {what(asked)} ran out of memory: cut it into tiles or reduce it."}
    except Exception as error:
        said = {"error": f"Reading {what(asked)} failed unexpectedly ({type(error).__name__}: {error})."}
    with channel:
        channel.write(json.dumps(said) + "\n")
