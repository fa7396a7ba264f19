"""vehicle.toml: what is written comes back, units in keys, every mistake named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navfilter.io import VehicleError, read_vehicle, write_vehicle
from navfilter.io.write import labelled, write_outputs
from navfilter.models.error_models import Arma, GaussMarkov, RandomWalk, White
from navfilter.models.learned_arma import LearnedArma, learned_part
from navfilter.models.mechanisation import DeadReckoning, Imu
from navfilter.models.sensors import BodyVelocity, Depth, Heading, Position, WaterVelocity, ZeroVelocity
from navfilter.models.vehicle import Vehicle
from navfilter.playback.replay import replay
from navfilter.simulation.scenarios import simulate_scenario
from navfilter.timeseries.model import ArmaModel

RECORDINGS = Path(__file__).parent / "recordings"

INERTIAL = Vehicle(
    imu=Imu(rate_hz=100.0, gyro=White(density=1e-4) + RandomWalk(density=1e-6, start_sd=1e-5), accel=White(sd=0.03)),
    sensors={
        "compass": Heading(
            rate_hz=8.0, error=Arma(ar=(-0.5, 0.1), ma=(0.2,), sd=0.01), magnetometer=True, bias_sd_rad=0.1
        ),
        "dvl": BodyVelocity(
            rate_hz=4.0,
            error=(White(sd=0.01), White(sd=0.02) + GaussMarkov(sd=0.1, tau_s=30.0, order=2), White(sd=0.03)),
            lever_arm_b_m=(0.5, 0.0, 0.1),
        ),
        "depth": Depth(rate_hz=1.0, pressure=True),
        "gps": Position(error=GaussMarkov(sd=3.0, tau_s=60.0)),
        "water": WaterVelocity(
            rate_hz=2.0, current_sd_m_s=0.5, current_tau_s=7200.0, mounting_rad=(0.0, 0.0, 0.7), scale_sd=0.01
        ),
        "still": ZeroVelocity(),
    },
    name='made of everything, \U0001f6a2 \x7f "\\\n',
)
RECKONING = Vehicle(
    drive=DeadReckoning(
        rate_hz=5.0,
        attitude=Heading(rate_hz=5.0, error=GaussMarkov(sd=0.02, tau_s=100.0), deviation_sd_rad=(0.1, 0.05)),
        velocity=BodyVelocity(rate_hz=5.0, scale_sd=0.01),
        tilt=White(sd=0.001) + RandomWalk(density=1e-6),
    ),
    sensors={"a name": Position()},
)
SLOW = Vehicle(drive=DeadReckoning(rate_hz=5.0, attitude=Heading(rate_hz=1.0), velocity=BodyVelocity(rate_hz=1.0)))
PLAIN = Vehicle(
    drive=DeadReckoning(rate_hz=1.0, attitude=(White(sd=0.1), White(sd=0.2), White(sd=0.3)), velocity=White(sd=0.1))
)
ADOPTED = ArmaModel(
    [-1.2, 0.3], [0.1], 0.0123456789012345, np.diag([1e-4, 2e-4, 3e-4]) - 1e-5, 0.25, 3990.5, frozenset({"a", "b c"})
)
LEARNING = Vehicle(
    imu=Imu(rate_hz=100.0),
    sensors={
        "plain": Heading(rate_hz=8.0, error=LearnedArma()),
        "prior": Heading(
            rate_hz=8.0,
            error=LearnedArma(prior=GaussMarkov(sd=0.01, tau_s=30.0), orders=((1, 0), (4, 4)), window=2000, hop=7),
        ),
        "known": Heading(
            rate_hz=8.0, error=LearnedArma(prior=GaussMarkov(sd=0.01, tau_s=30.0), prior_within=(2.0, 3.0))
        ),
        "sum": Depth(error=White(sd=0.01) + LearnedArma(prior=White(sd=0.1) + RandomWalk(density=1e-3))),
        "adopted": Depth(error=LearnedArma(model=ADOPTED)),
        "slow": Depth(error=LearnedArma(model=ADOPTED, slow=GaussMarkov(sd=0.1, tau_s=60.0))),
        "two": Depth(
            error=White(sd=0.1)
            + LearnedArma(
                model=ADOPTED, slow=GaussMarkov(sd=0.1, tau_s=60.0) + GaussMarkov(sd=0.2, tau_s=300.0, order=2)
            )
        ),
        "white": Depth(error=LearnedArma(model=ArmaModel([], [], 0.5, np.zeros((0, 0)), 0.02))),
        "axes": BodyVelocity(
            error=(LearnedArma(), White(sd=0.1), LearnedArma(model=ArmaModel([], [], 0.5, sd_log_s0=np.inf)))
        ),
    },
)


@pytest.mark.parametrize(
    "vehicle", [INERTIAL, RECKONING, SLOW, PLAIN, LEARNING], ids=["inertial", "reckoning", "slow", "plain", "learning"]
)
def test_what_is_written_comes_back(tmp_path, vehicle):
    assert read_vehicle(write_vehicle(vehicle, tmp_path / "v.toml")) == vehicle


def test_what_a_run_has_learnt_is_written_for_the_next_one(tmp_path):
    """The file holds the models in force at the end, number for number; a run that learnt nothing writes none."""
    vehicle, mission = simulate_scenario("lawnmower", seed=3, duration_s=150.0)
    learning = vehicle.with_error(compass=White(sd=0.001) + LearnedArma(window=400, orders=((1, 0), (1, 1))))
    for who, expected in ((vehicle, False), (learning, True)):
        track = replay(who, mission)
        files = {path.name for path in write_outputs(labelled(track), mission, tmp_path / str(expected))}
        assert ("vehicle_learned.toml" in files) == expected
    back = read_vehicle(tmp_path / "True" / "vehicle_learned.toml")
    last = track.error_models["compass"][-1][1][0]
    assert learned_part(last).model is not None and back.sensors["compass"].error == last
    assert back.with_error(compass=learning.sensors["compass"].error) == learning


@pytest.mark.parametrize(
    "path", sorted(RECORDINGS.glob("*/*/vehicle.toml")), ids=lambda p: f"{p.parts[-3]}-{p.parts[-2]}"
)
def test_vehicles_of_the_recordings(tmp_path, path):
    vehicle = read_vehicle(path)
    assert read_vehicle(write_vehicle(vehicle, tmp_path / "v.toml")) == vehicle


def test_units_in_keys(tmp_path):
    (tmp_path / "vehicle.toml").write_text(
        """
        [drive]
        type = "imu"
        rate_hz = 100
        gyro = {model = "random-walk", density_deg_per_h_per_sqrt_h = 6.0, start_sd_deg_per_h = 36.0}
        accel = {model = "white", density_ug_per_sqrt_hz = 100.0}
        [sensors.compass]
        type = "heading"
        error = {model = "white", sd_deg = 0.5}
        deviation_sd_deg = [1.0, 0.5]
        [sensors.dvl]
        type = "body-velocity"
        mounting_deg = [0.0, 0.0, 45.0]
        error = {model = "white", sd_cm_per_s = 2.0}
        lever_arm_b_cm = [50.0, 0.0, 10.0]
        """
    )
    vehicle = read_vehicle(tmp_path)
    assert vehicle.name == tmp_path.name
    assert vehicle.drive.gyro.density == pytest.approx(np.radians(6.0) / 3600 / 60)
    assert vehicle.drive.gyro.start_sd == pytest.approx(np.radians(36.0) / 3600)
    assert vehicle.drive.accel.density == pytest.approx(9.80665e-4)
    assert vehicle.sensors["compass"].error.sd == pytest.approx(np.radians(0.5))
    assert vehicle.sensors["compass"].deviation_sd_rad == pytest.approx(np.radians([1.0, 0.5]))
    assert vehicle.sensors["dvl"].mounting_rad == pytest.approx((0.0, 0.0, np.pi / 4))
    assert vehicle.sensors["dvl"].error.sd == pytest.approx(0.02)
    assert vehicle.sensors["dvl"].lever_arm_b_m == pytest.approx((0.5, 0.0, 0.1))


@pytest.mark.parametrize(
    ("text", "messages"),
    [
        ("", ["drive: a vehicle has a [drive], or inertial units as [imus.a]"]),
        ('[drive]\ntype = "rocket"\n', ['drive: there is no kind "rocket"']),
        ('[drive]\ntype = "imu"\nrate_hz = 0\n', ["drive.rate_hz: must be >= 1e-06; found 0"]),
        ("[drive]\nrate_hz = 1\n", ["drive: the key 'type' is missing"]),
        ('[drive]\ntype = "imu"\nrate_hz = 9\ngyro = {model = "white", sd = 1, sd_deg = 2}\n', ["given twice"]),
        (
            '[drive]\ntype = "imu"\nrate = 1\n[sensors.d]\ntype = "depth"\nerror = {model = "white", sd = "much"}\n',
            ["3 mistakes", 'drive.rate: unknown key; did you mean "rate_hz"?', "sensors.d.error.sd:", 'found "much"'],
        ),
        (
            '[drive]\ntype = "imu"\nrate_hz = 9\n[sensors.d]\ntype = "body-velocity"\nerror = {x = {model = "white", '
            "sd = 1}}\n",
            ["sensors.d.error.y: this key is missing", "sensors.d.error.z: this key is missing"],
        ),
        ('[drive]\ntype = "imu"\nrate_hz = 9\n[sensors.gyro]\ntype = "depth"\n', ['"gyro" is reserved']),
    ],
)
def test_mistakes_are_named(tmp_path, text, messages):
    (tmp_path / "vehicle.toml").write_text(text)
    with pytest.raises(VehicleError) as caught:
        read_vehicle(tmp_path)
    for message in messages:
        assert message in str(caught.value)


EVERY_MISTAKE = """
nam = "x"
[drive]
type = "imu"
rate_hz = -5
gyro = [{model = "white", sd_deg = -1}, {model = "random-walk", density_deg_per_hour = 1}]
accel = {model = "white"}
increments = 3
[sensors.compass]
type = "heading"
rate_hz = "8"
error = [{model = "white", sd_deg = -1.5}, {model = "gauss-markov", sd_deg = "x", tau_s = 0, order = 2.0}, {model = "gauss-markow"}]
deviation_sd_deg = [1, 2, 3]
magnetic = "no"
[sensors.dvl]
type = "body-velocity"
error = {x = {model = "white", sd = true}, y = [{model = "arma", ar = [-2.0]}], z = []}
lever_arm_b_m = [1, 2]
mounting_deg = ["a", 1, 2]
gate_probability = 1
[sensors.truth]
type = "depth"
offset_sd_mm = inf
latitude_deg = 91
[sensors.gps]
type = "position"
lever_arm_b_m = 3
error = {north = {model = "white", sd = 1}, up = {model = "white", sd = 1}, down = {model = "white", sd = -2}}
[sensors.learning]
type = "depth"
error = {model = "learned-arma", orders = [[1, 11], [1]], window = 50, prior = {model = "learned-arma"}}
[sensors.adopted]
type = "depth"
error = {model = "learned-arma", adopted = {ar = [-1.5], ma = [], sd = -1, covariance = [[1.0]], flag = 3}}
"""


def test_every_mistake_at_once(tmp_path):
    """Each with its path and value as they stand in the file, and a cure; none hides another."""
    (tmp_path / "vehicle.toml").write_text(EVERY_MISTAKE)
    with pytest.raises(VehicleError) as caught:
        read_vehicle(tmp_path)
    first, *found = str(caught.value).splitlines()
    expected = [
        "drive.rate_hz: must be >= 1e-06; found -5.",
        "drive.gyro[0].sd_deg: must be >= 0; found -1.",
        "drive.gyro[1].density: this key is missing; add it.",
        'drive.gyro[1].density_deg_per_hour: unknown key; did you mean "density_deg_per_h"? known keys: density, '
        "model, start_sd.",
        "drive.accel: White needs exactly one of sd and density, found sd=None, density=None.",
        "drive.increments: must be true or false; found 3.",
        'sensors.compass.rate_hz: must be a number; found "8".',
        "sensors.compass.error[0].sd_deg: must be >= 0; found -1.5.",
        'sensors.compass.error[1].sd_deg: must be a number; found "x".',
        "sensors.compass.error[1].tau_s: must be >= 1e-06; found 0.",
        "sensors.compass.error[1].order: must be a whole number; found 2.0.",
        'sensors.compass.error[2]: there is no kind "gauss-markow"; did you mean "gauss-markov"? known: ',
        "sensors.compass.deviation_sd_deg: may have 2 values, not 3; found [1, 2, 3].",
        'sensors.compass.magnetic: must be true or false; found "no".',
        "sensors.dvl.error.x.sd: must be a number; found true.",
        "sensors.dvl.error.y[0]: Arma.ar has a pole of radius 2.000000: ",
        "sensors.dvl.error.z: an empty list is no error model; give at least one, such as ",
        "sensors.dvl.lever_arm_b_m: needs 3 values; found [1, 2].",
        'sensors.dvl.mounting_deg[0]: must be a number; found "a".',
        "sensors.dvl.gate_probability: must be < 1; found 1.",
        'sensors.truth: "truth" is reserved for the drive; give the sensor another name.',
        "sensors.truth.offset_sd_mm: must be a finite number; found inf.",
        "sensors.truth.latitude_deg: must be <= 90; found 91.",
        "sensors.gps.lever_arm_b_m: must be a list, such as [1.0, 2.0]; found 3.",
        "sensors.gps.error.down.sd: must be >= 0; found -2.",
        "sensors.gps.error.east: this key is missing; add it.",
        "sensors.gps.error.up: unknown key; known keys: down, east, north.",
        "sensors.learning.error.orders[0][1]: must be <= 10; found 11.",
        "sensors.learning.error.orders[1]: needs 2 values; found [1].",
        'sensors.learning.error.prior: there is no kind "learned-arma"; ',
        "sensors.adopted.error.adopted.sd: must be >= 0; found -1.",
        'sensors.adopted.error.adopted.flag: unknown key; did you mean "flags"? known keys: ',
        'nam: unknown key; did you mean "name"? known keys: dead_reckoning_lane, drive, imus, learnt, name, sensors.',
    ]
    assert first.endswith(f"{len(found)} mistakes:")
    for begin in expected:
        assert any(line.strip().startswith(begin) for line in found), begin
    assert len(found) == len(expected), found


def test_what_a_class_refuses_stands_beside_mistakes_elsewhere(tmp_path):
    (tmp_path / "vehicle.toml").write_text(
        """
        [drive]
        type = "dead-reckoning"
        rate_hz = 4
        attitude = {type = "heading", magnetometer = true}
        velocity = {type = "depth"}
        [sensors.a]
        type = "depth"
        error = {model = "learned-arma", window = 50}
        [sensors."new\\nline"]
        type = "depth"
        error = [{model = "learned-arma"}, {model = "learned-arma"}]
        [sensors.b]
        type = "depth"
        error = {model = "learned-arma", adopted = {ar = [-0.5], ma = [0.1], sd = 1, covariance = [[1.0]]}}
        """
    )
    with pytest.raises(VehicleError) as caught:
        read_vehicle(tmp_path)
    for message in (
        'drive.velocity: there is no kind "depth"; known: body-velocity, water-velocity.',
        "sensors.a.error: LearnedArma.window must be at least 103 samples for a model of order (0, 0), found 50",
        'sensors."new\\nline": a sensor needs a name of printable characters',
        "can hold one LearnedArma",
        "sensors.b.error.adopted: covariance must be 2 x 2",
    ):
        assert message in str(caught.value), message


def test_what_no_filter_can_use_is_refused_when_it_is_read(tmp_path):
    text = (
        '[drive]\ntype = "dead-reckoning"\nrate_hz = 4\nattitude = {model = "learned-arma"}\n[sensors.x]\ntype = '
        '"depth"\nrate_hz = 0\n'
    )
    (tmp_path / "vehicle.toml").write_text(text)
    with pytest.raises(VehicleError, match=r"drive: LearnedArma needs a prior here(.|\n)*sensors\.x\.rate_hz"):
        read_vehicle(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a = " + "[" * 3000, "nested too deeply"),
        (f"a = 1{'0' * 5000}", "not valid TOML"),
        (f"[drive]\nrate_hz = 1{'0' * 30}", "drive.rate_hz: whole numbers of TOML have 64 bit"),
        ("a = 1\na = 2", "not valid TOML"),
        ("a = 2026-13-01", "not valid TOML"),
    ],
    ids=["nested", "digits", "64 bit", "twice", "date"],
)
def test_toml_that_no_parser_takes(tmp_path, text, message):
    (tmp_path / "vehicle.toml").write_text(text)
    with pytest.raises(VehicleError, match=message):
        read_vehicle(tmp_path)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(VehicleError, match="no such file"):
        read_vehicle(tmp_path)


def test_a_name_that_a_sensor_has_for_a_time_is_none_for_a_file(tmp_path):
    write_vehicle(simulate_scenario("lawnmower", 1, 10.0)[0], tmp_path / "vehicle.toml")
    text = (tmp_path / "vehicle.toml").read_text(encoding="utf-8").replace("[sensors.gps]", '[sensors."gps@2"]')
    (tmp_path / "vehicle.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match='"gps@2" would be gps, described otherwise for a time'):
        read_vehicle(tmp_path / "vehicle.toml")
