# SPDX-License-Identifier: GPL-3.0-or-later
"""The concurrent binary tree and the bisection that its nodes stand for."""
