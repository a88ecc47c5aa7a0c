# SPDX-License-Identifier: GPL-3.0-or-later
"""The asset library: its content, the child process that writes it, and its entry in the preferences."""

import re
import subprocess
import sys

import bpy
import numpy as np
import pytest
from adaptive_terrain.operators.assets import library
from adaptive_terrain.operators.assets.build import BLEND, CATALOGS

KINDS = "materials", "node_groups", "objects", "collections"


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Write the library once, as the extension does."""
    folder = tmp_path_factory.mktemp("user") / "assets"
    folder.mkdir()
    assert not library.is_current(folder)
    script = "import sys; from pathlib import Path; from adaptive_terrain.operators.assets import build, thumbnails; "
    script += "thumbnails.SIDE, thumbnails.SAMPLES = 32, 1; "  # which takes a third of the time
    script += "build.write_library(Path(sys.argv[1]), sys.argv[2])"
    subprocess.run([sys.executable, "-c", script, folder, library._stamp()], check=True, stdout=subprocess.DEVNULL)
    assert library.is_current(folder) and list(folder.parent.iterdir()) == [folder]
    return folder


@pytest.fixture
def assets(empty, written):
    """Append all assets, and return them by their kinds."""
    with bpy.data.libraries.load(str(written / BLEND), assets_only=True) as (there, wanted):
        for kind in KINDS:
            setattr(wanted, kind, list(getattr(there, kind)))
    return {kind: {item.name: item for item in getattr(wanted, kind)} for kind in KINDS}


@pytest.fixture
def folders(monkeypatch, tmp_path):
    """Begin with one library of the user, and remove all entries at the end."""
    libraries = bpy.context.preferences.filepaths.asset_libraries
    monkeypatch.setattr(library, "library_folder", lambda create=False: tmp_path)
    libraries.new(name=library.AUTHOR, directory=str(tmp_path / "user"))
    before = entries()
    yield tmp_path, before
    while len(libraries):
        libraries.remove(libraries[0])


def entries() -> list[tuple[str, str]]:
    return [(entry.name, entry.path) for entry in bpy.context.preferences.filepaths.asset_libraries]


def test_the_library_has_materials_groups_and_plants(assets):
    layers = {f"Terrain {name}" for name in ("Grass", "Scree", "Rock", "Snow")}
    assert set(assets["materials"]) == {"Terrain Material", "Terrain Water", *layers}
    assert set(assets["node_groups"]) == {"Terrain Layers", "Adaptive Scatter in Metres", "Terrain Haze"}
    assert set(assets["collections"]) == {"Conifers", "Broadleaves", "Bushes", "Grass", "Rocks"}
    assert len(assets["objects"]) == 16 and all(obj.data.polygons for obj in assets["objects"].values())


def test_every_asset_is_in_a_catalog_and_has_a_picture(assets, written):
    text = (written / CATALOGS).read_text()
    assert text.startswith("VERSION 1\n")
    catalogs = dict(re.findall(r"^([0-9a-f-]{36}):Adaptive Terrain/([^:]+):", text, re.M))
    found = {}
    for kind, items in assets.items():
        for item in items.values():
            found.setdefault(catalogs[item.asset_data.catalog_id], set()).add(kind)
            assert item.asset_data.description and item.asset_data.author == "Adaptive Terrain"
            if kind != "node_groups":
                pixels = np.array(item.preview.image_pixels_float).reshape(-1, 4)
                assert 0.01 < (pixels[:, 3] > 0.5).mean() < 0.9 and pixels[pixels[:, 3] > 0.5, :3].std() > 0.02
    assert found == {
        "Materials": {"materials"},
        "Node Groups": {"node_groups"},
        "Plants": {"objects", "collections"},
        "Rocks": {"objects", "collections"},
    }


def test_the_material_works_on_a_terrain(assets, scene, add_terrain):
    """It reads the layers, and the button builds its group again instead of adding a second material."""
    terrain, material = add_terrain(), bpy.data.materials["Terrain Material"]
    terrain.data.materials.append(material)
    bpy.ops.adaptive_terrain.update()
    assert terrain.data.attributes["splat_1"].domain == "POINT"
    assert bpy.ops.adaptive_terrain.terrain_material() == {"FINISHED"}
    assert [slot.material for slot in terrain.material_slots] == [material]


def test_the_entry_comes_once_and_only_it_goes(folders):
    folder, before = folders
    library.start()
    assert entries() == before, "an empty library is not listed"
    (folder / BLEND).write_bytes(b"")
    for _ in range(2):
        library.start()
        assert entries() == [*before, (f"{library.AUTHOR}.001", str(folder))]
    bpy.context.preferences.filepaths.asset_libraries[len(before)].name = "Renamed"
    library.stop()
    assert entries() == before
    library.stop()
    assert entries() == before


def test_a_library_of_another_version_is_not_current(written, monkeypatch):
    assert library.is_current(written)
    monkeypatch.setattr(library, "ASSETS", library.ASSETS + 1)
    assert not library.is_current(written)


def test_a_package_outside_of_blender_has_no_library(empty):
    assert library.library_folder() is None and library.PACKAGE == "adaptive_terrain"
    before = entries()
    library.start()
    library.stop()
    assert entries() == before and not bpy.app.timers.is_registered(library._turn)
