# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of a criterion's settings.

`Criterion` takes its ranges from it; the saved properties, the rows of the panels, the options of `export` and the
overrides of a request are made from it. It imports neither bpy nor numpy.
"""

import math
import sys
from dataclasses import dataclass

from ..errors import TerrainError
from .morph import MAX_MORPH, SMOOTH

FINITE = sys.float_info.max
VIEWPORT, RENDER = "viewport", "render"


@dataclass(frozen=True)
class CriterionSetting:
    """One field of `Criterion`: its range, its words and its place in the user interface.

    Attributes:
        name: field of `Criterion`; also the identifier of the saved property, except where `is_flag`.
        label: name of the property.
        tooltip: sentence without a full stop, of the property and of the option.
        default: value of `Criterion()`; None is no limit.
        row: label in the panel, "" for `label`.
        unit: "px", "px²", "m", "°", "fraction" or "".
        viewport, render: default of the saved properties where it differs from `default`.
        min, max: range that a criterion accepts, both included.
        usual: value that its switch sets: of a criterion, a limit or a flag.
        switch, switch_label, switch_tooltip: saved property that switches a limit or a flag on.
        whole: whether values are whole numbers.
        soft_max, digits: end of the slider, digits after the decimal point.
        option: option of `export`, "" for none.
    """

    name: str
    label: str
    tooltip: str
    default: float | None
    row: str = ""
    unit: str = ""
    viewport: float | None = None
    render: float | None = None
    min: float = 0.0
    max: float = FINITE
    usual: float | None = None
    switch: str = ""
    switch_label: str = ""
    switch_tooltip: str = ""
    whole: bool = False
    soft_max: float = math.inf
    digits: int = 1
    option: str = ""

    @property
    def is_flag(self) -> bool:
        """Tell whether the setting is shown as a check box without a number: on is `usual`, off is `default`."""
        return bool(self.switch) and self.default is not None

    @property
    def expected(self) -> str:
        """Return the range as the end of a sentence, for example "a number from 0 to 1"."""
        number = "a whole number" if self.whole else "a finite number" if self.max == FINITE else "a number"
        if self.max < FINITE:
            return f"{number} from {self.min:g} to {self.max:,.10g}"
        return f"{number}, {self.min:g} or more"

    def default_in(self, mode: str) -> float | None:
        """Return the default in VIEWPORT or RENDER."""
        return self.default if getattr(self, mode) is None else getattr(self, mode)

    def accepts(self, value: float | None) -> bool:
        """Tell whether a criterion may have the value."""
        return self.default is None if value is None else self.min <= value <= self.max

    def check(self, value: float | None) -> None:
        """Raise TerrainError where a criterion may not have the value."""
        if not self.accepts(value):
            raise TerrainError(f"The criterion's {self.name} is {value}", expected=self.expected)


# At least one is above 0; 0 switches one off, and those that are on hold together.
CRITERIA = (
    CriterionSetting(
        "error_px", "Screen Error",
        "Largest error that the camera may see, in pixels: smaller is finer and slower; 0 is off",
        1.0, unit="px", viewport=2.0, usual=2.0, soft_max=20.0, digits=2, option="--pixel-error",
    ),
    CriterionSetting(
        "edge_px", "Edge Length",
        "Longest edge of a triangle as the camera sees it, in pixels, for materials and modifiers that move vertices; "
        "0 is off",
        0.0, unit="px", usual=40.0, soft_max=200.0, option="--edge",
    ),
    CriterionSetting(
        "area_px", "Triangle Area",
        "Largest triangle as the camera sees it, in square pixels; 0 is off",
        0.0, row="Area (px²)", unit="px²", usual=400.0, soft_max=10_000.0, option="--area",
    ),
    CriterionSetting(
        "error_m", "Vertical Error",
        "How far the mesh may be above or below the ground anywhere, in metres, whatever the camera sees; 0 is off",
        0.0, unit="m", usual=1.0, soft_max=100.0, digits=3, option="--metres",
    ),
)  # fmt: skip
# Where the criteria count less, how vertices move, and what each leaf becomes.
MODIFIERS = (
    CriterionSetting(
        "guard_deg", "Guard Band",
        "How far outside the camera's frame full detail is kept, in degrees, for reflections and shadows. It is meant "
        "for a field of view of 50°; narrower lenses have less, in proportion",
        2.5, row="Guard (°)", unit="°", soft_max=89.0, option="--guard",
    ),
    CriterionSetting(
        "off_screen_factor", "Off-Screen Factor",
        "How many times coarser the terrain may be outside the camera's frame, at a field of view of 50°; narrower "
        "lenses have it coarser, in proportion. 1 keeps full detail everywhere",
        16.0, row="Off-Screen ×", min=1.0, max=math.inf, soft_max=1000.0, option="--off-screen",
    ),
    CriterionSetting(
        "hidden_factor", "Hidden Factor",
        "How many times coarser the terrain may be where hills hide it from the camera; 1 keeps full detail. Keep 1 "
        "where shadows, mirrors or a strong depth of field show hidden ground",
        1.0, row="Hidden ×", min=1.0, max=math.inf, soft_max=64.0, option="--occlusion",
    ),
    CriterionSetting(
        "shading_floor", "Shading Floor",
        "How much errors of height count that move no pixel but change the shading, as seen from above: 1 is finest, 0 "
        "counts only visible movement",
        0.5, unit="fraction", max=1.0, digits=2, option="--shading-floor",
    ),
    CriterionSetting(
        "morph", "Geomorph",
        "Move vertices smoothly to their places as the camera comes nearer, instead of letting them pop. It takes "
        "about a third more triangles",
        1.0, render=SMOOTH, min=1.0, max=MAX_MORPH, usual=SMOOTH, switch="smooth_transitions", option="--morph",
    ),
    CriterionSetting(
        "meshlet", "Meshlet Level",
        "Divide every triangle into 4 (level 1), 16 (2), 64 (3) or 256 (4) smaller ones: less time for each triangle, "
        "but more of them",
        0, max=4, whole=True, option="--meshlet",
    ),
)  # fmt: skip
# Where refinement stops whatever the criteria request.
LIMITS = (
    CriterionSetting(
        "max_depth", "Max Depth",
        "How often the coarsest triangles may be halved; two more halve their size",
        None, min=1, usual=20, switch="limit_depth", switch_label="Limit Depth",
        switch_tooltip="Stop halving triangles at a depth, even where the error is larger", whole=True, soft_max=40,
    ),
    CriterionSetting(
        "max_triangles", "Max Triangles",
        "Largest number of triangles in the mesh",
        None, max=2**31 - 1, usual=1_000_000, switch="limit_triangles", switch_label="Limit Triangles",
        switch_tooltip="Make the mesh coarser until it fits a number of triangles", whole=True, option="--budget",
    ),
)  # fmt: skip
SETTINGS = (*CRITERIA, *MODIFIERS, *LIMITS)
# Label and unit of each bound that an update reports, by its field in `ReportedBounds`, in the order of their display.
BOUNDS = {
    "bound_px": ("Screen error", "px"),
    "bound_m": ("Vertical error", "m"),
    "bound_edge_px": ("Longest edge", "px"),
    "bound_area_px": ("Largest triangle", "px²"),
}
