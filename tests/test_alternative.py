"""While the inertial unit is in doubt the same filter goes on without it beside the run, and the readings decide."""

import math
from dataclasses import replace

import numpy as np
import pytest
import same_runs
from feeding import events_of, one_by_one

import navfilter as nf
from navfilter.evaluation.baselines import rivals
from navfilter.evaluation.montecarlo.campaign import Campaign
from navfilter.faults import settings
from navfilter.navigation import runner
from navfilter.simulation.scenarios import simulate_scenario, survey, survey_vehicle
from navfilter.simulation.simulate import Faults, simulate

DEG, METRES = math.pi / 180.0, 6.37e6
TURN_S, FAULT_S = 175.0, 120.0  # between two quarter turns, and anywhere


@pytest.fixture(scope="module")
def dive():
    vehicle, mission = simulate_scenario("lawnmower", 3, 360.0)
    mission = mission.hide("gps", (60.0, 1e9)).between(0.0, 300.0)
    return vehicle, mission, nf.replay(vehicle, mission, output_rate_hz=1.0)


def spoiled(mission, change, name="imu", begin_s=FAULT_S, end_s=math.inf):
    stream = mission.streams[name]
    value = stream.value.copy()
    hit = (stream.time_s >= begin_s) & (stream.time_s < end_s)
    value[hit] = change(value[hit])
    return mission.with_stream(name, nf.Stream(stream.time_s, value, stream.columns))


def times(axis, factor):
    return lambda v: v * np.where(np.arange(6) == axis, factor, 1.0)


def plus(axis, by):
    return lambda v: v + by * (np.arange(6) == axis)


UNIT = {
    "gyro z of the other sign": (times(2, -1.0), TURN_S),
    "gyro z doubled": (times(2, 2.0), TURN_S),
    "gyro x +400 deg/h": (plus(0, 400.0 * DEG / 3600.0), FAULT_S),
    "accelerometer y +50 mg": (plus(4, 0.49), FAULT_S),
    "accelerometer x +3 m/s^2": (plus(3, 3.0), FAULT_S),
    "gyros x and z exchanged": (lambda v: v[:, [2, 1, 0, 3, 4, 5]], FAULT_S),
    "accelerometers y and z exchanged": (lambda v: v[:, [0, 1, 2, 3, 5, 4]], FAULT_S),
}


@pytest.mark.parametrize("name", UNIT)
def test_a_unit_that_is_wrong_takes_the_run_nowhere(dive, name):
    vehicle, mission, clean = dive
    change, begin_s = UNIT[name]
    track = nf.replay(vehicle, spoiled(mission, change, begin_s=begin_s), output_rate_hz=1.0)
    errors, late = track.errors(mission.truth), track.time_s > begin_s
    assert np.nanmax(errors.horizontal[late]) < 6.0 + np.nanmax(clean.errors(mission.truth).horizontal)
    # the heading is the compass's, whose slow error no gyro outlives
    assert np.nanmean(track.nees(errors)["heading"][track.time_s > 270.0]) < 9.0
    assert clean.counts["contradicted"] == 0


def test_a_unit_that_is_good_again_is_used_again(dive):
    vehicle, mission, _ = dive
    nav = nf.Navigator(vehicle, mission.start)
    one_by_one(nav, events_of(vehicle, spoiled(mission, plus(3, 3.0), end_s=130.0)))
    assert nav.counts["contradicted"] == 3  # its gyros were used all the time
    assert set(nav.health.axes.values()) == {"good"}


COMPASSES = {
    "deviation of 15 deg": lambda v: v + 15.0 * DEG * np.sin(v),
    "mirrored": lambda v: -v,
    "stuck": lambda v: np.full_like(v, v[0]),
    "25 deg off": lambda v: v + 25.0 * DEG,
    "noisy": lambda v: v + 5.0 * DEG * np.random.default_rng(1).normal(size=v.shape),
    "2 s late": lambda v: np.roll(np.unwrap(v, axis=0), 16, axis=0),
}
VELOCITIES = {
    "mm/s": lambda v: 1e3 * v,
    "knots": lambda v: 1.94 * v,
    "5 s late": lambda v: np.roll(v, 20, axis=0),
}
SENSORS = [("compass", name, change) for name, change in COMPASSES.items()]
SENSORS += [("dvl", name, change) for name, change in VELOCITIES.items()]


@pytest.mark.parametrize(("sensor", "name", "change"), SENSORS, ids=[f"{s} {n}" for s, n, _ in SENSORS])
@pytest.mark.parametrize("begin_s", [0.0, TURN_S])
def test_a_sensor_that_is_wrong_accuses_no_unit(dive, sensor, name, change, begin_s):
    vehicle, mission, _ = dive
    track = nf.replay(vehicle, spoiled(mission, change, sensor, begin_s), output_rate_hz=1.0)
    assert track.counts["contradicted"] == 0


def test_a_dvl_that_is_mirrored_in_a_turn_accuses_no_accelerometers(dive):
    """Its residuals grow from nothing there, as a force makes them, but in proportion to the turn. A lever arm explains
    them as well until the vehicle goes straight: 10 m, within the bounds.
    """
    vehicle, mission, _ = dive
    track = nf.replay(vehicle, spoiled(mission, lambda v: v * [1.0, -1.0, 1.0], "dvl", TURN_S), output_rate_hz=1.0)
    errors = track.errors(mission.truth).horizontal
    assert track.counts["contradicted"] == 0
    assert np.nanmax(errors) < 12.0 and (errors <= track.bounds[:, 0]).all()


def test_a_dvl_that_is_let_in_now_and_then_on_a_slow_ramp_has_not_jumped():
    """Exchanged accelerometers feel a level vehicle's bias and trim on the wrong axis: the ramp is slow at first."""
    fixes = {"gps": Faults(available=((0.0, 140.0),))}
    vehicle = survey_vehicle()
    mission = simulate(vehicle, survey(700.0, surface_s=110.0), seed=4, duration_s=360.0, faults=fixes)
    track = nf.replay(vehicle, spoiled(mission, lambda v: v[:, [0, 1, 2, 4, 3, 5]], begin_s=250.0))
    assert np.nanmax(track.errors(mission.truth).horizontal[track.time_s > 250.0]) < 15.0  # 780 m if the DVL is blamed


@pytest.mark.parametrize("name", ["accelerometer x +3 m/s^2", "gyro z of the other sign"])
def test_in_stretches_one_by_one_live_and_restored(dive, name, monkeypatch):
    vehicle, mission, _ = dive
    change, begin_s = UNIT[name]
    wrong = spoiled(mission, change, begin_s=begin_s, end_s=begin_s + 30.0).between(0.0, 290.0)
    events = events_of(vehicle, wrong)
    whole, half, late = (nf.Navigator(vehicle, mission.start) for _ in range(3))
    one_by_one(whole, events)
    assert whole.counts["contradicted"] == (3 if name.startswith("accelerometer") else 6)
    together = nf.replay(vehicle, wrong, output_rate_hz=math.inf)
    np.testing.assert_array_equal(together.covariance[-1], whole.covariance)
    assert together.counts == whole.counts
    # a snapshot while the second filter stands for the unit, and every tenth reading a second late
    middle = begin_s + 40.0
    one_by_one(half, [e for e in events if e.time_s <= middle])
    assert half.alternative.is_alive and half.counts["contradicted"]
    again = nf.Navigator.restore(vehicle, half.snapshot())
    one_by_one(again, [e for e in events if e.time_s > middle])
    same_runs.assert_same_bits(whole, again)
    order = sorted((e.time_s + 1.0 * (k % 10 == 0 and e.sensor == "dvl"), k) for k, e in enumerate(events))
    one_by_one(late, [events[k] for _, k in order])
    same_runs.assert_same_bits(whole, late)
    monkeypatch.setattr(runner.BatchRunner, "possible", property(lambda self: False))
    np.testing.assert_array_equal(nf.replay(vehicle, wrong, output_rate_hz=math.inf).covariance, together.covariance)


# --- a velocity that runs away, and a force that is felt wrongly, look the same ------------------------------------


def running_away(mission, m_s2, lasts_s):
    stream = mission.streams["dvl"]
    off = m_s2 * np.clip(stream.time_s - FAULT_S, 0.0, lasts_s)
    return mission.with_stream("dvl", nf.Stream(stream.time_s, stream.value + np.outer(off, [1.0, 0.0, 0.0])))


@pytest.fixture(scope="module")
def surfacing():
    vehicle, mission = simulate_scenario("lawnmower", 3, 360.0)
    return vehicle, mission.hide("gps", (60.0, 250.0)).between(0.0, 340.0)


@pytest.mark.parametrize(("m_s2", "lasts_s"), [(0.1, 60.0), (0.1, 10.0), (0.03, 60.0)])
def test_a_velocity_that_runs_away_is_told_from_a_force_by_fixes_and_the_distance_until_then(surfacing, m_s2, lasts_s):
    vehicle, mission = surfacing
    track = nf.replay(vehicle, running_away(mission, m_s2, lasts_s), output_rate_hz=1.0)
    errors, dived = track.errors(mission.truth), (track.time_s > FAULT_S) & (track.time_s < 250.0)
    nees, late = track.nees(errors), track.time_s > 300.0
    assert (errors.horizontal <= track.bounds[:, 0])[dived].all()
    # 150 to 7,000, and with fixes 13 to 75,000, where the unit is believed to be what errs
    assert np.nanmean(nees["position"][dived]) < 2.0 and np.nanmean(nees["position"][late]) < 2.0


def test_a_force_that_is_felt_wrongly_costs_no_distance(surfacing):
    """No vehicle is as fast as the unit says soon: the velocity was right."""
    vehicle, mission = surfacing
    wrong = spoiled(mission, plus(3, 0.1))
    track = nf.replay(vehicle, wrong, output_rate_hz=1.0)
    dived = (track.time_s > FAULT_S + 40.0) & (track.time_s < 250.0)
    assert np.nanmax(track.errors(mission.truth).horizontal[dived]) < 3.0
    assert track.horizontal_sd()[dived].max() < 6.0


def test_the_filter_without_a_velocity_is_the_same_late_and_restored(surfacing):
    vehicle, mission = surfacing
    events = events_of(vehicle, running_away(mission, 0.1, 10.0).between(0.0, 280.0))
    whole, half, late = (nf.Navigator(vehicle, mission.start) for _ in range(3))
    one_by_one(whole, events)
    one_by_one(half, [e for e in events if e.time_s <= 200.0])
    assert half.alternative.subset.memory is not None
    sd = half.state.sd[:2].max()
    again = nf.Navigator.restore(vehicle, half.snapshot())
    assert again.state.sd[:2].max() == sd > 5.0
    one_by_one(again, [e for e in events if e.time_s > 200.0])
    same_runs.assert_same_bits(whole, again)
    order = sorted((e.time_s + 1.0 * (k % 10 == 0 and e.sensor == "dvl"), k) for k, e in enumerate(events))
    one_by_one(late, [events[k] for _, k in order])
    same_runs.assert_same_bits(whole, late)
    together = nf.replay(vehicle, running_away(mission, 0.1, 10.0).between(0.0, 280.0), output_rate_hz=math.inf)
    np.testing.assert_array_equal(together.covariance[-1], whole.covariance)


@pytest.mark.parametrize("change", [{"without": ("none",)}, {"most_m_s": 0.0}, {"against": math.nan}])
def test_a_snapshot_whose_filter_without_a_velocity_is_none_is_refused(surfacing, change):
    vehicle, mission = surfacing
    nav = nf.Navigator(vehicle, mission.start)
    one_by_one(nav, events_of(vehicle, running_away(mission, 0.1, 10.0).between(0.0, 140.0)))
    nav.alternative.subset._memory = replace(nav.alternative.subset.memory, **change)
    nav.history.start_here()
    with pytest.raises(ValueError, match=r"memory\.subset"):
        nf.Navigator.restore(vehicle, nav.snapshot())


def test_a_snapshot_whose_second_filter_is_none_is_refused(dive):
    vehicle, mission, _ = dive
    nav = nf.Navigator(vehicle, mission.start)
    events = events_of(vehicle, spoiled(mission, plus(3, 3.0)))
    one_by_one(nav, [e for e in events if e.time_s < FAULT_S + 10.0])
    assert nav.alternative.is_alive
    nav.alternative._filter.memory.P[0, 0] = -1.0
    nav.history.start_here()
    with pytest.raises(ValueError, match="covariance"):
        nf.Navigator.restore(vehicle, nav.snapshot())


def test_smoothing_over_a_change_of_filters_is_finite_and_honest(dive):
    vehicle, mission, _ = dive
    track = nf.replay(vehicle, spoiled(mission, plus(3, 3.0), end_s=140.0), smooth=True)
    assert track.counts["contradicted"] == 3 and np.isfinite(track.covariance).all()
    nees = track.nees(track.errors(mission.truth))["position"]
    assert np.nanmean(nees[track.time_s > 140.0]) < 3.0


def test_without_a_compass_the_gyros_are_kept(dive):
    vehicle, mission, clean = dive
    alone, begun = vehicle.without("compass"), mission.hide("compass", (-math.inf, math.inf))
    track = nf.replay(alone, spoiled(begun, plus(3, 3.0)), output_rate_hz=1.0)
    assert track.counts["contradicted"] == 3
    errors = track.errors(mission.truth)
    assert np.nanmax(errors.horizontal) < 6.0 + np.nanmax(clean.errors(mission.truth).horizontal)
    assert np.nanmean(track.nees(errors)["heading"][track.time_s > FAULT_S]) < 9.0


def test_gyros_that_fail_beside_accelerometers_that_have_are_left_out_too(dive):
    vehicle, mission, clean = dive
    wrong = spoiled(spoiled(mission, plus(3, 3.0)), plus(2, 0.2), begin_s=200.0)
    track = nf.replay(vehicle, wrong, output_rate_hz=1.0)
    assert track.counts["contradicted"] == 6
    errors = track.errors(mission.truth)
    # one sensor has to speak for a third of a minute; until then 1.5 m/s may lead the other way
    most_m = 2.0 * 1.5 * settings.LANE_SHARE * settings.WINDOW_S
    assert np.nanmax(errors.horizontal) < most_m + np.nanmax(clean.errors(mission.truth).horizontal)
    assert np.nanmean(track.nees(errors)["heading"][track.time_s > 270.0]) < 9.0


def test_sensors_whose_clocks_are_states_bring_the_unit_back(dive):
    vehicle, mission, _ = dive
    clocks = {name: replace(sensor, time_offset_sd_s=0.02) for name, sensor in vehicle.sensors.items()}
    vehicle = nf.Vehicle(vehicle.drive, clocks)
    nav = nf.Navigator(vehicle, mission.start)
    one_by_one(nav, events_of(vehicle, spoiled(mission, plus(3, 3.0), end_s=130.0)))
    assert nav.counts["contradicted"] and set(nav.health.axes.values()) == {"good"}


def test_who_wants_no_second_filter_has_none_after_a_restart(dive):
    vehicle, mission, _ = dive
    events = events_of(vehicle, spoiled(mission, plus(3, 3.0)))
    nav = nf.Navigator(vehicle, mission.start, alternative=False)
    one_by_one(nav, [e for e in events if e.time_s < 100.0])
    again = nf.Navigator.restore(vehicle, nav.snapshot(), alternative=False)
    one_by_one(again, [e for e in events if 100.0 <= e.time_s < 150.0])
    assert not again.alternative.is_alive and again.counts["contradicted"] == 0


@pytest.mark.parametrize(
    ("scenario", "seed", "until_s"), [("compass-tails", 201, 500.0), ("compass-coarse", 202, 300.0)]
)
def test_one_that_is_refused_now_and_then_accuses_no_unit(scenario, seed, until_s):
    """Its refused readings are far from each other whatever the gyros say, and there are hundreds of them."""
    staged = Campaign(scenario, gyro="mems", smooth=False, imu_rate_hz=50.0).staged
    vehicle, mission = staged.vehicle, staged.mission(seed)
    described = rivals(("vehicle",), vehicle, mission, sensors=(staged.learnt,))["vehicle"]
    track = nf.replay(described, mission.between(0.0, until_s), output_rate_hz=1.0)
    assert track.residuals["compass"].count("rejected") > 100
    assert track.counts["contradicted"] == 0
