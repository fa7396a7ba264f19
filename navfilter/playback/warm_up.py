"""Kernels compiled ahead, by running tiny missions: what a vehicle needs, on two cores where there are two."""

import gc
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from navfilter.foundation.arguments import needs
from navfilter.kernels.compiling.progress import (
    FILTER,
    announce_each,
    count_announced,
    is_compiled,
    kernel_count,
    show_compilation,
)
from navfilter.kernels.compiling.type_cache import calls_remembered
from navfilter.models.error_models import GaussMarkov
from navfilter.models.learned_arma import LearnedArma
from navfilter.models.mechanisation import Imu
from navfilter.models.sensors import Depth
from navfilter.models.vehicle import Vehicle
from navfilter.navigation.navigator import Navigator
from navfilter.playback.replay import learns, replay
from navfilter.simulation.simulate import tiny_mission, tiny_missions


def warm_up(vehicle: Vehicle | None = None, progress: bool = False, *, smoother: bool = True) -> None:
    """Compile the kernels of navigator, smoother and learners by running tiny missions: once, then they are cached.

    Where nothing has been compiled yet and there is a second core, a second process compiles some of them meanwhile.

    Parameters
    ----------
    vehicle : Vehicle, optional
        Compile only what this vehicle's drive and sensors need, and leave the learners out if none of them learns.
        Default: everything.
    progress : bool
        Show on standard error what is being compiled.
    smoother : bool
        Also what only the smoother needs.

    Notes
    -----
    After it nothing is compiled under way: live, in a replay, or by the smoother if that is asked for, late readings
    and gaps included.
    """
    needs("warm_up: vehicle", vehicle, Vehicle, type(None))
    if progress:
        show_compilation()
    learning = vehicle is None or learns(vehicle)
    helper = None if is_compiled(*FILTER) or is_compiled("batch") else _Helper(learning, vehicle is None, smoother)
    with calls_remembered(), _no_collector():
        try:
            # units differ by numbers only, and the lane without one has a sensor of its own
            lanes: list[Vehicle | None] = [] if vehicle is None else list(vehicle.lanes().values())
            for single in [*lanes[:1], *lanes[1:][-1:]] or [vehicle]:
                _warm_filter(single, learning, smoother)
            if helper is not None:
                helper.wait()
        finally:
            if helper is not None:
                helper.end()
        if vehicle is None:
            _warm_reckoning(smoother)
        if learning:
            _warm_learner()


def help_warming(learning: bool, everything: bool, smoother: bool) -> None:
    """What the second process of `warm_up` does: first what the first one comes to next, when it has what corrects.

    It ends at once: nothing is to be tidied that took seconds, for all of it is in files.
    """
    announce_each()
    gc.disable()
    with calls_remembered():
        _compile_stretch()
        if learning:
            _warm_learner()
        if everything:
            _warm_reckoning(smoother)
    sys.stdout.flush()
    os._exit(0)


@contextmanager
def _no_collector() -> Iterator[None]:
    """numba makes millions of objects that all live until the end: looking for garbage takes a seventh of its time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _warm_filter(vehicle: Vehicle | None, learning: bool, smoother: bool) -> None:
    if vehicle is None:  # where some kinds are on board a replay goes reading by reading, else in stretches
        plain = Vehicle(imu=Imu(rate_hz=20.0), sensors={"depth": Depth(rate_hz=2.0)})
        replay(*tiny_mission(plain), smooth=smoother)
    tiny, mission = next(tiny_missions()) if vehicle is None else tiny_mission(vehicle)
    replay(tiny, mission, smooth=smoother)
    _ = Navigator(tiny, mission.start).health  # asks the drive for its errors by itself
    _compile_prompt()
    replay(
        tiny.without(*(name for name, sensor in tiny.sensors.items() if not sensor.from_drive)), mission
    )  # a silence
    if learning:
        learned = LearnedArma(prior=GaussMarkov(sd=0.01, tau_s=10.0))
        heard = {name: learned for name, sensor in tiny.sensors.items() if sensor.open_loop}
        replay(tiny.with_error(**heard), mission)


def _warm_reckoning(smoother: bool) -> None:
    _, (tiny, mission) = tiny_missions()
    replay(tiny, mission, smooth=smoother)


def _compile_stretch() -> None:
    """What goes through many readings at once. The smoother is left to the first process: both take as long then."""
    from numba import config

    from navfilter.kernels import batch
    from navfilter.kernels.compiling import addresses

    settings: Any = config
    if not settings.DISABLE_JIT:
        batch.run_batch.compile(addresses.STRETCH)


def _compile_prompt() -> None:
    """What takes a single reading or sample live, and what is asked now and then."""
    from numba import config

    from navfilter.kernels import batch, noise_scale, open_loop_residual
    from navfilter.kernels.compiling import addresses

    settings: Any = config
    if not settings.DISABLE_JIT:
        batch.correct_reading.compile(addresses.PROMPT)
        batch.propagate_sample.compile(addresses.SAMPLE)
        noise_scale.update_scale.compile(addresses.SCATTERED)
        open_loop_residual.judge_level.compile(addresses.LEVEL)
        batch.readmission.compile(addresses.READMISSION)


def _warm_learner() -> None:
    """A learner's first hop comes minutes into a dive: no place to compile."""
    from navfilter.learning.axis_learner import Learner
    from navfilter.learning.slow_prior import SlowPrior
    from navfilter.models.navigation_drift import Drift

    prior, described = SlowPrior(0.01, 10.0, 100.0), GaussMarkov(sd=0.01, tau_s=10.0)
    learner = Learner(LearnedArma().orders, 400, Drift((1e-3, 1e-5), 0.25), prior=prior, described=described)
    learner.hop(np.random.default_rng(1).normal(size=400))


class _Helper:
    """A second process that compiles into the same cache. Whatever becomes of it, the first one compiles the rest."""

    def __init__(self, learning: bool, everything: bool, smoother: bool) -> None:
        self._process: subprocess.Popen[str] | None = None
        if not (sys.executable and _kept() and available_cores() > 1):
            return
        from numba import config

        settings: Any = config
        program = (
            f"from navfilter.playback.warm_up import help_warming; help_warming({learning}, {everything}, {smoother})"
        )
        paths = {"PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)}
        if settings.CACHE_DIR:
            paths["NUMBA_CACHE_DIR"] = settings.CACHE_DIR
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-c", program],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                env={**os.environ, **paths},
            )
        except OSError:  # no process to be had: compiled here, one after the other
            return
        most = kernel_count()
        self._counter = threading.Thread(target=count_announced, args=(self._process.stdout, most), daemon=True)
        self._counter.start()

    def wait(self) -> None:
        if self._process is not None:
            self._process.wait()
            self._counter.join()

    def end(self) -> None:
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.wait()


def _kept() -> bool:
    """Whether what another process compiles can be found by this one."""
    from navfilter.kernels import measurement

    folder = measurement.heading.stats.cache_path if hasattr(measurement.heading, "stats") else None
    return folder is not None and os.access(folder if os.path.isdir(folder) else os.path.dirname(folder), os.W_OK)


def available_cores() -> int:
    """Processors that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on macOS and Windows
        return os.cpu_count() or 1
