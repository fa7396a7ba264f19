"""A heading that is hardly known: what turns with it, and what nothing but noise would tell of it."""

import dataclasses
import math

import numpy as np
import pytest
from kernel_inputs import assert_close, random_nav, run_both, spd
from scipy.spatial.transform import Rotation

import navfilter as nf
from navfilter.kernels import consistency, kalman
from navfilter.simulation.manoeuvres import Wait
from navfilter.simulation.motion import Motion
from navfilter.simulation.scenarios import lawnmower, survey_vehicle, transit
from navfilter.simulation.simulate import Faults, StartErrors, simulate

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
    ours, twins = run_both(consistency.turn_velocity, spd(rng, 14), random_nav(rng), (1.0, -2.0, 0.1), np.zeros(3))
    assert_close([ours[0], ours[3]], [twins[0], twins[3]], 1e-13)
    # errors that are all of the attitude stay so: psi x v, whatever v becomes
    nav, v, psi = random_nav(rng), np.array([1.5, -0.3, 0.1]), spd(rng, 3)
    nav[3:6] = v + np.array([0.02, -0.01, 0.03])
    turned = [np.vstack([np.cross(axis, u) for axis in np.eye(3)]).T for u in (v, nav[3:6])]
    before, after = (np.block([[X @ psi @ X.T, X @ psi], [psi @ X.T, psi]]) for X in turned)
    P = np.zeros((9, 9))
    P[3:, 3:] = before
    consistency.turn_velocity(P, nav, tuple(v), np.zeros(3))
    np.testing.assert_allclose(P[3:, 3:], after, atol=1e-14)


def test_what_is_left_of_the_attitude_counts_from_the_tilts_as_corrected():
    """The errors of an attitude that fixes have tilted, as rotations that are drawn have them."""
    rng, n, change, sd = np.random.default_rng(4), 14, np.array([0.03, -0.02]), np.array([0.01, 0.02, 0.05])
    K, residuals = 0.1 * rng.normal(size=(n, 3)), rng.normal(size=3)
    ours, twins = run_both(consistency.turn_tilts, spd(rng, n), K, residuals, np.zeros(2))
    assert_close([ours[0], ours[3]], [twins[0], twins[3]], 1e-13)
    P, K = np.zeros((n, n)), np.zeros((n, 1))
    P[6:9, 6:9], K[6:8, 0] = np.diag(sd**2), change
    consistency.turn_tilts(P, K, np.ones(1), np.zeros(2))
    # the error until then was what is taken off and what was not known; what is left is the product of both rotations
    off = np.r_[change, 0.0]
    drawn = Rotation.from_rotvec(off) * Rotation.from_rotvec(sd * rng.normal(size=(400_000, 3)) - off)
    expected = np.cov(drawn.as_rotvec().T)
    # 400,000 draws leave a part in 400 of a product of two sds, where 0.05 and 0.04 of one are told between tilts and
    # heading, which were told apart before
    np.testing.assert_allclose(P[6:9, 6:9] / np.outer(sd, sd), expected / np.outer(sd, sd), atol=8e-3)
    assert abs(expected[0, 2]) > 0.04 * sd[0] * sd[2]


def test_a_current_goes_with_the_heading_as_the_velocity_does():
    rng, n, first = np.random.default_rng(5), 16, 11
    K, residuals = 0.1 * rng.normal(size=(n, 3)), rng.normal(size=3)
    ours, twins = run_both(consistency.turn_current, spd(rng, n), K, residuals, first)
    assert_close([ours[0]], [twins[0]], 1e-13)
    np.testing.assert_array_equal(ours[0], ours[0].T)
    # the heading by one, velocity and current turned with it: no log reads that, and none does after a change of both
    nav, v, c = random_nav(rng), np.array([1.5, -0.3, 0.1]), np.array([0.2, 0.4])

    def untold(velocity, current):
        direction = np.zeros(n)
        direction[8] = 1.0
        direction[3:5], direction[first : first + 2] = (-velocity[1], velocity[0]), (-current[1], current[0])
        return direction

    before, changed = untold(v, c), c + K[first : first + 2] @ residuals
    nav[3:6] = v + np.array([0.02, -0.01, 0.0])
    P = 0.01 * np.outer(before, before)
    consistency.turn_velocity(P, nav, tuple(v), np.zeros(3))
    consistency.turn_current(P, K, residuals, first)
    after = untold(nav[3:6], changed)
    np.testing.assert_allclose(P, 0.01 * np.outer(after, after), atol=1e-16)


def test_a_deviation_goes_with_the_heading_by_what_it_has_become():
    rng, n, first = np.random.default_rng(4), 16, 11
    K, residual = 0.1 * rng.normal(size=n), 0.3
    ours, twins = run_both(consistency.turn_deviation, spd(rng, n), K, residual, first)
    assert_close([ours[0]], [twins[0]], 1e-13)
    np.testing.assert_array_equal(ours[0], ours[0].T)
    # what no reading tells stays what no reading tells: the heading by one, the deviation turned with it
    deviation = np.array([0.05, -0.03, 0.01, 0.02])

    def untold(sine, cosine, sine_2, cosine_2):
        direction = np.zeros(n)
        direction[[8, first - 1]] = 1.0, -1.0
        direction[first : first + 4] = cosine, -sine, 2.0 * cosine_2, -2.0 * sine_2
        return direction

    before, after = untold(*deviation), untold(*(deviation + K[first : first + 4] * residual))
    P = 0.01 * np.outer(before, before)
    consistency.turn_deviation(P, K, residual, first)
    np.testing.assert_allclose(P, 0.01 * np.outer(after, after), atol=1e-16)
    for psi in np.linspace(0.0, 6.0, 7):
        s, c, s2, c2 = deviation
        slope = s * math.cos(psi) - c * math.sin(psi) + 2.0 * (s2 * math.cos(2.0 * psi) - c2 * math.sin(2.0 * psi))
        harmonics = math.sin(psi), math.cos(psi), math.sin(2.0 * psi), math.cos(2.0 * psi)
        read = (1.0 + slope) * before[8] + before[first - 1] + before[first : first + 4] @ harmonics
        assert read == pytest.approx(0.0)


@pytest.mark.parametrize("magnetometer", [False, True], ids=["compass", "magnetometer"])
def test_a_compass_tells_no_heading_by_its_deviation(magnetometer):
    """The heading that nothing but fixes tells does not hang on how white the compass is said to be.

    When the first turns showed the deviation, the slope of a reading by the heading changed with each estimate of it;
    the heading went to the same side in every mission, by 0.4 to 2.2 deg where the white noise was told too small.
    """
    plain, slow = survey_vehicle(), nf.GaussMarkov(sd=0.4 * DEG, tau_s=60.0)
    unsure = dataclasses.replace(
        plain.sensors["compass"],
        magnetometer=magnetometer,
        error=slow + nf.White(sd=0.15 * DEG),
        bias_sd_rad=2.0 * DEG,
        deviation_sd_rad=(2.0 * DEG, 1.0 * DEG),
    )
    vehicle = nf.Vehicle(plain.drive, {**plain.sensors, "compass": unsure})
    for seed in (901, 902, 905):
        mission = simulate(vehicle, lawnmower(1200.0), seed=seed, duration_s=240.0)
        told = nf.replay(vehicle, mission, output_rate_hz=1.0)
        quieter = nf.replay(vehicle.with_error(compass=slow + nf.White(sd=0.05 * DEG)), mission, output_rate_hz=1.0)
        apart = quieter.errors(mission.truth).heading - told.errors(mission.truth).heading
        assert abs(apart[-1]) < 0.15 * DEG, seed  # a fifth of its standard deviation


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


@pytest.mark.parametrize("fixes_s", [0.5, 300.0], ids=["alone", "fixes"])
def test_a_log_tells_no_heading_through_water_that_moves(fixes_s):
    """As a DVL, though what it reads changes the current, not the velocity. Where the current did not turn with the
    heading each reading told of it: the mean of these squares, 0.8 and 0.5, was 81 and 72.
    """
    log = nf.WaterVelocity(
        rate_hz=8.0, error=nf.GaussMarkov(sd=0.004, tau_s=4.5, order=2) + nf.White(sd=0.0004), current_sd_m_s=0.2
    )
    drive = dataclasses.replace(survey_vehicle().drive, rate_hz=20.0)
    vehicle = nf.Vehicle(drive, {"water": log, "depth": nf.Depth(), "gps": nf.Position(error=nf.White(sd=0.5))})
    start, heading = StartErrors(heading_sd_deg=4.0, tilt_sd_deg=0.4), []
    for seed in range(8):
        faults = {"gps": Faults(available=((0.0, fixes_s),))}
        mission = simulate(vehicle, lawnmower(300.0), seed=seed, duration_s=300.0, start=start, faults=faults)
        track = nf.replay(vehicle, mission, smooth=True, output_rate_hz=0.2)
        for run in (track.forward, track):
            heading.append(np.mean(run.nees(run.errors(mission.truth))["heading"][track.time_s > 30.0]))
    # sixteen, but eight independent ones, each hardly less than one number: above 3.2 in a case of a thousand
    assert np.mean(heading) < 3.2, heading


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


@pytest.mark.parametrize("sd_deg", [5.0, 0.5])
def test_a_forward_speed_alone_tells_no_heading(sd_deg):
    """Wheels without constraints beside fixes: what they say of the heading is the square of the sideways velocity that
    the unit feels, and that is what the tilt errs by.

    Of six normalised squares, each the mean of one mission and hardly less than one number, the mean is above 3.7 in a
    case of a thousand. With the slope as it is it was 1450 and 7.
    """
    wheels = nf.Odometer(
        rate_hz=5.0, constrained=False, error=(nf.GaussMarkov(sd=0.006, tau_s=4.0), *(nf.White(sd=0.1),) * 2)
    )
    drive = dataclasses.replace(survey_vehicle().drive, rate_hz=50.0)
    vehicle = nf.Vehicle(drive, {"wheels": wheels, "gps": nf.Position(rate_hz=1.0), "depth": nf.Depth()})
    start, heading = StartErrors(heading_sd_deg=sd_deg, tilt_sd_deg=0.5), []
    for seed in range(6):
        mission = simulate(vehicle, transit(300.0), seed=seed, duration_s=300.0, start=start)
        track = nf.replay(vehicle, mission, output_rate_hz=0.2)
        nees = track.nees(track.errors(mission.truth))
        heading.append(np.mean(nees["heading"][track.time_s > 30.0]))
    assert np.mean(heading) < 3.7
