"""Mistakes of a mapping or a vehicle.toml, in the manual's own example: what `check` and the verdict of a replay say;
and tables as other programs write them.

No other software is known that looks for them; the row without a mistake is the reference.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

from harness import ROOT, Options, Table, main, quick

sys.path.insert(0, str(ROOT / "tests"))
import file_mistakes
import mistakes_library as library

from navfilter import read_mission, read_vehicle
from navfilter.check import check_mission
from navfilter.check.finding import Finding
from navfilter.simulation.scenarios import SCENARIOS, simulate_scenario


def mistakes(options: Options) -> list[dict[str, Any]]:
    """Each mistake, what check says first, and the verdict of the replay with its exit code."""
    table = Table("mistake<46 check<110 exit>4d verdict<110")
    vehicle, mission = library.sound()
    cases: dict[str, library.Mistake] = {"none": lambda *both: both} | library.MISTAKES
    for name, spoil in [*cases.items()][: 3 if options.quick else None]:
        told = library.told(*spoil(vehicle, mission))
        table.add({"mistake": name, "check": first(told.check), "exit": told.code, "verdict": said(told)})
    return table.rows


def files(options: Options) -> list[dict[str, Any]]:
    """Each file, what is said of it, and the exit code of `check`."""
    out = Table("file<42 said<150 exit>4d")
    for name, (content, clock) in [*file_mistakes.FILES.items()][: 3 if options.quick else None]:
        with tempfile.TemporaryDirectory() as folder:
            told = file_mistakes.told(Path(folder), content, clock)
        out.add({"file": name, "said": told.said or "read right", "exit": told.code})
    return out.rows


def clean(options: Options) -> list[dict[str, Any]]:
    """What `check` says of the recordings that ``tests/recordings`` has a mission.toml for, with and without their
    vehicle.toml, and of 30 simulated missions without a mistake.
    """
    table = Table("mission<40 check<150")
    places = sorted(path.parent for path in (ROOT / "tests" / "recordings").rglob("mission.toml"))
    for place in places[: 2 if options.quick else None]:
        mission = read_mission(place)
        name = str(place.relative_to(ROOT / "tests" / "recordings"))
        for words, vehicle in (("", read_vehicle(place)), (", alone", None)):
            table.add({"mission": f"{name}{words}", "check": graver(check_mission(mission, vehicle))})
    names = [name for name in SCENARIOS if name != "miscalibrated"]  # that one is not meant to be without a mistake
    for k in range(2 if options.quick else 30):
        name, seed = names[k % len(names)], 101 + k // len(names)
        vehicle, mission = simulate_scenario(name, seed, min(SCENARIOS[name].duration_s, 600.0))
        table.add({"mission": f"{name}, seed {seed}", "check": graver(check_mission(mission, vehicle))})
    return table.rows


def graver(findings: tuple[Finding, ...]) -> str:
    """The gravest finding that is worth more than knowing."""
    return first(tuple(f for f in findings if f.severity != "info"))


def first(findings: tuple[Finding, ...]) -> str:
    """The gravest finding, and how many more there are."""
    if not findings:
        return "-"
    more = f" (+{len(findings) - 1})" if findings[1:] else ""
    where = f"{findings[0].stream}: " if findings[0].stream else ""
    return f"{where}{findings[0].text}{more}"


def said(told: library.Told) -> str:
    """What the replay ends with."""
    if isinstance(told.verdict, str):
        return f"refused: {told.verdict}"
    grave = tuple(f for f in told.verdict.findings if f.severity != "info")
    return first(grave)


if __name__ == "__main__":
    main(__doc__, {mistakes: [quick("two mistakes")], files: [quick("three files")], clean: [quick("four")]})
