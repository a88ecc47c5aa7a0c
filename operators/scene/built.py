# SPDX-License-Identifier: GPL-3.0-or-later
"""What Set Up Scene has made for a scene. The scene itself points to it, so that a copy of the user's is none of it."""

BUILT = "adaptive_terrain_scene"  # property of a scene: its items by their role
SUN, CAMERA, SKY = "sun", "camera", "sky"


def was_set_up(scene) -> bool:
    """Return whether Set Up Scene has made anything for the scene before."""
    return BUILT in scene


def find_built(scene, role: str):
    """Return the sun, camera or sky that was made for the scene; None if there is none, or it was deleted."""
    items = scene.get(BUILT)
    return items.get(role) if hasattr(items, "keys") else None


def remember_built(scene, role: str, item) -> None:
    """Remember an item that was made for the scene, or with None forget it."""
    if not hasattr(scene.get(BUILT), "keys"):
        scene[BUILT] = {}
    scene[BUILT][role] = item
