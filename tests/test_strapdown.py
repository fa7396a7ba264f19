"""Mechanisations against independent integrators, exact motion, closed forms, and finite differences."""

import dataclasses
import math

import naive
import numpy as np
import pyins.sim
import pyins.strapdown
import pytest
from geographiclib.geodesic import Geodesic
from kernel_inputs import imu_samples, random_drive, random_nav, uncalibrated_drive

import navfilter as nf
from navfilter.kernels import strapdown
from navfilter.models.state import (
    NavState,
    euler_from_matrix,
    matrix_from_euler,
    rotation_matrix,
    rotation_vector,
    wrap,
)
from navfilter.simulation.manoeuvres import ChangeSpeed, Dive, FigureEight, SpiralDive, Straight, Turn
from navfilter.simulation.motion import Motion, Wander
from navfilter.track.track import _metres

RATE_HZ = 100.0


# ---------------------------------------------------------------- ten minutes without noise
@pytest.fixture(scope="module")
def motion():
    lap = (
        Straight(duration_s=15.0),
        Turn(120.0),
        Dive(30.0, pitch_deg=20.0),
        FigureEight(rate_deg_s=10.0),
        SpiralDive(5.0),
        ChangeSpeed(2.5),
        Turn(-200.0),
    )
    return Motion(
        lap * 6, latitude_deg=48.0, longitude_deg=-5.0, heading_deg=20.0, speed_m_s=2.0, depth_m=5.0, wander=Wander()
    )


def truth_at(motion, times):
    here = motion.at(times)
    return np.column_stack([here.latitude, here.longitude, here.height, here.velocity_n]), here.C_nb


def differences(out, place, C):
    """Largest difference in metres, m/s, rad."""
    metres = _metres(*out[:, :3].T, *place[:, :3].T)
    turn = rotation_vector(out[:, 6:15].reshape(-1, 3, 3) @ np.swapaxes(C, 1, 2))
    return np.abs(metres).max(), np.abs(out[:, 3:6] - place[:, 3:6]).max(), np.abs(turn).max()


def without_errors(nav, drv, samples, out):
    """Strapdown alone: the state after each sample goes to the rows of out (n, 17), if it has any."""
    none, output, acc = np.zeros((0, 0)), np.zeros((6, 1)), np.vstack([np.eye(9), np.zeros((27, 9))])
    for begin in range(0, len(samples), 1 if len(out) else len(samples)):
        block = samples[begin : begin + 1] if len(out) else samples
        strapdown.imu_steps(nav, np.zeros(0), drv, block, none, none, output, acc)
        out[begin : begin + 1] = nav


def integrate(place, C, samples, increments):
    nav = NavState(0.0, *place[:3], place[3:6], C).pack()
    drv = nf.Imu(rate_hz=RATE_HZ, increments=increments).memory(0)
    out = np.zeros((len(samples), 17))
    without_errors(nav, drv, samples, out)
    return out


def python_ins(begin, imu, kind):
    """Rows of python-ins' own integration: place and velocity (n, 6), attitude matrices."""
    frame = pyins.strapdown.Integrator(begin).integrate(pyins.strapdown.compute_increments_from_imu(imu, kind))
    place = np.column_stack([np.radians(frame[["lat", "lon"]]), frame[["alt", "VN", "VE", "VD"]]])
    return place, matrix_from_euler(*np.radians(frame[["roll", "pitch", "heading"]].values.T))


@pytest.mark.parametrize("kind", ["rate", "increment"])
def test_strapdown_equals_python_ins_for_ten_minutes(motion, kind):
    times = np.arange(0.0, 600.0 + 1e-9, 1.0 / RATE_HZ)
    place, C = truth_at(motion, times)
    degrees = np.column_stack([np.degrees(place[:, :2]), place[:, 2]])
    trajectory, imu = pyins.sim.generate_imu(
        times, degrees, np.degrees(euler_from_matrix(C)), place[:, 3:], sensor_type=kind
    )
    theirs, C_theirs = python_ins(trajectory.iloc[0], imu, kind)
    readings = imu[["gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"]].values
    nav = NavState(0.0, *place[0, :3], place[0, 3:], C[0]).pack()
    drv, out = nf.Imu(rate_hz=RATE_HZ, increments=kind == "increment").memory(0), np.zeros((len(times) - 1, 17))
    drv[strapdown.PREVIOUS : strapdown.PREVIOUS + 6], drv[strapdown.STARTED] = (
        readings[0],
        1.0,
    )  # python-ins starts from the reading before
    without_errors(nav, drv, np.column_stack([np.diff(times), readings[1:]]), out)
    position, velocity, attitude = differences(out[::50], theirs[1::50], C_theirs[1::50])
    assert position < 1e-3
    assert velocity < 1e-5
    assert attitude < 1e-6
    # Against the motion itself, both err alike: a third of a metre from rates that do not change linearly, 17 mm from
    # increments.
    ours, python = (
        differences(out[::50], place[1::50], C[1::50]),
        differences(np.hstack([theirs, C_theirs.reshape(-1, 9)])[1::50], place[1::50], C[1::50]),
    )
    np.testing.assert_allclose(ours[:2], python[:2], rtol=0.02)
    assert ours[0] < (0.5 if kind == "rate" else 0.02) and ours[2] < 1e-6


@pytest.mark.parametrize(("increments", "rate_hz", "position_m"), [(True, 500.0, 1e-3), (False, 1000.0, 6e-3)])
def test_strapdown_converges_to_the_exact_motion(motion, increments, rate_hz, position_m):
    """The error is of second order in the step, so fast samples show that nothing else is missing: 17 mm / 25; 0.34 m /
    100, and rounding.
    """
    times, gyro, accel = motion.inertial(rate_hz, increments=increments, duration_s=600.0)
    checked = np.arange(0.0, 601.0, 60.0)
    place, C = truth_at(motion, checked)
    samples = np.column_stack([np.diff(times, prepend=0.0), gyro, accel])
    nav = NavState(0.0, *place[0, :3], place[0, 3:], C[0]).pack()
    drv = nf.Imu(rate_hz=rate_hz, increments=increments).memory(0)
    for k in range(1, len(checked)):
        block = samples[(times > checked[k - 1] + 1e-9) & (times <= checked[k] + 1e-9)]
        without_errors(nav, drv, np.ascontiguousarray(block), np.zeros((0, 17)))
        position, velocity, attitude = differences(nav[None], place[k : k + 1], C[k : k + 1])
        assert position < position_m
        assert velocity < 5e-5
        assert attitude < 2e-8


@pytest.mark.parametrize("increments", [False, True])
def test_holds_between_samples_change_when_not_what(motion, increments):
    """Corrections between samples hold the state to their time: what comes after the next sample is nearly the same as
    without.
    """
    times, gyro, accel = motion.inertial(RATE_HZ, increments=increments, duration_s=60.0)
    place, C = truth_at(motion, np.array([0.0]))
    samples = np.column_stack([np.diff(times, prepend=0.0), gyro, accel])
    plain = integrate(place[0], C[0], samples, increments)[-1]
    rng = np.random.default_rng(0)
    drv, xd, Phid, Qd, Cr, acc = random_drive(rng, 0, INCREMENTS=float(increments))
    nav = NavState(0.0, *place[0, :3], place[0, 3:6], C[0]).pack()
    for k in range(len(samples)):
        strapdown.imu_steps(nav, xd, drv, samples[k : k + 1], Phid, Qd, Cr, acc)
        if k % 7 == 0 and k + 1 < len(samples):
            for part in (0.003, 0.004):
                strapdown.imu_hold(nav, xd, drv, part, Phid, Qd, Cr, acc)
    position, velocity, attitude = differences(nav[None], plain[None, :6], plain[None, 6:15].reshape(1, 3, 3))
    # A split step sees half its coning term at another attitude: some 1e-9 rad each, 860 times.
    assert (position, velocity, attitude) < (2e-3, 1e-4, 1e-5)


def test_dead_reckoning_follows_the_exact_motion(motion):
    """Lever arm and mounting included; the trapezoidal rule at 20 Hz is what is left."""
    arm, mounting = (0.6, -0.2, 0.3), (0.05, -0.1, 0.8)
    sensor = nf.BodyVelocity(rate_hz=20.0, lever_arm_b_m=arm, mounting_rad=mounting)
    drive = nf.DeadReckoning(rate_hz=20.0, velocity=sensor)
    times = np.arange(0.0, 300.0 + 1e-9, 0.05)
    here = motion.at(times)
    v_b = np.einsum("nij,ni->nj", here.C_nb, here.velocity_n) + np.cross(here.rate_eb_b, arm)
    samples = np.column_stack([np.diff(times, prepend=0.0), here.attitude, v_b @ matrix_from_euler(*mounting)])
    nav = NavState(0.0, here.latitude[0], here.longitude[0], here.height[0], here.velocity_n[0], here.C_nb[0]).pack()
    acc, Cr = np.vstack([np.eye(9), np.zeros((27, 9))]), np.zeros((6, 1))
    strapdown.dead_reckoning_steps(
        nav, np.zeros(0), drive.memory(0), samples, np.zeros((0, 0)), np.zeros((0, 0)), Cr, acc
    )
    end = np.concatenate([[here.latitude[-1], here.longitude[-1], here.height[-1]], here.velocity_n[-1]])
    position, velocity, attitude = differences(nav[None], end[None], here.C_nb[-1:])
    assert position < 0.02  # of 600 m
    assert velocity < 0.01  # the arm's velocity is half a sample old
    assert attitude < 1e-12


# ---------------------------------------------------------------- the Earth
def test_radii_against_closed_forms():
    a, b = 6378137.0, 6378137.0 * math.sqrt(1.0 - 6.69437999014e-3)
    equator, pole = strapdown.radii(0.0), strapdown.radii(math.pi / 2)
    np.testing.assert_allclose(equator, [b * b / a, a], rtol=1e-14)
    np.testing.assert_allclose(pole, [a * a / b, a * a / b], rtol=1e-14)
    # a meridian quadrant is 10 001 965.729 m
    latitudes = np.linspace(0.0, math.pi / 2, 2001)
    meridian = [strapdown.radii(latitude)[0] for latitude in latitudes]
    assert abs(np.trapezoid(meridian, latitudes) - 10001965.729) < 0.01


def test_gravity_against_the_constants_of_wgs84():
    assert strapdown.gravity(0.0, 0.0) == pytest.approx(9.7803253359, abs=1e-12)
    assert strapdown.gravity(math.pi / 2, 0.0) == pytest.approx(9.8321849378, abs=1e-9)
    assert strapdown.gravity(math.radians(45.0), 0.0) == pytest.approx(
        9.8061977, abs=1e-6
    )  # Groves (2013), fig. 2.22: 9.806
    slope = (strapdown.gravity(0.7, 100.0) - strapdown.gravity(0.7, -100.0)) / 200.0
    assert slope == pytest.approx(-3.086e-6, rel=5e-3)  # free-air gradient


@pytest.mark.parametrize("latitude_deg", [-75.0, -30.0, 0.0, 45.0, 80.0])
def test_plus_and_track_metres_against_geographiclib(latitude_deg):
    state = NavState(0.0, math.radians(latitude_deg), math.radians(179.9995), 0.0, np.zeros(3), np.eye(3))
    for north, east in ((300.0, 0.0), (0.0, 300.0), (-200.0, 150.0)):
        moved = state.plus([north, east, 0, 0, 0, 0, 0, 0, 0])
        line = Geodesic.WGS84.Inverse(
            latitude_deg, 179.9995, math.degrees(moved.latitude), math.degrees(moved.longitude)
        )
        azimuth = math.radians(line["azi1"])
        # a metre on the tangent plane against one on the ellipsoid: d^2 tan(latitude) / 2R, some 4 cm for 300 m at 80
        # degrees
        slack = 1e-3 + (north**2 + east**2) * (1.0 + abs(math.tan(state.latitude))) / 6.3e6
        np.testing.assert_allclose(
            [line["s12"] * math.cos(azimuth), line["s12"] * math.sin(azimuth)], [north, east], atol=slack
        )
        metres = _metres(moved.latitude, moved.longitude, 5.0, state.latitude, state.longitude, 0.0)
        middle = 0.5 * (line["azi1"] + line["azi2"])  # mid-latitude formulas: third order
        expected = [line["s12"] * math.cos(math.radians(middle)), line["s12"] * math.sin(math.radians(middle)), -5.0]
        np.testing.assert_allclose(metres, expected, atol=1e-3)


def test_minus_undoes_plus():
    rng = np.random.default_rng(0)
    state = NavState.unpack(0.0, random_nav(rng))
    error = np.concatenate([rng.normal(size=3), rng.normal(size=3), 0.5 * rng.normal(size=3)])
    # to first order in metres over the Earth's radius: 1e-7 of the position
    np.testing.assert_allclose(state.plus(error).minus(state), error, atol=1e-6)
    np.testing.assert_allclose(state.plus(error).plus(-error).minus(state)[[3, 4, 5, 6, 7, 8]], 0.0, atol=1e-12)
    np.testing.assert_array_equal(NavState.unpack(0.0, state.pack()).C_nb, state.C_nb)


def test_rotations():
    rng = np.random.default_rng(1)
    for scale in (1e-9, 1e-4, 1.0, 3.0):
        v = scale * rng.normal(size=3) / math.sqrt(3)
        np.testing.assert_allclose(rotation_matrix(v), naive.rotation(v), atol=1e-13)
        np.testing.assert_allclose(rotation_vector(rotation_matrix(v)), v, atol=1e-12, rtol=1e-7)
    angles = rng.uniform([-3, -1.5, -3], [3, 1.5, 3], (20, 3))
    np.testing.assert_allclose(euler_from_matrix(matrix_from_euler(*angles.T)), angles, atol=1e-12)
    np.testing.assert_allclose(matrix_from_euler(*angles[0]), naive.euler(*angles[0]), atol=1e-13)
    assert wrap(math.pi) == -math.pi and wrap(-math.pi) == -math.pi and wrap(0.1) == pytest.approx(0.1)


# ---------------------------------------------------------------- Jacobians by finite differences
# Ten metres move a latitude by 1.6e-6 rad, which is rounded at 1e-16: 1e-9 m, or 1e-10 of the step. Smaller steps drown
# in that, larger ones see the curvature of the Earth (10 m over 6.4e6 m, squared in a central difference).
STEPS = np.array([10.0] * 3 + [0.1] * 3 + [1e-3] * 3)


def numeric(run, nav, xd, drv, drive_steps):
    """Derivative of the state and of the drive's states after `run` with respect to both before it; and the state
    after.
    """
    state = NavState.unpack(0.0, nav)
    m = 9 + len(xd)
    columns = []
    for j in range(m):
        ends = []
        for sign in (1.0, -1.0):
            moved, x, memory = state, xd.copy(), drv.copy()
            if j < 9:
                error = np.zeros(9)
                error[j] = sign * STEPS[j]
                moved = state.plus(error)
                # the velocity of the lever arm, remembered in n, turns with the attitude; so does what it comes from
                turn = rotation_matrix(error[6:9])
                memory[56:59], memory[78:87] = turn @ memory[56:59], (turn @ memory[78:87].reshape(3, 3)).ravel()
            else:
                x[j - 9] += sign * drive_steps[j - 9]
            ends.append(run(moved.pack(), x, memory))
        step = STEPS[j] if j < 9 else drive_steps[j - 9]
        middle = NavState.unpack(0.0, run(state.pack(), xd.copy(), drv.copy())[0])
        up, down = (np.concatenate([NavState.unpack(0.0, n).minus(middle), x]) for n, x in ends)
        columns.append((up - down) / (2.0 * step))
    return np.column_stack(columns)


def compare(analytic, difference, drive_scale, tolerance):
    """Elements in units of what errors amount to: 10 m, 1 m/s, 0.01 rad and the drive's own, so that all count
    alike.
    """
    scale = np.concatenate([[10.0] * 3, [1.0] * 3, [0.01] * 3, drive_scale])
    np.testing.assert_allclose(
        analytic * scale / scale[:, None], difference * scale / scale[:, None], rtol=0, atol=tolerance
    )


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("increments", [False, True])
@pytest.mark.parametrize("kind", ["step", "hold"])
@pytest.mark.parametrize("elements", [(), tuple(range(18))], ids=["errors", "calibration"])
def test_strapdown_transition_equals_finite_differences(kind, increments, seed, elements):
    rng = np.random.default_rng(seed)
    drv, xd, Phid, Qd, Cr, acc = uncalibrated_drive(rng, 6, elements, INCREMENTS=float(increments))
    Cr[:3] *= 0.01
    nav, samples = random_nav(rng), imu_samples(rng, 2, increments)
    strapdown.imu_steps(nav, xd, drv, samples[:1], Phid, Qd, Cr, acc.copy())

    def run(n, x, memory, a=None):
        a = acc.copy() if a is None else a
        if kind == "step":
            strapdown.imu_steps(n, x, memory, samples[1:], Phid, Qd, Cr, a)
        else:
            strapdown.imu_hold(n, x, memory, 0.006, Phid, Qd, Cr, a)
        return n, x

    a = acc.copy()
    run(nav.copy(), xd.copy(), drv.copy(), a)
    drive_scale = np.array([0.1] * 6 + [0.01] * len(elements))
    # The transition is of second order in the step: 10 ms with 0.3 rad/s and 10 m/s^2 leave (0.003)^2 of 0.1 m/s, and
    # the variation of gravity with latitude (1e-8 1/s^2) is left out on purpose.
    compare(a[: 15 + len(elements)], numeric(run, nav, xd, drv, drive_scale * 0.1), drive_scale, 3e-6)


def test_strapdown_transition_compounds(motion):
    """Over ten seconds of turns the product of the transitions is still the derivative: the small terms are right
    too.
    """
    times, gyro, accel = motion.inertial(RATE_HZ, duration_s=30.0)
    rng = np.random.default_rng(1)
    drv, xd, Phid, Qd, Cr, acc = random_drive(rng, 6)
    Phid, Cr[:, :6], xd = np.eye(6), np.eye(6), np.zeros(6)
    samples = np.column_stack([np.diff(times, prepend=0.0), gyro, accel])[1:]
    here = motion.at([0.0])
    nav = NavState(0.0, here.latitude[0], here.longitude[0], here.height[0], here.velocity_n[0], here.C_nb[0]).pack()

    def run(n, x, memory, a=None):
        strapdown.imu_steps(n, x, memory, samples, Phid, Qd, Cr, acc.copy() if a is None else a)
        return n, x

    a = acc.copy()
    run(nav.copy(), xd.copy(), drv.copy(), a)
    drive_scale = np.array([1e-3] * 3 + [0.05] * 3)
    # In 30 s the gravity gradient that is left out (1e-8 1/s^2) makes 5e-6.
    compare(a[:15], numeric(run, nav, xd, drv, drive_scale * 0.1), drive_scale, 1e-5)


DEAD_RECKONING = {
    "plain": ({}, 6),
    "arm": ({"LEVER": (0.8, -0.3, 0.4)}, 6),
    "deviation": ({"LEVER": (0.8, -0.3, 0.4), "DEVIATION": 6}, 10),
    "calibration": ({"SCALE": 6}, 10),
    "all": ({"LEVER": (0.8, -0.3, 0.4), "DEVIATION": 6, "SCALE": 10}, 14),
    "clocks": ({"LEVER": (0.8, -0.3, 0.4), "SCALE": 6, "ATTITUDE_CLOCK": 10, "VELOCITY_CLOCK": 11}, 12),
    "current": ({"LEVER": (0.8, -0.3, 0.4), "SCALE": 6, "CURRENT": 10}, 12),
    "uncertain arm": ({"LEVER": (0.8, -0.3, 0.4), "ARM": 6, "VELOCITY_CLOCK": 9, "ATTITUDE_CLOCK": 10}, 11),
}


@pytest.mark.parametrize("lost", ["nothing", "velocity", "attitude", "both"])
@pytest.mark.parametrize("case", DEAD_RECKONING)
def test_dead_reckoning_transition_equals_finite_differences(case, lost):
    settings, k = DEAD_RECKONING[case]
    rng = np.random.default_rng(7)
    drv, xd, Phid, Qd, Cr, acc = random_drive(rng, k, PERIOD_S=0.25, **settings)
    Phid, Cr[:, :k] = np.eye(k), 0.0
    Cr[:, :6] = np.eye(6)
    if "DEVIATION" in settings:  # its slopes are at what is read, and not at what that is believed to err by
        xd[:6] = 0.0
    if "ARM" in settings:  # slopes by it are those of the attitude as it is read
        xd[:6], xd[9:], Cr[:, k] = 0.0, 0.0, 0.0
        Qd[:6] = Qd[:, :6] = 0.0
    nav = random_nav(rng)
    samples = np.column_stack([np.full(2, 0.25), [[0.1, -0.2, 1.0], [0.13, -0.17, 1.08]], [[1.5, 0.2, -0.1]] * 2])
    before = samples[:1].copy()
    before[0, 1:] += [0.02, -0.01, -0.03, -0.1, 0.05, 0.02]
    strapdown.dead_reckoning_steps(nav, xd, drv, before, Phid, Qd, Cr, acc.copy())
    strapdown.dead_reckoning_steps(nav, xd, drv, samples[:1].copy(), Phid, Qd, Cr, acc.copy())
    strapdown.dead_reckoning_hold(nav, xd, drv, 0.1, Phid, Qd, Cr, acc.copy())
    if lost in ("velocity", "both"):
        samples[1, 4:] = np.nan
    if lost in ("attitude", "both"):
        samples[1, 1:4] = np.nan

    def run(n, x, memory, a=None):
        strapdown.dead_reckoning_steps(n, x, memory, samples[1:].copy(), Phid, Qd, Cr, acc.copy() if a is None else a)
        # how the way bends counts as known: no sum is taken of it
        bent = np.r_[memory[strapdown.BENT : strapdown.BENT + 3], np.zeros(6)]
        return NavState.unpack(0.0, n).plus(bent).pack(), x

    # the clock of the velocity sees how it changed a reading before: here as it does now
    now, places = drv.copy(), slice(strapdown.SLOPES, strapdown.SLOPES + 3)
    run(nav.copy(), xd.copy(), now)
    drv[places], a = now[places], acc.copy()
    run(nav.copy(), xd.copy(), drv.copy(), a)
    drive_scale = np.array([0.01] * 3 + [0.1] * 3 + [0.01] * (k - 6))
    # Exact but for terms of the Earth's curvature in the lever arm (1 m over 6e6 m).
    compare(a[: 9 + k], numeric(run, nav, xd, drv, drive_scale * 0.05), drive_scale, 1e-6)


def test_dead_reckoning_hold_equals_finite_differences():
    rng = np.random.default_rng(8)
    drv, xd, Phid, Qd, Cr, acc = random_drive(rng, 3)
    nav = random_nav(rng)

    def run(n, x, memory, a=None):
        strapdown.dead_reckoning_hold(n, x, memory, 0.2, Phid, Qd, Cr, acc.copy() if a is None else a)
        return n, x

    a = acc.copy()
    run(nav.copy(), xd.copy(), drv.copy(), a)
    compare(
        a[:12], numeric(run, nav, xd, drv, np.full(3, 0.1)), np.full(3, 0.1), 1e-8
    )  # second order: (0.2 s x 5 m/s / 6e6 m) x 0.02


def test_white_noise_of_the_drive_spreads_the_state_as_its_covariance_says():
    """Monte Carlo over the samples' noise: the covariance that the kernels gather is that of the state (within what
    1500 runs can tell).
    """
    rng, runs, n = np.random.default_rng(9), 1500, 150
    for kernel, drive, sd in (
        (
            strapdown.imu_steps,
            nf.Imu(rate_hz=20.0, gyro=nf.White(sd=0.01), accel=nf.White(sd=0.1)),
            [0.01] * 3 + [0.1] * 3,
        ),
        (
            strapdown.dead_reckoning_steps,
            nf.DeadReckoning(
                rate_hz=20.0,
                attitude=nf.White(sd=0.01),
                velocity=nf.BodyVelocity(rate_hz=20.0, error=nf.White(sd=0.1), lever_arm_b_m=(0.5, 0.1, 0.2)),
            ),
            [0.01] * 3 + [0.1] * 3,
        ),
    ):
        inertial = isinstance(drive, nf.Imu)
        base = np.array([0.02, 0.01, 0.3, 0.5, 0.2, -9.7]) if inertial else np.array([0.1, 0.05, 0.3, 1.5, 0.1, 0.05])
        samples = np.column_stack([np.full(n, 0.05), np.tile(base, (n, 1))])
        samples[:, 3] += 0.0 if inertial else np.arange(n) * 0.015
        nav0 = NavState(0.0, 0.7, 0.1, -5.0, np.array([1.4, 0.4, 0.0]), matrix_from_euler(0.1, 0.05, 0.3)).pack()
        Cr, none = np.array(sd)[:, None] ** 2, np.zeros((0, 0))

        def run(noise, a, kernel=kernel, drive=drive, samples=samples, nav0=nav0, Cr=Cr, none=none):
            nav, moved = nav0.copy(), samples.copy()
            moved[:, 1:] += noise
            kernel(nav, np.zeros(0), drive.memory(0), moved, none, none, Cr, a)
            return NavState.unpack(0.0, nav)

        blank = np.vstack([np.eye(9), np.zeros((27, 9))])
        acc = blank.copy()
        middle = run(0.0, acc)
        errors = np.array([run(rng.normal(size=(n, 6)) * sd, blank.copy()).minus(middle) for _ in range(runs)])
        Q = acc[9:18]
        unit = np.sqrt(np.diag(Q))
        spread = np.cov(errors.T) / np.outer(unit, unit)
        # Correlations from 1500 runs have an sd of 0.026, relative variances 0.037; the first inertial sample stands
        # for the one before it too, which adds 3 % to the variance of the position.
        np.testing.assert_allclose(spread, Q / np.outer(unit, unit), atol=0.14)


def test_limits_of_the_drives():
    assert nf.Imu(rate_hz=100.0).limits().tolist() == [50.0] * 3 + [1000.0] * 3
    assert nf.Imu(rate_hz=100.0, increments=True).limits() == pytest.approx([0.5] * 3 + [10.0] * 3)
    with pytest.raises(ValueError, match="rate_hz"):
        dataclasses.replace(nf.Imu(rate_hz=100.0), rate_hz=0.0)
