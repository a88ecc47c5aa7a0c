# SPDX-License-Identifier: GPL-3.0-or-later
"""The check that a farm makes at the end.

All frames are there and whole, made with one set of settings, of the files that are there now. A summary is the JSON
that closes a frame: its files and inputs with their digests, and a digest of its settings.
"""

import os
from collections import Counter
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from ...cbt_terrain.errors import TerrainError, shown
from ...cbt_terrain.run import stopping
from .formats import range_text
from .summaries import content_digest, file_fault, file_named, read_summary, summary_name

MAX_NAMED_FAULTS = 10


def verify_frames(out: Path, frames: Sequence[int]) -> tuple[list[dict], int]:
    """Check that `frames` in the folder `out` are complete, current and of one scene.

    Returns their summaries, and the number of inputs that are missing here and were not compared. Raises
    TerrainError that names the first bad frames and why.
    """
    summaries, faults, missing = [], [], []
    for frame in frames:
        stopping.check()
        try:
            summary = read_summary(out, frame)
        except FileNotFoundError:
            missing.append(frame)
        except ValueError:
            faults.append(f"frame {frame}: {summary_name(frame)} is damaged")
        else:
            named = ((name, file_fault(summary, name, out)) for name in summary["files"])
            faults += [f"frame {frame}: {shown(name)} {fault}" for name, fault in named if fault]
            summaries.append(summary)
    if missing:
        frame_s, are = ("frame", "is") if len(missing) == 1 else ("frames", "are")
        faults.insert(0, f"{frame_s} {shown(range_text(missing))} {are} missing")
    # Frames of other settings are named only if no file is missing or damaged.
    faults += _describe_stale_frames(summaries, out) + ([] if faults else _describe_odd_frames(summaries))
    if faults:
        more = f"; {len(faults) - MAX_NAMED_FAULTS:,} more" if len(faults) > MAX_NAMED_FAULTS else ""
        raise TerrainError(
            f"{out} is not complete: {'; '.join(faults[:MAX_NAMED_FAULTS])}{more}", fix="make those frames again"
        )
    names = {name for summary in summaries for name in summary["inputs"]}
    return summaries, sum(not os.path.exists(file_named(name, out)) for name in names)


def _describe_stale_frames(summaries: list[dict], out: Path) -> list[str]:
    """Return a text for each input that has changed since a frame was made from it.

    A missing file is not compared: a folder of frames may be checked without their scene.
    """
    contents, faults = cache(content_digest), []
    for summary in summaries:
        for name, digest in summary["inputs"].items():
            found = contents(file_named(name, out))
            if found is not None and found != digest:
                faults.append(f"frame {summary['frame']} is stale: {shown(name)} has changed since")
    return faults


def _describe_odd_frames(summaries: list[dict]) -> list[str]:
    """Return a text for each frame with other settings than the most frequent ones; [] if all have the same."""
    counts = Counter(summary["settings"] for summary in summaries)
    if len(counts) < 2:
        return []
    [(usual, _)] = counts.most_common(1)
    odd = [summary["frame"] for summary in summaries if summary["settings"] != usual]
    return [f"frame {frame} was made of another scene, or by another version" for frame in odd]
