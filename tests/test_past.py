"""Kernels of readings whose place or clock is a state, and of equations that bend: twins, Jacobians, moments."""

from dataclasses import replace

import numpy as np
import pytest
from delayed_look import Sight
from kernel_inputs import assert_close, random_nav, readings, run_both, spd, uncalibrated_drive

import navfilter as nf
from navfilter.kernels import consistency, delayed_state, measurement, strapdown
from navfilter.kernels.compiling import addresses
from navfilter.kernels.compiling.addresses import address
from navfilter.models.state import NavState, matrix_from_euler

START = nf.Start(latitude_deg=50.0, longitude_deg=5.0)
ARM = {"lever_arm_b_m": (0.5, -0.2, 0.3), "lever_arm_sd_m": (0.3, 0.2, 0.1)}
BEACONS = ((50.001, 5.001, -40.0), (50.0, 4.999, -40.0))
KINDS = {
    "velocity": (nf.BodyVelocity(mounting_rad=(0.1, -0.2, 0.7), scale_sd=0.02, **ARM), [1.0, -0.4, 0.2]),
    "water": (nf.WaterVelocity(**ARM), [1.0, -0.4, 0.2]),
    "beams": (nf.DvlBeams(current_sd_m_s=0.2, **ARM), [1.0, -0.4, 0.2, 0.7, 0.9, -0.2, 0.1, 0.4]),
    "heading": (nf.Heading(bias_sd_rad=0.1), [0.4, np.nan]),
    "magnetometer": (nf.Heading(magnetometer=True, declination_rad=0.1), [24.0, 7.0, 30.0, np.nan]),
    "attitude": (nf.Attitude(), [0.1, -0.2, 0.3]),
    "course": (nf.Course(**ARM), [1.0, -0.4, np.nan]),
    "depth": (nf.Depth(**ARM), [12.0]),
    "position": (nf.Position(**ARM), [0.87, 0.09, 4.0]),
    "range": (nf.Range(beacons=BEACONS, scale_sd=0.01, **ARM), [400.0, 1.0]),
}


def looked(sensor, clock):
    """Sensor, the arguments of `delayed_state.sight` up to the state, and its sight."""
    sensor = replace(sensor, time_offset_sd_s=clock)
    sight = Sight(sensor, START)
    equation = address(sensor.kernel, addresses.EQUATION)
    return sensor, sight, (equation, address(delayed_state.inertial_motion, addresses.MOTION), sight.facts)


def steady(rng, elements=()):
    """A drive that has felt the same turn and force for 3 s, and its states."""
    k = 6 + len(elements)
    drv, xd, _, _, Cr, _ = uncalibrated_drive(rng, 6, elements)
    drv[strapdown.PREVIOUS : strapdown.PREVIOUS + 6] = felt = [0.1, -0.05, 0.3, 0.2, -0.1, -9.7]
    drv[strapdown.INERTIAL] = 1.0
    drv[strapdown.CALIBRATION + np.array(elements, dtype=int)] = xd[6:]
    recent = np.column_stack([np.full(300, 0.01), np.tile(felt, (300, 1))])
    return drv, recent, Cr, xd[:k]


@pytest.mark.parametrize("elements", [(), (0, 4, 7, 9, 13, 17)], ids=len)
@pytest.mark.parametrize("increments", [0.0, 1.0])
def test_outputs_and_inertial_motion(increments, elements):
    rng = np.random.default_rng(1)
    drv, recent, Cr, xd = steady(rng, elements)
    drv[strapdown.INCREMENTS], drv[strapdown.HELD_S] = increments, 0.004
    recent[:, 1:] += rng.normal(size=(300, 6))
    recent[250:, 0] = 0.0
    shape = (6, len(xd))
    ours, twins = run_both(delayed_state.drive_outputs, drv, Cr, xd, np.zeros(shape), np.zeros(6))
    assert_close(ours, twins, 1e-13)
    ours, twins = run_both(
        delayed_state.inertial_motion, recent, random_nav(rng), drv, ours[-1], np.zeros((301, 7)), np.zeros(1)
    )
    assert_close(ours[-2:], twins[-2:], 1e-13)


@pytest.mark.parametrize("known", [0, 1, 2, 40])
def test_reckoned_motion(known):
    rng = np.random.default_rng(2)
    drv, _, _, _ = steady(rng)
    drv[strapdown.HELD_S] = 0.1
    recent = np.column_stack([np.full(40, 0.25), 3.0 * rng.normal(size=(40, 3)), rng.normal(size=(40, 3))])
    recent[known:] = 0.0
    recent[3:5, 5] = np.nan, 99.0  # lost
    args = recent, random_nav(rng), drv, np.zeros(6), np.ones((41, 7)), np.ones(1)
    ours, twins = run_both(delayed_state.dead_reckoning_motion, *args)
    assert_close(ours[-2:], twins[-2:], 1e-12)
    assert bool(ours[-2].any()) == (known > 1)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("inertial", [True, False])
@pytest.mark.parametrize("since_s", [0.3, -0.4])
@pytest.mark.parametrize(("clock", "variance"), [(0.0, 0.0), (0.4, 0.16), (0.4, 1e-4)])
def test_sight_equals_its_twin_and_that_of_users_kinds(kind, clock, variance, inertial, since_s):
    rng = np.random.default_rng(3)
    sensor, sight, head = looked(KINDS[kind][0], clock)
    if not (clock or any(sensor.lever_arm_sd_m)):
        return
    drv, recent, Cr, xd = steady(rng, (0, 4, 7, 9, 13, 17))
    recent[:, 1:] += 0.1 * rng.normal(size=(300, 6))
    recent[0, 1:] = drv[:6]
    drv[strapdown.INERTIAL] = inertial
    drv[strapdown.STEADY_C : strapdown.STEADY_C + 9] = matrix_from_euler(0.1, -0.2, 0.7).ravel()
    nav, par = random_nav(rng), 0.05 * rng.normal(size=len(sensor.all_parameters()))
    a, z = sensor.axes, np.array(KINDS[kind][1])
    into = np.zeros((a, 9 + len(xd) + 5)), np.zeros((a, 9 + len(par))), np.zeros(a), np.eye(a)
    here = z, nav, np.array([0.1, 0.2, 0.3]), par, sensor.constants(START)
    pushes = 1e-4 * np.array([[2.0, 0.5, -0.2], [0.5, 1.0, 0.1], [-0.2, 0.1, 0.3]])
    ours, twins = run_both(
        delayed_state.delayed_reading, *head, *here, recent, drv, Cr, xd, since_s, variance, pushes, *into
    )
    assert_close(ours[-4:], twins[-4:], 1e-9)  # quotients over 1e-3 of rounding
    imu = nf.Imu(rate_hz=100.0)
    outputs, errors = imu.outputs(Cr, drv, xd)
    near, res, H, R = np.zeros_like(into[1]), np.zeros(a), np.zeros((a, len(xd))), np.eye(a)
    known = imu.motion(recent, nav, drv, errors), since_s, outputs, (drv, Cr), (variance, pushes)
    sight.look(*here[:4], *known, (H, near, res, R))
    assert_close((ours[-4][:, 9 : 9 + len(xd)], *ours[-3:]), (H, near, res, R), 1e-9)
    assert ours[-4].any() == bool(clock)
    assert np.all(np.diag(R) >= 1.0) and (R[0, 0] > 1.0) == bool(clock)


@pytest.mark.parametrize("kind", ["velocity", "water", "beams"])
@pytest.mark.parametrize("clock", [0.0, 0.4])
def test_a_component_that_is_missing_has_the_slopes_of_one_that_is_read(kind, clock):
    rng = np.random.default_rng(6)
    sensor, _, head = looked(KINDS[kind][0], clock)
    drv, recent, Cr, xd = steady(rng)
    recent[:, 1:] += 0.1 * rng.normal(size=(300, 6))
    nav, par, a = random_nav(rng), 0.05 * rng.normal(size=len(sensor.all_parameters())), sensor.axes
    found = []
    for missing in ((), (0,)):
        z, near, res = np.array(KINDS[kind][1]), np.zeros((a, 9 + len(par))), np.zeros(a)
        z[list(missing)] = np.nan
        here = z, nav, np.array([0.1, 0.2, 0.3]), par, sensor.constants(START), recent, drv, Cr, xd, 0.05, 0.01
        delayed_state.delayed_reading(*head, *here, np.zeros((3, 3)), np.zeros((a, 9 + len(xd))), near, res, np.eye(a))
        found.append((near, res))
    (near, res), (less, left) = found
    np.testing.assert_allclose(less, near, atol=1e-9)
    assert np.isfinite(res).all() and np.flatnonzero(np.isnan(left)).tolist() == [0]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("clock", [0.0, 0.4])
def test_jacobians_of_sight_equal_finite_differences(kind, clock):
    rng = np.random.default_rng(4)
    sensor, _, head = looked(KINDS[kind][0], clock)
    if not (clock or any(sensor.lever_arm_sd_m)):
        return
    drv, recent, Cr, xd = steady(rng)
    Cr[:, -1] = 0.0  # without noise a slope counts in full
    nav = random_nav(rng)
    nav[:3] = np.radians(50.0003), np.radians(5.0002), -10.0
    nav[15:17] = np.array(strapdown.radii(nav[0])) + nav[2]
    state, par, a = NavState.unpack(0.0, nav), 0.02 * rng.normal(size=len(sensor.all_parameters())), sensor.axes
    z, rate = np.array(KINDS[kind][1]), recent[0, 1:4] - (Cr[:3, :-1] @ xd)

    def residual(state, par):
        near, res, H = np.zeros((a, 9 + len(par))), np.zeros(a), np.zeros((a, 9 + len(xd)))
        here = z, state.pack(), rate, par, sensor.constants(START)
        delayed_state.delayed_reading(
            *head, *here, recent, drv, Cr, xd, 0.05, 0.01, np.zeros((3, 3)), H, near, res, np.eye(a)
        )
        return near, res

    if kind == "position":
        z[:2] = nav[:2] + 1e-7
    for _ in range(50 if kind == "magnetometer" else 0):  # its slopes are those of the field that is predicted
        turn = matrix_from_euler(0.0, 0.0, residual(state, par)[1][0])
        z[:3] = state.C_nb.T @ turn @ state.C_nb @ z[:3]
    near, res = residual(state, par)
    assert np.isfinite(near[np.isfinite(res)]).all() and np.isfinite(res).any()
    for j in range(9 + len(par)):
        if sensor.observes.in_body_axes and j > 8 and sensor.all_parameters()[j - 9].name.startswith("scale"):
            continue  # what it makes of the arm's turn is left out: see test_measurement
        step, ends = (10.0 if j < 3 else 0.1 if j < 6 else 1e-3), []
        step = 0.1 if kind == "range" and j < 3 else step  # it bends over 10 m
        for sign in (1.0, -1.0):
            error, moved = np.zeros(9), par.copy()
            if j < 9:
                error[j] = sign * step
            else:
                moved[j - 9] += sign * step
            ends.append(residual(state.plus(error), moved)[1])
        slope = -(ends[0] - ends[1]) / (2.0 * step)
        seen = np.isfinite(slope)
        # as in test_measurement: rounding of 1e-9 m, and the second order of a rotation
        np.testing.assert_allclose(near[seen, j], slope[seen], rtol=2e-5, atol=3e-5)


@pytest.mark.parametrize("known", [True, False])
def test_bends_equal_their_twins(known):
    rng = np.random.default_rng(5)
    nav = random_nav(rng)
    found = [given for given in readings(rng, nav) if given[0] in (measurement.slant_range, measurement.usbl)]
    for kernel, z, cfg, (size,), a in found:
        near, res = np.zeros((a, 9 + size)), np.zeros(a)
        kernel(z, nav, np.zeros(3), np.zeros(size), cfg, near, res)
        bend = consistency.range_second_order if kernel is measurement.slant_range else consistency.usbl_second_order
        z = z if known or a == 1 else np.where(np.arange(len(z)) == 0, np.nan, z)
        ours, twins = run_both(bend, z, near, 100.0 * spd(rng, 14 + size), 12, cfg, np.eye(a))
        assert_close(ours[-1:], twins[-1:], 1e-12)
        assert np.all(np.diag(ours[-1]) > 1.0)
