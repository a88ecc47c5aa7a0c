# SPDX-License-Identifier: GPL-3.0-or-later
"""Derived stores: ordinary stores with layers, which are rebuilt only after a change."""

import dataclasses
import json
import os
import shutil

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes.attribute import AttributeRequest, SamplePoints
from adaptive_terrain.cbt_terrain.attributes.layers import LAYERS, NAMES, make, why_missing
from adaptive_terrain.cbt_terrain.attributes.plan import plan
from adaptive_terrain.cbt_terrain.attributes.splat_rules import Layer, Rule
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.detail import Detail
from adaptive_terrain.cbt_terrain.field.heightfield import with_detail
from adaptive_terrain.cbt_terrain.field.store import discard, open_store, read_json
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.height_operators import level_plan
from adaptive_terrain.cbt_terrain.height_operators.catalogue import HEIGHT_OPERATORS
from adaptive_terrain.cbt_terrain.height_operators.mask import HeightMask
from adaptive_terrain.cbt_terrain.height_operators.shape_process import ShapeJob, shape_store
from adaptive_terrain.cbt_terrain.height_operators.shape_store import run_shape
from adaptive_terrain.cbt_terrain.height_operators.stack import Entry, Stack
from adaptive_terrain.cbt_terrain.height_operators.tiles import levels_of
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.import_report import describe
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from evaluations import Evaluations
from land_effects import SMOOTH, bumpy

HILL = Entry("hill", {"east": 2000.0, "north": 1500.0, "radius": 800.0})
STACK = Stack((Entry("smooth"), HILL))


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """Import a store of 333 x 700 samples, 20 m by 9 m apart, with a hole."""
    folder = tmp_path_factory.mktemp("source")
    heights = bumpy(333, 700)
    heights[200:230, 500:560] = np.nan
    np.save(folder / "land.npy", heights[::-1])
    settings = ImportSettings(str(folder / "land.npy"), extent=(699 * 9.0, 332 * 20.0), holes=True)
    run_import(settings, folder / "store")
    return folder / "store"


@pytest.fixture(scope="module")
def hill_folder(tmp_path_factory):
    return tmp_path_factory.mktemp("hilled")


@pytest.fixture
def hilled(source, hill_folder):
    """Return the store of the land with the hill alone, which is made once; tests change copies of it."""
    if not (hill_folder / "store").exists():
        run_shape(source, Stack((HILL,)), hill_folder / "store")
    return hill_folder / "store"


def test_a_shaped_store_is_an_ordinary_one(source, tmp_path):
    report = run_shape(source, STACK, tmp_path / "out")
    before, field = open_store(source), open_store(tmp_path / "out")
    assert field.samples.dtype == np.float32 and (field.valid == before.valid).all()
    assert report["tiles_built"] == report["tiles_there_are"] and report["cut_out"] == 1800
    assert report["left_out_most_m"] == 0.0 and len(report["levels"]) == 2 * len(levels_of(field.lattice))
    update = Terrain(field, 1).update(Criterion(error_px=0, error_m=5.0))
    assert update.surface.triangles.size and update.bound_m <= 5.0
    blocks = verify(tmp_path / "out")
    assert {"layer_worn.npy", "layer_fresh.npy", "layer_mark.npy", "samples.npy", "valid.npy"} <= set(blocks)
    shaped = read_json(tmp_path / "out")["provenance"]["shaped"]
    assert shaped["source_key"] == before.raster.digest and shaped["stack"]["entries"][1]["effect"] == "hill"
    assert describe(tmp_path / "out")["format"] == "shaped"


def test_unchanged_samples_keep_their_bits(source, tmp_path):
    run_shape(source, Stack((HILL,)), tmp_path / "out")
    before, field = open_store(source), open_store(tmp_path / "out")
    y, x = np.mgrid[0:333, 0:700]
    away = np.hypot(x * 9.0 - 2000.0, y * 20.0 - 1500.0)
    beyond = (away > 801) & (before.valid == 1)
    assert (field.samples[beyond] == before.heights()[beyond]).all() and beyond.sum() > 200_000
    cone = np.maximum(100 * (1 - away / 800.0), 0)
    assert abs(field.samples - before.heights() - cone)[before.valid == 1].max() < 1e-3
    assert abs(field.layers["fresh"] - cone).max() < 1e-3


def test_only_another_stack_or_request_rebuilds_a_store(source, tmp_path):
    first = run_shape(source, STACK, tmp_path / "out")
    assert run_shape(source, STACK, tmp_path / "out")["unchanged"] and "unchanged" not in first
    key = open_store(tmp_path / "out").key
    second = run_shape(source, Stack((HILL,)), tmp_path / "out")
    assert "unchanged" not in second and open_store(tmp_path / "out").key != key
    tiles = [{0: 0.0}, *({} for _ in levels_of(open_store(source).lattice)[1:])]
    third = run_shape(source, Stack((HILL,)), tmp_path / "out", tiles)
    assert third["tiles_built"] < third["tiles_there_are"] and "unchanged" not in third
    assert run_shape(source, Stack((HILL,)), tmp_path / "out", tiles)["unchanged"]
    assert len(list((tmp_path / "out").glob("data-*"))) == 1


def test_layers_decide_the_key_and_a_shaped_store_can_be_shaped(source, tmp_path):
    """Depths add up, states are replaced, and other layers are copied."""
    run_shape(source, Stack((HILL,)), tmp_path / "one")
    run_shape(tmp_path / "one", Stack((Entry("hill", {**HILL.parameters, "height": 50.0}),)), tmp_path / "two")
    one, two = open_store(tmp_path / "one"), open_store(tmp_path / "two")
    assert abs(two.layers["fresh"] - 1.5 * one.layers["fresh"]).max() < 1e-3
    assert (two.layers["mark"] == np.where(two.valid == 0, 0, 50)).all()
    run_shape(tmp_path / "two", Stack(), tmp_path / "three")
    three = open_store(tmp_path / "three")
    assert (three.samples == two.samples).all() and set(three.layers) == {"fresh", "mark"}
    assert one.key != two.key and str(one.key) == one.raster.digest


@pytest.mark.parametrize("damage", ["bytes", "missing", "short", "link", "nan"])
def test_a_damaged_layer_is_named(source, hilled, tmp_path, damage):
    shutil.copytree(hilled, tmp_path / "out")
    [file] = (tmp_path / "out").glob("data-*/layer_fresh.npy")
    content = bytearray(file.read_bytes())
    if damage == "bytes":
        content[6000] ^= 255
        file.write_bytes(content)
    elif damage == "short":
        file.write_bytes(content[:-5])
    else:
        file.unlink()
        if damage == "link":
            file.symlink_to(tmp_path / "elsewhere")
        elif damage == "nan":
            file.write_bytes(b"\x93NUMPY" + bytes(5000))
    field = open_store(tmp_path / "out")
    with pytest.raises(TerrainError, match="layer_fresh.npy"):
        field.layers["fresh"]
    with pytest.raises(TerrainError, match="layer_fresh.npy"):
        verify(tmp_path / "out")
    assert Terrain(field, 1).update(Criterion(error_px=0, error_m=5.0)).surface.triangles.size
    run_shape(source, Stack((HILL, Entry("smooth"))), tmp_path / "out")
    verify(tmp_path / "out")


@pytest.mark.parametrize("layers", [{"../x": "m"}, {"A": "m"}, {"a": 1}, [], {f"a{k}": "m" for k in range(65)}])
def test_invalid_names_of_layers_are_refused(hilled, tmp_path, layers):
    shutil.copytree(hilled, tmp_path / "out")
    file = tmp_path / "out" / "store.json"
    content = json.loads(file.read_text())
    file.write_text(json.dumps(content | {"layers": layers}))
    with pytest.raises(TerrainError, match="layers"):
        open_store(tmp_path / "out")


def test_invalid_requests_are_refused_before_writing(source, tmp_path):
    for out, match in ((source, "into itself"), (tmp_path / "file", "is a file")):
        (tmp_path / "file").write_text("x")
        for tried in (run_shape, ShapeJob):
            with pytest.raises(TerrainError, match=match):
                tried(source, STACK, out)
    with pytest.raises(TerrainError, match="no terrain store"):
        run_shape(tmp_path / "none", STACK, tmp_path / "out")
    with pytest.raises(TerrainError, match="m.png"):
        run_shape(source, Stack((Entry("hill", mask=HeightMask(str(tmp_path / "m.png"))),)), tmp_path / "out")
    with pytest.raises(TerrainError, match="expected one of"):
        ShapeJob(source, Stack((Entry("lava"),)), tmp_path / "out")
    assert not list(tmp_path.glob("out/data-*"))


def test_a_mask_from_a_file(source, tmp_path):
    part = np.zeros((40, 60), np.uint8)
    part[:, 30:] = 255
    np.save(tmp_path / "east.npy", part)
    wide = Entry("hill", {"radius": 1e5}, mask=HeightMask(str(tmp_path / "east.npy")))
    run_shape(source, Stack((wide,)), tmp_path / "out")
    change = open_store(tmp_path / "out").samples - open_store(source).heights()
    assert not change[:190, :340].any() and (change[:190, 360:] > 90).all()


def contents(store):
    """Return the bytes of all files except the tiles."""
    files = [file for file in store.rglob("*") if file.is_file() and file.parent.name != "tiles"]
    return {file: file.read_bytes() for file in files}


def test_cancelling_leaves_the_old_store(source, tmp_path):
    run_shape(source, Stack((HILL,)), tmp_path / "out")
    before = contents(tmp_path / "out")

    def cancel(fraction, _message):
        if fraction > 0.3:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run_shape(source, STACK, tmp_path / "out", on_progress=cancel)
    assert contents(tmp_path / "out") == before


def test_a_child_shapes_as_this_process_does(tmp_path):
    """A second run computes nothing."""
    run_import(ImportSettings("island", size=300), tmp_path / "island")
    stack = Stack((Entry("relief"),))
    reports = []
    report = shape_store(tmp_path / "island", stack, tmp_path / "out", on_progress=lambda *args: reports.append(args))
    run_shape(tmp_path / "island", stack, tmp_path / "here", threads=3)
    there, here = open_store(tmp_path / "out"), open_store(tmp_path / "here")
    assert there.samples.tobytes() == here.samples.tobytes() and there.key == here.key
    assert reports[-1] == (1.0, "Done") and report["effects"] == ["relief"]
    assert shape_store(tmp_path / "island", stack, tmp_path / "out")["unchanged"]


def test_every_layer_except_flow_and_uplift_is_an_attribute():
    layers = {layer.name: layer.unit for effect in HEIGHT_OPERATORS.values() for layer in effect.layers}
    own = {"worn", "fresh", "mark", "twice"}
    assert set(layers) - own <= {*NAMES, "flow", "uplift"}
    assert all(layers.get(effect.name, effect.unit) == effect.unit for effect in LAYERS)


def test_attributes_read_layers_at_points_and_scales(source, tmp_path, monkeypatch):
    """A ramp as a layer gives its value at a point on every level; a terrain without the layer gives 0 and a reason."""
    run_shape(source, Stack((HILL,)), tmp_path / "out")
    field = open_store(tmp_path / "out")
    west, south, _, _ = field.lattice.rectangle()
    ramp = np.tile(np.arange(700, dtype=np.float32) * 9.0, (333, 1))
    field = field.with_raster(layers={"snow": ramp})
    rng = np.random.default_rng(2)
    places = rng.uniform((500, 700, 0), (5000, 5000, 0), (100, 3)).astype(np.float32) + np.float32((west, south, 0))
    for surface in (field, with_detail(field, Detail(2.0, 30.0))):
        for level in (0.0, 1.5):
            there = SamplePoints(surface, places, np.full(100, level, np.float32))
            made = make(there, {"snow": {}, "scree": {}}, {})
            assert abs(made["snow"] - (places[:, 0] - west)).max() < 0.01 and not made["scree"].any()
    assert why_missing(field, "snow") == why_missing(field, "slope") == ""
    assert "no layer scree" in why_missing(field, "scree")


def test_a_foreign_folder_of_tiles_is_refused(source, tmp_path):
    (tmp_path / "out" / "tiles").mkdir(parents=True)
    (tmp_path / "out" / "tiles" / "floor.jpg").write_bytes(b"x")
    with pytest.raises(TerrainError, match="tiles"):
        run_shape(source, STACK, tmp_path / "out")
    os.replace(tmp_path / "out" / "tiles" / "floor.jpg", tmp_path / "floor.jpg")
    assert run_shape(source, STACK, tmp_path / "out")["samples"] == [700, 333]


def test_removing_the_tiles_meanwhile_does_not_lose_the_store(source, tmp_path):
    """Nothing is left to trim after the cache was cleared."""

    def cleared(_fraction, _message):
        shutil.rmtree(tmp_path / "tiles", ignore_errors=True)

    run_shape(source, STACK, tmp_path / "out", on_progress=cleared, tiles=tmp_path / "tiles")
    assert not (tmp_path / "tiles").exists()
    verify(tmp_path / "out")


def test_discarding_a_draft_does_not_remove_a_published_store(source, tmp_path):
    run_shape(source, STACK, tmp_path / "out")
    discard(tmp_path / "out", read_json(tmp_path / "out")["data"], [])
    verify(tmp_path / "out")


def test_splat_rules_read_layers(source, tmp_path):
    """Ground under more than a metre of snow is white; without the layer none is."""
    run_shape(source, Stack(), tmp_path / "out")
    field = open_store(tmp_path / "out")
    layers = Layer("Grass"), Layer("White", (Rule("snow", low=1.0),), on_top=True)
    asked = plan([AttributeRequest("splat_1", ("a test",), parameters=(("layers", layers),))])
    surface = Terrain(field, 1).update(Criterion(error_px=0, error_m=20.0)).surface
    assert {step.name for step in asked.steps} == {"snow", "splat_1"}
    for depth in (None, np.tile(np.linspace(0, 2, 700, dtype=np.float32), (333, 1))):
        field = field.with_raster(layers={} if depth is None else {"snow": depth})
        white = Evaluations().attributes(asked, field, surface)["splat_1"].array[:, 1]
        east = surface.positions[:, 0] > 0.01 * 699 * 9
        west = surface.positions[:, 0] < -0.01 * 699 * 9
        assert not white[west].any() and (white[east] == (0.0 if depth is None else 1.0)).all()


def test_a_report_warns_of_doubtful_tiles(source, tmp_path, monkeypatch):
    monkeypatch.setattr(level_plan, "MAX_WHOLE", 600)
    monkeypatch.setitem(HEIGHT_OPERATORS, "smooth", dataclasses.replace(SMOOTH, doubts=lambda *_: True))
    doubted = run_shape(source, STACK, tmp_path / "doubted")
    assert ["smooth may differ" in text for text in doubted["warnings"]] == [True]
    monkeypatch.setattr(level_plan, "MAX_WHOLE", 700)
    assert run_shape(source, STACK, tmp_path / "whole")["warnings"] == []
