"""What is shown at a prompt: descriptions as they are typed in, results in a few lines; and when two are equal."""

import copy
import dataclasses
import datetime
import os
import pickle
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest
from small_run import small_run
from test_every_kind import VEHICLES

import navfilter as nf
from navfilter.foundation.display import Shown
from navfilter.models.error_models import ErrorModel
from navfilter.models.mechanisation import Mechanisation
from navfilter.models.sensors import Sensor
from navfilter.navigation.snapshot import fingerprint

#: What is at hand where all of navfilter has been imported.
PROMPT = {"datetime": datetime, **{name: getattr(nf, name) for name in nf.__all__}}
PUBLIC = [value for value in PROMPT.values() if isinstance(value, type)]
START = nf.Start(latitude_deg=45.0, longitude_deg=-4.0, date=datetime.date(2026, 5, 4), position_sd_m=(1.0, 1.0, 0.2))
MODEL = nf.ArmaModel([-0.8], [0.3], 0.01, covariance=np.eye(2) / 3.0, flags={"stale", "gaps", "coloured"})
MODELS = [
    nf.White(sd=0.1),
    nf.White(density=np.float64(1e-3)),
    nf.RandomWalk(density=1e-5),
    nf.RandomWalk(1e-5, start_sd=0),
    nf.GaussMarkov(sd=1 / 3, tau_s=30, order=2),
    nf.Arma(ar=[-0.8], ma=[0.2]),
    nf.Cycle(sd=0.1, period_s=44714.0, tau_s=1e6),
    nf.White(sd=0.1) + nf.GaussMarkov(sd=0.2, tau_s=60.0) + nf.RandomWalk(1e-6),
    nf.White(sd=0.1) + nf.LearnedArma(prior=nf.GaussMarkov(sd=0.2, tau_s=60.0) + nf.White(sd=1.0), orders=[(1, 0)]),
    nf.LearnedArma(model=MODEL, slow=nf.GaussMarkov(sd=0.2, tau_s=60.0), frozen=True),
]
SENSORS = [one for one in PUBLIC if issubclass(one, Sensor)]


def again(value):
    return eval(repr(value), dict(PROMPT))


@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
def test_an_error_model_is_shown_as_it_is_typed(model):
    assert again(model) == model and "None" not in repr(model)


def test_every_error_model_is_here():
    parts = {type(part) for model in MODELS for part in getattr(model, "parts", (model,))}
    assert {one for one in PUBLIC if issubclass(one, ErrorModel)} - {ErrorModel} == parts


@pytest.mark.parametrize("kind", SENSORS, ids=lambda kind: kind.__name__)
def test_a_sensor_is_shown_as_it_is_typed(kind):
    beacons = {"beacons": ((45.0, -4.0, -40.0),)} if kind is nf.Range else {}
    plain = kind(**beacons)
    assert again(plain) == plain and len(repr(plain)) < 70
    other = kind(rate_hz=3, error=nf.GaussMarkov(sd=0.01, tau_s=30), gate_timeout_s=np.inf, **beacons)
    assert again(other) == other
    assert repr(other).startswith(f"{kind.__name__}(rate_hz=3, error=GaussMarkov(sd=0.01, tau_s=30), ")


def test_what_is_at_its_default_is_left_out():
    assert repr(nf.Heading(rate_hz=8, error=nf.White(sd=0.01))) == "Heading(rate_hz=8, error=White(sd=0.01))"
    assert repr(nf.White(sd=1.0) + nf.RandomWalk(1e-3)) == "White(sd=1.0) + RandomWalk(density=0.001)"


@pytest.mark.parametrize("vehicle", [*VEHICLES.values(), nf.Vehicle(imu=nf.Imu(rate_hz=1))])
def test_a_vehicle_is_shown_as_it_is_typed(vehicle):
    assert again(vehicle) == vehicle and hash(again(vehicle)) == hash(vehicle)
    assert len(repr(vehicle).splitlines()) <= len(vehicle.sensors) + 6


def test_so_are_a_vehicle_with_lanes_a_start_and_a_model():
    units = {"a": nf.Imu(rate_hz=100), "b": nf.Imu(rate_hz=100, increments=True)}
    sensors = {"dvl": nf.BodyVelocity(rate_hz=4), "compass": nf.Heading(rate_hz=8)}
    for value in (nf.Vehicle(imus=units, sensors=sensors, name="x", dead_reckoning_lane=True), START, MODEL):
        assert again(value) == value


def test_a_kind_of_a_users_own_is_too():
    @dataclass(frozen=True, kw_only=True)
    class Sonar(nf.Heading):
        """Something else."""

        beams: int = 4

    @dataclass(frozen=True)
    class Plain(ErrorModel):
        """Shows itself in another way."""

        def __repr__(self):
            return "plain"

    assert repr(Sonar(beams=5)) == "Sonar(beams=5)"
    assert repr(Plain() + nf.White(sd=1.0)) == "plain + White(sd=1.0)"


# --- results ----------------------------------------------------------------------------------------------------------
def navigators():
    units = {"a": nf.Imu(rate_hz=100), "b": nf.Imu(rate_hz=100)}
    sensors = {"depth": nf.Depth(rate_hz=1), "compass": nf.Heading(rate_hz=8, error=nf.LearnedArma())}
    one = nf.Navigator(nf.Vehicle(imu=units["a"], sensors=sensors), START)
    several = nf.LaneNavigator(nf.Vehicle(imus=units, sensors=sensors), START)
    for k in range(50):
        one.step(0.01 * k, (0.0, 0.0, 0.0), (0.0, 0.0, -9.806))
        for unit in units:
            several.step(0.01 * k, (0.0, 0.0, 0.0), (0.0, 0.0, -9.806), unit)
    for nav in (one, several):
        nav.correct("depth", 0.49, 0.02)
    return one, several


def results():
    mission, tracks = small_run()
    track, series = tracks["smoothed"], nf.simulate_arma([-0.8], [0.3], 1.0, 3000, seed=1)
    one, several = navigators()
    bank, recursive = nf.timeseries.ArmaBank(window=2000), nf.RecursiveArma(1, 1, 2000)
    front = nf.timeseries.FrontEnd(recursive)
    bank.update_many(series)
    front.update_many(series)
    values = [track, mission, track.errors(mission.truth), *mission.streams.values(), *track.residuals.values()]
    values += [one, several, one.state, several.health, nf.Tape(), bank, recursive, front]
    return [*values, nf.fit_arma(series, 1, 1), nf.select_order(series, 1, 1), one.residuals("compass")[0]]


def test_results_are_shown_in_a_few_lines():
    for value in results():
        text, html = repr(value), value._repr_html_()
        assert isinstance(value, Shown) and len(text) < 1200, type(value)
        title, *rows = text.splitlines()
        assert len(rows) <= 20 and max(map(len, (title, *rows))) <= 160, text
        assert html.count("<tr>") == len(rows) and "array(" not in text, text


def test_a_comparison_shows_its_table():
    mission, tracks = small_run()
    compared = nf.compare(tracks, truth=mission.truth)
    assert repr(compared) == str(compared) and "position rms" in repr(compared)


def test_a_navigator_says_what_it_is_worth_and_what_is_in_force():
    one, several = navigators()
    assert repr(one).startswith("Navigator of vehicle, at 0.490 s")
    assert "LearnedArma(prior=" in repr(one) and "1 used" in repr(one) and "trust" in repr(one)
    assert "lane b" in repr(several) and "LearnedArma(prior=" in repr(several)
    assert one.snapshot() == one.snapshot()
    before = one.snapshot()
    repr(one)
    assert one.snapshot() == before, "to look changes something"


def test_what_is_not_finished_can_be_looked_at():
    """In a debugger, inside of what makes it."""
    for kind in (
        nf.Navigator,
        nf.LaneNavigator,
        nf.Tape,
        nf.Track,
        nf.Mission,
        nf.Stream,
        nf.NavState,
        nf.timeseries.ArmaBank,
    ):
        assert repr(object.__new__(kind)).startswith(f"<{kind.__module__}.{kind.__name__} object at")


# --- equality ---------------------------------------------------------------------------------------------------------
def test_values_with_the_same_numbers_are_equal():
    mission, tracks = small_run()
    one, several = navigators()
    values = [mission, *mission.streams.values(), *tracks.values(), tracks["forward"].vehicle, one.state, one.health]
    values += [
        several.state,
        START,
        MODEL,
        tracks["forward"].errors(mission.truth),
        *tracks["forward"].residuals.values(),
    ]
    for value in values:
        for other in (copy.deepcopy(value), copy.copy(value), pickle.loads(pickle.dumps(value))):
            assert value == other and hash(value) == hash(other), type(value)
        assert value != 1 and value != None  # noqa: E711


def test_values_with_others_are_not():
    mission, tracks = small_run()
    track, stream = tracks["forward"], mission.streams["depth"]
    assert stream != stream.later(1.0) and stream != stream.keep(slice(1, None)) and stream != mission
    assert mission != mission.with_stream("depth", stream.later(1.0)) and mission != mission.without_stream("depth")
    assert track != dataclasses.replace(track, height=track.height + 1e-9) and track != tracks["smoothed"]
    assert dataclasses.replace(track, cpu_s=1e9) == track, "how long it took is no part of what came out"


def test_replaying_twice_gives_equal_tracks():
    mission, tracks = small_run()
    vehicle, part = tracks["forward"].vehicle, mission.between(0.0, 20.0)
    assert nf.replay(vehicle, part, smooth=True) == nf.replay(vehicle, part, smooth=True)


def test_a_saved_mission_is_the_same(tmp_path):
    mission, _ = small_run()
    assert nf.read_mission(mission.save(tmp_path / "m.npz")) == mission


# --- what identifies a vehicle in a snapshot --------------------------------------------------------------------------
def test_equal_vehicles_have_one_fingerprint():
    learnt = nf.Heading(rate_hz=8, error=nf.LearnedArma(model=MODEL, frozen=True))
    vehicle = nf.Vehicle(imu=nf.Imu(rate_hz=100), sensors={"compass": learnt})
    other = vehicle.with_error(gyro=vehicle.drive.gyro)
    other = nf.Vehicle(
        imu=nf.Imu(rate_hz=np.float64(100.0)), sensors={"compass": dataclasses.replace(learnt, rate_hz=8.0)}
    )
    expected = fingerprint(vehicle)
    with np.printoptions(precision=2):
        assert vehicle == other and fingerprint(other) == expected
    changed = nf.ArmaModel(MODEL.ar + 1e-15, MODEL.ma, MODEL.sd, MODEL.covariance, flags=MODEL.flags)
    assert fingerprint(vehicle.with_error(compass=nf.LearnedArma(model=changed, frozen=True))) != expected
    assert fingerprint(vehicle.with_error(compass=nf.White(sd=1.0))) != expected
    imports = "import datetime; from navfilter import *; from navfilter.navigation.snapshot import fingerprint"
    for seed in ("1", "2", "3"):
        done = subprocess.run(
            [sys.executable, "-c", f"{imports}; print(fingerprint({vehicle!r}))"],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "PYTHONHASHSEED": seed},
        )
        assert done.stdout.strip() == expected


def test_all_that_is_described_shows_itself_so():
    described = [one for one in PUBLIC if issubclass(one, ErrorModel | Sensor | Mechanisation)]
    assert len(described) > 20 and all(one.__repr__ is not object.__repr__ for one in described)
