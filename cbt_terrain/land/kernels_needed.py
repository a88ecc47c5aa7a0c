# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernel modules that a stack launches. Compiling one takes seconds to minutes, once on a machine."""

from collections.abc import Callable
from types import ModuleType

from ..effects.catalogue import EFFECTS
from ..effects.effect import Asked
from ..evaluate.kernels_needed import kernels_named_by
from ..evaluate.plan import plan
from ..run import warmup
from .mask_reads import SHAPES
from .stack import Stack

PREPARING = "Preparing kernels"


def kernels_of(stack: Stack) -> list[ModuleType]:
    """Return the kernel modules of a stack's operators and of the attributes that its masks read."""
    effects = [entry.declaration.apply for entry in stack.active]
    rules = [rule for entry in stack.active if entry.mask is not None for rule in entry.mask.rules]
    read = [EFFECTS[step.name].make for step in plan(Asked(rule.of, ()) for rule in rules if rule.of in SHAPES).steps]
    return kernels_named_by(function.__module__ for function in (*effects, *read))


def prepare(stack: Stack, on_progress: Callable[[float, str], None] = lambda _fraction, _message: None) -> None:
    """Load the kernel modules of a stack and report progress for those that have to be compiled."""
    modules = kernels_of(stack)
    missing = [module for module in modules if not warmup.compiled_file(module).exists()]
    for number, module in enumerate(missing, 1):
        on_progress(0.0, f"{PREPARING}, {number} of {len(missing)}")
        warmup.load(module)
    for module in modules:
        warmup.load(module)
