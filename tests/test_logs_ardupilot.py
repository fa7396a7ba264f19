"""ArduPilot logs: DataFlash with the units that it states itself, telemetry with MAVLink's, velocity logs as deltas."""

import datetime
import random
import struct
import tracemalloc
from collections import Counter

import numpy as np
import pytest

import navfilter as nf
from navfilter.io.logs import Shelf
from navfilter.io.logs.survey import survey
from navfilter.io.logs.topic_names import Wanted
from navfilter.models.mission import MissionError

mavutil = pytest.importorskip(
    "pymavlink.mavutil", reason='pymavlink is not installed: pip install "navfilter[ardupilot]"'
)
DFReader = pytest.importorskip("pymavlink.DFReader")
dataflash = pytest.importorskip("navfilter.io.logs.ardupilot")

BIN, TLOG = "ardupilot/ardusub_small.BIN", "ardupilot/ardusub_small.tlog"


def test_a_dataflash_log_in_its_own_units(log_sample, tmp_path):
    (tmp_path / "mission.toml").write_text(
        f"""
[streams.imu]
file = "{log_sample(BIN)}"
topic = "IMU"
time = {{column = "TimeUS"}}
rate = ["GyrX", "GyrY", "GyrZ"]
force = ["AccX", "AccY", "AccZ"]
[streams.compass]
file = "{log_sample(BIN)}"
topic = "MAG[0]"
time = {{column = "log_time"}}
field = ["MagX", "MagY", "MagZ"]
[streams.attitude]
file = "{log_sample(BIN)}"
topic = "ATT"
time = {{column = "log_time"}}
attitude = ["Roll", "Pitch", "Yaw"]
"""
    )
    mission = nf.read_mission(tmp_path)
    imu = mission.streams["imu"]
    assert {name: len(stream) for name, stream in mission.streams.items()} == {
        "imu": 594,
        "compass": 237,
        "attitude": 237,
    }
    assert imu.time_s[0] == pytest.approx(265.678654, abs=1e-9)
    np.testing.assert_array_equal(imu.value[0, [0, 5]], np.float32([-0.007749793119728565, -9.770174026489258]))
    # Microseconds, mGauss and degrees: by the log's own UNIT and MULT, nothing is said in the mission.toml.
    np.testing.assert_allclose(mission.streams["compass"].value[0], np.array([-140, 63, 900]) * 1e-7, rtol=1e-12)
    np.testing.assert_allclose(
        np.degrees(mission.streams["attitude"].value[0]), [-0.08, -0.63, 213.93 - 360], atol=1e-9
    )


def test_one_topic_by_two_names(log_sample):
    path = log_sample(BIN)
    shelf = Shelf({path: {"IMU": {"GyrX"}, "IMU[0]": {"GyrY"}}})
    assert shelf.table(path, "IMU").raw("GyrX").size == shelf.table(path, "IMU[0]").raw("GyrY").size == 594


def by_pymavlink(path):
    """Topic -> times and values of every field, by the library's own reader, and its units."""
    log, found, units = DFReader.DFReader_binary(str(path)), {}, {}
    while (message := log.recv_match()) is not None:
        form = message.fmt
        topic = form.name
        if form.instance_field is not None:
            topic = f"{topic}[{getattr(message, form.instance_field)}]"
        times, rows = found.setdefault(topic, ([], {}))
        times.append(message._timestamp)
        for field in message.get_fieldnames():
            value = getattr(message, field)
            many = enumerate(value) if hasattr(value, "typecode") else ()
            for name, one in [(f"{field}[{k}]", v) for k, v in many] or [(field, value)]:
                rows.setdefault(name, []).append(one)
        units[topic] = {name: unit for name, unit in zip(form.columns, form.units or (), strict=False) if unit}
    log.close()
    return found, units


def assert_as_by_pymavlink(path):
    wanted, found = Wanted(), {}
    for topic, time_s, record in dataflash.dataflash_records(path, wanted, Counter()):
        times, rows = found.setdefault(topic, ([], {}))
        times += np.atleast_1d(time_s).tolist()
        for name, cells in record.items():
            rows.setdefault(name, []).extend(np.atleast_1d(cells).tolist())
    expected, units = by_pymavlink(path)
    assert set(found) == set(expected) and len(found) > 2
    for topic, (times, rows) in expected.items():
        if "TimeUS" in rows:  # what has none gets the time of some other message
            # of a date in float64, added up in another order
            np.testing.assert_allclose(found[topic][0], times, rtol=0, atol=1e-6)
        assert set(found[topic][1]) == set(rows)
        for name, cells in rows.items():
            numbers = not isinstance(cells[0], str)
            # the same bits
            assert np.array_equal(found[topic][1][name], cells, equal_nan=numbers), (topic, name)
        assert {name: unit for name, unit in wanted.units[topic].items() if unit} == units[topic]


def test_every_message_is_that_of_the_library(log_sample):
    assert_as_by_pymavlink(log_sample(BIN))


def dataflash_log(messages, units=()):
    """A log: name -> format, columns and rows, in this order; `units` are rows of FMTU, the types begin with 13."""
    labels = [(1, ord("s"), b"s"), (1, ord("m"), b"m"), (1, ord("#"), b"instance")]
    described = {
        "UNIT": ("QbZ", "TimeUS,Id,Label", labels),
        "MULT": ("Qbd", "TimeUS,Id,Mult", [(1, ord("F"), 1e-6), (1, ord("0"), 1.0), (1, ord("B"), 1e-2)]),
        "FMTU": ("QBNN", "TimeUS,FmtType,UnitIds,MultIds", list(units)),
    } | messages
    out = b""
    for kind, (name, (form, columns, _)) in enumerate(described.items(), 10):
        length = 3 + struct.calcsize(packed(form))
        fields = (kind, length, name.encode(), form.encode(), columns.encode())
        out += b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", *fields)
    for kind, (form, _, rows) in enumerate(described.values(), 10):
        out += b"".join(b"\xa3\x95" + bytes([kind]) + struct.pack(packed(form), *row) for row in rows)
    return out


def packed(form):
    return "<" + "".join(DFReader.FORMAT_TO_STRUCT[character][0] for character in form)


def test_every_type_of_field_and_utc_are_those_of_the_library(tmp_path):
    """Made by hand from the description of the format: what the sample does not hold."""
    many = np.arange(-16, 16, dtype="<i2").tobytes()
    gps = [(4_000_000, 0, 0, 0), (5_000_000, 0, 345_600_000, 2420), (6_000_000, 1, 345_601_000, 2420)]
    depth = [(5_100_000 + 1000 * k, k % 3, 100 * k) for k in range(50)]
    numbers = (5_000_000, -3, 250, -300, 60000, -70000, 4_000_000_000, 1.5, -2.25, 0.5, -9)
    scaled = (5_000_000, -123, 123, -456, 456, 541234567, 7)
    log = dataflash_log(
        {
            "NUM": ("QbBhHiIfdgq", "TimeUS,b,B,h,H,i,I,f,d,g,q", [numbers]),
            "SCA": ("QcCeELM", "TimeUS,c,C,e,E,L,M", [scaled]),
            "TXT": ("QnNZ", "TimeUS,n,N,Z", [(5_000_000, b"ab", b"a name", b"text, \xe9")]),
            "ARR": ("Qa", "TimeUS,a", [(5_000_000, many)]),
            "GPS": ("QBIH", "TimeUS,I,GMS,GWk", gps),
            "DPT": ("QBe", "TimeUS,I,D", depth),
        },
        units=[(1, 17, b"s#--", b"F-00"), (1, 18, b"s#m", b"F-0")],
    )
    (tmp_path / "made.bin").write_bytes(log)
    assert_as_by_pymavlink(tmp_path / "made.bin")
    table = Shelf().table(tmp_path / "made.bin", "DPT[1]")
    assert table.units["D"] == "m" and table.raw("D")[0] == 1.0
    # 345600 s into the week of Sunday 2026-05-24: Thursday, 0:00 of GPS, 18 s ahead of UTC
    midnight = datetime.datetime(2026, 5, 28, tzinfo=datetime.UTC).timestamp()
    assert table.raw("log_time")[0] == pytest.approx(midnight - 18.0 + 0.101, abs=1e-6)


def test_a_long_log_costs_the_memory_of_a_block(log_sample, tmp_path, monkeypatch):
    whole = log_sample(BIN).read_bytes()
    (tmp_path / "long.bin").write_bytes(40 * whole)
    once = Shelf().table(log_sample(BIN), "IMU").raw("GyrX")
    monkeypatch.setattr(dataflash, "_BLOCK", 1 << 16)
    tracemalloc.start()
    try:
        gyro = Shelf({tmp_path / "long.bin": {"IMU": {"GyrX"}}}).table(tmp_path / "long.bin", "IMU").raw("GyrX")
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # blocks cut messages in two: none is lost
    np.testing.assert_array_equal(gyro, np.tile(once, 40))
    # of a log of 12 MB: what is read of it, its times and copies of both, and a block with the places in it
    assert most < 4e6


def test_a_log_without_times_is_refused(tmp_path):
    old = dataflash_log({"ATT": ("Ic", "TimeMS,Roll", [(5, 100)])}).replace(b"TimeUS", b"TimeMS")
    (tmp_path / "old.bin").write_bytes(old)
    with pytest.raises(MissionError, match="no message of this log has TimeUS"):
        Shelf().table(tmp_path / "old.bin", "ATT")


def test_formats_that_contradict_themselves_are_left_out(tmp_path):
    """A length that is not that of the fields, a field of an unknown type: counted, the others are read."""
    good = ("Qf", "TimeUS,V", [(1_000_000 + k, 0.5 * k) for k in range(5)])
    log = dataflash_log({"BAD": good, "ODD": good, "OK": good})
    bad = log.replace(b"BAD\0Qf\0", b"BAD\0Qff").replace(b"ODD\0Qf", b"ODD\0Q?")
    (tmp_path / "odd.bin").write_bytes(bad)
    shelf = Shelf({tmp_path / "odd.bin": {"OK": None}})
    table = shelf.table(tmp_path / "odd.bin", "OK")
    np.testing.assert_array_equal(table.raw("V"), 0.5 * np.arange(5))
    assert any("2 contradictory formats" in note for note in table.notes)
    assert any("10 messages of no known format" in note for note in table.notes)


def test_a_unit_of_the_log_must_fit(log_sample, tmp_path):
    (tmp_path / "mission.toml").write_text(
        f'[streams.depth]\nfile = "{log_sample(BIN)}"\ntopic = "BARO[0]"\n'
        'time = {column = "log_time"}\ndepth = "Press"\n'
    )
    with pytest.raises(MissionError, match='column "Press" is in Pa by the file itself, depth needs length'):
        nf.read_mission(tmp_path)


def test_telemetry_of_a_bluerov(log_sample, tmp_path):
    (tmp_path / "mission.toml").write_text(
        f"""
[streams.attitude]
file = "{log_sample(TLOG)}"
topic = "ATTITUDE"
time = {{column = "time_boot_ms", unit = "ms"}}
attitude = ["roll", "pitch", "yaw"]
[streams.depth]
file = "{log_sample(TLOG)}"
topic = "SCALED_PRESSURE2"
time = {{column = "time_boot_ms", unit = "ms"}}
pressure = "press_abs"
[streams.usbl]
file = "{log_sample(TLOG)}"
topic = "GPS_INPUT"
time = {{column = "log_time"}}
position = ["lat", "lon"]
"""
    )
    mission = nf.read_mission(tmp_path)
    counts = {name: len(stream) for name, stream in mission.streams.items()}
    assert counts["depth"] == 635 and counts["usbl"] == 1011 and counts["attitude"] > 5000
    assert mission.streams["depth"].value[0, 0] == pytest.approx(101580.0, abs=0.01)
    np.testing.assert_allclose(np.degrees(mission.streams["usbl"].value[0, :2]), [48.3861418, -124.6305732], atol=1e-9)
    assert any("4 messages with a wrong checksum" in note for note in mission.notes)
    with pytest.raises(MissionError, match=r"HEARTBEAT\[255.190\] \(265 records\) and HEARTBEAT\[1.100\]"):
        Shelf().table(log_sample(TLOG), "HEARTBEAT")


def test_position_changes_of_a_velocity_log_are_velocities(tmp_path):
    from pymavlink.dialects.v20 import ardupilotmega

    sender = ardupilotmega.MAVLink(None, srcSystem=1, srcComponent=197)
    with (tmp_path / "dvl.tlog").open("wb") as file:
        for k in range(5):
            changes = ([0.0, 0.0, 0.001], [0.02 + 0.001 * k, -0.01, 0.0])
            message = sender.vision_position_delta_encode(1_000_000 + 100_000 * k, 100_000, *changes, 90.0)
            file.write(struct.pack(">Q", 1_700_000_000_000_000 + 100_000 * k) + message.pack(sender))
    table = Shelf().table(tmp_path / "dvl.tlog", "VISION_POSITION_DELTA")
    np.testing.assert_allclose(table.raw("velocity_x"), 0.2 + 0.01 * np.arange(5), rtol=1e-6)
    np.testing.assert_allclose(table.raw("velocity_y"), -0.1, rtol=1e-6)
    np.testing.assert_allclose(table.raw("log_time"), 1.7e9 + 0.1 * np.arange(5), atol=1e-5)
    assert table.raw("angle_delta[2]")[0] == np.float32(0.001)


def test_logs_that_are_cut_short_or_none(log_sample, tmp_path):
    for name, whole in (("cut.bin", log_sample(BIN).read_bytes()), ("cut.tlog", log_sample(TLOG).read_bytes())):
        (tmp_path / name).write_bytes(whole[: len(whole) // 2])
    assert 100 < Shelf().table(tmp_path / "cut.bin", "IMU").raw("log_time").size < 594
    assert 1000 < Shelf().table(tmp_path / "cut.tlog", "ATTITUDE").raw("log_time").size < 5245
    (tmp_path / "no.bin").write_bytes(b"")
    with pytest.raises(MissionError, match="cannot be read as an ArduPilot log"):
        Shelf().table(tmp_path / "no.bin", "IMU")


@pytest.mark.parametrize("block", [1000, 4 << 20])
def test_damage_is_read_over_or_refused(log_sample, tmp_path, monkeypatch, recwarn, block):
    """Formats, lengths and units too, in blocks that cut everything in two; no warning of NumPy either."""
    monkeypatch.setattr(dataflash, "_BLOCK", block)
    whole, read = log_sample(BIN).read_bytes(), 0
    for seed in range(25):
        chance = random.Random(seed)
        piece = bytearray(whole[: chance.randrange(1, 60_000)])
        for _ in range(chance.choice([1, 30, 800])):
            # the formats stand at the beginning
            piece[chance.randrange(min(len(piece), chance.choice([len(piece), 20_000])))] = chance.randrange(256)
        piece += bytes(chance.randrange(256) for _ in range(chance.choice([0, 3000])))
        (tmp_path / "damaged.bin").write_bytes(piece)
        try:
            read += len(survey(tmp_path / "damaged.bin").topics) > 0
        except MissionError as error:
            assert "\n" not in str(error)
    assert read > 10 and not recwarn.list
