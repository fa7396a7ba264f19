"""Readings that come with their own standard deviation: from any file to the filter, live as in a replay."""

import dataclasses
import json

import numpy as np
import pytest
from live_run import as_lines, run_session, states

import navfilter as nf
from navfilter.filter.filter import CODES
from navfilter.models.mission import Mission, MissionError, Stream
from navfilter.service.session import Options
from navfilter.simulation.scenarios import simulate_scenario

#: What drivers send: for all axes, for each, none, and what no navigator takes.
GIVEN = [[0.5], [2.0, 3.0, 5.0], None, [1.0, None, 1.0], [-1.0], [1.0, 2.0]]


@pytest.fixture(scope="module")
def dive():
    vehicle, mission = simulate_scenario("lawnmower", 4, 60.0)
    return vehicle, mission


def with_sd(lines, sensor, given):
    """The lines of a mission in which each reading of one sensor brings the next of these."""
    result, k = [], 0
    for line in lines:
        fields = json.loads(line)
        if fields["sensor"] == sensor:
            fields |= {} if given[k % len(given)] is None else {"sd": given[k % len(given)]}
            line, k = json.dumps(fields).encode() + b"\n", k + 1
        result.append(line)
    return result


@pytest.mark.parametrize(("sensor", "given"), [("gps", GIVEN), ("depth", [[0.2], None, [0.02], [0.0]])])
def test_a_log_is_replayed_to_the_bit(dive, tmp_path, sensor, given):
    vehicle, mission = dive
    lines = with_sd(as_lines(vehicle, mission), sensor, given)
    start = {k: v for k, v in dataclasses.asdict(mission.start).items() if v is not None}
    live = states(run_session(vehicle, lines, Options(start=start, date=start["date"])))[0][-1]
    (tmp_path / "readings.jsonl").write_bytes(b"".join(lines))
    (tmp_path / "mission.toml").write_text('[log]\nfile = "readings.jsonl"\n')
    read = nf.read_mission(tmp_path).with_start(mission.start)
    assert read.notes == () and read.streams["compass"].sd is None
    last = nf.replay(vehicle, read, output_rate_hz=None).to_frame().iloc[-1]
    for key in ("time_s", "latitude_deg", "longitude_deg", "depth_m", "roll_deg", "pitch_deg", "heading_deg"):
        assert live[key] == last[key]
    assert live["position_sd_m"] == [last[f"position_{axis}_sd_m"] for axis in ("north", "east", "down")]
    without = nf.replay(vehicle, mission, output_rate_hz=None).to_frame().iloc[-1]
    assert last["position_down_sd_m"] != without["position_down_sd_m"]


def test_a_replay_gives_what_the_live_loop_is_given(dive):
    vehicle, mission = dive
    gps = mission.streams["gps"]
    sd = np.random.default_rng(2).uniform(0.5, 5.0, (len(gps), 3))
    none_given = dataclasses.replace(gps, sd=np.full((len(gps), 1), np.nan))
    plain = nf.replay(vehicle, mission)
    np.testing.assert_array_equal(nf.replay(vehicle, mission.with_stream("gps", none_given)).states, plain.states)
    own = nf.replay(vehicle, mission.with_stream("gps", dataclasses.replace(gps, sd=sd)))
    assert np.abs(own.latitude - plain.latitude).max() > 0.0
    negative = nf.replay(vehicle, mission.with_stream("gps", dataclasses.replace(gps, sd=-sd)))
    assert set(negative.residuals["gps"].outcome.tolist()) == {CODES["invalid"]}


CSV = "t,d,sd_mm,sd_x\n0,5.0,100,1\n1,5.1,-1,1\n2,5.2,300,1\n3,5.3,400,1\n"


def stream_of(folder, more, text=CSV, stream="depth", group='depth = "d"'):
    (folder / "a.csv").write_text(text)
    clock = 'file = "a.csv"\ntime = {column = "t"}'
    (folder / "mission.toml").write_text(f"[streams.{stream}]\n{clock}\n{group}\n{more}\n")
    return nf.read_mission(folder).streams[stream]


def test_a_column_of_a_file_in_its_unit(tmp_path):
    sd = 'sd = {column = "sd_mm", unit = "mm", invalid = [-1]}'
    read = stream_of(tmp_path, sd)
    np.testing.assert_allclose(read.sd, [[0.1], [np.nan], [0.3], [0.4]], rtol=1e-15)
    assert read.columns == ("depth_m",) and read.value.shape == (4, 1)
    # the mean of two readings with white errors of 0.3 and 0.4 errs by half the root of the sum of the squares
    np.testing.assert_allclose(stream_of(tmp_path, f"{sd}\naverage = 2").sd, [[np.nan], [0.25]], rtol=1e-15)
    np.testing.assert_allclose(stream_of(tmp_path, f"{sd}\nevery = 2").sd, [[0.1], [0.3]], rtol=1e-15)


def test_new_sd_is_no_new_reading(tmp_path):
    held = "t,d,sd_mm,sd_x\n0,5.0,100,1\n1,5.1,200,1\n2,5.1,300,1\n3,5.3,400,1\n"
    read = stream_of(tmp_path, 'sd = {column = "sd_mm", unit = "mm"}\nonly_changes = true', held)
    np.testing.assert_array_equal(read.time_s, [1.0, 3.0])
    np.testing.assert_allclose(read.sd, [[0.2], [0.4]], rtol=1e-15)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ('sd = {column = "sd_mm", unit = "deg"}', 'sd: "deg" is no unit of length'),
        ('sd = ["sd_mm", "sd_x"]', "sd has 2 columns, it needs 1, or one for each of the 1 axes"),
        ('sd = {column = "sd_mm", axes = "x,y,z"}', "sd takes no axes"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, more, message):
    with pytest.raises(MissionError, match=message):
        stream_of(tmp_path, more)


def test_what_drives_takes_none(tmp_path):
    with pytest.raises(MissionError, match="what drives takes none"):
        stream_of(tmp_path, 'sd = "sd_x"', stream="imu", group='rate = ["d", "d", "d"]\nforce = ["d", "d", "d"]')


def test_it_stays_with_its_reading(tmp_path):
    value = np.arange(5.0)
    mission = Mission("m", {"depth": Stream(value, value, ("depth_m",), 0.1 * value), "other": Stream(value, value)})
    mission.save(tmp_path / "m.npz")
    read = nf.read_mission(tmp_path / "m.npz")
    np.testing.assert_array_equal(read.streams["depth"].sd, 0.1 * value[:, np.newaxis])
    assert read.streams["other"].sd is None
    for part in (read.between(2.0, 9.0), read.hide("depth", (0.0, 1.5))):
        np.testing.assert_array_equal(part.streams["depth"].sd[:, 0], 0.1 * value[2:])
    with pytest.raises(ValueError, match="sd must have one row per time"):
        Stream(value, value, sd=[0.1])
