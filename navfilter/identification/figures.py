"""The figures of an identification: series, spectra, correlations, order surfaces, residuals, poles and zeros, Allan
deviation.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator
from scipy.signal import welch

from navfilter.foundation import utc
from navfilter.foundation.arrays import Array, Complex
from navfilter.identification.conditioning import bridged
from navfilter.identification.identify import Identification
from navfilter.rendering.drawing import COLOURS, WIDTH_IN, draw
from navfilter.rendering.panels import Band, Level, Line, Mark, Panel, Part, Stack, stems
from navfilter.timeseries.diagnostics import WT_WHITE, acf, pacf
from navfilter.timeseries.roots import root_sd

SAMPLE, MODEL, GREY = COLOURS[1], COLOURS[5], "#777777"
LAGS = 50


def identification_figures(found: Identification, unit: str = "") -> Iterator[tuple[str, str, str, Figure]]:
    """File stem, heading, caption and figure, one after the other.

    Parameters
    ----------
    found : Identification
    unit : str
        Unit of the series.
    """
    yield "series", "Series", _series_caption(found), series_figure(found, unit)
    caption = (
        "Power spectral density of the samples (Welch) and of the fitted model; both one-sided, their integral "
        "is the variance."
    )
    yield "psd", "Spectrum", caption, spectrum_figure(found, unit)
    caption = "Autocorrelation and partial autocorrelation of what was modelled, with the 95 % limits of white noise."
    x = np.diff(found.data.value, found.fit.d) if found.fit.d else found.data.value
    yield "correlation", "Correlation", caption, correlation_figure(x)
    if found.table is not None and found.table.bic.size > 1:
        caption = (
            "Criteria over the order: AIC and BIC above their smallest value (squares), and the thesis's all-lag "
            f"whiteness measure WT, which is {WT_WHITE} on average for white noise. The chosen order carries a cross."
        )
        yield "orders", "Order", caption, order_figure(found)
    verdict = "white" if found.tests.is_white else "not white"
    caption = (
        f"Residuals of the model: {verdict} (Ljung-Box p = {found.tests.ljung_box_p:.2g}, periodogram p = "
        f"{found.tests.periodogram_p:.2g})."
    )
    yield "residuals", "Residuals", caption, residual_figure(found, unit)
    caption = "The same of the residuals, which have none where the model is right."
    yield "residual_correlation", "Correlation of the residuals", caption, correlation_figure(found.fit.residuals)
    if found.fit.model.p + found.fit.model.q:
        caption = "Poles (crosses) and zeros (circles) with their ranges of two standard deviations."
        yield "poles", "Poles and zeros", caption, pole_figure(found)
    caption = "Allan deviation of the whole record (band: one standard deviation) and of the model."
    yield "allan", "Allan deviation", caption, allan_figure(found, unit)


def _series_caption(found: Identification) -> str:
    data = found.data
    text = f"{data.whole.size} samples at {data.rate_hz:.6g} Hz"
    return text + (
        f"; the model is fitted to the {data.value.size} shaded ones." if data.value.size < data.whole.size else "."
    )


def _labelled(quantity: str, unit: str) -> str:
    return f"{quantity} [{unit}]" if unit else quantity


def _times(found: Identification, count: int, first: int) -> tuple[Array, str]:
    """Times of so many samples, of which the one of number `first` is the first that was taken, and what they are."""
    span_s, (zero, since) = count / found.data.rate_hz, utc.axis_from(found.data.begin_s)
    name, factor = ("h", 1 / 3600) if span_s > 3 * 3600 else ("min", 1 / 60) if span_s > 1200 else ("s", 1.0)
    time_s = found.data.begin_s - zero + (np.arange(count) - first) / found.data.rate_hz
    return time_s * factor, f"time{since} [{name}]"


def series_figure(found: Identification, unit: str) -> Figure:
    """The record over time, the fitted part shaded."""
    data, shown = found.data, found.data.value.size + found.data.seasonal_lag
    first = (data.whole.size - shown) // 2
    time, label = _times(found, data.whole.size, first)
    fitted = (Mark(time[first], time[first + shown - 1], "fitted", "", GREY),) if shown < data.whole.size else ()
    panel = Panel(_labelled(data.name, unit), (Line(time, data.whole, "", SAMPLE, width=0.7),))
    return draw(Stack((panel,), 1.5, fitted, label))


def spectrum_figure(found: Identification, unit: str) -> Figure:
    """Sample spectrum, averaged in bands that widen with frequency, and the model's."""
    data, fit = found.data, found.fit
    x, rate = bridged(data.value), data.rate_hz
    freq, power = _spectrum(x, rate)
    grid = np.geomspace(freq[0], 0.5 * rate, 600)
    model = Line(grid, fit.model.spectrum(grid, rate), _order_text(found), MODEL, width=1.5)
    label = _labelled("density", f"{_squared(unit)}/Hz" if unit else "1/Hz")
    panel = Panel(label, (Line(freq, power, "samples", SAMPLE, width=0.8), model), log=True)
    return draw(Stack((panel,), 2.3, x_label="frequency [Hz]", log_x=True))


def _squared(unit: str) -> str:
    return f"({unit})²" if "/" in unit else f"{unit}²"


def _spectrum(x: Array, rate: float) -> tuple[Array, Array]:
    """Welch's estimate from long segments at low and short ones at high frequencies, so that both ends are smooth."""
    freqs, top = [], 0.5 * rate
    for share in (4, 32, 256):
        size = max(x.size // share, 64)
        f, p = welch(x, rate, nperseg=min(size, x.size), detrend="constant")
        low = 1.5 * f[1]
        freqs.append((f, p, low))
        if size == 64:
            break
    edges = [low for _, _, low in freqs[1:]]
    out_f, out_p = [], []
    for k, (f, p, low) in enumerate(freqs):
        high = 8.0 * edges[k] if k < len(edges) else top * 1.01
        below = 8.0 * edges[k - 1] if k else low
        keep = (f >= below) & (f < high)
        out_f.append(f[keep])
        out_p.append(p[keep])
    powers = np.concatenate(out_p)
    freq = np.concatenate(out_f)
    # The band at half the rate is half as wide as the others and scatters more.
    return freq[freq < 0.4999 * rate], np.maximum(powers[freq < 0.4999 * rate], 1e-300)


def _order_text(found: Identification) -> str:
    fit = found.fit
    return f"ARIMA({fit.p},{fit.d},{fit.q})" if fit.d else f"ARMA({fit.p},{fit.q})"


def correlation_figure(x: Array) -> Figure:
    """Autocorrelation and partial autocorrelation."""
    lags = min(LAGS, x.size // 4)
    limit = 1.959964 / math.sqrt(np.isfinite(x).sum())
    white, panels = Level(-limit, limit, "95 % of white noise"), []
    for r, name in ((acf(x, lags), "auto-\ncorrelation"), (pacf(bridged(x), lags), "partial auto-\ncorrelation")):
        low, high = float(r[1:].min()), float(r[1:].max())
        top = max(float(np.abs(r[1:]).max()), 2.0 * limit) * 1.1
        limits = min(1.1 * low, -1.5 * limit), top if high > 0.3 * top else max(1.1 * high, 1.5 * limit)
        lines = stems(np.arange(1.0, lags + 1.0), np.zeros(lags), r[1:], SAMPLE, 1.3)
        panels.append(Panel(name, (lines,), limits, lines_at=(0.0,), level=white))
    return draw(Stack(tuple(panels), 1.3, x_label="lag [samples]"))


def order_figure(found: Identification) -> Figure:
    """AIC, BIC and WT over (p, q)."""
    table = found.table
    assert table is not None
    figure = Figure(figsize=(WIDTH_IN, 2.6), layout="constrained")
    axes = figure.subplots(1, 3, sharey=True)
    for ax, values, name in zip(axes, (table.aic, table.bic, table.whiteness), ("AIC", "BIC", "WT"), strict=True):
        above = name != "WT"
        shown = np.log10(1.0 + values - values.min()) if above else np.minimum(values, 8.0)
        image = ax.imshow(shown, origin="lower", cmap="viridis_r" if above else "viridis", aspect="equal")
        if not above:
            image.set_clim(0.0, max(4.0, float(shown.max())))
        ax.grid(False)
        best = np.unravel_index(int(np.argmin(values) if above else np.argmax(values)), values.shape)
        hollow: dict[str, Any] = {"markerfacecolor": "none", "markersize": 9}
        for width, hue in ((3.0, "white"), (1.2, "black")):
            ax.plot(best[1], best[0], "s", markeredgecolor=hue, markeredgewidth=width, **hollow)
        for width, hue in ((3.0, "white"), (1.3, "black")):
            ax.plot(table.best[1], table.best[0], "x", color=hue, markersize=7, markeredgewidth=width)
        ax.set_xlabel("q")
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        ax.yaxis.set_major_locator(MaxNLocator(integer=True))
        bar = figure.colorbar(image, ax=ax, shrink=0.62, pad=0.03)
        bar.outline.set_linewidth(0.4)
        if above:
            ticks = [t for t in range(7) if t <= shown.max()]
            bar.set_ticks(ticks, labels=[f"$10^{t}$" if t else "0" for t in ticks])
        ax.set_title(f"{name} above best" if above else "WT (white: 3.86)")
    axes[0].set_ylabel("p")
    return figure


def residual_figure(found: Identification, unit: str) -> Figure:
    """Residuals over time, and where 95 % of them should lie."""
    e, limits = found.fit.residuals, (-1.96 * found.fit.sd, 1.96 * found.fit.sd)
    time, label = _times(found, e.size, -found.fit.d - found.data.seasonal_lag)
    panel = Panel(_labelled("residual", unit), (Line(time, e, "", SAMPLE, width=0.6),), lines_at=limits)
    return draw(Stack((panel,), 1.5, x_label=label))


def pole_figure(found: Identification) -> Figure:
    """Unit circle with poles and zeros, and its surroundings of 1."""
    model, fit = found.fit.model, found.fit
    reach = _zoom(model.poles, model.zeros)
    figure = Figure(figsize=(WIDTH_IN, 3.2), layout="constrained")
    axes = list(figure.subplots(1, 2 if reach else 1, squeeze=False)[0])
    spreads = [
        (
            model.poles,
            [root_sd(fit.ar, fit.covariance[: fit.p, : fit.p], r) if abs(r - 1.0) > 1e-9 else 0.0 for r in model.poles],
            "x",
            MODEL,
        ),
        (model.zeros, [root_sd(fit.ma, fit.covariance[fit.p :, fit.p :], r) for r in model.zeros], "o", SAMPLE),
    ]
    for ax in axes:
        ax.add_patch(Ellipse((0, 0), 2, 2, facecolor="none", edgecolor="black", linewidth=0.8))
        for roots, sds, mark, hue in (spread for spread in spreads if spread[0].size):
            for root, sd in zip(roots, sds, strict=True):
                if sd < 0.5 and root.imag:
                    ax.add_patch(
                        Ellipse((root.real, root.imag), 4.0 * sd, 4.0 * sd, facecolor=hue, alpha=0.25, linewidth=0.0)
                    )
                elif sd < 0.5:
                    ends = [root.real - 2.0 * sd, root.real + 2.0 * sd]
                    ax.plot(ends, [0.0, 0.0], color=hue, alpha=0.35, linewidth=5.0, solid_capstyle="butt")
            label = "poles" if mark == "x" else "zeros"
            hollow: dict[str, Any] = {"markerfacecolor": "none", "markersize": 7, "markeredgewidth": 1.4}
            ax.plot(roots.real, roots.imag, mark, color=hue, label=label, linestyle="", **hollow)
        ax.set_aspect("equal")
        ax.set_xlabel("real part")
    axes[0].set_xlim(-1.15, 1.15)
    axes[0].set_ylim(-1.15, 1.15)
    axes[0].set_ylabel("imaginary part")
    if reach:
        axes[1].set_xlim(1.0 - 1.7 * reach, 1.0 + 0.3 * reach)
        axes[1].set_ylim(-reach, reach)
        axes[1].xaxis.set_major_locator(MaxNLocator(4))
    axes[-1].legend(loc="best")
    return figure


def _zoom(poles: Complex, zeros: Complex) -> float:
    """Half width of the window about 1 that holds the roots within 0.2 of it; 0 when there is none."""
    roots = np.r_[poles, zeros]
    close = np.abs(roots[np.abs(roots - 1.0) < 0.2] - 1.0)
    return float(np.clip(1.2 * close.max(), 0.005, 0.25)) if close.size else 0.0


def allan_figure(found: Identification, unit: str) -> Figure:
    """Allan deviation of record and model."""
    tau, deviation = found.allan_tau_s, found.allan
    # Relative spread of an overlapping estimate from N/m independent averages.
    spread = 1.0 / np.sqrt(2.0 * np.maximum(tau[-1] * 3.0 / tau - 1.0, 0.5))
    parts: list[Part] = [
        Band(tau, deviation / (1.0 + spread), deviation * (1.0 + spread), "", SAMPLE, 0.2),
        Line(tau, deviation, "record", SAMPLE),
    ]
    if np.isfinite(found.allan_model).any():
        parts.append(Line(tau, found.allan_model, _order_text(found), MODEL, (0, (5, 1.5)), 1.5))
    rounding, low = found.data.step / math.sqrt(12.0), float(deviation[deviation > 0.0].min())
    if rounding > 0.5 * low:
        level = np.full(tau.size, rounding)
        parts.append(Line(tau, level, "quantisation of one sample", GREY, (0, (1, 1.5)), 0.8))
    low = float(np.nanmin(np.r_[found.allan_model, low]))
    limits = 0.5 * low, 2.0 * float(np.nanmax(np.r_[found.allan_model, deviation]))
    panel = Panel(_labelled("Allan deviation", unit), tuple(parts), limits, log=True)
    return draw(Stack((panel,), 2.3, x_label="averaging time [s]", log_x=True))
