# SPDX-License-Identifier: GPL-3.0-or-later
"""Tools that rows share: timing, scenes, baselines, child processes."""
