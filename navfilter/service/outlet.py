"""The output of a run: a bounded queue with a thread of its own, so that a slow reader never keeps the navigator waiting."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections import deque

from navfilter.service.protocol import event_line

__all__ = ["Outlet"]


class Outlet:
    """Lines on their way out.

    Parameters
    ----------
    handle : int, optional
        File descriptor to write to; a socket can take its place later (`attach`).
    longest : int
        Lines that may wait; beyond them the oldest states are dropped and counted, events only when there is nothing else.
    wait : bool
        Wait for the reader instead of dropping: for a log that is fed again there is no hurry.
    """

    #: Lines that are written in one go.
    AT_ONCE = 64

    def __init__(self, handle: int | None, *, longest: int = 4096, wait: bool = False) -> None:
        self._handle, self._longest, self._wait = handle, longest, wait
        self._socket: socket.socket | None = None
        self._queue: deque[tuple[bytes, bool]] = deque()
        self.dropped = self._told = 0
        self._closing = self._busy = False
        self.gone = False
        self._progress = time.monotonic()
        self._condition = threading.Condition()
        self._thread = threading.Thread(target=self._work, name="navfilter-output", daemon=True)
        self._thread.start()

    def put(self, line: bytes, is_state: bool) -> None:
        """Add a line; returns at once unless this outlet waits."""
        with self._condition:
            if self.gone:
                return
            while self._wait and len(self._queue) >= self._longest and not self._closing and not self.gone:
                self._condition.wait()
            if len(self._queue) >= self._longest:
                self._drop()
            self._queue.append((line, is_state))
            self._condition.notify_all()

    def _drop(self) -> None:
        self.dropped += 1
        for k, (_, is_state) in enumerate(self._queue):
            if is_state:
                del self._queue[k]
                return
        self._queue.popleft()

    def attach(self, client: socket.socket | None) -> None:
        """Write to this client from now on, or to nobody."""
        with self._condition:
            self._socket = client
            self._condition.notify_all()

    def close(self, patience_s: float = 5.0) -> bool:
        """Write what waits and end; False when the reader has not taken a line for so long."""
        with self._condition:
            self._closing = True
            self._condition.notify_all()
        return self.drain(patience_s)

    def drain(self, patience_s: float) -> bool:
        """Wait until everything is written; False when the reader has not taken a line for so long."""
        with self._condition:
            self._progress = time.monotonic()
            while (self._queue or self._busy) and not self.gone and (self._handle is not None or self._socket is not None):
                left = self._progress + patience_s - time.monotonic()
                if left <= 0.0:
                    return False
                self._condition.wait(left)
        return True

    # ---------------------------------------------------------------- the thread
    def _work(self) -> None:
        while True:
            with self._condition:
                while not self._queue or (self._handle is None and self._socket is None):
                    self._condition.wait()
                lines = [self._queue.popleft()[0] for _ in range(min(self.AT_ONCE, len(self._queue)))]
                if self.dropped > self._told:
                    lines.insert(0, event_line("notice", what="output-dropped", lines=self.dropped))
                    self._told = self.dropped
                client, self._busy = self._socket, True
            whole = self._send(b"".join(lines), client)
            with self._condition:
                self._busy, self._progress = False, time.monotonic()
                if not whole and client is None:
                    self.gone = True
                    self._queue.clear()
                elif not whole and self._socket is client:
                    self._socket = None  # the loop will notice that this client has gone
                self._condition.notify_all()

    def _send(self, data: bytes, client: socket.socket | None) -> bool:
        try:
            if client is not None:
                client.sendall(data)
                return True
            if self._handle is None:
                return False
            view = memoryview(data)
            while view:
                view = view[os.write(self._handle, view) :]
            return True
        except OSError:
            return False
