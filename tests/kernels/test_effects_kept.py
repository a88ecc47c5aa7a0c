# SPDX-License-Identifier: GPL-3.0-or-later
"""What stays of a surface: runs against sets in Python, and the snippets against Warp alone."""

from pathlib import Path

import numpy as np
import pytest
from adaptive_terrain import kernels
from adaptive_terrain.cbt_terrain.attributes import values as effect_values
from adaptive_terrain.cbt_terrain.attributes.values import EffectValues
from twins import load


def surfaces(rng):
    """Return the points of two surfaces: many in both in the same order, some moved, one with another sign of 0."""
    first = rng.integers(-9, 9, (3000, 3)).astype(np.float32) + np.arange(3000, dtype=np.float32)[:, None]
    second = np.delete(first, rng.integers(0, 3000, 40), axis=0)
    second = np.insert(second, rng.integers(0, len(second), 30), rng.uniform(-9, 9, (30, 3)), axis=0)
    if rng.random() < 0.5:
        cut = rng.integers(200, 2500)
        second = np.concatenate([second[cut:], rng.uniform(0, 9, (70, 3)).astype(np.float32), second[:cut]])
    second[5] = 0.0
    first[7] = 0.0
    first[7, 0] = -0.0
    return np.ascontiguousarray(first), np.ascontiguousarray(second)


def taken(first: np.ndarray, second: np.ndarray, threads: int = 1) -> tuple[list[np.ndarray], int]:
    """Return reused values of width 1 and 3 at the second surface, and how many were computed anew."""
    kept, found = EffectValues(threads), []
    kept.move_to(first)
    kept.swap_levels("level")[0][:] = first[:, 2] > 1500
    kept.put("one", first[:, 0] * 2 + 1)
    kept.put("three", first * 2 + 1)
    kept.move_to(second)
    levels, before = kept.swap_levels("level")
    levels[:] = second[:, 2] > 1400
    fresh = kept.find_fresh(levels, before)
    both = kept.reuse({"one": 1, "three": 3})
    for name, places in (("one", second[:, 0]), ("three", second)):
        values = both[name]
        values[fresh] = places[fresh] * 2 + 1
        found.append(values.copy())
    return found, len(fresh)


@pytest.mark.parametrize("seed", range(6))
def test_every_place_has_its_own_values_and_few_are_fresh(seed):
    first, second = surfaces(np.random.default_rng(seed))
    (one, three), fresh = taken(first, second, threads=1 + seed % 2)
    assert (one == second[:, 0] * 2 + 1).all() and (three == second * 2 + 1).all()
    known = {(place.tobytes(), bool(place[2] > 1500)) for place in first}
    new = [(place.tobytes(), bool(place[2] > 1400)) not in known for place in second]
    assert sum(new) <= fresh <= sum(new) + 0.1 * len(second)


def test_snippets_find_and_copy_the_bytes_of_plain_warp(tmp_path, monkeypatch):
    load("checked", Path(__file__).with_name("checked.py"))
    source = (Path(kernels.__file__).parent / "effects" / "keep.py").read_text()
    assert source.count("from ..unchecked import ") == 1
    path = tmp_path / "keep_checked.py"
    path.write_text(source.replace("from ..unchecked import ", "from ..checked import "))
    pairs = [surfaces(np.random.default_rng(seed)) for seed in range(4)]
    fast = [taken(*pair) for pair in pairs]
    monkeypatch.setattr(effect_values, "kernels", load("effects.keep_checked", path))
    for (values, fresh), pair in zip(fast, pairs, strict=True):
        plain, as_many = taken(*pair)
        assert fresh == as_many and [a.tobytes() for a in values] == [b.tobytes() for b in plain]


def test_points_of_a_lattice_are_found_in_any_order():
    """Plane coordinates of a mesh have few bits: a hash has to spread them."""
    x, y = np.meshgrid(np.arange(-300.0, 300.0, 2.0), np.arange(-200.0, 200.0, 2.0))
    first = np.stack([x.ravel(), y.ravel(), 5.0 * np.sin(x.ravel())], 1).astype(np.float32)
    second = np.concatenate([first[40_000:], first[:40_000]])
    _, fresh = taken(first, second)
    assert fresh < 0.1 * len(second)
