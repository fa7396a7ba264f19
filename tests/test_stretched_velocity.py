"""Stretched clocks of a velocity and of positions are told; none is where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from navfilter.check import check_mission
from navfilter.check.shared_motion import felt_clock
from navfilter.io import read_mission
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


def turning_dive(seed, rate=1.0):
    """Ten minutes of diving and turning, with a good inertial unit and a DVL of 1 Hz that errs by 2 mm/s; an attitude
    of tens of degrees, so that no small angles help.
    """
    rng, step_s = np.random.default_rng(seed), 0.02
    time_s = np.arange(0.0, 600.0, step_s)
    yaw = 1.1 * np.sin(time_s / 20.0 + seed) + 0.5 * np.sin(time_s / 7.0)
    pitch, roll = 0.4 * np.sin(time_s / 19.0), 0.3 * np.sin(time_s / 5.0)
    turned = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]))
    speed = 1.8 + 0.5 * np.sin(time_s / 13.0)
    velocity_b = np.column_stack([speed, 0.1 * np.sin(time_s / 13.0), 0.05 * np.cos(time_s / 9.0)])
    velocity_n = turned.apply(velocity_b)
    force = turned.inv().apply(np.gradient(velocity_n, step_s, axis=0) - [0.0, 0.0, 9.81])
    spin = (turned[:-1].inv() * turned[1:]).as_rotvec() / step_s
    rates = 0.5 * (np.vstack([spin, spin[-1:]]) + np.vstack([spin[:1], spin]))  # at the samples, not between
    noise = rng.standard_normal((2, time_s.size, 3))
    imu = np.hstack([rates + 1e-4 * noise[0] + 2e-5, force + 5e-3 * noise[1] + 0.01])
    at = np.arange(5.0, 595.0, 1.0)
    dvl = np.column_stack([np.interp(at, time_s, column) for column in velocity_b.T])
    rows = np.column_stack([np.interp(at, time_s, column) for column in np.cumsum(velocity_n, axis=0).T]) * step_s
    fixes = rows[:, :2] / 6.371e6 + 1e-3 / 6.371e6 * rng.standard_normal((at.size, 2))
    columns = ("latitude_rad", "longitude_rad", "height_m")
    streams = {
        "imu": Stream(time_s, imu, IMU),
        "dvl": Stream(rate * at, dvl + 0.002 * rng.standard_normal(dvl.shape), ("v_x_m_s", "v_y_m_s", "v_z_m_s")),
        "compass": Stream(at, np.interp(at, time_s, yaw), ("heading_rad",)),
        "gps": Stream(at, np.column_stack([fixes, -rows[:, 2]]), columns),
    }
    return Mission("dive", streams)


IMU = tuple(f"{what}_{axis}_{unit}" for what, unit in (("rate", "rad_s"), ("force", "m_s2")) for axis in "xyz")


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("rate", [1.0, 1.0025])
def test_a_velocity_of_a_vehicle_that_dives_and_turns(seed, rate):
    mission = turning_dive(seed, rate)
    expected = {} if rate == 1.0 else {"dvl": 1.0 / rate}
    assert scales(mission) == pytest.approx(expected, abs=3e-4)
    stream = mission.streams["dvl"]
    fit = felt_clock(mission.streams["imu"], stream.time_s, stream.value, np.zeros(3))
    assert abs(fit.rate - (rate - 1.0)) < 4.0 * fit.rate_sd < 1e-3


@pytest.mark.parametrize("scale", [1.0025, 0.9975])
@pytest.mark.parametrize("with_unit", [True, False])
def test_fixes_on_a_stretched_clock(scale, with_unit):
    """Heading and velocity agree, and the positions lie otherwise than both."""
    mission = stretched(turning_dive(3), "gps", scale)
    if not with_unit:
        mission = mission.without_stream("imu")
    assert scales(mission) == pytest.approx({"gps": 1.0 / scale}, abs=4e-4)


def test_real_dives(recording):
    """Positions of a dive at sea, stretched as its logger stretched all its rows."""
    mission = read_mission(recording("snapir-auv-1hz/08"))
    plain = replace(mission, truth=None)
    assert scales(plain) == {}
    assert "usbl" in scales(stretched(plain, "usbl", 1.003))
