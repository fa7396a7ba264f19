"""Figures of what was learnt: the spectrum beside the one that was believed, and the models over time."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from navfilter.evaluation.learned_text import LearnedText
from navfilter.foundation.arrays import Array
from navfilter.rendering.drawing import colour
from navfilter.rendering.panels import Band, Line, Panel, Part, Points, Stack, short

#: Frequencies of a spectrum that nobody has learnt, from one period in so many samples up.
FREQUENCIES, LONGEST = 400, 20000


class SpectrumBand(NamedTuple):
    """What is known of a spectrum: frequencies [Hz], and its density, low, median and high, in the unit that is shown,
    shape (n,) each.
    """

    freq_hz: Array
    low: Array
    median: Array
    high: Array


def learnt_figures(found: tuple[LearnedText, ...], end_s: float) -> Iterator[tuple[str, Stack]]:
    """Caption and figure, spectrum and history of every axis, one after the other.

    Parameters
    ----------
    found : tuple of LearnedText
    end_s : float
        Until when the last models are in force [s].
    """
    for history in found:
        caption = (
            "Spectrum at the end, with the range from 5 to 95 % that its posterior leaves, and that of vehicle.toml."
        )
        yield f"{history}. {caption}", spectrum_figure(history)
        last = history.models[-1]
        text = f"{history.title}: {len(history.models)} models, the last one of order ({last.p}, {last.q})."
        yield f"{text} A pole radius of 1 would be a random walk.", adopted_figure(history, end_s)


def learnt_band(history: LearnedText) -> SpectrumBand:
    """The learnt spectrum with the range from 5 to 95 % that its posterior leaves; empty for a model from a file."""
    freq_hz, low, median, high = history.spectrum
    if not freq_hz.size:
        freq_hz = np.geomspace(history.scale.rate_hz / LONGEST, 0.5 * history.scale.rate_hz, FREQUENCIES)
        low = median = high = np.full(freq_hz.size, np.nan)
    return SpectrumBand(freq_hz, low, median, high)


def spectrum_figure(history: LearnedText, band: SpectrumBand | None = None) -> Stack:
    """Density of the learnt error with its range, and of what was believed, over frequency.

    Parameters
    ----------
    history : LearnedText
    band : SpectrumBand, optional
        Default `learnt_band`.
    """
    band = learnt_band(history) if band is None else band
    believed = history.believed_spectrum(band.freq_hz)
    (prior, _), (learnt, dash) = colour(0), colour(1)
    parts: tuple[Part, ...] = (Line(band.freq_hz, believed, "believed", prior),)
    if np.isfinite(band.median).any():
        parts = (
            Band(band.freq_hz, band.low, band.high, "5 to 95 %", learnt),
            *parts,
            Line(band.freq_hz, band.median, "learnt", learnt, dash),
        )
    curves = np.concatenate([believed[believed > 0.0], band.median[band.median > 0.0]])
    limits = (0.3 * float(curves.min()), 3.0 * float(curves.max())) if curves.size else (0.1, 10.0)
    label = f"{short(history.title)}\n[({history.scale.unit})²/Hz]"
    return Stack((Panel(label, parts, limits, log=True),), 2.2, x_label="frequency [Hz]", log_x=True)


def adopted_figure(history: LearnedText, end_s: float) -> Stack:
    """Coefficients, radii of the poles and innovation sd of the adopted models over time.

    Parameters
    ----------
    history : LearnedText
    end_s : float
        Until when the last model is in force.
    """
    t = np.array([*history.time_s, max(end_s, history.time_s[-1])])
    models = history.models
    panels = []
    for kind, name in (("ar", "autoregressive"), ("ma", "moving average")):
        count = max(len(getattr(m, kind)) for m in models)
        series = [_steps(t, [_at(getattr(m, kind), k) for m in models], k, f"{kind}[{k}]") for k in range(count)]
        if count:
            panels.append(Panel(f"{name}\ncoefficients", tuple(part for pair in series for part in pair)))
    order = max(m.p for m in models)
    radii = [[_nines(_at(np.abs(m.poles), k)) for m in models] for k in range(order)]
    if order:
        names = ["largest", *(f"{k + 1}." for k in range(1, order))]
        steps = [_steps(t, values, k, names[k]) for k, values in enumerate(radii)]
        top = max(2.0, float(np.ceil(np.nanmax(radii))))
        ticks = tuple((tick, f"{1.0 - 10.0**-tick:.{int(tick)}f}") for tick in np.arange(top + 1.0))
        parts = tuple(part for pair in steps for part in pair)
        panels.append(Panel("pole radius", parts, (0.0, top), ticks=ticks))
    sds = _steps(t, [history.scale.factor * m.sd for m in models], 0, "innovation sd")
    panels.append(Panel(f"sd [{history.scale.unit}]", sds, shape="from zero"))
    return Stack(tuple(panels), 1.25)


def _nines(radius: float) -> float:
    """Radius of a pole on a scale that counts its nines: what happens near 1 is what matters."""
    return -float(np.log10(max(1.0 - radius, 1e-6)))


def _at(values: Array, k: int) -> float:
    return float(values[k]) if k < len(values) else np.nan


def _steps(t: Array, values: list[float], number: int, label: str) -> tuple[Part, ...]:
    hue, dash = colour(number)
    held = np.array([*values, values[-1]])
    return Line(t, held, label, hue, dash, steps=True), Points(t[:-1], held[:-1], label, hue, "o")
