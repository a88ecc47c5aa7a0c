# SPDX-License-Identifier: GPL-3.0-or-later
"""The documents: every link leads somewhere, and every figure is the one that its script draws."""

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
LINK = re.compile(r"!?\[(?:[^\]]|\n)*\]\(([^)\s]+)\)")
CODE = re.compile(r"^```.*?^```|^    .*?$|`[^`\n]*`", re.MULTILINE | re.DOTALL)


def anchors(page: Path) -> set[str]:
    """Of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    names = [re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings]
    return {f"{name}-{names[:k].count(name)}".removesuffix("-0") for k, name in enumerate(names)}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_link_of_a_page_leads_somewhere(page):
    for link in LINK.findall(CODE.sub("", page.read_text(encoding="utf-8"))):
        if re.match("[a-z]+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_no_page_of_the_method_is_out_of_reach():
    index = (ROOT / "docs" / "method.md").read_text(encoding="utf-8")
    assert {f"method/{page.name}" for page in (ROOT / "docs" / "method").glob("*.md")} == {
        link.partition("#")[0] for link in LINK.findall(index) if link.startswith("method/")
    }


def test_figures_are_those_that_the_script_draws(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "tools")
    spec = importlib.util.spec_from_file_location("draw_figures", ROOT / "tools" / "draw_figures.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    drawn = {f"method_{name}.svg": draw() for name, draw in script.FIGURES.items()}
    kept = {path.name: path.read_text(encoding="utf-8") for path in script.IMAGES.glob("method_*.svg")}
    assert drawn == kept, "run `make figures`"


def test_the_page_of_effects_has_each_of_them_and_the_example_that_runs():
    from adaptive_terrain.cbt_terrain.effects.catalogue import EFFECTS
    from adaptive_terrain.cbt_terrain.land_effects.catalogue import LAND_EFFECTS

    page = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    assert re.findall(r"^### (\w+)$", page, re.MULTILINE) == [*EFFECTS, *LAND_EFFECTS], "run `make effects`"
    for name, effect in [*EFFECTS.items(), *LAND_EFFECTS.items()]:
        assert f"{effect.about}." in page, name
    example = (ROOT / "examples" / "06_an_effect.py").read_text(encoding="utf-8")
    assert example.split("\n", 1)[1] in page
