# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects that are functions of the ground's height and its derivatives at a place: one kernel makes all that are
wanted, because it takes the derivatives once."""

from collections.abc import Mapping

import numpy as np

from .effect import Places, Wanted


def make(places: Places, wanted: Wanted, read: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """See Make in effect.py."""
    field = places.field
    lattice = field.lattice
    west, south, _, _ = lattice.rectangle()
    samples = field.heights() * places.vertical_scale
    north, east = np.gradient(samples, lattice.step_y, lattice.step_x)
    i = np.clip(np.rint((places.positions[:, 0] - west) / lattice.step_x).astype(int), 0, lattice.width - 1)
    j = np.clip(np.rint((places.positions[:, 1] - south) / lattice.step_y).astype(int), 0, lattice.height - 1)
    return {"slope": np.arctan(np.hypot(east[j, i], north[j, i])).astype(np.float32)}
