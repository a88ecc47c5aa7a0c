# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings that Blender keeps in its files: what each is called, what it may be, what its tooltip says."""
