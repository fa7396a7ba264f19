"""The loop of ``navfilter run``: read a block, log it, navigate with it; snapshots between blocks; an ordered end.

What is around the navigation never stops it: outputs, log, snapshots and supervision have threads of their own, and
whatever goes wrong with one of them is told and counted.

What others see of a run: notifications for systemd, and a state file for everybody else.
"""

import contextlib
import os
import socket
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from navfilter.foundation.atomic_files import replacing_binary
from navfilter.io.json_lines import BadLine, Item, LineParser, Note, Reading
from navfilter.models.vehicle import Vehicle
from navfilter.service.disk import Disk, StateFile
from navfilter.service.kernel_cache import warm
from navfilter.service.log import LOG_FILE, log_items, logged_options, prepare_log, remade_log, run_note
from navfilter.service.output import Outlet
from navfilter.service.protocol import Lines, event_line, to_line
from navfilter.service.session import Options, Session
from navfilter.service.sources import (
    Client,
    FileSource,
    Instrument,
    NoSource,
    Stopped,
    StopSignal,
    TcpSource,
    WaterLinked,
)


class Supervision:
    """Tells those that watch a run how it is.

    Parameters
    ----------
    path : Path, optional
        State file.
    say : callable
        Takes a line for the operator.
    """

    #: They hear of a run so often [s], or oftener where systemd's watchdog asks for it.
    PERIOD_S = 1.0
    #: A start may take so long until it is heard of again [s]: a slow computer compiles for minutes.
    START_S = 900.0

    def __init__(self, path: Path | None, say: Callable[[str], None]) -> None:
        self._notifier = Notifier(os.environ)
        self._file = None if path is None else HealthFile(path, say)
        self._began, self._ended = time.monotonic(), False

    @property
    def period_s(self) -> float:
        """Time between two reports [s]."""
        watchdog_s = self._notifier.watchdog_s
        return self.PERIOD_S if watchdog_s is None else min(self.PERIOD_S, watchdog_s / 3.0)

    def starting(self, text: str) -> None:
        """It is on its way."""
        self._write("starting", {"text": text})
        self._notifier.tell(STATUS=text, EXTEND_TIMEOUT_USEC=int(1e6 * self.START_S))

    def ready(self) -> None:
        """Readings are taken from now on."""
        self._notifier.tell(READY=1)

    def report(self, phase: str, **fields: Any) -> None:
        """A round of the loop: only this keeps systemd's watchdog quiet, so a loop that hangs is noticed."""
        self._write(phase, fields)
        age_s = fields["input_age_s"]
        self._notifier.tell(
            WATCHDOG=1, STATUS=f"{phase}, {fields['readings']} readings, the last line {age_s:.1f} s ago"
        )

    def ended(self, phase: str) -> None:
        """The last word; only the first time counts."""
        if not self._ended:
            self._ended = True
            self._notifier.tell(STOPPING=1, STATUS=phase)
            self._write(phase, {})
            if self._file is not None:
                self._file.close()

    def _write(self, phase: str, fields: dict[str, Any]) -> None:
        if self._file is not None:
            up_s = time.monotonic() - self._began
            self._file.put({"phase": phase, "pid": os.getpid(), "unix_s": time.time(), "up_s": up_s, **fields})


class Notifier:
    """systemd's notifications: datagrams to the socket that ``NOTIFY_SOCKET`` names; without one nothing is sent.

    Parameters
    ----------
    environment : mapping of str to str

    Attributes
    ----------
    watchdog_s : float or None
        The service is killed when it sends no ``WATCHDOG=1`` for so long [s].

    Notes
    -----
    Protocol: sd_notify(3), sd_watchdog_enabled(3).
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        path = environment.get("NOTIFY_SOCKET", "")
        self._address = ("\0" + path[1:] if path.startswith("@") else path) if path[:1] in ("/", "@") else ""
        self.watchdog_s = _watchdog_s(environment) if self._address else None
        self._socket: socket.socket | None = None
        if self._address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)

    def tell(self, **fields: Any) -> None:
        """Send ``KEY=value`` for each field; a supervisor that does not listen is none of the run's business."""
        if self._socket is not None:
            text = "\n".join(f"{key}={value}".replace("\n", " ") for key, value in fields.items())
            with contextlib.suppress(OSError):
                self._socket.sendto(text.encode(), self._address)


def _watchdog_s(environment: Mapping[str, str]) -> float | None:
    usec, pid = environment.get("WATCHDOG_USEC", ""), environment.get("WATCHDOG_PID", "")
    if not usec.isdecimal() or int(usec) == 0 or (pid and pid != str(os.getpid())):
        return None
    return int(usec) * 1e-6


class HealthFile:
    """One line of JSON, replaced as a whole by a thread of its own: a disk that hangs makes it old, and nothing else.

    Parameters
    ----------
    path : Path
    notice : callable
        Is told, once, when the file cannot be written.
    """

    def __init__(self, path: Path, notice: Callable[[str], None]) -> None:
        self._path, self._notice = path, notice
        self._latest: dict[str, Any] | None = None
        self._closing = self._failed = False
        self._condition = threading.Condition()
        self._thread = threading.Thread(target=self._work, name="navfilter-health", daemon=True)
        self._thread.start()

    @staticmethod
    def is_one(path: Path) -> bool:
        """Whether a file begins like one that was written here."""
        with path.open("rb") as file:
            return file.read(32).startswith(b'{"phase":')

    def put(self, fields: dict[str, Any]) -> None:
        """Write this next; of several that wait only the latest counts."""
        with self._condition:
            self._latest = fields
            self._condition.notify()

    def close(self, patience_s: float = 2.0) -> None:
        """Write what waits and end."""
        with self._condition:
            self._closing = True
            self._condition.notify()
        self._thread.join(patience_s)

    def _work(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._latest is not None or self._closing)
                fields, self._latest = self._latest, None
                if fields is None:
                    return
            try:
                with replacing_binary(self._path) as file:  # not synced: after a power cut nobody asks how it was
                    file.write(to_line(fields))
                self._failed = False
            except OSError as error:
                if not self._failed:
                    self._notice(f"{self._path}: {error.strerror or error}; the navigation goes on")
                self._failed = True


#: Exit codes: the end was asked for, or nobody asked for it. (2 is that of everything that prevents the start.)
ORDERED, UNASKED = 0, 1
_STDOUT = 1


def run(vehicle: Vehicle, options: Options, service: "Service") -> int:
    """Navigate by the lines that arrive until they end or a signal comes.

    Parameters
    ----------
    vehicle : Vehicle
    options : Options
    service : Service

    Returns
    -------
    int
        `ORDERED`, or `UNASKED` when the input failed, or ended before its first reading.

    Raises
    ------
    ValueError
        When the log or the snapshot cannot be used.
    OSError
        When the log cannot be opened or the address cannot be listened on.
    """
    stop, supervision = StopSignal(), Supervision(service.health, service.say)
    try:
        with stop.at_once():
            live = _Run(vehicle, options, service, stop, supervision)
            live.open()
        code = live.loop()
        supervision.ended("stopped" if code == ORDERED else "failed")
        return code
    except Stopped:
        service.say("stopped before the navigation began; log and snapshot are as they were")
        supervision.ended("stopped")
        return ORDERED
    finally:
        supervision.ended("failed")  # unless it has been told already
        stop.restore()


class _Run:
    """One run: the session and everything that is open around it."""

    #: Without a reading for so long the operator is told [s].
    SILENT_S = 5.0

    def __init__(
        self, vehicle: Vehicle, options: Options, service: "Service", stop: StopSignal, supervision: Supervision
    ) -> None:
        self._vehicle, self._options, self._service = vehicle, options, service
        self._stop, self._supervision = stop, supervision
        self._muted = self._output_gone = False
        self.errors = self._readings = 0
        self._heard = time.monotonic()
        self._stated: float | None = None
        self._client = ""
        supervision.starting("compiling, or loading what has been compiled")
        self._outlet = Outlet(None if isinstance(service.input, tuple) else _STDOUT)
        self._parser, self._lines, self._tally = LineParser(vehicle), Lines(), Tally()
        log = self._open_log()
        warm(service.say, vehicle)
        resumed = self._resume(None if log is None or service.log is None else service.log / LOG_FILE)
        self._disk = Disk(log, service.state, service.fsync_s, self._notice, self._remade)
        self._outlet.follow(self._disk.behind)
        self._disk.append(run_note(options, **({"resumed": True} if resumed else {})))
        if resumed is not None:
            self._session.feed(Note("run", options.to_json(), b""))
            self._tell("resume", time_s=self._session.nav and self._session.nav.time_s, **resumed)
        self._source: FileSource | TcpSource | NoSource
        self._instruments = [Instrument(source, stop.wake) for source in service.sources]

    def open(self) -> None:
        """Begin to listen, or to read."""
        service = self._service
        if isinstance(service.input, tuple):
            self._source = TcpSource(service.input, self._stop, self._client_changed, service.silent_s)
            service.say(f"listening on {self._source.url}")
        else:
            self._source = NoSource(self._stop) if service.input is None else FileSource(service.input, self._stop)
        for instrument in self._instruments:
            instrument.start()
        self._supervision.ready()

    # ---------------------------------------------------------------- what goes out
    def _emit(self, line: bytes, is_state: bool) -> None:
        if not self._muted:
            self._stated = time.monotonic() if is_state else self._stated
            self._outlet.put(line, is_state, self._disk.appended)

    def _log_note(self, line: bytes) -> None:
        if not self._muted:
            self._disk.append(line)

    def _tell(self, event: str, **fields: Any) -> None:
        self._outlet.put(event_line(event, **fields), False)

    def _notice(self, what: str, **fields: Any) -> None:
        """What is no consequence of the readings: it does not come again when the log is fed again."""
        self._tell("notice", what=what, **fields)
        self._service.say(f"{what}: {fields.get('text', fields)}")

    def _client_changed(self, client: Client | None, text: str) -> None:
        if client is None:
            self._outlet.drain(1.0)
        self._client = "" if client is None else client.name
        self._outlet.attach(None if client is None else client.connection)
        self._notice("client", text=text)

    # ---------------------------------------------------------------- log and resuming
    def _open_log(self) -> BinaryIO | None:
        service = self._service
        if service.log is None:
            return None
        try:
            return prepare_log(
                service.log,
                self._vehicle,
                self._options,
                resume=service.resume,
                tell=lambda text: self._notice("resume", text=text),
            )
        except OSError as error:
            if service.resume != "best":
                raise
            what = f"{error.filename or service.log}: {error.strerror or error}"
            self._notice("disk-failed", text=f"{what}; navigating without a log")
            return None

    def _remade(self, old: BinaryIO) -> BinaryIO:
        assert self._service.log is not None  # only asked of a log
        return remade_log(old, self._service.log, self._vehicle, self._options)

    def _resume(self, log: Path | None) -> dict[str, Any] | None:
        """Make the session, and bring it to where an earlier run was; says from what."""
        service = self._service
        past = earlier_run(
            lambda how: Session(self._vehicle, how, self._emit, self._log_note),
            self._options,
            service.state,
            log,
            service.resume,
            lambda text: self._notice("resume", text=text),
        )
        self._session = past.session
        if not past.snapshot and past.offset is None:
            return None
        readings = 0
        if log is not None and past.offset is not None:
            service.say("resuming ...")
            readings = self._catch_up(log_items(log, self._vehicle, past.offset))
        return {"snapshot": past.snapshot, "readings_from_log": readings}

    def _catch_up(self, items: Iterator[Item]) -> int:
        """What the log holds after the snapshot; its output was given already."""
        self._muted, count = True, 0
        try:
            for item in items:
                self._guarded(item)
                count += 1
                if count % 10_000 == 0:
                    self._supervision.starting(f"resuming: {count} lines of the log")
        except OSError as error:
            if self._service.resume != "best":
                raise
            self._notice("resume", text=f"the log cannot be read to its end: {error.strerror or error}")
        self._muted = False
        return count

    # ---------------------------------------------------------------- the loop
    def loop(self) -> int:
        """Until the end of the input or a signal; the exit code."""
        try:
            code = self._rounds()
        except Exception as error:  # whatever it is, log and last snapshot are written
            self._notice("failed", text=f"{type(error).__name__}: {error}")
            code = UNASKED
        self._end()
        return code

    def _rounds(self) -> int:
        now = time.monotonic()
        tend_at, snapshot_at, self._heard, silent = now, now + self._service.snapshot_s, now, False
        read_at = now
        while not self._stop.received:
            if now >= tend_at:
                self._tend(now)
                tend_at = now + self._supervision.period_s
            try:
                data = self._source.read(max(0.0, min(tend_at, snapshot_at) - now))
            except OSError as error:
                self._notice("input-failed", text=f"{error.strerror or error}")
                return UNASKED
            now = time.monotonic()
            if data is None:
                self._take(self._lines.end())
                return ORDERED if self._read_anything() else UNASKED
            spoken = self._hear_instruments()
            read = bool(data) and self._take(self._lines.feed(data))
            if read:
                self._source.heard()
            if data or spoken:
                self._heard = now
            if read or spoken:
                read_at, silent = now, False
            elif now - read_at > self.SILENT_S and not silent:
                silent = True
                what = "no reading among the lines" if self._heard > read_at else "no line"
                self._notice("input-silent", text=f"{what} for {self.SILENT_S:.0f} s")
            if now >= snapshot_at:
                self._snapshot()
                snapshot_at = now + self._service.snapshot_s
        return ORDERED

    def _read_anything(self) -> bool:
        if self._readings or self._session.nav is not None:
            return True
        bad = sum(self._session.bad.values())
        found = f"not one of its {bad} lines was one" if bad else "it had no line"
        self._notice("input-empty", text=f"the input ended before its first reading: {found}")
        return False

    def _hear_instruments(self) -> bool:
        """Take what the instruments have sent; whether there was anything."""
        spoken = False
        for instrument in self._instruments:
            readings, told = instrument.take()
            for text in told:
                self._notice("source", text=text)
            spoken = self._take((line.rstrip(b"\n"), False) for line in readings) or spoken
        return spoken

    def _take(self, lines: Iterable[tuple[bytes, bool]]) -> bool:
        """Log a block of lines, then navigate with them; whether there was a reading among them."""
        parsed = (self._parser.too_long(line) if cut_off else self._parser.parse(line) for line, cut_off in lines)
        items = list(self._tally.take(item for item in parsed if item is not None))
        self._disk.append(b"".join(item.raw for item in items))
        before = self._readings
        for item in items:
            self._readings += isinstance(item, Reading)
            self._guarded(item)
        return self._readings > before

    def _guarded(self, item: Item) -> None:
        """A mistake in this program must not end the navigation under way: it is told, and the next line is taken."""
        try:
            self._session.feed(item)
        except Exception as error:
            sensor = item.sensor if isinstance(item, Reading) else type(item).__name__
            self._mistake(error, sensor)

    def _mistake(self, error: Exception, where: str) -> None:
        self.errors += 1
        if self.errors <= 10 or self.errors % 1000 == 0:
            self._notice("internal-error", text=f"{type(error).__name__}: {error} ({where})", count=self.errors)

    def _snapshot(self) -> None:
        if self._service.state is None:
            return
        try:
            taken = self._session.snapshot()
        except Exception as error:
            self._mistake(error, "snapshot")
            return
        if taken is not None:
            self._disk.snapshot(*taken)

    def _tend(self, now: float) -> None:
        """Once a second: what has been gathered, and word to those that watch."""
        items = self._tally.due()
        self._disk.append(b"".join(item.raw for item in items))
        for item in items:
            self._guarded(item)
        if self._outlet.gone and not self._output_gone:
            self._output_gone = True
            self._service.say("the reader of the output has gone; the navigation goes on")
        if self._stop.hung_up:
            self._stop.hung_up = False
            self._notice("hang-up", text="SIGHUP; the navigation goes on (SIGTERM ends it)")
        nav = self._session.nav
        self._supervision.report(
            "waiting" if nav is None else "navigating",
            time_s=None if nav is None else nav.time_s,
            input_age_s=now - self._heard,
            state_age_s=None if self._stated is None else now - self._stated,
            readings=self._readings,
            bad_lines=sum(self._session.bad.values()),
            client=self._client,
            output_dropped=self._outlet.dropped,
            output_gone=self._outlet.gone,
            disk_troubles=self._disk.troubles,
            lost_log_lines=self._disk.lost_lines,
            failed_snapshots=self._disk.failed_snapshots,
            snapshot_age_s=None if self._disk.snapshot_at is None else now - self._disk.snapshot_at,
            internal_errors=self.errors,
        )

    def _end(self) -> None:
        items = self._tally.due()
        self._disk.append(b"".join(item.raw for item in items) + event_line("stop"))
        for item in (*items, Note("stop", {}, b"")):
            self._guarded(item)
        self._snapshot()
        if not self._disk.close():
            self._notice("disk-failed", text="the disk does not come to an end")
        if not self._outlet.close():
            self._service.say("the reader of the output has gone or stopped reading; its last lines are lost")
        for instrument in self._instruments:
            instrument.close()
        self._source.close()


class Tally:
    """Passes items on; gathers bad lines that are not quoted any more until the next reading, or until `due` is called.

    So there is at most one note of each kind between two readings, however much noise there is, and where it stands
    follows from the lines alone. Without readings `due` is to be called once a second.
    """

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}

    def take(self, items: Iterable[Item]) -> Iterator[Item]:
        """The items, with one note for many bad lines."""
        for item in items:
            if isinstance(item, BadLine) and not item.text:
                self._counts[item.kind] = self._counts.get(item.kind, 0) + item.lines
            else:
                yield from self.due()
                yield item

    def due(self) -> list[Item]:
        """What has been gathered."""
        counts, self._counts = self._counts, {}
        return [BadLine.several(kind, count) for kind, count in counts.items()]


def replay_log(vehicle: Vehicle, folder: Path, *, rate_hz: float | None, say: Callable[[str], None]) -> int:
    """Feed a log again: the output of the run that wrote it, bit for bit.

    Parameters
    ----------
    vehicle : Vehicle
    folder : Path
    rate_hz : float, optional
        Another rate of states than that of the run.
    say : callable
        Takes a line for the operator.

    Returns
    -------
    int
        0; 1 when the reader of the output has gone before its end.
    """
    path = folder / LOG_FILE
    options = logged_options(path)
    stop = StopSignal()
    outlet = Outlet(_STDOUT, wait=True)
    try:
        with stop.at_once():
            warm(say, vehicle)
            session, last = Session(vehicle, options, outlet.put), None
            for last in log_items(path, vehicle):
                if rate_hz is not None and isinstance(last, Note) and last.event == "run":
                    last = last._replace(fields={**last.fields, "rate_hz": rate_hz})
                try:
                    session.feed(last)
                except Exception as error:  # as in the run itself
                    say(f"internal-error: {type(error).__name__}: {error}")
                if outlet.gone:
                    return 1
            if not (isinstance(last, Note) and last.event == "stop"):
                session.stop()
            return int(not outlet.close())
    except Stopped:
        outlet.close(0.5)
        return 0
    finally:
        stop.restore()


# --- what an earlier run left ----------------------------------------------------------------------------------------


class Past(NamedTuple):
    """What an earlier run left.

    Parameters
    ----------
    session : Session
        As its snapshot had it, or a new one.
    snapshot : bool
        Whether there was a snapshot.
    offset : int or None
        Byte of the log at which the feeding begins; None where there is nothing to feed.
    """

    session: Session
    snapshot: bool
    offset: int | None


def earlier_run(
    make: Callable[[Options], Session],
    options: Options,
    state: Path | None,
    log: Path | None,
    policy: str | None,
    tell: Callable[[str], None],
) -> Past:
    """Find what an earlier run left.

    Parameters
    ----------
    make : callable
        Makes a session.
    options : Options
        Of the present run; a log is fed with its own.
    state, log : Path, optional
        Files of the snapshot and of the log, as far as they are in use.
    policy : {"strict", "best"}, optional
        None: this is a new run.
    tell : callable
        Takes a sentence about what does not fit.

    Raises
    ------
    ValueError
        When something does not fit and the policy is "strict".
    """
    size = 0 if log is None else log.stat().st_size
    if policy is None:
        return Past(make(options), False, None)
    if state is not None:
        try:
            session = make(options)
            place = _restored(session, state)
            return Past(session, True, _checked_place(place, size, state, policy, tell) if log is not None else None)
        except FileNotFoundError:
            pass
        except Exception as error:  # nobody can say what a damaged file does
            if policy == "strict":
                raise
            tell(f"the snapshot is refused: {error}")
            with contextlib.suppress(OSError):
                if state.is_file():
                    state.replace(state.with_name(state.name + ".refused"))
    if log is None or not size:
        return Past(make(options), False, None)
    try:
        options = logged_options(log)
    except ValueError as error:
        if policy == "strict":
            raise
        tell(f"{error} What can be read is fed with the options of this run")
    return Past(make(options), False, 0)


def _restored(session: Session, state: Path) -> int | None:
    """Bring a session to its snapshot; how much of the log was in it."""
    saved, nav, place = StateFile.read(state)
    session.restore(saved, nav)
    return place


def _checked_place(place: int | None, size: int, state: Path, policy: str, tell: Callable[[str], None]) -> int | None:
    """Where the feeding of a log begins."""
    if place is None or place <= size:
        return place
    if policy == "strict":
        raise ValueError(f"the log is shorter than when the snapshot {state} was taken: it belongs to another run.")
    tell("the log is shorter than when the snapshot was taken: going on from the snapshot, the log lacks readings")
    return None


# --- how a run is set up ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Service:
    """How a run is set up, beside what decides its output (`Options`).

    Parameters
    ----------
    input : int or (str, int) or None
        File descriptor, or host and port to listen on; None: only the sources.
    sources : tuple of WaterLinked
        Instruments to connect to.
    silent_s : float
        A client without a reading for so long [s] loses its place to one that comes.
    log : Path, optional
        Folder of the log.
    fsync_s : float
        The log is synced so often [s].
    state : Path, optional
        File of the snapshots.
    snapshot_s : float
        One every so many seconds.
    resume : {"strict", "best"}, optional
        Continue from the snapshot and the log, and what to do when they do not fit (see `navfilter.service.loop`).
    health : Path, optional
        State file for others.
    say : callable
        Takes a line for the operator; must neither wait nor raise.
    """

    input: int | tuple[str, int] | None
    sources: tuple[WaterLinked, ...] = ()
    silent_s: float = 10.0
    log: Path | None = None
    fsync_s: float = 1.0
    state: Path | None = None
    snapshot_s: float = 10.0
    resume: str | None = None
    health: Path | None = None
    say: Callable[[str], None] = lambda text: None
