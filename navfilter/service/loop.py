"""The loop of ``navfilter run``: read a block, log it, navigate with it; snapshots between blocks; a clean end on SIGTERM and SIGINT."""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from navfilter.io.json_lines import Item, LineParser, Note, Reading
from navfilter.playback import warm_up
from navfilter.service.disk import Disk, StateFile
from navfilter.service.log import LOG_FILE, log_items, logged_options, prepare_log, run_note
from navfilter.service.outlet import Outlet
from navfilter.service.protocol import Lines, event_line
from navfilter.service.session import Options, Session
from navfilter.service.sources import Client, FileSource, StopSignal, TcpSource
from navfilter.vehicle import Vehicle

__all__ = ["Service", "replay_log", "run"]

_STDOUT = 1


@dataclass(frozen=True, kw_only=True)
class Service:
    """How a run is set up, beside what decides its output (`Options`).

    Parameters
    ----------
    input : int or (str, int)
        File descriptor, or host and port to listen on.
    log : Path, optional
        Folder of the log.
    fsync_s : float
        The log is synced so often [s].
    state : Path, optional
        File of the snapshots.
    snapshot_s : float
        One every so many seconds.
    resume : bool
        Continue from the snapshot, or from the log alone where there is no snapshot.
    say : callable
        Takes a line for the operator.
    """

    input: int | tuple[str, int]
    log: Path | None = None
    fsync_s: float = 1.0
    state: Path | None = None
    snapshot_s: float = 10.0
    resume: bool = False
    say: Callable[[str], None] = lambda text: None


def run(vehicle: Vehicle, options: Options, service: Service) -> int:
    """Navigate by the lines that arrive until they end or a signal comes.

    Parameters
    ----------
    vehicle : Vehicle
    options : Options
    service : Service

    Returns
    -------
    int
        0.

    Raises
    ------
    ValueError
        When the log or the snapshot cannot be used.
    OSError
        When the log cannot be opened or the address cannot be listened on.
    """
    stop = StopSignal()
    try:
        live = _Run(vehicle, options, service, stop)
        _warm(service.say)
        live.open()
        return live.loop()
    except _Interrupted:
        service.say("ended while it was resuming; log and snapshot are as they were")
        return os.EX_OK
    finally:
        stop.restore()


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
    """
    path = folder / LOG_FILE
    options = logged_options(path)
    stop = StopSignal()
    outlet = Outlet(_STDOUT, wait=True)
    try:
        _warm(say)
        session, last = Session(vehicle, options, outlet.put), None
        for last in log_items(path, vehicle):
            if rate_hz is not None and isinstance(last, Note) and last.event == "run":
                last = last._replace(fields={**last.fields, "rate_hz": rate_hz})
            session.feed(last)
            if stop.received or outlet.gone:
                break
        if not (isinstance(last, Note) and last.event == "stop"):
            session.stop()
        outlet.close()
    finally:
        stop.restore()
    return 0


def _warm(say: Callable[[str], None]) -> None:
    say("warming up ...")
    began = time.perf_counter()
    warm_up()
    # What is here now stays: the collector need not look at it again and again.
    gc.collect()
    gc.freeze()
    say(f"ready ({time.perf_counter() - began:.1f} s)")


class _Interrupted(Exception):
    """A signal came before everything of the log was fed again."""


class _Run:
    """One run: the session and everything that is open around it."""

    #: Without a line for so long the operator is told [s].
    SILENT_S = 5.0

    def __init__(self, vehicle: Vehicle, options: Options, service: Service, stop: StopSignal) -> None:
        self._vehicle, self._service, self._stop = vehicle, service, stop
        self._muted = False
        self._outlet = Outlet(None if isinstance(service.input, tuple) else _STDOUT)
        self._parser, self._lines = LineParser(vehicle), Lines()
        self.errors = 0
        log = None if service.log is None else prepare_log(service.log, vehicle, options, resume=service.resume)
        self._session, resumed = self._prepared(options, None if service.log is None else service.log / LOG_FILE)
        self._disk = Disk(log, service.state, service.fsync_s, self._notice)
        self._disk.append(run_note(options, **({"resumed": True} if resumed else {})))
        if resumed:
            self._session.feed(Note("run", options.to_json(), b""))
            self._tell("resume", time_s=self._session.nav and self._session.nav.time_s, **resumed)
        self._source: FileSource | TcpSource | None = None

    def open(self) -> None:
        """Begin to listen, or to read."""
        if isinstance(self._service.input, tuple):
            self._source = TcpSource(self._service.input, self._stop, self._client_changed)
            self._service.say(f"listening on {self._source.url}")
        else:
            self._source = FileSource(self._service.input, self._stop)

    def _emit(self, line: bytes, is_state: bool) -> None:
        if not self._muted:
            self._outlet.put(line, is_state)

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
        self._outlet.attach(None if client is None else client.connection)
        self._notice("client", text=text)

    # ---------------------------------------------------------------- resuming
    def _prepared(self, options: Options, path: Path | None) -> tuple[Session, dict[str, Any] | None]:
        """The session, and what it resumed from."""
        service = self._service
        log = path is not None and path.stat().st_size > 0
        saved = StateFile.read(service.state) if service.resume and service.state is not None and service.state.exists() else None
        if path is not None and log and saved is None:
            options = logged_options(path)
        session = Session(self._vehicle, options, self._emit, self._log_note)
        if saved is None and not log:
            return session, None
        offset: int | None = 0
        if saved is not None:
            session.restore(*saved[:2])
            offset = saved[2]
        readings = 0
        if path is not None and log and offset is not None:
            if offset > path.stat().st_size:
                raise ValueError(f"{path} is shorter than when the snapshot {service.state} was taken: it belongs to another run.")
            service.say("resuming ...")
            readings = self._catch_up(session, log_items(path, self._vehicle, offset))
        return session, {"snapshot": saved is not None, "readings_from_log": readings}

    def _catch_up(self, session: Session, items: Iterable[Item]) -> int:
        """What the log holds after the snapshot; its output was given already."""
        self._muted, count = True, 0
        for item in items:
            session.feed(item)
            count += 1
            if self._stop.received:
                raise _Interrupted
        self._muted = False
        return count

    # ---------------------------------------------------------------- the loop
    def loop(self) -> int:
        """Until the end of the input or a signal."""
        snapshot_at, heard, silent = time.monotonic() + self._service.snapshot_s, time.monotonic(), False
        while not self._stop.received and self._source is not None:
            data = self._source.read(min(1.0, max(0.0, snapshot_at - time.monotonic())))
            now = time.monotonic()
            if data is None:
                self._take(self._lines.end())
                break
            if data:
                self._take(self._lines.feed(data))
                heard, silent = now, False
            elif now - heard > self.SILENT_S and not silent:
                silent = True
                self._notice("input-silent", text=f"no line for {self.SILENT_S:.0f} s")
            if now >= snapshot_at:
                self._snapshot()
                snapshot_at = now + self._service.snapshot_s
        return self._end()

    def _take(self, lines: Iterable[tuple[bytes, bool]]) -> None:
        """Log a block of lines, then navigate with them."""
        items: list[Item] = []
        for line, cut_off in lines:
            item = self._parser.too_long(line) if cut_off else self._parser.parse(line)
            if item is not None:
                items.append(item)
        self._disk.append(b"".join(item.raw for item in items))
        for item in items:
            self._guarded(item)

    def _guarded(self, item: Item) -> None:
        """A mistake in this program must not end the navigation of a vehicle under way: it is told, and the next line is taken."""
        try:
            self._session.feed(item)
        except Exception as error:
            self.errors += 1
            if self.errors <= 10 or self.errors % 1000 == 0:
                sensor = item.sensor if isinstance(item, Reading) else type(item).__name__
                self._notice("internal-error", text=f"{type(error).__name__}: {error} ({sensor})", count=self.errors)

    def _snapshot(self) -> None:
        if self._service.state is None:
            return
        taken = self._session.snapshot()
        if taken is not None:
            self._disk.snapshot(*taken)

    def _end(self) -> int:
        self._disk.append(event_line("stop"))
        self._session.stop()
        self._snapshot()
        if not self._disk.close():
            self._notice("disk-failed", text="the disk does not come to an end")
        if not self._outlet.close():
            self._service.say("the reader of the output has stopped reading; its last lines are lost")
        if isinstance(self._source, TcpSource):
            self._source.close()
        return os.EX_OK
