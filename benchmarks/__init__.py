# SPDX-License-Identifier: GPL-3.0-or-later
"""Cost of the program on this machine, compared with baselines that run alternately: `adaptive-terrain bench`.

`suite.py` lists the rows in order. `rows/` measures them with the tools of `rig/`. `pages/` holds their goals
(`goals.py`) and writes the results. Only the command line imports this package.
"""
