# SPDX-License-Identifier: GPL-3.0-or-later
"""Bounds in the panel, the command line and pages: rounded up, so that the shown number is a bound, too."""

import decimal
import math

from ...cbt_terrain.view.criterion import LARGEST

NO_BOUND = "none: may reach the eye"
# Update.limited in words.
LIMITS = {
    "max_triangles": "the triangle limit",
    "max_depth": "the depth limit",
    "precision": "float32 precision",
    "source": "source rounding",
}
LONG = 1e7  # below this, all digits before the point are shown


def bound_text(bound: float, unit: str, digits: int = 3) -> str:
    """Format as `0.998 px`, rounded up to at least `digits` significant digits; NO_BOUND if there is none.

    A bound of more digits, up to LONG, is shown with all digits before the point, as `12,345 px`.
    """
    if not bound < LARGEST:
        return NO_BOUND
    if 10.0 ** (digits - 1) <= bound < LONG:
        return f"{math.ceil(bound):,} {unit}"
    # `repr` gives the shortest digits, so that 0.1, whose float is slightly larger, stays 0.1
    shown = decimal.Context(prec=digits, rounding=decimal.ROUND_CEILING).create_decimal(repr(float(bound)))
    return f"{float(shown):.{digits}g} {unit}"


def limit_text(*limits: str) -> str:
    """Return values of `Update.limited` in words."""
    return " and ".join(LIMITS[name] for name in limits if name)
