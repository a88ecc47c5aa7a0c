# SPDX-License-Identifier: GPL-3.0-or-later
"""Merging the layers of a stack with those of its source."""

from collections.abc import Mapping

import numpy as np

from .tile_cache import compute_digest


def merge_layers(
    before: Mapping[str, np.ndarray], new: Mapping[str, np.ndarray], depths: set[str]
) -> dict[str, np.ndarray]:
    """Return the layers of a source with those of a stack: depths are added, states replaced.

    before, new: those of the source and of the stack, by name. depths: names of depths.
    """
    merged = {name: before[name] + new[name] if name in before and name in depths else new[name] for name in new}
    return dict(before) | merged


def key_with(key: str, layers: Mapping[str, np.ndarray]) -> str:
    """Return the content key of a field that has these layers besides its heights. key: of the heights alone."""
    if not layers:
        return key
    return compute_digest(key, *(part for name in sorted(layers) for part in (name, layers[name])))
