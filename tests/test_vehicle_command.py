"""``navfilter vehicle``: the template, the description and the warnings."""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from navfilter.check.description import describe_error, describe_vehicle, zero_frequency
from navfilter.check.plausibility import check_vehicle
from navfilter.check.units_text import amount, duration, root_density
from navfilter.commands.cli import main
from navfilter.filter.state_layout import Layout
from navfilter.io import read_vehicle
from navfilter.io.vehicle_template import DRIVES, vehicle_template
from navfilter.io.vehicle_toml import _NOT_IN_FILES, _concrete, _kinds, kind_name
from navfilter.models.error_models import Arma, ErrorModel, GaussMarkov, RandomWalk, White
from navfilter.models.learned_arma import LearnedArma
from navfilter.models.mechanisation import DeadReckoning, Imu
from navfilter.models.sensors import (
    Altitude,
    Attitude,
    BodyVelocity,
    Course,
    Depth,
    DvlBeams,
    Heading,
    Odometer,
    Position,
    Range,
    Sensor,
    Usbl,
    WaterVelocity,
    ZeroRate,
    ZeroVelocity,
)
from navfilter.models.vehicle import Vehicle
from navfilter.simulation.scenarios import SCENARIOS, simulate_scenario
from navfilter.timeseries.model import ArmaModel

RECORDINGS = sorted((Path(__file__).parent / "recordings").glob("*/*/vehicle.toml"))


def written(tmp_path, text, name="vehicle.toml"):
    path = tmp_path / name
    path.write_text(text)
    return read_vehicle(path)


# --- template -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("drive", DRIVES)
def test_defaults_in_the_template_are_the_defaults(tmp_path, drive):
    """Taking the # away from every key changes nothing: what is stated as a default is one."""
    text = vehicle_template(drive)
    as_written = written(tmp_path, text)
    uncommented = written(tmp_path, re.sub(r"^#(?=[^ #\n])", "", text, flags=re.MULTILINE))
    arm, below, half = (0.5, 0.0, 0.1), (0.0, 0.0, -0.3), White(sd=math.radians(0.5))
    unused = {
        "altitude": Altitude(rate_hz=4.0, lever_arm_b_m=arm),
        "ranges": Range(beacons=((26.0, -80.0, -50.0),), lever_arm_b_m=below),
        "usbl": Usbl(rate_hz=0.2, error=(White(sd=1.0), half, half), lever_arm_b_m=below),
    }
    if drive != "dead-reckoning":
        unused |= {
            "still": ZeroVelocity(),
            "turning": ZeroRate(),
            "water": WaterVelocity(rate_hz=4.0, lever_arm_b_m=arm),
            "beams": DvlBeams(rate_hz=4.0, lever_arm_b_m=arm),
            "odometer": Odometer(rate_hz=10.0, lever_arm_b_m=(-1.0, 0.0, 0.4)),
            "course": Course(lever_arm_b_m=(-0.4, 0.0, -0.2)),
            "ahrs": Attitude(
                rate_hz=5.0, error=(GaussMarkov(math.radians(0.5), 30),) * 2 + (GaussMarkov(math.radians(1.0), 60),)
            ),
        }
    assert {name: uncommented.sensors[name] for name in unused} == unused
    uncommented = uncommented.without(*unused)
    assert uncommented.driving == as_written.driving
    assert list(uncommented.lanes()) == list(as_written.lanes())
    assert list(uncommented.sensors) != [] and dict(uncommented.sensors) == dict(as_written.sensors)


@pytest.mark.parametrize("drive", DRIVES)
def test_the_template_is_what_it_says(tmp_path, drive):
    vehicle = written(tmp_path, vehicle_template(drive))
    assert list(vehicle.imus) == (["a", "b"] if drive == "imus" else [])
    assert list(vehicle.lanes()) == (["a", "b", "dead-reckoning"] if drive == "imus" else [])
    assert kind_name(type(vehicle.drive)) == drive.removesuffix("s")
    assert not [finding for finding in check_vehicle(vehicle) if finding.severity != "info"]
    expected = {"depth", "gps"} if drive == "dead-reckoning" else {"compass", "dvl", "depth", "gps"}
    assert set(vehicle.sensors) == expected


def test_the_templates_know_every_class_and_key():
    """A new sensor, drive, error model or field must appear in what people start from."""
    kinds = tuple(
        kind for kind in _kinds() if kind.__module__.startswith("navfilter.")
    )  # not those that other tests define
    both = vehicle_template("imu") + vehicle_template("dead-reckoning")
    keys = set(re.findall(r"^#? ?(\w+) = ", both, flags=re.MULTILINE))
    for cls in (*_concrete(Sensor, kinds).values(), Imu, DeadReckoning):
        assert f'type = "{kind_name(cls)}"' in both
        wanted = {re.sub(r"_rad(?=_|$)", "_deg", field.name) for field in dataclasses.fields(cls)}
        # Tables of their own.
        assert wanted - keys - {"attitude", "velocity"} == set(), cls
    for name, cls in _concrete(ErrorModel, kinds).items():
        assert f'{{model = "{name}"' in both
        for field in (field for field in dataclasses.fields(cls) if (cls, field.name) not in _NOT_IN_FILES):
            assert re.search(
                rf"\b{'adopted' if (name, field.name) == ('learned-arma', 'model') else field.name} = ", both
            ), (name, field)


def test_every_key_of_the_template_is_explained():
    lines = vehicle_template("imu").splitlines()
    for before, line in itertools.pairwise(lines):
        if re.match(r"#\w+ = ", line) and not line.startswith(("#type", "#rate", "#error")):
            explained = before.startswith("# ") or re.match(r"#\w+ = ", before)
            # What all sensors share is explained with the first of them.
            assert explained or line.startswith("#gate_probability"), line


def test_there_is_no_template_for_another_drive():
    with pytest.raises(ValueError, match=r'no drive "sail" \(known: imu, imus, dead-reckoning\)'):
        vehicle_template("sail")


# --- the command ----------------------------------------------------------------------------------------------------


def test_init_writes_once(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["vehicle", "--init"]) == 0
    assert "navfilter vehicle --check vehicle.toml" in capsys.readouterr().out
    Path("vehicle.toml").write_text("mine")
    assert main(["vehicle", "--init"]) == 2
    said = capsys.readouterr()
    assert said.err.count("\n") == 1 and "--force" in said.err and Path("vehicle.toml").read_text() == "mine"
    assert main(["vehicle", "--init", ".", "--drive", "dead-reckoning", "--force", "--quiet"]) == 0
    assert capsys.readouterr().out == "" and isinstance(read_vehicle(tmp_path).drive, DeadReckoning)


def test_init_where_nothing_can_be_written(tmp_path, capsys):
    assert main(["vehicle", "--init", str(tmp_path / "no" / "v.toml")]) == 2
    assert "No such file or directory" in capsys.readouterr().err


def test_check_ends_with_0_1_2(tmp_path, capsys):
    path = tmp_path / "v.toml"
    path.write_text(vehicle_template())
    assert main(["vehicle", "--check", str(path)]) == 0
    assert "Nothing looks wrong." in capsys.readouterr().out
    path.write_text(vehicle_template().replace("sd_deg = 0.6, tau_s", "sd = 0.6, tau_s", 2))
    assert main(["vehicle", "--check", str(path)]) == 1
    said = capsys.readouterr().out
    assert "sensors.compass.error.sd: 34.4 deg (0.6 in SI)" in said and "write sd_deg = 0.6." in said
    assert main(["vehicle", "--check", str(path), "--quiet"]) == 1
    assert capsys.readouterr() == ("", "")
    path.write_text("drive = 1")
    assert main(["vehicle", "--check", str(path), "--quiet"]) == 2
    assert "drive: must be a table" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [[], ["--init", "x", "--check", "y"], ["--drive", "sail"]])
def test_wrong_usage(arguments):
    with pytest.raises(SystemExit) as end:
        main(["vehicle", *arguments])
    assert end.value.code == 2


# --- description ----------------------------------------------------------------------------------------------------


def test_description_of_the_template(tmp_path):
    vehicle = written(tmp_path, vehicle_template())
    text = describe_vehicle(vehicle)
    assert (
        f"{Layout.of(vehicle).size} states (9 of navigation, 6 of the drive, 1 of compass, 3 of gps), 4 sensors" in text
    )
    for words in (
        'inertial unit at 100 Hz, rates and forces (stream "imu")',
        "0.3 deg/sqrt(h)",
        "bias: sd 5 deg/h at the start, wanders by 1 deg/h in an hour",
        "Gauss-Markov of first order: sd 0.6 deg, correlation time 30 s",
        "0.5 m forward, 0 m right, 0.1 m down",
        "one good reading in 10000",
    ):
        assert words in text, words


def test_description_of_everything_else():
    learned = LearnedArma(
        prior=GaussMarkov(sd=0.1, tau_s=10.0) + White(sd=0.2),
        orders=((1, 0), (2, 1)),
        window=400,
        prior_within=(2.0, 3.0),
    )
    vehicle = Vehicle(
        drive=DeadReckoning(
            rate_hz=4.0,
            attitude=Heading(error=White(sd=0.01), bias_sd_rad=0.1, deviation_sd_rad=(0.05, 0.0)),
            velocity=BodyVelocity(scale_sd=0.01, mounting_rad=(0.0, 0.0, np.pi / 4)),
        ),
        sensors={
            "learning": Depth(rate_hz=2.0, error=learned, pressure=True),
            "learnt": Depth(error=LearnedArma(model=ArmaModel([-0.99], [-0.5], 0.1))),
            "swinging": Position(
                error=(Arma([-1.6, 0.9], [], 0.1), White(sd=1.0), RandomWalk(density=0.0, start_sd=2.0))
            ),
            "magnetometer": Heading(magnetometer=True),
            "still": ZeroVelocity(),
        },
    )
    text = describe_vehicle(vehicle)
    for words in (
        "dead reckoning by attitude and body velocity at 4 Hz",
        "yaw.one_cycle_sin 2.86 deg, yaw.one_cycle_cos 2.86 deg, velocity.scale 1 %",
        "mounting     roll 0, pitch 0, yaw 45 deg",
        "learnt under way from the last 3.33 min, first after 2.03 min, orders (1,0), (2,1)",
        "until then Gauss-Markov of first order: sd 10 cm, correlation time 10 s + white noise: sd 0.2 m of a "
        "reading; believed within a factor of 2 in sd, 3 in time".replace("10 cm", "0.1 m"),
        "depth from absolute pressure",
        "learnt ARMA(1, 1)",
        "time constant 99.5 s",
        "error north  ARMA(2, 0)",
        "swings with a period of 11.1 s, decays in 19 s",
        "error down   constant bias: sd 2 m",
        "magnetometer, 1 Hz",
        "needs no stream",
    ):
        assert words in text, words
    assert "two_cycle" not in text


@pytest.mark.parametrize(
    "model",
    [
        White(sd=0.3),
        GaussMarkov(sd=0.7, tau_s=3.0),
        GaussMarkov(sd=0.7, tau_s=3.0, order=3),
        Arma([-1.2, 0.5], [0.4], 0.2),
        White(sd=0.1) + Arma([-0.9], [], 0.2),
        LearnedArma(model=ArmaModel([-0.8], [0.3], 0.2)),
    ],
    ids=str,
)
def test_root_of_the_spectrum_at_zero_is_what_long_means_show(model):
    """Variance of the mean of N samples, from the block alone: (1/N^2) sum of the covariances of all pairs."""
    period_s, n = 0.5, 4000
    block = model.block(period_s)
    covariance = np.zeros(n)
    state = block.P0 @ block.C
    for k in range(n):
        covariance[k] = block.C @ state + (block.r if k == 0 else 0.0)
        state = block.Phi @ state
    variance = (covariance[0] + 2.0 * np.sum((1.0 - np.arange(1, n) / n) * covariance[1:])) / n
    # The mean over T is S(0)/T up to terms of (memory / T)^2: here 10 samples in 4000.
    assert zero_frequency(block, period_s) == pytest.approx(math.sqrt(variance * n * period_s), rel=5e-3)


def test_the_zero_frequency_of_an_arma_model_is_that_of_its_coefficients():
    ar, ma, sd = [-1.2, 0.5], [0.4], 0.2
    gain = lfilter([1.0, *ma], [1.0, *ar], np.ones(500))[-1]
    assert zero_frequency(Arma(ar, ma, sd).block(0.25), 0.25) == pytest.approx(sd * gain * 0.5, rel=1e-12)
    assert math.isinf(zero_frequency(RandomWalk(density=1.0).block(1.0), 1.0))


def test_slow_errors_promise_no_mean():
    assert "mean" not in describe_error(GaussMarkov(sd=1.0, tau_s=1e5), "m", 1.0)[-1]
    assert len(describe_error(RandomWalk(density=1.0) + White(sd=1.0), "m", 1.0)) == 2


def test_amounts():
    assert amount(0.0, "m_s") == "0 m/s" and amount(-0.002, "m") == "-0.2 cm"
    assert amount(math.radians(3.0), "rad_s") == "3 deg/s" and root_density(0.01, "m") == "1 cm/sqrt(Hz)"
    assert duration(0.001) == "0.001 s" and duration(119.0) == "119 s" and duration(121.0) == "2.02 min"


# --- plausibility ---------------------------------------------------------------------------------------------------


def imu(**changes):
    return Imu(**{"rate_hz": 100.0, **changes})


def with_sensor(sensor):
    return Vehicle(imu=imu(), sensors={"gps": Position(), "compass": Heading(), "s": sensor})


DEG = math.pi / 180.0
SUSPICIOUS = {
    "gyro in deg/sqrt(h)": (
        Vehicle(imu=imu(gyro=White(density=0.3))),
        "drive.gyro.density",
        "write density_deg_per_sqrt_h = 0.3.",
    ),
    "gyro bias in deg/h": (
        Vehicle(imu=imu(gyro=White(density=1e-4) + RandomWalk(density=1e-7, start_sd=5.0))),
        "drive.gyro[1].start_sd",
        "write start_sd_deg_per_h = 5.",
    ),
    "gyro walk": (Vehicle(imu=imu(gyro=RandomWalk(density=1.0))), "drive.gyro.density", "(change in an hour) / 60"),
    "accel in mg": (Vehicle(imu=imu(accel=GaussMarkov(sd=4.0, tau_s=100.0))), "drive.accel.sd", "write sd_mg = 4."),
    "accel density in mg": (
        Vehicle(imu=imu(accel=White(density=0.1))),
        "drive.accel.density",
        "write density_mg_per_sqrt_hz = 0.1.",
    ),
    "one axis": (
        Vehicle(imu=imu(accel=(White(sd=0.1), White(sd=0.1), White(sd=9.0)))),
        "drive.accel.z.sd",
        "sd_mg = 9.",
    ),
    "fast unit": (Vehicle(imu=imu(rate_hz=1000.0)), "drive.rate_hz", "Hz"),
    "slow unit": (Vehicle(imu=imu(rate_hz=1.0)), "drive.rate_hz", "Hz"),
    "dvl of 1 m/s": (with_sensor(BodyVelocity(error=White(sd=1.0))), "sensors.s.error.sd", "write sd_cm_per_s = 1."),
    "dvl that never errs": (
        with_sensor(BodyVelocity(error=White(sd=0.0))),
        "sensors.s.error",
        "believes such a sensor blindly",
    ),
    "compass in degrees": (with_sensor(Heading(error=White(sd=0.6))), "sensors.s.error.sd", "write sd_deg = 0.6."),
    "compass by density": (
        with_sensor(Heading(rate_hz=4.0, error=White(density=0.5))),
        "sensors.s.error.density",
        "sd_deg",
    ),
    "bias in degrees": (with_sensor(Heading(bias_sd_rad=5.0)), "sensors.s.bias_sd_rad", "bias_sd_deg"),
    "deviation in degrees": (
        with_sensor(Heading(deviation_sd_rad=(0.0, 2.0))),
        "sensors.s.deviation_sd_rad",
        "deviation_sd_deg",
    ),
    "declination in degrees": (
        with_sensor(Heading(declination_rad=-5.0)),
        "sensors.s.declination_rad",
        "declination_deg",
    ),
    "mounting in degrees": (
        with_sensor(BodyVelocity(mounting_rad=(0.0, 0.0, 45.0))),
        "sensors.s.mounting_rad",
        "mounting_deg",
    ),
    "current in cm/s": (
        with_sensor(WaterVelocity(current_sd_m_s=30.0)),
        "sensors.s.current_sd_m_s",
        "current_sd_cm_per_s",
    ),
    "current of seconds": (with_sensor(WaterVelocity(current_tau_s=5.0)), "sensors.s.current_tau_s", "in seconds"),
    "misalignment": (
        with_sensor(BodyVelocity(misalignment_sd_rad=0.5)),
        "sensors.s.misalignment_sd_rad",
        "misalignment_sd_deg",
    ),
    "scale in per cent": (with_sensor(BodyVelocity(scale_sd=1.0)), "sensors.s.scale_sd", "1 % is 0.01"),
    "gps in degrees": (with_sensor(Position(error=White(sd=3e-5))), "sensors.s.error", "in metres, not in degrees"),
    "gps of kilometres": (
        with_sensor(Position(error=White(sd=3e4))),
        "sensors.s.error.sd",
        "in metres, not in degrees",
    ),
    "held readings": (with_sensor(Depth(rate_hz=1000.0)), "sensors.s.rate_hz", "held value"),
    "lever arm of 100 m": (
        with_sensor(Depth(lever_arm_b_m=(100.0, 0.0, 0.0))),
        "sensors.s.lever_arm_b_m",
        "lever_arm_b_mm",
    ),
    "narrow gate": (with_sensor(Depth(gate_probability=0.9)), "sensors.s.gate_probability", "0.9999"),
    "memory shorter than a period": (
        with_sensor(Depth(error=GaussMarkov(sd=0.1, tau_s=0.5))),
        "sensors.s.error.tau_s",
        "use white",
    ),
    "memory of weeks": (
        with_sensor(Depth(error=GaussMarkov(sd=0.1, tau_s=1e6))),
        "sensors.s.error.tau_s",
        "use random-walk",
    ),
    "large arma": (
        with_sensor(Depth(error=White(sd=0.1) + Arma([-0.999], [], 10.0))),
        "sensors.s.error[1]",
        "innovations",
    ),
    "long window": (
        with_sensor(Position(error=LearnedArma(window=100_000))),
        "sensors.s.error.window",
        "A window of 1800",
    ),
    "prior": (
        with_sensor(Heading(error=LearnedArma(prior=White(sd=0.01) + White(sd=2.0)))),
        "sensors.s.error.prior[1].sd",
        "write sd_deg = 2.",
    ),
    "too many states": (with_sensor(Position(error=Arma([0.0] * 39 + [0.5], [], 1.0))), "", "lower orders"),
    "nothing to correct with": (Vehicle(imu=imu(), sensors={"depth": Depth()}), "sensors", "lost within minutes"),
    "rest without a unit": (
        Vehicle(drive=DeadReckoning(rate_hz=4.0), sensors={"gps": Position(), "still": ZeroVelocity()}),
        "sensors.still",
        "Leave it out",
    ),
    "slow reckoning": (Vehicle(drive=DeadReckoning(rate_hz=0.01), sensors={"gps": Position()}), "drive.rate_hz", "Hz"),
    "temperature in dead reckoning": (
        Vehicle(drive=DeadReckoning(rate_hz=4.0, attitude=Heading(temperature_sd_rad_per_k=0.01))),
        "drive.attitude.temperature_sd_rad_per_k",
        "Leave it out",
    ),
    "attitude in degrees": (
        Vehicle(drive=DeadReckoning(rate_hz=4.0, attitude=White(sd=2.0))),
        "drive.attitude.sd",
        "sd_deg = 2.",
    ),
    "tilt in degrees": (
        Vehicle(drive=DeadReckoning(rate_hz=4.0, attitude=Heading(), tilt=White(sd=1.0))),
        "drive.tilt.sd",
        "sd_deg = 1.",
    ),
    "a quick prior that is believed": (
        with_sensor(
            BodyVelocity(error=LearnedArma(prior=GaussMarkov(sd=0.01, tau_s=4.0), window=4000, prior_within=(2.0, 3.0)))
        ),
        "sensors.s.error.prior_within",
        "leave prior_within out",
    ),
    "velocity of a drive": (
        Vehicle(
            drive=DeadReckoning(rate_hz=4.0, velocity=BodyVelocity(error=White(sd=1.0), lever_arm_b_m=(99.0, 0.0, 0.0)))
        ),
        "drive.velocity.lever_arm_b_m",
        "metres",
    ),
}


@pytest.mark.parametrize("case", SUSPICIOUS)
def test_what_looks_wrong_is_named_with_a_cure(case):
    vehicle, place, cure = SUSPICIOUS[case]
    warnings = {finding.stream: finding.cure for finding in check_vehicle(vehicle) if finding.severity == "warning"}
    assert place in warnings and cure in warnings[place], warnings


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda p: f"{p.parts[-3]}-{p.parts[-2]}")
def test_vehicles_of_real_recordings_are_plausible(path):
    assert [finding for finding in check_vehicle(read_vehicle(path)) if finding.severity != "info"] == []


@pytest.mark.parametrize("name", SCENARIOS)
def test_simulated_vehicles_are_plausible(name):
    vehicle, _ = simulate_scenario(name, 1, 20.0)
    assert [finding for finding in check_vehicle(vehicle) if finding.severity != "info"] == []
    assert describe_vehicle(vehicle)


def test_a_compass_that_learns_is_asked_for_its_bias():
    """Readings do not show one: 120 compasses that err as no file describes had NEES 2.7 of the heading in the mean."""
    learning = Heading(error=LearnedArma(prior=GaussMarkov(sd=0.01, tau_s=30.0)))
    unsaid, said, described = (
        [one for one in check_vehicle(with_sensor(sensor)) if one.stream.endswith(".bias_sd_deg")]
        for sensor in (learning, dataclasses.replace(learning, bias_sd_rad=0.5 * DEG), Heading())
    )
    assert [one.severity for one in unsaid] == ["info"] and "bias_sd_deg = 0.5" in unsaid[0].cure
    assert not said and not described


def test_what_is_worth_knowing_is_no_warning():
    found = check_vehicle(Vehicle(imu=imu(gyro=White(density=1e-4)), sensors={"dvl": BodyVelocity()}))
    assert {(finding.severity, finding.stream) for finding in found} == {("info", "drive.gyro"), ("info", "sensors")}


def test_a_drive_that_cannot_learn_is_said():
    """Dead reckoning by an error to be learnt: nothing would ever learn it."""
    velocity = BodyVelocity(rate_hz=4.0, error=LearnedArma(prior=GaussMarkov(sd=0.02, tau_s=5.0)))
    drive = DeadReckoning(rate_hz=4.0, attitude=White(sd=0.01), velocity=velocity)
    found = [f for f in check_vehicle(Vehicle(drive=drive)) if f.severity != "info"]
    assert [(f.stream, f.code) for f in found] == [("drive.velocity.error", "sd")]
    text = describe_vehicle(Vehicle(drive=drive))
    assert "learnt" not in text and "Gauss-Markov of first order: sd 2 cm/s, correlation time 5 s" in text


@pytest.mark.parametrize("rate_hz, first_s", [(8.0, 32.0), (4.0, 32.0), (3.0, 122.0), (1.0, 122.0), (0.1, 1034.0)])
def test_the_first_adoption_is_when_the_schedule_has_it(rate_hz, first_s):
    learnt = LearnedArma(window=400)
    words = f"first after {duration(first_s)}, orders"
    assert words in describe_vehicle(Vehicle(Imu(rate_hz=100), {"depth": Depth(rate_hz=rate_hz, error=learnt)}))


def test_a_window_from_which_nothing_is_ever_learnt_is_refused():
    with pytest.raises(ValueError, match="at least 103 samples for a model of order"):
        LearnedArma(window=102)
    with pytest.raises(ValueError, match=r"at least 223 samples for a model of order \(5, 5\)"):
        LearnedArma(window=222, orders=((5, 5),))
    assert LearnedArma(window=103).window == 103
