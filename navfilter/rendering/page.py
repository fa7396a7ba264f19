"""One self-contained HTML page, and tables for page and terminal."""

import base64
import hashlib
import html
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import NamedTuple

from navfilter.foundation.quoting import printable

#: Says, before anything is painted, that scripts run: the page then waits with what they will draw.
_SCRIPTED = 'document.documentElement.classList.add("scripted");'


@dataclass(frozen=True)
class Section:
    """A part of a page that its table of contents names.

    Attributes
    ----------
    title : str
    parts : tuple of str
        HTML, one part after the other.
    sensor : str
        Where scripts run, only one of the sections with a sensor is shown at a time.
    mood : str
        Of a verdict: "good", "care" or "bad".
    """

    title: str
    parts: tuple[str, ...]
    sensor: str = ""
    mood: str = ""

    @property
    def anchor(self) -> str:
        """What links to the section name."""
        plain = re.sub("[^A-Za-z0-9 ]", lambda sign: f"_{ord(sign.group()):x}", self.title)
        return f"{'sensor-' if self.sensor else ''}{plain.replace(' ', '-')}"

    def __str__(self) -> str:
        of = f' data-sensor="{escape(self.sensor)}"' if self.sensor else ""
        mood = f' class="verdict {self.mood}"' if self.mood else ""
        inside = "\n".join(self.parts)
        return f'<section id="{escape(self.anchor)}"{of}{mood}>{heading_html(self.title)}\n{inside}</section>'


class Scripts(NamedTuple):
    """What a page runs: it forbids the browser to run any other script, and to load anything.

    Attributes
    ----------
    run : tuple of str
        At the end of the page, one after the other.
    library : str
        What these may insert.
    data : str
        HTML without scripts that runs nothing, before them.
    """

    run: tuple[str, ...]
    library: str
    data: str


@cache
def resource(name: str, package: str = "navfilter.rendering") -> str:
    """Text of a file that lies in a package."""
    return (files(package) / name).read_text(encoding="utf-8")


def page(title: str, heading: str, subtitle: str, body: Iterable[str | Section], scripts: Scripts | None = None) -> str:
    """A page that needs nothing but itself, readable on a phone and in print.

    Parameters
    ----------
    title : str
        Of the window.
    heading, subtitle : str
        Plain text at the top.
    body : iterable of str or Section
        HTML, one part after the other. With sections the page has a table of contents.
    scripts : Scripts, optional
        Default none: nothing runs.
    """
    scripts = Scripts((), "", "") if scripts is None else scripts
    body = list(body)
    sections = [part for part in body if isinstance(part, Section)]
    run = (_SCRIPTED, *scripts.run) if scripts.run else ()
    policy = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"
    policy += _allowed((*run, scripts.library))
    head = (
        f'<meta charset="utf-8"><meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title>{f'<script>{_SCRIPTED}</script>' if run else ''}<style>{resource('page.css')}</style>"
    )
    top = f'<h1>{escape(heading)}</h1>\n<p class="sub">{escape(subtitle)}</p>\n'
    main = top + "\n".join(map(str, body))
    inside = f"{_contents(sections)}\n<main>\n{main}\n</main>" if sections else main
    ends = "".join(f"<script>{script}</script>" for script in scripts.run)
    return (
        f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body{" class=contents" if sections else ""}>\n'
        f"{inside}\n{scripts.data}{ends}</body></html>\n"
    )


def _allowed(scripts: Iterable[str]) -> str:
    """What lets exactly these scripts run."""
    digests = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in scripts if text]
    return "; script-src " + " ".join(f"'sha256-{digest}'" for digest in digests) if digests else ""


def _contents(sections: Sequence[Section]) -> str:
    def entry(section: Section) -> str:
        return f'<a href="#{escape(section.anchor)}">{escape(section.title)}</a>'

    lines, sensors = [], [entry(section) for section in sections if section.sensor]
    for section in sections:
        if not section.sensor:
            lines.append(f"<li>{entry(section)}</li>")
        elif sensors:
            lines.append(f"<li>Sensors<ul>{''.join(f'<li>{line}</li>' for line in sensors)}</ul></li>")
            sensors = []
    return f"<nav><details><summary>Contents</summary><ul>{''.join(lines)}</ul></details></nav>"


def escape(text: str) -> str:
    """Text as HTML, with nothing in it that is not seen."""
    return html.escape(printable(str(text)), quote=True)


def heading_html(text: str) -> str:
    """Heading of a section."""
    return f"<h2>{escape(text)}</h2>"


def list_html(lines: Iterable[str]) -> str:
    """A list of plain lines; nothing where there are none."""
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f"<ul>{items}</ul>" if items else ""


def image_html(drawn: bytes, caption: str) -> str:
    """A picture (SVG, see `navfilter.rendering.drawing.svg`) inside the page."""
    text = drawn.decode("utf-8").replace("%", "%25").replace("#", "%23").replace("<", "%3C").replace(">", "%3E")
    quoted = text.replace("'", "%27").replace('"', "'").replace("&", "&amp;")
    return f'<img alt="{escape(caption)}" src="data:image/svg+xml,{quoted}">'


def figure_html(drawn: bytes, caption: str, live: str = "") -> str:
    """A figure with its caption.

    Parameters
    ----------
    drawn : bytes
        For print, and for readers without scripts: SVG, see `navfilter.rendering.drawing.svg`.
    caption : str
    live : str
        HTML of the place where a script draws the same.
    """
    linked = ' class="linked"' if live else ""
    return f"<figure{linked}>{live}{image_html(drawn, caption)}<figcaption>{escape(caption)}</figcaption></figure>"


def table_html(header: Sequence[str], rows: Iterable[Sequence[str]], text_columns: Sequence[int] = ()) -> str:
    """A table; the first column and `text_columns` are aligned to the left, the others are numbers."""

    def line(cells: Sequence[str], tag: str) -> str:
        marks = [' class="text"' if i in text_columns else "" for i in range(len(cells))]
        marked = zip(marks, cells, strict=True)
        return f"<tr>{''.join(f'<{tag}{mark}>{escape(cell)}</{tag}>' for mark, cell in marked)}</tr>"

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
