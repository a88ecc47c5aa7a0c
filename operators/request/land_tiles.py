# SPDX-License-Identifier: GPL-3.0-or-later
"""Which tiles of a shaped store its views have asked for: written beside it, since less may have been worth making."""

import hashlib
import json
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...cbt_terrain.ask.view import View
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.land.tiles import tiles_seen
from ...cbt_terrain.run import owned_files
from ...cbt_terrain.run.named_file import read_regular
from ...cbt_terrain.run.partial_files import written_beside

# By level: of each tile, metres by which its heights may be off.
Tiles = list[dict[int, float]]


MAX_BYTES = 1 << 26


@dataclass(frozen=True, eq=False)
class Seen:
    """Views of a terrain that stands at `placement`, float64 [4, 4]; the other numbers are those of `tiles_seen`."""

    views: tuple[View, ...]
    placement: np.ndarray
    error_px: float
    vertical_scale: float
    vertical_offset: float

    def tiles(self, source: HeightField) -> Tiles:
        scale = self.vertical_scale, self.vertical_offset
        return tiles_seen(source, self.views, self.placement, self.error_px or 1.0, *scale)


def _file(folder: str) -> Path:
    return Path(f"{folder}.json")


def known(folder: str) -> Tiles:
    """What the store in `folder` was asked for; [] where that is not known, or damaged."""
    try:
        digest, text = read_regular(_file(folder), MAX_BYTES, links=False).decode("utf-8").split("\n", 1)
        levels = json.loads(text) if digest == _digest(text) else []
    except (OSError, ValueError):
        return []
    return [dict(map(tuple, level)) for level in levels]


def _digest(text: str) -> str:
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


def has(folder: str, wanted: Tiles | None) -> bool:
    """Whether a store that is there was asked for these tiles, as exactly."""
    if wanted is None:
        return True
    there = known(folder)
    return len(there) == len(wanted) and all(
        before.get(tile, np.inf) <= metres
        for before, level in zip(there, wanted, strict=True)
        for tile, metres in level.items()
    )


def with_known(folder: str, wanted: Tiles | None) -> Tiles | None:
    """With what was asked for before: what one frame needs does not go for the next."""
    there = known(folder)
    if wanted is None or len(there) != len(wanted):
        return wanted
    pairs = zip(there, wanted, strict=True)
    return [
        {tile: min(before.get(tile, np.inf), level.get(tile, np.inf)) for tile in before | level}
        for before, level in pairs
    ]


def note(folder: str, wanted: Tiles | None) -> None:
    """Write down what a store was asked for; one in a folder that cannot be written is asked again."""
    if wanted is not None:
        with suppress(OSError), written_beside(_file(folder)) as partial:
            text = json.dumps([sorted(level.items()) for level in wanted])
            partial.write_text(f"{_digest(text)}\n{text}")


def forget(folder: str) -> None:
    with suppress(OSError):
        owned_files.remove_file(_file(folder))
