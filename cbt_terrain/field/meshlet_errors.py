# SPDX-License-Identifier: GPL-3.0-or-later
"""Error hierarchies for leaves that are drawn finer than they are, as meshlets."""

import numpy as np

from ..run import launch
from ..run.locks import cached
from . import codes, hierarchy, store
from .heightfield import HeightField


def error_for(field: HeightField, meshlet: int) -> np.ndarray:
    """uint8 [node_count], of the field's table: the error hierarchy for leaves that are drawn as 4**meshlet triangles.

    Computed once for each `meshlet`, and kept in the store if the field has one.
    """
    if meshlet == 0:
        return field.error
    return cached(field.expanded, meshlet, lambda: _load_or_expand(field, meshlet))


def _load_or_expand(field: HeightField, meshlet: int) -> np.ndarray:
    name = f"error_m{meshlet}" if field.interpolation == "bilinear" else f"error_c_m{meshlet}"
    kept = store.load_kept(field, name, field.error.shape, np.uint8)
    if kept is not None:
        return kept
    errors, made = codes.decode(field.lattice, field.error, field.table), np.zeros_like(field.error)
    threads = launch.default_threads()
    hierarchy.expand_errors(field.lattice, errors, meshlet, threads)
    codes.put(field.lattice, errors, field.table, made, threads)
    store.keep(field, name, made)
    return made
