# SPDX-License-Identifier: GPL-3.0-or-later
"""A process that makes one mesh of a store and says how long after its start: `first_mesh STORE PX STARTED`.

STARTED is the time of the clock (seconds since the epoch) at which it was started.
"""

import json
import sys
import time

from ...cbt_terrain.field.store import open_store
from ...cbt_terrain.terrain import Terrain
from . import scenes

if __name__ == "__main__":
    update = Terrain(open_store(sys.argv[1])).update(scenes.errors(float(sys.argv[2])), [scenes.over(0)])
    elapsed_ms = (time.time() - float(sys.argv[3])) * 1e3
    print(json.dumps({"elapsed_ms": elapsed_ms, "update_ms": update.ms["total"]}))
