# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores in which equal pages are stored once: everything is as with whole pages, in less space."""

import errno
import itertools
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import shared_pages
from adaptive_terrain.cbt_terrain.field import store as store_module
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.cell_ranges import rectangle_ranges
from adaptive_terrain.cbt_terrain.field.packing import copy_store
from adaptive_terrain.cbt_terrain.field.shared_pages import SharedPages, image_pages, stored_from
from adaptive_terrain.cbt_terrain.field.store import is_intact, open_store, read_json
from adaptive_terrain.cbt_terrain.field.store_folder import remove_abandoned
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.fit.fit import fit
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.query.box import box_range
from adaptive_terrain.cbt_terrain.query.rays import pick
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.scatter.points import scatter_points
from adaptive_terrain.cbt_terrain.scatter.scatter import Scatter
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View

WIDTH, HEIGHT, STEP = 700, 450, 4.0


def coast() -> np.ndarray:
    """Return float32 [HEIGHT, WIDTH] metres: hills in a sea at 0, and a lake at 40."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    hills = 90 * np.exp(-((x - 150) ** 2 + (y - 90) ** 2) / 6000) + 3 * np.sin(x / 3) * np.cos(y / 4) - 12
    hills[300:420, 500:690] = 40.0
    return np.where((hills > 0) | (hills == 40.0), hills, 0).astype(np.float32)


def imported(folder: Path, name: str) -> Path:
    """Import the coast into a store of a folder; return the store."""
    np.save(folder / "coast.npy", coast())
    extent = ((WIDTH - 1) * STEP, (HEIGHT - 1) * STEP)
    run_import(ImportSettings(source=str(folder / "coast.npy"), extent=extent), folder / name)
    return folder / name


@pytest.fixture(scope="module")
def stores(tmp_path_factory):
    """Return a folder with the same terrain in two stores, "whole" and "shared"."""
    folder = tmp_path_factory.mktemp("coast")
    imported(folder, "whole")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shared_pages, "MIN_SAVED", 0)
        imported(folder, "shared")
    return folder


@pytest.fixture(scope="module")
def pair(stores):
    """Return the height fields of both stores."""
    return open_store(stores / "whole"), open_store(stores / "shared")


@pytest.fixture
def shared(stores, tmp_path):
    """Return a copy of the store with shared pages that a test may damage."""
    return shutil.copytree(stores / "shared", tmp_path / "shared")


def test_small_stores_and_rough_land_have_whole_pages(stores, tmp_path, monkeypatch):
    assert "shared" not in read_json(stores / "whole") and read_json(stores / "whole")["version"] == 6
    monkeypatch.setattr(shared_pages, "MIN_SAVED", 0)
    run_import(ImportSettings(source="mountains", size=129), tmp_path / "mountains")
    assert "shared" not in read_json(tmp_path / "mountains")


@pytest.mark.parametrize("name", ["error", "ranges"])
def test_pages_equal_to_the_one_before_are_not_stored(pair, name):
    whole, found = (getattr(field, name) for field in pair)
    assert isinstance(whole, np.ndarray) and isinstance(found, SharedPages)
    assert found.shape == whole.shape and found.dtype == whole.dtype and len(found) == len(whole)
    pages = [page.tobytes() for page in whole.reshape(-1, 32 * 32, *whole.shape[1:])]
    runs = [page for page, _ in itertools.groupby(pages)]
    assert len(found.stored) == 1024 * len(runs) < 0.7 * len(whole)
    assert found.nbytes < 0.75 * whole.nbytes
    assert np.array_equal(np.asarray(found), whole)


@pytest.mark.parametrize("name", ["error", "ranges"])
def test_parts_of_shared_pages_are_read_like_arrays(pair, name):
    whole, found = (getattr(field, name) for field in pair)
    rng = np.random.default_rng(2)
    for first, end in [(0, 0), (0, 1), (5, 1029), (1024, 2048), (1023, 1025), (len(whole) - 7, len(whole) + 9), (9, 3)]:
        assert np.array_equal(found[first:end], whole[first:end])
    for first, end in rng.integers(0, len(whole), (50, 2)):
        assert np.array_equal(found[first:end], whole[first:end])
    with pytest.raises(IndexError, match="step -1"):
        found[::-1]
    entries = rng.integers(0, len(whole), (40, 30))
    assert np.array_equal(found[entries], whole[entries])


def test_pages_of_an_image_are_copied_alone(pair):
    """Those of the finest vertices; the rows and columns are of pages."""
    (whole, found), lattice = (field.error for field in pair), pair[0].lattice
    (first, end), pages = lattice.layout()[0][:2], int(lattice.layout()[1][0])
    expected = whole[first:end].reshape(-1, pages, 1024)[2:7, 3:9]
    for array in (whole, found):
        assert np.array_equal(image_pages(array, slice(first, end), pages, slice(2, 7), slice(3, 9)), expected)


def test_stored_pages_from_a_page_on_have_all_values(pair):
    whole, found = (field.error for field in pair)
    for page in (0, 3, 40, len(whole) // 1024 - 1):
        assert set(stored_from(found, page * 1024)) == set(whole[page * 1024 :])
    assert np.shares_memory(stored_from(found, 1024), found.stored)
    assert len(stored_from(found, 1024)) < 0.7 * len(stored_from(whole, 1024))


VIEW = View.look((-1500.0, -1200.0, 300.0), (0.0, 0.0, 0.0), resolution=(640, 360))
NEAR = View.look((900.0, 700.0, 60.0), (-900.0, -500.0, 0.0), resolution=(640, 360))


@pytest.mark.parametrize("interpolation", ["bilinear", "bicubic"])
@pytest.mark.parametrize(
    "criterion",
    [
        Criterion(error_px=1.0),
        Criterion(error_px=0.3, meshlet=2),
        Criterion(error_px=0.0, edge_px=9.0),
        Criterion(error_px=0.0, error_m=0.05),
    ],
    ids=["error", "meshlets", "edges", "metres"],
)
def test_meshes_are_those_of_whole_pages(pair, interpolation, criterion):
    terrains = [Terrain(interpolated(field, interpolation)) for field in pair]
    for view in (VIEW, NEAR):
        a, b = (terrain.update(criterion, [view]) for terrain in terrains)
        assert a.triangles == b.triangles > 500
        assert a.surface.positions.tobytes() == b.surface.positions.tobytes()
        assert a.surface.corner_verts.tobytes() == b.surface.corner_verts.tobytes()


@pytest.mark.parametrize("interpolation", ["bilinear", "bicubic"])
def test_queries_are_those_of_whole_pages(pair, interpolation):
    whole, found = (interpolated(field, interpolation) for field in pair)
    rng = np.random.default_rng(4)
    origins = rng.uniform((-1300, -800, 10), (1300, 800, 200), (400, 3))
    directions = rng.normal(size=(400, 3)) - (0, 0, 0.3)
    hits = [pick(field, origins, directions) for field in (whole, found)]
    assert np.isfinite(hits[0].distance).sum() > 50
    assert hits[0].distance.tobytes() == hits[1].distance.tobytes()
    for west, south, width in rng.uniform((-1390, -890, 0), (1000, 500, 300), (30, 3)):
        box = west, south, west + width, south + width
        assert box_range(whole, *box) == box_range(found, *box)
    sides = [(0.0, 40.0), (333.5, 610.0)]
    assert np.array_equal(rectangle_ranges(whole, sides, sides[:1]), rectangle_ranges(found, sides, sides[:1]))


def test_scatters_and_fits_are_those_of_whole_pages(pair):
    points = [scatter_points(field, Scatter(spacing=22.0), [VIEW]) for field in pair]
    assert len(points[0]) > 100 and points[0].positions.tobytes() == points[1].positions.tobytes()
    fitted = [fit(field, 0.4) for field in pair]
    assert fitted[0].surface.positions.tobytes() == fitted[1].surface.positions.tobytes()


def test_every_block_is_verified_and_copied(stores, tmp_path):
    counts = verify(stores / "shared")
    files = {"error_pages.npy", "error_places.npy", "ranges_pages.npy", "ranges_places.npy"}
    assert files < counts.keys() and "error.npy" not in counts
    copy_store(stores / "shared", tmp_path / "copy")
    assert verify(tmp_path / "copy") == counts
    assert not list(stores.glob("shared/data-*/error.npy"))


def replace_places(store: Path, change) -> None:
    """Change the table of a store's errors, with valid checksums."""
    file = next(store.glob("data-*/error_places.npy"))
    places = np.ascontiguousarray(change(np.load(file)), np.int32)
    file.unlink()
    shared_pages.write_array(file, places)


@pytest.mark.parametrize(
    "change",
    [lambda p: p - 1, lambda p: np.where(p > 3, p + 1, p), lambda p: p * 2, lambda p: p[::-1], lambda p: p * 0 - 2**31],
    ids=["negative", "gap", "double", "falling", "lowest"],
)
def test_a_table_with_wrong_numbers_is_refused(shared, change):
    replace_places(shared, change)
    with pytest.raises(TerrainError, match=r"error_places.npy is damaged \(its numbers do not rise by 0 or 1"):
        open_store(shared)


def test_a_table_for_fewer_pages_is_refused(shared):
    replace_places(shared, lambda places: np.minimum(places, 3))
    with pytest.raises(TerrainError, match=r"error_pages.npy is damaged"):
        open_store(shared)


def test_cut_off_pages_are_noticed(shared):
    field = open_store(shared)
    assert is_intact(field)
    with next(shared.glob("data-*/ranges_pages.npy")).open("r+b") as file:
        file.truncate(5000)
    assert not is_intact(field)


def test_a_full_disk_leaves_whole_pages(tmp_path, monkeypatch):
    monkeypatch.setattr(shared_pages, "MIN_SAVED", 0)

    def full(file, *_):
        file.write_bytes(b"begun")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(shared_pages, "allocate_array", full)
    store = imported(tmp_path, "store")
    assert "shared" not in read_json(store) and verify(store)["error.npy"] > 0
    assert not list(store.glob("data-*/*_pages.npy"))


def test_pages_do_not_fill_the_disk(tmp_path, monkeypatch):
    """What is written after them needs room, too."""
    monkeypatch.setattr(shared_pages, "MIN_SAVED", 0)
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shared_pages.shutil, "disk_usage", lambda _: usage._replace(free=9_000_000))
    store = imported(tmp_path, "store")
    assert "shared" not in read_json(store) and verify(store)["error.npy"] > 0


def test_whole_pages_of_a_killed_import_are_removed(tmp_path, monkeypatch):
    """It was killed after it had published the store, and before it removed the pages that are in another file."""

    def killed(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(shared_pages, "MIN_SAVED", 0)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(store_module, "remove_abandoned", killed)
        imported(tmp_path, "store")
    counts, left = verify(tmp_path / "store"), lambda: [*tmp_path.glob("store/data-*/error.npy")]
    assert len(left()) == 1
    remove_abandoned(tmp_path / "store")  # as the next import does
    assert not left() and verify(tmp_path / "store") == counts


def test_pages_of_no_heights_are_refused(tmp_path):
    """A raster of 2 x 2 samples has no ranges; a hostile store may say that they are shared."""
    np.save(tmp_path / "four.npy", np.float32([[1, 2], [3, 4]]))
    store = tmp_path / "four"
    run_import(ImportSettings(source=str(tmp_path / "four.npy")), store)
    content, [ranges] = read_json(store), store.glob("data-*/ranges.npy")
    shared_pages.write_array(ranges.with_name("ranges_places.npy"), np.empty(0, np.int32))
    content |= {"shared": ["ranges"], "version": 8}
    content["sum"] = store_module._sum_of({name: value for name, value in content.items() if name != "sum"})
    (store / "store.json").write_text(json.dumps(content))
    with pytest.raises(TerrainError, match=r"ranges_places.npy is damaged"):
        open_store(store)


def test_mapped_files_are_kept_where_they_cannot_be_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(shared_pages, "MIN_SAVED", 0)
    monkeypatch.setattr(shared_pages, "CAN_REMOVE_MAPPED", False)
    assert "shared" not in read_json(imported(tmp_path, "store"))
