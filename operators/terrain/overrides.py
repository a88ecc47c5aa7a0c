# SPDX-License-Identifier: GPL-3.0-or-later
"""Values that a command uses in place of a terrain's settings, animated or not. It needs no bpy."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

from ...cbt_terrain.field.displacement_layers import Ground


@dataclass(frozen=True)
class Overrides:
    """Values in place of a terrain's settings; None, or no key in `criterion`, keeps the setting.

    Attributes:
        criterion: fields of `Criterion` by their names. An error in pixels or metres also replaces a time budget.
        interpolation: the height field's.
        effects: names of the attributes to compute, in place of those that the scene reads.
        ground: displacement.
    """

    criterion: Mapping[str, float | None] = field(default_factory=dict)
    interpolation: str | None = None
    effects: tuple[str, ...] | None = None
    ground: Ground | None = None

    def to_json(self) -> dict:
        """Return the settings that a frame's digest covers, with the keys of version 0.3: its frames can be resumed."""
        others = asdict(self)
        criterion = dict.fromkeys(("error_px", "max_triangles", "meshlet", "shading_floor", "morph"))
        criterion |= others.pop("criterion")
        morph = criterion.pop("morph")  # a factor above 1 with geomorph
        return {**criterion, "smooth_transitions": None if morph is None else morph > 1.0, **others}


NO_OVERRIDES = Overrides()
