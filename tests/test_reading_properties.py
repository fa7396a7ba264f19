"""What readers do with any angles, quaternions, clocks and dialects of CSV, against slow and obvious references."""

from __future__ import annotations

import csv
import datetime
import io
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

import navfilter as nf
from navfilter.io import dates
from navfilter.io.stamps import continued, runs_of, strays
from navfilter.io.stream_joining import block_mean, circular_mean, mean, resampled
from navfilter.io.tables import read_table
from navfilter.io.units import angles

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
    found = dates.seconds(texts, None, date)
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
    np.testing.assert_allclose(dates.seconds(texts, order, None).time_s, expected)
    try:
        found = dates.seconds(texts, None, None)
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
