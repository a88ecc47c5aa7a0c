# SPDX-License-Identifier: GPL-3.0-or-later
"""Flow: the drainage area of a point, from one result for the whole raster."""

from collections.abc import Mapping
from functools import partial

import numpy as np

from ..field.derived_arrays import samples_by_level, scratch_array
from ..field.heightfield import HeightField, HeightRaster
from ..field.lattice import fit
from ..run import launch
from ..run.buffers import flat, shared
from .attribute import AttributeDeclaration, Evaluate, SamplePoints, Wanted
from .pyramid import level_of, level_with, missing_of_level, scaled_pyramid
from .whole import whole

VERSION = 1
# A larger raster is routed at a coarser level, which bounds memory and time.
MAX_SAMPLES = 4097 * 4097


def routed_level(field: HeightField) -> int:
    """Return the level of the height pyramid where water is routed: 0 except for rasters of more than 4097 x 4097."""
    return level_with(field.lattice, MAX_SAMPLES)


def logarithms(field: HeightField, vertical_scale: float, threads: int) -> HeightRaster:
    """Return natural logarithms of drainage areas in m^2 at the samples of `routed_level`, as a cached raster.

    Its south-western sample is the field's. It may extend further, so its middle, the origin of its space, may differ.
    """
    from ...kernels import wp
    from ...kernels.effects import catchment
    from .routing import route

    level = routed_level(field)
    (rows, columns), lattice = samples_by_level(field.lattice)[level], field.lattice
    # Slopes are only compared with each other, so that only the sign of their scale matters.
    sign = float(np.sign(vertical_scale))
    steps = lattice.step_x * 2**level, lattice.step_y * 2**level
    allocate = partial(scratch_array, field.raster)

    def make() -> np.ndarray:
        """Compute the logarithms, float32 [rows, columns], where none are cached."""
        heights = level_of(field.raster, level, threads)
        if sign != 1.0:  # a negative scale turns the ground upside down, and 0 makes it level
            heights = np.multiply(heights, np.float32(sign), out=allocate(heights.shape, np.float32))
        holes = missing_of_level(field.raster, level)
        drainage = route(heights, *steps, holes, threads, allocate=allocate)
        filled = drainage.filled()  # the ground, with lakes up to their outlets
        area = drainage.areas(filled)
        drainage.level_lakes(filled, area)  # samples of a lake get the area of its outlet
        del heights, drainage, filled  # read by nothing below
        out = allocate((rows, columns), np.float32)
        cell_m2 = steps[0] * steps[1]  # `area` counts samples
        inputs = [cell_m2, flat(area, wp.float64), flat(out, wp.float32)]
        launch.spread(catchment.take_logarithms, out.size, inputs, step="routing", threads=threads)
        return out

    # From memory or the store, else from `make`. Water flows the same way under all scales of one sign.
    return whole("flow", VERSION, parameters=(sign,), field=field, lattice=fit(columns, rows, *steps), make=make)


def make(points: SamplePoints, wanted: Wanted, read: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Compute the attribute flow at points: the drainage area in m^2, from one result for the whole raster.

    The logarithms of areas are interpolated. wanted, read: unused, since flow has no parameters and reads no attribute.
    Returns {"flow": float32 [n]}.
    """
    from ...kernels import wp
    from ...kernels.effects import flow as kernels

    field, out = points.field, np.empty(len(points), np.float32)
    log_areas = scaled_pyramid(
        logarithms(field, points.vertical_scale, points.threads),
        vertical_scale=1.0,
        vertical_offset=0.0,
        threads=points.threads,
    )
    # The raster of areas may extend further, so its own origin differs; its south-western corner is the field's.
    log_areas.west, log_areas.south, _, _ = field.lattice.rectangle()
    inputs = [log_areas, float(routed_level(field)), shared(points.positions, wp.vec3f), flat(points.level, wp.float32)]
    launch.spread(
        kernels.flow_at, len(points), [*inputs, flat(out, wp.float32)], step="flow", threads=points.threads, cost=3
    )
    return {"flow": out}


def example(evaluate: Evaluate) -> None:
    """Assert that a point of a roof, whose rows drain separately, has the area up to the ridge.

    The ridge gives half to each side, and water leaves at the border.

    evaluate: returns an attribute at the samples of a raster, without the two outermost on each side.
    """
    x = np.arange(17, dtype=np.float32)
    flow = evaluate("flow", np.tile(-abs(x - 8.0), (9, 1)), step=10.0).reshape(5, 13)
    samples = abs(x[2:-2] - 8.0) + 0.5
    samples[6] = 1.0  # the ridge
    # In the middle row, since near the other two borders less enters over the diagonals. A sample has 100 m2.
    assert abs(flow[2, 5:8] - 100.0 * samples[5:8]).max() < 1e-2


FLOW = AttributeDeclaration(
    name="flow",
    about="Area of the land whose water runs through a point; in a lake, through its outlet",
    unit="m2",
    make=make,
    kernels=("effects.catchment", "effects.flow", "effects.pyramid", "effects.routing"),
    example=example,
    halo="the whole raster; of more than 4097 x 4097 samples its finest level that has no more",
    cost_ns=25,
    source="Multiple flow directions, Quinn et al. 1991; depressions, Cordonnier et al. 2019",
    version=VERSION,
)
