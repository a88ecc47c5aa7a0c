# SPDX-License-Identifier: GPL-3.0-or-later
"""The group Terrain Layers reads only its declared inputs, keeps its links, and has the layers' colours."""

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes.tiling import MARGIN
from adaptive_terrain.operators.layers.material import SEAM, LayerSources, build_group, give_terrain_material
from demand_trees import new_object
from mathutils import Matrix
from rendered_pictures import rendered

LAYERS = [(f"Layer {i}", (0.05 * i, 0.3, 1.0 - 0.05 * i)) for i in range(12)]


@pytest.fixture
def ground(empty):
    """Add a plane of one square in front of a camera; the world is black but for one light."""
    obj = new_object("Ground", [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
    obj.data.uv_layers.new(name="UVMap")
    return obj


def attributes_read(tree) -> set[str]:
    return {node.attribute_name for node in tree.nodes if node.type == "ATTRIBUTE"}


def group_of(obj):
    return next(node for node in obj.data.materials[0].node_tree.nodes if node.type == "GROUP")


@pytest.mark.parametrize("count", [0, 1, 4, 5, 12])
def test_the_group_reads_what_it_says(ground, count):
    for light in ((), ("sky",), ("sky", "sun")):
        sources = LayerSources(LAYERS[:count], light=light)
        give_terrain_material(ground, sources)
        assert attributes_read(group_of(ground).node_tree) == {f"splat_{k // 4 + 1}" for k in range(count)} | {*light}
    assert len(bpy.data.node_groups) == len(bpy.data.materials) == 1


def test_a_map_takes_the_place_of_the_attribute(ground):
    baked = bpy.data.images.new("map", 4, 4, alpha=True)
    sources = LayerSources(LAYERS[:5], ("sky",), {"splat_2": baked, "detail_normal": baked})
    give_terrain_material(ground, sources)
    group = group_of(ground)
    assert attributes_read(group.node_tree) == {"splat_1", "sky"}
    assert sum(node.type == "TEX_IMAGE" for node in group.node_tree.nodes) == 2
    [link] = group.outputs["Normal"].links
    assert link.to_node.type == "BSDF_PRINCIPLED"
    give_terrain_material(ground, LayerSources(LAYERS[:5], ("sky",)))
    assert attributes_read(group_of(ground).node_tree) == {"splat_1", "splat_2", "sky"}
    assert "Normal" not in group_of(ground).outputs


def test_links_and_settings_stay_when_it_is_built_again(ground):
    give_terrain_material(ground, LayerSources(LAYERS[:3]))
    tree, group = ground.data.materials[0].node_tree, group_of(ground)
    checker = tree.nodes.new("ShaderNodeTexChecker")
    tree.links.new(checker.outputs["Color"], group.inputs["Layer 1"])
    group.inputs["Variation"].default_value = 0.25
    give_terrain_material(ground, LayerSources(LAYERS[:6], light=("sky",)))
    assert [link.from_node for link in group.inputs["Layer 1"].links] == [checker]
    assert group.inputs["Variation"].default_value == 0.25 and group.inputs["Occlusion"].default_value > 0
    give_terrain_material(ground, LayerSources(LAYERS[:1]))
    assert [item.name for item in group.inputs] == ["Layer 0", "Variation", "Variation Size"]


def test_layers_may_have_any_names(ground):
    names = ["X", "Variation", "", "Color", "X", "Occlusion", "Layer"]
    for _ in range(2):
        give_terrain_material(
            ground, LayerSources([(name, (0.1 * number,) * 3) for number, name in enumerate(names)], light=("sky",))
        )
        sockets = group_of(ground).inputs
        wanted = ["X", "Variation 2", "Layer", "Color", "X 2", "Occlusion 2", "Layer 2"]
        assert [socket.name for socket in sockets][:7] == wanted
        assert [round(sockets[name].default_value[0], 3) for name in wanted] == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6]


def test_a_group_that_a_user_has_rearranged_is_built_again(ground):
    give_terrain_material(ground, LayerSources(LAYERS[:2]))
    interface = group_of(ground).node_tree.interface
    panel = interface.new_panel("Mine")
    interface.move_to_parent(next(item for item in interface.items_tree if item.name == "Layer 1"), panel, 0)
    give_terrain_material(ground, LayerSources(LAYERS[:3]))
    assert [i.name for i in group_of(ground).inputs] == ["Layer 0", "Layer 1", "Layer 2", "Variation", "Variation Size"]


def test_a_material_that_another_terrain_wears_stays_as_it_is(ground):
    worn = give_terrain_material(ground, LayerSources(LAYERS[:2]))
    other = bpy.data.objects.new("Other", ground.data.copy())
    assert give_terrain_material(other, LayerSources(LAYERS[:5])) != worn
    assert attributes_read(group_of(ground).node_tree) == {"splat_1"} and ground.data.materials[0] == worn
    assert attributes_read(group_of(other).node_tree) == {"splat_1", "splat_2"}
    assert give_terrain_material(other, LayerSources(LAYERS[:6])) == other.data.materials[0]
    assert len(bpy.data.materials) == 2


def test_a_slot_of_the_object_gets_the_material(ground):
    ground.data.materials.append(None)
    ground.material_slots[0].link = "OBJECT"
    ground.material_slots[0].material = bpy.data.materials.new("Mine")
    made = give_terrain_material(ground, LayerSources(LAYERS[:2]))
    assert ground.material_slots[0].material == made == give_terrain_material(ground, LayerSources(LAYERS[:2]))


def picture_of(ground, weights, size: int = 8, height: float = 2.0, across: float = 1.0, **settings) -> np.ndarray:
    """Return linear colours that Cycles gives the group alone, as emission, in the inner quarter of the square.

    size: pixels along a side. height: of the camera above the square, metres. across: width of the picture, metres.
    """
    tree, group = ground.data.materials[0].node_tree, group_of(ground)
    for name, value in settings.items():
        group.inputs[name].default_value = value
    output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
    emission = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(group.outputs["Color"], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], output.inputs["Surface"])
    for name, four in weights.items():
        found = ground.data.attributes.get(name) or ground.data.attributes.new(
            name, "FLOAT_COLOR" if np.size(four) == 4 else "FLOAT", "POINT"
        )
        found.data.foreach_set("color" if np.size(four) == 4 else "value", np.tile(four, 4).astype(np.float32))
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location, camera.data.type, camera.data.ortho_scale = (0, 0, height), "ORTHO", across
    camera.data.clip_end = 1e4
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.resolution_x = scene.render.resolution_y = size
    return rendered(bpy.app.tempdir + "terrain_colour.exr")[..., :3]


def colour_of(ground, weights, **settings) -> np.ndarray:
    """Return the linear colour that Cycles gives the group alone in the middle of the square."""
    return picture_of(ground, weights, **settings)[4, 4]


@pytest.mark.parametrize("layer", [0, 3, 6])
def test_one_layer_alone_has_its_colour(ground, layer):
    give_terrain_material(ground, LayerSources(LAYERS[:7]))
    weights = np.zeros(8)
    weights[layer] = 1.0
    seen = colour_of(ground, {"splat_1": weights[:4], "splat_2": weights[4:]}, Variation=0.0)
    np.testing.assert_allclose(seen, LAYERS[layer][1], atol=2e-3)


def test_layers_mix_their_colours_and_little_sky_is_dark(ground):
    give_terrain_material(ground, LayerSources(LAYERS[:4], light=("sky",)))
    given = {"splat_1": (0.5, 0.0, 0.0, 0.5), "sky": 1.0}
    light = colour_of(ground, given, Variation=0.0, Occlusion=0.5)
    assert LAYERS[0][1][0] < light[0] < LAYERS[3][1][0] and abs(light[1] - 0.3) < 2e-3
    dark = colour_of(ground, given | {"sky": 0.0}, Variation=0.0, Occlusion=0.5)
    np.testing.assert_allclose(dark, 0.5 * light, atol=2e-3)


def test_without_layers_there_is_one_plain_colour(ground):
    tree = bpy.data.node_groups.new("alone", "ShaderNodeTree")
    build_group(tree, LayerSources([]), 1.0)
    assert attributes_read(tree) == set() and "Variation" in tree.interface.items_tree


@pytest.mark.parametrize("height", [2.0, 6.0])
def test_tiled_maps_are_read_without_mipmaps_along_seams(ground, height):
    """Only an image with cubic interpolation has no mipmaps in EEVEE; here it is white, and the other one black.

    In the middle of the square four tiles of 1 m meet. `test_no_line_is_seen_between_tiles` renders with EEVEE.
    """

    def place(tree):
        position, scaled = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeVectorMath")
        scaled.operation, scaled.inputs["Scale"].default_value = "SCALE", 2.0
        tree.links.new(position.outputs["UV"], scaled.inputs[0])
        return scaled.outputs[0]

    image = bpy.data.images.new("map", 4, 4, tiled=True)
    give_terrain_material(ground, LayerSources([], maps={"color": image}, place=place, tile=1.0))
    tree = group_of(ground).node_tree
    images = [node for node in tree.nodes if node.type == "TEX_IMAGE"]
    assert [node.image for node in images] == [image] * 2 and len({node.interpolation for node in images}) == 2
    for node in images:
        white = tree.nodes.new("ShaderNodeRGB").outputs[0]
        white.default_value = (*[float(node.interpolation == "Cubic")] * 3, 1.0)
        for link in list(node.outputs["Color"].links):
            tree.links.new(white, link.to_socket)
    size = 128
    seen = picture_of(ground, {}, size, height, Variation=0.0)[..., 0]
    width = size * (SEAM * height + MARGIN)  # of the ground on either side of a seam, pixels
    from_seam = np.abs(np.arange(size) + 0.5 - size / 2)
    from_seam = np.minimum(from_seam[:, None], from_seam)
    assert (seen[from_seam < width - 1] == 1.0).all() and (seen[from_seam > width + 2] == 0.0).all()


GREEN, GREY, TURQUOISE = (0.085, 0.12, 0.035), (0.2, 0.19, 0.17), (0.06, 0.12, 0.1)


def contrast_of(ground, color, height: float) -> float:
    """Return the standard deviation of a layer's colour over 16 m of ground, divided by its mean.

    The broad variation is made much larger than the ground, so that only tufts remain. height: of the camera, metres.
    """
    ground.data.transform(Matrix.Diagonal((20.0, 20.0, 1.0, 1.0)))
    give_terrain_material(ground, LayerSources([("Ground", color)]))
    weights, settings = {"splat_1": (1.0, 0.0, 0.0, 0.0)}, {"Variation": 0.5, "Variation Size": 1e6}
    seen = picture_of(ground, weights, 64, height, across=16.0, **settings)[..., 1]
    return float(seen.std() / seen.mean())


@pytest.mark.parametrize(
    ("color", "height", "low", "high"),
    [(GREEN, 10.0, 0.1, 1.0), (GREEN, 1000.0, 0.0, 0.01), (GREY, 10.0, 0.0, 0.01), (TURQUOISE, 10.0, 0.0, 0.01)],
)
def test_only_grass_has_tufts_near_the_camera(ground, color, height, low, high):
    assert low <= contrast_of(ground, color, height) <= high


def test_ground_without_grass_has_no_tuft_nodes(ground):
    kinds = []
    for color in (GREEN, GREY):
        give_terrain_material(ground, LayerSources([("Ground", color)]))
        kinds.append([node.type for node in group_of(ground).node_tree.nodes].count("TEX_NOISE"))
    assert kinds == [3, 2]
