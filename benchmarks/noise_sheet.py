"""Noise sheets of inertial units: `simulated`: known noise, are the stated uncertainties honest; `recordings`: real
units at rest, against their data sheets. No other software gives uncertainties of all terms to compare with.
"""

from __future__ import annotations

import math
import sys
import time
from typing import Any

import numpy as np
from harness import ROOT, Options, Table, data_root, flag, main, quick

sys.path.insert(0, str(ROOT / "tests"))
from inertial_noise import noise

from navfilter.foundation.constants import STANDARD_GRAVITY
from navfilter.identification.noise_sheet import AxisSheet, noise_sheet
from navfilter.io.inertial import ImuColumns, ImuRecord, read_imu
from navfilter.io.table import TableOptions

DEG, MICRO_G = math.pi / 180.0, 1e-6 * STANDARD_GRAVITY
RATE_HZ = 50.0
#: N [deg/sqrt(h)], B [deg/h], K [deg/h/sqrt(h)], Q [arcsec] of the gyros; N [ug/sqrt(Hz)], B [ug], K [ug/sqrt(h)] of
#: the accelerometers.
TRUE = {
    "gyro_x": (0.3, 3.0, 0.0, 0.0),
    "gyro_y": (0.1, 0.0, 5.0, 1.0),
    "gyro_z": (0.5, 10.0, 20.0, 0.0),
    "accel_x": (100.0, 30.0, 0.0, 0.0),
    "accel_y": (60.0, 0.0, 300.0, 0.0),
    "accel_z": (300.0, 80.0, 900.0, 0.0),
}
TERMS = ("white", "flicker", "walk", "quantisation")


def true_sizes(name: str) -> tuple[float, ...]:
    """N, B, K and Q in SI."""
    n, b, k, q = TRUE[name]
    if name.startswith("gyro"):
        return n * DEG / 60.0, b * DEG / 3600.0, k * DEG / 3600.0 / 60.0, q * DEG / 3600.0
    return n * MICRO_G, b * MICRO_G, k * MICRO_G / 60.0, q


def simulated(options: Options) -> list[dict[str, Any]]:
    """Simulated units at rest for two hours: errors of the sheet in units of its standard deviations.

    A term that does not show counts by its upper limit: the share of records in which the truth lies below it.
    """
    scores: dict[tuple[str, str], list[float]] = {}
    limits: dict[tuple[str, str], list[bool]] = {}
    n = round(RATE_HZ * (600.0 if options.quick else 7200.0))
    began = time.process_time()
    for seed in range(2 if options.quick else options.seeds):
        columns = [noise(n, [seed, i], RATE_HZ, *true_sizes(name)) for i, name in enumerate(TRUE)]
        columns[0] += 1e-4
        columns[5] -= STANDARD_GRAVITY
        record = ImuRecord(f"simulated {seed}", RATE_HZ, 0.0, tuple(TRUE), np.column_stack(columns), ())
        for axis in noise_sheet(record).axes:
            for term, true in zip(TERMS, true_sizes(axis.name), strict=True):
                gather(
                    axis, term, true, scores.setdefault((axis.name, term), []), limits.setdefault((axis.name, term), [])
                )
    table = Table("axis<8 term<13 shown>6d false>6d mean>6.2f sd>6.2f limits>7d held>6.2f")
    for (name, term), found in scores.items():
        held = limits[name, term]
        if found or held:
            known = np.array([score for score in found if math.isfinite(score)])
            row = {"axis": name, "term": term, "shown": known.size, "false": len(found) - known.size}
            row |= {"limits": len(held)}
            mean, sd = (float(known.mean()), float(known.std())) if known.size else (math.nan, math.nan)
            table.add(row | {"mean": mean, "sd": sd, "held": float(np.mean(held)) if held else math.nan})
    print(f"processor time {time.process_time() - began:.0f} s")
    return table.rows


def gather(axis: AxisSheet, term: str, true: float, scores: list[float], limits: list[bool]) -> None:
    """The score of a term that shows, or whether its upper limit holds; false terms count as a score of infinity."""
    if term == "quantisation":
        if not math.isnan(axis.quantisation):
            scores.append((axis.quantisation - true) / axis.quantisation_sd if true else math.inf)
        return
    found = axis.sheet.term(term)
    if found is not None:
        scores.append((found.size - true) / found.sd if true else math.inf)
    elif true:
        limits.append(axis.limits[term] >= true)


#: Recording -> file, columns, layout.
RECORDINGS: dict[str, tuple[str, ImuColumns, TableOptions]] = {
    f"ADIS16405 unit {k}": (
        f"imu-adis16405-static/adis16405_unit{k}.npz",
        ImuColumns(("0", "1", "2"), ("3", "4", "5"), "0.05 deg/s", "0.00333 g", rate_hz=100.0),
        TableOptions(table="counts"),
    )
    for k in (1, 2, 3, 4)
}
RECORDINGS["MPU-6050"] = (
    "imu-mpu6050-raw-static/mpu6050_static_450s.csv.xz",
    ImuColumns(gyro_unit="0.00763358779 deg/s", accel_unit="6.103515625e-5 g", rate_hz=100.0),
    TableOptions(skip_lines=4),
)
RECORDINGS["MPU-6050, another"] = (
    "imu-mag-mpu6050-hmc5883l-static/unmoved_10min_mpu6050_gyroscope.mat",
    ImuColumns(("1", "2", "3"), gyro_unit="deg/s", time_column="0"),
    TableOptions(),
)
RECORDINGS["Xsens DOT 2"] = (
    "imu-xsens-dot-static/x_stat_2.csv.xz",
    ImuColumns(gyro_unit="deg/s", time_column="0"),
    TableOptions(),
)
RECORDINGS["Memsense 3025"] = (
    "gyro-memsense-3025-static/memsense_test_real.npy",
    ImuColumns(("0", "1", "2"), gyro_unit="deg/s", rate_hz=250.0),
    TableOptions(table="[0]", transpose=True),
)


def recordings(options: Options) -> list[dict[str, Any]]:
    """Real units at rest: random walks, bias instability (flicker) and the lowest point of the Allan deviation.

    Gyros in deg/sqrt(h) and deg/h, accelerometers in ug/sqrt(Hz) and ug.
    """
    columns = "recording<18 axis<8 share>6.3f white>8.4g white_sd>8.2g flicker>8.3g flicker_sd>10.2g"
    table = Table(f"{columns} lowest>8.3g at_s>7.3g lines>6d")
    for name, (file, where, layout) in [*RECORDINGS.items()][: 1 if options.quick else None]:
        record = read_imu(data_root() / file, where, layout)
        sheet = noise_sheet(record.part(0.0, 600.0) if options.quick else record)
        for axis in sheet.axes:
            n, unit = (60.0 / DEG, 3600.0 / DEG) if axis.is_gyro else (1.0 / MICRO_G, 1.0 / MICRO_G)
            white, flicker, k = axis.sheet.terms[0], axis.sheet.term("flicker"), axis.allan.lowest
            row = {"recording": name, "axis": axis.name, "share": sheet.share, "lines": len(axis.lines)}
            row |= {"white": n * white.size, "white_sd": n * white.sd}
            row |= {"flicker": unit * flicker.size, "flicker_sd": unit * flicker.sd} if flicker else {}
            table.add(row | {"lowest": unit * axis.allan.deviation[k], "at_s": axis.allan.tau_s[k]})
    return table.rows


if __name__ == "__main__":
    seeds = flag("--seeds", type=int, default=25, help="simulated units (default: %(default)s)")
    short = quick("two units of ten minutes; one recording")
    main(__doc__, {simulated: [seeds, short], recordings: [short]})
