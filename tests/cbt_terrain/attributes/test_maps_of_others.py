# SPDX-License-Identifier: GPL-3.0-or-later
"""A folder of maps that holds a user's images, or leads to them: none is replaced, removed or taken for a map."""

import json
import os

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes.attribute import AttributeRequest
from adaptive_terrain.cbt_terrain.attributes.bake import bake
from adaptive_terrain.cbt_terrain.attributes.folder import JSON_NAME
from adaptive_terrain.cbt_terrain.errors import TerrainError
from fields import rough
from matplotlib.image import imsave

SLOPE, NORMAL = AttributeRequest("slope", ("a test",)), AttributeRequest("detail_normal", ("a test",))
links = pytest.mark.skipif(os.name != "posix", reason="Windows lets only some users make symbolic links")


def test_a_users_image_with_a_comment_is_not_replaced(tmp_path):
    imsave(tmp_path / "slope.png", np.zeros((8, 8, 3)), metadata={"Comment": "Created with GIMP"})
    before = (tmp_path / "slope.png").read_bytes()
    with pytest.raises(TerrainError, match="slope.png was not baked"):
        bake(rough(9, 9), [SLOPE], tmp_path, [16])
    assert (tmp_path / "slope.png").read_bytes() == before


def test_a_users_image_is_not_replaced(tmp_path):
    (tmp_path / "slope.png").write_bytes(b"mine")
    with pytest.raises(TerrainError, match="slope.png was not baked by Adaptive Terrain; expected a folder"):
        bake(rough(9, 9), [SLOPE], tmp_path, [16])
    assert (tmp_path / "slope.png").read_bytes() == b"mine" and os.listdir(tmp_path) == ["slope.png"]


def test_a_users_image_that_an_index_names_is_not_removed(tmp_path):
    """A stranger's maps.json may name any image in its folder."""
    bake(rough(9, 9), [SLOPE, NORMAL], tmp_path, [16])
    (tmp_path / "portrait.png").write_bytes(b"mine")
    file = tmp_path / JSON_NAME
    index = json.loads(file.read_text())
    index["maps"]["slope"]["tiles"][0]["file"] = "portrait.png"
    file.write_text(json.dumps(index | {"height_field": "another"}))
    bake(rough(9, 9), [NORMAL], tmp_path, [16])
    assert (tmp_path / "portrait.png").read_bytes() == b"mine"


def test_a_damaged_map_is_baked_again(tmp_path):
    bake(rough(9, 9), [SLOPE], tmp_path, [16])
    whole = (tmp_path / "slope.png").read_bytes()
    (tmp_path / "slope.png").write_bytes(whole[:50])
    assert bake(rough(9, 9), [SLOPE], tmp_path, [16]).written == 1
    assert (tmp_path / "slope.png").read_bytes() == whole


@links
def test_an_image_is_not_written_through_a_link(tmp_path):
    precious = tmp_path / "precious"
    bake(rough(9, 9), [SLOPE], precious, [16])
    before = {name: (precious / name).read_bytes() for name in os.listdir(precious)}
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "slope.png").symlink_to(precious / "slope.png")
    with pytest.raises(TerrainError, match="slope.png was not baked"):
        bake(rough(9, 9), [SLOPE], tmp_path / "maps", [16])
    (tmp_path / "st_maps").symlink_to(precious)
    with pytest.raises(TerrainError, match="st_maps is a link; expected a folder"):
        bake(rough(9, 9), [SLOPE], tmp_path / "st_maps" / "Terrain", [16])
    assert {name: (precious / name).read_bytes() for name in os.listdir(precious)} == before


@links
def test_maps_go_into_a_folder_that_the_user_has_linked(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    assert bake(rough(9, 9), [SLOPE], tmp_path / "out", [16]).written == 1
    assert sorted(os.listdir(tmp_path / "disk")) == ["maps.json", "slope.png"]
