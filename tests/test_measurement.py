"""Measurement kernels: Jacobians by finite differences, signs, and what the sensors let through."""

import math

import numpy as np
import pytest
from gsw import p_from_z
from kernel_inputs import random_nav, readings

import navfilter as nf
from navfilter.kernels import measurement
from navfilter.models.sensors import Sensor
from navfilter.models.state import NavState, matrix_from_euler

STEPS = np.array(
    [10.0] * 3 + [0.1] * 3 + [1e-3] * 3
)  # see test_strapdown: 10 m against the rounding of radians times 6.4e6 m


def evaluate(kernel, z, state, rate, par, cfg, axes):
    H, res = np.zeros((axes, 9 + len(par))), np.zeros(axes)
    kernel(z, state.pack(), rate, par, cfg, H, res)
    return H, res


@pytest.mark.parametrize("seed", range(4))
def test_jacobians_equal_finite_differences(seed):
    rng = np.random.default_rng(seed)
    nav = random_nav(rng)
    state, rate = NavState.unpack(0.0, nav), 0.2 * rng.normal(size=3)
    for kernel, z, cfg, sizes, axes in readings(rng, nav):
        for size in sizes:
            par = 0.05 * rng.normal(size=size)
            if kernel is measurement.magnetometer:
                z = as_predicted(z, state, rate, par, cfg)
            H, res = evaluate(kernel, z, state, rate, par, cfg, axes)
            scales = scales_of(kernel, cfg, size)
            for j in range(9 + size):
                step = STEPS[j] if j < 9 else 1e-3
                turning = (
                    rate if j - 9 not in scales else np.zeros(3)
                )  # what a scale makes of an arm's turn is left out
                ends = []
                for sign in (1.0, -1.0):
                    error, moved = np.zeros(9), par.copy()
                    if j < 9:
                        error[j] = sign * step
                    else:
                        moved[j - 9] += sign * step
                    ends.append(evaluate(kernel, z, state.plus(error), turning, moved, cfg, axes)[1])
                # the reading is predicted plus residual: H is minus the slope of the residual
                slope = -(ends[0] - ends[1]) / (2.0 * step)
                seen = ~np.isnan(res)
                # Rounding 1e-9 m over 10 m; second order of a rotation by 1e-3 rad, 1e-6 / 6; metres east on the mid
                # parallel, 10 m / 6e6 m. Per metre and rad of up to 3 m/s or 1 m lever arm. A nearly vertical field
                # magnifies the second order.
                np.testing.assert_allclose(H[seen, j], slope[seen], rtol=2e-5, atol=6e-6)


def scales_of(kernel, cfg, size):
    """Which of so many parameters are scales of a velocity."""
    firsts = {"body_velocity": 0, "water_velocity": int(cfg[12]) if len(cfg) > 12 else 0, "beam_velocity": int(cfg[-1])}
    first = firsts.get(kernel.__name__)
    return () if first is None else range(first, size - 3)


def as_predicted(z, state, rate, par, cfg):
    """A field that reads what is predicted: the slopes of a magnetometer are those of what should have been read."""
    z = z.copy()
    for _ in range(50):
        (res,) = evaluate(measurement.magnetometer, z, state, rate, par, cfg, 1)[1]
        z[:3] = state.C_nb.T @ matrix_from_euler(0.0, 0.0, res) @ state.C_nb @ z[:3]
    assert abs(res) < 1e-9
    return z


def level(heading=0.0, velocity=(0.0, 0.0, 0.0)):
    return NavState(0.0, 0.7, 0.1, -20.0, np.array(velocity, dtype=float), matrix_from_euler(0.0, 0.0, heading))


def test_signs_of_the_residuals():
    """Residual = measured minus predicted, in plain situations."""
    still, none = np.zeros(3), np.zeros(0)
    state = level(heading=math.pi / 2, velocity=(0.0, 2.0, 0.0))  # eastward, nose east
    plain = np.concatenate([np.zeros(3), np.eye(3).ravel()])
    _, res = evaluate(measurement.body_velocity, np.array([2.5, 0.0, 0.0]), state, still, none, plain, 3)
    np.testing.assert_allclose(res, [0.5, 0.0, 0.0], atol=1e-12)
    # a turn to the right moves an instrument in front of the reference point to the right
    ahead = np.concatenate([[2.0, 0.0, 0.0], np.eye(3).ravel()])
    _, res = evaluate(
        measurement.body_velocity, np.array([2.0, 0.2, 0.0]), state, np.array([0.0, 0.0, 0.1]), none, ahead, 3
    )
    np.testing.assert_allclose(res, 0.0, atol=1e-12)
    # an instrument whose forward axis points to starboard sees the vehicle go to its left
    turned = np.concatenate([np.zeros(3), matrix_from_euler(0.0, 0.0, math.pi / 2).ravel()])
    _, res = evaluate(measurement.body_velocity, np.array([0.0, -2.0, 0.0]), state, still, none, turned, 3)
    np.testing.assert_allclose(res, 0.0, atol=1e-12)
    # water that flows east at 0.5 m/s carries a third of that speed: eastward, the log reads 1.5 m/s; a current north
    # comes from port
    flow = np.array([0.25, 0.5])
    _, res = evaluate(
        measurement.water_velocity, np.array([1.5, 0.25, 0.0]), state, still, flow, np.append(plain, 2.0), 3
    )
    np.testing.assert_allclose(res, 0.0, atol=1e-12)
    # declination east: a magnetic compass reads less than the true heading
    _, res = evaluate(
        measurement.heading, np.array([math.pi / 2 - 0.1, np.nan]), state, still, none, np.array([0.1, 20.0]), 1
    )
    np.testing.assert_allclose(res, 0.0, atol=1e-12)
    _, res = evaluate(
        measurement.heading,
        np.array([math.pi / 2 - 0.1 + 6 * math.pi + 0.02, np.nan]),
        state,
        still,
        none,
        np.array([0.1, 20.0]),
        1,
    )
    np.testing.assert_allclose(res, 0.02, atol=1e-12)
    # the field points to magnetic north and down; turned by 0.02 rad too far to the left, the azimuth of magnetic north
    # comes out too small
    field_n = matrix_from_euler(0.0, 0.0, 0.1) @ [20.0, 0.0, 40.0]
    field_b = matrix_from_euler(0.0, 0.0, math.pi / 2 + 0.02).T @ field_n
    _, res = evaluate(
        measurement.magnetometer, np.array([*field_b, np.nan]), state, still, none, np.array([0.1, 20.0, -1.0, -1.0]), 1
    )
    np.testing.assert_allclose(res, 0.02, atol=1e-12)
    # 20 m below the ellipsoid, surface at +3 m, gauge 0.5 m above the reference point: depth 22.5 m
    _, res = evaluate(measurement.depth, np.array([22.6]), state, still, none, np.array([0.0, 0.0, -0.5, 3.0]), 1)
    np.testing.assert_allclose(res, 0.1, atol=1e-12)
    moved = state.plus([3.0, -2.0, 1.0, 0, 0, 0, 0, 0, 0])
    _, res = evaluate(
        measurement.position,
        np.array([moved.latitude, moved.longitude, moved.height]),
        state,
        still,
        none,
        np.zeros(3),
        3,
    )
    np.testing.assert_allclose(res, [3.0, -2.0, 1.0], atol=1e-5)
    _, res = evaluate(measurement.velocity, np.array([0.1, 2.0, 0.0]), state, still, none, np.zeros(1), 3)
    np.testing.assert_allclose(res, [0.1, 0.0, 0.0], atol=1e-12)


def test_position_across_the_date_line():
    state = NavState(0.0, 0.2, math.pi - 1e-7, 0.0, np.zeros(3), np.eye(3))
    _, res = evaluate(
        measurement.position, np.array([0.2, -math.pi + 1e-7, 0.0]), state, np.zeros(3), np.zeros(0), np.zeros(3), 3
    )
    assert res[1] == pytest.approx(2e-7 * 6378137.0 * math.cos(0.2), rel=1e-2)


# ---------------------------------------------------------------- sensors
def test_pressure_becomes_depth():
    sensor = nf.Depth(pressure=True, latitude_deg=30.0)
    for depth_m in (0.0, 10.0, 1000.0, 6000.0):
        pascal = 101325.0 + 1e4 * p_from_z(-depth_m, 30.0)
        assert sensor.read(np.array([pascal]))[0] == pytest.approx(depth_m, abs=1e-6 * max(1.0, depth_m))
    # a constant density times g is metres off at 1000 dbar, which is why TEOS-10 is used
    assert abs(sensor.read(np.array([101325.0 + 1e7]))[0] - 1e7 / (1025.0 * 9.80665)) > 2.0


def test_iron_calibration_is_applied():
    soft = (1.1, 0.02, 0.0, 0.02, 0.9, 0.0, 0.0, 0.0, 1.0)
    sensor = nf.Heading(magnetometer=True, declination_rad=0.0, hard_iron=(3.0, -2.0, 1.0), soft_iron=soft)
    field = np.array([20.0, 5.0, 40.0])
    reading = np.linalg.solve(np.reshape(soft, (3, 3)), field) + np.array([3.0, -2.0, 1.0])
    np.testing.assert_allclose(sensor.read(np.array([*reading, 12.0])), [*field, 12.0], atol=1e-12)
    assert sensor.read(np.array([3.0, -2.0, 1.0])) is None  # no field at all


def test_parameters_appear_only_where_they_are_uncertain():
    assert nf.Heading().parameters() == () and nf.Depth().parameters() == () and nf.BodyVelocity().parameters() == ()
    names = [p.name for p in nf.Heading(bias_sd_rad=0.1).parameters()]
    assert names == ["bias", "one_cycle_sin", "one_cycle_cos", "two_cycle_sin", "two_cycle_cos", "temperature"]
    angles = tuple((f"misalignment_{axis}", 0.0, "rad") for axis in "xyz")
    assert tuple(p[:3] for p in nf.BodyVelocity(scale_sd=0.01).parameters()) == (("scale", 0.01, "1"), *angles)
    assert [p[:3] for p in nf.Depth(offset_sd_m=0.3).parameters()] == [("offset", 0.3, "m")]
    flows = [("current_north", 0.3, "m_s"), ("current_east", 0.3, "m_s")]
    assert [p[:3] for p in nf.WaterVelocity().parameters()] == flows
    assert len(nf.WaterVelocity(misalignment_sd_rad=0.01).parameters()) == 6


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: nf.Depth(rate_hz=0.0), r"Depth\.rate_hz"),
        (lambda: nf.Depth(rate_hz=math.nan), r"Depth\.rate_hz"),
        (lambda: nf.Position(gate_probability=1.0), "gate_probability"),
        (lambda: nf.Position(gate_timeout_s=0.0), "gate_timeout_s"),
        (lambda: nf.BodyVelocity(lever_arm_b_m=(1.0, 2.0)), "lever_arm_b_m must be 3 finite"),
        (lambda: nf.BodyVelocity(mounting_rad=(0.0, math.nan, 0.0)), "mounting_rad"),
        (lambda: nf.Position(error=(nf.White(sd=1.0),)), "tuple of 3"),
        (lambda: nf.Position(error=2.0), r"one error model, or a tuple of 3, found 2\.0"),
        (lambda: nf.Heading(soft_iron=(1.0, 0.0)), "soft_iron must be 9"),
        (lambda: nf.Heading(magnetometer=True, hard_iron_sd=-1e-6), "hard_iron_sd must be a finite number >= 0"),
        (lambda: nf.Heading(soft_iron_sd=0.05), "soft_iron_sd is for a magnetometer"),
        (lambda: nf.WaterVelocity(current_sd_m_s=0.0), r"WaterVelocity\.current_sd_m_s"),
        (lambda: nf.WaterVelocity(current_tau_s=math.inf), r"WaterVelocity\.current_tau_s"),
        (lambda: nf.WaterVelocity(error=nf.LearnedArma()), "the current hides in it"),
        (lambda: nf.DeadReckoning(rate_hz=4.0, velocity=nf.Course()), "must be a BodyVelocity, a WaterVelocity or"),
    ],
)
def test_wrong_sensors_are_refused(build, message):
    with pytest.raises(ValueError, match=message):
        build()


def test_every_sensor_reads_nothing_from_nothing():
    for sensor in (
        nf.BodyVelocity(),
        nf.WaterVelocity(),
        nf.Heading(),
        nf.Heading(magnetometer=True, declination_rad=0.0),
        nf.Depth(),
        nf.Depth(pressure=True),
        nf.Position(),
    ):
        assert isinstance(sensor, Sensor)
        assert sensor.read(np.full(sensor.reads, np.nan)) is None
        assert sensor.read(np.full(sensor.reads, np.inf)) is None
