# SPDX-License-Identifier: GPL-3.0-or-later
"""The walk against a forced-split reference that knows nothing of curves and nesting, and the criterion's bounds."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.refine.refinement import _cuts
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, View
from fields import extent, random_view, rough
from reference_bisection import forced_split_leaves, from_tree_id
from reference_criterion import correction, reference_pixels

SHAPES = [(9, 9), (17, 9), (9, 25), (6, 10), (3, 2)]


def tree_leaves(terrain: Terrain) -> list[tuple[int, int]]:
    """(square, heap id) of the leaves of the tree, in curve order, without those that only fill it."""
    lattice = terrain.field.lattice
    nodes = (from_tree_id(lattice, leaf) for leaf in terrain.tree.leaves())
    return [node for node in nodes if node[0] < lattice.squares]


@pytest.mark.parametrize(
    "seed", [*range(5), *(pytest.param(seed, marks=pytest.mark.thorough) for seed in range(5, 12))]
)
def test_leaves_equal_forced_splits(seed):
    rng = np.random.default_rng(seed)
    field = rough(*SHAPES[seed % len(SHAPES)], seed=seed, relief=30.0)
    lattice = field.lattice
    depth = int(rng.integers(1, lattice.cell_depth + 1))
    for _ in range(3):
        view = random_view(rng, field)
        asked = float(10 ** rng.uniform(0, 2.5))
        terrain = Terrain(field, 1)
        update = terrain.update(Criterion(error_px=asked, off_screen_factor=1.0, max_depth=depth), [view])
        rounded = terrain._placed[1].rounding
        # the reference's units: 2^exponent a side of a root square
        exponent = lattice.levels + 1
        per_sample = 2.0 ** (exponent - lattice.levels)

        times = correction(view, asked)

        def wants(x, y, d, view=view, asked=asked, times=times, per_sample=per_sample, rounded=rounded):
            return reference_pixels(field, view, x / per_sample, y / per_sample, d, rounded) * times > asked

        expected = forced_split_leaves(lattice.columns, lattice.rows, depth, wants, exponent)
        found = tree_leaves(terrain)
        assert set(found) == expected and len(found) == len(expected) == update.leaves


def test_tree_holds_the_leaves_in_curve_order():
    field = rough(17, 33)
    terrain = Terrain(field, 1)
    update = terrain.update(Criterion(error_m=5.0, error_px=0.0))
    leaves = tree_leaves(terrain)
    assert [heap.bit_length() - 1 for _, heap in leaves] == update.surface.level.tolist()
    assert leaves == sorted(leaves, key=lambda leaf: (leaf[0], leaf[1] / (1 << leaf[1].bit_length() - 1)))


def test_vertical_error_needs_no_view_and_meets_the_request():
    field = rough(33, 33)
    for asked in (50.0, 5.0, 0.5):
        update = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=asked))
        assert update.bound_m <= asked and update.bound_px is None and update.limited == ""


@pytest.mark.parametrize(("kind", "edge_px"), [("PERSPECTIVE", 160.0), ("PANORAMIC", 80.0)])
def test_errors_and_edges_refine_what_each_of_them_refines(kind, edge_px):
    """Errors have slants and edges have none, so from above the mesh of both is the union of two meshes."""
    view = View.look((30.0, -40.0, 300.0), (31.0, -40.0, 0.0), kind=kind, fov_deg=140.0)
    cells = []
    for asked in ({"error_px": 2.0}, {"error_px": 0.0, "edge_px": edge_px}, {"error_px": 2.0, "edge_px": edge_px}):
        terrain = Terrain(rough(65, 65), 1)
        update = terrain.update(Criterion(**asked), [view])
        assert (update.bound_px or 0) <= 2.0 and (update.bound_edge_px or 0) <= edge_px
        cells.append(set(terrain.tree.cells().tolist()))
    of_errors, of_edges, both = cells
    assert both == of_errors | of_edges and len(both) > 1.1 * max(len(of_errors), len(of_edges))


@pytest.mark.parametrize("heights", [(1000.0,), (1000.0, 610.0), (333.0,)])
def test_an_error_just_above_a_code_takes_no_extra_level(heights):
    """On a cliff errors are h / 4^k. The request is 0.1 % above one of them, or 4 % above, beyond the rounding."""
    y, x = np.mgrid[0:90, 0:121]
    steps = [np.where(x + 0.3 * y > 45 + 40 * k, h, 0.0) for k, h in enumerate(heights)]
    field = from_array(np.sum(steps, axis=0).astype(np.float32), 1.0)
    for level in (3, 4, 5):
        near, above = (
            Terrain(field, 1).update(Criterion(error_px=0.0, error_m=heights[0] / 4**level * part)).triangles
            for part in (1.001, 1.04)
        )
        assert above <= near <= 1.2 * above


@pytest.mark.parametrize("fov_deg", [0.5, 2.0, 10.0, 50.0])
def test_little_is_drawn_outside_a_narrow_frame(fov_deg):
    """By default: at most 1.3 times the triangles that the frame alone takes."""
    field = rough(257, 257, seed=1, relief=60.0, step=30.0)
    away = 3000.0 / np.tan(np.radians(fov_deg / 2)) ** 0.5
    view = View.look((-away, 0.2 * away, 0.4 * away), (0, 0, 0), fov_deg=fov_deg, clip=(1, 1e7))
    frame = Terrain(field, 1).update(Criterion(error_px=1.0, guard_deg=0.0, off_screen_factor=1e12), [view])
    whole = Terrain(field, 1).update(Criterion(error_px=1.0), [view])
    assert whole.triangles < 1.3 * frame.triangles and frame.triangles > 1000


def test_caps_hold_together_with_the_error():
    field = rough(33, 33, relief=20.0)
    view = View.look((0, -500, 300), (0, 0, 0))
    alone = Terrain(field, 1).update(Criterion(error_px=4.0), [view])
    capped = Terrain(field, 1).update(Criterion(error_px=4.0, edge_px=60.0, area_px=900.0), [view])
    assert capped.bound_px <= 4.0 and capped.bound_edge_px <= 60.0 and capped.bound_area_px <= 900.0
    assert capped.leaves > alone.leaves

    p = capped.surface.positions.astype(np.float64)
    camera = p @ view.world_to_camera[:3, :3].T + view.world_to_camera[:3, 3]
    device = np.c_[camera, np.ones(len(p))] @ view.projection.T
    pixels = device[:, :2] / device[:, 3:] * np.array(view.resolution) / 2
    seen = (np.abs(device[:, :2] / device[:, 3:]) <= 1).all(axis=1)[capped.surface.edges].all(axis=1)
    ends = pixels[capped.surface.edges[seen]]
    assert np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).max() <= capped.bound_edge_px


@pytest.mark.parametrize(
    ("height", "width", "edge_px", "limited"),
    [(8e3, 2.0, 60.0, ""), (8e3, 2.0, 20.0, "max_depth"), (1e6, 4.0, 60.0, "precision"), (1e6, 4.0, 40.0, "precision")],
)
def test_edges_hold_where_float32_corners_stretch_them(height, width, edge_px, limited):
    """Corners far from the origin are off by millimetres, which edges of half a metre show."""
    heights = height + 100.0 * np.random.default_rng(4).normal(size=(33, 33))
    field = from_array(heights.astype(np.float32), 1000.1)
    eye = np.array([15_003.3, 15_002.7, height + 1000.0])
    view = View.look(
        eye, eye - [0, 0, 1], kind=ORTHOGRAPHIC, ortho_width=width, resolution=(200, 200), clip=(1.0, 2000.0)
    )
    update = Terrain(field, 1).update(
        Criterion(error_px=0.0, edge_px=edge_px, max_depth=34, off_screen_factor=1e30), [view]
    )
    assert update.limited == limited and (update.bound_edge_px > edge_px) == bool(limited)
    p = update.surface.positions.astype(np.float64)
    camera = p @ view.world_to_camera[:3, :3].T + view.world_to_camera[:3, 3]
    pixels = camera[:, :2] * view.pixels_per_unit
    ends = pixels[update.surface.edges]
    seen = (np.abs(ends) < 100).all(axis=(1, 2))
    longest = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)[seen].max()
    assert 0.5 * update.bound_edge_px < longest <= update.bound_edge_px


def test_off_screen_factor_coarsens_only_what_is_outside():
    field = rough(65, 65)
    view = View.look((0, -330, 100), (0, 0, 0), fov_deg=30)
    counts = [
        Terrain(field, 1).update(Criterion(error_px=0.5, off_screen_factor=factor), [view]).leaves
        for factor in (1.0, 4.0, 64.0)
    ]
    assert counts[0] > counts[1] > counts[2]


def test_meshlets_need_fewer_leaves_for_the_same_bound():
    field = rough(65, 65)
    view = View.look((0, -500, 300), (0, 0, 0))
    whole = Terrain(field, 1).update(Criterion(error_px=1.0), [view])
    for meshlet in (1, 2, 3):
        update = Terrain(field, 1).update(Criterion(error_px=1.0, meshlet=meshlet), [view])
        assert update.leaves < whole.leaves and update.triangles == update.leaves << (2 * meshlet)
        assert update.bound_px <= 1.0


def test_an_unusable_criterion_is_one_clear_error():
    for wrong in ({"error_px": -1}, {"error_px": 0.0}, {"meshlet": 5}, {"off_screen_factor": 0.5}, {"max_depth": 0}):
        with pytest.raises(TerrainError, match="expected|ask for"):
            Criterion(**wrong)
    with pytest.raises(TerrainError, match="no camera"):
        Terrain(rough(9, 9), 1).update(Criterion())


def test_a_near_view_refines_below_the_raster_cells():
    field = rough(17, 17)
    eye = np.array([0.0, 0.0, field.max_height + 1.0])
    update = Terrain(field, 1).update(Criterion(error_px=1.0), [View.look(eye, eye + extent(field) * [1, 0, -0.1])])
    assert update.surface.level.max() > field.lattice.cell_depth


def test_extreme_requests_are_the_finest_and_the_coarsest_mesh():
    field = rough(9, 9)
    view = View.look((0, -100, 50), (0, 0, 0))
    finest = Terrain(field, 1).update(Criterion(error_px=1e-12, max_depth=9), [view]).triangles
    for tiny in (1e-300, 1e-45, 1e-38):
        update = Terrain(field, 1).update(Criterion(error_px=tiny, max_depth=9), [view])
        assert update.triangles == finest and update.limited == "precision", "no depth would hold it"
        budget = Terrain(field, 1).update(Criterion(error_px=tiny, max_triangles=200), [view])
        assert 100 < budget.triangles <= 200 and budget.limited == "max_triangles"
        assert Terrain(field, 1).update(Criterion(error_px=0, error_m=tiny, max_depth=9)).triangles > 100
    assert Terrain(field, 1).update(Criterion(error_px=0.1, max_depth=5), [view]).limited == "max_depth"
    for criterion in (Criterion(error_px=1e300), Criterion(error_px=0, edge_px=1e300, off_screen_factor=1e300)):
        assert Terrain(field, 1).update(criterion, [view]).triangles == 2


def test_axes_in_one_plane_are_refused():
    flat = np.eye(4)
    flat[:3, 2] = flat[:3, 0] * (1 + 1e-16)
    with pytest.raises(TerrainError, match="scale|axes"):
        Terrain(rough(9, 9), 1).update(Criterion(), [View.look((0, -100, 50), (0, 0, 0))], flat)


def test_threads_share_the_curve_by_cost(eager_threads):
    """Where the last slices cost 3 to 1 a leaf, the next cut is within the first of them."""
    field, view = rough(65, 129), View.look((0.0, -300.0, 200.0), (0, 0, 0), resolution=(640, 480))
    terrain = Terrain(field, 2)
    leaves = terrain.update(Criterion(error_px=1.0), [view]).leaves
    tree, last = terrain.tree, terrain.history.last.leaves
    for costs, share in (((3, 1), 1 / 3), ((1, 3), 2 / 3), ((1, 1), 1 / 2)):
        half = leaves // 2
        last.counts = np.array([[half, 0, 0], [leaves - half, 0, 0]])
        last.work = np.array(costs) * half
        _, cut, _ = _cuts(terrain.history, field.lattice, 2)
        near = (int(share * leaves) - 1, int(share * leaves))  # an odd number of leaves has no half
        assert cut in [int(tree.cells()[leaf]) >> 6 << 6 for leaf in near]
