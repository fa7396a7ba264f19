"""A mission knows UTC from its stamps, its log or its mission.toml, and hands it on to everything that is written."""

import dataclasses
import datetime

import numpy as np
import pandas as pd
import pytest
from small_run import small_run

import navfilter as nf
from navfilter.foundation import utc
from navfilter.models.mission import MissionError

#: 2023-11-14T22:13:20Z
UNIX = 1.7e9


def mission(folder, head="", clock='{column = "t"}', stamps=(UNIX, UNIX + 1.5)):
    """A mission.toml with a depth gauge, and what it reads."""
    (folder / "log.csv").write_text("t,d\n" + "".join(f"{t},{k}\n" for k, t in enumerate(stamps)))
    (folder / "mission.toml").write_text(f'{head}\n[streams.depth]\nfile = "log.csv"\ntime = {clock}\ndepth = "d"\n')
    return nf.read_mission(folder)


@pytest.mark.parametrize(
    ("head", "clock", "stamps", "epoch"),
    [
        ("", '{column = "t"}', (UNIX, UNIX + 1), 0.0),
        ('zero_s = "first"', '{column = "t"}', (UNIX, UNIX + 1), UNIX),
        ("zero_s = 1699999990.0", '{column = "t"}', (UNIX, UNIX + 1), UNIX - 10.0),
        ('zero_s = "first"', '{column = "t", unit = "us"}', (1e6 * UNIX, 1e6 * UNIX + 1e6), UNIX),
        (
            'zero_s = "first"',
            '{column = "t", unit = "iso8601"}',
            ("2023-11-14T22:13:20Z", "2023-11-14T23:13:21+01:00"),
            UNIX,
        ),
        ("date = 2023-11-14", '{column = "t"}', (UNIX, UNIX + 1), 0.0),
        ("", '{column = "t"}', (0.0, 1.0), None),
        ('zero_s = "first"', '{column = "t"}', (86000.0, 86001.0), None),
        ('epoch = "unknown"', '{column = "t"}', (UNIX, UNIX + 1), None),
        ("epoch = 2023-11-14T22:13:20Z", '{column = "t"}', (0.0, 1.0), UNIX),
        ("epoch = 2023-11-14T23:13:20.25+01:00", '{column = "t"}', (0.0, 1.0), UNIX + 0.25),
        ('epoch = 2023-11-14T00:00:00Z\nzero_s = "first"', '{column = "t"}', (80000.0, 80001.0), UNIX),
        # seconds of GPS: 18 leap seconds since 1980-01-06
        ("epoch = 1980-01-05T23:59:42Z", '{column = "t"}', (UNIX - 315964782, UNIX - 315964781), 315964782.0),
    ],
)  # fmt: skip
def test_what_a_mission_knows_of_utc(tmp_path, head, clock, stamps, epoch):
    read = mission(tmp_path, head, clock, stamps)
    # float64 seconds since 1970 are good to 0.3 us
    assert read.epoch_utc_s == (None if epoch is None else pytest.approx(epoch, abs=1e-6))
    assert read.notes == ()


def test_stamps_that_contradict_the_date_are_no_utc(tmp_path):
    read = mission(tmp_path, "date = 2026-06-01")
    assert read.epoch_utc_s is None
    assert read.notes[0].startswith("the stamps read as seconds since 1970 begin on 2023-11-14, date says 2026-06-01")
    assert mission(tmp_path, "date = 2026-06-01\nepoch = 1970-01-01T00:00:00Z").epoch_utc_s == 0.0


@pytest.mark.parametrize("epoch", ["2023-11-14T22:13:20", "2023-11-14", '"2023-11-14T22:13:20Z"', "1.7e9", "true"])
def test_an_epoch_is_a_date_with_time_and_zone(tmp_path, epoch):
    with pytest.raises(MissionError, match="must be the UTC at which the stamps read zero, such as 2026-06"):
        mission(tmp_path, f"epoch = {epoch}")


def test_one_clock_of_several_that_is_not_utc(tmp_path):
    (tmp_path / "other.csv").write_text("t,h\n0,1\n1,1\n")
    more = '[streams.compass]\nfile = "other.csv"\ntime = {column = "t"}\nheading = "h"\n'
    assert mission(tmp_path, more).epoch_utc_s is None


def test_a_mission_keeps_it(tmp_path):
    read = mission(tmp_path, 'zero_s = "first"')
    assert nf.read_mission(read.save(tmp_path / "dive.npz")).epoch_utc_s == UNIX
    assert read.between(0.5, 2.0).epoch_utc_s == UNIX
    with pytest.raises(ValueError, match="epoch_utc_s must be seconds since 1970"):
        dataclasses.replace(read, epoch_utc_s=float("nan"))


@pytest.mark.parametrize("smooth", [False, True])
def test_a_replay_hands_it_on(smooth):
    recorded, tracks = small_run()
    dated = dataclasses.replace(recorded.between(0.0, 20.0), epoch_utc_s=UNIX)
    track = nf.replay(tracks["forward"].vehicle, dated, smooth=smooth)
    assert track.epoch_utc_s == UNIX and (track.forward is None or track.forward.epoch_utc_s == UNIX)
    assert track.at(np.array([1.0])).time_utc[0] == np.datetime64("2023-11-14T22:13:21")
    stamps = track.to_frame()["time_utc"]
    assert stamps.iloc[0] == pd.Timestamp("2023-11-14T22:13:20Z")
    plain = nf.replay(tracks["forward"].vehicle, dataclasses.replace(dated, epoch_utc_s=None), smooth=smooth)
    assert plain.time_utc is None and "time_utc" not in plain.to_frame()
    # dates are beside the navigation, not in it
    np.testing.assert_array_equal(plain.latitude, track.latitude)


def test_a_draft_says_when_the_boot_clock_of_an_autopilot_began(log_sample, tmp_path):
    """A PX4 log counts from boot; its receiver tells UTC."""
    pytest.importorskip("pyulog", reason='pyulog is not installed: pip install "navfilter[px4]"')
    from navfilter.io.logs.draft import draft
    from navfilter.io.logs.survey import survey

    path = log_sample("px4/sample_log_small.ulg")
    found = survey(path)
    told = next(topic for topic in found.topics if topic.has("time_utc_usec"))
    made = draft(found, tmp_path)
    assert "epoch = 20" in made.mission_toml
    (tmp_path / "mission.toml").write_text(made.mission_toml)
    read = nf.read_mission(tmp_path)
    log_s, told_s = told.time_s[0], 1e-6 * told.columns["time_utc_usec"][0]
    # the first sample of the inertial unit (see test_logs_px4); stamps of the receiver reach the log unevenly late
    assert read.epoch_utc_s + read.streams["imu"].time_s[0] == pytest.approx(told_s - log_s + 20.326716, abs=0.5)


# --- stamps and their text ------------------------------------------------------------------------------------------


def test_nanoseconds_are_whole_and_exact():
    # a day at 1 kHz behind an epoch of a quarter of a second: every stamp to the nanosecond
    time_s = np.arange(0.0, 86400.0, 86.4) + 0.001
    expected = [1_700_000_000_250_000_000 + round(1e9 * t) for t in time_s]
    assert utc.nanoseconds(time_s, UNIX + 0.25).tolist() == expected
    assert utc.nanoseconds(np.array([-0.5]), None).tolist() == [-500_000_000]


def test_text_is_iso_8601():
    [text] = utc.text(np.array([12.3456784]), UNIX)
    parsed = datetime.datetime.fromisoformat(text)
    assert text.endswith("Z") and parsed.timestamp() == pytest.approx(UNIX + 12.345678, abs=1e-6)
    assert utc.date_text(1.0, None) is None


def test_times_that_no_date_has_are_refused():
    with pytest.raises(ValueError, match="are no seconds; check unit and epoch"):
        utc.dates(np.array([1e13]), UNIX)


# --- axes -----------------------------------------------------------------------------------------------------------


def labels(figure):
    return [ax.get_xlabel() for sub in figure.subfigs for ax in sub.axes]


def test_a_plot_has_dates_or_mission_times_and_never_seconds_since_1970():
    _, tracks = small_run()
    track = tracks["smoothed"]
    plain, dated = track.plot(), dataclasses.replace(track, epoch_utc_s=UNIX).plot()
    assert "mission time [s]" in labels(plain) and "UTC" in labels(dated)
    late = dataclasses.replace(track, time_s=track.time_s + UNIX).plot()
    assert "mission time - 1700000000 s [s]" in labels(late)
    assert max(late.subfigs[1].axes[-1].get_xlim()) < 1e3
    with pytest.raises(ValueError, match="no rows: there is nothing to plot"):
        track.keep(slice(0, 0)).plot()


def test_figures_of_the_report_count_from_the_beginning_where_the_clock_counts_from_1970():
    from matplotlib.figure import Figure

    from navfilter.rendering.clock import Clock
    from navfilter.rendering.drawing import time_axis

    clock = Clock(UNIX, UNIX + 100.0)
    ax = Figure().subplots()
    time_axis(ax, clock)
    assert ax.get_xlabel() == "mission time - 1700000000 s [s], UTC"
    np.testing.assert_array_equal(clock(np.array([UNIX + 1.0])), [1.0])
    assert max(ax.get_xlim()) < 200.0
    np.testing.assert_array_equal(Clock(5.0, 100.0)(np.array([7.0])), [7.0])
