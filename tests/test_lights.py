"""How far each constant is told: lights, limits, whether missions agree; through replay and the table of all."""

import json
from dataclasses import replace

import numpy as np
import pytest

from navfilter.calibration.lights import LEFT, agreement, check_limits, limit_of, lit
from navfilter.calibration.parts import constants_of
from navfilter.commands.cli import main
from navfilter.io import write_vehicle
from navfilter.report.constant_table import agreement_html, lights_html, lights_text
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


def test_missions_agree_as_often_as_chance_lets_them():
    """Against sums written out: what each says beyond the description, weighted."""
    random = np.random.default_rng(1)
    doubtful = 0
    for _ in range(2000):
        truth, each = random.normal(), []
        for sd in random.uniform(0.1, 2.0, 3):
            told = truth + sd * random.normal()
            both = (1.0 + sd**-2) ** -0.5
            each.append(
                {"given": 0.0, "given_sd": 1.0, "value": both**2 * told / sd**2, "sd": both, "told": (told, sd)}
            )
        found = agreement(each)
        weights = np.array([1.0, *(one["told"][1] ** -2 for one in each)])
        values = np.array([0.0, *(one["told"][0] for one in each)])
        assert found.value == pytest.approx(weights @ values / weights.sum())
        assert found.sd == pytest.approx(weights.sum() ** -0.5)
        doubtful += found.colour != "green"
    assert 70 < doubtful < 130  # one in twenty


def test_one_mission_alone_agrees_with_nobody():
    assert agreement([{"given": 0.0, "given_sd": 1.0, "value": 0.5, "sd": 0.1}]).colour == ""


def test_tables_say_it_by_colour_shape_and_words(constants):
    one = constants["dvl.scale"]._replace(name="<dvl>.scale")
    lights = [lit(one, 0.002, sd) for sd in (0.001, 0.006, 0.01)]
    table = lights_html(lights)
    assert "<dvl>" not in table and all(word in table for word in ("green", "half told", "hardly told", "&#9632;"))
    assert lights_text(lights).startswith("constants: 1 told, 1 half told, 1 hardly told: <dvl>.scale (sd 1 %)")
    both = agreement([light.to_dict() for light in lights])
    assert "agree" in agreement_html(("a<", "b", "c"), {"scale": (both, "1", (*lights[:2], None))})


def test_replays_show_their_lights_and_whether_they_agree(vehicle, tmp_path, capsys):
    write_vehicle(vehicle, tmp_path / "vehicle.toml")
    missions = []
    for seed in (3, 4):
        _, mission = simulate_scenario("lawnmower", seed=seed, duration_s=200.0)
        missions.append(str(tmp_path / f"dive{seed}.npz"))
        mission.save(missions[-1])
    common = ["--vehicle", str(tmp_path / "vehicle.toml"), "--out", str(tmp_path / "out"), "--no-report"]
    assert main(["replay", missions[0], *common, "--limit", "iron=1uT"]) == 2
    assert "replaying" not in capsys.readouterr().out and not (tmp_path / "out").exists()
    main(["replay", *missions, *common, "--limit", "scale=0.1%", "--workers", "1"])
    assert "constants.html" in capsys.readouterr().out
    summaries = [json.loads(path.read_text()) for path in (tmp_path / "out").glob("*/summary.json")]
    found = [summary["constants"]["dvl.scale"] for summary in summaries]
    assert len(found) == 2 and all(one["limit"] == 0.001 and one["light"] in ("orange", "red") for one in found)
    assert "dvl.misalignment_z" in (tmp_path / "out" / "constants.html").read_text()
