"""Results without a truth: surfacings, outages, spread, separation, and fixes that are withheld."""

import dataclasses
import json

import numpy as np
import pytest

from navfilter.commands.cli import main
from navfilter.evaluation.assessment import assess
from navfilter.evaluation.diagnostics import evidence, surfacings
from navfilter.filter.records import OUTCOMES
from navfilter.io.write import labelled
from navfilter.models.error_models import White
from navfilter.models.mission import Stream
from navfilter.playback.replay import drift, replay, score, withhold
from navfilter.simulation.scenarios import simulate_scenario

REJECTED = OUTCOMES.index("rejected")


@pytest.fixture(scope="module")
def dive():
    """Dead reckoning with fixes all the way and without those from 61 to 199 s; its vehicle, its smoothed track."""
    vehicle, mission = simulate_scenario("reckoning", seed=3, duration_s=240.0)
    # white: no part of a fix is predicted from the fixes before the outage
    vehicle = vehicle.with_error(gps=White(sd=1.0))
    # the scenario's fixes end somewhere; these are the truth itself, and where they end is known
    at = np.arange(1.0, 240.0)
    places = np.column_stack([np.interp(at, mission.truth.time_s, column) for column in mission.truth.value[:, :3].T])
    full = mission.with_stream("gps", Stream(at, places, mission.streams["gps"].columns[:3]))
    with_gap = full.hide("gps", (61.0, 199.0))
    return vehicle, full, with_gap, replay(vehicle, with_gap, smooth=True)


def test_a_surfacing_is_what_the_filter_had_not_foreseen(dive):
    """Error, distance and predicted sd against the truth and the covariance just before the fix."""
    vehicle, _, mission, track = dive
    (found,) = surfacings(track)
    assert (found.sensor, found.time_s, found.without_s, found.used) == ("gps", 200.0, 140.0, True)
    run = replay(vehicle, mission.hide("gps", (61.0, 300.0)), output_rate_hz=None)
    # The filter that gets no fix at 200 s is at 200 s where the other one was before it took its own.
    error = run.at(np.array([200.0])).errors(mission.truth).horizontal[0]
    np.testing.assert_allclose(found.error_m, error, rtol=0.02, atol=0.01)
    predicted = np.sqrt(np.trace(run.at(np.array([200.0])).covariance[0, :2, :2]) + 2.0)
    np.testing.assert_allclose(found.sd_m, predicted, rtol=1e-3)
    distance = np.hypot(*np.diff(track.forward.local()[:, :2], axis=0).T)[
        (track.forward.time_s[1:] > 60.0) & (track.forward.time_s[1:] <= 200.0)
    ].sum()
    # the path jumps at no fix in between, so that steps of position and of velocity agree
    np.testing.assert_allclose(found.distance_m, distance, rtol=0.02)
    assert f"{found.error_m:.2f} m off" in str(found) and "inside the 95 % range" in str(found)


def test_outage_spread_and_separation(dive):
    *_, track = dive
    found = evidence(track)
    assert (found.outage.begin_s, found.outage.end_s) == (60.0, 200.0)
    assert found.outage.drift_m == found.surfacings[0].error_m
    sd = np.sqrt(track.forward.covariance[:, 0, 0] + track.forward.covariance[:, 1, 1])
    assert found.sd_end_m == sd[-1] and found.sd_most_m == sd.max()
    assert found.separation.sd_most_m < found.sd_most_m
    apart = np.hypot(*(track.forward.local() - track.local(*_first(track.forward)))[:, :2].T)
    np.testing.assert_allclose(found.separation.most_m, apart.max(), rtol=1e-9)
    assert evidence(track.forward).separation is None


def _first(track):
    return float(track.latitude[0]), float(track.longitude[0])


def test_a_run_that_ends_without_fixes_has_an_open_outage(dive):
    vehicle, _, mission, _ = dive
    found = evidence(replay(vehicle, mission.hide("gps", (61.0, 300.0))))
    assert found.surfacings == () and found.outage.drift_m is None
    np.testing.assert_allclose(found.outage.end_s, 240.0, atol=0.5)
    assert "no fix ended it" in "\n".join(found.lines())


@pytest.mark.parametrize(("rejected", "time_s"), [((200.0,), 201.0), ((200.0, 201.0), 200.0)])
def test_a_lone_rejected_fix_is_an_outlier_and_no_surfacing(dive, rejected, time_s):
    track = dive[-1].forward
    r = track.residuals["gps"]
    outcome = np.where(np.isin(r.time_s, rejected), REJECTED, r.outcome).astype(np.uint8)
    odd = dataclasses.replace(track, residuals={"gps": dataclasses.replace(r, outcome=outcome)})
    (found,) = surfacings(odd)
    assert found.time_s == time_s and found.used == (time_s == 201.0)


def test_withheld_fixes_are_scored_against_the_truth(dive):
    """Fixes that are the truth itself: the score is the error of the track, and an honest sd holds it."""
    vehicle, full, _, _ = dive
    mission, readings = withhold(full, vehicle, "gps", [(61.0, 199.0)])
    assert len(readings.readings) == 139
    track = replay(vehicle, mission, smooth=True)
    for run in labelled(track).values():
        found = score(run, readings)
        error = run.at(readings.readings.time_s).errors(full.truth).horizontal
        np.testing.assert_allclose(found.rms_m, np.sqrt(np.mean(error**2)), rtol=1e-3)
        np.testing.assert_allclose((found.most_m, found.end_m), (error.max(), error[-1]), rtol=1e-3)
        assert found.inside == 1.0 and found.count == 139
    said = list(assess(labelled(track), mission, (readings,)).lines())
    assert said[0].startswith("forward: 139 fixes of gps withheld (61 to 199 s)") and said[1].startswith("smoothed: ")


def test_the_lever_arm_of_a_withheld_fix_counts():
    """Fixes of an antenna 10 m ahead, without noise: the score does not hold its arm."""
    vehicle, mission = simulate_scenario("reckoning", seed=3, duration_s=240.0)
    far = dataclasses.replace(vehicle.sensors["gps"], lever_arm_b_m=(10.0, 0.0, 0.0))
    vehicle = dataclasses.replace(vehicle, sensors={**vehicle.sensors, "gps": far})
    truth = mission.truth
    at = np.arange(1.0, 240.0)
    lat, lon, yaw = (np.interp(at, truth.time_s, np.unwrap(truth.value[:, c])) for c in (0, 1, 8))
    # a degree of latitude is 111.1 km; a centimetre of 10 m is asked for
    places = np.column_stack(
        [lat + np.cos(yaw) * 10 / 6.367e6, lon + np.sin(yaw) * 10 / 6.388e6 / np.cos(lat), np.full(at.size, np.nan)]
    )
    mission = mission.with_stream("gps", Stream(at, places, mission.streams["gps"].columns[:3]))
    kept, readings = withhold(mission, vehicle, "gps", [(100.0, 200.0)])
    found = score(replay(vehicle, kept), readings)
    assert found.rms_m < 3.0


def test_what_cannot_be_withheld(dive):
    vehicle, full, *_ = dive
    with pytest.raises(ValueError, match=r"no correcting sensor .*depth, gps"):
        withhold(full, vehicle, "velocity", [(0.0, 1.0)])
    with pytest.raises(ValueError, match=r"no reading .* 500.0 to 600.0 s; they lie from 1.0 to 239.0 s"):
        withhold(full, vehicle, "gps", [(500.0, 600.0)])


# --- the command ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("dive")
    assert main(["simulate", "reckoning", "--duration", "240", "--out", str(path), "--quiet"]) == 0
    return path


def run(folder, out, *more):
    return main(["replay", str(folder / "mission.npz"), "--vehicle", str(folder), "--out", str(out), *more])


def test_replay_scores_what_it_withheld(folder, tmp_path, capsys):
    assert run(folder, tmp_path, "--withhold", "gps:all-but-first-20", "--smooth") == 0
    said = capsys.readouterr().out
    summary = json.loads((tmp_path / "summary.json").read_text())
    found = summary["withheld"]["forward"]["gps"]
    assert found["begin_s"] >= 20.0 and f"{found['count']} fixes of gps withheld" in said
    assert summary["withheld"]["smoothed"]["gps"]["count"] == found["count"]
    assert summary["without_truth"]["outage"]["drift_m"] is None
    assert "fixes of gps withheld" in (tmp_path / "report.html").read_text()


def test_replay_of_a_part_from_another_start(folder, tmp_path):
    more = (
        "--from",
        "+20",
        "--to",
        "100",
        "--start",
        "latitude_deg=40,longitude_deg=10,time_s=30",
        "--quiet",
        "--no-report",
    )
    assert run(folder, tmp_path, *more) == 1 or (tmp_path / "summary.json").exists()
    rows = np.genfromtxt(tmp_path / "track.csv", delimiter=",", names=True)
    assert rows["time_s"][0] >= 29.9 and rows["time_s"][-1] <= 100.0
    np.testing.assert_allclose(rows["latitude_deg"][0], 40.0, atol=1e-3)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--withhold", "gps:900-300"), "no reading"),
        (("--withhold", "gps"), "is not SENSOR:BEGIN-END"),
        (("--withhold", "gps:-"), "is not SENSOR:BEGIN-END"),
        (("--withhold", "sonar:1-2"), "no correcting sensor"),
        (("--from", "5000"), "nothing was recorded"),
        (("--from", "50", "--to", "40"), "--from must be before --to"),
        (("--start", "speed=3"), "is not KEY=NUMBER"),
        (("--from", "100", "--start", "heading_deg=3"), "lacks latitude_deg and longitude_deg"),
    ],
)
def test_what_cannot_be_selected_is_said(folder, tmp_path, capsys, more, said):
    assert run(folder, tmp_path, *more) == 2
    assert said in capsys.readouterr().err


@pytest.fixture(scope="module")
def long_dive():
    """Fixes all the way, all but the first minute of them kept from the filter."""
    vehicle, mission = simulate_scenario("reckoning", seed=2, duration_s=900.0)
    truth, fixes = mission.truth, mission.streams["gps"]
    at = np.arange(1.0, 900.0)
    value = np.column_stack([np.interp(at, truth.time_s, truth.value[:, c]) for c in range(3)])
    return vehicle, *withhold(
        mission.with_stream("gps", Stream(at, value, fixes.columns[:3])), vehicle, "gps", [(60, 900)]
    )


def test_a_drift_that_lasts_too_long_makes_a_doubt(long_dive):
    """A velocity that errs to one side by five times its description."""
    vehicle, mission, readings = long_dive
    honest = drift(vehicle, mission, readings)
    assert honest.count == 12 and honest.chance > 0.01 and honest.lasting < 3.0
    assert not any(
        "withheld" in f.text for f in assess(labelled(replay(vehicle, mission)), mission, (readings,)).verdict.findings
    )
    stream = mission.streams["velocity"]
    leaning = mission.with_stream(
        "velocity", dataclasses.replace(stream, value=stream.value + np.array([0.0, 0.25, 0.0]))
    )
    found = drift(vehicle, leaning, readings)
    assert found.chance < 1e-6 and found.lasting > 5.0
    verdict = assess(labelled(replay(vehicle, leaning)), leaning, (readings,)).verdict
    assert any(f.stream == "gps" and "fixes withheld, 70 s apart" in f.text for f in verdict.findings), str(verdict)


def test_too_few_fixes_withheld_are_no_test(long_dive):
    vehicle, mission, readings = long_dive
    few = dataclasses.replace(readings, readings=readings.readings.keep(slice(0, 3)))
    assert drift(vehicle, mission, few) is None
