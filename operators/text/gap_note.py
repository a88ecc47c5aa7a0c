# SPDX-License-Identifier: GPL-3.0-or-later
"""A sentence about land that mostly consists of gaps, for the reports of exports."""

from .numbers import plain

MIN_PERCENT = 10.0  # of the samples; smaller gaps are not worth a sentence


def gap_note(field) -> str:
    """Return a sentence on the part of a height field without data, after a full stop; "" below MIN_PERCENT.

    For example `. 95 % of its rectangle is holes`.
    """
    percent = 100.0 * field.filled / field.samples.size
    if percent < MIN_PERCENT:
        return ""
    gaps = "gaps without data, filled from the nearest heights" if field.valid is None else "holes"
    return f". {gap_percent(percent)} of its rectangle is {gaps}"


def missing_text(count: int, samples: int) -> str:
    """Return the number of samples without data as a text, from MIN_PERCENT on as a percentage of all samples."""
    percent = 100.0 * count / samples
    return gap_percent(percent) if percent >= MIN_PERCENT else f"{count:,}"


def gap_percent(percent: float) -> str:
    """Return the percentage of a rectangle that is gaps as a text, below 100 %."""
    return f"{plain(min(percent, 99.99), 4)} %"
