# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows of a sweep: the figures of a setting, and what rows show together."""

import dataclasses
import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from ..refine.terms import Terms
from .cost_curve import CostCurve
from .measure import Measurement
from .mesh import Errors
from .sweep_settings import Setting
from .timed_runs import ms_to_finished_mesh

# Errors that differ by less than this fraction are the same for the Pareto front.
DIFFERENT = 0.02
# Runs of the same that differ by more than this factor do not show the cost of an error.
MAX_SPREAD = 2.0
STEPS = ("refine", "weld", "meshlets", "displace", "effects", "ingest", "fit")
ALIKE = "unit", "interpolation"  # fields that are equal in all settings of one cost curve
TERMS = tuple(Terms.__dataclass_fields__)
TRANSITIONS = "popping_px", "shading_change"  # between the meshes of two frames
PARTS = tuple(Errors.__dataclass_fields__)


@dataclass(frozen=True)
class Row:
    """Results of a setting over all frames: the largest errors and bounds, the median of triangles and times.

    `bound`: in the setting's unit. `limited`: reasons why the bound of any frame exceeds its error, for example
    "max_triangles". `surface_mb`: the mesh's arrays; `buffers_mb`: address space of all arrays of the engine, of which
    the system commits the pages that are used (None for a fit). `terms`: the parts of the largest bound, in the
    setting's unit. `popping_px`, `shading_change` (255ths): None where no frame follows. `ms`: by step, and "total" of
    the update (of the fit for a fitted row); "effects", making attributes, and "ingest", writing a Blender mesh, come
    on top; of each frame those of its fastest run.
    `cpu_ms`: processor time of all threads to the finished mesh; `spread_ms`: that of the fastest and of the slowest
    run, of the frame where they differ most.
    """

    setting: Setting
    bound: float
    limited: tuple[str, ...]
    triangles: float
    vertices: float
    surface_mb: float
    buffers_mb: float | None
    measured: Measurement
    terms: Terms | None = None
    popping_px: Errors | None = None
    shading_change: Errors | None = None
    ms: dict[str, float] = field(default_factory=dict)
    spread_ms: tuple[float, float] | None = None
    cpu_ms: float | None = None

    @property
    def error(self) -> float:
        """Return the largest error that was measured, in the setting's unit: of visible points, or of height."""
        if self.setting.unit == "m":
            return self.measured.vertical_max_m
        assert self.measured.screen_px is not None  # it was measured in a view
        return self.measured.screen_px.max

    @property
    def whole_ms(self) -> float:
        """Return the milliseconds from the camera to the finished mesh, in Blender's memory if that was measured."""
        return ms_to_finished_mesh(self.ms)

    @property
    def cost_ms(self) -> float:
        """Return the processor time of all threads to the finished mesh; elapsed time where that was not measured."""
        return self.whole_ms if self.cpu_ms is None else self.cpu_ms

    def figures(self) -> dict[str, float | int | str | None]:
        """Return every figure under a name with its unit, the same names for every row.

        Figures that are not measured are None. TERMS and PARTS are the fields of a bound's terms and of measured errors
        (maximum, percentiles and so on), STEPS the steps of an update, TRANSITIONS the changes between two frames.
        """
        figures = {"asked" if k == "error" else k: v for k, v in dataclasses.asdict(self.setting).items()}
        figures |= {"bound": self.bound, "measured": self.error}
        figures |= {f"bound_{part}": getattr(self.terms, part, None) for part in TERMS}
        figures |= {"limited": ", ".join(self.limited), "triangles": self.triangles, "vertices": self.vertices}
        figures |= {f"ms_{step}": self.ms.get(step) for step in ("total", *STEPS)}
        figures["ms_cpu"] = self.cpu_ms
        figures |= dict(zip(("ms_fastest", "ms_slowest"), self.spread_ms or (None, None), strict=True))
        figures |= {"surface_mb": self.surface_mb, "buffers_mb": self.buffers_mb}
        measured = {f.name: getattr(self.measured, f.name) for f in dataclasses.fields(self.measured)}
        for name, value in (measured | {n: getattr(self, n) for n in TRANSITIONS}).items():
            if isinstance(value, float):
                figures[name] = value
            else:
                figures |= {f"{name}_{part}": getattr(value, part, None) for part in PARTS}
        return figures


def curve_of(rows: Sequence[Row]) -> CostCurve:
    """Return the cost curve through `curve_rows`, in processor time to the finished mesh.

    Raises TerrainError if these have fewer than two different errors.
    """
    points = [(row.setting.error, row.triangles, row.cost_ms) for row in curve_rows(rows)]
    return CostCurve.through(rows[0].setting.unit if rows else "px", points)


def unsteady_row(rows: Sequence[Row]) -> Row | None:
    """Return the row of the cost curve whose runs differ most, if by more than MAX_SPREAD: then there is no curve."""
    unsteadiest = max(curve_rows(rows), key=lambda row: _spread_factor(row.spread_ms), default=None)
    return unsteadiest if unsteadiest is not None and is_unsteady(unsteadiest.spread_ms) else None


def is_unsteady(spread_ms: tuple[float, float] | None) -> bool:
    """Return whether runs of the same update differ by more than MAX_SPREAD. spread_ms: the result of `spread_of`."""
    return _spread_factor(spread_ms) > MAX_SPREAD


def unsteady_text(setting: str, spread_ms: tuple[float, float]) -> str:
    """Return why no cost curve is drawn: the runs of `setting` differ too much.

    The text follows a colon.

    Args:
        setting: error of the runs with its unit, as "0.5 px".
        spread_ms: milliseconds of processor time of the fastest and of the slowest run.
    """
    low, high = spread_ms
    return (
        f"at {setting} runs of the same update took {low:.3g} to {high:.3g} ms of CPU, more than a factor of "
        f"{MAX_SPREAD:g} apart, so that none of these times can be relied on. Measure again while nothing else runs."
    )


def _spread_factor(spread_ms: tuple[float, float] | None) -> float:
    """Return how many times longer the slowest run took than the fastest, 1 for a single run (None).

    Infinity if the fastest took no time that could be measured.
    """
    low, high = spread_ms or (1.0, 1.0)
    return high / low if low > 0.0 else math.inf


def curve_rows(rows: Sequence[Row]) -> list[Row]:
    """Return the rows that the cost curve goes through: those with the unit and the interpolation of the first row.

    Rows with further settings, and those that the triangle limit alone held back, are left out.
    """
    alike = [r for r in rows if all(getattr(r.setting, n) == getattr(rows[0].setting, n) for n in ALIKE)]
    return [r for r in alike if r.setting.is_plain and r.limited != ("max_triangles",)]


def pareto(points: Sequence[tuple[float, float]]) -> list[int]:
    """Return the indices of the points (error, cost) that no other beats, by rising cost.

    Each is better than all cheaper ones by DIFFERENT or more, so that rounding and noise make no front.
    """
    front, best = [], math.inf
    for i in sorted(range(len(points)), key=lambda i: (points[i][1], points[i][0])):
        if points[i][0] < best * (1 - DIFFERENT):
            front.append(i)
            best = points[i][0]
    return front


def median_count(counts: Sequence[int]) -> float:
    """Return the median of counts, of an even number of them the mean of the two in the middle; whole where it can."""
    median = statistics.median(counts)
    return int(median) if median == int(median) else median


def spread_of(times_ms: Sequence[float]) -> tuple[float, float] | None:
    """Return the smallest and the largest time; None for a single time, which shows no spread."""
    return (min(times_ms), max(times_ms)) if len(times_ms) > 1 else None


def worst(parts: Sequence) -> Any:
    """Return the largest of every figure of several Errors or Measurements, with their counts added; None for none.

    parts: of one class, or None; in the recursion also the values of one field of them.
    """
    parts = [part for part in parts if part is not None]
    if not parts or isinstance(parts[0], float):
        return max(parts, default=None)
    if isinstance(parts[0], int):
        return sum(map(int, parts))
    names = [f.name for f in dataclasses.fields(parts[0])]
    return type(parts[0])(**{name: worst([getattr(part, name) for part in parts]) for name in names})
