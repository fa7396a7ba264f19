"""The online estimator's coefficients along a recorded series, as a vehicle would have seen them."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from navfilter.foundation import utc
from navfilter.foundation.arrays import AnyArray, Array, Ints, Mask
from navfilter.identification.conditioning import Conditioned, condition
from navfilter.identification.report import write_page
from navfilter.io.inertial import Series
from navfilter.io.write import write_json
from navfilter.models.interpretation import number, read_model
from navfilter.rendering.drawing import COLOURS, DASHES, draw, style
from navfilter.rendering.page import table_text
from navfilter.rendering.panels import Band, Line, Panel, Part, Stack
from navfilter.timeseries.model import ArmaModel
from navfilter.timeseries.online.order_bank import ArmaBank
from navfilter.timeseries.online.recursive import RecursiveArma

#: Looks at the estimate per window.
LOOKS = 8
#: Colour and dashes of zeros and of the moving average.
_OTHER = COLOURS[1], DASHES[2]


@dataclass(frozen=True, eq=False)
class Tracks:
    """The estimate at every look.

    Attributes
    ----------
    data : Conditioned
        The samples.
    window : int
    is_bank : bool
        Whether the order was tracked too.
    time_s : ndarray, shape (k,)
    ar, ar_sd : ndarray, shape (k, p)
        Coefficients and their standard deviations; NaN beyond the order in use.
    ma, ma_sd : ndarray, shape (k, q)
    sd : ndarray, shape (k,)
        Innovation.
    pole, zero : ndarray, shape (k,)
        Largest radius of a pole and of a zero (0 without any).
    order : ndarray, shape (k, 2)
        Order in use, before a random-walk bias is split off.
    walk_sd : ndarray, shape (k,)
        Step of the random-walk bias that was split off; 0 for none.
    is_white : ndarray of bool, shape (k,)
    model : ArmaModel
        The last one.
    """

    data: Conditioned
    window: int
    is_bank: bool
    time_s: Array
    ar: Array
    ar_sd: Array
    ma: Array
    ma_sd: Array
    sd: Array
    pole: Array
    zero: Array
    order: Ints
    walk_sd: Array
    is_white: Mask
    model: ArmaModel


def track_online(
    series: Series,
    window: int,
    *,
    order: tuple[int, int] | None = None,
    difference: int = 0,
    progress: Callable[[int], Any] | None = None,
    **conditions: Any,
) -> Tracks:
    """Feed a series to the online estimator and look at it `LOOKS` times per window.

    Parameters
    ----------
    series : Series
    window : int
        Samples behind an estimate.
    order : (p, q), optional
        A single `RecursiveArma`; without it an `ArmaBank` chooses the order as it goes.
    difference : int
        Times to difference first.
    progress : callable, optional
        Told the number of samples done since the last call.
    **conditions
        Of `navfilter.identification.conditioning.condition`. By default the whole record is used, however long.

    Raises
    ------
    ValueError
        For a window longer than the record, and what the estimators refuse.
    """
    conditions.setdefault("max_samples", 2**62)
    data = condition(series, **conditions)
    x = np.diff(data.value, difference) if difference else data.value
    if window >= x.size:
        raise ValueError(
            f"the window of {window} samples is no shorter than the series ({x.size}). Take a shorter window."
        )
    hop = max(window // LOOKS, 1)
    # A differenced series has no mean worth carrying.
    estimator: ArmaBank | RecursiveArma
    if order is None:
        estimator = ArmaBank(window, hop=hop, mean=not difference)
    else:
        estimator = RecursiveArma(*order, window, hop=hop, mean=not difference)
    times, models, orders, walks, white = [], [], [], [], []
    for first in range(0, x.size, hop):
        part = x[first : first + hop]
        estimator.update_many(part)
        if progress is not None:
            progress(part.size)
        model = estimator.model
        if "starting" in model.flags:
            continue
        times.append(data.begin_s + (first + part.size + difference) / data.rate_hz)
        models.append(model)
        orders.append((estimator.order if isinstance(estimator, ArmaBank) else order) or (model.p, model.q))
        walks.append(estimator.walk_sd if isinstance(estimator, ArmaBank) else 0.0)
        white.append(estimator.is_white)
    if not models:
        raise ValueError(f"{x.size} samples did not suffice to start the estimator: too many are missing or equal.")
    return Tracks(
        data=data,
        window=window,
        is_bank=order is None,
        time_s=np.array(times),
        order=np.array(orders),
        walk_sd=np.array(walks),
        is_white=np.array(white),
        model=models[-1],
        **_columns(models),
    )


def _columns(models: list[ArmaModel]) -> dict[str, Array]:
    p, q = max(m.p for m in models), max(m.q for m in models)
    ar, ar_sd, ma, ma_sd = (np.full((len(models), width), np.nan) for width in (p, p, q, q))
    for k, m in enumerate(models):
        ar[k, : m.p], ma[k, : m.q] = m.ar, m.ma
        if m.covariance is not None:
            spread = np.sqrt(np.maximum(np.diag(m.covariance), 0.0))
            ar_sd[k, : m.p], ma_sd[k, : m.q] = spread[: m.p], spread[m.p :]
    radii = [np.array([np.abs(getattr(m, roots)).max(initial=0.0) for m in models]) for roots in ("poles", "zeros")]
    sd = np.array([m.sd for m in models])
    return {"ar": ar, "ar_sd": ar_sd, "ma": ma, "ma_sd": ma_sd, "sd": sd, "pole": radii[0], "zero": radii[1]}


def tracks_figure(tracks: Tracks, unit: str = "") -> Figure:
    """Coefficients with two standard deviations, innovation sd, largest radii and, from a bank, the order over time."""
    zero, since = utc.axis_from(float(tracks.time_s[0]))
    time, per = tracks.time_s - zero, f"\n[{unit}]" if unit else ""
    panels = []
    for name, value, sd in (("ar", tracks.ar, tracks.ar_sd), ("ma", tracks.ma, tracks.ma_sd)):
        parts: list[Part] = []
        for i, (one, width) in enumerate(zip(value.T, 2.0 * sd.T, strict=True)):
            hue = COLOURS[(i + 1) % len(COLOURS)]
            parts.append(Band(time, one - width, one + width, "", hue))
            parts.append(Line(time, one, f"{name}[{i}]", hue, DASHES[i % len(DASHES)]))
        panels += [Panel(name, tuple(parts))] * bool(parts)
    panels.append(Panel(f"innovation sd{per}", (Line(time, tracks.sd, "", COLOURS[1]),)))
    if len(panels) > 1:
        radii = Line(time, tracks.pole, "largest pole", COLOURS[5]), Line(time, tracks.zero, "largest zero", *_OTHER)
        panels.append(Panel("radius", radii, lines_at=(1.0,)))
    if np.any(tracks.walk_sd > 0.0):
        walk = tracks.walk_sd * math.sqrt(tracks.data.rate_hz)
        panels.append(Panel(f"bias walk\n[{unit or 1}/sqrt(s)]", (Line(time, walk, "", COLOURS[2]),)))
    if tracks.is_bank:
        p, q = tracks.order.T.astype(np.float64)
        orders = Line(time, p, "p", COLOURS[5], steps=True), Line(time, q, "q", *_OTHER, steps=True)
        panels.append(Panel("order", orders, limits=(-0.4, max(float(tracks.order.max()), 1.0) + 0.4)))
    return draw(Stack(tuple(panels), 1.45, x_label=f"time{since} [s]"))


def tracks_text(tracks: Tracks, unit: str = "") -> str:
    """Table for the terminal: a dozen looks, and the last model in words."""
    shown = np.unique(np.linspace(0, tracks.time_s.size - 1, 12).astype(int))
    per = f"{unit}/sqrt(s)" if unit else "1/sqrt(s)"
    sd = f"sd [{unit}]" if unit else "sd"
    header = ["time [s]", "order", "ar", "ma", sd, "largest pole", f"bias walk [{per}]", "white"]
    rows = []
    for k in shown:
        ar, ma = (
            " ".join(f"{c:.4f}" for c in values[np.isfinite(values)]) or "-" for values in (tracks.ar[k], tracks.ma[k])
        )
        walk = number(tracks.walk_sd[k] * math.sqrt(tracks.data.rate_hz), 3) if tracks.walk_sd[k] > 0.0 else "-"
        order, verdict = f"({tracks.order[k, 0]},{tracks.order[k, 1]})", "yes" if tracks.is_white[k] else "no"
        rows.append(
            [f"{tracks.time_s[k]:.1f}", order, ar, ma, number(tracks.sd[k]), f"{tracks.pole[k]:.4f}", walk, verdict]
        )
    if not tracks.walk_sd.any():
        header, rows = header[:6] + header[7:], [row[:6] + row[7:] for row in rows]
    return "\n".join([table_text(header, rows), "", f"last model: {_last_reading(tracks)}"])


def _last_reading(tracks: Tracks) -> str:
    model = tracks.model
    n = int(model.effective_window or tracks.window)
    text = read_model(model, tracks.data.rate_hz, n, "", bool(tracks.is_white[-1])).text
    if tracks.walk_sd[-1] > 0.0:
        parts, _, end = text.partition("; minimal order")
        more = end.partition(")")[2]
        text = f"random-walk bias + {parts}; minimal order ({tracks.order[-1, 0]},{tracks.order[-1, 1]}){more}"
    return text


def write_tracks(tracks: Tracks, folder: Path, unit: str = "") -> list[Path]:
    """Write identify.json, tracks.csv, tracks.svg and identify.html."""
    columns: dict[str, AnyArray] = {"time_s": tracks.time_s, "p": tracks.order[:, 0], "q": tracks.order[:, 1]}
    for name, value in (("ar", tracks.ar), ("ar_sd", tracks.ar_sd), ("ma", tracks.ma), ("ma_sd", tracks.ma_sd)):
        columns |= {f"{name}_{i + 1}": value[:, i] for i in range(value.shape[1])}
    columns |= {"sd": tracks.sd, "pole_radius": tracks.pole, "zero_radius": tracks.zero, "walk_sd": tracks.walk_sd}
    columns["is_white"] = tracks.is_white
    table = pd.DataFrame(columns).astype({"is_white": int})
    table.to_csv(folder / "tracks.csv", index=False, float_format="%.9g", lineterminator="\n")
    data, model = tracks.data, tracks.model
    result = {
        "name": data.name,
        "source": data.source,
        "unit": unit,
        "period_s": 1.0 / data.rate_hz,
        "window": tracks.window,
        "online": True,
        "tracks": columns,
        "last": {
            "ar": model.ar,
            "ma": model.ma,
            "sd": model.sd,
            "covariance": model.covariance,
            "flags": sorted(model.flags),
        },
        "reading": _last_reading(tracks),
        "remarks": list(data.notes),
    }
    write_json(result, folder / "identify.json")
    caption = (
        f"Online estimates over windows of {tracks.window} samples ({tracks.window / data.rate_hz:.6g} s), with "
        "two standard deviations."
    )
    with style():
        figures = [("tracks", "Coefficients over time", caption, tracks_figure(tracks, unit))]
        pages = write_page(folder, f"{data.name}: {_last_reading(tracks)}", data.source, [], figures)
    return [folder / "identify.json", folder / "tracks.csv", *pages]
