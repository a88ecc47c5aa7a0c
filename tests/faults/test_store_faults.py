# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores that are damaged, deleted, or written by several processes at once."""

import json
import os
import shutil
import subprocess
import time

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import store as store_module
from adaptive_terrain.cbt_terrain.field import store_arrays, store_folder
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from forked_programs import start_program
from invariants import arrays, assert_invariants
from mutants import put_checksums

ASKED = Criterion(error_px=0, error_m=20.0, meshlet=1)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Write a store of 129 x 129 samples with its errors for meshlets."""
    path = tmp_path_factory.mktemp("whole") / "store"
    run_import(ImportSettings(source="island", size=129), path)
    Terrain(open_store(path), 1).update(ASKED)
    return path


@pytest.fixture
def store(whole, tmp_path):
    """Copy the whole store."""
    return shutil.copytree(whole, tmp_path / "store")


def arrays_of(store):
    [folder] = store.glob("data-*")
    return sorted(folder.iterdir())


def mesh(field):
    update = Terrain(field, 1).update(ASKED)
    assert_invariants(update.surface, field.lattice, meshlet=1)
    return arrays(update.surface)


@pytest.mark.parametrize("left", [0, 1, 100, 4096, 0.5, -1])
@pytest.mark.parametrize("name", ["samples.npy", "error.npy", "ranges.npy", "error_m1.npy"])
def test_an_array_is_cut_short(store, name, left):
    before = mesh(open_store(store))
    [file] = [path for path in arrays_of(store) if path.name == name]
    size = file.stat().st_size
    os.truncate(file, int(size * left) if isinstance(left, float) else left if left >= 0 else size + left)
    if name == "error_m1.npy":  # it is made anew from the others
        assert mesh(open_store(store)) == before
        assert mesh(open_store(store)) == before
        return
    with pytest.raises(TerrainError, match=f"{name}.*import") as caught:
        open_store(store)
    assert "\n" not in str(caught.value)
    run_import(ImportSettings(source="island", size=129), store)  # mends it
    assert mesh(open_store(store)) == before


def overwrite(file, value, where=slice(None), dtype=np.float32, fits=True):
    """Change values of an array; `fits`: with checksums that fit, so that only what they do is noticed."""
    raw = bytearray(file.read_bytes())
    nbytes = len(np.load(file).reshape(-1)) * np.dtype(dtype).itemsize
    np.frombuffer(raw, np.uint8, nbytes, 4096).view(dtype)[where] = value
    if fits:
        put_checksums(raw)
    file.write_bytes(raw)


VIEWS = [[View.look((60.0 * k, -900.0, 500.0), (0, 0, 0))] for k in range(3)]


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("meshlet", [0, 2])
@pytest.mark.parametrize("value", [0, 128, 255, "random"])
def test_errors_that_are_anything_give_a_mesh_or_one_sentence(store, monkeypatch, value, meshlet, threads):
    """In every second entry, so that nothing is nested; and the terrain goes on with what still can be had."""
    from adaptive_terrain.cbt_terrain.run import launch

    monkeypatch.setattr(launch, "SLICE_ITEMS", 50)
    file = next(store.glob("data-*/error.npy"))
    if value == "random":
        value = np.random.default_rng(0).integers(0, 256, (len(np.load(file)) + 1) // 2)
    overwrite(file, value, slice(None, None, 2), np.uint8)
    terrain, refused = Terrain(open_store(store), threads), 0
    for view in VIEWS:
        try:
            update = terrain.update(Criterion(error_px=1.0, max_depth=16, meshlet=meshlet), view)
        except TerrainError as error:
            assert str(error).startswith(f"The store {store} is damaged (it") and "import" in str(error)
            refused += 1
            continue
        assert_invariants(update.surface, terrain.field.lattice, meshlet)
    assert refused == 3 or isinstance(value, int) and value < 255 or meshlet
    whole = terrain.update(Criterion(error_px=0, error_m=1e9), VIEWS[0])  # needs no error below the roots
    assert_invariants(whole.surface, terrain.field.lattice)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 3.4e38])
def test_heights_that_are_not_finite_do_not_reach_a_mesh(store, value):
    overwrite(next(store.glob("data-*/samples.npy")), value, slice(0, None, 7))
    terrain = Terrain(open_store(store), 1)
    with pytest.raises(TerrainError, match="heights that are not finite.*import it again"):
        terrain.update(Criterion(error_px=0.0, error_m=1.0, max_depth=12), vertical_scale=1.5)
    if not np.isfinite(value):
        with pytest.raises(TerrainError, match="heights that are not finite"):
            interpolated(terrain.field, "bicubic")


def test_info_verify_names_the_block(store, run_command):
    file = next(store.glob("data-*/error_m1.npy"))
    overwrite(file, np.load(file)[5] ^ 1, 5, np.uint8, fits=False)
    done = run_command("info", "--verify", store)
    assert done.returncode == 1 and "error_m1.npy is damaged (block 1 of 1, bytes 4096 to" in done.stderr
    assert "delete the file" in done.stderr and len(done.stderr.strip().splitlines()) == 1
    before = mesh(open_store(store))  # it is made anew
    assert verify(store) == dict.fromkeys(["samples.npy", "error.npy", "ranges.npy", "error_m1.npy"], 1)
    assert mesh(open_store(store)) == before


def test_what_a_sample_of_blocks_does_not_find_verify_does(tmp_path):
    """Of 65 blocks the first, the last and two between are checked when a store is opened."""
    path = tmp_path / "store"
    run_import(ImportSettings(source="island", size=2049), path)
    file = next(path.glob("data-*/samples.npy"))
    blocks = -(-4 * 2049 * 2049 // store_arrays.BLOCK_BYTES)
    assert blocks == 65
    sums = np.frombuffer(file.read_bytes()[-4 * blocks :], "<u4")
    assert len(np.unique(sums)) > 50, "each has its own"
    entry = store_arrays.BLOCK_BYTES // 4
    overwrite(file, 12.0, 10 * entry + 3, fits=False)
    assert open_store(path).samples.shape == (2049, 2049)
    with pytest.raises(TerrainError, match=r"samples.npy is damaged \(block 11 of 65, bytes 2625536 to 2887679"):
        verify(path)
    for block in (0, 64):
        overwrite(file, 13.0, block * entry + 3, fits=False)
        with pytest.raises(TerrainError, match=rf"samples.npy is damaged \(block {block + 1} of 65"):
            open_store(path)
        overwrite(file, 13.0, block * entry + 3)


def in_place_of(file, how):
    raw = file.read_bytes()
    file.unlink()
    if how == "pipe":
        os.mkfifo(file)
    elif how == "link":
        file.symlink_to("/dev/zero")
    elif how == "folder":
        file.mkdir()
    elif how == "zip":
        with file.open("wb") as out:
            np.savez(out, np.zeros(9))
    elif how == "objects":
        np.save(file, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    elif how == "columns first":
        file.write_bytes(raw.replace(b"False", b"True ", 1))
    elif how == "long header":
        head = b"\x93NUMPY\x03\x00" + (2**31).to_bytes(4, "little")
        file.write_bytes(head + b"[" * 10**6)


@pytest.mark.skipif(os.name != "posix", reason="pipes and links")
@pytest.mark.parametrize(("name", "how"), [
    *((name, how) for how in ("pipe", "link", "folder", "zip", "long header") for name in ("error.npy", "store.json")),
    ("samples.npy", "objects"), ("samples.npy", "columns first"),
])  # fmt: skip
def test_something_else_in_place_of_a_file(store, name, how):
    in_place_of(next(store.rglob(name)), how)
    with pytest.raises(TerrainError, match=f"{name}.*import") as caught:
        open_store(store)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["[" * 10**6, '{"a": ' * 10**5, '{"version": 5, "report": "' + "x" * 10**7 + '"}'])
def test_a_json_that_is_deep_or_huge(store, text):
    (store / "store.json").write_text(text)
    with pytest.raises(TerrainError, match="store.json cannot be read.*import it again") as caught:
        open_store(store)
    assert len(str(caught.value)) < 1000


REPORT = "its 'report' is .*, expected an object with the figures and warnings"


@pytest.mark.parametrize(("entry", "changes", "message"), [
    ("range_step", 0.5, "its entries differ from their checksum[)]: import it again"),
    *(("report", report, REPORT)
      for report in ({"warnings": 5}, {"warnings": [5]}, {"raster": [10**400, 3]}, {"x": {"y": 1}})),
    *(("lattice", lattice, "its 'lattice' is")
      for lattice in ({"columns": 2**25}, {"columns": 2**20, "rows": 2**10}, {"levels": 26})),
])  # fmt: skip
def test_an_entry_that_was_changed_is_noticed(store, entry, changes, message):
    content = json.loads((store / "store.json").read_text())
    assert content[entry] != changes
    content[entry] = content[entry] | changes if entry == "lattice" else changes
    (store / "store.json").write_text(json.dumps(content))
    with pytest.raises(TerrainError, match=message):
        open_store(store)


def test_a_cut_store_is_one_line_of_the_command_line(store, run_command):
    os.truncate(arrays_of(store)[0], 1000)
    done = run_command("info", store)
    assert done.returncode == 1 and len(done.stderr.strip().splitlines()) == 1 and "import" in done.stderr


@pytest.mark.parametrize("part", range(0, 100, 7))
def test_the_json_is_cut_short(store, part):
    content = (store / "store.json").read_bytes()
    (store / "store.json").write_bytes(content[: len(content) * part // 100])
    with pytest.raises(TerrainError, match="store.json cannot be read.*import it again"):
        open_store(store)


def test_arrays_are_deleted_while_they_are_open(store):
    field = open_store(store)
    before = mesh(field)
    for file in arrays_of(store):
        file.unlink()
    assert mesh(field) == before
    with pytest.raises(TerrainError, match="lacks .*: import it again"):
        open_store(store)


IMPORT = """
import sys
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
sys.stdin.read(1)  # all begin at once
run_import(ImportSettings(source="island", size=257, seed=int(sys.argv[2])), sys.argv[1])
"""


def begin_imports(store, seeds):
    pipes = {"stdin": subprocess.PIPE, "stderr": subprocess.PIPE}
    started = [start_program(IMPORT, store, seed, **pipes) for seed in seeds]
    for child in started:
        child.stdin.write(b"g")
        child.stdin.flush()
    return started


@pytest.mark.parametrize("published", [False, True])
def test_another_import_ends_while_a_folder_is_looked_at(tmp_path, monkeypatch, published):
    """It was given up, and its arrays are gone when they are looked at; or there is a store now."""
    (tmp_path / ("data-" + "0" * 32)).mkdir()

    def ended(entry):
        if published:
            (tmp_path / store_module.JSON_NAME).write_text("{}")
        else:
            entry.rmdir()
        return False

    monkeypatch.setattr(store_folder, "is_array_folder", ended)
    store_folder.check_target(tmp_path)


@pytest.mark.parametrize("there_before", [False, True])
def test_three_processes_import_into_one_store(tmp_path, there_before):
    store = tmp_path / "store"
    expected = {}
    for seed in (1, 2, 3):
        run_import(ImportSettings(source="island", size=257, seed=seed), tmp_path / f"alone{seed}")
        expected[seed] = mesh(open_store(tmp_path / f"alone{seed}"))
    if there_before:
        run_import(ImportSettings(source="island", size=65), store)
    children = begin_imports(store, (1, 2, 3))
    if there_before:  # readers find a whole store meanwhile
        while any(child.poll() is None for child in children):
            field = open_store(store)
            assert field.samples.shape in ((65, 65), (257, 257))
            assert float(field.samples.max()) == field.max_height
            time.sleep(0.002)
    assert [(child.communicate()[1], child.returncode) for child in children] == [(b"", 0)] * 3
    field = open_store(store)
    assert mesh(field) == expected[field.provenance["settings"]["seed"]]
    content = json.loads((store / "store.json").read_text())
    assert (store / content["data"]).is_dir()
    # a later import removes the folders of the losers of a race once they are a day old
    for folder in store.glob("data-*"):
        if folder.name != content["data"]:
            os.utime(folder, (0, 0))
    run_import(ImportSettings(source="island", size=65), store)
    assert len(list(store.glob("data-*"))) == 1
