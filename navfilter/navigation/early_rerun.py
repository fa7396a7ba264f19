"""The beginning done again with models that were learnt from it: by the run itself, or by a twin of it on the learning
thread, whose place the run then takes.
"""

import math
import os
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

from navfilter.filter.events import Measurement
from navfilter.filter.imu_intake import joined
from navfilter.foundation.arrays import Array
from navfilter.foundation.state_values import copied
from navfilter.learning.background import Task, Worker
from navfilter.learning.schedule import LearningMemory, RerunRequest
from navfilter.navigation.runner import Rerun, Run


class EarlyRerun:
    """Adopts the early models of a run, and does its beginning again where they are others.

    Parameters
    ----------
    nav : Run
    worker : Worker
        With threads a twin does it; the results are the same to the last bit.

    Attributes
    ----------
    twin : ShadowRun or None
        Who follows the run at present.
    """

    def __init__(self, nav: Run, worker: Worker) -> None:
        self._nav, self._worker = nav, worker
        self.twin: ShadowRun | None = None
        self._goes_back = False

    @contextmanager
    def while_going_back(self) -> Iterator[None]:
        """While a late reading is put in its place."""
        self._goes_back = True
        try:
            yield
        finally:
            self._goes_back = False

    def advance_shadow(self, item: Array | Measurement) -> None:
        """Let the twin have an input of the run, before samples are taken and after a reading has been."""
        if self._nav.learning.again is None:
            self.twin = None
        elif self.twin is not None:
            self.twin.buffer_input(item.copy() if isinstance(item, np.ndarray) else item)

    def before(self, time_s: float) -> None:
        """Before a reading of this time: do what is due by then."""
        while self._nav.learning.early_s <= time_s < math.inf:
            self._early()

    def _early(self) -> None:
        """At `LearningSchedule.early_s`: adopt what was found, or do the beginning again."""
        nav, learning = self._nav, self._nav.learning
        if learning.again is None:
            learning.early()
            # what a late reading has fed again would not reach a twin that was made on the way
            if learning.again is not None and not self._goes_back:
                self._worker.later(partial(self._follow, learning.again))
            return
        twin, self.twin = self.twin, None
        # while a late reading is put in its place the twin is ahead: it has had what came since
        here = twin is not None and not self._goes_back and twin.again == learning.again
        if twin is None or not here or twin.process != os.getpid():
            _in_place(nav, learning.again)
            return
        other = twin.arrived()
        if learning.compares and other.learning.is_worse(learning.feedback):
            learning.refuse()
        else:
            _change_places(nav, other)
        self._worker.later(partial(self._worker.begin, partial(_let_go, twin)))

    def _follow(self, again: RerunRequest) -> None:
        """Make a twin, where the beginning is still to be done again so."""
        if self.twin is None and self._nav.learning.again == again:
            self.twin = ShadowRun(self._nav, again, self._worker)


def _change_places(nav: Run, other: Run) -> None:
    """Let a run be where another one is, and that have what is left."""
    if nav.history is not None and other.history is not None:
        nav.history.change_places(other.history)
    # the whole filter, not its memory alone: its states are laid out already
    nav.filter, other.filter = other.filter, nav.filter
    nav.alternative, other.alternative = other.alternative, nav.alternative
    nav.learning.filter, before = nav.filter, nav.learning.beginning
    nav.learning.memory = other.learning.memory
    other.learning.beginning = before
    nav.change_count += 1
    for name, prompt in nav.fast_paths.items():
        prompt.exchange(other.fast_paths[name])


def _let_go(twin: "ShadowRun") -> None:
    """Free what is left of a run, on the thread.

    Its parts refer to each other, so Python's collector would come upon them in the middle of a call; and a
    `MeasurementFastPath` that has not been used since still holds its filter.
    """
    run = twin.run
    for part in (run.filter.memory, *run.filter.channels.values(), run.filter, run):
        vars(part).clear()


class ShadowRun:
    """Another run over the same inputs as `nav`, from the start with other models.

    It is given what `nav` is given, in the order in which it arrives, and works that off on the learning thread.

    Parameters
    ----------
    nav : Run
        Whose beginning is to be done again; it must have kept its inputs.
    again : RerunRequest
    worker : Worker
    """

    #: Inputs that are worked off together: each time costs a hand-over between threads. It is done at a reading, for
    #: samples are many and have less time to spare.
    TOGETHER = 16
    #: So long before it is awaited it is given each reading at once [s], so that next to nothing is left to be done.
    CLOSE_S = 0.5

    def __init__(self, nav: Run, again: RerunRequest, worker: Worker) -> None:
        self.again, self._worker, self._close_s = again, worker, nav.learning.early_s - self.CLOSE_S
        self._inputs: deque[Array | Measurement] = deque()
        learning = copied(nav.learning.memory)
        learning.beginning = learning.beginning and learning.beginning.so_far()
        self._task: Task = Task(worker, partial(_begun, nav, learning, again, nav.learning.early_s, nav.time_s))
        self._drained: Future[Any] | None = None
        #: A fork may have been made in the middle of its work, and has no thread that would end it.
        self.process = os.getpid()

    def buffer_input(self, item: Array | Measurement) -> None:
        """The next input."""
        self._inputs.append(item)
        if not isinstance(item, Measurement) or not (
            len(self._inputs) >= self.TOGETHER or item.time_s >= self._close_s
        ):
            return
        if self._drained is None or self._drained.done():
            self._drained = self._worker.begin(self._follow)

    def _follow(self) -> None:
        """On the thread: work off what there is, and have in hand what the next readings need."""
        self._drain()
        for prompt in self.run.fast_paths.values():
            prompt.is_ready()

    def _drain(self) -> None:
        while self._inputs:
            for item in joined([self._inputs.popleft() for _ in range(len(self._inputs))]):
                self.run.repeat_input(item)

    def arrived(self) -> Run:
        """The run, when it has come as far as the one it is a twin of."""
        self._task.answer()
        if self._drained is not None:
            self._drained.result()
        self._drain()
        return self.run

    @property
    def run(self) -> Run:
        """As far as it has come; waits until it has begun."""
        run: Run = self._task.answer()
        return run


def _begun(of: Run, learning: LearningMemory, again: RerunRequest, until_s: float, now_s: float) -> Run:
    """A twin of a run that has begun again."""
    history_s = 0.0 if of.history is None else of.history.length_s
    kind: Any = type(of)
    twin: Run = kind(of.vehicle, of.start, history_s=history_s, threads=False, alternative=of.alternative.wanted)
    for name, memory in learning.listeners.items():
        memory.ring = np.full_like(memory.ring, np.nan)
        if name not in twin.learning.listeners:
            twin.learning.record_residuals(name, memory.ring.shape[1])
    twin.learning.memory = learning
    _begin_again(twin, again, until_s, now_s)
    return twin


def _in_place(nav: Run, again: RerunRequest) -> None:
    """Do the beginning again with the very filter, for what runs over it goes on with it; and be again where it was if
    that is worse.
    """
    learning, until_s = nav.learning, nav.learning.early_s
    before = copied(nav.memory) if learning.compares else None
    if before is None:
        _begin_again(nav, again, until_s, until_s)
        return
    for one in (*before.learning.listeners.values(), before.learning.rest):
        if one is not None:
            one.ring = one.ring.copy()  # copies share it
    beside = [(part, vars(part).copy()) for part in (nav.history, nav.filter.tape) if part is not None]
    _begin_again(nav, again, until_s, until_s)
    if learning.is_worse(before.learning.fed_back):
        nav.memory = before
        for part, was in beside:
            vars(part).update(was)
        learning.refuse()


def _begin_again(nav: Run, again: RerunRequest, until_s: float, now_s: float) -> None:
    """Run what there was so far again, with other models; nothing is learnt from it before `until_s`."""
    nav.filter.begin(dict(again.models))
    nav.alternative.restore(None, None)
    nav.filter.counts["adopted"] = again.adopted
    inputs = nav.learning.begin_again(until_s)
    history = nav.history
    if history is None:
        Rerun(nav, inputs).run()
        return
    # the last of it goes through the history, so that late readings find their place
    history.start_here()
    before = inputs.until(now_s - history.length_s)
    Rerun(nav, inputs.first(*before)).run()
    for item in inputs.inputs(before):
        history.process(item)
