"""All sensors at once send rubbish for a while: the state stays finite, and finds its way back."""

import math
import warnings

import faults_run as watched
import numpy as np
import pytest
from feeding import DRIVE, events_of

import navfilter as nf
from navfilter.models.sensors.sensor import LARGEST
from navfilter.simulation.scenarios import simulate_scenario

BAD = ((60.0, 90.0), (150.0, 190.0))
NUMBERS = (1e10, -1e6, 1e3, 40.0, 0.0, -3.0)


@pytest.fixture(scope="module")
def dive():
    return simulate_scenario("lawnmower", 3, 320.0)


def rubbish(value, rng):
    """No number, a text, too many, too large, nothing, or numbers of any size."""
    numbers = rng.choice(NUMBERS, len(value)).tolist()
    return (math.nan, "x", [1.0] * 9, [1e300] * len(value), None, numbers)[int(rng.integers(6))]


@pytest.mark.parametrize("seed", [1, 3, 4, 5, 6, 8])
def test_the_state_stays_finite_and_bounded_and_finds_its_way_back(dive, seed):
    """A fix on the other side of the Earth opened the second filter's position by as much, beyond what doubles bear."""
    vehicle, mission = dive
    nav, rng = nf.Navigator(vehicle, mission.start), np.random.default_rng(seed)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for event in events_of(vehicle, mission):
            if event.sensor == DRIVE:
                nav.step(event.time_s, event.value[:3], event.value[3:])
            else:
                bad = any(begin <= event.time_s < end for begin, end in BAD)
                nav.correct(event.sensor, event.time_s, rubbish(event.value, rng) if bad else event.value)
                assert np.isfinite(nav.filter.P).all()
    state = nav.state
    error = state.minus(watched.truth_at(mission.truth, state.time_s))
    off = math.hypot(*error[:2])
    # no further off than it has gone meanwhile, at 1.5 m/s
    assert off < min(60.0, state.bounds.horizontal_m) and abs(error[8]) < state.bounds.heading_rad
    assert off < 3.0 * math.hypot(*state.sd[:2]) and np.abs(error[3:6]).max() < max(0.1, 3.0 * state.sd[3:6].min())


@pytest.mark.parametrize(("name", "value"), [("gps", [0.7, 0.1, 1e300]), ("depth", [1e300]), ("compass", [1e300])])
def test_numbers_beyond_any_measurement_are_no_readings(dive, name, value):
    vehicle, mission = dive
    nav = nf.Navigator(vehicle, mission.start)
    nav.step(mission.start.time_s + 0.01, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8))
    assert nav.correct(name, mission.start.time_s + 0.01, value).status == "invalid"
    _, good = vehicle.sensors[name].read_all(np.array([value]))
    assert not good.any()
    assert vehicle.sensors["depth"].read(np.array([0.9 * LARGEST])) is not None


def test_a_component_beyond_any_measurement_is_missing():
    z = nf.Attitude(rate_hz=1.0).read(np.array([0.1, 1e300, 0.2]))
    np.testing.assert_array_equal(z, [0.1, np.nan, 0.2])
