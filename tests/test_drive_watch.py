"""The watch over the axes of an inertial unit: what it finds in its samples, when, and what the filter makes of it."""

import math
from dataclasses import replace

import naive
import numpy as np
import pytest
from kernel_inputs import assert_close, random_nav

import navfilter as nf
from navfilter.faults.imu.monitor import CONDITIONS, ImuMonitor
from navfilter.kernels import imu_checks as kernel
from navfilter.simulation.presets import mems_imu, tactical_imu
from navfilter.simulation.scenarios import lawnmower, simulate_scenario
from navfilter.simulation.simulate import simulate

LEVEL = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -9.81])
DEG = math.pi / 180.0


def quiet(drive, seconds, seed=1, step=None):
    """Samples of a unit at rest, with the noise of its description; rounded to a step, if one is given."""
    n = round(seconds * drive.rate_hz)
    sd = np.sqrt([model.block(drive.period_s).r for model in drive.models])
    values = LEVEL + sd * np.random.default_rng(seed).normal(size=(n, 6))
    if step is not None:
        values = np.round(values / (step * sd)) * (step * sd)
    return np.column_stack([np.full(n, drive.period_s), values * (drive.period_s if drive.increments else 1.0)])


def watched(drive, samples, w=None):
    """Times [s] at which conditions changed, and what they changed to."""
    watch = ImuMonitor(drive)
    w = watch.initial_memory() if w is None else w
    nav = nf.Start(latitude_deg=45.0, longitude_deg=-4.0).state.pack()
    watch.refer(w, nav, np.zeros((9, 9)))
    sd = np.sqrt([model.block(drive.period_s).r for model in drive.models])
    found, at, before = [], 0, watch.conditions(w)
    while at < len(samples):
        at += watch.check_samples(samples[at:], w, sd)
        if w[kernel.UNIT, kernel.TICK] * drive.period_s >= kernel.JUDGED_S:
            w[kernel.UNIT, kernel.TICK] = 0.0
            watch.refer(w, nav, np.zeros((9, 9)))
        now = watch.conditions(w)
        found += [(at * drive.period_s, name, now[name]) for name in now if now[name] != before[name]]
        before = now
    return found, w


def rates(drive):
    return drive.period_s if drive.increments else 1.0


def freeze(v):
    v[:, :3] = v[0, :3]


def dead(v):
    v[:, 2] = 0.0


def noisy(v):
    sd = np.std(v[:, 3])
    v[:, 3] += 10.0 * sd * np.random.default_rng(2).normal(size=len(v))


def degrees(v):
    v[:, :3] /= DEG


def in_g(v):
    v[:, 3:] /= 9.80665


def swapped(v):
    v[:, 3:] = v[:, [5, 4, 3]]


def nothing(v):
    v[:] = 0.0


FAULTS = [
    (freeze, {"gyro_x": "stuck", "gyro_y": "stuck", "gyro_z": "stuck"}),
    (dead, {"gyro_z": "dead"}),
    (noisy, {"accel_x": "noisy"}),
    (degrees, {"gyro_x": "wrong-unit", "gyro_y": "wrong-unit", "gyro_z": "wrong-unit"}),
    (in_g, {"accel_x": "wrong-unit", "accel_y": "wrong-unit", "accel_z": "wrong-unit"}),
    (swapped, {"accel_x": "swapped", "accel_y": "swapped", "accel_z": "swapped"}),
    (nothing, dict.fromkeys(("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"), "dead")),
]


@pytest.mark.parametrize("increments", [False, True])
@pytest.mark.parametrize(("fault", "expected"), FAULTS, ids=[fault.__name__ for fault, _ in FAULTS])
def test_a_fault_is_found_named_and_ends(fault, expected, increments):
    drive = tactical_imu(increments=increments)
    samples = quiet(drive, 60.0)
    fault(samples[3000:4500, 1:])
    found, _ = watched(drive, samples)
    # named within five seconds (a noise must be measured before it can be called degrees), good again two after the end
    named = {}
    for time_s, name, condition in found:
        assert 30.0 < time_s < 35.0 or 45.0 < time_s < 50.0, (time_s, name, condition)
        if time_s < 35.0:
            named[name] = condition
    assert named == expected
    assert {name: condition for _, name, condition in found} == dict.fromkeys(expected, "good")


@pytest.mark.parametrize("step", [None, 0.5, 2.0, 8.0, 40.0])
@pytest.mark.parametrize("drive", [tactical_imu(), mems_imu(), mems_imu(increments=True)])
def test_a_healthy_unit_is_left_alone_however_coarse_its_steps(drive, step):
    """Steps of 8 standard deviations repeat one value for minutes at rest, and are no fault."""
    samples = quiet(drive, 300.0, seed=3, step=step)
    before = samples.copy()
    found, w = watched(drive, samples)
    assert found == [] and w[:6, kernel.SPIKES].sum() == 0
    np.testing.assert_array_equal(samples, before)


def test_an_axis_that_has_never_shown_its_noise_is_not_judged():
    drive = tactical_imu()
    samples = quiet(drive, 30.0)
    samples[:, 1:] = LEVEL
    assert watched(drive, samples)[0] == []


def test_noise_that_stays_becomes_usual():
    drive = tactical_imu()
    samples = quiet(drive, 300.0)
    noisy(samples[3000:, 1:])
    found, _ = watched(drive, samples)
    assert [condition for _, _, condition in found] == ["noisy", "good"]
    assert 60.0 < found[1][0] < 240.0


def test_values_at_the_end_of_the_range_are_saturated():
    drive = nf.Imu(rate_hz=100.0, max_rate=5.0)
    samples = quiet(drive, 20.0)
    samples[1500:1510, 3] = 4.9999
    found, _ = watched(drive, samples)
    assert found[0][1:] == ("gyro_z", "saturated") and 15.0 < found[0][0] < 15.05


def test_a_single_sample_is_a_spike_and_no_condition():
    drive = tactical_imu()
    samples = quiet(drive, 30.0)
    samples[2000, 3] += 2.0
    found, w = watched(drive, samples)
    assert found == [] and w[2, kernel.SPIKES] == 1.0
    assert abs(w[2, kernel.SIZE] - 2.0) < 0.05


COLOURED = {
    "swing": nf.Arma(ar=(-1.2, 0.9), ma=(0.3,), sd=0.01),
    "quick": nf.GaussMarkov(sd=0.02, tau_s=0.05),
    "walk": nf.RandomWalk(density=1e-7, start_sd=1e-5) + nf.Arma(ar=(-0.9,), sd=0.01),
    "both": nf.GaussMarkov(sd=0.005, tau_s=10.0) + nf.Arma(ar=(-0.5,), sd=0.003) + nf.White(sd=0.002),
}


@pytest.mark.parametrize("name", COLOURED)
def test_an_axis_without_white_noise_of_its_own_is_no_spike_at_each_sample(name):
    """All of its noise is in error states: its samples differ as much all the same."""
    drive = nf.Imu(rate_hz=50.0, gyro=COLOURED[name], accel=COLOURED[name])
    vehicle = nf.Vehicle(drive, {"depth": nf.Depth(rate_hz=1.0, error=nf.White(sd=0.05))})
    mission = simulate(vehicle, lawnmower(120.0), seed=1, duration_s=120.0)
    nav = nf.Navigator(vehicle, mission.start)
    values = mission.streams["imu"].value
    # 6000 samples, coloured: their second differences are known to some percent; slow turns hardly add to them
    measured = np.sqrt(np.mean(np.diff(values[:, :3], 2, axis=0) ** 2, axis=0) / 6.0)
    np.testing.assert_allclose(nav.filter.drive_sd[:3], measured, rtol=0.08)
    assert nf.replay(vehicle, mission).counts["spike"] == 0
    values[3000, 1] += 40.0 * measured[1]
    spiked = replace(mission, streams={**mission.streams, "imu": replace(mission.streams["imu"], value=values)})
    assert nf.replay(vehicle, spiked).counts["spike"] == 1


@pytest.mark.parametrize("slow", [nf.RandomWalk(density=1e-7, start_sd=1e-5), nf.GaussMarkov(sd=1e-5, tau_s=600.0)])
def test_of_slow_errors_alone_nothing_is_expected(slow):
    """How the vehicle moves is more than they change from one sample to the next."""
    vehicle = nf.Vehicle(nf.Imu(rate_hz=50.0, gyro=slow, accel=slow), {"depth": nf.Depth(error=nf.White(sd=0.05))})
    mission = simulate(vehicle, lawnmower(240.0), seed=1, duration_s=240.0)
    track = nf.replay(vehicle, mission)
    assert not np.array([track.counts[name] for name in ("spike", "noisy", "erratic", "wrong-unit")]).any()


def test_of_a_unit_without_any_error_described_noise_and_spikes_are_not_judged():
    """A simulation without errors: what differs from one sample to the next is how the vehicle moves."""
    drive = tactical_imu()
    samples = quiet(drive, 30.0)
    samples[:1200, 1:] = LEVEL
    samples[2000, 3] += 2.0
    watch, w = ImuMonitor(drive), ImuMonitor(drive).initial_memory()
    watch.refer(w, nf.Start(latitude_deg=45.0, longitude_deg=-4.0).state.pack(), np.zeros((9, 9)))
    at = 0
    while at < len(samples):
        at += watch.check_samples(samples[at:], w, np.zeros(6))
        w[kernel.UNIT, kernel.TICK] = 0.0
    assert not w[:6, [kernel.SPIKES, kernel.CODE]].any()


@pytest.mark.parametrize("described", [True, False])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("increments", [False, True])
def test_the_kernel_and_its_twin(seed, increments, described):
    rng = np.random.default_rng(seed)
    drive = tactical_imu(increments=increments)
    w = ImuMonitor(drive).initial_memory()
    ImuMonitor(drive).refer(w, random_nav(rng), np.zeros((9, 9)))
    twin, sd = w.copy(), np.sqrt([model.block(drive.period_s).r for model in drive.models]) * described
    samples = quiet(drive, 30.0, seed, 0.7 if seed % 2 else None)
    w[kernel.UNIT, kernel.REFERENCE : kernel.REFERENCE + 3] = twin[6, 5:8] = LEVEL[3:]
    samples[:, 0] += rng.uniform(-0.003, 0.003, len(samples))
    samples[rng.integers(len(samples), size=5), 0] = 0.1
    for fault, _ in FAULTS:
        begin = rng.integers(1200, 2700)
        fault(samples[begin : begin + 100, 1:])
    samples[rng.integers(len(samples), size=20), 1 + rng.integers(6)] += rates(drive)
    ours, twins, limits = samples.copy(), samples.copy(), np.repeat([0.5, 90.0], 3)
    alone, one_by_one = w.copy(), samples.copy()
    at, conditions = 0, set()
    while at < len(samples):
        args = sd, limits, drive.period_s, increments
        n = kernel.check_samples(ours[at:], w, *args)
        assert n == naive.check_samples(twins[at:], twin, *args)
        for k in range(at, at + n):  # all axes at once, or one after the other, is the same to the bit
            assert kernel.check_samples(one_by_one[k : k + 1], alone, *args) == 1
        np.testing.assert_array_equal(w, alone)
        at += n
        assert_close(w[np.isfinite(w)][None], twin[np.isfinite(twin)][None], 1e-12)
        for a in (w, twin, alone):
            a[kernel.UNIT, kernel.TICK] *= a[kernel.UNIT, kernel.TICK] * drive.period_s < kernel.JUDGED_S
        conditions |= set(w[:6, kernel.CODE].tolist())
    np.testing.assert_allclose(ours, twins, rtol=0, atol=1e-12)
    assert len(conditions) > (3 if described else 2)


def faulty(mission, change, begin_s, end_s):
    """The mission with other values of its inertial unit in an interval."""
    stream = mission.streams["imu"]
    value = stream.value.copy()
    inside = (stream.time_s >= begin_s) & (stream.time_s < end_s)
    change(part := value[inside])
    value[inside] = part
    return mission.with_stream("imu", nf.Stream(stream.time_s, value))


@pytest.fixture(scope="module")
def dive():
    return simulate_scenario("lawnmower", 2, 150.0)


def test_blocks_and_single_samples_give_the_same(dive):
    """A condition that changes within a block changes there."""
    vehicle, mission = dive
    mission = faulty(mission, freeze, 60.0, 80.0)
    times, values = mission.streams["imu"].time_s, mission.streams["imu"].value
    navs = [nf.Navigator(vehicle, mission.start) for _ in range(3)]
    rows = np.column_stack([times, values])[times <= 100.0]
    for nav, size in zip(navs, (1, 37, 2000), strict=True):
        for begin in range(0, len(rows), size):
            nav.step_samples(rows[begin : begin + size].copy())
    for nav in navs:
        assert nav.counts["stuck"] == 3
        np.testing.assert_array_equal(nav.state.covariance, navs[0].state.covariance)
        np.testing.assert_array_equal(nav.filter.nav, navs[0].filter.nav)


@pytest.mark.parametrize("fault", [freeze, nothing, in_g, swapped, dead])
def test_the_position_outlives_it(dive, fault):
    """Compass and DVL carry the vehicle on: no worse than without an inertial unit, and honest."""
    vehicle, mission = dive
    clean, track = (nf.replay(vehicle, m) for m in (mission, faulty(mission, fault, 60.0, 90.0)))
    apart = np.hypot(*(6.37e6 * (getattr(track, x) - getattr(clean, x)) for x in ("latitude", "longitude")))
    # 30 s of 1.5 m/s with a heading of 0.7 deg, and a second or two of growing doubt
    assert apart.max() < 3.0
    summary = track.summary(mission.truth)
    assert summary["nees_position"] < 4.0


def test_conditions_are_in_the_health(dive):
    vehicle, mission = dive
    mission = faulty(mission, dead, 60.0, 200.0)
    nav = nf.Navigator(vehicle, mission.start)
    stream = mission.streams["imu"]
    nav.step(stream.time_s[:6900], stream.value[:6900, :3], stream.value[:6900, 3:])
    assert nav.health.axes["gyro_z"] == "dead" and nav.health.axes["gyro_x"] == "good"
    assert nav.health.degraded[-1] == "gyro_z" and nav.counts["dead"] == 1
    again = nf.Navigator.restore(vehicle, nav.snapshot())
    assert again.health.axes == nav.health.axes
    for one in (nav, again):
        one.step(stream.time_s[6900:7000], stream.value[6900:7000, :3], stream.value[6900:7000, 3:])
    np.testing.assert_array_equal(nav.state.covariance, again.state.covariance)
    nav.step(stream.time_s[7000:], stream.value[7000:, :3] + 1e-5, stream.value[7000:, 3:])
    assert set(CONDITIONS) > set(nav.health.axes.values())


def test_without_an_inertial_unit_its_two_parts_are_looked_at_and_no_axis_is_watched():
    vehicle, mission = simulate_scenario("reckoning", 1, 20.0)
    nav = nf.Navigator(vehicle, mission.start)
    assert nav.health.axes == {"attitude": "good", "velocity": "good"} and nav.filter.memory.monitor.imu.shape == (
        0,
        kernel.COLUMNS,
    )
