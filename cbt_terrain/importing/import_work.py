# SPDX-License-Identifier: GPL-3.0-or-later
"""The unfinished work of an import by tile in a store's folder: a new one, or that of a killed import, found again.

A TileWork is the folder of the arrays, with the records of finished tiles; a draft makes that folder the store's
content at the end. A TileSource is the opened raster with its settings and position.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from ..errors import TerrainError
from ..field import codes, store_folder
from ..field.lands import LANDS
from ..field.lattice import Lattice, lattice_for
from ..field.store import Draft
from ..rasters.raster import MOSAIC
from ..run import partial_files
from ..tiling.moved_tiles import copy_moved, tiles_moved
from ..tiling.tile_grid import TILE_BITS, TileGrid
from ..tiling.tile_work import TileWork, work_in
from . import refining
from .drafts import open_draft, work_bytes
from .height_reader import scaling_of
from .tile_tasks import TileSource, unit_count

# Remedies for an implausibly large store, of a built-in terrain, one file, and a mosaic with its gaps.
FEWER = ", or import {} with fewer samples (--size)"
DOUBT = ", or check that the header of {} has its true size"
COARSER = ", or give a larger step"
WITHOUT_HOLES = ", or fill gaps instead of cutting them out, which takes little room if they are wide"


@contextmanager
def open_work(wanted: TileWork, source: TileSource) -> Iterator[tuple[Draft, TileWork | None]]:
    """Yield a draft of a store, and the unfinished work that an earlier import with the same digest has left, if any.

    That work is moved into the new folder. A block that fails or does not publish leaves work that can be continued.
    wanted: the work from its beginning. Raises TerrainError for a disk with too little room, and for any OSError of the
    block.
    """
    path, lattice = wanted.folder.parent, wanted.grid.lattice
    work = _continued(wanted)
    if path.exists():
        store_folder.remove_abandoned(path, with_work=work is None)
    # A new work needs room on the disk: 4 bytes for a height as float, 2 for a number of steps.
    needed = work_bytes(lattice, 4 if wanted.steps is None else 2) if work is None else None
    settings = source.settings
    remedy = (FEWER if settings.source in LANDS else DOUBT).format(settings.name)
    if source.raster.format == MOSAIC:
        remedy = COARSER + (WITHOUT_HOLES if settings.holes else "")
    with open_draft(path, wanted.folder.name, lattice, needed, doubt=remedy) as draft:
        yield draft, work


def count_tiles(size: Sequence[int]) -> int:
    """Return the number of tiles of an import of all samples. size: columns and rows of the raster."""
    columns, rows = (max(count, 2) for count in size)
    return len(TileGrid(lattice_for(columns, rows), TILE_BITS))


def work_of(folder: Path, source: TileSource, lattice: Lattice, digest: str) -> TileWork:
    """Return the description of an import's work before anything is done: its folder, tiles and stored type.

    Its `steps` convert stored 16-bit numbers to heights, None for heights stored as floats. Its `corner` is where the
    first sample is, by which an import of a mosaic with another extent finds the same tiles. folder: of the arrays, in
    the store's folder. digest: of the settings and sources.
    """
    bits = TILE_BITS if source.coarse is None else refining.BITS  # log2 of the cells along a tile
    return TileWork(
        folder,
        grid=TileGrid(lattice, bits),
        steps=_steps_of(source),
        holes=source.settings.holes,
        digest=digest,
        corner=_corner_of(source, lattice),
    )


def _corner_of(source: TileSource, lattice: Lattice) -> tuple[float, float] | None:
    """Return the position of a mosaic's south-western sample in its coordinate system, in samples along x and y.

    By it an import with another extent finds the tiles that both have. None for other rasters, and for a quick import,
    whose samples depend on the whole extent.
    """
    place = source.place
    if source.raster.inputs is None or place.across is None or place.up is None:
        return None
    # across, up: steps along a row and a column in units of the system, here along x and y
    x, y = place.middle[0] / place.across[0], place.middle[1] / place.up[1]
    return x - 0.5 * lattice.cells_x, y - 0.5 * lattice.cells_y


def _continued(wanted: TileWork) -> TileWork | None:
    """Return the unfinished work of a killed import with the same tiles, moved to the wanted folder; None for none."""
    work = find_work(wanted)
    if work is None:
        return None
    os.rename(work.folder, wanted.folder)
    return work_in(wanted.folder)


def find_work(wanted: TileWork) -> TileWork | None:
    """Return work of the same import in the store, which can be continued and no process has locked; None for none."""
    path = wanted.folder.parent
    for folder in path.glob(f"{store_folder.DATA_PREFIX}*"):
        with suppress(OSError):
            # The named folder is the content of a finished store, all others were begun.
            if store_folder.is_array_folder(folder) and folder != store_folder.named_folder(path):
                work = None if partial_files.is_in_use(folder) else work_in(folder)
                if work is not None and work.digest == wanted.digest and _has_same_tiles(work, wanted):
                    if work.can_be_continued():
                        return work
    return None


def _has_same_tiles(work: TileWork, wanted: TileWork) -> bool:
    """Return whether a work has the tiles and the stored type of a wanted one; one with floats has any type."""
    is_same = (work.grid, work.holes) == (wanted.grid, wanted.holes)
    return is_same and (work.steps is None or work.steps == wanted.steps)


def start_work(work: TileWork | None, draft: Draft, wanted: TileWork, source: TileSource) -> TileWork:
    """Return an earlier work, or else the wanted one with reused results of the store that it replaces.

    Its arrays are attached to the draft, in whose folder it is.
    """
    if work is None:
        work = wanted
        _begin(work, draft, source)
    else:
        work.attach(draft)
    source.raster.finish(draft.folder)  # other processes read the catalogue of a mosaic there
    return work


def _steps_of(source: TileSource) -> codes.Steps | None:
    """Return the conversion of 16-bit samples to heights; None for heights that are stored as floats.

    Interpolated heights of coarse land need floats.
    """
    if source.coarse is not None:
        return None
    return codes.steps_of(np.dtype(source.raster.stored), *scaling_of(source.raster, source.settings))


def _begin(work: TileWork, draft: Draft, source: TileSource) -> None:
    """Begin a new work in a draft's folder, with copies of results of the store at its path that can be used again.

    The store must have the same stored type of heights and use of holes, and the same tiles or, as a mosaic with
    another extent, some of them.
    """
    folder = store_folder.named_folder(draft.path)
    before = None if folder is None else work_in(folder)
    # Tiles by which those of the store are further east and north in the new raster; None if they do not coincide.
    moved = None if before is None else tiles_moved(before, work)
    has_same_tiles = before is not None and moved == (0, 0) and before.grid == work.grid
    if before is not None and has_same_tiles:
        with suppress(OSError, ValueError, TerrainError):  # then everything is made anew
            work.copy(before, unit_count(work.grid, source))
    work.attach(draft)  # makes the arrays that were not copied
    if before is not None and moved is not None and not has_same_tiles:
        with suppress(OSError, TerrainError):
            copy_moved(before, work, moved)
    work.make_sparse("missing")  # marks of missing samples: zeros that take no room
    if len(work.grid) > 1 or source.raster.finer is not None:
        work.describe()  # from now on a later import can continue it, which is not worth it for a single tile
