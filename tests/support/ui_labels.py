# SPDX-License-Identifier: GPL-3.0-or-later
"""The labels of the user interface, collected from the registered classes and from the source of the draw code."""

import ast
import re
from pathlib import Path

import bpy
from adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES
from adaptive_terrain.cbt_terrain.height_operators.catalogue import HEIGHT_OPERATORS
from adaptive_terrain.cbt_terrain.sandbox.store_job import READING
from adaptive_terrain.cbt_terrain.view.settings import BOUNDS, SETTINGS
from adaptive_terrain.operators import jobs
from adaptive_terrain.operators.accuracy.panel import STEPS, TERMS
from adaptive_terrain.operators.importing.imported import LINES
from adaptive_terrain.operators.land import shaped_land
from adaptive_terrain.operators.land.presets import SHIPPED
from adaptive_terrain.operators.land.resting_land import CHOOSING
from adaptive_terrain.operators.text.shown_bounds import LIMITS, NO_BOUND
from adaptive_terrain.operators.ui.status_row import NO_VIEW

OPERATORS = Path(__file__).resolve().parents[2] / "operators"
TEXTS = ("text", "heading", "confirm_text")  # arguments of layout functions and dialogs
VARIABLES = (*TEXTS, "bound", "_stage")  # that are drawn
PHRASES = ("phrase", "say")  # functions that translate a template, and fill in its values
WORD = re.compile(r"(?<![\w.])[^\W\d_]{3,}(?![\w.])")
# Units, file formats, types of samples, names of the product and of attributes, and properties that no panel draws.
UNTRANSLATED = {
    *(
        "m",
        "px",
        "PNG",
        "OpenEXR",
        "GeoTIFF",
        "CRS",
        "Terrarium",
        "Mapbox",
        "Adaptive Terrain",
        "Splat 1",
        "Splat 2",
        "Splat 3",
    ),
    *("uint8", "int8", "uint16", "int16", "uint32", "int32", "float16", "float32", "float64"),
    *("Cost Curve", "No Cost Curve", "Measured Accuracy"),
}
# Labels that Blender translates itself into all five languages (checked with Blender 4.3).
LEFT_TO_BLENDER = {
    " ".join(label.split())
    for label in """
    3D Cursor, Animation, Active, Active Layer, Active Object, Align, Align to Normal, Ambient Occlusion, Amount,
    Amplitude, Aspect, Attribute, Bicubic, Bilinear, Boundary, Camera, Channel, Clear, Color, Curvature, Depth, Detail,
    Direction, Displacement, Edge, Edge Length, Effect, Export, File, File Path, Fit, Flow, Format, Frames, From, Gain,
    Height, Highest, Image, Interpolation, Layers, Level, Line, Location, Lowest, Margin, Mask, Masks, Memory, Mesh,
    Move, Noise Size, None, Object, Off, Offset, Origin, Other, Overlap, Overlay, Pack, Pattern, Pinned, Points,
    Preview, Radius, Read, Render, Rigid Body, Rotation, Roughness, Samples, Scene Camera, Seed, Set Size, Shape, Size,
    Sky, Smooth Shading, Source, Strength, Surface, Thickness, Tile Size, Tiles, Time, To, Triangle Area, Triangles,
    Type, View, Viewport, Wave, Wavelength, Wetness, Wind, World
    """.split(",")
}


def collect_labels() -> dict[str, str]:
    """Return each label with one place that shows it."""
    labels = dict.fromkeys(_labels_of_catalogues(), "catalogue")
    for cls in _registered_classes():
        labels |= dict.fromkeys(_labels_of_class(cls), cls.__name__)
    for path in sorted(OPERATORS.rglob("*.py")):
        labels |= dict.fromkeys(_labels_of_source(path), path.name)
    return {label: place for label, place in labels.items() if any(map(str.isalpha, label))}


def collect_tooltips() -> dict[str, str]:
    """Return the tooltip of each operator, property and enum item that users see, by a name of its place."""
    tooltips = {}
    for cls in _registered_classes():
        if not issubclass(cls, bpy.types.Operator | bpy.types.PropertyGroup):
            continue
        if issubclass(cls, bpy.types.Operator):
            tooltips[cls.__name__] = _rna_of(cls).description
        for prop in _shown_properties(cls):
            place = f"{cls.__name__}.{prop.identifier}"
            if not hasattr(prop, "fixed_type") or isinstance(prop.fixed_type, bpy.types.ID):
                tooltips[place] = prop.description
            if prop.type == "ENUM":
                tooltips |= {f"{place}.{item.identifier}": item.description for item in prop.enum_items_static}
    return tooltips


def drawn_f_strings() -> list[str]:
    """Return the f-strings with words in modules of panels: Blender translates only texts without values."""
    found = []
    for path in sorted(OPERATORS.rglob("*.py")):
        if "panel" not in path.name and path.parent.name != "ui":
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            texts = [part.value for part in getattr(node, "values", ()) if isinstance(part, ast.Constant)]
            if isinstance(node, ast.JoinedStr) and WORD.search(" ".join(texts).replace("Adaptive Terrain", "")):
                found.append(f"{path.name}: {ast.unparse(node)}")
    return found


def _registered_classes() -> list[type]:
    """Return the extension's registered classes, without lists: Blender shows no label of a list."""
    bases = [bpy.types.Panel, bpy.types.Menu, bpy.types.Operator, bpy.types.PropertyGroup]
    found = []
    while bases:
        subclasses = bases.pop().__subclasses__()
        bases += subclasses
        found += [cls for cls in subclasses if cls.__module__.startswith("adaptive_terrain.") and cls.is_registered]
    return found


def _labels_of_class(cls: type) -> list[str]:
    """Return the label of a class, and the names of its properties and of their items."""
    if not issubclass(cls, bpy.types.Operator | bpy.types.PropertyGroup):
        # Blender writes the name of the last preset over the label of a panel of presets; the source has it.
        return [] if hasattr(cls, "preset_subdir") else [cls.bl_label, getattr(cls, "bl_category", "")]
    labels = [cls.bl_label] if issubclass(cls, bpy.types.Operator) else []
    for prop in _shown_properties(cls):
        if prop.name != prop.identifier and prop.name not in ATTRIBUTES:  # the rest is drawn without its name
            labels.append(prop.name)
        labels += [item.name for item in prop.enum_items_static] if prop.type == "ENUM" else []
    return labels


def _rna_of(cls: type):
    """Return the RNA of a class; that of an operator has its properties in `bpy.ops`."""
    if not issubclass(cls, bpy.types.Operator):
        return cls.bl_rna
    module, name = cls.bl_idname.split(".")
    return getattr(getattr(bpy.ops, module), name).get_rna_type()


def _shown_properties(cls: type) -> list:
    """Return the properties of an operator or a property group that users may see."""
    properties = _rna_of(cls).properties
    return [prop for prop in properties if prop.identifier not in ("rna_type", "name") and not prop.is_hidden]


def _labels_of_source(path: Path) -> list[str]:
    """Return the literal texts that a module draws.

    They are arguments of layout functions, local variables with one of VARIABLES' names, templates that the draw
    code translates, names of figures (first in the tuples of functions `..._lines`), and the notices on sight.
    """
    labels = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.keyword) and node.arg in TEXTS:
            labels += _literals(node.value)
        elif isinstance(node, ast.Call) and node.args and getattr(node.func, "id", "") in PHRASES:
            labels += _literals(node.args[0])
        elif isinstance(node, ast.Assign) and getattr(node.targets[0], "id", None) in {*VARIABLES, "bl_label"}:
            labels += _literals(node.value)
        elif isinstance(node, ast.FunctionDef) and node.name == "sight_notice":
            labels += [text for inner in ast.walk(node) if isinstance(inner, ast.Tuple) for text in _literals(inner)]
        elif isinstance(node, ast.FunctionDef) and node.name.endswith("_lines"):
            labels += [
                text
                for inner in ast.walk(node)
                if isinstance(inner, ast.Tuple)
                for text in _literals(inner.elts[0])
                if text[:1].isupper()
            ]
    return labels


def _literals(node: ast.expr) -> list[str]:
    """Return the texts that an expression of literals may have as its value."""
    if isinstance(node, ast.Constant):
        return [node.value] if isinstance(node.value, str) else []
    if isinstance(node, ast.IfExp):
        return [*_literals(node.body), *_literals(node.orelse)]
    if isinstance(node, ast.BoolOp):
        return [text for value in node.values for text in _literals(value)]
    if isinstance(node, ast.Tuple):
        return [text for element in node.elts for text in _literals(element)]
    return []


def _labels_of_catalogues() -> list[str]:
    """Return the labels of the tables from which panels and menus are made."""
    bounds = [label for label, _unit in BOUNDS.values()]
    rows = [setting.row or setting.label for setting in SETTINGS]
    lands = [operator.label for operator in HEIGHT_OPERATORS.values()]
    notes = (*shaped_land.NOTES.values(), shaped_land.DOUBTFUL, shaped_land.LEFT_OUT, shaped_land.LEFT_OUT_BUT)
    shown = (shaped_land.SOURCE, shaped_land.PREVIEW, shaped_land.SHAPED, NO_BOUND, *LIMITS.values())
    messages = (jobs.CANCELLING, jobs.CHECKING, jobs.LOOKING, jobs.STARTING, jobs.PREPARING, CHOOSING, READING)
    presets = [
        text for heading, group in SHIPPED.items() for text in (heading, *(label for label, _ in group.values()))
    ]
    return [
        *bounds,
        *rows,
        *lands,
        *presets,
        *TERMS.values(),
        *STEPS.values(),
        *NO_VIEW,
        *LINES,
        *notes,
        *shown,
        *messages,
    ]
