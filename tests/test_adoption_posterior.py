"""Exactness under changes of the error models: filter and smoother are the Gaussian posterior of the time-varying
model.

A change is one more link of the chain, ``e' = M e + w, w ~ N(0, N)``, with M rectangular where an order changes.
Whether M and N are the right ones is the business of `test_adoption`; here the chain with these links is conditioned in
one piece.
"""

import numpy as np
import pytest
from dense_posterior import (
    DEG,
    Capture,
    Step,
    Unknowns,
    assert_same,
    drive_through,
    inertial_vehicle,
    reckoning_vehicle,
    start,
    water_vehicle,
)

import navfilter as nf
from navfilter.filter.filter import Filter
from navfilter.models.learned_arma import LearnedArma
from navfilter.timeseries.model import ArmaModel


class Changing(Capture):
    """Notes the changes of the layout too."""

    def __init__(self, monkeypatch, vehicle, start):
        super().__init__(monkeypatch, vehicle, start)
        follow, self.sizes = Filter._transform, []

        def change(filter, M, N):
            assert not self._single  # what was not yet folded would belong before the change
            for chain in (self.steps, self.samples):
                chain.append(Step(M.copy(), N.copy()))
            self.n = len(M)
            self.sizes.append(M.shape)
            follow(filter, M, N)

        monkeypatch.setattr(Filter, "_transform", change)


def learnt(ar=(), ma=(), sd=1.0, slow=None):
    return LearnedArma(model=ArmaModel(ar, ma, sd), slow=slow)


FAST, SLOW = ((-1.6, 0.7), (0.4,)), ((-1.2, 0.3), (-0.5,))
LONG = ((-1.6, 0.9, -0.3, 0.1), (0.4, 0.1, -0.2, 0.05))
ROUGH, SMOOTH = nf.GaussMarkov(sd=0.3 * DEG, tau_s=8.0), nf.GaussMarkov(sd=0.5 * DEG, tau_s=20.0, order=2)
OTHER = nf.GaussMarkov(sd=0.6 * DEG, tau_s=4.0) + nf.GaussMarkov(sd=0.2 * DEG, tau_s=60.0, order=2)
METRES = nf.GaussMarkov(sd=0.5, tau_s=10.0)
COMPASS = [
    (0.7, "compass", learnt((-0.9,), (), 0.5 * DEG, ROUGH + SMOOTH)),  # from a fixed model to a register and slow parts
    (1.3, "compass", learnt((-0.7,), (), 0.8 * DEG, OTHER)),  # the coefficients and sizes alone
    (1.9, "compass", learnt(*FAST, 0.4 * DEG, SMOOTH + ROUGH)),  # slow parts of other orders
    (2.4, "compass", learnt(*SLOW, 0.4 * DEG, ROUGH)),
    (2.9, "compass", learnt(*LONG, 0.4 * DEG)),  # no slow part any more
    (3.4, "compass", learnt((-0.9,), (), 0.5 * DEG)),
    (4.0, "compass", learnt(sd=1.0 * DEG)),  # white: no state at all
    (4.3, "compass", learnt(sd=1.0 * DEG, slow=SMOOTH)),  # nothing but a slow part
    (4.6, "compass", learnt(*FAST, 0.4 * DEG, OTHER)),
    (5.2, "compass", nf.GaussMarkov(sd=1.0 * DEG, tau_s=5.0) + nf.White(sd=0.2 * DEG)),
]
WALK, WHITE = nf.RandomWalk(density=0.1, start_sd=0.5), nf.White(sd=0.05)
OTHERS = [
    (0.9, "dvl", (learnt((-0.9,), (), 0.1), learnt(sd=0.1), learnt(*FAST, 0.05))),
    (1.1, "depth", WALK + learnt((-0.5,), (0.2,), 0.2, METRES)),
    (1.6, "gps", learnt((-1.2, 0.4), (), 1.0, METRES + METRES)),
    (2.6, "depth", WALK + learnt((-0.5, 0.2), (), 0.2, METRES)),
    (2.7, "dvl", (WHITE + learnt(*LONG, 0.05), learnt((-0.9,), (), 0.1), learnt(*SLOW, 0.05))),
    (3.7, "gps", (learnt((), (0.5, 0.2), 1.0), nf.GaussMarkov(sd=2.0, tau_s=20.0), learnt((-0.9,), (), 1.0))),
    (4.3, "dvl", nf.GaussMarkov(sd=0.1, tau_s=2.0) + nf.White(sd=0.05)),
    (4.4, "depth", nf.White(sd=0.2)),
]
BIAS, QUIET = nf.RandomWalk(density=1e-4, start_sd=1e-3), nf.White(density=1e-3)
IMU = [
    (0.72, "gyro", QUIET + BIAS + learnt((-0.8,), (), 1e-3)),
    (1.52, "accel", (BIAS + learnt((-0.9,), (), 0.01), learnt(*FAST, 0.01), nf.White(density=1e-2))),
    (2.31, "gyro", (QUIET + BIAS + learnt(*FAST, 1e-3), QUIET + BIAS, learnt(sd=5e-3))),
    (3.02, "accel", nf.White(density=1e-2) + nf.RandomWalk(density=1e-3, start_sd=0.02)),
    (4.01, "gyro", (QUIET + BIAS + learnt(*SLOW, 1e-3), QUIET + BIAS, learnt(sd=2e-3))),
]
VELOCITY = [
    (1.1, "velocity", (nf.White(sd=0.02) + learnt((-0.8,), (), 0.05), nf.White(sd=0.05), learnt(*FAST, 0.02))),
    (2.3, "attitude", learnt(*FAST, 0.8 * DEG)),
    (3.1, "velocity", learnt((-0.9, 0.2), (), 0.05)),
    (4.2, "attitude", learnt((-0.9,), (), 0.8 * DEG)),
    (5.5, "velocity", nf.White(sd=0.05)),
]
#: Its error is not learnt, but may be changed; in between nothing of it ticks but the current.
WATER = [
    (0.5, "dvl", WHITE),
    (1.6, "dvl", nf.GaussMarkov(sd=0.1, tau_s=2.0) + nf.White(sd=0.05)),
    (2.1, "dvl", (WHITE, nf.GaussMarkov(sd=0.1, tau_s=2.0) + WHITE, WHITE)),
]
CASES = {
    "compass": (inertial_vehicle, 6.0, COMPASS),
    "others": (inertial_vehicle, 5.0, OTHERS),
    "imu": (inertial_vehicle, 4.8, IMU),
    "all": (inertial_vehicle, 3.8, sorted([*COMPASS, *OTHERS, *IMU], key=lambda change: change[0])),
    "water": (water_vehicle, 3.0, sorted([*COMPASS, *WATER], key=lambda change: change[0])),
    "reckoning": (
        reckoning_vehicle,
        9.0,
        sorted([*VELOCITY, *(c for c in OTHERS if c[1] in ("gps", "depth"))], key=lambda c: c[0]),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_filter_and_smoother_equal_the_dense_posterior_of_changing_models(case, monkeypatch):
    build, seconds, changes = CASES[case]
    capture = Changing(monkeypatch, build(), start())
    drive_through(capture.nav, seconds, seed=1, changes=changes)
    assert len(capture.sizes) == sum(time_s < seconds for time_s, *_ in changes) == capture.nav.counts["adopted"]
    assert len({rows for rows, _ in capture.sizes}) > 3 and any(rows == columns for rows, columns in capture.sizes)
    rows, smoothed = capture.rows(), capture.smoothed()
    unknowns = Unknowns(capture.steps, capture.P0, dict(rows))
    dense = unknowns.posterior(dict(rows))
    for count, P in rows:
        assert_same(smoothed[count], dense[count], np.sqrt(np.diag(P)), 1e-8)
    for count, P in rows[:: max(1, len(rows) // 6)]:
        past = unknowns.posterior({count}, upto=count)[count]
        assert_same((np.zeros(len(P)), P), past, np.sqrt(np.diag(P)), 1e-8)
