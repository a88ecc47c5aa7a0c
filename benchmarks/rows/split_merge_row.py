# SPDX-License-Identifier: GPL-3.0-or-later
"""The classic concurrent update, a pass of splits and merges a frame, against the walk for the same leaves."""

import statistics
from dataclasses import dataclass

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.leb.bisection import plant
from ...cbt_terrain.refine.split_merge import split_merge
from ...cbt_terrain.terrain import Terrain
from ...cbt_terrain.tree.concurrent_binary_tree import ConcurrentBinaryTree
from ..rig import scenes
from ..rig.measure import BenchmarkRow, stopwatch
from . import engine

SIZE = 500_000
CUT = 500  # frames of the flight between two views that have little in common
FRAMES = 5


@dataclass
class Convergence:
    """Passes until no leaf changes, including the last one, with their median and their total time."""

    passes: int
    pass_ms: float
    all_ms: float


def split_merge_row(rough: HeightField) -> BenchmarkRow:
    """Return the median time of a pass in a flight, against that of the walk and its tree, on one thread."""
    criterion = scenes.errors(engine.error_px(rough, SIZE))
    terrain, walks, flights = Terrain(rough, 1), [], []
    terrain.update(criterion, [scenes.over(CUT)])
    tree = ConcurrentBinaryTree(terrain.tree.max_depth)
    plant(tree, rough.lattice)
    root = _converge(tree, terrain)
    terrain.update(criterion, [scenes.over(0)])
    cut = _converge(tree, terrain)
    for frame in range(1, FRAMES + 1):
        walks.append(engine.refine_ms(terrain.update(criterion, [scenes.over(frame)]).ms))
        flights.append(_converge(tree, terrain))
    row = BenchmarkRow("split_merge", SIZE, statistics.median(flight.pass_ms for flight in flights), "walk")
    row.baseline_ms = statistics.median(walks)
    row.ratio = row.ms / row.baseline_ms
    row.figures = {"passes_from_roots": root.passes, "passes_after_cut": cut.passes}
    row.figures["passes_in_flight"] = max(flight.passes for flight in flights)
    row.figures["after_cut_ms"] = cut.all_ms
    row.figures["in_flight_ms"] = statistics.median(flight.all_ms for flight in flights)
    return row


def _converge(tree: ConcurrentBinaryTree, terrain: Terrain) -> Convergence:
    """Make passes until the tree has the leaves of the terrain's last update."""
    domain, request, max_depth, _ = terrain.history.last.result.horizon
    times, changes = [], 1
    while changes:
        with stopwatch() as elapsed:
            changes = split_merge(tree, terrain.field.lattice, domain, request, max_depth)
        times.append(elapsed[0])
    if tree.to_bytes() != terrain.tree.to_bytes():
        raise TerrainError("The passes ended with other leaves than the walk")
    return Convergence(len(times), statistics.median(times), sum(times))
