# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows of a sweep whose figures are known, for what reports make of them."""

from adaptive_terrain.cbt_terrain.accuracy.measure import Measurement
from adaptive_terrain.cbt_terrain.accuracy.mesh import Errors
from adaptive_terrain.cbt_terrain.accuracy.rows import Row
from adaptive_terrain.cbt_terrain.accuracy.sweep_settings import Setting


def known_rows() -> list[Row]:
    """Return rows where meshlets beat 1 px in time and the fit has the fewest triangles."""
    known = [  # asked, measured, triangles, ms
        (Setting("px", 4.0), 3.0, 100, 1.0),
        (Setting("px", 2.0), 1.5, 400, 2.0),
        (Setting("px", 1.0), 0.9, 1600, 5.0),
        (Setting("px", 1.0, meshlet=2), 0.5, 9000, 3.0),
        (Setting("px", 1.0, max_depth=9), 2.0, 500, 2.5),
        (Setting("m", 8.0), 7.0, 50, 1.0),
        (Setting("m", 8.0, fitted=True), 7.5, 20, 900.0),
    ]
    rows = []
    for setting, error, triangles, ms in known:
        errors = Errors(9, error, error / 2, error, error / 3, error / 3)
        on_screen = errors if setting.unit == "px" else None
        measured = Measurement(errors, error, 0.0, errors, errors, on_screen, on_screen, None)
        bound = max(setting.error, error)
        rows.append(Row(setting, bound, (), triangles, triangles, 1.0, 2.0, measured, ms={"total": ms}))
    return rows
