# SPDX-License-Identifier: GPL-3.0-or-later
"""An import in a child process: started, watched and ended by the parent, and its own main function.

`import_source` waits for it, an `ImportJob` is polled: a bad file or a clash of libraries cannot hurt the calling
process, which is Blender. The child prints one JSON object a line: {"fraction", "message"}, and at the end {"report"}
or {"error"}. It gives up the network and writing elsewhere (guard.py) before it opens a file, and nothing of a file
from outside is parsed in the calling process.
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

from ..errors import TerrainError
from ..field import store as stores
from ..run import child, stopping
from ..run.stall import Stall, stalled_text
from .build_store import READING, finished_before, run_import, source_digest
from .guard import VARIABLES, guard_import
from .raster import ImportSettings

POLL_SECONDS = 0.02
PROGRESS_SECONDS = 0.05


@dataclass(frozen=True)
class Progress:
    """How far an import is: `fraction` 0 .. 1; when `done`, either `error` or `report` is set."""

    fraction: float = 0.0
    message: str = "Starting"
    done: bool = False
    error: str | None = None
    report: dict | None = None


class ImportJob:
    """An import that runs in a child process. Raises TerrainError at once for settings that cannot be used."""

    def __init__(self, settings: ImportSettings, store: str | os.PathLike):
        stores.check_target(store)
        self._settings, self._store = settings, Path(store)
        self._progress, self.cancelled, self._lines = Progress(), False, []
        self._process, self._stall, self._stalled = None, Stall(), False
        stores.remove_abandoned(self._store)
        report = finished_before(self._store, source_digest(settings))
        if report is not None:
            self._progress = Progress(1.0, "Done", True, None, report)
            return
        self._folder = stores.new_data_name()
        self._made = stores.missing_folders(self._store)
        self._start()

    def _start(self) -> None:
        self._errors = tempfile.TemporaryFile()
        try:
            pipe = subprocess.PIPE
            self._process = child.start(
                "cbt_terrain.importing.import_process", variables=VARIABLES, stdout=pipe, stderr=self._errors
            )
            request = {
                "settings": dataclasses.asdict(self._settings),
                "store": str(self._store.absolute()),
                "folder": self._folder,
                "made": list(map(str, self._made)),
            }
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()
        except OSError as reason:
            raise TerrainError(f"No Python process could be started for the import ({reason}): try again.") from reason
        self._reader = threading.Thread(target=self._read_lines, daemon=True)
        self._reader.start()

    def _read_lines(self) -> None:
        for line in self._process.stdout:
            try:
                told = json.loads(line)
            except ValueError:
                continue  # cut off by a kill
            self._lines.append(told)

    def poll(self) -> Progress:
        """How far the import is; never waits."""
        if self._progress.done:
            return self._progress
        reading = self._progress.message in (Progress.message, READING)
        if reading and not self._stalled and self._stall.is_over(len(self._lines)):
            self._stalled = True
            self._process.kill()
            self._process.wait()
        ended = self._process.poll() is not None
        if ended:
            self._reader.join()
        told = [line for line in self._lines if "fraction" in line]
        if told:
            self._progress = Progress(told[-1]["fraction"], told[-1]["message"])
        if ended:
            self._finish()
        return self._progress

    def cancel(self) -> None:
        """Stop the import now; the store stays as it was. Does nothing to one that is done."""
        if self.poll().done:
            return
        self._process.kill()
        self.cancelled = True
        self._process.wait()
        self.poll()

    def _reason_of_end(self) -> str:
        source = self._settings.source
        if self.cancelled:
            return f"The import of {source} was cancelled; the store is as it was before."
        if self._stalled:
            return stalled_text(source)
        code = self._process.returncode
        self._errors.seek(0)
        said = self._errors.read()[-2000:].decode(errors="replace").strip().splitlines()
        how = f"exit code {code}" + (f" ({said[-1]})" if said else "")
        if code < 0:
            how = f"signal {signal.Signals(-code).name}"
        return (
            f"The import of {source} ended with {how} before it was done, and the store is as it was before: the file "
            "may be damaged, or memory may have run out."
        )

    def _finish(self) -> None:
        """The child has ended: with a report, with an error, or killed, perhaps just after it published the store."""
        self._process.stdin.close()
        self._process.stdout.close()
        last = self._lines[-1] if self._lines else {}
        report, error = last.get("report"), last.get("error")
        if report is None and error is None:
            try:
                content = stores.read_json(self._store)
                report = content["report"] if content["data"] == self._folder else None
            except TerrainError:
                pass
            error = self._reason_of_end() if report is None else None
        if report is not None:
            self._progress = Progress(1.0, "Done", True, None, report)
            self.cancelled = False
        else:
            self._progress = dataclasses.replace(self._progress, done=True, error=error)
            stores.discard(self._store, self._folder, self._made)
        self._errors.close()


def import_source(
    source: ImportSettings | str | os.PathLike,
    store: str | os.PathLike,
    on_progress: Callable[[float, str], None] = lambda _fraction, _message: None,
) -> dict:
    """Import in a child process and wait; returns the report, with "unchanged" if the store held this source already.

    source: settings, or a path or a built-in land, as "island", where their defaults do. on_progress(fraction, message)
    is called as it goes on; what it raises stops the import. Raises TerrainError. The store is then as it was before.
    """
    settings = source if isinstance(source, ImportSettings) else ImportSettings(os.fspath(source))
    with stopping.listening():  # an exception in the middle of a wait for a process may leave its lock taken
        job = ImportJob(settings, store)
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


def child_main() -> None:
    """Read a request from stdin, import, and say on stdout how it goes."""
    channel = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print goes to stderr
    request = json.loads(sys.stdin.readline())
    path, folder = Path(request["store"]), request["folder"]
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

    settings = request["settings"]
    for name in ("raw_size", "extent"):
        settings[name] = tuple(settings[name]) if settings[name] is not None else None
    try:
        guard_import(ImportSettings(**settings), path)
        # After the guard: a thread that was there before it would still be able to write elsewhere.
        child.end_with_parent(lambda: stores.discard(path, folder, list(map(Path, request["made"]))))
        say({"report": run_import(ImportSettings(**settings), path, on_progress, folder)})
    except TerrainError as error:
        say({"error": str(error)})
    except MemoryError:
        say({"error": f"The import of {settings['source']} ran out of memory: cut it into tiles or reduce it."})
    except Exception as error:
        say({"error": f"The import of {settings['source']} failed unexpectedly ({type(error).__name__}: {error})."})
        raise
