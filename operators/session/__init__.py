# SPDX-License-Identifier: GPL-3.0-or-later
"""Terrains while Blender runs: what each mesh shows, live updates, frames of a shot and stale renders."""
