# SPDX-License-Identifier: GPL-3.0-or-later
"""Plans: requested attributes and those that they read, in the order of computation.

The readers of an attribute are names of what uses it, its family is their kind: GEOMETRY if any of them makes geometry,
else PICTURE.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from graphlib import TopologicalSorter
from types import ModuleType

from ..run.warmup import import_kernels
from .attribute import GEOMETRY, AttributeRequest
from .catalogue import ATTRIBUTES

NOTHING_READS_IT = "nothing reads it"


@dataclass(frozen=True)
class AttributePlan:
    """Steps in the order of computation, and the sorted names of the requested attributes, which the mesh gets."""

    steps: tuple[AttributeRequest, ...] = ()
    attributes: tuple[str, ...] = ()

    @property
    def skipped(self) -> dict[str, str]:
        """Return the attributes that are not computed, with the reason."""
        run = {step.name for step in self.steps}
        return {name: NOTHING_READS_IT for name in ATTRIBUTES if name not in run}


def plan(requests: Iterable[AttributeRequest]) -> AttributePlan:
    """Return the plan that computes the requested attributes, with those that they read, in order.

    Names outside the catalogue are ignored, since a mesh has attributes from other sources, too. An attribute that
    others read has its default parameters unless it was requested. Raises TerrainError for an unknown parameter or an
    invalid value.
    """
    merged: dict[str, AttributeRequest] = {}
    for request in requests:
        if request.name in ATTRIBUTES:
            ATTRIBUTES[request.name].check(dict(request.parameters))
            merged[request.name] = _merge(merged[request.name], request) if request.name in merged else request
    requested = tuple(sorted(merged))
    waiting = list(merged.values())
    while waiting:  # also for a known attribute whose request has changed, since that may concern those that it reads
        request = waiting.pop()
        for name in ATTRIBUTES[request.name].reads_with(request.parameters):
            reader = f"effect {request.name}"
            known = merged.get(name) or AttributeRequest(name, readers=(), family=request.family)
            merged[name] = _merge(known, AttributeRequest(name, readers=(reader,), family=request.family))
            if merged[name] != known:
                waiting.append(merged[name])
    reads = {name: ATTRIBUTES[name].reads_with(merged[name].parameters) for name in sorted(merged)}
    order = TopologicalSorter(reads).static_order()
    return AttributePlan(tuple(merged[name] for name in order), requested)


def kernels_of_steps(plan: AttributePlan) -> list[ModuleType]:
    """Return the modules of kernels that the attributes of a plan launch."""
    return import_kernels(module for step in plan.steps for module in ATTRIBUTES[step.name].kernels)


def _merge(one: AttributeRequest, other: AttributeRequest) -> AttributeRequest:
    """Merge two requests for an attribute. Geometry wins, since all that it reads has one scale.

    Parameters of `other` replace those of `one` with the same name.
    """
    readers = tuple(dict.fromkeys((*one.readers, *other.readers)))
    family = GEOMETRY if GEOMETRY in (one.family, other.family) else one.family
    parameters = tuple(sorted((dict(one.parameters) | dict(other.parameters)).items()))
    return replace(one, readers=readers, family=family, parameters=parameters)
