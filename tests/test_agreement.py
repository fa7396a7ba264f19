"""Several refused readings that agree beat a state that nobody confirmed; a sensor that jumps is set aside."""

import dataclasses
import functools
import math
from types import SimpleNamespace

import faults_run as watched
import numpy as np
import pytest
from feeding import once_a_second
from scipy.stats import norm
from state_differences import differences

import navfilter as nf
from navfilter.faults import policy, sensor_bias
from navfilter.faults.sensor_bias import RejectionRun
from navfilter.kernels import batch, fault_bank
from navfilter.models.fault_bias import (
    FaultBias,
    FaultCurrent,
    FaultScale,
    FaultTurn,
    currents,
    descriptions,
    has_offset,
    offset_states,
    proportions,
    unfaulted,
    with_description,
    with_offsets,
    with_the_same_offsets,
)
from navfilter.models.state import wrap
from navfilter.simulation.scenarios import simulate_scenario, survey, survey_vehicle
from navfilter.simulation.simulate import Faults, simulate

DEG = math.pi / 180.0
RADIUS_M = 6.37e6
DURATION_S, DIVE_S, FAULT_S = 260.0, 120.0, 130.0


@functools.cache
def dive(mems=False):
    """Fixes for two minutes, then none: 20 s at rest, straight on, a dive, turns."""
    plain = survey_vehicle(mems=mems)
    vehicle = plain.with_error(
        compass=plain.sensors["compass"].error + nf.White(sd=0.1 * DEG),
        gps=plain.sensors["gps"].error + nf.White(sd=0.5),
    )
    fixes = {"gps": Faults(available=((0.0, DIVE_S),))}
    return vehicle, simulate(vehicle, survey(DURATION_S), seed=3, duration_s=DURATION_S, faults=fixes)


def altered(mission, name, change, begin_s, end_s=math.inf):
    """The mission with other readings of a sensor between two times."""
    stream = mission.streams[name]
    inside = (stream.time_s >= begin_s) & (stream.time_s < end_s)
    value = np.where(inside[:, None], change(stream.value), stream.value)
    return mission.with_stream(name, nf.Stream(stream.time_s, value, stream.columns))


def fly(vehicle, mission, until_s=math.inf, **start):
    """A navigator after the mission, and how far it was off once a second: horizontal, down, heading [deg], with sd."""
    nav = nf.Navigator(vehicle, dataclasses.replace(mission.start, **start))
    return nav, feed(nav, vehicle, mission, until_s)


def feed(nav, vehicle, mission, until_s=math.inf, after_s=-math.inf):
    off = []
    for state in once_a_second(nav, vehicle, mission, until_s, after_s):
        e = state.minus(watched.truth_at(mission.truth, state.time_s))
        off.append([state.time_s, math.hypot(e[0], e[1]), abs(e[2]), abs(e[8]) / DEG, *state.sd[[0, 2, 8]]])
    return np.array(off)


def after(off, time_s):
    return off[off[:, 0] > time_s]


def turned(value):
    return wrap(value + math.pi)


# --- the state was told wrongly ------------------------------------------------------------------------------------


@pytest.mark.parametrize("mems", [False, True])
def test_a_start_that_is_2_km_off_is_corrected_by_the_first_fixes(mems):
    vehicle, mission = dive(mems)
    nav, off = fly(vehicle, mission, latitude_deg=mission.start.latitude_deg + 2000.0 / RADIUS_M / DEG)
    assert off[3, 1] > 1900.0
    late = after(off, mission.start.time_s + 16.0)  # 15 fixes
    # fixes err by 3 m and slowly: four of their sd hold what is left, at once and in the dive
    assert late[:, 1].max() < 14.0 and (late[:, 1] < 4.5 * math.sqrt(2.0) * late[:, 4]).all()
    assert nav.counts["reset"] == 1 and nav.counts["jumped"] == 0
    assert after(off, 40.0)[:, 3].max() < 3.0  # the fixes moved the place, not the heading


def test_a_start_heading_that_is_turned_round_follows_the_compass():
    vehicle, mission = dive()
    heading = mission.start.heading_deg
    nav, off = fly(vehicle, mission, heading_deg=heading + 180.0, heading_sd_deg=5.0)
    late = after(off, mission.start.time_s + 10.0)
    assert off[3, 3] > 170.0 and late[:, 3].max() < 3.0  # five sd of the compass
    assert late[:, 1].max() < 15.0
    assert nav.counts["reset"] == 1 and nav.counts["jumped"] == 0


def test_a_magnetometer_turns_a_wrong_start_heading_and_leaves_the_smoother_right():
    plain = survey_vehicle()
    compass = nf.Heading(
        rate_hz=4.0, magnetometer=True, declination_rad=0.1, error=nf.GaussMarkov(sd=0.6 * DEG, tau_s=60.0)
    )
    vehicle = dataclasses.replace(plain, sensors=plain.sensors | {"compass": compass})
    mission = simulate(vehicle, survey(60.0), seed=3, duration_s=60.0)
    start = dataclasses.replace(mission.start, heading_deg=mission.start.heading_deg + 180.0, heading_sd_deg=5.0)
    track = nf.replay(vehicle, mission, start=start, smooth=True)
    true = np.interp(track.time_s, mission.truth.time_s, np.unwrap(mission.truth.value[:, 8]))
    off = np.abs(wrap(track.attitude[:, 2] - true)) / DEG
    assert track.counts["reset"] == 1 and np.isfinite(track.covariance).all()
    assert off[track.time_s > 10.0].max() < 3.0  # five sd of the compass


def test_a_reset_leaves_the_smoother_right():
    vehicle, mission = dive()
    start = dataclasses.replace(mission.start, latitude_deg=mission.start.latitude_deg + 2000.0 / RADIUS_M / DEG)
    track = nf.replay(vehicle, mission, start=start, smooth=True)
    right = nf.replay(vehicle, mission, smooth=True)
    late = track.time_s > mission.start.time_s + 12.0
    gap = track.local(right.latitude[0], right.longitude[0]) - right.local(right.latitude[0], right.longitude[0])
    # the same fixes but the first ten: within what those say of the place
    assert np.abs(gap[late, :2]).max() < 4.0
    assert np.linalg.eigvalsh(track.covariance[late, :2, :2]).min() > 0.0
    assert track.counts["reset"] == 1 and right.counts["reset"] == 0


# --- a sensor jumps -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mems", [False, True])
def test_a_compass_turned_for_good_is_used_as_a_change_of_heading(mems):
    vehicle, mission = dive(mems)
    broken = altered(mission, "compass", turned, FAULT_S)
    nav, off = fly(vehicle, broken)
    assert after(off, FAULT_S)[:, 3].max() < (3.0 if not mems else 4.0)
    assert nav.counts["jumped"] == 1 and nav.counts["reset"] == 0
    assert nav.health.sensors["compass"].condition == "jumped" and "compass" in nav.health.degraded
    assert nav.health.sensors["compass"].age_s < 1.0  # it helps all the same
    assert abs(abs(sum(nav.errors[f"compass[{i}]"] for i in range(2))) - math.pi) < 0.1


def test_a_compass_that_comes_back_is_taken_back():
    vehicle, mission = dive()
    nav, off = fly(vehicle, altered(mission, "compass", turned, FAULT_S, FAULT_S + 60.0))
    assert after(off, FAULT_S)[:, 3].max() < 3.0
    assert nav.counts["jumped"] == 2
    assert nav.health.sensors["compass"].condition == "good"
    assert not offset_states(nav.filter.channels["compass"].sensor.models, 0.125).size
    clean, _ = fly(vehicle, mission)
    assert abs(nav.state.sd[8] - clean.state.sd[8]) < 0.1 * clean.state.sd[8]


def test_a_depth_that_jumps_does_not_take_the_vehicle_with_it():
    vehicle, mission = dive()
    nav, off = fly(vehicle, altered(mission, "depth", lambda z: z + 5.0, FAULT_S))
    assert after(off, FAULT_S)[:, 2].max() < 0.5
    assert nav.counts["jumped"] == 1
    assert abs(nav.errors["depth[0]"] - 5.0) < 0.3


def test_a_dvl_whose_scale_jumps_leaves_the_velocity_alone():
    vehicle, mission = dive()
    nav, off = fly(vehicle, altered(mission, "dvl", lambda v: 1.05 * v, FAULT_S))
    # 5 % of 1.5 m/s would be 9 m by now
    late = after(off, FAULT_S)
    assert late[:, 1].max() < 5.0 * late[-1, 4]
    assert late[-1, 1] < 4.0
    # it stands still now, where a scale is nothing and a constant would be 0.075 m/s
    state = nav.state
    velocity = state.minus(watched.truth_at(mission.truth, state.time_s))[3:5]
    assert (np.abs(velocity) < 4.0 * state.sd[3:5]).all() and np.abs(velocity).max() < 0.04
    assert nav.health.sensors["dvl"].condition == "jumped"


def read(filter, channel, z, nav, x):
    """Jacobian of the fault's states as the kernel has it for a reading."""
    table, at = filter.bench[channel.spot[batch.FAULTS] :], (channel.group.start, channel.spot[batch.NORTH])
    seen, none = (channel.C, channel.near, channel.res), np.zeros(6)
    batch.fault_states(table, np.array(z), nav, x, none, *at, *seen, np.zeros(3), 0.0)


def test_what_was_found_of_a_description_outlives_a_jump():
    """But not the run: files that are handed on know nothing of it."""
    described = with_description((nf.White(sd=0.01),) * 3, {0: 2.0, 3: 1.0})
    jumped = with_offsets(described, 0.1, at_m_s=2.0)
    assert has_offset(jumped) and not has_offset(described)
    assert with_offsets(jumped) == described and descriptions(jumped, 0.25) == [(0, 0), (1, 3), (6, 6)]
    assert unfaulted(jumped) == (nf.White(sd=0.01),) * 3


def test_what_is_in_proportion_to_the_speed_vanishes_at_rest():
    """And what moves with the bottom goes with no turn of the vehicle."""
    opened = with_offsets((nf.White(sd=0.01),) * 3, 0.1, at_m_s=2.0)
    assert opened[1] == nf.White(sd=0.01) + FaultBias(start_sd=0.1)
    flows = FaultCurrent(start_sd=0.1) + FaultCurrent(start_sd=0.1, component=1)
    assert opened[0] == opened[1] + FaultScale(start_sd=0.1, at_m_s=2.0) + flows + FaultTurn(start_sd=0.05)
    assert proportions(opened, 0.25) == [(1, 2.0)] and currents(opened, 0.25) == [(2, 0), (3, 1)]
    vehicle, mission = dive()
    filter = nf.Navigator(vehicle.with_error(dvl=opened), mission.start).filter
    channel = filter.channels["dvl"]
    at = channel.group.start - 9
    x = np.zeros(at + channel.group.size)
    x[at + 1] = 0.1
    channel.near[:], channel.res[:] = 1.0, 0.0
    channel.near[:, 3:6] = about_z = np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    read(filter, channel, [1.0, 0.5, 0.0], mission.start.state.pack(), x)
    # 5 % at any speed: half of 0.1 m/s at 1 m/s
    np.testing.assert_allclose(channel.C @ x[at:], [0.05, 0.025, 0.0], atol=1e-15)
    np.testing.assert_allclose(channel.near[:, 3:6], 1.05 * about_z, atol=1e-15)
    # a bottom that goes north is read the other way, in the axes of the instrument
    np.testing.assert_allclose(channel.C[:, 2:4], -1.05 * about_z[:, :2], atol=1e-15)
    x[at + 4] = 0.1
    state = dataclasses.replace(mission.start.state, velocity_n=np.zeros(3))
    read(filter, channel, [0.0, 0.0, 0.0], state.pack(), x)
    assert not (channel.C @ x[at:]).any()


@pytest.mark.parametrize("window", [(70.0, 110.0), (DIVE_S - 25.0, DIVE_S + 1.0)])
def test_a_jump_of_the_fixes_is_not_followed(window):
    vehicle, mission = dive()
    broken = altered(mission, "gps", lambda p: p + np.array([100.0 / RADIUS_M, 0.0, 0.0]), *window)
    nav, off = fly(vehicle, broken)
    assert after(off, window[0])[:, 1].max() < 8.0
    assert nav.counts["reset"] == 0


# --- nothing else changes --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scenario", ["lawnmower", "reckoning", "thesis"])
def test_without_a_fault_nothing_fires_and_nothing_changes(monkeypatch, scenario):
    vehicle, mission = simulate_scenario(scenario, 11, 150.0)
    with_agreement = nf.replay(vehicle, mission)
    assert with_agreement.counts["reset"] == with_agreement.counts["jumped"] == 0
    monkeypatch.setattr(policy, "_agreed", lambda *_: False)
    assert with_agreement.to_frame().equals(nf.replay(vehicle, mission).to_frame())


def test_live_is_the_replay_and_a_snapshot_goes_on_bit_for_bit():
    vehicle, mission = dive()
    broken = altered(mission, "compass", turned, FAULT_S, FAULT_S + 60.0)
    whole, _ = fly(vehicle, broken)
    track = nf.replay(vehicle, broken, output_rate_hz=None)
    np.testing.assert_array_equal(track.attitude[-1], whole.state.roll_pitch_heading)
    # in the middle of the refusals, with the constant in force, and when it is refused again
    for at in (FAULT_S + 4.0, FAULT_S + 30.0, FAULT_S + 64.0):
        nav, _ = fly(vehicle, broken, until_s=at)
        again = nf.Navigator.restore(vehicle, nav.snapshot())
        assert not differences(again.memory.filter, nav.memory.filter)
        feed(again, vehicle, broken, after_s=at)
        assert not differences(again.memory.filter, whole.memory.filter), at


def test_a_model_that_is_learnt_keeps_the_constant():
    vehicle, mission = dive()
    nav, _ = fly(vehicle, altered(mission, "compass", turned, FAULT_S), until_s=FAULT_S + 30.0)
    before = sum(nav.errors[f"compass[{i}]"] for i in range(2))
    nav.adopt("compass", nf.GaussMarkov(sd=0.012, tau_s=25.0) + nf.White(sd=0.002))
    assert nav.filter.channels["compass"].offset
    assert abs(nav.errors["compass[1]"] - before) < 0.05
    assert not any("FaultBias" in str(model) for model in nav.filter.described_models({})["compass"])


# --- the parts -------------------------------------------------------------------------------------------------------


def refusals_of(residual, jumped=False):
    """What a fix sensor's refused readings say together, one a second; the state's velocity is known to 0.05 m/s."""
    vehicle, mission = dive()
    nav = nf.Navigator(vehicle, mission.start)
    channel, filter = nav.filter.channels["gps"], nav.filter
    P = filter.P.copy()
    P[range(3, 6), range(3, 6)] = 0.05**2
    if jumped:
        channel.faults.agreed_s, channel.memory.used_s = 0.0, 99.0
        channel.verdict[:2] = 1e4, 3.0
    for k, row in enumerate(residual):
        channel.res[:] = row
        arguments = channel, P, 1.5, 100.0 + k, filter.drive_output, 0.01
        channel.faults.refused = sensor_bias.add_rejection(*arguments)
    return channel


def test_what_is_remembered_of_limits_does_not_grow_with_refusals():
    """A compass that is refused for good has one more of them with each reading, all day."""
    run = RejectionRun(True, True, (0.0,), (0.0,), (1.0,), (1.0,), 0.0, 0.0, misfit=1.0)
    asked = [dataclasses.replace(run, dof=dof).scatters for dof in range(1, 1000)]
    assert not any(asked) and sensor_bias._limit.cache_info().currsize < 100


def test_agreement_is_a_constant_within_the_noise():
    rng = np.random.default_rng(1)
    noise = 0.5 * rng.normal(size=(20, 3))
    steady = noise + np.array([300.0, -40.0, 0.0])
    channel = refusals_of(steady)
    assert channel.faults.refused.agree(8.0) and sensor_bias.decided(channel) == "state"
    np.testing.assert_allclose(channel.faults.refused.offset[:2], [300.0, -40.0], atol=1.5)
    # a straight line, as a wrong heading makes, is none; nor are fixes all over the place
    ramp = noise + np.arange(20)[:, None] * np.array([6.0, 0.0, 0.0]) + 100.0
    assert not refusals_of(ramp).faults.refused.agree(8.0)
    assert not refusals_of(60.0 * noise).faults.refused.agree(8.0)
    # one odd reading among them is passed over
    odd = steady.copy()
    odd[7] += 500.0
    assert refusals_of(odd).faults.refused.count == 19


def test_who_has_jumped_is_a_matter_of_what_came_before():
    steady = 0.5 * np.random.default_rng(2).normal(size=(12, 3)) + np.array([300.0, -40.0, 0.0])
    assert sensor_bias.decided(refusals_of(steady, jumped=True)) is None  # of fixes: nothing is done
    assert refusals_of(steady, jumped=True).faults.refused.from_the_first()
    slow = np.concatenate([np.linspace(0.1, 1.0, 12)[:, None] * steady.mean(axis=0), steady])
    assert not refusals_of(slow, jumped=True).faults.refused.from_the_first()


def test_offsets_stand_beside_error_models():
    models = (nf.White(sd=0.1), nf.GaussMarkov(sd=1.0, tau_s=5.0) + nf.White(sd=0.1))
    opened = with_offsets(models, 2.0)
    assert offset_states(opened, 1.0).tolist() == [0, 2]
    assert [model.parts[-1] for model in opened] == [FaultBias(start_sd=2.0)] * 2
    assert with_offsets(opened) == models and not offset_states(models, 1.0).size
    assert with_offsets(opened, 4.0)[0] == nf.White(sd=0.1) + FaultBias(start_sd=4.0)
    other = (nf.White(sd=0.3), nf.White(sd=0.4))
    assert with_the_same_offsets(other, opened) == with_offsets(other, 2.0)
    assert with_the_same_offsets(other, models) == other
    assert RejectionRun(True, True, (1.0,), (1.0,), (0.1,), (0.1,), 0.0, 1.0).from_the_first()


def test_a_dvl_whose_sign_changes_for_a_minute_of_turns_is_taken_back():
    """What comes back in a turn is off by no constant: it agrees with the state as if it had not jumped."""
    vehicle, mission = dive()
    nav, off = fly(vehicle, altered(mission, "dvl", lambda v: -v, FAULT_S, FAULT_S + 60.0))
    assert after(off, FAULT_S)[:, 1].max() < 30.0
    assert nav.health.sensors["dvl"].condition == "good"


@pytest.mark.parametrize("seed", [3, 6])
def test_a_compass_that_follows_no_turn_is_left_out(seed):
    """Radians read as degrees: a constant and a deviation fit it, and it would tell that the vehicle does not turn."""
    vehicle, _ = dive(mems=True)
    fixes = {"gps": Faults(available=((0.0, DIVE_S),))}
    mission = simulate(vehicle, survey(480.0), seed=seed, duration_s=480.0, faults=fixes)
    nav, off = fly(vehicle, altered(mission, "compass", lambda value: value * DEG, FAULT_S))
    late = after(off, FAULT_S + 20.0)
    assert (late[:, 3] * DEG < 2.0 * late[:, 6]).all()
    health = nav.health.sensors["compass"]
    assert health.condition == "rejected" and nav.counts["jumped"] == 1
    # iron that turns it by up to 25 deg leaves a compass
    iron = altered(mission, "compass", lambda value: wrap(value + 25.0 * DEG * np.cos(value - 1.0)), FAULT_S)
    assert fly(vehicle, iron)[0].health.sensors["compass"].condition == "jumped"


def test_a_constant_is_dropped_where_its_density_at_none_has_grown():
    vehicle, mission = dive()
    nav, _ = fly(vehicle, altered(mission, "depth", lambda v: v + 5.0, FAULT_S + 10.0), FAULT_S + 40.0)
    depth, memory = nav.filter.channels["depth"], nav.filter.memory
    (place,) = sensor_bias.offset_places(depth)
    before = norm(0.0, math.sqrt(depth.group.P0[depth.offsets[0], depth.offsets[0]]))
    for size in (0.0, 0.1, 0.3, 1.0, 5.0):
        for share in (0.01, 0.1, 0.5, 0.99):
            known = norm(size, share * before.std())
            memory.x[place - 9], memory.P[place, place] = size, known.var()
            gained = known.logpdf(0.0) - before.logpdf(0.0)
            assert sensor_bias.is_none(depth, memory.x, memory.P, 0.0) == (gained > fault_bank.GONE)


@pytest.mark.parametrize(("size", "dropped"), [(0.0, True), (1.0, False)])
def test_constants_are_dropped_where_each_of_them_alone_is_rather_none(size, dropped):
    """One is known to be none, which would do for two; of the other hardly anything is known yet, but that it is."""
    group, faults = SimpleNamespace(start=9, P0=np.eye(2), Q=np.zeros((2, 2))), SimpleNamespace(odds=0.0)
    channel = SimpleNamespace(group=group, faults=faults, offsets=np.arange(2), period_s=1.0)
    assert sensor_bias.is_none(channel, np.array([0.0, size]), np.diag([0.0] * 9 + [1e-4, 0.9]), 0.0) == dropped


@pytest.mark.parametrize("seed", range(3))
def test_fixes_that_scatter_do_not_set_the_position_while_a_velocity_holds_it(seed):
    """One in five seconds, 24 times as noisy as described: refused, they contradict each other."""
    vehicle, mission = simulate_scenario("lawnmower", 3, 600.0)
    stream = mission.streams["gps"]
    scatter = np.random.default_rng(seed).normal(size=(len(stream.time_s), 1)) * [1.0, 1.0, 0.0]
    value = stream.value + np.where(stream.time_s > 200.0, 70.0 / RADIUS_M, 0.0)[:, None] * scatter
    thinned = slice(None, None, 5)
    fixes = nf.Stream(stream.time_s[thinned], value[thinned], stream.columns)
    track = nf.replay(vehicle, mission.with_stream("gps", fixes), output_rate_hz=1.0)
    nees = track.nees(track.errors(mission.truth))["position"]
    assert np.nanmax(nees[track.time_s > 200.0]) < 16.3 / 3.0  # of three components one in a thousand is beyond
