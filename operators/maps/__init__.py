# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes baked into images: settings, request, job, images and the panel."""
