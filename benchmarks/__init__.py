# SPDX-License-Identifier: GPL-3.0-or-later
"""What the program costs on this machine, beside two baselines measured in the same run: `adaptive-terrain bench`.

`suite.py` is the order of the rows (`rows/`), which are measured by what is in `rig/`; `pages/` has what they should
cost (`goals.py`) and how they are shown. Imports everything below; only the command line's verb imports this.
"""
