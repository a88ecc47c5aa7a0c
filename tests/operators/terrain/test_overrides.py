# SPDX-License-Identifier: GPL-3.0-or-later
"""The digest of overrides, which tells whether a frame of an earlier version can be resumed."""

from adaptive_terrain.cbt_terrain.field.detail import Detail
from adaptive_terrain.operators.terrain.overrides import NO_OVERRIDES, Overrides

KEYS = "error_px max_triangles meshlet shading_floor smooth_transitions interpolation effects ground".split()


def test_digests_of_earlier_versions_stay_valid():
    assert NO_OVERRIDES.to_json() == dict.fromkeys(KEYS)
    given = Overrides({"error_px": 2.0, "meshlet": 1, "morph": 1.5}, "bicubic", ("slope",), Detail(2.0, 60.0))
    ground = {"amplitude": 2.0, "wavelength": 60.0, "roughness": 0.5, "seed": 0}
    before = {"error_px": 2.0, "meshlet": 1, "smooth_transitions": True, "interpolation": "bicubic", "ground": ground}
    assert given.to_json() == {**dict.fromkeys(KEYS), **before, "effects": ("slope",)}
    assert Overrides({"morph": 1.0, "edge_px": 9.0}).to_json() == {
        **dict.fromkeys(KEYS), "smooth_transitions": False, "edge_px": 9.0
    }  # fmt: skip
