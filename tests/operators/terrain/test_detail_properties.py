# SPDX-License-Identifier: GPL-3.0-or-later
"""The saved properties of the level of detail: identifiers, defaults and ranges; and the criterion that they give."""

import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.morph import SMOOTH
from adaptive_terrain.operators.terrain.request import criterion_from

# Identifiers in files, which never change: default of the viewport, default of the render, lowest value.
SAVED = {
    "error_px": (2.0, 1.0, 0.0),
    "edge_px": (0.0, 0.0, 0.0),
    "area_px": (0.0, 0.0, 0.0),
    "error_m": (0.0, 0.0, 0.0),
    "guard_deg": (2.5, 2.5, 0.0),
    "off_screen_factor": (16.0, 16.0, 1.0),
    "hidden_factor": (1.0, 1.0, 1.0),
    "shading_floor": (0.5, 0.5, 0.0),
    "smooth_transitions": (False, True, None),
    "meshlet": (0, 0, 0),
    "limit_depth": (False, False, None),
    "max_depth": (20, 20, 1),
    "limit_triangles": (False, False, None),
    "max_triangles": (1_000_000, 1_000_000, 0),
    "limit_time": (False, False, None),
    "max_ms": (50.0, 50.0, pytest.approx(0.01)),
    "curve": ("", "", None),
    "no_curve": ("", "", None),
    "measured": ("", "", None),
}


@pytest.mark.parametrize("column", [0, 1], ids=["viewport", "render"])
def test_identifiers_defaults_and_ranges_of_files_stay(scene, add_terrain, column):
    settings = add_terrain().adaptive_terrain
    detail = (settings.viewport, settings.render)[column]
    saved = {p.identifier: p for p in detail.bl_rna.properties if not p.identifier.startswith(("ask_", "rna_", "name"))}
    assert {name: p.default for name, p in saved.items()} == {name: row[column] for name, row in SAVED.items()}
    assert {name: getattr(p, "hard_min", None) for name, p in saved.items()} == {n: row[2] for n, row in SAVED.items()}


def test_every_property_changes_the_criterion(scene, add_terrain):
    detail = add_terrain().adaptive_terrain.viewport
    detail.error_px = 2.0
    assert criterion_from(detail) == Criterion(error_px=2.0)
    detail.limit_depth = detail.limit_triangles = detail.smooth_transitions = True
    assert criterion_from(detail) == Criterion(2.0, max_depth=20, max_triangles=1_000_000, morph=SMOOTH)
    numbers = [3.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 0.25, 11, 12, 3]
    names = [name for name in Criterion.__dataclass_fields__ if name != "morph"]
    for name, value in zip(names, numbers, strict=True):
        setattr(detail, name, value)
    assert criterion_from(detail) == Criterion(*numbers, morph=SMOOTH)


def test_a_criterion_without_a_request_says_what_to_do(scene, add_terrain):
    detail = add_terrain().adaptive_terrain.viewport
    detail.error_px = 0.0
    with pytest.raises(TerrainError, match="Every criterion is 0: ask for"):
        criterion_from(detail)
