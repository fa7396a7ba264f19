"""Learning beside the navigation: what a hop learns from is fixed when it begins, its answer is taken at a reading
fixed in advance, and between the two a thread of its own works on it. So the result is the same at any speed.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from navfilter.models.health import LearningHealth


class _ShortTurns:
    """While it is entered, Python threads take turns after `TURN_S`, so that nobody waits long for this one."""

    #: A fifth of what the vehicle's loop may take [s]; Python's own turns are 5 ms.
    TURN_S = 0.0002

    def __init__(self) -> None:
        self._lock, self._inside, self._usual_s = threading.Lock(), 0, 0.0

    def forked(self) -> None:
        """In a forked process: the thread that was inside, or held the lock, is not there."""
        if self._inside:
            sys.setswitchinterval(self._usual_s)
        self._lock, self._inside = threading.Lock(), 0

    def __enter__(self) -> None:
        with self._lock:
            if not self._inside:
                self._usual_s = sys.getswitchinterval()
                sys.setswitchinterval(min(self._usual_s, self.TURN_S))
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if not self._inside:
                sys.setswitchinterval(self._usual_s)


_short_turns = _ShortTurns()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_short_turns.forked)


class Task:
    """A piece of work, and its answer: the same one however often it is asked for.

    Parameters
    ----------
    worker : Worker
    work : callable
    """

    def __init__(self, worker: Worker, work: Callable[[], Any]) -> None:
        self._worker, self._work = worker, work
        self._answer: list[Any] = []
        self._future, self._process = worker.begin(self._done), os.getpid()

    def _done(self) -> None:
        self._answer.append(self._work())

    def answer(self) -> Any:
        """What came out; waits for it where it is late."""
        if not self._answer:
            began = time.perf_counter()
            if self._future is None or self._process != os.getpid():  # a fork has no thread that would do it
                self._done()
            else:
                self._future.result()
            if self._worker.threads:
                self._worker.note(time.perf_counter() - began)
        return self._answer[0]


class Worker:
    """One thread that works on what it is given, in order; without threads the work is done when its answer is taken.

    Parameters
    ----------
    threads : bool

    Attributes
    ----------
    waiting : list of callable
        What is to be done behind one of the next readings, one behind each: together it would keep one waiting.
    """

    def __init__(self, threads: bool) -> None:
        self.threads, self._late, self._waited_s = threads, 0, 0.0
        self.waiting: list[Callable[[], object]] = []
        self._pool: ThreadPoolExecutor | None = None
        self._process = 0

    @property
    def health(self) -> LearningHealth:
        """Answers that had to be waited for: the machine is too slow for what it learns, or is fed faster than real
        time.
        """
        return LearningHealth(self._late, self._waited_s)

    def later(self, work: Callable[[], object]) -> None:
        """Have it done by `turn`; without threads there is nobody to be told anything."""
        if self.threads:
            self.waiting.append(work)

    def turn(self) -> None:
        """Behind a reading: do the next of what waits."""
        if self.waiting:
            self.waiting.pop(0)()

    def begin(self, work: Callable[[], None]) -> Future[Any] | None:
        """Have the thread do it; None without threads."""
        if not self.threads:
            return None
        if self._pool is None or self._process != os.getpid():
            self._process = os.getpid()
            self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="navfilter-learning")
        return self._pool.submit(self._run, work)

    def _run(self, work: Callable[[], None]) -> None:
        with _short_turns:
            work()

    def start(self) -> None:
        """Have the thread ready: making one takes milliseconds."""
        self.begin(lambda: None)

    def note(self, waited_s: float) -> None:
        """An answer was late."""
        self._late, self._waited_s = self._late + 1, self._waited_s + waited_s
