# SPDX-License-Identifier: GPL-3.0-or-later
"""How kernels are compiled."""

import importlib
import pkgutil

import warp as wp
from adaptive_terrain import kernels


def test_no_kernel_is_compiled_with_its_derivative():
    names = [found.name for found in pkgutil.walk_packages(kernels.__path__, f"{kernels.__name__}.")]
    with_kernels = [name for name in names if hasattr(importlib.import_module(name), "wp")]
    assert len(with_kernels) > 50
    assert [name for name in with_kernels if wp.get_module(name).options["enable_backward"]] == []
