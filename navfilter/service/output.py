"""Lines on their way out: a bounded queue with a thread of its own.

No reader keeps the navigator waiting, however slow it is, whether its disk is full or it has gone.
"""

import errno
import os
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable

from navfilter.service.protocol import event_line

#: After these nobody will ever read; everything else (a full disk, a terminal that hung up) may be well again.
_GONE = {errno.EPIPE, errno.EBADF, errno.ECONNRESET, errno.ESHUTDOWN, errno.ENOTCONN}


def _dropped(count: int) -> bytes:
    return event_line("notice", what="output-dropped", lines=count)


class Outlet:
    """Lines on their way out.

    Parameters
    ----------
    handle : int, optional
        File descriptor to write to; a socket can take its place later (`attach`).
    longest : int
        Lines that may wait; beyond them the oldest states are dropped and counted, events only when there is nothing
        else.
    wait : bool
        Wait for the reader instead of dropping: for a log that is fed again there is no hurry.
    dropped_line : callable
        The line that tells how many were dropped.
    """

    #: A line waits so long for the log to hold what it rests on [s]; then it goes out and says by how many lines it is
    #: ahead, and so do the following ones, at once, until the log has caught up.
    HOLD_S = 0.5
    #: Lines that are written in one go.
    AT_ONCE = 64
    #: An output that failed is tried again after so long [s].
    RETRY_S = 1.0

    def __init__(
        self,
        handle: int | None,
        *,
        longest: int = 4096,
        wait: bool = False,
        dropped_line: Callable[[int], bytes] = _dropped,
    ) -> None:
        self._handle, self._longest, self._wait, self._dropped_line = handle, longest, wait, dropped_line
        self._socket: socket.socket | None = None
        self._behind: Callable[[int, float], int] = lambda log_lines, patience_s: 0
        self._hold_s = self.HOLD_S
        self._queue: deque[tuple[bytes, bool, int]] = deque()
        self.dropped = self._told = 0
        self._closing = self._busy = self._torn = False
        self.gone = False
        self._progress = time.monotonic()
        self._condition = threading.Condition()
        self._thread = threading.Thread(target=self._work, name="navfilter-output", daemon=True)
        self._thread.start()

    def follow(self, behind: Callable[[int, float], int]) -> None:
        """Let lines wait for a log: ``behind(log_lines, patience_s)`` as `Disk.behind`."""
        self._behind = behind

    def put(self, line: bytes, is_state: bool, log_lines: int = 0) -> None:
        """Add a line that rests on the first so many lines of the log; returns at once unless this outlet waits."""
        with self._condition:
            if self.gone:
                return
            while self._wait and len(self._queue) >= self._longest and not self._closing and not self.gone:
                self._condition.wait()
            if len(self._queue) >= self._longest:
                self._drop()
            self._queue.append((line, is_state, log_lines))
            self._condition.notify_all()

    def _drop(self) -> None:
        self.dropped += 1
        for k, (_, is_state, _) in enumerate(self._queue):
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
        """Write what waits and end; False when the reader has not taken a line for so long, or has gone."""
        with self._condition:
            self._closing = True
            self._condition.notify_all()
        return self.drain(patience_s)

    def drain(self, patience_s: float) -> bool:
        """Wait until everything is written; False when the reader has gone, or has not taken a line for so long.

        However much it takes now and then, never longer than five times the patience.
        """
        with self._condition:
            begun = self._progress = time.monotonic()
            while (
                (self._queue or self._busy) and not self.gone and (self._handle is not None or self._socket is not None)
            ):
                left = min(self._progress + patience_s, begun + 5.0 * patience_s) - time.monotonic()
                if left <= 0.0:
                    return False
                self._condition.wait(left)
            return not self.gone

    # ---------------------------------------------------------------- the thread
    def _work(self) -> None:
        while True:
            with self._condition:
                while not self._queue or (self._handle is None and self._socket is None):
                    self._condition.wait()
                lines = [self._queue.popleft() for _ in range(min(self.AT_ONCE, len(self._queue)))]
                if self.dropped > self._told:
                    lines.insert(0, (self._dropped_line(self.dropped), False, 0))
                    self._told = self.dropped
                client, self._busy = self._socket, True
            written, error = self._send([self._told_ahead(line, log_lines) for line, _, log_lines in lines], client)
            with self._condition:
                self._busy = False
                self._progress = time.monotonic() if written else self._progress
                if error is not None:
                    self._failed(lines[written:], client, error)
                self._condition.notify_all()

    def _failed(self, lines: list[tuple[bytes, bool, int]], client: socket.socket | None, error: OSError) -> None:
        """What to do with lines that did not go out."""
        if client is not None:
            self.dropped += len(lines)
            if self._socket is client:
                self._socket = None  # the loop will notice that this client has gone
        elif error.errno in _GONE or self._closing:
            self.gone = True
            self._queue.clear()
        else:
            self._queue.extendleft(reversed(lines))
            while len(self._queue) > self._longest:
                self._drop()
            self._condition.wait_for(lambda: self._closing, self.RETRY_S)

    def _told_ahead(self, line: bytes, log_lines: int) -> bytes:
        """A line once the log holds what it rests on; or, where that takes too long, with a word of it."""
        ahead = self._behind(log_lines, self._hold_s)
        self._hold_s = 0.0 if ahead else self.HOLD_S
        return line[:-2] + b',"ahead_of_log":%d}\n' % ahead if ahead else line

    def _send(self, lines: list[bytes], client: socket.socket | None) -> tuple[int, OSError | None]:
        """How many whole lines went out, and what ended it."""
        data = b"".join(lines)
        if client is not None:
            try:
                client.sendall(data)
            except OSError as error:
                return 0, error
            return len(lines), None
        begin = b"\n" if self._torn else b""
        sent, failure = self._write(begin + data)
        if failure is None:
            self._torn = False
            return len(lines), None
        sent, written = sent - len(begin), 0
        for line in lines:
            if sent < len(line):
                break
            sent, written = sent - len(line), written + 1
        if sent >= 0:  # -1: not even the line feed that ends the half line before
            self._torn = sent > 0
        return written, failure

    def _write(self, data: bytes) -> tuple[int, OSError | None]:
        """Bytes that went out, and what ended it; a handle that does not block is waited for.

        A pipe takes so many bytes whole or not at all: no line is torn when the run ends while its reader sleeps.
        """
        sent = 0
        while sent < len(data) and self._handle is not None:
            lines = data.rfind(b"\n", sent, sent + select.PIPE_BUF) + 1 - sent
            try:
                sent += os.write(self._handle, data[sent : sent + (lines if lines > 0 else 65536)])
            except BlockingIOError:
                select.select([], [self._handle], [])
            except OSError as error:
                return sent, error
        return sent, None
