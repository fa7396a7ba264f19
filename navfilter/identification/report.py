"""What an identification leaves behind: a table for the terminal, identify.json, the figures and one HTML page."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from navfilter.foundation.quoting import json_value
from navfilter.identification.figures import identification_figures
from navfilter.identification.identify import Identification
from navfilter.io import units
from navfilter.io.vehicle_toml import error_text
from navfilter.io.write import write_json, write_text
from navfilter.models.error_models import ErrorModel, Sum
from navfilter.models.interpretation import number
from navfilter.rendering.drawing import style, svg
from navfilter.rendering.page import figure_html, heading_html, list_html, page, table_html
from navfilter.timeseries.roots import root_sd


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
