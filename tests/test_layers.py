# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports of houses and rooms: allowed directions, no cycles, and no Blender in the two lower houses."""

import ast
import subprocess
import sys
import tomllib
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
# The houses that each house may import; none imports the package's root.
MAY_IMPORT = {
    "kernels": {"kernels"},
    "cbt_terrain": {"cbt_terrain", "kernels"},
    "operators": {"operators", "cbt_terrain", "kernels"},
    "benchmarks": {"benchmarks", "operators", "cbt_terrain", "kernels"},
}
# Rooms of operators: a feature has its settings below the session and its panel above it, so they form one layer.
FEATURES = frozenset(
    "terrain assets importing land layers maps scatter overlay attributes accuracy export ground farm session ui jobs "
    "scene job_operator kernel_operator".split()
)
# The rooms and single modules of each house; each may import from those before it.
ROOMS = {
    "kernels": [
        "unchecked",
        "field",
        "mosaic",
        "tree",
        "leb",
        "refine",
        "budget",
        "bicubic",
        "mesh",
        "detail",
        "morph",
        "effects",
        "query",
        "scatter",
        "land",
        "fitting",
        "accuracy",
    ],
    "cbt_terrain": [
        *("errors", "plain_numbers", "run", "view", "field", "tree", "leb", "history", "refine", "mesh", "terrain"),
        *("query", "attributes", "scatter", "tiling", "rasters", "formats", "sandbox", "importing", "mosaic"),
        *("height_operators", "fit", "exporting", "accuracy"),
    ],
    "operators": [
        *("text", "bridge", FEATURES, "handlers", "registration"),
        *("blender", "demo", "cli"),
    ],
    "benchmarks": ["rig", "rows", "pages", "suite"],
}
MAY_ASK_FOR_BENCHMARKS = "operators/cli/verbs.py"
BLENDER = {"bpy", "bmesh", "mathutils", "gpu", "bpy_extras", "addon_utils", "bl_ui", "idprop", "blf"}
HOUSES = {house: sorted((ROOT / house).rglob("*.py")) for house in MAY_IMPORT}
FILES = [path for paths in HOUSES.values() for path in paths]


@cache
def imports_in(path: Path) -> list[ast.Import | ast.ImportFrom]:
    """Return the imports anywhere in a file; these are statements, so that no expression is looked at."""
    found, open_nodes = [], [ast.parse(path.read_text(encoding="utf-8"))]
    while open_nodes:
        node = open_nodes.pop()
        if isinstance(node, ast.Import | ast.ImportFrom):
            found.append(node)
        for name in ("body", "orelse", "handlers", "finalbody", "cases"):
            inside = getattr(node, name, [])
            open_nodes += inside if isinstance(inside, list) else []  # that of a lambda is an expression
    return found


@cache
def modules_imported(path: Path) -> set[tuple[str, ...]]:
    """Return the modules of this package that a file imports anywhere, as the parts of their paths."""
    folder, found = path.relative_to(ROOT).parent.parts, set()
    for node in imports_in(path):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = (*folder[: len(folder) - (node.level - 1)], *(node.module.split(".") if node.module else ()))
            for name in (alias.name for alias in node.names):
                inside = ROOT.joinpath(*base, name)
                found.add((*base, name) if inside.is_dir() or inside.with_suffix(".py").is_file() else base)
    return found - {()}


@cache
def packages_imported(path: Path) -> set[str]:
    """Return the external packages that a file imports."""
    found = set()
    for node in imports_in(path):
        if isinstance(node, ast.Import):
            found.update(alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add(node.module.split(".")[0])
    return found


def test_imports_are_found_in_every_statement(tmp_path):
    lines = ["import a", "if x:", " import b", "else:", " import c", "try:", " import d", "except E:", " import e"]
    lines += ["finally:", " import f", "match x:", " case 1:", "  import g", "for x in y:", " import h"]
    lines += ["class C:", " def f(self):", "  with x:", "   from i import j", "   g = lambda: 0", "while x: import k"]
    (tmp_path / "a.py").write_text("\n".join(lines))
    assert packages_imported(tmp_path / "a.py") == set("abcdefghik")


def layer_of(rooms: list, room: str) -> int:
    """Return the position of a room, or of the set with the rooms that it imports from and that import it."""
    [position] = [k for k, layer in enumerate(rooms) if room == layer or isinstance(layer, frozenset) and room in layer]
    return position


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_imports_point_down(path):
    house, room = (*path.relative_to(ROOT).with_suffix("").parts, "")[:2]
    outside = packages_imported(path)
    for module in modules_imported(path):
        if path.relative_to(ROOT).as_posix() == MAY_ASK_FOR_BENCHMARKS and module[0] == "benchmarks":
            continue
        assert module[0] in MAY_IMPORT[house]
        file = ROOT.joinpath(*module)
        assert file.is_dir() or file.with_suffix(".py").is_file(), f"there is no {'.'.join(module)}"
        rooms = ROOMS.get(house)
        if rooms and module[0] == house and len(module) > 1 and room != "__init__":
            assert layer_of(rooms, module[1]) <= layer_of(rooms, room), f"{room} may not import {'.'.join(module)}"
    assert "adaptive_terrain" not in outside, "an extension has another name: imports are relative"
    if house in ("kernels", "cbt_terrain"):
        assert not outside & BLENDER


def test_no_module_imports_itself_in_a_circle():
    graph = {}
    for path in FILES:
        name = path.relative_to(ROOT).with_suffix("").parts
        graph[name[:-1] if name[-1] == "__init__" else name] = modules_imported(path)
    try:
        list(TopologicalSorter(graph).static_order())
    except CycleError as circle:
        raise AssertionError(" -> ".join(".".join(name) for name in circle.args[1])) from None


@pytest.mark.parametrize("path", [p for p in HOUSES["kernels"] if p.stem != "__init__"], ids=lambda path: path.name)
def test_kernels_open_no_file(path):
    assert packages_imported(path) <= {"warp", "numpy", "math"}


def test_the_engine_imports_without_bpy():
    """Every module of the two lower houses, and the command line, in a Python where bpy cannot be imported."""
    names = [
        ".".join(("adaptive_terrain", *path.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__")
        for house in ("kernels", "cbt_terrain")
        for path in HOUSES[house]
    ]
    assert len(names) > 4
    script = f"""
import importlib, sys
for name in {sorted(BLENDER)!r}:
    sys.modules[name] = None
for name in {[*names, "adaptive_terrain.operators.cli.command_line"]!r}:
    importlib.import_module(name)
"""
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


def test_the_package_root_imports_no_bpy_at_import():
    tree = ast.parse((ROOT / "__init__.py").read_text(encoding="utf-8"))
    top = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    assert top == []


def test_every_house_is_packaged():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    packaged = set(project["tool"]["setuptools"]["packages"])
    folders = {path.parent.relative_to(ROOT).parts for path in FILES}
    assert packaged == {"adaptive_terrain", *(".".join(("adaptive_terrain", *parts)) for parts in folders)}


def test_one_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    source = (ROOT / "__init__.py").read_text(encoding="utf-8")
    assert manifest["version"] == project["project"]["version"]
    assert f'__version__ = "{manifest["version"]}"' in source
    assert f"## {manifest['version']}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_every_file_names_its_licence():
    python = [path for path in ROOT.glob("[a-z]*/**/*.py") if path.relative_to(ROOT).parts[0] != "build"]
    missing = [path.name for path in python if "SPDX-License-Identifier" not in path.read_text(encoding="utf-8")]
    assert missing == []
