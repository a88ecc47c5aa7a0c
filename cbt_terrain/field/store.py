# SPDX-License-Identifier: GPL-3.0-or-later
"""The store: a folder with one JSON file and, in a folder beside it, the memory-mapped arrays of a height field.

    STORE/store.json            what it holds, and the name of the folder of arrays
    STORE/data-*/samples.npy    [height, width]: float32, or uint16 where the source has steps that 16 bits can number
    STORE/data-*/error.npy      uint8 [lattice.node_count], codes (codes.py) in the order of lattice.py
    STORE/data-*/ranges.npy     uint16 [lattice.range_count, 2]
    STORE/data-*/valid.npy      uint8 [height, width], where what is missing is cut out
    STORE/data-*/error_m1.npy   error hierarchies for meshlets, made when first asked for
    STORE/data-*/*_c.npy        what a bicubic surface has of its own (bicubic.py), made when first asked for;
                                error_c_m1.npy its error hierarchies for meshlets
    STORE/data-*/effect_*.npy   what an effect has made of the whole raster (effects/whole.py)
    STORE/data-*/layer_*.npy    float32 [height, width], what effects on heights have left beside them (land/)
    STORE/tiles/*.npy           what effects on heights have made of tiles, by content (land/tile_cache.py)

A new version is written into a folder of its own; then store.json is replaced, which is atomic on every platform, also
while another process has the old arrays mapped. So there is either the old store or the new one, never a mixture.
"""

import hashlib
import json
import math
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np

from ..errors import TerrainError, check_path
from ..run import owned_files, partial_files
from ..run.named_file import cause, open_regular
from ..run.owned_files import NotOursError, open_folder
from . import codes
from .heightfield import HeightField
from .lattice import MAX_MESHLET, Lattice, fit
from .store_arrays import (
    AGAIN,
    PAGE_BYTES,
    all_checksums,
    file_bytes,
    header,
    is_cut_off,
    map_array,
    verify_array,
    write_array,
)
from .store_entries import LATTICE, check_entries
from .store_folder import (
    JSON_NAME,
    MAX_JSON_BYTES,
    discard,
    is_array_file,
    missing_folders,
    named_folder,
    new_data_name,
    remove_abandoned,
    remove_arrays,
)
from .store_layers import LayerFiles, layer_name

VERSION = 6

# What an import needs on its way.
_SCRATCH = ("raster", "errors")
_NUMBERS = (
    *("range_base", "range_step", "min_height", "max_height", "steepest_x", "steepest_y"),
    *("source_max", "filled", "exponents"),
)


def changed_ns(path: str | os.PathLike) -> int:
    """When what says that a folder is a store was last changed, its rights included; 0 where there is nothing of it."""
    try:
        stat = os.stat(os.path.join(path, JSON_NAME))
    except OSError:
        return 0
    return max(stat.st_mtime_ns, stat.st_ctime_ns)


def read_json(path: Path, file: Path | None = None) -> dict:
    """Return the content of a store's JSON file, checked entry by entry. file: another than that of the store `path`.
    Raises TerrainError."""
    file = file or path / JSON_NAME
    owned_files.check_no_link(file, AGAIN)
    try:
        with open_regular(file) as handle:
            text = handle.read(MAX_JSON_BYTES + 1)
        if len(text) > MAX_JSON_BYTES:
            raise ValueError(f"it is larger than {MAX_JSON_BYTES} bytes")
        content = json.loads(text.decode("utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        raise TerrainError(
            f"There is no terrain store at {path}: expected a folder that `import` has written."
        ) from None
    except (OSError, ValueError, RecursionError) as reason:
        raise TerrainError(f"The store {file} cannot be read ({cause(reason)}): import it again.") from reason
    if not isinstance(content, dict) or content.get("version") != VERSION:
        found = content.get("version") if isinstance(content, dict) else None
        raise TerrainError(f"The store {path} has version {found}, expected {VERSION}: import it again.")
    try:
        check_entries(content)
        if content["sum"] != _sum_of(content):
            raise ValueError("its entries differ from their checksum")
    except ValueError as fault:
        raise TerrainError(f"The store {file} is damaged: {fault}; import it again.") from None
    return content


def _sum_of(content: dict) -> str:
    """Checksum of all other entries of store.json."""
    others = {name: value for name, value in content.items() if name != "sum"}
    return hashlib.blake2b(json.dumps(others, sort_keys=True).encode(), digest_size=8).hexdigest()


def open_store(path: str | os.PathLike) -> HeightField:
    """Open a store: a HeightField over memory-mapped arrays. Raises TerrainError if it is missing or damaged."""
    check_path("The store", path)
    path = Path(path)
    try:
        return _open(path, read_json(path))
    except FileNotFoundError:
        pass  # another process has just replaced the store between its JSON and its arrays
    try:
        return _open(path, read_json(path))
    except FileNotFoundError as reason:
        raise TerrainError(f"The store {path} lacks {Path(reason.filename).name}: import it again.") from None


def check_version(path: Path, file: Path) -> None:
    """Raise TerrainError unless the store `path` can be opened once `file` is its JSON file."""
    _open(path, read_json(path, file))


def _open(path: Path, content: dict) -> HeightField:
    lattice = fit(**content["lattice"])
    shape = lattice.height, lattice.width
    folder = path / content["data"]
    owned_files.check_no_link(folder, AGAIN)
    steps = codes.Steps(*content["steps"]) if content["steps"] else None
    kind = np.uint16 if steps else np.float32
    return HeightField(
        samples=map_array(folder / "samples.npy", shape, kind),
        steps=steps,
        lattice=lattice,
        error=map_array(folder / "error.npy", (lattice.node_count,), np.uint8),
        ranges=map_array(folder / "ranges.npy", (lattice.range_count, 2), np.uint16),
        valid=map_array(folder / "valid.npy", shape, np.uint8) if content["holes"] else None,
        layers=LayerFiles(folder, content.get("layers", {}), shape),
        **{name: content[name] for name in _NUMBERS},
        key=content["key"],
        origin=np.array(content["origin"], np.float64),
        crs=content["crs"],
        provenance=content["provenance"],
        path=path,
    )


def is_intact(field: HeightField) -> bool:
    """Whether the files that a field has mapped are as long as they were."""
    surfaces = field, *field.surfaces.values()
    arrays = [getattr(surface, name) for surface in surfaces for name in ("samples", "error", "ranges", "valid")]
    arrays += [array for surface in surfaces for array in surface.expanded.values()]
    arrays += getattr(field.layers, "opened", {}).values()
    return not any(array is not None and is_cut_off(array) for array in arrays)


def verify(path: str | os.PathLike) -> dict[str, int]:
    """Check every block of every array of a store; returns how many blocks each file has.

    Raises TerrainError for the first array with a fault.
    """
    field = open_store(path)
    field.check_samples()
    folder, found = data_folder(field), {}
    shapes = {name: getattr(field, name) for name in ("samples", "error", "ranges", "valid")}
    shapes |= {layer_name(name): field.layers[name] for name in field.layers}
    for name, array in shapes.items():
        if array is not None:
            found[f"{name}.npy"] = verify_array(folder / f"{name}.npy", array.shape, array.dtype)
    kept = {f"{name}.npy": like for name, like in kept_arrays(field.lattice).items()}
    kept |= {
        file.name: (_shape_of(file, shapes_of_effects(field.lattice)), np.float32) for file in _effect_files(folder)
    }
    for name, (shape, dtype) in kept.items():
        if os.path.lexists(folder / name):
            try:
                found[name] = verify_array(folder / name, shape, dtype)
            except TerrainError as error:
                cause = str(error).removesuffix("import the terrain again.")
                raise TerrainError(f"{cause}delete the file, it is made again when it is needed.") from error
    return found


def _effect_files(folder: Path) -> list[Path]:
    """What effects have kept over a whole raster."""
    return sorted(file for file in folder.glob("effect_*.npy") if is_array_file(file))


def shapes_of_effects(lattice: Lattice) -> list[tuple[int, int]]:
    """Rows and columns of the results of effects over a whole raster: of its samples, of every other one, and so on."""
    cells = [(lattice.cells_y, lattice.cells_x)]
    while min(cells[-1]) > 1:
        cells.append(tuple(-(-count // 2) for count in cells[-1]))
    return [(rows + 1, columns + 1) for rows, columns in cells]


def _shape_of(file: Path, shapes: list[tuple[int, int]]) -> tuple[int, int]:
    """The one of the shapes that a file of float32 has by its size; the first where it has none's."""
    size = os.lstat(file).st_size
    return next((shape for shape in shapes if file_bytes(4 * math.prod(shape)) == size), shapes[0])


def kept_arrays(lattice: Lattice) -> dict[str, tuple]:
    """Names, shapes and dtypes of the arrays that a store may have kept."""
    plain, cells = lattice.node_count, lattice.node_count - lattice.cell_base
    # Behind the errors of a bicubic surface are the bends of the raster's cells.
    errors = {"error": plain, "error_c": plain + cells}
    kept = {f"{name}_m{m}": ((n,), np.uint8) for name, n in errors.items() for m in range(1, MAX_MESHLET + 1)}
    kept |= {"error_c": ((plain + cells,), np.uint8), "ranges_c": ((lattice.range_count + cells, 2), np.uint16)}
    # Six numbers, and the exponents of the groups, the cells and the bends.
    return kept | {"numbers_c": ((6 + lattice.groups + 2,), np.float64)}


def data_folder(field: HeightField) -> Path | None:
    """Where a field's arrays lie now, or None for a field in memory or whose store has been replaced."""
    if field.path is None:
        return None
    try:
        content = read_json(field.path)
    except TerrainError:
        return None
    return field.path / content["data"] if content["key"] == field.raster_key else None


def load_kept(field: HeightField, name: str, shape: tuple, dtype) -> np.ndarray | None:
    """An array that was made of a field and kept as NAME.npy, if there is one."""
    folder = data_folder(field)
    if folder is None:
        return None
    try:
        return map_array(folder / f"{name}.npy", shape, dtype)
    except (OSError, TerrainError):
        return None


def keep(field: HeightField, name: str, array: np.ndarray) -> None:
    """Keep an array that was made of a field as NAME.npy; a store that cannot be written is left as it is."""
    folder = data_folder(field)
    if folder is None:
        return
    partial_files.remove_abandoned(folder)
    with suppress(OSError):
        write_array(folder / f"{name}.npy", array)


class Draft:
    """A version of a store while it is written; nothing of it is visible until `publish`."""

    def __init__(self, path: Path, name: str | None = None):
        self.path = path
        self._made = missing_folders(path)
        self.folder = path / (name or new_data_name())
        self._lock = partial_files.make_folder(self.folder, parents=True)
        self.published = False
        self._arrays: dict[str, np.ndarray] = {}

    def allocate(self, name: str, shape: tuple, dtype) -> np.ndarray:
        """A new zeroed array in the file NAME.npy, mapped for writing; its space on disk is taken now.

        Raises OSError (ENOSPC) now if the disk is full: a mapped page that finds no room later would kill the process.
        """
        file = self.folder / f"{name}.npy"
        file.write_bytes(header(shape, dtype))
        if not np.prod(shape):
            return np.empty(shape, dtype)
        nbytes = file_bytes(math.prod(shape) * np.dtype(dtype).itemsize)
        with file.open("r+b") as handle:
            handle.truncate(nbytes)
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(handle.fileno(), 0, nbytes)
        self._arrays[name] = array = np.load(file, mmap_mode="r+").view(np.ndarray)
        return array

    def remove(self, name: str) -> None:
        del self._arrays[name]
        owned_files.remove_file(self.folder / f"{name}.npy")

    def rename(self, name: str, new: str) -> None:
        self._arrays[new] = self._arrays.pop(name)
        os.replace(self.folder / f"{name}.npy", self.folder / f"{new}.npy")

    def publish(self, field: HeightField, digest: str, report: dict, layers: Mapping[str, str] | None = None) -> None:
        """Make this the store's content: `digest` identifies the source and settings, `report` is shown to users;
        `layers`: the units of those that were allocated, by their names.

        Raises TerrainError where the result could not be opened; the store is then as it was.
        """
        for name in [name for name in self._arrays if name in _SCRATCH]:
            self.remove(name)
        for name, array in self._arrays.items():
            with (self.folder / f"{name}.npy").open("r+b") as file:
                file.seek(PAGE_BYTES + array.nbytes)
                file.write(all_checksums(array))
        content = {
            "version": VERSION,
            "data": self.folder.name,
            "digest": digest,
            "key": field.key,
            "holes": field.valid is not None,
            "lattice": {name: getattr(field.lattice, name) for name in LATTICE},
            "steps": field.steps and [field.steps.first, field.steps.scale, field.steps.offset],
            **{name: getattr(field, name) for name in _NUMBERS},
            "origin": [float(c) for c in field.origin],
            "crs": field.crs,
            **({"layers": layers} if layers else {}),
            "provenance": field.provenance,
            "report": report,
        }
        part = self.folder / JSON_NAME
        part.write_text(self._checked_text(content), encoding="utf-8")
        check_version(self.path, part)
        previous = named_folder(self.path)
        with open_folder(self.path) as store, store.open_inner(self.folder.name) as arrays:
            store.replace(JSON_NAME, arrays, JSON_NAME)
        self.published = True
        partial_files.end_work(self.folder, self._lock)
        with suppress(OSError, NotOursError):  # what is not the program's keeps its folder
            if previous is not None:
                remove_arrays(previous)
        remove_abandoned(self.path)

    def _checked_text(self, content: dict) -> str:
        """Return the JSON of a new version. Raises TerrainError where reading it would fail."""
        try:
            content["sum"] = _sum_of(json.loads(json.dumps(content)))
            check_entries(json.loads(json.dumps(content)))
            text = json.dumps(content, indent=1, allow_nan=False)
            if len(text) > MAX_JSON_BYTES:
                raise ValueError(f"its description has more than {MAX_JSON_BYTES} characters")
        except ValueError as fault:
            raise TerrainError(
                f"The store {self.path} stays as it was, because the new terrain cannot be stored: {fault}; check its "
                "heights, height scale and offset, extent and georeference."
            ) from None
        return text

    def discard_unless_published(self) -> None:
        """Take away what was written for nothing; a store that stood there before is untouched."""
        if self.published:
            return
        os.close(self._lock)
        discard(self.path, self.folder.name, self._made)
