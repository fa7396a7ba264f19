"""What users hand over at a prompt: taken as it was meant, or refused with what was wrong and what to do."""

import ast
import copy
import datetime
import pickle
import types
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from small_run import small_run

import navfilter as nf
from navfilter.kernels import kalman
from navfilter.simulation.scenarios import stage

WHITE = nf.White(sd=0.1)
IMU = nf.Imu(rate_hz=100)
START = nf.Start(latitude_deg=45.0, longitude_deg=-4.0)
VEHICLE = nf.Vehicle(
    imu=IMU, sensors={"compass": nf.Heading(rate_hz=8), "dvl": nf.BodyVelocity(rate_hz=4), "depth": nf.Depth()}
)
STREAM = nf.Stream([0, 1, 2.0], [5, 6, 7], "depth_m")
MISSION = nf.Mission("dive", {"depth": STREAM})
DAYS = np.array(["2026-05-04", "2026-05-05"], dtype="datetime64[ns]")


def start(**others):
    return nf.Start(**{"latitude_deg": 45.0, "longitude_deg": -4.0, **others})


# --- descriptions -----------------------------------------------------------------------------------------------------
WRONG_DESCRIPTIONS = {
    "White.sd must be a number, found '0.1'": lambda: nf.White(sd="0.1"),
    "White.sd must be a number, found True": lambda: nf.White(sd=True),
    "White.sd must be a number, found (0.1, 0.2)": lambda: nf.White(sd=[0.1, 0.2]),
    "RandomWalk.density must be a number, found None": lambda: nf.RandomWalk(None),
    "GaussMarkov.order must be a whole number, found '2'": lambda: nf.GaussMarkov(sd=1, tau_s=3, order="2"),
    "Arma.ar must be finite numbers in a sequence, as [-0.8], found 0.5": lambda: nf.Arma(ar=0.5),
    "Arma.ma must be finite numbers in a sequence": lambda: nf.Arma(ar=[-0.5], ma="0.5"),
    "LearnedArma.orders must be pairs (p, q)": lambda: nf.LearnedArma(orders=(1, 0)),
    "LearnedArma.window must be a whole number, found 'x'": lambda: nf.LearnedArma(window="x"),
    "LearnedArma.model must be an ArmaModel, found Arma(": lambda: nf.LearnedArma(model=nf.Arma(ar=[-0.5])),
    "Heading.rate_hz must be a number, found '8'": lambda: nf.Heading(rate_hz="8"),
    "Heading.rate_hz must be a number, found None": lambda: nf.Heading(rate_hz=None),
    "Heading.bias_sd_rad must be a number, found 'x'": lambda: nf.Heading(bias_sd_rad="x"),
    "Heading.magnetometer must be True or False, found 'yes'": lambda: nf.Heading(magnetometer="yes"),
    "found the class White, which wants its numbers in brackets": lambda: nf.Heading(error=nf.White),
    "BodyVelocity.lever_arm_b_m must be 3 finite numbers, found 'abc'": lambda: nf.BodyVelocity(lever_arm_b_m="abc"),
    "BodyVelocity.scale_sd must be a finite number >= 0": lambda: nf.BodyVelocity(scale_sd="x"),
    "Vehicle.drive must be an Imu or a DeadReckoning, found the class Imu": lambda: nf.Vehicle(imu=nf.Imu),
    'Vehicle.sensors must be a dict by name, such as {"depth": Depth()}, found a list': lambda: nf.Vehicle(
        imu=IMU, sensors=[nf.Depth()]
    ),
    "Vehicle.sensors goes by names, found 1": lambda: nf.Vehicle(imu=IMU, sensors={1: nf.Depth()}),
    "Vehicle.name must be text, found 3": lambda: nf.Vehicle(imu=IMU, name=3),
    'without takes names, such as without("compass", "depth"), found': lambda: VEHICLE.without(["depth"]),
    "Start.latitude_deg must be a number, found '45'": lambda: start(latitude_deg="45"),
    "Start.longitude_deg must lie within 360 degrees, found 400": lambda: start(longitude_deg=400),
    "Start.velocity_n must be three finite numbers (north, east, down), found (1, 2)": lambda: start(velocity_n=[1, 2]),
    "Start.velocity_n must be three finite numbers": lambda: start(velocity_n=(np.nan, 0, 0)),
    "Start.position_sd_m must be a finite number >= 0, or three of them": lambda: start(position_sd_m=(1, 2)),
    "Start.heading_sd_deg must be a number, found None": lambda: start(heading_sd_deg=None),
    "Start.date must be a day such as datetime.date(2026, 5, 4), found 'x'": lambda: start(date="x"),
}


@pytest.mark.parametrize("words", WRONG_DESCRIPTIONS)
def test_wrong_descriptions_are_refused_in_words(words):
    with pytest.raises(ValueError) as refused:
        WRONG_DESCRIPTIONS[words]()
    assert words in str(refused.value)


def test_lists_and_arrays_are_numbers():
    arm = nf.BodyVelocity(lever_arm_b_m=(0.5, 0.0, 0.1), error=(WHITE,) * 3)
    for given in ([0.5, 0.0, 0.1], np.array([0.5, 0.0, 0.1]), pd.Series([0.5, 0.0, 0.1])):
        other = nf.BodyVelocity(lever_arm_b_m=given, error=[WHITE] * 3)
        assert other == arm and hash(other) == hash(arm)
    assert nf.White(sd=np.array(0.5)) == nf.White(sd=np.float32(0.5)) == nf.White(sd=0.5)
    assert type(nf.White(sd=np.float64(0.5)).sd) is float and nf.GaussMarkov(1, 2, 2.0).order == 2
    assert hash(nf.Range(beacons=[[45, -4, -40]])) == hash(nf.Range(beacons=((45, -4, -40),)))
    assert nf.Arma(ar=np.array([-0.5]), ma=pd.Series([0.1])) == nf.Arma(ar=(-0.5,), ma=(0.1,))
    assert start(velocity_n=np.zeros(3)) == start(velocity_n=[0, 0, 0])
    assert nf.Heading(magnetic=np.True_) == nf.Heading(magnetic=1) == nf.Heading(magnetic=True)


@pytest.mark.parametrize(
    "given", ["2026-05-04", datetime.datetime(2026, 5, 4, 12), DAYS[0], pd.Timestamp("2026-05-04T12:00Z")]
)
def test_dates_are_days(given):
    day = datetime.date(2026, 5, 4)
    assert start(date=given).date == day == nf.Mission("m", date=given).date
    assert type(start(date=given).date) is datetime.date
    assert nf.declination(45.0, -4.0, 0.0, given) == nf.declination(45.0, -4.0, 0.0, day)


# --- readings ---------------------------------------------------------------------------------------------------------
WRONG_READINGS = {
    "time_s must be seconds, found datetime64[ns]: (t - t[0]) / np.timedelta64(1": lambda: nf.Stream(DAYS, [1, 2]),
    "time_s must be seconds, found datetime64": lambda: nf.Stream(pd.DatetimeIndex(DAYS), [1, 2]),
    "time_s must be seconds, found timedelta64": lambda: nf.Stream(pd.to_timedelta([0, 1], unit="s"), [1, 2]),
    "time_s must be seconds, found a datetime": lambda: nf.Stream([datetime.datetime(2026, 5, 4)], [1]),
    "time_s must be a sequence, found 0.0. Of one reading it is [time_s]": lambda: nf.Stream(0.0, 5.0),
    "time_s must be real numbers, found ['a', 'b']": lambda: nf.Stream(["a", "b"], [1, 2]),
    "value must be real numbers, found [[1, 2], [3]]": lambda: nf.Stream([0, 1], [[1, 2], [3]]),
    "value must be real numbers, found [5j, 6.0]": lambda: nf.Stream([0, 1], [5j, 6.0]),
    "time_s is of float32, whose last digit is 1.3e+02 s at its end": lambda: nf.Stream(
        np.float32(1.78e9 + np.arange(3.0)), [1, 2, 3]
    ),
    "sd must be real numbers, found ['a', 'b']": lambda: nf.Stream([0, 1], [1, 2], sd=["a", "b"]),
    "keep takes a mask, a slice or indices of rows, found None": lambda: STREAM.keep(None),
    'Mission.streams must be a dict, found a list. By name: {"depth"': lambda: nf.Mission("m", [STREAM]),
    'stream "d" must be a Stream, found an ndarray': lambda: nf.Mission("m", {"d": np.zeros(3)}),
    "the name of a stream must be text, found 1": lambda: nf.Mission("m", {1: STREAM}),
    "Mission.truth must be a Stream or None, found an ndarray": lambda: nf.Mission("m", truth=np.zeros((3, 9))),
    "Mission.start must be a navfilter.Start, found {'latitude_deg': 1}": lambda: MISSION.with_start(
        {"latitude_deg": 1}
    ),
    "epoch_utc_s must be seconds since 1970, a datetime or None, found 'x'": lambda: nf.Mission("m", epoch_utc_s="x"),
    "Mission.windows takes pairs of mission times (t0_s, t1_s) in seconds, found (0, 10)": lambda: nf.Mission(
        "m", windows=(0, 10)
    ),
    "between takes pairs of mission times": lambda: MISSION.between(0, None),
    "hide takes pairs of mission times": lambda: MISSION.hide("depth", 0, 1),
}


@pytest.mark.parametrize("words", WRONG_READINGS)
def test_wrong_readings_are_refused_in_words(words):
    with pytest.raises(ValueError) as refused:
        WRONG_READINGS[words]()
    assert words in str(refused.value)


def test_tables_of_pandas_are_streams():
    table = pd.DataFrame({"x": [1, 2], "y": [3.0, np.nan]}, index=[0.0, 0.5])
    stream = nf.Stream(table.index, table)
    assert stream.columns == ("x", "y") and stream == nf.Stream([0.0, 0.5], [[1, 3], [2, np.nan]], ["x", "y"])
    assert np.isnan(nf.Stream([0, 1], pd.array([1, None], dtype="Int64")).value[1, 0])


def test_masked_values_are_missing():
    masked = np.ma.masked_array([1.0, -999.0, 3.0], [False, True, False])
    assert nf.Stream([0, 1, 2], masked) == nf.Stream([0, 1, 2], [1.0, np.nan, 3.0])
    series = np.ma.masked_greater(nf.simulate_arma([-0.8], [], 1.0, 600, seed=1), 2.0)
    gaps = series.filled(np.nan)
    assert nf.fit_arma(series, 1, 0) == nf.fit_arma(gaps, 1, 0)
    np.testing.assert_array_equal(nf.acf(series, 3), nf.acf(gaps, 3))
    assert nf.timeseries.fit_gauss_markov(series, 1, 10.0) == nf.timeseries.fit_gauss_markov(gaps, 1, 10.0)


def test_strided_and_read_only_arrays_are_streams():
    table = np.arange(24.0).reshape(6, 4)
    table.flags.writeable = False
    stream = nf.Stream(table[::2, 0], table[::2, ::-2])
    assert stream.value.flags.c_contiguous and stream == nf.Stream([0, 8, 16], [[3, 1], [11, 9], [19, 17]])


def test_an_epoch_is_a_date():
    for given in (1777852800.0, datetime.datetime(2026, 5, 4), pd.Timestamp("2026-05-04T00:00Z"), DAYS[0]):
        assert nf.Mission("m", {"depth": STREAM}, epoch_utc_s=given).begin_utc == "2026-05-04T00:00:00.000Z"


# --- runs and tracks --------------------------------------------------------------------------------------------------
def wrong_runs():
    mission, tracks = small_run()
    track = tracks["forward"]
    return {
        "replay: vehicle must be a Vehicle or a path or text, found a Mission. It is replay(": lambda: nf.replay(
            mission, VEHICLE
        ),
        "replay: mission must be a Mission or a path or text, found None": lambda: nf.replay(VEHICLE, None),
        "replay: start must be a Start or None, found a dict": lambda: nf.replay(VEHICLE, mission, start={}),
        "output_rate_hz must be > 0, or None for every sample, found 0": lambda: nf.replay(
            track.vehicle, mission, output_rate_hz=0
        ),
        "output_rate_hz must be > 0, or None": lambda: nf.Tape(-1.0),
        "align: vehicle must be a Vehicle, found a Mission": lambda: nf.align(mission, VEHICLE),
        "align: window_s must be > 0 seconds, found 'a'": lambda: nf.align(VEHICLE, mission, window_s="a"),
        'this mission has no reading in its stream "attitude"': lambda: nf.align(
            track.vehicle, mission.between(1e5, 2e5)
        ),
        "Navigator: vehicle must be a Vehicle, found a Start": lambda: nf.Navigator(START, VEHICLE),
        "Navigator: start must be a Start, found None": lambda: nf.Navigator(VEHICLE, None),
        "Navigator: tape must be a Tape or None, found True": lambda: nf.Navigator(VEHICLE, START, True),
        "LaneNavigator: vehicle must be a Vehicle, found a Start": lambda: nf.LaneNavigator(START, VEHICLE),
        "restore: vehicle must be a Vehicle, found None": lambda: nf.Navigator.restore(None, b""),
        "restore: source must be bytes or a path or text, found None": lambda: nf.Navigator.restore(VEHICLE, None),
        "warm_up: vehicle must be a Vehicle or None, found 3": lambda: nf.warm_up(3),
        "between rows needs two of them, this track has 1": lambda: track.keep(0).at([0.0]),
        "1 of 2 times lie outside this track, the first is 1e+06 s": lambda: track.at([10.0, 1e6]),
        "at: time_s must be seconds, found datetime64[ns]": lambda: track.at(DAYS),
        "keep takes a mask, a slice or indices": lambda: track.keep(None),
        "local takes radians, found 26.0, -80.0": lambda: track.local(26.0, -80.0),
        "errors: truth must be a Stream, found a Mission. That of a mission is": lambda: track.errors(mission),
        "errors: truth must have nine columns, found depth_m": lambda: track.errors(STREAM),
        "nees: errors must be a TrackErrors, found a Stream": lambda: track.nees(mission.truth),
        "summary: truth must be a Stream or None, found a Mission": lambda: track.summary(mission),
        "summary: windows takes pairs": lambda: track.summary(mission.truth, windows=(0, 10)),
        'no outcome is called "use"; there are used, rejected': lambda: track.residuals["gps"].count("use"),
        "write_track: track must be a Track, found None": lambda: nf.write_track(None, "x.csv"),
        'compare: tracks must be a dict, found a Track. By label: {"GM1": track}': lambda: nf.compare(track),
        'compare: tracks["a"] must be a Track, found 3': lambda: nf.compare({"a": 3}),
        "compare: truth must be a Stream or None, found a Mission": lambda: nf.compare({"a": track}, truth=mission),
        "calibrate: missions must be a Mission, found 3": lambda: nf.calibrate(VEHICLE, [3]),
        '"compas" is no sensor of this vehicle': lambda: nf.rival("gm1", VEHICLE, mission, sensors="compas"),
        "field must be one row (x, y, z) per reading, found shape (3, 100)": lambda: nf.calibrate_magnetometer(
            np.zeros((3, 100))
        ),
        "the readings lie on a short arc": lambda: nf.calibrate_magnetometer(np.zeros((100, 3))),
        "declination: latitude_deg must lie between": lambda: nf.declination(145.0, 0.0, 0.0, "2026-05-04"),
        "plus takes nine numbers": lambda: START.state.plus([1, 2, 3]),
        "FrontEnd: estimator must be a RecursiveArma or an ArmaBank, found None": lambda: nf.timeseries.FrontEnd(None),
        "orders must be pairs (p, q)": lambda: nf.timeseries.ArmaBank(2000, orders=(1, 1)),
        "add_arma: each of them must be an ArmaModel, found a White": lambda: nf.timeseries.add_arma([WHITE]),
        "n must be a whole number of samples": lambda: nf.simulate_arma([-0.8], [], 1.0, 2.5),
        "p must be a whole number, at least 0, found '1'": lambda: nf.fit_arma(np.zeros(100), "1", 0),
    }


@pytest.mark.parametrize("words", wrong_runs())
def test_wrong_runs_are_refused_in_words(words):
    with pytest.raises(ValueError) as refused:
        wrong_runs()[words]()
    assert words in str(refused.value)


def test_degrees_and_other_clocks_are_noticed():
    """The start had any heading; nothing was ever used."""
    staged = stage("compass-rolling", duration_s=20.0, imu_rate_hz=20.0)
    vehicle, mission = staged.vehicle, staged.mission(1).with_start(None)
    compass, imu = mission.streams["compass"], mission.streams["imu"]
    degrees = nf.Stream(compass.time_s, 180.0 + np.degrees(compass.value), compass.columns)
    with pytest.raises(ValueError, match="rad: is it in degrees"):
        nf.replay(vehicle, mission.with_stream("compass", degrees))
    with pytest.raises(ValueError, match="bring them to one clock"):
        nf.replay(vehicle, mission.with_stream("imu", imu.later(1.78e9)), start=staged.mission(1).start)


def test_rows_of_a_track():
    track = small_run()[1]["forward"]
    early = track.time_s < 10.0
    for rows in (early, early.tolist(), pd.Series(early), np.flatnonzero(early)):
        assert track.keep(rows) == track.keep(early)
    assert len(track.keep(3)) == len(STREAM.keep(1)) == 1 and len(track.keep([])) == 0
    assert track.keep([]).local().shape == (0, 3) and len(track.at(1.5)) == 1


# --- a navigator ------------------------------------------------------------------------------------------------------
def test_a_table_the_other_way_round_is_no_block_of_samples():
    """It was read across its rows: forces became rates."""
    units = nf.Vehicle(imus={"a": IMU, "b": IMU}, sensors={})
    for nav, unit in ((nf.Navigator(VEHICLE, START), ()), (nf.LaneNavigator(units, START), ("a",))):
        nav.step([0.01, 0.02], np.zeros((3, 2)), np.zeros((3, 2)), *unit)
        assert nav.counts["bad-sample"] == 1 and nav.time_s == 0.0
        nav.step([0.01, 0.02], pd.DataFrame(np.zeros((2, 3))), [[0, 0, -9.8]] * 2, *unit)
        assert nav.counts["bad-sample"] == 1 and nav.time_s == pytest.approx(0.02)


def test_nothing_that_arrives_raises():
    nav = nf.Navigator(VEHICLE, START)
    nav.step(0.01, (0, 0, 0), (0, 0, -9.8))
    for sd in ("a", [0.1, 0.2, 0.3], object(), {}):
        assert nav.correct("depth", 0.01, 0.1, sd=sd).status == "invalid"
    for value in (None, "a", object(), {}, [[]], [1j]):
        assert not nav.correct("depth", 0.01, value).accepted
    for time_s in (None, "a", datetime.datetime(2026, 5, 4), DAYS[0], [0.01, 0.02]):
        assert not nav.correct("depth", time_s, 0.1).accepted
        nav.step(time_s, (0, 0), "abc")
    assert nav.correct("depth", 0.01, np.float32(0.1)).accepted


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda nav: pickle.loads(pickle.dumps(nav))])
@pytest.mark.parametrize("lanes", [False, True])
def test_copies_of_a_navigator_go_on_by_themselves(again, lanes):
    learns = VEHICLE.with_error(compass=nf.LearnedArma())
    vehicle = nf.Vehicle(imus={"a": IMU, "b": IMU}, sensors=learns.sensors) if lanes else learns
    nav = (nf.LaneNavigator if lanes else nf.Navigator)(vehicle, START)

    def run(one, begin, end):
        for k in range(begin, end):
            for unit in ("a", "b") if lanes else ():
                one.step(0.01 * k, (0.0, 0.001, 0.0), (0.01, 0.0, -9.8), unit)
            if not lanes:
                one.step(0.01 * k, (0.0, 0.001, 0.0), (0.01, 0.0, -9.8))
            if not k % 25:
                one.correct("compass", 0.01 * k, 0.1)

    run(nav, 1, 300)
    other = again(nav)
    before = nav.state
    run(other, 300, 600)
    assert nav.state == before and other.time_s > nav.time_s
    run(nav, 300, 600)
    assert other.state == nav.state


# --- estimators, and what else can be copied --------------------------------------------------------------------------
@pytest.mark.parametrize("again", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_copies_of_an_estimator_go_on_by_themselves(again):
    """The candidates of a bank work in two arrays of it. In a copy they stood apart, so that the kernel went on with
    windows that were never emptied, and wrote beyond the end of its memory.
    """
    series = nf.simulate_arma([-0.8], [0.3], 1.0, 6000, seed=1)
    for make in (
        lambda: nf.timeseries.ArmaBank(2000),
        lambda: nf.RecursiveArma(1, 1, 2000),
        lambda: nf.timeseries.FrontEnd(nf.timeseries.ArmaBank(500)),
    ):
        one = make()
        one.update_many(series[:2500])
        other, before = again(one), one.model
        other.update_many(series[2500:])
        assert one.model == before
        one.update_many(series[2500:])
        assert one.model == other.model != before


def test_kernels_can_be_looked_at_while_they_are_made():
    for kernel in vars(kalman).values():
        if type(kernel).__name__ in ("Apart", "Inner"):
            with pytest.raises(AttributeError):
                _ = type(kernel).__new__(type(kernel)).anything


# --- the face ---------------------------------------------------------------------------------------------------------
def test_checkers_see_what_is_imported_later():
    """Without these imports everything is Any to them, and a misspelt name passes."""
    stub = ast.parse(Path(nf.__file__).with_suffix(".pyi").read_text())
    stated = {a.name: line.module for line in stub.body if isinstance(line, ast.ImportFrom) for a in line.names}
    assert stated == nf._HOME and {*nf.__all__} == {*stated} - {"timeseries"}
    assert (Path(nf.__file__).parent / "py.typed").exists()


def test_completion_shows_what_is_public():
    for name in nf.__all__:
        getattr(nf, name)
    shown = [name for name in dir(nf) if not name.startswith("__")]
    assert shown == nf.__all__ and not any(isinstance(getattr(nf, name), types.ModuleType) for name in shown)
    with pytest.raises(AttributeError, match="Navigatr") as missing:
        _ = nf.Navigatr
    assert missing.value.name == "Navigatr" and missing.value.obj is nf


@pytest.mark.slow
def test_a_checked_script_of_a_user(tmp_path):
    """What docstrings call a sequence may be a list, and a misspelt name is found."""
    api = pytest.importorskip("mypy.api")
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    found, _, status = api.run(["--strict", "--cache-dir", str(tmp_path / "cache"), str(script)])
    assert status == 1 and found.count("error:") == 1 and 'Unexpected keyword argument "rate" for "Heading"' in found


SCRIPT = """
import numpy as np
import navfilter as nf

learnt = nf.LearnedArma(orders=[(1, 0), (2, 1)], prior=nf.GaussMarkov(sd=0.01, tau_s=30))
mission = nf.Mission("dive", {"depth": nf.Stream(np.arange(3), [1.0, 2.0, 3.0], ["depth_m"])})
sensors = {"depth": nf.Depth(error=learnt + nf.White(sd=0.1)), "compass": nf.Heading(error=nf.Arma(ar=[-0.8]))}
vehicle = nf.Vehicle(imu=nf.Imu(rate_hz=100), sensors=sensors)
track: nf.Track = nf.replay(vehicle, mission).at([0.0, 1.0])
outcome: nf.Outcome = nf.Navigator(vehicle, nf.Start(latitude_deg=45.0, longitude_deg=-4.0)).correct("depth", 0, [1])
sd: float = nf.fit_arma([1.0] * 100, 1, 1).model.sd + nf.ArmaModel([-0.8], [], 1.0).sd
nf.Heading(rate=8)
"""
