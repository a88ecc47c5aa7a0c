# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluation of a plan on a surface: each attribute once, and only at points that the last surface lacks.

A step of a plan is the request for one attribute. Its family, PICTURE or GEOMETRY, is the kind of its readers. For each
family every point has a level of the height pyramid, the scale at which attributes are evaluated there: pictures follow
the pixel footprint, geometry has one scale.
"""

import time
import weakref
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from ...kernels.effects import footprint as footprint_kernels
from ...kernels.effects import keep as keep_kernels
from ..field.heightfield import HeightField
from ..history.frame_history import FrameHistory
from ..mesh.attributes import POINT as POINTS
from ..mesh.attributes import Attribute
from ..mesh.surface import Surface
from ..view.view import View
from .attribute import GEOMETRY, AttributeRequest, SamplePoints
from .catalogue import ATTRIBUTES
from .plan import AttributePlan, kernels_of_steps, plan
from .scale import fixed_level, footprint_levels, limit_levels
from .values import EffectValues, ValueSource

KERNELS = footprint_kernels, keep_kernels

Group = list[AttributeRequest]  # attributes of one call
ANY_LEVEL = "ANY_LEVEL"  # in place of a family: of attributes without a scale, whose values depend on no level
BAND = 1 << 18  # samples that are evaluated together


def kernels_of(plan: AttributePlan) -> list[ModuleType]:
    """Return the modules of kernels that an evaluation of a plan launches, so that they can be compiled before."""
    return list(dict.fromkeys([*KERNELS, *kernels_of_steps(plan)])) if plan.steps else []


@dataclass(frozen=True)
class Ran:
    """The cost of one step of a plan."""

    ms: float  # an even share of a common call
    nbytes: int  # of its values
    computed: int  # points whose values were computed; 0 if all were reused


@dataclass(frozen=True)
class EffectRequest:
    """A plan and the surface on which its attributes are evaluated.

    views: cameras, whose finest pixel footprint is the scale of attributes in pictures; without any it is that of the
    finest samples. placement: float64 [4, 4], maps the terrain's space to the world, None for the identity. Heights
    are `height * vertical_scale + vertical_offset` metres. geometry_metres: metres between samples of the scale of
    attributes in geometry, 0 for the finest samples.
    """

    plan: AttributePlan
    surface: Surface
    views: Sequence[View] = ()
    placement: np.ndarray | None = None
    vertical_scale: float = 1.0
    vertical_offset: float = 0.0
    geometry_metres: float = 0.0

    def key(self, heights: HeightField) -> tuple:
        """Return everything that the values depend on, except the surface: equal keys give equal values."""
        placement = b"" if self.placement is None else np.asarray(self.placement, np.float64).tobytes()
        views = tuple(view.key() for view in self.views)
        scale = float(self.vertical_scale), float(self.vertical_offset)
        return self.plan, heights.key, scale, placement, views, self.geometry_metres


@dataclass(frozen=True)
class Evaluated:
    """Attributes by name, the cost of each step, and the bytes of all values in the history.

    The arrays are valid until the next evaluation with the same history.
    """

    attributes: dict[str, Attribute]
    ran: dict[str, Ran]
    nbytes: int = 0


def evaluate(
    heights: HeightField,
    request: EffectRequest,
    history: FrameHistory,
    threads: int = 1,
) -> Evaluated:
    """Evaluate attributes on a surface; points of the last surface reuse its values.

    Values are functions of a point, a level, parameters and heights alone, so that the bytes do not depend on the
    history. `history`: owns the values of the last surface; another thread that evaluates with it waits.
    """
    with history.alone():
        values, history.values = history.values, None  # discarded if this is interrupted
        if not request.plan.steps:
            return Evaluated({}, {})
        values = EffectValues(threads) if values is None else values
        last, request_key = values.source, request.key(heights)
        ran = {step.name: Ran(ms=0.0, nbytes=0, computed=0) for step in request.plan.steps}
        if request.surface is not last.surface() or request_key != last.request:
            step_keys = _keys_of_steps(request, heights)
            results = _evaluate_steps(heights, request, values, step_keys, ran)
            names = request.plan.attributes
            attributes = {name: Attribute(results[name], POINTS, ATTRIBUTES[name].unit) for name in names}
            values.source = ValueSource(weakref.ref(request.surface), request_key, step_keys, attributes)
        history.values = values
        return Evaluated(values.source.attributes, ran, values.nbytes)


def _evaluate_steps(
    heights: HeightField,
    request: EffectRequest,
    values: EffectValues,
    step_keys: dict[str, tuple],
    ran: dict[str, Ran],
) -> dict[str, np.ndarray]:
    """Return the values of all steps by name, and record their costs in `ran`.

    heights: field that attributes read. request: the plan of steps, the surface and its views. values: arrays of the
    last surface (`values.source`), moved to this one. step_keys: what each step's values depend on, except the surface;
    while it is unchanged, values of the last surface are reused.
    """
    steps, last = request.plan.steps, values.source  # `last.keys`: by step, the key of its values of the last surface
    # Points with their levels, and indices of new points, by family.
    points, fresh = _locate_points(heights, request, values)
    if not all(ATTRIBUTES[step.name].scaled for step in steps):
        fresh[ANY_LEVEL] = values.new_points()
    nonzero = [step for step in steps if not ATTRIBUTES[step.name].is_nothing(step.parameters)]
    reused = {step.name for step in nonzero if last.keys.get(step.name) == step_keys[step.name]}
    # By name, the indices of the points to compute; None, which is all points, where nothing is reused. Attributes that
    # are not `scaled` depend on no level, so only points that the last surface lacks are new for them.
    to_compute = {step.name: fresh[step.family if ATTRIBUTES[step.name].scaled else ANY_LEVEL] for step in nonzero}
    to_compute |= dict.fromkeys(to_compute.keys() - reused)
    # Arrays of this surface, filled at the points that the last one has.
    results = values.reuse({name: ATTRIBUTES[name].width for name, which in to_compute.items() if which is not None})
    for step in set(steps) - set(nonzero):  # their parameters make them 0 everywhere
        results[step.name] = values.zeros(ATTRIBUTES[step.name].width)
    for group in _group_steps(nonzero, reused):
        start = time.perf_counter()
        computed = _complete_group(group, points[group[0].family], to_compute[group[0].name], results, values)
        ms = (time.perf_counter() - start) * 1e3 / len(group)
        ran |= {step.name: Ran(ms, results[step.name].nbytes, computed) for step in group}
    values.forget_others({*to_compute}, {*points})
    return results


def _locate_points(
    heights: HeightField, request: EffectRequest, values: EffectValues
) -> tuple[dict[str, SamplePoints], dict[str, np.ndarray | None]]:
    """Return the surface's points with their levels, and the indices of the new ones, each by family.

    A family is the kind of reader, PICTURE or GEOMETRY, which decides the scale. Points are new if the last surface
    lacks them or has them at another level; None in place of indices: so many are new that all points are computed.
    request: the surface, its views and the plan. `values`, those of the last surface, move to this one.
    """
    scaling, positions = (request.vertical_scale, request.vertical_offset), request.surface.positions
    values.move_to(positions)
    points, fresh = {}, {}
    for family in sorted({step.family for step in request.plan.steps}):
        levels, last_levels = values.swap_levels(family)
        if family == GEOMETRY:
            levels[:] = fixed_level(heights, request.geometry_metres)
            limit_levels(heights, positions, levels, values.threads)
        else:
            footprint_levels(heights, positions, request.views, request.placement, values.threads, levels)
        points[family] = SamplePoints(heights, positions, levels, float(scaling[0]), float(scaling[1]), values.threads)
        fresh[family] = values.find_fresh(levels, last_levels)
    return points, fresh


def values_at(points: SamplePoints, requests: Iterable[AttributeRequest]) -> dict[str, np.ndarray]:
    """Return the values of attributes and of those that they read at points, by name, without a history.

    Raises TerrainError for parameters that cannot be used, and for values that are not finite. requests: the attributes
    with their parameters.
    """
    steps = list(plan(requests).steps)
    values: dict[str, np.ndarray] = {}
    while steps:  # one call computes the first step and all others of its function that are ready
        make = ATTRIBUTES[steps[0].name].make
        ready = [step for step in steps if {*ATTRIBUTES[step.name].reads_with(step.parameters)} <= {*values}]
        group = [step for step in ready if ATTRIBUTES[step.name].make is make]
        values |= _compute_group(group, points, values)
        steps = [step for step in steps if step not in group]
    return values


def on_samples(
    field: HeightField,
    requests: Iterable[AttributeRequest],
    vertical_scale: float = 1.0,
    vertical_offset: float = 0.0,
    threads: int = 1,
    level: float = 0.0,
) -> Iterator[tuple[slice, dict[str, np.ndarray]]]:
    """Yield attributes of a raster by strips of rows: a slice of rows (row 0 south), and the values there by name.

    These are float32 [rows, columns] or [rows, columns, width]. level: level of the height pyramid, 0 for the raster's
    own scale. Masks and splat layers are computed with this function. Heights are multiplied by `vertical_scale`, then
    `vertical_offset` metres are added.
    """
    lattice, requests = field.lattice, list(requests)
    west, south, _, _ = lattice.rectangle()
    x = west + np.arange(lattice.width) * lattice.step_x
    at_once = max(1, BAND // lattice.width)
    for first in range(0, lattice.height, at_once):
        rows = slice(first, min(first + at_once, lattice.height))
        y = south + np.arange(rows.start, rows.stop) * lattice.step_y
        z = field.heights(rows).astype(np.float64) * vertical_scale + vertical_offset
        positions = np.stack([*np.meshgrid(x, y), z], -1).astype(np.float32)
        levels = np.full(z.size, level, np.float32)
        points = SamplePoints(field, positions.reshape(-1, 3), levels, vertical_scale, vertical_offset, threads)
        yield rows, {name: v.reshape(*z.shape, *v.shape[1:]) for name, v in values_at(points, requests).items()}


def _keys_of_steps(request: EffectRequest, heights: HeightField) -> dict[str, tuple]:
    """Return a key of each step's values: ground, scale, parameters and the keys of attributes that it reads.

    The points and the levels of pictures are not in it, since they change with every surface.
    """
    keys: dict[str, tuple] = {}
    level = fixed_level(heights, request.geometry_metres)
    ground = heights.key, float(request.vertical_scale), float(request.vertical_offset)
    for step in request.plan.steps:
        effect = ATTRIBUTES[step.name]
        numbers = tuple(sorted((effect.defaults() | dict(step.parameters)).items()))
        scale = level if step.family == GEOMETRY and effect.scaled else None
        read = tuple(keys[name] for name in effect.reads_with(step.parameters))
        keys[step.name] = (step.name, effect.version, numbers, step.family, scale, ground, read)
    return keys


def _group_steps(steps: Sequence[AttributeRequest], reused: set[str]) -> list[Group]:
    """Group steps that one call computes: they share the function, the family and the points to compute.

    A group comes after those of the attributes that it reads. reused: names of steps with values of the last surface.
    """
    group_of: dict[str, int] = {}  # index in `order` of each step's group
    order: list[tuple[tuple, Group]] = []
    for step in steps:
        kind = (ATTRIBUTES[step.name].make, step.family, ATTRIBUTES[step.name].scaled, step.name in reused)
        last_read = max(
            (group_of.get(name, -1) for name in ATTRIBUTES[step.name].reads_with(step.parameters)), default=-1
        )
        # The first group of this kind after those that compute what the step reads, or a new one.
        number = next((k for k in range(last_read + 1, len(order)) if order[k][0] == kind), len(order))
        if number == len(order):
            order.append((kind, []))
        order[number][1].append(step)
        group_of[step.name] = number
    return [group for _, group in order]


def _compute_group(
    group: Sequence[AttributeRequest], points: SamplePoints, read: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return the values at points of attributes that one function computes, by name.

    Raises TerrainError for a value that is not finite. read: attributes that they depend on, at the same points. group:
    requests for these attributes.
    """
    wanted = {step.name: ATTRIBUTES[step.name].defaults() | dict(step.parameters) for step in group}
    results = ATTRIBUTES[group[0].name].make(points, wanted, read)
    for name, array in results.items():
        if not np.isfinite(array).all():
            raise points.field.raster.damage(f"its heights give values of {name} that are not finite")
    return results


def _complete_group(
    group: Group,
    points: SamplePoints,
    which: np.ndarray | None,
    results: dict[str, np.ndarray],
    values: EffectValues,
) -> int:
    """Compute a group's values at the points that lack them, into `results`; return the number of these points.

    which: indices of the points to compute, where `results` has the others from the last surface; None for all. values:
    stores whole arrays for the next surface.
    """
    read = {name: results[name] for step in group for name in ATTRIBUTES[step.name].reads_with(step.parameters)}
    if which is None:
        for name, array in _compute_group(group, points, read).items():
            values.put(name, array)
            results[name] = array
        return len(points)
    if len(which):
        read_there = {name: array[which] for name, array in read.items()}
        for name, array in _compute_group(group, points.only(which), read_there).items():
            results[name][which] = array
    return len(which)
