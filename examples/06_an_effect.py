# SPDX-License-Identifier: GPL-3.0-or-later
"""A custom effect: `.venv/bin/python examples/06_an_effect.py [FOLDER]`."""

# A complete effect consists of a function over arrays, a declaration and an example that tests it. Its values become an
# attribute of a mesh. The normals that it reads are computed for it; nothing else is computed.

import math
import sys
from pathlib import Path

import numpy as np
from adaptive_terrain import Criterion, ImportSettings, Terrain, import_source, open_store, register_attribute
from adaptive_terrain.cbt_terrain.attributes.attribute import AttributeDeclaration, AttributeRequest, Parameter
from adaptive_terrain.cbt_terrain.attributes.evaluate import EffectRequest, evaluate
from adaptive_terrain.cbt_terrain.attributes.examples import evaluate_on
from adaptive_terrain.cbt_terrain.attributes.plan import plan
from adaptive_terrain.cbt_terrain.history.frame_history import FrameHistory


def make(places, wanted, read):
    """Compute the cosine between the ground's normal and the sun at noon."""
    elevation = math.radians(wanted["noon_sun"]["elevation"])
    towards = np.array([0.0, -math.cos(elevation), math.sin(elevation)], np.float32)
    return {"noon_sun": np.maximum((read["detail_normal"] * towards).sum(1), 0.0)}


def example(evaluate):
    """Test that a slope of 45 degrees to the south faces a sun at 45 degrees."""
    north = np.arange(17, dtype=np.float32)[:, None] * np.ones(17, np.float32)
    assert abs(evaluate("noon_sun", north, step=1.0) - 1.0).max() < 1e-6


NOON_SUN = AttributeDeclaration(
    name="noon_sun",
    about="Cosine between the ground and the sun at noon: 1 faces the sun, 0 faces away",
    unit="",
    make=make,
    example=example,
    reads=("detail_normal",),
    parameters=(Parameter("elevation", 45.0, 0.0, 90.0, "degrees", "of the sun above the horizon"),),
    cost_ns=20,
    source="Lambert 1760",
)
register_attribute(NOON_SUN)

example(evaluate_on)
folder = Path(sys.argv[1] if len(sys.argv) > 1 else "example")
import_source(ImportSettings("island", size=513), folder / "island.store")
field = open_store(folder / "island.store")
surface = Terrain(field).update(Criterion(error_m=2.0, error_px=0), []).surface
planned = plan([AttributeRequest("noon_sun", ("example 6",), parameters=(("elevation", 30.0),))])
result = evaluate(field, EffectRequest(planned, surface), FrameHistory())
noon = result.attributes["noon_sun"].array
print(f"noon_sun of {len(noon):,} vertices: {noon.min():.2f} to {noon.max():.2f}")
print(f"computed: {', '.join(result.ran)}; skipped: {len(planned.skipped)}")
