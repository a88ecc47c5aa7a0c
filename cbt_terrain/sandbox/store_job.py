# SPDX-License-Identifier: GPL-3.0-or-later
"""Child processes that write a store or answer one request: their start, their supervision and their messages.

The request is one line of JSON on the child's stdin. The child prints one JSON object a line: {"fraction", "message"},
{"compiling"} before it compiles kernels, {"preview"} before long work, and at the end {"report"} or {"error": the
fields of a TerrainError}. The end of stdin is the end of the parent. Any later line on stdin is a wish to finish early.
The parent does not trust these messages, because a file from outside may have taken over the child.
"""

import dataclasses
import io
import json
import os
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ..errors import TerrainError, shown
from ..field import store as stores
from ..field import store_folder
from ..run import child, compile_note, stopping
from ..run.stall import Stall, stall_error
from .guard import VARIABLES

POLL_SECONDS = 0.02
PROGRESS_SECONDS = 0.05
MAX_LINE_BYTES, MAX_ERROR_CHARS = 1 << 26, 4_000
FREE_MEMORY = "free some memory and try again"
READING = "Reading"  # message of a child while it reads files from outside
CHECK_FILE = f"check that the file is whole, or {FREE_MEMORY}"

Tell = Callable[..., None]  # of a fraction and a message; a child's also of a preview


@dataclass(frozen=True)
class JobProgress:
    """Progress of a job: `fraction` is 0 .. 1; when `done`, either `error` or `report` is set.

    preview: a report on the input that the job has made before its long work, None if there is none.
    """

    fraction: float = 0.0
    message: str = "Starting"
    done: bool = False
    error: TerrainError | None = None
    report: dict | None = None
    preview: dict | None = None


class ChildJob:
    """A child process that runs `child_main` of a module on a request.

    Args:
        module: name of the module.
        request: content of the JSON that the child reads.
        what: the job in errors: "The import of a.tif".
        fix: remedy in the error about a child that ends without a result.
        reading: name of the file from outside that the child reads while its message is one of `watched`. A child that
            stays silent for too long then is killed.
        variables: environment of the child.
        report: result of a job that has nothing left to do; no process is started.

    Raises TerrainError if no process can be started.
    """

    _consequence = ""  # end of the clause about a job without a result

    def __init__(
        self,
        module: str,
        request: dict,
        *,
        what: str,
        fix: str = FREE_MEMORY,
        reading: str = "",
        watched: tuple[str, ...] = (),
        variables: dict[str, str] | None = None,
        report: dict | None = None,
    ):
        """Start a child process, or finish at once with `report` if there is one.

        While the child's message is one of `watched`, it reads the file `reading`, and long silence ends it.
        """
        self._what, self._fix, self._reading, self._watched = what, fix, reading, watched
        self._progress, self.cancelled = JobProgress(), False
        self._num_lines = 0
        self._messages: dict[str, Any] = {}  # the last message of each key
        self._stall, self._stalled = Stall(), False
        if report is not None:
            self._progress = JobProgress(1.0, "Done", done=True, report=report)
        else:
            self._start(module, request, variables or {})

    def _start(self, module: str, request: dict, variables: dict[str, str]) -> None:
        """Start the child, send the request and read its answers in a thread.

        Raises TerrainError. variables: additions to the child's environment. The child's temporary files are in a
        folder of this job, because a child that has been killed, or has given up its rights, cannot remove them.
        """
        try:
            self._temporary = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
            variables = variables | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), self._temporary.name)
            self._errors, pipe = tempfile.TemporaryFile(), subprocess.PIPE
            self._process = child.start(module, variables=variables, stdout=pipe, stderr=self._errors)
            assert self._process.stdin is not None and self._process.stdout is not None  # both are pipes
            self._stdin, self._stdout = self._process.stdin, self._process.stdout
            self._stdin.write(json.dumps(request).encode() + b"\n")
            self._stdin.flush()
        except OSError as reason:
            what = self._what[0].lower() + self._what[1:]
            raise TerrainError(f"No Python process could be started for {what} ({reason})", fix=FREE_MEMORY) from reason
        self._reader = threading.Thread(target=self._read_lines, daemon=True)
        self._reader.start()

    def _read_lines(self) -> None:
        """Collect the child's messages until it ends; runs on a thread.

        A later message replaces an earlier one of its kind.
        """
        while line := self._stdout.readline(MAX_LINE_BYTES):
            self._messages.update(_parse_line(line))
            self._num_lines += 1

    def poll(self) -> JobProgress:
        """Return the job's progress without waiting. A child that hangs while it reads a file is stopped here."""
        if self._progress.done:
            return self._progress
        reading = self._progress.message in self._watched
        if reading and not self._stalled and self._stall.is_over(self._num_lines):
            self._stalled = True
            child.kill(self._process)
        ended = child.poll(self._process) is not None
        if ended:
            self._reader.join()
        if "progress" in self._messages:
            fraction, message = self._messages["progress"]
            self._progress = JobProgress(fraction, message, preview=self._messages.get("preview"))
        if ended:
            self._finish()
        return self._progress

    @property
    def reached(self) -> tuple[float, str] | None:
        """Return the fraction and the message that a running child has sent last; None once it has ended.

        Unlike `poll` it may be read on any thread.
        """
        if self._progress.done or not self._reader.is_alive():
            return None
        return self._messages.get("progress", (0.0, JobProgress.message))

    @property
    def is_compiling(self) -> bool:
        """Return whether the child has begun to compile kernels."""
        return "compiling" in self._messages

    def cancel(self) -> None:
        """Stop the job now, if it is not done."""
        if self.poll().done:
            return
        child.kill(self._process)
        self.cancelled = True
        self.poll()

    def _send_line(self, text: str) -> None:
        """Write a line to the child, if it lives."""
        try:
            self._stdin.write(text.encode() + b"\n")
            self._stdin.flush()
        except OSError:
            pass  # it has just ended, which the next poll sees

    def _error_of_end(self) -> TerrainError:
        """Return the error for a child that has ended without a result."""
        if self.cancelled:
            return TerrainError(f"{self._what} was cancelled{self._consequence}")
        if self._stalled:
            return stall_error(self._reading)
        code = self._process.returncode
        self._errors.seek(max(0, self._errors.seek(0, os.SEEK_END) - 2000))
        printed = self._errors.read(2000).decode(errors="replace").strip().splitlines()
        how = f"exit code {code}" + (f" ({shown(printed[-1], 2000)})" if printed else "")
        if code < 0:
            how = f"signal {signal.Signals(-code).name}"
        what = f"{self._what} ended with {how} before it was done{self._consequence}"
        return TerrainError(what, fix=fix_of_end(code, self._fix))

    def _finish(self) -> None:
        """Set the outcome of a child that has ended: a report, an error, or a kill just after its work was done."""
        self._stdin.close()
        self._stdout.close()
        report, error = self._messages.get("report"), self._messages.get("error")
        if report is None and error is None:
            report = self._published()
            error = self._error_of_end() if report is None else None
        if report is not None:
            self._progress = JobProgress(1.0, "Done", done=True, report=report)
            self.cancelled = False
        else:
            self._progress = dataclasses.replace(self._progress, done=True, error=error)
            self._discard()
        self._errors.close()
        self._temporary.cleanup()

    def _published(self) -> dict | None:
        """Return the report of work that the child finished but was killed before sending; None if there is none.

        A subclass whose child publishes its work looks there; this one knows none.
        """

    def _discard(self) -> None:
        """Remove incomplete output of the child; here there is none."""


def fix_of_end(code: int | None, usual: str) -> str:
    """Return the remedy for a process that ended with a code. usual: that of most codes."""
    # The system sends SIGBUS where a mapped file has no page: the disk is full, or another program has cut the file.
    is_bus = hasattr(signal, "SIGBUS") and code == -signal.SIGBUS
    return "make room on the disk, and check that nothing else writes the files" if is_bus else usual


class StoreJob(ChildJob):
    """A child process that writes a store. If it does not finish, the store stays as it was."""

    _consequence = ", and the store is as it was before"

    def __init__(self, module: str, store: str | os.PathLike, request: dict, **options: Any) -> None:
        """Start the child with the request and the name of a new folder for its arrays.

        module: the child's main module. store: folder of the store. options: further arguments of ChildJob.
        """
        self._store, self._folder = Path(store), store_folder.new_data_name()
        self._new_folders = store_folder.missing_folders(self._store)
        folders = list(map(str, self._new_folders))
        output = {"store": str(self._store.absolute()), "folder": self._folder, "new_folders": folders}
        super().__init__(module, request | output, **options)

    def _published(self) -> dict | None:
        """Return the report in the store if this job has published it, None otherwise."""
        try:
            content = stores.read_json(self._store)
        except TerrainError:
            return None
        return content["report"] if content["data"] == self._folder else None  # "data": name of the arrays' folder

    def _discard(self) -> None:
        """Remove the incomplete arrays of the child; work that can be continued only after a cancel."""
        store_folder.discard(self._store, self._folder, self._new_folders, with_work=self.cancelled)


def _parse_line(line: bytes) -> dict:
    """Return the message in a line of the child, {} for an invalid line."""
    try:
        content = json.loads(line)
        if "fraction" in content:
            fraction = float(content["fraction"])
            return {"progress": (fraction, shown(content["message"]))} if 0.0 <= fraction <= 1.0 else {}
        if "error" in content:
            return {"error": _parse_error(content["error"])}
        if content.get("compiling") is True:
            return {"compiling": True}
        if "preview" in content:
            return {"preview": content["preview"]} if isinstance(content["preview"], dict) else {}
        return {"report": content["report"]} if isinstance(content["report"], dict | list) else {}
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return {}


def _parse_error(fields: dict) -> TerrainError:
    """Return the child's error without its field `code`, by which callers decide: the child is not trusted.

    Raises ValueError for other content.
    """
    fields = {name: fields[name] for name in TerrainError.FIELDS if name in fields and name != "code"}
    if "what" not in fields or not all(isinstance(text, str) for text in fields.values()):
        raise ValueError
    return TerrainError(**{name: shown(text, MAX_ERROR_CHARS) for name, text in fields.items()})


def wait_for(
    start: Callable[[], ChildJob],
    on_progress: Tell = lambda _fraction, _message: None,
    on_preview: Callable[[dict], None] = lambda _preview: None,
) -> dict:
    """Start a job, wait for it and return its report.

    on_progress(fraction, message) is called repeatedly; an exception from it stops the job. on_preview(preview) is
    called once if the job makes a preview. Raises TerrainError, after which the store is as it was before.
    """
    previewed = False
    with stopping.listening():  # an exception in the middle of a wait for a process may leave its lock taken
        job = start()
        try:
            while not (progress := job.poll()).done:
                stopping.check()
                if job.is_compiling:
                    compile_note.note()
                if progress.preview is not None and not previewed:
                    previewed = True
                    on_preview(progress.preview)
                on_progress(progress.fraction, progress.message)
                time.sleep(POLL_SECONDS)
        finally:
            job.cancel()
    if progress.error is not None:
        raise progress.error
    on_progress(1.0, progress.message)
    assert progress.report is not None  # a job that is done has an error or a report
    return progress.report


def ask(module: str, request: dict, what: str, on_progress: Tell = lambda _fraction, _message: None) -> Any:
    """Return the report of a child that opens a file from outside. what: the file, in errors. Raises TerrainError.

    module: its `child_main` answers the `request`, which is sent as JSON. on_progress(fraction, message) is called
    repeatedly; an exception from it stops the child.
    """
    # It is killed if it is silent for too long after its start: `watched` is the message that a job has at first.
    job = partial(ChildJob, what=f"Reading {what}", fix=CHECK_FILE, reading=what, watched=(JobProgress.message,))
    return wait_for(lambda: job(module, request, variables=VARIABLES), on_progress)


# Arguments: a request, a function for progress, and a function to call when the process may start threads. Result: the
# report, an object or a list.
ChildWork = Callable[[dict, Tell, Callable[[], None]], Mapping | Sequence]


def serve(work: ChildWork, what: Callable[[dict], str], heard: Callable[[], None] = lambda: None) -> None:
    """Read a request from stdin, do it, and report on stdout; for the child process.

    work(request, on_progress, watch_parent): does it and returns the report. As soon as the process may start threads
    it calls watch_parent(), and from then on this process ends with its parent. what(request): the work as a noun, for
    errors. heard(): called when the parent writes another line. An unexpected exception is reported and raised again.
    """
    # Messages go to a copy of stdout, and descriptor 1 to stderr, so that prints of libraries are no messages.
    channel = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    request = json.loads(io.FileIO(0, closefd=False).readline())  # the thread of end_with_parent reads the rest
    sent = 0.0

    def send(content: dict) -> None:
        """Write a message to the parent, as one line of JSON."""
        channel.write(json.dumps(content) + "\n")
        channel.flush()

    compile_note.replace(lambda: send({"compiling": True}))

    def on_progress(fraction: float, message: str, preview: dict | None = None) -> None:
        """Send a preview, if there is one, and the progress, at most once in PROGRESS_SECONDS.

        Raises if the work was cancelled.
        """
        nonlocal sent
        stopping.check()
        if preview is not None:
            send({"preview": preview})
        if time.monotonic() - sent > PROGRESS_SECONDS:
            sent = time.monotonic()
            send({"fraction": fraction, "message": message})

    def clean_up() -> None:
        """Remove the arrays of a store that was not completed, unless a later import can continue (`with_work`)."""
        new_folders = list(map(Path, request["new_folders"]))
        store_folder.discard(Path(request["store"]), request["folder"], new_folders, with_work=False)

    def send_error(error: TerrainError) -> None:
        """Report an error to the parent."""
        send({"error": error.to_json()})

    try:
        send({"report": work(request, on_progress, lambda: child.end_with_parent(clean_up, heard))})
    except TerrainError as error:
        send_error(error)
    except MemoryError:
        send_error(TerrainError(f"{what(request)} ran out of memory", fix="cut it into tiles or reduce it"))
    except Exception as error:
        fault = f"{what(request)} failed unexpectedly ({type(error).__name__}: {error})"
        send_error(TerrainError(fault, fix="report it with the file"))
        raise
