"""One thing worth saying about a mission."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Severity = Literal["error", "warning", "info"]


@dataclass(frozen=True)
class Finding:
    """What was seen in a mission and what to do about it.

    Parameters
    ----------
    severity : {"error", "warning", "info"}
    stream : str
        Name of the stream, empty for the mission as a whole.
    text : str
        What was seen, in plain words.
    cure : str
        What to do; empty where there is nothing to do.
    about : str
        "mounting", "clock" or "scale" where a state of the filter may hold the same; "habit" where a vehicle may well
        do what looks odd; else empty.
    """

    severity: Severity
    stream: str
    text: str
    cure: str = ""
    about: str = ""
