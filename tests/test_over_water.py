"""Dead reckoning through water: the current between fixes, honest, also with one heading in five seconds."""

from dataclasses import replace

import numpy as np
import pytest
import same_runs
from feeding import events_of, one_by_one

import navfilter as nf
from navfilter.evaluation.correlations import constants
from navfilter.io import write_vehicle
from navfilter.simulation.manoeuvres import ChangeSpeed, Dive, Straight, Turn
from navfilter.simulation.motion import Motion
from navfilter.simulation.simulate import Faults, StartErrors, simulate

DEG = np.pi / 180.0
WAY = Motion(
    (ChangeSpeed(2.0, 20.0), *(Straight(220.0), Turn(80.0, 1.0), Straight(180.0), Turn(-110.0, 1.0)) * 4),
    latitude_deg=54.0,
)


TIDE = nf.GaussMarkov(sd=0.1, tau_s=3000.0) + nf.Cycle(sd=0.25, period_s=1500.0, tau_s=20000.0)


def vehicle_of(rate_hz=1.0, fixes_hz=1.0, **log):
    """A yacht: compass, log, leeway."""
    leeway = nf.GaussMarkov(sd=0.1, tau_s=300.0)
    velocity = nf.WaterVelocity(
        error=(nf.White(sd=0.1), leeway, nf.White(sd=0.05)), zero_is_invalid=False, current_sd_m_s=0.3, **log
    )
    compass = nf.Heading(error=nf.White(sd=1.0 * DEG), bias_sd_rad=2.0 * DEG)
    drive = nf.DeadReckoning(rate_hz=rate_hz, attitude=compass, velocity=velocity, tilt=nf.White(sd=0.5 * DEG))
    return nf.Vehicle(drive, {"gps": nf.Position(rate_hz=fixes_hz, error=nf.White(sd=2.0))})


@pytest.mark.parametrize("rate_hz", [0.2, 1.0])
def test_the_current_carries_the_position_and_the_covariance_says_how_far(rate_hz):
    """Fixes for ten minutes, then none for five: NEES before, and at the end; against the same without a current."""
    vehicle = vehicle_of(rate_hz, scale_sd=0.02)
    blind = nf.BodyVelocity(error=vehicle.drive.velocity.error, zero_is_invalid=False)
    other = replace(vehicle, drive=replace(vehicle.drive, velocity=blind))
    nees, end, plain = [], [], []
    for seed in range(24):
        mission = simulate(vehicle, WAY, seed=seed, duration_s=900.0, start=StartErrors(heading_sd_deg=2.0))
        hidden = mission.hide("gps", (600.0, 901.0))
        track = nf.replay(vehicle, hidden)
        errors = track.errors(mission.truth)
        nees.append([track.nees(errors)["position"][np.searchsorted(track.time_s, t)] for t in (595.0, 890.0)])
        end.append(errors.horizontal[-1])
        plain.append(nf.replay(other, hidden).errors(mission.truth).horizontal[-1])
    # 72 squares: 0.6 to 1.5 holds 99.5 %; the height has little to say
    assert np.all((np.mean(nees, axis=0) > 0.5) & (np.mean(nees, axis=0) < 1.5)), np.mean(nees, axis=0)
    assert np.median(end) < 0.5 * np.median(plain)


@pytest.mark.parametrize("current", [nf.GaussMarkov(sd=0.3, tau_s=1200.0, order=2), TIDE], ids=["second", "tide"])
def test_a_current_that_turns_is_carried_on(current):
    """Fixes for twenty minutes, then none for five: NEES, and against a current of first order."""
    vehicle, other = (vehicle_of(0.2, fixes_hz=0.1, **given) for given in ({"current": current}, {}))
    nees, end, first = [], [], []
    for seed in range(16):
        mission = simulate(vehicle, WAY, seed=seed, duration_s=1500.0, start=StartErrors(heading_sd_deg=2.0))
        hidden = mission.hide("gps", (1200.0, 1501.0))
        track = nf.replay(vehicle, hidden)
        errors = track.errors(mission.truth)
        nees.append([track.nees(errors)["position"][np.searchsorted(track.time_s, t)] for t in (1195.0, 1490.0)])
        end.append(errors.horizontal[-1])
        first.append(nf.replay(other, hidden).errors(mission.truth).horizontal[-1])
    # 48 squares: 0.55 to 1.6 holds 99.5 %
    assert np.all((np.mean(nees, axis=0) > 0.55) & (np.mean(nees, axis=0) < 1.6)), np.mean(nees, axis=0)
    assert np.median(end) < np.median(first)


def test_states_of_a_current_are_its_process():
    """The parameter is the sum of the parts: its variance, and how the filter's block repeats the model's own."""
    from navfilter.filter.state_layout import Layout

    vehicle = vehicle_of(current=TIDE, scale_sd=0.02)
    group, block = Layout.of(vehicle).drive, TIDE.block(1.0)
    at = [group.names.index(name) for name in group.names if name.startswith("velocity.current_north")]
    assert [group.names[i] for i in at] == ["velocity.current_north", *(f"velocity.current_north[{j}]" for j in (1, 2))]
    Phi, Q, P0 = (M[np.ix_(at, at)] for M in (group.Phi, group.Q, group.P0))
    np.testing.assert_allclose(Phi @ P0 @ Phi.T + Q, P0, atol=1e-15)
    for lag in (0, 1, 50, 700):
        own = (block.C @ np.linalg.matrix_power(block.Phi, lag) @ block.P0 @ block.C).item()
        assert (np.linalg.matrix_power(Phi, lag) @ P0)[0, 0] == pytest.approx(own, abs=1e-13)
    # north and east, and the scale behind them, know nothing of each other
    rest = [i for i in range(group.size) if i not in at]
    assert not group.Phi[np.ix_(at, rest)].any() and not group.P0[np.ix_(at, rest)].any()
    with pytest.raises(ValueError, match="one error model without white noise"):
        nf.WaterVelocity(current=nf.White(sd=0.1))


def test_a_glider_finds_its_speed_by_depth_and_pitch():
    """No velocity is measured: its stream is zero, off by all of the speed, which the depth gauge sees."""
    along, across = nf.GaussMarkov(sd=0.3, tau_s=120.0), nf.GaussMarkov(sd=0.01, tau_s=120.0)
    water = nf.WaterVelocity(error=(along, across, across), zero_is_invalid=False, current_sd_m_s=0.01)
    compass = nf.Heading(error=nf.White(sd=1.0 * DEG))
    drive = nf.DeadReckoning(rate_hz=1.0, attitude=compass, velocity=water, tilt=nf.White(sd=0.5 * DEG))
    sensors = {"depth": nf.Depth(rate_hz=0.2, error=nf.White(sd=0.1)), "gps": nf.Position(error=nf.White(sd=2.0))}
    vehicle = nf.Vehicle(drive, sensors)
    way = Motion((ChangeSpeed(0.35, 20.0), *(Dive(30.0, 26.0), Dive(5.0, 26.0)) * 6), latitude_deg=40.0)
    found = []
    for seed in range(8):
        mission = simulate(vehicle, way, seed=seed, duration_s=900.0).hide("gps", (60.0, 901.0))
        track = nf.replay(vehicle, mission)
        errors = track.errors(mission.truth)
        found.append([errors.horizontal[-1], track.nees(errors)["position"][-1]])
    # the speed is unknown to 0.3 m/s for two minutes, which would make 100 m; 24 squares: 0.4 to 1.9 holds 99.5 %
    assert np.median(found, axis=0)[0] < 30.0 and 0.4 < np.mean(found, axis=0)[1] < 1.9, found


def test_a_compass_that_is_silent_for_long():
    """At the surface a glider reads its compass seldom: that is no leap of a clock, and no reason not to begin."""
    vehicle = vehicle_of(0.2, fixes_hz=0.1)
    whole = simulate(vehicle, WAY, seed=2, duration_s=1500.0)
    speaks = {
        name: (abs(s.time_s - 25.0) > 20.0) & (abs(s.time_s - 650.0) > 350.0) for name, s in whole.streams.items()
    }
    speaks["gps"] = whole.streams["gps"].time_s > 9.0
    streams = {n: nf.Stream(s.time_s[speaks[n]], s.value[speaks[n]], s.columns) for n, s in whole.streams.items()}
    track = nf.replay(vehicle, replace(whole, streams=streams, start=None))
    assert track.counts["clock-set"] == 0 and track.counts["gap"] >= 1
    assert track.time_s[0] == 10.0 and track.time_s[-1] > 1490.0
    assert track.errors(whole.truth).horizontal[-1] < 10.0


def test_a_steady_current_is_found_and_is_no_constant():
    vehicle = vehicle_of()
    steady = {"velocity": Faults(current_m_s=(0.2, -0.1))}
    mission = simulate(vehicle, WAY, seed=3, duration_s=1200.0, faults=steady)
    track = nf.replay(vehicle, mission)
    for name, truth in (("velocity.current_north", 0.2), ("velocity.current_east", -0.1)):
        value, sd = track.state(name)
        assert sd[-1] < 0.1 and abs(value[-1] - truth) < 4.0 * sd[-1]
    assert not [c for c in constants(track) if "current" in c.name]


def test_live_is_the_replay_and_files_hold_it(tmp_path):
    vehicle = vehicle_of(scale_sd=(0.02, 0.0, 0.0))
    mission = simulate(vehicle, WAY, seed=5, duration_s=200.0)
    events = events_of(vehicle, mission)
    whole, half = nf.Navigator(vehicle, mission.start), nf.Navigator(vehicle, mission.start)
    one_by_one(whole, events)
    one_by_one(half, events[: len(events) // 2])
    half.snapshot(tmp_path / "state.nav")
    rest = nf.Navigator.restore(vehicle, tmp_path / "state.nav")
    one_by_one(rest, events[len(events) // 2 :])
    same_runs.assert_same_bits(whole, rest)
    assert nf.read_vehicle(write_vehicle(vehicle, tmp_path / "vehicle.toml")) == vehicle
    tidal = vehicle_of(current=TIDE)
    assert nf.read_vehicle(write_vehicle(tidal, tmp_path / "tidal.toml")) == tidal
