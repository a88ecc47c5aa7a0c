# SPDX-License-Identifier: GPL-3.0-or-later
"""A terrain surface as one .npz file. Its bytes depend on the arguments alone, not on machine or time."""

import io
import json
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import TerrainError, check_kind, check_path, shown
from ..plain_numbers import rows
from ..run.named_file import open_regular
from ..run.partial_files import written_beside
from .surface import Surface, check_surface

# The earliest date that a zip can hold: the bytes do not depend on the time.
FIXED_DATE = (1980, 1, 1, 0, 0, 0)
MAX_ENTRIES = 64


def write_npz(
    path: str | os.PathLike,
    surface: Surface,
    origin: ArrayLike = (0.0, 0.0, 0.0),
    info: Mapping[str, object] = MappingProxyType({}),
    tree: bytes = b"",
) -> None:
    """Write a `Surface` to `path`, atomically.

    Entries: `positions` float32 [V, 3], metres about `origin` float64 [3]; `triangles` int32 [T, 3], counter-clockwise
    seen from above; `edges` int32 [E, 2]; every attribute by its name; `tree` uint8 [bytes], a saved tree (see
    `Terrain.restore`), if one is given; and `info`, JSON text (no times, so that it is a function of the frame alone),
    with the domains and units of the attributes under "attributes". Raises TerrainError for an attribute with the name
    of another entry, for a number that is not finite, and for a value of `info` that JSON cannot hold; and OSError if
    the file cannot be written.
    """
    check_path("The file", path)
    check_surface(surface)
    check_kind(info, Mapping, "The info of the file", "a dict")
    check_kind(tree, bytes, "The saved tree", "bytes, as Terrain.saved returns them")
    places = rows(origin, 3, "origin")
    if len(places) != 1:
        raise TerrainError(f"The origin came as {len(places)} points", expected="x, y and z in metres")
    about = {name: {"domain": a.domain, "unit": a.unit} for name, a in surface.attributes.items()}
    entries = {
        "positions": surface.positions,
        "origin": places[0],
        "triangles": surface.triangles,
        "edges": surface.edges,
        "tree": np.frombuffer(tree, np.uint8),
        "info": np.array(finite_json(dict(info) | {"attributes": about}, str(path), sort_keys=True, default=_to_json)),
    }
    if clashes := entries.keys() & surface.attributes.keys():
        raise TerrainError(
            f"An attribute is named {min(clashes)!r}, which is an entry of every exported file",
            where=shown(path),
            fix="give it another name",
        )
    if not tree:
        del entries["tree"]
    entries |= {name: attribute.array for name, attribute in surface.attributes.items()}
    for name, array in entries.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise TerrainError(
                f"The array {shown(name)} holds a value that is not a finite number",
                where=shown(path),
                expected="finite numbers",
                fix="import the terrain again, or remove the attribute",
            )
    with written_beside(Path(path)) as partial, zipfile.ZipFile(partial, "w", zipfile.ZIP_STORED) as archive:
        for name, array in entries.items():
            archive.writestr(zipfile.ZipInfo(f"{name}.npy", FIXED_DATE), _npy(array))


def finite_json(content: Mapping, where: str, **options: Any) -> str:
    """Return JSON text. Raises TerrainError for a number that is not finite, which JSON cannot hold.

    where: the file, in the error. options: of json.dumps.
    """
    try:
        return json.dumps(content, allow_nan=False, **options)
    except ValueError:
        raise TerrainError(
            "A number of the file's description is not finite",
            where=where,
            expected="finite numbers",
            fix="check the camera and the terrain's scale",
        ) from None


def read_npz(path: str | os.PathLike) -> dict:
    """Return the entries of a file of `write_npz`, with `info` as a dict. Raises TerrainError for any other file."""
    check_path("The file", path)
    path = Path(path)
    try:
        with open_regular(path, links=True) as file, zipfile.ZipFile(file) as archive:
            # `write_npz` does not compress, so the file's size bounds the size of its content.
            if len(archive.infolist()) > MAX_ENTRIES or any(e.compress_type for e in archive.infolist()):
                raise ValueError("its entries are compressed or too many")
            entries = {name.removesuffix(".npy"): _array(archive, name) for name in archive.namelist()}
        if "info" not in entries:
            raise ValueError("it has no entry 'info'")
        info = json.loads(str(entries["info"]), parse_constant=_refuse_constant)
        if not isinstance(info, dict):
            raise ValueError("its entry 'info' is no JSON object")
    except OSError as reason:
        why = reason.strerror or reason
        raise TerrainError(
            f"The file cannot be read: {shown(why)}", where=shown(path), expected="an exported .npz"
        ) from reason
    except Exception as reason:  # whatever the parsers of a damaged file raise
        why = shown(reason).rstrip(".") or type(reason).__name__
        raise TerrainError(
            f"The file is not an .npz that this add-on exported: {why}", where=shown(path), fix="export it again"
        ) from reason
    return entries | {"info": info}


def _refuse_constant(name: str) -> None:
    """Raise ValueError for NaN or Infinity, which are no JSON, in `info`."""
    raise ValueError(f"its entry 'info' has the number {name}")


def _to_json(value: object) -> object:
    """Convert a number or an array of numpy for JSON. Raises TerrainError for anything else."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TerrainError(f"The info of an .npz holds {shown(repr(value))}", expected="texts, numbers, lists and objects")


def _array(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """Return the array of an entry; pickled objects are refused, because loading them runs code."""
    with archive.open(name) as entry:
        return np.lib.format.read_array(entry, allow_pickle=False)


def _npy(array: np.ndarray) -> bytes:
    """Convert an array to the bytes of an .npy file, in C order and little endian."""
    buffer = io.BytesIO()
    array = np.asarray(array, order="C")
    np.lib.format.write_array(buffer, array.astype(array.dtype.newbyteorder("<"), copy=False), allow_pickle=False)
    return buffer.getvalue()
