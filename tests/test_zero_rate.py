"""Rest tells the bias of the gyros: the Earth's rate taken off, honest, beside zero velocity, live as replayed."""

from dataclasses import replace

import numpy as np
import pytest
import same_runs
from feeding import events_of, one_by_one

import navfilter as nf
from navfilter.check.plausibility import check_vehicle
from navfilter.io import write_vehicle
from navfilter.simulation.manoeuvres import ChangeSpeed, Straight, Turn, Wait
from navfilter.simulation.motion import Motion
from navfilter.simulation.scenarios import survey, survey_vehicle
from navfilter.simulation.simulate import StartErrors, simulate

DEG = np.pi / 180.0
BIAS = 0.01 * DEG
STILL = Motion((Wait(60.0), ChangeSpeed(1.0, 5.0), Turn(180.0, 8.0)), latitude_deg=48.0, heading_deg=70.0)


def vehicle_of(gyro=1e-4, start_sd=BIAS, rate=True, turning=1e-6, rate_hz=20.0):
    sensors = {
        "still": nf.ZeroVelocity(rate_hz=1.0),
        "gps": nf.Position(rate_hz=1.0, error=nf.White(sd=1.0)),
    }
    if rate:
        sensors["turning"] = nf.ZeroRate(rate_hz=1.0, error=nf.White(sd=turning))
    gyros = nf.White(density=gyro) + nf.RandomWalk(density=1e-9, start_sd=start_sd)
    return nf.Vehicle(imu=nf.Imu(rate_hz=rate_hz, gyro=gyros), sensors=sensors)


def bias(track, time_s):
    """Estimate and sd of the three gyros' biases."""
    row, at = int(np.searchsorted(track.time_s, time_s)), [track.state_names.index(f"gyro_{a}[0]") for a in "xyz"]
    return track.states[row, at], track.states_sd[row, at]


@pytest.mark.parametrize("rate_hz", [20.0, 100.0])
def test_27_seconds_at_rest_tell_the_bias(rate_hz):
    vehicle = vehicle_of(rate_hz=rate_hz)
    mission = simulate(vehicle, STILL, seed=1, duration_s=30.0)
    without = bias(nf.replay(vehicle.without("turning"), mission), 27.5)[1]
    found = bias(nf.replay(vehicle, mission), 27.5)[1]
    assert without[2] > 0.99 * BIAS  # the heading is all that would tell the third one
    # noise of 1e-4 over the root of 27 s, against what is believed beforehand; the Earth's rate in an uncertain heading
    # (1 deg: 8.5e-7) is in the level axes
    np.testing.assert_allclose(found[2], (27.0 / 1e-8 + BIAS**-2) ** -0.5, rtol=0.02)


@pytest.mark.parametrize("gyro", [1e-4, 3e-6])
def test_the_covariance_is_honest(gyro):
    """Bias and heading at the end of the rest, 40 seeds; with good gyros the Earth's rate shows where north is."""
    start_sd, square, heading, sd = (BIAS if gyro > 1e-5 else 3e-7), [], [], []
    vehicle = vehicle_of(gyro, start_sd, turning=1e-7)
    for seed in range(40):
        mission = simulate(vehicle, STILL, seed=seed, duration_s=58.0, start=StartErrors(heading_sd_deg=5.0))
        track = nf.replay(vehicle, mission)
        true = mission.streams["imu"].value[:, :3].mean(axis=0) - earth_rate(mission)
        value, spread = bias(track, 57.5)
        # what the noise of the gyros adds to that mean
        square.append(((value - true) ** 2) / (spread**2 + gyro**2 / 58.0))
        heading.append(track.nees(track.errors(mission.truth))["heading"][-1])
        sd.append(np.sqrt(track.covariance[-1, 8, 8]))
    # the mean and the estimate share their noise, so that the square is smaller than one
    assert np.mean(square) < 1.2, np.mean(square)
    assert 0.55 < np.mean(heading) < 1.6, np.mean(heading)  # chi-square of 40: 0.52 to 1.65 holds 99 %
    if gyro < 1e-5:
        assert np.median(sd) < 1.2 * DEG  # of 5 deg: 3e-7 of 4.9e-5 rad/s, and the tilts


def earth_rate(mission):
    """In the body, at rest on the truth's attitude."""
    roll, pitch, yaw = mission.truth.value[0, 6:9]
    from navfilter.models.state import matrix_from_euler

    lat = mission.truth.value[0, 0]
    return matrix_from_euler(roll, pitch, yaw).T @ (7.292115e-5 * np.array([np.cos(lat), 0.0, -np.sin(lat)]))


def test_under_way_it_says_nothing_and_live_is_the_replay(tmp_path):
    vehicle = vehicle_of()
    mission = simulate(vehicle, STILL, seed=2, duration_s=80.0)
    track = nf.replay(vehicle, mission)
    times = track.residuals["turning"].time_s
    still = track.residuals["still"].time_s
    np.testing.assert_array_equal(times, still[: len(times)])
    # a steady acceleration feels like rest, but the filter is sure that it moves; a turn does not
    assert len(times) >= 58 and times.max() < 63.0 < still.max() < 67.0
    events = events_of(vehicle.without("still", "turning"), mission)
    whole, half = nf.Navigator(vehicle, mission.start), nf.Navigator(vehicle, mission.start)
    one_by_one(whole, events)
    one_by_one(half, events[: len(events) // 3])
    half.snapshot(tmp_path / "state.nav")
    rest = nf.Navigator.restore(vehicle, tmp_path / "state.nav")
    one_by_one(rest, events[len(events) // 3 :])
    same_runs.assert_same_bits(whole, rest)
    np.testing.assert_array_equal(whole.filter.nav[:3], [track.latitude[-1], track.longitude[-1], track.height[-1]])


def test_words_and_files(tmp_path):
    vehicle = vehicle_of()
    assert nf.read_vehicle(write_vehicle(vehicle, tmp_path / "vehicle.toml")) == vehicle
    assert not [f for f in check_vehicle(vehicle) if "turning" in f.stream]
    odd = nf.Vehicle(vehicle.drive, {"turning": nf.ZeroRate(gyro_mean_max=1.0)})
    assert [f for f in check_vehicle(odd) if f.stream == "sensors.turning.gyro_mean_max"]


def test_a_vehicle_that_shakes_at_rest_rests_where_its_speed_is_none():
    """Limits of scatter that a running engine asks for hold under way, too; a speed that is told does not."""
    vehicle = vehicle_of()
    wheels = nf.BodyVelocity(rate_hz=5.0, error=nf.White(sd=0.01))
    loose = nf.ZeroRate(rate_hz=1.0, error=nf.White(sd=1e-6), gyro_sd_max=1.0, force_sd_max=10.0)
    # 60 s at rest, then straight on with 1 m/s
    ahead = Motion((Wait(60.0), ChangeSpeed(1.0, 5.0), Straight(60.0)), latitude_deg=48.0, heading_deg=70.0)
    sensors = {"wheels": wheels, "gps": vehicle.sensors["gps"]}
    mission = simulate(nf.Vehicle(vehicle.drive, sensors), ahead, seed=3, duration_s=120.0)
    ends = []
    for speed_max in (np.inf, 0.1):
        one = nf.Vehicle(vehicle.drive, {**sensors, "turning": replace(loose, speed_max=speed_max)})
        ends.append(nf.replay(one, mission).residuals["turning"].time_s.max())
    assert ends[0] > 119.0 and 59.0 <= ends[1] <= 62.0, ends


@pytest.mark.parametrize("steady", ["straight", "slow turn"])
def test_a_vehicle_that_goes_steadily_does_not_rest(steady):
    """Found by random vehicles: an AUV going straight on at depth was taken to be at rest, the rates that its autopilot
    leaves for biases of the gyros, and the position had a NEES of 1e3 to 1e6.
    """
    way = (Straight(duration_s=120.0),) if steady == "straight" else (Turn(100.0, 1.0), Turn(-100.0, 1.0))
    dive = Motion((Wait(20.0), ChangeSpeed(1.5, 15.0), *way, Straight(duration_s=60.0)), latitude_deg=48.0)
    survey = survey_vehicle()
    vehicle = nf.Vehicle(survey.drive, {**survey.sensors, "turning": nf.ZeroRate()})
    mission = simulate(vehicle, dive, seed=2, duration_s=180.0, start=StartErrors(heading_sd_deg=2.0))
    track = nf.replay(vehicle, mission, output_rate_hz=1.0)
    assert track.residuals["turning"].time_s.max() < 25.0
    errors = track.errors(mission.truth)
    nees = track.nees(errors)
    # 3: what a mission of some minutes may have by chance
    assert np.nanmean(nees["heading"]) < 3.0 and np.nanmean(nees["attitude"]) < 3.0


def test_a_rate_that_is_let_in_is_a_bias_and_no_attitude():
    """Refused when the vehicle set off, let in when it has not quite come to rest ten minutes later: the Earth's rate
    tells the attitude so weakly that any attitude seemed to explain it, and the tilt was off by 113 deg.
    """
    diver = survey_vehicle()
    vehicle = nf.Vehicle(diver.drive, {**diver.sensors, "turning": nf.ZeroRate(speed_max=0.2)})
    mission = simulate(vehicle, survey(700.0), seed=2, duration_s=700.0, start=StartErrors(heading_sd_deg=2.0))
    track = nf.replay(vehicle, mission, output_rate_hz=1.0)
    assert track.counts["widened"] == 1 and track.residuals["turning"].time_s[-1] > 690.0
    assert np.degrees(np.abs(track.errors(mission.truth).attitude[:, :2]).max()) < 1.0


@pytest.mark.parametrize("limit", ["gyro_sd_max", "force_sd_max", "gyro_mean_max", "speed_max"])
def test_a_limit_that_nothing_is_below_is_refused(limit):
    for value in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match=rf"ZeroRate\.{limit} must be > 0, found .*: nothing is below it"):
            nf.ZeroRate(**{limit: value})
