# SPDX-License-Identifier: GPL-3.0-or-later
"""What holds after every update: the invariants I1 to I6 of the hard cases, asserted by one function."""

from dataclasses import replace

import numpy as np
from adaptive_terrain.cbt_terrain.field.lattice import Lattice
from adaptive_terrain.cbt_terrain.mesh.surface import Surface
from adaptive_terrain.cbt_terrain.terrain import Terrain


def assert_invariants(surface: Surface, lattice: Lattice, meshlet: int = 0) -> None:
    """Assert I1 .. I6 for the surface of one terrain. `meshlet`: each leaf became 4**meshlet triangles."""
    positions, corners, edges = surface.positions, surface.triangles, surface.edges
    sides = surface.corner_edges.reshape(-1, 3)
    count_v, count_e, count_t = len(positions), len(edges), len(corners)

    # I1 finite; normals of length 1
    for array in (positions, surface.normals, surface.uv):
        assert np.isfinite(array).all()
    assert np.abs(np.linalg.norm(surface.normals.astype(np.float64), axis=1) - 1).max() < 1e-6
    beyond = np.array(lattice.span) / (lattice.cells_x, lattice.cells_y)  # size of the squares relative to the raster
    assert surface.uv.min() >= 0 and (surface.uv <= beyond.astype(np.float32)).all()

    # indices in range, every vertex used
    assert corners.min() == 0 and corners.max() == count_v - 1 and np.bincount(corners.ravel()).min() > 0
    assert sides.min() == 0 and sides.max() == count_e - 1

    # corner edges are the edges between corners, each edge once
    after, low_end, high_end = corners[:, [1, 2, 0]], np.minimum(*edges.T), np.maximum(*edges.T)
    assert np.array_equal(np.minimum(corners, after), low_end[sides])
    assert np.array_equal(np.maximum(corners, after), high_end[sides])
    assert count_distinct(low_end.astype(np.int64) * count_v + high_end) == count_e

    # I2 interior edges belong to two triangles, border edges to one; and the border is the domain's
    uses = np.bincount(sides.ravel(), minlength=count_e)
    assert uses.min() == 1 and uses.max() <= 2
    plane = positions[:, :2].astype(np.float64)
    low, high = plane.min(axis=0), plane.max(axis=0)
    size = np.array([lattice.cells_x, lattice.cells_y], np.float64) * (lattice.step_x, lattice.step_y)
    assert np.allclose(high - low, size, rtol=1e-6)
    border = plane[edges[uses == 1]]
    assert (((border == low) | (border == high)).all(axis=1)).any(axis=1).all()

    # I3 one sheet; every triangle counter-clockwise seen from above; each interior edge is run in both directions
    assert count_v - count_e + count_t == 1
    upward = np.bincount(sides[corners < after], minlength=count_e)
    assert upward.max() <= 1 and (uses - upward).max() <= 1

    # I4 the leaves partition the domain: two triangles of depth 1 a root square, in integers; a rim cuts some of them
    counts = np.bincount(surface.level).tolist()
    if not lattice.is_padded:
        assert sum(n << len(counts) - depth for depth, n in enumerate(counts)) == lattice.squares << len(counts)
        assert count_t % (1 << 2 * meshlet) == 0

    # I5 no two vertices at one place
    places = np.ascontiguousarray(positions[:, :2], np.float32) + np.float32(0)  # no -0
    assert count_distinct(places.view(np.uint64).ravel()) == count_v

    # I6 positive area in the plane, adding up to the domain
    p = plane[corners]
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    areas = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    assert areas.min() > 0
    assert abs(areas.sum() / 2 / np.prod(size) - 1) < 1e-6


def count_distinct(values: np.ndarray) -> int:
    ordered = np.sort(values)
    return 1 + int(np.count_nonzero(ordered[1:] != ordered[:-1]))


def with_arrays(surface: Surface, **arrays) -> Surface:
    """Return the surface with some arrays replaced, topology or attributes; they need not fit together."""
    old = surface.attributes
    attributes = {name: replace(old[name], array=arrays.pop(name)) for name in [*arrays] if name in old}
    return replace(surface, **arrays, attributes=old | attributes)


def arrays(surface: Surface) -> dict[str, bytes]:
    """Return the bytes of each array, to compare meshes that must be equal."""
    return {name: array.tobytes() for name, array in surface.arrays().items()}


def reused_leaves(terrain: Terrain) -> int:
    """Return the number of leaves that the last update reused from the frame before."""
    history = terrain.history
    return int(history.scratch.numpy("reused")[: history.last.subtrees.slots].sum())
