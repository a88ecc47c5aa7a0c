# SPDX-License-Identifier: GPL-3.0-or-later
"""The objects of Blender's start-up file, as long as they are unchanged."""

from itertools import product

import numpy as np

CUBE, LAMP, CAMERA, WORLD = "Cube", "Light", "Camera", "World"
LOCATIONS = {CUBE: (0.0, 0.0, 0.0), LAMP: (4.076245, 1.005454, 5.903862), CAMERA: (7.358891, -6.925791, 4.958309)}
LAMP_WATTS, WORLD_GREY = 1000.0, 0.050876
CAMERA_TURN, CAMERA_LENS = (1.109319, 0.0, 0.814928), {"type": "PERSP", "lens": 50.0, "shift_x": 0.0, "shift_y": 0.0}
VIEW_TURN = 0.712376, 0.441062, 0.287358, 0.464123  # of the viewport
CORNERS = sorted(product((-1.0, 1.0), repeat=3))


def untouched(scene) -> list:
    """Return the default cube and the default lamp of a scene as far as they are unchanged."""
    found = []
    for name, is_default in ((CUBE, _is_cube), (LAMP, _is_lamp)):
        obj = scene.objects.get(name)
        if obj is not None and _stands_alone(obj) and is_default(obj):
            found.append(obj)
    return found


def is_default_camera(camera) -> bool:
    """Return whether a camera is that of the start-up file, where it stands, looks and with its lens."""
    if camera is None or camera.name != CAMERA or camera.type != "CAMERA":
        return False
    if not np.allclose(camera.rotation_euler, CAMERA_TURN, atol=1e-4) or camera.data.animation_data is not None:
        return False
    return _stands_alone(camera) and all(getattr(camera.data, name) == value for name, value in CAMERA_LENS.items())


def is_default_view(region_3d) -> bool:
    """Return whether a viewport looks in the direction of the start-up file."""
    return region_3d.view_perspective == "PERSP" and np.allclose(region_3d.view_rotation, VIEW_TURN, atol=1e-4)


def is_default_world(world) -> bool:
    """Return whether a world is None or the grey one of the start-up file, by its name, nodes and color."""
    if world is None:
        return True
    tree = world.node_tree
    if world.name != WORLD or tree is None or {node.type for node in tree.nodes} - {"BACKGROUND", "OUTPUT_WORLD"}:
        return False
    background = next((node for node in tree.nodes if node.type == "BACKGROUND"), None)
    if background is None or background.inputs["Strength"].default_value != 1.0:
        return False
    return np.allclose(background.inputs["Color"].default_value[:3], WORLD_GREY, atol=1e-4)


def _stands_alone(obj) -> bool:
    """Return whether an object has its first location, a scale of 1, and nothing attached to it.

    Attached are parents, children, modifiers, constraints and animation. Its name has to be one of LOCATIONS.
    """
    attached = obj.parent, *obj.children, *obj.modifiers, *obj.constraints, obj.animation_data
    is_unscaled = np.allclose(obj.scale, 1.0)
    return not any(attached) and is_unscaled and np.allclose(obj.location, LOCATIONS[obj.name], atol=1e-4)


def _is_cube(obj) -> bool:
    """Return whether an object is a cube of 2 metres that is not turned, by its vertices, and has an unshared mesh."""
    if obj.type != "MESH" or obj.data.users > 1 or len(obj.data.vertices) != len(CORNERS):
        return False
    corners = sorted(tuple(vertex.co) for vertex in obj.data.vertices)
    return not any(obj.rotation_euler) and not obj.data.shape_keys and np.allclose(corners, CORNERS)


def _is_lamp(obj) -> bool:
    """Return whether an object is a white point light of LAMP_WATTS without further nodes, and has unshared data."""
    if obj.type != "LIGHT" or obj.data.users > 1 or obj.data.type != "POINT" or obj.data.animation_data is not None:
        return False
    return obj.data.energy == LAMP_WATTS and np.allclose(obj.data.color, 1.0) and not _has_nodes(obj.data)


def _has_nodes(lamp) -> bool:
    """Return whether a lamp has nodes besides the two that Blender gives it."""
    return bool(lamp.node_tree) and len(lamp.node_tree.nodes) > 2
