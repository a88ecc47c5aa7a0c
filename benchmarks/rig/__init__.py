# SPDX-License-Identifier: GPL-3.0-or-later
"""What rows are measured with: times, scenes, baselines, processes of their own."""
