"""`navfilter learn`: dives teach how the sensors err, by the fixes after their gaps; what they say adds up."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

import navfilter as nf
from navfilter.calibration.over_dives import (
    QUICK,
    SLOW,
    TOGETHER,
    from_table,
    ln_prior,
    models_of,
    pooled,
    posterior,
    to_table,
)
from navfilter.commands.cli import main
from navfilter.evaluation.over_dives_text import axis_spectra
from navfilter.io import read_vehicle, write_vehicle
from navfilter.io.toml_editing import write_over_dives
from navfilter.io.vehicle_toml import read_learnt
from navfilter.models.learned_arma import parts_of, scaled
from navfilter.simulation.manoeuvres import ChangeSpeed, Straight, Turn
from navfilter.simulation.motion import Motion
from navfilter.simulation.simulate import simulate

DEG = np.pi / 180.0
WAY = Motion((ChangeSpeed(1.5, 5.0), *(Straight(60.0), Turn(90.0)) * 3), latitude_deg=50.0, longitude_deg=5.0)
TRUE, TOO_GOOD, COMPASS = nf.White(sd=0.2), nf.White(sd=0.02), nf.White(sd=0.2 * DEG)


def reckoning(velocity=TOO_GOOD, heading=COMPASS, **more):
    drive = nf.DeadReckoning(
        rate_hz=4.0,
        attitude=nf.Heading(error=heading),
        velocity=nf.BodyVelocity(error=velocity),
        tilt=nf.White(sd=0.02 * DEG),
    )
    return nf.Vehicle(drive, {"gps": nf.Position(rate_hz=1.0, error=nf.White(sd=0.1)), **more}, "small")


def dive(seed, true=TRUE):
    """Fixes for the first ten seconds, and one at the end."""
    mission = replace(simulate(reckoning(true), WAY, seed=seed), name=f"dive_{seed}")
    gps = mission.stream("gps")
    return mission.hide("gps", (float(gps.time_s[0]) + 10.0, float(gps.time_s[-1]) - 0.5))


@pytest.fixture(scope="module")
def fleet():
    return [dive(seed) for seed in range(6)]


@pytest.fixture(scope="module")
def taught(fleet):
    return nf.learn(fleet, reckoning(), sensors=["velocity"])


# --- what is learnt -------------------------------------------------------------------------------------------------


def test_a_velocity_described_ten_times_too_good_is_found_out(taught):
    """Six dives know it within a third."""
    known = taught.known["velocity"]
    assert 10.0 / 1.7 < known.quick < 10.0 * 1.7 and known.quick_within < 1.5
    assert known.slow == known.slow_within == 1.0  # the description has no slow error
    assert taught.gain > 10.0 and taught.tells
    assert taught.vehicle.drive.velocity_sensor.error.sd == pytest.approx(0.02 * known.quick)


def test_dives_that_are_kept_back_are_foretold(taught):
    """NEES at the last fix of ten other dives: 1 is honest, and the description as it was is far from it."""
    square = {"described": [], "learnt": []}
    for seed in range(100, 110):
        mission = dive(seed).without_stream("gps")
        for name, vehicle in (("described", reckoning()), ("learnt", taught.vehicle)):
            track = nf.replay(vehicle.without("gps"), mission)
            square[name].append(track.nees(track.errors(mission.truth))["position"][-1])
    assert np.mean(square["described"]) > 10.0 and 0.3 < np.mean(square["learnt"]) < 3.0, square


def test_one_dive_moves_a_right_description_little_and_eight_confirm_it():
    """What one leaves is about what was believed; all of them together say that it is right."""
    said = [
        one.evidence for one in nf.learn([dive(seed) for seed in range(8)], reckoning(TRUE), sensors="velocity").dives
    ]
    each = [pooled(reckoning(TRUE), ("velocity",), [one])[0]["velocity"] for one in said]
    moved = np.log([one.quick for one in each])
    assert np.all(np.abs(moved) < math.log(2.0)) and abs(np.mean(moved)) < 0.3, np.exp(moved)
    known = pooled(reckoning(TRUE), ("velocity",), said)[0]["velocity"]
    assert known.quick_within < 1.3 < np.mean([one.quick_within for one in each]) and 0.7 < known.quick < 1.4


def test_nothing_said_leaves_the_description():
    """Whatever the sensors are, described alone or together."""
    flat = {"velocity": np.zeros((len(QUICK), 1)), "attitude": np.zeros((len(QUICK), len(SLOW)))}
    flat[TOGETHER] = np.zeros((len(QUICK), len(SLOW)))
    vehicle = reckoning(heading=nf.White(sd=0.01) + nf.GaussMarkov(sd=0.02, tau_s=60.0))
    known, same = pooled(vehicle, ("velocity", "attitude"), [flat])
    assert known["velocity"].quick == pytest.approx(1.0) and known["attitude"].slow == pytest.approx(1.0)
    assert known["attitude"].quick_within == pytest.approx(2.0, rel=0.02)
    assert models_of(same, "velocity")[0][0].sd == pytest.approx(TOO_GOOD.sd)


def test_the_prior_has_the_described_variance_as_its_mean():
    factors = 2.0 ** np.arange(-20.0, 21.0)
    assert np.exp(ln_prior(factors)) @ factors**2 == pytest.approx(1.0, rel=1e-7)


def test_another_sensor_that_errs_takes_the_blame():
    """The compass is ten times too good, the velocity right: on a straight way only the former errs to the side."""
    ahead = Motion((ChangeSpeed(1.5, 5.0), Straight(300.0)), latitude_deg=50.0, longitude_deg=5.0)
    fine, small, large = TOO_GOOD, *(nf.GaussMarkov(sd=sd * DEG, tau_s=2.0) for sd in (0.1, 1.0))
    dives = [simulate(reckoning(fine, heading=large), ahead, seed=seed) for seed in range(4)]
    found = nf.learn(dives, reckoning(fine, heading=small), gap_s=50.0)
    assert sum(one.gaps for one in found.dives) == 20
    assert found.known["attitude"].quick > 3.0 and found.known["velocity"].quick < 1.7, found
    assert set(found.evidence) == {"attitude", "velocity", TOGETHER}


# --- it adds up -----------------------------------------------------------------------------------------------------


def test_dive_by_dive_is_all_at_once(fleet, taught):
    first = nf.learn(fleet[:4], reckoning(), sensors="velocity")
    then = nf.learn(fleet[4:], first.vehicle, before=first)
    assert then.counted == taught.counted and then.vehicle == taught.vehicle
    assert np.array_equal(then.evidence["velocity"], taught.evidence["velocity"])


def test_the_posterior_sums_to_one_and_the_order_of_dives_does_not_count(taught):
    said = [one.evidence for one in taught.dives]
    for order in (said, said[::-1]):
        known, _ = pooled(reckoning(), ("velocity",), order)
        assert known["velocity"] == pytest.approx(taught.known["velocity"])
    assert sum(float(one.weight.sum()) for one in posterior(taught.evidence).values()) == pytest.approx(1.0)


def test_a_stray_fix_does_not_decide(fleet, taught):
    """The last fix of one dive of six is a kilometre off."""
    off = fleet[0]
    gps = off.stream("gps")
    value = gps.value.copy()
    value[-1, 0] += 1000.0 / 6.4e6
    off = off.with_stream("gps", nf.Stream(gps.time_s, value, gps.columns))
    found = nf.learn(off, reckoning(), sensors=["velocity"])
    said = [found.dives[0].evidence, *(one.evidence for one in taught.dives[1:])]
    known, _ = pooled(reckoning(), ("velocity",), said)
    assert 0.5 < known["velocity"].quick / taught.known["velocity"].quick < 2.0


# --- descriptions ---------------------------------------------------------------------------------------------------


def test_parts_of_a_description():
    white, slow = nf.White(sd=0.1), nf.GaussMarkov(sd=0.2, tau_s=60.0)
    assert parts_of(white + slow, 1.0) == (True, True, 0.0)
    assert parts_of(nf.GaussMarkov(sd=0.1, tau_s=2.0), 1.0) == (True, False, 0.0)
    assert parts_of(nf.White(density=1e-3) + nf.RandomWalk(density=1e-5), 0.01) == (True, True, 0.0)
    # how quick a slow error alone is nobody knows: white noise as large stands beside it
    assert parts_of(slow, 1.0) == (False, True, 0.2)
    assert scaled(slow, 1.0, 0.5, 2.0) == nf.GaussMarkov(sd=0.4, tau_s=60.0) + nf.White(sd=0.1)
    walk = nf.RandomWalk(density=1e-5, start_sd=0.1)
    assert scaled(walk, 1.0, 2.0, 2.0) == nf.RandomWalk(density=2e-5, start_sd=0.2)
    arma = nf.Arma(ar=[-0.5], sd=0.3)
    assert scaled(arma, 1.0, 2.0, 3.0) == nf.Arma(ar=[-0.5], sd=0.6)


def test_of_a_learner_the_prior_is_scaled():
    learner = nf.White(sd=0.1) + nf.LearnedArma(prior=nf.GaussMarkov(sd=0.2, tau_s=60.0))
    larger = scaled(learner, 1.0, 2.0, 4.0)
    assert larger == nf.White(sd=0.2) + nf.LearnedArma(prior=nf.GaussMarkov(sd=0.8, tau_s=60.0))


def test_a_vehicle_that_learns_is_given_a_better_prior(fleet, taught):
    found = nf.learn(fleet[:2], reckoning(nf.LearnedArma(prior=TOO_GOOD)), sensors=["velocity"])
    prior = found.vehicle.drive.velocity_sensor.error.prior
    known, _ = pooled(reckoning(), ("velocity",), [one.evidence for one in taught.dives[:2]])
    assert prior.sd == pytest.approx(0.02 * known["velocity"].quick, rel=1e-6)


def test_spectra_lie_in_their_bands(taught):
    (spectra,) = axis_spectra(taught, "velocity")
    assert np.all(spectra.low <= spectra.high) and np.all(spectra.learnt > 10.0 * spectra.described)
    assert len(spectra.dives) == 6 and all(np.all(one > spectra.described) for one in spectra.dives)
    # the power of white noise at 4 Hz, one-sided
    assert spectra.described == pytest.approx(np.full(len(spectra.freq_hz), 2.0 * 0.02**2 / 4.0))


# --- files ----------------------------------------------------------------------------------------------------------

TOML = """
name = "small"

[drive]
type = "dead-reckoning"
rate_hz = 4
attitude = {type = "heading", rate_hz = 1, error = {model = "white", sd_deg = 0.2}}
tilt = {model = "white", sd_deg = 0.02}

# of the data sheet
[drive.velocity]
type = "body-velocity"
rate_hz = 1
error = {model = "white", sd_cm_per_s = 2}  # too good

[sensors.gps]
type = "position"
rate_hz = 1
error = {model = "white", sd = 0.1}
"""


@pytest.fixture
def folder(tmp_path, fleet):
    (tmp_path / "vehicle.toml").write_text(TOML)
    for k, mission in enumerate(fleet[:3]):
        mission.save(tmp_path / f"dive_{k}.npz")
    return tmp_path


def learnt(folder, *arguments, vehicle="vehicle.toml", out="learnt.toml"):
    paths = [str(folder / one) if one.endswith(".npz") else one for one in arguments]
    return main(
        ["learn", *paths, "--vehicle", str(folder / vehicle), "--out", str(folder / out), "--sensor", "velocity"]
    )


def test_the_command_adds_dives_to_a_file(folder, fleet, capsys):
    assert learnt(folder, "dive_0.npz", "dive_1.npz", out="first.toml") == 0
    assert learnt(folder, "dive_2.npz", vehicle="first.toml", out="then.toml") == 0
    said = capsys.readouterr().out
    assert said.count("after gaps of up to") == 3 and "going on from 2 dives" in said and "nats likelier" in said
    arguments = ("dive_0.npz", "dive_1.npz", "dive_2.npz", "--json", str(folder / "all.json"), "--quiet")
    assert learnt(folder, *arguments, out="all.toml") == 0
    then, whole = read_vehicle(folder / "then.toml"), read_vehicle(folder / "all.toml")
    sd = whole.drive.velocity_sensor.error.sd
    assert then.drive.velocity_sensor.error.sd == pytest.approx(sd, rel=1e-6) and 0.04 < sd < 0.6
    assert then.sensors == whole.sensors and then.drive.attitude == whole.drive.attitude
    text = (folder / "then.toml").read_text()
    assert "# of the data sheet" in text and "# too good" in text and text.count("\n[learnt]\n") == 1
    found = json.loads((folder / "all.json").read_text())
    assert len(found["dives"]) == len(found["counted"]) == 3 and found["sensors"]["velocity"]["quick"] > 2.0
    page = (folder / "all.html").read_text()
    assert "<img" in page and all(mission.name in page for mission in fleet[:3])


def test_what_is_read_back_is_what_was_written(tmp_path, taught):
    write_vehicle(reckoning(), tmp_path / "vehicle.toml")
    assert write_over_dives(taught.vehicle, to_table(taught), tmp_path / "a.toml", tmp_path / "vehicle.toml")
    assert not write_over_dives(taught.vehicle, to_table(taught), tmp_path / "b.toml")
    for name in ("a.toml", "b.toml"):
        vehicle = read_vehicle(tmp_path / name)
        back = from_table(vehicle, read_learnt(tmp_path / name))
        assert vehicle == taught.vehicle and back.described == taught.described and back.counted == taught.counted
        assert back.known == taught.known
        assert back.evidence["velocity"] == pytest.approx(taught.evidence["velocity"], abs=1e-6)
    assert read_learnt(tmp_path / "vehicle.toml") is None


def test_dives_that_tell_nothing_end_with_one(folder, capsys):
    """Fixes of a hundred metres say nothing of a velocity."""
    good = TOML.replace("sd_deg = 0.2", "sd_deg = 0.0001").replace("sd = 0.1", "sd = 100")
    (folder / "vehicle.toml").write_text(good.replace("sd_cm_per_s = 2", "sd = 1e-6"))
    assert learnt(folder, "dive_0.npz") == 1
    assert "tell nothing" in capsys.readouterr().out
    before = read_vehicle(folder / "vehicle.toml").drive.velocity_sensor.error.sd
    assert read_vehicle(folder / "learnt.toml").drive.velocity_sensor.error.sd == pytest.approx(before, rel=0.1)


# --- what is refused ------------------------------------------------------------------------------------------------


def refusals(fleet, taught):
    surface = simulate(reckoning(), WAY, seed=1)
    adopted = nf.LearnedArma(model=nf.ArmaModel([], [], 0.1), frozen=True)
    return {
        "no gap with a fix after it": lambda: nf.learn(surface, reckoning()),
        "a gap must last 30 s at least": lambda: nf.learn(surface, reckoning(), gap_s=10.0),
        "holds the same readings as": lambda: nf.learn([fleet[0], fleet[0]], reckoning()),
        "which was counted already": lambda: nf.learn(fleet[0], taught.vehicle, before=taught, gap_s=math.inf),
        "has no fix of gps that was read": lambda: nf.learn(fleet[0].hide("gps", (-1.0, 1e9)), reckoning()),
        '"dvl" is no sensor of this vehicle; there are: gps, attitude, velocity': lambda: nf.learn(
            fleet[0], reckoning(), sensors=["dvl"]
        ),
        "the earlier dives were about velocity": lambda: nf.learn(
            fleet[0], taught.vehicle, before=taught, sensors=["attitude"]
        ),
        "gives the fixes": lambda: nf.learn(fleet[0], reckoning(), sensors=["gps"]),
        "a model in force that one dive has taught": lambda: nf.learn(fleet[0], reckoning(adopted)),
        "at least one dive": lambda: nf.learn([], reckoning()),
        "It is learn(missions, vehicle)": lambda: nf.learn(reckoning(), fleet[0]),
        "no sensor that gives fixes": lambda: nf.learn(fleet[0], reckoning().without("gps")),
        '"usbl" has no stream in mission "dive_0"': lambda: nf.learn(fleet[0], reckoning(usbl=nf.Position())),
    }


@pytest.mark.parametrize("said", range(13))
def test_what_cannot_be_learnt_from_is_refused_in_words(said, fleet, taught):
    text, call = list(refusals(fleet, taught).items())[said]
    with pytest.raises(ValueError) as refused:
        call()
    assert text in str(refused.value)


def test_a_description_that_was_changed_by_hand_is_noticed(folder, capsys):
    assert learnt(folder, "dive_0.npz", "--quiet") == 0
    path = folder / "learnt.toml"
    text = path.read_text()
    error = next(line for line in text.splitlines() if line.startswith("error") and "heading" not in line)
    path.write_text(text.replace(error, 'error = {model = "white", sd = 0.05}'))
    assert learnt(folder, "dive_1.npz", vehicle="learnt.toml", out="b.toml") == 2
    assert "no longer what navfilter learn has written" in capsys.readouterr().err
    path.write_text(text.replace("[learnt.sensors.velocity]", "[learnt.sensors.dvl]"))
    assert learnt(folder, "dive_1.npz", vehicle="learnt.toml", out="b.toml") == 2
    assert '"dvl", which is no sensor' in capsys.readouterr().err
    path.write_text(text.replace("evidence = [\n", "evidence = [\n  [0.0],\n"))
    assert learnt(folder, "dive_1.npz", vehicle="learnt.toml", out="b.toml") == 2
    assert "other candidates" in capsys.readouterr().err


def test_mistakes_of_usage_end_with_two(folder, capsys):
    assert learnt(folder, "dive_0.npz", out="vehicle.toml") == 2
    assert "is there already" in capsys.readouterr().err
    assert learnt(folder, "dive_9.npz") == 2
    assert "dive_9.npz" in capsys.readouterr().err
    with pytest.raises(SystemExit) as end:
        learnt(folder, "dive_0.npz", "--gap", "soon")
    assert end.value.code == 2
    with pytest.raises(SystemExit) as end:
        main(["learn", "--help"])
    said = capsys.readouterr().out
    assert end.value.code == 0 and "dive_01 dive_02" in said and "exit codes" in said and "--gap" in said
