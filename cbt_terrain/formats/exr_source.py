# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights in an OpenEXR file.

OpenEXR is imported inside functions only, which run in the import's child process: inside the real Blender program
its symbols bind to Blender's own library and reading crashes.
"""

from pathlib import Path

import numpy as np

from ..errors import TerrainError, shown
from ..rasters.raster import ImportSettings, Raster, blank, cause
from ..rasters.rounding import SourceRounding
from ..run.memory import physical_memory
from .exr_channels import ExrChannel, channels_by_name, likeliest

# Largest compression ratio of EXR's methods (zlib: 1,030), with a margin for the others.
MAX_RATIO = 20_000
PXR24_BITS = 16  # significant bits that this method leaves of a float32
# Channels that the methods DWAA and DWAB pack with loss, by the last part of their names.
DWA_CHANNELS = ("r", "g", "b", "y", "ry", "by", "red", "grn", "green", "blu", "blue")


def open_exr(path: Path, settings: ImportSettings) -> Raster:
    """Read the channel that the settings name, or the likeliest one, of an EXR file into memory.

    Raises TerrainError for a file, a size or a channel that cannot be used.
    """
    import OpenEXR

    try:  # a file has parts, each with a header and channels
        headers = [part.header for part in OpenEXR.File(str(path), separate_channels=True, header_only=True).parts]
        names = [header.get("name", "") if len(headers) > 1 else "" for header in headers]
        channels = [
            ExrChannel(number, str(names[number]), channel.name, (channel.xSampling, channel.ySampling))
            for number, header in enumerate(headers)
            for channel in header["channels"]
        ]
        sizes = [_part_size(header) for header in headers]
    except Exception as reason:
        raise TerrainError(f"{path} cannot be read as OpenEXR ({cause(reason)})", fix="get the file again") from reason
    channel, also_named = _choose(path, channels, settings.channel)
    width, height = sizes[channel.part]
    # A header may claim any size. All channels count, 4 bytes a pixel, against the memory and the size of the file.
    num_pixels = sum(int(sizes[c.part][0] * sizes[c.part][1]) for c in channels)
    if min(map(min, sizes)) < 1 or 4 * num_pixels > min(physical_memory() // 4, MAX_RATIO * path.stat().st_size):
        raise TerrainError(
            f"{path} has a header of {width} x {height} pixels in {len(channels)} channels, {4e-9 * num_pixels:.1f} GB",
            expected="at most a quarter of this machine's memory, and no more than a file of this size can hold",
            fix="get the file again, or cut it into tiles",
        )
    pixels = _read_channel(path, channel)
    if pixels.shape != (height, width):
        raise TerrainError(
            f"{path} holds {pixels.shape} pixels", expected=f"{(height, width)} by its header", fix="get the file again"
        )
    rounding = _channel_rounding(str(pixels.dtype), channel, headers[channel.part]["compression"].name)
    notes = []
    if len(channels) > 1 and not settings.channel:
        others = [c.full_name for c in channels if c is not channel]
        notes.append(
            f"The file has {len(channels)} channels; {shown(channel.full_name)} is taken as the height. If another one "
            f"is, name it (--channel): {shown(', '.join(others))}."
        )
    if also_named:
        full_names = shown(", ".join(c.full_name for c in also_named))
        notes.append(
            f"The file has {len(also_named) + 1} channels that {shown(settings.channel)!r} may mean; "
            f"{shown(channel.full_name)} is taken. If another one is meant, give its full name (--channel): "
            f"{full_names}."
        )
    return Raster(
        width=width,
        height=height,
        read=lambda first, count: blank(pixels[first : first + count], settings.no_data),
        stored=str(pixels.dtype),
        format=f"OpenEXR channel {shown(channel.full_name)}",
        roundings=(rounding,),
        warnings=notes,
    )


def _part_size(header: dict) -> tuple[int, int]:
    """Return the width and the height of a part of an OpenEXR file, from its header."""
    low, high = header["dataWindow"]
    return int(high[0]) - int(low[0]) + 1, int(high[1]) - int(low[1]) + 1


def _choose(path: Path, channels: list[ExrChannel], name: str) -> tuple[ExrChannel, list[ExrChannel]]:
    """Return the channel with the given name, or the likeliest one, and others that the name may mean.

    Raises TerrainError if there is none, or if it does not have a sample for every pixel.
    """
    if not channels:
        raise TerrainError(f"{path} has no channels", expected="a channel of heights", fix="get the file again")
    candidates = channels_by_name(channels, name) if name else [likeliest(channels, channels)]
    if not candidates:
        known = ", ".join(c.full_name for c in channels)
        raise TerrainError(f"{path} has no channel {shown(name)!r}", fix=f"choose one of {shown(known, 500)}")
    channel, *others = candidates
    if channel.sampling != (1, 1):
        raise TerrainError(
            f"{path} stores channel {shown(channel.full_name)!r} at a fraction of the resolution",
            expected="every pixel",
        )
    return channel, others


def _read_channel(path: Path, channel: ExrChannel) -> np.ndarray:
    """Return the samples of a channel, [rows, columns]. Raises TerrainError if they are damaged."""
    import OpenEXR

    try:
        parts = OpenEXR.File(str(path), separate_channels=True).parts
        if not parts:
            raise ValueError("its pixels cannot be decoded")
        return parts[channel.part].channels[channel.name].pixels
    except Exception as reason:
        raise TerrainError(f"{path} is damaged or incomplete ({cause(reason)})", fix="get the file again") from reason


def _channel_rounding(stored: str, channel: ExrChannel, compression: str) -> SourceRounding:
    """Return the rounding of a channel's samples by their type and the file's compression. stored: dtype's name."""
    method = compression.removesuffix("_COMPRESSION")
    bits = PXR24_BITS if method == "PXR24" and stored == "float32" else 0
    lossy = (
        (method in ("B44", "B44A") and stored == "float16")
        or (method in ("DWAA", "DWAB") and stored != "uint32" and channel.component in DWA_CHANNELS)
        or method == "LJ2K"
    )
    return SourceRounding(stored, bits, lossy=method if lossy else "")
