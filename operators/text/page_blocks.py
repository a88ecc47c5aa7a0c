# SPDX-License-Identifier: GPL-3.0-or-later
"""A page as blocks, and the same page as HTML and as Markdown."""

import html
import re
from dataclasses import dataclass, field

STYLE = """
:root { --ink: #1c1f26; --soft: #5d6470; --line: #d9d6cd; --paper: #faf9f5; --mark: #b4431e; --bar: #2f6f73; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e9e6df; --soft: #a0a6b0; --line: #3a3e46; --paper: #16181c; --mark: #ef8a5c; --bar: #5fb3a8; }
}
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 17px/1.55 Charter, "Bitstream Charter",
  "Iowan Old Style", Georgia, serif; }
main { max-width: 1080px; margin: 0 auto; padding: 56px 24px 80px; }
h1 { font-size: 42px; line-height: 1.1; font-weight: 600; margin: 0 0 12px; letter-spacing: -0.01em; }
h2 { font-size: 24px; font-weight: 600; margin: 56px 0 12px; }
p { max-width: 42em; margin: 0 0 16px; }
.lead { font-size: 20px; color: var(--soft); }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(190px, 1fr)); gap: 1px; margin: 36px 0;
  background: var(--line); border: 1px solid var(--line); }
.figures div { background: var(--paper); padding: 18px 20px; }
.figures b { display: block; font-size: 30px; font-weight: 600; line-height: 1.15; }
.figures span, figcaption, th, td, svg text, .small {
  font-family: system-ui, "Segoe UI", Helvetica, Arial, sans-serif; }
.figures span { font-size: 14px; color: var(--soft); }
figure { margin: 0 0 28px; }
figure img { display: block; width: 100%; height: auto; }
figcaption, .small { font-size: 14px; color: var(--soft); margin-top: 8px; }
.pair { display: grid; grid-template-columns: 1.78fr 1fr; gap: 20px; align-items: start; }
@media (max-width: 760px) { .pair { grid-template-columns: 1fr; } h1 { font-size: 32px; } }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { font-size: 14px; text-align: right; padding: 5px 12px; border-bottom: 1px solid var(--line); }
th { font-weight: 600; color: var(--soft); }
th:first-child, td:first-child { text-align: left; padding-left: 0; white-space: nowrap; }
.scroll { overflow-x: auto; }
svg { display: block; width: 100%; height: auto; }
svg text { font-size: 12px; fill: var(--soft); }
pre { font: 14px/1.5 ui-monospace, "DejaVu Sans Mono", Menlo, monospace; padding: 16px 20px; overflow-x: auto;
  border-left: 3px solid var(--bar); background: color-mix(in srgb, var(--bar) 8%, transparent); }
"""

EMPHASIS = re.compile(r"\*(\w[\w ]*)\*")


@dataclass(frozen=True)
class Heading:
    text: str


@dataclass(frozen=True)
class Text:
    """`*word*` is emphasised."""

    text: str


@dataclass(frozen=True)
class Figures:
    """Large figures: (value, what it is)."""

    pairs: list[tuple[str, str]]


@dataclass(frozen=True)
class Table:
    """The first column is text, the others are numbers."""

    head: list[str]
    rows: list[list[str]]


@dataclass(frozen=True)
class Plot:
    name: str
    caption: str
    svg: str = field(repr=False)


def as_markdown(title: str, blocks: list) -> str:
    parts = [f"# {title}"]
    for block in blocks:
        if isinstance(block, Heading):
            parts.append(f"## {block.text}")
        elif isinstance(block, Text):
            parts.append(block.text)
        elif isinstance(block, Figures):
            parts.append("\n".join(f"* {what}: {value}" for value, what in block.pairs))
        elif isinstance(block, Plot):
            parts.append(f"![{block.caption}]({block.name})")
        else:
            rule = "| --- " + "| ---: " * (len(block.head) - 1) + "|"
            lines = [f"| {' | '.join(cells)} |" for cells in (block.head, *block.rows)]
            parts.append("\n".join([lines[0], rule, *lines[1:]]))
    return "\n\n".join(parts) + "\n"


def as_html(title: str, blocks: list) -> str:
    body = [f"<h1>{html.escape(title)}</h1>"]
    for block in blocks:
        if isinstance(block, Heading):
            body.append(f"<h2>{html.escape(block.text)}</h2>")
        elif isinstance(block, Text):
            body.append("<p>" + EMPHASIS.sub(r"<em>\1</em>", html.escape(block.text)) + "</p>")
        elif isinstance(block, Figures):
            cells = (f"<div><b>{html.escape(v)}</b><span>{html.escape(w)}</span></div>" for v, w in block.pairs)
            body.append(f'<div class="figures">{"".join(cells)}</div>')
        elif isinstance(block, Plot):
            body.append(f"<figure>{block.svg}<figcaption>{html.escape(block.caption)}</figcaption></figure>")
        else:
            lines = [("th", block.head), *(("td", cells) for cells in block.rows)]
            rows = ("".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells) for tag, cells in lines)
            body.append(f'<div class="scroll"><table>{"".join(f"<tr>{row}</tr>" for row in rows)}</table></div>')
    return document(title, body)


def document(title: str, body: list[str]) -> str:
    """A whole page of that title, from the pieces of its body; it needs no other file."""
    head = (
        '<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>{STYLE}</style>\n<main>\n"
    )
    return head + "\n".join(body) + "\n</main>\n</html>\n"
