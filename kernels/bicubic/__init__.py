# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of the bicubic surface; compiled when a terrain is first interpolated so."""
