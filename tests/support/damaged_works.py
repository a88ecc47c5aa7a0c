# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged stores of imports by tile: `damaged_works.py FOLDER FIRST COUNT` imports into each again, and prints how many
ended in which way.

Kinds: a store of which one source has changed, the work of a killed import, a complete store, a store with loaded
tiles, the work of a killed load of tiles, works with results of a farm's tasks that have read and measured, a store
with squares of finer tiles, and the work of a killed load of squares. Every mutant runs in a fork of one process. A
mutant is at fault if its import hangs, crashes or ends with anything but a store or one sentence, if it changes a file
outside of the store or a user's file in it, or if accidental damage gives other heights or errors than those of an
undamaged store.
"""

import hashlib
import json
import os
import shutil
import sys
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path
from random import Random
from unittest.mock import patch

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import store_folder
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.importing import finer_import, import_work, refining, tile_import, view_needs
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.finer_squares import finer_squares
from adaptive_terrain.cbt_terrain.importing.import_report import describe
from adaptive_terrain.cbt_terrain.importing.tile_import import BEGIN, FILL, MEASURE, READ_TILES, ImportPart
from adaptive_terrain.cbt_terrain.mosaic import finer_plan
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.tiling import part_files, tile_work
from adaptive_terrain.cbt_terrain.tiling.tile_records import MEASURED, READ, line_of
from adaptive_terrain.cbt_terrain.tiling.tile_work import RECORDS_NAME
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from hostile_folders import JUNK, damage_text, end_of, make_precious, replace_entry
from invariants import assert_invariants
from mosaic_files import EAST, NORTH, UTM32, sheet
from mutants import PAGE, put_checksums
from rasterio.transform import from_origin
from rasters import hills, write_raster
from tiled_stores import write_tiles

SQUARES = "squares", "killed squares"
PARTS = "read parts", "measured parts"
MOSAIC = "changed", "killed", "complete", *PARTS
KINDS = "changed", "killed", "complete", "loaded", "killed load", *PARTS, *SQUARES
ALL_TILES = range(100)
QUICK, LOADED, FURTHER = 1000, (0, 4), (0, 4, 7)
NUMBERS = -1, 0, 1, 2, 31, 63, 10**6, 2**31, 2**63, 10**30, 1e308, -1e-300, 0.5
# Of a camera that looks down from 6,000 m above the middle.
VIEW = View(
    np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -6000], [0, 0, 0, 1.0]]),
    np.array([[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, -1, 0], [0, 0, -1, 0.0]]),
    (64, 64),
)
SEEN = view_needs.SeenLand([VIEW], np.eye(4))


class StoppingCrew(tile_import.Crew):
    """Ends like a killed process in the middle of one step."""

    def __init__(self, step: str) -> None:
        self.step = step

    def run(self, work, source, tasks, on_progress):
        for number, task in enumerate(tasks):
            if task.step == self.step and 2 * number > len(tasks):
                raise KeyboardInterrupt
            if not tile_import.perform(work, source, task, 1, source.coarse):
                return False
        return True


class Project:
    """The undamaged stores, their sources, and the arrays that each kind should end with."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.mosaic = ImportSettings(str(folder / "tiles"), holes=True)
        self.raster = ImportSettings(str(folder / "a.tif"), quick=QUICK)
        self.country = ImportSettings(str(folder / "country"), quick=QUICK)

    def whole(self, kind: str) -> Path:
        return self.folder / kind

    def make(self, kinds: set[str]) -> None:
        """Write the sources and the stores of these kinds; stores of a mosaic and of a raster in any case."""
        write_tiles(self.folder / "tiles", columns=2, rows=2, side=20)
        run_mosaic_import(self.mosaic, self.whole("changed"))
        part = sheet(UTM32, EAST + 100.0, NORTH - 200.0, 10.0, 10.0, 12, 12, shift=1.0)
        part.write(self.folder / "tiles" / "v.tif")
        run_mosaic_import(self.mosaic, self.whole("complete"))
        noise = np.random.default_rng(5).normal(0.0, 3.0, (151, 191))
        place = from_origin(EAST, NORTH, 10.0, 10.0)
        heights = (hills(191, 151) + noise).astype(np.float32)
        write_raster(self.folder / "a.tif", heights, crs=UTM32, transform=place, tiled=True)
        run_import(self.raster, self.whole("loaded"))
        self.copy("loaded", "killed load", "further")
        run_import(replace(self.raster, loaded_tiles=LOADED), self.whole("loaded"))
        further = replace(self.raster, loaded_tiles=FURTHER)
        run_import(further, self.whole("further"))
        run_import(replace(self.raster, quick=0), self.whole("full"))
        for step in (READ, MEASURED):  # two processes have written records
            with pytest.raises(KeyboardInterrupt):
                run_mosaic_import(self.mosaic, self.whole("killed"), crew=StoppingCrew(step))
            with pytest.raises(KeyboardInterrupt):
                run_import(further, self.whole("killed load"), crew=StoppingCrew(step))
        if kinds.intersection(PARTS):
            self.make_parts()
        if kinds.intersection(SQUARES):
            self.make_squares()

    def make_parts(self) -> None:
        """Write works with results of a farm's tasks."""
        for name, steps in (("read parts", (BEGIN, READ_TILES)), ("measured parts", (FILL, MEASURE))):
            for step in steps:
                numbers = ALL_TILES if step in (READ_TILES, MEASURE) else ()
                run_mosaic_import(self.mosaic, self.whole(name), part=ImportPart(step, numbers))
            if name == "read parts":
                self.copy(name, "measured parts")

    def copy(self, kind: str, *others: str) -> None:
        """Copy a store to other kinds, which begin like it."""
        for other in others:
            shutil.copytree(self.whole(kind), self.whole(other), symlinks=True)

    def make_squares(self) -> None:
        """Write a country with a city, and stores in which tiles and squares are loaded, one by a killed import."""
        sheet(UTM32, EAST, NORTH, 32.0, 32.0, 200, 150).write(self.folder / "country" / "a.tif")
        city = sheet(UTM32, EAST + 2000.0, NORTH - 1500.0, 1.0, 1.0, 300, 260, shift=3.0)
        city.write(self.folder / "country" / "b.tif")
        run_mosaic_import(self.country, self.whole("squares"))
        run_mosaic_import(replace(self.country, loaded_tiles=LOADED), self.whole("squares"))
        self.copy("squares", "further squares")
        squares = finer_squares(open_store(self.whole("squares")))
        assert squares is not None and len(squares.there) > 1
        self.squares = replace(self.country, loaded_tiles=LOADED, loaded_finer=tuple(sorted(squares.there)))
        some = replace(self.squares, loaded_finer=self.squares.loaded_finer[:1])
        run_mosaic_import(some, self.whole("squares"))
        self.copy("squares", "killed squares")
        run_mosaic_import(self.squares, self.whole("further squares"))
        note, left = finer_import._WorkRecords.note, 4

        def stop(self, *record, **values):
            nonlocal left
            left -= 1
            if left == 0:
                raise KeyboardInterrupt
            note(self, *record, **values)

        with patch.object(finer_import._WorkRecords, "note", stop), pytest.raises(KeyboardInterrupt):
            run_mosaic_import(self.squares, self.whole("killed squares"))

    def import_into(self, kind: str, store: Path, choice: int) -> Path | None:
        """Import into a store of one kind, and return the undamaged store that has its arrays."""
        if kind in SQUARES:
            if choice % 3 == 1 and kind == "squares":
                view_needs.missing_squares(store, [SEEN])
                return None
            report = run_mosaic_import(self.squares, store)
            return None if report.get("unchanged") else self.whole("further squares")
        if kind in PARTS and choice % 3 < 2:
            for step, numbers in ((READ_TILES, ALL_TILES), (FILL, ()), (MEASURE, ALL_TILES)):
                run_mosaic_import(self.mosaic, store, part=ImportPart(step, numbers))
        if kind in MOSAIC:
            run_mosaic_import(self.mosaic, store)
            return self.whole("complete")
        if choice % 3 == 0:
            run_import(replace(self.raster, quick=0), store)
            return self.whole("full")
        if choice % 3 == 1 and kind == "loaded":
            view_needs.missing_tiles(store, SEEN)
            view_needs.is_fine_enough(store, [SEEN])
            refining.loaded_at(open_store(store), 10.0, 20.0)
            return None
        report = run_import(replace(self.raster, loaded_tiles=FURTHER), store)
        return None if report.get("unchanged") else self.whole("further")


def damage(store: Path, precious: Path, rng: np.random.Generator) -> tuple[str, bool]:
    """Damage one or two files of a store; return a description, and whether the damage may be accidental.

    Damage with valid checksums, and that of arrays that have no checksums yet, may change heights.
    """
    random = Random(int(rng.integers(1 << 62)))
    done, accidental = [], True
    for _ in range(int(rng.choice([1, 1, 2]))):
        files = sorted(path for path in store.rglob("*") if not path.is_symlink())
        texts = [path for path in files if path.suffix in (".json", ".jsonl") and path.is_file()]
        arrays = [path for path in files if path.suffix == ".npy" and path.is_file()]
        parts = [path for path in files if path.suffix == ".part" and path.is_file()]
        how = str(rng.choice(["text", "text", "text", "value", "value", "value", "array", "array", "entry", "swap"]))
        if parts and rng.random() < 0.6:
            description, may_be_accident = damage_part(parts[rng.integers(len(parts))], rng)
        elif how == "text" and texts:
            description, may_be_accident = damage_text(texts[rng.integers(len(texts))], random), True
        elif how == "value" and texts:
            description, may_be_accident = change_value(texts[rng.integers(len(texts))], rng), False
        elif how == "array" and arrays:
            description, may_be_accident = damage_array(arrays[rng.integers(len(arrays))], rng)
        elif how == "swap" and len(arrays) > 1:
            a, b = (arrays[k] for k in rng.choice(len(arrays), 2, replace=False))
            (first, second) = a.read_bytes(), b.read_bytes()
            a.write_bytes(second), b.write_bytes(first)
            description, may_be_accident = f"{a.name} and {b.name} swapped", False
        else:
            description = replace_entry(random.choice([store, *files]), precious, random)
            may_be_accident = "gone" in description
        done.append(description)
        accidental &= may_be_accident
    return "; ".join(done), accidental


def damage_part(file: Path, rng: np.random.Generator) -> tuple[str, bool]:
    """Change the file of a farm's task; return a description, and whether it may be accidental."""
    raw = bytearray(file.read_bytes())
    how, end = str(rng.choice(["bits", "cut", "record", "record"])), len(raw) - part_files.LENGTH_BYTES
    if how == "record":
        try:
            length = int.from_bytes(raw[end:], "little")
            line = line_of(changed(json.loads(raw[end - length : end])["record"], rng)).encode()
            raw = raw[: max(end - length, 0)] + line + len(line).to_bytes(part_files.LENGTH_BYTES, "little")
        except (ValueError, TypeError, KeyError):
            how = "bits"
    if how == "cut":
        raw = raw[: rng.integers(len(raw) + 1)]
    elif how == "bits" and raw:
        raw[rng.integers(len(raw))] ^= 1 << int(rng.integers(8))
    file.write_bytes(raw)
    return f"{file.name} {how}", how != "record"


def damage_array(file: Path, rng: np.random.Generator) -> tuple[str, bool]:
    """Change bytes of an array, or its length; return a description, and whether checksums tell."""
    raw = bytearray(file.read_bytes())
    how = str(rng.choice(["bits", "bits", "noise", "ones", "cut", "longer"]))
    if how in ("cut", "longer") or len(raw) <= PAGE:
        raw = raw[: rng.integers(len(raw) + 1)] if how == "cut" else raw + bytes(4096)
    else:
        size = int(10 ** rng.uniform(0, np.log10(len(raw) - PAGE)))
        data = np.frombuffer(raw, np.uint8)
        if how == "bits":
            data[rng.integers(PAGE, len(raw), size=size)] ^= np.uint8(1 << rng.integers(8))
        else:
            start = int(rng.integers(PAGE, len(raw)))
            part = data[start : start + size]
            part[:] = 255 if how == "ones" else rng.integers(256, size=len(part))
    file.write_bytes(raw)
    has_sums = (file.parent / RECORDS_NAME).exists() or not (file.parent / store_folder.WORK_NAME).exists()
    fits = how not in ("cut", "longer") and len(raw) > PAGE and rng.random() < 0.6
    if fits:
        raw = bytearray(file.read_bytes())
        put_checksums(raw)
        file.write_bytes(raw)
    return f"{file.name} {how}{', valid checksums' if fits else ''}", has_sums and not fits


def change_value(file: Path, rng: np.random.Generator) -> str:
    """Change values of a JSON text, or of lines of it, and make its checksum valid."""
    text = file.read_text(errors="replace")
    try:
        if file.suffix == ".jsonl":
            lines = text.splitlines()
            for _ in range(int(rng.choice([1, 3, 20]))):
                number = int(rng.integers(len(lines)))
                lines[number] = line_of(changed(json.loads(lines[number])["record"], rng))[:-1]
            if '{"sum"' in text[:8] and file.name == RECORDS_NAME:
                rest = "".join(f"{line}\n" for line in lines[1:])
                lines[0] = json.dumps({"sum": hashlib.blake2b(rest.encode(), digest_size=16).hexdigest()})
            file.write_text("".join(f"{line}\n" for line in lines))
            return f"{file.name} values"
        content = json.loads(text)
        if file.name == "catalogue.json":
            inner = json.dumps(changed(json.loads(content["content"]), rng))
            content = {"sum": hashlib.sha256(inner.encode()).hexdigest(), "content": inner}
        else:
            content = changed(content, rng)
            if isinstance(content, dict):
                others = {name: value for name, value in content.items() if name != "sum"}
                text, size = json.dumps(others, sort_keys=True), 8 if file.name == store_folder.JSON_NAME else 16
                content["sum"] = hashlib.blake2b(text.encode(), digest_size=size).hexdigest()
        file.write_text(json.dumps(content))
        return f"{file.name} values"
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, RecursionError):
        return f"{file.name} was damaged"


def changed(value, rng: np.random.Generator):
    """Return a JSON value with another value, type or number somewhere inside."""
    if isinstance(value, dict | list) and value and rng.random() < 0.9:
        keys = list(value) if isinstance(value, dict) else range(len(value))
        key = keys[rng.integers(len(keys))]
        if rng.random() < 0.08:
            del value[key]
        elif isinstance(value, list) and rng.random() < 0.1:
            value.append(value[key])
        else:
            value[key] = changed(value[key], rng)
        return value
    choices = [*JUNK, *NUMBERS]
    if isinstance(value, int | float) and not isinstance(value, bool) and rng.random() < 0.6:
        return type(value)(value * float(rng.choice([-1.0, 0.5, 2.0, 1e6, 1.01]))) if abs(value) < 1e200 else 0
    return choices[rng.integers(len(choices))]


def arrays_of(store: Path) -> dict[str, np.ndarray]:
    folder = store_folder.named_folder(store)
    assert folder is not None
    names = "samples", "error", "ranges", "valid", "finer_numbers", "finer_heights", "finer_errors", "finer_ranges"
    return {name: np.load(folder / f"{name}.npy") for name in names if (folder / f"{name}.npy").exists()}


def try_import(project: Project, kind: str, store: Path, choice: int, is_accident: bool) -> int:
    """Import into a damaged store and look at the result; return 0, or 1 after one error."""
    tile_work._log_name.cache_clear()  # a fork writes its own file of records, as any process does
    try:
        expected = project.import_into(kind, store, choice)
        field = open_store(store)
        surface = Terrain(field, 1).update(Criterion(error_px=2.0, max_depth=14), [VIEW]).surface
        if field.valid is None:
            assert_invariants(surface, field.lattice)
        assert np.isfinite(surface.positions).all() and surface.triangles.max() < len(surface.positions)
        if expected is not None and is_accident:
            verify(store)
            found, wanted = arrays_of(store), arrays_of(expected)
            for name in wanted:
                assert np.array_equal(found[name], wanted[name]), f"other {name} than those of an undamaged store"
        describe(store)
    except TerrainError as error:
        text = str(error)
        assert "\n" not in text and text.endswith(".") and len(text) < 1500, text
        assert "unexpected" not in text
        print(f"error: {text}")
        return 1
    return 0


def contents(folder: Path, store: Path) -> dict:
    """Return kinds, links and bytes of all files outside of a store, and by name of the user's in it.

    These may move with the folder of arrays that an import gives its final name.
    """
    found = {}
    for at, folders, files in os.walk(folder):
        for path in (Path(at) / name for name in (*folders, *files)):
            is_inside = store in path.parents
            if path == store or (is_inside and not path.name.startswith("guest")):
                continue
            content = path.read_bytes() if path.is_file() and not path.is_symlink() else b""
            place = path.name if is_inside else str(path)
            found.setdefault(place, []).append((path.lstat().st_mode, content))
    return found


def switch_to_tiles() -> None:
    """Make tiles of 32 x 32 cells, and let this process's kernels run in one thread."""
    import_work.TILE_BITS = 5
    refining.BITS, refining.FACTOR, refining.FEWEST = 5, 4, 1
    finer_plan.FEWEST = 1 << 20
    launch.default_threads = lambda: 1


def main(folder: str, first: str, count: str) -> None:
    switch_to_tiles()
    base = Path(folder).resolve()
    base.mkdir(parents=True, exist_ok=True)
    project, ends = Project(base), Counter()
    seeds = range(int(first), int(first) + int(count))
    # in this process, which loads modules and kernels for its forks
    project.make({KINDS[seed % len(KINDS)] for seed in seeds})
    for seed in seeds:
        rng = np.random.default_rng([35, seed])
        kind = KINDS[seed % len(KINDS)]
        work = base / "mutant"
        shutil.rmtree(work, ignore_errors=True)
        store = work / "store"
        shutil.copytree(project.whole(kind), store, symlinks=True)
        if rng.random() < 0.2:
            (store / "guest.txt").write_text("a user's own")
        done, is_accident = damage(store, make_precious(work), rng)
        choice = int(rng.integers(3))
        do = partial(try_import, project, kind, store, choice, is_accident)
        end = end_of(do, partial(contents, work, store), f"mutant {seed} ({kind}; {choice}: {done})")
        ends[f"{kind} {end}"] += 1
    print(json.dumps(ends))


if __name__ == "__main__":
    main(*sys.argv[1:])
