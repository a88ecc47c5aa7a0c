# SPDX-License-Identifier: GPL-3.0-or-later
"""What the levels of shaped land cost and change: a part of the page of `accuracy`, for stores made by `shape`."""

from itertools import groupby

from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.height_operators.catalogue import operator_of
from ..text.page_blocks import Heading, Table, Text

HEAD = ["effect", "samples apart, m", "added, m rms", "m at most", "ms"]


def land_section(heights: HeightField, of: str) -> list:
    """Return blocks of the accuracy page about shaped land, level by level; [] for land that no stack has shaped.

    of: " of NAME" for headings if the page has several terrains, else "".
    """
    added = sorted(heights.provenance.get("shaped", {}).get("added", []), key=lambda one: (one["entry"], one["level"]))
    if not added:
        return []
    lines = [
        [
            getattr(operator_of(one["effect"]), "label", one["effect"]),
            *(f"{one[number]:.3g}" for number in ("spacing_m", "rms_m", "most_m")),
            f"{one['ms']:,.0f}" if one["computed"] else "known before",
        ]
        for one in added
    ]
    return [
        Heading(f"What finer land{of} costs and changes"),
        Text(
            "Effects are applied to samples far apart first. Each finer level adds what it sees, and takes its time; "
            "what is added shrinks from level to level. This page's errors are measured against this land: they do not "
            "include the additions of finer levels. " + _finest_level_text(added)
        ),
        Table(HEAD, lines),
    ]


def _finest_level_text(added: list[dict]) -> str:
    """Return a sentence about what would be saved and lost without the finest level; "" if not all times are known.

    added: entries of a shaped store's provenance, one a level and operator.
    """
    by_level = [list(group) for _, group in groupby(sorted(added, key=_level_of), key=_level_of)]
    if len(by_level) < 2 or not all(one["computed"] for one in added):
        return ""
    finest, time = by_level[0], sum(one["ms"] for one in added)
    part = sum(one["ms"] for one in finest) / time if time else 0.0
    largest = max(finest, key=lambda one: one["rms_m"])
    return (
        f"Without the finest level, {finest[0]['spacing_m']:.3g} m, it would have taken {part:.0%} less time, and been "
        f"off by {largest['rms_m']:.2g} m rms and {largest['most_m']:.2g} m at most ({largest['effect']})."
    )


def _level_of(one: dict) -> int:
    """Return the level of an entry, for sorting."""
    return one["level"]
