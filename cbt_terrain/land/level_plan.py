# SPDX-License-Identifier: GPL-3.0-or-later
"""What is to be done at each level: how each effect is applied there, to which tiles, and about how long it takes."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from .stack import Entry
from .tiles import BAND, Level, Wanted, closed, every_tile

# How an effect is applied at a level: to all of it, to tiles, or not at all: then its coarser change is taken.
WHOLE, TILES, UPSAMPLED = "WHOLE", "TILES", "UPSAMPLED"
# Samples along the longer side of the finest level that is worked on as a whole: where the whole is asked for; and, by
# effects that look at all of it, where tiles are.
MOST_WHOLE, MOST_WHOLE_FOR_SOME = 4097, 2049


class LevelPlan:
    """`total`: of the costs, in nanoseconds on one thread, as far as declarations know."""

    def __init__(self, levels: Sequence[Level], entries: Sequence[Entry], wanted: Wanted):
        self.levels, self.entries = levels, entries
        self.asked_whole = [tiles is None for tiles in wanted]
        wanted = [every_tile(level) if tiles is None else tiles for level, tiles in zip(levels, wanted, strict=True)]
        halo = [np.max([(0, 0), *(self.halo(e, level) or (0, 0) for e in entries)], axis=0) for level in levels]
        self.needed = closed(levels, wanted, halo)
        self.total = sum(self._cost(entry, level) for entry in entries for level in levels)

    def halo(self, entry: Entry, level: Level) -> tuple[int, int] | None:
        """Rows and columns that an effect looks beyond a tile of a level; None where only all of it will do."""
        metres = entry.declaration.halo(entry.values, max(level.step_x, level.step_y))
        return None if math.isinf(metres) else (math.ceil(metres / level.step_y), math.ceil(metres / level.step_x))

    def how(self, entry: Entry, level: Level) -> str:
        """How an effect is applied at a level. Whether in tiles is said by who asks, not by how many that happens to
        be: so that tiles of a shot do not change when it sees all of them."""
        finest, longer = entry.declaration.finest, max(level.shape)
        if finest and longer > finest and level is not self.levels[-1]:
            return UPSAMPLED
        if level.is_whole or (self.asked_whole[level.number] and longer <= MOST_WHOLE):
            return WHOLE  # for all tiles together their halos would be several times the work
        if self.halo(entry, level) is not None:
            return TILES
        return WHOLE if longer <= MOST_WHOLE_FOR_SOME else UPSAMPLED

    def cost(self, entry: Entry, level: Level, tile: int | None) -> float:
        """Of a tile, or of a whole level."""
        shape = level.shape
        if tile is not None:
            rows, columns = self.halo(entry, level)
            shape = [part.stop - part.start for part in level.window(tile, BAND + rows, BAND + columns)]
        return shape[0] * shape[1] * max(entry.declaration.cost_ns, 1.0)

    def _cost(self, entry: Entry, level: Level) -> float:
        tiles, how = self.made_with(level, self.needed[level.number]), self.how(entry, level)
        if how == UPSAMPLED or not (level.is_whole or tiles):
            return 0.0
        return self.cost(entry, level, None if how == WHOLE else min(tiles)) * (1 if how == WHOLE else len(tiles))

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
