# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps: attributes baked into images, so that shading does not depend on the triangles.

The ground is divided into tiles (`tiling.py`) with the resolution that views need (`sizing.py`). A texel is a point at
the scale of its size, so that every attribute can be baked (`bake.py`). Values are coded in 8 or 16 bits or as floats
(`coding.py`) and written as PNG or OpenEXR (`png.py`, `exr.py`). `folder.py` describes a folder of maps.
"""
