"""Reports of a Water Linked DVL as lines of readings, for ``navfilter run --source waterlinked://HOST``.

Instruments on the network that ``navfilter run`` connects to: each is read by a thread of its own, which connects
again and again, and never keeps the navigation waiting.
"""

import contextlib
import math
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from navfilter.foundation.display import counted
from navfilter.io.logs.waterlinked import number, report_in, valid_s
from navfilter.models.vehicle import Vehicle
from navfilter.service.protocol import Lines, to_line
from navfilter.service.sources import BLOCK, keep_alive


class Instrument:
    """One instrument.

    Parameters
    ----------
    source : WaterLinked
    wake : callable
        Called by the thread when there is something to take.
    """

    #: A connection is waited for so long, and tried again after so long [s].
    CONNECT_S, AGAIN_S = 5.0, 1.0
    #: Connected and without any report for so long: that connection is dead [s].
    SILENT_S = 10.0
    #: Readings that wait to be taken; beyond that the oldest are dropped.
    MOST = 10_000
    #: How often the thread looks whether it is to end [s].
    LOOK_S = 0.2

    def __init__(self, source: "WaterLinked", wake: Callable[[], None]) -> None:
        self.source, self._wake = source, wake
        self._readings: deque[bytes] = deque()
        self._told: deque[str] = deque()
        self._last = ""
        self._dropped = self._bad = 0
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name=source.url, daemon=True)

    def start(self) -> None:
        """Begin to connect."""
        self._thread.start()

    def take(self) -> tuple[list[bytes], list[str]]:
        """The readings that came since, as lines, and what there is to tell."""
        readings = [self._readings.popleft() for _ in range(len(self._readings))]
        return readings, [self._told.popleft() for _ in range(len(self._told))]

    def close(self) -> None:
        """End the thread; one that still waits for a connection ends by itself."""
        self._end.set()
        self._thread.join(2.0 * self.LOOK_S)

    # ---------------------------------------------------------------- in the thread
    def _run(self) -> None:
        while not self._end.is_set():
            try:
                with socket.create_connection(self.source.address, self.CONNECT_S) as connection:
                    with contextlib.suppress(OSError):
                        keep_alive(connection)
                    connection.settimeout(self.LOOK_S)
                    self._tell(self._listen(connection))
            except OSError as error:
                self._tell(f"not connected: {error.strerror or error}; trying again every {self.AGAIN_S:.0f} s")
            self._end.wait(self.AGAIN_S)

    def _listen(self, connection: socket.socket) -> str:
        """Until the connection ends; says why it did."""
        lines, heard = Lines(), time.monotonic()
        while not self._end.is_set():
            if time.monotonic() - heard > self.SILENT_S:
                return f"no report for {self.SILENT_S:.0f} s; connecting again"
            try:
                data = connection.recv(BLOCK)
            except TimeoutError:
                continue
            if not data:
                return "gone; connecting again"
            arrived_s = time.time()
            for line, cut_off in lines.feed(data):
                # one that is not asked for is a sign of life too
                if self._hear(line, cut_off, arrived_s):
                    heard = time.monotonic()
        return "closed"

    def _hear(self, line: bytes, cut_off: bool, arrived_s: float) -> bool:
        """Keep the reading of a line; whether it was a report."""
        try:
            reading = None if cut_off else self.source.reading(line, arrived_s)
        except (ValueError, TypeError, OverflowError, RecursionError):
            cut_off = True
        if cut_off:
            self._bad += 1
            if str(self._bad).strip("0") == "1":  # the first, the tenth, the hundredth ...
                self._tell(counted(self._bad, "lines that are no report"), repeat=True)
            return False
        self._tell("it speaks")
        if reading is not None:
            if len(self._readings) >= self.MOST:
                self._readings.popleft()
                self._dropped += 1
                if str(self._dropped).strip("0") == "1":
                    self._tell(counted(self._dropped, "readings dropped: the navigation does not keep up"), repeat=True)
            self._readings.append(reading)
            self._wake()
        return True

    def _tell(self, text: str, repeat: bool = False) -> None:
        """What is new; the same again and again is told once."""
        if text == self._last and not repeat:
            return
        self._last = self._last if repeat else text
        self._told.append(f"{self.source.url}: {text}")
        self._wake()


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
