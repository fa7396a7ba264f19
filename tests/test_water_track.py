"""Water track: while the bottom is lost, what is known of the current carries the position, and the covariance says how
far.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import same_runs
from feeding import delayed, events_of, one_by_one
from scipy.stats import chi2

import navfilter as nf
from navfilter.evaluation.baselines import learnable
from navfilter.simulation.manoeuvres import ChangeSpeed, Lawnmower, Wait
from navfilter.simulation.motion import Motion
from navfilter.simulation.scenarios import simulate_scenario
from navfilter.simulation.simulate import Faults, simulate

SEEDS = (1, 2, 3)
LOST_S, FOUND_S = 600.0, 1200.0  # the bottom, in the scenario of 1800 s


@cache
def runs(seed):
    """Mission, the run with water track, and that without it."""
    vehicle, mission = simulate_scenario("water-track", seed)
    return mission, nf.replay(vehicle, mission), nf.replay(vehicle.without("water"), mission)


def at(track, time_s):
    return int(np.searchsorted(track.time_s, time_s - 1e-6))


@pytest.mark.parametrize("seed", SEEDS)
def test_ten_minutes_without_the_bottom(seed):
    mission, water, none = runs(seed)
    seen = mission.streams["dvl"].time_s
    assert not np.any((seen > LOST_S) & (seen < FOUND_S)) and np.any(seen > FOUND_S + 1.0)
    inside = (water.time_s > LOST_S) & (water.time_s < FOUND_S)
    gone = np.nanmax(water.errors(mission.truth).horizontal[inside])
    alone = np.nanmax(none.errors(mission.truth).horizontal[(none.time_s > LOST_S) & (none.time_s < FOUND_S)])
    # The current changes by 0.1 sqrt(2 dt / 6 h) m/s in dt: over 600 s that alone is 0.1 sqrt(2 / 21600) sqrt(600^3 /
    # 3) = 8.2 m per axis. Four sd of it in either axis: 33 m. The accelerometers' 1 mg would be 1.8 km if nothing of it
    # were known.
    assert gone < 33.0 and alone > 10.0 * gone


@pytest.mark.parametrize("seed", SEEDS)
def test_the_bottom_comes_back_smoothly(seed):
    """No reading is rejected within the first minute: what the filter expects of the velocity is as uncertain as it
    says.
    """
    mission, water, _ = runs(seed)
    residuals = water.residuals["dvl"]
    first = (residuals.time_s >= FOUND_S) & (residuals.time_s < FOUND_S + 60.0)
    assert np.count_nonzero(first) > 200 and residuals.used[first].all()
    # The change of the current shows in the velocity now. A random walk and its integral are correlated by sqrt(3) / 2,
    # so that half the sd of the position goes with it, a little less for what it was before; and the position moves by
    # what was uncertain.
    before, after = at(water, FOUND_S - 1.0), at(water, FOUND_S + 10.0)
    sd = np.sqrt(np.diagonal(water.covariance, axis1=1, axis2=2)[:, :2])
    assert 0.45 * sd[before].mean() < sd[after].mean() < 0.65 * sd[before].mean()
    errors = water.errors(mission.truth).position_n
    assert np.all(np.abs(errors[after] - errors[before])[:2] < 4.0 * sd[before])


def test_the_covariance_is_honest():
    """NEES of position and velocity just before and after the bottom comes back, of all seeds together."""
    sums, dof = {}, 3 * len(SEEDS)
    for seed in SEEDS:
        mission, water, _ = runs(seed)
        figures = water.nees(water.errors(mission.truth))
        for name in ("position", "velocity"):
            for time_s in (900.0, FOUND_S - 1.0, FOUND_S + 10.0):
                sums[name, time_s] = sums.get((name, time_s), 0.0) + 3.0 * figures[name][at(water, time_s)]
    low, high = chi2.ppf([0.001, 0.999], dof)  # six figures
    assert all(low < value < high for value in sums.values()), (sums, low, high)


def test_the_current_is_found_and_stands_in_the_track():
    vehicle, _ = simulate_scenario("water-track", 1, 10.0)
    motion = Motion((Wait(5.0), ChangeSpeed(1.5, 10.0), Lawnmower(4, 60.0)), latitude_deg=26.0, heading_deg=40.0)
    steady = {"water": Faults(current_m_s=(0.12, -0.07))}
    mission = simulate(vehicle, motion, seed=5, duration_s=200.0, faults=steady)
    assert any("current 0.12 -0.07 m/s" in note for note in mission.notes)
    track = nf.replay(vehicle, mission)
    for name, truth in (("water.current_north", 0.12), ("water.current_east", -0.07)):
        value, sd = track.state(name)
        # sd: 0.02 and 0.01 m/s of two hundred seconds at 4 Hz leave millimetres; the current itself wanders on
        assert sd[-1] < 0.02 and abs(value[-1] - truth) < 4.0 * sd[-1]
    layout = nf.Navigator(vehicle, mission.start).filter.layout
    units = dict(zip(layout.names, layout.units, strict=True))
    assert units["water.current_north"] == units["water.current_east"] == "m_s"


@pytest.mark.parametrize(
    "current",
    [nf.GaussMarkov(sd=0.2, tau_s=400.0, order=2), nf.GaussMarkov(sd=0.1, tau_s=3000.0) + nf.Cycle(0.25, 1500.0, 2e4)],
    ids=["second order", "tide"],
)
def test_a_current_of_several_states_beside_a_unit(current):
    """What its model consists of stands before the scale: taken for that, the velocity was 1e7 and 5 variances off."""
    water = nf.WaterVelocity(rate_hz=1.0, error=nf.White(sd=0.01), current=current)
    plain = simulate_scenario("water-track", 1, 10.0)[0]
    others = {name: plain.sensors[name] for name in ("compass", "depth", "gps")}
    vehicle = nf.Vehicle(plain.drive, {**others, "water": water})
    motion = Motion((Wait(5.0), ChangeSpeed(1.5, 10.0), Lawnmower(4, 60.0)), latitude_deg=26.0, heading_deg=40.0)
    means = []
    for seed in range(6):
        mission = simulate(vehicle, motion, seed=seed, duration_s=250.0)
        track = nf.replay(vehicle, mission, output_rate_hz=0.2)
        means.append(np.nanmean(track.nees(track.errors(mission.truth))["velocity"]))
    # each hardly less than one square of three degrees of freedom: of six the mean is above 2.4 in a case of a thousand
    assert np.mean(means) < 2.4, means


def test_the_current_wanders_on_the_sensors_clock():
    """Between two readings 100 s apart the covariance of the current is that of a Gauss-Markov process after 100 s."""
    water = nf.WaterVelocity(rate_hz=4.0, current_sd_m_s=0.3, current_tau_s=500.0, gate_probability=1.0 - 1e-12)
    vehicle = nf.Vehicle(imu=nf.Imu(rate_hz=10.0), sensors={"water": water})
    nav = nf.Navigator(vehicle, nf.Start(latitude_deg=30.0, longitude_deg=0.0, velocity_sd_m_s=1e-6))
    group = nav.filter.layout.groups["water"]
    ticked = nav.filter.channels["water"].model
    np.testing.assert_allclose(np.diag(ticked[0]), np.exp(-0.25 / 500.0), rtol=1e-12)
    np.testing.assert_allclose(np.diag(ticked[1]), 0.09 * (1.0 - np.exp(-0.5 / 500.0)), rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(group.P0)), 0.3)
    constant = replace(vehicle, sensors={"dvl": nf.BodyVelocity(scale_sd=0.01)})
    assert not nf.Navigator(constant, nav.start).filter.layout.groups["dvl"].ticking


def test_alignment_does_not_take_the_water_for_the_ground():
    """The start's velocity comes from the bottom track, whichever stands first."""
    vehicle, mission = simulate_scenario("water-track", 2, 120.0)
    turned = nf.Vehicle(vehicle.drive, dict(reversed(vehicle.sensors.items())))
    plain = replace(mission, start=None)
    assert nf.align(turned, plain) == nf.align(vehicle.without("water"), plain)


def test_late_and_restored_water_tracks_are_in_order(tmp_path):
    """Readings through the water up to 1.5 s late, and a snapshot half-way, give what arrival in order gives."""
    vehicle, mission = simulate_scenario("water-track", 4, 60.0)
    events = events_of(vehicle, mission)
    late = delayed(events, ("water",), 1.5, seed=1)
    ordered, mixed = nf.Navigator(vehicle, mission.start), nf.Navigator(vehicle, mission.start)
    one_by_one(ordered, events)
    outcomes = [outcome.status for outcome in one_by_one(mixed, late[:4000])]
    assert outcomes.count("late-replayed") > 50
    mixed.snapshot(tmp_path / "state.nav")
    restored = nf.Navigator.restore(vehicle, tmp_path / "state.nav")
    for nav in (mixed, restored):
        one_by_one(nav, late[4000:])
    same_runs.assert_same_bits(mixed, restored)
    same_runs.assert_same_estimate(ordered, mixed)


def test_others_learn_beside_it():
    """What is learnt and compared leaves the log alone; to ask for it is refused with a reason."""
    vehicle, mission = simulate_scenario("water-track", 1, 120.0)
    assert "water" not in learnable(vehicle, mission)
    with pytest.raises(ValueError, match="the current hides in it"):
        vehicle.with_error(water=nf.LearnedArma())
    learning = vehicle.with_error(compass=nf.LearnedArma(prior=vehicle.sensors["compass"].error, window=400, hop=100))
    nav = nf.Navigator(learning, mission.start)
    one_by_one(nav, events_of(learning, mission))
    assert nav.counts["adopted"] > 0 and abs(nav.errors["water.current_north"]) < 0.4
