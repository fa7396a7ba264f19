"""How far each constant is told: lights and limits, through replay, too."""

import json
from dataclasses import replace

import pytest

from navfilter.calibration.lights import LEFT, check_limits, limit_of, lit
from navfilter.calibration.parts import constants_of
from navfilter.commands.cli import main
from navfilter.io import write_vehicle
from navfilter.report.constant_table import lights_html, lights_text
from navfilter.simulation.scenarios import simulate_scenario


@pytest.fixture(scope="module")
def vehicle():
    """Its DVL has a scale, a misalignment and a clock that nobody knows well."""
    plain, _ = simulate_scenario("lawnmower", seed=3, duration_s=1.0)
    dvl = replace(plain.sensors["dvl"], scale_sd=0.01, misalignment_sd_rad=0.02, time_offset_sd_s=0.1)
    return replace(plain, sensors={**plain.sensors, "dvl": dvl})


@pytest.fixture(scope="module")
def constants(vehicle):
    return {one.name: one for one in constants_of(vehicle)}


@pytest.mark.parametrize(("share", "colour"), [(0.9, "green"), (1.1, "orange"), (1.9, "orange"), (2.1, "red")])
def test_a_light_goes_by_the_sd_that_is_left(constants, share, colour):
    scale = constants["dvl.scale"]
    assert lit(scale, 0.0, share * LEFT * scale.sd).colour == colour
    assert lit(scale, 0.0, share * 0.001, [limit_of("dvl.scale=5%"), limit_of("scale=0.1%")]).colour == colour


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("scale", "is not NAME=NUMBER UNIT"),
        ("scale=-1%", "is not NAME=NUMBER UNIT"),
        ("scale=1 furlong", "is not NAME=NUMBER UNIT"),
        ("scale=1deg", "dvl.scale is no angle"),
        ("iron=1uT", r"no constant is called so \(constants: dvl.scale, "),
    ],
)
def test_limits_that_cannot_be_meant_are_refused(constants, text, words):
    with pytest.raises(ValueError, match=words):
        check_limits([limit_of(text)], list(constants.values()))


def test_tables_say_it_by_colour_shape_and_words(constants):
    one = constants["dvl.scale"]._replace(name="<dvl>.scale")
    lights = [lit(one, 0.002, sd) for sd in (0.001, 0.006, 0.01)]
    table = lights_html(lights)
    assert "<dvl>" not in table and all(word in table for word in ("green", "half told", "hardly told", "&#9632;"))
    assert lights_text(lights).startswith("constants: 1 told, 1 half told, 1 hardly told: <dvl>.scale (sd 1 %)")


def test_a_replay_shows_its_lights(vehicle, tmp_path, capsys):
    write_vehicle(vehicle, tmp_path / "vehicle.toml")
    _, mission = simulate_scenario("lawnmower", seed=3, duration_s=200.0)
    mission.save(tmp_path / "dive.npz")
    command = ["replay", str(tmp_path / "dive.npz"), "--vehicle", str(tmp_path / "vehicle.toml"), "--no-report"]
    command += ["--out", str(tmp_path / "out")]
    assert main([*command, "--limit", "iron=1uT"]) == 2
    assert "replaying" not in capsys.readouterr().out and not (tmp_path / "out").exists()
    main([*command, "--limit", "scale=0.1%"])
    found = json.loads((tmp_path / "out" / "summary.json").read_text())["constants"]["dvl.scale"]
    assert found["limit"] == 0.001 and found["light"] in ("orange", "red")
