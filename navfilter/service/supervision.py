"""What others see of a run: notifications for systemd, and a state file for everybody else."""

import contextlib
import os
import socket
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from navfilter.foundation.atomic_files import replacing_binary
from navfilter.service.protocol import to_line


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
