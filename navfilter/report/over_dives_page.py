"""The page of ``navfilter learn``: the dives, and of each sensor the spectrum as described and as learnt."""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from navfilter.calibration.over_dives import OverDives
from navfilter.evaluation.over_dives_text import AxisSpectra, axis_spectra, learnt_lines
from navfilter.io.write import write_text
from navfilter.rendering.clock import Clock
from navfilter.rendering.drawing import colour, draw, style, svg
from navfilter.rendering.page import Section, figure_html, list_html, page, table_html
from navfilter.rendering.panels import Band, Line, Panel, Part, Stack, short

#: Of a line that one dive draws.
GREY, THIN = "#999999", 0.6


def write_over_dives_page(result: OverDives, path: str | os.PathLike[str]) -> Path:
    """Write one HTML page that loads nothing.

    Parameters
    ----------
    result : OverDives
    path : path-like
        Of the .html.
    """
    header = ["dive", "fixes after gaps", "longest gap [s]", "missed by, rms [m]", "believed [m]", "NEES"]
    rows = [
        [d.name, f"{d.gaps}", f"{d.longest_s:.0f}", f"{d.missed_m:.2f}", f"{d.believed_m:.2f}", f"{d.nees:.2f}"]
        for d in result.dives
    ]
    body = [
        Section("Result", (list_html(learnt_lines(result)),)),
        Section("Dives", (table_html(header, rows),)),
        *(Section(name, tuple(_figures(result, name))) for name in result.known),
    ]
    counted = f"{len(result.counted)} dive{'s' * (len(result.counted) > 1)}: "
    counted += ", ".join(name for name, _ in result.counted)
    return write_text(page("navfilter learn", result.vehicle.name, counted, body), path)


def _figures(result: OverDives, name: str) -> Iterator[str]:
    for spectra in axis_spectra(result, name):
        caption = (
            f"{spectra.title}: spectrum as described, and as learnt with the range from 5 to 95 % that the posterior "
            "leaves; thin what each dive alone makes of it."
        )
        with style():
            yield figure_html(svg(draw(spectra_figure(spectra), Clock(0.0, 1.0))), caption)


def spectra_figure(spectra: AxisSpectra) -> Stack:
    """Density over frequency: described, learnt with its band, and by each dive."""
    f = spectra.freq_hz
    (described, _), (learnt, dash) = colour(0), colour(1)
    each = tuple(Line(f, values, "one dive alone", GREY, width=THIN) for values in spectra.dives)
    parts: tuple[Part, ...] = (
        Band(f, spectra.low, spectra.high, "5 to 95 %", learnt),
        *each,
        Line(f, spectra.described, "described", described),
        Line(f, spectra.learnt, "learnt", learnt, dash),
    )
    curves = np.concatenate([spectra.low, spectra.high, spectra.described, *spectra.dives])
    curves = curves[curves > 0.0]
    limits = (0.5 * float(curves.min()), 2.0 * float(curves.max())) if curves.size else (0.1, 10.0)
    label = f"{short(spectra.title)}\n[({spectra.unit})²/Hz]"
    return Stack((Panel(label, parts, limits, log=True),), 2.4, x_label="frequency [Hz]", log_x=True)
