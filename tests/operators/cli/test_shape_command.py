# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `shape`: a stack's file in, a store and rasters out, and one line where that cannot be."""

import json

import pytest
import rasterio
import store_exports
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.operators.cli import shape_command

FLIGHT = {
    "fov": 30,
    "clip": [1, 50000],
    "keyframes": [{"frame": 1, "eye": [-3500, -3500, 900], "target": [-3400, -3400, 0]}],
}
STACK = {"version": 1, "entries": [{"effect": "relief", "seed": 5}]}


@pytest.fixture(scope="module")
def island(tmp_path_factory):
    store = tmp_path_factory.mktemp("island") / "store"
    run_import(ImportSettings("island", size=1100), store)
    return store


@pytest.fixture
def run(island, tmp_path, capsys):
    """Run `shape`; returns the exit code and the output."""
    (tmp_path / "stack.json").write_text(json.dumps(STACK))
    (tmp_path / "flight.json").write_text(json.dumps(FLIGHT))

    def shape(*more, stack="stack.json"):
        argv = ["--store", island, "--stack", tmp_path / stack, "--out", tmp_path / "out", *more]
        return store_exports.run("shape", *argv), capsys.readouterr()

    return shape


def test_a_whole_store_and_its_raster(run, island, tmp_path):
    code, said = run("--export", tmp_path / "new.tif")
    field = open_store(tmp_path / "out")
    assert code == 0 and said.err == "" and "tiles: 39 built of 39 there are" in said.out
    assert "relief at 7.454 m" in said.out and f"{tmp_path / 'new.tif'} is written" in said.out
    with rasterio.open(tmp_path / "new.tif") as found:
        assert (found.read(1)[::-1] == field.samples).all()
    assert abs(field.samples - open_store(island).heights()).max() > 1
    assert "unchanged: True" in run()[1].out


def test_only_what_a_camera_sees(run, island, tmp_path):
    code, said = run("--path", tmp_path / "flight.json", "--resolution", "400x300", "--pixel-error", "0.5")
    assert code == 0 and "of 39 there are" in said.out and "warning: Finer levels are left out" in said.out
    changed = open_store(tmp_path / "out").samples - open_store(island).heights()
    between = abs(changed[:, 1:-1:2] - 0.5 * (changed[:, :-2:2] + changed[:, 2::2]))  # 0 where it was interpolated
    assert between[:150, :75].mean() > 0.01 and between[600:, 300:].mean() < 1e-4


def test_finishing_early(run, tmp_path):
    code, said = run("--finish-early", "1e-9")
    assert code == 0 and "finished_early: True" in said.out and open_store(tmp_path / "out").samples.size == 1100**2


def test_wrong_usage_is_told(run, island, tmp_path, monkeypatch):
    for option, value in (("--frames", "1"), ("--resolution", "400x300"), ("--pixel-error", "2")):
        code, printed = run(option, value)
        assert code == 2 and f"{option} is of a --path" in printed.err, "without one it would do nothing"
    assert run("--whole", "--path", tmp_path / "flight.json")[0] == 2
    assert run("--finish-early", "0")[0] == 2
    for arguments, said in (
        ({"stack": "none.json"}, "cannot be read"),
        ({"stack": "flight.json"}, "has 'clip'; expected version, entries"),
    ):
        code, printed = run(**arguments)
        assert code == 1 and said in printed.err and printed.err.count("\n") == 1
    for name, why in (("x.jpg", "expected .tif, .tiff, .exr"), ("none/x.tif", "there is no folder"), ("x", ".tif")):
        code, printed = run("--export", tmp_path / name)
        assert code == 1 and why in printed.err
        assert not (tmp_path / "out").exists(), "told before the work"
    monkeypatch.setattr(shape_command, "WHOLE_SAMPLES", 1000)
    code, printed = run()
    assert code == 1 and "--path FILE.json" in printed.err and "--whole" in printed.err


def test_a_mask_that_is_not_there_is_told_of_as_a_mask(run, tmp_path):
    masked = {"effect": "relief", "mask": {"image": "painted.png"}}
    (tmp_path / "masked.json").write_text(json.dumps({"version": 1, "entries": [masked]}))
    code, said = run(stack="masked.json")
    assert code == 1 and "painted.png does not exist; expected the file of a mask." in said.err


def test_an_empty_stack_is_told_without_empty_lines(run, tmp_path):
    (tmp_path / "empty.json").write_text('{"version": 1, "entries": []}')
    code, said = run(stack="empty.json")
    assert code == 0 and "\n\n" not in said.out


def test_the_help_has_an_example(capsys):
    assert store_exports.run("shape", "--help") == 0
    said = capsys.readouterr().out
    assert "adaptive-terrain shape --store island.store --stack rivers.json" in said
    example = said[said.index('  {"version"') : said.index("  adaptive-terrain shape")]
    from adaptive_terrain.cbt_terrain.height_operators.stack import stack_from

    assert stack_from(json.loads(example)).entries[0].effect == "rivers"
