# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo: the built-in island from import to pictures."""
