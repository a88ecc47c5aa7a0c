# SPDX-License-Identifier: GPL-3.0-or-later
"""The bounds that a mesh is reported with. Panels and files read them, so this module imports no kernels."""

from dataclasses import dataclass, fields

from .terms import Terms


@dataclass(frozen=True, kw_only=True)
class ReportedBounds:
    """The bounds of a mesh. A bound is None if the criterion does not limit it.

    Attributes:
        bound_px: no visible point of the reference surface is further than this from the mesh's point below it, in
            pixels (0: nothing is in view; 1e30: the mesh may reach the eye). It includes the rounding of float32
            positions and of the source, so it also holds for the heights before that rounding.
        bound_m: the same in metres of height, everywhere.
        bound_edge_px, bound_area_px: longest edge, largest triangle, also of float32 corners.
        terms_px, terms_m: terms of `bound_px` and `bound_m`.
        relaxed: factor by which a triangle limit coarsened the criterion.
        limited: cause of a bound above the criterion, one of REASONS in contract.py, or "". "precision" is the rounding
            of float32, "source" that of the source.
    """

    bound_px: float | None = None
    bound_m: float | None = None
    bound_edge_px: float | None = None
    bound_area_px: float | None = None
    terms_px: Terms | None = None
    terms_m: Terms | None = None
    relaxed: float = 1.0
    limited: str = ""

    @property
    def bounds(self) -> "ReportedBounds":
        """Return the bounds alone, without the other fields that a subclass, as an update's result, adds."""
        return ReportedBounds(**{item.name: getattr(self, item.name) for item in fields(ReportedBounds)})
