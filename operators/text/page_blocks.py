# SPDX-License-Identifier: GPL-3.0-or-later
"""A page of blocks, written as HTML or Markdown."""

import base64
import html
import re
from dataclasses import dataclass, field

from .svg import PALETTE

STYLE = (
    PALETTE
    + """
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
.figures span, figcaption, th, td {
  font-family: system-ui, "Segoe UI", Helvetica, Arial, sans-serif; }
.figures span { font-size: 14px; color: var(--soft); }
figure { margin: 0 0 28px; }
figure img { display: block; width: 100%; height: auto; }
figcaption { font-size: 14px; color: var(--soft); margin-top: 8px; }
.pair { display: grid; grid-template-columns: 1.78fr 1fr; gap: 20px; align-items: start; }
@media (max-width: 760px) { .pair { grid-template-columns: 1fr; } h1 { font-size: 32px; } }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { font-size: 14px; text-align: right; padding: 5px 12px; border-bottom: 1px solid var(--line); }
th { font-weight: 600; color: var(--soft); }
th:first-child, td:first-child { text-align: left; padding-left: 0; white-space: nowrap; }
.scroll { overflow-x: auto; }
dl { margin: 0; max-width: 48em; }
dt { font-weight: 600; margin-top: 10px; }
dd { margin: 0; color: var(--soft); }
.strip { display: grid; grid-template-columns: repeat(auto-fit, minmax(200px, 1fr)); gap: 12px; margin: 28px 0; }
.strip figure { margin: 0; }
.strip b { display: block; font-size: 17px; color: var(--ink); }
svg { display: block; width: 100%; height: auto; }
pre { font: 14px/1.5 ui-monospace, "DejaVu Sans Mono", Menlo, monospace; padding: 16px 20px; overflow-x: auto;
  border-left: 3px solid var(--teal); background: color-mix(in srgb, var(--teal) 8%, transparent); }
"""
)

EMPHASIS = re.compile(r"\*(\w[\w ]*)\*")


@dataclass(frozen=True)
class Heading:
    """A heading of a page."""

    text: str


@dataclass(frozen=True)
class Text:
    """A paragraph; `*word*` is emphasised."""

    text: str


@dataclass(frozen=True)
class Lead:
    """The first sentence below a title."""

    text: str


@dataclass(frozen=True)
class Words:
    """Definitions: (word, meaning)."""

    pairs: list[tuple[str, str]]


@dataclass(frozen=True)
class PagePicture:
    """A PNG file with a caption and an optional title. `png`: its bytes to embed in the page, None for a link."""

    name: str
    caption: str
    title: str = ""
    png: bytes | None = field(default=None, repr=False)


@dataclass(frozen=True)
class PictureStrip:
    """Pictures of equal width in a row; `first_wide`: two pictures, the first of which is wider than high."""

    pictures: list[PagePicture]
    first_wide: bool = False


@dataclass(frozen=True)
class Code:
    """Lines of a program; in HTML only."""

    text: str


@dataclass(frozen=True)
class Figures:
    """Large figures: (value, meaning)."""

    pairs: list[tuple[str, str]]


@dataclass(frozen=True)
class Table:
    """A table whose first column is text and whose other columns are numbers."""

    head: list[str]
    rows: list[list[str]]


@dataclass(frozen=True)
class Plot:
    """A picture of a page."""

    name: str
    caption: str
    svg: str = field(repr=False)


def as_markdown(title: str, blocks: list) -> str:
    """Return a page as Markdown. `blocks`: instances of this module's classes, in order."""
    return "\n\n".join([f"# {title}", *map(_block_to_markdown, blocks)]) + "\n"


def _block_to_markdown(block) -> str:
    """Return one block as Markdown. Pages with Code or a PagePicture outside of a strip are written as HTML only."""
    match block:
        case Heading(text):
            return f"## {text}"
        case Text(text) | Lead(text):
            return text
        case Words(pairs):
            return "\n".join(f"* **{word}**: {meaning}" for word, meaning in pairs)
        case Figures(pairs):
            return "\n".join(f"* {what}: {value}" for value, what in pairs)
        case PictureStrip(pictures):
            rows = ([f"**{p.title}**<br>{p.caption}" for p in pictures], [f"![{p.title}]({p.name})" for p in pictures])
            return _markdown_table(*rows, rule=" :-: ")
        case Plot(name, caption):
            return f"![{caption}]({name})"
    return _markdown_table(block.head, *block.rows)  # a Table


def _markdown_table(head: list[str], *rows: list[str], rule: str = "") -> str:
    """Return a Markdown table with a head and rows of cells.

    rule: the alignment of every column, by default left for the first and right for the others.
    """
    rules = [rule] * len(head) if rule else [" --- ", *[" ---: "] * (len(head) - 1)]
    lines = [f"| {' | '.join(cells)} |" for cells in (head, *rows)]
    return "\n".join([lines[0], f"|{'|'.join(rules)}|", *lines[1:]])


def as_html(title: str, blocks: list) -> str:
    """Return a page as self-contained HTML. `blocks`: instances of this module's classes, in order."""
    return document(title, [f"<h1>{html.escape(title)}</h1>", *map(_block_to_html, blocks)])


def _block_to_html(block) -> str:
    """Return one block as HTML."""
    match block:
        case Heading(text):
            return f"<h2>{html.escape(text)}</h2>"
        case Text(text):
            return "<p>" + EMPHASIS.sub(r"<em>\1</em>", html.escape(text)) + "</p>"
        case Lead(text):
            return f'<p class="lead">{html.escape(text)}</p>'
        case Words(pairs):
            terms = (f"<dt>{html.escape(word)}</dt><dd>{html.escape(meaning)}</dd>" for word, meaning in pairs)
            return f"<dl>{''.join(terms)}</dl>"
        case Figures(pairs):
            cells = (f"<div><b>{html.escape(v)}</b><span>{html.escape(w)}</span></div>" for v, w in pairs)
            return f'<div class="figures">{"".join(cells)}</div>'
        case PictureStrip(pictures, first_wide):
            return f'<div class="{"pair" if first_wide else "strip"}">{"".join(map(_block_to_html, pictures))}</div>'
        case PagePicture(name, caption, title, png):
            source = f"data:image/png;base64,{base64.b64encode(png).decode()}" if png else html.escape(name)
            text = (f"<b>{html.escape(title)}</b>" if title else "") + html.escape(caption)
            shown = f'<img src="{source}" alt="{html.escape(title or caption)}">'
            return f"<figure>{shown}<figcaption>{text}</figcaption></figure>"
        case Code(text):
            return f"<pre>{html.escape(text)}</pre>"
        case Plot(_, caption, svg):
            return f"<figure>{svg}<figcaption>{html.escape(caption)}</figcaption></figure>"
    lines = [("th", block.head), *(("td", cells) for cells in block.rows)]  # a Table
    rows = ("".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells) for tag, cells in lines)
    return f'<div class="scroll"><table>{"".join(f"<tr>{row}</tr>" for row in rows)}</table></div>'


def document(title: str, body: list[str]) -> str:
    """Return a self-contained page. title: text, which is escaped here. body: pieces of HTML, a line each."""
    head = (
        '<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>{STYLE}</style>\n<main>\n"
    )
    return head + "\n".join(body) + "\n</main>\n</html>\n"
