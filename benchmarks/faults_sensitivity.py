"""How much each constant of the fault rules matters: halved and doubled, what becomes of faults and of clean missions.

A constant that changes nothing, halved or doubled, is one that nobody would miss; one that changes much has to be
measured or derived. The cases are every nth of `faults.py outcomes` and `further`; a constant is tried on those whose
run reads it. There is no other software to compare with: the rival is the same filter with the constant as it is.
"""

from __future__ import annotations

import functools
import math
import re
import types
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import Any, ClassVar, NamedTuple

import faults_outcomes
import numpy as np
from faults_further import FURTHER
from faults_outcomes import VEHICLES, Case
from harness import Options, Table, flag, main, quick

import navfilter as nf
from navfilter.faults import settings

FACTORS = (0.5, 2.0)
#: An error below this is no error of a fault [m].
LEAST_M = 1.0
COLUMNS = "constant<18 factor>5.1f cases>5d changed>7d worse>5d better>6d error>6.3f largest>7.2f which<40"


class Tried(NamedTuple):
    """One case for one vehicle."""

    name: str
    vehicle: str


class Recording(types.ModuleType):
    """A module that knows which of its constants were read."""

    read: ClassVar[set[str]] = set()

    def __getattribute__(self, name: str) -> Any:
        if name.isupper():
            Recording.read.add(name)
        return super().__getattribute__(name)


def constants() -> dict[str, Any]:
    """The constants by name: numbers, arrays, and tables of numbers."""
    return {name: value for name, value in vars(settings).items() if re.fullmatch(r"[A-Z][A-Z0-9_]*", name)}


def scaled(value: Any, factor: float) -> Any:
    """A constant times a factor; a count stays one, of at least 1, and a share stays below 1."""
    if isinstance(value, dict):
        return {key: scaled(item, factor) for key, item in value.items()}
    if isinstance(value, int):
        return max(1, round(value * factor))
    return min(value * factor, 0.999) if isinstance(value, float) and value < 1.0 else value * factor


def all_cases(which: str) -> dict[str, Case]:
    """Every case for a vehicle."""
    vehicle, _ = faults_outcomes.mission_of(1, which)
    known = faults_outcomes.cases(vehicle)
    return known | {f"{name} (further)": case for name, case in FURTHER.items() if name not in known}


def chosen(vehicles: list[str], every: int) -> Iterator[Tried]:
    """Every nth case that changes anything, and the mission without a fault, for each vehicle."""
    at = 0
    for which in vehicles:
        for name, case in all_cases(which).items():
            at += 1
            if name == "no fault" or (at % every == 0 and faults_outcomes.befalls(name, case, which)):
                yield Tried(name, which)


def outcome(tried: Tried) -> dict[str, Any]:
    """What becomes of a case as the constants stand."""
    return faults_outcomes.row_of(tried.name, all_cases(tried.vehicle)[tried.name], [1], tried.vehicle)


@functools.cache
def as_it_is(tried: Tried) -> tuple[dict[str, Any], frozenset[str]]:
    """What becomes of a case, and the constants that were read, for the run without the fault as well."""
    faults_outcomes.clean.cache_clear()
    settings.__class__ = Recording
    Recording.read.clear()
    try:
        row = outcome(tried)
    finally:
        settings.__class__ = types.ModuleType
    return row, frozenset(Recording.read)


def with_constant(name: str, factor: float, cases: list[Tried]) -> list[dict[str, Any]]:
    """What becomes of cases with a constant changed."""
    value = getattr(settings, name)
    faults_outcomes.clean.cache_clear()
    setattr(settings, name, scaled(value, factor))
    try:
        return [outcome(tried) for tried in cases]
    finally:
        setattr(settings, name, value)


def rows_of(name: str, cases: list[Tried]) -> list[dict[str, Any]]:
    """The rows of one constant."""
    known = [(tried, *as_it_is(tried)) for tried in cases]
    read = [(tried, before) for tried, before, constants in known if name in constants]
    rows = []
    for factor in FACTORS:
        ratios, counts, which = [], {"changed": 0, "worse": 0, "better": 0}, ""
        results = with_constant(name, factor, [tried for tried, _ in read])
        for (tried, before), after in zip(read, results, strict=True):
            ratio = max(after["worst_m"], LEAST_M) / max(before["worst_m"], LEAST_M)
            counts["changed"] += after != before
            counts["worse"] += before["verdict"] == "ok" != after["verdict"]
            counts["better"] += before["verdict"] != "ok" == after["verdict"]
            if abs(math.log(ratio)) >= max((abs(math.log(x)) for x in ratios), default=0.0) and after != before:
                which = f"{tried.vehicle}: {tried.name}"
            ratios.append(ratio)
        largest = max(ratios, key=lambda x: abs(math.log(x)), default=1.0)
        mean = math.exp(np.mean(np.log(ratios))) if ratios else 1.0
        row = {"constant": name, "factor": factor, "cases": len(ratios), **counts, "error": mean}
        rows.append({**row, "largest": largest, "which": which})
    return rows


def sensitivity(options: Options) -> dict[str, Any]:
    """Every constant halved and doubled.

    cases: those whose run reads it. changed: of those, where any figure differs. worse, better: where the verdict of
    `faults.py` (error, NEES, bounds) was ok and is not, or was not and is. error: geometric mean, over the cases, of
    the greatest error of the dive relative to that of the constant as it is (errors below 1 m count as 1 m); largest:
    the ratio that is furthest from 1, of the case named last.
    """
    nf.warm_up()
    cases = list(chosen(options.vehicles, 60 if options.quick else options.every))
    names = [name for name in constants() if re.search(options.only, name)][: 3 if options.quick else None]
    print(f"{len(cases)} cases, {len(names)} constants")
    table = Table(COLUMNS)
    if options.workers > 1:
        with ProcessPoolExecutor(options.workers) as pool:
            for rows in pool.map(rows_of, names, [cases] * len(names)):
                list(map(table.add, rows))
    else:
        for name in names:
            list(map(table.add, rows_of(name, cases)))
    of = {name: [row for row in table.rows if row["constant"] == name] for name in names}
    unread = [name for name, rows in of.items() if not any(row["cases"] for row in rows)]
    idle = [name for name, rows in of.items() if name not in unread and not any(row["changed"] for row in rows)]
    print(f"\nread, and changes nothing: {', '.join(idle) or 'none'}")
    print(f"read in none of these cases: {', '.join(unread) or 'none'}")
    return {"cases": [tried._asdict() for tried in cases], "constants": table.rows, "idle": idle, "unread": unread}


if __name__ == "__main__":
    some = ["tactical", "mems"]
    flags = [
        flag("--vehicles", nargs="+", choices=list(VEHICLES), default=some, help="(default: %(default)s)"),
        flag("--every", type=int, default=8, help="one case in so many (default: %(default)s)"),
        flag("--only", default="", help="only constants whose name this pattern finds"),
        flag("--workers", type=int, default=1, help="processes"),
        quick("three constants, two or three cases"),
    ]
    main(__doc__, {sensitivity: flags})
