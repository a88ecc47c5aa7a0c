# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `effects`, and exports that carry effects, read by readers of the tests' own."""

from functools import partial

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.mesh.archive import read_npz
from store_exports import run


@pytest.fixture
def export(export):
    """Export the first frame of the small store; returns the exit code, the output and the folder."""
    return partial(export, "--frames", "1", "--format", "npz")


def test_the_catalogue_names_every_effect_with_its_unit_and_cost(capsys):
    assert run("effects") == 0
    printed = capsys.readouterr().out
    for name, effect in ATTRIBUTES.items():
        entry = printed.split(f"\n{name}:\n" if not printed.startswith(f"{name}:") else f"{name}:\n")[1].split(
            "\n  cost:"
        )[0]
        assert effect.about in entry and (not effect.unit or f"unit: {effect.unit}" in entry)
        assert all(f"{p.name}: " in entry for p in effect.parameters)
    assert printed.count("  cost: ") == len(ATTRIBUTES)


def test_of_a_store_each_is_measured(store, capsys):
    assert run("effects", "--store", store) == 0
    lines = capsys.readouterr().out.splitlines()[-len(ATTRIBUTES) :]
    for name, line in zip(ATTRIBUTES, lines, strict=True):
        ms, _, megabytes, _ = line.removeprefix(f"{name}: ").split()
        assert float(ms.replace(",", "")) > 0 and float(megabytes.replace(",", "")) > 0


def test_an_export_carries_what_is_named_and_nothing_else(export, store):
    _, _, bare = export(out="bare")
    code, _, folder = export("--effects", "slope, aspect,slope")
    assert code == 0
    plain, mesh = read_npz(bare / "terrain_0001.npz"), read_npz(folder / "terrain_0001.npz")
    assert mesh.keys() - plain.keys() == {"slope", "aspect"}
    assert mesh["slope"].shape == (len(mesh["positions"]),) and mesh["aspect"].shape == (len(mesh["positions"]), 2)
    assert mesh["info"]["attributes"]["slope"] == {"domain": "POINT", "unit": "rad"}
    for name in plain.keys() - {"info"}:
        np.testing.assert_array_equal(mesh[name], plain[name])
    # At the samples a cubic B-spline's slope is that of central differences, smoothed across.
    lattice, heights = open_store(store).lattice, open_store(store).heights().astype(np.float64)
    across = (heights[:-2] + 4 * heights[1:-1] + heights[2:]) / 6
    up = (heights[:, :-2] + 4 * heights[:, 1:-1] + heights[:, 2:]) / 6
    east = (across[:, 2:] - across[:, :-2]) / (2 * lattice.step_x)
    north = (up[2:] - up[:-2]) / (2 * lattice.step_y)
    west, south, _, _ = lattice.rectangle()
    i, j = ((mesh["positions"][:, :2] - (west, south)) / (lattice.step_x, lattice.step_y)).T
    at_samples = (i % 1 == 0) & (j % 1 == 0) & (np.minimum(i, j) >= 1) & (np.maximum(i, j) < lattice.width - 1)
    expected = np.arctan(np.hypot(east, north))[j[at_samples].astype(int) - 1, i[at_samples].astype(int) - 1]
    assert at_samples.sum() > 500
    np.testing.assert_allclose(mesh["slope"][at_samples], expected, atol=1e-5)


def test_frames_of_other_effects_are_made_anew(export):
    export("--effects", "slope")
    _, again, _ = export("--effects", "slope", "--resume")
    assert "complete before" in again.out
    _, other, folder = export("--effects", "height", "--resume")
    assert "complete before" not in other.out and "height" in read_npz(folder / "terrain_0001.npz")


def test_none_and_auto_write_no_effect_of_a_store(export):
    _, _, bare = export(out="bare")
    for text in ("none", "auto"):
        _, _, folder = export("--effects", text, out=text)
        assert (folder / "terrain_0001.npz").read_bytes() == (bare / "terrain_0001.npz").read_bytes()


def test_an_unknown_effect_is_one_line_that_lists_the_known(export):
    code, printed, folder = export("--effects", "slope,erosion")
    assert code == 2 and not folder.exists()
    last = printed.err.splitlines()[-1]
    assert "'erosion' is no effect; expected some of" in last and all(name in last for name in ATTRIBUTES)
