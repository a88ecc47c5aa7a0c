# SPDX-License-Identifier: GPL-3.0-or-later
"""The effects that a terrain computes: those that its scene reads or that are pinned, without those switched off."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ...cbt_terrain.attributes.attribute import GEOMETRY, PICTURE, AttributeRequest
from ...cbt_terrain.attributes.catalogue import ATTRIBUTES
from ...cbt_terrain.attributes.layers import why_missing
from ...cbt_terrain.attributes.plan import AttributePlan
from ...cbt_terrain.attributes.splat import NAMES
from ...cbt_terrain.field.heightfield import HeightField
from ..bridge.demand import demand_cache
from ..bridge.demand.found import ACTIVE_COLOR, ALL, Demand, Reader
from ..layers.decals import decal_parameters
from ..layers.properties import color_parameters, empty_layers_note, layer_parameters
from .properties import GROUPS, OFF, PINNED, changed_numbers
from .sun_lamps import suns_over

if TYPE_CHECKING:
    from ...cbt_terrain.attributes.evaluate import Ran

PIN = Reader("a pin", PICTURE)


@dataclass(frozen=True)
class Effects:
    """The attributes to compute for a terrain.

    `requests`: of these attributes. `off`: names of those that are switched off, with the names of their would-be
    readers. `geometry_metres`: the scale of attributes from which geometry is made; 0 is that of the finest samples.
    """

    requests: tuple[AttributeRequest, ...] = ()
    off: tuple[tuple[str, tuple[str, ...]], ...] = ()
    geometry_metres: float = 0.0


@dataclass(frozen=True)
class EffectStatus:
    """State of an effect after the last update.

    `readers`: their names. `family`: PICTURE if only pixels show it, GEOMETRY if geometry is made from it. `skipped`:
    why it was not computed, or "". `ms`: time of its computation. `nbytes`: memory of its values. `computed`: number of
    new values. `note`: why values may be unexpected, or "".
    """

    readers: tuple[str, ...] = ()
    family: str = ""
    ms: float = 0.0
    nbytes: int = 0
    computed: int = 0
    skipped: str = ""
    note: str = ""


# Parameters that come from the scene and are no numbers of the settings: by attribute, a function of (evaluated
# terrain, its placement, dependency graph), called if the attribute is computed.
SceneParameters = Callable[[object, np.ndarray, object], Mapping[str, object]]
FROM_SCENE: dict[str, SceneParameters] = {
    "sun": lambda _terrain, placement, depsgraph: {"suns": suns_over(placement, depsgraph)}
}
FROM_SCENE |= dict.fromkeys(NAMES, lambda terrain, _placement, _depsgraph: layer_parameters(terrain.adaptive_terrain))

FROM_SCENE["detail_normal"] = partial(decal_parameters, tilts=True)
FROM_SCENE["color"] = lambda terrain, placement, depsgraph: (
    color_parameters(terrain.adaptive_terrain) | decal_parameters(terrain, placement, depsgraph, tilts=False)
)


def gather_effects(obj, evaluated, placement: np.ndarray, depsgraph, mode: str, names: Iterable[str] | None) -> Effects:
    """Return the attributes to compute for a terrain, with their readers and parameters.

    Args:
        evaluated: the object's evaluated copy.
        placement: matrix from the terrain's space to the world, float64 [4, 4].
        mode: VIEWPORT or RENDER.
        names: attributes of an export, in place of those that the scene reads, whether pinned or switched off; None
            otherwise.
    """
    settings = evaluated.adaptive_terrain
    found = (
        _find_readers(obj, depsgraph, mode) if names is None else {n: [Reader("the export", GEOMETRY)] for n in names}
    )
    requests, off = [], []  # off: attributes that are switched off, with the names of their readers
    for name in GROUPS:
        readers, when = found.get(name, []), getattr(settings.effects, name).when
        if when == PINNED and names is None:
            readers = [*readers, PIN]
        labels = tuple(dict.fromkeys(reader.label for reader in readers))
        if when == OFF and names is None:
            off.append((name, labels))
        elif readers:
            # PICTURE: only pixels show the values, which may follow their size. GEOMETRY: one scale, from any camera.
            family = GEOMETRY if any(reader.family == GEOMETRY for reader in readers) else PICTURE
            from_scene = FROM_SCENE[name](evaluated, placement, depsgraph) if name in FROM_SCENE else {}
            parameters = tuple(sorted((*changed_numbers(settings, name), *from_scene.items())))
            requests.append(AttributeRequest(name, labels, family, parameters))
    return Effects(tuple(requests), tuple(off), settings.effects.geometry_metres)  # the scale of GEOMETRY


def statuses(
    effects: Effects, plan: AttributePlan, ran: "Mapping[str, Ran]", heights: HeightField
) -> dict[str, EffectStatus]:
    """Return an EffectStatus for every attribute by its name, computed or not.

    effects: its `off` has the attributes that are switched off, with the names of their readers. plan: the attributes
    of the update and those that they are computed from, even if these are switched off; `skipped` has the reason for
    each other attribute. ran: cost of the steps; one that is missing cost nothing.
    """
    from ...cbt_terrain.attributes.evaluate import Ran

    found = {}
    for step in plan.steps:
        cost = ran.get(step.name, Ran(ms=0.0, nbytes=0, computed=0))
        status = EffectStatus(step.readers, step.family, note=_note_on(step, heights))
        found[step.name] = replace(status, ms=cost.ms, nbytes=cost.nbytes, computed=cost.computed)
    off = dict(effects.off)
    for name, why in plan.skipped.items():
        found[name] = EffectStatus(off.get(name, ()), skipped=_switched_off_text(off[name]) if name in off else why)
    return {name: found[name] for name in ATTRIBUTES}


def _note_on(step: AttributeRequest, heights: HeightField) -> str:
    """Return why an attribute, or a layer in it, is 0 where one may not expect it, or "".

    step: the attribute's request.
    """
    if why := why_missing(heights, step.name):
        return f"0, since {why}"
    parameters = dict(step.parameters)
    if parameters.get("suns") == ():
        return "0, since no sun lamp shines in the scene"
    return empty_layers_note(parameters.get("layers", ()))


def _switched_off_text(readers: tuple[str, ...]) -> str:
    """Return the reason for skipping an attribute that is switched off, with its would-be readers."""
    return f"switched off, read by {' and '.join(readers)}" if readers else "switched off"


def _find_readers(obj, depsgraph, mode: str) -> dict[str, list[Reader]]:
    """Return the readers in the scene by attribute.

    A reader of everything counts for each attribute. A reader of "the active colours" counts for those two attributes
    that the mesh has as its active and its default colours. mode: VIEWPORT or RENDER.
    """
    demand = demand_cache.demand_of(obj, depsgraph, mode)
    found = Demand({name: list(readers) for name, readers in demand.items()})  # a copy: `demand` may be cached
    everything = {name: demand.get(ALL, []) for name in ATTRIBUTES}
    colours = {obj.data.attributes.active_color_name, obj.data.attributes.default_color_name}
    found.merge(Demand(everything | {name: demand.get(ACTIVE_COLOR, []) for name in colours if name}))
    return found
