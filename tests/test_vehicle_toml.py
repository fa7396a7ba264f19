"""vehicle.toml: what is written comes back, units in keys, every mistake named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navfilter.arma.model import ArmaModel
from navfilter.error_models import Arma, GaussMarkov, RandomWalk, White
from navfilter.io import VehicleError, read_vehicle, write_vehicle
from navfilter.learned import LearnedArma
from navfilter.mechanisation import DeadReckoning, Imu
from navfilter.sensors import BodyVelocity, Depth, Heading, Position, ZeroVelocity
from navfilter.vehicle import Vehicle

RECORDINGS = Path(__file__).parent / "recordings"

INERTIAL = Vehicle(
    imu=Imu(rate_hz=100.0, gyro=White(density=1e-4) + RandomWalk(density=1e-6, start_sd=1e-5), accel=White(sd=0.03)),
    sensors={
        "compass": Heading(rate_hz=8.0, error=Arma(ar=(-0.5, 0.1), ma=(0.2,), sd=0.01), magnetometer=True, bias_sd_rad=0.1),
        "dvl": BodyVelocity(
            rate_hz=4.0,
            error=(White(sd=0.01), White(sd=0.02) + GaussMarkov(sd=0.1, tau_s=30.0, order=2), White(sd=0.03)),
            lever_arm_b_m=(0.5, 0.0, 0.1),
        ),
        "depth": Depth(rate_hz=1.0, pressure=True),
        "gps": Position(error=GaussMarkov(sd=3.0, tau_s=60.0)),
        "still": ZeroVelocity(),
    },
    name="made of everything",
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
PLAIN = Vehicle(drive=DeadReckoning(rate_hz=1.0, attitude=(White(sd=0.1), White(sd=0.2), White(sd=0.3)), velocity=White(sd=0.1)))
ADOPTED = ArmaModel([-1.2, 0.3], [0.1], 0.0123456789012345, np.diag([1e-4, 2e-4, 3e-4]) - 1e-5, 0.25, 3990.5, frozenset({"a", "b c"}))
LEARNING = Vehicle(
    imu=Imu(rate_hz=100.0),
    sensors={
        "plain": Heading(rate_hz=8.0, error=LearnedArma()),
        "prior": Heading(
            rate_hz=8.0, error=LearnedArma(prior=GaussMarkov(sd=0.01, tau_s=30.0), orders=((1, 0), (4, 4)), window=2000, hop=7)
        ),
        "sum": Depth(error=White(sd=0.01) + LearnedArma(prior=White(sd=0.1) + RandomWalk(density=1e-3))),
        "adopted": Depth(error=LearnedArma(model=ADOPTED)),
        "axes": BodyVelocity(error=(LearnedArma(), White(sd=0.1), LearnedArma(model=ArmaModel([], [], 0.5, sd_log_s0=np.inf)))),
    },
)


@pytest.mark.parametrize("vehicle", [INERTIAL, RECKONING, PLAIN, LEARNING], ids=["inertial", "reckoning", "plain", "learning"])
def test_what_is_written_comes_back(tmp_path, vehicle):
    assert read_vehicle(write_vehicle(vehicle, tmp_path / "v.toml")) == vehicle


@pytest.mark.parametrize("path", sorted(RECORDINGS.glob("*/*/vehicle.toml")), ids=lambda p: f"{p.parts[-3]}-{p.parts[-2]}")
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


@pytest.mark.parametrize(
    ("text", "messages"),
    [
        ("", ["drive: this key is missing"]),
        ('[drive]\ntype = "rocket"\n', ['drive: there is no kind "rocket"']),
        ('[drive]\ntype = "imu"\nrate_hz = 0\n', ["drive.rate_hz: must be >= 1e-06; found 0"]),
        ("[drive]\nrate_hz = 1\n", ["drive: the key 'type' is missing"]),
        ('[drive]\ntype = "imu"\nrate_hz = 9\ngyro = {model = "white", sd = 1, sd_deg = 2}\n', ["given twice"]),
        (
            '[drive]\ntype = "imu"\nrate = 1\n[sensors.d]\ntype = "depth"\nerror = {model = "white", sd = "much"}\n',
            ["3 mistakes", 'drive.rate: unknown key; did you mean "rate_hz"?', "sensors.d.error.sd:", 'found "much"'],
        ),
        (
            '[drive]\ntype = "imu"\nrate_hz = 9\n[sensors.d]\ntype = "body-velocity"\nerror = {x = {model = "white", sd = 1}}\n',
            ["sensors.d.error: one error per axis needs the axes x, y, z; found x"],
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


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(VehicleError, match="no such file"):
        read_vehicle(tmp_path)
