"""NMEA 0183: what real files hold, times carried and spread, talkers told apart, checksums counted."""

import datetime
import lzma
from functools import reduce
from operator import xor

import numpy as np
import pytest

import navfilter as nf
from navfilter.io.logs import Shelf, format_of, nmea
from navfilter.io.table import TableOptions, Where
from navfilter.io.text_tables import read_table
from navfilter.models.mission import MissionError

pytest.importorskip("pynmeagps", reason='pynmeagps is not installed: pip install "navfilter[nmea]"')

YACHT = "../yacht-irene-1hz/flensburg_20130803_NMEA0004.TXT.xz"
MISSION = """
zero_s = "first"
[streams.gps]
file = "{log}"
topic = "IIRMC"
time = {{column = "log_time"}}
position = {{columns = ["lat", "lon"], unit = "deg"}}
where = {{column = "status", equals = "A"}}
[streams.compass]
file = "{log}"
topic = "IIHDG"
time = {{column = "log_time"}}
heading = {{column = "headingM", unit = "deg"}}
[streams.log]
file = "{log}"
topic = "IIVHW"
time = {{column = "log_time"}}
velocity = {{columns = ["spdN", {{constant = 0.0}}, {{constant = 0.0}}], unit = "kn"}}
"""


def utc(*when):
    return datetime.datetime(*when, tzinfo=datetime.UTC).timestamp()


def sentence(text):
    return f"${text}*{reduce(xor, text.encode()):02X}"


def write(path, *sentences):
    path.write_text("\r\n".join(sentences) + "\r\n")
    return path


def test_a_loggers_prefix_is_no_obstacle(log_sample):
    path = log_sample("nmea/ugps_nmea_log.txt")
    assert format_of(path).module == "nmea"
    table = read_table(path, TableOptions(topic="GGA", where=(Where(column="quality", at_least=1),)))
    assert table.raw("lat").size == 16
    # 4736.4517768 N, 12220.4723713 W at 22:56:45 on 2023-09-01; the library keeps ten digits.
    np.testing.assert_allclose(
        [table.raw("lat")[0], table.raw("lon")[0]], [47.60752961333, -122.34120618833], atol=1e-10
    )
    assert table.raw("log_time")[0] == utc(2023, 9, 1, 22, 56, 45)
    assert read_table(path, TableOptions(topic="GPRMC")).raw("lat").size == 129
    assert any("5 lines without a sentence" in note for note in table.notes)


def test_a_yachts_first_hour_in_one_pass(log_sample, tmp_path):
    with lzma.open(log_sample(YACHT), "rb") as file:
        (tmp_path / "yacht.nmea").write_bytes(b"".join(file.readline() for _ in range(30000)))
    (tmp_path / "mission.toml").write_text(MISSION.format(log="yacht.nmea"))
    mission = nf.read_mission(tmp_path)
    counts = {name: len(stream) for name, stream in mission.streams.items()}
    # Of the 2865 HDG and 2836 VHW of this talker those before the first fix have no time.
    assert counts == {"gps": 2728, "compass": 2825, "log": 2795}
    assert np.degrees(mission.streams["compass"].value[0, 0]) == pytest.approx(63.0)
    assert np.nanmax(mission.streams["log"].column("v_x_m_s")) < 9 * 0.5145
    assert any("sentences before the first time left out" in note for note in mission.notes)


def test_the_date_is_carried_over_midnight(tmp_path):
    path = write(
        tmp_path / "night.nmea",
        sentence("GPGGA,235958.00,5400.000,N,01000.000,E,1,08,0.9,1.0,M,40.0,M,,"),  # before the date is known
        sentence("GPZDA,235959.00,28,02,2024,00,00"),
        sentence("GPGGA,235959.50,5400.000,N,01000.000,E,1,08,0.9,1.0,M,40.0,M,,"),
        sentence("GPGGA,000000.50,5400.001,N,01000.000,E,1,08,0.9,1.0,M,40.0,M,,"),  # no new date yet
        sentence("GPZDA,000001.00,29,02,2024,00,00"),
        sentence("GPGGA,000001.50,5400.001,N,01000.000,E,1,08,0.9,1.0,M,40.0,M,,"),
    )
    time_s = Shelf().table(path, "GGA").raw("log_time")
    np.testing.assert_array_equal(time_s - utc(2024, 2, 28, 23, 59, 58), [0.0, 1.5, 2.5, 3.5])


def test_a_file_without_a_date_says_so(tmp_path):
    path = write(tmp_path / "x.nmea", sentence("GPGGA,120000.00,5400.000,N,01000.000,E,1,08,0.9,1.0,M,40.0,M,,"))
    table = Shelf().table(path, "GGA")
    assert table.raw("log_time")[0] == 12 * 3600
    assert any("without a date" in note for note in table.notes)


def test_sentences_without_a_time_are_spread_between_two_times(tmp_path):
    lines = []
    for second in range(3):
        lines.append(sentence(f"GPZDA,1200{second:02d}.00,01,06,2024,00,00"))
        lines += [sentence(f"HEHDT,{100 + second}.{k},T") for k in range(4)]
        lines.append(sentence("VWVHW,,T,90.0,M,5.0,N,9.3,K"))
    shelf = Shelf()
    path = write(tmp_path / "x.nmea", *lines)
    began = utc(2024, 6, 1, 12)
    np.testing.assert_allclose(shelf.table(path, "HDT").raw("log_time") - began, np.arange(12) / 4, atol=1e-6)
    np.testing.assert_array_equal(shelf.table(path, "VHW").raw("log_time") - began, [0.0, 1.0, 2.0])


def test_with_a_loggers_stamps_their_differences_count(tmp_path):
    path = write(
        tmp_path / "x.nmea",
        "2024-06-01T14:00:00.100Z " + sentence("GPZDA,120000.00,01,06,2024,00,00"),
        "2024-06-01T14:00:00.350Z " + sentence("HEHDT,100.0,T"),
        "2024-06-01T14:00:00.900Z " + sentence("HEHDT,101.0,T"),
    )
    time_s = Shelf().table(path, "HDT").raw("log_time")
    np.testing.assert_allclose(time_s - utc(2024, 6, 1, 12), [0.25, 0.8], atol=1e-6)


def test_a_loggers_stamps_alone(tmp_path):
    path = write(tmp_path / "x.nmea", *(f"1717243200.{k}5 {sentence(f'HEHDT,{k}.0,T')}" for k in range(3)))
    np.testing.assert_allclose(
        Shelf().table(path, "HDT").raw("log_time"), 1717243200.05 + 0.1 * np.arange(3), atol=1e-6
    )


def test_without_any_time_the_reason_is_said(tmp_path):
    path = write(tmp_path / "x.nmea", *(sentence(f"HEHDT,{k}.0,T") for k in range(3)))
    with pytest.raises(MissionError, match=r"3 sentences without any time left out .* write it as"):
        Shelf().table(path, "HDT")


def test_two_talkers_are_told_apart(tmp_path):
    clock = sentence("GPZDA,120000.00,01,06,2024,00,00")
    path = write(
        tmp_path / "x.nmea", clock, sentence("HEHDT,100.0,T"), sentence("IIHDT,140.0,T"), sentence("HEHDT,101.0,T")
    )
    with pytest.raises(MissionError, match=r'topic "HDT" is HEHDT \(2 records\) and IIHDT \(1 record\)'):
        Shelf().table(path, "HDT")
    assert Shelf().table(path, "IIHDT").raw("headingT").tolist() == [140.0]
    assert Shelf().table(path, "*HDT").raw("headingT").tolist() == [100.0, 140.0, 101.0]


def test_wrong_and_missing_checksums_are_counted(tmp_path):
    clock = sentence("GPZDA,120000.00,01,06,2024,00,00")
    path = write(tmp_path / "x.nmea", clock, sentence("HEHDT,100.0,T"), "$HEHDT,999.0,T*00", "$HEHDT,888.0,T", "noise")
    table = Shelf().table(path, "HDT")
    assert table.raw("headingT").tolist() == [100.0]
    text = " ".join(table.notes)
    for reason in ("1 sentence with a wrong checksum", "1 sentence without a checksum", "1 line without a sentence"):
        assert reason in text


def test_what_the_parser_does_not_know_is_counted(tmp_path, monkeypatch):
    """It says so by None, of sentences that only a fuzzer writes."""
    clock, heading = sentence("GPZDA,120000.00,01,06,2024,00,00"), sentence("HEHDT,100.0,T")
    path = write(tmp_path / "x.nmea", clock, heading, sentence("HEHDT,,T"))
    parse = nmea.NMEAReader.parse
    knows = lambda text, **how: None if b"HDT,," in text else parse(text, **how)  # noqa: E731
    monkeypatch.setattr(nmea.NMEAReader, "parse", knows)
    table = Shelf().table(path, "HDT")
    assert table.raw("headingT").tolist() == [100.0] and "1 HEHDT cannot be read" in " ".join(table.notes)


def test_velocity_logs_of_two_makers(tmp_path):
    """The examples of the makers' manuals."""
    path = write(
        tmp_path / "x.nmea",
        sentence("GPZDA,120000.00,01,06,2024,00,00"),
        sentence("DVPDL,101234000,50000,0.001263,-0.019663,-0.745226,-0.000,0.001,-0.005,100"),
        "$PNORBT7,1452244916.7508,1.234,-1.234,0.1234,0.1234,0.1234,12.34,23.45,23.45,23.45,23.45*39",
        sentence("PNORBT6,TIME=1452244917.7508,DT1=1.234,DT2=-1.234,VX=0.5,VY=-32.768,VZ=0.1,FOM=12.34"),
        sentence("IIXDR,A,-2.1,D,PITCH,A,3.4,D,ROLL"),
    )
    shelf = Shelf()
    deltas = shelf.table(path, "DVPDL")
    np.testing.assert_allclose([deltas.raw(f"velocity_{axis}")[0] for axis in "xyz"], [0.0, 0.02, -0.1], atol=1e-15)
    track = shelf.table(path, "PNORBT7")
    assert (track.raw("vx")[0], track.raw("d4")[0], track.raw("log_time")[0]) == (0.1234, 23.45, 1452244916.7508)
    assert shelf.table(path, "PNORBT6").raw("vy")[0] == -32.768
    assert shelf.table(path, "XDR").raw("PITCH")[0] == -2.1


def test_a_compressed_log_cut_short_gives_what_it_holds(tmp_path):
    lines = [
        sentence("GPZDA,120000.00,01,06,2024,00,00"),
        *(sentence(f"HEHDT,{k % 360}.{k % 10},T") for k in range(5000)),
    ]
    packed = lzma.compress("\n".join(lines).encode())
    (tmp_path / "x.nmea.xz").write_bytes(packed[: len(packed) // 2])
    table = Shelf().table(tmp_path / "x.nmea.xz", "HDT")
    assert 0 < table.raw("headingT").size < 5000
    assert any("cut short" in note for note in table.notes)
