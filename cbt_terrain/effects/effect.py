# SPDX-License-Identifier: GPL-3.0-or-later
"""What an effect is: a declaration, and a function over the places that it is asked for."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from numbers import Real

import numpy as np

from ..errors import TerrainError
from ..field.heightfield import HeightField
from ..plain_numbers import plain_number

# Who reads it, which decides the scale: what pixels show is prefiltered to a pixel's footprint, what geometry is made
# from has one scale in metres, so that nothing moves with the camera.
PICTURE, GEOMETRY = "PICTURE", "GEOMETRY"
LINEAR_RGB = "linear RGB"  # the unit of colours: of Rec. 709


@dataclass(frozen=True)
class Parameter:
    """A number that an effect takes. `unit`: of the number, "" where it has none. `least`, `most`: its range."""

    name: str
    default: float
    least: float
    most: float
    unit: str
    about: str


@dataclass(frozen=True, eq=False)
class Places:
    """Where effects are evaluated: vertices of a mesh, or texels of a map.

    `positions`: float32 [n, 3], metres in the terrain's own space, heights as displaced. `level`: float32 [n], the
    scale as a level of the pyramid: 0 is the raster's own spacing, 1 twice that. `image_level`: of images laid on the
    ground, which may be finer than the raster, so below 0; the same number everywhere, or None: they are at `level`.
    Heights of the field become `height * vertical_scale + vertical_offset`.
    """

    field: HeightField
    positions: np.ndarray
    level: np.ndarray
    vertical_scale: float = 1.0
    vertical_offset: float = 0.0
    threads: int = 1
    image_level: float | None = None

    def __len__(self) -> int:
        return len(self.positions)

    def only(self, which: np.ndarray) -> "Places":
        """Those of the numbers `which`."""
        return replace(self, positions=self.positions[which], level=self.level[which])


# What is asked of effects that are made together: the parameters of each, by the effects' names.
Wanted = Mapping[str, Mapping[str, object]]
# Places, what is wanted, and the values of what those effects read at these places -> the values of each wanted effect,
# float32 [n] or [n, width].
Make = Callable[[Places, Wanted, Mapping[str, np.ndarray]], dict[str, np.ndarray]]

# Evaluates an effect, by its name, on a raster: see evaluate_on in evaluate/examples.py.
Evaluate = Callable[..., np.ndarray]


@dataclass(frozen=True, eq=False)
class Effect:
    """One effect: what it is, and how it is made.

    `name`: of the attribute or map. `about`: one line of meaning. `unit`: of its numbers, of which each element has
    `width`. `make`: see Make; effects with the same `make` are made together, in one call. A function of the place, the
    level, the parameters and what is read alone: which other places are asked for changes nothing. `reads`: names of
    other effects; where parameters decide which of them, `choose` tells. `nothing`: tells for which parameters all its
    numbers are 0; it is not made then. `halo`: how far around a place it looks.
    `bound`: what it adds to the error of the mesh, "" for nothing. `scaled`: whether the level counts, too; of what it
    reads as well. `span`: between which all its numbers lie, None
    where nobody can say: maps of it hold floats. `cost_ns`: nanoseconds an element on one thread, measured. `source`:
    paper and section. `version`: raised whenever its values change. `example`: evaluates it where the answer is known,
    and asserts that.
    """

    name: str
    about: str
    unit: str
    make: Make
    example: Callable[[Evaluate], None]
    width: int = 1
    reads: tuple[str, ...] = ()
    parameters: tuple[Parameter, ...] = ()
    halo: str = ""
    bound: str = ""
    scaled: bool = True
    span: tuple[float, float] | None = None
    cost_ns: float = 0.0
    source: str = ""
    version: int = 1
    choose: Callable[[Mapping[str, object]], tuple[str, ...]] | None = None
    nothing: Callable[[Mapping[str, object]], bool] | None = None

    def reads_with(self, values: Iterable[tuple[str, object]]) -> tuple[str, ...]:
        """Names of the effects that it reads with parameters that differ from their defaults so."""
        return self.reads if self.choose is None else self.choose(self.defaults() | dict(values))

    def is_nothing(self, values: Iterable[tuple[str, object]]) -> bool:
        """Whether all its numbers are 0 with parameters that differ from their defaults so."""
        return self.nothing is not None and self.nothing(self.defaults() | dict(values))

    def defaults(self) -> dict[str, float]:
        return {parameter.name: parameter.default for parameter in self.parameters}

    def check(self, values: Mapping[str, object]) -> None:
        """Raise TerrainError for a number that is no parameter of this effect, or out of its range."""
        known = {parameter.name: parameter for parameter in self.parameters}
        for name, value in values.items():
            if name not in known:
                expected = ", ".join(known) or "none, it has no parameters"
                raise TerrainError(f"The effect {self.name!r} has no parameter {name!r}; expected one of: {expected}.")
            p = known[name]
            if isinstance(p.default, int | float) and not p.least <= value <= p.most:
                expected = f"{p.least:g} to {p.most:g} {p.unit}".rstrip()
                raise TerrainError(f"{name} of the effect {self.name!r} is {value}; expected {expected}.")


@dataclass(frozen=True)
class Asked:
    """One effect that is asked for. `readers`: who reads it, in words. `family`: PICTURE or GEOMETRY. `parameters`:
    those that differ from their defaults, as pairs."""

    name: str
    readers: tuple[str, ...]
    family: str = PICTURE
    parameters: tuple[tuple[str, object], ...] = field(default=())

    def __post_init__(self):
        numbers = tuple((name, _plain(value)) for name, value in self.parameters)
        object.__setattr__(self, "parameters", numbers)


def _plain(value: object):
    """Return a number, or those of a tuple, as floats, and anything else as it is."""
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    is_number = (isinstance(value, Real) and not isinstance(value, bool)) or isinstance(value, np.ndarray)
    return plain_number(value, float, "A parameter of an effect") if is_number else value
