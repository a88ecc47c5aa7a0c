# SPDX-License-Identifier: GPL-3.0-or-later
"""Baking of maps: attributes at the texels of tiles that are missing or out of date.

A tile is a rectangle of the ground, and an image shows one attribute on it with `side` x `side` texels.
A file contains the key of its content: the attributes with their versions and parameters, the heights, the tile, the
resolution and the coding. Files with the requested key stay. New ones are written in a private folder and renamed when
all are complete.
"""

import hashlib
import json
import math
import os
import re
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import warp as wp

from ...kernels.effects import texels as kernels
from ..errors import TerrainError
from ..field.heightfield import HeightField
from ..field.store_folder import check_is_no_store
from ..run import launch, owned_files, partial_files
from ..run.buffers import shared
from ..run.owned_files import open_folder
from . import exr, png
from .attribute import AttributeRequest, SamplePoints
from .catalogue import ATTRIBUTES
from .coding import PNG, Coding, coding_of
from .evaluate import values_at
from .finer_pyramid import is_finer, min_level
from .folder import JSON_NAME, UDIM, VERSION, file_name, image_files, read_index
from .plan import plan
from .pyramid import pack_pyramid
from .scale import STEPS_PER_LEVEL, limit_levels
from .tiling import Tiling, tiling_of

# Levels by which maps are sharper, since interpolation of the image smooths too: the shading of the island is off by
# 5.43 of 255 without it, by 5.05 with it.
SHARPER = 0.5
# IEC 61966-2-1 at even steps from 0 to 1; interpolation is off by at most a hundredth of a byte's step.
SRGB = [12.92 * x if x <= 0.0031308 else 1.055 * x ** (1 / 2.4) - 0.055 for x in (k / 4096 for k in range(4097))]
KEY = re.compile("[0-9a-f]{32}")  # of an image's content
BAND_TEXELS = 1 << 19  # texels of a band: some megabytes, and a thirtieth of a second


@dataclass(frozen=True)
class Baked:
    """The result of a bake: the content of maps.json, and the numbers of written and unchanged images."""

    index: dict
    written: int
    unchanged: int


@dataclass(frozen=True)
class _Image:
    """An image to bake: index of its tile, attribute, coding, side in texels, file name and content key."""

    tile: int
    request: AttributeRequest
    coding: Coding
    side: int
    file: str
    key: str


def bake(
    field: HeightField,
    requests: Iterable[AttributeRequest],
    folder: str | os.PathLike,
    resolutions: Sequence[int],
    *,
    vertical_scale: float = 1.0,
    vertical_offset: float = 0.0,
    form: str = PNG,
    threads: int | None = None,
    on_progress: Callable[[float], None] = lambda _fraction: None,
    lock: AbstractContextManager | None = None,
) -> Baked:
    """Update the maps of requested attributes in `folder`; `resolutions`: texels along a side of each tile.

    requests: attributes with their parameters, one map each.

    Heights are `height * vertical_scale + vertical_offset` metres. `form`: PNG or EXR. `on_progress` gets the finished
    fraction and may raise, which cancels without a change of the folder. `lock` is held while a band of texels is
    evaluated; between bands other threads can evaluate attributes. None for no lock. Images that the earlier maps.json
    lists and the new one does not are removed. Raises TerrainError.
    """
    # Tiles are counted in cells of the finest heights: level 0, or below where the raster has finer tiles.
    folder, tiling = Path(folder), tiling_of(field.lattice, min_level(field.raster))
    ground = _MapGround(field, tiling, vertical_scale, vertical_offset, threads or launch.default_threads())
    by_name = sorted(requests, key=lambda request: request.name)
    images = [_image(ground, request, tile, side, form) for tile, side in enumerate(resolutions) for request in by_name]
    check_is_no_store(folder)
    try:
        with open_folder(folder, make=True, may_be_link=True):
            pass  # the folder now exists
        partial_files.remove_abandoned(folder)
        before = read_index(folder)
        listed = image_files(before or {"maps": {}})  # images of the earlier maps
        # Images without a file, or whose file has the key of another content.
        missing = [image for image in images if _key_in(folder / image.file) != image.key]
        for image in missing:
            _check_replaceable(folder / image.file, listed)
        index = _index(ground, images, before)
        with partial_files.private_folder(folder) as partial:
            _bake_images(ground, missing, partial, on_progress, lock or nullcontext())
            (partial / JSON_NAME).write_text(json.dumps(index, indent=1), encoding="utf-8")
            with open_folder(folder, may_be_link=True) as target, open_folder(partial) as complete:
                for file in [image.file for image in missing] + [JSON_NAME]:
                    target.replace(file, complete, file)
        for file in listed - image_files(index):
            if _key_in(folder / file) is not None:  # otherwise it is not a baked image
                owned_files.remove_file(folder / file, may_be_link=True)
    except OSError as reason:
        problem = f"The maps cannot be written into {folder} ({reason.strerror or reason})"
        raise TerrainError(problem, fix="choose another folder") from reason
    return Baked(index, len(missing), len(images) - len(missing))


@dataclass(frozen=True, eq=False)
class _MapGround:
    """The ground of all images of a bake, with heights `height * vertical_scale + vertical_offset`."""

    field: HeightField
    tiling: Tiling
    vertical_scale: float
    vertical_offset: float
    threads: int

    def levels(self, side: int, positions: np.ndarray) -> np.ndarray:
        """Return the pyramid level at which each texel is evaluated, float32 [n]: the spacing of texels, less SHARPER.

        It is limited to the finest level that the ground has at the texel. side: texels along a side of the image.
        positions: float32 [n, 3], of the texels.
        """
        level = max(self.image_level(side), min_level(self.field.raster))
        levels = np.full(len(positions), level, np.float32)
        limit_levels(self.field, positions, levels, self.threads)
        return levels

    def finer_level(self, tile: int, side: int) -> float:
        """Return the finest level of a tile's texels: below 0 if its image shows finer tiles, else 0.

        side: texels along a side of the image.
        """
        raster, (west, south, east, north) = self.field.raster, self.tiling.box(tile)
        # Metres by which the image's margin extends beyond the tile.
        across, along = (side * self.tiling.margin * texel for texel in self.tiling.texel(side))
        has_finer = is_finer(raster, (west - across, south - along, east + across, north + along))
        return min(max(self.image_level(side), min_level(raster)), 0.0) if has_finer else 0.0

    def image_level(self, side: int) -> float:
        """Return the level at which decals are sampled, for images of `side` texels.

        It is log2 of the texel over the sample spacing, less SHARPER (interpolation of the image smooths it, too),
        rounded to a multiple of 1 / STEPS_PER_LEVEL. It is below 0 for texels finer than samples.
        """
        lattice = self.field.lattice
        ratio = max(self.tiling.texel(side)) / max(lattice.step_x, lattice.step_y)
        return round((math.log2(ratio) - SHARPER) * STEPS_PER_LEVEL) / STEPS_PER_LEVEL


def _image(ground: _MapGround, request: AttributeRequest, tile: int, side: int, form: str) -> _Image:
    """Return the image of an attribute for a tile of `side` x `side` texels, with its content key.

    The key changes with everything that the pixels depend on: parameters, versions, heights, tiling and coding. form:
    PNG or EXR.
    """
    coding = coding_of(ATTRIBUTES[request.name], form)
    steps, finer = plan([request]).steps, ground.finer_level(tile, side)
    finer_levels = (finer,) if finer else ()  # only in keys of images that show finer tiles
    content = (
        VERSION,
        [(step.name, ATTRIBUTES[step.name].version, sorted(step.parameters)) for step in steps],
        (ground.field.raster.digest, ground.vertical_scale, ground.vertical_offset),
        (ground.tiling, tile, side, ground.image_level(side), *finer_levels),
        coding,
    )
    key = hashlib.blake2b(repr(content).encode(), digest_size=16).hexdigest()
    number = ground.tiling.udim_number(tile) if len(ground.tiling) > 1 else None
    return _Image(tile, request, coding, side, file_name(request.name, coding.form, number), key)


def _check_replaceable(file: Path, listed: set[str]) -> None:
    """Raise TerrainError if a file has the name of an image but was not baked. listed: images of the maps.json."""
    if os.path.lexists(file) and file.name not in listed and _key_in(file) is None:
        raise TerrainError(
            f"{file} was not baked by Adaptive Terrain",
            expected="a folder without other images of that name",
            fix="move it, or choose another folder",
        )


def _key_in(file: Path) -> str | None:
    """Return the content key that a complete image has as its comment, None for anything else, such as a link."""
    if not owned_files.is_real_file(file):
        return None
    comment = png.comment_of(file) if file.suffix == ".png" else exr.comment_of(file)
    return comment if comment and KEY.fullmatch(comment) else None


def _bake_images(
    ground: _MapGround,
    images: list[_Image],
    folder: Path,
    on_progress: Callable[[float], None],
    lock: AbstractContextManager,
) -> None:
    """Write images into `folder`, in bands of rows so that memory stays bounded.

    Attributes of one tile are evaluated together. `lock` is held while a band is evaluated.
    """
    # Texels of all tiles, each counted once for all its attributes.
    total = sum(int(side * side) for side in {image.tile: image.side for image in images}.values())
    done = 0
    on_progress(0.0)
    with ThreadPoolExecutor(ground.threads, "adaptive_terrain_maps") as pool:
        for tile in sorted({image.tile for image in images}):
            together = [image for image in images if image.tile == tile]
            side = together[0].side
            with ExitStack() as stack:
                files = [_open_image(folder, image, pool, stack) for image in together]
                for first in range(0, side, _band_rows(side)):
                    rows = min(_band_rows(side), side - first)
                    with lock:
                        texels = _texel_points(ground, tile, side, first, rows)
                        values = values_at(texels, [image.request for image in together])
                    for image, file in zip(together, files, strict=True):
                        file.add(_encode_band(values[image.request.name], image))
                    done += rows * side
                    on_progress(done / total)
                for file in files:
                    file.close()


def _band_rows(side: int) -> int:
    """Return how many rows of texels are computed at once, of whole blocks of an EXR file; the last band may have less.

    side: texels of a row.
    """
    return max(BAND_TEXELS // side // exr.BLOCK, 1) * exr.BLOCK


def _open_image(folder: Path, image: _Image, pool: Executor, stack: ExitStack) -> png.PngFile | exr.ExrFile:
    """Open the file of an image in `folder` for writing.

    The owner of `stack` completes it with `close`; leaving `stack` closes it and discards waiting blocks. pool: threads
    that compress.
    """
    writer = png.PngFile if image.coding.form == PNG else exr.ExrFile
    file = writer(folder / image.file, image.side, image.coding.channels, image.coding.depth, image.key, pool)
    stack.callback(file.abandon)
    return file


def _texel_points(ground: _MapGround, tile: int, side: int, first: int, rows: int) -> SamplePoints:
    """Return the ground below some rows of texels, as points for attributes.

    tile: number in the tiling. side: texels along a side of the image. first, rows: first row, from the north, and
    number of rows.
    """
    no_coarser_levels = np.empty(1, np.float32)  # positions have the heights of the raster's own samples
    heights, grid, tiling = pack_pyramid(ground.field.raster, no_coarser_levels), kernels.Texels(), ground.tiling
    heights.height_scale, heights.height_offset = ground.vertical_scale, ground.vertical_offset
    grid.columns = side
    grid.west, grid.north = tiling.first_texel(tile, side)
    grid.step_x, grid.step_y = tiling.texel(side)
    positions = np.empty((rows * side, 3), np.float32)
    first_texel = first * side  # in the image
    inputs = [first_texel, heights, grid, shared(positions, wp.vec3f)]
    launch.spread(kernels.texel_places, len(positions), inputs, step="texels", threads=ground.threads)
    level = ground.levels(side, positions)
    scale = ground.vertical_scale, ground.vertical_offset
    return SamplePoints(ground.field, positions, level, *scale, ground.threads, ground.image_level(side))


def _encode_band(values: np.ndarray, image: _Image) -> np.ndarray:
    """Encode attribute values of a band, float32 [rows * side] or [rows * side, width], for the image's file.

    Returns uint8 [rows, bytes of a row] for PNG, float32 [rows, side, channels] for EXR. PNG has rounded steps between
    the coding's `low` and `high`; channels without a value are 0.
    """
    coding, kind = image.coding, "f4"
    if coding.form == PNG:
        limit, kind = (255, "u1") if coding.depth == 8 else (65535, ">u2")
        if coding.srgb:  # by a table, since the last bits of numpy's powers differ by processor
            values = np.interp(values, np.arange(len(SRGB)) / (len(SRGB) - 1), SRGB).astype(np.float32)
        steps = (values - np.float32(coding.low)) * np.float32(limit / (coding.high - coding.low))
        values = (np.clip(steps, 0, limit) + np.float32(0.5)).astype(np.uint16)
    out = np.zeros((len(values), coding.channels), kind)
    out[:, : values.size // len(values)] = values.reshape(len(values), -1)  # one row for each texel
    rows = out.reshape(-1, image.side, coding.channels)
    return rows.view(np.uint8).reshape(len(rows), -1) if coding.form == PNG else rows


def _index(ground: _MapGround, images: list[_Image], before: dict | None) -> dict:
    """Return the index of the folder: the maps of `images`, and others that exist for the same ground.

    before: the folder's index so far, None without one.
    """
    lattice, tiling = ground.field.lattice, ground.tiling
    west, south, east, north = lattice.rectangle()
    index = {
        "version": VERSION,
        "generator": "Adaptive Terrain",
        "height_field": ground.field.raster.digest,
        "place": {"west": west, "south": south, "east": east, "north": north, "unit": "m"},
        "origin": ground.field.origin.tolist(),
        "crs": ground.field.crs,
        "vertical_scale": ground.vertical_scale,
        "vertical_offset": ground.vertical_offset,
        "columns": tiling.columns,
        "rows": tiling.rows,
        "margin": tiling.margin,
    }
    # Maps of other ground are not listed any more.
    is_same = before is not None and all(before.get(name) == value for name, value in index.items())
    maps = dict(before["maps"]) if before is not None and is_same else {}
    for name in sorted({image.request.name for image in images}):
        maps[name] = _map_entry(ground, [image for image in images if image.request.name == name])
    return index | {"maps": {name: maps[name] for name in sorted(maps)}}


def _map_entry(ground: _MapGround, images: list[_Image]) -> dict:
    """Return the JSON entry of a map in maps.json: unit, file names, coding and tiles. images: one for each tile."""
    effect, coding, tiling = ATTRIBUTES[images[0].request.name], images[0].coding, ground.tiling
    coded = {
        "channels": coding.channels,
        "bits": coding.depth,
        "zero": coding.low,
        "one": coding.high,
        "srgb": coding.srgb,
    }
    several = len(tiling) > 1
    return {
        "about": effect.about,
        "unit": effect.unit,
        "file": f"{effect.name}.{UDIM}.{coding.form}" if several else images[0].file,
        "format": coding.form,
        "coding": coded | {"numbers": effect.width},
        "tiles": [
            {
                "tile": tiling.udim_number(image.tile),
                "file": image.file,
                "resolution": image.side,
                "texel_m": max(tiling.texel(image.side)),
                "box_m": list(tiling.box(image.tile)),
                "key": image.key,
            }
            for image in images
        ],
    }
