"""``navfilter compare`` and the comparison of the demonstration: what they write, what they say, how they end."""

import csv
import json

import numpy as np
import pytest

from navfilter.commands.cli import main
from navfilter.io import read_mission, read_vehicle, write_vehicle
from navfilter.learning.schedule import LearningSchedule
from navfilter.models.error_models import Arma, GaussMarkov, Sum, White
from navfilter.models.learned_arma import LearnedArma, learned_part
from navfilter.playback.replay import replay
from navfilter.simulation.scenarios import true_vehicle

MODELS = ("white", "gm1", "gm1-fitted", "arma", "oracle", "vehicle")


@pytest.fixture(scope="module")
def swing(tmp_path_factory):
    """Five minutes with a compass that swings; the vehicle learns on windows of 50 s so that something happens."""
    folder = tmp_path_factory.mktemp("swing")
    assert main(["simulate", "oscillating", "--duration", "300", "--seed", "3", "--out", str(folder), "--quiet"]) == 0
    vehicle = read_vehicle(folder)
    prior = vehicle.sensors["compass"].error
    write_vehicle(vehicle.with_error(compass=LearnedArma(prior=prior, window=400)), folder / "learning.toml")
    return folder


def compare(swing, *more, vehicle="learning.toml"):
    return main(["compare", str(swing / "mission.npz"), "--vehicle", str(swing / vehicle), *more])


@pytest.fixture(scope="module")
def compared(swing):
    out = swing / "compared"
    oracle = str(swing / "vehicle_true.toml")
    arguments = ("--models", ",".join(MODELS), "--sensors", "compass", "--oracle", oracle, "--out", str(out), "--quiet")
    assert compare(swing, *arguments) == 0
    return out


def test_it_writes_what_it_promises(compared):
    assert {path.name for path in compared.glob("[!.]*")} == {"report.html", "comparison.csv", "summary.json"}
    with (compared / "comparison.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["model"] for row in rows] == list(MODELS)
    summary = json.loads((compared / "summary.json").read_text())
    assert (
        list(summary["runs"]) == list(summary["whole_mission"]) == list(MODELS) and summary["baseline"] == "gm1-fitted"
    )
    for row in rows:
        assert float(row["heading_rms_deg"]) == pytest.approx(summary["runs"][row["model"]]["heading_rms_deg"])
    page = (compared / "report.html").read_text()
    assert "Models learnt under way" in page


def test_everything_is_scored_as_first_given_out(compared, swing):
    """The run that learns too: what running the beginning again made of it is not what is compared."""
    summary = json.loads((compared / "summary.json").read_text())
    (begin_s, end_s), *more = summary["windows_s"]
    assert begin_s == 0.0 and end_s == pytest.approx(300.0) and not more
    assert summary["whole_mission"]["arma"] == summary["runs"]["arma"]
    mission = read_mission(swing / "mission.npz")
    prior = read_vehicle(swing).sensors["compass"].error
    vehicle = read_vehicle(swing).with_error(compass=LearnedArma(prior=prior, window=400))
    track = replay(vehicle, mission, output_rate_hz=5.0)
    rms = [each.summary(mission.truth)["heading_rms_deg"] for each in (track, track.revised)]
    assert summary["runs"]["arma"]["heading_rms_deg"] == pytest.approx(rms[0], rel=1e-6)
    assert rms[0] != pytest.approx(rms[1], rel=1e-3)


def test_every_adoption_is_in_the_summary(compared):
    summary = json.loads((compared / "summary.json").read_text())
    steps = summary["adopted"]["arma"]["compass"]
    # As the filter had it: 2 s after each early look of five minutes; a fiftieth of the age later with a beginning
    # that was done again.
    times = np.array([step["time_s"] for step in steps])
    ages = np.array([age_s for age_s in LearningSchedule.EARLY_S if age_s < 300.0])
    assert len(ages) == len(times) == 2
    assert np.all((times > ages + 1.8) & (times < 1.02 * ages + 2.2))
    assert all(0.0 <= step["pole_radius"] < 1.0 and step["sd"] > 0.0 for step in steps)
    assert "LearnedArma" in summary["models"]["arma"]["compass"][0][1] and len(summary["models"]["gm1"]["compass"]) == 1


def test_the_table_goes_to_standard_output(swing, capsys):
    assert compare(swing, "--models", "white,gm1-fitted", "--sensors", "compass", "--begin", "20") == 0
    said = capsys.readouterr().out
    assert "heading rms [deg]" in said and "scored: 20 to 300 s." in said and "ratio to gm1-fitted" in said
    header = next(line for line in said.splitlines() if "gm1-fitted" in line and "white" in line)
    assert header.split() == ["white", "gm1-fitted"]
    # Fitting tells the slow part from white noise: white cannot have the whiter innovations here.
    row = next(line for line in said.splitlines() if line.startswith("compass: prediction error")).split()
    assert float(row[-3]) > float(row[-1])


def test_smoothed_tracks_and_sensors_left_out(swing, tmp_path, capsys):
    assert compare(swing, "--models", "vehicle", "--without", "gps", "--smooth", "--out", str(tmp_path), "--quiet") == 0
    assert capsys.readouterr().out == ""
    run = json.loads((tmp_path / "summary.json").read_text())["runs"]["vehicle"]
    assert "gps" not in run["sensors"]
    forward = replay(read_vehicle(swing / "learning.toml").without("gps"), read_mission(swing / "mission.npz"))
    smoothed_rms, forward_rms = (
        run["heading_rms_deg"],
        forward.summary(read_mission(swing / "mission.npz").truth)["heading_rms_deg"],
    )
    assert smoothed_rms != pytest.approx(forward_rms, rel=1e-3)


def test_without_truth_it_still_compares(swing, tmp_path, capsys):
    import dataclasses

    mission = dataclasses.replace(read_mission(swing / "mission.npz"), truth=None)
    path = mission.save(tmp_path / "blind.npz")
    assert (
        main(["compare", str(path), "--vehicle", str(swing), "--models", "white,gm1", "--out", str(tmp_path / "out")])
        == 0
    )
    said = capsys.readouterr().out
    assert "no truth in this mission" in said and "heading rms" not in said and "compass: NIS" in said


def test_wrong_input_is_one_line(swing, tmp_path, capsys):
    oracle = str(swing / "vehicle_true.toml")
    for arguments, expected in (
        (["--models", "gm2"], "there is no model"),
        (["--models", "oracle"], "needs --oracle TOML"),
        (["--models", "white", "--oracle", oracle], "add it to --models"),
        (["--models", "white", "--sensors", "sonar"], '"sonar" is no sensor'),
        (["--models", "vehicle", "--begin", "1e6"], "nothing is left to be scored"),
        (["--models", "vehicle", "--without", "sonar"], '"sonar" is no sensor'),
    ):
        assert compare(swing, *arguments, "--quiet") == 2
        said = capsys.readouterr()
        assert said.out == "" and said.err.count("\n") == 1 and expected in said.err, said.err
    with pytest.raises(SystemExit) as end:
        compare(swing, "--models", " , ")
    assert end.value.code == 2


def test_where_a_model_could_not_be_had_it_is_said(tmp_path, capsys):
    """A minute holds 60 fixes, which is too few, and 480 readings of the compass."""
    short = ["simulate", "oscillating", "--duration", "60", "--seed", "3", "--out", str(tmp_path), "--quiet"]
    assert main(short) == 0
    assert compare(tmp_path, "--models", "white,arma", "--sensors", "compass,gps", vehicle="vehicle.toml") == 0
    said = capsys.readouterr().out
    line = next(line for line in said.splitlines() if line.startswith("Too few readings, so vehicle.toml stands: "))
    assert "compass" not in line and all(f"gps {axis} (white, arma)" in line for axis in ("north", "east", "down"))


def test_help_teaches(capsys):
    with pytest.raises(SystemExit) as end:
        main(["compare", "--help"])
    said = capsys.readouterr().out
    assert end.value.code == 0 and said.startswith("usage: navfilter compare")
    assert all(f"\n  {name} " in said for name in MODELS) and "examples:" in said and "vehicle_true.toml" in said


def test_what_an_oracle_is_told(swing):
    really, believed = read_vehicle(swing / "vehicle_true.toml"), read_vehicle(swing)
    error = really.sensors["compass"].error
    assert isinstance(error, Sum) and [type(part) for part in error.parts] == [GaussMarkov, Arma]
    assert really.sensors["dvl"] == believed.sensors["dvl"] and learned_part(believed.sensors["compass"].error) is None
    # The compass of the demonstration rounds to 0.1 deg; an error that changes half-way is no model.
    assert true_vehicle("demo").sensors["compass"].error.parts[-1] == White(sd=np.radians(0.1) / np.sqrt(12.0))
    assert true_vehicle("changing") is None
    with pytest.raises(ValueError, match='no scenario "moon"'):
        true_vehicle("moon")


def test_the_demonstration_compares(tmp_path, capsys):
    assert main(["demo", "--duration", "90", "--seed", "2", "--out", str(tmp_path)]) == 0
    files = {"report.html", "summary.json", "track.csv", "track.tum", "truth.tum", "track.geojson"}
    files |= {"vehicle_learned.toml"}
    written = {path.name for path in tmp_path.glob("[!.]*")}
    assert written == files | {"mission.npz", "vehicle.toml", "vehicle_true.toml", "comparison"}
    assert {path.name for path in (tmp_path / "comparison").glob("[!.]*")} == {
        "report.html",
        "comparison.csv",
        "summary.json",
    }
    summary = json.loads((tmp_path / "comparison" / "summary.json").read_text())
    assert list(summary["runs"]) == ["white", "gm1-fitted", "arma", "oracle"]
    runs = json.loads((tmp_path / "summary.json").read_text())["runs"]
    # The result of the demonstration is the run that learns: the same one, once alone and once beside the others.
    assert runs["forward"]["heading_rms_deg"] == summary["whole_mission"]["arma"]["heading_rms_deg"]
    said = capsys.readouterr().out
    words = ("smoothed", "position rms [m]", "NIS", "gm1-fitted", "compass: largest autocorrelation")
    assert [word for word in words if word not in said] == []
