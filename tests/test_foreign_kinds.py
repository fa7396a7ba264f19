"""A sensor and an error model that nobody here knows go through everything, from vehicle.toml to learning."""

import itertools
import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from numba import njit

import navfilter as nf
from navfilter.check.description import describe_vehicle
from navfilter.check.plausibility import check_vehicle
from navfilter.io import write_vehicle
from navfilter.io.geodesy import ecef_from_geodetic
from navfilter.io.vehicle_template import vehicle_template
from navfilter.kernels import open_loop_residual
from navfilter.models.error_models import Block, ErrorModel, block_level
from navfilter.models.learned_arma import learned_part
from navfilter.models.navigation_drift import Drift
from navfilter.models.parameters import Parameter
from navfilter.models.sensors import Sensor
from navfilter.models.sensors.observable import Observable
from navfilter.models.sensors.traits import Columns, Example, Plausible
from navfilter.playback.replay import drive_samples
from navfilter.report.report import render_report
from navfilter.service.log import LOG_FILE, prepare_log
from navfilter.service.session import Options
from navfilter.simulation.manoeuvres import ChangeSpeed, Straight
from navfilter.simulation.motion import Motion
from navfilter.simulation.scenarios import SCENARIOS
from navfilter.simulation.simulate import Faults, StartErrors, simulate, tiny_missions


# --- a sensor: the distance to a beacon, with an unknown offset
# -----------------------------------------------------------------------
@njit(cache=True)
def beacon_range(z, nav, rate, par, cfg, H, res):
    """Distance to a point. cfg: its latitude, longitude [rad], height [m]. par: none or the offset [m]."""
    H[:] = 0.0
    north = (cfg[0] - nav[0]) * nav[15]
    east = (cfg[1] - nav[1]) * nav[16] * math.cos(0.5 * (cfg[0] + nav[0]))
    down = nav[2] - cfg[2]
    distance = math.sqrt(north * north + east * east + down * down)
    res[0] = z[0] - distance
    H[0, 0], H[0, 1], H[0, 2] = -north / distance, -east / distance, -down / distance
    if len(par) > 0:
        res[0] -= par[0]
        H[0, 9] = 1.0


@dataclass(frozen=True, kw_only=True)
class BeaconRange(Sensor):
    """Distance to a beacon on the bottom."""

    beacon_deg: tuple[float, float] = (0.0, 0.0)
    beacon_height_m: float = 0.0
    offset_sd_m: float = 0.0

    kernel: ClassVar = staticmethod(beacon_range)
    axis_names: ClassVar = ("range",)
    open_loop: ClassVar = open_loop_residual.POSITION
    observes: ClassVar = Observable.RANGE
    contents: ClassVar = ((Columns("beacon_range", ("range_m",), ("length",)),),)
    plausible: ClassVar = Plausible(1e-3, 100.0, "cm", most_rate_hz=20.0)

    def parameters(self):
        """The offset."""
        return (Parameter("offset", self.offset_sd_m, "m"),) if self.offset_sd_m else ()

    def constants(self, start):
        """Where the beacon is."""
        return np.array([*np.radians(self.beacon_deg), self.beacon_height_m])

    def simulated(self, here, truth):
        """The chord on the ellipsoid."""
        place = ecef_from_geodetic(np.column_stack([here.latitude, here.longitude, here.height]))
        beacon = ecef_from_geodetic(self.constants(None)[None])
        offset = truth.drawn["offset"][0] if self.offset_sd_m else 0.0
        return (np.linalg.norm(place - beacon, axis=1) + offset + truth.error[:, 0])[:, None], ("range_m",)


# --- an error model: what swings
# ------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Swing(ErrorModel):
    """Oscillation of random phase that is excited by white noise and decays."""

    sd: float
    swing_s: float
    tau_s: float

    def block(self, period_s):
        """Discretise: a rotation that shrinks."""
        angle, shrink = 2.0 * math.pi * period_s / self.swing_s, math.exp(-period_s / self.tau_s)
        c, s = math.cos(angle), math.sin(angle)
        variance = self.sd**2 * np.eye(2)
        return Block(
            shrink * np.array([[c, -s], [s, c]]), (1.0 - shrink**2) * variance, np.array([1.0, 0.0]), 0.0, variance
        )


RANGE_ERROR = nf.White(sd=0.3) + Swing(sd=0.5, swing_s=20.0, tau_s=40.0)


def vehicle_at(start, error=RANGE_ERROR, offset_sd_m=1.0):
    """A vehicle that hears one beacon north-east of its start, and whose gyros swing too."""
    beacon = (start.latitude_deg + 2e-3, start.longitude_deg + 3e-3)
    gyro = nf.White(density=1e-4) + nf.RandomWalk(density=1e-6) + Swing(sd=1e-5, swing_s=5.0, tau_s=10.0)
    return nf.Vehicle(
        imu=nf.Imu(rate_hz=20, gyro=gyro),
        sensors={
            "beacon": BeaconRange(
                rate_hz=2.0, error=error, beacon_deg=beacon, beacon_height_m=-40.0, offset_sd_m=offset_sd_m
            ),
            "compass": nf.Heading(rate_hz=4.0, error=nf.White(sd=0.01)),
            "dvl": nf.BodyVelocity(rate_hz=4.0, error=nf.White(sd=0.01)),
            "depth": nf.Depth(rate_hz=1.0, error=nf.White(sd=0.1)),
        },
        name="foreign",
    )


@pytest.fixture(scope="module")
def dive():
    """A vehicle with both foreign kinds, a mission of 300 s, and its smoothed track."""
    motion = SCENARIOS["lawnmower"].motion(300.0)
    vehicle = vehicle_at(motion)
    mission = simulate(vehicle, motion, seed=5, duration_s=300.0, start=StartErrors(position_sd_m=(5.0, 5.0, 1.0)))
    return vehicle, mission, nf.replay(vehicle, mission, smooth=True)


def test_each_is_short():
    """What the recipes promise: a sensor with its kernel, or an error model, in at most 60 lines."""
    lines = Path(__file__).read_text().splitlines()
    bounds = [k for k, line in enumerate(lines) if line.startswith(("# --- a", "# --- an", "RANGE_ERROR"))]
    assert len(bounds) == 3 and all(0 < after - before <= 60 for before, after in itertools.pairwise(bounds))


def test_vehicle_toml_writes_and_reads_them(dive, tmp_path):
    vehicle, _, _ = dive
    learnt = nf.LearnedArma(prior=Swing(sd=0.5, swing_s=20.0, tau_s=40.0))
    for each in (vehicle, vehicle.with_error(beacon=learnt)):
        path = write_vehicle(each, tmp_path / "vehicle.toml")
        assert 'type = "beacon-range"' in path.read_text() and 'model = "swing"' in path.read_text()
        assert nf.read_vehicle(path) == each


def test_mission_toml_maps_the_columns_of_the_kind(tmp_path):
    (tmp_path / "ranges.csv").write_text("t,km\n0,0.5\n1,0.75\n")
    mapping = (
        '[streams.beacon]\nfile = "ranges.csv"\ntime = {column = "t"}\nbeacon_range = {column = "km", unit = "km"}\n'
    )
    (tmp_path / "mission.toml").write_text(mapping)
    stream = nf.read_mission(tmp_path).streams["beacon"]
    assert stream.columns == ("range_m",) and stream.value.ravel().tolist() == [500.0, 750.0]
    (tmp_path / "mission.toml").write_text(mapping.replace('"km"}', '"deg"}'))
    with pytest.raises(ValueError, match=r'"deg" is no unit of length \(use m, mm, cm, km'):
        nf.read_mission(tmp_path)


def test_a_simulated_mission_is_replayed_as_well_as_the_filter_says(dive):
    _, mission, track = dive
    summary = track.summary(mission.truth)
    assert summary["used"]["beacon"] > 590 and summary["rejected"]["beacon"] == 0
    nis = track.residuals["beacon"].nis
    # 600 readings: the mean of chi-square over its freedom scatters by sqrt(2 / 600) = 0.06
    assert abs(float(np.nanmean(nis)) - 1.0) < 0.2
    offset = float(next(note for note in mission.notes if note.startswith("beacon: offset")).split()[-1])
    value, sd = track.state("beacon.offset")
    assert abs(value[-1] - offset) < 4.0 * sd[-1] < 4.0


def test_state_names_and_units_carry_through(dive):
    _, _, track = dive
    units = dict(zip(track.state_names, track.state_units, strict=True))
    assert units["beacon.offset"] == "m" and units["beacon_range[0]"] == "m"
    assert "beacon.offset_m" in track.to_frame().columns


def test_report_check_and_description_speak_of_them(dive):
    vehicle, mission, track = dive
    page = render_report({"foreign": track}, mission)
    assert "beacon" in page
    text = describe_vehicle(vehicle)
    assert 'Sensor "beacon": beacon range, 2 Hz' in text and "offset 1 m" in text and "Swing(sd=0.5" in text
    assert not [finding for finding in check_vehicle(vehicle) if finding.severity != "info"]
    found = check_vehicle(vehicle.with_error(beacon=Swing(sd=500.0, swing_s=20.0, tau_s=40.0)))
    assert [finding.stream for finding in found if finding.severity == "warning"] == ["sensors.beacon.error"]


def test_the_log_of_a_run_is_a_mission(dive, tmp_path):
    vehicle, mission, _ = dive
    stream = mission.streams["beacon"]
    with prepare_log(tmp_path, vehicle, Options(), resume=None, tell=print) as file:
        for time_s, value in zip(stream.time_s.tolist(), stream.value.tolist(), strict=True):
            file.write(json.dumps({"sensor": "beacon", "time_s": time_s, "value": value}).encode() + b"\n")
    assert (tmp_path / LOG_FILE).is_file() and nf.read_vehicle(tmp_path) == vehicle
    read = nf.read_mission(tmp_path).streams["beacon"]
    assert read.columns == ("range_m",) and np.array_equal(read.value, stream.value)


def test_warm_up_leaves_no_kernel_of_theirs_to_compile(dive):
    kinds = {type(sensor) for vehicle, _ in tiny_missions() for sensor in vehicle.sensors.values()}
    assert BeaconRange in kinds
    nf.warm_up()
    before = list(beacon_range.signatures)
    vehicle, mission, _ = dive
    nf.replay(vehicle, mission)
    assert beacon_range.signatures == before and len(before) == 1


def test_the_sensor_is_learnt():
    """On the way straight to the beacon: the direction in which it sees the position must not turn."""
    motion = Motion((ChangeSpeed(1.5, 10.0), Straight(640.0)), latitude_deg=26.0, heading_deg=0.0, surface_height_m=0.0)
    learned = nf.LearnedArma(prior=nf.White(sd=1.0), orders=((0, 0), (1, 0), (2, 1)), window=400, hop=100)
    vehicle, true = vehicle_at(motion, learned, offset_sd_m=0.0), nf.GaussMarkov(sd=1.0, tau_s=5.0)
    beacon = replace(vehicle.sensors["beacon"], beacon_deg=(26.02, motion.longitude_deg), beacon_height_m=0.0)
    vehicle = nf.Vehicle(vehicle.drive, {**vehicle.sensors, "beacon": beacon})
    mission = simulate(vehicle, motion, seed=6, duration_s=400.0, faults={"beacon": Faults(true_error=true)})
    models = nf.replay(vehicle, mission).error_models["beacon"]
    adopted = learned_part(models[-1][1][0])
    assert len(models) > 1 and adopted.model is not None
    # 200 s hold 20 times twice the correlation time: S(0) is known to a factor of two or so; the prior was off by 20
    level = block_level(adopted.block(0.5)) / block_level(true.block(0.5))
    assert 0.3 < level < 3.0


def test_snapshot_and_restore(dive):
    vehicle, mission, _ = dive
    times, values = drive_samples(vehicle, mission)
    ranges = mission.streams["beacon"]

    def feed(nav, rows):
        for k in rows:  # ten samples, then a range
            nav.step_samples(np.column_stack([times[10 * k : 10 * k + 10], values[10 * k : 10 * k + 10]]))
            nav.correct("beacon", float(ranges.time_s[k + 1]), ranges.value[k + 1])

    learned = nf.LearnedArma(prior=Swing(sd=0.5, swing_s=20.0, tau_s=40.0))
    for each in (vehicle, vehicle.with_error(beacon=learned)):
        nav = nf.Navigator(each, mission.start)
        feed(nav, range(20))
        nav.adopt("beacon", Swing(sd=0.7, swing_s=25.0, tau_s=40.0))
        feed(nav, range(20, 40))  # beyond what late readings reach, so that the model is in the snapshot
        again = nf.Navigator.restore(each, nav.snapshot())
        for run in (nav, again):
            feed(run, range(40, 60))
        assert np.array_equal(again.state.pack(), nav.state.pack()) and again.errors == nav.errors


def test_what_an_error_adds_to_an_integral():
    """A coloured model that nobody knows is white noise of its S(0), in a sum too; one with a unit root is a walk."""
    swing, period_s = Swing(sd=1e-3, swing_s=0.5, tau_s=1.0), 0.05
    level = block_level(swing.block(period_s))
    assert swing.integrated(period_s) == (level, 0.0, 0.0) and level > 0.0
    both = (nf.White(sd=0.1) + nf.RandomWalk(density=0.2, start_sd=0.3) + swing).integrated(period_s)
    assert both == pytest.approx((0.01 + level, 0.04 * period_s, 0.09), rel=1e-12)
    forever = Swing(sd=1.0, swing_s=0.5, tau_s=math.inf)
    assert forever.integrated(period_s) == (0.0, 0.0, 1.0)


def test_a_kind_without_a_drift_of_its_own_drifts_as_a_horizontal_position(dive):
    vehicle, _, _ = dive
    beacon, fix = vehicle.sensors["beacon"], nf.Position(rate_hz=2.0)
    assert beacon.drift(vehicle.drive, 0, 0.1) == fix.drift(vehicle.drive, 0, 0.1) != fix.drift(vehicle.drive, 2, 0.1)
    assert isinstance(beacon.drift(vehicle.drive, 0, 0.0), Drift)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (("offset", 1.0), r"beacon: a parameter is Parameter\(name, sd, unit\), such as .*found \(\'offset\', 1.0\)"),
        (Parameter("offset", 1.0, ""), "a parameter is Parameter"),
        (Parameter("offset", -1.0, "m"), 'the sd of the parameter "offset" must be a finite number >= 0, found -1.0'),
        (Parameter("offset", math.nan, "m"), "must be a finite number >= 0, found nan"),
    ],
)
def test_a_parameter_without_unit_or_with_a_wrong_sd_is_named(dive, monkeypatch, wrong, message):
    vehicle, mission, _ = dive
    monkeypatch.setattr(BeaconRange, "parameters", lambda self: (wrong,))
    with pytest.raises(ValueError, match=message):
        nf.Navigator(vehicle, mission.start)


@pytest.mark.parametrize(
    ("group", "message"),
    [("depth", 'two kinds of sensors mean different columns by "depth"'), ("file", '"file" is a key of every source')],
)
def test_a_group_of_columns_that_means_something_else_is_refused(monkeypatch, tmp_path, group, message):
    monkeypatch.setattr(BeaconRange, "contents", ((Columns(group, ("other_m",), ("length",)),),))
    (tmp_path / "mission.toml").write_text("")
    with pytest.raises(ValueError, match=message):
        nf.read_mission(tmp_path)


def test_a_kind_that_brings_an_example_stands_in_the_template(monkeypatch, tmp_path):
    example = Example(
        "beacon", "Distance to a beacon.", 2, ('error = {model = "swing", sd = 0.3, swing_s = 10, tau_s = 60}',)
    )
    monkeypatch.setattr(BeaconRange, "template", example)
    text = vehicle_template("imu")
    assert "# Distance to a beacon.\n[sensors.beacon]" in text and "#beacon_height_m = 0.0" in text
    (tmp_path / "vehicle.toml").write_text(text)
    sensor = nf.read_vehicle(tmp_path).sensors["beacon"]
    assert sensor == BeaconRange(rate_hz=2, error=Swing(sd=0.3, swing_s=10, tau_s=60))
