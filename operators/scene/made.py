# SPDX-License-Identifier: GPL-3.0-or-later
"""What Set Up Scene has made for a scene. The scene itself points to it, so that a copy of the user's is none of it."""

MADE = "adaptive_terrain_scene"  # property of a scene: its items by their role
SUN, CAMERA, SKY = "sun", "camera", "sky"


def was_set_up(scene) -> bool:
    """Return whether Set Up Scene has made anything for the scene before."""
    return MADE in scene


def find_made(scene, role: str):
    """Return the sun, camera or sky that was made for the scene; None if there is none, or it was deleted."""
    made = scene.get(MADE)
    return made.get(role) if hasattr(made, "keys") else None


def keep_made(scene, role: str, item) -> None:
    """Remember an item that was made for the scene, or with None forget it."""
    if not hasattr(scene.get(MADE), "keys"):
        scene[MADE] = {}
    scene[MADE][role] = item
