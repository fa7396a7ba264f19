"""Slocum gliders: five dives in nine files, most cells of which are NaN."""

import numpy as np
import pytest

import navfilter as nf
from navfilter.io.logs import Shelf, format_of
from navfilter.models.mission import MissionError

GLIDER = "../glider-slocum-ru28/ru28_2017_113_3_0_dbd.dat.xz"


def test_a_dive_by_its_sensors(log_sample, tmp_path):
    path = log_sample(GLIDER)
    assert format_of(path).module == "slocum"
    stream = f'file = "{path}"\ntopic = "glider"\ntime = {{column = "log_time"}}\n'
    (tmp_path / "mission.toml").write_text(
        f'[streams.compass]\n{stream}heading = "m_heading"\nwhere = {{column = "m_heading", known = true}}\n'
        f'[streams.depth]\n{stream}depth = "m_depth"\nwhere = {{column = "m_depth", known = true}}\n'
        f'[streams.gps]\n{stream}position = ["m_gps_lat", "m_gps_lon"]\n'
        'where = {column = "m_gps_lat", known = true}\n'
    )
    mission = nf.read_mission(tmp_path)
    compass, depth, gps = (mission.streams[name] for name in ("compass", "depth", "gps"))
    assert not np.isnan(compass.value).any() and not np.isnan(depth.value).any()
    # A reading about every 4.7 s, dives to 20 m, a fix before and after, off New Jersey.
    assert np.median(np.diff(compass.time_s)) == pytest.approx(4.7, abs=0.5)
    assert 15.0 < depth.value.max() < 25.0
    assert compass.value[0, 0] == pytest.approx(6.11912 - 2 * np.pi, abs=1e-6)
    # the file begins with the fix of the segment before, 40 19.4424 N: it is no new one
    known = gps.value[np.isfinite(gps.value[:, 0])]
    np.testing.assert_allclose(np.degrees(known[0, :2]), [40 + 19.3951 / 60, -(73 + 53.6777 / 60)], atol=1e-9)
    assert mission.duration_s == pytest.approx(4030, abs=10)
    assert any("rows left out by where (m_heading known)" in note for note in mission.notes)


def test_files_by_a_pattern_follow_one_another(log_sample):
    path = log_sample(GLIDER)
    shelf = Shelf({path.parent / "ru28*_3_[01]_dbd.dat.xz": {"glider": {"m_depth"}}})
    assert shelf.table(path.parent / "ru28*_3_[01]_dbd.dat.xz", "glider").raw("m_depth").size == sum(
        Shelf({one: {"glider": {"m_depth"}}}).table(one, "glider").raw("m_depth").size
        for one in (path, path.with_name("ru28_2017_113_3_1_dbd.dat.xz"))
    )
    with pytest.raises(MissionError, match="no file fits this pattern"):
        shelf.table(path.parent / "nothing*.dat", "glider")


HEAD = "dbd_label: x\nencoding_ver: 2\nnum_ascii_tags: 4\nnum_label_lines: 3\n"


def test_never_is_no_position_and_short_rows_are_counted(tmp_path):
    rows = "1000.0 69696969 -7353.5988\n1001.0 -0030.5 NaN\n1002.0 1.0\n"
    (tmp_path / "x.dat").write_text(f"{HEAD}m_present_time m_gps_lat m_gps_lon\ntimestamp lat lon\n8 8 8\n{rows}")
    table = Shelf().table(tmp_path / "x.dat", "glider")
    np.testing.assert_allclose(table.raw("m_gps_lat"), [np.nan, -0.5083333333333333])
    assert any("1 row cut short" in note for note in table.notes)


def test_a_table_without_a_clock(tmp_path):
    (tmp_path / "x.dat").write_text(f"{HEAD}m_depth\nm\n4\n1.0\n")
    with pytest.raises(MissionError, match="needs a column m_present_time"):
        Shelf().table(tmp_path / "x.dat", "glider")
