"""Lines out of ``navfilter run``: states, events, and the bytes of the input cut into lines.

Numbers are written with the fewest digits that read back as the same float64, so two outputs can be compared bit for
bit.
"""

import json
import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from navfilter.foundation.quoting import json_value
from navfilter.io.json_lines import LONGEST_LINE
from navfilter.models.health import Health
from navfilter.models.state import NavState


def to_line(fields: Mapping[str, Any]) -> bytes:
    """One object as one line; what is not finite becomes null."""
    try:
        text = json.dumps(fields, separators=(",", ":"), allow_nan=False)
    except ValueError:
        text = json.dumps(json_value(fields), separators=(",", ":"), allow_nan=False)
    return text.encode() + b"\n"


def event_line(event: str, **fields: Any) -> bytes:
    """A line that tells of something that happened."""
    return to_line({"event": event, **fields})


def state_fields(state: NavState) -> dict[str, Any]:
    """The navigation state as it is published.

    Returns
    -------
    dict
        ``time_s``, ``latitude_deg``, ``longitude_deg``, ``depth_m`` (minus the height), ``velocity_n_m_s`` (north,
        east, down), ``roll_deg``, ``pitch_deg``, ``heading_deg`` (0 to 360) and standard deviations ``position_sd_m``,
        ``velocity_sd_m_s`` (north, east, down) and ``attitude_sd_deg`` (rotations about north, east, down; the last is
        that of the heading of a level vehicle); ``sensors``: condition, age of the last good reading [s], mean NIS and
        what became of the readings, by name; ``lane`` (see `Health`) and ``axes``: conditions of those axes of the
        inertial unit that are not good; ``lanes``, where there are several: condition, gain and NIS (`LaneHealth`) by
        name, with ``lane_reason``;
        ``clock_offset_s`` and ``drive_clock_offset_s``; and `integrity_fields`.
    """
    health = state.health or Health({}, {})
    lanes = {
        name: {"condition": lane.condition, "gain": lane.gain, "nis": lane.nis} for name, lane in health.lanes.items()
    }
    roll, pitch, heading = np.degrees(state.roll_pitch_heading).tolist()
    sd = state.sd.tolist()
    return {
        "time_s": state.time_s,
        "latitude_deg": math.degrees(state.latitude),
        "longitude_deg": math.degrees(state.longitude),
        "depth_m": -state.height,
        "velocity_n_m_s": state.velocity_n.tolist(),
        "roll_deg": roll,
        "pitch_deg": pitch,
        "heading_deg": heading % 360.0,
        "position_sd_m": sd[:3],
        "velocity_sd_m_s": sd[3:6],
        "attitude_sd_deg": [math.degrees(s) for s in sd[6:]],
        "sensors": {
            name: {"condition": s.condition, "age_s": s.age_s, "nis": s.nis, "outcomes": s.outcomes}
            for name, s in health.sensors.items()
        },
        "lane": health.lane,
        "axes": {name: condition for name, condition in health.axes.items() if condition != "good"},
        **({"lane_reason": health.lane_reason, "lanes": lanes} if lanes else {}),
        "clock_offset_s": health.clock_offset_s,
        "drive_clock_offset_s": health.drive_clock_offset_s,
        **integrity_fields(health),
    }


def integrity_fields(health: Health) -> dict[str, Any]:
    """``trust`` with its ``reasons``, ``protection_radius_m`` and ``heading_bound_deg`` (null: there is no bound)."""
    if health.trust is None or health.bounds is None:
        return {}
    radius = health.bounds.horizontal_m
    return {
        "trust": health.trust.level,
        "reasons": list(health.trust.reasons),
        "protection_radius_m": radius if math.isfinite(radius) else None,
        "heading_bound_deg": math.degrees(health.bounds.heading_rad),
    }


class Lines:
    """Cuts bytes as they arrive into lines; one that does not end is cut off, and told from a whole one."""

    def __init__(self) -> None:
        self._rest = b""
        self._skipping = False

    def feed(self, data: bytes) -> Iterator[tuple[bytes, bool]]:
        """Lines that are complete now, without the line feed, and whether each was cut off."""
        *whole, self._rest = (self._rest + data).split(b"\n")
        for line in whole:
            if not self._skipping:
                yield line, False
            self._skipping = False
        if len(self._rest) > LONGEST_LINE:
            if not self._skipping:
                yield self._rest[:200], True
            self._rest, self._skipping = b"", True

    def end(self) -> Iterator[tuple[bytes, bool]]:
        """What stands after the last line feed when the input ends."""
        if self._rest and not self._skipping:
            yield self._rest, False
        self._rest, self._skipping = b"", False
