# SPDX-License-Identifier: GPL-3.0-or-later
"""What the levels of shaped land cost and change: a part of the page of `accuracy`, for stores made by `shape`."""

from itertools import groupby
from operator import itemgetter

from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.height_operators.catalogue import operator_of
from ..text.page_blocks import Heading, Table, Text

HEAD = ["effect", "samples apart, m", "added, m rms", "m at most", "ms"]


def land_section(heights: HeightField, of: str) -> list:
    """Return blocks of the accuracy page about shaped land; [] if no height operators have changed the heights.

    Their table has a row for each height operator and level of resolution, the finest level of an operator first. The
    store's provenance has a record for each: the operator's number ("entry") and name, the level's number (0: finest)
    and sample distance, the difference of heights to the next coarser level, the time, and the number of tiles that
    were computed (0 if all were cached).

    of: " of NAME" for headings if the page has several terrains, else "".
    """
    added = heights.provenance.get("shaped", {}).get("added", [])
    added = sorted(added, key=lambda record: (record["entry"], record["level"]))
    if not added:
        return []
    lines = [
        [
            getattr(operator_of(record["effect"]), "label", record["effect"]),
            *(f"{record[key]:.3g}" for key in ("spacing_m", "rms_m", "most_m")),
            f"{record['ms']:,.0f}" if record["computed"] else "known before",
        ]
        for record in added
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
    """Return a sentence about the time that would be saved, and the error, without the finest level.

    It is "" if there is only one level, or if a level of an operator was cached: its time is not known.
    added: records of a shaped store's provenance, one a level and operator.
    """
    level_of = itemgetter("level")  # 0 is the finest
    by_level = [list(group) for _, group in groupby(sorted(added, key=level_of), key=level_of)]
    if len(by_level) < 2 or not all(record["computed"] for record in added):
        return ""
    finest, ms = by_level[0], sum(record["ms"] for record in added)
    saved = sum(record["ms"] for record in finest) / ms if ms else 0.0
    largest = max(finest, key=lambda record: record["rms_m"])
    return (
        f"Without the finest level, {finest[0]['spacing_m']:.3g} m, it would have taken {saved:.0%} less time, and "
        f"been off by {largest['rms_m']:.2g} m rms and {largest['most_m']:.2g} m at most ({largest['effect']})."
    )
