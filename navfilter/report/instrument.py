"""The figures of a page, each for print and live, and the script and data that make them live."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from bokeh.resources import Resources
from matplotlib.figure import Figure

from navfilter.rendering.clock import Clock
from navfilter.rendering.drawing import draw, style, svg
from navfilter.rendering.page import Scripts, escape, figure_html, resource
from navfilter.rendering.panels import Stack
from navfilter.report.figures import predicted_rms
from navfilter.report.live import Live, live_stack
from navfilter.report.live_plan import COLOURINGS, live_plan
from navfilter.report.plan_view import Plan, draw_plan
from navfilter.track.track import Track

__all__ = ["Instrument"]

#: The cursor knows the track at so many times.
ROWS = 2000


class Instrument:
    """Collects the figures of a page.

    Parameters
    ----------
    clock : Clock
        The time axis of all figures.
    track : Track
        What the cursor tells: place, depth, heading, speed.
    origin : Track
        Where the metres of the plan view begin.
    progress : callable, optional
        Called after each figure.
    """

    def __init__(self, clock: Clock, track: Track, origin: Track, progress: Callable[[], Any] | None = None) -> None:
        self.clock = clock
        self._rows = _rows(clock, track, origin)
        self._figures: list[dict[str, Any]] = []
        self._progress = progress

    def figure(self, what: Stack | Plan | Figure, caption: str) -> str:
        """HTML of one figure; a matplotlib figure stays as it is."""
        live: Live | None = None
        with style():
            if isinstance(what, Stack):
                drawn, live = svg(draw(what, self.clock)), live_stack(what, self.clock)
            elif isinstance(what, Plan):
                drawn, live = svg(draw_plan(what)), live_plan(what, self.clock)
            else:
                drawn = svg(what)
        place = "" if live is None else self._place(live, isinstance(what, Plan))
        if self._progress is not None:
            self._progress()
        return figure_html(drawn, caption, place)

    def _place(self, live: Live, plan: bool) -> str:
        number = len(self._figures)
        self._figures.append({"item": live.item, "keys": live.keys, "plan": plan})
        return (
            f'{_colouring() if plan else ""}<div class="keys"><span></span></div>'
            f'<div class="live" id="live-{number}" data-figure="{number}" style="min-height:{live.height_px}px"></div>'
        )

    def scripts(self) -> Scripts:
        """What makes the figures of the page live."""
        clock = self.clock
        utc = None if clock.utc_s is None else 1000.0 * (clock.utc_s + clock.zero_s)
        about = {"unit": clock.unit, "factor": clock.factor, "range": clock.range, "utc": utc}
        figures = json.dumps({"figures": self._figures, "rows": self._rows, "clock": about}, separators=(",", ":"))
        data = f'{_packed("library", library())}{_packed("figures", figures)}<output id="readout"></output>'
        return Scripts((resource("instrument.js"),), library(), data)


@cache
def library() -> str:
    """The drawing library's own script, as its package ships it."""
    return "\n".join(Resources(mode="inline", components=["bokeh"], minified=True, log_level="error").js_raw)


def _packed(name: str, text: str) -> str:
    """Text that the script unpacks; a browser does not run it."""
    data = base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode()
    return f'<script type="application/gzip" id="{name}">{data}</script>\n'


def _colouring() -> str:
    chosen = "".join(
        f'<label><input type="radio" name="colouring" value="{key}"{" checked" if key == "run" else ""}> '
        f"{escape(text)}</label>"
        for key, text in COLOURINGS.items()
    )
    return f'<div class="choice">Colour by {chosen}</div>'


def _rows(clock: Clock, track: Track, origin: Track) -> dict[str, list[float]]:
    rows = np.unique(np.linspace(0, len(track) - 1, ROWS).astype(int))
    north, east = track.local(float(origin.latitude[0]), float(origin.longitude[0]))[rows, :2].T
    columns = {
        "time": (clock(track.time_s[rows]), 5),
        "east": (east, 2),
        "north": (north, 2),
        "latitude": (np.degrees(track.latitude[rows]), 6),
        "longitude": (np.degrees(track.longitude[rows]), 6),
        "depth": (-track.height[rows], 2),
        "heading": (np.degrees(track.attitude[rows, 2]) % 360.0, 2),
        "speed": (np.hypot(*track.velocity_n[rows, :2].T), 3),
        "rms": (predicted_rms(track)[rows], 4),
    }
    return {name: np.round(values, digits).tolist() for name, (values, digits) in columns.items()}
