# SPDX-License-Identifier: GPL-3.0-or-later
"""Shaping a store in a child process (store_job.py): polled by a `ShapeJob`, or waited for by `shape_store`."""

import os
import threading
from collections.abc import Callable
from pathlib import Path

from ..field import store_folder
from ..importing.build_store import finished_before
from ..importing.store_job import StoreJob, Tell, serve, wait_for
from .kernels_needed import prepare
from .shape_store import open_source, run_shape, shape_digest
from .stack import Stack, stack_content, stack_from
from .tiles import Wanted

__all__ = ["ShapeJob", "child_main", "shape_store"]

GENTLE = 10  # by which a gentle job is nicer than what asks for it
_enough = threading.Event()


class ShapeJob(StoreJob):
    """A stack applied to the store `source`, into the store `store`, in a child process.

    wanted: the tiles of each level, as `tiles_seen` finds them (tiles.py); None for all. tiles: as of `run_shape`.
    gentle: at a low priority. Raises TerrainError at once for what cannot be.
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
        stack = stack_from(stack_content(stack))
        store_folder.check_target(store)
        heights = open_source(source, Path(store), stack)
        store_folder.remove_abandoned(Path(store))
        asked = wanted and [None if some is None else sorted(some.items()) for some in wanted]
        request = {"source": str(Path(source).absolute()), "stack": stack_content(stack), "wanted": asked}
        super().__init__(
            "cbt_terrain.land.shape_process",
            store,
            request | {"tiles": None if tiles is None else str(Path(tiles).absolute()), "gentle": gentle},
            what=_what(str(source)),
            report=finished_before(store, shape_digest(heights, stack, wanted)),
        )

    def finish_early(self) -> None:
        """Be content with the levels that are complete; the job goes on until they are published."""
        if not self.poll().done:
            self._say("finish")


def _what(source: str) -> str:
    return f"Shaping {source}"


def shape_store(
    source: str | os.PathLike,
    stack: Stack,
    store: str | os.PathLike,
    wanted: Wanted | None = None,
    on_progress: Tell = lambda _fraction, _message: None,
    tiles: str | os.PathLike | None = None,
) -> dict:
    """Shape in a child process and wait; arguments and report as of `run_shape`, with "unchanged" if the store holds
    this already. on_progress(fraction, message) is called as it goes on; what it raises stops the job."""
    return wait_for(lambda: ShapeJob(source, stack, store, wanted, tiles), on_progress)


def child_main() -> None:
    """Read a request from stdin, shape, and say on stdout how it goes."""
    serve(_shape, lambda request: _what(request["source"]), _enough.set)


def _shape(request: dict, on_progress: Tell, begin: Callable[[], None]) -> dict:
    begin()
    if request["gentle"] and hasattr(os, "nice"):
        os.nice(GENTLE)
    wanted = request["wanted"] and [some if some is None else dict(map(tuple, some)) for some in request["wanted"]]
    stack = stack_from(request["stack"])
    prepare(stack, on_progress)
    more = {"folder": request["folder"], "finish": _enough.is_set, "tiles": request["tiles"]}
    return run_shape(request["source"], stack, request["store"], wanted, on_progress, **more)
