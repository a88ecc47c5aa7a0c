# SPDX-License-Identifier: GPL-3.0-or-later
"""Layers of height operators (height_operators/) as attributes; 0 for a terrain without them."""

from collections.abc import Callable, Mapping

import numpy as np

from ..field.heightfield import HeightField, HeightRaster
from ..run import launch
from ..run.buffers import flat, shared
from ..run.locks import cached
from .attribute import AttributeDeclaration, Evaluate, SamplePoints, Wanted
from .pyramid import PYRAMID, scaled_pyramid

# Name, unit, and one line of meaning.
KNOWN = (
    ("wear", "m", "Depth of rock that erosion has removed"),
    ("sediment", "m", "Depth of the material that rivers have deposited"),
    ("scree", "m", "Depth of the loose stones on the rock"),
    ("snow", "m", "Depth of snow"),
    ("slides", "m", "Depth of the snow that avalanches have brought; negative where they have taken it"),
    ("water_depth", "m", "Depth of the water of rivers, lakes and the sea"),
    ("water_speed", "m/s", "Speed of the water"),
    ("discharge", "m^3/s", "Water that passes a point; in a lake, the water that leaves it"),
)
NAMES = tuple(name for name, _, _ in KNOWN)


def make(points: SamplePoints, wanted: Wanted, read: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Interpolate the named layers of the terrain at points; 0 for one that it lacks.

    Layers are by-products of height operators, as the depth of water. wanted: parameters by name, which are empty.
    read: unused. Returns float32 [n] by name.
    """
    from ...kernels import wp
    from ...kernels.effects import flow as kernels

    values = {}
    for name in wanted:
        values[name] = out = np.zeros(len(points), np.float32)
        if name in points.field.layers:
            raster = _as_raster(points.field, name)
            pyramid = scaled_pyramid(
                raster, vertical_scale=1.0, vertical_offset=0.0, threads=points.threads, name=f"{PYRAMID}_{name}"
            )
            arrays = shared(points.positions, wp.vec3f), flat(points.level, wp.float32)
            inputs = [pyramid, *arrays, flat(out, wp.float32)]
            launch.spread(kernels.layer_at, len(points), inputs, step="layers", threads=points.threads, cost=3)
    return values


def why_missing(field: HeightField, name: str) -> str:
    """Return why a layer is 0 everywhere on a terrain, "" if it is not or if `name` is no layer's attribute."""
    if name not in NAMES or name in field.layers:
        return ""
    return f"the terrain has no layer {name}: no effect of its stack leaves one"


def _as_raster(field: HeightField, name: str) -> HeightRaster:
    """Return a layer as a raster of heights, so that a pyramid of coarser levels can be made of it.

    Path and digest are those of the field: its store caches the pyramids of large layers, too.
    """
    return cached(
        field.cache.results,
        ("layer", name),
        lambda: HeightRaster(field.layers[name], field.lattice, field.raster.digest, path=field.path),
    )


def _example(name: str) -> Callable[[Evaluate], None]:
    """Return the example of a layer written by a height operator."""

    def example(evaluate: Evaluate) -> None:
        """Assert that a terrain without height operators has 0."""
        assert (evaluate(name, np.zeros((9, 9)), step=10.0) == 0.0).all()

    return example


LAYERS = tuple(
    AttributeDeclaration(
        name=name,
        about=f"{about}. Land effects make it; 0 without them",
        unit=unit,
        make=make,
        kernels=("effects.flow", "effects.pyramid"),
        example=_example(name),
        halo="a sample of the level",
        cost_ns=25,
        source="The layer of the store, bilinear within a level of its pyramid and between levels",
    )
    for name, unit, about in KNOWN
)
