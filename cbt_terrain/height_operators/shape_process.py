# SPDX-License-Identifier: GPL-3.0-or-later
"""Shaping of a store in a child process (store_job.py): `ShapeJob` is polled, `shape_store` waits."""

import os
import threading
from collections.abc import Callable
from pathlib import Path

from ..field import store_folder
from ..importing.earlier_import import finished_before
from ..sandbox.store_job import StoreJob, Tell, serve, wait_for
from .prepare import prepare
from .stack import Stack, stack_content, stack_from
from .tiles import Wanted

__all__ = ["ShapeJob", "child_main", "shape_store"]

GENTLE = 10  # added to the niceness of a gentle job
_finish_early = threading.Event()  # set in the child by `ShapeJob.finish_early`


class ShapeJob(StoreJob):
    """A child process that applies a stack to the store `source` and writes the store `store`.

    Raises TerrainError at once for invalid arguments.
    """

    def __init__(
        self,
        source: str | os.PathLike,
        stack: Stack,
        store: str | os.PathLike,
        wanted: Wanted | None = None,
        tiles: str | os.PathLike | None = None,
        gentle: bool = False,
    ):
        """Start shaping `source` by a stack into `store` in a child process.

        No process starts if the store has this content already. wanted: for each level {tile: allowed error in metres}
        (`tiles_seen`), or None for the whole level; None for all levels. tiles: folder of cached tiles, None for one in
        the store. gentle: run at low priority.
        """
        from .shape_store import open_source, shape_digest

        stack = stack_from(stack_content(stack))  # the same numbers as the child reads
        store_folder.check_target(store)
        heights = open_source(source, Path(store), stack)
        store_folder.remove_abandoned(Path(store))
        pairs = None  # JSON has no objects with numbers as keys
        if wanted is not None:
            pairs = [None if tiles_of is None else sorted(tiles_of.items()) for tiles_of in wanted]
        request = {"source": str(Path(source).absolute()), "stack": stack_content(stack), "wanted": pairs}
        super().__init__(
            "cbt_terrain.height_operators.shape_process",
            store,
            request | {"tiles": None if tiles is None else str(Path(tiles).absolute()), "gentle": gentle},
            what=_job_name(str(source)),
            report=finished_before(store, shape_digest(heights, stack, wanted)),
        )

    def finish_early(self) -> None:
        """Publish the complete levels and skip the rest. The job runs until they are published."""
        if not self.poll().done:
            self._send_line("finish")


def _job_name(source: str) -> str:
    """Return the job's name as the subject of a message."""
    return f"Shaping {source}"


def shape_store(
    source: str | os.PathLike,
    stack: Stack,
    store: str | os.PathLike,
    wanted: Wanted | None = None,
    on_progress: Tell = lambda _fraction, _message: None,
    tiles: str | os.PathLike | None = None,
) -> dict:
    """Shape the store `source` into `store` in a child process, wait, and return the report. Raises TerrainError.

    The report has "unchanged" if the store is up to date. wanted: for each level {tile: allowed error in metres} or
    None for all of it; None for all levels. on_progress(fraction, message): an exception stops the job. tiles: folder
    of cached tiles, None for one in `store`.
    """
    return wait_for(lambda: ShapeJob(source, stack, store, wanted, tiles), on_progress)


def child_main() -> None:
    """Read a request from stdin, shape, and report progress on stdout."""
    serve(_shape, lambda request: _job_name(request["source"]), _finish_early.set)


def _shape(request: dict, on_progress: Tell, begin: Callable[[], None]) -> dict:
    """Shape the requested store in the child process and return its report.

    request: that of ShapeJob; StoreJob adds the store and the folder for new arrays. begin: says that the child is
    ready, so threads may start.
    """
    from .shape_store import run_shape

    begin()
    if request["gentle"] and hasattr(os, "nice"):
        os.nice(GENTLE)
    # In JSON the tiles of a level are pairs of number and allowed error.
    wanted = request["wanted"] and [None if pairs is None else dict(map(tuple, pairs)) for pairs in request["wanted"]]
    stack = stack_from(request["stack"])
    prepare(stack, on_progress)
    # `_finish_early` is set when the parent wants the complete levels only.
    options = {"folder": request["folder"], "finish": _finish_early.is_set, "tiles": request["tiles"]}
    return run_shape(request["source"], stack, request["store"], wanted, on_progress, **options)
