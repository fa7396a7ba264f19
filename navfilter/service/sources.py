"""Where the lines come from: a file, or one client at a time on a TCP socket; and the signals that end a run.

Reports of a Water Linked DVL as lines of readings, for ``navfilter run --source waterlinked://HOST``.

Instruments on the network that ``navfilter run`` connects to: each is read by a thread of its own, which connects
again and again, and never keeps the navigation waiting.
"""

import contextlib
import ipaddress
import math
import os
import select
import signal
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import FrameType
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from navfilter.foundation.display import counted
from navfilter.io.logs.waterlinked import number, report_in, valid_s
from navfilter.models.vehicle import Vehicle
from navfilter.service.protocol import Lines, to_line

BLOCK = 65536


class Stopped(BaseException):
    """A signal asked for the end while nothing was at stake yet (see `StopSignal.at_once`)."""


class StopSignal:
    """SIGTERM and SIGINT as a flag, and as something that wakes a `select`.

    SIGHUP is only noted: that somebody's terminal or connection has gone is no reason to stop navigating.
    """

    def __init__(self) -> None:
        self.received = self.hung_up = self._at_once = False
        self._wake, self._send = socket.socketpair()
        self._wake.setblocking(False)
        self._send.setblocking(False)
        signal.set_wakeup_fd(self._send.fileno(), warn_on_full_buffer=False)
        self._before = {
            number: signal.signal(number, self._take) for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
        }

    def _take(self, number: int, frame: FrameType | None) -> None:
        if number == signal.SIGHUP:
            self.hung_up = True
            return
        self.received = True
        if self._at_once:
            self._at_once = False  # what is closed on the way out is not interrupted
            raise Stopped

    @contextlib.contextmanager
    def at_once(self) -> Iterator[None]:
        """Within, a signal raises `Stopped` wherever the program is: nobody waits for a compilation."""
        self._at_once = True
        try:
            if self.received:
                raise Stopped
            yield
        finally:
            self._at_once = False

    def ready(self, watched: list[Any], timeout_s: float) -> list[Any]:
        """Those of the descriptors that can be read; returns early for a signal."""
        ready, _, _ = select.select([*watched, self._wake], [], [], timeout_s)
        if self._wake in ready:
            ready.remove(self._wake)
            with contextlib.suppress(BlockingIOError):
                self._wake.recv(BLOCK)
        return ready

    def wake(self) -> None:
        """Let `ready` return early; for other threads."""
        with contextlib.suppress(OSError):  # full: it will wake all the same
            self._send.send(b"\0")

    def restore(self) -> None:
        """Leave the process's signals as they were."""
        signal.set_wakeup_fd(-1)
        for which, handler in self._before.items():
            signal.signal(which, handler)
        self._wake.close()
        self._send.close()


class NoSource:
    """No input but that of instruments.

    Parameters
    ----------
    stop : StopSignal
    """

    def __init__(self, stop: StopSignal) -> None:
        self._stop = stop

    def read(self, timeout_s: float) -> bytes | None:
        """Nothing, after some time or when somebody wakes it."""
        self._stop.ready([], timeout_s)
        return b""

    def heard(self) -> None:
        """There was a reading: nothing follows from that here."""

    def close(self) -> None:
        """Nothing is open."""


class FileSource:
    """Bytes of a file descriptor.

    Parameters
    ----------
    handle : int
    stop : StopSignal
    """

    def __init__(self, handle: int, stop: StopSignal) -> None:
        self._handle, self._stop = handle, stop

    def read(self, timeout_s: float) -> bytes | None:
        """The next block; nothing when none came in time or a signal did; None at the end."""
        if not self._stop.ready([self._handle], timeout_s):
            return b""
        try:
            return os.read(self._handle, BLOCK) or None
        except BlockingIOError:
            return b""

    def heard(self) -> None:
        """There was a reading: nothing follows from that here."""

    def close(self) -> None:
        """Nothing is open that was not open before."""


def listen_address(url: str, *, allow_remote: bool) -> tuple[str, int]:
    """Host and port of ``tcp://127.0.0.1:4600``.

    Raises
    ------
    ValueError
        When it is no such address, or not on the loopback and that was not asked for.
    """
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise ValueError(f"--listen {url}: {error}.") from None
    if parts.scheme != "tcp" or host is None or port is None or parts.path not in ("", "/"):
        raise ValueError(f"--listen must look like tcp://127.0.0.1:4600, found {url!r}.")
    host = "127.0.0.1" if host == "localhost" else host
    try:
        local = ipaddress.ip_address(host).is_loopback
    except ValueError:
        raise ValueError(f'--listen needs the address of an interface such as 127.0.0.1, found "{host}".') from None
    if not local and not allow_remote:
        raise ValueError(
            f"{host} can be reached from other computers: whoever reaches it can steer the navigation, for there is no"
            " password. Use 127.0.0.1, or add --allow-remote if that is meant."
        )
    return host, port


class Client:
    """The client of the moment, what it is known by, and when it last sent a reading [s, monotonic]."""

    def __init__(self, connection: socket.socket, name: str) -> None:
        self.connection, self.name, self.heard_s = connection, name, time.monotonic()


class TcpSource:
    """Bytes of one client at a time; when it goes, or has been silent for too long, the next one may come.

    Parameters
    ----------
    address : (str, int)
    stop : StopSignal
    changed : callable
        Is told of each client that comes or, with None, goes: ``changed(client, text)``.
    silent_s : float
        A client without a reading for so long [s] loses its place to one that comes.

    Raises
    ------
    OSError
        When the address cannot be listened on.
    """

    def __init__(
        self,
        address: tuple[str, int],
        stop: StopSignal,
        changed: Callable[[Client | None, str], Any],
        silent_s: float = 10.0,
    ) -> None:
        self._stop, self._changed, self._silent_s = stop, changed, silent_s
        family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        self._server = socket.create_server(address, family=family, backlog=4)
        self._server.setblocking(False)
        self._client: Client | None = None

    @property
    def url(self) -> str:
        """Where it listens, with the port that was found when none was asked for."""
        host, port = self._server.getsockname()[:2]
        return f"tcp://[{host}]:{port}" if ":" in host else f"tcp://{host}:{port}"

    def read(self, timeout_s: float) -> bytes | None:
        """The next block; nothing when none came in time. A client that goes ends its last line."""
        watched: list[Any] = [self._server]
        if self._client is not None:
            watched.append(self._client.connection)
        ready = self._stop.ready(watched, timeout_s)
        data = b""
        if self._client is not None and self._client.connection in ready:
            try:
                data = self._client.connection.recv(BLOCK)
            except OSError:
                data = b""
            if not data:
                self._drop("gone")
                data = b"\n"
        if self._server in ready:
            data += self._accept()
        return data

    def heard(self) -> None:
        """What was read last held a reading: the client is not silent."""
        if self._client is not None:
            self._client.heard_s = time.monotonic()

    def _accept(self) -> bytes:
        """Let a new client in, or refuse it; a client that lost its place to it ends its last line."""
        try:
            connection, address = self._server.accept()
        except OSError:
            return b""
        name, end = f"{address[0]}:{address[1]}", b""
        if self._client is not None:
            silent_s = time.monotonic() - self._client.heard_s
            if silent_s < self._silent_s:
                self._changed(self._client, f"{name} refused: {self._client.name} is connected")
                connection.close()
                return b""
            self._drop(f"put out: no reading for {silent_s:.1f} s, and {name} has come")
            end = b"\n"
        with contextlib.suppress(OSError):  # it may have gone already
            keep_alive(connection)
        self._client = Client(connection, name)
        self._changed(self._client, f"{name} connected")
        return end

    def _drop(self, why: str) -> None:
        if self._client is None:
            return
        client, self._client = self._client, None
        self._changed(None, f"{client.name} {why}")
        with contextlib.suppress(OSError):
            client.connection.shutdown(socket.SHUT_RDWR)
        client.connection.close()

    def close(self) -> None:
        """Close the client and the server."""
        self._drop("gone")
        self._server.close()


def keep_alive(connection: socket.socket) -> None:
    """A peer whose power failed must not hold the place for hours."""
    for option, value in (("TCP_KEEPIDLE", 5), ("TCP_KEEPINTVL", 2), ("TCP_KEEPCNT", 3)):
        if hasattr(socket, option):
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


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
