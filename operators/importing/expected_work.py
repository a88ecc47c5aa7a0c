# SPDX-License-Identifier: GPL-3.0-or-later
"""A warning at the beginning of an import of several files that takes long or finds hardly any data."""

from ..text.console import duration
from ..text.gap_note import gap_percent
from ..text.numbers import plain

LONG_S = 600.0
WIDE_GAP_PERCENT = 90.0


def warn_of_work(operator, preview: dict) -> None:
    """Report that an import will take more than LONG_S, or that more than WIDE_GAP_PERCENT of it will be gaps.

    preview: the report on several files before they are imported (describe_mosaic).
    """
    seconds, gap = preview["expected_seconds"], preview["gap_percent"]
    if seconds <= LONG_S and gap <= WIDE_GAP_PERCENT:
        return
    size = f"{plain(preview['expected_disk_mb'] / 1000.0)} GB"
    gaps = f", and {gap_percent(gap)} of the rectangle has no data" if gap > WIDE_GAP_PERCENT else ""
    operator.report(
        {"WARNING"},
        f"Importing {preview['files']:,} files is expected to take {duration(seconds)} and {size} on the disk{gaps}. "
        "If that is too much, press the cross beside the progress bar and choose fewer files.",
    )
