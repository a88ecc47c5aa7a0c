# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh from its saved tree: the same bytes without the camera, and no other tree is taken for one."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.accuracy.measure import measure
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.tree.saved import depths_from_bytes, depths_to_bytes
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import rough
from invariants import arrays

# One square, a grid of three with a spare leaf of the tree, padded squares.
SHAPES = [(65, 65), (33, 97), (40, 57)]
VIEWS = [View.look((x, -300.0, 120.0), (0, 0, 0), resolution=(640, 480)) for x in (0.0, 40.0)]


@pytest.mark.parametrize("meshlet", [2, pytest.param(0, marks=pytest.mark.thorough)])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_a_saved_tree_is_the_same_mesh_again(shape, meshlet, monkeypatch):
    monkeypatch.setattr("adaptive_terrain.cbt_terrain.run.launch.SLICE_ITEMS", 64)  # so that three threads share it
    field, criterion, heights = rough(*shape), Criterion(error_px=1.0, meshlet=meshlet), {"vertical_scale": -1.5}
    terrain = Terrain(field, 3)
    terrain.update(criterion, VIEWS[1:], **heights)
    before = arrays(terrain.update(criterion, VIEWS[:1], **heights).surface)
    saved = terrain.tree.to_bytes()
    other = Terrain(field, 1)
    other.update(criterion, VIEWS[1:])  # its earlier mesh does not matter
    again = other.restore(saved, meshlet=meshlet, **heights)
    assert arrays(again.surface) == before and again.bound_px is None and other.tree.to_bytes() == saved
    assert not other.restore(saved, meshlet=meshlet, **heights).changed
    measured = measure(field, again.surface, None, None, -1.5, 0.0, random_points=20_000)
    assert 0.0 < measured.vertical_max_m <= again.bound_m == pytest.approx(sum(vars(again.terms_m).values()))


def test_the_next_update_is_as_if_nothing_had_been_restored():
    field, criterion = rough(65, 65), Criterion(error_px=1.0)
    terrain = Terrain(field, 1)
    terrain.update(criterion, VIEWS[:1])
    saved = terrain.tree.to_bytes()
    for view in (VIEWS[1], VIEWS[0]):
        assert terrain.restore(saved, vertical_offset=5.0).changed
        update = terrain.update(criterion, [view])
        assert arrays(update.surface) == arrays(Terrain(field, 1).update(criterion, [view]).surface)
    assert (terrain.triangles_at([[0.0, 0.0]]) >= 0).all()


def test_foreign_trees_are_refused_and_the_last_mesh_stays():
    terrain = Terrain(rough(65, 65), 1)
    before = arrays(terrain.update(Criterion(error_px=2.0), VIEWS[:1]).surface)
    saved = terrain.tree.to_bytes()
    max_depth, depths = depths_from_bytes(saved)
    shallow = depths_to_bytes(max_depth, np.zeros(1, np.uint8))
    deep = depths_to_bytes(40, np.array([*range(1, 41), 40], np.uint8))
    for tree, meshlet, said in (
        (saved[:-1], 0, "cut short or damaged"),
        (b"mesh", 0, "was not written by this add-on"),
        (shallow, 0, "leaves of 0 .. 0 bisections"),
        (deep, 4, "bisections of a square; expected 1 .. "),
        (saved, 5, "with meshlets of level 5"),
    ):
        with pytest.raises(TerrainError, match=said):
            terrain.restore(tree, meshlet=meshlet)
        assert arrays(terrain.update(Criterion(error_px=2.0), VIEWS[:1]).surface) == before


@pytest.mark.parametrize("damage", [{"meshlet": 1.5}, {"meshlet": "1"}, {"meshlet": None}, {"vertical_scale": "x"}])
def test_damaged_arguments_of_an_exported_tree_are_refused(damage):
    """They come from the JSON of a file."""
    terrain = Terrain(rough(17, 17), 1)
    terrain.update(Criterion(error_px=2.0), VIEWS[:1])
    tree, arguments = terrain.saved()
    with pytest.raises(TerrainError, match="expected a (whole )?number"):
        terrain.restore(tree, **arguments | damage)


def test_leaves_that_do_not_fit_together_are_refused():
    """A tree, but of triangles that would not meet: one half of a diamond is split without the other."""
    terrain = Terrain(rough(65, 65), 1)
    terrain.update(Criterion(error_px=2.0), VIEWS[:1])
    for torn in ([2, 3, 3, 1], [1, 3, 3, 3, 3], [2, 2, 1]):
        with pytest.raises(TerrainError, match="is corrupt; expected leaves that form a conforming mesh"):
            terrain.restore(depths_to_bytes(12, np.array(torn, np.uint8)))
    assert terrain.update(Criterion(error_px=2.0), VIEWS[:1]).triangles > 100
