"""Error models of gyros and accelerometers, learnt while the vehicle stands still."""

import dataclasses
import itertools
import lzma
import math

import numpy as np
import pytest
import same_runs
from feeding import DRIVE, delayed, events_of, in_blocks, one_by_one

import navfilter as nf
from navfilter.io.vehicle_toml import write_vehicle
from navfilter.io.write import learned_vehicle
from navfilter.learning.axis_learner import Learner
from navfilter.learning.schedule import LearningSchedule
from navfilter.learning.static_recorder import RestRecorder, hand_over
from navfilter.models.error_models import RandomWalk, Sum
from navfilter.models.learned_arma import DEFAULT_ORDERS, learned_part
from navfilter.models.mechanisation import ACCEL_PRIOR, GYRO_PRIOR
from navfilter.models.navigation_drift import Drift
from navfilter.models.window_limits import LONGEST_GAP
from navfilter.simulation.scenarios import dive, stage, survey_vehicle
from navfilter.simulation.simulate import Faults, draw_error, simulate
from navfilter.timeseries.model import ArmaModel, add_arma

RATE_HZ, GRAVITY = 100.0, 9.80665
PERIOD_S = 1.0 / RATE_HZ
LONGEST_BLOCK = 299  # of samples of the drive: up to three seconds, longer than what is judged at once
GYRO_SD, FORCE_SD = 1e-3, 1e-2  # of one sample, as believed
WALK, FORCE_WALK = nf.RandomWalk(density=1e-6, start_sd=1e-4), nf.RandomWalk(density=1e-5, start_sd=1e-2)
GYRO = WALK + nf.LearnedArma(prior=nf.White(sd=GYRO_SD))
FORCE = FORCE_WALK + nf.LearnedArma(prior=nf.White(sd=FORCE_SD))
START = nf.Start(latitude_deg=45.0, longitude_deg=0.0)


def vehicle_of(gyro=GYRO, accel=FORCE, **more):
    return nf.Vehicle(imu=nf.Imu(rate_hz=RATE_HZ, gyro=gyro, accel=accel, **more), sensors={"rest": nf.ZeroVelocity()})


def at_rest(seconds, gyro=None, accel=None, seed=1):
    """Samples of a level unit that stands still: times, rates and forces."""
    n = round(seconds * RATE_HZ)
    models = [gyro or WALK + nf.White(sd=GYRO_SD)] * 3 + [accel or FORCE_WALK + nf.White(sd=FORCE_SD)] * 3
    out = np.column_stack(
        [np.arange(1, n + 1) * PERIOD_S, *(draw_error(m, PERIOD_S, n, seed, "imu", i) for i, m in enumerate(models))]
    )
    out[:, 1] += 7.292e-5 * math.cos(math.radians(45.0))
    out[:, 3] -= 7.292e-5 * math.sin(math.radians(45.0))
    out[:, 6] -= GRAVITY
    return out


def run(vehicle, samples, start=START):
    nav = nf.Navigator(vehicle, start)
    for begin in range(0, len(samples), 700):
        nav.step_samples(samples[begin : begin + 700].copy())
    return nav


def in_force(nav):
    """The learnt models of the six axes; None where the prior still is."""
    return [getattr(learned_part(model), "model", None) for model in nav.filter.in_force.drive.models]


def band_power(model, edges):
    """Mean spectral density of an error model without its random walks in bands of angular frequency per sample."""
    powers = np.zeros(len(edges) - 1)
    for part in model.parts if isinstance(model, Sum) else (model,):
        if isinstance(part, RandomWalk):
            continue
        block = part.block(PERIOD_S)
        powers += block.r
        for i in range(len(powers) if block.size else 0):
            for w in np.linspace(edges[i], edges[i + 1], 101):
                h = np.linalg.solve(np.exp(1j * w) * np.eye(block.size) - block.Phi.T, block.C)
                powers[i] += (h @ block.Q @ h.conj()).real / 101
    return powers


# ---------------------------------------------------------------- what is believed before


@pytest.mark.parametrize("default", [GYRO_PRIOR, ACCEL_PRIOR])
def test_whatever_is_learnt_a_bias_stands_beside_it(default):
    white, walk = default.parts
    axis = 0 if default is GYRO_PRIOR else 3

    def resolved(model):
        return vehicle_of(model, model).drive.models[axis]

    other = nf.RandomWalk(density=3e-6)
    assert resolved(nf.LearnedArma()) == walk + nf.LearnedArma(prior=white)
    assert resolved(other + nf.LearnedArma()) == other + nf.LearnedArma(prior=white)
    assert resolved(nf.White(sd=0.1) + other + nf.LearnedArma()) == nf.White(sd=0.1) + other + nf.LearnedArma(
        prior=nf.White(sd=0.0)
    )
    assert resolved(nf.LearnedArma(prior=nf.White(sd=0.1) + other)) == other + nf.LearnedArma(prior=nf.White(sd=0.1))
    assert resolved(GYRO) == GYRO
    learnt = nf.LearnedArma(model=ArmaModel([-0.5], [], 1e-3))
    assert resolved(learnt) == learnt and resolved(other + learnt) == other + learnt


def test_without_a_learnt_axis_nothing_is_gathered():
    nav = run(vehicle_of(WALK + nf.White(sd=GYRO_SD), FORCE_WALK + nf.White(sd=FORCE_SD)), at_rest(2.0))
    assert nav.learning.rest is None


# ---------------------------------------------------------------- what is learnt

COLOURED = {
    "slow": WALK + nf.Arma(ar=(-0.9,), sd=2e-4) + nf.White(sd=5e-4),
    "swing": WALK + nf.Arma(ar=(-1.6, 0.9), ma=(-0.5,), sd=3e-4) + nf.White(sd=5e-4),
}


@pytest.mark.parametrize("name", COLOURED)
def test_spectrum_of_a_coloured_gyro(name):
    """Within a factor 1.5 in every band of 1 Hz: a band of the 40 s window holds 40 periodogram ordinates, 16 % by
    themselves.
    """
    nav = run(vehicle_of(), at_rest(65.0, COLOURED[name]))
    edges = np.linspace(1e-3, math.pi, 51)
    truth = band_power(COLOURED[name], edges)
    for model, learnt in zip(nav.filter.in_force.drive.models[:3], in_force(nav)[:3], strict=True):
        assert learnt.p >= 1
        ratio = band_power(model, edges) / truth
        assert ratio.min() > 1.0 / 1.5 and ratio.max() < 1.5
        assert known(model) == WALK
    for learnt, model in zip(in_force(nav)[3:], nav.filter.in_force.drive.models[3:], strict=True):
        assert learnt.p + learnt.q == 0 and known(model) == FORCE_WALK
        assert learnt.sd == pytest.approx(FORCE_SD, rel=0.05)


def known(model):
    return next(part for part in model.parts if isinstance(part, RandomWalk))


@pytest.mark.parametrize("gyro", ["tactical", "mems"])
def test_gyro_of_the_thesis_at_rest_before_a_dive(gyro):
    """ARMA(2,2), a line 0.01 Hz wide next to the Nyquist frequency: the line is found, and below it the spectrum is
    right.

    The window holds the line's own correlation time (16 s) two and a half times: its power in the window is anything
    within a factor 3.
    """
    staged = stage("gyro-thesis", motion="transit", gyro=gyro, duration_s=220.0)
    models = staged.vehicle.drive.models
    learnable = tuple(
        known(m) + nf.LearnedArma(prior=next(p for p in m.parts if not isinstance(p, RandomWalk))) for m in models
    )
    track = nf.replay(staged.vehicle.with_error(gyro=learnable[:3], accel=learnable[3:]), staged.mission(1))
    edges = np.linspace(1e-3, math.pi, 51)
    times = [time_s for time_s, _ in track.error_models["gyro"]]
    assert len(times) > 3 and times[-1] < 180.0  # the rest ends there
    for model, true in zip(track.error_models["gyro"][-1][1], staged.truth["gyro"], strict=True):
        ratio = band_power(model, edges) / band_power(true, edges)
        assert ratio[:-3].min() > 1.0 / 1.5 and ratio[:-3].max() < 1.5
        assert ratio[-3:].min() > 1.0 / 3.0 and ratio[-3:].max() < 3.0
        power = band_power(model, edges)
        assert power[-1] > 3.0 * power[:40].max()
    for model in track.error_models["accel"][-1][1]:
        learnt = learned_part(model).model
        assert learnt.p + learnt.q == 0


def test_known_white_noise_beside_is_not_learnt_again():
    white, true = nf.White(sd=5e-4), nf.Arma(ar=(-0.95,), sd=3e-4)
    nav = run(vehicle_of(white + WALK + nf.LearnedArma()), at_rest(65.0, WALK + white + true))
    for model, learnt in zip(nav.filter.in_force.drive.models[:3], in_force(nav)[:3], strict=True):
        assert model.parts[0] == white
        assert learnt.sd == pytest.approx(3e-4, rel=0.15)
        # S(0) of 40 s with a correlation time of 0.2 s is known to about a quarter, and says so
        level = math.log(0.5 * learnt.spectrum(0.0, 1.0) / (3e-4 / 0.05) ** 2)
        assert 0.1 < learnt.sd_log_s0 < 0.4 and abs(level) < 3.0 * learnt.sd_log_s0


def test_increments_are_learnt_as_rates():
    samples = at_rest(30.0, COLOURED["slow"])
    rates = run(vehicle_of(), samples)
    samples[:, 1:] *= PERIOD_S
    increments = run(vehicle_of(increments=True), samples)
    for one, two in zip(in_force(rates), in_force(increments), strict=True):
        assert one.p == two.p and one.q == two.q
        np.testing.assert_allclose(two.ar, one.ar, atol=1e-6)
        assert two.sd == pytest.approx(one.sd, rel=1e-6)


# ---------------------------------------------------------------- a slow pole is the bias


def test_power_that_drives_a_pole_is_that_of_its_part():
    from navfilter.learning.static_recorder import _driving_variance

    both = add_arma([ArmaModel([-0.9995], [], 0.01), ArmaModel([-1.2, 0.7], [0.3], 1.0)])
    assert _driving_variance(both, 0.9995) == pytest.approx(1e-4, rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("density", [1e-4, 3e-4])
def test_a_walk_larger_than_believed_goes_to_the_bias(density, seed):
    """No second bias among the ARMA states: the random walk takes it, and what is left is the white noise."""
    rng, drift = np.random.default_rng(seed), Drift((1e-6,), PERIOD_S)
    y = np.cumsum(rng.normal(size=4000) * density * math.sqrt(PERIOD_S)) + GYRO_SD * rng.normal(size=4000)
    found = Learner(DEFAULT_ORDERS, 4000, drift).hop(y).model
    assert abs(found.poles).max() > 1.0 - 10.0 / 4000
    left, model = hand_over(found, GYRO, y, drift, 0.0)
    assert left.p + left.q == 0 and left.sd == pytest.approx(GYRO_SD, rel=0.05)
    # 40 s of a walk: its density is known to a factor
    assert 0.5 < known(model).density / density < 2.5 and known(model).start_sd == WALK.start_sd


def test_a_pole_beyond_the_window_is_never_adopted_beside_a_bias():
    """The likelihood would not mind: a pole as near to 1 as the cap of 4000 samples is handed over whatever it says."""
    rng, drift = np.random.default_rng(4), Drift((1e-6,), PERIOD_S)
    y = GYRO_SD * rng.normal(size=4000)
    found = add_arma([ArmaModel([-(1.0 - 3.0 / 4000)], [], 1e-5), ArmaModel([], [], GYRO_SD)])
    left, model = hand_over(found, GYRO, y, drift, 0.0)
    assert left.p + left.q == 0 and known(model).density == pytest.approx(
        math.hypot(1e-6, 1e-5 / math.sqrt(PERIOD_S)), rel=1e-6
    )


def test_a_time_constant_that_the_window_holds_often_stays():
    true = ArmaModel([-0.99], [], 2e-4)
    y = nf.simulate_arma(true.ar, true.ma, true.sd, 4000, seed=2)
    left, model = hand_over(true, GYRO, y, Drift((1e-6,), PERIOD_S), 0.0)
    assert left is true and model is GYRO


def test_an_axis_is_white_or_coloured_and_not_both():
    """Of colour that 4000 samples hardly show."""
    gyro, accel = (walk + nf.Arma((-0.05,), (), sd) for walk, sd in ((WALK, GYRO_SD), (FORCE_WALK, FORCE_SD)))
    nav = run(vehicle_of(), at_rest(65.0, gyro, accel))
    parts = [learned_part(model) for model in nav.filter.in_force.drive.models]
    assert {part.model.p for part in parts} == {0, 1}
    assert all(part.slow is None for part in parts)


def test_the_bias_follows_an_adoption_of_another_walk():
    """Its estimate and variance stay; only how it wanders from now on changes."""
    nav = run(vehicle_of(), at_rest(3.0))
    place = nav.filter.layout.names.index("gyro_z[0]")
    nav.filter.x[place] = 3e-5
    before = nav.filter.x[place], nav.filter.P[9 + place, 9 + place]
    nav.adopt("gyro", nf.RandomWalk(density=5e-5, start_sd=1e-4) + nf.LearnedArma(model=ArmaModel([-0.5], [], 1e-3)))
    place = nav.filter.layout.names.index("gyro_z[0]")
    assert nav.filter.x[place] == before[0]
    assert nav.filter.P[9 + place, 9 + place] == pytest.approx(before[1], rel=1e-3)


# ---------------------------------------------------------------- what is rest


@pytest.mark.parametrize("gyro", ["tactical", "mems"])
@pytest.mark.parametrize("aided", [True, False])
def test_nothing_is_learnt_while_it_moves(gyro, aided):
    """Turns, dives and straight legs, with a DVL, and by inertia and depth alone, where only the samples tell."""
    staged = stage("gyro-thesis", motion="lawnmower", gyro=gyro, duration_s=500.0)
    mission = staged.mission(1)
    speed = np.linalg.norm(mission.truth.value[:, 3:6], axis=1)
    moving = mission.truth.time_s[speed > 0.1]
    vehicle = staged.vehicle if aided else staged.vehicle.without("dvl", "gps", "compass")
    vehicle = vehicle.with_error(
        gyro=nf.LearnedArma(prior=vehicle.drive.models[0]), accel=nf.LearnedArma(prior=vehicle.drive.models[3])
    )
    nav, events = nf.Navigator(vehicle, mission.start, history_s=0.0), events_of(vehicle, mission)
    kept = []
    for begin, end in ((-1.0, moving[0] + 1.0), (moving[0] + 1.0, moving[-1])):
        in_blocks(
            nav, [event for event in events if begin < event.time_s <= end], np.random.default_rng(0), LONGEST_BLOCK
        )
        kept.append(nav.learning.rest.memory.cursor)
    assert moving[-1] - moving[0] > 250.0 and (kept[0] > 10_000 or not aided)
    assert kept[1] == kept[0]


@pytest.mark.parametrize(("speed", "speed_sd", "kept"), [(0.0, 0.02, 8), (1.0, 0.02, 0), (0.0, 0.5, 0), (1.0, 0.5, 0)])
def test_calm_water_looks_like_rest_unless_the_velocity_is_known(speed, speed_sd, kept):
    start = nf.Start(
        latitude_deg=45.0, longitude_deg=0.0, velocity_n=(speed, 0.0, 0.0), velocity_sd_m_s=speed_sd, tilt_sd_deg=0.02
    )
    assert run(vehicle_of().without("rest"), at_rest(10.0), start).learning.rest.memory.cursor == 100 * kept


def kept_by(still, samples, speed=0.0, error=((0.0,) * 3,) * 2):
    """Straight into the collector, one second after the other; which seconds have been kept. error: of the gyros."""
    before = np.r_[0.0, samples[:-1, 0]]
    steps = np.column_stack([samples[:, 0] - before, samples[:, 1:]])
    kept = []
    for begin in range(0, len(steps) - 99, 100):
        cursor = still.memory.cursor
        still.note(steps[begin : begin + 100])
        still.close(np.array([[speed] * 3, [0.01] * 3]), np.array(error))
        kept.append(still.memory.cursor - cursor)
    return kept


def test_a_second_counts_between_two_others_at_rest():
    samples = at_rest(12.0)
    samples[600:700, 2] += 0.05 * np.sin(np.arange(100.0))
    kept = kept_by(RestRecorder(vehicle_of().drive, 2.0), samples)
    # the first of a run never, the second when the third has passed; a new run begins behind a gap that ends a segment
    assert kept == [0, 0, 100, 100, 100, 100, 0, 0, 0, 100 + LONGEST_GAP + 1, 100, 100]
    still = RestRecorder(vehicle_of().drive, 2.0)
    kept_by(still, samples)
    y = still.series(1, 4000)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(y)), 400 + np.arange(LONGEST_GAP + 1))
    np.testing.assert_array_equal(y[:400], samples[100:500, 2])
    np.testing.assert_array_equal(y[409:], samples[800:1100, 2])


def test_a_second_in_which_samples_are_missing_is_no_rest():
    samples = at_rest(8.0)
    samples[420, 1:] = np.nan
    kept = kept_by(RestRecorder(vehicle_of().drive, 2.0), samples)
    assert kept == [0, 0, 100, 100, 0, 0, 0, 100 + LONGEST_GAP + 1]


@pytest.mark.parametrize("column", range(1, 7))
def test_any_axis_that_moves_is_no_rest(column):
    samples = at_rest(6.0)
    size = 3.5 * math.sqrt(2.0) * (GYRO_SD if column < 4 else FORCE_SD)
    samples[:, column] += size * np.sin(2.0 * math.pi * samples[:, 0])
    assert kept_by(RestRecorder(vehicle_of().drive, 2.0), samples) == [0] * 6


def test_a_steady_turn_or_a_speed_is_no_rest():
    samples = at_rest(6.0)
    assert kept_by(RestRecorder(vehicle_of().drive, 2.0), samples, speed=0.2) == [0] * 6
    samples[:, 3] += 0.03
    assert kept_by(RestRecorder(vehicle_of().drive, 2.0), samples) == [0] * 6


def test_an_estimate_of_a_gyro_excuses_a_rate_and_makes_none():
    """Where nothing tells the heading, the estimate of a gyro may be anything: by itself it is no turn."""
    samples, bias = at_rest(6.0), np.array([[0.0, 0.0, 0.06], [0.001, 0.001, 0.008]])
    assert kept_by(RestRecorder(vehicle_of().drive, 2.0), samples, error=bias)[2:] == [100] * 4
    samples[:, 3] += bias[0, 2]
    assert kept_by(RestRecorder(vehicle_of().drive, 2.0), samples, error=bias)[2:] == [100] * 4
    samples[:, 3] += 0.05
    assert kept_by(RestRecorder(vehicle_of().drive, 2.0), samples, error=bias) == [0] * 6


def test_a_mean_that_moves_away_begins_another_segment():
    samples = at_rest(12.0)
    samples[500:, 4] += 4.0 * FORCE_SD  # a tilt of 0.23 deg
    kept = kept_by(RestRecorder(vehicle_of().drive, 2.0), samples)
    assert kept == [0, 0, 100, 100, 100, 0, 0, 100 + LONGEST_GAP + 1, 100, 100, 100, 100]


def test_missing_samples_are_missing_ticks():
    samples = at_rest(8.0)
    lost = np.array([250, 251, 315, 470])
    still = RestRecorder(vehicle_of().drive, 2.0)
    kept_by(still, np.delete(samples, lost, axis=0))
    y = still.series(0, 4000)
    first = int(np.flatnonzero(np.isclose(samples[:, 1], y[0], rtol=0, atol=0))[0])
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(y)), lost - first)
    told = ~np.isnan(y)
    np.testing.assert_array_equal(y[told], samples[first : first + len(y), 1][told])


def test_stamps_in_bursts_lose_no_sample():
    samples = at_rest(8.0)
    samples[:, 0] = 0.05 * np.ceil(samples[:, 0] / 0.05 - 1e-9) + 1e-4 * (np.arange(len(samples)) % 5)
    still = RestRecorder(vehicle_of().drive, 2.0)
    kept_by(still, samples)
    y = still.series(0, 4000)
    assert np.isfinite(y).sum() == 600 and len(y) < 700


def test_a_silence_ends_the_rest():
    samples = at_rest(8.0)
    still = RestRecorder(vehicle_of().drive, 2.0)
    kept = kept_by(still, np.delete(samples, np.arange(420, 440), axis=0))
    assert kept == [0, 0, 100, 100, 0, 0, 0]


# ---------------------------------------------------------------- one run, however it is fed

SMALL = {"orders": ((0, 0), (1, 0), (1, 1)), "window": 1000, "hop": 400}


@pytest.fixture(scope="module")
def survey():
    """40 s of rest, then a dive; compass learnt as well, with the beginning done again at 30, 60 and 120 s."""
    plain = survey_vehicle()
    mission = simulate(
        plain,
        dive(130.0, None, (10.0, 45.0), 5.0, 40.0),
        duration_s=130.0,
        seed=3,
        faults={"gyro": Faults(true_error=plain.drive.models[0] + nf.Arma(ar=(-0.9,), sd=5e-4))},
    )
    gyro, accel = plain.drive.models[0], plain.drive.models[3]

    def learnable(model):
        return model.parts[1] + nf.LearnedArma(prior=model.parts[0] + nf.GaussMarkov(sd=2e-3, tau_s=0.1), **SMALL)

    vehicle = plain.with_error(gyro=learnable(gyro), accel=learnable(accel))
    compass = nf.LearnedArma(prior=plain.sensors["compass"].error, window=400, hop=50, orders=((1, 0), (1, 1)))
    return vehicle, vehicle.with_error(compass=compass), mission, events_of(vehicle, mission)


def run_of(vehicle, mission, events, **options):
    nav = nf.Navigator(vehicle, mission.start, **options)
    one_by_one(nav, events)
    return nav


def blocks_of(vehicle, mission, events, seed, history_s):
    nav = nf.Navigator(vehicle, mission.start, history_s=history_s)
    in_blocks(nav, events, np.random.default_rng(seed), LONGEST_BLOCK)
    return nav


def assert_same_bits(one, two):
    same_runs.assert_same_bits(one, two)
    assert one.learning.rest.memory.cursor == two.learning.rest.memory.cursor
    np.testing.assert_array_equal(two.learning.rest.series(0, 1000), one.learning.rest.series(0, 1000))


def test_one_by_one_and_in_blocks_are_the_same_bits(survey):
    _, vehicle, mission, events = survey
    live = run_of(vehicle, mission, events)
    assert live.counts["adopted"] >= 2 and live.learning.rest.memory.cursor > 3000
    assert all(model is not None for model in in_force(live))
    # the rare corrections alone leave blocks longer than a second
    rare = [event for event in events if event.sensor in (DRIVE, "depth")]
    few = survey[0].without("compass", "dvl", "gps")
    one = run_of(few, mission, rare, history_s=0.0)
    for seed, history_s in ((0, 0.0), (1, 2.0)):
        assert_same_bits(one, blocks_of(few, mission, rare, seed, history_s))
    assert_same_bits(live, blocks_of(vehicle, mission, events, 2, 0.0))


def test_the_beginning_is_done_again_with_what_was_learnt_at_rest(survey, monkeypatch):
    """The compass's first models come at 30 s; the unit's, learnt by then, are in force from the start of the second
    pass.
    """
    monkeypatch.setattr(LearningSchedule, "ANOTHER", 0.0)  # whatever the compass's model is, it is another one
    _, vehicle, mission, events = survey
    tape = nf.Tape()
    run_of(vehicle, mission, events, tape=tape)
    begun_s, error = tape.models["compass"][0]
    models = error if isinstance(error, tuple) else (error,)
    assert begun_s == mission.start.time_s and learned_part(models[0]).model is not None
    first_s, first = tape.models["gyro"][0]
    assert first_s == mission.start.time_s
    assert all(learned_part(model).model is not None for model in first)


def test_snapshots_go_on_bit_for_bit(survey):
    _, vehicle, mission, events = survey
    whole = run_of(vehicle, mission, events)
    nav = nf.Navigator(vehicle, mission.start)
    places = [0, 1, 950, 1804, 2777, 5000, 12000, len(events)]
    for begin, end in itertools.pairwise(places):
        one_by_one(nav, events[begin:end])
        nav = nf.Navigator.restore(vehicle, nav.snapshot())
    assert_same_bits(whole, nav)


def test_late_readings_change_nothing(survey):
    """Of depth and compass three in ten come up to 1.9 s late, at rest as well: the run goes back over adoptions and
    samples at rest.
    """
    vehicle, _, mission, events = survey
    events = [event for event in events if event.time_s < 32.0]
    late = delayed(events, ("depth", "compass"), 1.9, seed=1, share=0.3)
    one = run_of(vehicle, mission, events)
    two = run_of(vehicle, mission, late)
    assert one.counts["adopted"] > 4 and one.counts == two.counts
    assert one.learning.rest.memory.cursor == two.learning.rest.memory.cursor
    np.testing.assert_allclose(two.filter.x, one.filter.x, rtol=0, atol=1e-9)
    for a, b in zip(in_force(one), in_force(two), strict=True):
        np.testing.assert_array_equal(b.ar, a.ar)


def test_replay_with_smoothing_over_the_adoptions(survey):
    vehicle, _, mission, _ = survey
    track = nf.replay(vehicle, mission, smooth=True, output_rate_hz=None)
    forward = track.forward
    assert len(forward.error_models["gyro"]) > 2 and forward.error_models["gyro"][0][0] == mission.start.time_s
    adopted_s = forward.error_models["gyro"][1][0]
    assert 4.0 < adopted_s < 40.0
    assert np.isfinite(track.covariance).all() and np.all(track.states_sd[np.isfinite(track.states_sd)] >= 0.0)
    # the prior has two states per axis, the bias and a Gauss-Markov process; what is learnt may have more
    grown = [i for i, name in enumerate(track.state_names) if name == "gyro_x[2]"]
    for i in grown:
        assert (
            np.isnan(track.states[track.time_s < adopted_s, i]).all()
            and np.isfinite(track.states[track.time_s > adopted_s + 0.1, i]).any()
        )
    bias = track.state_names.index("gyro_x[0]")
    assert np.isfinite(track.states[:, bias]).all()
    assert np.all(track.states_sd[:, bias] <= forward.states_sd[:, bias] * (1.0 + 1e-9))


# ---------------------------------------------------------------- a unit that really stood still


def recorded_run(rates, forces):
    """As its operator would describe it: half as much white noise again as there is, a bias, zero-velocity updates."""
    forces = forces - forces[:2000].mean(axis=0) + np.array([0.0, 0.0, -GRAVITY])
    vehicle = nf.Vehicle(
        imu=nf.Imu(
            rate_hz=RATE_HZ,
            gyro=nf.RandomWalk(density=1e-6, start_sd=0.05)
            + nf.LearnedArma(prior=nf.White(sd=1.5 * rates.std(axis=0).mean())),
            accel=nf.RandomWalk(density=1e-5, start_sd=0.05)
            + nf.LearnedArma(prior=nf.White(sd=1.5 * forces.std(axis=0).mean())),
        ),
        sensors={"rest": nf.ZeroVelocity(gyro_sd_max=0.02, force_sd_max=0.2, gyro_mean_max=0.1)},
    )
    nav = run(vehicle, np.column_stack([np.arange(1, len(rates) + 1) * PERIOD_S, rates, forces]))
    assert nav.learning.rest.memory.cursor > 0.8 * len(rates)
    return nav


def test_a_recorded_unit_that_is_white(data_file):
    path = data_file("imu-mpu6050-raw-static/mpu6050_static_450s.csv.xz")
    with lzma.open(path, "rt") as file:
        counts = np.loadtxt(file, delimiter=",", skiprows=5, max_rows=12_000)
    rates, forces = np.radians(counts[:, 3:] / 131.0), counts[:, :3] / 16384.0 * GRAVITY
    for axis, model in enumerate(in_force(recorded_run(rates, forces))):
        assert model.p + model.q == 0
        assert model.sd == pytest.approx(np.column_stack([rates, forces])[-4000:, axis].std(), rel=0.1)


def test_a_recorded_unit_that_is_nearly_white(data_file):
    """Its filter leaves a lag-1 autocorrelation of 0.17 in gyro x: that, and little more, is found."""
    data = np.load(data_file("imu-adis16405-static/adis16405_unit1.npz"))
    values = data["counts"][:12_000] * data["scale"]
    model = in_force(recorded_run(np.radians(values[:, :3]), values[:, 3:] * GRAVITY))[0]
    assert 0.1 < model.autocovariance(1)[1] / model.autocovariance(1)[0] < 0.25
    assert 1.0 - model.sd**2 / model.variance < 0.08


def test_what_is_learnt_of_the_unit_drives_the_other_sensors_series_as_white_noise():
    """A dive that begins with learnt gyros: heading and velocity wander by their S(0), not by the innovation of every
    sample.
    """
    white, sd = GYRO_SD * math.sqrt(PERIOD_S), 4e-4
    for model in (ArmaModel([], [], GYRO_SD), ArmaModel([-0.6], [], sd), ArmaModel([0.6], [0.3], sd)):
        learnt = WALK + nf.LearnedArma(model=model)
        plain = WALK + nf.White(density=math.sqrt(0.5 * model.spectrum(0.0, 1.0) * PERIOD_S))
        for one, two in zip(drifts(learnt), drifts(plain), strict=True):
            np.testing.assert_allclose(one.density, two.density, rtol=1e-12)
            np.testing.assert_allclose(one.start_sd, two.start_sd, rtol=1e-12)
    assert drifts(WALK + nf.White(sd=GYRO_SD))[0].density == pytest.approx((white, WALK.density))


def drifts(gyro):
    sensors = {"compass": nf.Heading(rate_hz=8), "dvl": nf.BodyVelocity(rate_hz=4), "gps": nf.Position(rate_hz=1)}
    vehicle = nf.Vehicle(
        imu=nf.Imu(rate_hz=RATE_HZ, gyro=gyro, accel=FORCE_WALK + nf.White(sd=FORCE_SD)), sensors=sensors
    )
    return [sensor.drift(vehicle.drive, 0, 0.0) for sensor in sensors.values()]


def test_the_next_dive_begins_with_what_was_learnt(tmp_path):
    """Through vehicle_learned.toml; a frozen model is not learnt again."""
    staged = stage("gyro-thesis", motion="transit", duration_s=200.0)
    mission, models = staged.mission(2), staged.vehicle.drive.models
    vehicle = staged.vehicle.with_error(gyro=nf.LearnedArma(prior=models[0], window=1000))
    track = nf.replay(vehicle, mission)
    learnt = learned_vehicle(track)
    again = nf.read_vehicle(write_vehicle(learnt, tmp_path / "vehicle_learned.toml"))
    for axis in range(3):
        one, two = learnt.drive.models[axis], again.drive.models[axis]
        np.testing.assert_array_equal(one.block(PERIOD_S).Phi, two.block(PERIOD_S).Phi)
        np.testing.assert_array_equal(one.block(PERIOD_S).Q, two.block(PERIOD_S).Q)
    nav = nf.Navigator(again, mission.start)
    assert nav.learning.rest is not None and all(model is not None for model in in_force(nav)[:3])
    fixed = again.with_error(
        gyro=tuple(known(m) + dataclasses.replace(learned_part(m), frozen=True) for m in again.drive.models[:3])
    )
    assert nf.Navigator(fixed, mission.start).learning.rest is None
