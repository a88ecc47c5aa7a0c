# SPDX-License-Identifier: GPL-3.0-or-later
"""Which modules of kernels effects launch from, so that they can be loaded ahead.

Found by what the modules of the effects' functions name: themselves, or through other modules of effects, those on
heights too. That may be a few too many, never one too few.
"""

import sys
from collections.abc import Iterable
from functools import cache
from types import ModuleType

import warp as wp

from ..effects.catalogue import EFFECTS
from ..run.warmup import others_named
from . import evaluate
from .plan import Plan

HOUSE = __name__.rsplit(".", 2)[0]
ROOMS = tuple(f"{HOUSE}.{room}." for room in ("effects", "evaluate", "land_effects"))


def kernels_of(plan: Plan) -> list[ModuleType]:
    """Modules of kernels that are launched for the steps of a plan; none for none."""
    makers = [EFFECTS[step.name].make.__module__ for step in plan.steps]
    return kernels_named_by([evaluate.__name__, *makers] if makers else [])


def kernels_named_by(modules: Iterable[str]) -> list[ModuleType]:
    """Modules of kernels that functions of these modules of effects launch."""
    return others_named(frozenset().union(*map(_named_by, modules)))


@cache
def _named_by(module: str) -> frozenset[str]:
    """Names of the modules that a module of effects has in hand, and those of effects that it uses."""
    found, waiting = set(), [module]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        found.add(name)
        # The evaluator knows every effect by the catalogue, and needs the kernels of none for that.
        if name.startswith(ROOMS) and name != EFFECTS_OF:
            waiting += {_home(value) for value in vars(sys.modules[name]).values()} - {None}
    return frozenset(found)


EFFECTS_OF = f"{HOUSE}.effects.catalogue"


def _home(value: object) -> str | None:
    """The name of the module that a global of a module is, or is from."""
    if isinstance(value, ModuleType):
        return value.__name__
    if isinstance(value, wp.Kernel):
        return value.module.name
    home = getattr(value, "__module__", None)
    return home if isinstance(home, str) and home.startswith(ROOMS) else None
