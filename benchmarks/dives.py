"""Real dives of an AUV with inertial unit and DVL: navfilter against the adaptive filters of the literature.

Every filter gets the same readings, mechanisation and constants as states (or none): navfilter as described, learnt,
and with every reading used; innovation-adaptive R, Sage-Husa, variational Bayes, merged models and Student's t
(`navfilter.evaluation.baselines`). Nine dives of 400 s with a post-processed truth, by the protocols of `dive_cases`:
raw, with an outage, low-cost, published and printed. The figures that papers give for the same task are printed beside,
with what differs. Environment variable NAVFILTER_DATA.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import dive_cases as dives
import numpy as np
from harness import Array, Options, Table, flag, main, quick

import navfilter as nf
from navfilter.check import check_mission
from navfilter.rendering.drawing import style, svg
from navfilter.rendering.page import Section, image_html, page, table_html
from navfilter.report.instrument import draw_plan, plan_view

Row = dict[str, Any]
#: What others publish for this task: source, dives, what differs, figures.
PUBLISHED = (
    (
        "A-KIT (Cohen and Klein, arXiv 2401.09987)",
        "two of its own, 743 and 748 m; tracks digitised, +-1 m",
        "its own start errors and noises; no depth",
        "end: EKF 137 and 167 m, three adaptive EKFs 3.2 to 103 m, A-KIT 18.8 and below 3 m",
    ),
    (
        "ANUKF (Levy and Klein, arXiv 2503.05490)",
        "two of 240 s",
        "protocol 'printed', 12 states, its own learnt Q",
        "VRMSE: UKF 0.1172, ANEKF 0.1004, ANUKF 0.0922 m/s; DVL lost from 180 to 200 s: 0.222, ANUKF 0.118 m/s",
    ),
    (
        "NAViLoss (2026)",
        "2, 3",
        "velocity by beams alone, errors of 0.7 %, 1 mm/s and 42 mm/s added to each",
        "velocity: least squares 0.178, BeamsNet 0.116, DVL-DeepONet 0.092, NAVi 0.082 m/s",
    ),
    (
        "BeamsNet with EKF (arXiv 2503.21727)",
        "two",
        "other errors added to the beams",
        "velocity: least squares 0.0135 and 0.0151, BeamsNet 0.0040 and 0.0039 m/s",
    ),
)
COLUMNS = (
    "filter<16 rms_m>6.2f low>5.2f high>5.2f ratio>5.2f r_low>5.2f r_high>6.2f end_m>6.2f end_pct>7.2f vrmse_m_s>9.3f"
    " prmse_m>7.2f nees>6.2f nees_mended>11.2f honest>6 heading_deg>11.2f nees_heading>12.2f"
)


def run(options: Options) -> Row:
    """All protocols that are asked for."""
    chosen = options.dives[: 2 if options.quick else None]
    tasks = [
        (protocol, dive, draw)
        for protocol in options.protocols
        for draw in range(draws_of(protocol, options))
        for dive in chosen
    ]
    with ProcessPoolExecutor(options.processes) as pool:
        print("time base, as navfilter finds it: check of the stamps as printed, states of a DVL a second too early")
        clocks = Table("dive>4d rows_s>7.5f clock_s>7.3f sd_s>6.3f arm_x_m>7.2f rms_m>6.2f over_right>10.2f")
        for row in pool.map(found_clock, chosen):
            clocks.add(row)
        rows = [row for part in pool.map(figures, tasks) for row in part]
    pooled = []
    for protocol in options.protocols:
        for constants in (False, True):
            kind = [row for row in rows if row["protocol"] == protocol and row["constants"] is constants]
            print(f"\n{title_of(protocol, constants, kind)}")
            table = Table(COLUMNS)
            for name in dives.filters(protocol):
                table.add(summary(name, kind))
            pooled += [{"protocol": protocol, "constants": constants, **row} for row in table.rows]
            print("\nhorizontal rms by dive [m], median of the draws")
            each = Table("filter<16 " + " ".join(f"{dive}>6.2f" for dive in numbers(kind)))
            for name in dives.filters(protocol):
                each.add(
                    {"filter": name, **{str(d): by_dive(kind, name, "rms_m", np.median)[d] for d in numbers(kind)}}
                )
    print("\nPublished for the same task:")
    for source, where, differs, said in PUBLISHED:
        print(f"  {source}; dives: {where}; differs: {differs}\n    {said}")
    if options.page:
        write_page(options.page, options.dives[0], options.protocols[0], pooled)
        print(f"\n{options.page} has the tables and the tracks of dive {options.dives[0]}.")
    return {"clocks": clocks.rows, "rows": rows, "pooled": pooled, "published": [list(line) for line in PUBLISHED]}


def draws_of(protocol: str, options: Options) -> int:
    """How often a dive is drawn by a protocol."""
    if protocol in ("raw", "outage") or options.quick:
        return 1
    return int(options.draws if protocol == "low-cost" else options.runs)


def figures(task: tuple[str, int, int]) -> list[Row]:
    """The figures of all filters on a dive by a protocol."""
    protocol, dive, draw = task
    rows = []
    for case in dives.cases(protocol, dive, draw):
        for name in dives.filters(protocol):
            with warnings.catch_warnings(action="ignore", category=UserWarning):
                found = dives.figures_of(dives.track_of(name, case), case)
            rows.append(
                {"protocol": protocol, "constants": case.constants, "dive": dive, "draw": draw, "filter": name, **found}
            )
    return rows


# --- pooled ---------------------------------------------------------------------------------------------------------


def numbers(rows: Sequence[Row]) -> list[int]:
    """Dives of rows."""
    return sorted({row["dive"] for row in rows})


def by_dive(rows: Sequence[Row], name: str, key: str, of: Callable[[Array], Any] = np.mean) -> dict[int, float]:
    """One figure of a filter for each dive, over the draws."""
    own = [row for row in rows if row["filter"] == name]
    return {dive: float(of(np.array([row[key] for row in own if row["dive"] == dive]))) for dive in numbers(rows)}


def summary(name: str, rows: Sequence[Row]) -> Row:
    """A filter over all dives and draws, with 95 % intervals over the dives (bootstrap).

    rms: root mean square over all. ratio: geometric mean of its rms over that of the best of the other filters of the
    class, in the pooled rms. honest: dives with a NEES of 0.5 to 2 against the mended truth. The rest: medians.
    """
    others = {row["filter"] for row in rows} & {*dives.RULES, "no gate"} - {name}
    squared = {other: by_dive(rows, other, "rms_m", mean_square) for other in {*others, name}}
    best = min(others, key=lambda other: sum(squared[other].values()))
    logs = np.array([0.5 * math.log(squared[name][dive] / squared[best][dive]) for dive in numbers(rows)])
    own = np.array(list(squared[name].values()))
    low, high = interval(own, lambda x: np.sqrt(np.mean(x, axis=1)))
    r_low, r_high = interval(logs, lambda x: np.exp(np.mean(x, axis=1)))
    mended = by_dive(rows, name, "nees_mended")
    keys = "end_m", "end_pct", "vrmse_m_s", "prmse_m", "nees", "nees_mended", "heading_deg", "nees_heading"
    return {
        "filter": name,
        "rms_m": float(np.sqrt(np.mean(own))),
        "low": low,
        "high": high,
        "ratio": float(np.exp(np.mean(logs))),
        "r_low": r_low,
        "r_high": r_high,
        "over": best,
        "honest": f"{sum(0.5 <= value <= 2.0 for value in mended.values())}/{len(mended)}",
        **{key: float(np.median([row[key] for row in rows if row["filter"] == name])) for key in keys},
    }


def mean_square(values: Array) -> float:
    """Of the values of one dive."""
    return float(np.mean(values**2))


def interval(values: Array, of: Callable[[Array], Array], draws: int = 4000) -> tuple[float, float]:
    """95 % interval of a figure over the dives, which are drawn anew."""
    again = np.random.default_rng(1).integers(0, len(values), (draws, len(values)))
    low, high = np.quantile(of(values[again]), [0.025, 0.975])
    return float(low), float(high)


def title_of(protocol: str, constants: bool, rows: Sequence[Row]) -> str:
    """Heading of a table."""
    states = "constants as states" if constants else "no constants as states"
    runs = len({(row["dive"], row["draw"]) for row in rows})
    return f"{protocol}, {states}: {runs} runs of {len(numbers(rows))} dives (ratio: to the best of the other rivals)"


# --- the time base --------------------------------------------------------------------------------------------------


def found_clock(dive: int) -> Row:
    """What navfilter says of stamps that are printed, and of a DVL whose clock is a second off and a state (sd 1 s).

    rows_s: by `navfilter mission --check`, how far apart the rows of the DVL are that are printed 1.0025 s apart.
    over_right: rms over that of the same vehicle with the right clock.
    """
    said = " ".join(f.cure for f in check_mission(dives.as_printed(dive), dives.vehicle_of("printed", False)))
    scale = re.search(r"time\.scale = ([\d.]+)", said)
    right = next(case for case in dives.cases("raw", dive, 0) if case.constants)
    late, dvl = right.mission.streams["dvl"], replace(right.vehicle.sensors["dvl"], time_offset_sd_s=1.0)
    vehicle = nf.Vehicle(right.vehicle.drive, {**right.vehicle.sensors, "dvl": dvl})
    mission = right.mission.with_stream("dvl", replace(late, time_s=late.time_s - 1.0))
    track = nf.replay(vehicle, mission)
    (clock, sd), (arm, _) = (track.state(f"dvl.{name}") for name in ("time_offset", "lever_arm_x"))
    rms = dives.figures_of(track, replace(right, vehicle=vehicle, mission=mission))["rms_m"]
    best = dives.figures_of(nf.replay(vehicle, right.mission), right)["rms_m"]
    return {
        "dive": dive,
        "rows_s": 1.00251 * float(scale.group(1)) if scale else None,
        "clock_s": float(clock[-1]),
        "sd_s": float(sd[-1]),
        "arm_x_m": float(arm[-1]),
        "rms_m": rms,
        "over_right": rms / best,
    }


# --- the page -------------------------------------------------------------------------------------------------------


def write_page(path: Path, dive: int, protocol: str, pooled: Sequence[Mapping[str, Any]]) -> None:
    """One HTML page: the tracks of all filters on a dive, and the tables."""
    parts = []
    for case in dives.cases(protocol, dive, 0):
        tracks = {name: dives.track_of(name, case) for name in dives.filters(protocol)}
        states = "constants as states" if case.constants else "no constants as states"
        with style():
            drawn = svg(draw_plan(plan_view(tracks, case.mission, ellipses=4)))
        parts.append(image_html(drawn, f"Dive {dive}, {protocol}, {states}; ellipses hold 95 %, if the run is honest."))
    sections = [Section("Tracks", tuple(parts))]
    for protocol, constants in dict.fromkeys((row["protocol"], row["constants"]) for row in pooled):
        kind = [row for row in pooled if (row["protocol"], row["constants"]) == (protocol, constants)]
        keys = [key for key in kind[0] if key not in ("protocol", "constants")]
        cells = [[text(row[key]) for key in keys] for row in kind]
        title = f"{protocol}, {'' if constants else 'no '}constants as states"
        sections.append(Section(title, (table_html(keys, cells),)))
    header = ["source", "dives", "what differs", "figures"]
    sections.append(Section("Published for the same task", (table_html(header, PUBLISHED, text_columns=(1, 2, 3)),)))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page("Dives", "Real dives, every adaptive rival", __doc__ or "", sections), encoding="utf-8")


def text(value: Any) -> str:
    """A cell."""
    return f"{value:.3g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main(
        __doc__,
        {
            run: [
                flag("--protocols", nargs="+", choices=dives.PROTOCOLS, default=["raw", "outage", "low-cost"]),
                flag("--dives", nargs="+", type=int, choices=dives.DIVES, default=list(dives.DIVES)),
                flag("--draws", type=int, default=4, help="of low-cost noises on every dive (default 4)"),
                flag(
                    "--runs", type=int, default=2, help="of published errors on every dive (default 2; papers have 100)"
                ),
                flag("--processes", type=int, default=2, help="at a time (default 2)"),
                flag(
                    "--page",
                    type=Path,
                    metavar="PATH",
                    help="write tables and tracks of the first dive as one HTML page",
                ),
                quick("two dives, one draw"),
            ]
        },
    )
