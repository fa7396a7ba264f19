"""Replay as a user calls it: what comes back, what is refused, and what smoothing must leave alone."""

import dataclasses

import numpy as np
import pytest

import navfilter as nf
from navfilter.simulation.scenarios import simulate_scenario
from navfilter.simulation.simulate import tiny_missions


@pytest.fixture(scope="module")
def tiny():
    return [(v, m, nf.replay(v, m, smooth=True)) for v, m in tiny_missions()]


def test_every_tiny_mission_gives_finite_tracks(tiny):
    for _, mission, track in tiny:
        for t in (track, track.forward):
            frame = t.to_frame()
            assert np.isfinite(frame.to_numpy()).all()
            assert len(frame) == len(t) > 0
            assert (np.linalg.eigvalsh(t.covariance) > -1e-12 * np.trace(t.covariance, axis1=1, axis2=2)[:, None]).all()
        assert set(track.residuals) == set(track.vehicle.sensors)
        summary = track.summary(mission.truth)
        assert (
            summary["used"].keys()
            == summary["rejected"].keys()
            == summary["invalid"].keys()
            == track.vehicle.sensors.keys()
        )


def test_columns_of_the_frame_name_their_units(tiny):
    units = ("_s", "_m", "_deg", "_m_s", "_m2", "_deg_s", "_m_s2", "_1", "_deg_per_k", "_field")
    for _, _, track in tiny:
        assert all(column.endswith(units) for column in track.to_frame().columns)


def test_twice_the_same_bit_for_bit():
    vehicle, mission = simulate_scenario("lawnmower", 5, 60.0)
    one, two = nf.replay(vehicle, mission, smooth=True), nf.replay(vehicle, mission, smooth=True)
    assert one.to_frame().equals(two.to_frame())


def test_smoothed_constants_are_constant_even_where_a_gate_was_widened():
    vehicle, mission = simulate_scenario("lawnmower", 5, 240.0)
    sensors = dict(vehicle.sensors)
    sensors["dvl"] = dataclasses.replace(sensors["dvl"], scale_sd=0.01, misalignment_sd_rad=0.01)
    sensors["gps"] = dataclasses.replace(sensors["gps"], gate_timeout_s=2.0)
    gps = mission.streams["gps"]
    # half a minute of fixes that all lie 300 m off: first rejected, then let in by the widened gate
    off = gps.value.copy()
    off[(gps.time_s > 60) & (gps.time_s < 95), 0] += 300.0 / 6.37e6
    vehicle = nf.Vehicle(vehicle.drive, sensors)
    track = nf.replay(vehicle, mission.with_stream("gps", nf.Stream(gps.time_s, off, gps.columns)), smooth=True)
    assert track.counts["widened"] > 0
    for name in ("dvl.scale", "dvl.misalignment_z"):
        value, sd = track.state(name)
        # rounding of P - P L P where P has held both centimetres and hundreds of metres
        assert np.ptp(value) < 1e-4 * sd.max(), name
        assert np.ptp(sd) < 1e-4 * sd.max(), name


def test_readings_before_the_start_are_left_out_and_output_is_thinned():
    vehicle, mission = simulate_scenario("lawnmower", 5, 60.0)
    full, thin = (nf.replay(vehicle, mission, output_rate_hz=r) for r in (None, 1.0))
    assert len(full) > len(thin) >= 60
    at = np.searchsorted(full.time_s, thin.time_s)
    assert np.array_equal(full.latitude[at], thin.latitude)
    later = dataclasses.replace(mission.start, time_s=30.0)
    assert nf.replay(vehicle, mission, start=later).time_s[0] == 30.0


def test_missing_and_short_streams_are_said_in_one_line():
    vehicle, mission = simulate_scenario("lawnmower", 5, 30.0)
    without = dataclasses.replace(mission, streams={k: v for k, v in mission.streams.items() if k != "compass"})
    with pytest.raises(ValueError, match=r'"compass" has no stream in this mission \(streams: .*--without compass, or'):
        nf.replay(vehicle, without)
    empty = mission.with_stream("gps", nf.Stream(np.empty(0), np.empty((0, 3))))
    assert nf.replay(vehicle, empty).residuals["gps"].count("used") == 0
    with pytest.raises(ValueError, match="is empty"):
        nf.replay(vehicle, mission.with_stream("imu", nf.Stream(np.empty(0), np.empty((0, 6)))))
    with pytest.raises(ValueError, match="has 1 columns"):
        nf.replay(vehicle, mission.with_stream("dvl", nf.Stream([0.0], [1.0])))
    with pytest.raises(ValueError, match="before the start"):
        nf.replay(vehicle, mission, start=dataclasses.replace(mission.start, time_s=1e6))


def test_zero_velocity_holds_a_vehicle_that_stands():
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 120.0, 0.02)
    imu = np.column_stack(
        [rng.normal(scale=1e-4, size=(len(t), 3)), rng.normal(loc=(0.02, 0.0, -9.8062), scale=5e-3, size=(len(t), 3))]
    )
    start = nf.Start(latitude_deg=45.0, longitude_deg=5.0, heading_sd_deg=1.0, tilt_sd_deg=0.5, velocity_sd_m_s=0.01)
    drive = nf.Imu(
        rate_hz=50,
        gyro=nf.White(sd=2e-4) + nf.RandomWalk(density=1e-6, start_sd=1e-4),
        accel=nf.White(sd=5e-3) + nf.RandomWalk(1e-5, 0.02),
    )
    mission = nf.Mission("rest", {"imu": nf.Stream(t, imu)}, start=start)
    free = nf.replay(nf.Vehicle(imu=drive), mission)
    held = nf.replay(nf.Vehicle(imu=drive, sensors={"rest": nf.ZeroVelocity(rate_hz=1)}), mission)
    assert held.residuals["rest"].count("used") > 100
    # 0.02 m/s^2 of bias for two minutes is 144 m; two centimetres a second of zero velocity leave less than a metre
    assert np.linalg.norm(free.local()[-1]) > 20.0
    assert np.linalg.norm(held.local()[-1]) < 1.0
