"""How descriptions and results show themselves in a notebook: a small table of HTML."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

__all__ = ["card"]


def card(title: str, rows: Mapping[str, object]) -> str:
    """A titled table of two columns; all text is escaped, rows that are None are left out.

    Examples
    --------
    >>> card("Track", {"rows": 3, "UTC": None})
    '<table><caption>Track</caption><tr><th>rows</th><td>3</td></tr></table>'
    """
    cells = (
        f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>"
        for name, value in rows.items()
        if value is not None
    )
    return f"<table><caption>{escape(title)}</caption>{''.join(cells)}</table>"
