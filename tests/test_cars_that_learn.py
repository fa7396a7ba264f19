"""A car whose wheels are learnt: quick errors in its file, constants as states, stops, errors that go with motion."""

from dataclasses import replace

import numpy as np
import pytest

import navfilter as nf
from navfilter.evaluation.baselines import rivals
from navfilter.models.mission import Stream
from navfilter.simulation.manoeuvres import ChangeSpeed, Straight, Turn, Wait
from navfilter.simulation.motion import Motion, Wander
from navfilter.simulation.simulate import Faults, draw_error, simulate

DEG, FIXED_S, RATE_HZ = np.pi / 180.0, 42.0, 10.0
SEEDS, MANY = range(51, 57), range(51, 75)
SMALL = (
    nf.White(sd=0.005) + nf.GaussMarkov(sd=0.01, tau_s=1.0),
    nf.GaussMarkov(sd=0.01, tau_s=0.3),
    nf.GaussMarkov(sd=0.02, tau_s=0.3),
)


def turn(angle_deg):
    return Turn(angle_deg, rate_deg_s=20.0, bank_deg=1.0, blend_s=1.5)


def drive(pitching=0.1):
    """Two minutes and a half of a town: stops, turns, and a body that rocks on its springs."""
    first = [Wait(14), ChangeSpeed(4, 6), Straight(4.0), turn(90), Straight(6.0), ChangeSpeed(6, 4), turn(-80)]
    stop = [Straight(8.0), turn(60), ChangeSpeed(0, 6), Wait(10), ChangeSpeed(7, 8), Straight(10.0), turn(-90)]
    last = [ChangeSpeed(4, 4), Straight(5.0), turn(70), ChangeSpeed(7, 4), Straight(10.0), turn(-50), Straight(8)]
    return Motion(
        [*first, *stop, *last, turn(90), ChangeSpeed(0, 7), Wait(8)],
        latitude_deg=32.8,
        longitude_deg=35.0,
        heading_deg=30.0,
        wander=Wander(0.3, pitching, pitching, 2.0),
    )


def car(unsure=True):
    """A car as its operator describes it, errors of its wheels: a decimetre a second, for a second."""
    gyro, force = nf.White(sd=0.05 * DEG), nf.White(sd=0.15)
    constants = {
        "lever_arm_sd_m": (0.15, 0.15, 0.0),
        "time_offset_sd_s": 0.3,
        "scale_sd": 0.005,
        "misalignment_sd_rad": DEG,
    }
    return nf.Vehicle(
        imu=nf.Imu(
            rate_hz=100.0,
            gyro=gyro + nf.RandomWalk(density=0.0002 * DEG, start_sd=0.01 * DEG),
            accel=force + nf.RandomWalk(density=0.0005, start_sd=0.15),
        ),
        sensors={
            "wheels": nf.BodyVelocity(
                rate_hz=RATE_HZ,
                lever_arm_b_m=(-0.23, 0.51, 0.5),
                zero_is_invalid=False,
                error=(
                    nf.White(sd=0.05) + nf.GaussMarkov(sd=0.1, tau_s=1.0),
                    nf.GaussMarkov(sd=0.05, tau_s=0.3),
                    nf.GaussMarkov(sd=0.1, tau_s=0.3),
                ),
                **(constants if unsure else {}),
            ),
            "compass": nf.Heading(rate_hz=RATE_HZ, error=nf.White(sd=2 * DEG) + nf.GaussMarkov(sd=3 * DEG, tau_s=20.0)),
            "rtk": nf.Position(rate_hz=5.0, error=nf.White(sd=0.05)),
        },
    )


def mission(vehicle, seed, springs=False):
    """Wheels err in proportion to the speed, and not at all at rest; on springs the upright axis by the pitch, too."""
    motion = drive(0.6 if springs else 0.1)
    faults = {
        "wheels": Faults(true_error=(nf.White(sd=1e-7),) * 3),
        "rtk": Faults(available=((0.0, FIXED_S),)),
    }
    recorded = simulate(vehicle, motion, seed=seed, duration_s=motion.duration_s, faults=faults, truth_rate_hz=RATE_HZ)
    stream = recorded.streams["wheels"]
    moved = motion.at(np.clip(stream.time_s, 0.0, motion.duration_s))
    speed = np.linalg.norm(moved.velocity_n, axis=1)
    off = [draw_error(model, 1.0 / RATE_HZ, speed.size, seed, "wheels", i) for i, model in enumerate(SMALL)]
    error = np.column_stack(off) * (speed / 4.0)[:, None]
    if springs:
        error[:, 2] -= 0.7 * speed * moved.attitude[:, 1]
        error[:, 1] += 0.2 * speed * moved.attitude[:, 0]
    wheels = Stream(stream.time_s, stream.value + error, stream.columns)
    return replace(recorded, streams={**recorded.streams, "wheels": wheels})


def scored(springs=False, unsure=True, seeds=SEEDS):
    """Rms of the position without fixes over that of the file, and NEES, a row a mission."""
    rows = []
    for seed in seeds:
        vehicle = car(unsure)
        recorded = mission(vehicle, seed, springs)
        rms, nees = [], 0.0
        for one in rivals(("vehicle", "arma"), vehicle, recorded, sensors=("wheels",)).values():
            track = nf.replay(one, recorded, output_rate_hz=5.0)
            errors, later = track.errors(recorded.truth), track.time_s > FIXED_S + 1.0
            rms.append(np.sqrt(np.nanmean(np.sum(errors.position_n[later, :2] ** 2, axis=1))))
            nees = float(np.nanmean(track.nees(errors)["position"][later]))
        rows.append((rms[1] / rms[0], nees))
    return np.array(rows)


@pytest.mark.parametrize("unsure", [True, False])
def test_wheels_that_err_less_than_described_navigate_no_worse(unsure):
    """The median was 1.4 and 1.8, constants being states or known, as long as what is quick in a file counted as slow,
    as what constants did to the open loop counted as error, and as wheels that stand were learnt from: 0.9 and 0.6.
    """
    ratio, nees = scored(unsure=unsure).T
    assert np.median(ratio) < 1.1
    assert nees.mean() < 1.5


def test_errors_that_go_with_the_motion_are_no_noise():
    """They tell a constant something else in each turn: with what was learnt alone in force NEES was 2.4 and the
    position 2.3 times as far off. The description stays a hypothesis beside it.
    """
    ratio, nees = scored(springs=True, seeds=MANY).T
    assert np.median(ratio) < 1.3
    assert nees.mean() < 1.5
