# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a delivered mesh is from the reference surface, measured."""

from .interpolation import interpolation
from .measure import Errors, Measurement, Sight, look, measure, popping, shading_change, triangle_errors

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
