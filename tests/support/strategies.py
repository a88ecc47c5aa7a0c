# SPDX-License-Identifier: GPL-3.0-or-later
"""Random scenarios for hypothesis: fields, views of all kinds, criteria, placements."""

import math
import os

from hypothesis import strategies as st
from scenarios import KINDS, VIEW_KINDS

# Pixels along a view's longer side at most. All are looked at, which takes most of the time.
MAX_PIXELS = 4000 if int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) >= 10_000 else 1000
SHAPES = [(2, 2), (3, 3), (5, 9), (9, 9), (17, 17), (17, 33), (33, 17), (9, 25), (33, 33)]


def magnitudes(low: float, high: float):
    """Return numbers from 10**low to 10**high, spread evenly over the decades."""
    return st.floats(low, high).map(lambda power: round(10**power, 12))


def fields(kinds=KINDS, shapes=SHAPES, interpolations=("bilinear", "bilinear", "bicubic")):
    """`field` of a scenario."""
    return st.fixed_dictionaries(
        {
            "kind": st.sampled_from(kinds),
            "shape": st.sampled_from(shapes).map(list),
            "seed": st.integers(0, 1000),
            "relief": magnitudes(-2, 4),
            "base": st.sampled_from([0.0, 0.0, -500.0, 8000.0]),
            "steps": st.sampled_from([[10.0, 10.0], [1.0, 1.0], [30.0, 20.0], [0.5, 3.0]]),
            "interpolation": st.sampled_from(interpolations),
        },
        optional={"rounded_to": magnitudes(-3, 2)},
    )


def views(kinds=VIEW_KINDS):
    """Return one view of a scenario from a random place in and around the terrain."""
    share = st.floats(-2, 2).map(lambda value: round(value, 6))
    # What measures errors looks at each pixel: one side is spread over the decades, and errors come as near to bounds.
    sides = st.tuples(st.integers(1, MAX_PIXELS), magnitudes(0, math.log10(MAX_PIXELS)).map(int))
    return st.fixed_dictionaries(
        {
            "kind": st.sampled_from(kinds),
            "eye": st.tuples(share, share, st.floats(-3, 6).map(lambda value: round(value, 6))).map(list),
            "look": st.tuples(share, share, share).filter(lambda v: sum(map(abs, v)) > 0.01).map(list),
            "on": st.one_of(st.none(), st.none(), st.tuples(st.floats(0, 1), st.floats(0, 1)).map(list)),
            "fov_deg": st.sampled_from([1.0, 20.0, 50.0, 90.0, 150.0, 175.0]),
            "resolution": sides.flatmap(st.permutations),
            "ortho": magnitudes(-2, 1),
            "clip": st.sampled_from([[0.1, 1e6], [1.0, 1e4], [1e-3, 1e8], [1e5, 0.1]]),
            "roll_deg": st.sampled_from([0.0, 90.0, 33.0, 180.0]),
        }
    )


def criteria(meshlets=(0, 0, 1, 2)):
    """`criterion` of a scenario: an error in pixels, and sometimes others, a depth and a budget."""
    return st.fixed_dictionaries(
        {
            "error_px": magnitudes(-1, 2),
            "max_triangles": st.integers(0, 4000),
            "meshlet": st.sampled_from(meshlets),
            "off_screen_factor": st.sampled_from([1.0, 4.0, 16.0, 1e6]),
            "guard_deg": st.sampled_from([0.0, 5.0, 30.0]),
        },
        optional={
            "error_m": magnitudes(-2, 3),
            "edge_px": magnitudes(0, 3),
            "area_px": magnitudes(0, 4),
            "max_depth": st.integers(1, 20),
        },
    )


PLACEMENTS = [
    None,
    None,
    [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],  # mirrored
    [1, 1.5, 0.7, 10, 0, 1, 0, -20, 0, 0, 1, 5, 0, 0, 0, 1],  # sheared
    [0.3, 0, 0, 0, 0, 4, 0, 0, 0, 0, 10, 0, 0, 0, 0, 1],  # stretched
]


def scenarios(**parts):
    """Whole scenarios; `parts` replaces strategies by name."""
    usual = {
        "field": fields(),
        "views": st.lists(views(), min_size=1, max_size=2),
        "criterion": criteria(),
        "placement": st.sampled_from(PLACEMENTS),
        "scale": st.sampled_from([1.0, 1.0, 1.0, -2.0, 0.1, 30.0]),
    }
    return st.fixed_dictionaries(usual | parts)
