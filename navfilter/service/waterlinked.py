"""Reports of a Water Linked DVL as lines of readings, for ``navfilter run --source waterlinked://HOST``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from navfilter.io.logs.waterlinked import number, report_in, valid_s
from navfilter.models.vehicle import Vehicle
from navfilter.service.protocol import to_line

PORT = 16171
#: Report -> its columns, and their factor to SI.
_COLUMNS = {
    "velocity": (("vx", "vy", "vz"), 1.0),
    "velocity_water": (("vx", "vy", "vz"), 1.0),
    "position_local": (("roll", "pitch", "yaw"), math.pi / 180.0),
}
#: No report is so long under way [s].
_LATEST_S = 10.0
_FORM = "waterlinked://192.168.194.95:16171?velocity=dvl&clock=instrument"


@dataclass(frozen=True)
class WaterLinked:
    """A DVL on the network, and what is taken from it.

    Parameters
    ----------
    url : str
        As it was asked for.
    address : (str, int)
        Host and port.
    sensors : dict of str to str
        Report -> sensor or stream of the vehicle.
    own_clock : bool
        Stamps are the instrument's; else those of this computer, less the time that the instrument says it took.
    """

    url: str
    address: tuple[str, int]
    sensors: Mapping[str, str]
    own_clock: bool = False

    def reading(self, line: bytes, arrived_s: float) -> bytes | None:
        """The line of a reading; nothing for a report that nobody asked for.

        Parameters
        ----------
        line : bytes
            As the instrument sent it.
        arrived_s : float
            By the clock of this computer [s since 1970].

        Raises
        ------
        ValueError
            When it is no report, or has no time.
        """
        report = report_in(line)
        if report is None:
            raise ValueError("no report")
        if (sensor := self.sensors.get(report["type"])) is None:
            return None
        columns, factor = _COLUMNS[report["type"]]
        value = [factor * number(report.get(column)) for column in columns]
        if report.get("velocity_valid") is False:
            # without a lock the numbers are arbitrary; that they came says that the instrument lives
            value = [math.nan] * 3
        time_s = valid_s(report) if self.own_clock else arrived_s - _latency_s(report)
        if not math.isfinite(time_s):
            raise ValueError("a report without a time")
        return to_line({"sensor": sensor, "time_s": time_s, "value": value})


def _latency_s(report: Mapping[str, Any]) -> float:
    """From when a report was valid to when it was sent [s]; 0 where it does not say."""
    seconds = 1e-6 * (number(report.get("time_of_transmission")) - number(report.get("time_of_validity")))
    return seconds if 0.0 <= seconds < _LATEST_S else 0.0


def waterlinked(url: str, vehicle: Vehicle) -> WaterLinked:
    """What ``--source`` asks for.

    Parameters
    ----------
    url : str
        ``waterlinked://HOST[:PORT][?REPORT=SENSOR&..&clock=instrument]``; without a report ``velocity=dvl``.
    vehicle : Vehicle

    Raises
    ------
    ValueError
        When it is no such address, or the vehicle has no such sensor.
    """
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port or PORT
        query = dict(parse_qsl(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query)))
    except ValueError as error:
        raise ValueError(f"--source {url}: {error}. Example: {_FORM}.") from None
    if parts.scheme != "waterlinked" or not host or parts.path not in ("", "/"):
        raise ValueError(f"--source must look like {_FORM}, found {url!r}.")
    clock = query.pop("clock", "computer")
    if clock not in ("computer", "instrument"):
        raise ValueError(f'--source {url}: clock is "computer" or "instrument", found "{clock}".')
    if unknown := sorted(query.keys() - _COLUMNS):
        raise ValueError(f"--source {url}: {unknown[0]} is no report of this instrument ({', '.join(_COLUMNS)}).")
    sensors = query or {"velocity": "dvl"}
    known = [name for name in (*vehicle.drive.streams, *vehicle.sensors) if name != "imu"]
    for sensor in sensors.values():
        if sensor not in known:
            raise ValueError(
                f'--source {url}: "{sensor}" is no sensor of this vehicle ({", ".join(known) or "none"}); say which is:'
                f" waterlinked://{host}?velocity=NAME."
            )
    return WaterLinked(url, (host, port), sensors, clock == "instrument")
