"""Small files that were read wrongly once, one of each kind: the right value, or what was found and the cure."""

from __future__ import annotations

import json
import math
import re

import numpy as np
import pytest

import navfilter as nf
from navfilter.check import check_mission
from navfilter.commands.cli import main
from navfilter.io.logs.survey import survey
from navfilter.models.magnetic import declination
from navfilter.models.mission import MissionError

DEG = np.pi / 180.0
#: 2023-05-01T12:00:00Z.
NOON = 1682942400.0


@pytest.fixture
def case(data_file):
    """The mission of a case."""
    return lambda name: nf.read_mission(data_file(f"cases/{name}"))


@pytest.fixture
def drafted(data_file, tmp_path):
    """Mission, vehicle and both files as text that ``mission --init`` makes of a file."""

    def draft(name):
        assert main(["mission", str(data_file(f"cases/{name}")), "--init", "--out", str(tmp_path), "--quiet"]) == 0
        texts = [(tmp_path / f"{kind}.toml").read_text(encoding="utf-8") for kind in ("mission", "vehicle")]
        return nf.read_mission(tmp_path), nf.read_vehicle(tmp_path), *texts

    return draft


def replayed(data_file, folder, tmp_path):
    """Exit code and summary of a replay."""
    path = str(data_file(f"cases/{folder}"))
    code = main(["replay", path, "--vehicle", path, "--out", str(tmp_path / "out"), "--no-report", "--quiet"])
    return code, json.loads((tmp_path / "out" / "summary.json").read_text())


# --- tables ---------------------------------------------------------------------------------------------------------


def test_a_delimiter_in_a_quoted_name_is_none(case):
    streams = case("quoted-header").streams
    np.testing.assert_allclose(streams["depth"].value[:, 0], 5.0 + 0.1 * np.arange(40))
    np.testing.assert_allclose(streams["compass"].value[:, 0], (90.0 + np.arange(40)) * DEG)


def test_decimal_commas(case):
    depth = case("locale-nodecimal").streams["depth"]
    np.testing.assert_allclose(depth.value[:, 0], 5.0 + 0.25 * np.arange(40))
    np.testing.assert_allclose(depth.time_s, 0.5 * np.arange(40))


def test_the_sign_of_comments_within_a_cell(case):
    np.testing.assert_allclose(case("hash-in-data").streams["depth"].value[:, 0], 5.0 + np.arange(40))


def test_zero_bytes_at_the_end(case):
    mission = case("nul-tail")
    np.testing.assert_allclose(mission.streams["depth"].value[:, 0], 5.0 + 0.1 * np.arange(40))
    assert any("4096 zero bytes left out" in note for note in mission.notes)


def test_a_row_that_is_cut(case):
    mission = case("cut-row")
    assert mission.duration_s == pytest.approx(299.6) and mission.begin_utc == "2023-05-01T12:00:00.000Z"
    assert any("1 row with fewer fields than columns left out" in note for note in mission.notes)
    assert any(f.code == "reader" and f.severity == "warning" for f in check_mission(mission))


# --- values ---------------------------------------------------------------------------------------------------------


def test_an_sd_of_zero_is_unknown(case, data_file, tmp_path):
    mission = case("sd-half-zero")
    assert np.isnan(mission.streams["gps"].sd[:, 0]).sum() == 30
    assert any("30 readings with an sd of 0 or less" in note for note in mission.notes)
    code, summary = replayed(data_file, "sd-half-zero", tmp_path)
    # it was 3.6 m rms with a NEES of 8e7, for 0 counted as perfect; 300 fixes of 2 m are averaged on the way
    run = summary["runs"]["forward"]
    assert code == 0 and run["position_rms_m"] < 1.0 and 0.5 < run["nees_position"] < 2.0


def test_the_mean_of_two_headings_around_north(case):
    heading = case("heading-mean").streams["compass"].value[:, 0]
    np.testing.assert_allclose(heading, 0.2 * DEG * np.arange(40), atol=1e-12)


def test_two_receivers_at_the_antimeridian(case):
    longitude = case("two-receivers").streams["gps"].value[:, 1]
    np.testing.assert_allclose(np.abs(longitude), np.pi, atol=1e-12)


def test_quaternions_of_both_signs(case):
    attitude = case("quat-average").streams["attitude"]
    yaw = attitude.value[np.argmin(np.abs(attitude.time_s - 4.5)), 2]
    assert yaw == pytest.approx(0.214, abs=1e-3)
    assert (np.abs(np.diff(attitude.value[:, 2])) < 0.1).all()


def test_degrees_and_minutes_with_letters_and_a_date_in_two_columns(data_file, tmp_path):
    (tmp_path / "mission.toml").write_text(
        f"[streams.gps]\nfile = {json.dumps(str(data_file('cases/ddmm/g.csv')))}\n"
        'time = {column = ["Date", "Time"], unit = "iso8601", order = "dmy"}\n'
        'position = {columns = ["lat", "lon"], unit = "ddmm"}\n'
    )
    mission = nf.read_mission(tmp_path)
    gps = mission.streams["gps"]
    expected = np.array([[45 + 30.2012 / 60, 13 + 35.0504 / 60], [45 + 30.2013 / 60, 13 + 35.0504 / 60]])
    np.testing.assert_allclose(np.degrees(gps.value[:, :2]), expected, atol=1e-9)
    assert np.diff(gps.time_s) == pytest.approx(1.0) and mission.begin_utc == "2017-03-11T12:59:59.000Z"
    assert any("12 hours without AM or PM" in note for note in mission.notes)


def test_degrees_and_minutes_are_guessed(drafted):
    mission, _, text, _ = drafted("ddmm/g.csv")
    assert 'unit = ["ddmm", "ddmm"]' in text and "# GUESSED: lat, lon in ddmm" in text
    assert len(mission.streams["gps"]) == 2


# --- times ----------------------------------------------------------------------------------------------------------


def test_dates_have_one_order_a_file(case):
    mission = case("iso-dayfirst-midnight")
    np.testing.assert_allclose(np.diff(mission.streams["depth"].time_s), 1.0)
    assert mission.begin_utc == "2023-05-12T23:59:50.000Z"


def test_minutes_and_seconds_alone_are_refused(case):
    with pytest.raises(MissionError, match=r'log.csv: row 1 of the times reads "59:50.5": .* Export the column with'):
        case("iso-mmss")


def test_a_counter_that_begins_anew_with_two_packets_exchanged(case):
    depth = case("rollover-swapped").streams["depth"]
    np.testing.assert_allclose(np.diff(depth.time_s), 0.01, atol=1e-9)
    assert depth.value[:, 0].tolist() == [0, 1, 2, 3, 5, 4, 6, 7, 8, 9, 10, 11]


def test_a_second_run_behind_the_first_is_refused_or_chosen(data_file, tmp_path, capsys):
    folder = data_file("cases/appended")
    assert main(["check", str(folder)]) == 1
    said = capsys.readouterr().err
    assert "nav.csv" in said and "rows 1001 to 2000 from 0 s to 199.8 s" in said and "run = 1 to 2" in said
    text = (folder / "mission.toml").read_text()
    for run, first in ((1, 0), (2, 1)):
        own = re.sub(r'file = "(.*)"', rf'file = "{folder}/\1"\nrun = {run}', text)
        (tmp_path / "mission.toml").write_text(own)
        mission = nf.read_mission(tmp_path)
        assert {len(stream) for name, stream in mission.streams.items() if name != "gps"} == {1000}
        rows = np.loadtxt(folder / "nav.csv", delimiter=",", skiprows=1, max_rows=1000) if not first else None
        if rows is not None:
            np.testing.assert_allclose(mission.streams["velocity"].value, rows[:, 4:7])


@pytest.mark.parametrize(
    ("name", "found"),
    [("wl-ntp-jump", "rows 1 to 80 from 35 s to 54.75 s, rows 81 to 200 from 2023-05-01T12:00:20Z")],
)
def test_a_clock_that_was_set_is_said(data_file, capsys, name, found):
    assert main(["check", str(data_file(f"cases/{name}"))]) == 1
    said = capsys.readouterr().err
    assert found in said and "run = 1 to 2 beside file" in said


def test_a_receiver_before_its_first_fix_does_not_know_the_time(case):
    mission = case("nmea-coldstart")
    assert mission.begin_utc == "2023-05-01T12:00:10.000Z" and mission.duration_s == 49.0
    assert any("before the receiver's first fix left out" in note for note in mission.notes)


def test_serial_days_of_a_spreadsheet_and_a_date_for_the_declination(case, data_file, tmp_path):
    mission = case("excel-magnetic")
    assert mission.begin_utc == "2023-05-01T12:00:00.000Z" and mission.date.isoformat() == "2023-05-01"
    assert any("days as spreadsheets count them" in note for note in mission.notes)
    magnetic = case("unix-magnetic")
    assert magnetic.date.isoformat() == "2023-05-01"
    # the replay has a day for the declination; the headings of this file count from true north, and the verdict says
    # by how much they are off
    code, summary = replayed(data_file, "unix-magnetic", tmp_path)
    latitude, longitude = np.nanmedian(magnetic.streams["gps"].value[:, :2], axis=0)
    off = math.degrees(declination(math.degrees(latitude), math.degrees(longitude), 0.0, magnetic.date))
    said = " ".join(finding["text"] for finding in summary["verdict"]["findings"])
    assert code == 1 and float(re.search(r"misalignment_z ([-\d.]+) deg", said)[1]) == pytest.approx(off, abs=0.3)


def test_gps_weeks_before_there_is_a_fix(case):
    pytest.importorskip("pymavlink")
    assert case("bin-early").begin_utc == "2023-05-02T11:59:42.000Z"


def test_stamps_of_a_logger(case):
    pytest.importorskip("pynmeagps")
    zone, midnight, epoch = (case(f"prefix-{name}") for name in ("zone", "midnight", "epochms"))
    assert zone.begin_utc == "2023-05-01T10:00:00.250Z"
    np.testing.assert_allclose(np.diff(midnight.streams["compass"].time_s), 0.5)
    np.testing.assert_allclose(epoch.streams["compass"].time_s, NOON + 0.123 + 0.5 * np.arange(40), atol=1e-6)


# --- logs -----------------------------------------------------------------------------------------------------------


def test_several_sentences_in_a_line(case):
    pytest.importorskip("pynmeagps")
    streams = case("nmea-somejoined").streams
    assert {name: len(stream) for name, stream in streams.items()} == {"compass": 60, "gps": 60}
    np.testing.assert_allclose(streams["compass"].value[:, 0], (90.0 + 0.1 * np.arange(60)) * DEG, atol=1e-9)


def test_talkers_that_take_turns(drafted):
    pytest.importorskip("pynmeagps")
    mission, _, text, _ = drafted("mixed-talkers/log.nmea")
    assert 'topic = "*GGA"' in text and len(mission.streams["gps"]) == 240


def test_deviation_and_variation_of_a_compass(drafted):
    pytest.importorskip("pynmeagps")
    mission, _, _, _ = drafted("hdg/log.nmea")
    assert np.degrees(mission.streams["attitude"].value[0, 2]) == pytest.approx(92.0)


def test_transducers_with_empty_and_unusual_fields(data_file):
    pytest.importorskip("pynmeagps")
    (xdr,) = (topic for topic in survey(data_file("cases/xdr.nmea")).topics if topic.name == "IIXDR")
    lines = data_file("cases/xdr.nmea").read_text().splitlines()
    heel = [float(re.search(r"A,([-\d.]*),D,HEEL", line)[1]) for line in lines if "HEEL" in line]
    np.testing.assert_allclose(xdr.columns["HEEL"], heel[-xdr.count :])


def test_a_block_with_an_impossible_date(case):
    mission = case("pd0-navdate")
    assert len(mission.streams["gps"]) == 49
    assert any("1 navigation block with an impossible date left out" in note for note in mission.notes)


def test_an_orientation_that_says_it_is_absent(drafted):
    pytest.importorskip("rosbags")
    mission, vehicle, _, _ = drafted("ros-10hz/dive.mcap")
    assert vehicle.drive.inertial and len(mission.streams["imu"]) == 300
    assert any("300 messages of /imu/data without orientation" in note for note in mission.notes)


def test_beams_are_mapped_with_the_geometry_of_their_file(drafted, tmp_path):
    mission, vehicle, _, text = drafted("beam.pd0")
    dvl = vehicle.sensors["dvl"]
    assert 'type = "dvl-beams"' in text and "magnetic = true" in text
    np.testing.assert_allclose(np.degrees(dvl.beam_azimuth_rad), [270.0, 90.0, 0.0, 180.0])
    assert math.degrees(dvl.beam_tilt_rad) == pytest.approx(20.0)
    assert len(mission.streams["gps"]) == 106 and len(mission.streams["dvl"]) == 30
    folder = str(tmp_path)
    # fixes and beams judge it
    assert main(["replay", folder, "--vehicle", folder, "--out", f"{folder}/out", "--no-report", "--quiet"]) == 0


def test_the_clock_of_an_instrument_is_put_right_by_its_receiver(drafted):
    mission, _, _, text = drafted("local_clock.pd0")
    assert mission.begin_utc.startswith("2017-04-06T20:23:58")
    assert len(mission.streams["gps"]) == 133 and "magnetic = true" in text
    assert any("clock 4 h 26.31 s behind UTC" in note for note in mission.notes)


def test_the_fix_that_a_segment_repeats_is_left_out(data_file):
    (glider,) = survey(data_file("cases/slocum-stale-fix/g_13.dat")).topics
    assert np.isnan(glider.columns["m_gps_lat"]).all() and np.isfinite(glider.columns["m_heading"]).any()


# --- identification -------------------------------------------------------------------------------------------------


def test_missing_samples_are_no_quiet_ones(data_file):
    from navfilter.identification.noise_sheet import noise_sheet
    from navfilter.io.inertial import ImuColumns, read_imu

    columns = ImuColumns(time_column="t", gyro_unit="rad/s", accel_unit="m/s^2")
    sheet = noise_sheet(read_imu(data_file("cases/imu-dropped/s.csv"), columns))
    for axis in sheet.axes[:3]:
        white = np.degrees(axis.sheet.term("white").size) * 60.0
        assert white == pytest.approx(15.4, abs=1.0)  # three of its standard deviations
        assert axis.sheet.term("flicker") is None and math.isnan(axis.quantisation)


def test_a_rate_that_contradicts_the_times(data_file, tmp_path, capsys):
    path = str(data_file("cases/gaps/s.csv"))
    times = ["--column", "x", "--time-column", "t_ms", "--time-unit", "ms", "--json"]
    assert main(["identify", path, "--rate-hz", "10", *times]) == 2
    assert "0.01 s apart (100 Hz), not 0.1 s (10 Hz)" in capsys.readouterr().err
    assert main(["identify", path, *times]) == 0
    assert "first-order Gauss-Markov, tau = 0.10 s" in capsys.readouterr().out


def test_a_heading_around_north_at_rest(data_file, capsys):
    path = str(data_file("cases/headingwrap/s.csv"))
    assert main(["identify", path, "--rate-hz", "10", "--unit", "deg", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert any("passes the end of its circle" in remark for remark in found["remarks"])
    assert found["fit"]["sd"] == pytest.approx(0.3, abs=0.01)  # 3000 samples know it to 1.3 %
