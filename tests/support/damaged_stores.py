# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged stores through updates and through `export`: FOLDER SEED COUNT.

Runs as a separate process, which a read or a write beyond an array ends: an inaccessible page follows each.
Each mutant gives a mesh with all invariants or one sentence. Prints what came of them as JSON.
"""

import collections
import contextlib
import faulthandler
import io
import json
import sys
from pathlib import Path

import numpy as np
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import shared_pages
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import build
from adaptive_terrain.cbt_terrain.field.codes import Steps
from adaptive_terrain.cbt_terrain.field.finer_build import with_finer_tiles
from adaptive_terrain.cbt_terrain.field.finer_tiles import SIDE
from adaptive_terrain.cbt_terrain.field.lattice import Lattice, TileBox, fit
from adaptive_terrain.cbt_terrain.field.meshlet_errors import error_for
from adaptive_terrain.cbt_terrain.field.store import Draft, open_store
from adaptive_terrain.cbt_terrain.run import buffers, launch
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from adaptive_terrain.operators.cli.command_line import main as command_line
from guarded_flights import guarded_numpy
from invariants import assert_invariants
from mutants import mutate

# One square; one that does not fit its lattice; three squares; one with finer tiles; a coast with shared pages.
SHAPES = (65, 65), (45, 70), (33, 97), (33, 40), (150, 300)
FINER, FINER_BITS, COAST = 3, 4, 4  # numbers of the last two shapes
CRITERIA = (
    Criterion(error_px=1.0, max_depth=15),
    Criterion(error_px=3.0, max_triangles=3000),
    Criterion(error_px=0.0, error_m=2.0, max_depth=14),
    Criterion(error_px=0.0, edge_px=12.0, max_depth=14),
    Criterion(error_px=2.0, edge_px=20.0, area_px=90.0, max_depth=15),
    Criterion(error_px=4.0, meshlet=1, max_depth=14),
    Criterion(error_px=8.0, meshlet=2, max_triangles=20000),
)
FLIGHT = {"fov": 50, "keyframes": [{"frame": 1, "eye": [0, -400, 150], "target": [0, 0, 0]}]}


def whole_stores(folder: Path) -> list[Path]:
    """Small stores with everything that a store may keep."""
    stores = []
    for seed, (rows, columns) in enumerate(SHAPES):
        path = folder / f"whole{seed}"
        stores.append(path)
        if path.exists():
            continue
        draft = Draft(path)
        samples = draft.allocate("samples", (rows, columns), np.float32)
        y, x = np.mgrid[0:rows, 0:columns]
        noise = np.random.default_rng(seed).standard_normal((rows, columns))
        samples[:] = 40 * np.sin(x / 9) * np.cos(y / 7) + 2 * noise
        if seed == COAST:
            samples[:, 40:] = 0.0
            shared_pages.MIN_SAVED = 0
        built = build(samples, 10.0, 10.0, missing=0, allocate=draft.allocate)
        draft.remove("errors")
        if seed == 2:  # numbers of steps of a centimetre
            heights = samples.copy()
            draft.remove("samples")
            numbers = draft.allocate("samples", heights.shape, np.uint16)
            numbers[:] = np.rint((heights + 300.0) * 100.0)
            built = built.with_raster(samples=numbers, steps=Steps(0, 0.01, -300.0))
        if seed == FINER:
            built = with_finer_tiles(built, FINER_BITS, [(0, 0), (1, 1)], waves, allocate=draft.allocate)
        draft.publish(built, "mutants", {})
        field = open_store(path)
        assert isinstance(field.error, shared_pages.SharedPages) == (seed == COAST)
        if seed == FINER:
            error_for(field, 1)
            continue
        for made in (field, interpolated(field, "bicubic")):
            error_for(made, 1), error_for(made, 2)
    return stores


def waves(box: TileBox) -> np.ndarray:
    """Return heights of finer samples; they are 0 on the borders of their tile."""
    y, x = np.arange(box.y0, box.y1 + 1)[:, None], np.arange(box.x0, box.x1 + 1)
    return (np.sin(x * (8 * np.pi / SIDE)) * np.sin(y * (4 * np.pi / SIDE)) * 9.0).astype(np.float32)


def lattice_of(store: Path) -> Lattice:
    return fit(**json.loads((store / "store.json").read_text())["lattice"])


def said(error: TerrainError) -> str:
    """Return the error's text; check that it is one sentence."""
    text = str(error)
    assert "\n" not in text and text.endswith(".") and len(text) < 1000, text
    return text


def updates(store: Path, rng: np.random.Generator) -> str:
    """Some frames of a flight over a store: "mesh" if all are sound, else the sentence that one ended with.

    An error in one frame leaves a terrain that goes on.
    """
    outcome = "mesh"
    try:
        field = interpolated(open_store(store), str(rng.choice(["bilinear", "bilinear", "bicubic"])))
        terrain = Terrain(field, int(rng.choice([1, 2, 3])))
        criterion = CRITERIA[rng.integers(len(CRITERIA))]
    except TerrainError as error:
        return said(error)
    jump = float(rng.choice([1.0, 1.0, 300.0]))
    eye, views = np.array([rng.uniform(-300, 300), -400.0, 150.0]), int(rng.choice([1, 1, 2]))
    for frame in range(4):
        looks = [View.look(tuple(eye + [k * 200, jump * frame, 0]), (0, 0, 0)) for k in range(views)]
        try:
            update = terrain.update(criterion, looks)
            assert_invariants(update.surface, lattice_of(store), criterion.meshlet)
            assert not np.isnan([update.bound_px or 0.0, update.bound_m or 0.0]).any()
        except TerrainError as error:
            outcome = said(error)
    return outcome


def export(store: Path, out: Path, path: Path) -> str:
    """`export` of a store as .npz: "mesh" or the line that it ended with."""
    errors, arguments = io.StringIO(), ["--frames", "1", "--format", "npz", "--budget", "4000", "--pixel-error", "2"]
    with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(io.StringIO()):
        code = command_line(["export", "--store", str(store), "--path", str(path), "--out", str(out), *arguments])
    lines = errors.getvalue().strip().splitlines()
    if code:
        assert code == 1 and len(lines) == 1 and "Traceback" not in lines[0], (code, lines)
        assert not list(out.glob("*.npz")), "a file of a frame that failed"
        return lines[0]
    [file] = out.glob("*.npz")
    with np.load(file) as entries:
        triangles, positions = entries["triangles"], entries["positions"]
    assert np.isfinite(positions).all() and 0 <= triangles.min() and triangles.max() == len(positions) - 1
    file.unlink()
    return "mesh"


def main(folder: Path, seed: int, count: int) -> None:
    faulthandler.enable()
    buffers.np = guarded_numpy()
    launch.SLICE_ITEMS = 200  # so that small meshes are welded in slices, too
    stores, outcomes = whole_stores(folder), collections.Counter()
    flight, mutant, exported = folder / "flight.json", folder / f"mutant{seed}", folder / f"out{seed}"
    flight.write_text(json.dumps(FLIGHT))
    for k in range(seed, seed + count):
        rng = np.random.default_rng([64, k])
        what = mutate(stores[k % len(stores)], mutant, rng)
        print(k, what, file=sys.stderr, flush=True)
        for outcome in (updates(mutant, rng), export(mutant, exported, flight)):
            outcomes["mesh" if outcome == "mesh" else "sentence"] += 1
    print(json.dumps(outcomes))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
