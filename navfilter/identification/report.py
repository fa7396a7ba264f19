"""What an identification leaves behind: a table for the terminal, identify.json, the figures and one HTML page.

The figures of an identification: series, spectra, correlations, order surfaces, residuals, poles and zeros, Allan
deviation.

The page of a noise sheet: tables, Allan deviations with error bars, spectra, and what of the record is at rest.
"""

import dataclasses
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator
from scipy.signal import welch

from navfilter.foundation import utc
from navfilter.foundation.arrays import Array, ArrayLike, Complex
from navfilter.foundation.quoting import json_value
from navfilter.identification.conditioning import bridged
from navfilter.identification.identify import Identification
from navfilter.identification.noise_sheet import AxisSheet, NoiseSheet
from navfilter.identification.noise_sheet_text import allan_rows, drive_toml, groups, rows, sheet_dict
from navfilter.io import units
from navfilter.io.inertial import ImuRecord
from navfilter.io.vehicle_toml import error_text
from navfilter.io.write import write_json, write_text
from navfilter.models.error_models import ErrorModel, Sum
from navfilter.models.interpretation import number
from navfilter.rendering.drawing import COLOURS, WIDTH_IN, draw, style, svg
from navfilter.rendering.page import escape, figure_html, heading_html, list_html, page, table_html
from navfilter.rendering.panels import Band, Level, Line, Mark, Panel, Part, Points, Stack, stems
from navfilter.timeseries.diagnostics import WT_WHITE, acf, pacf
from navfilter.timeseries.roots import root_sd

#: How the axes are told apart.
_HUES = COLOURS[1], COLOURS[5], COLOURS[2]
_MARKS: tuple[Literal["o", "x", "D"], ...] = ("o", "x", "D")
#: Two-sided density to the units in which gyros and accelerometers are drawn.
_GYRO, _ACCEL = 3600.0 * 180.0 / math.pi, 1e6 / 9.80665


def write_sheet(sheet: NoiseSheet, record: ImuRecord, folder: Path) -> list[Path]:
    """Write identify.json, drive.toml, the figures and identify.html.

    Parameters
    ----------
    sheet : NoiseSheet
    record : ImuRecord
        That it was made from.
    folder : Path
        Must exist; files of the same name are replaced.
    """
    body = [f"<p><b>{escape(sheet.verdict)}</b></p>"]
    for axes in groups(sheet):
        header = ["", *(axis.name.replace("_", " ") for axis in axes)]
        body.append(table_html(header, [*rows(axes), *allan_rows(axes)]))
    body += [
        heading_html("vehicle.toml"),
        f'<div class="wide"><pre>{escape(drive_toml(sheet))}</pre></div>',
        list_html(sheet.remarks),
    ]
    data = write_json(sheet_dict(sheet), folder / "identify.json")
    (folder / "drive.toml").write_text(drive_toml(sheet), encoding="utf-8")
    with style():
        subtitle = f"inertial unit, {sheet.rate_hz:.6g} Hz, {sheet.duration_s:.0f} s"
        figures = write_page(folder, f"Noise sheet of {sheet.source}", subtitle, body, _figures(sheet, record))
    return [data, folder / "drive.toml", *figures]


def _figures(sheet: NoiseSheet, record: ImuRecord) -> Iterator[tuple[str, str, str, Figure]]:
    for axes in groups(sheet):
        stem, name = ("gyro", "gyros") if axes[0].is_gyro else ("accel", "accelerometers")
        caption = (
            "Overlapping Allan deviation with error bars of one standard deviation (equivalent degrees of freedom of "
            "the fitted noise), and the terms of the sheet as a line."
        )
        yield f"allan_{stem}", f"Allan deviation of the {name}", caption, _allan_figure(axes)
        caption = (
            "Root spectral density in bands of the cosine transform (two-sided, as density in vehicle.toml; lines left "
            "out), the terms of the sheet as a line, those of the drive dashed. Each axis is drawn three times "
            "lower than the one before."
        )
        yield f"spectrum_{stem}", f"Spectrum of the {name}", caption, _spectrum_figure(axes, 1.0 / sheet.rate_hz)
    caption = "The record as means over a second, less its median. What is shaded is at rest and was used."
    yield "record", "Record", caption, _record_figure(sheet, record)


def _scale(axes: Sequence[AxisSheet]) -> tuple[float, str]:
    return (_GYRO, "deg/h") if axes[0].is_gyro else (_ACCEL, "ug")


def _allan_figure(axes: Sequence[AxisSheet]) -> Figure:
    factor, unit = _scale(axes)
    parts: list[Part] = []
    for axis, hue, mark in zip(axes, _HUES, _MARKS, strict=False):
        curve = axis.allan
        parts.append(Points(curve.tau_s, factor * curve.deviation, axis.name.replace("_", " "), hue, mark))
        parts.append(stems(curve.tau_s, factor * curve.low, factor * curve.high, hue, 0.8))
        parts.append(Line(curve.tau_s, factor * curve.model, "", hue, width=1.0))
    panel = Panel(f"Allan deviation [{unit}]", tuple(parts), log=True)
    return draw(Stack((panel,), 2.7, x_label="averaging time [s]", log_x=True))


def _spectrum_figure(axes: Sequence[AxisSheet], period_s: float) -> Figure:
    factor, unit = _scale(axes)
    parts: list[Part] = []
    for k, axis in enumerate(axes):
        size, hue, bands = factor / 3.0**k, _HUES[k], axis.bands
        middle = np.sqrt(bands.low * bands.high)
        label = axis.name.replace("_", " ") + ("" if k == 0 else f" / {3**k}")
        parts.append(Points(middle, size * np.sqrt(bands.power), label, hue, "o"))
        grid = np.geomspace(middle.min(), axis.sheet.highest_hz, 300)
        parts.append(Line(grid, size * np.sqrt(axis.sheet.density(grid, period_s)), "", hue, width=1.0))
        parts.append(Line(grid, size * np.sqrt(axis.drive.density(grid, period_s)), "", hue, "--", 0.8))
    panel = Panel(f"root density [{unit}/sqrt(Hz)]", tuple(parts), log=True)
    return draw(Stack((panel,), 3.0, x_label="frequency [Hz]", log_x=True))


def _record_figure(sheet: NoiseSheet, record: ImuRecord) -> Figure:
    length, panels = max(round(record.rate_hz), 1), []
    blocks = len(record.value) // length
    time: Array = (np.arange(blocks, dtype=np.float64) + 0.5) * length / record.rate_hz
    for axes in groups(sheet):
        factor, unit = _scale(axes)
        parts: list[Part] = []
        for axis, hue in zip(axes, _HUES, strict=False):
            x = record.value[: blocks * length, record.names.index(axis.name)].reshape(blocks, length)
            known = np.isfinite(x)
            mean = np.where(known, x, 0.0).sum(axis=1) / np.where(known.any(axis=1), known.sum(axis=1), np.nan)
            shown = np.asarray(factor * (mean - np.nanmedian(mean)), dtype=np.float64)
            parts.append(Line(time, shown, axis.name.replace("_", " "), hue, width=0.7))
        panels.append(Panel(f"{axes[0].name.split('_')[0]} [{unit}]", tuple(parts)))
    rest = tuple(Mark(begin, end, "at rest", "", "#999999") for begin, end in sheet.stretches_s)
    return draw(Stack(tuple(panels), 1.8, rest, "time [s]"))


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


def write_identification(found: Identification, folder: Path, unit: str = "") -> list[Path]:
    """Write identify.json, one .svg per figure and identify.html.

    Parameters
    ----------
    found : Identification
    folder : Path
        Must exist; files of the same name are replaced.
    unit : str
        Unit of the series.

    Returns
    -------
    list of Path
    """
    body = [table_html(["", ""], _summary(found, unit), text_columns=(1,))]
    if found.remarks:
        body.append(list_html(found.remarks))
    title, drawn = f"{found.data.name}: {found.reading.text}", identification_figures(found, unit)
    with style():
        figures = write_page(folder, title, found.data.source, body, drawn)
    return [write_json(as_dict(found, unit), folder / "identify.json"), *figures]


def write_page(
    folder: Path, title: str, subtitle: str, body: list[str], figures: Iterable[tuple[str, str, str, Figure]]
) -> list[Path]:
    """Write each figure as .svg, and identify.html with all of them inside; stem, heading, caption and figure of
    each.
    """
    written = []
    for stem, heading, caption, figure in figures:
        written.append(folder / f"{stem}.svg")
        drawn = svg(figure)
        written[-1].write_bytes(drawn)
        body += [heading_html(heading), figure_html(drawn, caption)]
    return [write_text(page(title, title, subtitle, body), folder / "identify.html"), *written]


def summary_text(found: Identification, unit: str = "") -> str:
    """Table for the terminal."""
    width = max(len(name) for name, _ in _summary(found, unit))
    lines = [f"{name:{width}}  {value}" for name, value in _summary(found, unit)]
    return "\n".join(lines + [f"note: {remark}" for remark in found.remarks])


def _summary(found: Identification, unit: str) -> list[list[str]]:
    data, fit, tests = found.data, found.fit, found.tests
    u = f" {unit}" if unit else ""
    sds, length_s = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0)), data.value.size / data.rate_hz
    rows = [
        ["reading", found.reading.text],
        ["sizes", found.reading.details],
        ["samples", f"{fit.n} at {data.rate_hz:.6g} Hz ({length_s:.6g} s), level {number(_level(found))}{u}"],
        ["order", _order(found)],
        ["ar", _coefficients(fit.ar, sds[: fit.p])],
        ["ma", _coefficients(fit.ma, sds[fit.p :])],
        ["innovation sd", f"{number(fit.sd)}{u}"],
        ["poles", _roots(fit.model.poles)],
        ["zeros", _roots(fit.model.zeros)],
        [
            "residuals",
            f"{'white' if tests.is_white else 'NOT white'}: Ljung-Box({tests.lags}) p = {tests.ljung_box_p:.2g}, "
            "cumulative periodogram "
            f"p = {tests.periodogram_p:.2g}, WT = {tests.wt:.2f} (white noise scores {tests.wt_white:.3f})",
        ],
    ]
    against = "" if np.isnan(data.value).any() else ", ln L {:+.1f} against it"
    for process in found.gauss_markov:
        size = f"sd {number(process.sd)}{u}, 1/e time {number(process.tau_s)} s"
        rows.append([f"Gauss-Markov {process.order}", size + against.format(process.loglik - fit.loglik)])
    rows.append(["Allan deviation", _allan(found, u)])
    if data.step > 0.0:
        rounding = number(data.step / math.sqrt(12.0))
        rows.append(["quantisation", f"step {number(data.step)}{u}, rounding noise {rounding}{u}"])
    toml, python = error_lines(found.reading.error, unit)
    rows += [["vehicle.toml", toml], ["Python", python]]
    return [row for row in rows if row[1]]


def _order(found: Identification) -> str:
    fit, table = found.fit, found.table
    text = f"({fit.p},{fit.d},{fit.q})"
    if table is None:
        return text + ", as given"
    if table.bic.size == 1:
        return text
    aic = np.unravel_index(int(np.argmin(table.aic)), table.aic.shape)
    bic = np.unravel_index(int(np.argmin(table.bic)), table.bic.shape)
    return f"{text} of {table.bic.size} compared; least AIC at ({aic[0]},{aic[1]}), least BIC at ({bic[0]},{bic[1]})"


def _coefficients(values: ArrayLike, sds: ArrayLike) -> str:
    return "  ".join(f"{value:.5f} +- {sd:.2g}" for value, sd in zip(np.asarray(values), np.asarray(sds), strict=True))


def _roots(roots: ArrayLike) -> str:
    upper = [r for r in np.asarray(roots) if r.imag >= 0.0]
    return "  ".join(
        f"{r.real:.5f}" if r.imag == 0.0 else f"{abs(r):.5f} at +-{np.degrees(np.angle(r)):.2f} deg" for r in upper
    )


def _allan(found: Identification, u: str) -> str:
    tau, deviation = found.allan_tau_s, found.allan
    # The longest averages rest on two or three independent ones.
    lowest = int(np.argmin(np.where(tau <= tau[-1] / 3.0, deviation, np.inf)))
    shown = [
        f"{number(float(np.interp(t, tau, deviation)), 3)}{u} at {t:g} s"
        for t in (1.0, 10.0, 100.0)
        if tau[0] <= t <= tau[-1]
    ]
    least = f"least {number(float(deviation[lowest]), 3)}{u} at {number(float(tau[lowest]), 2)} s"
    return ", ".join([*shown, least])


def _level(found: Identification) -> float:
    """Mean of the series (of its middle, with a trend); with differences the constant has no such meaning."""
    if found.fit.d or found.data.seasonal_lag or not found.fit.trend.size:
        return float(np.nanmean(found.data.value))
    return float(found.fit.trend[0])


# --- the suggested error model --------------------------------------------------------------------------------------


def error_lines(error: ErrorModel, unit: str = "") -> tuple[str, str]:
    """The model as a line of vehicle.toml and as Python, in SI and radians.

    Parameters
    ----------
    error : ErrorModel
        In the unit of the series.
    unit : str
        As in `navfilter.io.units`.

    Raises
    ------
    ValueError
        For an unknown unit.

    Examples
    --------
    >>> from navfilter.models.error_models import White
    >>> error_lines(White(sd=180.0), "mm")
    ('error = {model = "white", sd = 0.18}', 'error=nf.White(sd=0.18)')
    """
    scaled = _scaled(error, units.unit(unit).factor)
    python = " + ".join(f"nf.{part!r}" for part in scaled.terms)
    return f"error = {error_text(scaled, ())}", f"error={python}"


def _scaled(error: ErrorModel, factor: float) -> ErrorModel:
    if isinstance(error, Sum):
        return Sum(tuple(_scaled(part, factor) for part in error.parts))
    own: Any = error
    sizes = {f.name: getattr(own, f.name) for f in dataclasses.fields(own) if f.name in ("sd", "density", "start_sd")}
    changed = {name: float(f"{value * factor:.6g}") for name, value in sizes.items() if value is not None}
    return dataclasses.replace(error, **changed)  # type: ignore[type-var]


# --- JSON -----------------------------------------------------------------------------------------------------------


def as_dict(found: Identification, unit: str = "") -> dict[str, Any]:
    """Everything as plain numbers, lists and text; None where a number does not exist."""
    data, fit, table = found.data, found.fit, found.table
    poles, zeros = fit.model.poles, fit.model.zeros
    toml, python = error_lines(found.reading.error, unit)
    criteria: dict[str, Any] = {}
    if table is not None:
        criteria = {name: getattr(table, name) for name in ("loglik", "aic", "aicc", "bic", "hq", "sd")}
        criteria |= {"wt": table.whiteness, "is_white": table.is_white}
    result = {
        "name": data.name,
        "source": data.source,
        "unit": unit,
        "n": fit.n,
        "period_s": 1.0 / data.rate_hz,
        "begin_s": data.begin_s,
        "seasonal_lag": data.seasonal_lag,
        "level": _level(found),
        "criteria": criteria,
        "best": {"p": fit.p, "d": fit.d, "q": fit.q},
        "fit": {
            "ar": fit.ar,
            "ma": fit.ma,
            "sd": fit.sd,
            "covariance": fit.covariance,
            "poles": _pairs(poles),
            "poles_sd": [root_sd(fit.ar, fit.covariance[: fit.p, : fit.p], r) for r in ([] if fit.d else poles)],
            "zeros": _pairs(zeros),
            "zeros_sd": [root_sd(fit.ma, fit.covariance[fit.p :, fit.p :], r) for r in zeros],
            "loglik": fit.loglik,
            "trend": fit.trend,
            "flags": sorted(fit.flags),
        },
        "whiteness": dataclasses.asdict(found.tests),
        "reading": found.reading.text,
        "components": [dataclasses.asdict(part) for part in found.reading.components],
        "minimal_order": list(found.reading.minimal),
        "gauss_markov": [
            {"order": g.order, "sd": g.sd, "beta": g.beta, "tau_s": g.tau_s, "loglik": g.loglik}
            for g in found.gauss_markov
        ],
        "allan": {"tau_s": found.allan_tau_s, "deviation": found.allan, "model": found.allan_model},
        "quantisation": {"step": data.step, "sd": data.step / math.sqrt(12.0), "too_coarse": bool(data.step > fit.sd)},
        "error": {"toml": toml, "python": python},
        "remarks": list(found.remarks),
    }
    return {key: json_value(value) for key, value in result.items()}


def _pairs(roots: ArrayLike) -> list[list[float]]:
    return [[float(r.real), float(r.imag)] for r in np.asarray(roots)]
