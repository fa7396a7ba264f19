"""Instruments on the network that ``navfilter run`` connects to: each is read by a thread of its own, which connects
again and again, and never keeps the navigation waiting.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections import deque
from collections.abc import Callable

from navfilter.foundation.display import counted
from navfilter.service.protocol import Lines
from navfilter.service.sources import BLOCK, keep_alive
from navfilter.service.waterlinked import WaterLinked


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

    def __init__(self, source: WaterLinked, wake: Callable[[], None]) -> None:
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
