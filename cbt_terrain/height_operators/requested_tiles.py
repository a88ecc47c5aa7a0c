# SPDX-License-Identifier: GPL-3.0-or-later
"""The tiles that were requested of a derived store, in a file next to it. The store may hold fewer of them."""

import hashlib
import json
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..field.heightfield import HeightField
from ..run import owned_files
from ..run.named_file import read_regular
from ..run.partial_files import written_beside
from ..view.view import View
from .tiles import tiles_seen

# For each level: the tolerated error of each tile in metres.
Tiles = list[dict[int, float]]

MAX_BYTES = 1 << 26


@dataclass(frozen=True, eq=False)
class SeenTiles:
    """Views of a terrain at `placement`, float64 [4, 4], with the other arguments of `tiles_seen`.

    `error_px`: requested error in pixels, 0 if none is requested. Heights are multiplied by `vertical_scale`, then
    `vertical_offset` metres are added.
    """

    views: tuple[View, ...]
    placement: np.ndarray
    error_px: float
    vertical_scale: float
    vertical_offset: float

    def tiles(self, source: HeightField) -> Tiles:
        """Return the tiles that these views need, for an error of 1 pixel if none is requested."""
        scale = self.vertical_scale, self.vertical_offset
        return tiles_seen(source, self.views, self.placement, self.error_px or 1.0, *scale)


def _record_file(folder: str) -> Path:
    """Return the file beside a store that records its requested tiles."""
    return Path(f"{folder}.json")


def read_requested(folder: str) -> Tiles:
    """Return the tiles that were requested of a store, [] if the record is missing or damaged.

    The result is a list of levels from fine to coarse, each with the allowed error in metres by tile.
    """
    try:
        digest, text = read_regular(_record_file(folder), MAX_BYTES, links=False).decode("utf-8").split("\n", 1)
        levels = json.loads(text) if digest == _digest(text) else []
    except (OSError, ValueError):
        return []
    return [dict(map(tuple, level)) for level in levels]


def _digest(text: str) -> str:
    """Return the checksum of a record, by which damage is found."""
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


def has(folder: str, wanted: Tiles | None) -> bool:
    """Return whether a store was shaped with these tiles, at most with these errors, by its record; True for all tiles.

    folder: the store's. wanted: allowed error of each tile, metres, by level; None for all tiles.
    """
    if wanted is None:
        return True
    earlier = read_requested(folder)
    return len(earlier) == len(wanted) and all(
        before.get(tile, np.inf) <= metres
        for before, level in zip(earlier, wanted, strict=True)
        for tile, metres in level.items()
    )


def with_known(folder: str, wanted: Tiles | None) -> Tiles | None:
    """Return these tiles with those of earlier requests, so that land stays fine for other frames.

    A tile of both has the smaller error. A record with another number of levels does not count. folder: the shaped
    land's. wanted: allowed error of each tile, metres, by level; None for all tiles, which is returned.
    """
    earlier = read_requested(folder)
    if wanted is None or len(earlier) != len(wanted):
        return wanted
    pairs = zip(earlier, wanted, strict=True)
    return [
        {tile: min(before.get(tile, np.inf), level.get(tile, np.inf)) for tile in before | level}
        for before, level in pairs
    ]


def note(folder: str, wanted: Tiles | None) -> None:
    """Replace the record of the tiles that were requested of a store, if its folder can be written.

    Do nothing for None, all tiles.
    """
    if wanted is not None:
        with suppress(OSError), written_beside(_record_file(folder)) as partial:
            text = json.dumps([sorted(level.items()) for level in wanted])
            partial.write_text(f"{_digest(text)}\n{text}")


def remove_record(folder: str) -> None:
    """Remove the record of a store's requested tiles."""
    with suppress(OSError):
        owned_files.remove_file(_record_file(folder))
