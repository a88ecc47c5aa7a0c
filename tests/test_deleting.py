# SPDX-License-Identifier: GPL-3.0-or-later
"""Only one module deletes files and makes folders below a project."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
HOUSES = ("kernels", "cbt_terrain", "operators", "benchmarks", "tools", "examples")
OWNER = ROOT / "cbt_terrain" / "run" / "owned_files.py"
DELETING = {"rmtree", "unlink", "rmdir", "removedirs"}
# Folders that the user names for results.
MAY_MAKE = {"operators/export/exporting.py", "operators/farm/guard.py"}
FILES = sorted(f for house in HOUSES for f in (ROOT / house).rglob("*.py") if f != OWNER) + [ROOT / "__init__.py"]


def is_blender(node: ast.expr) -> bool:
    """Return whether a call unlinks an object from a collection: `collection.objects.unlink(...)`."""
    return isinstance(node, ast.Attribute) and node.attr in {"objects", "children"}


def deletions(text: str) -> list[str]:
    found = []
    for node in ast.walk(ast.parse(text)) if any(word in text for word in (*DELETING, "remove")) else ():
        if isinstance(node, ast.Attribute):
            of_os = isinstance(node.value, ast.Name) and node.value.id == "os"
            if (node.attr in DELETING and not is_blender(node.value)) or (of_os and node.attr == "remove"):
                found.append(f"{node.lineno}: {ast.unparse(node)}")
        elif isinstance(node, ast.ImportFrom) and node.module in {"os", "shutil"}:
            found += [f"{node.lineno}: {a.name}" for a in node.names if a.name in DELETING | {"remove"}]
    return found


@pytest.mark.parametrize(
    "code",
    ["shutil.rmtree(p)", "os.unlink(p)", "os.remove(p)", "p.unlink()", "Path(p).rmdir()", "from os import remove"],
)
def test_every_way_to_delete_is_found(code):
    assert len(deletions(code)) == 1
    assert not deletions("collection.objects.unlink(o); bpy.data.objects.remove(o); names.remove(n)")


def test_no_other_module_deletes_files():
    found = {str(file.relative_to(ROOT)): deletions(file.read_text(encoding="utf-8")) for file in FILES}
    assert len(FILES) > 300 and {file: lines for file, lines in found.items() if lines} == {}


def test_no_other_module_makes_folders_of_a_project():
    found = set()
    for file in FILES:
        name, text = str(file.relative_to(ROOT)), file.read_text("utf-8")
        if name.startswith(("cbt_terrain", "operators")) and ("mkdir" in text or "makedirs" in text):
            names = {n.attr for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Attribute)}
            found |= {name} if names & {"mkdir", "makedirs"} and name != "cbt_terrain/run/partial_files.py" else set()
    assert found == MAY_MAKE
