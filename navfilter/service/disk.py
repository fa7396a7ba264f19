"""The log and the snapshots of a run, written by a thread of their own: no disk keeps the navigator waiting.

The log is only ever appended to. Every block that was read goes to the operating system at once, so a killed process
loses nothing; a power cut loses what came after the last fsync. A snapshot is written beside the old one, synced and
moved over it, always after the log it refers to.
"""

from __future__ import annotations

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

from navfilter.navigation import snapshot
from navfilter.service.protocol import event_line, to_line

__all__ = ["Disk", "StateFile"]


class StateFile:
    """A snapshot on disk: lines with a checksum, the place in the log and the session, then that of the navigator."""

    MAGIC = b"navfilter-run-state 1 "

    @classmethod
    def pack(cls, session: bytes, nav: bytes, log_offset: int | None) -> bytes:
        """The bytes of the file."""
        rest = to_line({"log_offset": log_offset}) + session + nav
        return cls.MAGIC + hashlib.sha256(rest).hexdigest().encode() + b"\n" + rest

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
    """The thread that writes.

    Parameters
    ----------
    log : file, optional
        Unbuffered, to append lines to.
    state : Path, optional
        File of the snapshots.
    fsync_s : float
        The log is synced so often [s].
    notice : callable
        Is told, from the thread, of what goes wrong and when it is well again.
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
        self._queue: deque[bytes | tuple[bytes, bytes]] = deque()
        self._queued = 0
        self._lost_before = self._dirty = False
        self._troubles: dict[str, float] = {}
        self._synced = time.monotonic()
        self._closing = False
        self._condition = threading.Condition()
        self._thread = threading.Thread(target=self._work, name="navfilter-disk", daemon=True)
        self._thread.start()

    # ---------------------------------------------------------------- from the loop
    def append(self, lines: bytes) -> None:
        """Append whole lines to the log; returns at once."""
        if self._file is None or not lines:
            return
        with self._condition:
            if self._queued + len(lines) > self.LONGEST_QUEUE:
                self._lose(lines)
                return
            self._queue.append(lines)
            self._queued += len(lines)
            self._condition.notify()

    def snapshot(self, session: bytes, nav: bytes) -> None:
        """Write a snapshot that refers to the log as appended so far; returns at once."""
        with self._condition:
            # of two that wait only the later counts
            self._queue = deque(task for task in self._queue if isinstance(task, bytes))
            self._queue.append((session, nav))
            self._condition.notify()

    def close(self, patience_s: float = 30.0) -> bool:
        """Write everything, sync and end; False when the disk did not come to an end in time."""
        with self._condition:
            self._closing = True
            self._condition.notify()
        self._thread.join(patience_s)
        return not self._thread.is_alive()

    @property
    def troubles(self) -> list[str]:
        """What fails at present."""
        return list(self._troubles)

    # ---------------------------------------------------------------- the thread
    def _work(self) -> None:
        while True:
            with self._condition:
                if not self._queue and not self._closing:
                    self._condition.wait(self._fsync_s if self._dirty else None)
                tasks, self._queue, self._queued = self._queue, deque(), 0
                closing = self._closing
            try:
                self._do(tasks)
                if self._dirty and (closing or time.monotonic() - self._synced >= self._fsync_s):
                    self._sync()
            except Exception as error:  # without this thread there is no log any more
                self._lose(b"".join(task for task in tasks if isinstance(task, bytes)))
                self._trouble("writing", error)
            if closing and not self._queue:
                return

    def _do(self, tasks: deque[bytes | tuple[bytes, bytes]]) -> None:
        lines: list[bytes] = []
        for task in tasks:
            if isinstance(task, bytes):
                lines.append(task)
            else:
                self._write(b"".join(lines))
                lines.clear()
                self._save(*task)
        self._write(b"".join(lines))

    def _write(self, lines: bytes) -> None:
        if not lines or self._file is None:
            return
        data = event_line("lost") + lines if self._lost_before else lines
        view = memoryview(data)
        try:
            while view:
                view = view[self._file.write(view) or 0 :]
        except OSError as error:
            # What was written of these lines must not stand before later ones.
            with contextlib.suppress(OSError):
                os.ftruncate(self._file.fileno(), self._good)
            self._lose(lines)
            self._trouble("log", error)
            return
        self._good += len(data)
        self._dirty, self._lost_before = True, False
        self._recovered("log")

    def _lose(self, lines: bytes) -> None:
        self.lost_lines += lines.count(b"\n")
        self._lost_before = True

    def _sync(self) -> None:
        if self._file is not None:
            try:
                if self._remake is not None and os.fstat(self._file.fileno()).st_nlink == 0:
                    self._file = self._remake(self._file)
                    self._notice(
                        "log-deleted", text="the log was deleted while it was written; all of it has been written anew"
                    )
                os.fsync(self._file.fileno())
                self._recovered("fsync of the log")
            except (OSError, ValueError) as error:
                self._trouble("fsync of the log", error)
        self._dirty, self._synced = False, time.monotonic()

    def _save(self, session: bytes, nav: bytes) -> None:
        if self._state_path is None:
            return
        self._sync()
        data = StateFile.pack(session, nav, None if self._file is None else self._good)
        part = self._state_path.with_name(self._state_path.name + ".part")
        try:
            part.parent.mkdir(parents=True, exist_ok=True)
            with part.open("wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            part.replace(self._state_path)
            folder = os.open(self._state_path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
        except OSError as error:
            self.failed_snapshots += 1
            with contextlib.suppress(OSError):
                part.unlink()
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
