"""The simulator: readings agree with the measurement models, noise with its statistics, faults with what was asked."""

import dataclasses
import datetime
import math

import numpy as np
import pytest
from scipy.signal import lfilter

import navfilter.simulation.simulate as simulator
from navfilter.foundation.arguments import within
from navfilter.models.error_models import Arma, GaussMarkov, RandomWalk, White
from navfilter.models.mechanisation import DeadReckoning, Imu
from navfilter.models.sensors import BodyVelocity, Depth, Heading, Position
from navfilter.models.state import NavState
from navfilter.models.vehicle import Vehicle
from navfilter.playback.replay import replay
from navfilter.simulation.manoeuvres import ChangeSpeed, Dive, FigureEight, Straight, Surface, Turn, Wait
from navfilter.simulation.motion import Motion, Wander
from navfilter.simulation.presets import (
    crossbow_imu,
    mems_imu,
    motorola_gps,
    rdi_dvl,
    tactical_imu,
    tcm2_compass,
)
from navfilter.simulation.scenarios import SCENARIOS, simulate_scenario
from navfilter.simulation.simulate import (
    Changing,
    Faults,
    StartErrors,
    draw_error,
    draw_errors,
    generator,
    outliers,
    quantise,
    simulate,
    tiny_missions,
)

DEG = math.pi / 180.0
SILENT = White(sd=0.0)
EXACT = StartErrors(exact=True)


@pytest.fixture(scope="module")
def motion() -> Motion:
    manoeuvres = (
        Wait(5.0),
        ChangeSpeed(1.5),
        Straight(duration_s=10.0),
        Dive(5.0),
        Turn(200.0),
        FigureEight(rate_deg_s=8.0),
        Surface(),
        Straight(duration_s=30.0),
    )
    return Motion(manoeuvres, latitude_deg=40.0, longitude_deg=-70.0, heading_deg=20.0, wander=Wander())


def silent_imu(**changes) -> Imu:
    return Imu(rate_hz=100.0, gyro=SILENT, accel=SILENT, **changes)


def one_sensor(sensor, motion, fault=None, **options):
    """The stream of one sensor on a vehicle without other errors."""
    faults = {} if fault is None else {"it": fault}
    return simulate(
        Vehicle(imu=silent_imu(), sensors={"it": sensor}), motion, seed=3, faults=faults, **options
    ).streams["it"]


# ---- the truth side and the filter's measurement models, written apart, agree


SENSORS = {
    # at rest without noise all components are exactly zero, which a DVL's reader takes for lost lock
    "dvl": BodyVelocity(
        rate_hz=4.0, error=SILENT, lever_arm_b_m=(0.7, -0.2, 0.4), mounting_rad=(0.1, -0.2, 0.8), zero_is_invalid=False
    ),
    "compass": Heading(rate_hz=8.0, error=SILENT),
    "magnetic": Heading(rate_hz=8.0, error=SILENT, magnetic=True, declination_rad=-0.25),
    "model": Heading(rate_hz=8.0, error=SILENT, magnetic=True),
    "field": Heading(
        rate_hz=8.0,
        error=SILENT,
        magnetometer=True,
        hard_iron=(3.0, -2.0, 5.0),
        soft_iron=(1.1, 0.05, 0.0, -0.02, 0.9, 0.03, 0.01, 0.0, 1.2),
    ),
    "depth": Depth(rate_hz=1.0, error=SILENT, lever_arm_b_m=(0.5, 0.1, -0.2)),
    "pressure": Depth(rate_hz=1.0, error=SILENT, pressure=True, latitude_deg=40.0, lever_arm_b_m=(0.5, 0.1, -0.2)),
    "gps": Position(rate_hz=1.0, error=SILENT, lever_arm_b_m=(-0.4, 0.3, -0.5)),
}


@pytest.mark.parametrize("name", SENSORS)
def test_silent_readings_leave_no_residual(name, motion):
    sensor = SENSORS[name]
    mission = simulate(Vehicle(imu=silent_imu(), sensors={name: sensor}), motion, seed=1, start=EXACT)
    stream = mission.streams[name]
    constants = sensor.constants(mission.start)
    worst = 0.0
    for time_s, value in zip(stream.time_s, stream.value, strict=True):
        here = motion.at([time_s])
        place = (here.latitude[0], here.longitude[0], here.height[0])
        nav = NavState(time_s, *place, here.velocity_n[0], here.C_nb[0]).pack()
        residual, H = np.zeros(sensor.axes), np.zeros((sensor.axes, 9))
        sensor.kernel(sensor.read(value), nav, here.rate_eb_b[0], np.zeros(0), constants, H, residual)
        worst = max(worst, np.abs(residual).max())
    # the square of the antenna's lever arm over the Earth's radius, 4e-8 m; the latitude of the pressure's conversion
    # is that of the start, some 60 m away, which is 3e-7 m at 5 m depth
    assert worst < (1e-6 if name == "pressure" else 1e-7)


def test_calibration_errors_are_what_the_filter_calls_them(motion):
    """Scale, misalignment, deviation, offset and bias, as given, are the parameters of the measurement kernels."""
    angles = np.array([0.002, -0.003, 0.004])
    deviation = np.array([0.02, 0.03, -0.01, 0.005, 0.004])
    cases = {
        "dvl": (SENSORS["dvl"], Faults(scale=0.01, misalignment_rad=tuple(angles)), np.r_[0.01, angles]),
        "compass": (SENSORS["magnetic"], Faults(deviation_rad=tuple(deviation)), np.r_[deviation, 0.0]),
        "field": (SENSORS["field"], Faults(deviation_rad=tuple(deviation)), np.r_[deviation, 0.0]),
        "warm": (
            dataclasses.replace(SENSORS["compass"], temperature_sd_rad_per_k=0.01),
            Faults(temperature_rad_per_k=0.002),
            np.array([0, 0, 0, 0, 0, 0.002]),
        ),
        "depth": (SENSORS["depth"], Faults(bias=0.4), np.array([0.4])),
    }
    for name, (sensor, fault, par) in cases.items():
        vehicle = Vehicle(imu=silent_imu(), sensors={name: sensor})
        mission = simulate(vehicle, motion, seed=1, faults={name: fault}, start=EXACT)
        stream, constants = mission.streams[name], sensor.constants(mission.start)
        worst = 0.0
        for time_s, value in zip(stream.time_s, stream.value, strict=True):
            here = motion.at([time_s])
            place = (here.latitude[0], here.longitude[0], here.height[0])
            nav = NavState(time_s, *place, here.velocity_n[0], here.C_nb[0]).pack()
            residual, H = np.zeros(sensor.axes), np.zeros((sensor.axes, 9 + par.size))
            sensor.kernel(sensor.read(value), nav, here.rate_eb_b[0], par, constants, H, residual)
            worst = max(worst, np.abs(residual).max())
        # the kernels' misalignment is first order: 1.5 m/s times half the square of 5 mrad
        assert worst < (3e-5 if name == "dvl" else 1e-8), name


def test_declination_is_that_of_the_world_magnetic_model(motion):
    date = datetime.date(2026, 3, 1)
    magnetic = one_sensor(SENSORS["model"], motion, date=date).value[0, 0]
    # World Magnetic Model 2025 at 40 N 70 W: 14.0 deg west in 2026
    assert (magnetic - 20.0 * DEG) / DEG == pytest.approx(14.0, abs=0.3)


# ---- noise


MODELS = {
    "white": White(sd=2.0),
    "gm1": GaussMarkov(sd=1.5, tau_s=3.0),
    "gm2": GaussMarkov(sd=1.5, tau_s=3.0, order=2),
    "gm4": GaussMarkov(sd=1.5, tau_s=3.0, order=4),
    "arma": Arma(ar=(-1.6, 0.8), ma=(0.4, 0.1), sd=0.5),
    "sum": White(sd=1.0) + GaussMarkov(sd=1.0, tau_s=5.0) + Arma(ar=(-1.2, 0.9), sd=0.5),
}


@pytest.mark.parametrize("name", MODELS)
def test_noise_has_the_covariance_of_its_model(name):
    model, period = MODELS[name], 0.25
    block = model.block(period)
    n, runs, lags = 2000, 40, (0, 1, 2, 5, 10, 20)
    errors = np.stack([draw_error(model, period, n, seed, name) for seed in range(runs)])
    for lag in lags:
        expected = block.C @ np.linalg.matrix_power(block.Phi, lag) @ block.P0 @ block.C + (
            block.r if lag == 0 else 0.0
        )
        each = np.mean(errors[:, lag:] * errors[:, : n - lag], axis=1)
        # five standard errors of the mean over the runs
        assert abs(each.mean() - expected) < 5.0 * each.std() / math.sqrt(runs), lag
    # stationary from the first sample on: variance over runs, chi-square with 40 degrees of freedom (0.1 % .. 99.9 %)
    ratio = errors[:, 0].var() / (block.C @ block.P0 @ block.C + block.r)
    assert 0.4 < ratio < 1.9


def test_arma_noise_equals_its_difference_equation():
    """Whitening with the inverse filter leaves white innovations of the stated size."""
    model = MODELS["arma"]
    error = draw_error(model, 0.1, 50_000, 7, "x")
    innovation = lfilter([1.0, *model.ar], [1.0, *model.ma], error)[100:]
    # 50 000 samples: standard errors 0.3 % and 0.0045
    assert innovation.std() == pytest.approx(0.5, rel=0.015)
    correlation = [np.corrcoef(innovation[k:], innovation[:-k])[0, 1] for k in (1, 2, 3, 7)]
    assert np.abs(correlation).max() < 0.022


def test_random_walk_starts_and_spreads_as_stated():
    model = RandomWalk(density=0.5, start_sd=2.0)
    errors = np.stack([draw_error(model, 0.1, 1001, seed, "walk") for seed in range(400)])
    # 400 runs: the standard deviation is known to 3.5 %; four of those
    assert errors[:, 0].std() == pytest.approx(2.0, rel=0.14)
    assert (errors[:, -1] - errors[:, 0]).std() == pytest.approx(0.5 * math.sqrt(100.0), rel=0.14)


def test_longer_noise_begins_with_the_shorter():
    long, short = (draw_error(MODELS["sum"], 0.1, n, 5, "dvl", 2) for n in (1000, 300))
    np.testing.assert_array_equal(long[:300], short)


def test_axes_streams_and_seeds_are_independent():
    n = 20_000
    series = [
        draw_error(MODELS["gm1"], 10.0, n, seed, name, axis)
        for seed in (1, 2)
        for name in ("a", "b")
        for axis in (0, 1)
    ]
    correlation = np.corrcoef(series) - np.eye(8)
    # nearly white at this period (exp(-10 / 3) = 0.04): five standard errors
    assert np.abs(correlation).max() < 5.0 / math.sqrt(n)
    with pytest.raises(ValueError, match="negative"):
        generator(-1, "a", "b")


def test_error_that_changes_half_way():
    time_s = np.arange(8000) * 0.25
    model = Changing(((0.0, White(sd=1.0)), (1000.0, (White(sd=3.0), GaussMarkov(sd=2.0, tau_s=1.0)))))
    error = draw_errors(model, 0.25, time_s, 2, 1, "compass")
    early, late = error[time_s < 1000.0], error[time_s >= 1000.0]
    # 4000 samples: 1.1 % each; the correlated one about twice that
    np.testing.assert_allclose(early.std(axis=0), 1.0, rtol=0.06)
    np.testing.assert_allclose(late.std(axis=0), [3.0, 2.0], rtol=0.1)
    with pytest.raises(ValueError, match="begin at 0"):
        Changing(((5.0, SILENT),))


# ---- one thing changed leaves the rest as it was


def test_adding_a_sensor_or_a_fault_changes_no_other_noise(motion):
    imu = tactical_imu()
    dvl, gps = (
        BodyVelocity(rate_hz=4.0, error=MODELS["sum"]),
        Position(rate_hz=1.0, error=GaussMarkov(sd=3.0, tau_s=60.0)),
    )
    small = simulate(Vehicle(imu=imu, sensors={"dvl": dvl}), motion, seed=9)
    faults = {"gps": Faults(outlier_probability=0.1, outlier_sd=5.0, dropouts=((3.0, 5.0),))}
    large = simulate(Vehicle(imu=imu, sensors={"gps": gps, "dvl": dvl}), motion, seed=9, faults=faults)
    np.testing.assert_array_equal(small.streams["dvl"].value, large.streams["dvl"].value)
    np.testing.assert_array_equal(small.streams["imu"].value, large.streams["imu"].value)
    assert small.start == large.start
    other = simulate(Vehicle(imu=imu, sensors={"dvl": dvl}), motion, seed=10)
    assert np.abs(other.streams["dvl"].value - small.streams["dvl"].value).max() > 0.1


def test_shorter_mission_is_the_beginning_of_the_longer():
    vehicle, long = simulate_scenario("lawnmower", 4, 400.0)
    motion = SCENARIOS["lawnmower"].motion(400.0)
    short = simulate(vehicle, motion, seed=4, duration_s=100.0, faults=SCENARIOS["lawnmower"].faults(400.0))
    for name, stream in short.streams.items():
        np.testing.assert_array_equal(stream.value, long.streams[name].value[: len(stream)])


# ---- faults


def test_outliers_come_as_often_and_as_large_as_asked():
    extra = outliers(Faults(outlier_probability=0.05, outlier_sd=10.0), 40_000, 3, 1, "dvl")
    hit = np.any(extra != 0.0, axis=1)
    # binomial: 2000 +- 44
    assert 1780 < hit.sum() < 2220
    # 6000 values: 0.9 %
    assert extra[hit].std() == pytest.approx(10.0, rel=0.04)
    assert not outliers(Faults(), 100, 3, 1, "dvl").any()


def test_dropouts_remove_blank_or_zero(motion):
    sensor, lost = BodyVelocity(rate_hz=4.0, error=White(sd=0.1)), ((20.0, 30.0), (50.0, 50.6))
    whole = one_sensor(sensor, motion)
    inside = within(whole.time_s, lost)
    assert inside.sum() == 41 + 3
    missing = one_sensor(sensor, motion, Faults(dropouts=lost))
    np.testing.assert_array_equal(missing.time_s, whole.time_s[~inside])
    np.testing.assert_array_equal(missing.value, whole.value[~inside])
    blank = one_sensor(sensor, motion, Faults(dropouts=lost, dropout_reading="nan"))
    np.testing.assert_array_equal(np.isnan(blank.value).all(axis=1), inside)
    zero = one_sensor(sensor, motion, Faults(dropouts=lost, dropout_reading="zero"))
    np.testing.assert_array_equal((zero.value == 0.0).all(axis=1), inside)


def test_availability_at_the_surface_and_in_intervals(motion):
    gps = Position(rate_hz=1.0, error=SILENT)
    fixes = one_sensor(gps, motion, Faults(available="surface"))
    depth = -motion.at(fixes.time_s).height
    all_depths = -motion.at(np.arange(int(motion.duration_s) + 1.0)).height
    assert 0 < len(fixes) == np.count_nonzero(all_depths < 0.3)
    assert depth.max() < 0.3
    assert one_sensor(gps, motion, Faults(available=((10.0, 12.0),))).time_s.tolist() == [10.0, 11.0, 12.0]


def test_quantisation_rounds_to_the_step(motion):
    stream = one_sensor(Heading(rate_hz=8.0, error=White(sd=0.01)), motion, Faults(quantisation=0.1 * DEG))
    steps = stream.value / (0.1 * DEG)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    fine = one_sensor(Heading(rate_hz=8.0, error=White(sd=0.01)), motion)
    assert np.abs(fine.value - stream.value).max() <= 0.05 * DEG + 1e-12
    np.testing.assert_array_equal(quantise(np.array([[1.26, 1.26]]), (0.5, 0.0)), [[1.5, 1.26]])


def test_time_stamps_late_and_jittered(motion):
    depth = Depth(rate_hz=1.0, error=SILENT)
    prompt = one_sensor(depth, motion)
    late = one_sensor(depth, motion, Faults(time_offset_s=0.35))
    np.testing.assert_allclose(late.time_s, prompt.time_s + 0.35)
    np.testing.assert_array_equal(late.value, prompt.value)
    jittered = one_sensor(depth, motion, Faults(time_jitter_sd_s=0.02))
    # some 180 stamps: 5 %
    assert (jittered.time_s - prompt.time_s).std() == pytest.approx(0.02, rel=0.25)
    assert np.all(np.diff(one_sensor(depth, motion, Faults(time_jitter_sd_s=2.0)).time_s) >= 0.0)


def test_true_error_differs_from_what_the_vehicle_believes(motion):
    compass = Heading(rate_hz=8.0, error=White(sd=0.5))
    fault = Faults(true_error=White(sd=0.01), bias=0.2)
    stream = one_sensor(compass, motion, fault)
    error = np.angle(np.exp(1j * (stream.value[:, 0] - motion.at(stream.time_s).attitude[:, 2])))
    # some 1400 samples: 2 %
    assert error.std() == pytest.approx(0.01, rel=0.1)
    assert error.mean() == pytest.approx(0.2, abs=0.002)


def test_hdop_is_reported_in_steps(motion):
    stream = one_sensor(Position(rate_hz=1.0, error=SILENT), motion, Faults(hdop=((0.0, 1.2), (20.0, 6.0))))
    assert stream.columns[3] == "hdop"
    np.testing.assert_array_equal(stream.value[:, 3], np.where(stream.time_s < 20.0, 1.2, 6.0))


def test_imu_errors_scale_and_increments(motion):
    faults = {
        "gyro": Faults(bias=0.01, scale=0.1),
        "accel": Faults(misalignment_rad=(0.0, 0.0, 0.1)),
        "imu": Faults(dropouts=((3.0, 4.0),)),
    }
    stream = simulate(Vehicle(imu=silent_imu()), motion, seed=1, faults=faults).streams["imu"]
    assert not within(stream.time_s, ((3.0, 4.0),)).any()
    here = motion.at(stream.time_s)
    np.testing.assert_allclose(stream.value[:, :3], 1.1 * here.rate_b + 0.01, atol=1e-15)
    c, s = math.cos(0.1), math.sin(0.1)
    np.testing.assert_allclose(stream.value[:, 3], c * here.force_b[:, 0] - s * here.force_b[:, 1], atol=1e-12)
    increments = simulate(Vehicle(imu=silent_imu(increments=True)), motion, seed=1, faults={"gyro": Faults(bias=0.01)})
    stream = increments.streams["imu"]
    assert stream.time_s[0] == 0.01
    np.testing.assert_allclose(stream.value[:, :3] - motion.inertial(100.0, increments=True)[1], 1e-4, atol=1e-15)


def test_drawn_calibration_is_noted_and_as_large_as_stated(motion):
    vehicle = Vehicle(imu=silent_imu(), sensors={"dvl": BodyVelocity(rate_hz=1.0, error=SILENT, scale_sd=0.02)})
    short = Motion((ChangeSpeed(1.0, 1.0),))
    scales = []
    for seed in range(200):
        mission = simulate(vehicle, short, seed=seed)
        scales.append(mission.streams["dvl"].value[-1, 0] - 1.0)
        assert f"dvl: scale error {scales[-1]:.4g}" in mission.notes
    # 200 draws: 5 %
    assert np.std(scales) == pytest.approx(0.02, rel=0.2)


def test_what_is_calibrated_is_drawn_about_its_value():
    calibrated = (("scale", 0.05, 0.002), ("misalignment_z", 0.03, 0.0))
    dvl = BodyVelocity(
        rate_hz=1.0, error=SILENT, scale_sd=0.02, misalignment_sd_rad=(0.0, 0.0, 0.1), calibrated=calibrated
    )
    compass = Heading(rate_hz=1.0, error=SILENT, bias_sd_rad=0.1, calibrated=(("bias", -0.2, 0.0),))
    imu = dataclasses.replace(silent_imu(), gyro_scale_sd=0.01, calibrated=(("gyro.scale_z", 0.25, 0.0),))
    vehicle = Vehicle(imu=imu, sensors={"dvl": dvl, "compass": compass})
    turning = Motion((ChangeSpeed(1.0, 1.0), Turn(90.0, 6.0)))
    scales = []
    for seed in range(30):
        mission = simulate(vehicle, turning, seed=seed)
        # straight ahead at first: what shows across is the misalignment
        forward, right, _ = mission.streams["dvl"].value[1]
        assert math.atan2(right, forward) == pytest.approx(0.03, abs=1e-9)
        scales.append(math.hypot(forward, right) - 1.0)
    # 30 draws: 0.0004
    assert np.mean(scales) == pytest.approx(0.05, abs=0.0016) and np.std(scales) == pytest.approx(0.002, rel=0.5)
    ahead = mission.truth.column("yaw_rad")[0]
    assert mission.streams["compass"].value[0, 0] - ahead == pytest.approx(-0.2, abs=1e-12)
    rate = turning.inertial(100.0)[1]
    # true = reading - M reading
    np.testing.assert_allclose(mission.streams["imu"].value[:, 2] * (1.0 - 0.25), rate[:, 2], atol=1e-12)


# ---- mission, start, dead reckoning


def test_truth_is_the_motion(motion):
    mission = simulate(Vehicle(imu=silent_imu()), motion, seed=1, truth_rate_hz=10.0)
    here = motion.at(mission.truth.time_s)
    assert np.diff(mission.truth.time_s) == pytest.approx(0.1)
    np.testing.assert_array_equal(mission.truth.column("height_m"), here.height)
    np.testing.assert_array_equal(mission.truth.value[:, 3:6], here.velocity_n)
    np.testing.assert_array_equal(mission.truth.column("yaw_rad"), here.attitude[:, 2])


def test_start_is_drawn_with_the_stated_uncertainty():
    motion = Motion((Wait(1.0),), latitude_deg=60.0, longitude_deg=5.0, heading_deg=179.0)
    known = StartErrors(position_sd_m=(4.0, 2.0, 1.0), velocity_sd_m_s=0.1, tilt_sd_deg=0.5, heading_sd_deg=3.0)
    vehicle = Vehicle(imu=silent_imu())
    here = motion.at([0.0])
    truth = NavState(0.0, here.latitude[0], here.longitude[0], here.height[0], here.velocity_n[0], here.C_nb[0])
    starts = [simulate(vehicle, motion, seed=seed, start=known).start for seed in range(300)]
    errors = np.array([start.state.minus(truth) for start in starts])
    nees = np.mean(errors**2 / np.diag(starts[0].state.covariance), axis=0)
    # 300 draws: 8 % in the square; four of those
    np.testing.assert_allclose(nees, 1.0, atol=0.33)
    # the mean is known to a seventeenth of the standard deviation
    assert np.abs(errors.mean(axis=0) / np.sqrt(np.diag(starts[0].state.covariance))).max() < 4.0 / math.sqrt(300.0)
    exact = simulate(vehicle, motion, seed=1, start=dataclasses.replace(known, exact=True)).start
    assert np.abs(exact.state.minus(truth)).max() < 1e-8
    assert exact.heading_sd_deg == 3.0


def test_dead_reckoning_streams(motion):
    compass = Heading(rate_hz=4.0, error=White(sd=0.02), bias_sd_rad=0.1, deviation_sd_rad=(0.05, 0.0))
    velocity = BodyVelocity(rate_hz=4.0, error=SILENT, lever_arm_b_m=(1.0, 0.0, 0.0))
    drive = DeadReckoning(rate_hz=4.0, attitude=compass, velocity=velocity, tilt=White(sd=0.004))
    deviation = (0.0, 0.05, 0.0, 0.0, 0.0)
    mission = simulate(Vehicle(drive), motion, seed=2, faults={"attitude": Faults(deviation_rad=deviation)})
    stream = mission.streams["attitude"]
    here = motion.at(stream.time_s)
    error = np.angle(np.exp(1j * (stream.value - here.attitude)))
    # 700 samples: 2.7 %
    np.testing.assert_allclose(error[:, :2].std(axis=0), 0.004, rtol=0.12)
    yaw = error[:, 2] - 0.05 * np.sin(here.attitude[:, 2])
    assert yaw.std() == pytest.approx(0.02, rel=0.12)
    # one constant bias, of the stated size (0.1), apart from the mean of 700 samples of 0.02
    assert 0.003 < abs(yaw.mean()) < 0.4
    forward = mission.streams["velocity"].value[:, 0]
    np.testing.assert_allclose(forward, np.linalg.norm(here.velocity_n, axis=1), atol=1e-12)
    sideways = mission.streams["velocity"].value[:, 1]
    np.testing.assert_allclose(sideways, here.rate_eb_b[:, 2], atol=1e-12)


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda m: simulate(Vehicle(imu=silent_imu()), m, seed=1, faults={"dvl": Faults()}), 'no sensor "dvl"'),
        (lambda m: simulate(Vehicle(imu=silent_imu()), m, seed=1, duration_s=1e6), "between 0 and the motion's"),
        (
            lambda m: simulate(Vehicle(imu=silent_imu()), m, seed=1, faults={"imu": Faults(scale=0.1)}),
            '"gyro" and "accel"',
        ),
        (
            lambda m: simulate(Vehicle(imu=silent_imu()), m, seed=1, faults={"gyro": Faults(dropouts=((0, 1),))}),
            '"imu"',
        ),
        (lambda m: Faults(available="sometimes"), "available"),
        (lambda m: Faults(dropout_reading="noise"), "dropout_reading"),
        (lambda m: Faults(outlier_probability=2.0), "between 0 and 1"),
        (lambda m: Faults(dropouts=((2.0, 1.0),)), "before it begins"),
        (lambda m: simulate_scenario("nowhere", 1), "no scenario"),
        (lambda m: simulate_scenario("demo", 1, -5.0), "positive"),
    ],
)
def test_mistakes_are_named(build, words, motion):
    with pytest.raises(ValueError, match=words):
        build(motion)


# ---- presets and scenarios


def test_presets_say_what_the_table_says():
    gyro, accel = crossbow_imu().models[0].block(0.01), crossbow_imu().models[3].block(0.01)
    # 2.25 deg/sqrt(h): after one hour of white rate noise the angle has wandered 2.25 deg
    assert math.sqrt(gyro.r * 0.01 * 3600.0) / DEG == pytest.approx(2.25)
    assert math.sqrt(accel.r) == pytest.approx(0.25 * 9.80665e-3)
    assert math.sqrt(accel.P0[0, 0]) == pytest.approx(0.5 * 9.80665e-3)
    compass = tcm2_compass()
    assert math.sqrt(compass.models[0].block(0.125).P0[0, 0]) / DEG == pytest.approx(0.46, abs=0.005)
    assert tcm2_compass(calibrated=False).bias_sd_rad == pytest.approx(5.0 * DEG)
    assert (rdi_dvl().scale_sd, rdi_dvl(long_range=True).scale_sd) == (0.002, 0.004)
    assert (rdi_dvl().rate_hz, motorola_gps().rate_hz, crossbow_imu().rate_hz) == (4.0, 1.0, 100.0)
    dgps, gps = motorola_gps().models[0].block(1.0), motorola_gps(differential=False).models[0].block(1.0)
    assert math.sqrt(dgps.P0[0, 0]) == pytest.approx(2.5) and 2.0 * math.sqrt(gps.P0[0, 0]) == pytest.approx(25.0)
    assert mems_imu().models[0].block(0.01).r == pytest.approx(100.0 * tactical_imu().models[0].block(0.01).r)


@pytest.mark.parametrize("name", SCENARIOS)
def test_scenarios_fill_their_time_with_sound_streams(name):
    vehicle, mission = simulate_scenario(name, 1, 400.0)
    expected = {*vehicle.driving, *vehicle.sensors}
    assert set(mission.streams) == expected
    assert mission.end_s == pytest.approx(400.0, abs=1.0)
    for stream in mission.streams.values():
        assert len(stream) and np.isfinite(stream.value).all()
    # at the end of its full time the vehicle is back at the surface, and never out of the water
    height = mission.truth.column("height_m")
    assert height[-1] == pytest.approx(0.0, abs=0.3)
    assert height.min() < -4.0 and height.max() < 0.3
    # short missions are cut off, not refused
    assert simulate_scenario(name, 1, 30.0)[1].duration_s == pytest.approx(30.0, abs=1.0)


def test_demo_has_what_it_promises():
    vehicle, mission = simulate_scenario("demo", 1)
    assert mission.duration_s == pytest.approx(3600.0)
    gaps = np.diff(mission.streams["dvl"].time_s)
    assert np.sort(gaps)[-3:] == pytest.approx([30.25, 60.25, 180.25], abs=0.3)
    fixes = mission.streams["gps"].time_s
    assert fixes[0] == 0.0 and fixes[-1] == 3600.0
    assert np.diff(fixes).max() > 2700.0
    headings = np.degrees(mission.truth.column("yaw_rad"))
    along = np.histogram(headings, bins=36, range=(-180.0, 180.0))[0]
    # a lawnmower: two opposite headings take most of the time
    assert np.sort(along)[-4:].sum() > 0.5 * headings.size
    assert set(mission.streams) == {"imu", *vehicle.sensors}


@pytest.mark.parametrize("drive", ["imu", "increments", "reckoning"])
def test_replaying_a_silent_mission_gives_the_truth(drive):
    """No errors anywhere: the navigator has to arrive where the simulator says it is."""
    calm = Motion(
        (
            Wait(10.0),
            ChangeSpeed(1.5),
            Straight(duration_s=20.0),
            Dive(5.0, 8.0),
            Turn(90.0, 3.0, 0.5, 8.0),
            Straight(duration_s=60.0),
        ),
        latitude_deg=50.0,
        longitude_deg=8.0,
        heading_deg=-60.0,
    )
    if drive == "reckoning":
        # the trapezoidal rule between readings of a turning velocity errs with the square of the period: 50 Hz
        vehicle = Vehicle(DeadReckoning(rate_hz=50.0, attitude=SILENT, velocity=SILENT), name=drive)
    else:
        vehicle = Vehicle(imu=silent_imu(increments=drive == "increments"), name=drive)
    start = StartErrors(position_sd_m=1e-4, velocity_sd_m_s=1e-5, tilt_sd_deg=1e-5, heading_sd_deg=1e-5, exact=True)
    mission = simulate(vehicle, calm, seed=1, start=start, truth_rate_hz=50.0)
    errors = replay(vehicle, mission, output_rate_hz=None).errors(mission.truth)
    assert np.nanmax(np.abs(errors.position_n)) < 2e-3
    assert np.nanmax(np.abs(errors.velocity_n)) < 1e-4
    assert np.nanmax(np.abs(errors.attitude)) < 2e-6


def test_tiny_missions_cover_every_drive_and_sensor():
    kinds, drives = set(), set()
    for vehicle, mission in tiny_missions():
        drives.add(type(vehicle.drive).__name__)
        kinds |= {type(sensor).__name__ for sensor in vehicle.sensors.values()}
        assert mission.duration_s < 10.0
    assert drives == {"Imu", "DeadReckoning"}
    assert kinds >= {"Heading", "BodyVelocity", "Depth", "Position", "WaterVelocity", "ZeroVelocity"}


def test_unreadable_sensor_is_named(motion):
    class Sonar(Depth):
        pass

    assert one_sensor(Sonar(rate_hz=1.0), motion).columns == ("depth_m",)
    unknown = dataclasses.make_dataclass("Unknown", [], bases=(simulator.Sensor,), frozen=True)(rate_hz=1.0)
    with pytest.raises(ValueError, match="cannot read"):
        one_sensor(unknown, motion)
