# SPDX-License-Identifier: GPL-3.0-or-later
"""What is asked of effects, computed: a plan of which are needed, and why; each once; at the asker's scale.

`plan.py` says which of them a scene's demand calls for; `evaluate.py` runs those.
"""
