# SPDX-License-Identifier: GPL-3.0-or-later
"""The contents of drawn panels, without a window: texts, properties and the number of rows."""

from types import SimpleNamespace
from unittest.mock import Mock

import bpy
from adaptive_terrain.operators.ui import panels


class DrawnLayout:
    """A layout that records texts and rows.

    Attributes:
        texts: texts, identifiers of operators and `<properties>` in their order, those of inner layouts too.
    """

    def __init__(self, beside: bool = False, texts: list | None = None):
        self.texts: list[str] = [] if texts is None else texts
        self.operator_context = ""
        self._beside, self._parts = beside, []

    @property
    def rows(self) -> int:
        """Rows that are drawn: those of the parts below each other, or of the highest part beside others."""
        heights = [part if isinstance(part, int) else part.rows for part in self._parts]
        return max(heights, default=0) if self._beside else sum(heights)

    def _part(self, beside: bool) -> "DrawnLayout":
        self._parts.append(DrawnLayout(beside, self.texts))
        return self._parts[-1]

    def column(self, **_options):
        return self._part(False)

    box = grid_flow = column

    def row(self, **_options):
        return self._part(True)

    split = row

    def _item(self, text: str, rows: int = 1):
        self._parts.append(rows)
        self.texts.append(text)
        return SimpleNamespace()

    def label(self, text="", **_options):
        self._item(text)

    def prop(self, _data, name, text=None, **_options):
        self._item(f"<{name}>")

    def prop_enum(self, _data, name, value, **_options):
        self._item(f"<{name}={value}>")

    def prop_search(self, _data, name, *_places, **_options):
        self._item(f"<{name}>")

    def operator(self, name, text=None, **_options):
        return self._item(text or name)

    def operator_menu_enum(self, name, _property, **_options):
        self._item(name)

    def menu(self, name, **_options):
        self._item(name)

    def progress(self, text="", **_options):
        self._item(text)

    def template_list(self, name, *_places, rows=5, **_options):
        self._item(name, rows)

    def popover(self, *_places, **_options):
        """Draw into the header, which is no row."""

    context_pointer_set = separator = popover


def draw(panel, context=None) -> DrawnLayout:
    """Draw a panel, without its sub-panels: a plain class, or one that Blender has registered."""
    plain = panel.__bases__[0] if issubclass(panel, bpy.types.Panel) else panel
    drawn = plain()
    drawn.layout = DrawnLayout()
    drawn.draw(context or bpy.context)
    return drawn.layout


def draw_mocked(panel, obj=None) -> Mock:
    """Draw a panel of an object, by default the active one, and return the mock that stands for its layout."""
    layout = Mock()
    context = bpy.context if obj is None else SimpleNamespace(object=obj, scene=bpy.context.scene)
    panel.draw(SimpleNamespace(layout=layout, _columns=lambda: layout), context)
    return layout


def panels_in(space: str) -> list[type]:
    """Return the registered panels of an editor that are shown now, presets left out."""
    return [cls for cls in panels.CLASSES if cls.bl_space_type == space and cls.poll(bpy.context)]


def open_rows(space: str) -> int:
    """Return the rows that a new user sees: those of panels that begin open, below open ones."""
    shown, rows = set(), 0
    for cls in panels_in(space):
        parent = getattr(cls, "bl_parent_id", "")
        if (not parent or parent in shown) and "DEFAULT_CLOSED" not in getattr(cls, "bl_options", ()):
            shown.add(cls.bl_idname)
            rows += draw(cls).rows
    return rows
