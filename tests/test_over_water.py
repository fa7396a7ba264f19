"""Dead reckoning through water: the current between fixes, honest, also with one heading in five seconds."""

import numpy as np
import pytest
import same_runs
from feeding import events_of, one_by_one

import navfilter as nf
from navfilter.evaluation.constants import constants
from navfilter.io import write_vehicle
from navfilter.simulation.faults import Faults
from navfilter.simulation.manoeuvres import ChangeSpeed, Straight, Turn
from navfilter.simulation.motion import Motion
from navfilter.simulation.simulate import StartErrors, simulate

DEG = np.pi / 180.0
WAY = Motion(
    (ChangeSpeed(2.0, 20.0), *(Straight(220.0), Turn(80.0, 1.0), Straight(180.0), Turn(-110.0, 1.0)) * 4),
    latitude_deg=54.0,
)


def vehicle_of(rate_hz=1.0, **log):
    """A yacht: compass, log, leeway."""
    leeway = nf.GaussMarkov(sd=0.1, tau_s=300.0)
    velocity = nf.WaterVelocity(
        error=(nf.White(sd=0.1), leeway, nf.White(sd=0.05)), zero_is_invalid=False, current_sd_m_s=0.3, **log
    )
    compass = nf.Heading(error=nf.White(sd=1.0 * DEG), bias_sd_rad=2.0 * DEG)
    drive = nf.DeadReckoning(rate_hz=rate_hz, attitude=compass, velocity=velocity, tilt=nf.White(sd=0.5 * DEG))
    return nf.Vehicle(drive, {"gps": nf.Position(rate_hz=1.0, error=nf.White(sd=2.0))})


@pytest.mark.parametrize("rate_hz", [0.2, 1.0])
def test_the_current_carries_the_position_and_the_covariance_says_how_far(rate_hz):
    """Fixes for ten minutes, then none for five: NEES before, and at the end; against the same without a current."""
    vehicle = vehicle_of(rate_hz, scale_sd=0.02)
    blind = nf.BodyVelocity(error=vehicle.drive.velocity.error, zero_is_invalid=False)
    from dataclasses import replace

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
