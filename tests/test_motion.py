"""The simulated motion is exact: kinematics agree with each other, and an independent integrator follows them."""

import math
import os

import numpy as np
import pandas as pd
import pytest

from navfilter.simulation.manoeuvres import (
    ChangeSpeed,
    Dive,
    FigureEight,
    Lawnmower,
    SpiralDive,
    Straight,
    Surface,
    Turn,
    Wait,
)
from navfilter.simulation.motion import Motion, Wander, rotation

pytestmark = pytest.mark.filterwarnings("ignore:The copy keyword is deprecated")  # inside python-ins

TOUR = (
    Wait(20.0),
    ChangeSpeed(1.5),
    Straight(duration_s=30.0),
    Dive(10.0),
    FigureEight(),
    SpiralDive(20.0),
    Lawnmower(legs=3, leg_m=40.0, spacing_m=20.0),
    Surface(),
    ChangeSpeed(0.0),
    Wait(10.0),
)


@pytest.fixture(scope="module")
def tour() -> Motion:
    """About ten minutes with turns, dives and wander."""
    return Motion(TOUR, latitude_deg=26.0, longitude_deg=-80.0, heading_deg=30.0, wander=Wander())


def derivative(function, t, h):
    """Fourth-order central difference."""
    return (8.0 * (function(t + h) - function(t - h)) - (function(t + 2 * h) - function(t - 2 * h))) / (12.0 * h)


def inner_times(motion, n=4001):
    return np.linspace(0.5, motion.duration_s - 0.5, n)


def test_position_is_the_integral_of_velocity(tour):
    t, h = inner_times(tour), 0.02
    here = tour.at(t)
    s2 = np.sin(here.latitude) ** 2
    across = 6378137.0 / np.sqrt(1 - 6.69437999014e-3 * s2)
    meridian = across * (1 - 6.69437999014e-3) / (1 - 6.69437999014e-3 * s2)
    north = derivative(lambda x: tour.at(x).latitude, t, h) * (meridian + here.height)
    east = derivative(lambda x: tour.at(x).longitude, t, h) * (across + here.height) * np.cos(here.latitude)
    down = -derivative(lambda x: tour.at(x).height, t, h)
    # longitude is about 1.4 rad: its rounding, 2e-16 * 6e6 m, over 0.02 s is the largest error
    assert np.abs(np.stack([north, east, down], axis=-1) - here.velocity_n).max() < 2e-7


def test_rates_are_the_derivative_of_attitude(tour):
    t, h = inner_times(tour), 0.01
    here = tour.at(t)
    C_rate = derivative(lambda x: tour.at(x).C_nb, t, h)
    cross = np.einsum("nji,njk->nik", here.C_nb, C_rate)
    rate_nb = np.stack([cross[:, 2, 1], cross[:, 0, 2], cross[:, 1, 0]], axis=-1)
    # what remains is the transport rate, 2.4e-7 rad/s at 1.5 m/s
    assert np.abs(rate_nb - here.rate_eb_b).max() < 4e-7
    earth = 7.292115e-5
    earth_n = earth * np.stack([np.cos(here.latitude), 0 * t, -np.sin(here.latitude)], axis=-1)
    earth_b = np.einsum("nij,ni->nj", here.C_nb, earth_n)
    np.testing.assert_allclose(here.rate_b - here.rate_eb_b, earth_b, atol=1e-18)


def test_specific_force_is_the_second_derivative_in_inertial_space(tour):
    """Newton in the inertial frame, without any of the local-frame terms: force = r'' - gravitation."""
    t, h = inner_times(tour, 801), 0.1
    C_in = inertial_axes(tour, t)
    second = (
        -inertial_position(tour, t + 2 * h)
        + 16 * inertial_position(tour, t + h)
        - 30 * inertial_position(tour, t)
        + 16 * inertial_position(tour, t - h)
        - inertial_position(tour, t - 2 * h)
    ) / (12 * h**2)
    here = tour.at(t)
    f_n = np.einsum("nij,ni->nj", C_in, second)
    f_n[:, 2] -= somigliana(here)
    # gravity contains the centrifugal acceleration, gravitation does not
    centrifugal_i = inertial_position(tour, t) * np.array([1.0, 1.0, 0.0]) * 7.292115e-5**2
    f_n += np.einsum("nij,ni->nj", C_in, centrifugal_i)
    f_b = np.einsum("nij,ni->nj", here.C_nb, f_n)
    # rounding of 6.4e6 m over h^2 is 2e-7; the fourth-order formula at the wander's 5.6 s adds 1e-5
    assert np.abs(f_b - here.force_b).max() < 3e-5


def somigliana(here):
    s2 = np.sin(here.latitude) ** 2
    k = math.sqrt(1 - 6.69437999014e-3) * 9.8321849378 / 9.7803253359 - 1
    return 9.7803253359 * (1 + k * s2) / np.sqrt(1 - 6.69437999014e-3 * s2) * (1 - 2 * here.height / 6378137.0)


def inertial_position(motion, t):
    here = motion.at(t)
    s, c = np.sin(here.latitude), np.cos(here.latitude)
    across = 6378137.0 / np.sqrt(1 - 6.69437999014e-3 * s**2)
    turned = here.longitude + 7.292115e-5 * t
    r = (across + here.height) * c
    z = (across * (1 - 6.69437999014e-3) + here.height) * s
    return np.stack([r * np.cos(turned), r * np.sin(turned), z], axis=-1)


def inertial_axes(motion, t):
    here = motion.at(t)
    s, c = np.sin(here.latitude), np.cos(here.latitude)
    turned = here.longitude + 7.292115e-5 * t
    sl, cl = np.sin(turned), np.cos(turned)
    return np.moveaxis(np.array([[-s * cl, -sl, -c * cl], [-s * sl, cl, -c * sl], [c, 0 * t, -s]]), (0, 1), (1, 2))


def integrate(motion, rate_hz, increments):
    """Largest errors (position n m, velocity m/s, attitude rad) of the python-ins integrator along the motion."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        pytest.skip("the integrator's loop takes minutes without the compiler")
    strapdown = pytest.importorskip("pyins.strapdown", reason="install python-ins to run this test")
    t, gyro, accel = motion.inertial(rate_hz, increments=increments)
    if increments:
        # python-ins wants one sample more in front; at rest it equals the first
        t, gyro, accel = np.r_[0.0, t], np.vstack([gyro[:1], gyro]), np.vstack([accel[:1], accel])
    columns = ["gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"]
    imu = pd.DataFrame(np.hstack([gyro, accel]), index=t, columns=columns)
    here = motion.at(t)
    begin = np.r_[np.degrees([here.latitude[0], here.longitude[0]]), here.height[0], here.velocity_n[0]]
    names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    pva = pd.Series(np.r_[begin, np.degrees(here.attitude[0])], index=names)
    kind = "increment" if increments else "rate"
    track = strapdown.Integrator(pva).integrate(strapdown.compute_increments_from_imu(imu, kind))
    position = np.stack(
        [
            (np.radians(track.lat.values) - here.latitude) * 6.36e6,
            (np.radians(track.lon.values) - here.longitude) * 6.37e6 * np.cos(here.latitude),
            track.alt.values - here.height,
        ],
        axis=-1,
    )
    velocity = track[["VN", "VE", "VD"]].values - here.velocity_n
    angles = np.radians(track[["roll", "pitch", "heading"]].values) - here.attitude
    attitude = np.angle(np.exp(1j * angles))
    return np.abs(position).max(), np.abs(velocity).max(), np.abs(attitude).max()


def test_independent_integrator_follows_the_increments(tour):
    # second-order algorithm: 11 mm at 100 Hz with this much wander and banking, a sixteenth of it at 400 Hz
    position, velocity, attitude = integrate(tour, 400.0, increments=True)
    assert position < 1e-3
    assert velocity < 1e-5
    assert attitude < 1e-9


def test_independent_integrator_follows_a_calm_tour_at_100_hz():
    gentle = {"rate_deg_s": 3.0, "bank_deg": 0.5, "blend_s": 8.0}
    start = (Wait(20.0), ChangeSpeed(1.5), Straight(duration_s=60.0), Turn(90.0, **gentle))
    deep = (Dive(10.0, 8.0, blend_s=10.0), Turn(180.0, **gentle), Straight(duration_s=120.0), Turn(-180.0, **gentle))
    end = (Dive(0.0, 8.0, blend_s=10.0), Straight(duration_s=60.0))
    calm = Motion((*start, *deep, *end), latitude_deg=-35.0, longitude_deg=150.0, heading_deg=200.0)
    position, velocity, attitude = integrate(calm, 100.0, increments=True)
    assert position < 1e-3
    assert velocity < 1e-5
    assert attitude < 1e-9


def test_error_of_the_rate_algorithm_is_its_own(tour):
    """The linear-rate algorithm errs with the square of the sample period: nothing of the motion is left over."""
    coarse = np.array(integrate(tour, 100.0, increments=False))
    fine = np.array(integrate(tour, 200.0, increments=False))
    np.testing.assert_allclose(coarse / fine, 4.0, rtol=0.05)


def test_increments_are_integrals_of_rates(tour):
    t, gyro, accel = tour.inertial(10.0, increments=True, duration_s=100.0)
    assert t[0] == pytest.approx(0.1) and t[-1] == pytest.approx(100.0)
    fine, rate, force = tour.inertial(1000.0, duration_s=100.0)
    assert fine[0] == 0.0 and fine.size == 100001
    # Simpson's rule over the 100 fine intervals of each sample
    weights = np.r_[1.0, np.tile([4.0, 2.0], 49), 4.0, 1.0] / 3000.0
    rows = np.arange(1000)[:, None] * 100 + np.arange(101)
    np.testing.assert_allclose(np.einsum("k,nkj->nj", weights, rate[rows]), gyro, atol=1e-9)
    np.testing.assert_allclose(np.einsum("k,nkj->nj", weights, force[rows]), accel, atol=1e-8)


def test_acceleration_and_rates_are_continuous(tour):
    joints = tour._course.x[1:-1]
    before, after = tour.at(joints - 1e-7), tour.at(joints + 1e-7)
    # the steepest change, 0.1 rad/s^2 or 1 m/s^3, over 0.2 us
    assert np.abs(after.rate_b - before.rate_b).max() < 1e-7
    assert np.abs(after.force_b - before.force_b).max() < 1e-6


def test_at_rest_only_earth_rate_and_gravity():
    motion = Motion((Wait(10.0),), latitude_deg=45.0, heading_deg=90.0, wander=Wander())
    here = motion.at([0.0, 10.0])
    np.testing.assert_array_equal(here.velocity_n, 0.0)
    np.testing.assert_allclose(here.force_b, [[0, 0, -somigliana(here)[0]]] * 2, atol=1e-12)
    south_half = 7.292115e-5 * math.sqrt(0.5)
    np.testing.assert_allclose(here.rate_b, [[0, -south_half, -south_half]] * 2, atol=1e-18)


def test_manoeuvres_do_what_they_say():
    moving = {"speed_m_s": 2.0, "latitude_deg": 10.0}
    end = lambda *m: (lambda x: x.at(x.duration_s))(Motion(m, **moving))  # noqa: E731
    assert end(Turn(90.0)).attitude[0, 2] == pytest.approx(math.pi / 2)
    assert end(Turn(-3.0)).attitude[0, 2] == pytest.approx(math.radians(-3.0))
    assert end(Turn(0.0)).attitude[0, 2] == 0.0
    assert end(Dive(30.0)).height[0] == pytest.approx(-30.0)
    assert end(Dive(0.5)).height[0] == pytest.approx(-0.5)
    assert end(SpiralDive(30.0), Surface()).height[0] == pytest.approx(0.0, abs=1e-9)
    assert end(Straight(distance_m=100.0)).latitude[0] - math.radians(10.0) == pytest.approx(100.0 / 6337358, rel=1e-3)
    two_legs = end(Lawnmower(legs=2, leg_m=50.0, spacing_m=30.0))
    assert abs(two_legs.attitude[0, 2]) == pytest.approx(math.pi)
    # each of the four circles moves on by the way of one blend, 8 m
    eights = end(FigureEight(2))
    assert (eights.latitude[0] - math.radians(10.0)) * 6337358 == pytest.approx(32.0, abs=0.1)
    assert eights.longitude[0] == pytest.approx(0.0, abs=1e-9)  # 6 mm: the right and the left circles cancel
    assert np.abs(end(ChangeSpeed(0.0)).velocity_n).max() < 1e-12


def test_surface_height_and_start_depth():
    motion = Motion((Dive(5.0),), speed_m_s=1.0, surface_height_m=700.0, depth_m=20.0)
    here = motion.at([0.0, motion.duration_s])
    assert here.height == pytest.approx([680.0, 695.0])
    assert np.abs(here.attitude).max() < 1e-12


def test_wander_has_its_rms_and_stops_with_the_vehicle():
    wander = Wander(heading_deg=1.0, pitch_deg=0.5, roll_deg=2.0)
    value, rate = wander.at(np.arange(0.0, 5000.0, 0.1))
    # incommensurate sinusoids over hundreds of periods: the rms settles to a percent
    np.testing.assert_allclose(np.degrees(value.std(axis=0)), [1.0, 0.5, 2.0], rtol=0.02)
    t = np.linspace(1, 50, 50)
    np.testing.assert_allclose(rate[10:501:10], derivative(lambda x: wander.at(x)[0], t, 0.01), atol=1e-9)


def test_rotation_takes_forward_to_heading():
    C = rotation(np.array([0.0]), np.array([0.1]), np.array([math.pi / 2]))[0]
    np.testing.assert_allclose(C[:, 0], [0.0, math.cos(0.1), -math.sin(0.1)], atol=1e-15)
    C = rotation(np.array([0.2]), np.array([0.0]), np.array([0.0]))[0]
    np.testing.assert_allclose(C[:, 1], [0.0, math.cos(0.2), math.sin(0.2)], atol=1e-15)
    np.testing.assert_allclose(C @ C.T, np.eye(3), atol=1e-15)


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: Motion(()), "at least one manoeuvre"),
        (lambda: Motion((Wait(1.0),), latitude_deg=90.0), "latitude_deg"),
        (lambda: Motion((Wait(1.0),)).at([2.0]), "lasts from 0 to 1"),
        (lambda: Motion((Wait(1.0),)).at([math.nan]), "lasts from 0 to 1"),
        (lambda: Motion((ChangeSpeed(1.0), Wait(1.0))).duration_s, "at rest"),
        (lambda: Motion((Straight(distance_m=1.0),)).duration_s, "ChangeSpeed first"),
        (lambda: Motion((Dive(1.0),)).duration_s, "ChangeSpeed first"),
        (lambda: Straight(), "either"),
        (lambda: Straight(1.0, 1.0), "either"),
        (lambda: Wait(0.0), "positive"),
        (lambda: Turn(90.0, rate_deg_s=-1.0), "positive"),
        (lambda: Dive(5.0, pitch_deg=-5.0), "between 0 and 80"),
        (lambda: Wander(period_s=0.0), "positive"),
    ],
)
def test_mistakes_are_named(build, words):
    with pytest.raises(ValueError, match=words):
        build()
