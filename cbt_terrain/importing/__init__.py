# SPDX-License-Identifier: GPL-3.0-or-later
"""Import of height maps into stores: lists of files, checks of heights, drafts, and processes for tiles."""
