"""Rivals: each kind of model is fitted to the series of the mission, and nothing but its own sensors changes."""

import numpy as np
import pytest

import navfilter as nf
from navfilter.evaluation import baselines as module
from navfilter.evaluation.baselines import LEAST, MODELS, learnable, rival, rivals
from navfilter.learning.open_loop_series import ChannelSeries
from navfilter.models.error_models import Sum
from navfilter.models.learned_arma import LearnedArma
from navfilter.models.mission import Mission, Stream
from navfilter.models.navigation_drift import Drift
from navfilter.timeseries.model import simulate_arma

PERIOD = 0.125
PRIOR = nf.GaussMarkov(sd=0.02, tau_s=5.0)
ALL = ("compass", "dvl")


def wandering(drift, n, seed):
    """A chain of integrators with known noise."""
    random = np.random.default_rng(seed)
    step, noise = drift.transition(), np.linalg.cholesky(drift.noise() + 1e-30 * np.eye(drift.order))
    state, out = np.array([0.3, 1e-4]), np.empty(n)
    for k in range(n):
        out[k] = state[0]
        state = step @ state + noise @ random.standard_normal(drift.order)
    return out


def channel(error, drift=None, white=0.0, seed=9):
    """A channel in which this error rides on a drift."""
    drift = drift or Drift((1e-5, 1e-7), PERIOD)
    return ChannelSeries(error + wandering(drift, len(error), seed), drift, PERIOD, white)


def gauss_markov(sd, tau_s, n, seed):
    phi = np.exp(-PERIOD / tau_s)
    return simulate_arma([-phi], [], sd * np.sqrt(1.0 - phi**2), n, seed)


@pytest.fixture
def vehicle():
    sensors = {
        "compass": nf.Heading(rate_hz=8, error=PRIOR),
        "dvl": nf.BodyVelocity(rate_hz=8, error=nf.White(sd=0.01)),
        "gps": nf.Position(rate_hz=1, error=nf.White(sd=3.0)),
        "rest": nf.ZeroVelocity(),
    }
    return nf.Vehicle(imu=nf.Imu(rate_hz=100), sensors=sensors)


@pytest.fixture
def mission():
    many, few = np.arange(4000) * PERIOD, np.arange(LEAST - 1.0)
    streams = {
        "compass": Stream(many, np.zeros(4000)),
        "dvl": Stream(many, np.zeros((4000, 3))),
        "gps": Stream(few, np.zeros((len(few), 3))),
    }
    return Mission("made up", streams)


@pytest.fixture
def series(monkeypatch):
    """What the mission is said to hold, by sensor; how often it was asked for."""
    held, asked = {}, []

    def residual_series(vehicle, mission, sensors=None, start=None):
        asked.append(tuple(sensors))
        return {name: held[name] for name in sensors}

    monkeypatch.setattr(module, "residual_series", residual_series)
    return held, asked


def test_sensors_with_enough_readings(vehicle, mission):
    assert learnable(vehicle, mission) == ALL
    lost = mission.streams["compass"].value.copy()
    lost[: 4000 - LEAST + 1] = np.nan
    assert learnable(vehicle, mission.with_stream("compass", Stream(mission.streams["compass"].time_s, lost))) == (
        "dvl",
    )


def test_each_axis_gets_its_own_model(vehicle, mission, series):
    series[0]["compass"] = (channel(gauss_markov(0.01, 20.0, 16_000, 1)),)
    series[0]["dvl"] = tuple(
        channel(sd * np.random.default_rng(seed).standard_normal(4000)) for seed, sd in enumerate((0.01, 0.02, 0.04))
    )
    found = rivals(("white", "gm1-fitted", "gm1"), vehicle, mission)
    assert series[1] == [ALL]
    dvl = found["white"].sensors["dvl"].error
    # sd of an sd from 4000 samples: 1.1 %.
    np.testing.assert_allclose([model.sd for model in dvl], (0.01, 0.02, 0.04), rtol=0.05)
    fitted = found["gm1-fitted"].sensors["compass"].error
    # 2000 s hold 100 correlation times: the estimated ln tau has an sd of some 14 %, the sd half of it.
    assert (
        fitted.tau_s == pytest.approx(20.0, rel=0.45)
        and fitted.sd == pytest.approx(0.01, rel=0.25)
        and fitted.order == 1
    )
    for name in ("gps", "rest"):
        assert all(other.sensors[name] == vehicle.sensors[name] for other in found.values())
    assert all(other.drive == vehicle.drive for other in found.values())


def test_the_point_at_one_over_e(vehicle, mission, series):
    """No drift to speak of: what is left of a straight line is the process, and its autocorrelation falls to 1/e at
    tau.
    """
    error = gauss_markov(0.01, 2.0, 16_000, 2)
    series[0]["compass"] = (
        ChannelSeries(error + 5.0 + 1e-3 * np.arange(16_000), Drift((1e-9, 1e-9), PERIOD), PERIOD, 0.0),
    )
    model = rival("gm1", vehicle, mission, sensors=["compass"]).sensors["compass"].error
    assert model == nf.GaussMarkov(sd=model.sd, tau_s=model.tau_s) and model.tau_s == pytest.approx(2.0, rel=0.2)
    assert model.sd == pytest.approx(0.01, rel=0.1)


def test_the_point_at_one_over_e_stays_within_one_stretch(vehicle, mission, series):
    """Between two stretches the series runs away; a line through both would leave half of that as error."""
    error = gauss_markov(0.01, 2.0, 6000, 2)
    error[4000:4500] = np.nan
    error[4500:] += 30.0
    series[0]["compass"] = (ChannelSeries(error, Drift((1e-9, 1e-9), PERIOD), PERIOD, 0.0),)
    model = rival("gm1", vehicle, mission, sensors=["compass"]).sensors["compass"].error
    assert model.sd == pytest.approx(0.01, rel=0.3) and model.tau_s == pytest.approx(2.0, rel=0.4)


def test_an_alternating_error_is_white_to_a_gauss_markov_fit(vehicle, mission, series):
    series[0]["compass"] = (channel(simulate_arma([0.6], [], 0.01, 4000, 5)),)
    model = rival("gm1-fitted", vehicle, mission, sensors=["compass"]).sensors["compass"].error
    assert isinstance(model, nf.White) and model.sd == pytest.approx(0.01 / 0.8, rel=0.1)


def test_white_noise_beyond_the_sensor_is_not_charged_to_it(vehicle, mission, series):
    """Of the known white variance, what stands beside a learnt part is fitted anew; the rest, a lever arm's, is taken
    off.
    """
    noise = np.hypot(0.03, 0.04) * np.random.default_rng(6).standard_normal(8000)
    series[0]["compass"] = (channel(noise, white=0.04**2 + 0.01**2),)
    with_white = vehicle.with_error(compass=nf.White(sd=0.01) + LearnedArma(prior=PRIOR))
    model = rival("white", with_white, mission, sensors=["compass"]).sensors["compass"].error
    assert model.sd == pytest.approx(0.03, rel=0.05)


def test_too_few_or_constant_readings_keep_the_model(vehicle, mission, series):
    few = np.full(4000, np.nan)
    few[: LEAST - 1] = np.random.default_rng(1).standard_normal(LEAST - 1)
    noise = np.random.default_rng(2).standard_normal(4000)
    drift = Drift((0.0, 0.0), PERIOD)
    series[0]["dvl"] = tuple(ChannelSeries(value, drift, PERIOD, 0.0) for value in (noise, few, np.ones(4000)))
    for name in ("white", "gm1", "gm1-fitted"):
        x, *others = rival(name, vehicle, mission, sensors=["dvl"]).sensors["dvl"].error
        assert others == [nf.White(sd=0.01)] * 2 and x != nf.White(sd=0.01)


def test_the_bias_of_a_sensor_stays(vehicle, mission, series):
    walk = nf.RandomWalk(density=1e-5, start_sd=0.01)
    series[0]["compass"] = (channel(gauss_markov(0.01, 20.0, 4000, 1)),)
    biased = vehicle.with_error(compass=walk + PRIOR)
    for name in ("white", "gm1", "gm1-fitted", "arma"):
        model = rival(name, biased, mission, sensors=["compass"]).sensors["compass"].error
        assert isinstance(model, Sum) and model.parts[0] == walk and len(model.parts) == 2
    assert model.parts[1] == LearnedArma(prior=PRIOR)


def test_learning_begins_with_the_vehicle_file(vehicle, mission, series):
    found = rival("arma", vehicle, mission)
    assert found.sensors["compass"].error == LearnedArma(prior=PRIOR)
    assert found.sensors["dvl"].error == (LearnedArma(prior=nf.White(sd=0.01)),) * 3
    assert found.sensors["gps"] == vehicle.sensors["gps"] and series[1] == []
    own = LearnedArma(prior=PRIOR, window=1000)
    assert rival("arma", vehicle.with_error(compass=own), mission, sensors=["compass"]).sensors["compass"].error == own


def test_oracle_and_vehicle(vehicle, mission, series):
    truth = {"compass": nf.Arma([-0.9], [], 0.01), "gps": nf.White(sd=1.0), "usbl": nf.White(sd=1.0)}
    found = rivals(("oracle", "vehicle"), vehicle, mission, truth=truth)
    assert found["vehicle"] == vehicle and series[1] == []
    assert (
        found["oracle"].sensors["compass"].error == truth["compass"]
        and found["oracle"].sensors["gps"].error == truth["gps"]
    )
    assert found["oracle"].sensors["dvl"] == vehicle.sensors["dvl"]


def test_wrong_names_are_said(vehicle, mission):
    with pytest.raises(ValueError, match=r'no model "gm2"\. Models: white, gm1'):
        rival("gm2", vehicle, mission)
    with pytest.raises(ValueError, match='"sonar" is no sensor of this vehicle'):
        rival("white", vehicle, mission, sensors=["sonar"])
    with pytest.raises(ValueError, match="there are: compass, dvl, gps"):
        rival("arma", vehicle, mission, sensors=["rest"])
    with pytest.raises(ValueError, match='"oracle" needs the true error models'):
        rival("oracle", vehicle, mission)
    assert MODELS[:5] == ("white", "gm1", "gm1-fitted", "arma", "oracle")


def test_a_simulated_mission_gives_its_model_back():
    """Through the real series: a compass whose error is Gauss-Markov, and one that believes something else entirely."""
    from navfilter.simulation.scenarios import simulate_scenario

    vehicle, mission = simulate_scenario("lawnmower", seed=4, duration_s=1500.0)
    truth = vehicle.sensors["compass"].error
    wrong = vehicle.with_error(compass=nf.White(sd=0.05))
    model = rival("gm1-fitted", wrong, mission, sensors=["compass"]).sensors["compass"].error
    # 50 correlation times: ln tau is known to some 20 %, ln sd to half of that; two standard deviations.
    assert abs(np.log(model.tau_s / truth.tau_s)) < 0.45 and abs(np.log(model.sd / truth.sd)) < 0.25
