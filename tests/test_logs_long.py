"""Long tables: time, name and value in each row; the name says which quantity it is."""

import numpy as np
import pytest

import navfilter as nf
from navfilter.io.logs import Shelf
from navfilter.io.table import TableOptions, Where
from navfilter.io.text_tables import read_table
from navfilter.models.mission import MissionError

ALOG = """\
%% LOG FILE:       ./MOOSLog_6_6_2021_____12_00_00.alog
%% LOGSTART        1622980800.5
0.100     NAV_DEPTH             uSim          2.5
0.104     COMPASS_HEADING       iCompass      123.4
0.105     NODE_REPORT_LOCAL     pNodeReporter NAME=alpha,X=12.5,Y=-3,TYPE=AUV
0.204     COMPASS_HEADING       iCompass      124.4
0.205     APP_LOG               pHelm         COMPASS_HEADING looks odd
0.206     COMPASS_HEADING_RAW   iCompass      99.4
0.304     COMPASS_HEADING       iCompass      fault
0.404     COMPASS_HEADING       iCompass      126.4
"""


def test_a_moos_log_by_where_and_by_topic(tmp_path):
    (tmp_path / "dive.alog").write_text(ALOG)
    (tmp_path / "mission.toml").write_text(
        """
[streams.compass]
file = "dive.alog"
where = {column = "name", equals = "COMPASS_HEADING"}
time = {column = "time"}
heading = {column = "value", unit = "deg"}
[streams.depth]
file = "dive.alog"
topic = "NAV_DEPTH"
time = {column = "log_time"}
depth = "value"
"""
    )
    mission = nf.read_mission(tmp_path)
    compass = mission.streams["compass"]
    np.testing.assert_array_equal(compass.time_s, [0.104, 0.204, 0.304, 0.404])
    np.testing.assert_allclose(np.degrees(compass.value[:, 0]), [123.4, 124.4, np.nan, 126.4])
    assert mission.streams["depth"].value[0, 0] == 2.5
    assert any("1 cell without a number" in note for note in mission.notes)


def test_a_value_of_pairs_is_a_field_each(tmp_path):
    (tmp_path / "dive.alog").write_text(ALOG)
    report = Shelf().table(tmp_path / "dive.alog", "NODE_REPORT_LOCAL")
    assert (report.raw("X")[0], report.raw("Y")[0], report.raw("NAME")[0]) == (12.5, -3.0, "alpha")


def test_any_long_table_with_a_header(tmp_path):
    rows = [
        f"{0.1 * k:.1f},{name},{k + 100 * j}" for k in range(200) for j, name in enumerate(("yaw", "pitch", "yaw rate"))
    ]
    (tmp_path / "log.csv").write_text("t,signal,value\n" + "\n".join(rows) + "\n")
    table = read_table(tmp_path / "log.csv", TableOptions(where=(Where(column="signal", equals="yaw"),)))
    np.testing.assert_array_equal(table.numbers("value")[0], np.arange(200.0))
    assert table.notes == ("log.csv: 400 rows left out by where (signal = yaw)",)
    both = Where(column="signal", equals=("yaw", "pitch"))
    assert read_table(tmp_path / "log.csv", TableOptions(where=(both,))).raw("t").size == 400


def test_a_name_that_never_comes(tmp_path):
    (tmp_path / "dive.alog").write_text(ALOG)
    with pytest.raises(MissionError, match="no row has name = GPS"):
        read_table(tmp_path / "dive.alog", TableOptions(where=(Where(column="name", equals="GPS"),)))


def test_conditions_on_numbers_flags_and_blanks(tmp_path):
    (tmp_path / "x.csv").write_text("t,v,ok,quality\n0,1.5,true,4\n1,2.5,false,4\n2,,true,1\n3,3.5,True,9\n")

    def kept(**condition):
        return read_table(tmp_path / "x.csv", TableOptions(where=(Where(**condition),))).raw("t").tolist()

    assert kept(column="ok", equals=True) == [0, 2, 3]
    assert kept(column="v", known=True) == [0, 1, 3]
    assert kept(column="quality", at_least=2) == [0, 1, 3]
    assert kept(column="quality", at_least=2, at_most=5) == [0, 1]
    assert kept(column="quality", equals=1) == [2]
