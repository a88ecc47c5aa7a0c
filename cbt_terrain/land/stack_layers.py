# SPDX-License-Identifier: GPL-3.0-or-later
"""The layers of a stack beside those of what it was applied to."""

from collections.abc import Mapping

import numpy as np

from .tile_cache import content_key


def joined(before: Mapping[str, np.ndarray], own: Mapping[str, np.ndarray], depths: set[str]) -> dict[str, np.ndarray]:
    """Layers of a source with those of a stack: depths are added, states replaced."""
    both = {name: before[name] + own[name] if name in before and name in depths else own[name] for name in own}
    return dict(before) | both


def key_with(key: str, layers: Mapping[str, np.ndarray]) -> str:
    """The key of a field that has these layers beside the heights of `key`."""
    if not layers:
        return key
    return content_key(key, *(part for name in sorted(layers) for part in (name, layers[name])))
