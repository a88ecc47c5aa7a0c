# SPDX-License-Identifier: GPL-3.0-or-later
"""From what is read to what is run: the closure over what effects read themselves, in the order of making."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from graphlib import TopologicalSorter

from .catalogue import EFFECTS
from .effect import GEOMETRY, Asked

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
    """What `asked` calls for. Names that are no effects are left out: they are attributes of others."""
    found = {item.name: item for item in asked if item.name in EFFECTS}
    attributes = tuple(sorted(found))
    waiting = list(found.values())
    while waiting:
        item = waiting.pop()
        for name in EFFECTS[item.name].reads_with(item.parameters):
            reader = f"effect {item.name}"
            known = found.get(name) or Asked(name, (), item.family)
            # What geometry is made from has one scale, and so has what that reads.
            family = GEOMETRY if GEOMETRY in (known.family, item.family) else known.family
            if reader not in known.readers or family != known.family:
                readers = known.readers if reader in known.readers else (*known.readers, reader)
                found[name] = replace(known, readers=readers, family=family)
                waiting.append(found[name])
    reads = {name: EFFECTS[name].reads_with(found[name].parameters) for name in sorted(found)}
    order = TopologicalSorter(reads).static_order()
    return Plan(tuple(found[name] for name in order), attributes)
