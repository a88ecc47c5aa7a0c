# SPDX-License-Identifier: GPL-3.0-or-later
"""Layers and heights that are not finite in a store with valid checksums give one error wherever they are read."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from adaptive_terrain import Criterion, ImportSettings, Scatter, Terrain, open_store, scatter_points
from adaptive_terrain.cbt_terrain.attributes.attribute import AttributeRequest
from adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES
from adaptive_terrain.cbt_terrain.attributes.decals import picture
from adaptive_terrain.cbt_terrain.attributes.evaluate import on_samples
from adaptive_terrain.cbt_terrain.attributes.layers import NAMES
from adaptive_terrain.cbt_terrain.attributes.plan import plan
from adaptive_terrain.cbt_terrain.attributes.splat_rules import Layer, Rule
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store_arrays import all_checksums, header
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.height_operators.export import export_raster
from adaptive_terrain.cbt_terrain.height_operators.mask import GroundRule, HeightMask
from adaptive_terrain.cbt_terrain.height_operators.shape_store import run_shape
from adaptive_terrain.cbt_terrain.height_operators.stack import Entry, Stack
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.mesh.archive import finite_json, write_npz
from adaptive_terrain.cbt_terrain.mesh.attributes import Attribute
from evaluations import Evaluations

ROCK = (Layer("Scree", (Rule("scree", 0.1, 10.0, 0.1),)), Layer("Rock", ()))
SNOW = Stack((Entry("snow", mask=HeightMask("", (GroundRule("scree", low=0.1, edge=0.1),))),))


def change(store: Path, name: str, value: float) -> None:
    """Write `value` into an array of a store, with valid checksums."""
    file = store / json.loads((store / "store.json").read_text())["data"] / f"{name}.npy"
    array = np.load(file)
    array[20:30, 20:30] = value
    file.write_bytes(header(array.shape, array.dtype) + array.tobytes() + all_checksums(array))


@pytest.fixture(scope="module")
def shaped(tmp_path_factory):
    """Shape a store of 65 x 65 samples with a layer of scree."""
    folder = tmp_path_factory.mktemp("layers")
    y, x = np.indices((65, 65)) / 9.0
    np.save(folder / "d.npy", (300 * np.sin(x) * np.cos(y) + 20 * x).astype(np.float32))
    run_import(ImportSettings(str(folder / "d.npy"), extent=(3200.0, 3200.0)), folder / "store")
    run_shape(folder / "store", Stack((Entry("scree"),)), folder / "land", threads=1)
    return folder / "land"


def attributes(store, asked):
    field = open_store(store)
    surface = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=20.0)).surface
    return Evaluations(1).attributes(plan([asked]), field, surface, [])


READERS = {
    "an attribute": lambda store, out: attributes(store, AttributeRequest("scree", ("test",))),
    "splat weights": lambda store, out: attributes(
        store, AttributeRequest("splat_1", ("test",), parameters=(("layers", ROCK),))
    ),
    "samples": lambda store, out: list(on_samples(open_store(store), [AttributeRequest("scree", ("test",))])),
    "a scatter": lambda store, out: scatter_points(open_store(store), Scatter(spacing=50.0, where=ROCK[0])),
    "a further shape": lambda store, out: run_shape(store, SNOW, out / "more", threads=1),
    "a raster": lambda store, out: export_raster(store, out / "a.exr"),
    "verify": lambda store, out: verify(store),
}


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("reader", READERS)
def test_a_layer_that_is_not_finite_is_refused(reader, value, shaped, tmp_path):
    store = tmp_path / "land"
    shutil.copytree(shaped, store)
    if value is np.nan:
        READERS[reader](store, tmp_path)  # undamaged
        shutil.rmtree(tmp_path / "more", ignore_errors=True)
    change(store, "layer_scree", value)
    with pytest.raises(TerrainError, match=r"layer_scree.npy is damaged \(a value is not a finite number\): shape"):
        READERS[reader](store, tmp_path)
    assert not (tmp_path / "more" / "store.json").exists()


HEIGHT_READERS = {
    "slope": lambda store, out: attributes(store, AttributeRequest("slope", ("test",))),
    "samples": lambda store, out: list(on_samples(open_store(store), [AttributeRequest("slope", ("test",))])),
    "a scatter": lambda store, out: scatter_points(open_store(store), Scatter(spacing=50.0)),
    "a raster": READERS["a raster"],
    "verify": READERS["verify"],
}


@pytest.mark.parametrize("reader", HEIGHT_READERS)
def test_heights_that_are_not_finite_are_refused(reader, shaped, tmp_path):
    store = tmp_path / "land"
    shutil.copytree(shaped, store)
    change(store, "samples", np.nan)
    with pytest.raises(TerrainError, match="is damaged .*not finite.*import it again"):
        HEIGHT_READERS[reader](store, tmp_path)


@pytest.mark.parametrize("name", ["pictures", "tilts"])
def test_pictures_of_any_numbers_give_finite_values(name):
    pixels = np.ones((4, 4, 4), np.float32)
    pixels[0, 0], pixels[1, 1], pixels[2, 2], pixels[3, 3, 3] = np.nan, np.inf, -np.inf, np.nan
    made = picture(pixels, name == "tilts")
    assert all(np.isfinite(level).all() for level in made.mips)


def test_an_archive_takes_only_finite_numbers(shaped, tmp_path):
    surface = Terrain(open_store(shaped), 1).update(Criterion(error_px=0.0, error_m=20.0)).surface
    values = np.zeros(len(surface.positions), np.float32)
    values[3] = np.inf
    wrong = surface.with_attributes({"dust": Attribute(values, "POINT")})
    with pytest.raises(TerrainError, match="The array dust holds a value that is not a finite number"):
        write_npz(tmp_path / "a.npz", wrong, (0, 0, 0), {})
    with pytest.raises(TerrainError, match="A number of the file's description is not finite"):
        write_npz(tmp_path / "a.npz", surface, (0, 0, 0), {"bound_px": np.nan})
    assert not list(tmp_path.iterdir())
    assert finite_json({"a": 1.5}, "x") == '{"a": 1.5}' and set(NAMES) <= set(ATTRIBUTES)
