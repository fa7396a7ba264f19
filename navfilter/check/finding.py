"""One thing worth saying about a mission."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Severity = Literal["error", "warning", "info"]
#: Of what a finding is, in one word that stays when sentences change; the manual explains each (`mistakes.md`). Of a
#: stream, its times and its values:
OfStream = Literal["stream", "reader", "few", "clock", "clock-unit", "delay", "stamps", "rate", "gap", "span"]
OfValues = Literal["empty", "stuck", "held", "mark", "quantised", "leaps", "unit", "scale", "sign", "axes", "mounting"]
#: Of what streams say of each other, and of what vehicle.toml says:
OfMotion = Literal["exchanged", "course", "heading", "habit", "iron", "north", "datum"]
OfVehicle = Literal["sd", "bias", "lacking", "omitted", "arm-or-clock", "constant", "untold", "correlation"]
#: Of a track, of the unit that drives it, and of its sensors:
OfTrack = Literal["diverged", "impossible", "unbounded", "reset", "opened", "surfacing", "drift", "backward"]
OfDrive = Literal["lane", "samples", "noisy", "silent", "realigned", "shifted", "left-out"]
OfSensor = Literal["unheard", "unused", "lost", "jumped", "rejected", "widened", "component", "nis"]
Code = OfStream | OfValues | OfMotion | OfVehicle | OfTrack | OfDrive | OfSensor


@dataclass(frozen=True)
class Finding:
    """What was seen in a mission and what to do about it.

    Parameters
    ----------
    severity : {"error", "warning", "info"}
    code : str
        What it is of, in one word.
    stream : str
        Name of the stream, empty for the mission as a whole.
    text : str
        What was seen, in plain words.
    cure : str
        What to do; empty where there is nothing to do.
    """

    severity: Severity
    code: Code
    stream: str
    text: str
    cure: str = ""

    def lines(self) -> list[str]:
        """As text: what was seen, and below it the cure."""
        seen = f"  {self.stream + ': ' if self.stream else ''}{self.text}"
        return [seen, f"      -> {self.cure}"] if self.cure else [seen]


def by_severity(found: Iterable[Finding]) -> tuple[Finding, ...]:
    """Findings with errors first and facts last, otherwise in their order."""
    rank = {"error": 0, "warning": 1, "info": 2}
    return tuple(sorted(found, key=lambda finding: rank[finding.severity]))
