"""Missions in memory, their native file, and mission.toml: every way of mapping columns, every mistake named."""

from __future__ import annotations

import datetime
import gzip
import lzma
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

from navfilter.io import geodesy, read_mission
from navfilter.io.table import Table, TableOptions
from navfilter.io.text_tables import read_table
from navfilter.io.trust import expand
from navfilter.models.mission import TRUTH_COLUMNS, Mission, MissionError, Stream
from navfilter.models.start import Start


def write(folder: Path, toml: str, **files: str) -> Path:
    for name, text in files.items():
        (folder / name.replace("__", ".")).write_text(text)
    (folder / "mission.toml").write_text(toml)
    return folder


# --- Stream and Mission ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("time_s", "value", "message"),
    [
        ([0.0, 2.0, 1.0], [1.0, 2.0, 3.0], "goes back from 2 to 1 s at row 2"),
        ([0.0, np.nan], [1.0, 2.0], "1 times are not finite"),
        ([0.0, 1.0], [1.0, np.inf], "1 values are infinite"),
        ([0.0, 1.0], [[1.0], [2.0], [3.0]], "one row per time"),
        ([[0.0]], [1.0], "one-dimensional"),
    ],
)
def test_stream_refuses(time_s, value, message):
    with pytest.raises(ValueError, match=message):
        Stream(np.array(time_s), np.array(value), ("a",))


def example() -> Mission:
    time_s = np.arange(5.0)
    truth = Stream(time_s, np.full((5, 9), np.nan), TRUTH_COLUMNS)
    start = Start(time_s=1.0, latitude_deg=45.0, longitude_deg=7.0, position_sd_m=(1.0, 2.0, 3.0))
    streams = {
        "depth": Stream(time_s, np.array([1.0, np.nan, 3.0, 4.0, 5.0]), ("depth_m",)),
        "dvl": Stream(time_s + 0.5, np.arange(15.0).reshape(5, 3), ("v_x_m_s", "v_y_m_s", "v_z_m_s")),
    }
    return Mission("dive", streams, truth, start, datetime.date(2024, 5, 6), ("a note",), ((0.0, 2.0),))


def test_native_round_trip_is_exact(tmp_path):
    mission = example()
    back = read_mission(mission.save(tmp_path / "dive.npz"))
    assert (back.name, back.date, back.notes, back.windows) == (
        mission.name,
        mission.date,
        mission.notes,
        mission.windows,
    )
    assert back.start == mission.start
    assert list(back.streams) == list(mission.streams)
    for name, stream in mission.streams.items():
        np.testing.assert_array_equal(back.streams[name].time_s, stream.time_s)
        np.testing.assert_array_equal(back.streams[name].value, stream.value)
        assert back.streams[name].columns == stream.columns
    assert back.truth is not None and back.truth.columns == TRUTH_COLUMNS
    assert not list(tmp_path.glob("*.part"))


def test_native_refuses_other_files(tmp_path):
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(MissionError, match=r"was not written by Mission.save \(arrays: a\)"):
        read_mission(tmp_path / "other.npz")
    whole = example().save(tmp_path / "dive.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(MissionError, match=r"truncated or no \.npz"):
        read_mission(tmp_path / "cut.npz")
    with pytest.raises(ValueError, match=r"saved as \.npz"):
        example().save(tmp_path / "dive.csv")


def test_cutting_and_hiding():
    mission = example()
    part = mission.between(1.0, 3.0)
    assert part.streams["depth"].time_s.tolist() == [1.0, 2.0, 3.0]
    assert part.streams["dvl"].time_s.tolist() == [1.5, 2.5]
    assert part.start == mission.start
    assert mission.between(2.0, 3.0).start is None
    hidden = mission.hide("dvl", (0.0, 1.0), (3.0, np.inf))
    assert hidden.streams["dvl"].time_s.tolist() == [1.5, 2.5]
    assert hidden.duration_s == 4.0
    with pytest.raises(ValueError, match=r'"gps" has no stream in mission "dive" \(streams: depth, dvl\)'):
        mission.hide("gps", (0.0, 1.0))
    assert Mission("empty").duration_s == 0.0


# --- tables ---------------------------------------------------------------------------------------------------------


def test_text_tables_are_recognised(tmp_path):
    files = {
        "comma.csv": "t,x\n0,1.5\n1,2.5\n",
        "excel.csv": "sep=;\nt;x\n0;1,5\n1;2,5\n",
        "trailing.csv": "t, x,\n0, 1.5, \n1, 2.5, \n",
        "blank.dat": "0 1.5\n1  2.5\n",
        "comment.txt": "# by hand\nt,x # names\n0,1.5\n\n1,2.5 # last\n",
    }
    options = {"excel.csv": TableOptions(decimal=","), "blank.dat": TableOptions(header=("t", "x"))}
    for name, text in files.items():
        (tmp_path / name).write_text(text)
        table = read_table(tmp_path / name, options.get(name))
        assert list(table.columns) == ["t", "x"], name
        assert table.numbers("x")[0].tolist() == [1.5, 2.5], name


def test_compressed_and_binary_tables(tmp_path):
    text = b"t,x\n0,1.5\n1,2.5\n"
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress(text))
    (tmp_path / "a.csv.xz").write_bytes(lzma.compress(text))
    values = np.array([[0.0, 1.5], [1.0, 2.5]])
    np.save(tmp_path / "a.npy", values)
    np.savez(tmp_path / "a.npz", counts=values, rate=10.0)
    np.savez(tmp_path / "b.npz", t=values[:, 0], x=values[:, 1])
    scipy.io.savemat(tmp_path / "a.mat", {"data": {"imu": values.T}})
    with h5py.File(tmp_path / "new.mat", "w", userblock_size=512) as file:
        # MATLAB stores by columns: a 2 x 2 matrix arrives transposed in HDF5.
        file["buffer"] = values.T
    np.save(tmp_path / "cube.npy", values[np.newaxis])
    cases = {
        "a.csv.gz": ("x", TableOptions()),
        "a.csv.xz": ("x", TableOptions()),
        "a.npy": (1, TableOptions()),
        "a.npz": (1, TableOptions(table="counts")),
        "b.npz": ("x", TableOptions()),
        "a.mat": (1, TableOptions(table="data.imu", transpose=True)),
        "new.mat": (1, TableOptions()),
        "cube.npy": (1, TableOptions(table="[0]")),
    }
    for name, (column, options) in cases.items():
        assert read_table(tmp_path / name, options).numbers(column)[0].tolist() == [1.5, 2.5], name


def test_an_integer_beyond_all_floats_is_infinite():
    table = Table("a.csv", {"x": np.array([1, 10**400, -(10**400), "oops"], dtype=object)})
    values, unreadable = table.numbers("x")
    assert unreadable == 1
    np.testing.assert_array_equal(values, [1.0, np.inf, -np.inf, np.nan])
    texts = Table("a.csv", {"x": np.array(["1", "1" + "0" * 400, "-1" + "0" * 400, "oops", None], dtype=object)})
    values, unreadable = texts.numbers("x")
    assert unreadable == 1
    np.testing.assert_array_equal(values, [1.0, np.inf, -np.inf, np.nan, np.nan])


def test_rows_that_cannot_be_read_are_counted(tmp_path):
    (tmp_path / "a.csv").write_text("t,x\n0,1\n1,oops\n2,3,4,5\n3,\n4,5\n")
    table = read_table(tmp_path / "a.csv")
    values, unreadable = table.numbers("x")
    assert unreadable == 1
    np.testing.assert_array_equal(values, [1.0, np.nan, np.nan, 5.0])
    assert table.notes == ("a.csv: 1 row with too many fields skipped",)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", " \n", "\n\n", "\n ", "\x0b", " # remark\n", "\u2028"])
@pytest.mark.parametrize("last", [True, False])
def test_how_lines_end_does_not_matter(tmp_path, end, last):
    lines = ["t,x,name", "0,1,one", "1,2,3,4", "4,5,two"]
    (tmp_path / "a.csv").write_bytes((end.join(lines) + end * last).encode())
    table = read_table(tmp_path / "a.csv")
    assert {key: cells.tolist() for key, cells in table.columns.items()} == {
        "t": [0, 4],
        "x": [1, 5],
        "name": ["one", "two"],
    }
    assert table.notes == ("a.csv: 1 row with too many fields skipped",)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", b"", "is empty"),
        ("a.csv", b"t,x\n", "no rows of data"),
        ("a.csv", b"\x00\x01\x02\x03" * 50, "not a text file"),
        ("a.csv.gz", b"not gzip", "cannot be unpacked"),
        ("a.csv.xz", lzma.compress(b"t,x\n" + b"1,2\n" * 9999)[:60], "truncated"),
        ("a.npy", b"\x93NUMPY\x01\x00", "truncated"),
        ("a.npz", b"PK\x03\x04garbage", "truncated"),
        ("a.mat", b"MATLAB 5.0 MAT-file" + bytes(200), "truncated|no array"),
    ],
)
def test_broken_files_are_one_line(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(MissionError, match=message) as caught:
        read_table(tmp_path / name)
    assert "\n" not in str(caught.value)


# --- mission.toml ---------------------------------------------------------------------------------------------------


def test_units_axes_sentinels_and_clock(tmp_path):
    folder = write(
        tmp_path,
        """
        [streams.imu]
        file = "log.csv"
        time = {column = "t", unit = "ms", offset_s = 10.0}
        rate = {columns = ["gx", "gy", "gz"], unit = "deg/s", axes = "x,-y,-z"}
        force = {columns = ["ax", "ay", "az"], unit = "g", axes = "x,-y,-z"}
        [streams.dvl]
        file = "log.csv"
        time = {rate_hz = 2.0, start_s = 1.0}
        velocity = {columns = ["vx", {column = "vy", scale = 2.0}, {constant = 0.0}], unit = "cm/s", invalid = [-3276.8]}
        [streams.compass]
        file = "log.csv"
        time = {column = "t", unit = "ms"}
        heading = {column = "yaw", unit = "deg", scale = -1.0, offset = "90 deg"}
        """,
        log__csv="t,gx,gy,gz,ax,ay,az,vx,vy,yaw\n0,180,0,90,0,0,1,100,10,90\n500,0,180,0,0,1,1,-3276.8,0,-200\n1000,0,0,0,1,0,1,0,-5,450\n",
    )
    mission = read_mission(folder)
    imu, dvl = mission.streams["imu"], mission.streams["dvl"]
    assert imu.time_s.tolist() == [10.0, 10.5, 11.0]
    np.testing.assert_allclose(imu.value[0], [np.pi, 0, -np.pi / 2, 0, 0, -9.80665], atol=1e-12)
    assert dvl.time_s.tolist() == [1.0, 1.5, 2.0]
    np.testing.assert_allclose(dvl.value, [[1.0, 0.2, 0.0], [np.nan] * 3, [0.0, -0.1, 0.0]], atol=1e-15)
    # 90 - (-200) = 290 deg, wrapped to -70; 90 - 450 = -360, wrapped to 0.
    np.testing.assert_allclose(np.degrees(mission.streams["compass"].value[:, 0]), [0.0, -70.0, 0.0], atol=1e-9)
    assert any("1 row marked invalid" in note for note in mission.notes)


def test_two_wheels_become_one_odometer(tmp_path):
    folder = write(
        tmp_path,
        """
        [streams.odometer]
        average = 2
        [[streams.odometer.sources]]
        file = "left.csv"
        time = {column = "us", unit = "us", from_first = true}
        velocity = {columns = [{column = "g", unit = "deg/s", absolute = true, radius_m = 0.5}, {constant = 0.0}, {constant = 0.0}]}
        [[streams.odometer.sources]]
        file = "right.csv"
        time = {column = "us", unit = "us", from_first = true, offset_s = -1.0}
        velocity = {columns = [{column = "g", unit = "deg/s", absolute = true, radius_m = 0.5}, {constant = 0.0}, {constant = 0.0}]}
        """,
        left__csv="us,g\n5000000,360\n6000000,360\n7000000,360\n8000000,360\n",
        right__csv="us,g\n0,-360\n1000000,-360\n2000000,-720\n3000000,-720\n",
    )
    odometer = read_mission(folder).streams["odometer"]
    # The right wheel ends at 2 s: from there on the left one alone is the mean.
    assert odometer.time_s.tolist() == [0.5, 2.5]
    np.testing.assert_allclose(odometer.value[:, 0], [np.pi * 1.25, np.pi * 1.25], rtol=1e-12)


def test_new_fix_is_a_change_and_first_row_is_none(tmp_path):
    folder = write(
        tmp_path,
        """
        [streams.gps]
        file = "log.csv"
        time = {rate_hz = 1.0}
        only_changes = true
        position = {columns = ["lat", "lon"], unit = "deg"}
        """,
        log__csv="lat,lon\n10,20\n10,20\n10.1,20\n10.1,20\n10.1,20.1\n",
    )
    gps = read_mission(folder).streams["gps"]
    assert gps.time_s.tolist() == [2.0, 4.0]
    assert gps.columns == ("latitude_rad", "longitude_rad", "height_m")
    assert np.isnan(gps.value[:, 2]).all()


def test_disorder_in_time_is_sorted_and_counted(tmp_path):
    toml = """
        [streams.depth]
        file = "log.csv"
        time = {column = "t"}
        depth = "d"
        [streams.velocity]
        file = "log.csv"
        time = {column = "t"}
        velocity = {columns = ["d", {constant = 0.0}, {constant = 0.0}]}
        """
    mission = read_mission(write(tmp_path, toml, log__csv="t,d\n0,1\n2,3\n1,2\n1,2.5\nbad,9\n3,nan\n"))
    assert mission.streams["depth"].time_s.tolist() == [0.0, 1.0, 1.0, 2.0, 3.0]
    np.testing.assert_array_equal(mission.streams["depth"].value[:, 0], [1.0, 2.0, 2.5, 3.0, np.nan])
    # What drives cannot step by nothing: its repeated stamp is dropped.
    assert mission.streams["velocity"].time_s.tolist() == [0.0, 1.0, 2.0, 3.0]
    notes = " | ".join(mission.notes)
    for words in (
        "depth (log.csv): 1 row without a readable time dropped",
        "back in time, by up to 1 s",
        "1 row with the time",
    ):
        assert words in notes
    assert "velocity (log.csv): 1 row with the time of the row before dropped" in notes


def test_bursty_stamps_rollover_and_iso_times(tmp_path):
    toml = """
        zero_s = "first"
        [streams.a]
        file = "log.csv"
        time = {column = "received", ends_only = true}
        depth = "d"
        [streams.b]
        file = "log.csv"
        time = {column = "counter", rollover = 256, scale = 0.1, offset_s = 100.0}
        depth = "d"
        [streams.c]
        file = "log.csv"
        time = {column = "utc", unit = "iso8601", offset_s = -1700000000.0}
        depth = "d"
        """
    log = "received,counter,utc,d\n100,250,2023-11-14T22:15:00Z,1\n100.1,5,2023-11-14T22:15:01Z,2\n104,20,2023-11-14T22:15:02Z,3\n"
    mission = read_mission(write(tmp_path, toml, log__csv=log))
    assert mission.streams["a"].time_s.tolist() == [0.0, 2.0, 4.0]
    np.testing.assert_allclose(mission.streams["b"].time_s, [25.0, 26.1, 27.6], atol=1e-9)
    np.testing.assert_allclose(mission.streams["c"].time_s, [0.0, 1.0, 2.0], atol=1e-6)


def test_truth_in_ecef_and_start_from_it(tmp_path):
    # A point at 45 N 10 E, moving north at 2 m/s, heading 30 deg, level: everything as an earth-fixed file gives it.
    position = np.array([[np.radians(45.0), np.radians(10.0), 100.0]])
    axes = geodesy.ned_axes(position[:, 0], position[:, 1])[0]
    ecef = geodesy.ecef_from_geodetic(position)[0]
    v_ecef = np.array([2.0, 0.0, 0.0]) @ axes
    C = axes.T @ geodesy.matrix_from_euler(np.zeros(1), np.zeros(1), np.radians([30.0]))[0]
    w = np.sqrt(1.0 + np.trace(C)) / 2.0
    q = [w, *(np.array([C[2, 1] - C[1, 2], C[0, 2] - C[2, 0], C[1, 0] - C[0, 1]]) / (4.0 * w))]
    np.save(tmp_path / "truth.npy", np.array([[0.0, *ecef, *v_ecef, *q], [1.0, *ecef, *v_ecef, *q]]))
    folder = write(
        tmp_path,
        """
        date = 2020-01-02
        [start]
        from = "truth"
        position_sd_m = 2.0
        [truth]
        file = "truth.npy"
        time = {column = 0}
        ecef = [1, 2, 3]
        velocity_ecef = [4, 5, 6]
        quaternion = {columns = [7, 8, 9, 10], reference = "ecef"}
        """,
    )
    mission = read_mission(folder)
    assert mission.truth is not None
    expected = [np.radians(45.0), np.radians(10.0), 100.0, 2.0, 0.0, 0.0, 0.0, 0.0, np.radians(30.0)]
    np.testing.assert_allclose(mission.truth.value[0], expected, atol=1e-8)
    start = mission.start
    assert (start.position_sd_m, start.date) == (2.0, datetime.date(2020, 1, 2))
    assert start.heading_deg == pytest.approx(30.0)


def test_truth_lever_arm_moves_with_the_heading(tmp_path):
    folder = write(
        tmp_path,
        """
        [truth]
        file = "t.csv"
        time = {column = "t"}
        lever_arm_b_m = [2.0, 0.0, 0.0]
        local = {columns = ["x", "y", {constant = 0.0}], axes = "y,x,-z", origin = {latitude_deg = 50.0, longitude_deg = 8.0}}
        attitude = {columns = [{constant = 0.0}, {constant = 0.0}, "h"], unit = "deg"}
        """,
        t__csv="t,x,y,h\n0,0,0,90\n1,10,0,90\n2,10,5,0\n",
    )
    truth = read_mission(folder).truth
    assert truth is not None
    place = geodesy.ecef_from_geodetic(truth.value[:, :3])
    moved = (place - place[0]) @ geodesy.ned_axes(truth.value[:1, 0], truth.value[:1, 1])[0].T
    # The truth point is 2 m ahead: the vehicle's own is 2 m west of it while it heads east, 2 m south when north.
    np.testing.assert_allclose(moved[:, :2], [[0.0, 0.0], [0.0, 10.0], [3.0, 12.0]], atol=1e-4)


def test_environment_in_paths(monkeypatch, tmp_path):
    monkeypatch.setenv("DIVES", "/data/dives")
    assert expand("${DIVES}/a.csv", tmp_path) == Path("/data/dives/a.csv")
    assert expand("a.csv", tmp_path) == tmp_path / "a.csv"
    monkeypatch.delenv("DIVES")
    with pytest.raises(MissionError, match="environment variable DIVES is not set"):
        expand("$DIVES/a.csv", tmp_path)
    with pytest.raises(MissionError, match="no name of a file"):
        expand("a\0.csv", tmp_path)


@pytest.mark.parametrize(
    ("toml", "messages"),
    [
        ("[streams.x\n", ["not valid TOML"]),
        ("", ["there is no stream"]),
        ('[streams.d]\nfile = "a.csv"\ntime = {rate_hz = 1}\ndepht = "d"\n', ['did you mean "depth"', "streams.d"]),
        ('[streams.d]\nfile = "a.csv"\ndepth = "d"\n', ["time", "this key is missing"]),
        (
            '[streams.d]\nfile = "a.csv"\ntime = {rate_hz = 1, column = 0}\ndepth = "d"\n',
            ["either the column of times or"],
        ),
        (
            '[streams.d]\nfile = "a.csv"\ntime = {rate_hz = 1}\ndepth = {column = "d", unit = "deg"}\n',
            ["no unit of length"],
        ),
        (
            '[streams.d]\nfile = "a.csv"\ntime = {rate_hz = 1}\ndepth = {column = "d", unit = "furlong"}\n',
            ["unknown unit"],
        ),
        ('[streams.d]\nfile = "a.csv"\ntime = {rate_hz = 1}\nvelocity = ["a", "b"]\n', ["2 columns, it needs 3"]),
        (
            '[streams.d]\nfile = "a.csv"\ntime = {rate_hz = -1}\ndepth = {column = "d", axes = '
            '"x,y"}\n[start]\nheading = 3\n',
            [
                "3 mistakes",
                "streams.d.time.rate_hz: must be > 0; found -1",
                "names each of x, y, z once",
                'did you mean "heading_deg"',
            ],
        ),
        (
            '[streams.d]\nfile = "a.csv"\ntime = {column = "d"}\ndepth = "nope"\n',
            ['no column "nope" (columns: "t", "d")'],
        ),
        ('[streams.d]\nfile = "a.csv"\ntime = {column = "t"}\ndepth = 7\n', ["no column 7, the file has 2"]),
        ('[streams.d]\nfile = "b.csv"\ntime = {column = "t"}\ndepth = "d"\n', ["no such file"]),
        ('[streams.d]\nfile = "a.csv"\ntime = {column = "w"}\ndepth = "d"\n', ["no row is left"]),
        ('start = "truth"\n[streams.d]\nfile = "a.csv"\ntime = {column = "t"}\ndepth = "d"\n', ["there is no [truth]"]),
        (
            '[streams.d]\nfile = "a.csv"\ntime = {column = "t"}\ndepth = "d"\n[start]\ntime_s = 1\n',
            ["start lacks latitude_deg"],
        ),
        (
            '[streams.d]\nfile = "a.csv"\ntime = {column = "t"}\ndepth = {column = "d", mounting_deg = [1e300, 0, 0]}\n'
            "[start]\nposition_sd_m = [1, -1, 1]\nheight_m = 1e20\n",
            [
                "3 mistakes",
                "start.position_sd_m[1]: must be >= 0; found -1",
                "start.height_m: must be <= 1e+12",
                "streams.d.depth.mounting_deg[0]",
            ],
        ),
        (
            '[streams.d]\nfile = "a.csv"\ntime = {column = "t"}\ndepth = "d"\n[start]\n'
            "time_s = 1\nlatitude_deg = 89.95\nlongitude_deg = 0\n",
            ["mission.toml: Start.latitude_deg must lie within 89.9 degrees"],
        ),
    ],
)
def test_mistakes_in_the_mapping_are_named(tmp_path, toml, messages):
    text = "t,d,w\n0,1,x\n1,2,y\n" if 'column = "w"' in toml else "t,d\n0,1\n1,2\n"
    write(tmp_path, toml, a__csv=text)
    with pytest.raises(MissionError) as caught:
        read_mission(tmp_path)
    for message in messages:
        assert message in str(caught.value)


def test_paths_that_are_no_mission(tmp_path):
    with pytest.raises(MissionError, match=r"has no mission.toml"):
        read_mission(tmp_path)
    with pytest.raises(MissionError, match="no such file or folder"):
        read_mission(tmp_path / "nothing.toml")
    (tmp_path / "a.csv").write_text("x")
    with pytest.raises(MissionError, match="is no mission"):
        read_mission(tmp_path / "a.csv")


# --- geodesy --------------------------------------------------------------------------------------------------------


def test_geodetic_and_ecef_are_inverse_everywhere():
    rng = np.random.default_rng(1)
    position = np.column_stack(
        [rng.uniform(-np.pi / 2, np.pi / 2, 500), rng.uniform(-np.pi, np.pi, 500), rng.uniform(-1e4, 1e5, 500)]
    )
    position[:4, 0] = [np.pi / 2, -np.pi / 2, 0.0, 1e-9]
    back = geodesy.geodetic_from_ecef(geodesy.ecef_from_geodetic(position))
    # 1e-14 rad is 0.06 um; 1e-8 m is the rounding of coordinates of 6e6 m.
    np.testing.assert_allclose(back[:, 0], position[:, 0], atol=1e-14)
    np.testing.assert_allclose(back[:, 2], position[:, 2], atol=1e-8)
    away = np.abs(position[:, 0]) < 1.57
    np.testing.assert_allclose(back[away, 1], position[away, 1], atol=1e-12)
