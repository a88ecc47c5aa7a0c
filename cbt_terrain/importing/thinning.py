# SPDX-License-Identifier: GPL-3.0-or-later
"""Quick import: every n-th sample of a large raster, so that its land is shown within seconds.

The first and the last column and row are always read, so the coarse land covers the ground of the complete one and has
the same middle. If the step does not divide the raster, samples in between are off their positions by up to half a step
of the raster. If unpacking all samples would take long, overviews of the file are read instead: means over an eighth of
the coarse step around each position. Overviews as coarse as the step itself would shift the land by half a step.
"""

from dataclasses import replace

import numpy as np

from ..field.georeference import LARGEST_EXTENT, Georeference
from ..field.heightfield import LOADED
from ..rasters.raster import ImportSettings, Raster

QUICK_SAMPLES = 9 << 19  # 4.7 million: 2 s of work after they are read
# A raster of at most this many times the samples is imported completely: 0.34 us a sample make about 24 s.
WORTHWHILE = 15
# Samples that are unpacked at most if there are overviews: 4 ns a sample make 9 s for deflate.
MAX_UNPACKED = 1 << 31
FINER = 8  # ratio of the coarse step to an overview's: a mean is off its position by up to 1/16 of the coarse step
FROM_OVERVIEWS = {"loaded_from": "overviews"}  # entry of the report
# Entry of an incomplete store's provenance beside LOADED.
REFINED = "refined_m"  # metres between the samples of the loaded tiles, and their number


def stride_of(width: int, height: int, max_samples: int) -> int:
    """Return the step, the smallest power of two, that leaves `max_samples` of a raster at most.

    It is 1 for a raster whose complete import takes little longer.
    """
    if width * height <= WORTHWHILE * max_samples:
        return 1
    stride = 2
    while len(positions(width, stride)) * len(positions(height, stride)) > max_samples and stride < max(width, height):
        stride *= 2
    return stride


def positions(count: int, stride: int) -> np.ndarray:
    """Return about every stride-th of `count` columns or rows, the first and the last one included, int64."""
    if count < 3:
        return np.arange(count)
    return spread(count, -(-(count - 1) // stride))


def spread(count: int, cells: int) -> np.ndarray:
    """Return, of `count` columns or rows, those nearest to the corners of `cells` equal cells along them: int64."""
    return (2 * np.arange(cells + 1) * (count - 1) + cells) // (2 * cells)  # a rounded quotient


def thinned(raster: Raster, settings: ImportSettings) -> Raster:
    """Return a raster of at most `settings.quick` samples of another, or that raster if it needs no quick import.

    It reads rows of the other one, or of an overview of its file, and closes both. A raster with a function `pick`,
    such as a mosaic, reads single samples instead of rows.
    """
    stride = stride_of(raster.width, raster.height, settings.quick)
    if stride == 1:
        return raster
    columns, rows = positions(raster.width, stride), positions(raster.height, stride)
    is_long = raster.width * raster.height > MAX_UNPACKED  # to unpack
    small = raster.overview(stride // FINER) if is_long else None
    if small is not None:
        raster.details.update(FROM_OVERVIEWS)
    source = small or raster
    # the columns and rows of the source in which the wanted samples are
    wanted_columns = scaled(columns, raster.width, source.width)
    wanted_rows = scaled(rows, raster.height, source.height)

    def read(first: int, count: int) -> np.ndarray:
        """Return `count` rows from row `first` on of the coarse raster."""
        if raster.pick is None:
            wanted = wanted_rows[first : first + count]
            values = np.concatenate([source.read(int(row), 1)[:, wanted_columns] for row in wanted])
            coarse.moved = max(coarse.moved, source.moved)  # largest error of positions by reprojection
            return values
        values = raster.pick(rows[first : first + count], columns)
        coarse.shifted = raster.shifted  # largest error of the shift between vertical datums, which `pick` has set
        return values

    def close() -> None:
        """Close the file and its overview."""
        for opened in (small, raster):
            if opened is not None:
                opened.close()

    place = raster.georeference or Georeference(first_row_south=settings.first_row_south)
    # the coarse step in steps of the raster, along columns and rows
    ratios = (raster.width - 1) / max(len(columns) - 1, 1), (raster.height - 1) / max(len(rows) - 1, 1)
    ratio_x, ratio_y = ratios[::-1] if place.transposed else ratios
    coarse = replace(
        raster,
        width=len(columns),
        height=len(rows),
        read=read,
        window=None,
        pick=None,
        original=None,
        inputs=None,
        block_rows=1,
        georeference=place.with_steps_times(ratio_x, ratio_y),
        full_size=(raster.width, raster.height),
        close=close,
    )
    return coarse


def scaled(samples: np.ndarray, count: int, coarse_count: int) -> np.ndarray:
    """Return the columns (or rows) of an overview in which columns `samples` of its raster are.

    count: columns of the raster. coarse_count: columns of the overview.
    """
    return (2 * samples + 1) * coarse_count // (2 * count)  # (sample + 1/2) * coarse_count / count, rounded down


def loaded_steps(raster: Raster, place: Georeference) -> list[float]:
    """Return metres between the samples of a thinned raster, and between those of the complete one.

    Of the two axes the larger step counts. place: georeference of the thinned raster.
    """
    assert raster.full_size is not None, "the raster is thinned"
    steps = np.array([place.step_y, place.step_x] if place.transposed else [place.step_x, place.step_y])
    ratios = (np.array([raster.width, raster.height]) - 1) / np.maximum(np.array(raster.full_size) - 1, 1)
    return [float(steps.max()), float((steps * ratios).max())]


def loaded_entries(raster: Raster, provenance: dict) -> dict:
    """Return the report entries of a quick import. provenance: the store's record of its origin."""
    steps, text = provenance[LOADED], loaded_text(provenance)
    return {
        "loaded": text,
        "complete": False,
        "loaded_step_m": steps[0],
        "full_step_m": steps[1],
        "full_raster": list(raster.full_size or ()),
        "bounds_against": f"the surface as loaded so far, {text}",
    }


def loaded_m(provenance: dict) -> tuple[float, float] | None:
    """Return metres between the samples of an incomplete store, and between all samples of its source.

    None for a complete store or damaged entries. provenance: the store's record of its origin.
    """
    steps = provenance.get(LOADED)
    if not isinstance(steps, list) or [type(step) for step in steps] != [float, float]:
        return None
    return (steps[0], steps[1]) if all(0.0 < step < LARGEST_EXTENT for step in steps) else None


def refined_m(provenance: dict) -> tuple[float, int] | None:
    """Return the step of an incomplete store's loaded tiles in metres, and their number; None without any."""
    entry = provenance.get(REFINED)
    if not isinstance(entry, list) or [type(value) for value in entry] != [float, int]:
        return None
    return (entry[0], entry[1]) if 0.0 < entry[0] < LARGEST_EXTENT and entry[1] > 0 else None


def loaded_text(provenance: dict) -> str:
    """Return the detail of an incomplete store, as `to 640 m of 10 m`; "" for a complete one."""
    steps, tiles = loaded_m(provenance), refined_m(provenance)
    if steps is None:
        return ""
    text = "to {} m of {} m".format(*map(_three_digits, steps))
    if tiles is None:
        return text
    return f"{text}, in {tiles[1]} tile{'s' if tiles[1] > 1 else ''} to {_three_digits(tiles[0])} m"


def _three_digits(value: float) -> str:
    """Return a length as text with three significant digits, and whole metres from 100 on."""
    return f"{value:,.0f}" if value >= 100.0 else f"{value:.3g}"
