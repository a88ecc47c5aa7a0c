# SPDX-License-Identifier: GPL-3.0-or-later
"""What is to be done at each level: how each effect is applied there, to which tiles, and about how long it takes."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from ..ask.linear import add_up
from .mask_reads import SHAPES
from .stack import Entry
from .tiles import BAND, Level, Wanted, Window, closed, every_tile

# How an effect is applied at a level: to all of it, to tiles, or not at all: then its coarser change is taken.
WHOLE, TILES, UPSAMPLED = "WHOLE", "TILES", "UPSAMPLED"
# Samples along the longer side of the finest level that is worked on as a whole: where the whole is asked for, or tiles
# are doubted; and, by effects that look at all of it, where tiles are asked for.
MOST_WHOLE, MOST_WHOLE_FOR_SOME = 4097, 2049


class LevelPlan:
    """`total`: of the costs, in nanoseconds on one thread, as far as declarations know. `doubted`: numbers of entries
    whose tiles are not to be trusted: unless they are too large, their finer levels are made in one piece."""

    def __init__(self, levels: Sequence[Level], entries: Sequence[Entry], wanted: Wanted):
        self.levels, self.entries = levels, entries
        self.asked_whole = [tiles is None for tiles in wanted]
        every = zip(levels, wanted, strict=True)
        self.wanted = [every_tile(level) if tiles is None else tiles for level, tiles in every]
        self.doubted: set[int] = set()
        self._count()

    def _count(self) -> None:
        self.needed = closed(self.levels, self.wanted, [self._widest(level) for level in self.levels])
        self.total = add_up(self._cost(level) for level in self.levels)

    def doubt(self, number: int) -> None:
        """From the next finer level on: one that was made in one piece says so of an entry."""
        self.doubted.add(number)
        self._count()

    def halo(self, entry: Entry, level: Level) -> tuple[int, int] | None:
        """Rows and columns that an effect looks beyond a tile of a level; None where only all of it will do."""
        metres = entry.declaration.halo(entry.values, max(level.step_x, level.step_y))
        return None if math.isinf(metres) else (math.ceil(metres / level.step_y), math.ceil(metres / level.step_x))

    def how(self, number: int, level: Level) -> str:
        """How an entry is applied at a level. Whether in tiles is said by who asks, not by how many that happens to
        be: so that tiles of a shot do not change when it sees all of them."""
        entry = self.entries[number]
        finest, longer = entry.declaration.finest, max(level.shape)
        if finest and longer > finest and level is not self.levels[-1]:
            return UPSAMPLED
        at_once = self.asked_whole[level.number] or number in self.doubted
        if level.is_whole or (at_once and longer <= MOST_WHOLE):
            return WHOLE  # for all tiles together their halos would be several times the work
        if self.halo(entry, level) is not None:
            return TILES
        return WHOLE if longer <= MOST_WHOLE_FOR_SOME else UPSAMPLED

    def runs(self, level: Level) -> list[list[int]]:
        """The entries by their numbers: one that is applied to all of a level alone, those between together. These are
        applied one after the other within a tile, which so sees nothing of what was made of other tiles. A mask that
        has to see the whole begins a new run."""
        found = []
        for number, entry in enumerate(self.entries):
            alone = self.how(number, level) == WHOLE
            apart = entry.mask is not None and any(rule.of in SHAPES for rule in entry.mask.rules)
            if alone or apart or not found or self.how(found[-1][-1], level) == WHOLE:
                found.append([])
            found[-1].append(number)
        return found

    def margins(self, level: Level, numbers: Sequence[int]) -> list[tuple[int, int]]:
        """Of a run: rows and columns around a tile that its first entry looks at, that the next one does, and so on;
        and at the end what is asked for. Each makes what those after it look at."""
        found = [(BAND, BAND)]
        for number in reversed(numbers):
            more = self.halo(self.entries[number], level) if self.how(number, level) == TILES else (0, 0)
            found.append((found[-1][0] + more[0], found[-1][1] + more[1]))
        return found[::-1]

    def _widest(self, level: Level) -> tuple[int, int]:
        """Rows and columns beyond a tile and its BAND that any run looks at."""
        first = [self.margins(level, numbers)[0] for numbers in self.runs(level)]
        rows, columns = np.max([(BAND, BAND), *first], axis=0) - BAND
        return int(rows), int(columns)

    def cost(self, entry: Entry, window: Window) -> float:
        """Of a window of a level."""
        rows, columns = (part.stop - part.start for part in window)
        return rows * columns * max(entry.declaration.cost_ns, 1.0)

    def _cost(self, level: Level) -> float:
        tiles, total = self.made_with(level, self.needed[level.number]), 0.0
        for numbers in self.runs(level) if level.is_whole or tiles else ():
            for number, margin in zip(numbers, self.margins(level, numbers), strict=False):
                entry, how = self.entries[number], self.how(number, level)
                if how == WHOLE:
                    total += self.cost(entry, level.whole)
                elif how == TILES:
                    total += len(tiles) * self.cost(entry, level.window(min(tiles), *margin))
        return total

    def chosen_at(self, level: Level, most: np.ndarray | None, unsure: np.ndarray | None) -> list[int]:
        """The tiles of a level that are wanted, and where more is to be expected than the error that is allowed.

        most: float64 [tiles of the next coarser level] metres: what that has added at most; finer ones add less, but
        where it is `unsure`, bool likewise.
        """
        needed = self.needed[level.number]
        if most is None or level.is_whole:
            return list(needed)
        parents = {tile: level.parent(tile) for tile in needed}
        return [tile for tile, need in needed.items() if unsure[parents[tile]] or most[parents[tile]] > need.metres]

    def made_with(self, level: Level, chosen: Iterable[int]) -> list[int]:
        """All tiles of a level that are made if these are chosen."""
        return sorted(frozenset().union(*(self.needed[level.number][tile].tiles for tile in chosen)))
