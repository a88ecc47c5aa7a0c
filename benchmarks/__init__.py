# SPDX-License-Identifier: GPL-3.0-or-later
"""What the program costs on this machine, beside two baselines measured in the same run: `adaptive-terrain bench`.

`suite.py` is the order of the rows, `goals.py` what they should cost, `report.py` how they are shown. Imports
everything below; only the command line's verb imports this.
"""
