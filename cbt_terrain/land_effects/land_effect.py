# SPDX-License-Identifier: GPL-3.0-or-later
"""What an effect on heights is: a declaration, and a function that adds a change to a level of the ground.

Levels halve the spacing. An effect is applied to the coarsest level first, with all the steps it needs; on each finer
one it starts from its own change there and adds what only the finer samples can tell. All it takes and gives is in
metres and years. So halving the spacing adds detail to the same land; any other number of samples moves those of the
coarse levels, and then valleys lie elsewhere. Nothing here knows of a camera.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ..effects.effect import Parameter


@dataclass(frozen=True)
class LandLayer:
    """A by-product: a number for each sample beside the heights. `name`: of the attribute, map or file. `per_metre`:
    whether it is a depth, which is added up over a stack, or a state, of which the last one counts. `signed`: depths
    that may be below 0."""

    name: str
    unit: str
    about: str
    per_metre: bool = True
    signed: bool = False


@dataclass(frozen=True, eq=False)
class Ground:
    """One level of a terrain, or a tile of it with its halo, as an effect gets it; arrays are not written.

    `heights`: float32 [rows, columns] metres, row 0 south, column 0 west. `step_x`, `step_y`: metres between samples.
    `first`: row and column of sample [0, 0] in the numbering of the whole level, which decides phases, noise and beds.
    `whole`: rows and columns of the whole level. `level`: halvings of the spacing that are left until the raster's own.
    `missing`: bool [rows, columns] or None, holes of the file: heights there are filled, nothing should change them.
    `mask`: float32 [rows, columns], 0 to 1, or None: how much of the effect is wanted. Effects with `masks` heed it
    themselves, of the others the change is multiplied by it.
    `layers`: what effects before this one have left, float32 [rows, columns] each.
    `seed`: of what is random. `progress`: told the part that is done, 0 to 1; raises to stop the work.
    `asked`: the rows and columns of it whose change is wanted, the others are only looked at; None: all.
    `size`: metres from the raster's first row and column to its last, beyond which those of a coarser level may be
    counted; None: those of the level.
    """

    heights: np.ndarray
    step_x: float
    step_y: float
    first: tuple[int, int] = (0, 0)
    whole: tuple[int, int] = (0, 0)
    level: int = 0
    missing: np.ndarray | None = None
    mask: np.ndarray | None = None
    layers: Mapping[str, np.ndarray] = field(default_factory=dict)
    seed: int = 0
    threads: int = 1
    progress: Callable[[float], None] = lambda _part: None
    asked: tuple[slice, slice] | None = None
    size: tuple[float, float] | None = None

    @property
    def rims(self) -> tuple[bool, bool, bool, bool]:
        """Whether the south, north, west and east side is the raster's own rim, and not the cut of a tile."""
        (row, column), (rows, columns), shape = self.first, self.whole, self.heights.shape
        return row == 0, row + shape[0] >= rows, column == 0, column + shape[1] >= columns


@dataclass(frozen=True, eq=False)
class Change:
    """What an effect does to a ground: `heights`, float32 [rows, columns] metres to be added, kept apart from the
    heights so that small changes are not lost in large ones; and its layers, float32 [rows, columns] each.

    `kept`: likewise, what its next finer level has to know beside these; nobody else sees it, at level 0 it is empty.
    """

    heights: np.ndarray
    layers: dict[str, np.ndarray] = field(default_factory=dict)
    kept: dict[str, np.ndarray] = field(default_factory=dict)


# The ground, the parameters, and the effect's own change at the next coarser level brought to this one's samples (None
# at the coarsest) -> the change of this level. The heights of the ground are those before the effect.
Apply = Callable[[Ground, Mapping[str, float], Change | None], Change]

# A ground of float32 [rows, columns] m whose samples are so many metres apart, with the effect applied to it level by
# level, by its name: see examples.py.
Evaluate = Callable[..., Change]


@dataclass(frozen=True, eq=False)
class LandEffect:
    """One effect on heights: what it is, and how it is applied.

    `name`: in stacks and files. `label`: in menus. `about`: one line of meaning. `layers`: its by-products, those of
    others that it `reads`. `kept`: names of what its changes keep for its finer levels. `parameters`: in metres, years,
    degrees. `halo`: metres around a tile that its finer levels look at, given the parameters and the spacing; inf where
    only the whole raster will do. `doubts`: whether tiles of finer levels are not to be trusted, so that they have to
    be in one piece: asked of a level that is, given the coarser change brought to it, its own change, and the square
    metres of a sample. `finest`: the most samples along the longer side that it is worth or able to be
    applied to, 0 for no limit. `limit`: its stability, in words. `conserves`: what stays, and how exactly. `converges`:
    what a finer level changes, measured. `cost_ns`: nanoseconds a sample of a level on one thread, measured. `source`:
    paper and section. `version`: raised whenever its values change. `example`: evaluates it where the answer is known,
    and asserts that.
    """

    name: str
    label: str
    about: str
    apply: Apply
    example: Callable[[Evaluate], None]
    parameters: tuple[Parameter, ...] = ()
    layers: tuple[LandLayer, ...] = ()
    reads: tuple[str, ...] = ()
    kept: tuple[str, ...] = ()
    halo: Callable[[Mapping[str, float], float], float] = lambda _values, _step: 0.0
    doubts: Callable[[Change, Change, float], bool] = lambda _coarser, _own, _cell: False
    finest: int = 0
    masks: bool = False
    limit: str = ""
    conserves: str = ""
    converges: str = ""
    cost_ns: float = 0.0
    source: str = ""
    version: int = 1

    def defaults(self) -> dict[str, float]:
        return {parameter.name: parameter.default for parameter in self.parameters}
