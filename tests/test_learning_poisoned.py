"""What is learnt after a fault of a minute is what would have been learnt without it."""

import math
from functools import cache

import numpy as np
import pytest

import navfilter as nf
from navfilter.models.learned_arma import changed, learned_part
from navfilter.models.state import wrap
from navfilter.simulation.scenarios import survey, survey_vehicle
from navfilter.simulation.simulate import simulate

DEG = math.pi / 180.0
TRUE = nf.GaussMarkov(sd=0.5 * DEG, tau_s=10.0, order=2) + nf.White(sd=0.05 * DEG)
BELIEF = nf.GaussMarkov(sd=0.6 * DEG, tau_s=30.0) + nf.White(sd=0.1 * DEG)
DURATION_S, FAULT_S = 1400.0, 600.0


@cache
def dive():
    plain = survey_vehicle()
    sensors = {name: plain.sensors[name] for name in ("compass", "dvl", "depth")}
    vehicle = nf.Vehicle(nf.Imu(rate_hz=25.0, gyro=plain.drive.gyro, accel=plain.drive.accel), sensors)
    vehicle = vehicle.with_error(compass=TRUE)
    return vehicle, simulate(vehicle, survey(DURATION_S), seed=4, duration_s=DURATION_S)


def held(value):
    return np.broadcast_to(value[:1], value.shape)


FAULTS = {
    "iron": lambda value: wrap(value + 25.0 * DEG),
    "turned": lambda value: wrap(value + math.pi),
    "stuck": held,
}


def learnt(fault=None):
    """The compass's model at the end, and the counters."""
    vehicle, mission = dive()
    if fault is not None:
        stream = mission.streams["compass"]
        inside = (stream.time_s >= FAULT_S) & (stream.time_s < FAULT_S + 60.0)
        value = stream.value.copy()
        value[inside] = FAULTS[fault](value[inside])
        mission = mission.with_stream("compass", nf.Stream(stream.time_s, value, stream.columns))
    vehicle = vehicle.with_error(compass=nf.LearnedArma(prior=BELIEF))
    track = nf.replay(vehicle, mission, output_rate_hz=1.0)
    models = [m[0] if isinstance(m, tuple) else m for t, m in track.error_models["compass"]]
    return models[-1], track


def spectrum(model, frequency_hz):
    """[rad^2/Hz]"""
    block = model.block(0.125)
    z = np.exp(2j * np.pi * frequency_hz * 0.125)
    gain = block.C @ np.linalg.inv(z * np.eye(block.size) - block.Phi)
    return 0.25 * float(np.real(gain @ block.Q @ gain.conj()) + block.r)


@cache
def undisturbed():
    return learnt()[0]


@pytest.mark.parametrize("fault", FAULTS)
def test_ten_minutes_after_a_minute_of_wrong_headings_the_model_is_that_without_them(fault):
    model, track = learnt(fault)
    assert learned_part(model).model is not None and not any("Offset" in part for part in str(model).split(" + "))
    # a minute less of an hour's window: what is believed of the spectrum is good to a factor of 1.3 (sd)
    for frequency_hz in (0.003, 0.01, 0.03, 0.1, 0.5):
        ratio = spectrum(model, frequency_hz) / spectrum(undisturbed(), frequency_hz)
        assert 0.7 < ratio < 1.4, (frequency_hz, ratio)
    changes = [t for t, _ in track.error_models["compass"] if FAULT_S < t < FAULT_S + 120.0]
    assert (fault == "stuck") or len(changes) >= 2  # the constant came and went


def frozen(time_s, value):
    """All six axes repeat what they said, through a turn."""
    inside = (time_s >= FAULT_S) & (time_s < FAULT_S + 10.0)
    return time_s, np.where(inside[:, None], value[np.argmax(inside)], value)


def silent(time_s, value):
    kept = (time_s < FAULT_S) | (time_s >= FAULT_S + 20.0)
    return time_s[kept], value[kept]


def doubled(time_s, value):
    inside = (time_s >= FAULT_S) & (time_s < FAULT_S + 120.0)
    return time_s, np.where(inside[:, None], value * (1.0, 1.0, 2.0, 1.0, 1.0, 1.0), value)


def shaken(time_s, value):
    inside = (time_s >= FAULT_S) & (time_s < FAULT_S + 60.0)
    return time_s, np.where(inside[:, None], value + 0.5 * np.eye(6)[3], value)


def sizes(model):
    """Standard deviation of an error model [deg]."""
    block = model.block(0.125)
    return math.sqrt(float(block.C @ block.P0 @ block.C) + block.r) / DEG


@pytest.mark.parametrize("fault", [frozen, silent, doubled, shaken])
def test_while_the_unit_is_left_out_its_open_loop_is_none(fault):
    """Where no gyro is, no turn is made: the compass then seems to be wrong by all of it (up to 100 deg where the drift
    of the open loop did not begin anew). A first model is 1.6 times as large as the truth in any mission.
    """
    vehicle, mission = dive()
    stream = mission.streams["imu"]
    time_s, value = fault(stream.time_s, stream.value)
    mission = mission.with_stream("imu", nf.Stream(time_s, value, stream.columns))
    track = nf.replay(vehicle.with_error(compass=nf.LearnedArma(prior=BELIEF)), mission, output_rate_hz=1.0)
    adopted = [(t, models[0] if isinstance(models, tuple) else models) for t, models in track.error_models["compass"]]
    # as it was learnt: its level follows the seconds in which the unit errs unseen, and comes back when it is left out
    later = [sizes(*changed([model], level=1.0)) for t, model in adopted if t > FAULT_S]
    assert all(0.5 < learned_part(model).level < 2.0 for t, model in adopted if t > FAULT_S + 5.0)
    assert sum(track.counts[name] for name in ("stuck", "silent", "contradicted")) >= 1
    assert max(later, default=0.0) < 3.0 * sizes(TRUE)  # there may be nothing new to be learnt
