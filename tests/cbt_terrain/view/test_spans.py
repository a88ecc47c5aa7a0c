# SPDX-License-Identifier: GPL-3.0-or-later
"""Spans of a panorama: the angle by which an error of height moves a point, by triangles around the eye."""

import math

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.view.spans import as_seen, whole_of, widening
from adaptive_terrain.cbt_terrain.view.view import PANORAMIC, View

VIEW = View.look((0, 0, 0), (1, 0, 0), kind=PANORAMIC, fov_deg=360)


@pytest.mark.parametrize("smallest", [1.0, 0.9, 0.5, 1 / 16])
def test_a_panorama_bounds_the_angle_of_every_error(smallest):
    rng = np.random.default_rng(7)
    whole = whole_of(VIEW, np.eye(4), smallest)
    slants = np.sin(np.append(np.linspace(0, math.pi / 2, 2001), math.asin(smallest)))
    for spans in 10 ** rng.uniform(-3, 1, 200):
        parts = spans / np.maximum(slants, smallest)  # errors over the distance
        angles = np.arctan2(parts * slants, 1 - parts * np.sqrt(1 - slants * slants))
        bound = as_seen(VIEW, whole, VIEW.pixels_per_unit * spans) / VIEW.pixels_per_unit
        assert angles.max() * (1 - 1e-10) <= bound
        assert bound < angles.max() * 1.01 or spans > smallest


@pytest.mark.parametrize("smallest", [1.0, 0.9, 0.5, 1 / 16])
def test_a_panorama_requests_just_what_keeps_its_error(smallest):
    whole = whole_of(VIEW, np.eye(4), smallest)
    for asked in VIEW.pixels_per_unit * np.linspace(1e-4, 1.5, 300):
        found = as_seen(VIEW, whole, asked / widening(VIEW, whole, asked))
        assert asked * (1 - 1e-6) < found <= asked
