# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether all frames of a folder are there and whole, made with one set of settings: what a farm asks at the end."""

import json
from collections.abc import Sequence
from pathlib import Path

from ...cbt_terrain.errors import TerrainError
from .exporting import summary_name

MOST_NAMED = 5


def verify_frames(out: Path, frames: Sequence[int]) -> list[dict]:
    """The summaries of `frames`, each of which is complete; raises TerrainError that names the first that are not."""
    wrong, summaries = [], []
    for frame in frames:
        try:
            summary = json.loads((out / summary_name(frame)).read_text(encoding="utf-8"))
            summary["settings"], summary["terrains"], files = summary["settings"], summary["terrains"], summary["files"]
        except OSError:
            wrong.append(f"frame {frame} is missing")
            continue
        except (ValueError, KeyError, TypeError):
            wrong.append(f"{summary_name(frame)} is damaged")
            continue
        wrong += [f"{name} does not have its {size:,} bytes" for name, size in files.items() if _size(out / name) != size]
        summaries.append(summary)
    if not wrong and len(made := {summary["settings"] for summary in summaries}) > 1:
        odd = min(made, key=[summary["settings"] for summary in summaries].count)
        numbers = [str(summary["frame"]) for summary in summaries if summary["settings"] == odd]
        wrong += [f"frame {number} was made of another scene, or by another version" for number in numbers]
    if wrong:
        more = f"; {len(wrong) - MOST_NAMED:,} more" if len(wrong) > MOST_NAMED else ""
        raise TerrainError(f"{out} is not complete: {'; '.join(wrong[:MOST_NAMED])}{more}. Make those frames again.")
    return summaries


def _size(path: Path) -> int | None:
    try:
        return path.stat().st_size
    except OSError:
        return None
