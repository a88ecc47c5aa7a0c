# SPDX-License-Identifier: GPL-3.0-or-later
"""A small store and a flight over it, for tests of exports."""

import json
from pathlib import Path

import numpy as np
from adaptive_terrain.operators.cli import command_line

FRAMES = 8


def hills_flight(folder: Path) -> list[str]:
    """Build a store and a path in `folder`; return the arguments of an export of FRAMES frames, without --out."""
    y, x = np.mgrid[0:129, 0:129].astype(np.float32)
    np.save(folder / "hills.npy", 20 * np.sin(x / 5) * np.cos(y / 6))
    keys = [
        {"frame": 1, "eye": [0, -90, 60], "target": [0, 0, 0]},
        {"frame": FRAMES, "eye": [40, -20, 50], "target": [0, 20, 0]},
    ]
    (folder / "flight.json").write_text(json.dumps({"keyframes": keys}))
    store = str(folder / "hills.store")
    assert command_line.main(["import", str(folder / "hills.npy"), "--store", store]) == 0
    source = ["export", "--store", store, "--path", str(folder / "flight.json"), "--resolution", "640x360"]
    return [*source, "--frames", f"1-{FRAMES}", "--format", "npz"]
