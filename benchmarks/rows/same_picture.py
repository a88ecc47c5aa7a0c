# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows `same_picture`: costs of the coarsest error whose picture resembles that of the whole grid as much as dicing's.

They need 8 GB of memory. `python -m adaptive_terrain.benchmarks.rows.same_picture FOLDER` prints the table of
docs/understand/picture.md and writes its picture shading_by_map.jpg. Use the newest bpy: Cycles' dicing became several
times faster between Blender 4.2 and 5.2.
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
from ...cbt_terrain.rasters.raster import ISLAND, ImportSettings
from ..rig import scenes
from ..rig.measure import BenchmarkRow
from . import cycles
from .cycles import ADAPTIVE, BARE, ERROR, GRID, HIGH, LOW, MAPPED, PIXEL, similarity
from .files import write_tiff

HEIGHT_SCALE = 0.3  # of the island, which is larger than the ground under the flight
SAME = 0.002  # difference in SSIM below which two pictures count as the same
# Errors to choose from: the coarsest, and STEPS finer ones, a quarter of an octave apart.
COARSEST_PX, STEPS, STEP = 8.0, 36, 2**-0.25
DICING_PX = (1.0, 2.0, 4.0)
# The picture of that page: the whole grid, our mesh, and our mesh with a map, under a low sun; a crop of each.
SHOWN, CROP = (GRID, ERROR, MAPPED), (slice(95, 335), slice(250, 890))
TABLE_PX = (1.0, 0.5, 0.25, 0.1, 0.05)
BASELINE = "cycles dicing"


def same_picture_rows(folder: Path) -> Iterator[BenchmarkRow]:
    """Yield processor time and memory against dicing at 1 px; figures hold the ratios at coarser dicing."""
    render = cache(_island(folder))
    compared = {px: _compare(render, px) for px in DICING_PX}
    time, memory = compared.pop(PIXEL)
    for px, (coarse_time, coarse_memory) in compared.items():
        time.figures[f"ratio_at_{px:g}px"] = coarse_time.ratio
        if memory is not None:
            memory.figures[f"ratio_at_{px:g}px"] = coarse_memory.ratio
    yield time
    if memory is not None:
        yield memory


def _compare(render: Callable, dicing_px: float) -> tuple[BenchmarkRow, BenchmarkRow | None]:
    """Return rows of time and of memory against one dicing rate; None where the system reports no memory."""
    _, whole = render(GRID, PIXEL)
    theirs, picture = render(ADAPTIVE, dicing_px)
    baseline_ssim = similarity(picture, whole)
    error_px, ours, ssim = find_coarsest(render, whole, baseline_ssim - SAME)
    time = BenchmarkRow("same_picture", ours["triangles"], 1e3 * ours["cpu_s"], BASELINE, 1e3 * theirs["cpu_s"])
    time.figures = {"error_px": error_px, "ssim": ssim, "baseline_ssim": baseline_ssim}
    time.figures |= {"wall_ms": ours["ms"], "baseline_wall_ms": theirs["ms"], "bake_cpu_s": ours["bake_cpu_s"]}
    if ours["peak_mb"] is None:
        return time, None
    base_mb = render(BARE, PIXEL)[0]["peak_mb"]
    memory = BenchmarkRow("same_picture_memory", ours["triangles"], None, BASELINE)
    memory.ratio = (ours["peak_mb"] - base_mb) / (theirs["peak_mb"] - base_mb)
    memory.figures = {"peak_mb": ours["peak_mb"], "baseline_peak_mb": theirs["peak_mb"], "base_mb": base_mb}
    return time, memory


def find_coarsest(render: Callable, whole: np.ndarray, min_ssim: float) -> tuple[float, dict, float]:
    """Return the coarsest error in pixels whose picture with a map has at least `min_ssim`, its costs and its SSIM.

    If even the finest error has less, return the finest, whose SSIM shows the miss.
    """

    def measure(step: int) -> tuple[float, dict, float]:
        error_px = COARSEST_PX * STEP**step
        costs, picture = render(MAPPED, error_px)
        return error_px, costs, similarity(picture, whole)

    return measure(bisect.bisect_left(range(STEPS), True, key=lambda step: measure(step)[2] >= min_ssim))


def main(folder: Path) -> None:
    """Print the manual's table and write its picture into `folder`."""
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
        triangles = "" if mode == ADAPTIVE else f"{costs['triangles']:,}"  # Cycles does not report its own
        bake = f"{costs['bake_cpu_s']:.2f}" if mode == MAPPED else ""
        cells = [mode, f"{px:.3g}", triangles, f"{similarity(picture, whole):.3f}"]
        cells += [f"{costs['cpu_s']:.2f}", f"{costs['peak_mb']:.0f}", bake]
        print(f"| {' | '.join(cells)} |", flush=True)
    strip = np.concatenate([render(mode, PIXEL, LOW)[1][::-1][CROP] for mode in SHOWN])
    Image.fromarray(np.rint(strip).astype(np.uint8)).save(folder / "shading_by_map.jpg", quality=88)


def _island(folder: Path) -> Callable[..., tuple[dict, np.ndarray]]:
    """Import the island; return a function from a mode, pixels and a sun to costs and a picture."""
    folder.mkdir(parents=True, exist_ok=True)
    store, tiff = folder / "island.store", folder / "island.tif"
    side = (scenes.SIDE, scenes.SIDE)
    import_source(ImportSettings(ISLAND, size=scenes.SAMPLES, extent=side, height_scale=HEIGHT_SCALE), store)
    write_tiff(open_store(store), tiff)
    return lambda mode, px, sun=HIGH: cycles.render(mode, px, store, tiff, folder, sun)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
