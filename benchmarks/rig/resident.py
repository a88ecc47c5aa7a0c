# SPDX-License-Identifier: GPL-3.0-or-later
"""Program that flies over a store and prints the memory it keeps: `resident STORE PX`.

Megabytes are differences to the memory before the store was opened, after opening it (`open_`) and after the flight.
"""

import json
import statistics
import sys

from ...cbt_terrain.field.store import open_store
from . import scenes
from .child import resident_mb
from .measure import BLOCKS, RUNS


def main(store: str, px: float) -> dict:
    """Return milliseconds of the first frame and of the others, and megabytes where the system reports them."""
    before = resident_mb()
    field = open_store(store)
    opened = resident_mb()
    side = (field.lattice.width - 1) * field.lattice.step_x
    flight = scenes.TimedFlight(field, lambda frame: scenes.over(frame, side), scenes.errors(px))
    first_ms = flight()["total"]
    frames = [flight()["total"] for _ in range(BLOCKS * RUNS)]
    after = resident_mb()
    result = {"first_ms": first_ms, "frame_ms": statistics.median(frames)}
    if before is not None:
        result |= {f"open_{kind}_mb": opened[kind] - before[kind] for kind in before}
        result |= {f"{kind}_mb": after[kind] - before[kind] for kind in before}
    return result


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1], float(sys.argv[2]))))
