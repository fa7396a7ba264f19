"""Instructions for a part of a mission: off, noise, other keys; they hold there and nowhere else."""

import dataclasses
import json

import numpy as np
import pytest

import navfilter as nf
from navfilter.commands.cli import main
from navfilter.evaluation.correlations import constant_lights
from navfilter.io import read_mission, write_vehicle
from navfilter.models.during import During
from navfilter.models.error_models import Arma, Cycle, GaussMarkov, RandomWalk, White
from navfilter.models.learned_arma import LearnedArma, larger
from navfilter.navigation.navigator import Navigator
from navfilter.playback.instructions import instructed
from navfilter.playback.replay import replay
from navfilter.report.report import outages
from navfilter.simulation.scenarios import simulate_scenario
from navfilter.track.track import spells


@pytest.fixture(scope="module")
def dive():
    return simulate_scenario("lawnmower", 1, 300.0)


def with_during(mission, *instructions):
    return dataclasses.replace(mission, during=instructions)


def test_a_sensor_that_is_off(dive):
    vehicle, mission = dive
    track = replay(vehicle, with_during(mission, During("dvl", 100.0, 140.0, off=True)), output_rate_hz=1.0)
    same = replay(vehicle, mission.hide("dvl", (100.0, 140.0)), output_rate_hz=1.0)
    assert np.array_equal(track.covariance, same.covariance) and "dvl@2" not in track.residuals


def test_a_mounting_that_was_changed_is_undone(dive):
    """After a service the DVL stands turned by 5 degrees; the instruction says so, and the track is what it was."""
    vehicle, mission = dive
    stream, angle = mission.streams["dvl"], np.radians(5.0)
    turn = np.array([[np.cos(angle), np.sin(angle), 0.0], [-np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    value = np.where(stream.time_s[:, None] >= 150.0, stream.value @ turn.T, stream.value)
    turned = mission.with_stream("dvl", dataclasses.replace(stream, value=value))
    said = During("dvl", from_s=150.0, keys={"mounting_deg": (0.0, 0.0, 5.0)}, why="service")
    plain, wrong, right = (replay(vehicle, m, output_rate_hz=1.0) for m in (mission, turned, with_during(turned, said)))
    error = [float(np.sqrt(np.mean(t.errors(mission.truth).velocity_n[:, :2] ** 2))) for t in (plain, wrong, right)]
    assert error[2] < 1.2 * error[0] < error[1]  # what is not said is found, but later, and not as well
    assert right.residuals["dvl@2"].time_s[0] >= 150.0 > right.residuals["dvl"].time_s[-1]
    assert str(said) == "dvl from 150 to the end: mounting_deg = [0.0, 0.0, 5.0] (service)"


def test_noise_is_larger_there_alone(dive):
    vehicle, mission = dive
    new, seen = instructed(vehicle, with_during(mission, During("compass", 50.0, 60.0, noise=3.0)))
    assert new.sensors["compass"] == vehicle.sensors["compass"]
    part = new.sensors["compass"].models[0].block(0.125)
    assert pytest.approx(9.0 * part.P0) == new.sensors["compass@2"].models[0].block(0.125).P0
    assert len(seen.streams["compass"]) + len(seen.streams["compass@2"]) == len(mission.streams["compass"])
    assert seen.during == () and "during: compass from 50 to 60 s: noise x 3; 81 readings" in seen.notes
    assert instructed(new, seen) == (new, seen)


def test_a_name_that_others_stand_for_is_not_silent(dive):
    """An instrument is silent where none of its names is heard; off, it is."""
    vehicle, mission = dive
    said = During("dvl", 100.0, 160.0, noise=2.0), During("depth", 200.0, 260.0, off=True)
    track = replay(vehicle, with_during(mission, *said), output_rate_hz=1.0)
    assert {spell.reason for spell in spells(track)} == {"depth is silent"}
    assert [m.label for name in track.residuals for m in outages(track, name) if "gps" not in name] == ["no depth"]


@pytest.fixture(scope="module")
def unsure(dive):
    """The same vehicle with constants that it has to find, and a DVL that errs slowly."""
    error = GaussMarkov(sd=0.01, tau_s=30.0) + White(sd=0.01)
    known = {"scale_sd": 0.02, "misalignment_sd_rad": 0.03, "lever_arm_sd_m": (0.2, 0.2, 0.2)}
    sensors = dict(dive[0].sensors)
    sensors["dvl"] = dataclasses.replace(sensors["dvl"], error=error, **known)
    sensors["compass"] = dataclasses.replace(sensors["compass"], bias_sd_rad=0.03)
    return nf.Vehicle(dive[0].drive, sensors), dive[1]


def same_as_ever(vehicle, name, *times_s):
    return During(name, *times_s, keys={"rate_hz": vehicle.sensors[name].rate_hz})


def test_a_sensor_that_is_described_as_ever_is_what_it_was(unsure):
    """Errors and constants go over to the other name and back: forward and smoothed, to what one fold changes."""
    vehicle, mission = unsure
    spans = {"dvl": (100.0, 200.0), "compass": (100.0, 130.0), "gps": (50.0,), "depth": (10.0, 20.0)}
    said = with_during(mission, *(same_as_ever(vehicle, name, *span) for name, span in spans.items()))
    plain, track = (replay(vehicle, m, output_rate_hz=1.0, smooth=True) for m in (mission, said))
    for one, other in ((plain, track), (plain.forward, track.forward)):
        sd = np.sqrt(np.diagonal(one.covariance, axis1=1, axis2=2))
        places = (np.column_stack([track.latitude, track.longitude]) for track in (one, other))
        assert np.abs(np.subtract(*places)).max() * 6.4e6 < 0.02
        assert np.allclose(np.sqrt(np.diagonal(other.covariance, axis1=1, axis2=2)), sd, rtol=2e-3)


def test_what_is_learnt_of_a_constant_is_learnt_under_every_name(unsure):
    vehicle, mission = unsure
    said = During("dvl", 100.0, 130.0, noise=3.0), During("compass", 200.0, noise=3.0)
    moved = During("dvl", 150.0, keys={"lever_arm_b_m": (*vehicle.sensors["dvl"].lever_arm_b_m[:2], 0.9)})
    plain, noisy, after = (
        {light.name: light for light in constant_lights(replay(vehicle, with_during(mission, *what)))}
        for what in ((), said, (moved,))
    )
    assert plain.keys() == noisy.keys() == {name for name in after if "@" not in name}
    assert all(noisy[name].sd < 1.3 * light.sd for name, light in plain.items())
    assert {name for name in after if "@" in name} == {f"dvl@2.lever_arm_{axis}" for axis in "xyz"}
    assert after["dvl@2.lever_arm_z"].given == 0.9 and after["dvl.scale"].sd < 1.1 * plain["dvl.scale"].sd


@pytest.mark.parametrize("late_s", [0.0, 0.6])
def test_live_late_and_after_a_restart_it_is_the_same(unsure, late_s):
    said = During("dvl", 40.0, 60.0, noise=3.0), During("compass", 50.0, noise=2.0)
    vehicle, mission = instructed(unsure[0], with_during(unsure[1].between(0.0, 80.0), *said))
    lines = [(t, "", row) for t, row in zip(mission.streams["imu"].time_s, mission.streams["imu"].value, strict=True)]
    for name in vehicle.sensors:
        stream = mission.streams[name]
        lines += [(t, name, value) for t, value in zip(stream.time_s, stream.value, strict=True)]
    lines.sort(key=lambda line: round(line[0], 9) + late_s * line[1].startswith("dvl"))
    nav = Navigator(vehicle, mission.start)
    for k, (time_s, name, value) in enumerate(lines):
        if k == len(lines) * 5 // 8:  # under other names
            nav = Navigator.restore(vehicle, nav.snapshot())
        if name:
            assert nav.correct(name, time_s, value).status in ("used", "late-replayed", "rejected")
        else:
            nav.step(time_s, value[:3], value[3:])
    track = replay(vehicle, mission, output_rate_hz=None)
    assert np.array_equal(nav.state.covariance, track.covariance[-1]) and nav.state.latitude == track.latitude[-1]


def test_nor_is_it_on_board(dive):
    vehicle, mission = instructed(dive[0], with_during(dive[1], During("dvl", 10.0, noise=2.0)))
    nav, imu, dvl, told = Navigator(vehicle, mission.start), mission.streams["imu"], dive[1].streams["dvl"], []
    for t in np.arange(0.25, 26.0, 0.25):
        inside = (imu.time_s > t - 0.25 + 1e-6) & (imu.time_s <= t + 1e-6)
        nav.step_samples(np.column_stack([imu.time_s, imu.value])[inside])
        if t < 18.0:
            nav.correct("dvl" if t < 10.0 else "dvl@2", t, dvl.value[np.argmin(np.abs(dvl.time_s - t))])
        told.append(nav.health.trust.reasons)
    assert told[: 4 * 18] == [()] * 4 * 18 and told[-1] == ("dvl is silent",)


def test_instructions_that_overlap_are_put_together(dive):
    vehicle, mission = dive
    said = During("depth", 0.0, 100.0, noise=2.0), During("depth", 50.0, 150.0, keys={"lever_arm_b_m": (1.0, 0.0, 0.0)})
    new, seen = instructed(vehicle, with_during(mission, *said))
    times = {name: (s.time_s[0], s.time_s[-1]) for name, s in seen.streams.items() if name.startswith("depth@")}
    assert sorted(times.values()) == [(0.0, 49.0), (50.0, 100.0), (101.0, 150.0)]
    both = next(name for name, span in times.items() if span[0] == 50.0)
    assert new.sensors[both].lever_arm_b_m == (1.0, 0.0, 0.0)
    assert new.sensors[both].error.sd == 2.0 * vehicle.sensors["depth"].error.sd


def test_a_sensor_that_is_off_all_the_time_is_none(dive):
    vehicle, mission = dive
    new, _ = instructed(vehicle, with_during(mission, During("dvl", off=True)))
    assert "dvl" not in new.sensors


@pytest.mark.parametrize(
    ("said", "words"),
    [
        (During("sonar", off=True), "is no sensor of this vehicle with a stream"),
        (During("imu", noise=2.0), "only off = true"),
        (During("dvl", keys={"mountin_deg": 1.0}), "mountin_deg"),
        (During("dvl", keys={"rate_hz": -1.0}), "rate_hz"),
    ],
)
def test_what_cannot_be_said(dive, said, words):
    with pytest.raises(ValueError, match=words):
        instructed(dive[0], with_during(dive[1], said))


@pytest.mark.parametrize(
    "model",
    [
        White(sd=1.0),
        White(density=2.0),
        RandomWalk(density=0.5, start_sd=2.0),
        GaussMarkov(sd=2.0, tau_s=5.0) + White(sd=1.0),
        Arma(ar=(0.5,), sd=2.0),
        Cycle(sd=1.0, period_s=10.0, tau_s=100.0),
        LearnedArma(prior=GaussMarkov(sd=2.0, tau_s=5.0)),
    ],
)
def test_scaled_is_so_many_times_as_large(model):
    before, after = model.block(0.5), larger(model, 3.0).block(0.5)
    variances = [b.r + b.C @ b.P0 @ b.C for b in (before, after)]
    assert variances[1] == pytest.approx(9.0 * variances[0])
    assert np.allclose(before.Phi, after.Phi)


@pytest.mark.parametrize("more", [["--no-report"], []], ids=["no-report", "report"])
def test_files_and_command(tmp_path, dive, capsys, more):
    vehicle, mission = dive
    write_vehicle(vehicle, tmp_path / "vehicle.toml")
    said = with_during(mission, During("dvl", to_s=20.0, off=True, why="test"), During("gps", 10.0, noise=2.0))
    said.save(tmp_path / "m.npz")
    assert read_mission(tmp_path / "m.npz").during == said.during
    out = tmp_path / "out"
    arguments = ["replay", str(tmp_path / "m.npz"), "--vehicle", str(tmp_path / "vehicle.toml"), *more]
    assert main([*arguments, "--out", str(out)]) == 0 and "gps@2" in capsys.readouterr().out
    if not more:
        report = (out / "report.html").read_text(encoding="utf-8")
        assert "dvl from the beginning to 20 s: off (test)" in report
    assert json.loads((out / "summary.json").read_text(encoding="utf-8"))["runs"]["forward"]


def test_on_the_command_line(tmp_path, dive, capsys):
    vehicle, mission = dive
    write_vehicle(vehicle, tmp_path / "vehicle.toml")
    mission.save(tmp_path / "m.npz")
    arguments = ["replay", str(tmp_path / "m.npz"), "--vehicle", str(tmp_path), "--no-report"]
    arguments += ["--out", str(tmp_path / "out")]
    assert main([*arguments, "--during", "gps:10-20:off", "--during", "compass:+250-:noise=2.5"]) == 0
    assert "compass@2" in capsys.readouterr().out
    for wrong in ("gps", "gps:1-2", "gps:1-2:on", "gps:1-2:noise=0", ":1-2:off", "gps:a-2:off"):
        assert main([*arguments, "--during", wrong]) == 2
        assert "is not SENSOR:BEGIN-END:WHAT" in capsys.readouterr().err


TOML = """
[streams.depth]
file = "depth.csv"
time = {column = "t"}
depth = {column = "z"}
"""


def test_of_a_mission_toml(tmp_path):
    (tmp_path / "depth.csv").write_text("t,z\n0,1\n1,2\n", encoding="utf-8")
    file = tmp_path / "mission.toml"
    file.write_text(TOML + '[[during]]\nsensor = "depth"\nfrom_s = 0.5\nkeys = {lever_arm_b_cm = [1, 0, 0]}\n')
    (found,) = read_mission(tmp_path).during
    assert found == During("depth", 0.5, keys={"lever_arm_b_cm": [1, 0, 0]})
    for text, words in (("from_s = 2\nto_s = 1\noff = true", "must be before"), ("from_s = 2", "give off = true")):
        file.write_text(f'{TOML}[[during]]\nsensor = "depth"\n{text}\n')
        with pytest.raises(ValueError, match=words):
            read_mission(tmp_path)
