"""What error models are learnt from: the open-loop series holds the sensor's error whole, beside a drift that obeys its
claim.
"""

import dataclasses
import math
from functools import cache

import numpy as np
import pytest
from kernel_inputs import assert_close, random_nav, run_both

import navfilter as nf
from navfilter.kernels import kalman, open_loop_residual
from navfilter.models.mission import Stream
from navfilter.models.navigation_drift import Drift
from navfilter.models.window_limits import LONGEST_GAP
from navfilter.playback.replay import residual_series
from navfilter.simulation.scenarios import survey_vehicle, transit, turns_and_dives
from navfilter.simulation.simulate import draw_errors, simulate

# ---------------------------------------------------------------- kernels and their twins


def test_carry():
    rng = np.random.default_rng(1)
    for m in (9, 10, 15):
        Phi = np.eye(m) + 0.1 * rng.normal(size=(m, m))
        ours, twins = run_both(open_loop_residual.carry_feedback, rng.normal(size=2 * m + 3), Phi)
        assert_close([ours[0][: m + 9]], [twins[0][: m + 9]], 1e-14)


def ear(random, level=1.0):
    """One that watches the level, with odds of its own."""
    out = np.zeros(open_loop_residual.EAR)
    out[[open_loop_residual.CAPACITY, open_loop_residual.DUE, open_loop_residual.NOTED]] = (
        20,
        random.integers(90),
        random.integers(20),
    )
    out[[open_loop_residual.ANOTHER, open_loop_residual.LEVEL]] = 2.0, level
    odds = random.exponential(size=len(open_loop_residual.LEVELS)) ** 3
    out[open_loop_residual.ODDS : open_loop_residual.MOUNT] = odds / odds.sum()
    return out


@pytest.mark.parametrize("learning", [True, False])
@pytest.mark.parametrize("level", [1.0, 5.0])
def test_attend(level, learning):
    rng = np.random.default_rng(3)
    told = []
    for k in range(200):
        heard = ear(rng, level)
        heard[open_loop_residual.ANOTHER] *= k % 2
        nis = math.nan if rng.random() < 0.1 else rng.exponential(40.0)
        args = heard, nis, float(rng.integers(4)), int(rng.integers(1, 40)), learning
        ours, twins = run_both(open_loop_residual.after_reading, *args)
        assert_close([ours[0]], [twins[0]], 1e-12)
        told.append(open_loop_residual.after_reading(heard, *args[1:]))
    assert not any(told) if not learning else 20 < sum(told) < 180


def test_levels_by_bayes_rule():
    rng = np.random.default_rng(5)
    for dof in (1.0, 2.0, 3.0):
        args = ear(rng, 3.0), rng.exponential(10.0), dof
        ours, twins = run_both(open_loop_residual.judge_level, *args)
        assert_close([ours[0]], [twins[0]], 1e-12)
        assert ours[0][open_loop_residual.ODDS : open_loop_residual.MOUNT].sum() == pytest.approx(1.0)


def levels(scale, seed, dof=1):
    """In force after each reading, of white innovations of so many times the believed standard deviation."""
    heard, found = ear(np.random.default_rng(seed)), []
    odds = slice(open_loop_residual.ODDS, open_loop_residual.MOUNT)
    heard[odds], heard[open_loop_residual.DUE] = np.eye(len(open_loop_residual.LEVELS))[0], math.inf
    for sd, e in zip(scale, np.random.default_rng(seed).standard_normal((len(scale), dof)), strict=True):
        level = heard[open_loop_residual.LEVEL]
        if open_loop_residual.after_reading(heard, sd**2 * (e @ e) / level, float(dof), 1, True):
            heard[open_loop_residual.LEVEL] = heard[odds] @ open_loop_residual.LEVELS
        found.append(heard[open_loop_residual.LEVEL])
    return np.array(found)


def test_a_level_follows_at_once_and_comes_back():
    """Noise that trebles for a minute at 8 Hz; a spike, and noise that is smaller than believed, are no other level."""
    trebled = np.repeat([1.0, 3.0, 1.0], [2000, 480, 2000])
    for seed in range(10):
        found = levels(trebled, seed)
        assert np.mean(found[:2000] > 1.0) < 0.01  # by chance, for a moment
        assert np.all((found[2080:2480] > 4.0) & (found[2080:2480] < 20.0))  # ten seconds later
        assert np.mean(found[2600:] > 2.0) < 0.01
        spike = np.ones(600)
        spike[500] = 100.0
        assert all(levels(spike, seed, dof)[500] == 1.0 for dof in (1, 2, 3))
        assert np.all(levels(np.full(1000, 0.3), seed) == 1.0)


@pytest.mark.parametrize("used", [True, False])
@pytest.mark.parametrize("gravity", [9.81, 0.0])
@pytest.mark.parametrize(
    "kind",
    [open_loop_residual.NOTHING, open_loop_residual.HEADING, open_loop_residual.POSITION, open_loop_residual.VELOCITY],
)
@pytest.mark.parametrize("told", ["", "constants", "still", "fixes", "calibrated"])
def test_listen(kind, gravity, used, told):
    rng = np.random.default_rng(2)
    a = 1 if kind == open_loop_residual.HEADING else 3
    rows = a + 1 + (a + 1) * (told == "constants")
    facts = (
        1e3 * (told == "still"),
        0.7 * (told == "constants"),
        0.0,
        rows,
        {"fixes": 1.0, "calibrated": 2.0}.get(told, 0.0),
    )
    for ticks, cursor in ((1, 0), (4, 6), (30, 17)):
        dims = np.array([a, 20, 13, 4, 15, 3, 1, 0])
        n, m, errors, at = dims[1], dims[2], dims[5], kalman.memory_offsets(dims)
        mem = rng.normal(size=at[-1])
        mem[at[8] + 2] = used
        nav, mount = random_nav(rng), np.concatenate([facts, rng.normal(size=9)])
        args = (
            rng.normal(size=2 * m + 3),
            mem,
            dims,
            np.array(at),
            nav,
            rng.normal(size=(a, errors)),
            rng.normal(size=n - 9),
        )
        args += (
            kind,
            mount,
            rng.normal(size=(rows, 8)),
            np.array([cursor]),
            ticks,
            rng.normal(size=(6, m - 8)),
            gravity,
        )
        ours, twins = run_both(open_loop_residual.record_residual, *args)
        assert_close([ours[0][[*range(m + 9), -3, -2, -1]]], [twins[0][[*range(m + 9), -3, -2, -1]]], 1e-13)
        np.testing.assert_array_equal(np.isnan(ours[9]), np.isnan(twins[9]))
        assert_close([np.nan_to_num(ours[9])], [np.nan_to_num(twins[9])], 1e-13)
        np.testing.assert_array_equal(ours[10], twins[10])
        np.testing.assert_array_equal(
            ours[10], cursor + (0 if kind == open_loop_residual.NOTHING else min(ticks - 1, 8) + 1)
        )


# ---------------------------------------------------------------- a mission whose errors are known

TRUE = {
    "compass": nf.GaussMarkov(sd=0.01, tau_s=30.0),
    "dvl": nf.GaussMarkov(sd=0.01, tau_s=10.0) + nf.White(sd=0.005),
    "depth": nf.GaussMarkov(sd=0.05, tau_s=20.0) + nf.White(sd=0.02),
    "gps": nf.GaussMarkov(sd=3.0, tau_s=60.0),
}
MOTIONS = {"straight": transit, "turning": turns_and_dives}
CASES = [(mems, motion) for mems in (False, True) for motion in MOTIONS]
NAMES = ["tactical-straight", "tactical-turning", "mems-straight", "mems-turning"]
#: Each unit and each motion once; the other two with ``-m slow``.
SOME = [
    pytest.param(mems, motion, id=name, marks=[] if mems == (motion == "straight") else pytest.mark.slow)
    for (mems, motion), name in zip(CASES, NAMES, strict=True)
]
SEED, DURATION_S = 3, 1200.0
#: Where two series are compared little is a matter of statistics: twenty waves, and all turns and dives of the motion,
#: are enough.
PART_S = 660.0


@cache
def mission_of(mems, motion):
    """Vehicle and mission; fixes all the time, and gates wide open: beliefs may be as wrong as they like."""
    plain = survey_vehicle(mems=mems).with_error(**TRUE)
    vehicle = nf.Vehicle(
        plain.drive, {name: dataclasses.replace(s, gate_probability=1 - 1e-15) for name, s in plain.sensors.items()}
    )
    return vehicle, simulate(vehicle, MOTIONS[motion](DURATION_S), seed=SEED, duration_s=DURATION_S)


@cache
def series_of(mems, motion):
    return residual_series(*mission_of(mems, motion))


def first_part(mems, motion, seconds=PART_S):
    vehicle, mission = mission_of(mems, motion)
    return vehicle, mission.between(mission.start.time_s, mission.start.time_s + seconds)


def true_errors(mems, motion, name):
    """What the simulator added to the readings, (n, axes), at the ticks of the series."""
    vehicle, mission = mission_of(mems, motion)
    sensor, count = vehicle.sensors[name], len(mission.streams[name])
    error = draw_errors(sensor.error, 1.0 / sensor.rate_hz, np.arange(count) / sensor.rate_hz, sensor.axes, SEED, name)
    return error[-len(series_of(mems, motion)[name][0].value) :]


def difference(values, stride, order):
    """Differences of this order between samples `stride` apart: a polynomial of lower degree leaves nothing."""
    for _ in range(order):
        values = values[stride:] - values[:-stride]
    return values[np.isfinite(values)]


def claimed(channel, stride):
    """Variance that the channel claims for such differences of its drift and its known white noise."""
    drift = Drift(channel.drift.density, channel.drift.period_s * stride)
    r, F, Q = drift.order, drift.transition(), drift.noise()
    weights = [(-1) ** (r - j) * math.comb(r, j) for j in range(r + 1)]
    variance = channel.white * sum(w * w for w in weights)
    for i in range(r):
        g = sum(weights[j] * np.linalg.matrix_power(F, j - 1 - i)[0] for j in range(i + 1, r + 1))
        variance += g @ Q @ g
    return variance


SPACINGS_S = {
    "compass": (0.125, 1.0, 4.0, 16.0),
    "dvl": (0.25, 1.0, 4.0, 16.0),
    "depth": (1.0, 4.0, 16.0),
    "gps": (1.0, 4.0, 16.0),
}


@pytest.mark.parametrize("name", TRUE)
@pytest.mark.parametrize(("mems", "motion"), SOME)
def test_beside_the_true_error_there_is_only_the_claimed_drift(mems, motion, name):
    """r-th differences of series minus true error have the claimed variance within a factor of 2, from one tick to 16
    s.

    The longest spacing leaves 1200 / (3 * 16) = 25 independent differences: a variance known to 28 %, so a factor of 2
    is 2.5 sd away.
    """
    error = true_errors(mems, motion, name)
    for axis, channel in enumerate(series_of(mems, motion)[name]):
        for spacing_s in SPACINGS_S[name]:
            stride = round(spacing_s / channel.period_s)
            found = np.mean(difference(channel.value - error[:, axis], stride, channel.drift.order) ** 2)
            assert 0.5 < found / claimed(channel, stride) < 2.0, (axis, spacing_s)


def test_a_drift_begins_anew_where_a_force_was_found_while_turned():
    """At each reading by which it has moved by more than the drift allows; others are nothing to it."""
    turned = np.array([np.nan, 0.0, 0.1, np.nan, 0.5, 0.55, 0.6, np.nan, -0.2, -0.2])
    assert Drift((1e-3, 1e-5), 1.0, most_turned=0.3).begins_anew(turned) == [4, 8]
    assert Drift((1e-3, 1e-5), 1.0).begins_anew(turned) == []
    assert Drift((1e-3, 1e-5), 1.0, most_turned=0.3).begins_anew(np.full(3, np.nan)) == []


@pytest.mark.parametrize("name", ["dvl", "depth", "gps"])
def test_a_downward_series_begins_anew_in_the_dive_alone(name):
    """There the forward accelerometer is found wrong, whose error had not acted downward before. Beside it nothing is
    missing but a tick or two that stand out; along the other axes nothing ever.
    """
    vehicle, mission = mission_of(False, "straight")
    *level, down = (np.isnan(channel.value) for channel in series_of(False, "straight")[name])
    time_s = (np.arange(down.size) + len(mission.streams[name]) - down.size) / vehicle.sensors[name].rate_hz
    dive = (time_s > 65.0) & (time_s < 105.0)
    assert down[dive].sum() > LONGEST_GAP and not down[~dive].any()
    assert sum(int(axis.sum()) for axis in level) <= 2


# ---------------------------------------------------------------- nothing of the error is hidden

AMPLITUDE = {"compass": 0.01, "dvl": 0.02, "depth": 0.05, "gps": 2.0}
WAVE_S = 30.0
#: The closed loop's own error turns and pitches with the vehicle, unlike what was fed back. The wave moves tilt and
#: accelerometer biases a little; where the vehicle turns (DVL) or pitches (depth) that adds a wandering rest, out of
#: which the wave is read to a tenth at worst (0.103 of a DVL).
SLACK = {"compass": 0.002, "dvl": 0.11, "depth": 0.1, "gps": 0.005}


@pytest.mark.parametrize("name", TRUE)
@pytest.mark.parametrize(("mems", "motion"), SOME)
def test_a_slow_wave_on_the_readings_comes_out_whole(mems, motion, name):
    """A loop that followed it would hide it: a gain of 0.03 where tilt stays in the loop of a micromechanical unit."""
    # the wandering rest of a turning vehicle wants all forty waves
    vehicle, mission = first_part(mems, motion, DURATION_S if motion == "turning" else PART_S)
    stream = mission.streams[name]
    values = stream.value.copy()
    values[:, 0] += AMPLITUDE[name] * np.sin(2 * np.pi * stream.time_s / WAVE_S) / (6.34e6 if name == "gps" else 1.0)
    moved = dataclasses.replace(
        mission, streams=dict(mission.streams) | {name: Stream(stream.time_s, values, stream.columns)}
    )
    values = residual_series(vehicle, moved, sensors=[name])[name][0].value
    change = values - series_of(mems, motion)[name][0].value[: len(values)]
    t, known = stream.time_s[-len(change) :], np.isfinite(change)
    phase, trend = 2 * np.pi * t / WAVE_S, np.polynomial.chebyshev.chebvander(np.linspace(-1, 1, len(t)), 8)
    base = np.column_stack([np.sin(phase), np.cos(phase), trend])
    gain = np.linalg.lstsq(base[known], change[known], rcond=None)[0][:2] / AMPLITUDE[name]
    np.testing.assert_allclose(gain, [1.0, 0.0], rtol=0, atol=SLACK[name])


#: Far too good and far too poor; the third belief is the truth.
BELIEFS = {
    "compass": (nf.White(sd=0.002), nf.White(sd=0.1)),
    "dvl": (nf.White(sd=0.01), nf.White(sd=0.1)),
    "depth": (nf.White(sd=0.02), nf.White(sd=0.5)),
    "gps": (nf.White(sd=0.5), nf.White(sd=10.0)),
}


@pytest.mark.parametrize("name", TRUE)
@pytest.mark.parametrize(("mems", "motion"), SOME)
def test_the_series_does_not_depend_on_what_is_believed_of_the_sensor(mems, motion, name):
    """Series of different beliefs differ, in r-th differences, by less than the drift that is claimed beside the error
    anyway.

    They differ because the errors left in the closed loop do, and these (not what was fed back) are turned by the
    vehicle: e' = turn x e. A belief ten times too good leaves e = 0.01 m/s in the velocity, which a turn of 0.1 rad/s
    makes 0.001 m/s^2, about the drift of a tactical unit; so the bound is the claimed sd (times 1.5 for the DVL while
    turning). A heading also shows tilt errors by the tangent of the pitch, 0.3 in a dive, and compasses of different
    beliefs leave tilts that differ by a milliradian: 3 % of its error are added.
    """
    vehicle, mission = first_part(mems, motion)
    reference, other = (
        residual_series(vehicle.with_error(**{name: belief}), mission, sensors=[name])[name] for belief in BELIEFS[name]
    )
    truth = [
        dataclasses.replace(channel, value=channel.value[: len(reference[0].value)])
        for channel in series_of(mems, motion)[name]
    ]
    bound = 1.5 if name == "dvl" and motion == "turning" else 1.0
    for series in (other, truth):
        for axis, channel in enumerate(reference):
            assert series[axis].drift == channel.drift and series[axis].white == channel.white
            for spacing_s in SPACINGS_S[name]:
                stride = round(spacing_s / channel.period_s)
                sd = difference(series[axis].value - channel.value, stride, channel.drift.order).std()
                own = 0.03 * difference(true_errors(mems, motion, name)[:, axis], stride, channel.drift.order).std()
                assert sd < bound * math.sqrt(claimed(channel, stride)) + own, (axis, spacing_s)


def test_a_reading_that_is_missing_or_a_spike_is_nan_in_the_series():
    vehicle, mission = mission_of(False, "straight")
    stream = mission.streams["depth"]
    values, keep = stream.value.copy(), np.ones(len(stream), bool)
    values[300] += 50.0  # a spike
    keep[400:403] = False  # not there at all
    strict = nf.Vehicle(
        vehicle.drive,
        dict(vehicle.sensors) | {"depth": dataclasses.replace(vehicle.sensors["depth"], gate_probability=0.999999)},
    )
    faulty = dataclasses.replace(
        mission, streams=dict(mission.streams) | {"depth": Stream(stream.time_s[keep], values[keep], stream.columns)}
    )
    series = residual_series(strict, faulty, sensors=["depth"])["depth"][0].value
    first, level = len(stream) - len(series), 200  # the dive is over
    assert np.flatnonzero(np.isnan(series[level:])).tolist() == [
        300 - first - level,
        *(k - first - level for k in (400, 401, 402)),
    ]
