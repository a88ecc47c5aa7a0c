# SPDX-License-Identifier: GPL-3.0-or-later
"""Program that makes one mesh of a store and prints the time since its start: `first_mesh STORE PX STARTED`.

STARTED is the start time of the process in seconds since the epoch.
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
