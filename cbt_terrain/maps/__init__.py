# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps: effects baked into images, so that shading does not depend on how many triangles there are.

The ground is cut into tiles (`tiling.py`), each as fine as what looks at it needs (`sizing.py`); a texel is a place at
the scale of its size, so every effect of a place can be baked (`bake.py`), is coded in 8 or 16 bits or as floats
(`coding.py`) and written as PNG or OpenEXR (`png.py`, `exr.py`). `folder.py` says what a folder of maps holds.
"""
