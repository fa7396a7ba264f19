"""Look at a mission before it is replayed: what is in it, and which of the usual mistakes it seems to contain.

`check_mission` returns findings; `report_text` writes them as plain words. Nothing here changes a mission.
"""

from collections.abc import Iterator
from datetime import UTC, datetime

from navfilter.check.course import north_findings
from navfilter.check.finding import Finding, Severity, by_severity
from navfilter.check.motion import compared_findings, motion_findings
from navfilter.check.streams import stream_findings
from navfilter.check.time_units import clock_findings
from navfilter.models.mission import Mission
from navfilter.models.vehicle import Vehicle

__all__ = ["Finding", "Severity", "check_mission", "data_findings", "report_text"]


#: Words of a reader's note that is worth a look.
GRAVER: tuple[str, ...] = ("back in time", "too many fields", "cut short", "no neighbour supports")
GRAVER += ("without a number", "without AM or PM", "begin anew")


def check_mission(mission: Mission, vehicle: Vehicle | None = None) -> tuple[Finding, ...]:
    """Everything worth saying about a mission, the gravest first.

    Parameters
    ----------
    mission : Mission
    vehicle : Vehicle, optional
        If given, its sensors are looked for in the mission, and mountings are applied before directions are compared.

    Returns
    -------
    tuple of Finding
        Severity "error": a replay would go wrong; "warning": look at it; "info": a fact.

    Examples
    --------
    >>> import numpy as np
    >>> from navfilter.models.mission import Stream
    >>> held = Stream(np.arange(100.0), np.repeat(np.arange(10.0), 10), ("depth_m",))
    >>> [finding.severity for finding in check_mission(Mission("x", {"depth": held}))]
    ['warning', 'info', 'info']
    """
    found: list[Finding] = []
    if not mission.streams:
        found.append(Finding("error", "stream", "", "there is no stream.", "Add [streams.NAME] to the mission.toml."))
    if (begin := mission.begin_utc) is not None and begin > datetime.now(UTC).isoformat():
        cure = (
            "Weeks of GPS counted 1024 too far, a clock that was never set, or another first day: see time and epoch."
        )
        found.append(Finding("warning", "clock", "", f"the first reading is of {begin}, a day to come.", cure))
    for name, stream in mission.streams.items():
        found += stream_findings(name, stream, mission)
    for note in mission.notes:
        stream_name = note.split(" ", 1)[0].rstrip(":")
        known = stream_name if stream_name in mission.streams else ""
        graver: Severity = "warning" if any(words in note for words in GRAVER) else "info"
        cure = "Late or shuffled readings: is the time column the right one?" if "back in time" in note else ""
        found.append(Finding(graver, "reader", known, f"the reader notes: {note}.", cure))
    if vehicle is not None:
        found += _absent(mission, vehicle)
    found += clock_findings(mission, vehicle)
    found += motion_findings(mission, vehicle)
    found += north_findings(mission, vehicle)
    return by_severity(found)


def data_findings(mission: Mission, vehicle: Vehicle) -> tuple[Finding, ...]:
    """What the streams of a mission say of each other that speaks against a replay: for its verdict.

    Parameters
    ----------
    mission : Mission
    vehicle : Vehicle
    """
    found = (*clock_findings(mission, vehicle), *compared_findings(mission, vehicle))
    return tuple(finding for finding in found if finding.severity != "info" and finding.code != "habit")


def report_text(mission: Mission, findings: tuple[Finding, ...]) -> str:
    """The findings as text: one paragraph per severity, one line per finding, its cure below it."""
    when = f" from {mission.begin_utc}" if mission.begin_utc else ""
    streams = ", ".join(mission.streams) or "none"
    lines = [f"Mission {mission.name}: {mission.duration_s:.1f} s{when}, streams {streams}."]
    headings = {"error": "Wrong, to be put right first", "warning": "Worth a look", "info": "What is there"}
    for severity, heading in headings.items():
        of_kind = [finding for finding in findings if finding.severity == severity]
        if not of_kind:
            continue
        lines += ["", f"{heading}:"]
        for finding in of_kind:
            lines += finding.lines()
    if not any(finding.severity == "error" for finding in findings):
        lines += ["", "No mistake found that would spoil a replay."]
    return "\n".join(lines)


def _absent(mission: Mission, vehicle: Vehicle) -> Iterator[Finding]:
    silent = {name for name, sensor in vehicle.sensors.items() if sensor.from_drive}
    wanted = {*vehicle.driving, *vehicle.sensors} - silent
    for name in sorted(wanted - set(mission.streams)):
        cure = f"Add [streams.{name}], or take [sensors.{name}] out of the vehicle.toml"
        cure += f" (to replay without it: --without {name})."
        if name in vehicle.imus:
            cure = f"Add [streams.{name}], or take [imus.{name}] out of the vehicle.toml."
        elif name in vehicle.driving:
            cure = "Nothing moves without what drives: add the stream, or choose another drive."
        yield Finding("error", "stream", name, "the vehicle has this sensor, the mission has no such stream.", cure)
    for name in sorted(set(mission.streams) - wanted):
        yield Finding("info", "stream", name, "this stream belongs to no sensor of the vehicle and is not used.")
