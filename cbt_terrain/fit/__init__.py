# SPDX-License-Identifier: GPL-3.0-or-later
"""Static meshes whose vertices leave the surface to save triangles."""
