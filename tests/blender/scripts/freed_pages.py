# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure how the program's allocator treats freed, held and returned memory."""

import json
import sys
from importlib import import_module
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "support"))
import freed  # noqa: E402

[package] = [name for name in bpy.context.preferences.addons.keys() if name.endswith(".adaptive_terrain")]
found = freed.measured(import_module(package + ".operators.bridge.freed_memory"))
print("RESULT " + json.dumps(found | {"version": bpy.app.version[:2]}))
