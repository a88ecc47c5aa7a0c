# SPDX-License-Identifier: GPL-3.0-or-later
"""Warnings about files that later files hide, or that cut-out gaps leave nothing of, by their headers alone.

A Composite has the files (tiles) of a mosaic in the order of their priority. By their number in it, the rank, it also
has their boxes in columns and rows of the target grid, and the steps of their samples in samples of that grid. A
lattice is a grid that several files share.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import shown
from .catalogue import SourceTile
from .composite import Composite
from .insets import overlapping_pairs
from .lattices import TileLattice
from .systems import projected

STEP_TOLERANCE = 0.01  # steps that differ by less count as equal, as those of degrees in neighbouring zones
SIDE_POINTS = 24  # along each axis of a file, at which later files are looked for
BESIDE = 0.51  # of a sample around files that have neighbouring samples
HIDDEN_FRACTION = 0.5  # of a finer file below coarser ones, from which on it is warned about


class HiddenFile(NamedTuple):
    """A file below others.

    Attributes:
        rank: the file.
        upper: rank of the file that covers most of it.
        fraction: part of the file that is covered, 0 to 1.
    """

    rank: int
    upper: int
    fraction: float


def hidden_warnings(composite: Composite) -> list[str]:
    """Return warnings about files that later files hide or replace; [] without any.

    There are three kinds: files whose samples have the positions of a later file's, finer files largely below coarser
    ones, and files wholly below files that are not finer. A coarser file below finer ones fills their gaps.
    """
    replaced = _replaced_files(composite)  # by rank
    # Ranks of the files of all pairs whose boxes meet; `upper` is the later one.
    lower, upper = np.array(overlapping_pairs(composite.boxes), np.int64).reshape(-1, 2).T
    ratios = composite.steps[upper] / composite.steps[lower]
    is_coarser = ratios > 1 + STEP_TOLERANCE
    finer = _hidden_files(composite, lower[is_coarser], upper[is_coarser], min_fraction=HIDDEN_FRACTION)
    # Another file has no effect if files of its step and of larger ones, together, cover all of it.
    is_named = np.isin(lower, [*replaced, *(file.rank for file in finer)])
    is_left = (ratios >= 1 - STEP_TOLERANCE) & ~is_named
    without_effect = _hidden_files(composite, lower[is_left], upper[is_left], min_fraction=1.0)
    return [
        *_finer_warnings(composite, finer),
        *_effect_warnings(composite, without_effect),
        *_replaced_warnings(composite, replaced),
    ]


def thin_warnings(composite: Composite) -> list[str]:
    """Return a warning about files that are one sample wide and beside no other, if gaps are cut out; [] without any.

    Nothing is left of them, since a cell of ground has four samples.
    """
    around = np.maximum(composite.steps, 1.0)[:, None] * BESIDE
    boxes = composite.boxes + np.concatenate([-around, -around, around, around], axis=1)
    has_neighbour = set(np.array(overlapping_pairs(boxes), np.int64).ravel().tolist())
    # A file with larger steps than the grid's gives heights to several samples of it.
    thin = [
        rank
        for rank, tile in enumerate(composite.tiles)
        if min(tile.width, tile.height) == 1
        and rank not in has_neighbour
        and composite.steps[rank] < 1 + STEP_TOLERANCE
    ]
    if not thin:
        return []
    name = shown(Path(composite.tiles[thin[0]].path).name)
    which = f"{name} is" if len(thin) == 1 else f"{len(thin):,} files, such as {name}, are"
    return [
        f"{which} one sample wide and beside no other file, so nothing is left of {'it' if len(thin) == 1 else 'them'} "
        "where no-data is cut out. To keep such a file, fill no-data (untick Cut Out No-Data, or leave out --holes)."
    ]


def _hidden_files(composite: Composite, lower: np.ndarray, upper: np.ndarray, min_fraction: float) -> list[HiddenFile]:
    """Return the files of which later files cover at least `min_fraction`, 0 to 1, in the order of their ranks.

    lower, upper: ranks of each pair of files whose boxes meet, `lower` ascending.
    """
    half = composite.steps[:, None] / 2
    low, high = composite.boxes[:, :2] - half, composite.boxes[:, 2:] + half
    sides = np.minimum(high[lower], high[upper]) - np.maximum(low[lower], low[upper])
    fractions = np.maximum(sides, 0.0).prod(axis=1) / (high - low).prod(axis=1)[lower]
    # `fractions`: that of the lower box in each upper one. The box of a turned file has up to twice its area, so half
    # of the fraction is enough here; boxes only tell which files need a closer look.
    is_possible = np.bincount(lower, fractions, minlength=len(composite.tiles)) >= min_fraction / 2
    places = {int(n): (lattice, k) for lattice in composite.lattices for k, n in enumerate(lattice.tiles)}
    hidden = []
    for rank in np.flatnonzero(is_possible).tolist():
        pairs = slice(*np.searchsorted(lower, [rank, rank + 1]))  # those with this file below
        largest_first = upper[pairs][np.argsort(-fractions[pairs], kind="stable")]
        file = _cover_of(composite.tiles[rank], rank, {int(n): places[n] for n in largest_first})
        hidden += [file] if file.fraction >= min_fraction else []
    return hidden


def _cover_of(tile: SourceTile, rank: int, uppers: dict[int, tuple[TileLattice, int]]) -> HiddenFile:
    """Return how much of a file others cover, by evenly spread points.

    tile, rank: the file. uppers: by rank, the lattice of each other file and the file's number in it; the file that
    probably covers most comes first.
    """
    columns, rows = np.linspace(0, tile.width - 1, SIDE_POINTS), np.linspace(0, tile.height - 1, SIDE_POINTS)
    x, y = (values.ravel() for values in tile.position(*np.meshgrid(columns, rows)))
    in_system: dict[str, tuple] = {}  # the points by the name of the system
    is_covered = np.zeros(len(x), bool)
    counts = {}  # covered points by the rank of the file that covers them
    for upper, (lattice, number) in uppers.items():
        if lattice.crs not in in_system:
            in_system[lattice.crs] = projected(tile.crs, lattice.crs, x, y)
        is_inside = lattice.covers(number, *in_system[lattice.crs])
        counts[upper] = int(is_inside.sum())
        is_covered |= is_inside
        if is_covered.all():
            break
    return HiddenFile(rank, upper=max(counts, key=counts.__getitem__), fraction=float(is_covered.mean()))


def _names(composite: Composite, file: HiddenFile) -> tuple[str, str]:
    """Return the names of a hidden file and of the one that covers most of it."""
    lower, upper = (shown(Path(composite.tiles[rank].path).name) for rank in (file.rank, file.upper))
    return lower, upper


def _finer_warnings(composite: Composite, hidden: list[HiddenFile]) -> list[str]:
    """Return a warning about finer files of which coarser ones cover most; [] without any."""
    if not hidden:
        return []
    worst = max(hidden, key=lambda file: file.fraction)
    name, upper = _names(composite, worst)
    covered = f"{int(100 * worst.fraction)} % of {'it' if len(hidden) == 1 else name}"
    which = f"{name} lies" if len(hidden) == 1 else f"{len(hidden):,} files, such as {name}, lie"
    return [
        f"{which} below coarser files, such as {upper}, which cover {covered}, so only gaps in those show its heights "
        "there. Name the finer files last, or set Overlaps to Finest File (--priority resolution)."
    ]


def _effect_warnings(composite: Composite, hidden: list[HiddenFile]) -> list[str]:
    """Return a warning about files without an effect below files that are not finer; [] without any."""
    if not hidden:
        return []
    name, upper = _names(composite, hidden[0])
    which = f"{name} has" if len(hidden) == 1 else f"{len(hidden):,} files, such as {name}, have"
    return [
        f"{which} no effect except in gaps of later files, such as {upper}, which cover all of "
        f"{'it' if len(hidden) == 1 else name}. To use such a file, name it last (Overlaps: Last File, --priority "
        "order); otherwise leave it out."
    ]


def _replaced_files(composite: Composite) -> dict[int, int]:
    """Return the ranks of files whose samples have the positions of a later file's, each with the last such file."""
    last: dict[tuple, int] = {}  # the file of the highest priority at each place
    replaced = {}
    for rank in range(len(composite.tiles) - 1, -1, -1):
        tile = composite.tiles[rank]
        upper = last.setdefault((tile.crs, tile.transform, tile.width, tile.height), rank)
        if upper != rank:
            replaced[rank] = upper
    return replaced


def _replaced_warnings(composite: Composite, replaced: dict[int, int]) -> list[str]:
    """Return a warning about files that others replace, because their samples have the same positions.

    replaced: ranks of these files, each with the rank of the last file that replaces it.
    """
    if not replaced:
        return []
    rank = min(replaced)
    name, other = _names(composite, HiddenFile(rank, replaced[rank], fraction=1.0))
    more = f", and {len(replaced) - 1:,} more files are replaced so" if len(replaced) > 1 else ""
    return [
        f"{other} has all its samples at the places of those of {name}, and replaces these "
        f"except where it has no data{more}. If it holds no heights (a mask, a count of scenes), unpack or name only "
        "files of heights."
    ]
