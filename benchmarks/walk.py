"""How far a reading walks: files of the package, and changes from one to another, of the calls that it makes.

Traces Python calls of the package (a compiled kernel counts as one) while single inputs of a survey are taken live,
with and without learning: an ordinary sample, an ordinary reading of the compass, one with a standard deviation of its
own, and one that its gate refuses. There is no other software in it: the figures are for comparing trees of this one.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from harness import ROOT, Options, Table, main, quick

sys.path.insert(0, str(ROOT / "tests"))
from feeding import Event, events_of, one_by_one

import navfilter as nf
from navfilter.simulation.scenarios import simulate_scenario

PACKAGE = str(Path(nf.__file__).parent)
#: The inputs that are looked at come after so long [s]; learning has begun by then.
AFTER_S = 60.0


def walked(call: Callable[[], Any]) -> tuple[int, list[str]]:
    """Python calls of the package, and the files in which they stand one after the other."""
    calls, files = 0, []

    def trace(frame: FrameType, event: str, _: Any) -> None:
        nonlocal calls
        name = frame.f_code.co_filename
        if event in ("call", "return") and name.startswith(PACKAGE):
            calls += event == "call"
            where = name if event == "call" or frame.f_back is None else frame.f_back.f_code.co_filename
            if where.startswith(PACKAGE) and (not files or files[-1] != where):
                files.append(where)

    sys.setprofile(trace)
    try:
        call()
    finally:
        sys.setprofile(None)
    return calls, files


#: The inputs that are looked at, in the order in which they are taken: of which sensor, and how.
INPUTS: dict[str, tuple[str, Callable[[nf.Navigator, Event], Any]]] = {
    "sample": ("drive", lambda nav, e: nav.step(e.time_s, e.value[:3], e.value[3:])),
    "reading": ("compass", lambda nav, e: nav.correct(e.sensor, e.time_s, e.value)),
    "reading with its own sd": ("compass", lambda nav, e: nav.correct(e.sensor, e.time_s, e.value, 0.01)),
    "reading that is refused": ("compass", lambda nav, e: nav.correct(e.sensor, e.time_s, np.array(e.value) + 0.5)),
}


def walk(options: Options) -> list[dict[str, Any]]:
    """A row for each input."""
    table = Table("input<34 calls>6d files>6d changes>8d")
    vehicle, mission = simulate_scenario("lawnmower", 1, AFTER_S + 10.0)
    learnt = vehicle.with_error(compass=nf.LearnedArma())
    for name, one in {"": vehicle, " (learnt)": learnt}.items():
        if options.quick and name:
            continue
        events = events_of(one, mission)
        nav = nf.Navigator(one, mission.start, threads=False)
        one_by_one(nav, [e for e in events if e.time_s < AFTER_S])
        rest = iter([e for e in events if e.time_s >= AFTER_S])
        for kind, (sensor, call) in INPUTS.items():
            while (event := next(rest)).sensor != sensor:
                one_by_one(nav, [event])
            calls, files = walked(partial(call, nav, event))
            table.add({"input": kind + name, "calls": calls, "files": len(set(files)), "changes": len(files) - 1})
            if kind.endswith("refused") and not name:
                refused = files
    print(
        "\nthe reading that is refused:",
        " > ".join(Path(f).relative_to(PACKAGE).with_suffix("").as_posix() for f in refused),
    )
    return table.rows


if __name__ == "__main__":
    main(__doc__ or "", {walk: [quick("without learning")]})
