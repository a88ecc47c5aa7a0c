# SPDX-License-Identifier: GPL-3.0-or-later
"""Preparation of the kernels that a stack launches. Compiling a module takes seconds to minutes, once on a machine."""

from collections.abc import Callable
from types import ModuleType

from ..attributes.attribute import AttributeRequest
from ..attributes.plan import kernels_of_steps, plan
from ..run import warmup
from .mask_reads import SHAPES
from .stack import Stack

PREPARING = "Preparing kernels"


def kernels_of(stack: Stack) -> list[ModuleType]:
    """Return the modules of kernels of a stack's operators and of the attributes that its masks read."""
    rules = [rule for entry in stack.active if entry.mask is not None for rule in entry.mask.rules]
    # SHAPES are the attributes that kernels compute; others are by-products of operators.
    read = plan(AttributeRequest(rule.of, readers=()) for rule in rules if rule.of in SHAPES)
    launched = [module for entry in stack.active for module in entry.declaration.kernels]
    return warmup.import_kernels([*launched, *kernels_of_steps(read)])


def prepare(stack: Stack, on_progress: Callable[[float, str], None] = lambda _fraction, _message: None) -> None:
    """Load the kernel modules of a stack and report those that have to be compiled, with a fraction of 0 and a text."""
    modules = kernels_of(stack)
    missing = [module for module in modules if not warmup.compiled_file(module).exists()]
    for number, module in enumerate(missing, 1):
        on_progress(0.0, f"{PREPARING}, {number} of {len(missing)}")
        warmup.load(module)
    for module in modules:
        warmup.load(module)
