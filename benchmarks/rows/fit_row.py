# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles and time for one vertical error: interpolation, the fit, and greedy Delaunay insertion where there is one.

Greedy Delaunay is the C++ of pydelatin (Garland and Heckbert 1995), of the extra `dev`: without it the rows have no
baseline. Its error holds at the samples, ours on the whole surface between them too.
"""

from collections.abc import Callable, Iterator
from importlib import import_module

import numpy as np

from ...cbt_terrain.ask.criterion import Criterion
from ...cbt_terrain.field.build import from_array
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.fit.fit import fit
from ...cbt_terrain.terrain import Terrain
from ..rig.measure import Row, alternate, stopwatch
from ..rig.scenes import noise

SAMPLES = 513
ROUGH_M = (0.25, 0.5, 1.0, 4.0)
JACKSBORO_M = (5.0, 10.0, 20.0, 50.0)
JACKSBORO_STEP_M = 90.0
GREEDY = "pydelatin"


def jacksboro() -> np.ndarray:
    """float32 [321, 385] metres: most of the Jacksboro fault DEM (SRTM) that comes with matplotlib, row 0 south."""
    cbook = import_module("matplotlib.cbook")
    heights = cbook.get_sample_data("jacksboro_fault_dem.npz")["elevation"]
    return np.ascontiguousarray(heights[::-1][:321, :385].astype(np.float32))


def fit_rows(note: Callable[[str], None]) -> Iterator[Row]:
    """A row for each terrain and error; its size is the fit's triangles."""
    try:
        greedy = import_module(GREEDY).Delatin
    except ImportError:
        greedy = None
        note(f"The rows fit have no baseline: {GREEDY} (greedy Delaunay) is not installed; pip install {GREEDY}.")
    rough = from_array(np.ascontiguousarray(noise(2 * (SAMPLES - 1))[:SAMPLES, :SAMPLES]), 1.0)
    for error_m in ROUGH_M:
        yield fit_row("fit_rough", rough, error_m, greedy)
    try:
        real = from_array(jacksboro(), JACKSBORO_STEP_M)
    except ImportError:
        note("The rows fit_jacksboro are left out: the DEM comes with matplotlib, which cannot be imported.")
        return
    for error_m in JACKSBORO_M:
        yield fit_row("fit_jacksboro", real, error_m, greedy)


def fit_row(name: str, field: HeightField, error_m: float, greedy=None) -> Row:
    """Fit and greedy insertion in turns; interpolation, of which the time is that of one warm update, apart."""
    count = {}

    def fitted() -> dict[str, float]:
        found = fit(field, error_m)
        count["fit"], count["bound_m"], count["rounds"] = found.triangles, found.bound_m, found.rounds
        return found.ms

    def inserted() -> float:
        with stopwatch() as elapsed:
            count["greedy"] = len(greedy(field.heights(), max_error=error_m).triangles)
        return elapsed[0]

    timed = alternate(fitted, inserted if greedy else None)
    plain = Terrain(field)
    plain.update(Criterion(error_px=0.0, error_m=2 * error_m))
    update = plain.update(Criterion(error_px=0.0, error_m=error_m))
    row = Row(name, count["fit"], timed.ms["total"], GREEDY, timed.baseline_ms, first_ms=timed.first_ms["total"])
    row.steps = {step: ms for step, ms in timed.ms.items() if step != "total"}
    row.figures = {"asked_m": error_m, "bound_m": count["bound_m"], "rounds": count["rounds"]}
    row.figures |= {"plain_triangles": update.triangles, "plain_ms": update.ms["total"]}
    row.figures["triangles_to_plain"] = count["fit"] / update.triangles
    if greedy:
        row.figures |= {"greedy_triangles": count["greedy"], "triangles_to_greedy": count["fit"] / count["greedy"]}
    return row
