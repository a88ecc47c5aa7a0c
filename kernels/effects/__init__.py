# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects: values of places on the surface, for vertices and for texels of maps alike."""
