"""Identification on a whole mission: replay, fit, replay again; frozen models; what was adopted, in summary.json."""

import dataclasses
import json
import math
from functools import cache

import numpy as np
import pytest

import navfilter as nf
from navfilter.commands.cli import main
from navfilter.io import read_vehicle, write_vehicle
from navfilter.io.write import labelled, write_outputs
from navfilter.learning.axis_learner import Learner
from navfilter.learning.batch import change
from navfilter.models.error_models import block_level
from navfilter.models.learned_arma import LearnedArma, learned_part, learning_part
from navfilter.models.navigation_drift import Drift
from navfilter.models.spectrum import Spectrum
from navfilter.models.state import wrap
from navfilter.playback.replay import SETTLED, identified, replay
from navfilter.simulation.scenarios import survey_vehicle, transit
from navfilter.simulation.simulate import simulate
from navfilter.timeseries.model import ArmaModel

PERIOD_S, TRUE = 0.125, nf.GaussMarkov(sd=0.01, tau_s=30.0)
ORDERS = ((0, 0), (1, 0), (1, 1))
LEARNS = LearnedArma(prior=nf.White(sd=0.01), orders=ORDERS, window=2000)
KEPT = LearnedArma(model=ArmaModel([-0.9], [], 0.001), frozen=True)


@cache
def dive(mems=False, duration_s=420.0, seed=1):
    """A vehicle whose compass errs slowly and which does not know it."""
    true = survey_vehicle(mems=mems).with_error(compass=TRUE)
    mission = simulate(true, transit(duration_s), seed=seed, duration_s=duration_s)
    return true.with_error(compass=LEARNS), mission


@cache
def rounds(number=4):
    """The vehicle identified on the dive, and what was reported."""
    said = []
    return identified(*dive(), number, report=lambda *what: said.append(what)), said


def compass(vehicle):
    return learned_part(vehicle.sensors["compass"].models[0])


# ---------------------------------------------------------------- frozen


def test_a_frozen_model_is_kept_and_nothing_is_learnt():
    vehicle, mission = dive()
    track = replay(vehicle.with_error(compass=KEPT), mission)
    assert track.error_models["compass"] == [(track.time_s[0], KEPT)] and track.counts["adopted"] == 0
    nav = nf.Navigator(vehicle.with_error(compass=KEPT), mission.start)
    assert nav.learning.listeners.get("compass") is None and nav.learning.beginning is None


def test_a_frozen_model_is_the_model():
    """The filter takes it as it takes the same model that goes on learning."""
    going_on = dataclasses.replace(KEPT, frozen=False)
    for one, other in zip(
        dataclasses.astuple(KEPT.block(PERIOD_S)), dataclasses.astuple(going_on.block(PERIOD_S)), strict=True
    ):
        np.testing.assert_array_equal(one, other)
    assert (
        learning_part(KEPT) is None
        and learning_part(nf.White(sd=0.1) + going_on) is going_on
        and str(KEPT) == "LearnedArma(1, 0, frozen)"
    )


def test_frozen_and_learning_axes_of_one_sensor():
    vehicle = survey_vehicle()
    nav = nf.Navigator(vehicle.with_error(dvl=(KEPT, LEARNS, KEPT)), nf.Start(latitude_deg=45.0, longitude_deg=0.0))
    listener = nav.learning.listeners.get("dvl")
    assert [learner is not None for learner in listener.learners] == [
        False,
        True,
        False,
    ] and listener.window == LEARNS.window


def test_frozen_inertial_models_are_not_learnt_at_rest():
    start = nf.Start(latitude_deg=45.0, longitude_deg=0.0)
    one, other = (
        nf.Navigator(nf.Vehicle(imu=nf.Imu(rate_hz=100.0, gyro=gyro)), start) for gyro in (KEPT, (LEARNS, KEPT, KEPT))
    )
    assert one.learning.rest is None and [learner is not None for learner in other.learning.rest.learners] == [
        True
    ] + 5 * [False]


def test_frozen_needs_a_model():
    with pytest.raises(ValueError, match="no model to keep"):
        LearnedArma(prior=nf.White(sd=0.1), frozen=True)


def test_frozen_models_are_written_and_read(tmp_path):
    vehicle = dive()[0].with_error(compass=KEPT)
    assert "frozen = true" in write_vehicle(vehicle, tmp_path / "v.toml").read_text()
    assert read_vehicle(tmp_path / "v.toml") == vehicle


# ---------------------------------------------------------------- rounds


def test_rounds_end_when_the_models_have_settled():
    """The open-loop series hardly depends on what is believed of the sensor, so the second round finds what the first
    one found.
    """
    found, said = rounds()
    assert [number for number, _ in said] == list(range(1, len(said) + 1))
    assert said[0][1] == math.inf and said[-1][1] < SETTLED and all(apart >= SETTLED for _, apart in said[:-1])
    assert len(said) == 2 and compass(found).frozen and compass(found).prior == LEARNS.prior
    others = {name: sensor for name, sensor in found.sensors.items() if name != "compass"}
    assert others == {name: dive()[0].sensors[name] for name in others} and found.drive == dive()[0].drive


def test_replay_iterated_is_a_replay_of_the_identified_vehicle():
    vehicle, mission = dive()
    track, again = replay(vehicle, mission, iterate=4, smooth=True), replay(rounds()[0], mission, smooth=True)
    for name in ("latitude", "longitude", "attitude", "covariance", "states"):
        np.testing.assert_array_equal(getattr(track, name), getattr(again, name))
    assert track.label == "smoothed" and track.error_models == again.error_models
    assert [error.frozen for _, error in track.error_models["compass"]] == [True] and track.error_models["compass"][0][
        0
    ] == track.time_s[0]


def test_a_slow_part_is_identified_and_frozen_with_the_fast_one():
    """With a prior that allows for one."""
    vehicle, mission = dive()
    learns = LearnedArma(prior=nf.GaussMarkov(sd=0.02, tau_s=60.0), orders=ORDERS, window=2000)
    found = identified(vehicle.with_error(compass=learns), mission, 2)
    part = compass(found)
    assert part.frozen and part.slow_parts and part.spectrum is not None
    assert change(found, found) == 0.0


def test_a_single_round_fits_what_was_heard_while_learning():
    found, said = identified(*dive(), 1, report=lambda *what: None), rounds()[1]
    assert compass(found).frozen and change(found, rounds()[0]) == said[1][1]


def test_an_axis_that_says_too_little_goes_on_learning():
    """A minute and a half at 1 Hz is less than any fit needs."""
    vehicle, mission = dive()
    vehicle = survey_vehicle().with_error(compass=LEARNS, depth=LEARNS)
    few = nf.Mission("few", {**mission.streams, "depth": _first(mission.streams["depth"], 90)}, start=mission.start)
    found = identified(vehicle, few, 3)
    assert found.sensors["depth"].error == LEARNS and compass(found).frozen


def _first(stream, count):
    return nf.Stream(stream.time_s[:count], stream.value[:count], stream.columns)


def test_change_counts_in_standard_deviations():
    """Of the logarithm of the spectrum, from the width of its band; a tenth of the power is not told apart."""
    at = (0.01, 0.1, 1.0)
    wide = Spectrum(at, (0.5, 0.5, 0.95), (1.0, 1.0, 1.0), (2.0, 2.0, 1.05), 0.4)

    def vehicle(spectrum):
        model = None if spectrum is None else ArmaModel([-0.9], [], 0.1)
        return dive()[0].with_error(compass=dataclasses.replace(LEARNS, model=model, spectrum=spectrum))

    def moved(*factors):
        return dataclasses.replace(wide, median=factors)

    assert change(vehicle(moved(1.0, 2.0, 1.0)), vehicle(wide)) == pytest.approx(3.29 / 2.0)  # ln 4 is 3.29 sd
    assert change(vehicle(moved(1.0, 1.0, math.exp(0.03))), vehicle(wide)) == pytest.approx(0.3)
    assert change(vehicle(wide), vehicle(wide)) == 0.0 and change(vehicle(None), vehicle(wide)) == math.inf
    assert change(vehicle(None), vehicle(None)) == 0.0


@pytest.mark.parametrize("wrong", [-1, 1.5])
def test_impossible_numbers_of_rounds_are_refused(wrong):
    with pytest.raises(ValueError, match="whole number"):
        replay(*dive(), iterate=wrong)


def test_nothing_to_identify_is_refused():
    with pytest.raises(ValueError, match="no sensor of this vehicle learns"):
        replay(survey_vehicle(), dive()[1], iterate=2)


# ---------------------------------------------------------------- why not the smoothed residuals


def from_smoothed_residuals(seed, passes=2):
    """S(0) of the compass by fits to reading minus smoothed heading, each pass with the model of the one before."""
    learns, mission = dive(True, 900.0, seed)
    now = LEARNS.prior
    for _ in range(passes):
        track = replay(learns.with_error(compass=now), mission, smooth=True, output_rate_hz=None)
        stream = mission.streams["compass"]
        keep = stream.time_s > 60.0  # as of the open-loop series
        heading = np.interp(stream.time_s[keep], track.time_s, np.unwrap(track.attitude[:, 2]))
        residual = wrap(stream.value[keep, 0] - heading)
        fit = Learner(ORDERS, residual.size, Drift((), PERIOD_S)).hop(residual - residual.mean()).model
        now = LearnedArma(model=fit, frozen=True)
    return 0.5 * fit.spectrum(0.0, 1.0)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_low_frequencies_are_kept_that_smoothed_residuals_lose(seed):
    """A gyro of a MEMS unit and a compass that errs with 30 s: the smoother takes the slow error for heading.

    The 840 s heard hold 28 of its time constants, which leaves ln S(0) uncertain by about sqrt(4 / 28) = 0.4 even
    beside a perfect gyro, and more beside this one: 1 is two standard deviations. Of the smoothed residuals a factor of
    5 is asked, far beyond that. What the filter takes is the mean of what may be, so no less than the truth.
    """
    truth = block_level(TRUE.block(PERIOD_S))
    found = compass(identified(*dive(True, 900.0, seed), 2))
    low, ours, high = (
        math.log(np.array(getattr(found.spectrum, name))[0] / (2.0 * PERIOD_S * truth))
        for name in ("low", "median", "high")
    )
    theirs = math.log(from_smoothed_residuals(seed) / truth)
    assert low < 0.0 < high and abs(ours) < 1.0 and theirs < -math.log(5.0)
    assert found.s0(PERIOD_S) > truth


# ---------------------------------------------------------------- what is told


def test_every_adoption_is_in_the_summary(tmp_path):
    vehicle, mission = dive()
    track = replay(vehicle.with_error(compass=dataclasses.replace(LEARNS, window=800)), mission)
    write_outputs(labelled(track), mission, tmp_path)
    steps = json.loads((tmp_path / "summary.json").read_text())["runs"]["forward"]["adopted"]
    history = [(t, learned_part(e[0] if isinstance(e, tuple) else e)) for t, e in track.error_models["compass"]]
    learnt = [(t, part) for t, part in history if part.model is not None]
    assert list(steps) == ["compass"] and len(steps["compass"]) == len(learnt) > 1
    for step, (time_s, part) in zip(steps["compass"], learnt, strict=True):
        model = part.model
        assert (
            step["time_s"] == pytest.approx(time_s, abs=1e-3)
            and step["order"] == [model.p, model.q]
            and not step["frozen"]
        )
        assert step["sd"] == model.sd and step["sd_log_s0"] == model.sd_log_s0 and step["flags"] == sorted(model.flags)
        assert step["ar"] == model.ar.tolist() and step["ma"] == model.ma.tolist()
        gain = (1.0 + sum(step["ma"])) / (1.0 + sum(step["ar"]))
        # a Gauss-Markov process has twice its variance times its correlation time, per second
        slow = sum(2.0 * slow.sd**2 * slow.tau_s for slow in part.slow_parts) * vehicle.sensors["compass"].rate_hz
        assert step["s0"] == pytest.approx((step["sd"] * gain) ** 2 + step["white"] ** 2 + slow, rel=0.01)
        assert step["pole_radius"] == pytest.approx(np.abs(np.roots([1.0, *step["ar"]])).max(initial=0.0))


def test_axes_are_told_apart_and_repetitions_left_out():
    """A change of one axis is no news of the others."""
    track = replay(*dive())
    a = LearnedArma(model=ArmaModel([-0.5], [], 0.1), slow=nf.White(sd=0.05))
    b = LearnedArma(model=ArmaModel([], [], 0.2), frozen=True)
    told = dataclasses.replace(
        track, error_models={"dvl": [(0.0, (a, nf.White(sd=1.0), a)), (9.0, (a, b, b))], "gyro": [(3.0, (a, a, b))]}
    )
    steps = {title: [(s["time_s"], s["order"], s["frozen"]) for s in steps] for title, steps in told.adopted().items()}
    first, later = (0.0, [1, 0], False), (9.0, [0, 0], True)
    assert steps["dvl x"] == [first] and steps["dvl y"] == [later] and steps["dvl z"] == [first, later]
    assert [step["white"] for step in told.adopted()["dvl z"]] == pytest.approx([0.05, 0.0])
    assert steps["gyro x"] == [(3.0, [1, 0], False)] and steps["gyro z"] == [(3.0, [0, 0], True)]


def test_the_command(tmp_path, capsys):
    vehicle, mission = dive()
    mission.save(tmp_path / "mission.npz")
    path = write_vehicle(vehicle, tmp_path / "vehicle.toml")
    order = [
        "replay",
        str(tmp_path / "mission.npz"),
        "--vehicle",
        str(path),
        "--out",
        str(tmp_path / "out"),
        "--no-report",
        "--iterate",
        "3",
    ]
    assert main(order) == 0
    said = capsys.readouterr().out
    assert "round 1: first models" in said and "round 2" in said and "settled" in said
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    [step] = summary["runs"]["forward"]["adopted"]["compass"]
    assert step["frozen"] and step["time_s"] == pytest.approx(mission.start.time_s)
    assert compass(read_vehicle(tmp_path / "out" / "vehicle_learned.toml")).frozen
    with pytest.raises(SystemExit) as end:
        main([*order[:-1], "2.5"])
    assert end.value.code == 2 and "--iterate" in capsys.readouterr().err
    write_vehicle(survey_vehicle(), path)
    assert main(order) != 0 and "no sensor of this vehicle learns" in capsys.readouterr().err
