# SPDX-License-Identifier: GPL-3.0-or-later
"""From what is read to what is run: the closure over what effects read themselves, in the order of making."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from graphlib import TopologicalSorter

from ..effects.catalogue import EFFECTS
from ..effects.effect import GEOMETRY, Asked

NOTHING_READS_IT = "nothing reads it"


@dataclass(frozen=True)
class Plan:
    """`steps`: what is run, first things first: what is asked for, and what that is made from. `attributes`: the names
    of those that somebody reads from the mesh. `skipped`: of every other effect why it is not run."""

    steps: tuple[Asked, ...] = ()
    attributes: tuple[str, ...] = ()

    @property
    def skipped(self) -> dict[str, str]:
        run = {step.name for step in self.steps}
        return {name: NOTHING_READS_IT for name in EFFECTS if name not in run}


def plan(asked: Iterable[Asked]) -> Plan:
    """What `asked` calls for. Names that are no effects are left out: they are attributes of others.

    Raises TerrainError for a parameter that an effect does not have, or not so.
    """
    found: dict[str, Asked] = {}
    for item in asked:
        if item.name in EFFECTS:
            EFFECTS[item.name].check(dict(item.parameters))
            found[item.name] = _both(found[item.name], item) if item.name in found else item
    attributes = tuple(sorted(found))
    waiting = list(found.values())
    while waiting:
        item = waiting.pop()
        for name in EFFECTS[item.name].reads_with(item.parameters):
            reader = f"effect {item.name}"
            known = found.get(name) or Asked(name, (), item.family)
            found[name] = _both(known, Asked(name, (reader,), item.family))
            if found[name] != known:
                waiting.append(found[name])
    reads = {name: EFFECTS[name].reads_with(found[name].parameters) for name in sorted(found)}
    order = TopologicalSorter(reads).static_order()
    return Plan(tuple(found[name] for name in order), attributes)


def _both(one: Asked, other: Asked) -> Asked:
    """The same effect, asked for twice. What geometry is made from has one scale, and so has what that reads."""
    readers = tuple(dict.fromkeys((*one.readers, *other.readers)))
    family = GEOMETRY if GEOMETRY in (one.family, other.family) else one.family
    parameters = tuple(sorted((dict(one.parameters) | dict(other.parameters)).items()))
    return replace(one, readers=readers, family=family, parameters=parameters)
