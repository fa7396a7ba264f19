"""A velocity on a stretched clock is told by accelerations and by positions; none is where there is none."""

from dataclasses import replace

import numpy as np
import pytest

from navfilter.check import check_mission
from navfilter.models.mission import Mission, Stream
from navfilter.simulation.scenarios import simulate_scenario


def stretched(mission, name, scale):
    stream = mission.streams[name]
    return mission.with_stream(name, replace(stream, time_s=scale * stream.time_s))


def scales(mission, vehicle=None):
    """The proposed scale of each stream."""
    found = check_mission(mission, vehicle)
    return {f.stream: float(f.cure.split("time.scale = ")[1].split()[0]) for f in found if "time.scale = " in f.cure}


@pytest.mark.parametrize("scale", [1.0025, 0.9975])
@pytest.mark.parametrize("scenario", ["lawnmower", "transit"])
def test_accelerations_tell_the_clock_of_a_velocity(scenario, scale):
    vehicle, mission = simulate_scenario(scenario, 1, 600.0)
    mission = replace(mission, truth=None)
    assert scales(mission, vehicle) == {}
    assert scales(stretched(mission, "dvl", scale), vehicle) == pytest.approx({"dvl": 1.0 / scale}, abs=3e-4)


@pytest.mark.parametrize("scale", [1.0, 1.0025, 0.995])
def test_positions_tell_the_clock_of_a_velocity(scale):
    """A boat that speeds up and turns, with a compass and good fixes, and no inertial unit."""
    time_s = np.arange(0.0, 800.0, 0.5)
    heading = 1.2 * np.sin(time_s / 23.0) + 0.9 * np.sin(time_s / 61.0)
    speed = 2.0 + 0.8 * np.sin(time_s / 17.0)
    plane = np.cumsum(0.5 * speed * np.exp(1j * heading))
    noise = 0.3 * np.random.default_rng(4).standard_normal((2, time_s.size))
    fixes = np.column_stack([(plane.real + noise[0]) / 6.371e6, (plane.imag + noise[1]) / 6.371e6, 0.0 * time_s])
    streams = {
        "compass": Stream(time_s, heading[:, None], ("heading_rad",)),
        "gps": Stream(time_s, fixes, ("latitude_rad", "longitude_rad", "height_m")),
        "dvl": Stream(time_s, np.outer(speed, [1.0, 0.0, 0.0]), ("v_x_m_s", "v_y_m_s", "v_z_m_s")),
    }
    expected = {} if scale == 1.0 else {"dvl": 1.0 / scale}
    assert scales(stretched(Mission("x", streams), "dvl", scale)) == pytest.approx(expected, abs=3e-4)


@pytest.mark.parametrize("seed", [12, 15])
def test_a_current_is_no_clock_and_turns_no_velocity(seed):
    """Speeds through the water and over ground differ otherwise on each leg."""
    vehicle, mission = simulate_scenario("water-track", seed, 600.0)
    found = check_mission(replace(mission, truth=None), vehicle)
    assert [f.text for f in found if f.severity != "info" and f.stream == "water"] == []
