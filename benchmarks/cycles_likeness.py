# SPDX-License-Identifier: GPL-3.0-or-later
"""At what error a picture of ours is as close to that of the whole grid as Cycles' own dicing at one pixel, and what
both cost: `python -m adaptive_terrain.benchmarks.cycles_likeness FOLDER`. The built-in island; 8 GB of memory."""

import sys
from pathlib import Path

from ..cbt_terrain.field.store import open_store
from ..cbt_terrain.importing.import_process import import_source
from ..cbt_terrain.importing.raster import ISLAND, ImportSettings
from . import scenes
from .child import run_child
from .cycles import ADAPTIVE, ERROR, GRID, PIXEL, pixels, similarity
from .files import write_tiff

HEIGHT_SCALE = 0.3  # of the island, which is larger than the flight's ground
ERRORS_PX = (1.0, 0.25, 0.1, 0.05, 0.025)


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    store, tiff = folder / "island.store", folder / "island.tif"
    side = (scenes.SIDE, scenes.SIDE)
    import_source(ImportSettings(ISLAND, size=scenes.SAMPLES, extent=side, height_scale=HEIGHT_SCALE), store)
    write_tiff(open_store(store), tiff)
    print("| way | px | triangles | SSIM | CPU s a frame | peak MB |\n| --- | --: | --: | --: | --: | --: |")
    whole = None
    for mode, px in ((GRID, PIXEL), (ADAPTIVE, PIXEL), *((ERROR, px) for px in ERRORS_PX)):
        picture = folder / f"{mode}_{px}.png"
        said = run_child("cycles_frame", mode, store, tiff, px, picture)
        whole = pixels(picture) if whole is None else whole
        likeness = similarity(pixels(picture), whole)
        triangles = "" if mode == ADAPTIVE else f"{said['triangles']:,}"  # those are Cycles' own secret
        print(
            f"| {mode} | {px:g} | {triangles} | {likeness:.3f} | {said['cpu_s']:.2f} | {said['peak_mb']:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
