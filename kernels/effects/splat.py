# SPDX-License-Identifier: GPL-3.0-or-later
"""Weights of splat layers at places, from what their rules are about; see cbt_terrain/effects/splat_rules.py.

Weights are multiples of 2^-24 that add up to 1: whatever some of them add up to, in any order, is then exact in
float32.
"""

import warp as wp

from ..field.noise import value_noise
from .logarithm import natural_log

wp.set_module_options({"enable_backward": False})

MOST_LAYERS = wp.constant(12)
Weights = wp.types.vector(length=12, dtype=wp.float32)

# Kinds of rules: the value itself, its logarithm to the base 10, the part of a direction, the layer's noise, another
# layer, an image.
VALUE = wp.constant(0)
LOGARITHM = wp.constant(1)
DIRECTION = wp.constant(2)
NOISE = wp.constant(3)
LAYER = wp.constant(4)
IMAGE = wp.constant(5)

OCTAVES = wp.constant(4)
UNITS = wp.constant(wp.float32(16777216.0))  # 2^24
UNIT = wp.constant(wp.float32(5.9604644775390625e-08))
# A sum of weights below this is nothing: what would be shared has no digits left.
LEAST = wp.constant(wp.float32(1e-12))


@wp.struct
class Rule:
    """`at`: the row of `values`, the number of the layer, or the first sample of the image, which is [rows, columns].
    `sine`, `cosine`: of the direction."""

    kind: wp.int32
    at: wp.int32
    low: wp.float32
    high: wp.float32
    edge: wp.float32
    sine: wp.float32
    cosine: wp.float32
    rows: wp.int32
    columns: wp.int32


@wp.struct
class Layer:
    """Its rules are those from `first` to `end`. `noise_size`: metres, 0 for no noise."""

    first: wp.int32
    end: wp.int32
    on_top: wp.int32
    strength: wp.float32
    ragged: wp.float32
    noise_size: wp.float64
    seed: wp.uint32


@wp.struct
class Splat:
    """Layers, and what their rules read. `values`: a row of `count` numbers for each quantity; directions have two.

    Places are in metres from the raster's south-west corner at `west`, `south`; it is `across` by `up` metres.
    """

    layers: wp.array(dtype=Layer)
    layer_count: wp.int32
    rules: wp.array(dtype=Rule)
    values: wp.array(dtype=wp.float32)
    count: wp.int64
    images: wp.array(dtype=wp.float32)
    west: wp.float64
    south: wp.float64
    across: wp.float64
    up: wp.float64
    step: wp.float64  # metres between samples of the raster


@wp.func
def smooth(x: wp.float32) -> wp.float32:
    """0 below 0, 1 above 1."""
    t = wp.clamp(x, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


@wp.func
def waves(x: wp.float64, y: wp.float64, size: wp.float64, footprint: wp.float64, seed: wp.uint32) -> wp.float32:
    """Noise in -1 .. 1 of octaves from `size` metres on, those that are shorter than two footprints fading out."""
    sum = wp.float64(0.0)
    total = wp.float64(0.0)
    amount = wp.float64(1.0)
    per = wp.float64(1.0) / size
    for k in range(OCTAVES):
        seen = wp.clamp(wp.float64(1.0) / (per * footprint) - wp.float64(1.0), wp.float64(0.0), wp.float64(1.0))
        total += amount
        if seen > wp.float64(0.0):
            octave = value_noise(x * per, y * per, seed + wp.uint32(k) * wp.uint32(0x9E3779B9))
            sum += amount * seen * octave[2]
        amount *= wp.float64(0.5)
        per *= wp.float64(2.0)
    return wp.float32(sum / total)


@wp.func
def image_at(images: wp.array(dtype=wp.float32), r: Rule, u: wp.float64, v: wp.float64) -> wp.float32:
    """Bilinear between the middles of pixels; u, v in 0 .. 1 over the image."""
    x = wp.clamp(u * wp.float64(r.columns) - wp.float64(0.5), wp.float64(0.0), wp.float64(r.columns - 1))
    y = wp.clamp(v * wp.float64(r.rows) - wp.float64(0.5), wp.float64(0.0), wp.float64(r.rows - 1))
    i = wp.int32(x)
    j = wp.int32(y)
    east = wp.min(i + 1, r.columns - 1)
    south = r.at + j * r.columns
    north = r.at + wp.min(j + 1, r.rows - 1) * r.columns
    s = wp.float32(x - wp.float64(i))
    t = wp.float32(y - wp.float64(j))
    low = images[south + i] + (images[south + east] - images[south + i]) * s
    high = images[north + i] + (images[north + east] - images[north + i]) * s
    return low + (high - low) * t


@wp.func
def covered(q: wp.float32, low: wp.float32, high: wp.float32, edge: wp.float32, kind: wp.int32) -> wp.float32:
    """The band of a rule; straight edges where a quantity is a share itself."""
    a = (q - low) / edge + 0.5
    b = (high - q) / edge + 0.5
    part = wp.float32(0.0)
    if kind >= LAYER:
        part = wp.clamp(a, 0.0, 1.0) * wp.clamp(b, 0.0, 1.0)
    else:
        part = smooth(a) * smooth(b)
    return part


@wp.func
def cover_of(
    s: Splat, layer: Layer, v: wp.int32, x: wp.float64, y: wp.float64, level: wp.float32, covers: Weights
) -> wp.float32:
    """How much of a place a layer covers by its own rules; `covers` has that of those before it."""
    noise = wp.float32(0.0)
    if layer.noise_size > wp.float64(0.0):
        whole = wp.int32(level)
        # Between two levels the footprint is taken linear: a power of two by the C library is not the same everywhere.
        footprint = s.step * wp.float64(wp.int32(1) << whole) * (wp.float64(1.0) + wp.float64(level - float(whole)))
        noise = waves(x, y, layer.noise_size, footprint, layer.seed)
    cover = layer.strength
    for k in range(layer.first, layer.end):
        if cover > 0.0:
            r = s.rules[k]
            q = noise
            if r.kind <= DIRECTION:
                at = wp.int64(r.at) * s.count + wp.int64(v)
                q = s.values[at]
                if r.kind == LOGARITHM:
                    q = wp.float32(natural_log(wp.float64(q)) * wp.float64(0.4342944819032518))
                elif r.kind == DIRECTION:
                    q = r.sine * q + r.cosine * s.values[at + s.count]
                q += layer.ragged * r.edge * noise
            elif r.kind == LAYER:
                q = covers[r.at]
            elif r.kind == IMAGE:
                q = image_at(s.images, r, x / s.across, y / s.up)
            cover *= covered(q, r.low, r.high, r.edge, r.kind)
    return cover


@wp.func
def shares_of(w: Weights, count: wp.int32) -> Weights:
    """The weights in proportion, as multiples of 2^-24 that add up to 1: the largest takes what rounding leaves."""
    total = wp.float32(0.0)
    largest = wp.int32(0)
    for k in range(count):
        total += w[k]
        if w[k] > w[largest]:
            largest = k
    rest = wp.int32(16777216)
    out = Weights()
    if total > LEAST:
        for k in range(count):
            if k != largest:
                units = wp.min(wp.int32(w[k] / total * UNITS), rest)
                rest -= units
                out[k] = wp.float32(units) * UNIT
    out[largest] = wp.float32(rest) * UNIT
    return out


@wp.kernel
def splats(
    offset: int,
    s: Splat,
    positions: wp.array(dtype=wp.vec3f),
    levels: wp.array(dtype=wp.float32),
    wanted: int,
    out_1: wp.array(dtype=wp.vec4f),
    out_2: wp.array(dtype=wp.vec4f),
    out_3: wp.array(dtype=wp.vec4f),
):
    """Weights at the places `positions` and their levels; bit k of `wanted` asks for the k-th four layers."""
    v = offset + wp.tid()
    x = wp.float64(positions[v][0]) - s.west
    y = wp.float64(positions[v][1]) - s.south
    level = wp.clamp(levels[v], 0.0, 30.0)
    w = Weights()
    covers = Weights()
    sum = wp.float32(0.0)
    for k in range(s.layer_count):
        layer = s.layers[k]
        cover = cover_of(s, layer, v, x, y, level, covers)
        covers[k] = cover
        if layer.on_top != 0 and k > 0:
            if sum <= LEAST:  # on bare ground, which is the first layer's
                w[0] = 1.0
                sum = 1.0
            part = wp.min(cover, 1.0)
            left = (1.0 - part) / sum
            for below in range(k):
                w[below] = w[below] * left
            w[k] = part
            sum = wp.float32(1.0)
        else:
            w[k] = cover
            sum += cover
    w = shares_of(w, s.layer_count)
    if (wanted & 1) != 0:
        out_1[v] = wp.vec4f(w[0], w[1], w[2], w[3])
    if (wanted & 2) != 0:
        out_2[v] = wp.vec4f(w[4], w[5], w[6], w[7])
    if (wanted & 4) != 0:
        out_3[v] = wp.vec4f(w[8], w[9], w[10], w[11])
