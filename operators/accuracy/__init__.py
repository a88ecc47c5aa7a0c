# SPDX-License-Identifier: GPL-3.0-or-later
"""Measured errors and times: jobs, sweeps, reports and the panel."""
