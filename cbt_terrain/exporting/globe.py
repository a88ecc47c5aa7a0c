# SPDX-License-Identifier: GPL-3.0-or-later
"""Points of a terrain on the globe: Earth-centred coordinates (ECEF, WGS 84) and a frame at the terrain's middle.

A child process asks PROJ for longitude and latitude, since GDAL clashes with Blender. Heights count from the ellipsoid.
"""

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..field.georeference import WGS84
from ..importing.placing import Placing
from ..run import child
from ..run.partial_files import private_folder
from ..sandbox.store_job import ask, serve

MODULE = "cbt_terrain.exporting.globe"
# Metres from the middle to the point that gives the direction of the frame's x axis.
ARM = 1.0


@dataclass(frozen=True, eq=False)
class GlobeFrame:
    """The frame at a terrain's middle: x as the terrain's x, z up.

    Attributes:
        origin: float64 [3], ECEF coordinates of the middle at height 0.
        axes: float64 [3, 3], a row for each axis in ECEF.
    """

    origin: np.ndarray
    axes: np.ndarray

    def transform(self) -> list[float]:
        """Return the matrix from the frame to ECEF metres, 4 x 4 as 16 numbers column by column, as 3D Tiles has it."""
        columns = [[*axis.tolist(), 0.0] for axis in self.axes]
        return [number for column in columns for number in column] + [*self.origin.tolist(), 1.0]

    def to_frame(self, vectors: np.ndarray) -> np.ndarray:
        """Turn vectors [n, 3] of ECEF into the frame's axes.

        It is written out because the last bits of BLAS differ by processor.
        """
        return (vectors[:, None] * self.axes).sum(2)


def place_on_globe(placing: Placing, positions: np.ndarray, folder: Path) -> tuple[GlobeFrame, np.ndarray, np.ndarray]:
    """Return the frame of a terrain, and positions and unit vectors upwards in it, float64 [n, 3]. Raises TerrainError.

    Args:
        placing: the terrain's position in a named coordinate system.
        positions: float64 [n, 3], points of the terrain's space.
        folder: for a file that the child process reads.
    """
    # The middle, and points ARM metres west and east of it that give the direction of x.
    about_middle = np.array([[0.0, 0.0, 0.0], [-ARM, 0.0, 0.0], [ARM, 0.0, 0.0]])
    points, up = _earth_centred(placing, np.concatenate([about_middle, positions]), folder)
    along = points[2] - points[1]
    along = along - up[0] * (along * up[0]).sum()  # without its vertical part
    x = along / np.sqrt((along**2).sum())
    frame = GlobeFrame(points[0], np.stack([x, np.cross(up[0], x), up[0]]))
    return frame, frame.to_frame(points[3:] - frame.origin), frame.to_frame(up[3:])


def _earth_centred(placing: Placing, positions: np.ndarray, folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return ECEF coordinates of points, and the ellipsoid's upward normals there, both float64 [n, 3].

    positions: float64 [n, 3] in the terrain's space, heights above the ellipsoid. folder: where files for the child
    process that asks PROJ are written.
    """
    with private_folder(folder) as private:
        path = private / "coordinates.npy"
        _save(path, placing.from_terrain(positions[:, :2]))
        ask(MODULE, {"crs": placing.crs, "path": str(path.absolute())}, f"the coordinate system {placing.crs}")
        longitude, latitude = np.radians(np.load(path)).T
    semi_major, inverse_flattening = WGS84
    flattening = 1.0 / inverse_flattening
    eccentricity2 = flattening * (2.0 - flattening)  # of the ellipsoid, squared
    across = np.cos(latitude)
    up = np.stack([across * np.cos(longitude), across * np.sin(longitude), np.sin(latitude)], axis=-1)
    # The radius of curvature across the meridian, by which longitude, latitude and height become coordinates.
    radius, height = semi_major / np.sqrt(1.0 - eccentricity2 * up[:, 2] ** 2), positions[:, 2]
    points = (radius + height)[:, None] * up
    points[:, 2] = (radius * (1.0 - eccentricity2) + height) * up[:, 2]
    return points, up


def child_main() -> None:
    """Answer the request on stdin."""
    serve(_answer, lambda request: f"Reading the coordinate system {request['crs']}")


def _answer(request: dict, *_: object) -> dict:
    """Convert projected coordinates in the file `path` to longitude and latitude in degrees, in place.

    Run in a child process, since PROJ must not be loaded into Blender.
    """
    from rasterio.crs import CRS
    from rasterio.warp import transform

    child.end_with_parent()
    x, y = np.load(request["path"]).T
    degrees = transform(CRS.from_string(request["crs"]), CRS.from_epsg(4326), x.tolist(), y.tolist())
    _save(Path(request["path"]), np.stack(degrees, -1))
    return {}


def _save(path: Path, array: np.ndarray) -> None:
    """Write an array as .npy. `np.save` into a file would not name the reason of a failure. Raises OSError."""
    content = io.BytesIO()
    np.save(content, array)
    path.write_bytes(content.getvalue())
