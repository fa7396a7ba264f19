"""Bounds and trust along a track: as the live run says them, in the summary, and in the report."""

import dataclasses
import json
import math

import faults_run as watched
import numpy as np
import pytest
from feeding import events_of, one_by_one

import navfilter as nf
from navfilter.io.write import labelled, write_summary
from navfilter.report.figures import spell_rows, trust_figure
from navfilter.report.report import render_report
from navfilter.simulation.scenarios import simulate_scenario
from navfilter.track.track import DegradedInterval, integrity_figures, spells

STUCK, TURNED, SILENT = (60.0, 80.0), (100.0, 120.0), (150.0, 175.0)


def within(stream, span):
    return (stream.time_s > span[0]) & (stream.time_s < span[1])


@pytest.fixture(scope="module")
def dive():
    """A gyro that is stuck, a compass that is turned, a DVL that is silent, one after the other."""
    vehicle, mission = watched.simulated(4, 200.0)
    imu, compass, dvl = (mission.streams[name] for name in ("imu", "compass", "dvl"))
    samples, heading = imu.value.copy(), compass.value.copy()
    samples[within(imu, STUCK), 2] = samples[within(imu, STUCK), 2][0]
    heading[within(compass, TURNED)] += 1.5
    streams = {
        **mission.streams,
        "imu": dataclasses.replace(imu, value=samples),
        "compass": dataclasses.replace(compass, value=heading),
        "dvl": dvl.keep(~within(dvl, SILENT)),
    }
    return vehicle, dataclasses.replace(mission, streams=streams)


@pytest.fixture(scope="module")
def track(dive):
    return nf.replay(*dive, smooth=True)


def test_the_spells_are_what_was_done(track):
    found = spells(track)
    assert found == spells(track.forward) and all(spell.level == "degraded" for spell in found)
    gyro = next(spell for spell in found if spell.reason == "gyro_z is stuck")
    assert STUCK[0] < gyro.begin_s < STUCK[0] + 2.0 and STUCK[1] <= gyro.end_s < STUCK[1] + 2.0
    compass = [spell for spell in found if spell.reason.startswith("compass")]
    assert any(TURNED[0] <= spell.begin_s <= TURNED[0] + 15.0 for spell in compass)
    dvl = next(spell for spell in found if spell.reason == "dvl is silent")
    assert SILENT[0] < dvl.begin_s and dvl.end_s == pytest.approx(SILENT[1], abs=1.5)
    assert not any(spell.reason == "gps is silent" for spell in found)  # fixes are not there under water


def test_they_are_those_of_the_live_run(dive, track):
    vehicle, mission = dive
    nav, found = nf.Navigator(vehicle, mission.start, threads=False), spells(track)
    said = agreed = 0
    second = 0
    for event in events_of(vehicle, mission):
        one_by_one(nav, [event])
        if event.time_s >= second + 1:
            second = int(event.time_s)
            now = {spell.reason for spell in found if spell.begin_s <= nav.time_s < spell.end_s}
            said += 1
            agreed += now == set(nav.state.trust.reasons)
    # a condition begins between two rows of the track
    assert said >= 199 and agreed / said > 0.93


def test_a_unit_that_says_nothing_is_said(dive):
    """Its axes, as those of one whose samples are wrong; a track said "good" of each, with nothing before."""
    vehicle, mission = dive
    mission = mission.between(0.0, 50.0).with_start(mission.start)
    imu = mission.streams["imu"]
    track = nf.replay(vehicle, mission.with_stream("imu", imu.keep(~within(imu, (25.0, 33.0)))))
    said = {f"{axis} is silent" for axis in vehicle.drive.axis_names}
    silent = [spell for spell in spells(track) if spell.reason in said]
    assert {spell.reason for spell in silent} == said
    assert all(25.0 <= spell.begin_s < 26.5 and 33.0 <= spell.end_s < 35.0 for spell in silent)
    assert [condition for _, axis, condition in track.axes if axis == "gyro_x"] == ["silent", "good"]


def test_what_no_vehicle_does_is_lost():
    vehicle, mission = watched.simulated(4, 30.0)
    slow = dataclasses.replace(vehicle, drive=dataclasses.replace(vehicle.drive, max_speed_m_s=0.5))
    found = spells(nf.replay(slow, mission))
    assert any(spell.level == "lost" and "faster than the vehicle can be (0.5 m/s)" in spell.reason for spell in found)
    assert str(DegradedInterval(1.0, 2.0, "lost", "why")) == "1 to 2 s: lost, why"


def test_the_summary_has_bounds_and_trust(dive, track, tmp_path):
    mission = dive[1]
    runs = json.loads(write_summary(labelled(track), mission, tmp_path / "summary.json").read_text())["runs"]
    told = runs["forward"]["integrity"]
    assert runs["smoothed"]["integrity"] is None
    bounds = track.forward.bounds
    assert told["protection_radius_max_m"] == pytest.approx(bounds[:, 0].max())
    assert told["heading_bound_max_deg"] == pytest.approx(math.degrees(bounds[:, 1].max()))
    assert told["truth_inside"] >= 0.999 and told["without_bound"] == 0.0 and told["lost_s"] == 0.0
    assert 40.0 < told["degraded_s"] < 120.0 and "gyro_z is stuck" in {spell["reason"] for spell in told["spells"]}


def test_the_report_shows_them(dive, track):
    mission = dive[1]
    page = render_report(labelled(track), mission)
    assert "Trust and bounds" in page and "gyro_z is stuck" in page and "protection radius" in page
    stack, caption = trust_figure(labelled(track), mission.truth)
    assert [panel.label for panel in stack.panels] == ["horizontal [m]", "heading [deg]"]
    assert len(stack.panels[0].parts) == 2 and {mark.label for mark in stack.marks} == {"degraded"}
    assert "Dotted" in caption and "Shaded" in caption
    assert "Dotted" not in trust_figure(labelled(track), None)[1]
    assert spell_rows(track)[1][0][2] == "degraded"


def test_where_nothing_bounds_a_run_there_is_a_gap():
    vehicle, mission = simulate_scenario("reckoning", 1, 150.0)
    track = nf.replay(vehicle, mission.hide("gps", (30.0, 100.0)))
    assert np.isinf(track.bounds[:, 0]).any()
    stack, _ = trust_figure(labelled(track), mission.truth)
    line = stack.panels[0].parts[0]
    assert np.isnan(line.y).any() and np.isfinite(stack.panels[0].limits).all()
    assert 0.0 < integrity_figures(track, mission.truth)["without_bound"] < 1.0
