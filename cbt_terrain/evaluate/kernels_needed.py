# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernel modules that attributes launch, so that they can be loaded ahead.

They are found by the globals of the modules of the attributes' functions, and of other modules of attributes and height
operators that these use. The result may have a few too many, but never misses one.
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
    """Return the kernel modules that the steps of a plan launch."""
    makers = [EFFECTS[step.name].make.__module__ for step in plan.steps]
    return kernels_named_by([evaluate.__name__, *makers] if makers else [])


def kernels_named_by(modules: Iterable[str]) -> list[ModuleType]:
    """Return the kernel modules that functions of these modules launch."""
    return others_named(frozenset().union(*map(_named_by, modules)))


@cache
def _named_by(module: str) -> frozenset[str]:
    """Return the names of the modules that a module and the modules of attributes in its globals refer to."""
    found, waiting = set(), [module]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        found.add(name)
        # The catalogue lists every attribute, which needs none of their kernels.
        if name.startswith(ROOMS) and name != EFFECTS_OF:
            waiting += {_home(value) for value in vars(sys.modules[name]).values()} - {None}
    return frozenset(found)


EFFECTS_OF = f"{HOUSE}.effects.catalogue"


def _home(value: object) -> str | None:
    """Return the name of the module that a global is, or comes from."""
    if isinstance(value, ModuleType):
        return value.__name__
    if isinstance(value, wp.Kernel):
        return value.module.name
    home = getattr(value, "__module__", None)
    return home if isinstance(home, str) and home.startswith(ROOMS) else None
