# SPDX-License-Identifier: GPL-3.0-or-later
"""3D Tiles, read back by other code: rules of the format, true errors, shared borders, position on the globe."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.exporting.tileset import export_tileset
from adaptive_terrain.cbt_terrain.field.heightfield import anchored
from forked_programs import run_program
from matplotlib.tri import LinearTriInterpolator, Triangulation
from rasterio.transform import Affine
from rasters import hills, imported, write_raster
from tilesets import read_tileset, surface_of
from transverse_mercator import utm_to_degrees

UTM = {"crs": "EPSG:32632", "transform": Affine(7.3, 0, 532_000.0, 0, -11.9, 5_200_000.0)}


def smooth(width, height):
    y, x = np.indices((height, width))
    return (300 + 120 * np.sin(x / 17) * np.cos(y / 11) + hills(width, height) * 0.02).astype(np.float32)


def export(tmp_path, heights, error=1.0, triangles=500, holes=False, **place):
    field, _ = imported(tmp_path, write_raster(tmp_path / "in.tif", heights, **place), holes=holes)
    return field, export_tileset(field, tmp_path / "land.json", error, triangles)


def bilinear(heights, step, x, y):
    """Return the heights at x, y (metres from the middle) of a raster with row 0 north."""
    rows, columns = heights.shape
    u, v = x / step[0] + (columns - 1) / 2, (rows - 1) / 2 - y / step[1]
    i, j = np.clip(u.astype(int), 0, columns - 2), np.clip(v.astype(int), 0, rows - 2)
    s, t, h = u - i, v - j, heights.astype(float)
    return (h[j, i] * (1 - s) + h[j, i + 1] * s) * (1 - t) + (h[j + 1, i] * (1 - s) + h[j + 1, i + 1] * s) * t


def of_level(tiles, level):
    return [mesh for number, _, mesh in tiles if number == level and mesh is not None]


def plan_areas(mesh):
    a, b, c = (mesh.positions[surface_of(mesh)[:, k], :2].astype(float) for k in range(3))
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


@pytest.fixture(scope="module")
def local(tmp_path_factory):
    """Export 161 x 97 pixels without a coordinate system."""
    tmp_path = tmp_path_factory.mktemp("local")
    heights = smooth(161, 97)
    _, report = export(tmp_path, heights, transform=UTM["transform"])
    return heights, report, *read_tileset(tmp_path / "land.json")


def test_a_tileset_is_a_quadtree_with_falling_errors(local):
    _, report, tileset, tiles = local
    assert "transform" not in tileset["root"] and not report.is_on_globe
    assert report.num_tiles == len(tiles) == sum(4**k for k in range(len(report.bounds))) and len(report.bounds) >= 3
    for level, tile, mesh in tiles:
        assert tile["geometricError"] == report.bounds[level] == mesh.json["asset"]["extras"]["max_error_m"]
        assert mesh.json["meshes"][0]["extras"]["level"] == level
    assert report.bounds == tuple(sorted(report.bounds, reverse=True)) and 0.1 < report.bounds[-1] <= 1.01


def test_true_errors_of_each_level_are_within_its_bound(local):
    """Every sample and 20,000 random points of the bilinear surface; the tiles cover the terrain once."""
    heights, report, _, tiles = local
    rng = np.random.default_rng(1)
    for level, bound in enumerate(report.bounds):
        meshes, worst, covered = of_level(tiles, level), 0.0, 0.0
        for mesh in meshes:
            areas = plan_areas(mesh)
            assert areas.min() > 1e-3, "nothing is turned over"
            covered += areas.sum()
            points = mesh.positions.astype(float)
            low, high = points.min(0), points.max(0)
            x, y = (
                rng.uniform(low[0], high[0], 20_000 // len(meshes)),
                rng.uniform(low[1], high[1], 20_000 // len(meshes)),
            )
            gx, gy = np.meshgrid((np.arange(161) - 80) * 7.3, (np.arange(97) - 48) * 11.9)
            x, y = np.concatenate([x, gx.ravel()]), np.concatenate([y, gy.ravel()])
            found = LinearTriInterpolator(Triangulation(points[:, 0], points[:, 1], surface_of(mesh)), points[:, 2])(
                x, y
            )
            off = abs(found - bilinear(heights, (7.3, 11.9), x, y))
            worst = max(worst, float(off.max()))
        assert covered == pytest.approx(160 * 7.3 * 96 * 11.9, rel=1e-6)
        assert 0.1 * bound < worst <= bound


def test_neighbours_of_a_level_share_their_border(local):
    """Each edge inside the terrain, by its two float32 points, belongs to two triangles in all tiles together."""
    heights, report, _, tiles = local
    for level in range(len(report.bounds)):
        corners = np.concatenate([mesh.positions[surface_of(mesh)] for mesh in of_level(tiles, level)])
        _, numbers = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
        triangles = numbers.reshape(-1, 3)
        edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), 1)
        unique, counts = np.unique(edges, axis=0, return_counts=True)
        assert set(counts) == {1, 2}
        points = np.unique(corners.reshape(-1, 3), axis=0)
        ends = abs(points[unique[counts == 1]][..., :2].astype(float))
        on_border = (ends >= np.array([584 - 1e-3, 571.2 - 1e-3])).all(1).any(1)
        assert on_border.all(), "an edge with one triangle is on the border of the terrain"


def test_skirts_are_deeper_than_the_gap_between_any_levels(local):
    heights, report, _, tiles = local
    for level, bound in enumerate(report.bounds):
        for mesh in of_level(tiles, level):
            walls = mesh.triangles[len(surface_of(mesh)) :]
            assert (level == 0) == (len(walls) == 0)
            if len(walls):
                points = mesh.positions[walls].astype(float)
                assert np.ptp(points[..., 2], 1).min() >= bound + report.bounds[0] - 1e-3
                assert abs(points[..., :2]).max(1).max() <= 584.001
                across = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
                middle = mesh.positions[surface_of(mesh)].mean((0, 1))
                assert ((across * (points.mean(1) - middle))[:, :2].sum(1) > 0).all(), "walls look outwards"


def test_a_tileset_on_the_globe_is_where_its_raster_is(tmp_path):
    """Vertices are converted back to UTM with Karney's series and compared with the raster."""
    heights = smooth(161, 97)
    field, report = export(tmp_path, heights, error=2.0, **UTM)
    tileset, tiles = read_tileset(tmp_path / "land.json")
    matrix = np.array(tileset["root"]["transform"]).reshape(4, 4).T
    assert report.is_on_globe and np.allclose(matrix[:3, :3].T @ matrix[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix[:3, :3]) > 0
    for level in (0, len(report.bounds) - 1):
        for mesh in of_level(tiles, level)[:3]:
            used = np.unique(surface_of(mesh))
            longitude, latitude, height = geodetic(
                mesh.positions[used].astype(float) @ matrix[:3, :3].T + matrix[:3, 3]
            )
            u, v = mesh.uv[used].astype(float).T
            x, y = field.origin[0] + (u - 0.5) * 160 * 7.3, field.origin[1] + (0.5 - v) * 96 * 11.9
            wanted = np.stack(utm_to_degrees(x, y, 9.0), -1)
            assert abs(np.stack([longitude, latitude], -1) - wanted).max() * 111_320 < 2e-3
            off = height - bilinear(heights, (7.3, 11.9), x - field.origin[0], y - field.origin[1])
            assert abs(off).max() <= report.bounds[level]


def test_an_anchor_does_not_move_a_tileset(tmp_path):
    """Corners of both tilesets have the same Earth-centred coordinates."""
    place = {"crs": "EPSG:32632", "transform": Affine(300.0, 0, 532_000.0, 0, -200.0, 5_200_000.0)}
    field, _ = imported(tmp_path, write_raster(tmp_path / "in.tif", smooth(33, 33), **place))
    found = []
    for exported in (field, anchored(field, 3072.0, -2048.0)):
        export_tileset(exported, tmp_path / "land.json", 50.0, 10_000)
        tileset, [(_, _, mesh)] = read_tileset(tmp_path / "land.json")
        matrix = np.array(tileset["root"]["transform"]).reshape(4, 4).T
        corners = mesh.positions[[np.abs(mesh.uv - corner).sum(1).argmin() for corner in np.ndindex(2, 2)]]
        found.append(corners.astype(float) @ matrix[:3, :3].T + matrix[:3, 3])
    assert np.ptp(found[0], axis=0).max() > 5000.0 and np.abs(found[0] - found[1]).max() < 2e-3


def geodetic(points):
    """Return longitude, latitude (degrees) and height of ECEF points (WGS 84), by iteration."""
    a, f = 6378137.0, 1 / 298.257223563
    e2, (x, y, z) = f * (2 - f), points.T
    across = np.hypot(x, y)
    latitude = np.arctan2(z, across * (1 - e2))
    for _ in range(10):
        radius = a / np.sqrt(1 - e2 * np.sin(latitude) ** 2)
        height = across / np.cos(latitude) - radius
        latitude = np.arctan2(z, across * (1 - e2 * radius / (radius + height)))
    return np.degrees(np.arctan2(y, x)), np.degrees(latitude), height


@pytest.mark.thorough
def test_the_bound_on_the_globe_contains_the_curvature(tmp_path):
    """A plane of 200 km: points of its triangles are compared with the same points on the ellipsoid."""
    transform = Affine(20_000.0, 0, 400_000.0, 0, -20_000.0, 5_300_000.0)
    field, report = export(tmp_path, np.full((11, 11), 100, np.float32), crs="EPSG:32632", transform=transform)
    tileset, [(_, _, mesh)] = read_tileset(tmp_path / "land.json")
    matrix = np.array(tileset["root"]["transform"]).reshape(4, 4).T
    shares = np.random.default_rng(2).dirichlet([1, 1, 1], (len(mesh.triangles), 5000))
    u, v = np.einsum("tnk,tkc->tnc", shares, mesh.uv[mesh.triangles].astype(float)).reshape(-1, 2).T
    x, y = field.origin[0] + (u - 0.5) * 200_000, field.origin[1] + (0.5 - v) * 200_000
    longitude, latitude = np.radians(utm_to_degrees(x, y, 9.0))
    e2 = (2 - 1 / 298.257223563) / 298.257223563
    radius = 6378137.0 / np.sqrt(1 - e2 * np.sin(latitude) ** 2)
    across = (radius + 100) * np.cos(latitude)
    wanted = [across * np.cos(longitude), across * np.sin(longitude), (radius * (1 - e2) + 100) * np.sin(latitude)]
    local = np.einsum("tnk,tkc->tnc", shares, mesh.positions[mesh.triangles].astype(float)).reshape(-1, 3)
    off = np.sqrt(((local @ matrix[:3, :3].T + matrix[:3, 3] - np.stack(wanted, -1)) ** 2).sum(1)).max()
    assert 500 < off < report.bounds[0] < 1.5 * off


def test_holes_and_flat_land_have_sound_tilesets(tmp_path):
    heights = np.full((65, 65), 50, np.float32)
    heights[:40, :40] = np.nan
    _, report = export(tmp_path, heights, 0.5, 4, holes=True)
    _, tiles = read_tileset(tmp_path / "land.json")
    assert report.num_tiles == len([mesh for _, _, mesh in tiles if mesh is not None]) > 1
    assert {mesh.positions[:, 2].max() for _, _, mesh in tiles if mesh is not None} == {50.0}


@pytest.mark.parametrize("shape", [(3, 1025), pytest.param((1025, 3), marks=pytest.mark.thorough)])
def test_levels_of_a_narrow_terrain_follow_its_long_side(tmp_path, shape):
    heights = np.broadcast_to(np.random.default_rng(3).uniform(0, 50, (1, 1025)), (3, 1025)).astype(np.float32)
    _, report = export(tmp_path, heights if shape == heights.shape else heights.T, 0.5, 50)
    _, tiles = read_tileset(tmp_path / "land.json")
    meshes = of_level(tiles, len(report.bounds) - 1)
    counts = [len(surface_of(mesh)) for mesh in meshes]
    assert len(report.bounds) == 6 and len(meshes) == 2 * 32, "cells of the short side, tiles of the long one"
    assert np.mean(counts) < 1.5 * 50 and sum(plan_areas(mesh).sum() for mesh in meshes) == pytest.approx(
        2 * 1024, rel=1e-6
    )


def test_the_same_terrain_gives_the_same_bytes(tmp_path, monkeypatch):
    from adaptive_terrain.cbt_terrain.run import launch

    field, _ = imported(tmp_path, write_raster(tmp_path / "in.tif", smooth(161, 97)))
    found = []
    for threads in (1, 2, 3):
        monkeypatch.setattr(launch, "default_threads", lambda threads=threads: threads)
        export_tileset(field, tmp_path / "land.json", 1.0, 500)
        found.append({path.name: path.read_bytes() for path in tmp_path.glob("land*")})
    assert found[0] == found[1] == found[2] and len(found[0]) > 20


def test_tilesets_that_cannot_be_made_are_refused(tmp_path):
    field, _ = imported(tmp_path, write_raster(tmp_path / "in.tif", smooth(20, 20)))
    for path, error in (("land.glb", 1.0), ("none/land.json", 1.0), ("land.json", 0.0), ("land.json", float("nan"))):
        with pytest.raises(TerrainError):
            export_tileset(field, tmp_path / path, error)
    assert not list(tmp_path.glob("land*"))


def test_addresses_of_tiles_are_quoted(tmp_path):
    field, _ = imported(tmp_path, write_raster(tmp_path / "in.tif", smooth(20, 20)))
    path = tmp_path / "a b#c?d%20é.json"
    export_tileset(field, path, 1.0)
    tileset, tiles = read_tileset(path)
    assert tileset["root"]["content"]["uri"] == "a%20b%23c%3Fd%2520%C3%A9_0_0_0.glb" and len(tiles) == 1


def test_a_tileset_does_not_replace_the_description_of_a_store(tmp_path):
    field, _ = imported(tmp_path, write_raster(tmp_path / "in.tif", smooth(20, 20)))
    before = sorted(field.path.rglob("*"))
    with pytest.raises(TerrainError, match="belongs to a terrain store"):
        export_tileset(field, field.path / "store.json", 1.0)
    assert sorted(field.path.rglob("*")) == before


def test_a_second_export_of_one_tileset_is_refused(tmp_path):
    field, refused = imported(tmp_path, write_raster(tmp_path / "in.tif", smooth(20, 20), **UTM))[0], []

    def while_writing(_done):
        with pytest.raises(TerrainError, match="land.json and the files with it are being written by another export"):
            export_tileset(field, tmp_path / "land.json", 1.0)
        refused.append(_done)

    export_tileset(field, tmp_path / "land.json", 1.0, on_progress=while_writing)
    assert refused and export_tileset(field, tmp_path / "land.json", 1.0).num_tiles > 0


def test_a_full_disk_is_reported_with_the_tileset(tmp_path, monkeypatch):
    field, _ = imported(tmp_path, write_raster(tmp_path / "in.tif", smooth(20, 20), **UTM))

    def save(*_):
        raise OSError("99 requested and 1 written")  # numpy's own, without an error number

    monkeypatch.setattr(np, "save", save)
    with pytest.raises(TerrainError, match=r"land.json cannot be written \(99 requested and 1 written\)"):
        export_tileset(field, tmp_path / "land.json", 1.0)
    assert not list(tmp_path.glob("*land*"))


def test_what_a_killed_export_has_left_is_removed(tmp_path):
    field, _ = imported(tmp_path, write_raster(tmp_path / "in.tif", smooth(20, 20)))
    module, out = "adaptive_terrain.cbt_terrain.run.partial_files", tmp_path / "out"
    out.mkdir()
    begin = f"import os, pathlib, {module} as m; file = m.written_beside(pathlib.Path({str(out / 'a.glb')!r}))"
    run_program(f"{begin}; file.__enter__(); os._exit(1)")
    assert len(list(out.iterdir())) == 1
    export_tileset(field, out / "land.json", 1.0)
    assert sorted(path.name for path in out.iterdir()) == ["land.json", "land_0_0_0.glb"]
