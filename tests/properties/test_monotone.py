# SPDX-License-Identifier: GPL-3.0-or-later
"""Criteria are nested: a finer request splits everything that a coarser one splits, with all ancestors."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.leb.bisection import neighbours
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from diamond_entries import error_index
from fields import errors_of, least_triangles
from hypothesis import given
from hypothesis import strategies as st
from reference_bisection import from_tree_id, leaves_of, split_nodes, to_tree_id
from scenarios import make, make_field, to_remember
from strategies import criteria, fields, magnitudes, scenarios

MESHLETS = st.sampled_from([0, 1, 2, 3])


def split_in(terrain) -> set[tuple[int, int]]:
    """Return (square, id) of every split triangle."""
    return split_nodes(leaves_of(terrain.tree, terrain.field.lattice))


def without_budget(scenario, **changes):
    """Return field, views, the scenario's criterion without its budget and with `changes`, and the placement."""
    field, views, criterion, placed = make(scenario)
    return field, views, Criterion(**{**vars(criterion), "max_triangles": None, **changes}), placed


@given(scenarios(criterion=criteria(meshlets=(0,))), st.lists(magnitudes(-0.5, 2.5), min_size=3, max_size=3))
def test_a_finer_error_splits_all_that_a_coarser_one_does(scenario, errors):
    with to_remember(scenario):
        last: set = set()
        for error_px in sorted(errors, reverse=True):
            field, views, criterion, placed = without_budget(scenario, error_px=error_px)
            terrain = Terrain(field, 1)
            # a depth limit, the same for each error, keeps the examples short
            limit = min(criterion.max_depth or 99, field.lattice.cell_depth + 1)
            update = terrain.update(Criterion(**{**vars(criterion), "max_depth": limit}), views, **placed)
            now = split_in(terrain)
            assert last <= now and update.leaves == len(now) + 2 * field.lattice.squares
            last = now


@given(scenarios(criterion=criteria(meshlets=(0,))))
def test_split_triangles_have_split_diamonds_and_parents(scenario):
    """A diamond's value never exceeds its parents', so the set of split triangles is closed upward."""
    with to_remember(scenario):
        field, views, criterion, placed = make(scenario)
        terrain = Terrain(field, 1)
        terrain.update(criterion, views, **placed)
        split = np.array([to_tree_id(field.lattice, node) for node in split_in(terrain)], np.uint64)
        halves = np.setdiff1d(neighbours(field.lattice, split)[:, 2], [0])
        assert np.isin(halves, split).all()
        above = halves[halves >= np.uint64(4 << field.lattice.square_bits)] >> np.uint64(1)
        assert np.isin(above, split).all()


@given(scenarios(criterion=criteria(meshlets=(0, 1))), st.lists(st.integers(0, 6000), min_size=4, max_size=4))
def test_a_larger_budget_is_never_worse(scenario, budgets):
    with to_remember(scenario):
        last_bound, last_relaxed, last_triangles = np.inf, np.inf, 0
        for budget in sorted(budgets):
            field, views, criterion, placed = without_budget(scenario, max_triangles=budget)
            update = Terrain(field, 1).update(criterion, views, **placed)
            assert update.relaxed <= last_relaxed and update.triangles >= last_triangles
            least = least_triangles(field, criterion.meshlet)
            assert update.triangles <= max(budget, least)
            # several criteria are relaxed together; only that of the error alone must decrease with each step
            if not (criterion.edge_px or criterion.area_px or criterion.error_m):
                assert update.bound_px <= last_bound
            last_bound, last_relaxed, last_triangles = update.bound_px, update.relaxed, update.triangles


@given(fields(), st.lists(magnitudes(-2, 3), min_size=3, max_size=3), MESHLETS)
def test_a_finer_vertical_error_never_takes_fewer_leaves(asked, errors, meshlet):
    field = make_field(asked)
    last_leaves, last_bound = 0, np.inf
    for error_m in sorted(errors, reverse=True):
        update = Terrain(field, 1).update(Criterion(error_px=0, error_m=error_m, meshlet=meshlet))
        assert update.leaves >= last_leaves and update.bound_m <= last_bound
        last_leaves, last_bound = update.leaves, update.bound_m


@pytest.mark.thorough
@given(scenarios(criterion=criteria(meshlets=(0,))))
def test_the_union_of_views_splits_what_each_splits(scenario):
    with to_remember(scenario):
        field, views, criterion, placed = without_budget(scenario)
        limited = Criterion(
            **{**vars(criterion), "max_depth": min(criterion.max_depth or 99, field.lattice.cell_depth)}
        )
        terrain = Terrain(field, 1)
        alone = []
        for view in views:
            terrain.update(limited, [view], **placed)
            alone.append(split_in(terrain))
        terrain.update(limited, views, **placed)
        together = split_in(terrain)
        # edges are measured with the longest unit of any view, so the union may be finer than both
        assert set().union(*alone) <= together
        if not (criterion.edge_px or criterion.area_px):
            assert set().union(*alone) == together


@given(fields(), MESHLETS)
def test_stored_errors_are_nested(asked, meshlet):
    """The error of a diamond is never below that of the diamonds split at its edges, for every meshlet size."""
    field = make_field(asked)
    lattice, errors = field.lattice, errors_of(field, meshlet)
    for depth in range(1, 2 * lattice.levels):
        side = 1 << (lattice.levels - (depth - 1) // 2)  # of the cell, in samples
        half = side // 2
        j, i = np.mgrid[0 : lattice.height, 0 : lattice.width]
        if depth % 2:  # split at the centres of cells; children at the middles of the cells' sides
            here = (i % side == half) & (j % side == half)
            offsets = [(half, 0), (-half, 0), (0, half), (0, -half)]
        else:  # split at the middles of sides; children at the centres of the cells of half the side
            here = ((i % side == half) & (j % side == 0)) | ((i % side == 0) & (j % side == half))
            offsets = [(a * half // 2, b * half // 2) for a in (-1, 1) for b in (-1, 1)]
        if half < 2 and depth % 2 == 0:
            continue  # the children are the centres of the raster's cells
        i, j = i[here], j[here]
        own = errors[error_index(lattice, depth, i, j)]
        for dx, dy in offsets:
            x, y = i + dx, j + dy
            inside = (x >= 0) & (x < lattice.width) & (y >= 0) & (y < lattice.height)
            below = errors[error_index(lattice, depth + 1, x[inside], y[inside])]
            assert (below <= own[inside]).all()


@given(scenarios(), st.integers(0, 10**6))
def test_tree_ids_of_the_refinement_are_its_leaves(scenario, pick):
    """Leaf k of the tree is triangle k's leaf: rank, depth and id agree."""
    with to_remember(scenario):
        field, views, criterion, placed = make(scenario)
        terrain = Terrain(field, 1)
        update = terrain.update(criterion, views, **placed)
        k = pick % update.leaves
        tree_id = terrain.tree.decode([k])
        assert terrain.tree.find(terrain.tree.cells_of(tree_id))[0].tolist() == [k]
        node = from_tree_id(field.lattice, tree_id[0])
        assert to_tree_id(field.lattice, node) == tree_id[0]
        depth = node[1].bit_length() - 1
        # an expanded leaf's triangles carry the depth of its meshlet's own bisections
        assert depth + 2 * criterion.meshlet == update.surface.level[k << 2 * criterion.meshlet]
