# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials in a Blender of another language, which translates the names of new nodes."""

import pytest
from adaptive_terrain.operators.bridge.demand.trees import tree_of_new
from adaptive_terrain.operators.land import water_surface
from adaptive_terrain.operators.scatter import starter


def tree_of_german(block):
    tree = tree_of_new(block)
    for node in tree.nodes:
        node.name = {"Principled BSDF": "Prinzipielle BSDF", "Background": "Hintergrund"}.get(node.name, node.name)
    return tree


@pytest.mark.parametrize(
    ("module", "make"),
    [
        (water_surface, water_surface.new_water_material),
        (starter, lambda: starter._material("Bark")),
    ],
)
def test_materials_are_made_in_other_languages(empty, monkeypatch, module, make):
    monkeypatch.setattr(module, "tree_of_new", tree_of_german)
    nodes = make().node_tree.nodes
    assert nodes["Prinzipielle BSDF"].inputs["Base Color"].is_linked
