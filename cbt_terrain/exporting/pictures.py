# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendered maps with a position: world files, and GeoTIFF files that a child process writes.

A transform is six numbers from pixels to coordinates: a step of a column in x and of a row in x, x of the corner, and
the same for y. A world file has the middle of the first pixel instead of its corner.
"""

from collections.abc import Sequence
from pathlib import Path

from ..errors import unwritable
from ..run import child
from ..run.partial_files import written_beside
from ..sandbox.store_job import ask, serve

MODULE = "cbt_terrain.exporting.pictures"
# By suffix of a picture: suffix of its world file.
WORLD_FILES = {".png": ".pgw", ".jpg": ".jgw", ".jpeg": ".jgw", ".tif": ".tfw", ".tiff": ".tfw"}
BAND = 256  # rows


def write_world_file(picture: Path, transform: Sequence[float]) -> Path:
    """Write the world file beside a picture, whose suffix is one of WORLD_FILES; return its path. Raises OSError.

    transform: six numbers (a, b, x, d, e, y) of the affine map from pixels to coordinates.
    """
    a, b, x, d, e, y = transform
    lines = a, d, b, e, x + (a + b) / 2, y + (d + e) / 2  # it locates the middle of the first pixel, not its corner
    path = picture.with_suffix(WORLD_FILES[picture.suffix.lower()])
    with written_beside(path) as partial:
        partial.write_text("".join(f"{number!r}\n" for number in lines), encoding="ascii")
    return path


def write_geotiffs(pictures: Sequence[tuple[Path, Path, Sequence[float]]], crs: str) -> None:
    """Write pictures, at least one, into GeoTIFF files: (picture, file, transform) of each. Raises TerrainError.

    A file may have the picture's name. crs: name of the coordinate system, "" for none.
    """
    listed = [[str(picture.absolute()), str(file.absolute()), list(numbers)] for picture, file, numbers in pictures]
    ask(MODULE, {"pictures": listed, "crs": crs}, f"the picture {pictures[0][0]}")


def child_main() -> None:
    """Answer the request on stdin."""
    serve(_answer, lambda request: f"Reading the picture {request['pictures'][0][0]}")


def _answer(request: dict, *_: object) -> dict:
    """Write the requested pictures as GeoTIFFs in the child process. Raises TerrainError.

    A request has the `crs` and `pictures`: the file of each, the GeoTIFF to write and six numbers of its transform.
    """
    from rasterio.errors import RasterioError

    child.end_with_parent()
    for picture, file, transform in request["pictures"]:
        try:
            _write_geotiff(picture, Path(file), transform, request["crs"])
        except (OSError, RasterioError) as reason:
            raise unwritable(f"The map {file}", reason) from reason
    return {}


def _write_geotiff(source: str, path: Path, transform: Sequence[float], crs: str) -> None:
    """Copy a picture into a compressed GeoTIFF; transform: six affine numbers. crs: "" for none."""
    import rasterio
    from rasterio.transform import Affine
    from rasterio.windows import Window

    with rasterio.open(source) as picture, written_beside(path) as partial:
        options = {"driver": "GTiff", "width": picture.width, "height": picture.height, "count": picture.count}
        options |= {"dtype": picture.dtypes[0], "transform": Affine(*transform), "crs": crs or None}
        options |= {"compress": "deflate", "tiled": True, "BIGTIFF": "IF_SAFER"}
        with rasterio.open(partial, "w", **options) as file:
            file.colorinterp = picture.colorinterp
            for first in range(0, picture.height, BAND):
                window = Window(0, first, picture.width, min(BAND, picture.height - first))
                file.write(picture.read(window=window), window=window)
