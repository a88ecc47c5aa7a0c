# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors or levels as colours on the mesh, and their panel."""
