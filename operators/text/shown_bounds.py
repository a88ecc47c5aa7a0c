# SPDX-License-Identifier: GPL-3.0-or-later
"""Bounds as the panel, the command line and the pages show them: rounded up, so that what is shown holds too."""

import decimal
import math

from ...cbt_terrain.ask.criterion import LARGEST

NO_BOUND = "none: may reach the eye"
# Update.limited in words.
LIMITS = {
    "max_triangles": "the triangle limit",
    "max_depth": "the depth limit",
    "precision": "float32 precision",
    "source": "source rounding",
}
# Below this, all digits before the point are shown.
LONG = 1e7


def bound_text(bound: float, unit: str, digits: int = 3) -> str:
    """`0.998 px`: at least `digits` digits that count, never less than the bound; NO_BOUND where it says nothing."""
    if not bound < LARGEST:
        return NO_BOUND
    if 10.0 ** (digits - 1) <= bound < LONG:
        return f"{math.ceil(bound):,} {unit}"
    # From its shortest digits: 0.1, which is a little more as a float, stays 0.1.
    shown = decimal.Context(prec=digits, rounding=decimal.ROUND_CEILING).create_decimal(repr(float(bound)))
    return f"{float(shown):.{digits}g} {unit}"


def limit_text(limited: str) -> str:
    """Update.limited, or several with commas between, in words."""
    return " and ".join(LIMITS[name] for name in limited.split(", ") if name)
