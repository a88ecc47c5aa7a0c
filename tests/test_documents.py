# SPDX-License-Identifier: GPL-3.0-or-later
"""The documents: links and pictures exist, pages are short and match the code, figures match their scripts."""

import argparse
import ast
import importlib.util
import inspect
import operator
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
LINK = re.compile(r"!?\[(?:[^\]]|\n)*\]\(([^)\s]+)\)")
NAV = re.compile(r"^ *- (?:[^#\n]*: )?(\S+\.md)$", re.MULTILINE)
MAX_WORDS = 700
CODE = re.compile(r"^```.*?^```|^    .*?$|`[^`\n]*`", re.MULTILINE | re.DOTALL)


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
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


def pages_of(*folders: str) -> list[Path]:
    return [page for folder in folders for page in sorted((ROOT / "docs" / folder).glob("*.md"))]


def test_the_site_lists_every_page_once():
    listed = NAV.findall((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    pages = [page.relative_to(ROOT / "docs").as_posix() for page in (ROOT / "docs").rglob("*.md")]
    assert sorted(listed) == sorted([*pages, "hard_cases.md"])  # the last one is written by tools/hard_cases_page.py


FOR_USERS = pages_of("start", "howto", "understand", "reference/panel")


@pytest.mark.parametrize("page", FOR_USERS, ids=lambda page: page.stem)
def test_a_page_for_users_is_short_and_has_a_picture(page):
    text = page.read_text(encoding="utf-8")
    assert len(text.split()) <= MAX_WORDS
    assert re.search(r"!\[[^\]]+\]\([^)]+\.(?:jpg|png|svg)\)", text)


def texts_in(folder: Path) -> set[str]:
    """Return every text in the code of a folder, those of an f-string in parts."""
    trees = (ast.parse(path.read_text(encoding="utf-8")) for path in folder.rglob("*.py"))
    nodes = (node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Constant))
    return {node.value for node in nodes if isinstance(node.value, str)}


@pytest.fixture(scope="module")
def labels() -> set[str]:
    """Return the labels of panels and operators, and names of parameters as a panel turns them into labels."""
    texts = texts_in(ROOT / "operators") | texts_in(ROOT / "cbt_terrain")
    titles = {text.replace("_", " ").title() for text in texts if re.fullmatch("[a-z_]+", text)}
    return {text.strip(" :") for text in texts} | titles


@pytest.mark.parametrize("page", pages_of("reference/panel"), ids=lambda page: page.stem)
def test_the_panels_have_every_label_of_their_pages(page, labels):
    rows = re.findall(r"^\| (\*[^|]*)\|", page.read_text(encoding="utf-8"), re.MULTILINE)
    named = [name for row in rows for name in re.findall(r"(?<!\*)\*([^*]+)\*(?!\*)", row)]
    named = [name for name in named if not re.match(r"[\d.]+ px", name)]
    assert named and [name for name in named if name not in labels] == []


def test_the_page_of_a_command_has_its_options():
    from adaptive_terrain.operators.cli.parser import build_parser

    verbs = next(a for a in build_parser()._actions if isinstance(a, argparse._SubParsersAction)).choices
    pages = {page.stem: page for page in pages_of("reference/commands")}
    assert set(pages) == {*verbs, "index"} - {"bench"}
    for name, verb in verbs.items():
        text = pages["demo" if name == "bench" else name].read_text(encoding="utf-8")
        text = text.partition("## bench")[2 if name == "bench" else 0]
        options = {option for action in verb._actions for option in action.option_strings if option.startswith("--")}
        options -= {"--help", "--progress"}
        table = "\n".join(line for line in text.splitlines() if line.startswith("|"))
        found = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", table))
        assert options - found == set(), f"missing on the page of {name}"
        described = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", table.replace("`--path`, or", "")))
        assert described - options <= {"--store", "--path", "--frames"}, f"unknown on the page of {name}"


def test_the_api_page_has_every_public_name():
    import adaptive_terrain

    page = (ROOT / "docs" / "reference" / "python-api.md").read_text(encoding="utf-8")
    named = re.findall(r"^::: adaptive_terrain\.cbt_terrain\.(\S+)\.(\w+)$", page, re.MULTILINE)
    for module, name in named:
        assert hasattr(importlib.import_module(f"adaptive_terrain.cbt_terrain.{module}"), name)
    assert {name for _, name in named} >= set(adaptive_terrain.__all__)


def test_the_api_page_has_the_signatures():
    """Each line is a call with all parameters in their order; `...` stands for defaults that are no plain values."""
    import adaptive_terrain

    page = (ROOT / "docs" / "reference" / "python-api.md").read_text(encoding="utf-8")
    calls = [node.value for node in ast.parse(page.split("```python\n")[1].split("```")[0]).body]
    for call in calls:
        name = ast.unparse(call.func)
        parameters = inspect.signature(operator.attrgetter(name)(adaptive_terrain)).parameters.values()
        listed = [ast.unparse(argument) for argument in call.args]
        for word in call.keywords:
            listed.append(
                f"**{ast.unparse(word.value)}" if word.arg is None else f"{word.arg}={ast.unparse(word.value)}"
            )
        expected = [text for text in map(str, map(without_annotation, parameters)) if text != "self"]
        assert len(listed) == len(expected), name
        for shown, real in zip(listed, expected, strict=True):
            assert shown == real or shown == real.partition("=")[0] + "=...", (name, real)
    functions = {name for name in adaptive_terrain.__all__ if inspect.isfunction(getattr(adaptive_terrain, name))}
    assert functions <= {ast.unparse(call.func) for call in calls}


def without_annotation(parameter: inspect.Parameter) -> inspect.Parameter:
    return parameter.replace(annotation=inspect.Parameter.empty)


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


def test_the_effects_page_has_all_effects():
    from adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES
    from adaptive_terrain.cbt_terrain.height_operators.catalogue import HEIGHT_OPERATORS

    page = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    table, _, operators = page.partition("## Effects that shape the land")
    rows = re.findall(r"^\| `(\w+)` \| (.*?) \|", table, re.MULTILINE)
    assert rows == [(name, effect.about) for name, effect in ATTRIBUTES.items()], "run `make effects`"
    assert not any(effect.bound for effect in ATTRIBUTES.values())  # as the page states
    described = re.findall(r"^\* \*\*.*?\*\* \(`(\w+)`\)\. (.*?)\. \*", operators, re.MULTILINE)
    assert described == [(name, effect.about) for name, effect in HEIGHT_OPERATORS.items()], "run `make effects`"
