# SPDX-License-Identifier: GPL-3.0-or-later
"""Points of a scatter: candidates on the ground, the choice of those in view, and their attributes.

Square tiles of the ground repeat one pattern of points, each with another shift. A point's rank is its number in the
order in which points appear as the density grows. The plan is divided into smaller squares; each has a run of
candidates: the pattern's points in that square of its tile, from rank 0 on. Their positions depend on no view and are
cached from frame to frame. A run has its tile's column and row (`tile_x`, `tile_y`), `count` ranks from entry `first`
of `pattern.order` on, its first candidate (`at`) and the first entry for those that are chosen (`out`).
"""

import warp as wp

from ..detail.displace import with_detail
from ..field.detail import PackedLayers
from ..field.domain import Domain
from ..field.holes import is_whole
from ..field.noise import scramble
from ..mesh.displace import surface_at
from .seams import PER_RANK, Pattern, seam_density, shift_of, shift_point, tile_hash
from .seen import Views, density_of_views

UNIT = wp.constant(wp.float64(1.52587890625e-05))  # 2^-16 sides of a tile
RANKS = wp.constant(wp.int64(16384))
# Points have a size above 0 up to this times the density, and their full size up to the density.
GROWING = wp.constant(wp.float64(1.25))
TURNS = wp.constant(1024)  # number of rotations about the upright axis


@wp.struct
class CandidateRun:
    """The candidates of a square."""

    tile_x: wp.int32  # column and row of its tile
    tile_y: wp.int32
    first: wp.int32  # index of its window's first rank in `Pattern.order`
    count: wp.int32  # candidates
    at: wp.int32  # entry of the first candidate in CandidateArrays
    out: wp.int32  # first entry for its candidates in Chosen
    clear: wp.int32  # 1: the whole square is in the frame of the only view


@wp.struct
class CandidateArrays:
    """Arrays of candidates on the ground. `density`: 0 .. 1, the fraction of all ranks that exist there."""

    positions: wp.array(dtype=wp.vec3f)
    normals: wp.array(dtype=wp.vec3f)
    density: wp.array(dtype=wp.float32)


@wp.struct
class Chosen:
    """Candidates in view, run by run."""

    which: wp.array(dtype=wp.int32)  # index of the candidate
    rank: wp.array(dtype=wp.int32)
    scale: wp.array(dtype=wp.float32)  # size, 0 .. 1
    counts: wp.array(dtype=wp.int32)  # of each run


@wp.struct
class ScatterStyle:
    """Sizes and rotations of points."""

    seed: wp.uint32
    size: wp.float32  # mean size
    variation: wp.float32  # variation of the size as a fraction, in both directions
    align: wp.float32  # 0: upright; 1: along the normal
    tiles: wp.int64  # in a row of the raster
    first_tile: wp.int64  # first_y * tiles + first_x of the pattern
    cosine: wp.array(dtype=wp.float32)  # of half of each of the TURNS rotation angles
    sine: wp.array(dtype=wp.float32)


@wp.struct
class PointArrays:
    """The output arrays of points."""

    positions: wp.array(dtype=wp.vec3f)
    normals: wp.array(dtype=wp.vec3f)
    size: wp.array(dtype=wp.float32)
    id: wp.array(dtype=wp.int64)
    variant: wp.array(dtype=wp.int32)
    rotation: wp.array(dtype=wp.vec4f)


@wp.func
def is_ground(domain: Domain, valid: wp.array(dtype=wp.uint8), p: wp.vec2i) -> wp.bool:
    """Return whether lattice point p is on the raster and in no hole.

    A point on a side of a cell counts as in the cell to the north or east. valid: 0 for missing samples; empty without
    holes.
    """
    bits = domain.unit_bits - domain.levels
    i = wp.min(p[0] >> bits, domain.samples.columns - 2)
    j = wp.min(p[1] >> bits, domain.samples.rows - 2)
    has_ground = p[0] >= 0 and p[1] >= 0
    has_ground = (
        has_ground and p[0] <= (domain.samples.columns - 1) << bits and p[1] <= (domain.samples.rows - 1) << bits
    )
    if has_ground and valid.shape[0] > 0:
        has_ground = is_whole(valid, domain.samples.columns, i, j)
    return has_ground


@wp.func
def nearest_unit(units: wp.float64, samples: wp.int32, domain: Domain) -> wp.int32:
    """Return the lattice coordinate nearest to a position in lattice units, clamped to one unit outside the raster.

    samples: number of them along that axis.
    """
    end = wp.float64((samples - 1) << (domain.unit_bits - domain.levels)) + wp.float64(1.0)
    return wp.int32(wp.floor(wp.clamp(units, wp.float64(-1.0), end) + wp.float64(0.5)))


@wp.kernel
def place_candidates(
    begin: wp.int32,
    end: wp.int32,
    domain: Domain,
    displacement: PackedLayers,
    valid: wp.array(dtype=wp.uint8),
    pattern: Pattern,
    runs: wp.array(dtype=CandidateRun),
    candidates: CandidateArrays,
):
    """Write position, unit normal and density of the candidates of runs begin .. end - 1.

    A candidate is moved to the nearest lattice point. Density is 1, less at seams of tiles, and 0 where there is no
    ground; the position there is meaningless. displacement: the field's displacement layers. valid: 0 for missing
    samples, empty without holes. pattern.place: position of each rank in its tile, in steps of UNIT sides of the tile.
    """
    units_a_cell = wp.float64(wp.int32(1) << (domain.unit_bits - domain.levels))
    # From slopes in metres a cell to metres a metre after scaling.
    to_slope_x = domain.height_scale / (domain.unit_x * units_a_cell)
    to_slope_y = domain.height_scale / (domain.unit_y * units_a_cell)
    for t in range(begin, end):
        run = runs[t]
        shift = shift_of(pattern.seed, run.tile_x, run.tile_y)
        x0 = pattern.west + wp.float64(run.tile_x) * pattern.side - domain.west
        y0 = pattern.south + wp.float64(run.tile_y) * pattern.side - domain.south
        for k in range(run.count):
            rank = pattern.order[run.first + k]
            q = shift_point(pattern.place[rank], shift)
            x = (x0 + wp.float64(q[0]) * UNIT * pattern.side) / domain.unit_x
            y = (y0 + wp.float64(q[1]) * UNIT * pattern.side) / domain.unit_y
            p = wp.vec2i(nearest_unit(x, domain.samples.columns, domain), nearest_unit(y, domain.samples.rows, domain))
            position = wp.vec3f()
            normal = wp.vec3f(0.0, 0.0, 1.0)
            density = wp.float32(0.0)
            if is_ground(domain, valid, p):
                density = wp.float32(seam_density(pattern, run.tile_x, run.tile_y, rank, q))
                g = surface_at(domain, p)
                if displacement.count > 0:
                    g = with_detail(domain, displacement, p, g)
                px = domain.west + wp.float64(p[0]) * domain.unit_x
                py = domain.south + wp.float64(p[1]) * domain.unit_y
                pz = g[0] * domain.height_scale + domain.height_offset
                nx = -g[1] * to_slope_x
                ny = -g[2] * to_slope_y
                nz = wp.float64(1.0) / wp.sqrt(nx * nx + ny * ny + wp.float64(1.0))
                position = wp.vec3f(wp.float32(px), wp.float32(py), wp.float32(pz))
                normal = wp.vec3f(wp.float32(nx * nz), wp.float32(ny * nz), wp.float32(nz))
            candidates.positions[run.at + k] = position
            candidates.normals[run.at + k] = normal
            candidates.density[run.at + k] = density


@wp.kernel
def choose(
    begin: wp.int32,
    end: wp.int32,
    views: Views,
    pattern: Pattern,
    runs: wp.array(dtype=CandidateRun),
    candidates: CandidateArrays,
    chosen: Chosen,
):
    """Write to `chosen` the candidates of runs begin .. end - 1 that views want, with their sizes.

    A candidate's rank is its position in the order in which points appear as the density grows. It is wanted if its
    rank, as a fraction of all, is below GROWING times the density: the candidate's times the largest of the views. It
    has size 0 at that limit and its full size where its rank is below the density. The factor is the same for all
    ranks, so that the last ones do not appear all at once where the density reaches 1.
    """
    for t in range(begin, end):
        run = runs[t]
        n = run.out
        for k in range(run.count):
            candidate = run.at + k
            rank = pattern.order[run.first + k]
            rank_density = (wp.float64(rank) + wp.float64(0.5)) * PER_RANK  # the density of all ranks up to this one
            density = GROWING * wp.float64(candidates.density[candidate])
            if density > rank_density:  # otherwise no view can want it, whose densities are at most 1
                p = candidates.positions[candidate]
                p3 = wp.vec3d(wp.float64(p[0]), wp.float64(p[1]), wp.float64(p[2]))
                wanted = density * density_of_views(views, p3, run.clear)
                if wanted > rank_density:
                    grown = wp.min(
                        (wanted - rank_density) / ((GROWING - wp.float64(1.0)) * rank_density), wp.float64(1.0)
                    )
                    chosen.which[n] = candidate
                    chosen.rank[n] = rank
                    chosen.scale[n] = wp.float32(grown * grown * (wp.float64(3.0) - wp.float64(2.0) * grown))
                    n += 1
        chosen.counts[t] = n - run.out


@wp.func
def rotation_of(style: ScatterStyle, normal: wp.vec3f, turn: wp.int32) -> wp.vec4f:
    """Return the rotation of a point as a quaternion (w, x, y, z): about the vertical, then towards the normal.

    turn: index of the rotation about the vertical in `style.cosine` and `style.sine`, which have half of each angle.
    style.align: 0 for upright points, 1 for points along the normal.
    """
    # The shortest rotation from the vertical to a direction n = (x, y, z) is (|n| + z, -y, x, 0); turn first.
    x = normal[0] * style.align
    y = normal[1] * style.align
    z = normal[2] * style.align + (1.0 - style.align)
    w = wp.sqrt(x * x + y * y + z * z) + z
    c = style.cosine[turn]
    s = style.sine[turn]
    q = wp.vec4f(w * c, x * s - y * c, x * c + y * s, w * s)
    return q / wp.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])


@wp.kernel
def fill_points(
    begin: wp.int32,
    end: wp.int32,
    runs: wp.array(dtype=CandidateRun),
    first: wp.array(dtype=wp.int32),
    candidates: CandidateArrays,
    chosen: Chosen,
    style: ScatterStyle,
    points: PointArrays,
):
    """Write the chosen points of runs begin .. end - 1 to the output arrays, those of a run from index first[run] on.

    Size, variant and rotation depend on the style's seed, the tile and the rank alone, so a point keeps them. Its
    variant is a random number, 0 .. 2^31 - 1; its id is unique, with RANKS ids for each tile. style.variation: largest
    change of the size, a fraction.
    """
    for t in range(begin, end):
        run = runs[t]
        tile = wp.int64(run.tile_y) * style.tiles + wp.int64(run.tile_x) - style.first_tile
        tile_bits = tile_hash(style.seed, run.tile_x, run.tile_y)
        for k in range(chosen.counts[t]):
            n = first[t] + k
            candidate = chosen.which[run.out + k]
            rank = chosen.rank[run.out + k]
            bits = scramble(tile_bits + wp.uint32(rank))
            more_bits = scramble(bits + wp.uint32(1))
            vary = wp.float32(wp.int32(more_bits)) * 4.656612873077393e-10  # 2^-31: -1 .. 1
            points.positions[n] = candidates.positions[candidate]
            points.normals[n] = candidates.normals[candidate]
            points.size[n] = style.size * (1.0 + style.variation * vary) * chosen.scale[run.out + k]
            points.id[n] = tile * RANKS + wp.int64(rank)
            points.variant[n] = wp.int32(bits >> wp.uint32(1))
            turn = wp.int32(scramble(more_bits) >> wp.uint32(22))  # the upper 10 bits: 0 .. TURNS - 1
            points.rotation[n] = rotation_of(style, candidates.normals[candidate], turn)
