"""What is learnt while the vehicle moves and turns: is it the sensor's error, is the filter honest with it, and does it
follow a change?

One kind of mission for most of it: a survey vehicle on a lawnmower, all its correcting sensors erring in colours that
the half hour can show (their correlation times are short beside the time after which the inertial drift is larger than
the error), all four learnt at once from beliefs of white noise or a wrong Gauss-Markov process.
"""

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
import same_runs
from feeding import delayed, events_of, in_blocks, one_by_one
from scipy.stats import chi2

import navfilter as nf
from navfilter.evaluation.montecarlo.campaign import Campaign, run_seed
from navfilter.evaluation.montecarlo.scores import SCORES
from navfilter.learning.axis_learner import Learner
from navfilter.learning.learned_model import LearnedModel
from navfilter.learning.open_loop_series import without_spikes
from navfilter.learning.schedule import LearningSchedule
from navfilter.models.error_models import block_level
from navfilter.models.learned_arma import DEFAULT_ORDERS, learned_part
from navfilter.models.spectrum import Spectrum
from navfilter.playback.replay import residual_series
from navfilter.simulation.manoeuvres import Lawnmower
from navfilter.simulation.scenarios import SCENARIOS, USUAL, dive, stage, survey_vehicle
from navfilter.simulation.simulate import Changing, Faults, simulate
from navfilter.timeseries.model import ArmaModel

DEG = np.pi / 180.0
GYROS = ("tactical", "mems")
TRUE = {
    "compass": nf.GaussMarkov(sd=0.5 * DEG, tau_s=10.0, order=2),
    "dvl": nf.GaussMarkov(sd=0.02, tau_s=2.0) + nf.White(sd=0.006),
    "depth": nf.GaussMarkov(sd=0.05, tau_s=4.0) + nf.White(sd=0.02),
    "gps": nf.GaussMarkov(sd=2.0, tau_s=6.0),
}
BELIEF = {
    "compass": nf.GaussMarkov(sd=0.6 * DEG, tau_s=30.0) + nf.White(sd=0.1 * DEG),
    "dvl": nf.White(sd=0.03),
    "depth": nf.White(sd=0.1),
    "gps": nf.White(sd=3.0),
}
# the answer of the last hop, at 1500 s, is taken some seconds later
DURATION_S, SCORED_S = 1510.0, 560.0
#: One mission of each kind always, six with ``-m slow``.
ONE, ALL = range(1), range(6)
#: Of the power that the filter takes over the true one: a micromechanical gyro hides more of the low frequencies.
BARS = {"tactical": (0.6, 1.7), "mems": (0.4, 2.5)}


@cache
def described(gyro):
    plain = survey_vehicle(mems=gyro == "mems")
    sensors = dict(plain.sensors)
    for name in ("gps", "depth"):  # a thousand readings in the time of a window
        sensors[name] = replace(sensors[name], rate_hz=4.0)
    return nf.Vehicle(replace(plain.drive, rate_hz=25.0), sensors).with_error(**BELIEF)


def learns(vehicle):
    return vehicle.with_error(**{name: nf.LearnedArma(prior=BELIEF[name]) for name in TRUE})


@cache
def mission_of(gyro, seed, duration_s=DURATION_S):
    """Fixes all the time, so that their error can be learnt."""
    motion = dive(duration_s, lambda legs: (Lawnmower(legs, 60.0),), (45.0, 45.0), 10.0, 20.0)
    faults = {name: Faults(true_error=error) for name, error in TRUE.items()}
    return simulate(described(gyro), motion, seed=seed, duration_s=duration_s, faults=faults)


@dataclass(frozen=True)
class Run:
    history: dict  # sensor -> [(time_s, models by axis), ...]
    squared: dict  # track -> mean squared heading error, scored part
    nees: dict  # track -> mean NEES of the heading, scored part


def adopted(track, sensor):
    """When, and what is learnt by axis (None while the prior is in force)."""
    found = []
    for time_s, models in track.error_models[sensor]:
        parts = [learned_part(model) for model in (models if isinstance(models, tuple) else (models,))]
        found.append((time_s, [part if part is not None and part.model is not None else None for part in parts]))
    return found


def density(error, frequency_hz, period_s):
    """One-sided spectrum of an error model through its block [unit^2/Hz]."""
    block = error.block(period_s)
    z = np.exp(2j * np.pi * np.asarray(frequency_hz) * period_s)
    gains = np.array([block.C @ np.linalg.inv(each * np.eye(block.size) - block.Phi) for each in z])
    power = np.real(np.einsum("ni,ij,nj->n", gains, block.Q, gains.conj())) if block.size else 0.0
    return 2.0 * period_s * (power + block.r)


def heading_figures(track, mission, begin_s):
    errors = track.errors(mission.truth)
    rows = (track.time_s >= begin_s) & np.isfinite(errors.heading)
    return float(np.mean(errors.heading[rows] ** 2)), float(np.mean(track.nees(errors)["heading"][rows]))


@cache
def run_of(gyro, seed):
    mission = mission_of(gyro, seed)
    smoothed = nf.replay(learns(described(gyro)), mission, smooth=True, output_rate_hz=1.0)
    oracle = nf.replay(described(gyro).with_error(**TRUE), mission, output_rate_hz=1.0)
    figures = {
        name: heading_figures(track, mission, SCORED_S)
        for name, track in (("forward", smoothed.forward), ("smoothed", smoothed), ("oracle", oracle))
    }
    history = {name: adopted(smoothed, name) for name in TRUE}
    return Run(history, {k: v[0] for k, v in figures.items()}, {k: v[1] for k, v in figures.items()})


SEEDS = pytest.mark.parametrize(
    "seeds", [pytest.param(ONE, id="one"), pytest.param(ALL, id="all", marks=pytest.mark.slow)]
)

# ---------------------------------------------------------------- what is identified


@pytest.mark.slow
@pytest.mark.parametrize("name", TRUE)
@pytest.mark.parametrize("gyro", GYROS)
def test_the_spectrum_is_that_of_the_sensor(gyro, name):
    """Of the last models in force, over the low half of the spectrum (in decades, from two cycles in the window on):
    the truth is inside the band of 90 % at more than half of the frequencies, and the power that the filter takes,
    slow parts included, is within the bars in the median over seeds and axes.

    Bands are of the parameters, given that the order is right: 90 % cannot be asked of them.
    """
    period_s = 1.0 / described(gyro).sensors[name].rate_hz
    inside, ratios = [], []
    parts = [part for seed in ALL for part in run_of(gyro, seed).history[name][-1][1]]
    for part in parts:
        spectrum = part.spectrum
        at = np.array(spectrum.frequency_hz)
        low = (at > 4.0 * at[0]) & (at < math.sqrt(at[0] * at[-1]))
        truth = density(TRUE[name], at[low], period_s)
        # nodes of the correlation time stand a factor of two apart: between them the power is known to a quarter
        below, above = np.array(spectrum.low)[low] / 1.25, 1.25 * np.array(spectrum.high)[low]
        inside.append(np.mean((below <= truth) & (truth <= above)))
        ratios.append(density(part, at[low][:1], period_s)[0] / truth[0])
    assert np.mean(inside) > 0.5, np.round(inside, 2)
    bottom, top = BARS[gyro]
    # what is slower than some 12 s the drift of the accelerometers hides from a depth gauge: a slow error, one the size
    # of what was described as white, is there with a probability of a third, and S(0) of that is eleven times as large
    assert bottom < np.median(ratios) < (4.5 if name == "depth" else top), np.round(sorted(ratios), 2)


@pytest.mark.parametrize("seed", [2, 4])
def test_a_dive_is_not_taken_for_an_error_of_the_depth(seed):
    """The forward accelerometer is found wrong while the vehicle pitches: a step of the downward drift, which no chain
    of integrators explains. The power at 10 mHz is the true one within a factor of four at every hop; it was 16 to 300
    times that.
    """
    described_, frequency_hz = described("tactical"), np.array([0.01])
    (channel,) = residual_series(described_, mission_of("tactical", seed), sensors=["depth"])["depth"]
    learner, before = Learner(DEFAULT_ORDERS, 4000, channel.drift, white=channel.white), 0
    truth = density(TRUE["depth"], frequency_hz, channel.period_s)[0]
    for age_s in (120.0, 240.0, 500.0, 1000.0):
        heard = round(age_s / channel.period_s)
        found = learner.hop(without_spikes(channel.value[:heard]), heard - before).model
        before = heard
        assert 0.25 < found.spectrum(frequency_hz, 1.0 / channel.period_s)[0] / truth < 4.0, age_s


@pytest.mark.parametrize("gyro", GYROS)
@SEEDS
def test_only_stable_invertible_models_come_into_force(seeds, gyro):
    for seed in seeds:
        for history in run_of(gyro, seed).history.values():
            found = [part for _, parts in history for part in parts if part is not None]
            assert found
            for part in found:
                model = part.model
                assert model.is_stable and model.is_invertible and math.isfinite(model.sd) and model.sd > 0.0
                assert (model.p, model.q) in DEFAULT_ORDERS
                # no slow part is excluded, neither where a Gauss-Markov process is the prior, nor where white noise is
                assert part.slow_parts and all(each.sd > 0.0 and each.tau_s > 0.0 for each in part.slow_parts)


def test_white_readings_of_what_is_described_as_white_leave_little_to_slow_errors():
    """A small part of the variance, and what navigates is as good. At zero frequency that may be tens of times the
    power of the white noise (eight seeds: 15 to 71): by minutes nobody can tell.
    """
    motion = dive(400.0, lambda legs: (Lawnmower(legs, 60.0),), (45.0, 45.0), 10.0, 20.0)
    mission = simulate(described("tactical"), motion, seed=4, duration_s=400.0)
    vehicle = described("tactical").with_error(dvl=nf.LearnedArma(prior=BELIEF["dvl"]))
    learnt, plain = (nf.replay(one, mission, output_rate_hz=1.0) for one in (vehicle, described("tactical")))
    parts = [part for _, parts in adopted(learnt, "dvl") for part in parts if part is not None]
    assert len(parts) > 5
    for part in parts:
        quick = replace(part, slow=part.beside[-1] if isinstance(part.beside[-1], nf.White) else None)
        block = quick.block(0.25)
        # of white noise of that size; a hundred readings leave room for colour of some seconds
        assert block_level(block) < 3.0 * (block.r + block.C @ block.P0 @ block.C)
        assert sum(one.sd**2 for one in part.slow_parts) < 0.1 * BELIEF["dvl"].sd ** 2
    off = [np.mean(np.sum(track.errors(mission.truth).position_n[:, :2] ** 2, axis=1)) for track in (learnt, plain)]
    assert math.sqrt(off[0] / off[1]) < 1.05  # means of eight missions: 1.02


# ---------------------------------------------------------------- is the filter honest with it


def independent_errors(seeds):
    """Number of independent heading errors of all runs: they are correlated over two to three minutes (compass against
    gyro).
    """
    return len(seeds) * (DURATION_S - SCORED_S) / 300.0


@pytest.mark.parametrize("label", ["forward", "smoothed"])
@pytest.mark.parametrize("gyro", GYROS)
@SEEDS
def test_heading_is_honest_across_adoptions(seeds, gyro, label):
    """Mean NEES within the 99.9 % range of chi-square with as many independent errors as there are."""
    freedom = independent_errors(seeds)
    low, high = chi2.ppf([0.0005, 0.9995], freedom) / freedom
    values = [run_of(gyro, seed).nees[label] for seed in seeds]
    assert low < np.mean(values) < high, np.round(values, 2)


@pytest.mark.slow
@pytest.mark.parametrize("gyro", GYROS)
def test_heading_is_nearly_that_of_the_filter_that_knows_the_truth(gyro):
    """The aim is 5 % over fifty seeds; over a few the two rms differ by 12 % by chance (each follows other errors)."""
    ours, oracle = (
        math.sqrt(np.mean([run_of(gyro, seed).squared[label] for seed in ALL])) for label in ("forward", "oracle")
    )
    assert ours < 1.25 * oracle


# ---------------------------------------------------------------- when


def short_run(end_s):
    mission = mission_of("tactical", 0)
    nav = nf.Navigator(learns(described("tactical")), mission.start)
    one_by_one(
        nav,
        [event for event in events_of(described("tactical"), mission) if event.time_s <= mission.start.time_s + end_s],
    )
    return nav


def test_the_first_models_come_after_half_a_minute():
    """From the first early hop on; before it nothing is adopted, though all is noted."""
    early = short_run(LearningSchedule.EARLY_S[0] - 1.0)
    for name in TRUE:
        rate_hz = described("tactical").sensors[name].rate_hz
        assert all(abs(series.value.size - 29.0 * rate_hz) <= 2 for series in early.residuals(name))
    assert early.counts["adopted"] == 0
    # 30 s at 8 Hz are 240 readings of the compass; 120 of the others, of which the newest may still change
    # the answer is taken 2 s later, and the beginning done again 0.6 s after that
    assert short_run(LearningSchedule.EARLY_S[0] + 4.0).counts["adopted"] >= 1


def test_a_mission_that_ends_before_the_first_models_are_due_keeps_its_priors():
    track = nf.replay(learns(described("tactical")), mission_of("tactical", 0, 25.0), output_rate_hz=1.0)
    assert all(parts == [None] * len(parts) for name in TRUE for _, parts in adopted(track, name))


# ---------------------------------------------------------------- what there is nothing to learn from


class Says:
    """Stands in for a learner: hands out what it is told to."""

    def __init__(self, *found):
        self.found = list(found)

    def hop(self, series, fresh):
        return self.found.pop(0)

    memory, window = None, 4000


def test_a_sensor_that_is_heard_late_is_learnt_all_the_same():
    """At the first ages nothing had been heard of it yet: that ended the run."""
    vehicle = survey_vehicle().with_error(dvl=nf.LearnedArma(), compass=nf.LearnedArma())
    mission = simulate(vehicle, SCENARIOS["lawnmower"].motion(200.0), seed=1, duration_s=200.0)
    dvl = mission.streams["dvl"]
    late = mission.with_stream("dvl", dvl.keep(dvl.time_s > 60.0))
    learnt = {name: len(models) for name, models in nf.replay(vehicle, late).error_models.items()}
    assert learnt["compass"] > 1 and learnt["dvl"] > 1


def test_where_nothing_is_learnt_the_last_model_stays():
    """Before a good one the prior, after it the good one."""
    vehicle = described("tactical").with_error(compass=nf.LearnedArma(prior=BELIEF["compass"]))
    nav = nf.Navigator(vehicle, mission_of("tactical", 0).start)
    listener = nav.learning.listeners.get("compass")
    at = np.array([0.01, 1.0])
    spectrum = Spectrum.weighted(at, np.ones((1, 2)), np.ones(1))
    slow = nf.GaussMarkov(sd=0.01, tau_s=60.0), nf.GaussMarkov(sd=0.02, tau_s=300.0)
    good = LearnedModel(ArmaModel([-0.9], [], 0.001, sd_log_s0=0.2), slow, spectrum)
    listener.learners = (Says(None, good, None, good),)

    def learn():
        listener.memory.cursor[0] += 1  # another hop
        listener.begin_hop()
        return listener.learnt()

    assert learn() is None and learned_part(listener.memory.models[0]).model is None
    (first,) = learn()
    part = learned_part(first)
    assert part.model == good.model and part.slow_parts == slow and part.prior == BELIEF["compass"]
    assert learn() is None and listener.memory.models == (first,)
    assert learn() is None  # the same again is nothing new


# ---------------------------------------------------------------- the same bits


def test_live_in_blocks_and_replayed_are_the_same_bits_while_all_sensors_are_learnt():
    """Samples one by one, in blocks, and replayed, past the first adoption (with the beginning run again) and a later
    one.
    """
    vehicle = described("tactical").with_error(
        **{name: nf.LearnedArma(prior=BELIEF[name], window=400, hop=100, orders=((1, 0), (1, 1))) for name in TRUE}
    )
    mission = mission_of("tactical", 0, 300.0)
    events = events_of(vehicle, mission)
    single, blocks = nf.Navigator(vehicle, mission.start), nf.Navigator(vehicle, mission.start, history_s=0.5)
    one_by_one(single, events)
    in_blocks(blocks, events, np.random.default_rng(1))
    assert single.counts["adopted"] > len(TRUE)
    same_runs.assert_same_bits(single, blocks)
    track = nf.replay(vehicle, mission, output_rate_hz=None)
    assert track.time_s[-1] == single.state.time_s
    np.testing.assert_array_equal(track.velocity_n[-1], single.state.velocity_n)
    np.testing.assert_array_equal(track.covariance[-1], single.filter.P[:9, :9])
    last = dict(
        zip(track.state_names, track.states[-1], strict=True)
    )  # its names are those of all times, sorted by sensor
    np.testing.assert_array_equal([last[name] for name in single.filter.layout.names], single.filter.x)


# ---------------------------------------------------------------- noise that changes

CHANGE_S, WINDOW_S, CHANGED_S = 900.0, 500.0, 2700.0


def variance(part):
    """Of what is in force, fast and slow."""
    block = part.block(1.0)
    return float(block.C @ block.P0 @ block.C) + block.r


@cache
def changing_run(gyro, seed):
    """Heading NEES from two windows after the change on, and the standard deviations of the models in force, by time
    [deg].
    """
    staged = stage("compass-triples", gyro=gyro, imu_rate_hz=25.0)
    mission = staged.mission(seed)
    vehicle = staged.vehicle.with_error(compass=nf.LearnedArma(prior=BELIEF["compass"]))
    track = nf.replay(vehicle, mission, output_rate_hz=1.0)
    sds = [
        (time_s, math.sqrt(variance(part)) / DEG) for time_s, (part,) in adopted(track, "compass") if part is not None
    ]
    return heading_figures(track, mission, CHANGE_S + 2.0 * WINDOW_S)[1], sds


@pytest.mark.parametrize("gyro", ["tactical", pytest.param("mems", marks=pytest.mark.slow)])
def test_a_compass_error_that_trebles_is_followed_within_two_windows(gyro):
    """0.5 deg becomes 1.5 deg. A window holds 500 / 30 independent errors: an sd to 17 %, the median of three to 12 %;
    the evidence for the slow part still holds some of the quiet time, so the lower limit is 1.5 - 30 %.

    NEES: 800 s are left, in which a heading error lasts for about 150 s each way: 8 independent ones in three seeds,
    whose mean is within 0.11 .. 3.3 with 99.9 %. A filter that stays with 0.5 deg would have 9.
    """
    runs = [changing_run(gyro, seed) for seed in range(3)]
    before = [next(sd for time_s, sd in reversed(sds) if time_s <= CHANGE_S) for _, sds in runs]
    after = [next(sd for time_s, sd in reversed(sds) if time_s <= CHANGE_S + 2.0 * WINDOW_S) for _, sds in runs]
    assert 0.3 < np.median(before) < 0.7
    assert 1.05 < np.median(after) < 2.1
    low, high = chi2.ppf([0.0005, 0.9995], 8) / 8
    assert low < np.mean([nees for nees, _ in runs]) < high


@pytest.mark.slow
@pytest.mark.parametrize("gyro", GYROS)
def test_heading_is_honest_again_two_windows_after_the_error_trebled(gyro):
    """The issue's bar, over 24 seeds: about 64 independent errors, a mean good to 0.18."""
    values = [changing_run(gyro, seed)[0] for seed in range(24)]
    assert 0.6 < np.mean(values) < 1.6, np.round(sorted(values), 2)


def test_white_noise_that_is_described_and_not_there_is_no_change_again_and_again():
    """A data sheet's 0.3 deg where there are 0.1: no model that is learnt beside it brings the NIS to 1. Each minute
    was taken for a change, and what came before it forgotten (a window of 120 s, heading NEES 2.6 over six seeds).
    """
    prior, truth = BELIEF["compass"].parts[0], BELIEF["compass"]
    plain, motion = survey_vehicle(), SCENARIOS["lawnmower"].motion(900.0)
    mission = simulate(plain.with_error(compass=truth), motion, seed=303, duration_s=900.0)
    vehicle = plain.with_error(compass=nf.LearnedArma(prior=prior) + nf.White(sd=0.3 * DEG))
    models = [learned_part(error[0]).model for _, error in nf.replay(vehicle, mission).error_models["compass"][1:]]
    windows = np.array([model.effective_window for model in models if model is not None])
    assert windows[-1] > 1500, windows


def test_white_noise_that_trebles_says_little_of_what_is_slow():
    """A compass whose error trebles, nine tenths of which is white from one reading to the next: the level of that is
    found at once, and what no reading has shown yet of slow errors is not made ten times as large with it.

    S(0) of what is in force became 6 to 18 times as large in five seeds, and becomes 1.6 to 2.5 times as large.
    """
    small, large = (nf.GaussMarkov(sd=k * 0.2 * DEG, tau_s=20.0) + nf.White(sd=k * 0.1 * DEG) for k in (1.0, 3.0))
    staged = stage("compass-gm1", gyro="tactical", duration_s=TURNS_S + 60.0, imu_rate_hz=50.0)
    error = Changing(((0.0, small), (TURNS_S, large)))
    staged = replace(staged, faults=staged.faults | {"compass": replace(staged.faults["compass"], true_error=error)})
    vehicle = staged.vehicle.with_error(compass=nf.LearnedArma(prior=BELIEF["compass"]))
    track = nf.replay(vehicle, staged.mission(912), output_rate_hz=1.0)
    *_, before = (parts[0] for time_s, parts in adopted(track, "compass") if time_s < TURNS_S)
    after = adopted(track, "compass")[-1][1][0]
    assert before.level == 1.0 and after.model == before.model
    assert 4.0 < after.level < 20.0
    assert after.s0(0.125) < 4.0 * before.s0(0.125)


# ---------------------------------------------------------------- studies

FIXED = [name for name, study in USUAL.items() if study.kind != "changing" and study.sensor != "gyro"]


def identified(scenario, gyro, seeds):
    """Power over the true one at two cycles in the window, of the last models in force, all seeds and axes."""
    staged = stage(scenario, gyro=gyro, imu_rate_hz=50.0)
    sensor = staged.study.sensor
    period_s, errors = 1.0 / staged.vehicle.sensors[sensor].rate_hz, staged.truth[sensor]
    priors = staged.vehicle.sensors[sensor].models
    vehicle = staged.vehicle.with_error(**{sensor: tuple(nf.LearnedArma(prior=prior) for prior in priors)})
    ratios = []
    for seed in seeds:
        track = nf.replay(vehicle, staged.mission(seed), output_rate_hz=1.0)
        for axis, part in enumerate(adopted(track, sensor)[-1][1]):
            true = errors[axis] if isinstance(errors, tuple) else errors
            at = np.array([2.0 / (part.window * period_s)])
            ratios.append((density(part, at, period_s) / density(true, at, period_s))[0])
    return np.array(ratios)


#: Medians that are beyond the bars, and why.
TAIL = "what the readings cannot exclude stays, and the mean of the posterior is ruled by its longest times"
SLOW = "what two cycles in a window tell is slower than the minute over which learnt and described are weighed"
BEYOND = {
    ("tactical", "compass-thesis"): f"0.28: {SLOW}",
    ("tactical", "dvl-coloured"): f"0.08: {SLOW}",
    ("mems", "dvl-coloured"): f"0.06: {SLOW}",
    ("tactical", "compass-gm1-white"): f"2.2: {TAIL}",
    ("tactical", "compass-mixed"): f"2.0: {TAIL}",
    ("mems", "compass-mixed"): f"3.4: {TAIL}",
    ("tactical", "gps-thesis"): f"4.3: {TAIL}",
    ("mems", "gps-thesis"): f"5.7: {TAIL}",
    ("mems", "compass-white"): f"10: {TAIL}",
    ("mems", "compass-thesis"): f"2.58: {TAIL}",
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gyro", "scenario"),
    [
        pytest.param(
            gyro,
            name,
            marks=[pytest.mark.xfail(strict=True, reason=BEYOND[gyro, name])] if (gyro, name) in BEYOND else [],
        )
        for gyro in GYROS
        for name in FIXED
    ],
)
def test_the_power_at_low_frequencies_in_every_scenario(gyro, scenario):
    """The bars on the median over 12 seeds (and axes)."""
    ratios = identified(scenario, gyro, range(12))
    low, high = BARS[gyro]
    print(scenario, gyro, np.round(np.quantile(ratios, [0.1, 0.5, 0.9]), 2))
    assert low < np.median(ratios) < high, np.round(np.sort(ratios), 2)


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["compass-gm2", "compass-rolling", "dvl-coloured"])
def test_fifty_missions_are_honest(scenario):
    """ANEES of position and heading within 0.5 to 1.6 of that of the truth (issue's bar), NIS within 0.8 to 1.25,
    forward and smoothed (tactical gyro, first window not scored).
    """
    campaign = Campaign(scenario, imu_rate_hz=50.0)
    runs = [run_seed(campaign, seed, ("arma", "oracle")) for seed in range(50)]
    of = {name: SCORES.index(name) for name in ("anees_position", "anees_heading", "nis_all", "nis_sensor")}
    mean = {
        name: {key: np.mean([run[name]["scores"][:, at] for run in runs], axis=0) for key, at in of.items()}
        for name in ("arma", "oracle")
    }
    print(scenario, {name: {key: np.round(v, 3).tolist() for key, v in one.items()} for name, one in mean.items()})
    for key in ("anees_position", "anees_heading"):
        ratio = mean["arma"][key] / mean["oracle"][key]
        assert np.all((ratio > 0.5) & (ratio < 1.6)), (key, ratio)
    assert 0.8 < mean["arma"]["nis_all"][0] < 1.25 and 0.8 < mean["arma"]["nis_sensor"][0] < 1.25


# ---------------------------------------------------------------- another error, and no fault


def turned_slow(seed, ends_s):
    """A vehicle whose compass has been learnt as white when its error turns slow, and a mission of it."""
    slow = nf.GaussMarkov(sd=0.4 * DEG, tau_s=40.0) + nf.White(sd=0.1 * DEG)
    error = Changing(((0.0, nf.White(sd=0.4 * DEG)), (TURNS_S, slow)))
    staged = stage("compass-gm1", gyro="tactical", duration_s=ends_s, imu_rate_hz=50.0)
    staged = replace(staged, faults=staged.faults | {"compass": replace(staged.faults["compass"], true_error=error)})
    return staged.vehicle.with_error(compass=nf.LearnedArma(prior=BELIEF["compass"])), staged.mission(seed)


TURNS_S = 560.0


@pytest.mark.parametrize("seed", [912, 916, 920])
def test_an_error_that_becomes_another_one_is_no_fault(seed):
    """White noise that turns into a slow error of the described size is no compass that has jumped, nor a gyro that has
    shifted: constants and biases that were opened for it would leave the heading to themselves for good.
    """
    vehicle, mission = turned_slow(seed, 900.0)
    track = nf.replay(vehicle, mission, output_rate_hz=1.0)
    assert not track.counts["jumped"]
    assert not track.counts["shifted"]
    after = track.time_s > TURNS_S
    errors = track.errors(mission.truth)
    assert np.mean(track.nees(errors)["heading"][after]) < 1.5  # 0.3 to 0.6; 1 to 23 where it is taken for a fault
    models = [learned_part(models[0]) for _, models in track.error_models["compass"][1:]]
    assert [part.model is None for part in models] == [False, False, False, True, False]


def test_another_error_is_the_same_bits_with_late_readings_and_from_a_snapshot():
    vehicle, mission = turned_slow(916, 640.0)
    events = events_of(vehicle, mission)
    straight, late = nf.Navigator(vehicle, mission.start), nf.Navigator(vehicle, mission.start, history_s=2.0)
    one_by_one(straight, events)
    arrived = delayed(events, ("compass",), 1.9, seed=1, share=0.1)
    half = len(arrived) * 95 // 100
    one_by_one(late, arrived[:half])
    again = nf.Navigator.restore(vehicle, late.snapshot())
    one_by_one(again, arrived[half:])
    assert learned_part(straight.filter.channels["compass"].sensor.models[0]).model is None
    same_runs.assert_same_bits(straight, again)
