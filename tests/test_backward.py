"""A run from the end to the beginning is as honest as one forward, and independent of it."""

import dataclasses
import datetime

import numpy as np
import pytest

from navfilter.commands.cli import main
from navfilter.evaluation.assessment import assess
from navfilter.io import read_vehicle, write_vehicle
from navfilter.io.write import labelled
from navfilter.models.mission import Mission, Stream
from navfilter.models.sensors import Usbl
from navfilter.playback.replay import Apart, apart, backward, mirrored, replay
from navfilter.report.figures import backward_figure
from navfilter.simulation.scenarios import simulate_scenario

MIRROR = np.diag([-1.0, 1.0, 1.0])


@pytest.fixture(scope="module", params=["lawnmower", "reckoning", "water-track"])
def runs(request):
    vehicle, mission = simulate_scenario(request.param, 1, 500.0)
    forward = replay(vehicle, mission, smooth=True, output_rate_hz=1.0)
    return vehicle, mission, forward, backward(vehicle, mission, forward, output_rate_hz=1.0)


def test_it_is_as_good_as_the_run_forward(runs):
    """With a wrong sign anywhere, of the Earth's rotation too, it is off by far more than it predicts."""
    _, mission, _, back = runs
    assert back.label == "backward" and (np.diff(back.time_s) > 0.0).all()
    errors = back.errors(mission.truth)
    nees = {name: float(np.nanmean(values)) for name, values in back.nees(errors).items()}
    assert all(0.1 < value < 3.5 for value in nees.values()), nees
    assert np.nanmedian(errors.horizontal) < 6.0


def test_it_begins_where_the_mission_ends(runs):
    """What both predict at either end shows whose readings they had: the one few, the other all."""
    _, _, forward, back = runs
    sd = [np.sqrt(run.covariance[[0, -1], 8, 8]) for run in (forward.forward, back)]
    assert sd[0][0] > sd[0][1] and sd[1][1] > sd[1][0]


def test_two_honest_runs_are_as_far_apart_as_both_predict(runs):
    _, mission, forward, back = runs
    found = apart(forward, back)
    assert found.own_start and 0.02 < found.nis < 4.0 and found.chance > 0.01
    assert found.smoothed_sd is not None and (found.smoothed_sd[:, :2] <= found.sd[:, :2] + 1e-9).all()
    verdict = assess(labelled(forward), mission, back=back).verdict
    assert not any("forward and backward" in finding.text for finding in verdict.findings)


def test_runs_that_part_are_told():
    """A DVL that errs by far more on the second half than it should: the run backward begins with it."""
    vehicle, mission = simulate_scenario("reckoning", 2, 600.0)
    stream = mission.streams["velocity"]
    value = stream.value.copy()
    value[stream.time_s > 300.0, 0] += 0.4
    gone = mission.with_stream("velocity", dataclasses.replace(stream, value=value)).hide("gps", (30.0, 560.0))
    forward = replay(vehicle, gone, output_rate_hz=1.0)
    back = backward(vehicle, gone, forward, output_rate_hz=1.0)
    found = assess(labelled(forward), gone, back=back)
    assert found.apart.nis > 8.0
    assert any("times as far apart as both predict" in finding.text for finding in found.verdict.findings)
    assert found.to_dict()["backward"]["most_m"] > 20.0


def test_without_fixes_at_the_end_it_begins_there(runs):
    vehicle, mission, _, _ = runs
    none = mission.with_stream("gps", mission.streams["gps"].keep(slice(0, 0)))
    forward = replay(vehicle, none, start=mission.start, output_rate_hz=1.0)
    back = backward(vehicle, none, forward, output_rate_hz=1.0)
    assert not apart(forward, back).own_start and "forward end" in back.label
    here = forward.local()[-1, :2] - back.local(forward.latitude[0], forward.longitude[0])[-1, :2]
    assert np.hypot(*here) < 1.0


@pytest.mark.parametrize("kind", ["velocity", "heading", "magnetometer", "beams", "position"])
def test_the_mirror_twice_is_no_mirror(kind, tmp_path):
    """Of every number of a description, and of every reading."""
    text = {
        "velocity": 'type = "body-velocity"\nlever_arm_b_m = [1.0, 2.0, 3.0]\nmounting_deg = [1.0, 2.0, 3.0]\n'
        "time_offset_s = 0.2\nscale_sd = 0.01\ncalibrated = {scale = [0.003, 0.001]}",
        "heading": 'type = "heading"\nmagnetic = true\ndeclination_deg = 5.0\nbias_sd_deg = 1.0\n'
        "calibrated = {bias = [0.02, 0.01]}",
        "magnetometer": 'type = "heading"\nmagnetometer = true\ndeclination_deg = 5.0\nhard_iron = [1.0, 2.0, 3.0]\n'
        "soft_iron = [1.0, 0.1, 0.2, 0.3, 1.0, 0.4, 0.5, 0.6, 1.0]",
        "beams": 'type = "dvl-beams"\nmounting_deg = [1.0, 2.0, 3.0]',
        "position": 'type = "position"\nlever_arm_b_m = [1.0, 2.0, 3.0]',
    }[kind]
    file = tmp_path / "vehicle.toml"
    file.write_text(f'[drive]\ntype = "imu"\nrate_hz = 100\n[sensors.x]\nrate_hz = 2\n{text}\n', encoding="utf-8")
    vehicle = read_vehicle(file)
    columns = vehicle.sensors["x"].stream_columns()
    rows = np.random.default_rng(1).normal(size=(5, len(columns)))
    mission = Mission("m", {"x": Stream(np.arange(5.0), rows, columns)}, date=datetime.date(2026, 6, 1))
    _, mission2 = simulate_scenario("lawnmower", 1, 60.0)
    start = mission2.start
    once = mirrored(vehicle, mission, start)
    again = mirrored(*once, start)
    assert once[0] != vehicle
    np.testing.assert_allclose(again[1].streams["x"].value, rows, atol=1e-12)
    before, after = vehicle.sensors["x"], again[0].sensors["x"]
    for field in dataclasses.fields(before):
        old, new = getattr(before, field.name), getattr(after, field.name)
        if isinstance(old, tuple) and old and isinstance(old[0], float):
            np.testing.assert_allclose(new, old, atol=1e-12)
        elif isinstance(old, float):
            assert new == pytest.approx(old)


def test_a_sensor_without_a_mirror_is_refused():
    vehicle, mission = simulate_scenario("lawnmower", 1, 60.0)
    with_usbl = dataclasses.replace(vehicle, sensors={**vehicle.sensors, "usbl": Usbl()})
    with pytest.raises(ValueError, match="usbl: the mirror image of a Usbl is not known"):
        mirrored(with_usbl, mission, mission.start)


@pytest.mark.parametrize("more", [["--no-report"], []], ids=["no-report", "report"])
def test_the_command(tmp_path, capsys, more):
    vehicle, mission = simulate_scenario("reckoning", 1, 200.0)
    mission.save(tmp_path / "m.npz")
    write_vehicle(vehicle, tmp_path / "vehicle.toml")
    arguments = ["replay", str(tmp_path / "m.npz"), "--vehicle", str(tmp_path / "vehicle.toml"), "--smooth"]
    assert main([*arguments, *more, "--backward", "--out", str(tmp_path / "out")]) == 0
    assert "forward and backward run, independent of each other, differ by" in capsys.readouterr().out
    if not more:
        assert "Forward and backward" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_the_start_of_the_backward_run_does_not_rule_the_figure():
    """Its depth is known to 30 m until the first reading; beside that nothing would be seen of the rest."""
    sd = np.full((400, 4), 0.5)
    sd[-2:] = 30.0
    found = Apart(np.arange(400.0), *np.zeros((4, 400)), sd=sd, smoothed_sd=None, nis=1.0, chance=1.0, own_start=True)
    assert [panel.limits[1] for panel in backward_figure(found).panels[:3]] == pytest.approx([1.05] * 3)
