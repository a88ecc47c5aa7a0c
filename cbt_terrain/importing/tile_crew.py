# SPDX-License-Identifier: GPL-3.0-or-later
"""Processes that read and measure tiles for an import, each sandboxed like the import's process.

A sandboxed process cannot start others, so the import starts them before it drops its rights. They wait for the first
line on stdin and load nothing until then, because most imports are small. They are in the import's group of processes,
and end when their stdin closes.

The first line has the settings and the folder of an import, each further one a task. A process answers each task with
a line: {"done": true}, or false if heights have to be stored as floats, or {"error": the fields of a TerrainError}.
"""

import dataclasses
import io
import json
import os
import queue
import subprocess
import threading
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ..errors import TerrainError, unwritable
from ..field.lands import LANDS
from ..field.store_folder import FIRST
from ..formats.sources import open_source
from ..rasters.raster import ImportSettings, Raster
from ..run import child, launch, memory, stopping
from ..sandbox.guard import VARIABLES, guard_import
from ..sandbox.store_job import FREE_MEMORY
from ..tiling.tile_records import READ
from ..tiling.tile_work import TileWork, work_in
from .build_store import place_of
from .refining import coarse_land, refined
from .source_list import INDEX_SUFFIXES, files_of, names_several
from .tile_import import Crew
from .tile_tasks import TileSource, TileTask, perform

MIN_BYTES = 1 << 22  # of the files of an import, for which processes are started
MIN_SAMPLES = 1 << 25  # of a raster for which they work: they take a second to begin
POLL_S = 0.1


def start_crew(settings: ImportSettings, module: str) -> Crew:
    """Return processes for an import, which the caller closes; the calling process alone for a probably small import.

    The calling process is also used with one thread, or where no process can be started. module: name of a module with
    the function `idle_main`. Raises TerrainError for sources that name no file.
    """
    count = launch.default_threads()
    if count < 2 or not may_be_large(settings):
        return Crew()
    try:
        return ProcessCrew(module, count)
    except OSError:
        return Crew()


def may_be_large(settings: ImportSettings) -> bool:
    """Return whether an import is large enough for processes: a large built-in terrain, or MIN_BYTES of files.

    A tile index counts, whose files are not known yet. A missing file does not.
    """
    if settings.source in LANDS:
        return settings.size**2 > MIN_SAMPLES
    files = files_of(settings) if names_several(settings) else [Path(settings.source)]
    try:
        return (
            any(file.suffix.lower() in INDEX_SUFFIXES for file in files)
            or sum(int(file.stat().st_size) for file in files) >= MIN_BYTES
        )
    except OSError:
        return False


class ProcessCrew(Crew):
    """Processes that do the tasks of one import, one task at a time each; the calling process does a small one."""

    def __init__(self, module: str, count: int) -> None:
        """Start `count` processes that each call the `idle_main` of the module named `module`. Raises OSError."""
        pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "start_new_session": False}
        self._processes = [
            child.start("cbt_terrain.run.idle_process", module, variables=VARIABLES, **pipes) for _ in range(count)
        ]
        self._has_begun = False

    def run(
        self, work: TileWork, source: TileSource, tasks: Sequence[TileTask], on_progress: Callable[[float], None]
    ) -> bool:
        """Do tasks in the processes. Return False, before the rest is done, if heights have to be stored as floats.

        on_progress: called with the fraction of finished tasks. Raises TerrainError for a task that fails. No process
        works on a task when this returns or raises.
        """
        lattice = work.grid.lattice
        if lattice.width * lattice.height <= MIN_SAMPLES:
            return super().run(work, source, tasks, on_progress)
        if tasks and not self._has_begun:
            self._has_begun = True
            for process in self._processes:
                _send(process, {"settings": dataclasses.asdict(source.settings), "folder": str(work.folder)})
        waiting, answers = deque(tasks), queue.SimpleQueue[dict]()
        threads = [
            threading.Thread(target=_do_tasks, args=(process, waiting, answers), daemon=True)
            for process in self._processes
        ]
        for thread in threads:
            thread.start()
        try:
            for number in range(len(tasks)):
                if not _next_answer(answers):
                    return False
                on_progress((number + 1) / len(tasks))
        finally:
            waiting.clear()
            for thread in threads:
                thread.join()
        return True

    def close(self) -> None:
        """Let the processes end, without a wait: each reads the end of its stdin."""
        for process in self._processes:
            assert process.stdin is not None
            process.stdin.close()


def _next_answer(answers: queue.SimpleQueue[dict]) -> bool:
    """Wait for the next answer of a process. Return False if heights have to be stored as floats.

    Raises TerrainError for a task that failed, and what `stopping.check` raises.
    """
    while True:
        stopping.check()
        try:
            answer = answers.get(timeout=POLL_S)
        except queue.Empty:
            continue
        if "error" in answer:
            raise TerrainError(**answer["error"])
        return bool(answer["done"])


def _do_tasks(process: subprocess.Popen, waiting: deque[TileTask], answers: queue.SimpleQueue[dict]) -> None:
    """Send waiting tasks to a process and collect its answers, until there is no more task or one fails.

    A process that has ended gives an error as its answer.
    """
    assert process.stdout is not None
    while True:
        try:
            task = waiting.popleft()
        except IndexError:  # another thread has taken the last one
            return
        try:
            _send(process, task._asdict())
            answer = json.loads(process.stdout.readline())
        except (OSError, ValueError):
            what = "A process of the import ended before its work was done"
            answer = {"error": TerrainError(what, fix="free some memory and disk space, and try again").to_json()}
        answers.put(answer)
        if "error" in answer:
            return


def _send(process: subprocess.Popen, content: dict) -> None:
    """Write a line to a process."""
    assert process.stdin is not None
    process.stdin.write(json.dumps(content).encode() + b"\n")
    process.stdin.flush()


def idle_main(line: bytes) -> None:
    """Do the tasks of an import of one file in an idle process. line: settings and folder of the import as JSON."""
    serve_tasks(line, guard_import, lambda settings, _folder: open_source(settings))


def serve_tasks(
    line: bytes,
    guard: Callable[[ImportSettings, Path], None],
    open_raster: Callable[[ImportSettings, Path], Raster],
) -> None:
    """Do tasks from stdin until it ends, and answer on stdout; the module's docstring has the messages.

    Args:
        line: the settings and the folder of the import as JSON.
        guard: guard(settings, store) drops the rights of this process.
        open_raster: open_raster(settings, folder) opens the source.
    """
    channel = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print to stdout goes to stderr, so that it is not among the answers
    request, source = json.loads(line), None
    settings, folder = ImportSettings(**request["settings"]), Path(request["folder"])
    guard(settings, folder.parent)
    coarse = coarse_land(settings, folder / FIRST) if settings.loaded_tiles else None
    try:
        for text in io.FileIO(0, closefd=False):
            task = TileTask(**json.loads(text))
            work = work_in(folder)  # each time, since it may have begun again with floats
            answer: dict = {}
            try:
                if work is None:
                    raise TerrainError(f"The arrays in {folder} were removed", fix="import again")
                if source is not None and task.step != READ:  # its caches are no longer needed
                    source.raster.close()
                    source = None
                    memory.give_back()
                if source is None and task.step == READ:
                    raster = open_raster(settings, folder)
                    raster = raster if coarse is None else refined(raster, settings, coarse)
                    source = TileSource(raster, settings, place_of(settings, raster), coarse)
                answer["done"] = perform(work, source, task, threads=1, coarse=coarse)
            except TerrainError as error:
                answer["error"] = error.to_json()
            except OSError as reason:
                answer["error"] = unwritable(f"The store {folder.parent}", reason).to_json()
            except MemoryError:
                answer["error"] = TerrainError("The import ran out of memory", fix=FREE_MEMORY).to_json()
            channel.write(json.dumps(answer) + "\n")
            channel.flush()
    finally:
        if source is not None:
            source.raster.close()
