"""Slow faults that no gate sees are told by the innovations of all sensors, and what they did is taken back."""

import dataclasses
import functools
import math

import naive
import numpy as np
import pytest
from kernel_inputs import assert_close, random_nav, run_both, spd
from scipy.stats import multivariate_normal
from state_differences import differences
from test_agreement import altered, feed, fly

import navfilter as nf
from navfilter.evaluation.diagnostics import doubts, evidence
from navfilter.faults import fault_bank, settings
from navfilter.filter.model_change import Change
from navfilter.kernels import fault_bank as kernels
from navfilter.kernels import kalman
from navfilter.models.during import During
from navfilter.models.fault_bias import has_offset, with_offsets
from navfilter.models.learned_arma import LearnedArma
from navfilter.models.state import matrix_from_euler
from navfilter.navigation import runner
from navfilter.playback.instructions import instructed
from navfilter.simulation.scenarios import reckoning_vehicle, survey, survey_vehicle
from navfilter.simulation.simulate import Faults, simulate
from navfilter.timeseries.model import ArmaModel

DEG = math.pi / 180.0
DEG_H = DEG / 3600.0
END_S, DIVE_S, SHIFT_S = 490.0, 140.0, 200.0


@functools.cache
def long_dive(back_s=math.inf, mems=False):
    """Fixes for 140 s, then none until `back_s`."""
    vehicle = survey_vehicle(mems=mems)
    fixes = {"gps": Faults(available=((0.0, DIVE_S), (back_s, math.inf)))}
    return vehicle, simulate(vehicle, survey(END_S, surface_s=110.0), seed=8, duration_s=END_S, faults=fixes)


def shifted_by(mission, axis, deg_h):
    return altered(mission, "imu", lambda v: v + np.eye(6)[axis] * deg_h * DEG_H, SHIFT_S)


def over_a_bottom(mission, flows, begin_s):
    """The mission over a bottom that moves; `flows` takes the age [s], (k,), and gives north and east [m/s], (k, 2)."""
    stream, truth = mission.streams["dvl"], mission.truth
    attitude = [np.interp(stream.time_s, truth.time_s, np.unwrap(angle)) for angle in truth.value[:, 6:9].T]
    C = np.array([matrix_from_euler(*angles) for angles in zip(*attitude, strict=True)])
    age = np.maximum(stream.time_s - begin_s, 0.0)
    flow = np.column_stack([flows(age), np.zeros(len(age))]) * (stream.time_s >= begin_s)[:, None]
    value = stream.value - np.einsum("kji,kj->ki", C, flow)
    return mission.with_stream("dvl", nf.Stream(stream.time_s, value, stream.columns))


@pytest.mark.parametrize(("axis", "deg_h", "within_s"), [(2, 200.0, 110.0), (2, -100.0, 180.0), (0, -50.0, 80.0)])
def test_a_shift_is_found_and_learnt_anew(axis, deg_h, within_s):
    vehicle, mission = long_dive()
    track = nf.replay(vehicle, shifted_by(mission, axis, deg_h), output_rate_hz=1.0)
    errors = track.errors(mission.truth)
    sd = np.sqrt(track.covariance[:, 8, 8])
    late = track.time_s > SHIFT_S + within_s + 40.0
    assert track.counts["shifted"] >= 1
    assert np.nanmax(np.abs(errors.heading[late]) / sd[late]) < 3.5
    assert not nf.replay(vehicle, mission, output_rate_hz=1.0).counts["shifted"]


@pytest.mark.parametrize("mems", [False, True])
def test_after_the_dive_fixes_tell_of_a_bottom_that_moved(mems):
    vehicle, mission = long_dive(350.0, mems)
    flow = np.array([0.25, -0.15])
    moving = over_a_bottom(mission, lambda age: np.minimum(0.005 * age, 1.0)[:, None] * flow, 160.0)
    track = nf.replay(vehicle, moving, output_rate_hz=1.0)
    errors, late = track.errors(mission.truth), track.time_s > 470.0
    horizontal, P = errors.position_n[late, :2], track.covariance[late]
    nees = np.einsum("ki,kij,kj->k", horizontal, np.linalg.inv(P[:, :2, :2]), horizontal) / 2.0
    assert track.counts["jumped"] >= 1 and np.mean(nees) < 2.0  # 100 and more where the velocity is believed
    assert np.abs(errors.velocity_n[late, :2]).max() < 0.15  # of 0.25


def test_where_a_velocity_gets_constants_the_state_has_followed_it():
    """Else it knows at once that there are none: what it foretells is what it has taken from that velocity."""
    vehicle, mission = long_dive(350.0)
    flow = np.array([-0.09, -0.09])
    moving = over_a_bottom(mission, lambda age: np.minimum(0.01 * age, 1.0)[:, None] * flow, 160.0)
    track = nf.replay(vehicle, moving, output_rate_hz=1.0)
    late = (track.time_s > 375.0) & (track.time_s < 450.0)
    assert track.counts["jumped"] >= 1
    nees = track.nees(track.errors(mission.truth))["velocity"]
    assert np.nanmean(nees[late]) < 3.0  # 800 to 2,000


def test_a_mounting_that_is_described_wrongly_is_found_without_fixes():
    """A DVL turned by 5 deg: the unit feels other turns than it shows, but from no reading to the next."""
    vehicle, mission = long_dive(400.0)
    stream, angle = mission.streams["dvl"], 5.0 * DEG
    turned = stream.value @ matrix_from_euler(0.0, 0.0, angle)
    track = nf.replay(vehicle, mission.with_stream("dvl", nf.Stream(stream.time_s, turned, stream.columns)))
    late = track.time_s > 250.0
    assert track.counts["arm-or-clock"] == 1 and not track.counts["jumped"]
    at = track.state_names.index("dvl_x[0]")
    assert abs(abs(track.states[-1, at]) - angle) < 0.7 * DEG
    off = track.errors(mission.truth).position_n[late, :2]
    assert np.hypot(*off.T).max() < 12.0  # 40 m where it is believed
    said = [one for one in doubts(track, mission, evidence(track)) if one.code == "arm-or-clock"]
    assert [one.stream for one in said] == ["dvl"] and "it is turned in heading by" in said[0].text


def test_a_start_that_is_told_wrongly_is_set_right():
    vehicle, mission = long_dive()
    nees = []
    for off_deg in (-3.0, 3.0):
        told = dataclasses.replace(mission.start, roll_deg=mission.start.roll_deg + off_deg, tilt_sd_deg=0.05)
        track = nf.replay(vehicle, mission.with_start(told), output_rate_hz=1.0)
        assert track.counts["realigned"] == 1 and not track.counts["shifted"]
        nees.append(np.mean(track.nees(track.errors(mission.truth))["attitude"][track.time_s > 150.0]))
    assert np.mean(nees) < 30.0  # 300 where the start is believed


def test_a_scale_of_a_velocity_is_told_from_other_faults():
    """The velocity of water or bottom, a constant: none of them is in proportion to the speed, on every course."""
    vehicle, mission = long_dive(350.0, mems=True)
    stream = mission.streams["dvl"]
    value = stream.value * (1.0 + 0.05 * (stream.time_s >= SHIFT_S))[:, None]
    track = nf.replay(vehicle, mission.with_stream("dvl", nf.Stream(stream.time_s, value, stream.columns)))
    errors, late = track.errors(mission.truth), track.time_s > 400.0
    assert track.counts["jumped"] >= 1 and has_offset(track.error_models["dvl"][-1][1])
    assert np.mean(track.nees(errors)["velocity"][late]) < 3.0  # 20 where it is believed


def test_nothing_that_begins_later_is_from_the_start():
    vehicle, mission = long_dive()
    nav = fly(vehicle, mission.between(0.0, 30.0))[0]
    bank = nav.filter.memory.monitor.bank
    D, more = fault_bank.parts(bank)[2], fault_bank.parts(bank)[5]
    begun = kernels.signatures_of(bank, kernels.WINDOWS)[2]
    assert D[8, begun + 2] != 0.0 and (more[begun:] == 0.0).all()
    nav.filter.monitor.begin_again(nav.filter, nav.filter.memory.monitor)
    assert not D[:9, begun:].any() and (more[begun:] == fault_bank.NEVER).all()


def test_a_bank_that_begins_again_knows_the_error_models_that_innovations_have_told():
    """Else what fixes say after the dive is doubted as if nobody had heard one before."""
    vehicle, mission = long_dive()
    filter = fly(vehicle, mission.between(0.0, 130.0))[0].filter
    heard = fault_bank.parts(filter.memory.monitor.bank)[6].copy()
    assert (heard[:, kernels.TOLD] > kernels.DOUBTED + kernels.CONFIRMED).all()
    filter.monitor.begin_again(filter, filter.memory.monitor)
    onsets, *_, after = fault_bank.parts(filter.memory.monitor.bank)
    assert (onsets[: kernels.WINDOWS] == filter.memory.time_s).all()
    np.testing.assert_array_equal(after[:, : kernels.BEFORE], heard[:, : kernels.BEFORE])
    assert (after[:, kernels.BEFORE : kernels.BEFORE + kernels.WINDOWS] >= 1.0).all()


def test_a_fix_that_is_refused_tells_the_size_of_the_fault_that_explains_it_and_no_other():
    """As a reading of the fault, with the state as uncertain as it was when the fix was refused."""
    vehicle, mission = long_dive(350.0)
    filter = fly(vehicle, mission.between(0.0, 330.0))[0].filter
    gps, bank = filter.channels["gps"], filter.memory.monitor.bank
    table = fault_bank.parts(bank)[1]
    window = kernels.WINDOWS - 1
    flow = int(np.flatnonzero(table[:, kernels.KIND] == kernels.FLOW_STEP)[0])
    _, _, D, s, J, more, heard = fault_bank.parts(bank)
    s[:], J[:], more[:] = 0.0, 0.0, 0.0
    heard[:, kernels.BEFORE : kernels.THEN] = 1.0
    at = kernels.signatures_of(bank, window)[2] + flow + np.arange(2)
    G = gps.H @ D[:, at]
    a, size = gps.axes, np.array([0.4, -0.2])
    gps.note[3 : 3 + a], gps.note[3 + a : 3 + 2 * a] = G @ size, 1.0
    fault_bank.note_jump(filter, gps, filter.memory.time_s)
    S = gps.S[:a]
    np.testing.assert_allclose(J[np.ix_(at, at)], G.T @ np.linalg.solve(S, G), rtol=1e-9)
    np.testing.assert_allclose(s[at], G.T @ np.linalg.solve(S, G) @ size, rtol=1e-9)
    begins = fault_bank.columns(bank, *np.array(fault_bank.hypotheses(bank)).T)
    silent = begins[more[begins] == 0.0]
    assert 0 < len(silent) < begins.size and not J[silent].any() and not s[silent].any()
    rare = math.log(settings.FAULTS_PER_S * max(filter.memory.time_s - gps.memory.used_s, gps.period_s))
    likely = [
        multivariate_normal(np.zeros(a), S + off**2 * np.eye(a)).logpdf(G @ size) for off in (0.0, settings.JUMP_M)
    ]
    assert more[at[0]] == pytest.approx(likely[0] - likely[1] - rare)
    # where innovations are as large as that anyway, it has not jumped, and no fault is likelier for it
    heard[:, kernels.BEFORE : kernels.THEN] = 1e3
    before = more.copy()
    fault_bank.note_jump(filter, gps, filter.memory.time_s)
    assert (more == before).all()


def test_a_compass_that_runs_away_is_told_from_the_gyros():
    vehicle, mission = long_dive()
    stream = mission.streams["compass"]
    off = np.clip(0.1 * DEG * (stream.time_s - SHIFT_S), 0.0, 20.0 * DEG)
    wrong = mission.with_stream("compass", nf.Stream(stream.time_s, stream.value + off[:, None], stream.columns))
    track = nf.replay(vehicle, wrong, output_rate_hz=1.0)
    errors, late = track.errors(mission.truth), track.time_s > SHIFT_S + 120.0
    assert np.abs(errors.heading[late]).max() < 8.0 * DEG
    assert np.all(np.abs(errors.heading) <= track.bounds[:, 1])
    distance = np.hypot(*errors.position_n[:, :2].T)
    assert np.mean(distance <= track.bounds[:, 0]) > 0.99


@pytest.mark.parametrize("deg_s", [0.1, 0.2])
def test_an_explanation_that_is_put_in_force_beside_another_stays_until_it_is_disproved(deg_s):
    """A compass that runs away, or a gyro that drifts: a reading later nothing has told the two apart."""
    vehicle, mission = long_dive(mems=True)
    stream = mission.streams["compass"]
    off = np.clip(deg_s * DEG * (stream.time_s - SHIFT_S), 0.0, 20.0 * DEG)
    wrong = mission.with_stream("compass", nf.Stream(stream.time_s, stream.value + off[:, None], stream.columns))
    track = nf.replay(vehicle, wrong, output_rate_hz=1.0)
    (_, before), (adopted_s, models) = track.error_models["compass"]
    assert has_offset(models) and not has_offset(before)
    errors, late = track.errors(mission.truth), track.time_s > adopted_s + 60.0
    assert np.mean(track.nees(errors)["heading"][late]) < 8.0  # 1,700 and more where it is taken away at once
    assert np.all(np.abs(errors.heading) <= track.bounds[:, 1])


@pytest.mark.parametrize("error", [nf.White(sd=0.6 * DEG), nf.GaussMarkov(sd=0.3 * DEG, tau_s=30.0)])
def test_an_error_model_that_is_wrong_is_no_fault(error):
    vehicle, mission = long_dive()
    track = nf.replay(vehicle.with_error(compass=error), mission, output_rate_hz=1.0)
    assert not track.counts["shifted"] and not track.counts["jumped"]


@pytest.mark.parametrize("mems", [False, True])
def test_an_hour_without_a_fault_has_none(mems):
    """What adds up little by little takes more than a dive to be believed: a scale of the velocity took 15 minutes."""
    vehicle = survey_vehicle(mems=mems)
    fixes = {"gps": Faults(available=tuple((begin_s, begin_s + 120.0) for begin_s in np.arange(0.0, 3600.0, 900.0)))}
    mission = simulate(vehicle, survey(3600.0, surface_s=110.0), seed=100, duration_s=3600.0, faults=fixes)
    counts = nf.replay(vehicle, mission).counts
    assert [counts[name] for name in ("jumped", "shifted", "reset", "contradicted")] == [0, 0, 0, 0]


def test_noise_of_the_gyros_is_no_lever_arm():
    """It moves the velocity by the arm that there is, and the next innovation with it: 0.3 m in ten minutes."""
    plain = survey_vehicle(mems=True)
    gyro = nf.White(density=4e-3) + nf.RandomWalk(density=1.6e-6, start_sd=2.9e-4)
    dvl = dataclasses.replace(plain.sensors["dvl"], lever_arm_b_m=(1.0, -1.0, -1.0), error=nf.White(sd=0.004))
    drive = dataclasses.replace(plain.drive, rate_hz=20.0, gyro=gyro)
    vehicle = nf.Vehicle(drive, plain.sensors | {"dvl": dvl})
    mission = simulate(vehicle, survey(600.0, surface_s=110.0), seed=1, duration_s=600.0)
    assert not nf.replay(vehicle, mission).counts["arm-or-clock"]


def test_a_velocity_that_errs_in_all_axes_is_known_to_in_all():
    """Of two axes hardly anything is told by the time that the third is believed: they may err as much."""
    vehicle, mission = long_dive()
    vehicle, mission = vehicle.without("depth"), mission.hide("depth", (-math.inf, math.inf))
    stream = mission.streams["dvl"]
    off = np.outer(np.clip(stream.time_s - SHIFT_S, 0.0, 60.0), [2e-3, -1e-3, 1e-3])
    wrong = mission.with_stream("dvl", nf.Stream(stream.time_s, stream.value + off, stream.columns))
    track = nf.replay(vehicle, wrong, output_rate_hz=1.0)
    late, nees = track.time_s > 300.0, track.nees(track.errors(mission.truth))
    assert track.counts["jumped"] >= 1
    # 50 and 15 where only those axes get constants that are believed by themselves
    assert np.nanmean(nees["position"][late]) < 3.0 and np.nanmean(nees["velocity"][late]) < 3.0


def test_a_course_that_errs_is_no_moving_bottom():
    """What tells of a sensor that no other rule knows, too, is a hypothesis: fixes are not refused for it."""
    plain, _ = long_dive()
    vehicle = nf.Vehicle(plain.drive, plain.sensors | {"course": nf.Course()})
    fixes = {"gps": Faults(available=((0.0, DIVE_S), (350.0, math.inf)))}
    mission = simulate(vehicle, survey(END_S, surface_s=110.0), seed=8, duration_s=END_S, faults=fixes)
    stream = mission.streams["course"]
    off = np.clip(0.008 * (stream.time_s - SHIFT_S), 0.0, 2.0)
    wrong = mission.with_stream("course", nf.Stream(stream.time_s, stream.value + off[:, None], stream.columns))
    track = nf.replay(vehicle, wrong, output_rate_hz=1.0)
    errors = track.errors(mission.truth)
    distance, late = np.hypot(*errors.position_n[:, :2].T), track.time_s > 360.0
    assert has_offset(track.error_models["course"][-1][1])
    assert np.mean(distance <= track.bounds[:, 0]) > 0.99
    assert distance[late].max() < 8.0  # 660 where the bottom is thought to move


def test_stretches_lives_and_snapshots_give_the_same(monkeypatch):
    vehicle, mission = long_dive()
    broken = shifted_by(mission, 0, -50.0).between(0.0, SHIFT_S + 70.0)
    whole, _ = fly(vehicle, broken)
    assert whole.counts["shifted"] == 1
    track = nf.replay(vehicle, broken, output_rate_hz=None)
    np.testing.assert_array_equal(track.velocity_n[-1], whole.state.velocity_n)
    assert track.bounds[-1] == pytest.approx(dataclasses.astuple(whole.state.bounds), rel=1e-9)
    monkeypatch.setattr(runner.BatchRunner, "possible", property(lambda self: False))
    again = nf.replay(vehicle, broken, output_rate_hz=None)
    np.testing.assert_array_equal(again.covariance[-1], track.covariance[-1])
    np.testing.assert_array_equal(again.bounds, track.bounds)
    half, _ = fly(vehicle, broken, until_s=SHIFT_S + 10.0)
    restored = nf.Navigator.restore(vehicle, half.snapshot())
    feed(restored, vehicle, broken, after_s=SHIFT_S + 10.0)
    assert not differences(whole.filter.memory, restored.filter.memory)


def test_dead_reckoning_has_no_bank():
    vehicle = reckoning_vehicle()
    mission = simulate(vehicle, survey(60.0), seed=1, duration_s=60.0)
    nav, _ = fly(vehicle, mission)
    assert nav.filter.memory.monitor.look_s == math.inf and not nav.filter.memory.monitor.bank.size


def test_the_largest_transition_finds_room():
    """Of a velocity with registers of ten on each axis more states tick than the drive has."""
    vehicle, mission = long_dive()
    long = LearnedArma(model=ArmaModel((-0.5,) + (0.0,) * 8 + (0.1,), (0.1,) * 10, 0.01))
    nav = nf.Navigator(vehicle.with_error(dvl=long), mission.start)
    layout, channels = nav.filter.layout, nav.filter.channels
    _, more = fault_bank.room(layout, channels)
    columns = kernels.width(nav.filter.memory.monitor.bank)
    assert layout.groups["dvl"].ticking > layout.head and more >= layout.groups["dvl"].ticking * columns
    assert nav.filter.bank.size == nav.filter.memory.monitor.bank.size + more


def test_a_unit_with_another_number_of_biases_begins_anew():
    vehicle, mission = long_dive()
    nav, _ = fly(vehicle, mission.between(0.0, 80.0))
    nav.filter.adopt(Change("gyro", nf.GaussMarkov(sd=1e-5, tau_s=100.0) + nf.White(sd=1e-4)), nav.on_event)
    onsets, table, D = fault_bank.parts(nav.filter.memory.monitor.bank)[:3]
    assert np.all(onsets[: kernels.WINDOWS] == nav.time_s) and np.all(table[:, kernels.CHANNEL] < 3)
    assert np.sum(table[:, kernels.KIND] == kernels.STATE) == 3 + 3 + 3 and D.shape[0] == nav.filter.layout.size


def test_an_instrument_goes_wrong_under_all_of_its_names():
    vehicle, mission = long_dive()
    stream = mission.streams["compass"]
    off = np.maximum(0.1 * DEG * (stream.time_s - SHIFT_S), 0.0)
    wrong = mission.with_stream("compass", nf.Stream(stream.time_s, stream.value + off[:, None], stream.columns))
    said = During("compass", SHIFT_S + 20.0, keys={"gate_probability": 0.9995})
    named, seen = instructed(vehicle, dataclasses.replace(wrong.between(0.0, 280.0), during=(said,)))
    nav, _ = fly(named, seen)
    assert nav.counts["shifted"] >= 1 and nav.filter.channels["compass@2"].offset
    plain = nf.Navigator(vehicle, mission.start).filter
    names = [list(filter.channels.values()) for filter in (plain, nav.filter)]
    ours, others = fault_bank.signatures(plain.layout, names[0]), fault_bank.signatures(plain.layout, names[1])
    assert [*map(len, ours)] == [*map(len, others)]


def test_what_is_believed_is_not_given_up_by_what_was_decided_before():
    vehicle, mission = long_dive()
    nav, _ = fly(vehicle, mission.between(0.0, 150.0))
    filter, compass, size = nav.filter, nav.filter.channels["compass"], 3.0 * DEG
    bank = filter.memory.monitor.bank
    _, table, D, s, J, more, _ = fault_bank.parts(bank)
    step = np.flatnonzero((table[:, kernels.KIND] == kernels.STEP) & (table[:, kernels.CHANNEL] == 0))[0]
    s[:], J[:], more[:], D[:], bank[kernels.ODDS] = 0.0, 0.0, 0.0, 0.0, 20.0
    s[step], J[step, step] = 1e8 * size, 1e8
    filter.monitor.changes.append(Change("compass", with_offsets(compass.sensor.models), offsets=True))
    filter.monitor.has_pending = True
    filter.handle_pending(nav.on_event)
    assert compass.offset and filter.x[compass.group.start + int(compass.offsets[0]) - 9] == pytest.approx(size)


def test_what_an_offset_has_taken_already_is_not_taken_twice():
    """A compass that has a state for what it is off by: of a step the filter has put a part there itself."""
    vehicle, mission = long_dive()
    nav, _ = fly(vehicle, mission.between(0.0, 150.0))
    filter, compass = nav.filter, nav.filter.channels["compass"]
    open_ = with_offsets(compass.sensor.models, 5.0 * DEG, density=0.5 * DEG, only=0)
    filter.adopt(Change("compass", open_, offsets=True), nav.on_event)
    feed(nav, vehicle, altered(mission, "compass", lambda v: v + 10.0 * DEG, 150.0).between(0.0, 175.0), after_s=150.0)
    state, size, told = compass.group.start + int(compass.offsets[0]), 3.0 * DEG, []
    bank = filter.memory.monitor.bank
    onsets, table, D, s, J, more, _ = fault_bank.parts(bank)
    window = int(np.argmin(np.where(onsets[: kernels.WINDOWS] > 149.0, onsets[: kernels.WINDOWS], math.inf)))
    step = np.flatnonzero((table[:, kernels.KIND] == kernels.STEP) & (table[:, kernels.CHANNEL] == 0))[0]
    column = kernels.signatures_of(bank, window)[2] + step
    s[:], J[:], more[:], bank[kernels.ODDS] = 0.0, 0.0, 0.0, 20.0
    s[column], J[column, column] = 1e8 * size, 1e8
    taken, before = D[state, column], filter.x[state - 9]
    filter.act(fault_bank.judge(filter), told.append)
    assert taken < -0.2
    assert filter.x[state - 9] - before == pytest.approx((1.0 + taken) * size, rel=1e-4)
    assert told[-1].anew  # an open loop knows nothing of this step


def test_what_a_fault_did_goes_on_under_another_name():
    vehicle, mission = long_dive()
    said = During("compass", 100.0, keys={"gate_probability": 0.99})
    vehicle, mission = instructed(vehicle, dataclasses.replace(mission, during=(said,)))
    filter = fly(vehicle, mission.between(0.0, 99.9))[0].filter
    compass, done = filter.layout.groups["compass"].start, fault_bank.parts(filter.memory.monitor.bank)[2].copy()
    filter._take_over(filter.channels["compass@2"], lambda event: None)
    after = fault_bank.parts(filter.memory.monitor.bank)[2]
    assert np.any(done[compass])
    np.testing.assert_allclose(after[filter.layout.groups["compass@2"].start], done[compass])


# --- the recursion ---------------------------------------------------------------------------------------------------

SMALL = 1e-6


def _with_fault(mission, kind, place, begin_s):
    """The mission with a small fault of this kind from a time on."""
    if kind in (kernels.FLOW_STEP, kernels.FLOW_RAMP):
        ages = (lambda age: np.ones_like(age)) if kind == kernels.FLOW_STEP else (lambda age: age)
        return over_a_bottom(mission, lambda age: SMALL * ages(age)[:, None] * np.eye(2)[place], begin_s)
    if kind == kernels.STATE:
        return altered(mission, "imu", lambda v: v + SMALL * np.eye(6)[place], begin_s)
    if kind == kernels.SCALE:
        stream = mission.streams["dvl"]
        value = stream.value * (1.0 + SMALL * (stream.time_s >= begin_s))[:, None]
        return mission.with_stream("dvl", nf.Stream(stream.time_s, value, stream.columns))
    stream = mission.streams["compass"]
    age = stream.time_s - begin_s
    off = SMALL * np.where(age >= 0.0, age if kind == kernels.RAMP else 1.0, 0.0)
    return mission.with_stream("compass", nf.Stream(stream.time_s, stream.value + off[:, None], stream.columns))


@functools.cache
def quiet_dive():
    """Nothing errs: what a fault does to a gain and to a Jacobian, times an innovation, is nothing."""
    vehicle = survey_vehicle()
    silent = vehicle.with_error(**dict.fromkeys(("gyro", "accel", *vehicle.sensors), nf.White(sd=1e-9)))
    fixes = {"gps": Faults(available=((0.0, DIVE_S),))}
    return vehicle, simulate(silent, survey(150.0, surface_s=110.0), seed=8, duration_s=150.0, faults=fixes)


@pytest.mark.parametrize(
    ("kind", "place", "within"),
    [
        (kernels.STEP, 0, 1e-3),
        (kernels.RAMP, 0, 1e-3),
        (kernels.FLOW_STEP, 0, 5e-3),
        (kernels.FLOW_RAMP, 1, 2e-2),  # so much is left to the estimated heading
        (kernels.STATE, 0, 1e-2),  # it begins with a sample, not with a reading
        (kernels.STATE, 2, 1e-2),
        (kernels.STATE, 3, 1e-2),
        (kernels.SCALE, 0, 5e-2),  # it goes by the velocity of before, held within what is known
    ],
)
def test_what_a_fault_does_is_what_the_filter_makes_of_it(kind, place, within):
    """D and J against finite differences of state and score: the share that is missing, D in sds of the state."""
    vehicle, mission = quiet_dive()
    window = kernels.WINDOWS - 1
    nav, _ = fly(vehicle, mission)
    bank, drive = nav.filter.memory.monitor.bank, nav.filter.layout.drive
    onsets, table, D, s, J = fault_bank.parts(bank)[:5]
    assert onsets[window] < 70.0  # the longest window begins when the start is confirmed
    # a reading of the compass begins it, and those of the DVL at the same time follow
    first_s = onsets[window] + (-1e-6 if kind in (kernels.FLOW_STEP, kernels.FLOW_RAMP, kernels.SCALE) else 1e-6)
    faulty, _ = fly(vehicle, _with_fault(mission, kind, place, first_s))
    own = place if kind != kernels.STATE else drive.start + int(drive.biases[place][0])
    signature = next(k for k, row in enumerate(table) if row[kernels.KIND] == kind and row[kernels.PLACE] == own)
    column, sd = kernels.signatures_of(bank, window)[2] + signature, np.sqrt(np.diag(nav.filter.memory.P)[:9])
    done = D[:9, column]
    moved = nav.state.minus(faulty.state)[:9] / SMALL  # errors are what is true less what is estimated
    assert np.linalg.norm((moved - done) / sd) < within * np.linalg.norm(done / sd)
    told = (fault_bank.parts(faulty.filter.memory.monitor.bank)[3] - s)[column] / SMALL
    assert told == pytest.approx(J[column, column], rel=within)


def _random_bank(rng, n=14, channels=2):
    kinds = [
        (0, 0, 0, 1),
        (1, 0, 0, 1),
        (2, 1, 0, 2),
        (2, 1, 1, 0),
        (3, 1, 0, 2),
        (3, 1, 1, 0),
        (4, -1, 11, 1),
        (5, -1, 10, 1),
        (7, 0, 0, 1),
    ]
    from_start = [(4, -1, 6, 3), (4, -1, 7, 0), (4, -1, 8, 0), *((6, 1, i, (3, 0, 0, 1, 3, 0, 0)[i]) for i in range(7))]
    c, f = len(kinds), len(from_start)
    kinds += from_start
    bank = np.zeros(kernels.ONSETS)
    bank[[kernels.SIGNATURES, kernels.STATES, kernels.CHANNELS, kernels.BEGUN]] = c, n, channels, f
    bank[kernels.LOOKS] = rng.integers(0, 64)
    bank[kernels.RATE_SD] = 0.1
    bank = np.concatenate([bank, np.zeros(naive.places(bank)[-1] - kernels.ONSETS + 40 * naive.width(bank))])
    onsets, table, D, s, J, more, heard = naive._bank(bank)
    onsets[:] = rng.uniform(0.0, 90.0, len(onsets))
    for row, (kind, channel, place, together) in zip(table, kinds, strict=True):
        row[:] = kind, channel, place, rng.uniform(0.5, 2.0), -12.0, together, 2.0
    D[:], s[:], J[:], more[:] = rng.normal(size=D.shape), rng.normal(size=len(s)), spd(rng, len(s)), 0.1
    heard[:] = rng.uniform(0.5, 2.0, heard.shape)
    heard[0, kernels.SUMS + 1 : kernels.SUMS + kernels.AXES] = 0.0
    return bank


@pytest.mark.parametrize("seed", range(6))
def test_the_kernels_and_their_twins(seed):
    rng = np.random.default_rng(seed)
    bank, n, a = _random_bank(rng), 14, (1, 3, 1, 3, 1, kernels.AXES + 1)[seed]
    size = kernels.places(bank)[-1]
    assert kernels.places(bank) == naive.places(bank)

    def same(kernel, *args, rtol=1e-10):
        ours, twins = run_both(kernel, bank, *args)
        assert_close(
            [ours[0][:size], *(x for x in ours[1:] if isinstance(x, np.ndarray))],
            [twins[0][:size], *(x for x in twins[1:] if isinstance(x, np.ndarray))],
            rtol,
        )

    same(kernels.carry, rng.normal(size=(11, 11)), 0)
    same(kernels.carry, rng.normal(size=(2, 2)), 12)
    same(kernels.begin_window, seed + 1, 100.0)
    same(kernels.forget, 5 * seed)
    assert kernels.width(bank) == naive.width(bank)
    assert kernels.signatures_of(bank, seed + 1) == naive.signatures_of(bank, seed + 1)
    for k in (0, 1, 2, 4, 6, 7, 8):
        same(kernels.judged, seed, k, 95.0, np.zeros(5), rtol=1e-9)
    for k in (9, 12, 15, 16):
        same(kernels.judged, kernels.WINDOWS, k, 95.0, np.zeros(5), rtol=1e-9)
    dims = np.array([a, n, 11, 2, 12, 2, 0, 0])
    at = np.array(kalman.memory_offsets(dims))
    mem = rng.normal(size=at[-1])
    S = spd(rng, a)
    mem[at[5] : at[5] + 2 * a * a] = np.vstack([S, np.linalg.inv(S)]).ravel()
    mem[at[8] + 3 + a : at[8] + 3 + 2 * a] = np.diag(S)
    if seed == 1:
        mem[at[8] + 3 + a] = np.nan  # a component that is left out
    PH, heard = spd(rng, n, 0.01) @ mem[at[0] : at[0] + a * n].reshape(a, n).T, naive._bank(bank)[6]
    mem[at[6] : at[6] + a * n], mem[at[8]] = PH.T.ravel(), 40.0
    for value, limit, used in ((1.0, 9.0, True), (math.nan, 9.0, True), (1.0, 9.0, False), (1.0, 0.0, False)):
        seen = rng.normal(size=(a, 9)), random_nav(rng), rng.normal(size=6), 0.5
        same(kernels.take_reading, mem, dims, at, *seen, seed % 2, 95.0, value, limit, used)
    heard[:, kernels.REFUSED] = 0.0
    for value in (1.0, heard[seed % 2, kernels.VALUE]):  # the first that is refused, and one that comes again
        same(kernels.take_reading, mem, dims, at, *seen, seed % 2, 95.0, value, 50.0, False)
    assert kernels.likeliest(bank, seed, 95.0) == pytest.approx(naive.likeliest(bank, seed, 95.0), rel=1e-9)
    for component in range(7):
        moving = random_nav(rng), rng.normal(size=3), rng.normal(size=6)
        ours, twins = run_both(kernels.description_slope, component, *moving, np.zeros(3))
        assert_close([ours[-1]], [twins[-1]], 1e-12)
    ours, twins = bank.copy(), bank.copy()
    assert kernels.look(ours, 100.0) == pytest.approx(naive.look(twins, 100.0), rel=1e-9)
    assert_close([ours[:size]], [twins[:size]], 1e-9)


def test_an_estimated_error_is_fed_back_as_its_twin_does():
    rng = np.random.default_rng(3)
    ours, twins = run_both(kalman.feed_back, random_nav(rng), rng.normal(size=4), rng.normal(size=13) * 1e-2)
    assert_close(ours, twins, 1e-12)


def test_conditioning_is_that_of_a_filter_that_had_the_fault_as_a_state_from_its_onset():
    """Friedland (1969): D, J and s hold all that the readings say of the size."""
    rng = np.random.default_rng(4)
    n, a, V = 11, 2, 0.3
    bank = _random_bank(rng, n, 1)
    for window in range(kernels.WINDOWS):
        kernels.begin_window(bank, window, 0.0)
    table = naive._bank(bank)[1]
    table[:9, kernels.CHANNEL], table[9:, kernels.CHANNEL], table[6, kernels.PLACE] = (
        [0, 0, 5, 5, 5, 5, -1, -1, 5],
        5,
        9,
    )
    naive._bank(bank)[6][:] = 0.0
    naive._bank(bank)[6][:, kernels.SQUARE] = 1.0
    x, P, size = np.zeros(n), spd(rng, n), 0.7
    wide, big = np.zeros(n + 1), np.block([[P, np.zeros((n, 1))], [np.zeros((1, n)), np.full((1, 1), V)]])
    dims = np.array([a, n, n, 0, n, 0, 0, 0])
    at = np.array(kalman.memory_offsets(dims))
    for k in range(25):
        Phi, Q = np.eye(n) + 0.1 * rng.normal(size=(n, n)), spd(rng, n, 1e-3)
        H, R, F = rng.normal(size=(a, n)), spd(rng, a), np.array([1.0, 0.0])
        kernels.carry(bank, Phi, 0)
        x, P = Phi @ x, Phi @ P @ Phi.T + Q
        grown = np.block([[Phi, np.zeros((n, 1))], [np.zeros((1, n)), np.eye(1)]])
        wide, big = grown @ wide, grown @ big @ grown.T
        big[:n, :n] += Q
        z = H @ rng.normal(size=n) + F * size + rng.normal(size=a)
        S = H @ P @ H.T + R
        K, y = P @ H.T @ np.linalg.inv(S), z - H @ x
        mem = np.zeros(at[-1])
        mem[at[0] : at[1]], mem[at[1] : at[2]] = H.ravel(), K.ravel()
        mem[at[5] : at[6]] = np.vstack([S, np.linalg.inv(S)]).ravel()
        mem[at[8] : at[8] + 3 + 2 * a] = [1.0, a, 1.0, *y, *np.diag(S)]
        moving = random_nav(rng), np.zeros(6), 0.0
        kernels.take_reading(bank, mem, dims, at, np.zeros((a, 9)), *moving, 0, float(k + 1), 1.0, 9.0, True)
        x, P = x + K @ y, P - K @ S @ K.T
        whole = np.column_stack([H, F])
        gain = big @ whole.T @ np.linalg.inv(whole @ big @ whole.T + R)
        wide, big = wide + gain @ (z - whole @ wide), big - gain @ whole @ big
    _, _, D, s, J, _, _ = naive._bank(bank)
    M = 1.0 / (J[0, 0] + 1.0 / V)
    m = M * s[0]
    assert_close([x + D[:, 0] * m, P + M * np.outer(D[:, 0], D[:, 0])], [wide[:n], big[:n, :n]], 1e-9)
    assert_close([np.array([m, M])], [np.array([wide[n], big[n, n]])], 1e-9)
