# SPDX-License-Identifier: GPL-3.0-or-later
"""Splat layers: weights of up to twelve layers at a point, four for each attribute, by one kernel.

Rules read other attributes, which are computed once for all their readers. A rule is an interval of one quantity with
soft edges, and a layer covers a point by the product of its rules.
"""

import math
from collections.abc import Mapping
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np

from ..run import launch
from ..run.buffers import flat, shared
from . import splat_rules
from .attribute import AttributeDeclaration, Evaluate, ParameterValue, SamplePoints, Wanted
from .splat_rules import LAYERS, READ_FROM, Layer, Rule, attributes_of_rules, check_layers

if TYPE_CHECKING:
    import warp as wp

    from ...kernels.effects import splat as kernels

NAMES = ("splat_1", "splat_2", "splat_3")
# Width of an edge of 0, in any unit; the weight at a limit is 0.5.
MIN_EDGE = 1e-30


def make(points: SamplePoints, wanted: Wanted, read: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Compute splat weights at points: the share of the ground of each of up to twelve layers, four for each attribute.

    Shares are 0 to 1 and add up to 1; numbers beyond the last layer are 0. wanted: the parameter `layers` for each of
    splat_1, splat_2, splat_3. read: the attributes that the layers' rules read. Returns float32 [n, 4] by name. Raises
    TerrainError for layers that cannot be evaluated.
    """
    weights: dict[str, np.ndarray] = {}
    for layers in dict.fromkeys(values["layers"] for values in wanted.values()):
        names = [name for name in wanted if wanted[name]["layers"] == layers]
        weights |= _weights(points, layers, names, read)
    return weights


def _weights(
    points: SamplePoints, layers: tuple[Layer, ...], names: list[str], read: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return the weights of the layers at points, float32 [n, 4] for each of `names` (splat_1 ...).

    read: attributes that the rules read.
    """
    from ...kernels import wp
    from ...kernels.effects import splat as kernels

    field, lattice, count = points.field, points.field.lattice, len(points)
    ends = (end * points.vertical_scale + points.vertical_offset for end in (field.min_height, field.max_height))
    tables = _tables(layers, *sorted(ends))
    splat = kernels.Splat()
    splat.layers, splat.rules, splat.images = tables
    splat.layer_count, splat.count = len(layers), count
    splat.values = flat(_rule_inputs(layers, read, count), wp.float32)
    splat.west, splat.south, east, north = lattice.rectangle()
    splat.across, splat.up = east - splat.west, north - splat.south
    splat.step = max(lattice.step_x, lattice.step_y)
    weights = {name: np.empty((count, 4), np.float32) for name in names}
    unused = np.empty((0, 4), np.float32)
    outputs = [shared(weights.get(name, unused), wp.vec4f) for name in NAMES]
    bits = sum(int(1 << NAMES.index(name)) for name in names)  # of the outputs that the kernel writes
    inputs = [splat, shared(points.positions, wp.vec3f), flat(points.level, wp.float32), bits, *outputs]
    launch.spread(kernels.splats, count, inputs, step="splats", threads=points.threads, cost=2 + 2 * len(layers))
    return weights


def _rule_inputs(layers: tuple[Layer, ...], read: Mapping[str, np.ndarray], count: int) -> np.ndarray:
    """Return the attributes that rules read, one below the other, float32 [rows, n]; a direction has two rows."""
    rows = [np.atleast_2d(read[name].T) for name in attributes_of_rules(layers)]
    return np.concatenate(rows) if rows else np.empty((0, count), np.float32)


@lru_cache(maxsize=8)
def _tables(layers: tuple[Layer, ...], lowest: float, highest: float) -> "tuple[wp.array, wp.array, wp.array]":
    """Return layers, rules and image pixels as arrays for the kernel, those of all layers one after another.

    `lowest`, `highest`: metres at which relief is 0 and 1. Raises TerrainError for layers that cannot be evaluated.
    """
    from ...kernels import wp
    from ...kernels.effects import splat as kernels

    check_layers(layers)
    row, rows = 0, {}  # first row of each attribute in `_rule_inputs`
    for name in attributes_of_rules(layers):
        rows[name], row = row, row + (2 if name == READ_FROM[splat_rules.ASPECT] else 1)  # a direction has two
    structs = []
    rules: list[kernels.SplatRule] = []
    images: list[np.ndarray] = []
    for layer in layers:
        struct = kernels.SplatLayer()
        struct.first, struct.end, struct.on_top = len(rules), len(rules) + len(layer.rules), int(layer.on_top)
        struct.strength, struct.ragged, struct.noise_size = layer.strength, layer.ragged, layer.noise_size
        struct.seed = wp.uint32(layer.seed * 0x85EBCA6B & 0xFFFFFFFF)  # so that small seeds differ in high bits, too
        structs.append(struct)
        for rule in layer.rules:
            if rule.of in READ_FROM:  # the attribute that a quantity is read from
                source = rows[READ_FROM[rule.of]]
            elif rule.of == splat_rules.LAYER:
                source = rule.other
            else:  # first pixel of an image; noise has no source
                source = sum(int(image.size) for image in images)
            rules.append(_rule(rule, source, lowest, highest))
            if rule.of == splat_rules.IMAGE and rule.image is not None:
                images.append(rule.image.values.reshape(-1))
    pixels = np.concatenate(images) if images else np.empty(0, np.float32)
    # A layer without rules covers all ground; an unused rule keeps the array of rules from being empty.
    arrays = (structs, kernels.SplatLayer), (rules or [kernels.SplatRule()], kernels.SplatRule)
    return *(wp.array(items, dtype=kind, device=launch.DEVICE) for items, kind in arrays), flat(pixels, wp.float32)


def _rule(rule: Rule, source: int, lowest: float, highest: float) -> "kernels.SplatRule":
    """Convert a rule for the kernel, with limits in the unit of the values that it reads.

    source: row of the attribute, first pixel of the image, or index of the other layer; unused for noise. lowest,
    highest: heights in metres at which relief is 0 and 1. Flow is compared by its decimal logarithm, so its edge is in
    powers of ten.
    """
    from ...kernels.effects import splat as kernels

    limits, edge = np.array([rule.low, rule.high]), rule.edge
    if rule.of == splat_rules.RELIEF:
        # Level terrain has no range of heights. Any number but 0 in its place gives it the relief 0 everywhere.
        relief = highest - lowest or max(abs(lowest), 1.0)
        limits, edge = lowest + limits * relief, edge * relief
    elif rule.of == splat_rules.FLOW:
        with np.errstate(divide="ignore"):
            limits = np.log10(np.maximum(limits, 0.0))
    kinds = {
        splat_rules.ASPECT: kernels.DIRECTION,
        splat_rules.FLOW: kernels.LOGARITHM,
        splat_rules.NOISE: kernels.NOISE,
        splat_rules.LAYER: kernels.LAYER,
        splat_rules.IMAGE: kernels.IMAGE,
    }
    packed = kernels.SplatRule()
    packed.kind, packed.at = kinds.get(rule.of, kernels.VALUE), source
    packed.low, packed.high, packed.edge = *limits, edge
    packed.per_edge = 1.0 / max(edge, MIN_EDGE)  # weights rise by this; MIN_EDGE stands for a sharp edge of 0
    packed.sine, packed.cosine = math.sin(rule.direction), math.cos(rule.direction)
    if rule.image is not None:
        packed.rows, packed.columns = rule.image.values.shape
    return packed


def example(evaluate: Evaluate) -> None:
    """Assert that rock above 30 degrees covers no plane of 20 degrees and all of one of 40; weights add up to 1.

    evaluate: returns an attribute at the samples of a raster, without the two outermost on each side.
    """
    rock = Layer("Rock", (Rule("slope", low=math.radians(30), edge=math.radians(4)),), on_top=True)
    east = np.arange(17, dtype=np.float32) * 10.0
    for degrees, share in ((20, 0.0), (40, 1.0)):
        plane = np.tile(east * np.float32(math.tan(math.radians(degrees))), (17, 1))
        weights = evaluate("splat_1", plane, step=10.0, layers=(Layer("Grass"), rock))
        assert (weights == (1.0 - share, share, 0.0, 0.0)).all()


def _is_empty(first: int, values: Mapping[str, ParameterValue]) -> bool:
    """Return whether there is no splat layer with the index `first`. values: the attribute's parameters."""
    return len(values["layers"]) <= first


SPLATS = tuple(
    AttributeDeclaration(
        name=name,
        about=f"Shares of the ground that layers {4 * k + 1} to {4 * k + 4} cover; all layers add up to exactly 1",
        unit="",
        make=make,
        kernels=("effects.splat",),
        example=example,
        width=4,
        span=(0.0, 1.0),
        reads=tuple(sorted(set(READ_FROM.values()))),
        choose=lambda values: attributes_of_rules(values["layers"]),
        nothing=partial(_is_empty, 4 * k),
        parameters=(LAYERS,),
        halo="as far as the attributes of its rules",
        cost_ns=100,
        source="Bands of rules; exact shares by the method of the largest remainder",
    )
    for k, name in enumerate(NAMES)
)
