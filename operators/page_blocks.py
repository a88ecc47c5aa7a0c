# SPDX-License-Identifier: GPL-3.0-or-later
"""A page as blocks, and the same page as HTML and as Markdown."""

import html
import re
from dataclasses import dataclass, field

from .demo_page import document

EMPHASIS = re.compile(r"\*(\w+)\*")


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
