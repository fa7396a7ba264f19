"""One self-contained HTML page, and tables for page and terminal."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence

__all__ = ["escape", "figure_html", "heading_html", "list_html", "page", "table_html", "table_text"]

_CSS = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; color: #1b1b1b; background: #fff;
       max-width: 820px; margin: 0 auto; padding: 1rem; }
h1 { font-size: 1.5rem; margin: .5rem 0 .2rem; } h2 { font-size: 1.15rem; margin: 2rem 0 .5rem; border-bottom: 1px solid #ccc; }
p.sub { color: #555; margin: 0 0 1rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .85rem; font-variant-numeric: tabular-nums; width: 100%; }
th, td { padding: .3rem .5rem; text-align: right; border-bottom: 1px solid #e2e2e2; }
th { font-weight: 600; vertical-align: bottom; } th:first-child, td:first-child, td.text, th.text { text-align: left; }
figure { margin: 1rem 0; break-inside: avoid; page-break-inside: avoid; }
figure img { width: 100%; height: auto; display: block; }
figcaption { font-size: .85rem; color: #444; margin-top: .3rem; }
ul { padding-left: 1.2rem; } li, td.text { overflow-wrap: anywhere; }
@media print { body { max-width: none; font-size: 10pt; padding: 0; } .wide { overflow: visible; }
  h2 { break-after: avoid; page-break-after: avoid; } }
"""


def page(title: str, heading: str, subtitle: str, body: Iterable[str]) -> str:
    """A page that needs nothing but itself, readable on a phone and in print.

    Parameters
    ----------
    title : str
        Of the window.
    heading, subtitle : str
        Plain text at the top.
    body : iterable of str
        HTML, one part after the other.
    """
    head = (
        '<meta charset="utf-8"><meta name="viewport" content="width=device-width, '
        f'initial-scale=1"><title>{escape(title)}</title>'
    )
    top = f'<h1>{escape(heading)}</h1>\n<p class="sub">{escape(subtitle)}</p>\n'
    parts = "\n".join(body)
    return (
        "<!doctype html>\n<html "
        f'lang="en"><head>{head}<style>{_CSS}</style></head>\n<body>\n{top}{parts}\n</body></html>\n'
    )


def escape(text: str) -> str:
    """Text as HTML."""
    return html.escape(str(text), quote=True)


def heading_html(text: str) -> str:
    """Heading of a section."""
    return f"<h2>{escape(text)}</h2>"


def list_html(lines: Iterable[str]) -> str:
    """A list of plain lines; nothing where there are none."""
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f"<ul>{items}</ul>" if items else ""


def figure_html(drawn: bytes, caption: str) -> str:
    """A figure (SVG, see `navfilter.report.drawing.svg`) with its caption, inside the page."""
    data = base64.b64encode(drawn).decode("ascii")
    return (
        f'<figure><img alt="{escape(caption)}" '
        f'src="data:image/svg+xml;base64,{data}"><figcaption>{escape(caption)}</figcaption></figure>'
    )


def table_html(header: Sequence[str], rows: Iterable[Sequence[str]], text_columns: Sequence[int] = ()) -> str:
    """A table; the first column and `text_columns` are aligned to the left, the others are numbers."""

    def line(cells: Sequence[str], tag: str) -> str:
        marks = [' class="text"' if i in text_columns else "" for i in range(len(cells))]
        return (
            "<tr>"
            + "".join(f"<{tag}{mark}>{escape(cell)}</{tag}>" for mark, cell in zip(marks, cells, strict=True))
            + "</tr>"
        )

    body = "".join(line(row, "td") for row in rows)
    return f'<div class="wide"><table><thead>{line(header, "th")}</thead><tbody>{body}</tbody></table></div>'


def table_text(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """The same as text, for a terminal."""
    lines = [header, *rows]
    widths = [max(len(row[i]) for row in lines) for i in range(len(header))]
    aligned = [
        [cell.rjust(w) if i else cell.ljust(w) for i, (cell, w) in enumerate(zip(row, widths, strict=True))]
        for row in lines
    ]
    return "\n".join("  ".join(row).rstrip() for row in aligned)
