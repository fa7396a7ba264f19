"""The first use of the kernels: what is compiled is shown, and it is no more than a vehicle needs."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from feeding import events_of, one_by_one
from numba.core.types.functions import BaseFunction

import navfilter as nf
from navfilter.kernels import batch, kalman
from navfilter.kernels.compiling import addresses, progress
from navfilter.kernels.compiling.type_cache import calls_remembered
from navfilter.simulation.scenarios import simulate_scenario
from navfilter.simulation.simulate import tiny_mission

COMPILE = """
import sys
import navfilter.kernels.compiling.progress as compilation
import numba
sys.stderr.isatty = lambda: {terminal}
compilation._EVERY_S = 0.0
compilation.show_compilation()
compilation.show_compilation()
def {name}(x):
    return x + 1
compilation.expect(1)
for name in ("{name}", "other"):
    {name}.__module__ = "navfilter.kernels.example" if name == "{name}" else "elsewhere"
    numba.njit({name})(1)
"""


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled without the JIT")
@pytest.mark.parametrize("terminal", [True, False])
def test_what_is_compiled_is_said(terminal):
    run = subprocess.run(
        [sys.executable, "-c", COMPILE.format(terminal=terminal, name="add")], capture_output=True, check=True
    )
    said = run.stderr.decode()
    # once each, although it was asked for twice; other packages' functions are no news
    assert said.count("now example.add ...") == 1 and "0 of at most 1 kernels in" in said
    assert ("\r" in said) == terminal and (not terminal or "1 of at most 1 kernels done" in said)


def test_how_long_it_takes_here_is_said():
    shown = progress._Shown()
    shown.most, shown.began = 100, 50.0
    left = []
    for shown.done in (5, 20, 100, 120):
        left.append(shown._left(70.0))
    assert left == ["", ", 80 s left", "", ""]


#: A copy of the package, warmed up, is all that the other user has: nothing else can be written or read.
COPY = """
import sys
from navfilter.kernels.compiling import progress
from navfilter.service.kernel_cache import make_usable
make_usable(print)
progress.show_compilation()
import navfilter as nf
from navfilter.kernels import measurement
if progress.is_compiled("strapdown"):
    nf.warm_up(nf.Vehicle(imu=nf.Imu(rate_hz=10.0), sensors={"depth": nf.Depth()}))
print(progress.is_compiled("strapdown"), progress.show_compilation().done)
"""


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled without the JIT")
@pytest.mark.parametrize("damaged", [False, True])
def test_a_copy_that_cannot_be_written_serves_every_user(tmp_path, damaged):
    """At another path, with other times of its files, for somebody whose own cache is empty."""
    nf.warm_up(nf.Vehicle(imu=nf.Imu(rate_hz=10.0), sensors={"depth": nf.Depth()}))
    package, home = tmp_path / "image" / "navfilter", tmp_path / "home"
    shutil.copytree(Path(nf.__file__).parent, package)
    kernels = package / "kernels"
    # where they are kept here, be it beside the package or not
    shutil.copytree(kalman.update._cache.cache_path, kernels / "__pycache__", dirs_exist_ok=True)
    if damaged:
        cut = min((kernels / "__pycache__").glob("kalman.*.nbi"))
        cut.write_bytes(cut.read_bytes()[:-10])
    for number, file in enumerate(sorted(kernels.glob("*.py"))):
        os.utime(file, (number, number))
    program = (
        "import numba.core.caching as c\n"  # root may write wherever nobody else may
        "def readonly(self): raise PermissionError(13, 'read-only')\n"
        "c.InTreeCacheLocator.ensure_cache_path = readonly\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "image"), "XDG_CACHE_HOME": str(home), "HOME": str(home)}
    environment.pop("NUMBA_CACHE_DIR", None)
    run = subprocess.run(
        [sys.executable, "-c", program + COPY], capture_output=True, text=True, env=environment, cwd=tmp_path
    )
    assert run.returncode == 0, run.stderr
    *said, last = run.stdout.splitlines()
    compiled, count = last.split()
    assert (compiled, count, len(said)) == (str(not damaged), "0", int(damaged))


@pytest.mark.parametrize("scenario", ["lawnmower", "reckoning", "thesis", "water-track"])
def test_a_vehicle_s_own_warm_up_hears_each_of_its_sensors(scenario):
    vehicle, _ = simulate_scenario(scenario, 1, 60.0)
    slow = next(iter(vehicle.sensors))
    vehicle = vehicle.with_error(**{slow: nf.White(sd=1e-9)})
    tiny, mission = tiny_mission(vehicle)
    assert set(tiny.sensors) == set(vehicle.sensors) and type(tiny.drive) is type(vehicle.drive)
    track = nf.replay(tiny, mission)
    heard = {name for name, sensor in tiny.sensors.items() if sensor.from_drive or track.residuals[name].count("used")}
    assert heard == set(vehicle.sensors)
    assert np.isfinite(track.covariance).all()
    nf.warm_up(vehicle)


HELPED = """
import pathlib, sys
import navfilter as nf
from navfilter.kernels.compiling import progress
from navfilter.playback import warm_up as warming
warming._cores = lambda: 2
warming._warm_filter = lambda *_: None  # what the second process does is enough
nf.warm_up(nf.Vehicle(imu=nf.Imu(rate_hz=10.0), sensors={"depth": nf.Depth(error=nf.LearnedArma())}), progress=True)
from navfilter.kernels import arma_likelihood
print(progress.show_compilation().done, sum(arma_likelihood.channel_filter.stats.cache_hits.values()))
"""


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled without the JIT")
def test_a_second_process_compiles_for_the_first(tmp_path):
    """What learns is compiled there, counted here, and loaded from the cache."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    run = subprocess.run([sys.executable, "-c", HELPED], capture_output=True, check=True, env=environment)
    done, loaded = map(int, run.stdout.split())
    assert done >= 15 and loaded == 1


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled without the JIT")
def test_what_is_compiled_ahead_is_what_a_replay_calls():
    vehicle, mission = simulate_scenario("thesis", 1, 60.0)
    nf.replay(vehicle, mission, smooth=True)
    assert batch.run_batch.signatures == [addresses.STRETCH]
    assert len(kalman.smooth_run.signatures) == 1


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled without the JIT")
def test_what_is_compiled_ahead_is_what_is_called_live():
    vehicle, mission = simulate_scenario("thesis", 1, 20.0)
    nav = nf.Navigator(vehicle, mission.start)
    one_by_one(nav, events_of(vehicle, mission))
    assert batch.correct_reading.signatures == [addresses.PROMPT]
    assert batch.propagate_sample.signatures == [addresses.SAMPLE]


def test_kernels_are_counted_but_for_those_that_are_parts_of_others():
    if not numba.config.DISABLE_JIT:
        assert progress.kernel_count("open_loop_residual") == 6


GRAM = """
import numpy as np
from navfilter.kernels import arma_fit as fit
G, x = np.zeros((3, 3)), np.arange(9.0) ** 2
fit.shift_gram(x, x[::-1].copy(), 1, G)
print(G.sum(), *(sum(kernel.stats.cache_hits.values()) for kernel in (fit.shift_gram, fit.lag_products)))
"""


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled without the JIT")
def test_a_kernel_that_was_kept_finds_one_apart_that_was_not(tmp_path):
    """Its callers know a kernel by its symbol, wherever that stands: it may have been compiled anew."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}

    def run():
        done = subprocess.run([sys.executable, "-c", GRAM], capture_output=True, check=True, env=environment)
        return done.stdout.split()

    first = run()
    kept = [path for path in tmp_path.rglob("*.nb?") if "lag_products" in path.name]
    for path in kept:
        path.unlink()
    second, third = run(), run()
    assert len(kept) == 2 and first[0] == second[0] == third[0] and float(first[0]) != 0.0
    assert [first[1:], second[1:], third[1:]] == [[b"0", b"0"], [b"1", b"0"], [b"1", b"1"]]


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled without the JIT")
def test_what_is_linked_from_the_cache_brings_what_it_calls_apart(tmp_path):
    """`turn_velocity` holds `add_turned`, which calls `mirror_rows` by its symbol. Where that was compiled by another
    process, as after a first start that was broken off, numba kept nothing of it, and the next start ended in LLVM.
    """
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    part = "consistency.add_turned.compile((addresses._TABLE, types.int64, types.int64, *(types.float64,) * 3))"
    given = "addresses._TABLE, addresses._ROW, types.UniTuple(types.float64, 3), addresses._ROW"
    whole = f"consistency.turn_velocity.compile(({given}))"
    call = "P = np.eye(12); consistency.turn_velocity(P, np.ones(17), (0.0, 0.0, 0.0), np.zeros(3)); print(P[3, 7])"
    for step in (part, whole, call):
        program = (
            f"import numpy as np; from numba import types; from navfilter.kernels import consistency; "
            f"from navfilter.kernels.compiling import addresses; {step}"
        )
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment)
        assert done.returncode == 0, done.stderr
    assert float(done.stdout) != 0.0


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="without the JIT it is an ordinary function")
def test_python_cannot_call_a_kernel_that_is_for_kernels_only():
    for kernel in (kalman._orthonormal, kalman._invert):
        with pytest.raises(TypeError, match=f"{kernel.__name__} is called by other kernels only"):
            kernel(np.eye(2))


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled without the JIT")
def test_what_is_remembered_of_calls_changes_nothing():
    def sums(x, n):
        total = 0.0
        for i in range(n):
            total += x[i] * 2 + abs(x[i]) - (i + True)
        return total

    x, plain = np.arange(5.0), numba.njit(sums)
    resolve = BaseFunction.get_call_type
    with calls_remembered():
        assert BaseFunction.get_call_type is not resolve
        quick = numba.njit(sums)
        assert quick(x, 5) == sums(x, 5) and quick(x.astype(int), 5) == sums(x, 5)
        with pytest.raises(numba.TypingError):
            quick("text", 4)
    assert BaseFunction.get_call_type is resolve
    assert plain(x, 5) == quick(x, 5)
    assert plain.overloads[plain.signatures[0]].signature == quick.overloads[quick.signatures[0]].signature


def test_with_another_numba_kernels_are_compiled_by_numba_itself(tmp_path):
    """Its insides may be others than the decorators know: the same numbers, without them."""
    program = """
import numba, numpy as np
numba.__version__ = "0.99.0"
from navfilter.kernels import kalman
from navfilter.kernels.compiling import decorators
W = np.zeros((4, 2, 2))
kalman.power(np.array([[0.9, 0.1], [0.0, 0.8]]), 0.1 * np.eye(2), 3, W)
print(decorators.KNOWN, type(kalman.power).__module__.split(".")[0], *W[0].ravel().round(12).tolist())
"""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    known, module, *power = done.stdout.split()
    assert (known, module) == ("False", "numba")
    expected = np.linalg.matrix_power([[0.9, 0.1], [0.0, 0.8]], 3).ravel().round(12).tolist()
    assert [float(value) for value in power] == expected
