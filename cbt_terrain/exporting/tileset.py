# SPDX-License-Identifier: GPL-3.0-or-later
"""3D Tiles 1.1: a quadtree of glb files, whose geometric errors are the bounds of their meshes.

Level 0 is one tile. Each further level halves the requested error and the sides of the tiles. A level is one mesh of
the whole terrain, divided at the borders of its tiles: neighbours of a level share the vertices on their border.
Between levels the heights on a border differ by at most the sum of both bounds. A skirt that is as deep as the sum with
the root's bound hangs from each border inside the terrain. `placing` is the terrain's position in its coordinate
system.
"""

import json
import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import quote

import numpy as np

from ..errors import TerrainError, unwritable
from ..field.heightfield import HeightField
from ..field.store_folder import check_is_no_store
from ..importing.placing import Placing, placing_or_middle
from ..run import stopping
from ..run.owned_files import remove_file
from ..run.partial_files import remove_abandoned, sole_writer, written_beside
from ..view.criterion import Criterion
from ..view.linear import length
from .glb import glb_of
from .globe import GlobeFrame, place_on_globe
from .mesh_tiles import TileMesh, border_edges, edge_keys, part_of, split, with_skirt

MAX_LEVELS = 9
TRIANGLES = 20_000  # of a tile, on average
# A quadratic map of a triangle is at most this many times further from the chord plane than at an edge's middle.
MIDDLES = 4.0 / 3.0
MIN_HALF = 1e-3  # metres; a flat tile has a box, too


@dataclass(eq=False)
class _Level:
    """The mesh of one level: its bound in metres, divided into `side` x `side` tiles at `lines`.

    `lines`: x and y in the terrain's space. `_place_levels` sets the last two fields, in the frame of the tileset:
    positions, float32 [n, 3], and unit vectors upwards, float64 [n, 3].
    """

    mesh: TileMesh
    bound: float
    side: int
    lines: tuple[np.ndarray, np.ndarray]
    positions: np.ndarray = field(default_factory=lambda: np.empty(0))
    up: np.ndarray = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class TilesetReport:
    """Content of a written tileset. `bounds`: metres, of each level from the root."""

    num_tiles: int
    num_triangles: int
    bounds: tuple[float, ...]
    is_on_globe: bool


def export_tileset(
    field: HeightField,
    path: Path,
    error_m: float,
    triangles: int = TRIANGLES,
    on_progress: Callable[[float], None] = lambda _fraction: None,
) -> TilesetReport:
    """Write a tileset and its tiles, NAME_LEVEL_X_Y.glb, into one folder.

    Raises TerrainError for numbers and a path that cannot be used, a terrain whose holes leave nothing, and files that
    cannot be written.

    Args:
        field: a store's height field.
        path: NAME.json; its folder exists.
        error_m: requested error of the finest level, metres of height.
        triangles: mean number in a tile of the finest level.
        on_progress: called with the fraction done; may raise, which cancels.
    """
    if path.suffix.lower() != ".json" or not os.path.isdir(path.parent):
        raise TerrainError(f"{path} is no tileset", expected="a .json file in an existing folder")
    if not (math.isfinite(error_m) and error_m > 0.0) or triangles < 1:
        raise TerrainError(f"The error is {error_m} m with {triangles} triangles", expected="numbers above 0")
    check_is_no_store(path.parent)
    remove_abandoned(path.parent)
    try:
        with sole_writer(path):
            return _write_tileset(field, path, error_m, triangles, on_progress)
    except OSError as reason:
        raise unwritable(f"The tileset {path}", reason) from reason


def _write_tileset(
    field: HeightField, path: Path, error_m: float, triangles: int, on_progress: Callable[[float], None]
) -> TilesetReport:
    """Write the files of a tileset. Its arguments are those of `export_tileset`. Raises TerrainError and OSError."""
    levels = _levels(field, error_m, triangles, lambda done: on_progress(0.5 * done))
    placing = placing_or_middle(field)
    frame = _place_levels(levels, placing, path.parent)  # position on the globe; None without a coordinate system
    # From the finest level up: 3D Tiles require that a tile's error is no smaller than its children's.
    for finer, level in zip(levels[:0:-1], levels[-2::-1], strict=True):
        level.bound = max(level.bound, finer.bound)
    tiles: dict[tuple[int, int, int], tuple] = {}  # (level, x, y): box and number of triangles of a written tile
    remove_file(path)  # of an earlier export, whose tiles are about to be replaced
    total = sum(len(level.mesh.triangles) for level in levels)
    for number, level in enumerate(levels):
        for _ in _write_level(path, number, level, levels[0].bound, tiles):
            on_progress(0.5 + 0.5 * sum(int(count) for _, count in tiles.values()) / total)
    root = _tile_json(path.stem, levels, tiles, number=0, x=0, y=0)
    if root is None:
        raise TerrainError("Nothing is left of the terrain", fix="check its holes")
    with written_beside(path) as partial:
        partial.write_text(json.dumps(_tileset_json(root, levels[0], frame), indent=1) + "\n", encoding="utf-8")
    num_triangles = sum(int(count) for _, count in tiles.values())
    return TilesetReport(len(tiles), num_triangles, tuple(level.bound for level in levels), frame is not None)


def _levels(field: HeightField, error_m: float, triangles: int, on_progress: Callable[[float], None]) -> list[_Level]:
    """Return the levels from the root to the finest; the error doubles from level to level.

    `triangles`: about as many in a tile; the number of levels follows from it. error_m: requested error of the finest
    level.
    """
    from ..terrain import Terrain

    terrain, finest_first = Terrain(field), []
    depth = doublings = 0
    while doublings <= depth:
        stopping.check()
        update = terrain.update(Criterion(error_px=0.0, error_m=error_m * 2.0**doublings))
        if doublings == 0:
            depth = _depth((field.lattice.cells_x, field.lattice.cells_y), update.triangles / triangles)
        s = update.surface
        assert update.bound_m is not None  # the criterion has an error in metres
        mesh = TileMesh(s.positions, s.normals, s.uv, s.triangles.astype(np.int64))
        finest_first.append(_divide_level(field, mesh, update.bound_m, 1 << (depth - doublings)))
        doublings += 1
        on_progress(1.0 - 0.25**doublings)  # each coarser level has a quarter of the triangles
    return finest_first[::-1]


def _depth(cells: tuple[int, int], tiles: float) -> int:
    """Return the first level with at least `tiles` tiles, or whose tiles are about a cell long, at most MAX_LEVELS.

    A level has four times the tiles of the one above, and twice as many once tiles are as narrow as a cell. cells: the
    raster's columns and rows of cells.
    """
    depth = 0
    while depth < MAX_LEVELS and 2 << depth <= max(cells) and math.prod(min(1 << depth, n) for n in cells) < tiles:
        depth += 1
    return depth


def _divide_level(field: HeightField, mesh: TileMesh, bound: float, side: int) -> _Level:
    """Divide the mesh of a level at the borders of its tiles, which are lines of samples.

    field: gives the lines of samples. bound: error of the mesh, metres; it grows by the rounding of the new vertices.
    side: number of tiles along a side.
    """
    lattice = field.lattice
    west, south, _, _ = lattice.rectangle()
    lines = []
    for axis, (first, cells, step) in enumerate(
        [(west, lattice.cells_x, lattice.step_x), (south, lattice.cells_y, lattice.step_y)]
    ):
        positions = [np.float32(first + round(cells * k / side) * step) for k in range(1, side)]
        for line in positions:
            mesh = split(mesh, axis, float(line))
        lines.append(np.array(positions, np.float64))
    if side > 1:  # new vertices are rounded to float32: their heights, and x and y on at most the steepest slope
        slope = length((field.steepest_x, field.steepest_y))
        top = np.abs(mesh.positions).max(0)
        bound += float(np.spacing(top[2])) + slope * float(np.spacing(top[:2].max()))
    return _Level(mesh, bound, side, (lines[0], lines[1]))


def _place_levels(levels: list[_Level], placing: Placing, folder: Path) -> GlobeFrame | None:
    """Set positions in the frame of the tileset, and add to bounds by how much the globe bends the triangles.

    Return the frame, None for a terrain without a named coordinate system. folder: for a temporary file.
    """
    if not placing.crs:
        for level in levels:
            level.positions = level.mesh.positions
            level.up = np.broadcast_to([0.0, 0.0, 1.0], level.positions.shape)
        return None
    points, ends = [], []
    for level in levels:
        triangles, positions = level.mesh.triangles, level.mesh.positions.astype(np.float64)
        edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
        # Both ends of an edge in one integer: `unique` of rows would hold Python's lock for seconds.
        keys = np.unique(edge_keys(edges))
        ends.append(np.stack([keys >> 32, keys & 0xFFFFFFFF]))
        points += [positions, 0.5 * (positions[ends[-1][0]] + positions[ends[-1][1]])]
    frame, in_frame, up = place_on_globe(placing, np.concatenate(points), folder)
    cuts = np.cumsum([len(some) for some in points])[:-1]
    parts, ups = np.split(in_frame, cuts), np.split(up, cuts)  # of each level its vertices, then its edges' middles
    for level, (a, b), exact, middles, upwards in zip(levels, ends, parts[::2], parts[1::2], ups[::2], strict=True):
        level.positions, level.up = exact.astype(np.float32), upwards
        # A curved triangle is at most MIDDLES times further from its plane than at the middles of its edges.
        bent = middles - 0.5 * (exact[a] + exact[b])
        rounding = np.abs(level.positions - exact).max()  # of one coordinate; of a position sqrt(3) times that
        level.bound += MIDDLES * math.sqrt((bent**2).sum(1).max()) + math.sqrt(3.0) * float(rounding)
    return frame


def _write_level(path: Path, number: int, level: _Level, root_bound: float, tiles: dict) -> Iterator[None]:
    """Write the tiles of a level as glb files, each with a skirt that hides cracks to other levels.

    Yield after each tile.

    path: file of the tileset, beside which the tiles are written. tiles: gets the box of each tile (its lowest and
    highest corner) and its number of triangles, by level, x and y. root_bound: error of level 0, metres.
    """
    # A triangle belongs to the tile that contains its centroid.
    centroids = level.mesh.positions[level.mesh.triangles].astype(np.float64).mean(1)
    x, y = (np.searchsorted(level.lines[axis], centroids[:, axis]) for axis in (0, 1))
    owner = y * level.side + x
    order = np.argsort(owner, kind="stable")
    # First triangle in `order` of each tile, and the number of all.
    starts = np.searchsorted(owner[order], np.arange(level.side**2 + 1))
    # The mesh's own border gets no skirt.
    outer = edge_keys(border_edges(level.mesh))
    for tile in np.flatnonzero(np.diff(starts)):
        stopping.check()
        ty, tx = divmod(int(tile), level.side)
        # `used`: numbers in the level's mesh of the part's vertices.
        part, used = part_of(level.mesh, order[starts[tile] : starts[tile + 1]])
        count = len(part.triangles)
        placed = TileMesh(level.positions[used], part.normals, part.uv, part.triangles)
        edges = border_edges(part)
        edges = edges[~np.isin(edge_keys(used[edges]), outer)]
        placed = with_skirt(placed, edges, -(level.bound + root_bound) * level.up[used])
        extras = {"max_error_m": level.bound, "level": number, "x": tx, "y": ty, "num_surface_triangles": count}
        content = glb_of(placed.positions, placed.normals, placed.uv, placed.triangles, extras)
        with written_beside(path.with_name(_glb_name(path.stem, number, tx, ty))) as partial:
            partial.write_bytes(content)
        box = placed.positions.min(0).astype(np.float64), placed.positions.max(0).astype(np.float64)
        tiles[number, tx, ty] = box, count
        yield


def _glb_name(stem: str, level: int, x: int, y: int) -> str:
    """Return the file name of a tile."""
    return f"{stem}_{level}_{x}_{y}.glb"


def _tile_json(stem: str, levels: list[_Level], tiles: dict, number: int, x: int, y: int) -> dict | None:
    """Return a tile and those below it as JSON, or None if there are none.

    It has its box, lowest and highest corner, under "box" for the caller, which removes it. tiles: (box, number of
    triangles) of each tile that was written, by (level, column, row). number: level. x, y: column and row of the tile.
    stem: of the tileset's file name.
    """
    children = []
    if number + 1 < len(levels):
        quarters = [(2 * x + dx, 2 * y + dy) for dy in (0, 1) for dx in (0, 1)]
        below = [_tile_json(stem, levels, tiles, number + 1, *column_row) for column_row in quarters]
        children = [child for child in below if child is not None]
    box = tiles.get((number, x, y), (None, 0))[0]
    boxes = [child.pop("box") for child in children] + ([box] if box is not None else [])
    if not boxes:
        return None
    low, high = np.min([b[0] for b in boxes], 0), np.max([b[1] for b in boxes], 0)
    tile = {
        "boundingVolume": {"box": _box_json(low, high)},
        "geometricError": levels[number].bound,
        "box": (low, high),
    }
    if box is not None:
        tile["content"] = {"uri": quote(_glb_name(stem, number, x, y)), "boundingVolume": {"box": _box_json(*box)}}
    return tile | ({"children": children} if children else {})


def _box_json(low: np.ndarray, high: np.ndarray) -> list[float]:
    """Return a box as 3D Tiles has it: the middle and half of each side, 12 numbers. Flat boxes are made thicker.

    low, high: its lowest and highest corner.
    """
    middle = 0.5 * (low + high)
    half = np.maximum(np.maximum(high - middle, middle - low), MIN_HALF)
    return [*middle.tolist(), float(half[0]), 0.0, 0.0, 0.0, float(half[1]), 0.0, 0.0, 0.0, float(half[2])]


def _tileset_json(root: dict, level: _Level, frame: GlobeFrame | None) -> dict:
    """Return the content of the tileset's JSON file.

    root: from `_tile_json`; its "box" is removed. level: that of the root. frame: position on the globe, None for no
    position.
    """
    low, high = root.pop("box")
    placed = {} if frame is None else {"transform": frame.transform()}
    return {
        "asset": {"version": "1.1", "generator": "Adaptive Terrain"},
        # Without the tileset there is no terrain: the error is its size.
        "geometricError": max(float((high - low).max()), level.bound),
        "root": root | placed | {"refine": "REPLACE"},
    }
