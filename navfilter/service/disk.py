"""The log and the snapshots of a run, written by threads of their own: no disk keeps the navigator waiting.

The log is only ever appended to. One thread hands every block that was read to the operating system at once, and
`Disk.behind` says what it has not come to yet, so that no state is published before what it rests on is written: a
killed process loses nothing that anybody has heard of. Another thread syncs, however long that takes; a power cut loses
what came after the last fsync. A snapshot is written beside the old one, synced and moved over it, always after the log
it refers to.
"""

import contextlib
import hashlib
import json
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

from navfilter.foundation.atomic_files import replacing_binary
from navfilter.navigation import snapshot
from navfilter.service.protocol import event_line, to_line


class StateFile:
    """A snapshot on disk: lines with a checksum, the place in the log and the session, then that of the navigator."""

    MAGIC = b"navfilter-run-state 1 "

    @classmethod
    def pack(cls, session: bytes, nav: bytes, log_offset: int | None) -> bytes:
        """The bytes of the file."""
        rest = to_line({"log_offset": log_offset}) + session + nav
        return cls.MAGIC + hashlib.sha256(rest).hexdigest().encode() + b"\n" + rest

    @classmethod
    def is_one(cls, path: Path) -> bool:
        """Whether a file begins like a snapshot, of whatever version."""
        with path.open("rb") as file:
            return file.read(32).startswith(b"navfilter-run-state ")

    @classmethod
    def read(cls, path: Path) -> tuple[bytes, bytes, int | None]:
        """The session, the navigator's snapshot, and how much of the log was in them.

        Raises
        ------
        ValueError
            When the file is damaged, none, or of another version.
        """
        data = snapshot.content(path)
        head, _, rest = data.partition(b"\n")
        if not head.startswith(b"navfilter-run-state "):
            raise ValueError(f"{path} is no snapshot of navfilter run. Move it away to start afresh.")
        if not head.startswith(cls.MAGIC):
            raise ValueError(
                f"{path} was written by another version ({head[:24].decode('ascii', 'replace')})."
                " Move it away to start afresh."
            )
        if hashlib.sha256(rest).hexdigest().encode() != head[len(cls.MAGIC) :]:
            raise ValueError(
                f"{path} is damaged (its checksum is wrong). Move it away, or use --resume=best:"
                " the whole log is then fed instead."
            )
        place, session, nav = rest.split(b"\n", 2)
        return session, nav, json.loads(place)["log_offset"]


class Disk:
    """The threads that write and sync.

    Parameters
    ----------
    log : file, optional
        Unbuffered, to append lines to.
    state : Path, optional
        File of the snapshots.
    fsync_s : float
        The log is synced so often [s].
    notice : callable
        Is told, from the threads, of what goes wrong and when it is well again.
    remake : callable, optional
        Writes a log that was deleted anew: takes the old file, which is still open, and returns the new one.
    """

    #: So many bytes may wait for the disk; more are counted as lost.
    LONGEST_QUEUE = 64 << 20
    #: What failed is well again when it has not failed for so long [s]: a full disk takes a little now and then.
    WELL_S = 5.0

    def __init__(
        self,
        log: BinaryIO | None,
        state: Path | None,
        fsync_s: float,
        notice: Callable[..., None],
        remake: Callable[[BinaryIO], BinaryIO] | None = None,
    ) -> None:
        self._state_path, self._fsync_s, self._notice, self._remake = state, fsync_s, notice, remake
        self.snapshot_at: float | None = None
        self.lost_lines = self.failed_snapshots = 0
        self._file: Any = log
        self._good = 0 if log is None else log.seek(0, os.SEEK_END)
        #: Lines that were handed over, and those of them that were written, or counted as lost.
        self.appended = self._settled = 0
        #: Lines, a snapshot, or how many lines were lost here.
        self._queue: deque[bytes | tuple[bytes, bytes] | int] = deque()
        self._queued = 0
        self._unsaved: tuple[bytes, bytes, int | None] | None = None
        self._lost_before = self._dirty = False
        self._troubles: dict[str, float] = {}
        self._synced = time.monotonic()
        self._closing = self._all_written = False
        lock = threading.Lock()
        self._to_write, self._to_sync, self._settling = (threading.Condition(lock) for _ in range(3))
        self._file_lock = threading.Lock()  # held while the log is written to, or exchanged for a new one
        self._threads = [
            threading.Thread(target=work, name=f"navfilter-{name}", daemon=True)
            for name, work in (("log", self._write_all), ("sync", self._sync_all))
        ]
        for thread in self._threads:
            thread.start()

    # ---------------------------------------------------------------- from the loop
    def append(self, lines: bytes) -> None:
        """Append whole lines to the log; returns at once."""
        if self._file is None or not lines:
            return
        count = lines.count(b"\n")
        with self._to_write:
            self.appended += count
            fits = self._queued + len(lines) <= self.LONGEST_QUEUE
            if fits:
                self._queue.append(lines)
                self._queued += len(lines)
            elif self._queue and isinstance(self._queue[-1], int):
                self._queue[-1] += count
            else:
                self._queue.append(count)
            self._to_write.notify()
        if not fits:
            self._lose(count, OSError("the disk takes less than arrives"))

    def behind(self, appended: int, patience_s: float) -> int:
        """How many of the first `appended` lines are not in the log yet; waits so long for the last of them [s]."""
        with self._settling:
            self._settling.wait_for(lambda: self._settled >= appended, patience_s)
            return max(0, appended - self._settled)

    def snapshot(self, session: bytes, nav: bytes) -> None:
        """Write a snapshot that refers to the log as appended so far; returns at once."""
        with self._to_write:
            # of two that wait only the later counts
            self._queue = deque(task for task in self._queue if not isinstance(task, tuple))
            self._queue.append((session, nav))
            self._to_write.notify()

    def close(self, patience_s: float = 30.0) -> bool:
        """Write everything, sync and end; False when the disk did not come to an end in time."""
        with self._to_write:
            self._closing = True
            self._to_write.notify()
        until = time.monotonic() + patience_s
        for thread in self._threads:
            thread.join(max(0.0, until - time.monotonic()))
        return not any(thread.is_alive() for thread in self._threads)

    @property
    def troubles(self) -> list[str]:
        """What fails at present."""
        return list(self._troubles)

    # ---------------------------------------------------------------- the thread that writes
    def _write_all(self) -> None:
        while True:
            with self._to_write:
                self._to_write.wait_for(lambda: self._queue or self._closing)
                tasks, self._queue, self._queued = self._queue, deque(), 0
                if not tasks:
                    self._all_written = True
                    self._to_sync.notify()
                    return
            lines: list[bytes] = []
            for task in [*tasks, 0]:
                if isinstance(task, bytes):
                    lines.append(task)
                    continue
                self._append(b"".join(lines))
                lines.clear()
                if isinstance(task, int):
                    self._lost_before |= task > 0
                    self._settle(task)
                else:
                    with self._to_sync:
                        self._unsaved = (*task, None if self._file is None else self._good)
                        self._to_sync.notify()

    def _append(self, lines: bytes) -> None:
        count = lines.count(b"\n")
        try:
            with self._file_lock:
                self._write(lines)
        except Exception as error:  # without this thread there is no log any more
            self._lost_before = True
            self._lose(count, error)
        self._settle(count)

    def _settle(self, count: int) -> None:
        with self._settling:
            self._settled += count
            self._settling.notify_all()

    def _write(self, lines: bytes) -> None:
        if not lines or self._file is None:
            return
        data = event_line("lost") + lines if self._lost_before else lines
        view = memoryview(data)
        try:
            while view:
                view = view[self._file.write(view) or 0 :]
        except OSError:
            # What was written of these lines must not stand before later ones.
            with contextlib.suppress(OSError):
                os.ftruncate(self._file.fileno(), self._good)
            raise
        self._good += len(data)
        self._lost_before = False
        if not self._dirty:
            with self._to_sync:
                self._dirty = True
                self._to_sync.notify()
        self._recovered("log")

    def _lose(self, count: int, error: Exception) -> None:
        """Count lines that the log lacks, and say so before anything that rests on them is published."""
        self.lost_lines += count
        self._trouble("log", error)

    # ---------------------------------------------------------------- the thread that syncs
    def _sync_all(self) -> None:
        while True:
            with self._to_sync:
                self._to_sync.wait_for(lambda: self._dirty or self._unsaved or self._all_written)
                left_s = self._synced + self._fsync_s - time.monotonic()
                self._to_sync.wait_for(lambda: self._unsaved or self._all_written, max(0.0, left_s))
                snapshot, self._unsaved = self._unsaved, None
                ended = self._all_written
            try:
                self._sync()
                if snapshot is not None:
                    self._save(*snapshot)
            except Exception as error:  # without this thread there are no snapshots any more
                self._trouble("syncing", error)
            if ended:
                return

    def _sync(self) -> None:
        self._dirty, file = False, self._file
        if file is not None:
            try:
                if self._remake is not None and os.fstat(file.fileno()).st_nlink == 0:
                    with self._file_lock:
                        file = self._file = self._remake(file)
                    self._notice(
                        "log-deleted", text="the log was deleted while it was written; all of it has been written anew"
                    )
                os.fsync(file.fileno())
                self._recovered("fsync of the log")
            except (OSError, ValueError) as error:
                self._trouble("fsync of the log", error)
        self._synced = time.monotonic()

    def _save(self, session: bytes, nav: bytes, log_offset: int | None) -> None:
        if self._state_path is None:
            return
        data = StateFile.pack(session, nav, log_offset)
        try:
            self._state_path.parent.mkdir(parents=True, exist_ok=True)
            with replacing_binary(self._state_path, synced=True) as file:
                file.write(data)
        except OSError as error:
            self.failed_snapshots += 1
            self._trouble("snapshot", error)
            return
        self.snapshot_at = time.monotonic()
        self._recovered("snapshot")

    def _trouble(self, what: str, error: Exception) -> None:
        """Told once, until it is well again."""
        if what not in self._troubles:
            reason = getattr(error, "strerror", None) or error
            self._notice("disk-failed", text=f"{what}: {reason}; the navigation goes on", lost_lines=self.lost_lines)
        self._troubles[what] = time.monotonic()

    def _recovered(self, what: str) -> None:
        if what in self._troubles and time.monotonic() - self._troubles[what] >= self.WELL_S:
            del self._troubles[what]
            self._notice(
                "disk-recovered", text=what, lost_lines=self.lost_lines, failed_snapshots=self.failed_snapshots
            )
