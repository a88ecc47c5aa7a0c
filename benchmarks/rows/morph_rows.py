# SPDX-License-Identifier: GPL-3.0-or-later
"""What it costs that points rise to their places, at the same bound: in a flight, and after a cut to another view."""

from collections.abc import Callable, Iterator
from dataclasses import replace

from ...cbt_terrain.ask.criterion import Criterion
from ...cbt_terrain.ask.morph import SMOOTH
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.terrain import Terrain
from ..rig import scenes
from ..rig.measure import Row, alternate
from . import engine

TRIANGLES = 1_000_000  # without a morph
SLOW = 0.25  # frames of the benchmarks' flight at a time: a thousandth of the terrain is fast
CUT = 500  # frames away
FAR_PX = 64.0


def morph_rows(rough: HeightField) -> Iterator[Row]:
    """Whole updates of a rough terrain for an error on screen, one thread."""
    plain = scenes.errors(engine.error_px(rough, TRIANGLES, 0))
    rising = replace(plain, morph=SMOOTH)
    yield _row("morph_flight", *(_flight(rough, criterion) for criterion in (rising, plain)))
    yield _row("morph_cut", *(_cut(rough, criterion) for criterion in (rising, plain)))


def _row(name: str, rising: Callable[[], dict], plain: Callable[[], dict]) -> Row:
    timed = alternate(rising, lambda: plain()["total"])
    return Row(name, TRIANGLES, timed.ms["total"], "without", timed.baseline_ms, steps=timed.ms)


def _flight(field: HeightField, criterion: Criterion) -> Callable[[], dict]:
    return scenes.Flight(field, lambda frame: scenes.over(SLOW * frame), criterion, threads=1)


def _cut(field: HeightField, criterion: Criterion) -> Callable[[], dict]:
    """Of each two frames the second, of which nothing was in the one before."""
    terrain, far = Terrain(field, 1), replace(criterion, error_px=FAR_PX)

    def cut() -> dict[str, float]:
        terrain.update(far, [scenes.over(CUT)])
        return terrain.update(criterion, [scenes.over(0)]).ms

    return cut
