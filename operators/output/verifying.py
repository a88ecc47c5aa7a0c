# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether all frames of a folder are there and whole, made with one set of settings: what a farm asks at the end."""

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from ...cbt_terrain.errors import TerrainError, shown
from ...cbt_terrain.run.named_file import read_regular
from .exporting import MAX_SUMMARY_BYTES, summary_name

MOST_NAMED = 5
BOUNDS = ("bound_px", "bound_m", "bound_edge_px", "bound_area_px")


def verify_frames(out: Path, frames: Sequence[int]) -> list[dict]:
    """The summaries of `frames`, each of which is complete; raises TerrainError that names the first that are not."""
    wrong, summaries = [], []
    for frame in frames:
        try:
            summary = _read(out / summary_name(frame), frame)
        except OSError:
            wrong.append(f"frame {frame} is missing")
            continue
        except (ArithmeticError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
            wrong.append(f"{summary_name(frame)} is damaged")
            continue
        wrong += [f"{shown(name)} is not whole" for name, size in summary["files"].items() if _size(out / name) != size]
        summaries.append(summary)
    wrong += [] if wrong else _of_another_scene(summaries)
    if wrong:
        more = f"; {len(wrong) - MOST_NAMED:,} more" if len(wrong) > MOST_NAMED else ""
        raise TerrainError(f"{out} is not complete: {'; '.join(wrong[:MOST_NAMED])}{more}. Make those frames again.")
    return summaries


def _read(path: Path, frame: int) -> dict:
    """What is asked of the summary of a frame; raises what damage makes of it."""
    summary = json.loads(read_regular(path, MAX_SUMMARY_BYTES).decode("utf-8"))
    if summary["frame"] != frame:
        raise ValueError("it is of another frame")
    files = {str(name): int(size) for name, size in summary["files"].items()}
    terrains = [_figures(terrain) for terrain in summary["terrains"]]
    return {"frame": frame, "settings": str(summary["settings"]), "files": files, "terrains": terrains}


def _figures(terrain: dict) -> dict:
    bounds = {name: None if terrain[name] is None else float(terrain[name]) for name in BOUNDS}
    return {"triangles": int(terrain["triangles"]), **bounds}


def _of_another_scene(summaries: list[dict]) -> list[str]:
    """Of frames that were made with several settings, those with any but the most frequent."""
    made = Counter(summary["settings"] for summary in summaries)
    if len(made) < 2:
        return []
    [(most, _)] = made.most_common(1)
    odd = [summary["frame"] for summary in summaries if summary["settings"] != most]
    return [f"frame {frame} was made of another scene, or by another version" for frame in odd]


def _size(path: Path) -> int | None:
    try:
        return path.stat().st_size
    except (OSError, ValueError):
        return None
