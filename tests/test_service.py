"""The live loop: lines in, states out, a log that replays to the bit, kills, full disks, slow readers and every kind of
bad line.
"""

import contextlib
import dataclasses
import errno
import json
import os
import resource
import signal
import socket
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live_run import PATIENCE_S, Dive, Process, as_lines, run_session, states, wait_for

import navfilter as nf
from navfilter.commands.cli import main
from navfilter.io.json_lines import BAD_KINDS, BadLine, LineParser, Note, Reading, StartLine, start_from
from navfilter.playback.replay import drive_samples
from navfilter.service.disk import Disk, StateFile
from navfilter.service.log import LOG_FILE, log_items, logged_options
from navfilter.service.output import Outlet
from navfilter.service.protocol import Lines, to_line
from navfilter.service.session import Options, Pairing, Session
from navfilter.service.sources import listen_address


@pytest.fixture(scope="module")
def dive(tmp_path_factory):
    return Dive(tmp_path_factory.mktemp("dive"), "lawnmower", 60.0)


@pytest.fixture(scope="module")
def reckoning(tmp_path_factory):
    return Dive(tmp_path_factory.mktemp("reckoning"), "reckoning", 90.0)


def reproducible(output):
    """The lines that follow from the readings."""
    return [line for line in output if json.loads(line).get("event") not in ("notice", "resume")]


def imu(t, rate=(0.0, 0.0, 0.0), force=(0.0, 0.0, -9.8)):
    return json.dumps({"sensor": "imu", "time_s": t, "rate_b": rate, "force_b": force}).encode()


def value(sensor, t, value, **more):
    return json.dumps({"sensor": sensor, "time_s": t, "value": value, **more}).encode()


# --- lines ----------------------------------------------------------------------------------------------------------

BAD = {
    "too-long": [b'{"sensor":"' + b"x" * 70000 + b'"}'],
    "not-utf8": [b'{"sensor":"\xff\xfe"}', b"\x80"],
    "not-json": [
        b"hello",
        b'{"sensor":"imu",',
        b"{'sensor':1}",
        b"[" * 60000,
        b'{"time_s":' + b"1" * 5000 + b"}",
        b"\x00",
    ],
    "not-an-object": [b"[1,2]", b"3", b"null", b'"imu"'],
    "unknown-sensor": [value("sonar", 1.0, 2.0), value("velocity", 1.0, [1, 2, 3]), b'{"sensor":"\\ud800"}'],
    "wrong-fields": [
        b"{}",
        b'{"sensor":3}',
        value("imu", 1.0, [0] * 6),
        b'{"sensor":"imu","time_s":1,"rate_b":[0,0,0]}',
        value("compass", 1.0, 1.0, std=1.0),
        b'{"sensor":"compass","value":1}',
        b'{"event":"stop"}',  # notes are for logs
    ],
    "wrong-type": [
        value("compass", "1", 1.0),
        value("compass", 1.0, "1.0"),
        value("compass", 1.0, True),
        value("compass", 1.0, [[1.0]]),
        value("compass", 1.0, {"x": 1}),
        value("compass", None, 1.0),
        value("compass", 1.0, 1.0, sd=[False]),
    ],
    "wrong-size": [
        value("dvl", 1.0, [1, 2]),
        value("gps", 1.0, 1.0),
        value("compass", 1.0, []),
        value("compass", 1.0, [1.0] * 17),
        imu(1.0, rate=(0.0, 0.0)),
    ],
    "not-finite": [
        value("compass", 1.0, float("nan")),
        value("compass", float("inf"), 1.0),
        b'{"sensor":"compass","time_s":1,"value":1e999}',
        b'{"sensor":"compass","time_s":1,"value":-Infinity}',
        b'{"sensor":"compass","time_s":1,"value":' + b"9" * 400 + b"}",
    ],
    "wrong-time": [value("compass", 1.7e15, 1.0), value("compass", -1e11, 1.0)],
    "wrong-start": [
        b'{"sensor":"start"}',
        b'{"sensor":"start","latitude_deg":91,"longitude_deg":0}',
        b'{"sensor":"start","latitude_deg":45,"longitude_deg":0,"heading":3}',
        b'{"sensor":"start","latitude_deg":45,"longitude_deg":0,"date":"soon"}',
        b'{"sensor":"start","latitude_deg":45,"longitude_deg":0,"date":7}',
        b'{"sensor":"start","latitude_deg":45,"longitude_deg":0,"from":"truth"}',
        b'{"sensor":"start","latitude_deg":45,"longitude_deg":0,"time_s":1e300}',
        b'{"sensor":"start","latitude_deg":45,"longitude_deg":0,"position_sd_m":-1}',
    ],
}


def test_every_kind_of_bad_line_is_tried():
    assert set(BAD) == set(BAD_KINDS)


@pytest.mark.parametrize("kind", BAD)
def test_a_bad_line_is_told_by_its_kind(kind, dive):
    parser, log = LineParser(dive.vehicle), LineParser(dive.vehicle, notes=True)
    for line in BAD[kind]:
        item = parser.parse(line)
        assert isinstance(item, BadLine) and item.kind == kind, (line[:60], item)
        assert log.parse(item.raw) == item  # its note in the log says the same


def test_good_lines(dive):
    parser = LineParser(dive.vehicle)
    assert parser.parse(b" \r") is None
    assert parser.parse(imu(1) + b"\r") == Reading("imu", 1.0, [0.0, 0.0, 0.0, 0.0, 0.0, -9.8], None, imu(1) + b"\n")
    item = parser.parse(value("gps", 1, [0.7, -0.1, None], sd=2))
    assert item.value[:2] == [0.7, -0.1] and np.isnan(item.value[2]) and item.sd == [2.0]
    item = parser.parse(b'{"sensor":"start","latitude_deg":45,"longitude_deg":-4,"date":"2026-05-04"}')
    assert isinstance(item, StartLine) and str(item.fields["date"]) == "2026-05-04"
    assert LineParser().parse(value("anything", 1, 2)).sensor == "anything"


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)
NAMES = st.sampled_from(["imu", "compass", "dvl", "gps", "depth", "start", "nobody"]) | JSON
KEYS = st.sampled_from(
    ["time_s", "value", "sd", "rate_b", "force_b", "latitude_deg", "longitude_deg", "heading_deg", "event", "kind"]
)


@settings(max_examples=200)
@given(
    st.binary(max_size=60)
    | st.builds(lambda n, d: json.dumps({"sensor": n, **d}).encode(), NAMES, st.dictionaries(KEYS, JSON))
)
def test_no_line_raises(line):
    for notes in (False, True):
        item = LineParser(FUZZED, notes=notes).parse(line)
        assert item is None or isinstance(item, Reading | StartLine | BadLine | Note)
        if item is not None:
            assert item.raw.endswith(b"\n") and item.raw.count(b"\n") == 1


FUZZED = nf.Vehicle(
    imu=nf.Imu(rate_hz=100),
    sensors={"compass": nf.Heading(), "dvl": nf.BodyVelocity(), "gps": nf.Position(), "depth": nf.Depth()},
)
FUZZ_START = {"time_s": 0.0, "latitude_deg": 45.0, "longitude_deg": -4.0}
PLAUSIBLE = st.floats(-1e3, 1e3) | st.floats(allow_nan=False, allow_infinity=False) | st.none()
FUZZ_LINE = st.builds(
    lambda name, t, v: imu(t, v[:3], v[3:6]) if name == "imu" else value(name, t, v),
    st.sampled_from(["imu", "imu", "imu", "compass", "dvl", "gps", "depth"]),
    st.floats(-5.0, 20.0) | st.floats(-9e10, 9e10),
    st.lists(PLAUSIBLE, min_size=6, max_size=6),
)


@settings(max_examples=100)
@given(st.lists(FUZZ_LINE, max_size=30))
def test_no_readings_stop_a_session(lines):
    """Whatever values and times arrive: no exception, and a state that is finite."""
    with np.errstate(all="ignore"):
        out = run_session(FUZZED, lines, Options(start=start_from(FUZZ_START)))
    for row in states(out)[0]:
        assert np.isfinite([row["latitude_deg"], row["longitude_deg"], row["depth_m"], *row["position_sd_m"]]).all()


@pytest.mark.parametrize("size", [1, 7, 4096])
def test_lines_do_not_depend_on_blocks(size):
    data = b"a\nbb\n\n" + b"x" * 70000 + b"\nccc\r\nlast"
    cutter, found = Lines(), []
    for k in range(0, len(data), size):
        found += cutter.feed(data[k : k + size])
    found += cutter.end()
    assert [line for line, cut in found if not cut] == [b"a", b"bb", b"", b"ccc\r", b"last"] and sum(
        cut for _, cut in found
    ) == 1


def test_numbers_come_back_as_they_were():
    numbers = [0.1, 1 / 3, 1e-300, 26.05001250877863, float("nan"), float("inf")]
    assert json.loads(to_line({"x": numbers, "y": {"z": numbers[4]}})) == {
        "x": [*numbers[:4], None, None],
        "y": {"z": None},
    }


# --- the session ----------------------------------------------------------------------------------------------------


def test_states_are_those_of_a_replay(dive, reckoning):
    """One by one as they arrive is, bit for bit, the replay of the recording."""
    for case in (dive, reckoning):
        track = nf.replay(case.vehicle, case.mission, output_rate_hz=None).to_frame()
        rows, events = states(case.output)
        assert [e["event"] for e in events if e["event"] != "condition"] == ["start", "stop"]
        assert [round(row["time_s"]) for row in rows[:-1]] == list(range(1, round(case.mission.duration_s) + 1))
        last, live = track.iloc[-1], rows[-1]
        for key in ("time_s", "latitude_deg", "longitude_deg", "depth_m", "roll_deg", "pitch_deg", "heading_deg"):
            assert live[key] == last[key]
        assert live["velocity_n_m_s"] == [last[f"velocity_{axis}_m_s"] for axis in ("north", "east", "down")]
        assert live["position_sd_m"] == [last[f"position_{axis}_sd_m"] for axis in ("north", "east", "down")]
        assert sum(live["sensors"]["depth"]["outcomes"].values()) == len(case.mission.streams["depth"])


def test_a_session_goes_on_from_its_snapshot(dive, reckoning):
    """Taken anywhere, also while a velocity waits for its attitude or drive samples are being gathered; with bad lines
    on the way.
    """
    for case in (dive, reckoning):
        lines = [*case.lines]
        for k in range(50, len(lines), 211):
            lines.insert(k, b"nonsense")
        # late and out of order: the history belongs to the snapshot
        lines[300:330] = lines[300:330][::-1]
        whole = run_session(case.vehicle, lines, case.options)
        rng, parser, waiting = np.random.default_rng(3), LineParser(case.vehicle), 0
        for cut in [*rng.integers(2, len(lines), 6).tolist(), 311]:
            out = []
            session = Session(case.vehicle, case.options, lambda line, is_state, out=out: out.append(line))
            for line in lines[:cut]:
                session.feed(parser.parse(line))
            saved, nav = session.snapshot()
            waiting += bool(json.loads(saved)["rows"])
            told = len(out)
            for line in lines[cut : cut + 40]:  # the first one goes on: its snapshot must not change with it
                session.feed(parser.parse(line))
            del out[told:]
            second = Session(case.vehicle, Options(), lambda line, is_state, out=out: out.append(line))
            second.restore(saved, nav)
            for line in lines[cut:]:
                second.feed(parser.parse(line))
            second.stop()
            # the text of a bad line is told only for the first ones of a parser, which is no part of the session
            assert [line for line in out if b"bad-line" not in line] == [
                line for line in whole if b"bad-line" not in line
            ]
        assert waiting or case is reckoning


def test_the_start_may_be_a_line_or_found(dive):
    readings = dive.lines
    given_line = {k: v for k, v in dive.start.items() if k not in ("time_s", "date")}
    line = json.dumps({"sensor": "start", **given_line}).encode()
    options = Options(date=dive.options.date)
    assert run_session(dive.vehicle, [line, *readings], options) == dive.output  # time_s: that of the first reading
    with_time = json.dumps({"sensor": "start", **given_line, "time_s": 0.0}).encode()
    late = run_session(dive.vehicle, [*readings[:40], with_time, *readings[40:]], options)
    assert states(late)[0] == states(dive.output)[0] and states(late)[1][0]["how"] == "line"
    assert states(run_session(dive.vehicle, [line, *readings[:9], line], options))[1][1]["kind"] == "wrong-start"

    aligned = run_session(dive.vehicle, readings, options)
    track = nf.replay(
        dive.vehicle, dataclasses.replace(dive.mission, start=None, date=dive.options.date), output_rate_hz=None
    ).to_frame()
    assert (
        states(aligned)[1][0]["how"] == "aligned"
        and states(aligned)[0][-1]["latitude_deg"] == track["latitude_deg"].iloc[-1]
    )


def test_without_a_compass_it_waits_until_the_vehicle_goes():
    """And starts where a replay of the whole mission does, though it has heard no more than it needs."""
    t, still = np.arange(0.0, 140.0, 0.1), [0.0, 0.0, 0.0, 0.0, 0.0, -9.80665]
    noise = np.random.default_rng(3).standard_normal((140, 2))
    north = 2.0 * np.maximum(np.arange(140.0) - 110.0, 0.0) + noise[:, 0]
    fixes = np.column_stack([0.7 + north / 6.37e6, 0.2 + noise[:, 1] / 6.37e6, np.full(140, 5.0)])
    streams = {"imu": nf.Stream(t, np.tile(still, (len(t), 1))), "gps": nf.Stream(np.arange(140.0), fixes)}
    vehicle = nf.Vehicle(imu=nf.Imu(rate_hz=10), sensors={"gps": nf.Position(error=nf.White(sd=1.0))})
    mission = nf.Mission("quay", streams)
    told = states(run_session(vehicle, as_lines(vehicle, mission), Options()))[1]
    assert [event["event"] for event in told][:2] == ["waiting", "start"] and "do not move" in told[0]["text"]
    start = nf.align(vehicle, mission)
    assert told[1]["time_s"] == start.time_s > 50.0 and told[1]["heading_deg"] == start.heading_deg


def test_without_a_fix_it_waits_and_says_so(dive):
    readings = [line for line in dive.lines if b'"gps"' not in line]
    out = run_session(dive.vehicle, readings, Options())
    rows, events = states(out)
    assert rows == [] and [e["event"] for e in events] == ["waiting", "stop"] and "no start" in events[0]["text"]


def test_lost_sensors_are_told_and_come_back(dive):
    """The DVL for half a minute, longer than 5 s and 8 periods; then the drive for three seconds."""
    lines = [line for line in dive.lines if not (b'"dvl"' in line and 20 < json.loads(line)["time_s"] < 50)]
    lines = [line for line in lines if not (b'"imu"' in line and 55 < json.loads(line)["time_s"] < 58)]
    events = [e for e in states(run_session(dive.vehicle, lines, dive.options))[1] if e["event"] == "condition"]
    # the six axes of the unit are told of, too
    events = [e for e in events if e["sensor"] in ("dvl", "imu")]
    assert [(e["sensor"], e["condition"]) for e in events] == [
        ("dvl", "silent"),
        ("dvl", "good"),
        ("imu", "silent"),
        ("imu", "good"),
    ]
    assert 25 <= events[0]["time_s"] <= 27 and 50 <= events[1]["time_s"] <= 52


def test_a_state_that_is_lost_is_found_again(dive, reckoning):
    """The covariance is broken on purpose: nothing that arrives should be able to."""
    for case in (dive, reckoning):
        out, parser, broken = [], LineParser(case.vehicle), False
        session = Session(case.vehicle, case.options, lambda line, is_state, out=out: out.append(line))
        for line in case.lines:
            item = parser.parse(line)
            if item.time_s == 20.5 and not broken:
                session.nav.filter.P[:], broken = np.nan, True
            session.feed(item)
        session.stop()
        rows, events = states(out)
        told = [(e["event"], e.get("how")) for e in events if e["event"] != "condition"]
        assert told == [("start", "given"), ("diverged", None), ("start", "aligned"), ("stop", None)]
        assert 21.0 <= events[1]["time_s"] <= events[2]["time_s"] <= 22.0
        times = [row["time_s"] for row in rows]
        assert times == sorted(times) and set(range(1, 61)) - {round(t) for t in times} <= {21, 22}
        assert (
            abs(rows[-1]["latitude_deg"] - states(case.output)[0][-1]["latitude_deg"]) < 5 * 3.0 / 111e3
        )  # the fixes have 3 m


@pytest.mark.parametrize("sd", [1e300, 1e160])
def test_a_standard_deviation_whose_square_is_infinite_is_invalid(dive, sd):
    """Found by fuzzing: the covariance became NaN."""
    nav = nf.Navigator(dive.vehicle, dive.mission.start)
    nav.step(0.01, (0, 0, 0), (0, 0, -9.8))
    assert nav.correct("depth", 0.01, 0.0, sd=sd).status == "invalid" and np.isfinite(nav.state.covariance).all()


def test_a_wild_stamp_does_not_make_the_drive_silent(dive):
    lines = [*dive.lines[:3000], value("dvl", 5000.0, [1.0, 0.0, 0.0]), *dive.lines[3000:]]
    rows, events = states(run_session(dive.vehicle, lines, dive.options))
    assert [e["event"] for e in events] == ["start", "stop"] and rows[-1]["sensors"]["dvl"]["outcomes"]["ahead"] == 1


STAMPS = {
    "stand still": lambda t: 20.0,
    "go backwards": lambda t: 40.0 - t,
    "creep backwards": lambda t: 20.0 - 0.01 * (t - 20.0),
    "go round": lambda t: 20.0 + t % 0.2,
    "crawl": lambda t: 20.0 + 0.01 * (t - 20.0),
}


@pytest.mark.parametrize(
    ("vehicle", "which", "stamps"),
    [
        *(("reckoning", which, stamps) for which in ("all", "drive") for stamps in STAMPS),
        ("dive", "all", "stand still"),
        ("dive", "drive", "go backwards"),
        ("dive", "all", "crawl"),
    ],
)
def test_stamps_that_do_not_rise_are_no_state_to_trust(request, vehicle, which, stamps):
    """No new state can be told; so much is, and once they rise again, that too. Also after a restart in between."""
    run = request.getfixturevalue(vehicle)
    lines = []
    for line in run.lines:
        row = json.loads(line)
        if 20.0 < row["time_s"] <= 40.0 and (which == "all" or row["sensor"] in run.vehicle.driving):
            line = json.dumps({**row, "time_s": STAMPS[stamps](row["time_s"])}).encode() + b"\n"
        lines.append(line)
    whole = run_session(run.vehicle, lines, run.options)
    rows, events = states(whole)
    told = [event for event in events if event["event"] == "trust" and "no state since" in str(event["reasons"])]
    assert told and all(event["trust"] == "lost" for event in told)
    stale = [row for row in rows if row["trust"] == "lost" and "no state since" in str(row["reasons"])]
    assert len(stale) == len(told) and all(20.0 <= row["time_s"] <= 21.5 for row in stale)
    assert rows[-1]["trust"] != "lost" and rows[-1]["time_s"] > 58.0
    end = sum(json.loads(line)["time_s"] <= 40.0 for line in run.lines)
    last = states(run_session(run.vehicle, lines[:end], run.options))[0][-1]
    assert last["trust"] == "lost" or last["time_s"] in {row["time_s"] for row in rows}
    parser, out = LineParser(run.vehicle), []
    first, second = (Session(run.vehicle, run.options, lambda line, is_state: out.append(line)) for _ in range(2))
    cut = end - 10
    for line in lines[:cut]:
        first.feed(parser.parse(line))
    while (saved := first.snapshot()) is None:  # samples are being gathered
        first.feed(parser.parse(lines[cut]))
        cut += 1
    second.restore(*saved)
    for line in lines[cut:]:
        second.feed(parser.parse(line))
    second.stop()
    assert out == whole


def test_warnings_of_bad_lines_are_few(dive):
    lines = []
    for line in dive.lines[:3000]:
        lines += [line, b"nonsense"]
    rows, events = states(run_session(dive.vehicle, lines, dive.options))
    assert [e["count"] for e in events if e["event"] == "bad-line"] == [1, 10, 100, 1000]
    assert rows[-1]["bad_lines"] == {"not-json": 3000}


# --- dead reckoning -------------------------------------------------------------------------------------------------


def reading(sensor, t, *value):
    return Reading(sensor, t, list(value), None, b"")


def test_pairs_are_those_of_a_recording(reckoning):
    """However the attitude arrives, early or late: within its patience the pairs are bit for bit those of the
    recording.
    """
    times, pairs = drive_samples(reckoning.vehicle, reckoning.mission)
    attitude, velocity = (reckoning.mission.streams[name] for name in ("attitude", "velocity"))
    turning = attitude.value.copy()
    turning[:, 2] += 0.7 * attitude.time_s  # through the north every nine seconds
    turning[:, 2] = (turning[:, 2] + np.pi) % (2 * np.pi) - np.pi
    mission = reckoning.mission.with_stream("attitude", nf.Stream(attitude.time_s, turning))
    times, pairs = drive_samples(reckoning.vehicle, mission)
    for delay_s in (0.0, 0.3, -0.3):
        rows = [
            (t + delay_s, reading("attitude", t, *v))
            for t, v in zip(attitude.time_s.tolist(), turning.tolist(), strict=True)
        ]
        rows += [
            (t + 0.02, reading("velocity", t, *v))
            for t, v in zip(velocity.time_s.tolist(), velocity.value.tolist(), strict=True)
        ]
        pairing, found = Pairing(reckoning.vehicle.drive.period_s), []
        for _, item in sorted(rows, key=lambda row: row[0]):
            found += pairing.take(item)
        found += pairing.end()
        assert [r.time_s for r, _ in found] == times.tolist()
        assert np.array_equal([a + r.value for r, a in found], pairs, equal_nan=True)


def test_described_clocks_are_taken_off_as_in_a_replay():
    """Attitude 0.5 s late, velocity 1.25 s early: pairs as in a replay, though the velocity comes long before."""
    sensors = {"attitude": nf.Heading(time_offset_s=0.5), "velocity": nf.BodyVelocity(time_offset_s=-1.25)}
    drive = nf.DeadReckoning(rate_hz=4.0, **sensors)
    t = np.arange(0.0, 8.0, 0.25)
    angles, velocity = np.column_stack([0.0 * t, 0.0 * t, 0.1 * t]), np.column_stack([1.0 + t, 0.0 * t, 0.0 * t])
    streams = {"attitude": nf.Stream(t, angles, ("a",) * 3), "velocity": nf.Stream(t, velocity, ("v",) * 3)}
    times, pairs = drive.samples(streams)
    pairing, found = Pairing(drive.period_s, drive.late_s), []
    for k, time_s in enumerate(t.tolist()):
        found += pairing.take(reading("attitude", time_s, *angles[k]))
        found += pairing.take(reading("velocity", time_s, *velocity[k]))
    found += pairing.end()
    assert pairing.counts["unpaired"] == len(t) - len(times) > 0  # after the last attitude
    assert [r.time_s for r, _ in found] == times.tolist()
    np.testing.assert_array_equal([a + r.value for r, a in found], pairs)


def test_a_velocity_without_attitude_is_held_or_dropped_and_keeps_the_order():
    pairing = Pairing(0.25)
    assert list(pairing.take(reading("velocity", 0.0, 1, 0, 0))) == []
    assert list(pairing.take(reading("depth", 0.0, 5.0))) == []  # waits behind it
    assert [(r.sensor, a) for r, a in pairing.take(reading("attitude", 0.1, 0, 0, 1.0))] == [
        ("velocity", [0, 0, 1.0]),
        ("depth", None),
    ]
    assert list(pairing.take(reading("velocity", 0.3, 1, 0, 0))) == []
    assert list(pairing.take(reading("velocity", 0.5, 1, 0, 0))) == []
    # the attitude is lost: the first holds it (0.2 s old, within a period), the second (0.4 s) is dropped
    held = list(pairing.take(reading("depth", 2.0, 5.0)))
    assert [(r.sensor, r.time_s) for r, _ in held] == [("velocity", 0.3), ("depth", 2.0)] and pairing.counts[
        "unpaired"
    ] == 1
    # nan is no attitude, a repeat neither; a clock set back starts afresh
    for t, angle in ((2.1, float("nan")), (0.1, 1.0), (-50.0, 1.0)):
        list(pairing.take(reading("attitude", t, 0, 0, angle)))
    assert [pairing.counts[f"attitude-{key}"] for key in ("invalid", "backward", "clock-set-back")] == [1, 1, 1]
    before = Pairing(0.25)
    before.restore(json.loads(to_line(pairing.snapshot())))
    assert before.snapshot() == pairing.snapshot()


# --- output and disk ------------------------------------------------------------------------------------------------


def test_a_slow_reader_loses_the_oldest_states_and_no_event():
    ours, theirs = os.pipe()
    outlet = Outlet(theirs, longest=20)
    line = to_line({"pad": "x" * 20000})

    def put():
        for k in range(500):
            outlet.put(to_line({"k": k}) + line, True)
            if k % 100 == 0:
                outlet.put(to_line({"event": k}), False)

    putting = threading.Thread(target=put, daemon=True)
    putting.start()
    putting.join(PATIENCE_S)
    assert not putting.is_alive()  # nobody reads: it would be for ever
    assert not outlet.close(0.05) and outlet.dropped > 300
    data, reader = b"", os.fdopen(ours, "rb")
    while b'"k":499}' not in data:
        data += os.read(reader.fileno(), 65536)
    rows = [json.loads(row) for row in data.splitlines() if row.endswith(b"}")]
    assert [row["event"] for row in rows if isinstance(row.get("event"), int)] == [0, 100, 200, 300, 400]
    numbers = [row["k"] for row in rows if "k" in row]
    assert numbers == sorted(numbers) and numbers[-10:] == list(range(490, 500))
    assert any(row.get("what") == "output-dropped" and row["lines"] == outlet.dropped for row in rows)
    reader.close()
    os.close(theirs)


def test_a_full_disk_is_counted_and_left_behind(tmp_path, monkeypatch):
    notices, path, first, lost = [], tmp_path / "log", b"one 0\ntwo 0\n", b'{"event":"lost"}\n'
    disk = Disk(
        path.open("ab", buffering=0), tmp_path / "state", 0.05, lambda what, **fields: notices.append((what, fields))
    )
    write, full = disk._file.write, threading.Event()

    class Full:
        def __getattr__(self, name):
            return getattr(file, name)

        def write(self, view):
            if not full.is_set():
                return write(view)
            write(view[: len(view) // 2])  # a full disk takes what still fits
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Disk, "WELL_S", 0.0)
    file, disk._file = disk._file, Full()
    for is_full, happened in (
        (False, lambda: path.read_bytes() == first),
        (True, lambda: len(notices) == 1),
        (False, lambda: path.read_bytes() == first + lost + first),
    ):
        (full.set if is_full else full.clear)()
        disk.append(b"one %d\ntwo %d\n" % (is_full, is_full))
        wait_for(happened)
    assert disk.close()
    assert path.read_bytes() == first + lost + first
    assert [what for what, _ in notices] == ["disk-failed", "disk-recovered"] and disk.lost_lines == 2
    # a disk that takes a little now and then is not well
    disk._trouble("log", OSError(errno.ENOSPC, ""))
    monkeypatch.setattr(Disk, "WELL_S", 100.0)
    disk._recovered("log")
    assert [what for what, _ in notices] == ["disk-failed", "disk-recovered", "disk-failed"]


def test_damaged_snapshots_are_refused(tmp_path):
    path, data = tmp_path / "state", StateFile.pack(b'{"a":1.5}\n', b"navigator\n\x00", 7)
    path.write_bytes(data)
    assert StateFile.read(path) == (b'{"a":1.5}', b"navigator\n\x00", 7)
    for damaged, why in (
        (data[:-1], "damaged"),
        (data[:-3] + bytes([data[-3] ^ 1]) + data[-2:], "damaged"),
        (data.replace(b"state 1", b"state 2"), "another version"),
        (b"", "no snapshot"),
        (b"\xff" * 50, "no snapshot"),
    ):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=why):
            StateFile.read(path)


# --- the command ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def logged(dive, tmp_path_factory):
    """A run through standard input with a log, to its end, with every kind of bad line on the way."""
    folder = tmp_path_factory.mktemp("logged") / "log"
    lines, bad = [*dive.lines], [line for kind in BAD.values() for line in kind]
    for k, line in enumerate(bad):
        lines.insert(100 + 90 * k, line + b"\n")
    process = Process(*dive.arguments, "--log", folder, "--quiet")
    process.send(lines)
    output = process.end()
    assert (process.code, process.errors) == (0, b"")
    return folder, output, lines


def test_end_to_end(dive, logged):
    _, output, _ = logged
    rows, events = states(output)
    without = [{k: v for k, v in row.items() if k != "bad_lines"} for row in rows]
    assert without == [{k: v for k, v in row.items() if k != "bad_lines"} for row in states(dive.output)[0]]
    assert rows[-1]["bad_lines"] == {kind: len(of) for kind, of in BAD.items()}
    assert [e["event"] for e in events] == ["start", *["bad-line"] * len(BAD), "stop"] and {
        e.get("kind") for e in events
    } >= set(BAD)
    assert reproducible(output) == output


def test_the_log_gives_the_output_again(logged, capfdbinary):
    folder, output, _ = logged
    assert main(["run", "--replay-log", str(folder), "--quiet"]) == 0
    again = capfdbinary.readouterr()
    assert again.err == b"" and again.out == b"".join(output)


def test_the_log_is_a_mission(dive, logged, tmp_path):
    folder, output, _ = logged
    logged_lines = (folder / LOG_FILE).read_bytes().splitlines(keepends=True)
    assert [
        line for line in logged_lines if not line.startswith(b'{"event"')
    ] == dive.lines  # as they came, in their order
    mission = nf.read_mission(folder)
    assert mission.start == dive.mission.start and mission.notes == (
        f"{LOG_FILE}: {sum(map(len, BAD.values()))} lines were no readings when they arrived",
    )
    for name, stream in dive.mission.streams.items():
        assert np.array_equal(mission.streams[name].time_s, stream.time_s)
        assert np.array_equal(mission.streams[name].value, stream.value, equal_nan=True)
    track = nf.replay(nf.read_vehicle(folder), mission, output_rate_hz=None).to_frame()
    assert track["longitude_deg"].iloc[-1] == states(output)[0][-1]["longitude_deg"]
    assert main(["check", str(folder), "--vehicle", str(folder), "--quiet"]) == 0
    assert (
        main(
            ["replay", str(folder), "--vehicle", str(folder), "--out", str(tmp_path / "out"), "--quiet", "--no-report"]
        )
        == 0
    )


def test_over_tcp_with_a_client_that_comes_back(dive):
    process, out = Process(*dive.arguments, "--listen", "tcp://127.0.0.1:0"), []
    host, port = process.said("listening").split("tcp://")[1].strip().rsplit(":", 1)
    cut = len(dive.lines) // 2

    def connect():
        return socket.create_connection((host, int(port)), timeout=PATIENCE_S)

    with connect() as client, client.makefile("rb") as answers:
        sending = threading.Thread(target=client.sendall, args=(b"".join(dive.lines[:cut]),))
        sending.start()
        out.append(answers.readline())
        with connect() as other:
            assert other.recv(10) == b""  # one at a time
        sending.join()
        client.shutdown(socket.SHUT_WR)
        out += answers.readlines()  # everything is answered before the client goes
    assert states(out)[0][-1]["time_s"] == json.loads(dive.lines[cut])["time_s"] // 1
    with connect() as client, client.makefile("rb") as answers:
        client.sendall(b"".join(dive.lines[cut:]))
        while b'"time_s":60.0' not in out[-1]:
            out.append(answers.readline())
        process.end(signal.SIGTERM)
        out += answers.readlines()
    assert process.code == 0 and reproducible(out) == dive.output
    assert process.errors.count(b"connected") == 3 and process.errors.count(b"refused") == 1


def test_killed_while_it_reads_it_goes_on(dive, tmp_path, capfdbinary):
    """SIGKILL twice; the sender goes on with what the log does not have; the end is, bit for bit, that of an
    undisturbed run.
    """
    folder, rng, output, sent, under_way = tmp_path / "log", np.random.default_rng(5), [], 0, []
    arguments = [*dive.arguments, "--log", folder, "--resume", "--snapshot-every", "0.2", "--fsync", "0.1", "--quiet"]
    for kill_at_s in (7.0, 33.0):
        process = Process(*arguments)
        more = int(rng.integers(200, 400))
        end = next(k for k, line in enumerate(dive.lines) if json.loads(line)["time_s"] > kill_at_s) + 1
        process.send(dive.lines[sent:end])
        process.read_until(kill_at_s)
        wait_for((folder / "snapshot").exists)
        # the log is written beside the loop; a power cut loses what it had no time for
        wait_for(lambda: (folder / LOG_FILE).read_bytes().count(b'{"sensor": ') >= end)  # noqa: B023
        sending = threading.Thread(target=quietly, args=(process.send, dive.lines[end : end + more]))
        sending.start()
        process.read_until(kill_at_s + 1.0)  # in the middle of what is being sent
        process.process.kill()
        sending.join(PATIENCE_S)
        under_way.append((kill_at_s + 1.0, json.loads(dive.lines[end + more])["time_s"]))
        output += process.end()
        assert process.code == -signal.SIGKILL and process.errors == b""
        assert nf.read_mission(folder).duration_s > kill_at_s - 1.0  # readable as it lies there
        whole = [item for item in log_items(folder / LOG_FILE, dive.vehicle) if isinstance(item, Reading)]
        assert [item.raw for item in whole] == dive.lines[: len(whole)] and len(whole) >= end
        sent = len(whole)
        with (folder / LOG_FILE).open("ab") as log:
            log.write(b'{"sensor":"imu","time_s":')  # a power cut in the middle of a line
    process = Process(*arguments)
    process.send(dive.lines[sent:])
    output += process.end()
    assert process.code == 0 and process.errors == b""
    told = states(output)[1]
    resumed = [e for e in told if e["event"] == "resume"]
    assert (
        len(resumed) == 2
        and all(e["snapshot"] for e in resumed)
        and not any(e.get("what") == "internal-error" for e in told)
    )
    expected = [line for line in dive.output if b'"event"' not in line]
    got = [line for line in output if b'"event"' not in line]
    assert set(got) <= set(expected) and got[-1] == expected[-1]
    # nothing but what was on its way to the reader when the process was killed is missing
    missing = [json.loads(line)["time_s"] for line in set(expected) - set(got)]
    assert all(any(begin < time_s <= end for begin, end in under_way) for time_s in missing), (missing, under_way)
    capfdbinary.readouterr()
    assert main(["run", "--replay-log", str(folder), "--quiet"]) == 0
    assert capfdbinary.readouterr().out == b"".join(dive.output)


def quietly(call, *arguments):
    with contextlib.suppress(OSError):
        call(*arguments)


def test_a_signal_ends_it_cleanly_and_a_damaged_snapshot_is_refused_where_asked(dive, tmp_path, capfd):
    folder = tmp_path / "log"
    process = Process(*dive.arguments, "--log", folder, "--quiet", "--rate-hz", "5")
    half = [line for line in dive.lines if json.loads(line)["time_s"] <= 30.1]
    process.send(half)
    process.read_until(30.0)
    assert main(["run", *dive.arguments, "--log", str(folder), "--resume"]) == 2  # it is being written
    assert "another process" in capfd.readouterr().err
    output = process.end(signal.SIGTERM)
    rows, events = states(output)
    assert (
        process.code == 0
        and events[-1]["event"] == "stop"
        and rows[-1]["time_s"] == pytest.approx(30.1)
        and len(rows) == 151
    )
    assert (folder / LOG_FILE).read_bytes().splitlines()[-1] == b'{"event":"stop"}'
    assert main(["run", *dive.arguments, "--log", str(folder)]) == 2  # there is a log already
    data = bytearray((folder / "snapshot").read_bytes())
    data[-100] ^= 1
    (folder / "snapshot").write_bytes(data)
    assert main(["run", *dive.arguments, "--log", str(folder), "--resume", "strict", "--quiet"]) == 2
    # without it the whole log is fed again
    (folder / "snapshot").unlink()
    (tmp_path / "rest").write_bytes(b"".join(dive.lines[len(half) :]))
    capfd.readouterr()
    assert (
        main(
            [
                "run",
                "--vehicle",
                str(dive.toml),
                "--log",
                str(folder),
                "--quiet",
                "--resume",
                "--input",
                str(tmp_path / "rest"),
            ]
        )
        == 0
    )
    rows, events = states(capfd.readouterr().out.splitlines())
    assert events[0] == {
        "event": "resume",
        "time_s": rows[0]["time_s"] - 0.9,
        "snapshot": False,
        "readings_from_log": events[0]["readings_from_log"],
    }
    assert rows[-1] == states(dive.output)[0][-1]


def test_a_full_disk_does_not_stop_it(dive, tmp_path):
    limit = 300_000

    def full_disk():
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    process = Process(*dive.arguments, "--log", tmp_path / "log", "--quiet", preexec_fn=full_disk)
    process.send(dive.lines)
    output = process.end()
    assert process.code == 0 and reproducible(output) == dive.output
    notices = [e for e in states(output)[1] if e["event"] == "notice"]
    assert [e["what"] for e in notices] == ["disk-failed"] and "too large" in notices[0]["text"]
    mission = nf.read_mission(tmp_path / "log")
    logged = mission.streams["imu"]
    whole = dive.mission.streams["imu"]
    rows = np.searchsorted(whole.time_s, logged.time_s)
    assert (
        len(logged) > 500
        and np.array_equal(logged.time_s, whole.time_s[rows])
        and np.array_equal(logged.value, whole.value[rows])
    )


def test_only_the_loopback_is_listened_on():
    assert listen_address("tcp://127.0.0.1:4600", allow_remote=False) == ("127.0.0.1", 4600)
    assert listen_address("tcp://localhost:0", allow_remote=False) == ("127.0.0.1", 0)
    assert listen_address("tcp://[::1]:4600", allow_remote=False) == ("::1", 4600)
    assert listen_address("tcp://0.0.0.0:4600", allow_remote=True) == ("0.0.0.0", 4600)
    for url in ("tcp://0.0.0.0:4600", "tcp://192.168.1.2:4600", "tcp://[::]:4600"):
        with pytest.raises(ValueError, match="allow-remote"):
            listen_address(url, allow_remote=False)
    for url in (
        "udp://127.0.0.1:1",
        "127.0.0.1:1",
        "tcp://127.0.0.1",
        "tcp://127.0.0.1:99999",
        "tcp://auv:1",
        "tcp://:1",
        "tcp://[::1:1",
    ):
        with pytest.raises(ValueError, match="--listen"):
            listen_address(url, allow_remote=True)


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        ([], "needs --vehicle"),
        (["--vehicle", "V", "--resume"], "nothing to go on from"),
        (["--vehicle", "V", "--listen", "tcp://0.0.0.0:4600"], "can be reached from other computers"),
        (["--vehicle", "V", "--input", "/nowhere"], "/nowhere"),
        (["--vehicle", "V", "--start", "V"], "start lacks"),
        (["--replay-log", "V", "--log", "x"], "as it is"),
        (["--replay-log", "V"], "V"),
    ],
)
def test_wrong_usage_is_one_line(arguments, why, dive, tmp_path, capsys):
    (tmp_path / "empty.toml").write_text("height_m = 3.0\n")
    arguments = [str(dive.toml) if word == "V" else word for word in arguments]
    if "--start" in arguments:
        arguments[-1] = str(tmp_path / "empty.toml")
    assert main(["run", *arguments]) == 2
    said = capsys.readouterr()
    assert (
        said.out == ""
        and said.err.startswith("navfilter: ")
        and said.err.count("\n") == 1
        and why.replace("V", str(dive.toml)) in said.err
    )


def test_help_teaches(capsys):
    with pytest.raises(SystemExit) as end:
        main(["run", "--help"])
    said = capsys.readouterr().out
    assert end.value.code == 0 and "examples:" in said and '{"sensor": "imu"' in said and "--quiet" in said


def test_input_from_a_named_pipe(dive, tmp_path, capfdbinary):
    """As a driver that is another process, and a rate of its own."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    driver = threading.Thread(target=pipe.write_bytes, args=(b"".join(dive.lines),))
    driver.start()
    assert main(["run", *dive.arguments, "--input", str(pipe), "--rate-hz", "0.1"]) == 0
    driver.join(PATIENCE_S)
    rows, _ = states(capfdbinary.readouterr().out.splitlines())
    assert [row["time_s"] for row in rows] == [10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 60.0]
    assert rows[-1] == states(dive.output)[0][-1]


def test_a_log_of_nothing(dive, tmp_path):
    with pytest.raises(ValueError, match="no such file"):
        logged_options(tmp_path / LOG_FILE)
    (tmp_path / LOG_FILE).write_bytes(dive.lines[0])
    with pytest.raises(ValueError, match="does not begin"):
        logged_options(tmp_path / LOG_FILE)
