# SPDX-License-Identifier: GPL-3.0-or-later
"""Running a plan on a surface: each effect once, nothing that is not in the plan, nothing again that is known."""

import time
import weakref
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..ask.view import View
from ..effects.catalogue import EFFECTS
from ..effects.effect import GEOMETRY, Asked, Places
from ..field.heightfield import HeightField
from ..mesh.attributes import POINT as POINTS
from ..mesh.attributes import Attribute
from ..mesh.surface import Surface
from ..run.locks import SharedLock
from .keep import Kept
from .plan import Plan, plan
from .scale import fixed_level, footprint_levels

Group = list[Asked]  # what is made in one call
# Bytes that the values of effects may take of one terrain, with those of the last surface. This surface's are held
# whatever they take: the mesh is written from them.
MOST_BYTES = 1 << 28
NUMBER = 4  # bytes of a number, float32
ANY_LEVEL = "ANY_LEVEL"
BAND = 1 << 18  # samples that are evaluated together


@dataclass(frozen=True)
class Ran:
    """What one effect of a plan took: milliseconds (shared evenly by those that were made together), bytes that it
    holds, and for how many elements it was computed; 0 where all were known."""

    ms: float
    nbytes: int
    computed: int


@dataclass(frozen=True)
class _State:
    """What the last call left. `keys`: of the values that are kept, by effect."""

    surface: weakref.ref[Surface] | Callable[[], None] = lambda: None
    asked: tuple = ()
    keys: dict[str, tuple] = field(default_factory=dict)
    found: dict[str, Attribute] = field(default_factory=dict)


@dataclass
class Evaluator:
    """Evaluates effects for one terrain's surfaces; keeps what the next surface may take over.

    `most_bytes`: see MOST_BYTES. `runs`: how often each effect was computed, ever: what is not asked for is not in it.
    `ran`: what the last call took. Values are functions of a place, a level, parameters and heights alone, so what is
    kept has the bits of what would be computed, whatever surfaces came before.
    """

    threads: int = 1
    most_bytes: int = MOST_BYTES
    runs: Counter = field(default_factory=Counter)
    ran: dict[str, Ran] = field(default_factory=dict)
    _lock: SharedLock = field(default_factory=SharedLock, init=False, repr=False)
    _state: _State = field(default_factory=_State, init=False, repr=False)
    _kept: Kept | None = field(default=None, init=False, repr=False)

    @property
    def nbytes(self) -> int:
        """Bytes of all values that are held, of this surface and of the last one."""
        return 0 if self._kept is None else self._kept.nbytes

    def attributes(
        self,
        plan: Plan,
        heights: HeightField,
        surface: Surface,
        views: Sequence[View] = (),
        placement: np.ndarray | None = None,
        vertical_scale: float = 1.0,
        vertical_offset: float = 0.0,
        geometry_metres: float = 0.0,
    ) -> dict[str, Attribute]:
        """The attributes of the plan for this surface, by name; in arrays that stay as they are until the next call.

        Arguments as of `Terrain.update`. With no views what pictures show is at the raster's own scale, and so is what
        geometry is made from, unless `geometry_metres` says another.
        """
        scale = float(vertical_scale), float(vertical_offset)
        with self._lock:
            return self._attributes(plan, heights, surface, views, placement, scale, geometry_metres)

    def _attributes(
        self,
        plan: Plan,
        heights: HeightField,
        surface: Surface,
        views: Sequence[View],
        placement: np.ndarray | None,
        scale: tuple[float, float],
        geometry_metres: float,
    ) -> dict[str, Attribute]:
        where = b"" if placement is None else np.asarray(placement, np.float64).tobytes()
        asked = (plan, heights.key, scale, where, tuple(view.key() for view in views), geometry_metres)
        last, self._state, self.ran = self._state, _State(), {}
        if surface is last.surface() and asked == last.asked:
            self._state, self.ran = last, {step.name: Ran(0.0, 0, 0) for step in plan.steps}
            return last.found
        kept, self._kept = self._kept, None  # what is half done when this is stopped is not known
        if not plan.steps:
            return {}
        kept = Kept(self.threads) if kept is None else kept
        level = fixed_level(heights, geometry_metres)
        keys = _keys(plan, (heights.key, *scale), level)
        values: dict[str, np.ndarray] = {}
        positions = kept.move_to(surface.positions)
        places, fresh = {}, {}
        for family in sorted({step.family for step in plan.steps}):
            levels, before = kept.turn(family)
            if family == GEOMETRY:
                levels[:] = level
            else:
                footprint_levels(heights, positions, views, placement, self.threads, levels)
            places[family] = Places(heights, positions, levels, *scale, self.threads)
            fresh[family] = kept.fresh(levels, before)
        if not all(EFFECTS[step.name].scaled for step in plan.steps):
            fresh[ANY_LEVEL] = kept.new()
        made = [step for step in plan.steps if not EFFECTS[step.name].is_nothing(step.parameters)]
        once = _held_once(made, len(positions), self.most_bytes)
        kept.forget(once)
        stay = {step.name for step in made if last.keys.get(step.name) == keys[step.name]} - once
        which = {step.name: fresh[step.family if EFFECTS[step.name].scaled else ANY_LEVEL] for step in made}
        which |= dict.fromkeys(which.keys() - stay)
        values |= kept.take({name: EFFECTS[name].width for name, some in which.items() if some is not None})
        for step in set(plan.steps) - set(made):
            values[step.name] = kept.zeros(EFFECTS[step.name].width)
            self.runs[step.name] += 0
            self.ran[step.name] = Ran(0.0, 0, 0)
        for group in _made_together(made, stay):
            start = time.perf_counter()
            computed = _make(group, places[group[0].family], which[group[0].name], values, kept, once)
            ms = (time.perf_counter() - start) * 1e3 / len(group)
            for step in group:
                self.runs[step.name] += computed > 0
                self.ran[step.name] = Ran(ms, values[step.name].nbytes, computed)
        kept.forget_others({*which, *places})
        found = {name: Attribute(values[name], POINTS, EFFECTS[name].unit) for name in plan.attributes}
        self._kept, self._state = kept, _State(weakref.ref(surface), asked, keys, found)
        return found


def values_at(places: Places, asked: Iterable[Asked]) -> dict[str, np.ndarray]:
    """Effects, and what they read, at places that nothing is known of: by name, as `make` gives them."""
    steps = list(plan(asked).steps)
    values: dict[str, np.ndarray] = {}
    while steps:
        make = EFFECTS[steps[0].name].make
        now = [step for step in steps if EFFECTS[step.name].make is make and _reads(step) <= {*values}]
        values |= _computed(now, places, values)
        steps = [step for step in steps if step not in now]
    return values


def on_samples(
    field: HeightField,
    asked: Iterable[Asked],
    vertical_scale: float = 1.0,
    vertical_offset: float = 0.0,
    threads: int = 1,
    level: float = 0.0,
) -> Iterator[tuple[slice, dict[str, np.ndarray]]]:
    """Some rows after the other, row 0 south, and the values there by name: float32 [rows, columns], or with an
    effect's width. level: of the pyramid, 0 is the raster's own scale."""
    lattice, asked = field.lattice, list(asked)
    west, south, _, _ = lattice.rectangle()
    x = west + np.arange(lattice.width) * lattice.step_x
    at_once = max(1, BAND // lattice.width)
    for first in range(0, lattice.height, at_once):
        rows = slice(first, min(first + at_once, lattice.height))
        y = south + np.arange(rows.start, rows.stop) * lattice.step_y
        z = field.heights(rows).astype(np.float64) * vertical_scale + vertical_offset
        positions = np.stack([*np.meshgrid(x, y), z], -1).astype(np.float32)
        levels = np.full(z.size, level, np.float32)
        places = Places(field, positions.reshape(-1, 3), levels, vertical_scale, vertical_offset, threads)
        yield rows, {name: v.reshape(*z.shape, *v.shape[1:]) for name, v in values_at(places, asked).items()}


def _reads(step: Asked) -> set[str]:
    return set(EFFECTS[step.name].reads_with(step.parameters))


def _held_once(steps: Sequence[Asked], count: int, most: int) -> set[str]:
    """Names of the effects of which only this surface's values are held, because those of the last one, too, would take
    more than `most` bytes at so many places: what is cheapest to compute for its size goes first."""
    effects = [EFFECTS[step.name] for step in steps]
    # Two copies of places and of the levels of both families.
    left = most - NUMBER * count * (2 * (3 + 2) + sum(int(effect.width) for effect in effects))
    once = set()
    for effect in sorted(effects, key=lambda effect: (-effect.cost_ns / effect.width, effect.name)):
        left -= NUMBER * count * effect.width
        if left < 0:
            once.add(effect.name)
    return once


def _keys(plan: Plan, heights: tuple, level: float) -> dict[str, tuple]:
    """What the values of each step are a function of, beside places and the levels of pictures."""
    keys: dict[str, tuple] = {}
    for step in plan.steps:
        effect = EFFECTS[step.name]
        numbers = tuple(sorted((effect.defaults() | dict(step.parameters)).items()))
        scale = level if step.family == GEOMETRY and effect.scaled else None
        read = tuple(keys[name] for name in effect.reads_with(step.parameters))
        keys[step.name] = (step.name, effect.version, numbers, step.family, scale, heights, read)
    return keys


def _made_together(steps: Sequence[Asked], stay: set[str]) -> list[Group]:
    """Steps in groups that one call makes: of one function and family, of which all are known of the same places."""
    group_of: dict[str, int] = {}
    order: list[tuple[tuple, Group]] = []
    for step in steps:
        kind = (EFFECTS[step.name].make, step.family, EFFECTS[step.name].scaled, step.name in stay)
        after = max((group_of.get(name, -1) for name in EFFECTS[step.name].reads_with(step.parameters)), default=-1)
        number = next((k for k in range(after + 1, len(order)) if order[k][0] == kind), len(order))
        if number == len(order):
            order.append((kind, []))
        order[number][1].append(step)
        group_of[step.name] = number
    return [group for _, group in order]


def _computed(group: Sequence[Asked], places: Places, read: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the values of effects that one function makes. Raises TerrainError where one is not finite."""
    wanted = {step.name: EFFECTS[step.name].defaults() | dict(step.parameters) for step in group}
    found = EFFECTS[group[0].name].make(places, wanted, read)
    for name, array in found.items():
        if not np.isfinite(array).all():
            raise places.field.damage(f"its heights give values of {name} that are not finite")
    return found


def _make(
    group: Group, places: Places, which: np.ndarray | None, values: dict[str, np.ndarray], kept: Kept, once: set[str]
) -> int:
    """Put the group's values into `values`; returns of how many elements they were computed. which: the places that are
    not known, where `values` has the others; None for all of them. once: see `_held_once`."""
    read = {name: values[name] for step in group for name in EFFECTS[step.name].reads_with(step.parameters)}
    if which is None:
        for name, array in _computed(group, places, read).items():
            kept.put(name, array, name in once)
            values[name] = array
        return len(places)
    if len(which):
        some = {name: array[which] for name, array in read.items()}
        for name, array in _computed(group, places.only(which), some).items():
            values[name][which] = array
    return len(which)
