# SPDX-License-Identifier: GPL-3.0-or-later
"""Error hierarchies for leaves that are drawn finer than they are, as meshlets."""

import numpy as np

from ..run import launch
from ..run.locks import cached
from . import codes, hierarchy, store
from .heightfield import HeightField


def error_for(field: HeightField, meshlet: int) -> np.ndarray:
    """Return the error hierarchy for leaves that are drawn as 4**meshlet triangles.

    The result is uint8 [node_count]: a code for each diamond, which the field's table turns into metres. Errors are
    smaller than those of `field.error`, so the refinement needs fewer leaves. It is computed once for each `meshlet`,
    and cached in the field's store, if it has one.
    """
    if meshlet == 0:
        return field.error
    return cached(field.cache.expanded, (field.interpolation, meshlet), lambda: _load_or_expand(field, meshlet))


def _load_or_expand(field: HeightField, meshlet: int) -> np.ndarray:
    """Load the hierarchy from the field's store, or compute it and write it there."""
    name = f"error_m{meshlet}" if field.interpolation == "bilinear" else f"error_c_m{meshlet}"
    expanded = store.load_derived(field, name, field.error.shape, np.uint8)
    if expanded is not None:
        return expanded
    errors, expanded = codes.decode(field.lattice, field.error, field.table), np.zeros_like(field.error)
    threads = launch.default_threads()
    hierarchy.expand_errors(field.lattice, errors, meshlet, threads)
    codes.encode_with_table(field.lattice, errors, field.table, expanded, threads)
    store.cache_derived(field, name, expanded)
    return expanded
