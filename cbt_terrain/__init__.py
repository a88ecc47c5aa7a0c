# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine: numpy and kernels. It never imports bpy."""
