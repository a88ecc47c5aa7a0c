# SPDX-License-Identifier: GPL-3.0-or-later
"""Images that a user paints or reloads: the live update of their terrain follows."""

import bpy
import numpy as np
import pytest
from adaptive_terrain.operators.session import live
from adaptive_terrain.operators.terrain.overrides import Overrides
from adaptive_terrain.operators.terrain.request import gather
from land_scenes import add


@pytest.fixture
def image(tmp_path):
    """Return an image of a file, black."""
    made = bpy.data.images.new("Paint", 8, 4)
    made.filepath_raw, made.file_format = str(tmp_path / "paint.png"), "PNG"
    made.save()
    bpy.data.images.remove(made)
    return bpy.data.images.load(str(tmp_path / "paint.png"))


@pytest.fixture
def marks(monkeypatch):
    """Return a list with an item for each request of a live update."""
    found = []
    monkeypatch.setattr(live, "mark_dirty", lambda: found.append(None))
    return found


def use_as_mask(terrain, image):
    entry = add("relief")
    entry.mask.kind, entry.mask.image = "IMAGE", image


def use_as_decal(terrain, image):
    decal = bpy.data.objects.new("Decal", None)
    decal.empty_display_type, decal.empty_display_size, decal.parent, decal.data = "IMAGE", 40.0, terrain, image
    bpy.context.scene.collection.objects.link(decal)


def use_as_hidden_decal(terrain, image):
    use_as_decal(terrain, image)
    bpy.data.objects["Decal"].hide_viewport = True


def use_as_layer(terrain, image):
    terrain.adaptive_terrain.layers.add().image = image


def paint(image):
    """Change pixels, and report it as Blender's brushes do."""
    image.pixels.foreach_set(np.tile(np.float32([1.0, 0.5, 0.0, 1.0]), 32))
    image.update_tag()


def reload(image):
    """Replace the file, and reload it as the button does."""
    other = bpy.data.images.new("Other", 8, 4)
    other.pixels.foreach_set(np.tile(np.float32([1.0, 0.5, 0.0, 1.0]), 32))
    other.filepath_raw, other.file_format = image.filepath, "PNG"
    other.save()
    image.reload()
    image.update_tag()


@pytest.mark.parametrize("change", [paint, reload])
@pytest.mark.parametrize("use", [use_as_mask, use_as_decal, use_as_hidden_decal, use_as_layer])
def test_a_changed_image_is_shown_by_the_live_update(use, change, terrain, image, marks):
    use(terrain, image)
    bpy.context.view_layer.update()

    def key():
        graph = bpy.context.evaluated_depsgraph_get()
        return gather(terrain, graph, overrides=Overrides(effects=("color",))).key()

    before = key()
    marks.clear()
    change(image)
    bpy.context.view_layer.update()
    assert marks and key() != before


def test_a_decal_is_read_once_unless_it_changes(terrain, image, monkeypatch):
    use_as_decal(terrain, image)
    bpy.context.view_layer.update()
    graph = bpy.context.evaluated_depsgraph_get()
    gather(terrain, graph, overrides=Overrides(effects=("color",)))
    monkeypatch.setattr("adaptive_terrain.operators.layers.decals._to_picture", None)
    paint(bpy.data.images.new("Other", 8, 4))
    bpy.context.view_layer.update()
    bpy.data.objects["Decal"].location.x = 3.0
    bpy.context.view_layer.update()
    gather(terrain, bpy.context.evaluated_depsgraph_get(), overrides=Overrides(effects=("color",)))
