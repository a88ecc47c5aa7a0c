# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles of a fit for one vertical error, against greedy Delaunay insertion.

Greedy insertion is the C++ of pydelatin (Garland and Heckbert 1995) from the extra `dev`; without it the row has no
ratio. Its error holds at the samples, ours over the whole surface.
"""

from collections.abc import Callable, Iterator
from importlib import import_module

import numpy as np

from ...cbt_terrain.field.build import from_array
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.fit.fit import fit
from ...cbt_terrain.terrain import Terrain
from ...cbt_terrain.view.criterion import Criterion
from ..rig.measure import BenchmarkRow, alternate, time_ms

ERRORS_M = (5.0, 20.0, 50.0)
STEP_M = 90.0
GREEDY = "pydelatin"


def jacksboro() -> np.ndarray:
    """Return most of the Jacksboro fault DEM (SRTM) of matplotlib, float32 [321, 385] metres, row 0 in the south."""
    cbook = import_module("matplotlib.cbook")
    heights = cbook.get_sample_data("jacksboro_fault_dem.npz")["elevation"]
    return np.ascontiguousarray(heights[::-1][:321, :385].astype(np.float32))


def fit_rows(note: Callable[[str], None]) -> Iterator[BenchmarkRow]:
    """Yield a row for each error; its size is the triangles of the fit."""
    try:
        greedy = import_module(GREEDY).Delatin
    except ImportError:
        greedy = None
        note(f"The row fit_jacksboro has no baseline: {GREEDY} is not installed; pip install {GREEDY}.")
    try:
        field = from_array(jacksboro(), STEP_M)
    except ImportError:
        note("The row fit_jacksboro is left out: the DEM comes with matplotlib, which cannot be imported.")
        return
    for error_m in ERRORS_M:
        yield fit_row("fit_jacksboro", field, error_m, greedy)


def fit_row(name: str, field: HeightField, error_m: float, greedy=None) -> BenchmarkRow:
    """Measure a fit; its ratio is of triangles."""
    fits, greedy_meshes = [], []

    def run_fit() -> dict[str, float]:
        fits.append(fit(field, error_m))
        return fits[-1].ms

    def run_greedy() -> float:
        return time_ms(lambda: greedy_meshes.append(greedy(field.heights(), max_error=error_m).triangles))

    timed = alternate(run_fit, run_greedy if greedy else None)
    triangles = fits[-1].triangles
    plain = Terrain(field).update(Criterion(error_px=0.0, error_m=error_m))
    row = BenchmarkRow(name, triangles, timed.ms["total"], f"triangles of {GREEDY}", first_ms=timed.first_ms["total"])
    row.steps = {step: ms for step, ms in timed.ms.items() if step != "total"}
    row.figures = {"error_m": error_m, "bound_m": fits[-1].bound_m, "plain_triangles": plain.triangles}
    if greedy:
        greedy_triangles = len(greedy_meshes[-1])
        row.ratio = triangles / greedy_triangles
        row.figures |= {"greedy_triangles": greedy_triangles, "greedy_ms": timed.baseline_ms}
    return row
