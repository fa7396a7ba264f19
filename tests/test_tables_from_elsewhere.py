"""Tables and NMEA logs as other people's loggers write them: read right, or refused with the cure."""

import datetime
import functools
import operator

import numpy as np
import pytest

import navfilter as nf
from navfilter.check import check_mission
from navfilter.commands.cli import main
from navfilter.io.inertial import read_series
from navfilter.io.logs.draft import draft, survey_of
from navfilter.models.mission import MissionError

NOON = 1682942400.0  # 2023-05-01T12:00:00Z
K = np.arange(120)
DEPTH, HEADING = 5.0 + 0.1 * K, (350.0 + 0.5 * K) % 360.0
LATITUDE, LONGITUDE = 45.5001 + 1e-5 * K, 13.6001 + 2e-5 * K


def utc(form, begin=NOON):
    return [datetime.datetime.fromtimestamp(begin + k, datetime.UTC).strftime(form) for k in K.tolist()]


def text(values, digits=3):
    return [f"{value:.{digits}f}" for value in values]


def table(columns, delimiter=","):
    rows = [delimiter.join(columns), *map(delimiter.join, zip(*columns.values(), strict=True))]
    return "\n".join(rows) + "\n"


def depth_of(folder, content, clock='{column = "t"}'):
    """The stream of depths of a table that a mission.toml maps."""
    (folder / "log.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    (folder / "mission.toml").write_text(f'[streams.depth]\nfile = "log.csv"\ntime = {clock}\ndepth = "depth"\n')
    mission = nf.read_mission(folder)
    return mission, mission.streams["depth"]


def drafted(folder, name, content):
    """The mission that ``mission --init`` makes of a file."""
    (folder / name).write_text(content)
    assert main(["mission", str(folder / name), "--init", "--out", str(folder / "made"), "--quiet"]) == 0
    return nf.read_mission(folder / "made")


# --- layout ---------------------------------------------------------------------------------------------------------


def test_bars_between_fields(tmp_path):
    _, depth = depth_of(tmp_path, table({"t": text(K), "depth": text(DEPTH), "x": text(K)}, "|"))
    np.testing.assert_allclose(depth.value[:, 0], DEPTH)


@pytest.mark.parametrize("rows", [1, 2, 119])
def test_a_quote_within_a_field_is_part_of_it(tmp_path, rows):
    """Inches: an odd number of them made one record of two lines, and an error that is none of the reader's."""
    size = ['4"' if k < rows else "4" for k in range(len(K))]
    for columns in (
        {"t": text(K), "depth": text(DEPTH), "size": size},
        {"t": text(K), "size": size, "depth": text(DEPTH)},
    ):
        _, depth = depth_of(tmp_path, table(columns))
        np.testing.assert_allclose(depth.value[:, 0], DEPTH)


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(table({"t": text(K), "depth": text(DEPTH)}).replace(".", ","), id="decimal commas between commas"),
        pytest.param("t,depth\n" + "".join(f"{k},{k},{5 + k / 10}\n" for k in K), id="row numbers without a name"),
        pytest.param("t depth (m) x\n" + "".join(f"{k} {5 + k / 10} 7\n" for k in K), id="names with blanks"),
    ],
)
def test_names_and_fields_of_another_number_are_refused(tmp_path, content):
    with pytest.raises(MissionError, match=r"header has \d names, the rows have \d fields: .* Write the names: header"):
        depth_of(tmp_path, content)


def test_a_delimiter_at_the_end_of_rows_is_no_field(tmp_path):
    _, depth = depth_of(tmp_path, "t,depth\n" + "".join(f"{k},{5 + k / 10:.1f},\n" for k in K))
    np.testing.assert_allclose(depth.value[:, 0], DEPTH)


# --- times ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("stamps", "cure"),
    [
        (text(1e3 * (NOON + K), 0), "ms"),
        (text(NOON / 86400 + 25569 + K / 86400, 9), "day"),
        (utc("%H%M%S.00"), "iso8601"),
    ],
)
def test_times_that_are_no_seconds_are_refused_and_the_cure_works(tmp_path, stamps, cure):
    content = table({"t": stamps, "depth": text(DEPTH)})
    with pytest.raises(MissionError, match=f'are no seconds.*unit = "{cure}"'):
        depth_of(tmp_path, content)
    _, depth = depth_of(tmp_path, content, f'{{column = "t", unit = "{cure}"}}')
    np.testing.assert_allclose(np.diff(depth.time_s), 1.0, atol=1e-3)


@pytest.mark.parametrize("zero", [25569.0, 40587.0, 719529.0, 2440587.5], ids=["sheet", "MJD", "datenum", "JD"])
def test_days_from_elsewhere(tmp_path, zero):
    days = text(NOON / 86400 + zero + K / 86400, 9)
    mission, _ = depth_of(tmp_path, table({"t": days, "depth": text(DEPTH)}), '{column = "t", unit = "day"}')
    assert mission.begin_utc == "2023-05-01T12:00:00.000Z" and any("count" in note for note in mission.notes)


def test_a_day_to_come_is_said(tmp_path):
    mission, _ = depth_of(tmp_path, table({"t": text(NOON + 1024 * 604800.0 + K), "depth": text(DEPTH)}))
    assert any("2042-12-15" in one.text and one.code == "clock" for one in check_mission(mission))


def test_a_clock_face_goes_on_over_midnight(tmp_path):
    stamps = utc("%H%M%S", NOON + 43140)
    _, depth = depth_of(tmp_path, table({"t": stamps, "depth": text(DEPTH)}), '{column = "t", unit = "iso8601"}')
    np.testing.assert_allclose(np.diff(depth.time_s), 1.0)


def test_date_and_time_in_one_number(tmp_path):
    content = table({"t": utc("%Y%m%d%H%M%S"), "depth": text(DEPTH)})
    mission, _ = depth_of(tmp_path, content, '{column = "t", unit = "iso8601"}')
    assert mission.begin_utc == "2023-05-01T12:00:00.000Z"


@pytest.mark.parametrize("form", ["%Y-%m-%d %H:%M:%S CEST", "%Y-%jT%H:%M:%S", "%a %b %d %H:%M:%S %Y"])
def test_dates_that_nobody_knows_are_shown(tmp_path, form):
    stamps = utc(form)
    with pytest.raises(MissionError, match=f'"{stamps[0]}" is no date and no time of day .* Write it as 2026'):
        depth_of(tmp_path, table({"t": stamps, "depth": text(DEPTH)}), '{column = "t", unit = "iso8601"}')


@pytest.mark.parametrize(("form", "unit"), [("%Y-%m-%dT%H:%M:%SZ", "s"), ("%H%M%S", "s"), ("epoch", "ms")])
def test_a_series_takes_its_times_as_they_are_written(tmp_path, form, unit):
    (tmp_path / "still.csv").write_text(
        table({"t": utc(form) if form != "epoch" else text(1e3 * (NOON + K), 0), "depth": text(DEPTH)})
    )
    series = read_series(tmp_path / "still.csv", "depth", time_column="t", time_unit=unit)
    assert series.rate_hz == pytest.approx(1.0) and series.value.size == K.size


def test_milliseconds_are_no_seconds_of_a_series(tmp_path):
    (tmp_path / "still.csv").write_text(table({"t": text(1e3 * (NOON + K), 0), "depth": text(DEPTH)}))
    with pytest.raises(MissionError, match=r"are no seconds.*--time-unit ms"):
        read_series(tmp_path / "still.csv", "depth", time_column="t")


# --- guesses --------------------------------------------------------------------------------------------------------


PLAIN = {
    "time": utc("%Y-%m-%d %H:%M:%S"), "lat": text(LATITUDE, 7), "lon": text(LONGITUDE, 7),
    "heading": text(HEADING), "depth": text(DEPTH),
}  # fmt: skip


def angle(form):
    def written(values):
        whole, minutes = np.floor(values), 60.0 * (values % 1.0)
        parts = zip(whole.astype(int), minutes, np.floor(minutes).astype(int), 60.0 * (minutes % 1.0), strict=True)
        return [form.format(d=d, m=m, i=i, s=s) for d, m, i, s in parts]

    return written


@pytest.mark.parametrize("form", ["{d} {m:.6f}", "{d}° {m:.6f}'", "{d}°{i:02d}'{s:07.4f}''"])
def test_angles_with_letters_beside_a_heading(tmp_path, form):
    north, east = (angle(form)(values) for values in (LATITUDE, LONGITUDE))
    columns = PLAIN | {"lat": [f"{one} S" for one in north], "lon": [f"{one} W" for one in east]}
    mission = drafted(tmp_path, "log.csv", table(columns))
    gps = np.degrees(mission.streams["gps"].value)
    np.testing.assert_allclose(gps[:, :2], -np.column_stack([LATITUDE, LONGITUDE]), atol=1e-6)


@pytest.mark.parametrize("names", [("NS", "EW"), ("lat_dir", "lon_dir")])
def test_letters_in_a_column_of_their_own(tmp_path, names):
    south = {"time": PLAIN["time"], "lat": PLAIN["lat"], names[0]: ["S"] * K.size, "lon": PLAIN["lon"]}
    mission = drafted(tmp_path, "log.csv", table(south | {names[1]: ["W"] * K.size, "heading": PLAIN["heading"]}))
    gps = np.degrees(mission.streams["gps"].value)
    np.testing.assert_allclose(gps[:, :2], -np.column_stack([LATITUDE, LONGITUDE]), atol=1e-6)


def test_letters_that_a_mapping_leaves_out_are_asked_for(tmp_path):
    columns = {"t": text(K), "lat": PLAIN["lat"], "NS": ["S"] * K.size, "lon": PLAIN["lon"], "EW": ["E"] * K.size}
    (tmp_path / "log.csv").write_text(table(columns))
    mapping = (
        '[streams.gps]\nfile = "log.csv"\ntime = {{column = "t"}}\nposition = {{columns = [{}, "lon"], unit = "deg"}}'
    )
    (tmp_path / "mission.toml").write_text(mapping.format('"lat"'))
    with pytest.raises(MissionError, match=r'reads S: .* Write {column = \["lat", "NS"\]}'):
        nf.read_mission(tmp_path)
    (tmp_path / "mission.toml").write_text(mapping.format('{column = ["lat", "NS"]}'))
    gps = np.degrees(nf.read_mission(tmp_path).streams["gps"].value)
    np.testing.assert_allclose(gps[:, :2], np.column_stack([-LATITUDE, LONGITUDE]), atol=1e-9)


@pytest.mark.parametrize(
    ("name", "factor"), [("heading", 100.0), ("heading [gon]", 1 / 0.9), ("HeadingDeg", 1.0), ("compass_heading", 1.0)]
)
def test_headings_of_any_unit(tmp_path, name, factor):
    columns = {name if key == "heading" else key: value for key, value in PLAIN.items()}
    mission = drafted(tmp_path, "log.csv", table(columns | {name: text(factor * HEADING, 6)}))
    found = np.degrees(mission.streams["attitude"].value[:, 2])
    np.testing.assert_allclose((found - HEADING + 180.0) % 360.0 - 180.0, 0.0, atol=1e-4)


def test_a_heading_whose_unit_cannot_be_told_is_none(tmp_path):
    mission = drafted(tmp_path, "log.csv", table(PLAIN | {"heading": text(10.0 * HEADING, 0)}))
    assert any("attitude" in note and "stands in" in note for note in mission.notes)


def test_units_behind_names(tmp_path):
    columns = {"time_ms": text(1e3 * K, 0), "HeadingDeg": text(HEADING), "depth_mm": text(1e3 * DEPTH, 0)}
    mission = drafted(tmp_path, "log.csv", table(columns))
    np.testing.assert_allclose(mission.streams["depth"].value[:, 0], DEPTH, atol=1e-9)
    np.testing.assert_allclose(np.diff(mission.streams["depth"].time_s), 1.0)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda whole: "Logger 1.2\nSerial, 123\n\n" + whole,
        lambda whole: "# Logger\n# " + whole,
        lambda whole: whole.replace("\n", "\nUTC,deg,deg,deg,m\n", 1),
        lambda whole: whole.replace("\n", "\n[-],[deg],[deg],[deg],[m]\n", 1),
    ],
    ids=["a preamble", "names in a comment", "a row of units", "units in brackets"],
)
def test_where_the_names_stand(tmp_path, spoil):
    streams = drafted(tmp_path, "log.csv", spoil(table(PLAIN))).streams
    gps = np.degrees(streams["gps"].value[:, :2])
    np.testing.assert_allclose(gps, np.column_stack([LATITUDE, LONGITUDE]), atol=1e-6)
    np.testing.assert_allclose(streams["depth"].value[:, 0], DEPTH, atol=1e-4)


def test_a_row_of_units_counts(tmp_path):
    columns = PLAIN | {"depth": text(100.0 * DEPTH, 1), "heading": text(np.radians(HEADING), 6)}
    mission = drafted(tmp_path, "log.csv", table(columns).replace("\n", "\n-,deg,deg,rad,cm\n", 1))
    np.testing.assert_allclose(mission.streams["depth"].value[:, 0], DEPTH, atol=1e-3)
    found = np.degrees(mission.streams["attitude"].value[:, 2])
    np.testing.assert_allclose((found - HEADING + 180.0) % 360.0 - 180.0, 0.0, atol=1e-3)


@pytest.mark.parametrize(("mark", "heading_mark"), [("0", "-1"), ("-999", "-999"), ("999.9", "9999")])
def test_marks_for_no_reading_are_guessed(tmp_path, mark, heading_mark):
    none = K % 4 == 0
    columns = PLAIN | {
        key: np.where(none, mark if key != "heading" else heading_mark, PLAIN[key]).tolist()
        for key in ("lat", "lon", "heading")
    }
    streams = drafted(tmp_path, "log.csv", table(columns)).streams
    for found in (streams["gps"].value[:, 0], streams["attitude"].value[:, 2]):
        np.testing.assert_array_equal(np.isnan(found), none)
    np.testing.assert_allclose(np.degrees(streams["gps"].value[~none, 0]), LATITUDE[~none], atol=1e-6)
    assert f"{float(mark):g} for no fix" in (tmp_path / "made" / "mission.toml").read_text()


def test_all_angles_of_a_table_are_of_one_unit(tmp_path):
    columns = {key: text(np.radians(x), 9) for key, x in (("lat", LATITUDE), ("lon", LONGITUDE), ("yaw", HEADING))}
    gps = drafted(tmp_path, "log.csv", table({"time": PLAIN["time"]} | columns)).streams["gps"].value
    np.testing.assert_allclose(gps[:, :2], np.radians(np.column_stack([LATITUDE, LONGITUDE])), atol=1e-8)


def test_a_table_of_no_known_columns_is_refused(tmp_path):
    (tmp_path / "log.csv").write_text(table({"time": text(K), "p": text(K), "q": text(K)}))
    with pytest.raises(MissionError, match="nothing in this log can drive"):
        draft(survey_of(tmp_path / "log.csv"), tmp_path)


# --- NMEA -----------------------------------------------------------------------------------------------------------


def sentence(body, signed=True):
    return f"${body}*{functools.reduce(operator.xor, body.encode()):02X}" if signed else f"${body}"


def fixes(signed=True, quality=1, prefix="{0}", kind="GGA"):
    """A fix and a heading each second; the first 30 of another quality."""
    pytest.importorskip("pynmeagps")
    rows = []
    for k in K.tolist():
        north, east = (f"{int(x):02d}{60.0 * (x % 1.0):09.6f}" for x in (LATITUDE[k], LONGITUDE[k]))
        level = quality if k < 30 else {"GGA": 1, "GNS": "AN"}[kind]
        gga = f"GP{kind},{utc('%H%M%S')[k]}.00,{north},N,0{east},E,{level},08,1.0,5.0"
        gga += ",M,40.0,M,," if kind == "GGA" else ",40.0,,"
        for body in (gga, f"HEHDT,{HEADING[k]:.2f},T"):
            rows.append(prefix.format(sentence(body, signed), NOON + k))
    return "\r\n".join(rows) + "\r\n"


def test_a_log_without_any_checksum(tmp_path):
    mission = drafted(tmp_path, "log.nmea", fixes(signed=False))
    assert len(mission.streams["gps"]) == K.size
    assert any("without a checksum taken as they are" in note for note in mission.notes)


@pytest.mark.parametrize(("kind", "quality"), [("GGA", 6), ("GGA", 7), ("GGA", 8), ("GNS", "NN"), ("GNS", "EE")])
def test_what_a_receiver_makes_up_is_no_fix(tmp_path, kind, quality):
    mission = drafted(tmp_path, "log.nmea", fixes(quality=quality, kind=kind))
    assert len(mission.streams["gps"]) == K.size - 30


def test_the_date_of_the_logger_where_no_sentence_has_one(tmp_path):
    mission = drafted(tmp_path, "log.nmea", fixes(prefix="\\c:{1:.0f}*00\\{0}"))
    assert mission.begin_utc == "2023-05-01T12:00:00.000Z"
    assert any("that of the logger's stamps" in note for note in mission.notes)
