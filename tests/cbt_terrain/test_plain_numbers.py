# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers and views of any type that a caller has are taken, and kept as Python's own."""

import dataclasses
import json
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.accuracy.measure import measure
from adaptive_terrain.cbt_terrain.attributes.attribute import AttributeRequest
from adaptive_terrain.cbt_terrain.attributes.catalogue import register_attribute
from adaptive_terrain.cbt_terrain.attributes.decals import Decal, picture
from adaptive_terrain.cbt_terrain.attributes.splat_rules import Layer, Rule
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.detail import Detail
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.fit.fit import bake
from adaptive_terrain.cbt_terrain.height_operators.catalogue import register_height_operator
from adaptive_terrain.cbt_terrain.height_operators.mask import GroundRule, HeightMask
from adaptive_terrain.cbt_terrain.height_operators.stack import Entry, Stack
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.mesh.archive import read_npz, write_npz
from adaptive_terrain.cbt_terrain.plain_numbers import plain_number
from adaptive_terrain.cbt_terrain.query.box import box_range
from adaptive_terrain.cbt_terrain.query.ground import ground_at, profile
from adaptive_terrain.cbt_terrain.query.viewshed import viewshed
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.scatter.points import scatter_points
from adaptive_terrain.cbt_terrain.scatter.scatter import Scatter
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View

NUMBERS = [np.float32, np.float64, np.int64, np.int8, np.longdouble, Fraction, np.array, float, int]
VIEW = View.look((0, -80, 60), (0, 0, 0), resolution=(64, 36))


def field():
    y, x = np.mgrid[0:33, 0:33].astype(np.float32)
    return from_array(5 * np.sin(x / 4) * np.cos(y / 5), 2.0)


@cache
def mesh():
    return Terrain(field(), 1).update(Criterion(), VIEW).surface


# Settings built with numbers of one type.
SETTINGS = {
    "criterion": lambda n: Criterion(error_px=n(4), max_triangles=n(100), max_depth=n(14), meshlet=n(1), morph=n(2)),
    "scatter": lambda n: Scatter(spacing=n(50), seed=n(3), on=n(-1), size=n(2)),
    "import": lambda n: ImportSettings(
        "a.raw", size=n(65), height_scale=n(2), raw_size=(n(3), n(4)), extent=(n(5), n(6)), no_data=n(9), band=n(1)
    ),
    "layer": lambda n: Layer("A", (Rule("slope", low=n(1), edge=n(1), other=n(-1)),), strength=n(1), seed=n(2)),
    "detail": lambda n: Detail(n(2), wavelength=n(3), seed=n(4)),
    "stack": lambda n: Stack(
        (
            Entry(
                "rivers",
                {"years": n(100)},
                seed=n(4),
                mask=HeightMask(rules=(GroundRule("height", low=n(5)),), factor=n(1)),
            ),
        )
    ),
    "effect": lambda n: AttributeRequest("occlusion", (), parameters=(("radius", n(9)), ("colors", ((n(1), n(0)),)))),
    "decal": lambda n: Decal("a", picture(np.ones((2, 2, 4)), False), (n(0), n(0)), (n(9), n(0)), (n(0), n(9)), n(1)),
}


@pytest.mark.parametrize("build", SETTINGS.values(), ids=SETTINGS)
def test_settings_are_equal_for_numbers_of_any_type(build):
    found = [build(number) for number in NUMBERS]
    assert len({repr(one) for one in found}) == 1 and all(one == found[0] for one in found)


def test_settings_of_numpy_numbers_can_be_written_as_json():
    text = json.dumps(dataclasses.asdict(SETTINGS["import"](np.float32)))
    assert text == json.dumps(dataclasses.asdict(SETTINGS["import"](int)))
    assert json.loads(text)["raw_size"] == [3, 4] and '"height_scale": 2.0' in text
    stacks = [SETTINGS["stack"](number).key() for number in NUMBERS]
    assert len(set(stacks)) == 1
    assert ImportSettings("a.raw", holes=np.bool_(True)).holes is True


def test_views_are_equal_for_numbers_of_any_type():
    def view(n):
        return View.look(
            (n(0), n(-80), n(60)),
            (n(0),) * 3,
            fov_deg=n(50),
            resolution=(n(64), n(36)),
            clip=(n(1), n(99)),
            roll_deg=n(3),
        )

    views = [view(n) for n in NUMBERS]
    assert len({v.key() for v in views}) == 1 and json.dumps(views[0].resolution) == "[64, 36]"
    assert {json.dumps([v.resolution, v.clip]) for v in views} == {"[[64, 36], [1.0, 99.0]]"}


@pytest.mark.parametrize("number", [np.float32, np.int64, Fraction, np.array])
def test_functions_take_numbers_of_any_type(number):
    heights = field()
    assert (
        ground_at(heights, [(1, 2)], number(2), number(1), number(1)).heights
        == ground_at(heights, [(1, 2)], 2.0, 1.0, 1).heights
    )
    assert box_range(heights, *map(number, (-9, -9, 9, 9))) == box_range(heights, -9, -9, 9, 9)
    line = [(-9, 0), (9, 0)]
    assert np.array_equal(profile(heights, line, number(4)).heights, profile(heights, line, 4.0).heights)
    seen = [viewshed(heights, (0, 0, 20), n(1), n(30)) for n in (number, float)]
    assert np.array_equal(*seen) and seen[0].any()
    baked = bake(heights, number(1), fitted=True, max_triangles=number(500), threads=number(1))
    assert baked.bound_m == bake(heights, 1.0, fitted=True, max_triangles=500).bound_m
    terrain = Terrain(heights, number(2))
    update = terrain.update(Criterion(), VIEW, vertical_scale=number(2), vertical_offset=number(1))
    tree, how = terrain.saved()
    assert json.dumps(how) and update.changed
    assert not terrain.update(Criterion(), [VIEW], None, 2.0, 1).changed
    restored = Terrain(heights, 1).restore(tree, **{name: number(value) for name, value in how.items()})
    assert np.array_equal(restored.surface.positions, update.surface.positions)


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: Criterion(max_triangles=5.5), "The criterion's max_triangles is 5.5; expected a whole number."),
        (lambda: Criterion(max_triangles=np.nan), "max_triangles is nan; expected a whole number"),
        (lambda: Criterion(meshlet=True), "The criterion's meshlet is True; expected a whole number."),
        (lambda: Criterion(error_px=None), "The criterion's error_px is None; expected a number."),
        (lambda: Criterion(error_px=10**400), "error_px is 1000.*; expected a number"),
        (lambda: Criterion(error_px=[1.0]), r"error_px is \[1.0\]; expected a number"),
        (lambda: Criterion(error_px=1 + 2j), r"error_px is \(1\+2j\); expected a number"),
        (lambda: Scatter(spacing="50"), "The scatter's spacing is '50'; expected a number."),
        (lambda: Scatter(seed=-1), "The scatter's seed is -1; expected a whole number, 0"),
        (lambda: ImportSettings("a.tif", extent=5), "The import's extent is 5; expected 2 numbers."),
        (lambda: ImportSettings("a.tif", holes="yes"), "The import's holes is 'yes'; expected True or False."),
        (lambda: View.look((0, 0, 1), (0, 0, 0), resolution=640), "The resolution is 640; expected 2 numbers."),
        (lambda: View.look((0, 0), (0, 0, 0)), r"The view's eye came as an array of the shape \(2,\)"),
        (lambda: View.look((0, 0, 1), (0, 0, 0), fov_deg="50"), "The field of view is '50'; expected a number."),
        (lambda: ground_at(field(), [(0, 0)], "2"), "The vertical scale is '2'; expected a number."),
        (lambda: Terrain(field(), 1).update(Criterion(), [VIEW, 3]), "The views have 3 among them; expected View"),
        (lambda: Terrain(field(), 1).update(Criterion(), None), "The views have None among them; expected View"),
        (lambda: scatter_points(field(), Scatter(), ["a"]), "The views have 'a' among them; expected View"),
        (lambda: Terrain(field(), "2"), "The number of threads is '2'; expected a whole number."),
        (lambda: Terrain("a.store"), "The height field is 'a.store'; expected one that open_store returns."),
        (lambda: Terrain(field(), 1).update(1.0, VIEW), "The criterion is 1.0; expected a Criterion"),
        (
            lambda: Terrain(field(), 1).update(Criterion(), VIEW, (1, 2, 3)),
            r"rows of the placement came .* the shape \(3,\)",
        ),
        (lambda: Terrain(field(), 1).restore("tree"), "The saved tree is 'tree'; expected bytes"),
        (lambda: Terrain(field(), 1, whole="yes"), "The argument whole is 'yes'; expected True or False."),
        (lambda: View("camera", np.eye(4), (9, 9)), "The rows of the camera's matrix are no numbers"),
        (
            lambda: View(np.eye(3), np.eye(4), (9, 9)),
            r"The rows of the camera's matrix came as an array of the shape \(3, 3\)",
        ),
        (lambda: View.look((0, 0, 1), (0, 0, 0), kind=None), "The camera's kind is None; expected one of PERSPECTIVE"),
        (lambda: View.look(("1", "2", "3"), (0, 0, 0)), "The view's eye are no numbers"),
        (lambda: bake("a.store", 1.0), "The height field is 'a.store'"),
        (lambda: bake(None, 1.0, fitted=True), "The height field is None"),
        (lambda: bake(field(), 1.0, fitted="no"), "The argument fitted is 'no'; expected True or False."),
        (lambda: bake(field(), 1.0, fitted=True, on_progress=None), "on_progress is None; .* function: leave it out."),
        (lambda: ground_at("a.store", [(0, 0)]), "The height field is 'a.store'"),
        (lambda: ground_at(field(), [("0", "0")]), "The places are no numbers"),
        (lambda: ground_at(field(), [(0, 0)], threads="2"), "The number of threads is '2'"),
        (lambda: profile("a.store", [(0, 0), (1, 1)]), "The height field is 'a.store'"),
        (lambda: viewshed(field(), (0, 0, 9), threads=[1]), r"The number of threads is \[1\]"),
        (lambda: scatter_points("a.store", Scatter()), "The height field is 'a.store'"),
        (lambda: scatter_points(field(), 10.0), "The scatter is 10.0; expected a Scatter"),
        (
            lambda: scatter_points(field(), Scatter(), placement=[1, 2]),
            r"The rows of the placement came as .* the shape \(2,\)",
        ),
        (lambda: Scatter(where="grass"), "The scatter's where is 'grass'; expected a Layer."),
        (lambda: Scatter(layers="grass"), "The scatter's layers is 'grass'; expected a list of Layer objects."),
        (lambda: Scatter(layers=["grass"]), "One of the scatter's layers is 'grass'; expected Layer objects."),
        (lambda: Layer("A", Rule("slope")), r"layer's rules is Rule\(of='slope', .* expected a list of Rule objects."),
        (lambda: Layer(Rule("slope")), "A splat layer's name is Rule.*; expected a text."),
        (lambda: Rule(3), "A splat rule's of is 3; expected the name of a quantity."),
        (lambda: Rule("image", image=[[1.0]]), r"image is \[\[1.0\]\]; expected one of image_rule, or None."),
        (lambda: ImportSettings(None), "The import's source is None; expected the path of a height map."),
        (lambda: ImportSettings(["a.tif", "b.tif"]), "The import's source is .'a.tif', 'b.tif'.; expected the path of"),
        (lambda: ImportSettings("a.tif", more_sources="b.tif"), "more_sources is 'b.tif'; expected a list of paths"),
        (lambda: ImportSettings("a.tif", more_sources=Path("b")), "more_sources is .*Path.*; expected a list of paths"),
        (lambda: ImportSettings("a.tif", more_sources=[3]), "One of the import's more_sources is 3; expected paths"),
        (lambda: ImportSettings("a.tif", project=32632), "The import's project is 32632; expected a text."),
        (lambda: ImportSettings("a.tif", loaded_tiles=5), "loaded_tiles is 5; expected a list of whole numbers."),
        (lambda: ImportSettings("a.tif", loaded_tiles=[1.5]), "loaded_tiles is 1.5; expected a whole number."),
        (lambda: import_source(3, "a.store"), "The import's source is 3; expected the path of a height map."),
        (lambda: import_source("island", None), "The store None is of the type NoneType; expected the name of a file"),
        (lambda: import_source("island", "a.store", None), "on_progress is None; expected a function: leave it out."),
        (lambda: import_source("island", "a.store", part=("read", [1])), "The part is .*; expected an ImportPart"),
        (lambda: open_store(None), "The store None is of the type NoneType; expected the name of a file or folder."),
        (lambda: open_store(b"a"), "is of the type bytes"),
        (lambda: read_npz(3), "The file 3 is of the type int"),
        (lambda: write_npz(None, mesh()), "The file None is of the type NoneType"),
        (
            lambda: write_npz("a.npz", "mesh"),
            "The surface is 'mesh'; expected a Surface, as the `surface` of an update.",
        ),
        (lambda: write_npz("a.npz", mesh(), origin=3.0), r"The origin came as an array of the shape \(1,\)"),
        (lambda: write_npz("a.npz", mesh(), origin=[(0, 0, 0)] * 2), "The origin came as 2 points"),
        (lambda: write_npz("a.npz", mesh(), info=["a"]), r"The info of the file is \['a'\]; expected a dict."),
        (lambda: write_npz("a.npz", mesh(), tree="tree"), "The saved tree is 'tree'; expected bytes"),
        (lambda: measure("a.store", mesh()), "The height field is 'a.store'"),
        (lambda: measure(field(), Terrain(field(), 1)), "The surface is <Terrain.*; expected a Surface"),
        (lambda: measure(field(), mesh(), [VIEW]), r"The view is \[<View.*\]; expected a View or None."),
        (lambda: measure(field(), mesh(), VIEW, "up"), "The rows of the placement are no numbers"),
        (lambda: measure(field(), mesh(), vertical_scale="2"), "The vertical scale is '2'; expected a number."),
        (lambda: measure(field(), mesh(), random_points=1.5), "The number of random points is 1.5; expected a whole"),
        (lambda: measure(field(), mesh(), random_points=-1), "The number of random points is -1; expected 0 .."),
        (lambda: measure(field(), mesh(), random_points=10**12), "random points is 1000000000000; expected 0 .."),
        (lambda: measure(field(), mesh(), seed="a"), "The seed is 'a'; expected a whole number."),
        (lambda: measure(field(), mesh(), sight=VIEW), "The sight is <View.*; expected one that `look` returns"),
        (lambda: measure(field(), mesh(), on_progress=3), "The argument on_progress is 3; expected a function"),
        (lambda: register_attribute("slope"), "The attribute is 'slope'; expected an AttributeDeclaration."),
        (lambda: register_height_operator("rivers"), "The height operator is 'rivers'; expected a HeightOperator."),
    ],
)
def test_other_values_are_refused_in_one_sentence(make, message):
    with pytest.raises(TerrainError, match=message):
        make()


@pytest.mark.parametrize("places", [np.array([[1.0, 2.0 + 3.0j]]), [(1j, 0)], [(10**400, 0)]])
def test_positions_that_no_float_holds_are_refused(places):
    with pytest.raises(TerrainError, match="are no numbers"):
        ground_at(field(), places)


def test_views_and_positions_come_from_generators():
    heights, terrain = field(), Terrain(field(), 1)
    expected = terrain.update(Criterion(error_px=0.5), [VIEW])
    assert expected.triangles > 100
    for views in ((v for v in [VIEW]), VIEW, (VIEW,), {1: VIEW}.values()):
        found = Terrain(heights, 1).update(Criterion(error_px=0.5), views)
        assert found.triangles == expected.triangles and found.bound_px == expected.bound_px
    places = [(1.0, 2.0), (3.0, -4.0)]
    assert np.array_equal(terrain.triangles_at(iter(places)), terrain.triangles_at(places))
    assert np.array_equal(ground_at(heights, iter(places)).heights, ground_at(heights, places).heights)
    scatter = Scatter(spacing=3.0, full_until=0.0)
    seen = scatter_points(heights, scatter, [VIEW])
    assert 0 < len(seen) == len(scatter_points(heights, scatter, iter([VIEW])))


def test_paths_and_lists_of_sources_are_taken():
    given = ImportSettings(Path("a.tif"), more_sources=[Path("b.tif"), np.str_("c.tif")], loaded_tiles=np.arange(3))
    assert repr(given) == repr(ImportSettings("a.tif", more_sources=("b.tif", "c.tif"), loaded_tiles=(0, 1, 2)))
    assert json.loads(json.dumps(dataclasses.asdict(given)))["more_sources"] == ["b.tif", "c.tif"]


def test_lists_and_matrices_of_any_type_are_taken(tmp_path):
    layers = [Layer("A"), Layer("B", [Rule("slope", low=0.5)])]
    assert hash(Scatter(layers=layers, on=1)) == hash(Scatter(layers=tuple(layers), on=1))
    write_npz(tmp_path / "a.npz", mesh(), np.float32([1, 2, 3]), {"a": np.int64(3)})
    assert read_npz(str(tmp_path / "a.npz"))["origin"].tolist() == [1.0, 2.0, 3.0]
    shifted = np.eye(4, dtype=np.float32)
    shifted[0, 3] = 5.0
    for placement in (shifted, shifted.tolist(), tuple(map(tuple, shifted.tolist()))):
        assert Terrain(field(), 1).update(Criterion(), VIEW, placement).triangles > 0
        assert len(scatter_points(field(), Scatter(spacing=3.0), [VIEW], placement=placement)) > 0
    measured = [measure(field(), mesh(), random_points=n(100), seed=n(3)) for n in (int, np.int64, np.float32)]
    assert measured[0] == measured[1] == measured[2]


def test_large_whole_numbers_keep_their_digits():
    assert plain_number(np.uint64(2**63 + 1), int, "") == 2**63 + 1
    assert plain_number(2**53 + 1, int | None, "") == 2**53 + 1
    assert plain_number(None, int | None, "") is None and type(plain_number(np.float64(3), int, "")) is int
