# SPDX-License-Identifier: GPL-3.0-or-later
"""Weights of splat layers at points by their rules; see cbt_terrain/attributes/splat_rules.py.

A splat layer is a material; its weight at a point is the fraction of the ground that it covers there. Weights are
multiples of 2^-24 that add up to 1, so that any sum of them is exact in float32.
"""

import warp as wp

from ..field.noise import scramble
from ..unchecked import item_at
from .logarithm import natural_log
from .pyramid import inverse_power

MAX_LAYERS = wp.constant(12)
Weights = wp.types.vector(length=12, dtype=wp.float32)

# Kinds of rules: a value, its decimal logarithm, the component in a direction, the layer's noise, another layer, an
# image.
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
# A sum of weights below this counts as 0.
MIN_SUM = wp.constant(wp.float32(1e-12))


@wp.struct
class SplatRule:
    """A rule: the weight of a layer by a value, 1 between `low` and `high`, 1/2 at these limits, 0 outside."""

    kind: wp.int32  # VALUE .. IMAGE
    at: wp.int32  # row of `Splat.values`, index of the layer, or the image's first pixel in `Splat.images`
    low: wp.float32
    high: wp.float32
    edge: wp.float32  # width of the soft edges with their middles at `low` and `high`, in the value's unit
    per_edge: wp.float32  # 1 / edge
    sine: wp.float32  # of the azimuth of a DIRECTION
    cosine: wp.float32
    rows: wp.int32  # of an IMAGE
    columns: wp.int32


@wp.struct
class SplatLayer:
    """A layer with the rules first .. end - 1."""

    first: wp.int32
    end: wp.int32
    on_top: wp.int32  # 1: it covers the layers before it; 0: it shares the ground with them
    strength: wp.float32  # factor on the weight of its rules
    ragged: wp.float32  # amplitude of the noise that shifts the rules' values, in widths of their edges
    noise_size: wp.float64  # length of the longest waves, metres; 0: no noise
    seed: wp.uint32


@wp.struct
class Splat:
    """Layers and the values that their rules read."""

    layers: wp.array(dtype=SplatLayer)
    layer_count: wp.int32
    rules: wp.array(dtype=SplatRule)
    values: wp.array(dtype=wp.float32)  # a row of `count` numbers for each quantity, two rows for directions
    count: wp.int64  # points
    images: wp.array(dtype=wp.float32)  # pixels of all images
    west: wp.float64  # the raster's south-west corner, metres
    south: wp.float64
    across: wp.float64  # the raster's size to the east and north, metres
    up: wp.float64
    step: wp.float64  # metres between samples of the raster


@wp.func
def smooth(x: wp.float32) -> wp.float32:
    """Return the smoothstep of x: 0 below 0, 1 above 1."""
    t = wp.clamp(x, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


@wp.func
def lattice_value(row: wp.uint32, i: wp.uint32) -> wp.float32:
    """Return the random value of lattice point i of a row, -1 .. 1. row: hash of the row's number."""
    return wp.float32(wp.int32(scramble(row + i))) * 4.656612873077393e-10


@wp.func
def fade(t: wp.float32) -> wp.float32:
    """Return Perlin's quintic fade of t in 0 .. 1 (2002, "Improving noise"), smooth to the second derivative."""
    return t * t * t * (t * (t * 6.0 - 15.0) + 10.0)


@wp.func
def wave(x: wp.float64, y: wp.float64, seed: wp.uint32) -> wp.float32:
    """Return value noise at (x, y), -1 .. 1, with a lattice spacing of 1; another seed gives other noise."""
    column = wp.floor(x)
    row = wp.floor(y)
    i = wp.uint32(wp.int64(column))
    j = wp.uint32(wp.int64(row))
    u = fade(wp.float32(x - column))
    south = scramble(j + seed)
    north = scramble(j + wp.uint32(1) + seed)
    low = wp.lerp(lattice_value(south, i), lattice_value(south, i + wp.uint32(1)), u)
    high = wp.lerp(lattice_value(north, i), lattice_value(north, i + wp.uint32(1)), u)
    return wp.lerp(low, high, fade(wp.float32(y - row)))


@wp.func
def noise_of(layer: SplatLayer, x: wp.float64, y: wp.float64, footprint: wp.float64) -> wp.float32:
    """Return the layer's noise at (x, y) metres, -1 .. 1, a sum of octaves that a pixel can show.

    An octave fades out as its waves shrink from two footprints to one. footprint: metres that a pixel covers. Without a
    `noise_size` the result is 0.
    """
    total = wp.float32(0.0)
    if layer.noise_size > wp.float64(0.0):
        per_wave = wp.float64(1.0) / layer.noise_size
        footprints_per_wave = wp.float32(layer.noise_size / footprint)
        amplitude = wp.float32(8.0 / 15.0)  # amplitudes add up to 1
        octave = wp.int32(0)
        while octave < OCTAVES and footprints_per_wave > 1.0:
            waves = wave(x * per_wave, y * per_wave, layer.seed + wp.uint32(octave) * GOLDEN)
            total += amplitude * wp.min(footprints_per_wave - 1.0, 1.0) * waves
            amplitude *= 0.5
            footprints_per_wave *= 0.5
            per_wave *= wp.float64(2.0)
            octave += 1
    return total


@wp.func
def image_at(images: wp.array(dtype=wp.float32), r: SplatRule, u: wp.float64, v: wp.float64) -> wp.float32:
    """Return a rule's image at (u, v), 0 .. 1 over the image, bilinearly between the centres of its pixels.

    images: pixels of all images, row by row; those of the rule's image begin at r.at.
    """
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
def rule_weight(q: wp.float32, low: wp.float32, high: wp.float32, per_edge: wp.float32, kind: wp.int32) -> wp.float32:
    """Return the weight of a rule for the value q: 1 between `low` and `high`, 1/2 at these limits, 0 outside.

    It changes over the soft edges, whose middles are at the limits. per_edge: 1 / width of an edge. kind: the rule's
    kind; edges are linear for LAYER and IMAGE, whose values are weights themselves, and a smoothstep for the others.
    """
    above_low = (q - low) * per_edge + 0.5
    below_high = (high - q) * per_edge + 0.5
    nearer = wp.min(above_low, below_high)
    weight = wp.float32(1.0)
    if nearer <= 0.0:
        weight = 0.0
    elif nearer < 1.0 and kind >= LAYER:
        weight = wp.min(above_low, 1.0) * wp.min(below_high, 1.0)
    elif nearer < 1.0:
        weight = smooth(above_low) * smooth(below_high)
    return weight


@wp.func
def covers_at(s: Splat, v: wp.int32, x: wp.float64, y: wp.float64, footprint: wp.float64) -> Weights:
    """Return each layer's cover at point v before layers share the ground: its strength times its rules' weights.

    x, y: position of the point, metres from the raster's south-west corner. footprint: metres that a pixel covers. A
    rule reads what its kind says, at `at`: a row of s.values, the cover of a layer before its own (LAYER), an image
    (IMAGE) or the layer's noise (NOISE). Entries beyond the layers are 0.
    """
    covers = Weights()
    for number in range(s.layer_count):
        layer = s.layers[number]
        noise = wp.float32(0.0)
        cover = layer.strength
        # Noise moves q by up to `ragged` widths of an edge. It is expensive and does not matter far from a rule's
        # limits. Rules without it are evaluated in turn 0, those that need it in turn 1, left out if none does.
        turn = wp.int32(0)
        turns = wp.int32(1)
        while turn < turns and cover > 0.0:
            if turn == 1:
                noise = noise_of(layer, x, y, footprint)
            for k in range(layer.first, layer.end):
                if cover > 0.0:
                    r = s.rules[k]
                    q = wp.float32(0.0)
                    needs_noise = wp.int32(0)
                    if r.kind <= DIRECTION:  # a rule by one of the values
                        entry = wp.int64(r.at) * s.count + wp.int64(v)
                        q = item_at(s.values, entry)
                        if r.kind == LOGARITHM:
                            q = wp.float32(natural_log(wp.float64(q)) * wp.float64(0.4342944819032518))  # 1 / ln 10
                        elif r.kind == DIRECTION:
                            q = r.sine * q + r.cosine * item_at(s.values, entry + s.count)
                        to_limit = wp.min(wp.abs(q - r.low), wp.abs(q - r.high))
                        needs_noise = wp.where(layer.ragged > 0.0 and to_limit < (0.5 + layer.ragged) * r.edge, 1, 0)
                        if turn == 1:
                            q += layer.ragged * r.edge * noise
                    elif r.kind == NOISE:
                        q = noise
                        needs_noise = 1
                    elif r.kind == LAYER:
                        q = covers[r.at]
                    elif turn == 0:
                        q = image_at(s.images, r, x / s.across, y / s.up)  # the image covers the raster
                    if needs_noise == turn:
                        cover *= rule_weight(q, r.low, r.high, r.per_edge, r.kind)
                    elif needs_noise == 1:
                        turns = wp.int32(2)
            turn += 1
        covers[number] = cover
    return covers


@wp.func
def normalise(w: Weights, count: wp.int32) -> Weights:
    """Return the first `count` weights of w scaled to a sum of 1, as multiples of 2^-24.

    The largest weight absorbs the rounding. If all are 0, the first becomes 1.
    """
    total = wp.float32(0.0)
    largest = wp.int32(0)
    for k in range(count):
        total += w[k]
        if w[k] > w[largest]:
            largest = k
    units_left = wp.int32(16777216)
    out = Weights()
    if total > MIN_SUM:
        scale = UNITS / total
        for k in range(count):
            if k != largest:
                units = wp.min(wp.int32(w[k] * scale), units_left)
                units_left -= units
                out[k] = wp.float32(units) * UNIT
    out[largest] = wp.float32(units_left) * UNIT
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
    """Compute the weights of all splat layers at point `offset + tid`.

    s: the layers, and the values that their rules read. positions: metres. levels: log2 of the samples that a pixel
    covers at each point. wanted: bit k requests layers 4 k .. 4 k + 3, written to out_(k + 1): out_1, out_2, out_3.
    """
    v = offset + wp.tid()
    x = wp.float64(positions[v][0]) - s.west
    y = wp.float64(positions[v][1]) - s.south
    level = wp.clamp(levels[v], -30.0, 30.0)
    whole = wp.int32(wp.floor(level))
    # The footprint is linear between two levels, since powers of the C library differ between machines.
    footprint = s.step * inverse_power(-whole) * wp.float64(1.0 + level - float(whole))
    covers = covers_at(s, v, x, y, footprint)
    w = Weights()
    sum = wp.float32(0.0)
    for k in range(s.layer_count):
        cover = covers[k]
        if s.layers[k].on_top != 0 and k > 0:  # it covers the layers before it
            if sum <= MIN_SUM:  # bare ground has the first layer
                w[0] = 1.0
                sum = 1.0
            weight = wp.min(cover, 1.0)
            factor = (1.0 - weight) / sum
            for below in range(k):
                w[below] = w[below] * factor
            w[k] = weight
            sum = wp.float32(1.0)
        else:
            w[k] = cover
            sum += cover
    w = normalise(w, s.layer_count)
    if (wanted & 1) != 0:
        out_1[v] = wp.vec4f(w[0], w[1], w[2], w[3])
    if (wanted & 2) != 0:
        out_2[v] = wp.vec4f(w[4], w[5], w[6], w[7])
    if (wanted & 4) != 0:
        out_3[v] = wp.vec4f(w[8], w[9], w[10], w[11])
