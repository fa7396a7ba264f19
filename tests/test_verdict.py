"""The verdict: provoked mistakes are noticed and named, sound missions raise no alarm."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from navfilter.commands.cli import main
from navfilter.evaluation.assessment import assess, judge
from navfilter.evaluation.diagnostics import LIMITS, Surfacing, evidence
from navfilter.io import read_mission, read_vehicle, write_vehicle
from navfilter.io.write import labelled
from navfilter.models.error_models import White
from navfilter.models.mission import Stream
from navfilter.playback.replay import replay
from navfilter.simulation.scenarios import SCENARIOS, simulate_scenario


def verdict_of(vehicle, mission):
    tracks = labelled(replay(vehicle, mission, output_rate_hz=2.0))
    return assess(tracks, mission).verdict


def with_values(name, change, times=lambda t: t):
    """A mistake in the readings of one stream."""

    def mistake(vehicle, mission):
        stream = mission.streams[name]
        return vehicle, mission.with_stream(
            name, Stream(times(stream.time_s), change(stream.value.copy()), stream.columns)
        )

    return mistake


def as_it_is(value):
    return value


def stuck(value):
    value[1000:] = value[1000]
    return value


#: What is wrong, whether the verdict must be "not to be trusted" (else "with care"), which sensor and code it names.
MISTAKES = {
    "heading mirrored": (with_values("compass", np.negative), True, "compass", "rejected"),
    "heading in degrees": (with_values("compass", lambda x: np.degrees(x) % 360.0), True, "compass", "rejected"),
    "compass turned by 90 deg": (with_values("compass", lambda x: x + np.pi / 2), True, "gps", "rejected"),
    "compass turned by 10 deg": (
        with_values("compass", lambda x: x + np.radians(10)),
        True,
        "compass",
        "jumped",  # the surfacing showed it
    ),
    "compass stuck": (with_values("compass", stuck), True, "compass", "rejected"),
    "compass 3 s late": (with_values("compass", as_it_is, lambda t: t + 3.0), True, "compass", "rejected"),
    "dvl in mm/s": (with_values("dvl", lambda x: 1e3 * x), True, "dvl", "unused"),
    "dvl in knots": (with_values("dvl", lambda x: 1.94 * x), True, "dvl", "scale"),
    "dvl backwards": (with_values("dvl", np.negative), True, "dvl", "jumped"),
    "dvl axes exchanged": (with_values("dvl", lambda x: x[:, [1, 0, 2]]), True, "dvl", "jumped"),
    "dvl mirrored": (with_values("dvl", lambda x: x * [1.0, -1.0, 1.0]), True, "dvl", "axes"),
    "dvl never valid": (
        with_values("dvl", lambda x: np.nan * x),
        True,
        "dvl",
        "unused",
    ),
    "dvl 5 s late": (with_values("dvl", as_it_is, lambda t: t + 5.0), True, "dvl", "rejected"),
    "dvl 400 s late": (with_values("dvl", as_it_is, lambda t: t + 400.0), False, "dvl", "span"),
    "depth upside down": (with_values("depth", np.negative), True, "depth", "jumped"),
    "depth in cm": (with_values("depth", lambda x: 1e2 * x), True, "depth", "rejected"),
    "latitude for longitude": (with_values("gps", lambda x: x[:, [1, 0, 2]]), True, "gps", "unused"),
    "gps on another clock": (with_values("gps", as_it_is, lambda t: t + 1e5), True, "gps", "clock"),
    "imu forward left up": (with_values("imu", lambda x: x * np.tile([1.0, -1.0, -1.0], 2)), True, "imu", "left-out"),
    "imu in ms": (with_values("imu", as_it_is, lambda t: 1e3 * t), True, "imu", "rate"),
    "imu lost for minutes": (
        lambda v, m: (v, m.hide("imu", (100.0, 350.0))),
        False,  # compass and DVL carry it
        "imu",
        "gap",
    ),
    "nothing bounds the velocity": (lambda v, m: (v.without("dvl"), m), False, "", "unbounded"),
    "dvl believed too well": (lambda v, m: (v.with_error(dvl=White(sd=0.001)), m), True, "dvl", "nis"),
    "start a kilometre off": (
        lambda v, m: (v, m.with_start(dataclasses.replace(m.start, latitude_deg=m.start.latitude_deg + 0.01))),
        False,
        "",
        "reset",
    ),
}


@pytest.fixture(scope="module")
def sound():
    return simulate_scenario("lawnmower", 1, 600.0)


#: What is not as it should be.
EXPECTED = {
    "dvl 5 s late": "taken for a lever arm and a scale, and the unit is left out: velocity NEES 64, 12 m off at most",
    "sonia-auv-pool/20160123_HEADING": "the compass follows the turn rate in the second half: nobody knows its clock",
}


def but_for_limits(names):
    """Each name, those of `EXPECTED` expected to fail."""
    return [
        pytest.param(name, marks=pytest.mark.xfail(strict=True, reason=EXPECTED[name])) if name in EXPECTED else name
        for name in names
    ]


@pytest.mark.parametrize("name", but_for_limits(MISTAKES))
def test_a_mistake_does_not_pass_unnoticed(sound, name):
    mistake, grave, sensor, code = MISTAKES[name]
    verdict = verdict_of(*mistake(*sound))
    assert verdict.trusted != grave
    doubts = [f for f in verdict.findings if f.severity != "info"]
    assert any(f.stream == sensor and f.code == code for f in doubts), str(verdict)
    assert all(f.cure for f in doubts)


def doubted(verdict):
    """Sensor of every finding that is more than a remark."""
    return {finding.stream for finding in verdict.findings if finding.severity != "info"}


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_no_alarm_on_a_simulated_mission(scenario):
    vehicle, mission = simulate_scenario(scenario, 2, 600.0)
    verdict = verdict_of(vehicle, mission)
    # one compass becomes worse half way; lever arm, clock and deviation of the other vehicle are not described
    expected = {"changing": {"compass"}, "miscalibrated": {"dvl", "compass"}}.get(scenario, set())
    found = doubted(verdict)
    if scenario == "miscalibrated":  # what is not described shows in the fixes, too
        found -= {"", "usbl"}
    assert verdict.trusted != (scenario == "miscalibrated") and found == expected, str(verdict)
    assert verdict.headline.startswith("Nothing speaks against this track") != bool(expected)


#: What is true of these recordings: the fixes follow the heading sideways, as if the mounting changed;
#: one sample a second where the vehicle has ten, and 100 of 106 go back in time;
#: one reading of the DVL in five is rejected; the DVL is in air.
KNOWN = {
    "snapir-auv-1hz/06": {"usbl"},
    "auv-lake-sea-10hz/20220712_0_1": {"velocity", "gps"},
    "sonia-auv-pool/20160123_HEADING": {"dvl"},
    "sonia-auv-pool/20160305_OUTOFWATER": {"", "dvl"},
}
RECORDED = (
    *(f"auv-lake-sea-10hz/{name}" for name in ("20220625_0_0", "20220712_0_1", "20220719_6_1")),
    "comma2k19/segment40",
    *(f"snapir-auv-1hz/{k:02d}" for k in (1, 2, 3, 5, 6, 7, 8, 10, 12)),
    *(
        f"sonia-auv-pool/{name}"
        for name in ("20160123", "20160123_HEADING", "20160305_CIRCLE", "20160305_OUTOFWATER", "20160305_SQUARE")
    ),
    *(f"wid-car-rtk/{name}" for name in ("00", "02", "08", "10")),
)


@pytest.mark.parametrize("name", but_for_limits(RECORDED))
def test_no_false_alarm_on_a_recording(recording, name):
    folder = recording(name)
    verdict = verdict_of(read_vehicle(folder), read_mission(folder))
    assert verdict.trusted and doubted(verdict) == KNOWN.get(name, set()), str(verdict)


def test_a_sensor_believed_much_worse_than_it_is_is_remarked(sound):
    vehicle, mission = sound
    verdict = verdict_of(vehicle.with_error(depth=White(sd=3.0)), mission)
    assert verdict.trusted and doubted(verdict) == set()
    (remark,) = verdict.findings
    assert remark.severity == "info" and remark.stream == "depth" and "remark: depth" in str(verdict)


def test_surfacings_are_judged_together(sound):
    """One of three outside the 95 % range happens; three of three do not."""
    _, mission = sound
    track = replay(*sound, output_rate_hz=2.0)
    one = Surfacing("gps", 100.0, 60.0, 90.0, 9.0, 3.0, inside=False, used=True)
    good = dataclasses.replace(one, inside=True)
    for found, alarmed in (((one, good, good), False), ((one, one, one), True)):
        verdict = judge(track, mission, dataclasses.replace(evidence(track), surfacings=found))
        assert any(f.code == "surfacing" for f in verdict.findings) == alarmed
    refused = dataclasses.replace(one, used=False)
    (one,) = judge(track, mission, dataclasses.replace(evidence(track), surfacings=(good, refused))).findings
    assert one.code == "surfacing" and all(number in one.text for number in ("60 s", "9.0 m", "3.0 m", "1 of 2"))


def test_the_manual_states_the_limits():
    page = (Path(__file__).parent.parent / "docs" / "pages" / "replay.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in row.split("|")[2:4]] for row in page.splitlines() if row.startswith("| ")]
    low, high = LIMITS.rejected
    assert [f"{100 * low:.0f} %", f"{100 * high:.0f} %"] in rows
    assert [f"{value:.0f}" for value in LIMITS.nis] in rows
    assert [f"{value:.0f} times" for value in LIMITS.rate] in rows
    assert [f"{value:.0f} m/s" for value in LIMITS.speed_sd_m_s] in rows
    assert LIMITS.gaps == LIMITS.repaired and [f"{100 * LIMITS.gaps:.0f} %", ""] in rows
    assert f"below {LIMITS.modest} a remark" in page and f"speed above {LIMITS.speed_m_s:.0f} m/s" in page


def test_the_exit_code_is_the_verdict(sound, tmp_path, capsys):
    vehicle, mission = MISTAKES["dvl in knots"][0](*sound)
    mission.save(tmp_path / "wrong.npz")
    write_vehicle(vehicle, tmp_path / "vehicle.toml")
    assert (
        main(["replay", str(tmp_path / "wrong.npz"), "--vehicle", str(tmp_path), "--out", str(tmp_path / "out")]) == 1
    )
    said, complaint = capsys.readouterr()
    assert "\nnavfilter: This track is not to be trusted. See " in "\n" + complaint
    assert "Verdict: This track is not to be trusted." in said and "navfilter check" in said
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())["verdict"]
    assert not summary["trusted"] and summary["findings"][0]["severity"] == "error"
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.index("not to be trusted") < page.index("<h2>Result</h2>") and "How to look further" in page
