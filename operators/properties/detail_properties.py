# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of how fine a terrain is: `object.adaptive_terrain.viewport` and `.render`."""

import bpy
from bpy.props import BoolProperty, FloatProperty, IntProperty, StringProperty


def changed(self, _context) -> None:
    """A script that sets a property tags nothing: without this its object's evaluated copy keeps the old value."""
    self.id_data.update_tag()


def _screen_error(default: float):
    return FloatProperty(
        name="Screen Error",
        description="Largest geometric error as seen by the camera, in pixels; 0 switches this criterion off",
        default=default, min=0.0, soft_max=20.0, precision=2, subtype="PIXEL", update=changed,
    )  # fmt: skip


def _smooth_transitions(default: bool):
    return BoolProperty(
        name="Smooth Transitions",
        description="Points rise to their places as the camera comes nearer, instead of popping. The bound holds as "
        "without; it takes a third more triangles or so",
        default=default, update=changed,
    )  # fmt: skip


def _asked(name: str, label: str, usual: float):
    """A switch of a criterion whose 0 means off; it keeps nothing itself, and switches on with a usual value."""

    def switch(self, on: bool) -> None:
        if on != (getattr(self, name) > 0.0):
            setattr(self, name, usual if on else 0.0)

    return BoolProperty(
        name=label,
        description="Whether this is asked for",
        get=lambda self: getattr(self, name) > 0.0,
        set=switch,
        options=set(),
    )


class DetailSettings:
    """How much detail; of the viewport and of the render, which differ in their defaults."""

    ask_error_px: _asked("error_px", "Screen Error", 2.0)
    ask_edge_px: _asked("edge_px", "Edge Length", 40.0)
    ask_area_px: _asked("area_px", "Triangle Area", 400.0)
    ask_error_m: _asked("error_m", "Vertical Error", 1.0)
    edge_px: FloatProperty(
        name="Edge Length",
        description="Longest edge as seen by the camera, in pixels; 0 switches this criterion off",
        default=0.0, min=0.0, soft_max=200.0, precision=1, subtype="PIXEL", update=changed,
    )  # fmt: skip
    area_px: FloatProperty(
        name="Triangle Area",
        description="Largest triangle as seen by the camera, in square pixels; 0 switches this criterion off",
        default=0.0, min=0.0, soft_max=10000.0, precision=1, update=changed,
    )  # fmt: skip
    error_m: FloatProperty(
        name="Vertical Error",
        description="Largest vertical error in metres, whatever the camera sees; 0 switches this criterion off",
        default=0.0, min=0.0, soft_max=100.0, precision=3, unit="LENGTH", update=changed,
    )  # fmt: skip
    guard_deg: FloatProperty(
        name="Guard Band",
        description="How far outside the frame full detail is kept, in degrees at a field of view of 50; a lens that "
        "sees less has it in proportion",
        default=2.5, min=0.0, max=89.0, precision=1, update=changed,
    )  # fmt: skip
    off_screen_factor: FloatProperty(
        name="Off-Screen Factor",
        description="How many times coarser the terrain may be outside the frame, at a field of view of 50 degrees; "
        "a lens that sees less has it coarser in proportion. 1 keeps full detail everywhere",
        default=16.0, min=1.0, soft_max=1000.0, precision=1, update=changed,
    )  # fmt: skip
    hidden_factor: FloatProperty(
        name="Hidden Factor",
        description="How many times coarser the terrain may be where nearer ground hides it from the camera; 1 keeps "
        "full detail. Shadows, mirrors and a wide aperture can show hidden ground: keep 1 where they matter",
        default=1.0, min=1.0, soft_max=64.0, precision=1, update=changed,
    )  # fmt: skip
    shading_floor: FloatProperty(
        name="Shading Floor",
        description="From above, errors of height move no pixel but show in shading and shadows: this part of them "
        "counts at least. 1 is an error seen from the side, 0 counts only what moves in the picture",
        default=0.5, min=0.0, max=1.0, precision=2, subtype="FACTOR", update=changed,
    )  # fmt: skip
    meshlet: IntProperty(
        name="Meshlet Level",
        description="Every leaf of the tree becomes 4 to this power triangles",
        default=0, min=0, max=4, update=changed,
    )  # fmt: skip
    limit_depth: BoolProperty(name="Limit Depth", description="Stop refining at a depth", update=changed)
    max_depth: IntProperty(
        name="Max Depth", description="Bisections of a root square", default=20, min=1, soft_max=40, update=changed
    )
    limit_triangles: BoolProperty(
        name="Limit Triangles", description="Coarsen the error asked for until the mesh fits a budget", update=changed
    )
    max_triangles: IntProperty(
        name="Max Triangles", description="Triangles at most", default=1_000_000, min=0, update=changed
    )
    limit_time: BoolProperty(
        name="Time Budget",
        description="Instead of the error above ask for the finest error that fits a time, from the curve that "
        "Measure Accuracy has measured; the live viewport corrects it by the times of its last updates. A render does "
        "not: the same curve and the same time give the same mesh on every machine",
        update=changed,
    )  # fmt: skip
    max_ms: FloatProperty(
        name="Max Time (ms)",
        description="Milliseconds of the engine for a new view; handing the mesh to Blender comes on top",
        default=50.0, min=0.01, soft_max=1000.0, precision=1, update=changed,
    )  # fmt: skip
    curve: StringProperty(
        name="Cost Curve", description="What errors cost, as Measure Accuracy has measured it; JSON", update=changed
    )
    no_curve: StringProperty(
        name="No Cost Curve", description="Why the last Measure Accuracy gave no curve; empty if it did"
    )
    measured: StringProperty(
        name="Measured Accuracy", description="Errors of one mesh, as Measure Accuracy has measured them; JSON"
    )


class ViewportDetail(DetailSettings, bpy.types.PropertyGroup):
    """How much detail in the viewport."""

    error_px: _screen_error(2.0)
    smooth_transitions: _smooth_transitions(False)


class RenderDetail(DetailSettings, bpy.types.PropertyGroup):
    """How much detail in a render, a bake or an export."""

    error_px: _screen_error(1.0)
    smooth_transitions: _smooth_transitions(True)
