# SPDX-License-Identifier: GPL-3.0-or-later
"""The plan of applying a stack: how each operator is applied at each level, to which tiles, and its estimated cost.

An *entry* is one operator of the stack with its parameters, here numbered by its index. Its *halo* is what it reads
around a tile. Tiles are blended with their neighbours over BAND samples on both sides of their borders, so a tile is
computed BAND samples wider than it is.
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from ..view.linear import add_up
from .mask_reads import SHAPES
from .stack import Entry
from .tiles import BAND, Level, Wanted, Window, add_coarser, every_tile

# An operator is applied to a whole level, to tiles, or not at all; its coarser change is then interpolated.
WHOLE, TILES, UPSAMPLED = "WHOLE", "TILES", "UPSAMPLED"
# Samples along the longer side of the finest level that is computed as a whole if the whole is requested or tiles are
# doubted; and, by operators without a finite halo, if only tiles are requested.
MAX_WHOLE, MAX_WHOLE_FOR_TILES = 4097, 2049


class LevelPlan:
    """How entries are applied at each level, and the cost of that in nanoseconds on one thread.

    Lists are indexed by the level's number. levels: the finest first. wants_whole: whether all of a level is requested.
    wanted: requested tiles with their allowed error in metres. needed: these and those that they start from. costs,
    total: of each entry and of all. doubted: numbers of entries whose tiles differ too much from a level in one piece;
    their finer levels are computed in one piece if possible.
    """

    def __init__(self, levels: Sequence[Level], entries: Sequence[Entry], wanted: Wanted) -> None:
        """Plan the levels, finest first; wanted: tiles of each level by index, None for all."""
        self.levels, self.entries = levels, entries
        self.wants_whole = [tiles is None for tiles in wanted]
        self.wanted = [
            every_tile(level) if tiles is None else tiles for level, tiles in zip(levels, wanted, strict=True)
        ]
        self.doubted: set[int] = set()  # indices of entries (see `doubt`)
        self._plan_work()  # sets `needed`, `costs` and `total`

    def _plan_work(self) -> None:
        """Set the tiles that each level needs for finer ones, and the nanoseconds planned for entries and in total."""
        self.needed = add_coarser(self.levels, self.wanted, [self._max_halo(level) for level in self.levels])
        self.costs = [0.0] * len(self.entries)
        for level in self.levels:
            self._add_costs(level)
        self.total = add_up(self.costs)

    def doubt(self, number: int) -> None:
        """Note that the change of an entry contradicts the coarser level (see HeightOperator.doubts).

        From the next finer level on the entry is applied to whole levels instead of tiles. number: its index.
        """
        self.doubted.add(number)
        self._plan_work()

    def halo(self, entry: Entry, level: Level) -> tuple[int, int] | None:
        """Return the rows and columns that an operator reads beyond a tile of a level, None if it reads all of it."""
        metres = entry.declaration.halo(entry.values, max(level.step_x, level.step_y))
        return None if math.isinf(metres) else (math.ceil(metres / level.step_y), math.ceil(metres / level.step_x))

    def how(self, number: int, level: Level) -> str:
        """Return how an entry is applied at a level: WHOLE, TILES or UPSAMPLED.

        A request for tiles is computed in tiles even if it lists all of them, so that tiles in view of a moving camera
        do not change once it has seen every one.
        """
        entry = self.entries[number]
        # `finest`: largest side of levels that the operator is applied to, 0 for no limit.
        finest, longer = entry.declaration.finest, max(level.shape)
        if finest and longer > finest and level is not self.levels[-1]:
            return UPSAMPLED
        # Levels that are small or narrow (`is_whole`) always come in one piece, others on request or after a doubt.
        one_piece = self.wants_whole[level.number] or number in self.doubted
        if level.is_whole or (one_piece and longer <= MAX_WHOLE):
            return WHOLE  # the halos of all tiles would be several times the work
        if self.halo(entry, level) is not None:  # else the operator reads the whole level
            return TILES
        return WHOLE if longer <= MAX_WHOLE_FOR_TILES else UPSAMPLED

    def runs(self, level: Level) -> list[list[int]]:
        """Group the numbers of the entries into runs, for example [[0], [1, 2], [3]].

        An entry that is applied to a whole level is a run by itself. The entries between two of these form a run that
        is applied within each tile, which reads nothing of other tiles. A mask that reads the whole level starts a run.
        """
        runs: list[list[int]] = []
        for number, entry in enumerate(self.entries):
            is_whole = self.how(number, level) == WHOLE
            reads_whole = entry.mask is not None and any(rule.of in SHAPES for rule in entry.mask.rules)
            if is_whole or reads_whole or not runs or self.how(runs[-1][-1], level) == WHOLE:
                runs.append([])
            runs[-1].append(number)
        return runs

    def margins(self, level: Level, numbers: Sequence[int]) -> list[tuple[int, int]]:
        """Return how many rows and columns around a tile each entry of a run reads, and last those of its result: BAND.

        Each entry computes the region that the next one reads, so the first one reads the widest: with halos of 5 and 2
        rows [BAND + 7, BAND + 2, BAND]. numbers: the run's entries, by index.
        """
        margins = [(BAND, BAND)]
        for number in reversed(numbers):
            halo = self.halo(self.entries[number], level) if self.how(number, level) == TILES else None
            rows, columns = halo or (0, 0)
            margins.append((margins[-1][0] + rows, margins[-1][1] + columns))
        return margins[::-1]

    def _max_halo(self, level: Level) -> tuple[int, int]:
        """Return the largest number of rows and columns beyond a tile and its BAND that a run reads."""
        first = [self.margins(level, numbers)[0] for numbers in self.runs(level)]  # the widest of each run
        rows, columns = np.max([(BAND, BAND), *first], axis=0) - BAND
        return int(rows), int(columns)

    def cost(self, entry: Entry, window: Window) -> float:
        """Return the nanoseconds of an entry on a window of a level, on one thread."""
        rows, columns = (axis.stop - axis.start for axis in window)
        return rows * columns * max(entry.declaration.cost_ns, 1.0)

    def _add_costs(self, level: Level) -> None:
        """Add the planned nanoseconds of all entries at a level."""
        tiles = self.with_neighbours(level, self.needed[level.number])
        for numbers in self.runs(level) if level.is_whole or tiles else ():
            # Without the last margin, which is that of the run's result.
            for number, margin in zip(numbers, self.margins(level, numbers)[:-1], strict=True):
                entry, how = self.entries[number], self.how(number, level)
                if how == WHOLE:
                    self.costs[number] += self.cost(entry, level.whole)
                elif how == TILES:  # every tile is counted like the first; UPSAMPLED costs nothing
                    self.costs[number] += len(tiles) * self.cost(entry, level.window(min(tiles), *margin))

    def choose_tiles(self, level: Level, max_change: np.ndarray | None, uncertain: np.ndarray | None) -> list[int]:
        """Return the needed tiles of a level where its change may exceed the allowed error.

        For a level in one piece these are all. max_change: float64 [tiles of the next coarser level], largest change
        there, metres; finer levels change heights less. uncertain: bool [tiles of the next coarser level], where that
        does not hold. Both are None at the coarsest level.
        """
        needed = self.needed[level.number]
        if max_change is None or uncertain is None or level.is_whole:
            return list(needed)
        parents = {tile: level.parent(tile) for tile in needed}
        return [t for t, need in needed.items() if uncertain[parents[t]] or max_change[parents[t]] > need.metres]

    def with_neighbours(self, level: Level, chosen: Iterable[int]) -> list[int]:
        """Return the chosen tiles and those of the same level that their finer tiles start from."""
        return sorted(frozenset().union(*(self.needed[level.number][tile].tiles for tile in chosen)))
