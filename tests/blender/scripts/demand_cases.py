# SPDX-License-Identifier: GPL-3.0-or-later
"""Run the cases of demand in the real program, and print the failures."""

import json

import bpy
from bl_ext.user_default.adaptive_terrain.operators.bridge.demand.demand import find_demand
from demand_cases import CASES


def demanded(obj, mode="RENDER"):
    return find_demand(obj, bpy.context.evaluated_depsgraph_get(), mode)


held, failed = 0, []
for case in CASES:
    for label, found, wanted in case(demanded):
        if set(found) == wanted:
            held += 1
        else:
            failed.append([label, sorted(found), sorted(wanted)])
print("RESULT " + json.dumps({"held": held, "failed": failed, "version": bpy.app.version_string}))
