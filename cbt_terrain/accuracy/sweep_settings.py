# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of a sweep: errors, limits of depth, meshlets, interpolation, fitted heights, and geomorphs."""

import dataclasses
import math
from dataclasses import dataclass
from functools import partial

from ..field.heightfield import INTERPOLATIONS, HeightField
from ..plain_numbers import keep_plain_numbers
from ..view.criterion import Criterion
from ..view.morph import SMOOTH
from .timed_runs import TimedFrame

PIXELS = (16.0, 8.0, 4.0, 2.0, 1.0, 0.5, 0.25)
# Steps of a sweep in metres, each half of the one before; the coarsest is at most this fraction of the relief.
METRE_STEPS, COARSEST_PART = 7, 1 / 32
MESHLETS = (1, 2, 3, 4)
# Errors in pixels of which transitions are measured both ways, smooth and not.
BOTH_WAYS_PX = (4.0, 2.0, 1.0, 0.5)
# Bisections that a limit of depth stops short of the raster's cells.
SHORT_OF_CELLS = (6, 4, 2, 0)
# Beyond this many triangles a setting stays coarser than its error, so that no sweep fills the memory.
MAX_TRIANGLES = 1 << 23


@dataclass(frozen=True)
class Setting:
    """One thing to measure.

    `error`: the criterion's error in `unit`, "px" or "m" (of height). `max_depth`: limit of bisections, None for none.
    `meshlet`: each leaf becomes 4^meshlet triangles. `fitted`: heights of vertices are fitted (metres only).
    `interpolation`: the height field's. `morph`: in place of the criterion's; None keeps that.
    """

    unit: str
    error: float
    max_depth: int | None = None
    meshlet: int = 0
    fitted: bool = False
    interpolation: str = INTERPOLATIONS[0]
    morph: float | None = None

    def __post_init__(self) -> None:
        keep_plain_numbers(self, "The setting's")

    @property
    def is_plain(self) -> bool:
        """Return whether the criterion is nothing but an error: no depth limit, meshlets, fitted heights or geomorph.

        The cost curve goes through these settings.
        """
        return self.max_depth is None and self.meshlet == 0 and not self.fitted and self.morph is None

    def criterion(self, base: Criterion) -> Criterion:
        """Return `base` with this setting in place of its errors, lengths, areas and limits; 0 is no criterion."""
        return dataclasses.replace(
            base,
            error_px=self.error if self.unit == "px" else 0.0,
            error_m=self.error if self.unit == "m" else 0.0,
            edge_px=0.0,
            area_px=0.0,
            max_depth=self.max_depth,
            max_triangles=MAX_TRIANGLES,
            meshlet=self.meshlet,
            morph=base.morph if self.morph is None else self.morph,
        )


def settings_for(heights: HeightField, frame: TimedFrame, morph: float = 1.0) -> list[Setting]:
    """Return the settings of a whole sweep.

    They are pixels, depth limits and meshlets if there is a view; metres, plain and fitted; and every other error with
    the other interpolation. Only bilinear terrain without detail or holes can be fitted. If a frame follows, some
    errors are repeated with the other geomorph: SMOOTH if `morph`, that of the swept criterion, is 1 (none), else 1.
    """
    same = partial(Setting, interpolation=heights.interpolation)
    other = partial(Setting, interpolation=next(name for name in INTERPOLATIONS if name != heights.interpolation))
    settings = []
    if frame.views:
        settings += [same("px", error) for error in PIXELS]
        depths = [heights.lattice.cell_depth - short for short in SHORT_OF_CELLS]
        settings += [same("px", 1.0, max_depth=depth) for depth in depths if depth >= 1]
        settings += [same("px", 1.0, meshlet=meshlet) for meshlet in MESHLETS]
        settings += [other("px", error) for error in PIXELS[::2]]
        changed = SMOOTH if morph == 1 else 1.0
        settings += [same("px", error, morph=changed) for error in BOTH_WAYS_PX if frame.after]
    metres = metre_steps((heights.max_height - heights.min_height) * abs(frame.vertical_scale))
    settings += [same("m", error) for error in metres]
    settings += [other("m", error) for error in metres[::2]]
    can_be_fitted = not heights.detail and heights.valid is None
    return settings + [Setting("m", error, fitted=True) for error in metres if can_be_fitted]


def metre_steps(relief_m: float) -> list[float]:
    """Return METRE_STEPS errors in metres that suit a terrain of that relief, each half of the one before.

    They are powers of two; for a relief of 0 the first is 1.
    """
    coarsest = 2.0 ** math.floor(math.log2(relief_m * COARSEST_PART)) if relief_m > 0 else 1.0
    return [coarsest / 2**i for i in range(METRE_STEPS)]
