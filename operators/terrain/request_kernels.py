# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernels that a request needs in addition to those of every terrain."""

from types import ModuleType

from ...cbt_terrain.attributes.attribute import AttributeRequest
from ...cbt_terrain.attributes.layered_detail import LayeredDetail
from ...cbt_terrain.attributes.plan import plan
from ...cbt_terrain.attributes.splat import NAMES
from ...cbt_terrain.height_operators.prepare import kernels_of as kernels_of_stack
from ...cbt_terrain.run.warmup import modules_of
from .request import Request


def kernels_for(request: Request) -> list[ModuleType]:
    """Return the kernel modules that a request needs, so that they can be compiled ahead of the update.

    They are those of attributes and land effects, and of displacement, bicubic interpolation, geomorphing, scatters
    and horizon maps as far as the request uses them. Raises TerrainError for attributes that are not valid.
    """
    from ...cbt_terrain.attributes.evaluate import kernels_of
    from ...kernels import bicubic, detail, morph, scatter
    from ...kernels.refine import horizon_map

    attributes = list(request.effects.requests)
    # The weights of layers' displacement are splat attributes. One stands for all, which have the same kernels.
    if isinstance(request.ground, LayeredDetail):
        attributes.append(
            AttributeRequest(NAMES[0], readers=("detail",), parameters=(("layers", request.ground.layers),))
        )
    for item in request.scatters.items:
        attributes += [read for read, _ in item.scatter.reads()]
    found = kernels_of(plan(attributes)) + (kernels_of_stack(request.land.stack) if request.land is not None else [])
    # The horizon map tells which ground is hidden: there the mesh may be coarser, or scatters may have no points.
    needs_horizon = request.criterion.hidden_factor != 1.0 or any(item.culls for item in request.scatters.items)
    packages = (
        (detail, request.ground is not None),
        (bicubic, request.interpolation == "bicubic"),
        (morph, request.criterion.morph_until > 1),
        (scatter, bool(request.scatters.items)),
    )
    found += [module for package, is_used in packages if is_used for module in modules_of(package)]
    return [*found, horizon_map] if needs_horizon else found
