"""The dives of snapir-auv-1hz with their own inertial unit, for `gaps.py`: 100 Hz, DVL and depth at 1 Hz.

The time base is the one that the README of the recordings has found: rows a second apart, each dive with its offset.
The vehicle is described as a careful user would by data sheets and that README.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from car_clocks import read_text
from harness import data_root

import navfilter as nf
from navfilter.models.mission import Mission
from navfilter.models.vehicle import Vehicle

#: When the inertial unit of each dive begins, on the truth's clock [s]; the DVL begins a second later.
UNIT_S = {"1": 0.42, "2": 0.46, "3": 0.47, "5": -0.49, "6": -0.43, "7": 0.44, "8": 0.42, "10": 0.46, "12": -0.47}
DVL_LATER_S = 1.0

VEHICLE = """
name = "AUV with inertial unit, DVL and depth"

[drive]
type = "imu"
rate_hz = 100
gyro = [
  {model = "white", sd_deg_per_s = 0.01},
  {model = "random-walk", density_deg_per_s = 3e-6, start_sd_deg_per_s = 0.002},
]
accel = [{model = "white", sd = 0.02}, {model = "random-walk", density = 1e-5, start_sd = 0.005}]

[sensors.dvl]
type = "body-velocity"
rate_hz = 1
lever_arm_b_m = [0.0, 0.0, 0.2]
lever_arm_sd_m = [0.2, 0.1, 0.2]
error = [{model = "gauss-markov", sd = 0.01, tau_s = 2}, {model = "gauss-markov", sd = 0.003, tau_s = 200}]
time_offset_sd_s = 0.1
scale_sd = 0.01
misalignment_sd_deg = 1.0

[sensors.depth]
type = "depth"
rate_hz = 1
error = {model = "white", sd = 0.1}

[sensors.usbl]
type = "position"
rate_hz = 1
lever_arm_b_m = [1.76, 0.0, 0.0]
error = {model = "white", sd = 0.3}
"""

MISSION = """
name = "dive {dive}"
date = 2022-06-08

[streams.imu]
file = "{folder}/IMU_trajectory{dive}.csv.xz"
time = {{rate_hz = 100, start_s = {unit_s}}}
rate = {{columns = ["GYRO X [rad/s]", "GYRO Y [rad/s]", "GYRO Z [rad/s]"], unit = "rad/s", axes = "x,-y,z"}}
force = {{columns = ["ACC X [m/s^2]", "ACC Y [m/s^2]", "ACC Z [m/s^2]"], unit = "m/s^2", axes = "x,-y,z"}}

[streams.dvl]
file = "{folder}/DVL_trajectory{dive}.csv"
time = {{rate_hz = 1, start_s = {dvl_s}}}
velocity = {{columns = ["DVL X [m/s]", "DVL Y [m/s]", "DVL Z [m/s]"], unit = "m/s"}}

[streams.depth]
{truth}
depth = {{column = "Altitude [m]", unit = "m", scale = -1}}

[streams.usbl]
{truth}
position = {{columns = ["Latitude [rad]", "Longitude [rad]", "Altitude [m]"], unit = ["rad", "rad", "m"]}}

[truth]
{truth}
lever_arm_b_m = [1.76, 0.0, 0.0]
position = {{columns = ["Latitude [rad]", "Longitude [rad]", "Altitude [m]"], unit = ["rad", "rad", "m"]}}
velocity_n = {{columns = ["V North [m/s]", "V East [m/s]", "V Down [m/s]"], unit = "m/s"}}
attitude = {{columns = ["Roll [rad]", "Pitch [rad]", "Yaw [rad]"], unit = "rad"}}
"""


@cache
def dive(number: str) -> tuple[Mission, Vehicle]:
    """A dive and its vehicle. It begins where the truth says: some begin in a turn, where nothing can be aligned."""
    folder, unit_s = data_root() / "snapir-auv-1hz", UNIT_S[number]
    truth = f'file = "{folder}/GT_trajectory{number}.csv"\ntime = {{rate_hz = 1}}'
    text = MISSION.format(dive=number, folder=folder, unit_s=unit_s, dvl_s=unit_s + DVL_LATER_S, truth=truth)
    mission, vehicle = read_text(text, VEHICLE)
    assert mission.truth is not None
    t, value = mission.truth.time_s, mission.truth.value
    row = int(np.searchsorted(t, max(mission.streams["imu"].time_s[0], t[0]) + 0.01))
    latitude, longitude, height, *rest = map(float, value[row])
    start = nf.Start(
        time_s=float(t[row]),
        latitude_deg=math.degrees(latitude),
        longitude_deg=math.degrees(longitude),
        height_m=height,
        velocity_n=(rest[0], rest[1], rest[2]),
        roll_deg=math.degrees(rest[3]),
        pitch_deg=math.degrees(rest[4]),
        heading_deg=math.degrees(rest[5]),
        position_sd_m=0.3,
        velocity_sd_m_s=0.1,
        tilt_sd_deg=0.1,
        heading_sd_deg=0.1,
    )
    return mission.with_start(start), vehicle
