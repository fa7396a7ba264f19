"""The rooms changed and no result did: tracks, smoothed tracks and adopted models are those of the tree before, bit for
bit.

Where a processor or a library rounds otherwise than where the figures were made (the probe tells), they agree to a
micrometre and to a millionth instead. This test goes when results change on purpose.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

import navfilter as nf
from navfilter.kernels import kalman
from navfilter.simulation.campaigns import stage
from navfilter.simulation.scenarios import simulate_scenario

Case = tuple[nf.Vehicle, nf.Mission]


def learning(vehicle: nf.Vehicle, *names: str) -> nf.Vehicle:
    return vehicle.with_error(**{name: nf.LearnedArma(prior=vehicle.sensors[name].error) for name in names})


def demo() -> Case:
    vehicle, mission = simulate_scenario("demo", 1)
    return learning(vehicle, "compass"), mission


def oscillating() -> Case:
    vehicle, mission = simulate_scenario("oscillating", 1)
    return learning(vehicle, "compass", "dvl", "depth"), mission


def rolling() -> Case:
    staged = stage("compass-rolling", imu_rate_hz=50.0)
    return learning(staged.vehicle, "compass"), staged.mission(1)


#: Digest of everything, and (latitude [rad], longitude [rad], heading sd [rad], number of adoptions) at the end.
BEFORE: dict[str, tuple[str, tuple[float, float, float, int]]] = {
    "demo": (
        "6d0df2ce039197f0aa1e0ef0c1438bc1d306447fe5f413755ae0dce73628dfff",
        (0.45451734400421606, -1.3978534095552753, 0.002228094580095395, 13),
    ),
    "oscillating": (
        "a5a259154c996504fe03f804b01b8a93e05ded4a5e09411eb72c0882060d11a2",
        (0.4546208439528863, -1.3978444032309265, 0.0030718915123992504, 9),
    ),
    "rolling": (
        "51920a83eb56fac4e8c3594c2637efae0deda6b52b2f99060130f30ac7672da1",
        (0.454620946088741, -1.3978442323161633, 0.004014683005903134, 6),
    ),
    "snapir-auv-1hz/01": (
        "61dc7894e79a510db2df14070e728f371048ac50bdaf16bec2e03c6a7a3f4016",
        (0.5733490940531598, 0.6089782053836564, 0.0017292128875666824, 0),
    ),
    "wid-car-rtk/02": (
        "1c27c49717ad5009fd8939189494733b945ef3160652ae9a487d5498fbac1231",
        (0.5718806208766318, 0.6111136935775019, 0.021726454252309495, 0),
    ),
}
PROBE = "ac2c5d2b48cb00f557a5d005b69beb89065758192f51fcc2f47d788b43452219"


def digest(track: nf.Track) -> str:
    total = hashlib.sha256()
    names = ("time_s", "latitude", "longitude", "height", "velocity_n", "attitude", "covariance", "states", "states_sd")
    assert track.forward is not None
    # of a beginning that was run again, what the run made of it
    for run in (track.forward.revised or track.forward, track):
        for name in names:
            total.update(np.ascontiguousarray(getattr(run, name)).tobytes())
        for sensor in sorted(run.residuals):
            for name in ("time_s", "value", "sd", "nis", "dof", "outcome"):
                total.update(np.ascontiguousarray(getattr(run.residuals[sensor], name)).tobytes())
        for sensor in sorted(run.error_models):
            for time_s, model in run.error_models[sensor]:
                total.update(f"{float(time_s)!r} {model!r}".encode())
    return total.hexdigest()


@cache
def probe() -> str:
    """How this machine rounds: products, factorisations, functions, and a kernel."""
    rng = np.random.default_rng(0)
    A, total = rng.normal(size=(23, 23)), hashlib.sha256()
    stable = A / (1.1 * np.abs(np.linalg.eigvals(A)).max())
    for value in (
        A @ A.T,
        np.linalg.eigh(A @ A.T)[1],
        np.linalg.pinv(A),
        solve_discrete_lyapunov(stable, np.eye(23)),
        np.exp(np.sin(A)),
    ):
        total.update(np.ascontiguousarray(value).tobytes())
    P, acc, nav = A @ A.T, np.vstack([A[:9, :9], np.eye(9), np.zeros((18, 9))]), rng.normal(size=17)
    kalman.fold(P, acc, nav, np.zeros((9, 23)))
    total.update(P.tobytes())
    return total.hexdigest()


def same_as_before(name: str, case: Callable[[], Case]) -> None:
    vehicle, mission = case()
    track = nf.replay(vehicle, mission, smooth=True)
    before, (latitude, longitude, heading_sd, adopted) = BEFORE[name]
    if probe() == PROBE:
        assert digest(track) == before
    metre = 1.0 / 6.4e6
    assert abs(track.latitude[-1] - latitude) < 1e-6 * metre and abs(track.longitude[-1] - longitude) < 1e-6 * metre
    assert math.isclose(math.sqrt(track.covariance[-1, 8, 8]), heading_sd, rel_tol=1e-6)
    assert track.counts["adopted"] == adopted


@pytest.mark.parametrize("case", [demo, oscillating, rolling], ids=lambda case: case.__name__)
def test_simulated(case):
    same_as_before(case.__name__, case)


@pytest.mark.parametrize("name", ["snapir-auv-1hz/01", "wid-car-rtk/02"])
def test_recorded(name, recording):
    folder = recording(name)
    same_as_before(name, lambda: (nf.read_vehicle(folder / "vehicle.toml"), nf.read_mission(folder)))
