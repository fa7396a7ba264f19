"""What is in force of an error that will be learnt, until something has been: its prior, which may be quick."""

import numpy as np
import pytest

import navfilter as nf
from navfilter.filter.state_layout import Layout
from navfilter.models.learned_arma import as_described
from navfilter.simulation.presets import mems_imu
from navfilter.simulation.scenarios import lawnmower
from navfilter.simulation.simulate import Faults, simulate

SLOW, WHITE = nf.GaussMarkov(sd=0.3, tau_s=40.0), nf.White(sd=0.1)


@pytest.mark.parametrize(
    ("model", "added"),
    [
        (nf.LearnedArma(prior=SLOW + WHITE), 0.3**2),
        (nf.White(sd=0.05) + nf.LearnedArma(prior=SLOW + nf.GaussMarkov(sd=0.4, tau_s=5.0)), 0.5**2),
        # a bias is no noise, however far it may be off at the start
        (nf.LearnedArma(prior=SLOW + nf.RandomWalk(density=1e-3, start_sd=2.0)), 0.3**2),
        (nf.LearnedArma(prior=WHITE), 0.0),
        (nf.LearnedArma(prior=SLOW, model=nf.ArmaModel([-0.5], [], 0.1)), 0.0),
        (SLOW + WHITE, 0.0),
    ],
)
def test_as_much_white_noise_as_the_prior_is_large_stands_beside_it(model, added):
    plain, block = model.block(0.5), model.in_force(0.5)
    assert block.r == pytest.approx(plain.r + added, rel=1e-12)
    for name in ("Phi", "Q", "C", "P0"):
        np.testing.assert_array_equal(getattr(block, name), getattr(plain, name))


def test_sensors_are_laid_out_so_and_no_unit_is():
    drive = nf.Imu(rate_hz=50.0, gyro=nf.LearnedArma(prior=nf.GaussMarkov(sd=1e-4, tau_s=50.0) + nf.White(sd=1e-3)))
    layout = Layout.of(nf.Vehicle(drive, {"depth": nf.Depth(rate_hz=2.0, error=nf.LearnedArma(prior=SLOW + WHITE))}))
    assert layout.groups["depth"].r[0] == pytest.approx(0.3**2 + 0.1**2, rel=1e-12)
    assert layout.drive.r[0] == pytest.approx(1e-6, rel=1e-12)


def test_what_will_not_be_learnt_is_as_described():
    learnt = nf.LearnedArma(prior=SLOW, model=nf.ArmaModel([-0.5], [], 0.1))
    given = (nf.LearnedArma(prior=SLOW + WHITE), nf.White(sd=0.05) + nf.LearnedArma(prior=SLOW), WHITE, learnt)
    assert as_described(given) == (SLOW + WHITE, nf.White(sd=0.05) + SLOW, WHITE, learnt)


def test_a_quick_error_that_is_described_as_slow_is_not_believed_too_much():
    """A gauge that rings by 2 cm from reading to reading, of which the file says that it errs for half a minute: what
    few readings tell of the vertical velocity is off by less than the filter thinks.
    """
    rings = nf.Arma(ar=(0.57, 0.54), sd=0.016) + nf.White(sd=0.012)
    prior = nf.GaussMarkov(sd=0.0156, tau_s=33.0) + nf.White(sd=0.0047)
    fixes = nf.Position(error=nf.GaussMarkov(sd=5.0, tau_s=26.0), lever_arm_b_m=(-1.7, 0.4, -1.8))
    told = nf.Vehicle(mems_imu(), {"depth": nf.Depth(error=rings), "gps": fixes})
    vehicle, nees, used = told.with_error(depth=nf.LearnedArma(prior=prior)), [], []
    for seed in range(4):
        mission = simulate(
            told, lawnmower(200.0), seed=seed, duration_s=200.0, faults={"gps": Faults(available="always")}
        )
        track = nf.replay(vehicle, mission, output_rate_hz=1.0)
        begun = track.time_s > 10.0
        down = track.errors(mission.truth).position_n[begun, 2]
        nees.append(float(np.mean(down**2 / track.covariance[begun, 2, 2])))
        used.append(float(np.mean(track.residuals["depth"].used)))
    # of 1 for an honest filter; with the prior as it stands all four lost the gauge: 6 to 55
    assert max(nees) < 3.0 and min(used) > 0.9, (nees, used)
