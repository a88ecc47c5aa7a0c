# SPDX-License-Identifier: GPL-3.0-or-later
"""The store: a folder with a JSON file and a folder of the memory-mapped arrays of a height field.

    STORE/store.json            description, and the name of the folder of arrays
    STORE/data-*/samples.npy    [height, width]: float32, or uint16 if 16 bits can number the source's steps
    STORE/data-*/error.npy      uint8 [lattice.node_count], codes (codes.py) in the order of lattice.py
    STORE/data-*/ranges.npy     uint16 [lattice.range_count, 2]; in place of these two files there may be
                                error_pages.npy and error_places.npy, or those of `ranges` (shared_pages.py)
    STORE/data-*/valid.npy      uint8 [height, width], if missing samples are cut out
    STORE/data-*/error_m1.npy   error hierarchies for meshlets, computed on first use
    STORE/data-*/*_c.npy        arrays of the bicubic surface (bicubic.py), computed on first use;
                                error_c_m1.npy: its error hierarchies for meshlets
    STORE/data-*/pyramid.npy    float32, coarser levels of the heights of a large raster (attributes/pyramid.py);
                                pyramid_*.npy: those of its layers
    STORE/data-*/tops.npy       float32, maxima of blocks of heights of a large raster (attributes/occluder.py);
                                bottoms.npy: their minima
    STORE/data-*/effect_*.npy   attributes of the whole raster (attributes/whole.py)
    STORE/data-*/mask*_*.npy    uint8, masks of displacement layers (attributes/layered_detail.py), of a large raster
    STORE/data-*/borders.npy    with tiles.jsonl and work.json: inputs and borders of tiles
    STORE/data-*/finer_*.npy    finer tiles (finer_tiles.py), if the store has some: their numbers, heights and errors
    STORE/data-*/layer_*.npy    float32 [height, width], by-products of height operators
    STORE/tiles/*.npy           tiles that height operators have computed, by content (land/tile_cache.py)

A new version is written into a new folder; then store.json is replaced, which is atomic on every platform, also while
another process has the old arrays mapped. So there is either the old store or the new one, never a mixture.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike

from ..errors import TerrainError, check_path
from ..run import owned_files, partial_files
from ..run.named_file import cause, open_regular
from ..run.owned_files import NotOursError, open_folder
from . import codes
from .displacement_layers import layers_below
from .heightfield import HeightField, HeightRaster
from .lattice import fit
from .shared_pages import NAMES, Paged, map_pages, parts_of, share_pages
from .store_arrays import AGAIN, allocate_array, append_checksums, is_cut_off, map_array
from .store_entries import LATTICE, check_entries
from .store_folder import (
    JSON_NAME,
    MAX_JSON_BYTES,
    discard,
    missing_folders,
    named_folder,
    new_data_name,
    remove_abandoned,
    remove_arrays,
)
from .store_layers import LayerFiles

VERSION = 6
FINER_VERSION = 7  # of stores with finer tiles, which older versions of this program cannot show
SHARED_VERSION = 8  # ... and of stores with shared pages
REMEDY = "import it again"

_NUMBERS = (
    *("range_base", "range_step", "min_height", "max_height", "steepest_x", "steepest_y"),
    *("source_max", "filled", "exponents"),
)


def changed_ns(path: str | os.PathLike) -> int:
    """Return when a store's JSON file or its permissions last changed, in ns; 0 if there is none."""
    try:
        stat = os.stat(os.path.join(path, JSON_NAME))
    except OSError:
        return 0
    return max(stat.st_mtime_ns, stat.st_ctime_ns)


def check_exists(store: str) -> int:
    """Return `changed_ns` of a store. Raises TerrainError if there is none."""
    changed = changed_ns(store)
    if not changed:
        what = f"There is no terrain store at {store!r}"
        raise TerrainError(what, fix="choose its folder under Store, or import again")
    return changed


def read_json(path: Path, file: Path | None = None) -> dict:
    """Return the content of a store's JSON file, checked entry by entry.

    file: JSON file to read instead of that of the store `path`. Raises TerrainError if it is missing, a link, of
    another version or damaged.
    """
    file = file or path / JSON_NAME
    owned_files.check_no_link(file, AGAIN)
    try:
        with open_regular(file) as handle:
            text = handle.read(MAX_JSON_BYTES + 1)
        if len(text) > MAX_JSON_BYTES:
            raise ValueError(f"it is larger than {MAX_JSON_BYTES} bytes")
        content = json.loads(text.decode("utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        what = f"There is no terrain store at {path}"
        fix = "choose its folder (--store, or Store in Blender), or import again"
        raise TerrainError(what, expected="a folder that `import` has written", fix=fix) from None
    except (OSError, ValueError, RecursionError) as reason:
        raise TerrainError(f"The store {file} cannot be read ({cause(reason)})", fix=REMEDY) from reason
    needed = _version_of(content) if isinstance(content, dict) else VERSION
    if not isinstance(content, dict) or content.get("version") != needed:
        version = content.get("version") if isinstance(content, dict) else None
        raise TerrainError(f"The store {path} has version {version}", expected=f"version {needed}", fix=REMEDY)
    try:
        check_entries(content)
        if content["sum"] != _sum_of(content):
            raise ValueError("its entries differ from their checksum")
    except ValueError as fault:
        raise TerrainError(f"The store {file} is damaged ({fault})", fix=REMEDY) from None
    return content


def _version_of(content: dict) -> int:
    """Return the version of a store with these entries of store.json."""
    return SHARED_VERSION if "shared" in content else FINER_VERSION if "finer" in content else VERSION


def _sum_of(content: dict) -> str:
    """Return the checksum of all entries of store.json but "sum", a hex digest."""
    others = {name: value for name, value in content.items() if name != "sum"}
    return hashlib.blake2b(json.dumps(others, sort_keys=True).encode(), digest_size=8).hexdigest()


def open_store(path: str | os.PathLike) -> HeightField:
    """Open a store as a HeightField of memory-mapped arrays. Raises TerrainError if it is missing or damaged."""
    check_path("The store", path)
    path = Path(path)
    try:
        return _open(path, read_json(path))
    except FileNotFoundError:
        pass  # another process has just replaced the store between its JSON and its arrays
    try:
        return _open(path, read_json(path))
    except FileNotFoundError as reason:
        raise TerrainError(f"The store {path} lacks {Path(reason.filename).name}", fix=REMEDY) from None


def check_version(path: Path, file: Path) -> None:
    """Raise TerrainError unless the store `path` can be opened with `file` as its JSON file."""
    _open(path, read_json(path, file))


def _open(path: Path, content: dict) -> HeightField:
    """Map the arrays that a checked JSON file describes, and return their height field.

    Raises FileNotFoundError if an array is missing, and TerrainError if one is damaged.
    """
    from . import finer_tiles

    lattice = fit(**content["lattice"])
    shape = lattice.height, lattice.width
    folder = path / content["data"]
    owned_files.check_no_link(folder, AGAIN)
    steps = codes.Steps(*content["steps"]) if content["steps"] else None
    kind = np.uint16 if steps else np.float32
    numbers = {name: content[name] for name in _NUMBERS}  # such as `exponents` and `min_height`
    raster = HeightRaster(
        map_array(folder / "samples.npy", shape, kind),
        lattice,
        content["key"],
        steps=steps,
        filled=numbers.pop("filled"),
        valid=map_array(folder / "valid.npy", shape, np.uint8) if content["holes"] else None,
        layers=LayerFiles(folder, content.get("layers", {}), shape),
        origin=np.array(content["origin"], np.float64),
        crs=content["crs"],
        place=tuple(content["place"]) if "place" in content else None,
        provenance=content["provenance"],
        path=path,
        finer=finer_tiles.open_tiles(folder, lattice, content["finer"]) if "finer" in content else None,
    )

    def pages(name: str, shape: tuple[int, ...], dtype: DTypeLike) -> Paged:
        """Map an array of pages."""
        is_shared = name in content.get("shared", ())
        return map_pages(folder, name, shape, dtype) if is_shared else map_array(folder / f"{name}.npy", shape, dtype)

    return HeightField(
        raster,
        error=pages("error", (lattice.node_count,), np.uint8),
        ranges=pages("ranges", (lattice.range_count, 2), np.uint16),
        **numbers,
    )


def is_intact(field: HeightField) -> bool:
    """Return whether the files that a field and its cache have mapped still have their length (`is_cut_off`)."""
    from . import finer_tiles

    surfaces = field, *field.cache.surfaces.values()  # `cache` has what was derived from the field, by kind
    arrays = [getattr(surface, name) for surface in surfaces for name in ("samples", "valid")]
    arrays += [part for surface in surfaces for array in (surface.error, surface.ranges) for part in parts_of(array)]
    arrays += [*field.cache.expanded.values(), *field.cache.pyramid]
    masks = [layer.mask for surface in surfaces for layer in layers_below(surface.detail) if layer.mask is not None]
    arrays += [array for mask in masks for array in (mask.values, mask.max_cells)]
    # Results of extremes.py and attributes/finer_pyramid.py are tuples that begin with a mapped array.
    arrays += [result[0] for key, result in field.cache.results.items() if key[0] in ("tops", finer_tiles.PYRAMID)]
    layers = [result for key, result in field.cache.results.items() if key[0] == "layer"]
    arrays += [array for layer in layers for array in layer.cache.pyramid]
    arrays += getattr(field.layers, "opened", {}).values()
    finer = {id(surface.finer): surface.finer for surface in surfaces if surface.finer is not None}
    arrays += [array for tiles in finer.values() for array in tiles.arrays]
    if any(array is not None and is_cut_off(array) for array in arrays):
        return False
    return all(map(is_intact, field.cache.anchored.values()))  # the same field with another origin


def data_folder(raster: HeightRaster) -> Path | None:
    """Return the folder of a raster's arrays; None for a raster in memory or with a replaced or damaged store."""
    if raster.path is None:
        return None
    try:
        content = read_json(raster.path)
    except TerrainError:
        return None
    return raster.path / content["data"] if content["key"] == raster.digest else None


class Draft:
    """A version of a store while it is written; invisible until `publish`.

    Its arrays are in `folder`. The caller ends it with `publish`, `discard_unless_published`, or both.
    """

    def __init__(self, path: Path, name: str | None = None, may_exist: bool = False):
        """Create the folder of a new version and lock it. Raises OSError and NotOursError.

        path: the store's folder. name: that of the folder of arrays in it; None for a new unpredictable one. may_exist:
        whether the folder of arrays may be there, with arrays that were allocated before.
        """
        self.path = path
        self._new_folders = missing_folders(path)  # to be removed if the draft is discarded
        self.folder = path / (name or new_data_name())
        self._lock = partial_files.make_folder(self.folder, parents=True, may_exist=may_exist)
        self.published = False
        self._arrays: dict[str, np.ndarray] = {}

    def allocate(self, name: str, shape: tuple, dtype: DTypeLike) -> np.ndarray:
        """Return a zeroed array in the file NAME.npy, or the one that is there, mapped for writing.

        See `allocate_array`.
        """
        self._arrays[name] = array = allocate_array(self.folder / f"{name}.npy", shape, dtype)
        return array

    def remove(self, name: str) -> None:
        """Remove an allocated array and its file."""
        del self._arrays[name]
        owned_files.remove_file(self.folder / f"{name}.npy")

    def publish(self, field: HeightField, digest: str, report: dict, layers: Mapping[str, str] | None = None) -> None:
        """Make this version the store's content, and remove the arrays of the version before.

        Args:
            field: made of the allocated arrays.
            digest: identifies the source and settings.
            report: for the user.
            layers: units of the allocated layers, by name.

        Raises TerrainError if the result could not be opened; the store is then as it was.
        """
        shared = [name for name in NAMES if share_pages(self.folder, name, self._arrays[name])]
        for name, array in self._arrays.items():
            if name not in shared:
                append_checksums(self.folder / f"{name}.npy", array)
        content = {
            "data": self.folder.name,
            "digest": digest,
            "key": field.raster.digest,  # identifies the heights
            "holes": field.valid is not None,
            "lattice": {name: getattr(field.lattice, name) for name in LATTICE},
            "steps": field.steps and [field.steps.first, field.steps.scale, field.steps.offset],
            **{name: getattr(field, name) for name in _NUMBERS},
            "origin": [float(c) for c in field.origin],
            "crs": field.crs,
            **({"place": field.raster.place} if field.raster.place else {}),
            **({"layers": layers} if layers else {}),
            **({"finer": field.raster.finer.entry} if field.raster.finer is not None else {}),
            **({"shared": shared} if shared else {}),
            "provenance": field.provenance,
            "report": report,
        }
        content["version"] = _version_of(content)
        part = self.folder / JSON_NAME
        part.write_text(self._checked_text(content), encoding="utf-8")
        check_version(self.path, part)  # raises unless the store could be opened with the draft `part`
        previous = named_folder(self.path)
        with open_folder(self.path) as store, store.open_inner(self.folder.name) as arrays:
            store.replace(JSON_NAME, arrays, JSON_NAME)
        self.published = True
        partial_files.end_work(self.folder, self._lock)  # release the folder's lock
        with suppress(OSError, NotOursError):  # a folder with files of the user stays
            if previous is not None:
                remove_arrays(previous)
        # Also whole arrays with shared pages, and unfinished versions, which are of no use now.
        remove_abandoned(self.path, with_work=True)

    def _checked_text(self, content: dict) -> str:
        """Return the JSON of a new version; `content` gets its "sum". Raises TerrainError if reading it would fail."""
        try:  # as `read_json` will find it: tuples become lists, for example
            content["sum"] = _sum_of(json.loads(json.dumps(content)))
            check_entries(json.loads(json.dumps(content)))
            text = json.dumps(content, indent=1, allow_nan=False)
            if len(text) > MAX_JSON_BYTES:
                raise ValueError(f"its description has more than {MAX_JSON_BYTES} characters")
        except ValueError as fault:
            raise TerrainError(
                f"The store {self.path} stays as it was, because the new terrain cannot be stored ({fault})",
                fix="check its heights, height scale and offset, extent and georeference",
            ) from None
        return text

    def discard_unless_published(self, with_work: bool = True) -> None:
        """Remove the draft's files if it was not published. An earlier store at its path is untouched.

        with_work: also remove the files of a tiled import that could be completed later. Its lock is released.
        """
        if self.published:
            return
        os.close(self._lock)
        discard(self.path, self.folder.name, self._new_folders, with_work)
