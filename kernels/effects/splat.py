# SPDX-License-Identifier: GPL-3.0-or-later
"""Weights of splat layers at places, from what their rules are about; see cbt_terrain/effects/splat_rules.py.

Weights are multiples of 2^-24 that add up to 1: whatever some of them add up to, in any order, is then exact in
float32.
"""

import warp as wp

from ..field.noise import scramble
from ..unchecked import item_at
from .logarithm import natural_log

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
GOLDEN = wp.constant(wp.uint32(0x9E3779B9))
UNITS = wp.constant(wp.float32(16777216.0))  # 2^24
UNIT = wp.constant(wp.float32(5.9604644775390625e-08))
# A sum of weights below this is nothing: what would be shared has no digits left.
LEAST = wp.constant(wp.float32(1e-12))


@wp.struct
class SplatRule:
    """`at`: the row of `values`, the number of the layer, or the first sample of the image, which is [rows, columns].
    `sine`, `cosine`: of the direction."""

    kind: wp.int32
    at: wp.int32
    low: wp.float32
    high: wp.float32
    edge: wp.float32
    per_edge: wp.float32
    sine: wp.float32
    cosine: wp.float32
    rows: wp.int32
    columns: wp.int32


@wp.struct
class SplatLayer:
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

    layers: wp.array(dtype=SplatLayer)
    layer_count: wp.int32
    rules: wp.array(dtype=SplatRule)
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
def corner(row: wp.uint32, i: wp.uint32) -> wp.float32:
    """Value of the lattice point i of a hashed row, in -1 .. 1."""
    return wp.float32(wp.int32(scramble(row + i))) * 4.656612873077393e-10


@wp.func
def fade(t: wp.float32) -> wp.float32:
    """Perlin's quintic ("Improving noise", 2002)."""
    return t * t * t * (t * (t * 6.0 - 15.0) + 10.0)


@wp.func
def wave(x: wp.float64, y: wp.float64, seed: wp.uint32) -> wp.float32:
    """Value noise in -1 .. 1, lattice points one apart."""
    column = wp.floor(x)
    row = wp.floor(y)
    i = wp.uint32(wp.int64(column))
    j = wp.uint32(wp.int64(row))
    u = fade(wp.float32(x - column))
    south = scramble(j + seed)
    north = scramble(j + wp.uint32(1) + seed)
    low = wp.lerp(corner(south, i), corner(south, i + wp.uint32(1)), u)
    high = wp.lerp(corner(north, i), corner(north, i + wp.uint32(1)), u)
    return wp.lerp(low, high, fade(wp.float32(y - row)))


@wp.func
def noise_of(layer: SplatLayer, x: wp.float64, y: wp.float64, footprint: wp.float64) -> wp.float32:
    """Noise in -1 .. 1 of octaves from the layer's size on, those that are shorter than two footprints fading out."""
    sum = wp.float32(0.0)
    if layer.noise_size > wp.float64(0.0):
        per = wp.float64(1.0) / layer.noise_size
        seen = wp.float32(layer.noise_size / footprint)  # footprints in a wave
        amount = wp.float32(8.0 / 15.0)  # they add up to 1
        octave = wp.int32(0)
        while octave < OCTAVES and seen > 1.0:
            waves = wave(x * per, y * per, layer.seed + wp.uint32(octave) * GOLDEN)
            sum += amount * wp.min(seen - 1.0, 1.0) * waves
            amount *= 0.5
            seen *= 0.5
            per *= wp.float64(2.0)
            octave += 1
    return sum


@wp.func
def image_at(images: wp.array(dtype=wp.float32), r: SplatRule, u: wp.float64, v: wp.float64) -> wp.float32:
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
def covered(q: wp.float32, low: wp.float32, high: wp.float32, per_edge: wp.float32, kind: wp.int32) -> wp.float32:
    """The band of a rule; straight edges where a quantity is a share itself."""
    a = (q - low) * per_edge + 0.5
    b = (high - q) * per_edge + 0.5
    least = wp.min(a, b)
    part = wp.float32(1.0)
    if least <= 0.0:
        part = 0.0
    elif least < 1.0 and kind >= LAYER:
        part = wp.min(a, 1.0) * wp.min(b, 1.0)
    elif least < 1.0:
        part = smooth(a) * smooth(b)
    return part


@wp.func
def covers_at(s: Splat, v: wp.int32, x: wp.float64, y: wp.float64, footprint: wp.float64) -> Weights:
    """How much of a place each layer covers by its own rules."""
    covers = Weights()
    for number in range(s.layer_count):
        layer = s.layers[number]
        noise = wp.float32(0.0)
        cover = layer.strength
        # Noise is dear, and far from its limits it changes nothing of a rule: rules that need it have the second turn.
        turn = wp.int32(0)
        turns = wp.int32(1)
        while turn < turns and cover > 0.0:
            if turn == 1:
                noise = noise_of(layer, x, y, footprint)
            for k in range(layer.first, layer.end):
                if cover > 0.0:
                    r = s.rules[k]
                    q = wp.float32(0.0)
                    needed = wp.int32(0)
                    if r.kind <= DIRECTION:
                        at = wp.int64(r.at) * s.count + wp.int64(v)
                        q = item_at(s.values, at)
                        if r.kind == LOGARITHM:
                            q = wp.float32(natural_log(wp.float64(q)) * wp.float64(0.4342944819032518))
                        elif r.kind == DIRECTION:
                            q = r.sine * q + r.cosine * item_at(s.values, at + s.count)
                        near = wp.min(wp.abs(q - r.low), wp.abs(q - r.high))
                        needed = wp.where(layer.ragged > 0.0 and near < (0.5 + layer.ragged) * r.edge, 1, 0)
                        if turn == 1:
                            q += layer.ragged * r.edge * noise
                    elif r.kind == NOISE:
                        q = noise
                        needed = 1
                    elif r.kind == LAYER:
                        q = covers[r.at]
                    elif turn == 0:
                        q = image_at(s.images, r, x / s.across, y / s.up)
                    if needed == turn:
                        cover *= covered(q, r.low, r.high, r.per_edge, r.kind)
                    elif needed == 1:
                        turns = wp.int32(2)
            turn += 1
        covers[number] = cover
    return covers


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
        scale = UNITS / total
        for k in range(count):
            if k != largest:
                units = wp.min(wp.int32(w[k] * scale), rest)
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
    whole = wp.int32(level)
    # Between two levels the footprint is taken linear: a power of two by the C library is not the same everywhere.
    footprint = s.step * wp.float64(wp.int32(1) << whole) * wp.float64(1.0 + level - float(whole))
    covers = covers_at(s, v, x, y, footprint)
    w = Weights()
    sum = wp.float32(0.0)
    for k in range(s.layer_count):
        cover = covers[k]
        if s.layers[k].on_top != 0 and k > 0:
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
