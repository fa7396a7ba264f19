"""Identify real sensors at rest and compare with what is known about them.

Needs the recordings: set NAVFILTER_DATA to their folder. Every row is one
`navfilter.identification.identify.identify` with its default choice of order; where a recording is known by the
coefficients of a fixed order, that order is fitted as well. The "expected" column is what the recordings' own
descriptions state, found with other software (statsmodels).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from harness import Array, Options, Table, data_root, flag, main, quick

import navfilter as nf
from navfilter.identification.identify import Identification, identify
from navfilter.io.geodesy import matrix_from_euler
from navfilter.io.inertial import Series, read_series
from navfilter.io.table import TableOptions
from navfilter.io.text_tables import read_table


@dataclass(frozen=True)
class Case:
    """One series, how to identify it, what is expected and whether it was found."""

    name: str
    load: Callable[[Path], Series]
    expected: str
    found: Callable[[Identification], bool] | None
    order: tuple[int, int] | None = None


# --- loading --------------------------------------------------------------------------------------------------------


def table(file: str, column: str | int, rate_hz: float, **layout: object) -> Callable[[Path], Series]:
    """A column of a table at a known rate."""
    return lambda root: read_series(root / file, str(column), rate_hz=rate_hz, options=TableOptions(**layout))


def gps(file: str) -> Callable[[Path], Series]:
    """North position, every tenth fix of the file, the first 1500, gaps ignored: as the expected figures were found."""

    def load(root: Path) -> Series:
        latitude, _ = read_table(root / "gps-sa-2000-static" / file).numbers(3)
        north = np.radians(latitude - latitude.mean()) * 6_371_000.0
        return Series("north", north[::10][:1500], 0.1, file)

    return load


def bme280(root: Path) -> Series:
    """Pressure about every 2 s; steps of up to 6 s are taken as one, as the expected figures were found."""
    import pandas as pd

    frame = pd.read_csv(root / "baro-static" / "bme280_temphumpress_0p5hz.csv", header=None, comment="#")
    stamp, pressure = frame.iloc[:, 0], pd.to_numeric(frame.iloc[:, 3], errors="coerce")
    keep = pressure.notna().to_numpy()
    return Series("pressure", pressure.to_numpy()[keep], 0.5, "bme280 " + str(stamp.iloc[-1]))


def compass_heading(root: Path) -> Series:
    """Heading of a level magnetometer, deg."""
    file = root / "imu-mag-mpu6050-hmc5883l-static" / "unmoved_10min_hmc5883l_compass.mat"
    columns = read_table(file)
    x, y = columns.numbers(1)[0], columns.numbers(2)[0]
    return Series("heading", np.degrees(np.unwrap(np.arctan2(-y, x))), 76.9, file.name)


def xsens_heading(root: Path) -> Series:
    """Fused heading of a wearable unit, its first (empty) row dropped."""
    psi, _ = read_table(root / "imu-xsens-dot-static" / "x_stat_2.csv.xz").numbers(3)
    psi = psi[1:]
    return Series("psi", psi[np.isfinite(psi)], 120.0, "x_stat_2")


def dvl_residual(run: int, regressed: bool) -> Callable[[Path], Series]:
    """Forward DVL minus truth in the body, time shift undone; if asked, scale, misalignment, rates regressed out."""

    def load(root: Path) -> Series:
        folder = root / "snapir-auv-1hz"
        dvl, truth = (read_table(folder / f"{kind}_trajectory{run}.csv") for kind in ("DVL", "GT"))
        t = dvl.numbers(0)[0]
        reading = np.column_stack([dvl.numbers(k)[0] for k in (1, 2, 3)])
        columns = np.column_stack([truth.numbers(k)[0] for k in range(10)])

        def left(shift: float) -> float:
            return float(np.sum(_residuals(t, reading, columns, shift)[1][5:-5, :2] ** 2))

        shift = min(np.arange(0.0, 2.6, 0.05), key=left)
        raw, rest = _residuals(t, reading, columns, shift)
        return Series(f"trajectory {run}", (rest if regressed else raw)[5:-5, 0], 1.0 / 1.0025)

    return load


def _residuals(t: Array, reading: Array, truth: Array, shift: float) -> tuple[Array, Array]:
    """DVL minus truth read `shift` seconds later, and what body velocity and angular rates (lever arms) leave of it."""
    from scipy.interpolate import CubicSpline

    clock = np.clip(t + shift, truth[0, 0], truth[-1, 0])
    angles = CubicSpline(truth[:, 0], np.unwrap(truth[:, 7:10], axis=0))
    velocity, rates = CubicSpline(truth[:, 0], truth[:, 4:7])(clock), angles(clock, 1)
    body = np.einsum("nji,nj->ni", matrix_from_euler(*angles(clock).T), velocity)
    raw = reading - body
    regressors = np.column_stack([np.ones(t.size), body, rates])
    return raw, raw - regressors @ np.linalg.lstsq(regressors, raw, rcond=None)[0]


# --- what is expected -----------------------------------------------------------------------------------------------


def orders(*wanted: tuple[int, int]) -> Callable[[Identification], bool]:
    """One of these orders was chosen."""
    return lambda found: (found.fit.p, found.fit.q) in wanted


def coefficients(
    ar: dict[int, tuple[float, float]], ma: dict[int, tuple[float, float]]
) -> Callable[[Identification], bool]:
    """Coefficients within a tolerance, by their index from 0."""

    def check(found: Identification) -> bool:
        pairs = [(found.fit.ar, ar), (found.fit.ma, ma)]
        return all(
            k < c.size and abs(c[k] - value) <= near for c, wanted in pairs for k, (value, near) in wanted.items()
        )

    return check


def pole(value: float, near: float) -> Callable[[Identification], bool]:
    """The largest pole within a tolerance."""
    return lambda found: found.fit.p > 0 and abs(abs(found.fit.model.poles[0]) - value) <= near


def first_lag(low: float, high: float) -> Callable[[Identification], bool]:
    """First autocorrelation of the model in a range, whatever its order."""

    def check(found: Identification) -> bool:
        gamma = found.fit.model.autocovariance(1)
        return low <= gamma[1] / gamma[0] <= high

    return check


def inertial() -> Iterator[Case]:
    """Gyros at rest."""
    mpu = "imu-mpu6050-raw-static/mpu6050_static_450s.csv.xz"
    # x is described as white; y and z are not (Allan deviation at 100 s three times that of white noise)
    for axis in "xyz":
        yield Case(f"MPU-6050 gyro {axis}", table(mpu, f"g{axis}", 100.0, skip_lines=4), "(0,0)", orders((0, 0)))
    memsense = "gyro-memsense-3025-static/memsense_test_real.npy"
    for k, axis in enumerate("xyz"):
        load = table(memsense, k, 250.0, table="[0]", transpose=True)
        yield Case(f"Memsense gyro {axis}", load, "MA(1)/AR(2), lag 1 about -.15", first_lag(-0.17, -0.13))
    for unit, low in ((1, 0.170), (2, 0.169), (3, 0.198), (4, 0.197)):
        load = table(f"imu-adis16405-static/adis16405_unit{unit}.npz", 0, 100.0, table="counts")
        near = first_lag(low - 0.015, low + 0.015)
        yield Case(f"ADIS16405 #{unit} gyro x", load, f"MA(1)-like, lag 1 {low:.3f} (+-.015)", near)
    load = table("imu-mag-mpu6050-hmc5883l-static/unmoved_10min_mpu6050_gyroscope.mat", 1, 99.3)
    yield Case("MPU6050 (HMC unit) gyro x", load, "white + slow bias: |lag 1| < .03", first_lag(-0.03, 0.03))


def aiding() -> Iterator[Case]:
    """Barometers, headings and fixes at rest."""
    load = table("baro-static/ms5611_static_altitude_80hz.csv.xz", "h", 80.0, skip_lines=2)
    near = coefficients({0: (-0.998, 0.002)}, {0: (-0.985, 0.005)})
    yield Case("MS5611 height", load, "(1,1): AR .998+-.002, MA -.985+-.005", near)
    yield Case("BME280 pressure", bme280, "pole .995 (+-.01), MA about -.82", pole(0.995, 0.01))
    for oss in (0, 3):
        load = table(f"baro-static/bmp180_mpl115_oss{oss}.log", 1, 1.0, delimiter=";", skip_lines=4, header=False)
        yield Case(f"BMP180 oss {oss}", load, "AR about .99, MA -.93", pole(0.985, 0.015))
    load = table("ahrs-vn100-static/vn100_live_capture_vnymr.txt.xz", 1, 40.0)
    yield Case("VN-100 heading", load, "pole .998 (+-.002)", pole(0.998, 0.002))
    yield Case("VN-100 heading, AR(1)", load, "AR .998+-.002", coefficients({0: (-0.998, 0.002)}, {}), (1, 0))
    yield Case("HMC5883L heading", compass_heading, "about white: lag 1 -.02 (+-.05)", first_lag(-0.07, 0.03))
    yield Case("Xsens DOT heading", xsens_heading, "lag 1 .999: pole above .99", pole(1.0, 0.01))
    for name, a, b in (("on", -1.839, 0.848), ("off", -1.239, 0.306)):
        load, near = gps(f"gps_sa_{name}_dev.dat.gz"), coefficients({0: (a, 0.02), 1: (b, 0.02)}, {})
        yield Case(f"GPS SA {name} 10 s, AR(2)", load, f"AR {-a}, {-b} (+-.02)", near, (2, 0))
        yield Case(f"GPS SA {name} 10 s", load, "second order, strongly coloured", lambda found: found.fit.p >= 2)


def moving() -> Iterator[Case]:
    """A DVL under way, against the truth."""
    for run in (1, 2, 3, 5, 6, 7, 8, 10):
        yield Case(f"snapir {run} DVL forward", dvl_residual(run, False), "lag 1 .35 to .83", first_lag(0.3, 0.88))
    yield Case("snapir 12 DVL forward", dvl_residual(12, False), "straight run: white", orders((0, 0)))
    for run in (1, 2, 3, 5, 6, 7, 8, 10, 12):
        yield Case(f"snapir {run} DVL forward, regressed", dvl_residual(run, True), "-", None)


# --- running --------------------------------------------------------------------------------------------------------


def run(case: Case, root: Path, max_order: int) -> dict[str, Any]:
    """Identify one recording."""
    series = case.load(root)
    began = time.perf_counter()
    found = identify(series, max_p=max_order, max_q=max_order, order=case.order)
    seconds = time.perf_counter() - began
    fit = found.fit
    return {
        "series": case.name,
        "samples": fit.n,
        "order": f"({fit.p},{fit.q})",
        "ar": fit.ar.tolist(),
        "ma": fit.ma.tolist(),
        "sd": fit.sd,
        "largest_pole": float(abs(fit.model.poles[0])) if fit.p else 0.0,
        "white": found.tests.is_white,
        "ljung_box_p": found.tests.ljung_box_p,
        "reading": found.reading.text,
        "remarks": list(found.remarks),
        "expected": case.expected,
        "as_expected": None if case.found is None else bool(case.found(found)),
        "seconds": seconds,
    }


def shown(values: list[float]) -> str:
    """The first coefficients."""
    return " ".join(f"{c:.4f}" for c in values[:4]) + (" .." if len(values) > 4 else "") or "-"


def identify_recordings(options: Options) -> list[dict[str, Any]]:
    """Identify every recording and print the table."""
    root = data_root()
    chosen = [case for case in chain(inertial(), aiding(), moving()) if options.only in case.name]
    if options.quick:
        few = ("MPU-6050 gyro x", "MS5611 height", "Memsense gyro x", "GPS SA on 10 s, AR(2)")
        chosen = [case for case in chosen if case.name in few]
    # Compiling is not identifying.
    identify(nf.simulate_arma([-0.9], [-0.4], 1.0, 500, seed=1), 1.0, max_p=1, max_q=1)
    columns = (
        "series<28 samples>7d order<8 ar<32 ma<32 white<5d ljung_box_p>9.2g expected<40 as_expected<5 seconds>5.1f"
    )
    table, results = Table(columns), []
    for case in chosen:
        result = run(case, root, 3 if options.quick else options.max_order)
        results.append(result)
        table.add(result | {"ar": shown(result["ar"]), "ma": shown(result["ma"])})
    print()
    for result in results:
        print(f"{result['series']:30}{result['reading']}")
    known = [result["as_expected"] for result in results if result["as_expected"] is not None]
    print(f"\n{sum(known)} of {len(known)} as expected")
    return results


if __name__ == "__main__":
    flags = [
        flag("--max-order", type=int, default=6, help="largest p and q (default: %(default)s)"),
        flag("--only", default="", metavar="TEXT", help="recordings whose name contains this"),
        quick("a few recordings, orders up to 3"),
    ]
    main(__doc__, {identify_recordings: flags})
