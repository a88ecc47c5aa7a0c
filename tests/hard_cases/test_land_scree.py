# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard cases 54 to 58 of thermal erosion and droplets."""

import hashlib
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.island import SIDE, island
from adaptive_terrain.cbt_terrain.height_operators import droplets, thermal
from adaptive_terrain.cbt_terrain.height_operators.catalogue import HEIGHT_OPERATORS
from adaptive_terrain.cbt_terrain.height_operators.examples import shape_with
from adaptive_terrain.cbt_terrain.height_operators.height_operator import Change, OperatorGround
from fields import rough


def crags(rows: int, columns: int, seed: int = 0) -> np.ndarray:
    """Return steep heights above the sea, float32 metres."""
    return rough(rows, columns, seed, relief=400.0).samples[:rows, :columns].astype(np.float32) + 2000.0


def digest() -> str:
    """Return a digest of the changes that thermal erosion and droplets make to one ground."""
    changes = [shape_with(name, crags(70, 61, 3), 11.0).heights for name in ("scree", "droplets")]
    assert all(change.any() for change in changes)
    return hashlib.blake2b(b"".join(change.tobytes() for change in changes)).hexdigest()


@pytest.mark.parametrize("name", ["scree", "droplets"])
def test_case_54_a_pit_without_outlet_and_a_perfect_plateau(name):
    """A plateau does not change by a bit; a pit in it only fills, equally from east and west to 5 %."""
    assert not shape_with(name, np.full((97, 120), 700.0, np.float32), 12.0).heights.any()
    pit = np.full((97, 97), 700.0, np.float32)
    away = np.hypot(*(np.mgrid[:97, :97] - 48))
    pit -= np.clip(400.0 - 14.0 * away, 0.0, 300.0).astype(np.float32)
    change = shape_with(name, pit, 12.0, **({"uneven": 0.0, "hard_angle": 45.0} if name == "scree" else {})).heights
    assert change[away < 6].mean() > 0.5 and not change[away > 70].any()
    east, west = (np.abs(half).sum() for half in (change[:, 49:], change[:, :48]))
    assert abs(east / west - 1.0) < 0.05


def test_case_55_no_rock_is_lost_as_scree():
    """Rock and scree together keep mass to 1e-7 of the wear, over two levels and an uneven border."""
    change = shape_with("scree", crags(301, 420), 10.0)
    worn, deposited = (change.layers[name].sum(dtype=np.float64) for name in ("wear", "scree"))
    assert worn > 1e4 and abs(worn - deposited) < 1e-7 * worn


def test_case_55_no_rock_is_lost_by_droplets():
    """Rock eroded, deposited and carried over the border adds up to 1e-12 of the change."""
    heights = crags(120, 131)
    change, carried = droplets.rain_on(
        OperatorGround(heights, 9.0, 13.0, whole=heights.shape), droplets.DROPLETS.defaults()
    )
    assert abs(change.sum() * 9.0 * 13.0 + carried) < 1e-12 * np.abs(change).sum() * 9.0 * 13.0


def test_case_56_twice_the_samples_wear_as_much():
    """Thermal wear of a steep island at 513 samples is within 10 % of that at 257, the surfaces within 1.2 m."""
    changes = {}
    for size in (257, 513):
        heights = 2.0 * np.maximum(island(1025), 0.0)[:: 1024 // (size - 1), :: 1024 // (size - 1)]
        changes[size] = shape_with("scree", heights, SIDE / (size - 1))
    worn = [changes[size].layers["wear"].mean() for size in (257, 513)]
    assert worn[0] > 1.0 and abs(worn[1] / worn[0] - 1.0) < 0.1
    difference = changes[513].heights[::2, ::2] - changes[257].heights
    assert math.sqrt(np.mean(difference**2)) < 1.2 < 10.0 < math.sqrt(np.mean(changes[513].heights ** 2))


def test_case_57_four_tiles_of_scree_are_the_whole():
    """Four tiles of odd sides with their halos, over a coarser change, have every byte of the whole level."""
    heights, step, values = crags(290, 331, 1), 8.0, thermal.THERMAL.defaults()
    halo = math.ceil(thermal.THERMAL.halo(values, step) / step)
    scree = np.random.default_rng(1).random(heights.shape).astype(np.float32)
    before = {"scree": scree, "wear": scree[::-1].copy()}

    def tile(rows: slice, columns: slice) -> np.ndarray:
        window = tuple(
            slice(max(part.start - halo, 0), min(part.stop + halo, size))
            for part, size in zip((rows, columns), heights.shape, strict=True)
        )
        first = tuple(part.start for part in window)
        ground = OperatorGround(np.ascontiguousarray(heights[window]), step, step, first, (999, 999), level=1)
        coarse = Change(scree[window], {name: layer[window] for name, layer in before.items()})
        inner = tuple(slice(part.start - at, part.stop - at) for part, at in zip((rows, columns), first, strict=True))
        return thermal.apply(ground, values, coarse).heights[inner]

    whole = tile(slice(0, 290), slice(0, 331))
    for rows in (slice(0, 141), slice(141, 290)):
        for columns in (slice(0, 172), slice(172, 331)):
            assert np.array_equal(tile(rows, columns), whole[rows, columns])


@pytest.mark.thorough
def test_case_58_other_processors_give_the_same_bytes(tmp_path):
    """Code compiled without fused multiply-add and wide vectors gives the same bytes."""
    paths = [str(Path(__file__).parent), *sys.path]
    script = f"import sys, warp as wp; sys.path[:0] = {paths!r}; wp.config.quiet = True\n"
    script += f"wp.config.cpu_compiler_flags = '-target-cpu x86-64'; wp.config.kernel_cache_dir = {str(tmp_path)!r}\n"
    script += "import test_land_scree; print(test_land_scree.digest())"
    run = subprocess.run([sys.executable, "-W", "ignore", "-c", script], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert run.stdout.split()[-1] == digest()


def test_case_58_only_the_seed_changes_the_bytes():
    """Thermal erosion and droplets give the same bytes on 1, 2 and 3 threads, and others with another seed."""
    for name in ("scree", "droplets"):
        effect, heights = HEIGHT_OPERATORS[name], crags(130, 97)

        def change(seed: int, threads: int, effect=effect, heights=heights) -> bytes:
            ground = OperatorGround(heights, 14.0, 14.0, whole=heights.shape, seed=seed, threads=threads)
            return effect.apply(ground, effect.defaults(), None).heights.tobytes()

        assert change(1, 1) == change(1, 2) == change(1, 3) != change(2, 1)
