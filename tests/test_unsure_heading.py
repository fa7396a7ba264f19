"""A heading that is hardly known: what turns with it, and what nothing but noise would tell of it."""

import dataclasses
import math

import numpy as np
import pytest
from kernel_inputs import assert_close, random_nav, run_both, spd

import navfilter as nf
from navfilter.kernels import kalman
from navfilter.simulation.faults import Faults
from navfilter.simulation.manoeuvres import Wait
from navfilter.simulation.motion import Motion
from navfilter.simulation.scenarios import lawnmower, survey_vehicle
from navfilter.simulation.simulate import simulate

DEG = math.pi / 180.0


def folded(way_m, parts, heading_sd):
    """Covariance after a straight way northwards of a heading with this sd, in so many folds."""
    nav, m, P = random_nav(np.random.default_rng(1)), 9, np.zeros((9, 9))
    P[8, 8] = heading_sd**2
    for _ in range(parts):
        acc = np.zeros((4 * m, m))
        acc[:m], acc[1, 8] = np.eye(m), way_m / parts
        kalman.fold(P, acc, nav, np.zeros((m, m)))
    return P


def test_on_another_heading_a_way_is_an_arc():
    """Along the way the position errs by the second order, as a drawn heading has it; across it as ever."""
    psi = 10.0 * DEG * np.random.default_rng(2).normal(size=400_000)
    north, east = 300.0 * (np.cos(psi) - 1.0), 300.0 * np.sin(psi)
    P = folded(300.0, 60, 10.0 * DEG)
    # the fourth order, sixth of the sine, is a tenth of the square; 400,000 draws leave a per cent
    assert P[0, 0] == pytest.approx(np.mean(north**2), rel=0.1)
    assert P[1, 1] == pytest.approx(np.mean(east**2), rel=0.1)
    np.testing.assert_allclose(P[:2, :2], folded(300.0, 1, 10.0 * DEG)[:2, :2], rtol=1e-9, atol=1e-9)


def test_velocity_turns_with_the_attitude_by_what_it_has_become():
    rng = np.random.default_rng(3)
    ours, twins = run_both(kalman.turn_velocity, spd(rng, 14), random_nav(rng), (1.0, -2.0, 0.1), np.zeros(3))
    assert_close([ours[0], ours[3]], [twins[0], twins[3]], 1e-13)
    # errors that are all of the attitude stay so: psi x v, whatever v becomes
    nav, v, psi = random_nav(rng), np.array([1.5, -0.3, 0.1]), spd(rng, 3)
    nav[3:6] = v + np.array([0.02, -0.01, 0.03])
    turned = [np.vstack([np.cross(axis, u) for axis in np.eye(3)]).T for u in (v, nav[3:6])]
    before, after = (np.block([[X @ psi @ X.T, X @ psi], [psi @ X.T, psi]]) for X in turned)
    P = np.zeros((9, 9))
    P[3:, 3:] = before
    kalman.turn_velocity(P, nav, tuple(v), np.zeros(3))
    np.testing.assert_allclose(P[3:, 3:], after, atol=1e-14)


@pytest.mark.parametrize("mems", [False, True], ids=["tactical", "micromechanical"])
def test_a_dvl_alone_tells_no_heading(mems):
    """Without compass and fixes, five minutes on, heading and position are as well known as they are said to be.

    Of ten normalised squares the mean is above 2.5 in five cases of a thousand. Where noise told the heading, it was 20
    with either unit, of the position 25 and 35.
    """
    base = survey_vehicle(mems=mems)
    others = {name: sensor for name, sensor in base.sensors.items() if name != "compass"}
    vehicle = nf.Vehicle(dataclasses.replace(base.drive, rate_hz=50.0), others)
    heading, place = [], []
    for seed in range(401, 411):
        faults = {"gps": Faults(available=((0.0, 0.5),))}
        mission = simulate(vehicle, lawnmower(300.0), seed=seed, duration_s=300.0, faults=faults)
        off_deg = 10.0 * np.random.default_rng(seed).normal()
        told_deg = math.degrees(mission.truth.value[0, 8]) + off_deg
        start = dataclasses.replace(mission.start, heading_deg=told_deg, heading_sd_deg=10.0)
        track = nf.replay(vehicle, mission, start=start, output_rate_hz=0.2)
        nees = track.nees(track.errors(mission.truth))
        heading.append(nees["heading"][-1])
        place.append(nees["position"][-1])
    assert np.mean(heading) < 2.5
    assert np.mean(place) < 2.5


def test_noise_at_rest_tells_no_heading():
    """Of a heading that is known to ten degrees a vehicle that stands and has no compass learns nothing in a minute."""
    base = survey_vehicle(mems=True)
    others = {name: sensor for name, sensor in base.sensors.items() if name in ("dvl", "depth")}
    vehicle = nf.Vehicle(dataclasses.replace(base.drive, rate_hz=50.0), others)
    mission = simulate(vehicle, Motion((Wait(60.0),)), seed=1, duration_s=60.0)
    start = dataclasses.replace(mission.start, heading_sd_deg=10.0, velocity_n=(0.0, 0.0, 0.0))
    track = nf.replay(vehicle, mission, start=start, output_rate_hz=1.0)
    # the Earth turns by a quarter of what the gyros' offsets may be
    assert track.attitude_sd()[-1, 2] > 9.5 * DEG
