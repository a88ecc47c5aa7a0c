# SPDX-License-Identifier: GPL-3.0-or-later
"""UTM by an independent formula."""

import math

import numpy as np


def utm_to_degrees(x, y, central_meridian):
    """Return longitude and latitude (degrees, WGS 84) of UTM north: Krueger's series (Karney 2011)."""
    flattening = 1.0 / 298.257223563
    n = flattening / (2.0 - flattening)
    radius = 6378137.0 / (1.0 + n) * (1.0 + n**2 / 4.0 + n**4 / 64.0)
    xi, eta = y / (0.9996 * radius), (x - 500_000.0) / (0.9996 * radius)
    betas = [
        n / 2 - 2 * n**2 / 3 + 37 * n**3 / 96 - n**4 / 360,
        n**2 / 48 + n**3 / 15 - 437 * n**4 / 1440,
        17 * n**3 / 480 - 37 * n**4 / 840,
        4397 * n**4 / 161280,
    ]
    xi_, eta_ = np.array(xi), np.array(eta)
    for j, beta in enumerate(betas, start=1):
        xi_ = xi_ - beta * np.sin(2 * j * xi) * np.cosh(2 * j * eta)
        eta_ = eta_ - beta * np.cos(2 * j * xi) * np.sinh(2 * j * eta)
    conformal = np.arctanh(np.sin(xi_) / np.cosh(eta_))  # isometric latitude
    eccentricity = math.sqrt(flattening * (2.0 - flattening))
    latitude = np.arcsin(np.tanh(conformal))
    for _ in range(12):
        latitude = np.arcsin(np.tanh(conformal + eccentricity * np.arctanh(eccentricity * np.sin(latitude))))
    return central_meridian + np.degrees(np.arctan2(np.sinh(eta_), np.cos(xi_))), np.degrees(latitude)
