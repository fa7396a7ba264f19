"""A mission in stretches is, bit for bit, the mission reading by reading; and the kernels of it against their twins."""

from dataclasses import replace

import naive
import numpy as np
import pytest
from feeding import events_of
from feeding import one_by_one as feed_one_by_one
from kernel_inputs import assert_close, run_both
from state_differences import differences

import navfilter as nf
from navfilter.filter.records import RecordStore, Tape
from navfilter.kernels import batch as kernels
from navfilter.kernels import measurement
from navfilter.kernels.compiling.addresses import named
from navfilter.learning.schedule import LearningSchedule
from navfilter.navigation import runner
from navfilter.navigation.alternative import Alternative
from navfilter.playback.replay import _replayed
from navfilter.simulation.scenarios import simulate_scenario

DEG = np.pi / 180.0


def survey(seconds=60.0):
    """Coloured errors, scale and misalignment, a lever arm, fixes with gaps of the clock between the others."""
    base, mission = simulate_scenario("lawnmower", 3, seconds)
    slow = nf.GaussMarkov(sd=0.01, tau_s=10.0) + nf.White(sd=0.01)
    sensors = {
        "compass": nf.Heading(rate_hz=8, error=nf.GaussMarkov(sd=0.6 * DEG, tau_s=30.0) + nf.White(sd=0.1 * DEG)),
        "dvl": nf.BodyVelocity(rate_hz=4, error=slow, scale_sd=0.003, lever_arm_b_m=(0.5, 0.0, 0.1)),
        "depth": nf.Depth(rate_hz=1, error=nf.White(sd=0.05), offset_sd_m=0.2),
        "gps": base.sensors["gps"],
    }
    return nf.Vehicle(base.drive, sensors), mission


def changed(mission, name, **fields):
    return replace(mission, streams={**mission.streams, name: replace(mission.streams[name], **fields)})


def calibrated(vehicle):
    """The same with constants as states: of the inertial unit, and the lever arm of a sensor."""
    names = ("gyro_scale_sd", "gyro_misalignment_sd_rad", "accel_scale_sd", "accel_misalignment_sd_rad")
    sensors, unit = dict(vehicle.sensors), dict.fromkeys(names, 1e-3)
    sensors["dvl"] = replace(sensors["dvl"], lever_arm_sd_m=(0.1, 0.1, 0.1))
    return nf.Vehicle(replace(vehicle.drive, **unit), sensors)


def with_defects(mission):
    """Outliers in a row, a reading repeated for long, one that is none, a stamp twice, samples missing and impossible,
    an axis that sticks, standard deviations of single readings.
    """
    dvl, depth, imu = mission.streams["dvl"], mission.streams["depth"], mission.streams["imu"]
    speed = dvl.value.copy()
    speed[20:24] += 3.0
    speed[40] = np.nan
    stamps = dvl.time_s.copy()
    stamps[12] = stamps[11]  # before the outliers: Python looks at what comes after them
    mission = changed(mission, "dvl", value=speed, time_s=stamps)
    level = depth.value.copy()
    level[20:45] = level[20]
    sd = np.full((len(level), 1), np.nan)
    sd[10:15] = 0.2
    mission = changed(mission, "depth", value=level, sd=sd)
    keep = np.ones(len(imu.time_s), bool)
    keep[2000:2010] = False
    values = imu.value[keep].copy()
    values[3000, 2] = 1e6
    values[4500:4600, 4] = values[4500, 4]
    return changed(mission, "imu", time_s=imu.time_s[keep], value=values)


def one_by_one(monkeypatch):
    monkeypatch.setattr(runner.BatchRunner, "possible", property(lambda self: False))


def assert_same(one, other):
    for name in (
        "time_s",
        "latitude",
        "longitude",
        "height",
        "velocity_n",
        "attitude",
        "covariance",
        "states",
        "states_sd",
    ):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    assert one.counts == other.counts and one.residuals.keys() == other.residuals.keys()
    for sensor, residuals in one.residuals.items():
        for name in ("time_s", "value", "sd", "nis", "dof", "outcome"):
            np.testing.assert_array_equal(getattr(residuals, name), getattr(other.residuals[sensor], name))


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("defects", [False, True])
def test_in_stretches_as_one_by_one(smooth, defects, monkeypatch):
    vehicle, mission = survey()
    if defects:
        mission = with_defects(mission)
    monkeypatch.setattr(runner, "READINGS", 300)
    monkeypatch.setattr(runner, "ROWS", 40)
    together = nf.replay(vehicle, mission, smooth=smooth)
    reasons = []
    call = runner.BatchRunner._call
    monkeypatch.setattr(runner.BatchRunner, "_call", lambda self: reasons.append(call(self)) or reasons[-1])
    assert_same(together, nf.replay(vehicle, mission, smooth=smooth))
    expected = {kernels.DONE, kernels.FULL} | (
        {kernels.NEXT, kernels.REFUSED, kernels.JUDGED, kernels.HEED} if defects else set()
    )
    assert set(reasons) >= expected and len(reasons) < 100
    one_by_one(monkeypatch)
    assert_same(together, nf.replay(vehicle, mission, smooth=smooth))
    assert not defects or together.residuals["dvl"].count("rejected") >= 4


@pytest.mark.parametrize("defects", [False, True])
def test_learning_in_stretches_as_one_by_one(defects, monkeypatch):
    """Early models, the beginning done again, hops, another level of the error, a sensor that is stuck."""
    vehicle, mission = survey(100.0)
    learned = nf.LearnedArma(orders=[(0, 0), (1, 0)], window=400, hop=100)
    vehicle = vehicle.with_error(compass=learned, dvl=learned, depth=learned)
    monkeypatch.setattr(LearningSchedule, "EARLY_S", (15.0, 30.0, 40.0))
    monkeypatch.setattr(LearningSchedule, "ANOTHER", 0.01)
    monkeypatch.setattr(LearningSchedule, "WORSE", np.inf)  # whatever the fixes say
    if defects:
        mission = with_defects(mission)
        course = mission.streams["compass"].value.copy()
        course[500:] += np.random.default_rng(1).normal(0.0, 0.03, course[500:].shape)
        mission = changed(mission, "compass", value=course)
    reasons, begun = [], []
    call, again = runner.BatchRunner._call, runner.Rerun.run
    monkeypatch.setattr(runner.BatchRunner, "_call", lambda self: reasons.append(call(self)) or reasons[-1])
    monkeypatch.setattr(runner.Rerun, "run", lambda self: begun.append(self) or again(self))
    together, nav = _replayed(vehicle, mission, mission.start, Tape(5.0, smoothable=True), False, ())
    # once each time that models ask for it
    assert reasons.count(kernels.LEARN) >= 6 and len(begun) >= 2 and together.counts["adopted"] > 6
    calls = len(reasons)
    one_by_one(monkeypatch)
    alone, other = _replayed(vehicle, mission, mission.start, Tape(5.0, smoothable=True), False, ())
    assert len(reasons) == calls
    assert_same(together, alone)
    assert_same(together.forward, alone.forward)
    assert differences(nav.memory, other.memory) == []
    assert differences(nav.sensor_monitors, other.sensor_monitors) == []
    assert (nav.learning.memory.listeners["compass"].level > 1.0) == defects


@pytest.mark.parametrize("constants", [False, True])
@pytest.mark.parametrize("defects", [False, True])
def test_a_row_per_sample_is_what_the_vehicle_knew_then(defects, constants, monkeypatch):
    """In stretches, reading by reading and live, to the last bit; the rows at readings are those of any other rate."""
    vehicle, mission = survey(20.0)
    if constants:
        vehicle = calibrated(vehicle)
    if defects:
        mission = with_defects(survey(60.0)[1]).between(0.0, 50.0)
    monkeypatch.setattr(runner, "ROWS", 40)
    monkeypatch.setattr(RecordStore, "CHUNK", 40 * 200)
    track, at_readings = (nf.replay(vehicle, mission, output_rate_hz=rate) for rate in (None, np.inf))
    assert np.isin(mission.streams["imu"].time_s, track.time_s).all() and (np.diff(track.time_s) > 0.0).all()
    assert_same(track.keep(np.isin(track.time_s, at_readings.time_s)), at_readings)
    one_by_one(monkeypatch)
    assert_same(track, nf.replay(vehicle, mission, output_rate_hz=None))
    if defects:
        return
    nav, states = nf.Navigator(vehicle, mission.start), {}
    for event in events_of(vehicle, mission):
        feed_one_by_one(nav, [event])
        states[nav.time_s] = nav.state, nav.filter.present[81:]
        np.testing.assert_array_equal(nav.covariance, nav.state.covariance)
    assert states.keys() == set(track.time_s)
    for i, time_s in enumerate(track.time_s):
        state, variance = states[time_s]
        place = track.latitude[i], track.longitude[i], track.height[i]
        assert place == (state.latitude, state.longitude, state.height)
        np.testing.assert_array_equal(track.velocity_n[i], state.velocity_n)
        np.testing.assert_array_equal(track.covariance[i], state.covariance)
        np.testing.assert_array_equal(track.states_sd[i], np.sqrt(variance))


@pytest.mark.parametrize("smooth", [False, True])
def test_a_silence_of_all_sensors_longer_than_the_room_for_rows(smooth, monkeypatch):
    monkeypatch.setattr(runner, "ROWS", 8)
    monkeypatch.setattr(RecordStore, "CHUNK", 1)
    vehicle, mission = survey(30.0)
    for name in vehicle.sensors:
        mission = mission.hide(name, (2.0, 27.0))
    together = nf.replay(vehicle, mission, smooth=smooth)
    one_by_one(monkeypatch)
    assert_same(together, nf.replay(vehicle, mission, smooth=smooth))


def quiet(vehicle):
    """The same, described with a fraction of the noise; of the DVL one axis."""
    dvl = tuple(nf.White(sd=sd) for sd in (0.004, 0.03, 0.03))
    return vehicle.with_error(compass=nf.White(sd=0.002), dvl=dvl, depth=nf.White(sd=0.003))


@pytest.mark.parametrize("learning", [False, True])
@pytest.mark.parametrize("defects", [False, True])
def test_noise_that_is_larger_than_described_in_stretches_as_one_by_one(defects, learning, monkeypatch):
    """Each reading is heard, some are refused, and those behind them are used."""
    # a second filter beside the run has each reading taken by itself
    monkeypatch.setattr(Alternative, "begin", lambda *_: None)
    vehicle, mission = survey(120.0)
    vehicle, asked = quiet(vehicle), []
    if defects:
        mission = with_defects(mission)
    if learning:
        vehicle = vehicle.with_error(depth=nf.LearnedArma(orders=[(0, 0)], window=400, hop=50))
    taken = runner.BatchRunner._correct
    monkeypatch.setattr(runner.BatchRunner, "_correct", lambda self, at: (asked.append(at), taken(self, at)))
    stretches = nf.replay(vehicle, mission, smooth=True)
    few, many = len(asked), sum(len(mission.streams[name]) for name in vehicle.sensors)
    one_by_one(monkeypatch)
    alone = nf.replay(vehicle, mission, smooth=True)
    assert_same(stretches, alone)
    assert_same(stretches.forward, alone.forward)
    assert 0.3 < np.mean(stretches.residuals["compass"].used) < 1.0
    assert few < 0.4 * many  # the compass has jumped for half of the time: those are Python's


def test_correction_is_its_twin_for_every_kind(monkeypatch):
    ours, kinds, counts = kernels.correction, set(), set()

    def both(*args):
        copies = [a.copy() if isinstance(a, np.ndarray) else a for a in args]
        ours(*args)
        naive.correction(*copies)
        assert_close([args[i] for i in (2, 3, 4)], [copies[i] for i in (2, 3, 4)], 1e-8)
        spot = args[1]
        pulled = spot[kernels.MEM] + spot[kernels.VERDICT] + 3 + 2 * spot[0] + kernels.LET_GO
        assert args[0][pulled] == copies[0][pulled]
        a, errors = spot[0], spot[5]
        C = args[0][spot[kernels.OUTPUT] :][: a * errors].reshape(a, errors)
        given = *args[:5], *args[6:8], C, args[0][spot[kernels.NOISE] :][: a * a].reshape(a, a)
        once_more, twins = run_both(kernels.readmission, *given)
        assert_close(once_more[2:5], twins[2:5], 1e-8)
        counts.add(float(args[0][pulled]))
        kinds.add(named(args[1][kernels.EQUATION]).__name__)

    error = nf.White(sd=0.05) + nf.GaussMarkov(sd=0.1, tau_s=20.0)
    arm, clock = {"lever_arm_b_m": (0.1, 0.2, 0.3), "lever_arm_sd_m": (0.1, 0.1, 0.1)}, {"time_offset_sd_s": 0.01}
    ship = 0.7854, -0.0698, 0.0, 0.0, 0.0, 0.3
    sensors = {
        "compass": (nf.Heading(error=error), 0.3),
        "field": (nf.Heading(magnetometer=True, error=error, declination_rad=0.0), (0.2, -0.05, 0.4)),
        "ahrs": (nf.Attitude(error=error, misalignment_sd_rad=0.1, **clock), (0.0, 0.0, 0.3)),
        "depth": (nf.Depth(error=error, **arm, **clock), 1.0),
        "height": (nf.Altitude(error=error, bottom_height_m=-20.0), 20.0),
        "gps": (nf.Position(**arm), (0.7854, -0.0698, 0.0)),
        "dvl": (nf.BodyVelocity(error=error, scale_sd=0.01, **arm, **clock), (0.5, 0.1, 0.0)),
        "beams": (nf.DvlBeams(current_sd_m_s=0.2, **arm), (0.2, 0.1, -0.1, 0.0)),
        "water": (nf.WaterVelocity(), (0.4, 0.0, 0.0)),
        "course": (nf.Course(), (0.5, 0.2)),
        "wheels": (nf.Odometer(), 0.5),
        "free wheels": (nf.Odometer(constrained=False, error=error, scale_sd=0.01), 0.5),
        "lbl": (nf.Range(beacons=((45.001, -4.0, 0.0),), beacon_sd_m=(3.0, 3.0, 3.0)), 111.0),
        "usbl": (nf.Usbl(**clock), (5.0, 0.1, 0.3, *ship)),
    }
    still = {"still": nf.ZeroVelocity(rate_hz=10, gyro_mean_max=0.2), "turning": nf.ZeroRate(rate_hz=10)}
    sensors_only = {name: sensor for name, (sensor, _) in sensors.items()}
    vehicle = nf.Vehicle(imu=nf.Imu(rate_hz=100, gyro_scale_sd=0.01), sensors={**sensors_only, **still})
    nav = nf.Navigator(vehicle, nf.Start(latitude_deg=45.0, longitude_deg=-4.0, heading_sd_deg=20.0), history_s=0.0)
    monkeypatch.setattr(kernels, "correction", both)
    for k in range(1, 61):
        nav.step(0.01 * k, (0.0, 0.0, 0.1 if k < 31 else 0.001), (0.1, 0.0, -9.806))
        if k % 10 == 0:
            for name, (_, value) in sensors.items():
                nav.correct(name, 0.01 * k, value, sd=0.3 if k == 20 else None)
    nav.finish()
    assert kinds == {sensor.kernel.__name__ for sensor in vehicle.sensors.values()}
    assert {0.0, 1.0} < counts  # there are those that have been let go, and those that have not
    # every kernel of a measurement but those of the kinds that are on board
    public = {name for name, kernel in vars(measurement).items() if hasattr(kernel, "py_func") and name[0] != "_"}
    assert not public or public - kinds == {"earlier"}


@pytest.mark.parametrize(
    "sensor",
    [
        nf.Heading(rate_hz=8),
        nf.Heading(rate_hz=8, magnetometer=True),
        nf.BodyVelocity(rate_hz=4),
        nf.BodyVelocity(rate_hz=4, zero_is_invalid=False, max_speed_m_s=2.0),
        nf.Depth(rate_hz=1),
        nf.Altitude(rate_hz=1),
        nf.Position(rate_hz=1),
    ],
    ids=str,
)
def test_many_readings_are_read_as_one_by_one(sensor):
    rng = np.random.default_rng(5)
    values = rng.choice(
        [0.0, -0.5, 1.2, 3.0, 700.0, np.inf, np.nan], size=(200, 4), p=[0.2, 0.2, 0.2, 0.1, 0.1, 0.1, 0.1]
    )
    for width in range(max(1, sensor.reads), 5):
        z, good = sensor.read_all(values[:, :width])
        for given, made, ok in zip(values[:, :width], z, good, strict=True):
            one = sensor.read(given.copy())
            assert ok == (one is not None)
            if ok:
                np.testing.assert_array_equal(made, [*one, *[np.nan] * (len(made) - len(one))])
        assert 0 < good.sum() < len(values)


def test_a_kind_that_reads_in_its_own_way_is_asked_reading_by_reading():
    class Halved(nf.Heading):
        def read(self, value):
            return None if value[0] < 0.0 else super().read(0.5 * value)

    z, good = Halved(rate_hz=8).read_all(np.array([[1.0], [-1.0], [np.nan]]))
    assert good.tolist() == [True, False, False] and z[0, 0] == 0.5
