# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights, normals and slopes at places, and profiles, against surfaces evaluated in numpy and against the mesh."""

import numpy as np
import pytest
from adaptive_terrain import Criterion, Terrain, ground_at, profile
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from fields import reference_heights, scattered
from query_fields import ROUGH, SHAPE, SURFACES, with_holes
from sight_lines import holes_of


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("heights", [(1.0, 0.0), (-2.5, 30.0), (0.0, 12.0)])
def test_heights_are_those_of_the_surface(name, heights):
    field, places = SURFACES[name], scattered(SURFACES[name], 4000)
    found, truth = ground_at(field, places, *heights), reference_heights(field, places) * heights[0] + heights[1]
    assert found.inside.all() and np.abs(found.heights - truth).max() < 1e-10
    assert np.abs(np.linalg.norm(found.normals, axis=1) - 1).max() < 1e-15
    assert np.abs(np.cos(found.slopes) - found.normals[:, 2]).max() < 1e-14


@pytest.mark.parametrize("name", ["bicubic", "masked"])
def test_normals_are_those_of_smooth_surfaces(name):
    places, apart = np.random.default_rng(1).uniform(-150, 150, (500, 2)), 1e-5
    east, west, north, south = (
        reference_heights(SURFACES[name], places + apart * np.array(way)) for way in ((1, 0), (-1, 0), (0, 1), (0, -1))
    )
    slope = np.stack([east - west, north - south], 1) / (2 * apart)
    normals = ground_at(SURFACES[name], places, vertical_scale=3.0).normals
    assert np.abs(normals[:, :2] / normals[:, 2:] + 3 * slope).max() < 2e-5


def test_normals_of_bilinear_ground_are_central_differences():
    north, east = np.gradient(ROUGH.samples.astype(float), 7.0)
    places = scattered(ROUGH, 3000)
    normals = ground_at(ROUGH, places).normals
    for axis, slopes in enumerate((east, north)):
        truth = reference_heights(ROUGH.with_raster(samples=slopes), places)
        assert np.abs(normals[:, axis] / normals[:, 2] + truth).max() < 1e-12


@pytest.mark.parametrize("name", SURFACES)
def test_the_mesh_lies_on_it_with_these_normals(name):
    surface = Terrain(SURFACES[name]).update(Criterion(error_px=0.0, error_m=3.0), vertical_scale=2.0).surface
    found = ground_at(SURFACES[name], surface.positions[:, :2], vertical_scale=2.0)
    assert found.inside.all()  # also where float32 has rounded the rim
    assert np.abs(found.heights - surface.positions[:, 2]).max() < 1e-4
    assert np.abs(found.normals - surface.normals).max() < 1e-4


def test_only_borders_that_float32_rounds_are_inside():
    field = from_array(np.ones((4, 3)), 1e5 / 3)
    rim = np.array(field.lattice.rectangle()[2:])
    corners = rim * [[1, 1], [-1, 1], [1, -1], [-1, -1]]
    assert ground_at(field, corners.astype(np.float32)).inside.all()
    beyond = ground_at(field, corners * (1 + 1e-6))
    assert not beyond.inside.any() and np.isnan(beyond.heights).all() and np.isnan(beyond.normals).all()


def test_holes_have_no_ground_and_their_borders_have():
    field = with_holes()
    holes, (west, south, _, _) = holes_of(field), field.lattice.rectangle()
    rng = np.random.default_rng(0)
    places = rng.uniform((west, south), (-west, -south), (4000, 2))
    column, row = ((places - (west, south)) / 7.0).astype(int).T
    found = ground_at(field, places)
    assert np.array_equal(found.inside, ~holes[row, column]) and 50 < holes[row, column].sum()
    assert np.array_equal(np.isnan(found.slopes), ~found.inside)
    # a sample is ground if a cell at it is
    beside = ~np.pad(holes, 1, constant_values=True)
    touched = beside[1:, 1:] | beside[1:, :-1] | beside[:-1, 1:] | beside[:-1, :-1]
    j, i = np.indices(SHAPE).reshape(2, -1)
    samples = np.stack([west + 7.0 * i, south + 7.0 * j], 1)
    assert np.array_equal(ground_at(field, samples).inside, touched.ravel())


def test_any_number_of_threads_gives_the_same_bytes():
    places = np.random.default_rng(3).uniform(-300, 300, (50_000, 2))
    one, five = (ground_at(SURFACES["masked"], places, threads=n) for n in (1, 5))
    assert all(a.tobytes() == b.tobytes() for a, b in zip(one, five, strict=True))
    assert not one.inside.all() and one.inside.any()


@pytest.mark.parametrize(
    ("places", "said"),
    [
        ([[0, 0], [np.nan, 1]], r"Number 1 of the places is \(nan, 1\); expected finite metres"),
        ([[0, 0, 0]], r"shape \(1, 3\); expected \[n, 2\] metres"),
        ([["a", "b"]], "are no numbers"),
    ],
)
def test_bad_places_are_refused(places, said):
    with pytest.raises(TerrainError, match=said):
        ground_at(ROUGH, places)
    assert len(ground_at(ROUGH, []).heights) == 0 and ground_at(ROUGH, [0, 0]).inside.tolist() == [True]
    with pytest.raises(TerrainError, match="vertical scale nan"):
        ground_at(ROUGH, [[0, 0]], vertical_scale=np.nan)


def test_a_profile_has_every_crossing_of_lines_of_samples():
    west, south, east, north = ROUGH.lattice.rectangle()
    line = [(west, south), (east, north - 3.0), (east, 0.0), (1.0, 0.0), (1.0, 0.0), (-500.0, 1.0)]
    found = profile(ROUGH, line, vertical_scale=2.0, vertical_offset=1.0)
    beyond = found.places[:, 0] < west
    assert beyond.sum() == 1 and np.isnan(found.heights[beyond]).all()
    truth = 2 * reference_heights(ROUGH, found.places) + 1
    assert np.abs(found.heights - truth)[~beyond].max() < 1e-10
    legs = np.linalg.norm(np.diff(line, axis=0), axis=1)
    assert np.isclose(found.along[-1], legs.sum()) and (np.diff(found.along) >= 0).all()
    # between two of them is no line of samples
    cells = (found.places - (west, south)) / 7.0
    middle, half = (cells[1:] + cells[:-1]) / 2, np.abs(np.diff(cells, axis=0)) / 2
    off = np.abs(middle - np.rint(middle))
    within = (middle > 0).all(axis=1)
    assert (off + 1e-9 >= half)[within].all()
    for corner in line:
        assert (np.abs(found.places - corner).max(axis=1) < 1e-9).any()


def test_a_profile_with_a_spacing_is_even():
    found = profile(ROUGH, [(-100, 0), (0, 0), (0, 51)], spacing=20)
    assert found.along.tolist() == [0, 20, 40, 60, 80, 100, 120, 140, 151]
    assert np.abs(found.places[[0, 5, 6, 8]] - [(-100, 0), (0, 0), (0, 20), (0, 51)]).max() < 1e-12


@pytest.mark.parametrize("spacing", [0.0, -1.0, np.nan, 1e-9])
def test_bad_profiles_are_refused(spacing):
    with pytest.raises(TerrainError, match="spacing"):
        profile(ROUGH, [(-100, 0), (0, 0)], spacing=spacing)
    with pytest.raises(TerrainError, match="1 points; expected 2"):
        profile(ROUGH, [(-100, 0)])
    with pytest.raises(TerrainError, match="1e\\+308 m from the terrain's middle"):
        profile(ROUGH, [(-1e308, 0), (0, 1e308)])
