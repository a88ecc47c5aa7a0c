# SPDX-License-Identifier: GPL-3.0-or-later
"""The rows *same picture*: the coarsest error whose picture of ours is as close to that of the whole grid as one that
Cycles dices at 1, 2 or 4 pixels, and what both cost.

The built-in island, and 8 GB of memory. `python -m adaptive_terrain.benchmarks.rows.cycles_likeness FOLDER` prints a
table of several errors, for the manual, and leaves its picture shading_by_map.jpg. Cycles' dicing became several times
faster between Blender 4.2 and 5.2, so run it with the newest bpy.
"""

import bisect
import sys
from collections.abc import Callable, Iterator
from functools import cache
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
# The errors that are tried: the coarsest, and STEPS finer ones, each a quarter of an octave below the last.
COARSEST_PX, STEPS, STEP = 8.0, 36, 2**-0.25
DICING_PX = (1.0, 2.0, 4.0)
# The manual's picture: the whole grid, our mesh, and the same with a map, under a low sun; part of each.
SHOWN, PART = (GRID, ERROR, MAPPED), (slice(95, 335), slice(250, 890))
TABLE_PX = (1.0, 0.5, 0.25, 0.1, 0.05)


def same_picture_rows(folder: Path) -> Iterator[Row]:
    """Yield, for each rate of dicing, processor time and memory at the coarsest error whose picture is the same."""
    render = cache(_island(folder))
    _, whole = render(GRID, PIXEL)
    for dicing_px in DICING_PX:
        theirs, picture = render(ADAPTIVE, dicing_px)
        baseline_ssim = similarity(picture, whole)
        error_px, ours, ssim = find_coarsest(render, whole, baseline_ssim - SAME)
        name = "same_picture" if dicing_px == PIXEL else f"same_picture_{dicing_px:g}px"
        row = Row(name, ours["triangles"], 1e3 * ours["cpu_s"], "cycles dicing", 1e3 * theirs["cpu_s"])
        row.figures = {"error_px": error_px, "ssim": ssim, "baseline_ssim": baseline_ssim}
        row.figures |= {"wall_ms": ours["ms"], "baseline_wall_ms": theirs["ms"], "bake_cpu_s": ours["bake_cpu_s"]}
        yield row
        if ours["peak_mb"] is not None:
            base, _ = render(BARE, PIXEL)
            yield memory_row(f"{name}_memory", ours, theirs, base["peak_mb"])


def find_coarsest(render: Callable, whole: np.ndarray, min_ssim: float) -> tuple[float, dict, float]:
    """Return the coarsest error in pixels whose picture with a map has at least `min_ssim`, its costs and its SSIM.

    Where even the finest error has less, the finest is returned, and its SSIM shows the miss.
    """

    def measure(step: int) -> tuple[float, dict, float]:
        error_px = COARSEST_PX * STEP**step
        costs, picture = render(MAPPED, error_px)
        return error_px, costs, similarity(picture, whole)

    return measure(bisect.bisect_left(range(STEPS), True, key=lambda step: measure(step)[2] >= min_ssim))


def main(folder: Path) -> None:
    from ...operators.blender import need_bpy

    render = cache(_island(folder))
    _, whole = render(GRID, PIXEL)
    print(f"Blender {need_bpy('The table').app.version_string}\n")
    print("| way | px | triangles | SSIM | CPU s a frame | peak MB | CPU s of the bake |")
    print("| --- | --: | --: | --: | --: | --: | --: |")
    ways = [(GRID, PIXEL), *((ADAPTIVE, px) for px in DICING_PX)]
    ways += [(way, px) for way in (ERROR, MAPPED) for px in TABLE_PX]
    for dicing_px in DICING_PX:
        min_ssim = similarity(render(ADAPTIVE, dicing_px)[1], whole) - SAME
        ways.append((MAPPED, find_coarsest(render, whole, min_ssim)[0]))
    for mode, px in ways:
        costs, picture = render(mode, px)
        triangles = "" if mode == ADAPTIVE else f"{costs['triangles']:,}"  # Cycles does not tell its own
        bake = f"{costs['bake_cpu_s']:.2f}" if mode == MAPPED else ""
        cells = [mode, f"{px:.3g}", triangles, f"{similarity(picture, whole):.3f}"]
        cells += [f"{costs['cpu_s']:.2f}", f"{costs['peak_mb']:.0f}", bake]
        print(f"| {' | '.join(cells)} |", flush=True)
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
