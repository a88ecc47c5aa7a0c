# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels of the tab Terrain, and the text of the status bar."""
