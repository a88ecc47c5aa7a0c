# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes: a declaration, and a function that computes values at points."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from numbers import Real
from types import ModuleType
from typing import Any

import numpy as np

from ..errors import TerrainError
from ..field.heightfield import HeightField
from ..plain_numbers import plain_number

# The kind of reader decides the scale: values for pixels are prefiltered to a pixel's footprint, values for geometry
# have one scale in metres, so that nothing moves with the camera.
PICTURE, GEOMETRY = "PICTURE", "GEOMETRY"
LINEAR_RGB = "linear RGB"  # unit of colours, Rec. 709


# A value of a parameter: a number, a name, or a tuple of suns, layers, colours or decals.
ParameterValue = Any


@dataclass(frozen=True)
class Parameter:
    """A parameter with its default, range (`min`, `max`) and unit, "" if it has none."""

    name: str
    default: ParameterValue
    min: float
    max: float
    unit: str
    about: str


@dataclass(frozen=True, eq=False)
class SamplePoints:
    """Points where attributes are evaluated: vertices of a mesh, or texels of a map.

    `positions`: float32 [n, 3], metres in the terrain's space, displaced. `level`: float32 [n], the scale as a level of
    the pyramid; 0 is the raster's spacing, 1 twice that. It is below 0 only in finer tiles (`limit_levels`, scale.py).
    `image_level`: level of decals, which may be finer than the raster and then is below 0; None for `level`. Heights
    are those of `field` times `vertical_scale` plus `vertical_offset`.
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

    def only(self, which: np.ndarray) -> "SamplePoints":
        """Return some of the points, with the same field and scales. which: indices or a mask."""
        return replace(self, positions=self.positions[which], level=self.level[which])


# Parameters of the requested attributes that are computed together, by name.
Wanted = Mapping[str, Mapping[str, ParameterValue]]
# (points, requested attributes, values at the points of the attributes that these read) -> values of each requested
# attribute, float32 [n] or [n, width].
Make = Callable[[SamplePoints, Wanted, Mapping[str, np.ndarray]], dict[str, np.ndarray]]

# Evaluates an attribute by its name on a raster: evaluate_on in examples.py.
Evaluate = Callable[..., np.ndarray]


@dataclass(frozen=True, eq=False)
class AttributeDeclaration:
    """The declaration of an attribute.

    Attributes:
        name, about, unit: of the attribute or map, one line of meaning, and the unit of its `width` numbers.
        make: the function; attributes with the same one are computed in one call. Values depend only on the point, the
            level, the parameters and the attributes read, not on other points.
        example: evaluates it on ground with a known result and asserts that.
        kernels: modules of kernels that `make` launches, itself or through others; they are compiled ahead. A module of
            this package is named ("effects.jet"), so that a declaration imports no kernels.
        reads: names of other attributes; `choose` returns those that given parameters need.
        nothing: returns whether all its values are 0 with given parameters; it is not computed then.
        halo: how far around a point it reads, in words. bound: its contribution to the mesh's error, "" for none.
        scaled: whether it, or an attribute that it reads, depends on the level.
        span: range of its values, None if unknown; maps of it then hold floats.
        cost_ns: measured nanoseconds for an element on one thread.
        source: paper and section. version: raised whenever its values change.
    """

    name: str
    about: str
    unit: str
    make: Make
    example: Callable[[Evaluate], None]
    kernels: tuple[ModuleType | str, ...] = ()
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
    choose: Callable[[Mapping[str, ParameterValue]], tuple[str, ...]] | None = None
    nothing: Callable[[Mapping[str, ParameterValue]], bool] | None = None

    def reads_with(self, values: Iterable[tuple[str, ParameterValue]]) -> tuple[str, ...]:
        """Return the names of the attributes that this one reads with some parameters.

        values: parameters that differ from their defaults.
        """
        return self.reads if self.choose is None else self.choose(self.defaults() | dict(values))

    def is_nothing(self, values: Iterable[tuple[str, ParameterValue]]) -> bool:
        """Return whether all values of the attribute are 0 with some parameters, so that it need not be computed.

        values: parameters that differ from their defaults.
        """
        return self.nothing is not None and self.nothing(self.defaults() | dict(values))

    def defaults(self) -> dict[str, ParameterValue]:
        """Return the default of every parameter."""
        return {parameter.name: parameter.default for parameter in self.parameters}

    def check(self, values: Mapping[str, ParameterValue]) -> None:
        """Raise TerrainError for an unknown parameter, or a number out of its range or NaN.

        values: by name, any of the parameters. Those that are no numbers are not checked here, but by the function that
        computes the attribute.
        """
        known = {parameter.name: parameter for parameter in self.parameters}
        for name, value in values.items():
            if name not in known:
                expected = f"one of: {', '.join(known)}" if known else "no parameters"
                raise TerrainError(f"The effect {self.name!r} has no parameter {name!r}", expected=expected)
            p = known[name]
            if isinstance(p.default, int | float) and not p.min <= value <= p.max:
                expected = f"{p.min:g} to {p.max:g} {p.unit}".rstrip()
                raise TerrainError(f"{name} of the effect {self.name!r} is {value}", expected=expected)


@dataclass(frozen=True)
class AttributeRequest:
    """A request for an attribute.

    `readers`: its readers, in words. `family`: PICTURE or GEOMETRY. `parameters`: pairs that differ from their
    defaults.
    """

    name: str
    readers: tuple[str, ...]
    family: str = PICTURE
    parameters: tuple[tuple[str, ParameterValue], ...] = field(default=())

    def __post_init__(self) -> None:
        numbers = tuple((name, _plain(value)) for name, value in self.parameters)
        object.__setattr__(self, "parameters", numbers)


def _plain(value: ParameterValue) -> ParameterValue:
    """Return numbers, alone or in tuples, as floats, and anything else, also booleans, as it is.

    So equal parameters have equal keys, whatever type of number a caller used. Raises TerrainError for an array of
    several numbers.
    """
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    is_number = (isinstance(value, Real) and not isinstance(value, bool)) or isinstance(value, np.ndarray)
    return plain_number(value, float, "A parameter of an effect") if is_number else value
