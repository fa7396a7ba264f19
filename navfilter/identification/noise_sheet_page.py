"""The page of a noise sheet: tables, Allan deviations with error bars, spectra, and what of the record is at rest."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.figure import Figure

from navfilter.foundation.arrays import Array
from navfilter.identification.noise_sheet import AxisSheet, NoiseSheet
from navfilter.identification.noise_sheet_text import allan_rows, drive_toml, groups, rows, sheet_dict
from navfilter.identification.report import write_page
from navfilter.io.inertial import ImuRecord
from navfilter.io.write import write_json
from navfilter.rendering.drawing import COLOURS, draw, style
from navfilter.rendering.page import escape, heading_html, list_html, table_html
from navfilter.rendering.panels import Line, Mark, Panel, Part, Points, Stack, stems

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
