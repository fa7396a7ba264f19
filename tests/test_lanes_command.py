"""The command line with a vehicle of several inertial units: every command works, or says what to do."""

import json

import pytest
from live_run import as_lines, run_session, states

from navfilter.commands.cli import main
from navfilter.evaluation.assessment import assess
from navfilter.io import read_mission, read_vehicle, write_vehicle
from navfilter.io.write import labelled, summarise
from navfilter.models.learned_arma import LearnedArma, learned_part
from navfilter.playback.replay import identified, replay, residual_series
from navfilter.report.figures import lane_figure, lane_rows
from navfilter.report.report import marks
from navfilter.service.session import Options

END_S = 150.0


@pytest.fixture(scope="module")
def dive(tmp_path_factory):
    """Two units, of which the first is silent for 20 s from half of the time on."""
    folder = tmp_path_factory.mktemp("two")
    assert main(["simulate", "two-units", "--duration", str(END_S), "--out", str(folder), "--quiet"]) == 0
    return folder


def arguments(command, dive, out=None, *more):
    to = [] if out is None else ["--out", str(out)]
    return [command, str(dive / "mission.npz"), "--vehicle", str(dive), *to, *more]


def test_check_knows_the_units(dive, capsys):
    assert main(arguments("check", dive)) == 0
    said = capsys.readouterr().out
    assert "follows the gyro of a" in said and "follows the gyro of b" in said and "is not used" not in said


def test_check_says_which_unit_is_missing(dive, tmp_path, capsys):
    vehicle = (dive / "vehicle.toml").read_text().replace("[imus.b]", "[imus.c]")
    (tmp_path / "vehicle.toml").write_text(vehicle)
    assert main(["check", str(dive / "mission.npz"), "--vehicle", str(tmp_path)]) == 1
    assert "take [imus.c] out of the vehicle.toml" in capsys.readouterr().out
    assert main(["replay", str(dive / "mission.npz"), "--vehicle", str(tmp_path), "--out", str(tmp_path / "r")]) == 2
    assert '"c" has no stream' in capsys.readouterr().err


def test_vehicle_describes_the_lanes(dive, capsys):
    assert main(["vehicle", "--check", str(dive)]) == 0
    said = capsys.readouterr().out
    assert 'Unit "a"' in said and 'Unit "b"' in said and "Lanes: a, b, dead-reckoning" in said


def test_the_verdict_says_which_lane_was_left(dive):
    mission = read_mission(dive / "mission.npz")
    track = replay(read_vehicle(dive), mission, smooth=True)
    findings = assess(labelled(track), mission).verdict.findings
    assert [(f.stream, f.severity) for f in findings if f.code == "lane"] == [("a", "info")]
    figure = lane_figure(track)
    assert [panel.label for panel in figure.panels] == ["in force", "gain", "NIS"]
    bars = [(part.label, part.x.tolist()) for part in figure.panels[0].parts]
    at_s = track.lanes[1][0]
    assert bars == [("a", [0.0, at_s]), ("b", [at_s, track.forward.time_s[-1]])]
    assert list(figure.marks) == [mark for mark in marks(track, (), ()) if mark.label == "lane left"]
    rows = lane_rows(track)[1]
    assert [row[:3] for row in rows] == [[f"{at_s:.2f}", "a", "b"]] and "foretold better: " in rows[0][3]
    figures = summarise(labelled(track), mission)["runs"]["forward"]["lanes"]
    assert [change["lane"] for change in figures["in_force"]] == ["a", "b"]
    assert figures["in_force"][1]["reason"] == rows[0][3]
    assert 0.8 < figures["each"]["b"]["nis"] < 1.2 and figures["each"]["dead-reckoning"]["nis"] < 0.8
    # the lane without a unit says less of what it foretells, so its NIS is small and its gain is, too
    history = track.lane_history
    assert history.gain.shape == history.nis.shape == (len(history.time_s), 3)
    assert (history.gain[30:, 2] < history.gain[30:, 1]).all()


@pytest.mark.slow
def test_a_replay_says_which_lane_was_left(dive, tmp_path, capsys):
    assert main(arguments("replay", dive, tmp_path / "out", "--smooth")) == 0
    assert "a: its lane was left for b at 7" in capsys.readouterr().out
    findings = json.loads((tmp_path / "out" / "summary.json").read_text())["verdict"]["findings"]
    assert [(f["sensor"], f["severity"]) for f in findings if "lane" in f["text"]] == [("a", "info")]


def test_calibrate_asks_for_the_unit(dive, tmp_path, capsys):
    out = tmp_path / "calibrated.toml"
    assert main(arguments("calibrate", dive, out)) == 2
    assert "--imu NAME" in capsys.readouterr().err and not out.exists()
    assert main(arguments("calibrate", dive, out, "--imu", "c")) == 2
    assert '"c" is no inertial unit' in capsys.readouterr().err


@pytest.mark.slow
def test_calibrate_by_one_unit_keeps_the_other(dive, tmp_path):
    out = tmp_path / "calibrated.toml"
    assert main(arguments("calibrate", dive, out, "--imu", "b", "--open", "lever-arm", "--quiet")) in (0, 1)
    found, before = read_vehicle(out), read_vehicle(dive)
    assert found.imus["a"] == before.imus["a"] and list(found.sensors) == list(before.sensors)


def test_what_is_learnt_is_by_the_unit_that_was_in_force_last(dive):
    """The first one is silent for a while: identified is on the second, and every unit stays on board."""
    mission, vehicle = read_mission(dive / "mission.npz"), read_vehicle(dive)
    learning = vehicle.with_error(compass=LearnedArma(window=500))
    found = identified(learning, mission, 1)
    assert learned_part(found.sensors["compass"].error).model is not None
    assert found.imus == vehicle.imus and found.lanes().keys() == vehicle.lanes().keys()
    series = residual_series(vehicle, mission, ["compass"])["compass"]
    without = read_vehicle(dive).lanes()["b"]
    expected = residual_series(without, mission.with_stream("imu", mission.streams["b"]), ["compass"])["compass"]
    assert (series[0].value == expected[0].value).all()


@pytest.mark.slow
def test_error_models_are_compared(dive, tmp_path):
    assert main(arguments("compare", dive, tmp_path / "compared", "--quiet")) == 0


def test_the_log_of_a_run_is_replayed(dive, tmp_path, capfd):
    vehicle, mission = read_vehicle(dive), read_mission(dive / "mission.npz")
    lines = as_lines(vehicle, mission)
    (tmp_path / "lines").write_bytes(b"".join(lines))
    run = ["run", "--vehicle", str(dive), "--input", str(tmp_path / "lines"), "--log", str(tmp_path / "log"), "--quiet"]
    assert main(run) == 0
    told, events = states(capfd.readouterr().out.splitlines())
    assert told[-1]["lane"] == "b" and "a" in told[-1]["lanes"]
    assert [event["lane"] for event in events if event["event"] == "lane"] == ["b"]
    logged, again = read_mission(tmp_path / "log"), read_vehicle(tmp_path / "log")
    track = replay(again, logged, smooth=True)
    assert track.lanes == replay(vehicle, mission).lanes and assess(labelled(track), logged).verdict.trusted


def test_a_learnt_gyro_is_that_of_its_unit(dive, tmp_path):
    vehicle = read_vehicle(dive)
    learning = vehicle.with_error(**{"b.gyro": LearnedArma(window=600)})
    assert learning.imus["a"] == vehicle.imus["a"] and learning.imus["b"] != vehicle.imus["b"]
    with pytest.raises(ValueError, match=r"c\.gyro"):
        vehicle.with_error(**{"c.gyro": LearnedArma()})
    write_vehicle(learning, tmp_path / "vehicle.toml")
    assert read_vehicle(tmp_path).imus == learning.imus


def test_a_session_starts_by_the_unit_that_speaks(dive):
    vehicle, mission = read_vehicle(dive), read_mission(dive / "mission.npz")
    lines = [line for line in as_lines(vehicle, mission)[:6000] if b'"sensor": "a"' not in line]
    told, events = states(run_session(vehicle, lines, Options()))
    assert [event["how"] for event in events if event["event"] == "start"] == ["aligned"]
    assert told[-1]["lanes"]["a"]["condition"] in ("silent", "doubted") and told[-1]["lane"] == "b"
