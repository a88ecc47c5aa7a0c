# SPDX-License-Identifier: GPL-3.0-or-later
"""A camera's flight as a JSON file of keyframes, for exports without Blender.

    {"fov": 50,
     "clip": [0.1, 100000],
     "keyframes": [{"frame": 1, "eye": [0, -2000, 900], "target": [0, 0, 300]},
                   {"frame": 24, "eye": [1500, -800, 400], "target": [0, 0, 300], "fov": 35}]}

`eye` and `target` are metres in the terrain's own space (x east, y north, z up, the terrain's middle at x = y = 0);
`fov` is degrees across the larger side of the picture, or `lens` millimetres before a `sensor` of 36 millimetres.
Between keyframes every number follows a cubic Hermite curve with finite-difference tangents (Catmull-Rom on uneven
frames), in float64: the flight passes through its keyframes with continuous speed. Outside, the end keyframe holds.
The field of view is interpolated as the logarithm of its half's tangent, so that no curve leaves 0 .. 180 degrees.
"""

import json
import math
import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import TerrainError, named_once, shown
from ..run.named_file import read_named
from .linear import length
from .view import View

MAX_BYTES = 1 << 26
EXPECTED = "a JSON file of keyframes"
TOP_KEYS = {"fov", "lens", "sensor", "clip", "keyframes"}
KEY_KEYS = {"frame", "eye", "target", "fov", "lens"}
# Degrees; beyond, a picture's scale loses its digits.
SMALLEST_FOV, LARGEST_FOV = 1e-6, 180.0 - 1e-6


@dataclass(frozen=True, eq=False)
class CameraPath:
    """Keyframes: `frames` float64 [K], rising; `values` float64 [K, 7]: eye, target, log(tan(field of view / 2)).

    `clip`: start and end of the clip range, metres, of all frames.
    """

    frames: np.ndarray
    values: np.ndarray
    clip: tuple[float, float]

    def view(self, frame: float, resolution: tuple[int, int]) -> View:
        """Return the view at a frame, interpolated, for a picture of `resolution` pixels. Raises TerrainError."""
        with np.errstate(all="ignore"):  # the result is checked below
            values = hermite(self.frames, self.values, frame)
            distance = length(values[:3] - values[3:6])
        if not np.isfinite([*values, distance]).all() or distance == 0.0:
            raise TerrainError(
                f"The camera path has no place and direction at frame {frame:g}",
                expected="keyframes whose frames, eyes and targets are neither too near each other nor too far apart",
            )
        # values[6] is log(tan(fov / 2)). A curve may swing beyond its keyframes, so far that `exp` would overflow.
        fov = math.degrees(2 * math.atan(math.exp(min(max(float(values[6]), -50.0), 50.0))))
        fov = min(max(fov, SMALLEST_FOV), LARGEST_FOV)
        return View.look(values[:3], values[3:6], fov_deg=fov, resolution=resolution, clip=self.clip)


def hermite(times: np.ndarray, values: np.ndarray, at: float) -> np.ndarray:
    """Evaluate the cubic Hermite curve through `values` [K, N] at rising `times` [K]; `at` is clamped to the ends.

    Its tangents are finite differences of the keyframes.
    """
    at = min(max(float(at), times[0]), times[-1])
    if len(times) == 1:
        return values[0].copy()
    slopes = np.gradient(values, times, axis=0)
    i = min(int(np.searchsorted(times, at, side="right")) - 1, len(times) - 2)
    duration = times[i + 1] - times[i]
    t = (at - times[i]) / duration  # from keyframe i to the next, 0 .. 1
    return (
        (1 + 2 * t) * (1 - t) * (1 - t) * values[i]
        + t * (1 - t) * (1 - t) * duration * slopes[i]
        + t * t * (3 - 2 * t) * values[i + 1]
        + t * t * (t - 1) * duration * slopes[i + 1]
    )


def read_camera_path(path: Path) -> CameraPath:
    """Read and check a camera path; raises TerrainError with the file, the keyframe and the expected value."""
    path = Path(path)
    text = read_named(path, "The camera path", EXPECTED, MAX_BYTES)
    try:
        data = json.loads(text.decode("utf-8-sig"), object_pairs_hook=named_once)
    except (ValueError, RecursionError) as error:
        raise TerrainError(f"The camera path {path} cannot be read ({shown(error)})", expected=EXPECTED) from None
    if not isinstance(data, dict) or not isinstance(data.get("keyframes"), list) or not data["keyframes"]:
        raise TerrainError(f"The camera path {path} has no keyframes", expected='{"keyframes": [{"frame": 1, ...}]}')
    file = f"In the camera path {path}, the file"
    _check_names(file, data, TOP_KEYS)
    clip = _clip(file, data)
    sensor = _read_number(file, data, "sensor", 36.0)
    frames, values = [], []
    for number, keyframe in enumerate(data["keyframes"], 1):
        where = f"In the camera path {path}, keyframe {number}"
        if not isinstance(keyframe, dict):
            raise TerrainError(f"{where} is {keyframe!r}", expected="an object with frame, eye, target")
        _check_names(where, keyframe, KEY_KEYS)
        frames.append(_read_number(where, keyframe, "frame"))
        eye, target = (_read_numbers(where, keyframe, name, 3) for name in ("eye", "target"))
        if eye == target:
            raise TerrainError(f"{where} has its eye at its target", expected="different points")
        fov = _field_of_view(where, keyframe if {"fov", "lens"} & set(keyframe) else data, sensor)
        values.append([*eye, *target, math.log(math.tan(math.radians(fov) / 2))])
    if any(a >= b for a, b in pairwise(frames)):
        problem = f"In the camera path {path}, the frames are {frames}"
        raise TerrainError(problem, expected="each larger than the one before")
    return CameraPath(np.array(frames), np.array(values), clip)


def _clip(where: str, data: dict) -> tuple[float, float]:
    """Return the clip range (start, end), metres; a start beyond the end is allowed and clips nothing.

    Raises TerrainError for a range whose projection matrix would overflow. where: subject of errors, the file.
    """
    start, end = _read_numbers(where, {"clip": [0.1, 1e6]} | data, "clip", 2)
    if start == end or not math.isfinite(2 * start * end / (start - end)):
        raise TerrainError(f"{where} has clip {[start, end]!r}", expected="two different distances (m)")
    return start, end


def _field_of_view(where: str, data: dict, sensor: float) -> float:
    """Return the field of view in degrees: `fov`, else computed from `lens`, else 50. Raises TerrainError.

    where: subject of errors. data: JSON object. sensor: width in millimetres.
    """
    if "lens" in data and "fov" not in data:
        lens = _read_number(where, data, "lens")
        fov = math.degrees(2 * math.atan2(sensor / 2, lens))
    else:
        fov = _read_number(where, data, "fov", 50.0)
    if not SMALLEST_FOV <= fov <= LARGEST_FOV:
        expected = f"between {SMALLEST_FOV:g} and {LARGEST_FOV:.9g}"
        raise TerrainError(f"{where} has a field of view of {fov:g} degrees", expected=expected)
    return fov


def _check_names(where: str, data: dict, known: set[str]) -> None:
    """Raise TerrainError for a name in `data` that is not `known`. where: subject of the error, as a keyframe."""
    if unknown := sorted(set(data) - known):
        raise TerrainError(f"{where} has {unknown[0]!r}", expected=", ".join(sorted(known)))


def _read_number(where: str, data: dict, name: str, default: float | None = None) -> float:
    """Return the number `name` of a JSON object, or its default. Raises TerrainError. where: subject of the error."""
    return _read_numbers(where, {name: [data.get(name, default)]}, name, 1)[0]


def _read_numbers(where: str, data: dict, name: str, count: int) -> list[float]:
    """Return the list of `count` finite numbers that `data` has as `name`. Raises TerrainError with file and keyframe.

    A single number comes as a list of one, from `_read_number`. where: subject of the error, as a keyframe.
    """
    value: Any = data.get(name)
    is_list = isinstance(value, list) and len(value) == count
    if not is_list or not all(type(v) in (int, float) and abs(v) <= sys.float_info.max for v in value):
        wrong = value[0] if isinstance(value, list) and count == 1 else value
        expected = "a number" if count == 1 else f"{count} numbers"
        raise TerrainError(f"{where} has {name} {wrong!r}", expected=expected)
    return [float(v) for v in value]
