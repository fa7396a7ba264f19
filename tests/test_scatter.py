"""A sensor that scatters by more than its error model says is weighed by what it scatters."""

import math
from dataclasses import replace

import naive
import numpy as np
import pytest
from kernel_inputs import assert_close, random_nav, run_both, spd
from state_differences import differences
from test_agreement import FAULT_S, altered, dive, feed, fly

import navfilter as nf
from navfilter.faults import noise_scale as scatter
from navfilter.faults import sensor_bias
from navfilter.faults.noise_scale import NoiseScale
from navfilter.foundation.state_values import copied
from navfilter.kernels import noise_scale
from navfilter.models.fault_bias import with_offsets
from navfilter.navigation import runner
from navfilter.simulation.presets import mems_imu, tactical_imu
from navfilter.simulation.scenarios import lawnmower, scaled, stage
from navfilter.simulation.simulate import Faults, draw_error, simulate

DEG, RADIUS_M = math.pi / 180.0, 6.37e6
NOISE_S, MINUTE_S = FAULT_S + 10.0, 60.0


def noise(sd):
    return lambda value: value + np.random.default_rng(1).normal(size=value.shape) * sd


def judged(vehicle, mission):
    """The replayed track from the fault on: horizontal error, its sd, NEES of the velocity; what became of readings."""
    track = nf.replay(vehicle, mission, output_rate_hz=1.0)
    late, errors = track.time_s > NOISE_S, track.errors(mission.truth)
    sd = np.sqrt(track.covariance[late, 0, 0] + track.covariance[late, 1, 1])
    return errors.horizontal[late], sd, np.nanmean(track.nees(errors)["velocity"][late]), track


@pytest.mark.parametrize(("name", "sd"), [("dvl", 0.1), ("dvl", 1.0), ("compass", 6.0 * DEG), ("depth", 0.5)])
def test_a_noisy_sensor_is_weighed_by_its_noise_and_leads_nobody_off(name, sd):
    vehicle, mission = dive()
    off, known, nees, track = judged(vehicle, altered(mission, name, noise(sd), NOISE_S))
    readings = track.residuals[name]
    after = readings.time_s > NOISE_S + 20.0 / vehicle.sensors[name].rate_hz
    assert np.nanmax(off / known) < 3.0 and nees < 2.0
    assert np.mean(readings.used[after]) > 0.95
    # its NIS is that of the description, so that it is told
    assert np.median(readings.nis[after] / readings.dof[after]) > 3.0
    assert not track.counts["jumped"] and not track.counts["widened"]
    # a velocity that errs by 1 m/s is hardly one: the inertial unit goes alone
    whole, *_ = judged(vehicle, mission)
    assert np.nanmax(off) < 1.5 * np.nanmax(whole) + 5.0 * sd * (name == "dvl")


def test_it_is_told_ends_with_the_noise_and_stretches_lives_and_snapshots_give_the_same(monkeypatch):
    vehicle, mission = dive()
    mission = mission.between(0.0, NOISE_S + 60.0)
    noisy = altered(mission, "dvl", noise(0.1), NOISE_S, NOISE_S + 20.0)
    whole, _ = fly(vehicle, noisy)
    assert whole.filter.memory.monitor.channels["dvl"].scatter is None
    track = nf.replay(vehicle, noisy, output_rate_hz=None)
    np.testing.assert_array_equal(track.velocity_n[-1], whole.state.velocity_n)
    monkeypatch.setattr(runner.BatchRunner, "possible", property(lambda self: False))
    np.testing.assert_array_equal(nf.replay(vehicle, noisy).covariance[-1], track.covariance[-1])
    half, _ = fly(vehicle, noisy, until_s=NOISE_S + 10.0)
    assert half.filter.memory.monitor.channels["dvl"].scatter.excess.any()
    assert half.health.sensors["dvl"].condition == "noisy" and "dvl is noisy" in half.health.trust.reasons
    again = nf.Navigator.restore(vehicle, half.snapshot())
    feed(again, vehicle, noisy, after_s=NOISE_S + 10.0)
    assert not differences(whole.filter.memory, again.filter.memory)


def test_what_is_kept_of_noise_is_refused_where_a_kernel_could_not_go_by_it():
    """A snapshot may have been changed outside."""
    vehicle, mission = dive()
    nav, _ = fly(vehicle, altered(mission, "dvl", noise(0.1), NOISE_S), until_s=NOISE_S + 10.0)
    memory = nav.memory
    for change in (
        (noise_scale.COUNT, 1e9),
        (noise_scale.COUNT, math.nan),
        (noise_scale.NEXT, -1.0),
        (noise_scale.NEXT, 48.0),
    ):
        other = copied(memory)
        noted = other.filter.monitor.channels["dvl"].scatter.noted.copy()
        noted[change[0]] = change[1]
        other.filter.monitor.channels["dvl"].scatter = NoiseScale(noted)
        with pytest.raises(ValueError, match="the noise of dvl"):
            nav.resume(other)
    other = copied(memory)
    other.filter.monitor.channels["dvl"].scatter = NoiseScale(memory.filter.monitor.channels["dvl"].scatter.noted[:-1])
    with pytest.raises(ValueError, match="the noise of dvl"):
        nav.resume(other)


def test_a_velocity_in_another_unit_for_a_minute_is_as_good_as_none():
    vehicle, mission = dive()
    off, known, *_ = judged(vehicle, altered(mission, "dvl", lambda v: 1e3 * v, NOISE_S, NOISE_S + MINUTE_S))
    gone, *_ = judged(vehicle, altered(mission, "dvl", lambda v: v * np.nan, NOISE_S, NOISE_S + MINUTE_S))
    assert np.nanmax(off) < 1.2 * np.nanmax(gone) + 1.0 and np.nanmax(off / known) < 3.5


def beyond(bends, white, slack=0.0):
    """By axis; empty where it is none in any."""
    rows = np.zeros((noise_scale.MOST, 2 * len(white)))
    rows[: len(bends)] = np.column_stack([bends, np.full_like(bends, slack)])
    at, work = (len(bends), len(bends) - 1), np.zeros(3 * noise_scale.MOST)
    excess = [noise_scale.excess_variance(rows, axis, *at, variance, work) for axis, variance in enumerate(white)]
    return excess if any(excess) else ()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("axes", "kind", "lasting", "north"), [(1, 0, 0, 0), (3, 1, 1, -1), (3, 2, 0, -1), (1, 2, 1, -1)]
)
def test_the_kernel_is_its_twin_reading_by_reading(seed, axes, kind, lasting, north):
    """A sensor that gets noisy, jumps in unit, is lost for a while, is heard wrong, and gets quiet again."""
    rng, unit = np.random.default_rng(seed), 0.02 if north >= 0 else 1.0  # headings within half a turn
    kept, facts = np.zeros(scatter.size(axes)), np.zeros(scatter.facts_size(axes))
    facts[:4], facts[4 : 4 + 2 * axes] = (lasting, kind, 0.2, 0.02), unit**2 * rng.uniform(0.1, 1.0, 2 * axes)
    kept[noise_scale.TIME_S] = -math.inf
    Cr, P, nav = unit * rng.normal(size=(6, 5)) ** 2, unit * spd(rng, 14), random_nav(rng)
    noise = 3.0 * unit * rng.normal(size=(400, axes))
    noise[100:150] *= 5.0
    noise[200:230] *= 1e4
    noise[300:] *= 0.05
    places, ends, worthless, added = (0, axes * axes), 0, 0, 0
    for k, residual in enumerate(noise):
        excess = kept[6 + 2 * axes : 6 + 3 * axes]
        R = unit**2 * spd(rng, axes) + np.diag(excess if np.isfinite(excess).all() else np.zeros(axes))
        seen = rng.random(axes) > (0.1 if axes > 1 else 0.0)
        seen[0] = True
        S = R + unit**2 * spd(rng, axes, 0.1)
        sd = np.where(seen, np.sqrt(np.diag(S)), np.nan)
        nis = residual[seen] @ np.linalg.solve(S[np.ix_(seen, seen)], residual[seen])
        used = float(nis < 8.0 * seen.sum())
        residual = np.where(seen, residual, np.nan)
        mem = np.concatenate([S.ravel(), [nis, seen.sum(), used], residual, sd])
        time_s = 0.2 * k + (2.0 if k > 180 else 0.0)
        if used and not kept[noise_scale.WATCHED]:
            continue
        of = (mem, *places, R, north, P, nav, Cr, time_s, k == 121)
        own, twin, known = kept.copy(), kept.copy(), facts.copy()
        known[noise_scale.BY_AXIS + 2 * axes :] = math.nan  # room to work in: nothing there counts
        by_kernel = noise_scale.update_scale(own, known, *of)
        by_twin = naive.update_scale(twin, facts.copy(), *of)
        assert by_kernel == pytest.approx(by_twin, rel=1e-9)
        # sums in another order, of differences of squares that leave a thousandth of them
        np.testing.assert_allclose(own, twin, rtol=1e-9, atol=1e-12)
        kept = own
        ends += kept[noise_scale.TIME_S] == -math.inf
        worthless += np.isinf(kept[6 + 2 * axes : 6 + 3 * axes]).any()
        added += bool(np.any(kept[6 + 2 * axes : 6 + 3 * axes]))
        variance = np.where(rng.random() > 0.5, np.nan, rng.uniform(1.0, 2.0, axes))
        assert_close(*(args[1] for args in run_both(noise_scale.widen_variance, kept, facts, variance, axes)))
    assert added > 20 and (worthless > 5 or north >= 0) and ends > 0


@pytest.mark.parametrize(("sensor", "kind"), [(nf.Heading(), 0), (nf.BodyVelocity(), 1), (nf.Depth(), 2)])
def test_what_drive_may_have_added_is_what_refused_readings_are_judged_by(sensor, kind):
    """The same stands in the kernel, whose twin this is, and in Python for readings that are refused together."""
    rng = np.random.default_rng(3)
    P, Cr = spd(rng, 14), rng.normal(size=(6, 5)) ** 2
    once = sensor_bias.reckoned(sensor, P, 1.5, 0.4, Cr, 0.02)
    assert once == pytest.approx(naive.may_have_gone(kind, P, 1.5, 0.4, Cr, 0.02), rel=1e-12)


@pytest.mark.parametrize("count", [7, 8, 30, 48])
def test_what_is_beyond_the_variances_is_that_of_the_twin(count):
    rng = np.random.default_rng(count)
    for newest in (count - 1, 5):
        bends = np.abs(rng.normal(size=(noise_scale.MOST, 4)))
        bends[rng.random(noise_scale.MOST) < 0.2, 0] = np.nan
        for axis in range(2):
            for white in (1e-3, 0.05, 10.0):
                run = bends, axis, count, newest, white, np.zeros(3 * noise_scale.MOST)
                assert noise_scale.excess_variance(*run) == pytest.approx(naive.excess_variance(*run), rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_the_excess_is_that_of_the_noise_and_outliers_are_none(seed):
    rng = np.random.default_rng(seed)
    readings = rng.normal(scale=[0.1, 0.01, 0.01], size=(noise_scale.MOST + 2, 3))
    readings[::17, 2] += 5.0  # each outlier is in three second differences
    wide, right, spiked = beyond(np.diff(readings, n=2, axis=0), np.full(3, 1e-4))
    assert 0.005 < wide < 0.02 and right == 0.0 and spiked == 0.0
    assert not beyond(np.diff(readings[:, 1:], n=2, axis=0), np.full(2, 1e-4))
    assert not beyond(np.full((8, 1), np.nan), np.array([1e-4]))


def test_a_ramp_and_a_jump_are_no_noise():
    time_s = np.arange(noise_scale.MOST + 2.0)
    readings = np.random.default_rng(1).normal(scale=0.01, size=(len(time_s), 2))
    readings += np.column_stack([0.5 * time_s, np.where(time_s > 20, 3.0, 0.0)])
    assert not beyond(np.diff(readings, n=2, axis=0), np.full(2, 1e-4))


def test_what_else_is_in_a_second_difference_is_no_noise():
    bends = np.diff(np.random.default_rng(4).normal(scale=0.1, size=(noise_scale.MOST + 2, 1)), n=2, axis=0)
    assert not beyond(bends, np.array([1e-4]), slack=0.01)
    (excess,) = beyond(bends, np.array([1e-4]), slack=0.003)
    assert 0.004 < excess < 0.01  # of 0.01 the slack and what is described taken off


@pytest.mark.parametrize("velocity", [False, True])
@pytest.mark.parametrize("unit", [tactical_imu(), mems_imu()], ids=["tactical", "mems"])
def test_a_gauge_with_five_times_the_noise_that_is_described_is_not_lost(unit, velocity):
    """Its first readings tell the vertical velocity and the accelerometer too well, and the next are refused: what
    leaves it then is the height that only accelerometers carry, and by how much it scatters shows beside that.
    """
    fixes = nf.Position(error=nf.GaussMarkov(sd=5.0, tau_s=26.0))
    other = {"dvl": nf.BodyVelocity(error=nf.White(sd=0.02))} if velocity else {"gps": fixes}
    noisy = nf.Vehicle(unit, {"depth": nf.Depth(error=nf.White(sd=0.025))} | other)
    described = noisy.with_error(depth=nf.White(sd=0.005))
    for seed in range(3):
        faults = {} if velocity else {"gps": Faults(available="always")}
        mission = simulate(noisy, lawnmower(240.0), seed=seed, duration_s=240.0, faults=faults)
        track = nf.replay(described, mission, output_rate_hz=1.0)
        late = track.time_s > 60.0
        down = track.errors(mission.truth).position_n[late, 2]
        # of 1 for an honest filter; it was 20 to 160, with metres, and half of the readings refused
        assert np.mean(down**2 / track.covariance[late, 2, 2]) < 4.0 and np.abs(down).max() < 0.15
        assert np.mean(track.residuals["depth"].used) > 0.9


def test_noise_that_becomes_endless_within_a_batch_ends_the_batch(monkeypatch):
    """A smooth compass error of complex roots, described as a shorter one: its noise scale becomes infinite in between.

    The next reading of the batch was used with an infinite variance, and left a covariance of NaN.
    """
    vehicle, mission = smooth_compass()
    together = nf.replay(vehicle, mission)
    assert np.isfinite(together.covariance).all() and together.time_s[-1] > mission.duration_s - 1.0
    monkeypatch.setattr(runner.BatchRunner, "possible", property(lambda self: False))
    np.testing.assert_array_equal(together.covariance, nf.replay(vehicle, mission).covariance)


def smooth_compass(seed=0):
    """A mission of half an hour up to where it happens, cut at both ends by fixes."""
    r, w = math.exp(-1.0 / (120.0 * 8.0)), 2.0 * math.pi / (45.0 * 8.0)
    ar = np.poly([r * np.exp(1j * w), r * np.exp(-1j * w), 0.6]).real[1:]
    true = scaled(tuple(ar.tolist()), tuple(np.poly([0.9, -0.3])[1:].tolist()), 0.5 * DEG)
    plain = stage("compass-gm1", motion="lawnmower", gyro="tactical", imu_rate_hz=50.0)
    fault = replace(plain.faults["compass"], true_error=nf.White(sd=1e-9), quantisation=0.0)
    mission = replace(plain, faults={**plain.faults, "compass": fault}).mission(20270000 + seed)
    stream = mission.streams["compass"]
    index = np.round((stream.time_s - stream.time_s[0]) * 8.0).astype(int)
    value = stream.value.copy()
    value[:, 0] += draw_error(true, 0.125, int(index[-1]) + 1, seed, "new/a")[index]
    described = nf.White(sd=8.63784e-06) + nf.GaussMarkov(sd=0.00592797, tau_s=17.5677, order=2)
    mission = replace(mission, streams={**mission.streams, "compass": replace(stream, value=value)})
    return plain.vehicle.with_error(compass=described), mission.between(0.0, 1400.0)


def test_what_may_change_of_a_velocity_that_has_jumped_goes_with_its_speed():
    """Kernels write the slopes of its constants, which go with the velocity, where they stand."""
    vehicle = nf.Vehicle(imu=nf.Imu(rate_hz=50), sensors={"dvl": nf.BodyVelocity(rate_hz=4, error=nf.White(sd=0.01))})
    jumped = with_offsets(vehicle.sensors["dvl"].models, 0.5, at_m_s=1.0, density=0.01)
    nav = nf.Navigator(vehicle.with_error(dvl=jumped), nf.Start(latitude_deg=45.0, longitude_deg=0.0))
    channel = nav.filter.channels["dvl"]
    before = channel.wander(10.0)
    channel.C *= 2.0
    assert channel.offset and (before > 0.0).all()
    np.testing.assert_allclose(channel.wander(10.0), 4.0 * before, rtol=1e-12)
