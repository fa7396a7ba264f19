"""What readers do with any angles, quaternions, clocks and dialects of CSV, against slow and obvious references."""

from __future__ import annotations

import csv
import datetime
import io
import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

import navfilter as nf
from navfilter.check.streams import stream_findings
from navfilter.io import columns as dates
from navfilter.io.columns import since_1970
from navfilter.io.inertial import _held, _marked, on_a_grid
from navfilter.io.logs.logger_stamps import LoggerClock
from navfilter.io.stamps import continued, runs_of, strays
from navfilter.io.stream_joining import block_mean, circular_mean, mean, resampled
from navfilter.io.text_tables import read_table
from navfilter.io.units import angles
from navfilter.models.mission import MissionError

QUICK = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
ANGLE = st.floats(-20.0, 20.0)
YES = np.ones(1, dtype=bool)


def apart(a, b):
    """Between two angles, the shorter way."""
    return abs((a - b + math.pi) % (2.0 * math.pi) - math.pi)


def direction(values):
    """Of the sum of unit vectors; None where they cancel each other."""
    x, y = sum(math.cos(v) for v in values), sum(math.sin(v) for v in values)
    return math.atan2(y, x) if math.hypot(x, y) > 1e-3 * len(values) else None


# --- angles ---------------------------------------------------------------------------------------------------------


@QUICK
@given(st.lists(ANGLE, min_size=1, max_size=8))
def test_the_mean_of_angles_is_that_of_their_directions(values):
    expected = direction(values)
    assume(expected is not None)
    given_apart = [np.array([[value]]) for value in values]
    block = np.array(values)[:, None]
    for found in (
        circular_mean(np.array(values)),
        mean(given_apart, YES)[0, 0],
        block_mean(block, len(values), YES)[0, 0],
    ):
        assert apart(float(found), expected) < 1e-9


@QUICK
@given(ANGLE, st.floats(-3.0, 3.0), st.integers(-3, 3), st.floats(0.0, 1.0))
def test_between_two_angles_lies_what_is_between_them(first, step, turns, share):
    """However often the second one has gone round; of two that are opposite either way is the shorter."""
    part = np.array([[first], [first + step + 2.0 * math.pi * turns]])
    found = resampled(np.array([share]), np.array([0.0, 1.0]), part, YES, None)[0, 0]
    assert apart(found, first + share * step) < 1e-9


@QUICK
@given(
    st.integers(0, 89), st.integers(0, 59), st.integers(0, 9999), st.sampled_from("NSEW"), st.booleans(), st.booleans()
)
def test_degrees_and_minutes_in_one_number(degrees, minutes, ten_thousandths, letter, in_front, spaced):
    number = f"{degrees:02d}{minutes:02d}.{ten_thousandths:04d}"
    gap = " " * spaced
    text = f"{letter}{gap}{number}" if in_front else f"{number}{gap}{letter}"
    expected = (degrees + (minutes + 1e-4 * ten_thousandths) / 60.0) * (-1.0 if letter in "SW" else 1.0)
    assert angles(np.array([text], dtype=object), "ddmm")[0] == pytest.approx(expected, abs=1e-9)
    sign = -1.0 if letter in "SW" else 1.0
    assert angles(np.array([sign * float(number)]), "ddmm")[0] == pytest.approx(expected, abs=1e-9)


# --- quaternions ----------------------------------------------------------------------------------------------------


def about_z(yaw):
    return np.array([math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)])


@QUICK
@given(st.floats(-math.pi, math.pi), st.lists(st.floats(-0.2, 0.2), min_size=2, max_size=6), st.data())
def test_signs_of_quaternions_change_nothing(yaw, steps, data):
    """Nearby rotations about one axis: their mean and what lies between them is that of their angles."""
    yaws = yaw + np.array(steps)
    signs = data.draw(st.lists(st.sampled_from([1.0, -1.0]), min_size=len(steps), max_size=len(steps)))
    q = np.array([sign * about_z(one) for sign, one in zip(signs, yaws, strict=True)])
    no = np.zeros(4, dtype=bool)

    def yaw_of(one):
        return 2.0 * math.atan2(one[3], one[0])

    for found in (mean([row[None] for row in q], no, True)[0], block_mean(q, len(q), no, True)[0]):
        assert apart(yaw_of(found), direction(yaws)) < 1e-3  # of angles within 0.4 rad the two means are that near
    times = np.arange(len(q), dtype=float)
    between = resampled(times[:-1] + 0.5, times, q, no, None, True)
    for k, one in enumerate(between):
        assert apart(yaw_of(one), 0.5 * (yaws[k] + yaws[k + 1])) < 1e-9


# --- clocks ---------------------------------------------------------------------------------------------------------


@QUICK
@given(st.integers(20, 200), st.integers(0, 10_000), st.integers(300, 5000), st.data())
def test_a_counter_goes_on_although_packets_change_places(count, begin, period, data):
    """Steps of one to three counts; pairs of neighbours are exchanged here and there, also where it begins anew."""
    steps = data.draw(st.lists(st.integers(1, 3), min_size=count, max_size=count))
    true = begin + np.cumsum(steps).astype(float)
    order = np.arange(count)
    for k in data.draw(st.lists(st.integers(1, count - 3), max_size=4)):
        if order[k] == k and order[k + 1] == k + 1:
            order[[k, k + 1]] = order[[k + 1, k]]
    raw = (true % period)[order]
    found = continued(raw, float(period))
    np.testing.assert_allclose(found - found[0], true[order] - true[order][0])


@QUICK
@given(st.integers(0, 86_399), st.integers(1, 4000), st.integers(2, 60), st.booleans())
def test_a_time_of_day_goes_on_over_midnight(begin, step, count, with_date):
    moments = [datetime.datetime(2024, 2, 28) + datetime.timedelta(seconds=begin + k * step) for k in range(count)]
    texts = np.array([f"{moment:%H:%M:%S}" for moment in moments], dtype=object)
    assume(any(moment.hour in (0, *range(13, 24)) for moment in moments))  # else it might be a clock of twelve hours
    date = datetime.date(2024, 2, 28) if with_date else None
    found = dates.date_seconds(texts, None, date)
    zero = datetime.datetime(1970, 1, 1) if with_date else datetime.datetime(2024, 2, 28)
    assert found.of_day
    np.testing.assert_allclose(found.time_s, [(moment - zero).total_seconds() for moment in moments])


ORDERED = {"dmy": "%d/%m/%Y", "mdy": "%m/%d/%Y", "ymd": "%Y/%m/%d"}


@QUICK
@given(
    st.sampled_from(sorted(ORDERED)),
    st.datetimes(datetime.datetime(2001, 1, 1), datetime.datetime(2060, 1, 1)),
    st.integers(1, 40),
)
def test_dates_of_one_order_are_read_in_it_or_refused(order, begin, days):
    moments = [begin.replace(microsecond=0) + datetime.timedelta(days=k) for k in range(days)]
    texts = np.array([moment.strftime(f"{ORDERED[order]} %H:%M:%S") for moment in moments], dtype=object)
    expected = [(moment - datetime.datetime(1970, 1, 1)).total_seconds() for moment in moments]
    np.testing.assert_allclose(dates.date_seconds(texts, order, None).time_s, expected)
    try:
        found = dates.date_seconds(texts, None, None)
    except ValueError as error:
        assert "order = one of" in str(error)
        assert all(moment.day <= 12 for moment in moments) and order != "ymd"
    else:
        np.testing.assert_allclose(found.time_s, expected)


@QUICK
@given(st.integers(30, 120), st.integers(8, 60), st.floats(0.1, 5.0), st.floats(-1e6, 1e9))
def test_a_second_run_is_found_where_it_begins(first, second, step, zero):
    second = min(first, second)
    time_s = zero + step * np.concatenate([np.arange(first), np.arange(second)])
    assert runs_of(time_s).rows == ((0, first - 1), (first, first + second - 1))
    assert not strays(time_s).any()


@QUICK
@given(st.integers(30, 200), st.floats(0.01, 10.0), st.data())
def test_one_stamp_that_no_neighbour_supports(count, step, data):
    """Of another century, or far from its place where there is no room: the others stay."""
    time_s = 1.7e9 + step * np.arange(count)
    row = data.draw(st.integers(0, count - 1))
    for wrong in (168.0, 1.7e9 + step * ((row + count // 2) % count) + 0.1 * step):
        spoiled = time_s.copy()
        spoiled[row] = wrong
        assert np.flatnonzero(strays(spoiled)).tolist() == [row]
    assert not strays(time_s).any() and len(runs_of(time_s).rows) == 1


@QUICK
@given(st.integers(40, 200), st.data())
def test_late_packets_are_no_second_run_and_no_mistake(count, data):
    order = list(range(count))
    packet = order.pop(data.draw(st.integers(5, count - 20)))
    order.insert(packet + data.draw(st.integers(1, 15)), packet)
    time_s = 0.1 * np.array(order, dtype=float)
    assert len(runs_of(time_s).rows) == 1 and not strays(time_s).any()


@QUICK
@given(st.integers(6, 100), st.integers(6, 100), st.floats(0.1, 5.0), st.data())
def test_a_clock_that_is_set_back_begins_a_run_wherever_it_lands(first, second, step, data):
    """Before all that was written, or within it; a part that is late fills a place instead, and is none."""
    zero = 1.7e9
    back = data.draw(st.integers(6, first + second + 50))
    time_s = zero + step * np.concatenate([np.arange(first), first - back + np.arange(second)])
    assume(first - back + second <= first)
    assert runs_of(time_s).rows == ((0, first - 1), (first, first + second - 1))
    late = np.concatenate([np.arange(first), np.arange(first + second, first + 2 * second)])
    whole = zero + step * np.concatenate([late, np.arange(first, first + second)])
    assert len(runs_of(whole).rows) == 1


DAYS = {"spreadsheets": 25569.0, "MATLAB": 719529.0, "modified Julian": 40587.0, "the Julian": 2440587.5, "1970": 0.0}


@QUICK
@given(st.sampled_from(list(DAYS)), st.floats(1.0e9, 2.2e9), st.floats(0.02, 60.0), st.integers(3, 40))
def test_days_are_counted_from_where_they_say(who, begin, step, count):
    time_s = begin + step * np.arange(count)
    found, note = since_1970(time_s / 86400.0 + DAYS[who])
    np.testing.assert_allclose(found * 86400.0, time_s, atol=1e-3)
    assert (who in note) == (who != "1970")


@QUICK
@given(st.integers(0, 86_399), st.sampled_from([0.1, 0.5, 1.0, 2.0, 5.0]), st.integers(70, 200))
def test_hours_minutes_and_seconds_in_one_are_known_where_a_minute_ends(begin, step, count):
    assume(step * count > 61.0)
    time_s = begin + step * np.arange(count)
    of_day = time_s % 86400.0
    faces = 1e4 * (of_day // 3600) + 1e2 * (of_day // 60 % 60) + of_day % 60.0
    assert dates.is_clock_face(np.round(faces, 3))
    assert not dates.is_clock_face(time_s) or (time_s % 100.0 < 60.0).all()


# --- stamps of loggers ----------------------------------------------------------------------------------------------

STAMPS = {
    "iso": ("%Y-%m-%dT%H:%M:%SZ ", 0.0, True),
    "blank": ("%Y-%m-%d %H:%M:%S,", 0.0, True),
    "slashes": ("%Y/%m/%d %H:%M:%S.000 ", 0.0, True),
    "dots": ("%d.%m.%Y %H:%M:%S ", 0.0, True),
    "compact": ("%Y%m%dT%H%M%S ", 0.0, True),
    "digits": ("%Y%m%d%H%M%S ", 0.0, True),
    "tab": ("%Y-%m-%d\t%H:%M:%S\t", 0.0, True),
    "zone": ("[%Y-%m-%d %H:%M:%S +02:00] ", 7200.0, True),
    "zone without colon": ("%Y-%m-%dT%H:%M:%S-0330 ", -12600.0, True),
    "AM and PM": ("%Y-%m-%d %I:%M:%S %p ", 0.0, True),
    "seconds": ("%s.000 ", 0.0, True),
    "milliseconds": ("%s000 ", 0.0, True),
    "microseconds": ("(%s000000) ", 0.0, True),
    "time of day": ("[%H:%M:%S] ", 0.0, False),
    "time of day with AM and PM": ("%I:%M:%S %p ", 0.0, False),
}


@QUICK
@given(st.sampled_from(list(STAMPS)), st.integers(1_000_000_000, 2_000_000_000), st.integers(1, 1700), st.data())
def test_stamps_of_a_logger_go_on(name, begin, step, data):
    """Over midnight too, and where two lines changed places."""
    form, ahead_s, has_date = STAMPS[name]
    order = list(range(60))
    swapped = data.draw(st.integers(1, 58))
    order[swapped], order[swapped + 1] = order[swapped + 1], order[swapped]
    time_s = [begin + step * k for k in order]
    lines = [
        datetime.datetime.fromtimestamp(t + ahead_s, datetime.UTC).strftime(form.replace("%s", str(t))).encode()
        for t in time_s
    ]
    clock = LoggerClock(Counter())
    zero = 0.0 if has_date else 86400.0 * (begin // 86400)
    assert [clock(line) for line in lines] == [t - zero for t in time_s]
    assert clock.of_day != has_date and not clock.zone


def test_a_zone_by_its_name_is_remembered():
    tally = Counter()
    clock = LoggerClock(tally)
    assert clock(b"2023-05-01 14:00:00 CEST ") == 1682949600.0 and clock.zone == "CEST"
    assert clock(b"05/01/2023 14:00:00 ") == 50400.0 and sum(tally.values()) == 1


# --- missing samples and marks --------------------------------------------------------------------------------------


@QUICK
@given(st.integers(200, 600), st.floats(0.0, 0.6), st.floats(0.001, 10.0), st.integers(0, 2**32))
def test_missing_samples_do_not_change_the_rate(count, missing, step, seed):
    keep = np.random.default_rng(seed).random(count) >= missing
    keep[[0, 1, -1]] = True
    time_s = step * np.arange(count)[keep]
    series = on_a_grid("x", time_s, np.flatnonzero(keep).astype(float), None)
    assert series.rate_hz == pytest.approx(1.0 / step)
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(series.value)), np.flatnonzero(keep))
    on_a_grid("x", time_s, time_s, 1.0 / step)
    for other in (0.2, 0.5, 2.0, 3.0):
        with pytest.raises(MissionError, match="Leave the rate out"):
            on_a_grid("x", time_s, time_s, other / step)


@QUICK
@given(st.sampled_from(["held", -999.0, 0.0, 32767.0]), st.floats(0.02, 0.6), st.integers(0, 2**32))
def test_samples_of_an_inertial_unit_that_are_none(kind, share, seed):
    rng = np.random.default_rng(seed)
    value = rng.standard_normal((400, 6)) + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.8])
    bad = rng.random(400) < share
    bad[0] = False
    assume(bad.sum() > 5)
    spoiled = value.copy()
    for k in np.flatnonzero(bad).tolist():
        spoiled[k] = spoiled[k - 1] if kind == "held" else kind
    held, (_, marked) = _held(spoiled), _marked(spoiled)
    np.testing.assert_array_equal(held if kind == "held" else marked, bad)
    coarse = np.round(value)
    assert not _held(coarse).any() and not _marked(coarse)[1].any()


@QUICK
@given(st.sampled_from([-1.0, 0.0, -999.0, 99.99, 32767.0]), st.integers(5, 60), st.integers(0, 2**32))
def test_a_number_that_stands_for_no_reading_is_noticed(mark, count, seed):
    """A depth that swings slowly by 2 m about 10 m, with noise; without the mark nothing is said."""
    rng = np.random.default_rng(seed)
    depth = 10.0 + 2.0 * np.sin(np.arange(300) / 20.0) + 0.05 * rng.standard_normal(300)
    stream = nf.Stream(np.arange(300.0), depth[:, np.newaxis].copy(), ("depth_m",))
    assert not any(f.code == "mark" for f in stream_findings("depth", stream, nf.Mission("m", {"depth": stream})))
    stream.value[rng.permutation(300)[:count], 0] = mark
    (found,) = (f for f in stream_findings("depth", stream, nf.Mission("m", {"depth": stream})) if f.code == "mark")
    assert f"{count} readings of depth_m are exactly {mark:.6g}" in found.text


@QUICK
@given(st.sampled_from([-999.0, 9999.0, 32767.0, 655.35]), st.lists(st.booleans(), min_size=8, max_size=30))
def test_a_heading_far_beyond_a_circle_is_none(tmp_path, mark, none):
    """Once wrapped, nothing tells it from a heading. One that goes on over several turns stays."""
    assume(2 * sum(none) < len(none))
    heading = [(350.0 + 3.0 * k) % 360.0 for k in range(len(none))]
    for cells in ([mark if bad else h for bad, h in zip(none, heading, strict=True)], np.linspace(0, 2000, len(none))):
        (tmp_path / "h.csv").write_text("t,h\n" + "".join(f"{k},{x:.3f}\n" for k, x in enumerate(cells)))
        (tmp_path / "mission.toml").write_text(
            '[streams.compass]\nfile = "h.csv"\ntime = {column = "t"}\nheading = {column = "h", unit = "deg"}\n'
        )
        found = np.degrees(nf.read_mission(tmp_path).streams["compass"].value[:, 0])
        missing = np.array(none) if cells[-1] != 2000.0 else np.zeros(len(none), dtype=bool)
        np.testing.assert_array_equal(np.isnan(found), missing)
        off = (found - np.array(cells) + 180.0) % 360.0 - 180.0
        np.testing.assert_allclose(off[~missing], 0.0, atol=1e-3)


@QUICK
@given(st.lists(st.sampled_from([0.0, -1.0, -999.0, 3.0]), min_size=20, max_size=40), st.sampled_from([1.0, 32767.0]))
def test_what_is_as_long_as_no_rotation_is_none(tmp_path, marks, length):
    """Quaternions with four zeros, -1 or -999 here and there (1 in the list stands for a rotation)."""
    rows = []
    for k, mark in enumerate(marks):
        good = [length * math.cos(0.01 * k), 0.0, 0.0, length * math.sin(0.01 * k)]
        rows.append(good if mark == 3.0 or k % 4 else [mark] * 4)
    lines = [f"{k},{','.join(f'{x:.6f}' for x in row)}" for k, row in enumerate(rows)]
    (tmp_path / "q.csv").write_text("t,w,x,y,z\n" + "\n".join(lines) + "\n")
    (tmp_path / "mission.toml").write_text(
        '[streams.attitude]\nfile = "q.csv"\ntime = {column = "t"}\nquaternion = ["w", "x", "y", "z"]\n'
    )
    yaw = nf.read_mission(tmp_path).streams["attitude"].value[:, 2]
    expected = [math.nan if k % 4 == 0 and mark != 3.0 else 0.02 * k for k, mark in enumerate(marks)]
    np.testing.assert_allclose(yaw, expected, atol=1e-4)


# --- dialects of CSV ------------------------------------------------------------------------------------------------

NAME = st.text(st.sampled_from('abcXYZ (),;"\t#_°'), min_size=1, max_size=8).map(lambda text: f"c{text}c")
CELL = st.one_of(
    st.floats(-1e6, 1e6).map(lambda x: f"{x:.6g}"),
    st.integers(-9999, 9999).map(str),
)


@QUICK
@given(
    names=st.lists(NAME, min_size=2, max_size=5, unique_by=str.strip),
    delimiter=st.sampled_from([",", ";", "\t"]),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    quoting=st.sampled_from([csv.QUOTE_MINIMAL, csv.QUOTE_ALL, csv.QUOTE_NONNUMERIC]),
    last=st.booleans(),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252"]),
    data=st.data(),
)
def test_any_dialect_of_csv_is_read_as_python_writes_it(tmp_path, names, delimiter, end, quoting, last, encoding, data):
    rows = data.draw(st.lists(st.lists(CELL, min_size=len(names), max_size=len(names)), min_size=2, max_size=6))
    out = io.StringIO()
    writer = csv.writer(out, delimiter=delimiter, lineterminator=end, quoting=quoting)
    writer.writerows([names, *([float(cell) for cell in row] for row in rows)])
    text = out.getvalue()
    (tmp_path / "x.csv").write_bytes((text if last else text[: -len(end)]).encode(encoding))
    table = read_table(tmp_path / "x.csv")
    assert list(table.columns) == [name.strip() for name in names]
    for k, name in enumerate(table.columns):
        np.testing.assert_allclose(table.numbers(name)[0], [float(row[k]) for row in rows])


@QUICK
@given(
    st.lists(st.tuples(st.integers(-9999, 9999), st.integers(0, 99), st.integers(0, 99)), min_size=3, max_size=20),
    st.sampled_from([";", "\t"]),
    st.booleans(),
)
def test_decimal_commas_are_recognised(tmp_path, numbers, delimiter, thousands):
    def shown(whole, hundredths):
        body = f"{abs(whole):,}".replace(",", ".") if thousands else str(abs(whole))
        return f"{'-' if whole < 0 else ''}{body},{hundredths:02d}"

    lines = [delimiter.join((str(k), shown(w, a), shown(w, b))) for k, (w, a, b) in enumerate(numbers)]
    (tmp_path / "x.csv").write_text("\n".join([delimiter.join("tab"), *lines]))
    table = read_table(tmp_path / "x.csv")
    for name, at in (("a", 1), ("b", 2)):
        expected = [math.copysign(abs(n[0]) + n[at] / 100.0, n[0] if n[0] else 1) for n in numbers]
        np.testing.assert_allclose(table.numbers(name)[0], expected)


@QUICK
@given(st.lists(st.floats(-5.0, 5.0), min_size=3, max_size=30))
def test_an_sd_that_is_not_above_zero_is_unknown(tmp_path, sd):
    rows = "\n".join(f"{k},1.0,{value!r}" for k, value in enumerate(sd))
    Path(tmp_path / "d.csv").write_text(f"t,d,s\n{rows}\n")
    (tmp_path / "mission.toml").write_text(
        '[streams.depth]\nfile = "d.csv"\ntime = {column = "t"}\ndepth = "d"\nsd = "s"\n'
    )
    found = nf.read_mission(tmp_path).streams["depth"].sd[:, 0]
    np.testing.assert_array_equal(found, [value if value > 0.0 else np.nan for value in sd])
