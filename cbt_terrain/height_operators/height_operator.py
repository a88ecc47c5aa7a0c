# SPDX-License-Identifier: GPL-3.0-or-later
"""Height operators: a declaration, and a function that computes a change of a level of the ground.

Levels halve the spacing. An operator is applied to the coarsest level first, with all its steps; on each finer level it
starts from its coarser change and adds the detail of the finer samples. Units are metres and years. So half the spacing
adds detail to the same land. Any other number of samples moves the samples of the coarse levels, and thereby valleys.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import ModuleType

import numpy as np

from ..attributes.attribute import Parameter


@dataclass(frozen=True)
class LandLayer:
    """A by-product, a number for each sample.

    `name`: name of the attribute, map or file. `adds_up`: the numbers of several operators of a stack are added,
    as depths of sediment are, and a mask scales them; otherwise those of the last operator hold. `signed`: a depth that
    may be negative.
    """

    name: str
    unit: str
    about: str
    adds_up: bool = True
    signed: bool = False


@dataclass(frozen=True, eq=False)
class OperatorGround:
    """The input of an operator: one level of a terrain, or a tile of it with its halo. Arrays are read only.

    Attributes:
        heights: float32 [rows, columns], metres, row 0 south, column 0 west; `step_x`, `step_y` metres apart.
        first: row and column of sample [0, 0] in the whole level, so that noise is the same in every tile, and samples
            of the coarser level (even rows and columns) are known.
        whole: rows and columns of the whole level; (0, 0) stands for those of `heights`.
        level: number of the level; 0 is the raster's own.
        missing: bool [rows, columns], holes of the file with filled heights that must not change, or None.
        mask: float32 [rows, columns], 0 to 1, or None. Operators with `masks` apply it themselves; the change of others
            is multiplied by it.
        layers: layers of earlier operators and of the source, float32 [rows, columns] each.
        progress: called with the finished fraction, 0 to 1; raises to stop the work.
        target: rows and columns whose change is needed, None for all.
        size: metres from the raster's first row and column to its last, beyond which a coarser level may extend;
            None for the extent of the level.
        seed: of the operator's noise.
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
    target: tuple[slice, slice] | None = None
    size: tuple[float, float] | None = None

    @property
    def whole_shape(self) -> tuple[int, int]:
        """Return rows and columns of the whole level, of which the ground may be a tile."""
        rows, columns = np.maximum(self.whole, np.add(self.first, self.heights.shape))
        return int(rows), int(columns)

    @property
    def rims(self) -> tuple[bool, bool, bool, bool]:
        """Return whether the south, north, west and east side is the raster's border and not the cut of a tile."""
        (row, column), (rows, columns), shape = self.first, self.whole, self.heights.shape
        return row == 0, row + shape[0] >= rows, column == 0, column + shape[1] >= columns


@dataclass(frozen=True, eq=False)
class Change:
    """The result of an operator, float32 [rows, columns] each: `heights`, metres to add, and `layers` by name.

    Changes are separate from heights, since small ones would be lost in large heights. `state`: further arrays for the
    operator's next finer level; empty at level 0.
    """

    heights: np.ndarray
    layers: dict[str, np.ndarray] = field(default_factory=dict)
    state: dict[str, np.ndarray] = field(default_factory=dict)


# (ground before the operator, parameters, its change of the next coarser level interpolated to this one's samples, None
# at the coarsest level) -> change of this level.
Apply = Callable[[OperatorGround, Mapping[str, float], Change | None], Change]

# Applies an operator level by level: `shape_with` in examples.py.
Evaluate = Callable[..., Change]


@dataclass(frozen=True, eq=False)
class HeightOperator:
    """The declaration of a height operator.

    Attributes:
        name, label, about: for stacks and files, for menus, and one line of meaning.
        apply: the function.
        example: evaluates it on ground with a known result and asserts that.
        kernels: modules of kernels that `apply` launches, itself or through others; they are compiled ahead. A module
            of this package is named ("land.thermal"), so that a declaration imports no kernels.
        parameters: in metres, years, degrees.
        layers: its by-products. reads: layers of others that it reads.
        state: names of the arrays in `Change.state`.
        halo: returns the metres around a tile that finer levels read, from the parameters and the spacing; inf if they
            read the whole level.
        doubts: returns whether finer levels must be computed in one piece, from the interpolated coarser change, the
            change of a level in one piece, and the area of a sample in m2.
        finest: largest number of samples along the longer side that it is applied to, 0 for no limit.
        masks: it applies masks itself.
        limit, conserves, converges: its stability, its invariants with their accuracy, and the measured change of a
            finer level.
        cost_ns: measured nanoseconds for a sample of a level on one thread.
        source: paper and section.
        version: raised whenever its values change.
    """

    name: str
    label: str
    about: str
    apply: Apply
    example: Callable[[Evaluate], None]
    kernels: tuple[ModuleType | str, ...] = ()
    parameters: tuple[Parameter, ...] = ()
    layers: tuple[LandLayer, ...] = ()
    reads: tuple[str, ...] = ()
    state: tuple[str, ...] = ()
    halo: Callable[[Mapping[str, float], float], float] = lambda _values, _step: 0.0
    doubts: Callable[[Change, Change, float], bool] = lambda _coarser, _change, _cell: False
    finest: int = 0
    masks: bool = False
    limit: str = ""
    conserves: str = ""
    converges: str = ""
    cost_ns: float = 0.0
    source: str = ""
    version: int = 1

    def defaults(self) -> dict[str, float]:
        """Return the default of every parameter."""
        return {parameter.name: parameter.default for parameter in self.parameters}
