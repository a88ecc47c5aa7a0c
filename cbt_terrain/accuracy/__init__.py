# SPDX-License-Identifier: GPL-3.0-or-later
"""The measured distance of a delivered mesh from the reference surface."""

from .interpolation import interpolation
from .measure import Measurement, look, measure, popping, shading_change, triangle_errors
from .mesh import Errors
from .screen import Sight

__all__ = [
    "Errors",
    "Measurement",
    "Sight",
    "interpolation",
    "look",
    "measure",
    "popping",
    "shading_change",
    "triangle_errors",
]
