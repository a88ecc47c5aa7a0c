# SPDX-License-Identifier: GPL-3.0-or-later
"""The row *same picture*: at which error a picture of ours is as close to that of the whole grid as one that Cycles has
diced at one pixel, and what both cost.

The built-in island, and 8 GB of memory. `python -m adaptive_terrain.benchmarks.rows.cycles_likeness FOLDER` prints a
table of several errors, for the manual, and leaves its picture shading_by_map.jpg.
"""

import bisect
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from ...cbt_terrain.field.store import open_store
from ...cbt_terrain.importing.import_process import import_source
from ...cbt_terrain.importing.raster import ISLAND, ImportSettings
from ..rig import scenes
from ..rig.measure import Row
from .cycles import ADAPTIVE, BARE, ERROR, GRID, HIGH, LOW, MAPPED, PIXEL, memory_row, rendered, similarity
from .files import write_tiff

HEIGHT_SCALE = 0.3  # of the island, which is larger than the flight's ground
# By how much less alike, in SSIM, a picture may be and count as the same.
SAME = 0.002
# The errors that are tried: one pixel, and so many steps below it, each a quarter of an octave.
STEPS, STEP = 24, 2**-0.25
# The manual's picture: the whole grid, our mesh, and the same with a map, under a low sun; part of each.
SHOWN, PART = (GRID, ERROR, MAPPED), (slice(95, 335), slice(250, 890))
TABLE_PX = (1.0, 0.5, 0.25, 0.1, 0.05)


def same_picture_rows(folder: Path) -> Iterator[Row]:
    """The coarsest error whose picture is the same; processor time and memory there, beside dicing's."""
    render = _island(folder)
    _, whole = render(GRID, PIXEL)
    theirs, picture = render(ADAPTIVE, PIXEL)
    alike = similarity(picture, whole)
    tried: dict[int, tuple[dict, float]] = {}

    def is_same(step: int) -> bool:
        said, picture = render(MAPPED, PIXEL * STEP**step)
        tried[step] = said, similarity(picture, whole)
        return tried[step][1] >= alike - SAME

    step = bisect.bisect_left(range(STEPS), True, key=is_same)
    if step not in tried:  # even the finest: the row says so by its ssim
        is_same(step)
    ours, ssim = tried[step]
    row = Row("same_picture", ours["triangles"], 1e3 * ours["cpu_s"], "cycles dicing", 1e3 * theirs["cpu_s"])
    row.figures = {"error_px": PIXEL * STEP**step, "ssim": ssim, "baseline_ssim": alike}
    row.figures |= {"wall_ms": ours["ms"], "baseline_wall_ms": theirs["ms"]}
    yield row
    if ours["peak_mb"] is not None:
        base, _ = render(BARE, PIXEL)
        yield memory_row("same_picture_memory", ours, theirs, base["peak_mb"])


def main(folder: Path) -> None:
    render = _island(folder)
    print("| way | px | triangles | SSIM | CPU s a frame | peak MB |\n| --- | --: | --: | --: | --: | --: |")
    whole = None
    for mode, px in ((GRID, PIXEL), (ADAPTIVE, PIXEL), *((way, px) for way in (ERROR, MAPPED) for px in TABLE_PX)):
        said, picture = render(mode, px)
        whole = picture if whole is None else whole
        triangles = "" if mode == ADAPTIVE else f"{said['triangles']:,}"  # those are Cycles' own secret
        cells = [mode, f"{px:g}", triangles, f"{similarity(picture, whole):.3f}"]
        print(f"| {' | '.join(cells)} | {said['cpu_s']:.2f} | {said['peak_mb']:.0f} |", flush=True)
    strip = np.concatenate([render(mode, PIXEL, LOW)[1][::-1][PART] for mode in SHOWN])
    Image.fromarray(np.rint(strip).astype(np.uint8)).save(folder / "shading_by_map.jpg", quality=88)


def _island(folder: Path) -> Callable[..., tuple[dict, np.ndarray]]:
    """Renders the island: a mode, pixels and a sun to what that has cost, and its picture."""
    folder.mkdir(parents=True, exist_ok=True)
    store, tiff = folder / "island.store", folder / "island.tif"
    side = (scenes.SIDE, scenes.SIDE)
    import_source(ImportSettings(ISLAND, size=scenes.SAMPLES, extent=side, height_scale=HEIGHT_SCALE), store)
    write_tiff(open_store(store), tiff)
    return lambda mode, px, sun=HIGH: rendered(mode, px, store, tiff, folder, sun)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
