# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimates of the cost of shaping land: in one piece or in tiles, and in seconds on this machine."""

from collections.abc import Iterable
from contextlib import suppress
from math import inf
from pathlib import Path

from ..errors import TerrainError
from ..field import store as stores
from ..field import store_folder
from ..field.lattice import Lattice, fit
from ..view.linear import add_up
from . import requested_tiles
from .catalogue import RENAMED
from .land_folder import folder_beside, is_land_name
from .level_plan import MAX_WHOLE, LevelPlan
from .preview import Preview
from .stack import Stack
from .tiles import Wanted, all_tiles, levels_of, whole_land

# Part of all tiles that a shot is assumed to see. The frames of a shot are not known where land is chosen, and all of
# them need the same land on every machine, because tiles of some operators differ from land in one piece.
SHOT = 0.5
MAX_ESTIMATED = 8193  # samples a side; the plan of more tiles takes too long for a panel
NUM_EARLIER = 3  # newest shaped stores that are read for measured times
# Nanoseconds on one thread: of measuring a sample's errors, and of a planned nanosecond of operators (measured: 1.0 to
# 2.1, least for land in one piece).
BUILD_NS, PLANNED_NS = 240.0, 1.3


def costs_less_whole(lattice: Lattice, stack: Stack) -> bool:
    """Return whether the whole land in one piece costs less than the tiles of a shot with their margins."""
    return _costs_less_whole(lattice, stack, all_tiles(lattice), SHOT)


def costs_less_whole_than(lattice: Lattice, stack: Stack, folder: str, wanted: Wanted) -> bool:
    """Return whether the whole land in one piece costs less than the wanted tiles that its folder lacks.

    folder: the derived store's. wanted: by level the errors, metres, that tiles may have, None for a level in one
    piece.
    """
    before = requested_tiles.read_requested(folder) or [{} for _ in wanted]
    new = [  # None, a level in one piece, stays; of other levels tiles that are not yet so accurate remain
        level and {tile: error for tile, error in level.items() if not known.get(tile, inf) <= error}
        for known, level in zip(before, wanted, strict=True)
    ]
    return _costs_less_whole(lattice, stack, new)


def _costs_less_whole(lattice: Lattice, stack: Stack, tiles: Wanted, fraction: float = 1.0) -> bool:
    """Return whether the whole land costs at most as much as a fraction of the tiles with their margins.

    The costs are equal where a raster is a single tile. With a fraction of 1 the whole land is then preferred, since
    exports can use it, too. Land of more than MAX_WHOLE
    samples a side is not made in one piece, so the result is False.
    """
    if max(lattice.width, lattice.height) > MAX_WHOLE:
        return False
    total = _plan_levels(lattice, stack, tiles).total
    return _plan_levels(lattice, stack, whole_land(lattice)).total <= fraction * total


def lattice_of(source: str) -> Lattice:
    """Return the lattice of a store without opening its arrays. Raises TerrainError."""
    return fit(**stores.read_json(Path(source))["lattice"])


def estimate_seconds(source: str, stack: Stack, preview: Preview | None, in_tiles: bool) -> float | None:
    """Return the seconds that shaping a store will take; None without anything measured, and for very large land.

    Times of earlier land of this store count, or else those of the preview of the stack. in_tiles: shape all tiles one
    by one, the most that a shot can need; else the whole land in one piece.
    """
    lattice = lattice_of(source)
    if max(lattice.width, lattice.height) > MAX_ESTIMATED:
        return None
    plan = _plan_levels(lattice, stack, all_tiles(lattice) if in_tiles else whole_land(lattice))
    # By operator the measured over the planned time; and the seconds of the latest run outside of operators.
    rates, other_s = _measured_rates(_read_earlier(source))
    if rates:
        mean = add_up(rates.values()) / len(rates)  # for operators that no earlier run had
        pairs = zip(stack.active, plan.costs, strict=True)
        return other_s + add_up(cost * rates.get(entry.effect, mean) for entry, cost in pairs) / 1e9
    if preview is None or preview.build_ms <= 0.0:
        return None
    # The preview's times are added: it is the coarsest level, where operators take many more steps than at finer ones.
    # `slowness` is 1 on one thread of the machine on which BUILD_NS was measured.
    slowness = preview.build_ms * 1e6 / (preview.field.samples.size * BUILD_NS)
    # BUILD_NS: measuring the errors of a sample. PLANNED_NS: measured time of a planned nanosecond of operators.
    building = (lattice.width * lattice.height + _finer_samples(source)) * BUILD_NS
    return add_up(preview.ms) / 1e3 + slowness * (PLANNED_NS * plan.total + building) / 1e9


def _finer_samples(source: str) -> float:
    """Return the cost of the finer tiles of the store `source`, as a number of raster samples. Raises TerrainError.

    Measuring the errors of that many raster samples takes the same time; COST is that of one finer sample.
    """
    from ..field.finer_tiles import SIDE
    from .finer_land import COST

    tiles = stores.read_json(Path(source)).get("finer", {}).get("tiles", 0)
    return COST * SIDE * SIDE * tiles


def _plan_levels(lattice: Lattice, stack: Stack, wanted: Wanted) -> LevelPlan:
    """Return the plan of shaping a raster of this lattice; wanted: tiles of each level, None for whole levels."""
    return LevelPlan(levels_of(lattice), stack.active, wanted)


def _read_earlier(source: str) -> list[dict]:
    """Return the JSON of the newest shaped stores of a source, the newest last."""
    newest = []
    with suppress(OSError):
        files = [
            folder / store_folder.JSON_NAME for folder in folder_beside(source).iterdir() if is_land_name(folder.name)
        ]
        newest = sorted((file.stat().st_mtime, file) for file in files if file.is_file())[-NUM_EARLIER:]
    contents = []
    for _, file in newest:
        with suppress(TerrainError):
            contents.append(stores.read_json(file.parent))
    return contents


def _measured_rates(earlier: Iterable[dict]) -> tuple[dict[str, float], float]:
    """Return measured over planned time of each effect, and the seconds that the last land took besides its effects.

    earlier: contents of store.json of shaped land, the latest last. Of each effect its latest run counts, and of that
    the levels of which no piece was cached.
    """
    rates, other_s = {}, 0.0
    for content in earlier:
        with suppress(KeyError, TypeError, AttributeError, ZeroDivisionError):  # a provenance may hold anything
            added = content["provenance"]["shaped"]["added"]
            # `made` pieces of an effect at a level, of which `computed` were not cached.
            new = [one for one in added if one["computed"] == one["made"] > 0 and one["planned_ms"] > 0.0]
            for effect in {one["effect"] for one in new}:
                ms, planned = (add_up(o[name] for o in new if o["effect"] == effect) for name in ("ms", "planned_ms"))
                rates[RENAMED.get(effect, effect)] = ms / planned  # under its present name, if an old version wrote it
            other_s = max(content["report"]["seconds"] - add_up(one["ms"] for one in added) / 1e3, 0.0)
    return rates, other_s
