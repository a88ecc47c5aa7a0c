# SPDX-License-Identifier: GPL-3.0-or-later
"""A process that flies over a store and says what stayed in memory: `resident STORE PX`.

Megabytes count from before the store was opened: `open_` after opening it, the others after the flight; `own` is memory
of the process, `mapped` are pages of files.
"""

import json
import statistics
import sys

from ...cbt_terrain.field.store import open_store
from . import scenes
from .child import resident_mb
from .measure import BLOCKS, RUNS


def main(store: str, px: float) -> dict:
    before = resident_mb()
    field = open_store(store)
    opened = resident_mb()
    side = (field.lattice.width - 1) * field.lattice.step_x
    flight = scenes.Flight(field, lambda frame: scenes.over(frame, side), scenes.errors(px))
    first_ms = flight()["total"]
    frames = [flight()["total"] for _ in range(BLOCKS * RUNS)]
    after = resident_mb()
    said = {"first_ms": first_ms, "frame_ms": statistics.median(frames)}
    if before is not None:
        said |= {f"open_{kind}_mb": opened[kind] - before[kind] for kind in before}
        said |= {f"{kind}_mb": after[kind] - before[kind] for kind in before}
    return said


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1], float(sys.argv[2]))))
