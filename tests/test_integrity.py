"""The bounds hold the truth under a single fault, and trust says why the state is not what it should be."""

import dataclasses
import json
import math

import faults_run as watched
import numpy as np
import pytest
from feeding import once_a_second
from test_agreement import DIVE_S, FAULT_S, RADIUS_M, altered, dive, fly, turned

import navfilter as nf
from navfilter.faults.protection_level import IN_LINE, IN_PLANE, bounds, trust, whole_offset
from navfilter.io import read_vehicle, write_vehicle
from navfilter.models.health import Trust
from navfilter.service.protocol import state_fields, to_line
from navfilter.simulation.scenarios import simulate_scenario, survey
from navfilter.simulation.simulate import Faults, simulate

P = np.diag([4.0, 4.0, 1.0, 1e-4, 1e-4, 1e-4, 1e-6, 1e-6, 1e-4])
FAULTS = {
    "none": ("dvl", lambda v: v),
    "compass turned": ("compass", turned),
    "compass 4 deg": ("compass", lambda h: h + math.radians(4.0)),
    "dvl scale": ("dvl", lambda v: 1.05 * v),
    "dvl follows water": ("dvl", lambda v: v + np.array([0.25, -0.17, 0.0])),
}


def test_noise_alone_is_exceeded_once_in_a_thousand():
    rng = np.random.default_rng(1)
    assert abs(np.mean(np.hypot(*rng.normal(size=(2, 400_000))) > IN_PLANE) - 1e-3) < 2e-4  # four sd of the count
    assert abs(np.mean(np.abs(rng.normal(size=400_000)) > IN_LINE) - 1e-3) < 2e-4
    turned_P = np.array([[5.0, 3.0], [3.0, 5.0]])
    tilted = P.copy()
    tilted[:2, :2] = turned_P
    assert bounds(tilted, 0.0, 0.0, {})[0] == pytest.approx(IN_PLANE * math.sqrt(8.0))


def test_a_fault_does_what_its_sensor_does():
    noise = IN_PLANE * 2.0
    assert bounds(P, 1.0, 0.0, {"velocity": 0.1, "heading": 0.05})[0] == pytest.approx(noise)
    assert bounds(P, 600.0, 500.0, {"velocity": 0.1})[0] == pytest.approx(noise + 60.0)
    assert bounds(P, 600.0, 500.0, {"heading": math.pi})[0] == pytest.approx(noise + 1000.0)
    # one fault at a time
    assert bounds(P, 600.0, 500.0, {"position": 90.0, "velocity": 0.1})[0] == pytest.approx(noise + 90.0)
    assert bounds(P, 1.0, 0.0, {"heading": 0.05})[1] == pytest.approx(0.05 + IN_LINE * 0.01)
    # a drive that has failed unseen leaves the compass, and that errs slowly by more than the state believes of itself
    assert bounds(P, 1.0, 0.0, {"heading": 0.05}, slow=0.03**2)[1] == pytest.approx(0.05 + IN_LINE * 0.03)
    assert bounds(P, 1.0, 0.0, {"heading": 0.05}, slow=0.001**2)[1] == pytest.approx(0.05 + IN_LINE * 0.01)
    assert bounds(P, 600.0, 500.0, {}, held=False)[0] == math.inf
    assert bounds(P, 1.0, 0.0, {}, held=False)[0] == pytest.approx(noise)
    many = bounds(np.stack([P, P]), np.array([1.0, 600.0]), np.array([0.0, 500.0]), {"velocity": np.array([0.1, 0.1])})
    np.testing.assert_allclose(many[0], [noise, noise + 60.0])
    assert whole_offset("position", np.array([3.0, 4.0, 90.0]), 0.0) == 5.0
    assert whole_offset("velocity", np.array([[0.1, -0.4, math.nan]]), 0.0) == [0.4]
    # beside it, what the slow error of the sensor that is refused makes of it
    assert whole_offset("position", np.array([3.0, 4.0, 90.0]), 9.0) == 5.0 + 3.0 * IN_PLANE


def test_trust_says_why():
    assert trust(P, 1.5, 0.1, (None, None), ()).level == "good"
    assert trust(P, 1.5, 0.1, (3.0, 0.5), ["dvl is silent"]) == Trust("degraded", ("dvl is silent",))
    fast = trust(P, 9.0, 2.0, (3.0, 0.5), ["dvl is silent"])
    assert fast.level == "lost" and len(fast.reasons) == 3 and "9 m/s" in fast.reasons[0] and "turn" in fast.reasons[1]
    wide = P.copy()
    wide[3, 3] = 4.0
    assert "velocity is only known to 2 m/s" in trust(wide, 1.0, 0.0, (None, None), ()).reasons[0]


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("mems", [False, True])
def test_the_truth_lies_within_the_bounds_under_a_single_fault(fault, mems):
    vehicle, mission = dive(mems)
    name, change = FAULTS[fault]
    broken = altered(mission, name, change, FAULT_S)
    nav = nf.Navigator(vehicle, mission.start)
    inside, said = [], set()
    for outcome in once_a_second(nav, vehicle, broken):
        error = outcome.minus(watched.truth_at(mission.truth, outcome.time_s))
        bound = outcome.bounds
        inside.append(math.hypot(*error[:2]) <= bound.horizontal_m and abs(error[8]) <= bound.heading_rad)
        said.add(outcome.trust.level)
    assert np.mean(inside) >= 0.999
    # and they are of use: a dive of two minutes
    assert nav.state.bounds.horizontal_m < 60.0 and math.degrees(nav.state.bounds.heading_rad) < 12.0
    if fault in ("compass turned",):
        assert nav.state.trust.level == "degraded" and nav.state.trust.reasons == ("compass is jumped",)


def test_a_start_that_is_off_is_held_from_the_first_fix_on():
    vehicle, mission = dive()
    start = mission.start
    north_deg = math.degrees(2000.0 / RADIUS_M)
    nav = nf.Navigator(vehicle, dataclasses.replace(start, latitude_deg=start.latitude_deg + north_deg))
    for state in once_a_second(nav, vehicle, mission):
        if state.time_s > 1.5:
            error = state.minus(watched.truth_at(mission.truth, state.time_s))
            assert math.hypot(*error[:2]) <= state.bounds.horizontal_m, state.time_s


def test_fixes_that_come_up_with_a_wrong_place_are_held():
    """The first half minute after a dive is 500 m off: the state follows, for nothing else says where it is."""
    vehicle, _ = dive()
    available = {"gps": Faults(available=((0.0, 40.0), (110.0, 1e9)))}
    mission = simulate(vehicle, survey(320.0), seed=4, duration_s=320.0, faults=available)
    north = np.array([500.0 / RADIUS_M, 0.0, 0.0])
    broken = altered(mission, "gps", lambda value: value + north[: value.shape[1]], 110.0, 140.0)
    nav = nf.Navigator(vehicle, mission.start)
    off = []
    for state in once_a_second(nav, vehicle, broken):
        error = math.hypot(*state.minus(watched.truth_at(mission.truth, state.time_s))[:2])
        assert error <= state.bounds.horizontal_m, state.time_s
        off.append(error)
    assert max(off) > 400.0 and nav.counts["reset"] == 2
    assert nav.state.bounds.horizontal_m < 30.0  # and the bounds are of use again
    track = nf.replay(vehicle, broken)
    error = track.errors(mission.truth).horizontal
    assert error.max() > 400.0 and (error <= track.to_frame().protection_radius_m).all()


def test_dead_reckoning_between_fixes_is_held_by_nothing():
    vehicle, mission = simulate_scenario("reckoning", 2, 200.0)
    frame = nf.replay(vehicle, mission).to_frame()
    assert np.isinf(frame.protection_radius_m).any() and np.isfinite(frame.protection_radius_m[:20]).all()


def test_the_track_has_the_bounds_that_the_run_gave_out():
    vehicle, mission = dive()
    nav, _ = fly(vehicle, mission, until_s=DIVE_S + 60.0)
    frame = nf.replay(vehicle, mission, output_rate_hz=None).to_frame()
    row = frame.iloc[np.argmin(np.abs(frame.time_s - nav.time_s))]
    assert row.protection_radius_m == pytest.approx(nav.state.bounds.horizontal_m, rel=1e-3)
    assert row.heading_bound_deg == pytest.approx(math.degrees(nav.state.bounds.heading_rad), rel=1e-3)
    assert "protection_radius_m" not in nf.replay(vehicle, mission, smooth=True, output_rate_hz=1.0).to_frame()


def test_the_state_line_tells_them(tmp_path):
    vehicle, mission = simulate_scenario("reckoning", 2, 60.0)
    fast = nf.Vehicle(nf.DeadReckoning(rate_hz=4.0, max_speed_m_s=0.2, max_turn_rad_s=0.5), vehicle.sensors)
    path = write_vehicle(fast, tmp_path / "vehicle.toml")
    assert read_vehicle(path) == fast
    path.write_text(path.read_text().replace("max_turn_rad_s = 0.5", "max_turn_deg_s = 90"))
    assert read_vehicle(path).drive.max_turn_rad_s == pytest.approx(0.5 * math.pi)
    with pytest.raises(ValueError, match="max_speed_m_s must be > 0"):
        nf.DeadReckoning(rate_hz=4.0, max_speed_m_s=-1.0)
    nav = nf.Navigator(fast, mission.start)
    for second in range(1, 40):
        nav.step(0.25 * second, (0.0, 0.0, 0.5), (1.5, 0.0, 0.0))
    line = json.loads(to_line(state_fields(nav.state)))
    assert line["trust"] == "lost" and "speed of 1.5 m/s" in line["reasons"][0]
    # nothing holds what drives against anything
    assert line["protection_radius_m"] is None and line["heading_bound_deg"] == 180.0
