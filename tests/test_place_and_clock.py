"""Lever arm and time offset as states: kernel and Jacobian, simulator, and that they are found with an honest sd."""

from dataclasses import dataclass, replace
from typing import ClassVar

import naive
import numpy as np
import pytest
from delayed_look import Sight, by_drive
from kernel_inputs import assert_close, random_nav, run_both
from state_differences import differences

import navfilter as nf
from navfilter.check.description import describe_vehicle
from navfilter.filter.events import Measurement
from navfilter.io import write_vehicle
from navfilter.kernels import measurement
from navfilter.kernels.consistency import WINDOW_S
from navfilter.kernels.delayed_state import SLOPE_S
from navfilter.models.state import NavState, matrix_from_euler
from navfilter.simulation.manoeuvres import ChangeSpeed, Straight, Turn
from navfilter.simulation.motion import Motion
from navfilter.simulation.simulate import Faults, StartErrors, simulate

STEPS = np.array([10.0] * 3 + [0.1] * 3 + [1e-3] * 3)
NONE = np.zeros((6, 0))
#: The same, a drive without noise, and the variance of a clock.
STILL = NONE, (np.ones(200), np.zeros((6, 1))), (0.01, np.zeros((3, 3)))
START = nf.Start(latitude_deg=50.0, longitude_deg=5.0)


def motion(rng, nav, seconds=0.01, rows=80):
    """Intervals of a vehicle that shakes a little, and feels the gravity of its attitude."""
    force = nav[6:15].reshape(3, 3).T @ [0.2, -0.1, -9.8]
    values = np.concatenate([0.3 * rng.normal(size=3), force])
    return np.column_stack([np.full(rows, seconds), values + 0.05 * rng.normal(size=(rows, 6))])


def outputs():
    return np.zeros(17), np.zeros(6), np.zeros((2, 9)), np.zeros((9, 9))


@pytest.mark.parametrize("late_s", [0.0, 0.013, 0.3, 2.0, -0.4])
def test_earlier_equals_its_twin(late_s):
    rng = np.random.default_rng(1)
    for rows in (0, 1, 80):
        nav = random_nav(rng)
        felt = motion(rng, nav, rows=rows)
        felt[rows // 2 :, 0] = 0.0 if rows == 80 and late_s == 2.0 else 0.01  # no more is known
        ours, twins = run_both(measurement.earlier, nav, felt, 9.8, late_s, 0.2, 0.7, *outputs())
        assert_close(ours[6:], twins[6:], rtol=1e-12)


def test_earlier_takes_back_what_the_strapdown_did():
    """Half a second of navigation undone, but for the Earth's rotation: 4e-5 rad, Coriolis force 1e-3 m/s^2."""
    rng = np.random.default_rng(2)
    nav = random_nav(rng)
    drv = np.zeros(100)
    drv[36] = 0.01
    felt = motion(rng, nav, rows=50)
    samples = felt[::-1].copy()
    after = nav.copy()
    naive.integrate(after, drv, samples, np.zeros((0, 17)))
    mean = felt.copy()
    mean[:-1, 1:] = 0.5 * (felt[:-1, 1:] + felt[1:, 1:])
    then, turn, slope, B = outputs()
    measurement.earlier(after, mean, naive.gravity(nav[0], nav[2]), 0.5, 0.2, 0.2, then, turn, slope, B)
    error = NavState.unpack(0.0, then).minus(NavState.unpack(0.0, nav))
    np.testing.assert_allclose(error[:3], 0.0, atol=1e-3)
    np.testing.assert_allclose(error[3:6], 0.0, atol=3e-3)
    np.testing.assert_allclose(error[6:], 0.0, atol=2e-4)


@pytest.mark.parametrize("late_s", [0.0, 0.255, -0.21])  # not where the number of pieces changes
@pytest.mark.parametrize("gravity", [0.0, 9.8])
def test_derivatives_of_earlier_equal_finite_differences(late_s, gravity):
    rng = np.random.default_rng(3)
    nav = random_nav(rng)
    felt = motion(rng, nav)
    felt[:, 1:] = felt[0, 1:]  # a steady turn: the mean about then is what there is then
    state = NavState.unpack(0.0, nav)
    _, _, slope, B = given = outputs()
    measurement.earlier(nav, felt, gravity, late_s, WINDOW_S, SLOPE_S, *given)

    def ended(error, time_s):
        then, *rest = outputs()
        measurement.earlier(state.plus(error).pack(), felt, gravity, time_s, WINDOW_S, SLOPE_S, then, *rest)
        return NavState.unpack(0.0, then)

    for j in range(9):
        error = STEPS[j] * np.eye(9)[j]
        # plus adds to the error of the attitude in n; then the difference is one in n, too
        change = ended(error, late_s).minus(ended(-error, late_s)) / (2.0 * STEPS[j])
        # 10 m north turn the meridian's tangent: 1e-6; the rest is the second order of the step
        np.testing.assert_allclose(B[:, j], change, atol=1e-5)
    change = ended(np.zeros(9), late_s - 1e-4).minus(ended(np.zeros(9), late_s + 1e-4)) / 2e-4
    np.testing.assert_allclose(slope[0], change, atol=1e-3)  # the force of the middle of 20 ms: 1e-4 of it


def test_biases_bend_the_way_back_as_their_derivative_says():
    rng = np.random.default_rng(8)
    nav, late_s = random_nav(rng), 0.5
    felt, rows = motion(rng, nav), rng.normal(size=(6, 4)) * [[0.01], [0.01], [0.01], [0.1], [0.1], [0.1]]
    ends = []
    for sign in (1.0, -1.0):
        for column in rows.T:
            given = outputs()
            measurement.earlier(
                nav, felt - sign * np.concatenate([[0.0], column]), 9.8, late_s, WINDOW_S, SLOPE_S, *given
            )
            ends.append(NavState.unpack(0.0, given[0]))
    change = np.column_stack([0.5 * ends[k].minus(ends[4 + k]) for k in range(4)])
    given = outputs()
    measurement.earlier(nav, felt, 9.8, late_s, WINDOW_S, SLOPE_S, *given)
    found = by_drive(nav, given[0], given[3], late_s, rows)
    # the attitude of the middle, and no third power of the time: a hundredth of 5 cm/s and 1 cm, in a turn by 0.15 rad
    np.testing.assert_allclose(found[6:], change[6:], atol=2e-4)
    np.testing.assert_allclose(found[3:6], change[3:6], atol=2e-3)
    np.testing.assert_allclose(found[:3], change[:3], atol=3e-3)


VELOCITY = nf.BodyVelocity(lever_arm_b_m=(0.5, -0.2, 0.3), mounting_rad=(0.1, -0.2, 0.7), scale_sd=0.02)
KINDS = {
    "velocity": (VELOCITY, [1.0, -0.4, 0.2]),
    "water": (nf.WaterVelocity(lever_arm_b_m=(0.5, -0.2, 0.3)), [1.0, -0.4, 0.2]),
    "heading": (nf.Heading(bias_sd_rad=0.1), [0.4, np.nan]),
    "magnetometer": (nf.Heading(magnetometer=True, declination_rad=0.1), [24.0, 7.0, 30.0, np.nan]),
    "depth": (nf.Depth(lever_arm_b_m=(0.5, -0.2, 0.3)), [12.0]),
    "position": (nf.Position(lever_arm_b_m=(0.5, -0.2, 0.3)), [0.0, 0.0, 4.0]),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("clock", [0.0, 0.4])
def test_jacobians_of_every_kind_equal_finite_differences(kind, clock):
    rng = np.random.default_rng(4)
    plain, z = KINDS[kind]
    sensor = replace(plain, time_offset_sd_s=clock, lever_arm_sd_m=(0.3, 0.2, 0.1) if plain.has_lever_arm else (0,) * 3)
    nav = random_nav(rng)
    z = np.array(z)
    if kind == "position":
        z[:2] += nav[:2]
    felt = motion(rng, nav)
    felt[:, 1:] = felt[0, 1:]
    sight, state, par = (
        Sight(sensor, START),
        NavState.unpack(0.0, nav),
        0.05 * rng.normal(size=len(sensor.all_parameters())),
    )
    rate = felt[0, 1:4].copy()

    def look(state, par):
        near, res = np.zeros((sensor.axes, 9 + par.size)), np.zeros(sensor.axes)
        sight.look(
            z,
            state.pack(),
            rate,
            par,
            (felt, 9.8),
            0.05,
            *STILL,
            (np.zeros((sensor.axes, 0)), near, res, np.eye(sensor.axes)),
        )
        return near, res

    for _ in range(50 if kind == "magnetometer" else 0):  # its slopes are those of the field that is predicted
        turn = matrix_from_euler(0.0, 0.0, look(state, par)[1][0])
        z[:3] = state.C_nb.T @ turn @ state.C_nb @ z[:3]
    near, _ = look(state, par)
    for j in range(9 + par.size):
        if sensor.observes.in_body_axes and j > 8 and sensor.all_parameters()[j - 9].name.startswith("scale"):
            continue  # what it makes of the arm's turn is left out: see test_measurement
        step, ends = STEPS[j] if j < 9 else 1e-3, []
        for sign in (1.0, -1.0):
            error, moved = np.zeros(9), par.copy()
            if j < 9:
                error[j] = sign * step
            else:
                moved[j - 9] += sign * step
            ends.append(look(state.plus(error), moved)[1])
        # as in test_measurement: rounding of 1e-9 m, and the second order of a rotation
        np.testing.assert_allclose(near[:, j], -(ends[0] - ends[1]) / (2.0 * step), rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize("component", [0, 2])
@pytest.mark.parametrize("own", [{"time_offset_sd_s": 0.05}, {"lever_arm_sd_m": (0.1, 0.1, 0.1)}])
def test_a_velocity_without_a_component_is_used(own, component):
    dvl = nf.BodyVelocity(rate_hz=4.0, error=nf.White(sd=0.01), lever_arm_b_m=(0.5, 0.2, 0.3), **own)
    vehicle = nf.Vehicle(nf.Imu(rate_hz=50.0), {"compass": nf.Heading(rate_hz=4.0), "dvl": dvl, "depth": nf.Depth()})
    motion = Motion((Straight(10.0), Turn(90.0, 3.0), Straight(20.0)), speed_m_s=1.5, latitude_deg=50.0)
    mission = simulate(vehicle, motion, seed=2)
    stream = mission.streams["dvl"]
    value = stream.value.copy()
    value[40:, component] = np.nan
    track = nf.replay(vehicle, replace(mission, streams=mission.streams | {"dvl": replace(stream, value=value)}))
    residuals = track.residuals["dvl"]
    assert residuals.count("used") > 0.9 * len(value) and not residuals.count("invalid")


def test_a_rotating_arm_feels_the_angular_acceleration():
    """A reading half a second late, of an instrument on a long arm of a vehicle that begins to turn."""
    sensor = nf.BodyVelocity(lever_arm_b_m=(10.0, 0.0, 0.0), time_offset_sd_s=0.3)
    felt = np.zeros((100, 7))
    felt[:, 0] = 0.01
    felt[:, 3] = np.linspace(0.5, 0.0, 100)  # 0.5 rad/s^2
    near, res = np.zeros((3, 10)), np.zeros(3)
    nav = random_nav(np.random.default_rng(0))
    nav[3:6] = 0.0
    Sight(sensor, START).look(
        np.zeros(3), nav, np.zeros(3), np.zeros(1), (felt, 0.0), 0.0, *STILL, (np.zeros((3, 0)), near, res, np.eye(3))
    )
    np.testing.assert_allclose(near[1, 9], -5.0, rtol=0.02)  # the mean over the window


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: nf.Heading(lever_arm_sd_m=(0.1, 0.0, 0.0)), "no lever arm that could be uncertain"),
        (lambda: nf.Depth(lever_arm_sd_m=(0.1, -0.1, 0.0)), "lever_arm_sd_m must be three numbers >= 0"),
        (lambda: nf.Depth(lever_arm_sd_m=(0.1,)), "lever_arm_sd_m must be 3 finite"),
        (lambda: nf.Depth(time_offset_sd_s=-0.1), "time_offset_sd_s must be a finite number >= 0"),
        (lambda: nf.Depth(time_offset_s=np.nan), "time_offset_s must be a finite number"),
        (lambda: nf.ZeroVelocity(time_offset_sd_s=0.3), "no clock of its own"),
    ],
)
def test_what_no_sensor_has_is_refused(build, message):
    with pytest.raises(ValueError, match=message):
        build()


def shifted(z, nav, rate, par, cfg, H, res):
    """Not marked for numba: that is done for it."""
    measurement.position(z, nav, rate, par, cfg[2:], H, res)


@dataclass(frozen=True, kw_only=True)
class Foreign(nf.Position):
    """A kind of a user's own, whose constants do not begin with the lever arm."""

    kernel: ClassVar = staticmethod(shifted)

    def constants(self, start):
        """Two numbers more."""
        return np.array([1.0, 2.0, *self.lever_arm_b_m])


def test_any_kind_with_a_lever_arm_has_its_states_for_nothing():
    rng = np.random.default_rng(6)
    nav, arm = random_nav(rng), (0.5, -0.2, 0.3)
    z, par = np.array([*nav[:2], 4.0]), np.array([0.1, 0.2, -0.1])
    found = []
    for kind in (nf.Position, Foreign):
        near, res = np.zeros((3, 12)), np.zeros(3)
        sight = Sight(kind(lever_arm_b_m=arm, lever_arm_sd_m=(1.0,) * 3), START)
        sight.look(
            z, nav, np.zeros(3), par, (np.zeros((1, 7)), 0.0), 0.0, *STILL, (np.zeros((3, 0)), near, res, np.eye(3))
        )
        found.append((near, res))
    assert_close(found[0], found[1])
    C = nav[6:15].reshape(3, 3)
    np.testing.assert_allclose(found[0][0][:, 9:], C, atol=1e-6)  # rounding 1e-9 m over a step of 1 cm
    names = [p.name for p in Foreign(lever_arm_sd_m=(1.0, 0.0, 0.0), time_offset_sd_s=0.1).all_parameters()]
    assert names == ["lever_arm_x", "lever_arm_y", "lever_arm_z", "time_offset"]


DEG = np.pi / 180.0


def survey(arm_sd_m=0.0):
    """Legs and turns at two speeds: all clocks and arms but those along gravity can be found."""
    arm = (arm_sd_m,) * 3
    legs = (
        Straight(20.0),
        Turn(90.0, 8.0),
        ChangeSpeed(2.5, 5.0),
        Straight(20.0),
        Turn(90.0, 8.0),
        ChangeSpeed(1.2, 5.0),
    )
    vehicle = nf.Vehicle(
        imu=nf.Imu(rate_hz=50.0),
        sensors={
            "compass": nf.Heading(rate_hz=5.0, error=nf.White(sd=0.5 * DEG), time_offset_s=0.3, time_offset_sd_s=0.3),
            "dvl": nf.BodyVelocity(
                rate_hz=4.0,
                error=nf.White(sd=0.02),
                lever_arm_b_m=(0.5, 0.0, 0.1),
                time_offset_s=0.4,
                time_offset_sd_s=0.2,
                lever_arm_sd_m=arm,
            ),
            "gps": nf.Position(rate_hz=1.0, error=nf.White(sd=0.3), time_offset_sd_s=0.3, lever_arm_sd_m=arm),
        },
    )
    return vehicle, Motion((ChangeSpeed(1.5, 10.0), *legs, *legs), latitude_deg=45.0)


def drawn(mission, state):
    """What the simulator drew for a state, from the notes of the mission."""
    name, what = state.split(".")
    kind = "time offset" if what == "time_offset" else "lever arm"
    values = next(note for note in mission.notes if note.startswith(f"{name}: {kind} error")).split("error ")[1].split()
    return float(values["xyz".index(what[-1]) if kind == "lever arm" else 0])


@pytest.mark.parametrize("arm_sd_m", [0.0, 0.3])
def test_clocks_and_arms_are_found_with_an_honest_sd(arm_sd_m):
    """50 seeds, prior drawn as it is described; the squared error over the variance is 1 in the mean."""
    vehicle, way = survey(arm_sd_m)
    square, gained = {}, {}
    for seed in range(50):
        mission = simulate(vehicle, way, seed=seed, start=StartErrors(heading_sd_deg=5.0))
        track = nf.replay(vehicle, mission)
        states = [i for i, name in enumerate(track.state_names) if "time_offset" in name or "lever_arm" in name]
        for i in states:
            name = track.state_names[i]
            error = track.states[-1, i] - drawn(mission, name)
            square.setdefault(name, []).append((error / track.states_sd[-1, i]) ** 2)
            gained.setdefault(name, []).append(track.states_sd[-1, i] / track.states_sd[0, i])
    assert len(square) == (9 if arm_sd_m else 3)
    for name, values in square.items():
        # chi-square of 50: 0.58 to 1.53 holds 99 %; states that turns tell to a per cent of their sd also have their
        # linearisation in it, hence the upper end
        assert 0.5 < np.mean(values) < 2.0, (name, np.mean(values))
    for name in ("compass.time_offset", "dvl.time_offset"):
        assert np.median(gained[name]) < 0.05, name
    assert np.median(gained["gps.time_offset"]) < 0.3


NOISY = nf.White(sd=0.15) + nf.RandomWalk(density=5e-4, start_sd=0.02)


def test_noise_of_the_accelerometers_tells_no_clock():
    """Straight ahead at one speed nothing shows the clock: its sd stays, however noisy the accelerometers."""
    dvl = nf.BodyVelocity(rate_hz=4.0, error=nf.White(sd=0.01), time_offset_sd_s=0.3)
    compass = nf.Heading(rate_hz=2.0, error=nf.White(sd=0.5 * DEG))
    vehicle = nf.Vehicle(imu=nf.Imu(rate_hz=50.0, accel=NOISY), sensors={"compass": compass, "dvl": dvl})
    track = nf.replay(vehicle, simulate(vehicle, Motion((Straight(60.0),), speed_m_s=1.5), seed=1))
    assert track.states_sd[-1, track.state_names.index("dvl.time_offset")] > 0.29


def test_clocks_are_honest_where_the_accelerometers_are_noisy():
    """Vibration of 0.15 m/s^2 beside changes of speed of 0.2 m/s^2, 24 seeds."""
    vehicle, way = survey()
    vehicle = replace(vehicle, drive=nf.Imu(rate_hz=50.0, accel=NOISY))
    square, sds = [], []
    for seed in range(200, 224):
        mission = simulate(vehicle, way, seed=seed, start=StartErrors(heading_sd_deg=5.0))
        track = nf.replay(vehicle, mission)
        i = track.state_names.index("dvl.time_offset")
        sds.append(track.states_sd[-1, i])
        square.append(((track.states[-1, i] - drawn(mission, "dvl.time_offset")) / sds[-1]) ** 2)
    # chi-square of 24: 0.41 to 1.9 holds 99 %; what noise seems to say is left out, so it may be too modest
    assert 0.3 < np.mean(square) < 1.9, np.mean(square)
    assert np.median(sds) < 0.05


def test_the_smoother_gives_the_constant_back_from_the_start():
    vehicle, way = survey(0.3)
    mission = simulate(vehicle, way, seed=7)
    smoothed = nf.replay(vehicle, mission, smooth=True)
    for name in ("dvl.time_offset", "dvl.lever_arm_y"):
        i = smoothed.state_names.index(name)
        # of a constant the smoother knows the same at all times, but for rounding
        np.testing.assert_allclose(smoothed.states[:, i], smoothed.states[-1, i], atol=1e-8)
        np.testing.assert_allclose(smoothed.states_sd[:, i], smoothed.states_sd[-1, i], rtol=1e-3)
        assert abs(smoothed.states[0, i] - drawn(mission, name)) < 4.0 * smoothed.states_sd[0, i]


def test_a_described_offset_is_that_of_the_stamps():
    """Readings stamped late by what the vehicle says are those of a vehicle without the offset, to the last bit."""
    vehicle, way = survey()
    plain = vehicle.__class__(
        vehicle.drive, {n: replace(s, time_offset_s=0.0, time_offset_sd_s=0.0) for n, s in vehicle.sensors.items()}
    )
    mission = simulate(plain, way, seed=1)
    late = {name: {"compass": 0.25, "dvl": 0.5, "gps": -0.125}.get(name, 0.0) for name in mission.streams}
    moved = replace(mission, streams={n: s.later(late[n]) for n, s in mission.streams.items()})
    described = replace(plain, sensors={n: replace(s, time_offset_s=late[n]) for n, s in plain.sensors.items()})
    one, other = nf.replay(plain, mission), nf.replay(described, moved)
    np.testing.assert_array_equal(one.latitude, other.latitude)
    np.testing.assert_array_equal(one.covariance, other.covariance)


def test_a_vehicle_that_resumes_remembers_how_it_moved():
    """Snapshot with clocks in doubt and readings that wait: the same to the last bit."""
    vehicle, way = survey(0.1)
    mission = simulate(vehicle, way, seed=2, duration_s=40.0)
    imu, dvl = mission.streams["imu"], mission.streams["dvl"]

    def run(nav, begin_s, end_s):
        events = [(t, "imu", row) for t, row in zip(imu.time_s, imu.value, strict=True)]
        events += [(t, "dvl", row) for t, row in zip(dvl.time_s, dvl.value, strict=True)]
        for time_s, name, row in sorted((e for e in events if begin_s <= e[0] < end_s), key=lambda e: e[0]):
            if name == "imu":
                nav.step(float(time_s), row[:3], row[3:])
            else:
                status = nav.correct(name, float(time_s), row).status
                assert status == "waiting" or (status == "too-late" and time_s < 0.4)  # taken before the start
        return nav

    whole = run(nf.Navigator(vehicle, mission.start), 0.0, 40.0)
    half = run(nf.Navigator(vehicle, mission.start), 0.0, 20.0)
    rest = run(nf.Navigator.restore(vehicle, half.snapshot()), 20.0, 40.0)
    np.testing.assert_array_equal(whole.filter.nav, rest.filter.nav)
    np.testing.assert_array_equal(whole.filter.P, rest.filter.P)


def test_clocks_and_arm_of_dead_reckoning_are_found_with_an_honest_sd():
    """Both clocks and the arm of the drive against fixes, 40 seeds, prior drawn as it is described."""
    heading = nf.GaussMarkov(sd=0.3 * DEG, tau_s=60.0) + nf.White(sd=0.1 * DEG)
    velocity = nf.BodyVelocity(
        error=nf.White(sd=0.02), lever_arm_b_m=(-1.8, 0.0, 0.0), lever_arm_sd_m=(0.5, 0.5, 0.0), time_offset_sd_s=0.3
    )
    drive = nf.DeadReckoning(
        rate_hz=5.0,
        attitude=nf.Heading(error=heading, time_offset_s=-0.2, time_offset_sd_s=0.3),
        velocity=velocity,
        tilt=nf.White(sd=0.1 * DEG),
    )
    names = ("velocity.lever_arm_x", "velocity.lever_arm_y", "velocity.time_offset", "attitude.time_offset")
    assert tuple(p.name for p in drive.parameters() if p.sd) == names
    vehicle = nf.Vehicle(drive, {"gps": nf.Position(rate_hz=1.0, error=nf.White(sd=0.3))})
    way, square, gained = survey()[1], [], []
    for seed in range(40):
        mission = simulate(vehicle, way, seed=seed, start=StartErrors(heading_sd_deg=1.0))
        track = nf.replay(vehicle, mission)
        at = [track.state_names.index(name) for name in names]
        sd = track.states_sd[-1, at]
        square.append(((track.states[-1, at] - [drawn(mission, name) for name in names]) / sd) ** 2)
        gained.append(sd / track.states_sd[0, at])
    # chi-square of 40: 0.54 to 1.6 holds 99 %
    assert np.all((np.mean(square, axis=0) > 0.45) & (np.mean(square, axis=0) < 1.8)), np.mean(square, axis=0)
    assert np.all(np.median(gained, axis=0) < [0.5, 0.3, 0.3, 0.5]), np.median(gained, axis=0)


def test_keys_of_a_vehicle_toml(tmp_path):
    text = """
    [drive]
    type = "dead-reckoning"
    rate_hz = 4
    attitude = {type = "heading", error = {model = "white", sd_deg = 1}, time_offset_sd_s = 0.3}
    [drive.velocity]
    type = "body-velocity"
    time_offset_s = 1.5
    lever_arm_sd_cm = [10, 20, 30]
    [sensors.gps]
    type = "position"
    time_offset_s = -0.2
    time_offset_sd_s = 0.1
    """
    (tmp_path / "vehicle.toml").write_text(text)
    vehicle = nf.read_vehicle(tmp_path)
    assert vehicle.drive.velocity.lever_arm_sd_m == (0.1, 0.2, 0.3) and vehicle.drive.late_s == (0.0, 1.5)
    assert vehicle.sensors["gps"].place_and_clock() == (("time_offset", 0.1, "s", 0.0),)
    described = describe_vehicle(vehicle)
    assert "its stamps are 0.2 s early" in described and "attitude.time_offset 0.3 s" in described
    assert nf.read_vehicle(write_vehicle(vehicle, tmp_path / "again.toml")).sensors == vehicle.sensors
    (tmp_path / "vehicle.toml").write_text(text.replace("time_offset_sd_s = 0.1", "time_offset_sd_s = -0.1"))
    with pytest.raises(ValueError, match=r"gps\.time_offset_sd_s: must be >= 0"):
        nf.read_vehicle(tmp_path)


def test_a_fault_moves_a_sensor_and_what_has_no_arm_is_not_moved():
    vehicle, way = survey()
    plain = simulate(vehicle, way, seed=1, duration_s=30.0)
    moved = simulate(vehicle, way, seed=1, duration_s=30.0, faults={"gps": Faults(lever_arm_m=(0.0, 0.0, 2.0))})
    heights = [m.streams["gps"].value[:, 2] for m in (plain, moved)]
    np.testing.assert_allclose(heights[0] - heights[1], 2.0, atol=0.01)  # of two metres, tilted by 4 deg
    with pytest.raises(ValueError, match="has no lever arm"):
        simulate(vehicle, way, seed=1, duration_s=30.0, faults={"compass": Faults(lever_arm_m=(0.0, 0.0, 2.0))})


@pytest.mark.parametrize("latency_s", [0.0, 0.6, 1.2])
def test_live_is_the_replay_whenever_readings_arrive(latency_s):
    """Readings that wait, and such that arrive when they should have been taken already."""
    vehicle, way = survey(0.1)
    mission = simulate(vehicle, way, seed=4, duration_s=40.0)
    track = nf.replay(vehicle, mission, output_rate_hz=None)
    nav, arrivals = nf.Navigator(vehicle, mission.start), []
    for name, stream in mission.streams.items():
        late_s = 0.0 if name == "imu" else latency_s
        arrivals += [(t + late_s, t, name, row) for t, row in zip(stream.time_s.tolist(), stream.value, strict=True)]
    seen = set()
    for _, time_s, name, row in sorted(arrivals, key=lambda one: one[:3]):
        if name == "imu":
            nav.step(time_s, row[:3], row[3:])
        else:
            seen.add(nav.correct(name, time_s, row).status)
    nav.finish()
    assert "waiting" in seen and ("late-replayed" in seen) == (latency_s > 0.5)
    # what comes late is fed again from a checkpoint: the same but for the rounding of other folds
    atol = 0.0 if latency_s == 0.0 else 1e-12
    np.testing.assert_allclose(nav.state.latitude, track.latitude[-1], rtol=0, atol=atol)
    np.testing.assert_allclose(nav.state.velocity_n, track.velocity_n[-1], rtol=0, atol=1e-6 * bool(atol))
    errors = dict(zip(track.state_names, track.states[-1], strict=True))
    np.testing.assert_allclose(nav.errors["dvl.time_offset"], errors["dvl.time_offset"], atol=1e-7 * bool(atol))


def test_a_snapshot_has_what_has_waited_and_what_still_does():
    """Readings that had waited, and been taken since the oldest checkpoint, waited again in the restored run."""
    vehicle, way = survey(0.1)
    mission = simulate(vehicle, way, seed=4, duration_s=14.0)
    nav, events, seen = nf.Navigator(vehicle, mission.start, threads=False), [], set()
    for name in ("imu", *vehicle.sensors):
        stream = mission.streams[name]
        events += [(t, name, row) for t, row in zip(stream.time_s.tolist(), stream.value, strict=True)]
    for k, (time_s, name, row) in enumerate(sorted(events, key=lambda one: one[:2])):
        if name == "imu":
            nav.step(time_s, row[:3], row[3:])
        else:
            nav.correct(name, time_s, row)
        if time_s > 10.0 and k % 23 == 0:
            again = nf.Navigator.restore(vehicle, nav.snapshot())
            assert differences(again.memory.filter, nav.memory.filter) == []
            assert differences(again.queue.readings, nav.queue.readings) == []
            assert again.health.sensors == nav.health.sensors
            seen.add(len(nav.queue.readings))
    assert max(seen) > 0
    good = nav.snapshot()
    nav.queue.put(Measurement("sonar", 20.0, np.zeros(1), None))
    with pytest.raises(ValueError, match="cannot be read"):
        nf.Navigator.restore(vehicle, nav.snapshot())
    nf.Navigator.restore(vehicle, good)
