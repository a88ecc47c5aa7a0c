# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows of the benchmark, one file a topic; every function measures anew on each call."""
