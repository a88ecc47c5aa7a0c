# SPDX-License-Identifier: GPL-3.0-or-later
"""What a child process is asked for: a store that it makes, or one question. It is started, watched and ended by the
parent; and what the child says.

The request is one JSON object in a line on the child's stdin. It prints one JSON object a line: {"fraction",
"message"}, and at the end {"report"} or {"error"}. The stdin stays open: when it ends, the parent has, and what else is
written there is a wish to finish early.
"""

import dataclasses
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..errors import TerrainError, shown
from ..field import store as stores
from ..field import store_folder
from ..run import child, stopping
from ..run.stall import Stall, stalled_text
from .guard import VARIABLES

POLL_SECONDS = 0.02
PROGRESS_SECONDS = 0.05
MAX_LINE_BYTES, MAX_ERROR_CHARS = 1 << 26, 4_000

Tell = Callable[[float, str], None]


@dataclass(frozen=True)
class Progress:
    """How far a job is: `fraction` 0 .. 1; when `done`, either `error` or `report` is set."""

    fraction: float = 0.0
    message: str = "Starting"
    done: bool = False
    error: str | None = None
    report: dict | None = None


class ChildJob:
    """A child process that does something.

    module: whose `child_main` does it, with `request` as what it is asked for. what: "The import of a.tif", in errors;
    blame: what may be wrong where the child just ends. reading, watched: what is read from outside while messages are
    among `watched`: the child is then ended where it stays silent for too long. report: where there is nothing left to
    do. Raises TerrainError.
    """

    _left = ""  # what an end without a report has left, in errors

    def __init__(
        self,
        module: str,
        request: dict,
        *,
        what: str,
        blame: str = "memory may have run out",
        reading: str = "",
        watched: tuple[str, ...] = (),
        variables: dict[str, str] | None = None,
        report: dict | None = None,
    ):
        self._what, self._blame, self._reading, self._watched = what, blame, reading, watched
        self._progress, self.cancelled = Progress(), False
        self._num_lines, self._told = 0, {}  # of the child: how many lines, and the last of each key
        self._process, self._stall, self._stalled = None, Stall(), False
        if report is not None:
            self._progress = Progress(1.0, "Done", True, None, report)
        else:
            self._start(module, request, variables or {})

    def _start(self, module: str, request: dict, variables: dict[str, str]) -> None:
        try:
            self._errors, pipe = tempfile.TemporaryFile(), subprocess.PIPE
            self._process = child.start(module, variables=variables, stdout=pipe, stderr=self._errors)
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()
        except OSError as reason:
            raise TerrainError(
                f"No Python process could be started for {_inside(self._what)} ({reason}): try again."
            ) from reason
        self._reader = threading.Thread(target=self._read_lines, daemon=True)
        self._reader.start()

    def _read_lines(self) -> None:
        while line := self._process.stdout.readline(MAX_LINE_BYTES):
            self._told.update(_parse_line(line))
            self._num_lines += 1

    def poll(self) -> Progress:
        """Return how far the job is, without waiting."""
        if self._progress.done:
            return self._progress
        reading = self._progress.message in self._watched
        if reading and not self._stalled and self._stall.is_over(self._num_lines):
            self._stalled = True
            child.kill(self._process)
        ended = child.poll(self._process) is not None
        if ended:
            self._reader.join()
        if "progress" in self._told:
            self._progress = Progress(*self._told["progress"])
        if ended:
            self._finish()
        return self._progress

    def cancel(self) -> None:
        """Stop the job now. Does nothing to one that is done."""
        if self.poll().done:
            return
        child.kill(self._process)
        self.cancelled = True
        self.poll()

    def _say(self, text: str) -> None:
        """Write a line to the child, if it lives."""
        try:
            self._process.stdin.write(text.encode() + b"\n")
            self._process.stdin.flush()
        except OSError:
            pass  # it has just ended, which the next poll sees

    def _reason_of_end(self) -> str:
        if self.cancelled:
            return f"{self._what} was cancelled{self._left}."
        if self._stalled:
            return stalled_text(self._reading)
        code = self._process.returncode
        self._errors.seek(max(0, self._errors.seek(0, os.SEEK_END) - 2000))
        said = self._errors.read(2000).decode(errors="replace").strip().splitlines()
        how = f"exit code {code}" + (f" ({shown(said[-1], 2000)})" if said else "")
        if code < 0:
            how = f"signal {signal.Signals(-code).name}"
        return f"{self._what} ended with {how} before it was done{self._left}: {self._blame}."

    def _finish(self) -> None:
        """Set the outcome of a child that has ended: a report, an error, or a kill just after its work was done."""
        self._process.stdin.close()
        self._process.stdout.close()
        report, error = self._told.get("report"), self._told.get("error")
        if report is None and error is None:
            report = self._published()
            error = self._reason_of_end() if report is None else None
        if report is not None:
            self._progress = Progress(1.0, "Done", True, None, report)
            self.cancelled = False
        else:
            self._progress = dataclasses.replace(self._progress, done=True, error=error)
            self._discard()
        self._errors.close()

    def _published(self) -> dict | None:
        """Return the report of work that is done, though the child has not sent it."""

    def _discard(self) -> None:
        """Take away what the child has begun."""


class StoreJob(ChildJob):
    """A child process that makes a store, which stays as it was where it does not come to its end."""

    _left = ", and the store is as it was before"

    def __init__(self, module: str, store: str | os.PathLike, request: dict, **how):
        self._store, self._folder = Path(store), store_folder.new_data_name()
        self._made = store_folder.missing_folders(self._store)
        place = {"store": str(self._store.absolute()), "folder": self._folder, "made": list(map(str, self._made))}
        super().__init__(module, request | place, **how)

    def _published(self) -> dict | None:
        try:
            content = stores.read_json(self._store)
        except TerrainError:
            return None
        return content["report"] if content["data"] == self._folder else None

    def _discard(self) -> None:
        store_folder.discard(self._store, self._folder, self._made)


def _parse_line(line: bytes) -> dict:
    """Return what a line of the child holds, {} for what no child of ours writes: a file may have taken it over."""
    try:
        content = json.loads(line)
        if "fraction" in content:
            fraction = float(content["fraction"])
            return {"progress": (fraction, shown(content["message"]))} if 0.0 <= fraction <= 1.0 else {}
        if "error" in content:
            return {"error": shown(content["error"], MAX_ERROR_CHARS)}
        return {"report": content["report"]} if isinstance(content["report"], dict | list) else {}
    except (ValueError, TypeError, KeyError, RecursionError):
        return {}


def _inside(what: str) -> str:
    """Of "The import of a.tif", inside a sentence."""
    return what[0].lower() + what[1:]


def wait_for(start: Callable[[], ChildJob], on_progress: Tell = lambda _fraction, _message: None) -> dict:
    """Start a job and wait for it; returns its report.

    on_progress(fraction, message) is called as it goes on; what it raises stops the job. Raises TerrainError. The store
    is then as it was before.
    """
    with stopping.listening():  # an exception in the middle of a wait for a process may leave its lock taken
        job = start()
        try:
            while not (progress := job.poll()).done:
                stopping.check()
                on_progress(progress.fraction, progress.message)
                time.sleep(POLL_SECONDS)
        finally:
            job.cancel()
    if progress.error is not None:
        raise TerrainError(progress.error)
    on_progress(1.0, progress.message)
    return progress.report


def ask(module: str, request: dict, what: str):
    """What the `child_main` of a module, which opens a file from outside, reports; what: it opens, in errors. Raises
    TerrainError."""
    about = {"what": f"Reading {what}", "reading": what, "watched": (Progress.message,), "variables": VARIABLES}
    blame = "the file may be damaged, or memory may have run out"
    return wait_for(lambda: ChildJob(module, request, blame=blame, **about))


# A request, how to say how far it is, and what is to be called when the process may start threads; -> the report.
Serve = Callable[[dict, Tell, Callable[[], None]], dict]


def serve(work: Serve, what: Callable[[dict], str], heard: Callable[[], None] = lambda: None) -> None:
    """In the child: read a request from stdin, do it, and say on stdout how it goes. what: as of ChildJob; heard: is
    called when the parent writes something more."""
    channel = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print goes to stderr
    request = json.loads(sys.stdin.buffer.raw.readline())  # byte by byte: what follows is for who watches the parent
    said = 0.0

    def say(content: dict) -> None:
        channel.write(json.dumps(content) + "\n")
        channel.flush()

    def on_progress(fraction: float, message: str) -> None:
        nonlocal said
        stopping.check()
        if time.monotonic() - said > PROGRESS_SECONDS:
            said = time.monotonic()
            say({"fraction": fraction, "message": message})

    def clean_up() -> None:
        store_folder.discard(Path(request["store"]), request["folder"], list(map(Path, request["made"])))

    try:
        say({"report": work(request, on_progress, lambda: child.end_with_parent(clean_up, heard))})
    except TerrainError as error:
        say({"error": str(error)})
    except MemoryError:
        say({"error": f"{what(request)} ran out of memory: cut it into tiles or reduce it."})
    except Exception as error:
        say({"error": f"{what(request)} failed unexpectedly ({type(error).__name__}: {error})."})
        raise
