# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures of jobs that openjd-cli runs."""

from farm_jobs import shot, start, two_shares, worker  # noqa: F401
