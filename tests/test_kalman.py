"""Properties of the filter kernels that the twins do not show: definiteness, invariance, and one compiled signature each."""

import json
import os
import subprocess
import sys

import numba
import numpy as np
import pytest
from test_kernels_twins import random_nav, spd

from navfilter.kernels import kalman


def correction(P, H, R, res, nav):
    n, a = len(P), len(res)
    S, PH, K, out, turn = np.zeros((2 * a, a)), np.zeros((a, n)), np.zeros((n, a)), np.zeros(2), np.zeros(3)
    x = np.zeros(n - 9)
    kalman.innovation(P, H, res, R, S, PH, out)
    kalman.correct(P, nav, x, res, S, PH, K, turn)
    return x, out, turn


@pytest.mark.parametrize("white", [1e-12, 1.0, 1e12])
def test_correction_keeps_the_covariance_positive(white):
    """Ill-conditioned on purpose: readings a million times better, and worse, than the state."""
    rng = np.random.default_rng(0)
    P, nav = spd(rng, 14), random_nav(rng)
    for _ in range(500):
        H = rng.normal(size=(3, 14))
        correction(P, H, white * np.eye(3), 1e-3 * rng.normal(size=3), nav)
        P += 1e-3 * np.eye(14)
    assert np.isfinite(P).all() and np.array_equal(P, P.T)
    # Joseph's form with the gain as rounded loses at most rounding against the noise added each time.
    assert np.linalg.eigvalsh(P).min() > 0.5e-3 * min(1.0, white / 1e-3)


def test_components_one_by_one_are_the_components_together():
    rng = np.random.default_rng(1)
    P0, H, R, res = spd(rng, 12), rng.normal(size=(3, 12)), np.diag([0.1, 0.2, 0.3]), 1e-6 * rng.normal(size=3)
    together, nav = P0.copy(), random_nav(rng)
    _, out, _ = correction(together, H.copy(), R, res.copy(), nav.copy())
    single, total, moved = P0.copy(), 0.0, np.zeros(12)
    for i in range(3):
        n = nav.copy()
        before = res[i : i + 1] - H[i] @ moved
        x, part, turn = correction(single, H[i : i + 1].copy(), R[i : i + 1, i : i + 1].copy(), before, n)
        total += part[0]
        moved += np.concatenate(
            [[(n[0] - nav[0]) * nav[15], (n[1] - nav[1]) * nav[16] * np.cos(nav[0]), nav[2] - n[2]], n[3:6] - nav[3:6], turn, x]
        )
    # residuals of 1e-6, so that the reset of the attitude (second order, 1e-6 relative) does not tell the two apart; metres from radians
    # round at 1e-9
    np.testing.assert_allclose(single, together, atol=1e-5)
    assert total == pytest.approx(out[0], rel=2e-3)


def test_power_is_exact_for_a_long_silence():
    phi, q = 0.999, 0.01
    W = np.zeros((4, 1, 1))
    kalman.power(np.array([[phi]]), np.array([[q]]), 100_000, W)
    assert W[0, 0, 0] == pytest.approx(phi**100_000, rel=1e-9, abs=1e-40)
    assert W[1, 0, 0] == pytest.approx(q * (1.0 - phi**200_000) / (1.0 - phi**2), rel=1e-10)


RUN = """
import importlib, json, pathlib
import numpy as np
import navfilter as nf
from navfilter import kernels
from navfilter.simulation.scenarios import simulate_scenario

nf.warm_up()
after = {}
def signatures():
    found = {}
    for path in pathlib.Path(kernels.__file__).parent.glob("*.py"):
        if path.stem in ("strapdown", "measurement", "kalman"):
            module = importlib.import_module(f"navfilter.kernels.{path.stem}")
            for name, kernel in vars(module).items():
                # private kernels are compiled into their callers, and a literal 0 may be typed apart from a variable there
                if hasattr(kernel, "signatures") and not name.startswith("_"):
                    found[f"{path.stem}.{name}"] = len(kernel.signatures)
    return found
warm = signatures()
for name in ("lawnmower", "reckoning", "thesis"):
    vehicle, mission = simulate_scenario(name, seed=1, duration_s=120.0)
    track = nf.replay(vehicle, mission, smooth=True)
    track.summary(mission.truth)
    nav = nf.Navigator(vehicle, mission.start)
    if "imu" in mission.streams:
        imu = mission.streams["imu"]
        for k in range(50):
            nav.step(imu.time_s[k], imu.value[k, :3], imu.value[k, 3:])
    else:
        nav.step(0.25, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    for sensor in vehicle.sensors:
        stream = mission.streams[sensor]
        nav.correct(sensor, nav.time_s, stream.value[0])
        nav.correct(sensor, nav.time_s + 0.01, np.asfortranarray(stream.value)[0][::1].tolist(), sd=0.1)
        nav.correct(sensor, nav.time_s + 0.02, np.repeat(stream.value[0], 2)[::2], sd=np.ones(vehicle.sensors[sensor].axes))
    nav.state.plus(np.zeros(9)).minus(nav.state)
print(json.dumps([warm, signatures()]))
"""


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled without the JIT")
def test_each_kernel_is_compiled_once_and_warm_up_compiles_all_that_runs():
    """A second signature (a slice, a Fortran order, a read-only array) would be a pause of seconds on a vehicle."""
    done = subprocess.run(
        [sys.executable, "-c", RUN], capture_output=True, text=True, env={**os.environ, "NUMBA_DISABLE_JIT": "0"}, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]
    warm, after = json.loads(done.stdout.splitlines()[-1])
    assert {name: count for name, count in after.items() if count > 1} == {}
    late = {name for name, count in after.items() if count and not warm[name]}
    assert late == set()
