# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights in an OpenEXR file.

OpenEXR is imported inside `open_exr` only, which runs in the import's child process: inside the real Blender program
its symbols bind to Blender's own library and reading crashes.
"""

from pathlib import Path

from ..errors import TerrainError
from ..run.memory import physical_memory
from .raster import ImportSettings, Raster, blank, cause

# Where a height is looked for, in this order, when no channel is named; then the first channel.
CHANNELS = ("height", "Height", "Y", "Z", "V", "R")
# Times that EXR's methods can pack pixels at most (zlib: 1,030), with a margin for the others.
MOST_PACKED = 20_000


def open_exr(path: Path, settings: ImportSettings) -> Raster:
    """Read one channel of an EXR file's first part. Raises TerrainError if it cannot be used."""
    import OpenEXR

    try:
        part = OpenEXR.File(str(path), separate_channels=True, header_only=True).parts[0]
        header = part.header
        low, high = header["dataWindow"]
        channels = {channel.name: (channel.xSampling, channel.ySampling) for channel in header["channels"]}
    except Exception as reason:
        raise TerrainError(f"{path} cannot be read as OpenEXR ({cause(reason)}): get the file again.") from reason
    width, height = (int(high[axis]) - int(low[axis]) + 1 for axis in (0, 1))
    name = settings.channel or next((c for c in CHANNELS if c in channels), next(iter(channels), ""))
    if name not in channels:
        raise TerrainError(f"{path} has no channel {name!r}: choose one of {', '.join(channels)}.")
    if channels[name] != (1, 1):
        raise TerrainError(f"{path} stores channel {name!r} at a fraction of the resolution: expected every pixel.")
    needed = width * height * len(channels) * 4
    if width < 1 or height < 1 or needed > min(physical_memory() // 4, MOST_PACKED * path.stat().st_size):
        raise TerrainError(
            f"{path} says that it holds {width} x {height} pixels in {len(channels)} channels, {needed / 1e9:.1f} GB: "
            "more than a quarter of this machine's memory or than such a file can hold, so it is damaged or must be "
            "cut into tiles."
        )
    try:
        parts = OpenEXR.File(str(path), separate_channels=True).parts
        if not parts:
            raise ValueError("its pixels cannot be decoded")
        pixels = parts[0].channels[name].pixels
    except Exception as reason:
        raise TerrainError(f"{path} is damaged or incomplete ({cause(reason)}): get the file again.") from reason
    if pixels.shape != (height, width):
        raise TerrainError(
            f"{path} holds {pixels.shape} pixels, its header says {(height, width)}: get the file again."
        )
    return Raster(
        width=width,
        height=height,
        read=lambda first, count: blank(pixels[first : first + count], settings.no_data),
        stored=str(pixels.dtype),
        format=f"OpenEXR channel {name}",
    )
