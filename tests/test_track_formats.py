"""Tracks in the formats of other programs, each read back by a reader that is not ours and held against the track."""

import dataclasses
import datetime
import importlib.util
import json
import re
import sqlite3
import struct
import tracemalloc
import xml.etree.ElementTree as ElementTree
import zipfile

import numpy as np
import pandas as pd
import pytest
from scipy.io import loadmat
from scipy.spatial.transform import Rotation
from small_run import small_run

import navfilter as nf
from navfilter.commands.cli import main
from navfilter.filter.records import OUTCOMES
from navfilter.io.tracks.formats import FORMATS
from navfilter.models.state import NavState, matrix_from_euler

#: 2026-05-28T20:26:40.250Z
EPOCH = 1.78e9 + 0.25
NAMES = {"kml": "{http://www.opengis.net/kml/2.2}", "gx": "{http://www.google.com/kml/ext/2.2}"}
GPX = "{http://www.topografix.com/GPX/1/1}"
SUFFIXES = [form.suffix for form in FORMATS]


def run(epoch=EPOCH, label="smoothed"):
    """The mission and one of its tracks, with or without UTC."""
    mission, tracks = small_run()
    return dataclasses.replace(mission, epoch_utc_s=epoch), dataclasses.replace(tracks[label], epoch_utc_s=epoch)


def posix(text):
    """Seconds since 1970 of ISO 8601, by the standard library."""
    return datetime.datetime.fromisoformat(text).timestamp()


# --- text -----------------------------------------------------------------------------------------------------------


def test_csv_has_utc_beside_the_mission_time(tmp_path):
    _, track = run()
    read = pd.read_csv(nf.write_track(track, tmp_path / "track.csv"), parse_dates=["time_utc"])
    assert list(read.columns[:3]) == ["time_s", "time_utc", "latitude_deg"]
    # microseconds are what the file holds
    stamps = (read["time_utc"] - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1)
    np.testing.assert_allclose(stamps - EPOCH, track.time_s, rtol=0, atol=1e-6)
    np.testing.assert_allclose(read["latitude_deg"], np.degrees(track.latitude), rtol=0, atol=1e-10)


def test_csv_in_pieces_is_that_in_one(tmp_path, monkeypatch):
    from navfilter.foundation.atomic_files import pieces
    from navfilter.io.tracks import table

    _, track = run()
    whole = nf.write_track(track, tmp_path / "whole.csv").read_bytes()
    monkeypatch.setattr(table, "pieces", lambda rows: pieces(rows, 7))
    assert nf.write_track(track, tmp_path / "pieces.csv").read_bytes() == whole


def test_geojson_has_times_and_sd_beside_each_place(tmp_path):
    mission, track = run()
    path = nf.write_track(track, tmp_path / "track.geojson", mission)
    line, _, fixes = json.loads(path.read_text())["features"]
    about, places = line["properties"], line["geometry"]["coordinates"]
    assert len(places) == len(track)
    np.testing.assert_allclose(about["time_s"], track.time_s, rtol=0, atol=1e-6)
    # milliseconds
    np.testing.assert_allclose([posix(t) - EPOCH for t in about["coordTimes"]], track.time_s, rtol=0, atol=1e-3)
    sd = np.sqrt(np.diagonal(track.covariance, axis1=1, axis2=2))
    for axis, name in enumerate(("north", "east", "down")):
        # four digits behind the point
        np.testing.assert_allclose(about[f"sd_{name}_m"], sd[:, axis], rtol=0, atol=1e-4)
    assert about["begin_utc"] == "2026-05-28T20:26:40.250Z"
    gps = mission.streams["gps"]
    np.testing.assert_allclose(fixes["properties"]["time_s"], gps.time_s, rtol=0, atol=1e-6)
    assert len(fixes["geometry"]["coordinates"]) == len(fixes["properties"]["coordTimes"]) == len(gps)


def test_geojson_across_the_antimeridian_splits_times_and_sd_with_the_line(tmp_path):
    _, track = run()
    moved = dataclasses.replace(track, longitude=track.longitude - track.longitude[len(track) // 2] + np.pi)
    [line] = json.loads(nf.write_track(moved, tmp_path / "track.geojson").read_text())["features"]
    parts = line["geometry"]["coordinates"]
    assert len(parts) == 2
    for key in ("time_s", "coordTimes", "sd_north_m"):
        assert [len(cells) for cells in line["properties"][key]] == [len(part) for part in parts]


def test_geojson_without_utc_has_mission_times_only(tmp_path):
    mission, track = run(epoch=None)
    content = json.loads(nf.write_track(track, tmp_path / "track.geojson", mission).read_text())
    about = content["features"][0]["properties"]
    assert about["begin_utc"] is None and "coordTimes" not in about and len(about["time_s"]) == len(track)


def test_kml_is_a_track_with_times_and_sd(tmp_path):
    _, track = run()
    tree = ElementTree.parse(nf.write_track(track, tmp_path / "track.kml"))
    found = tree.find(f".//{NAMES['gx']}Track")
    whens = [posix(when.text) for when in found.iter(f"{NAMES['kml']}when")]
    coordinates = np.array([coord.text.split() for coord in found.iter(f"{NAMES['gx']}coord")], dtype=float)
    sds = np.array([value.text for value in found.iter(f"{NAMES['gx']}value")], dtype=float)
    assert len(whens) == len(coordinates) == len(sds) == len(track)
    # times in ms, places in 1e-9 deg (0.1 mm), heights and sd in mm
    np.testing.assert_allclose(np.array(whens) - EPOCH, track.time_s, rtol=0, atol=1e-3)
    expected = np.column_stack([np.degrees(track.longitude), np.degrees(track.latitude)])
    np.testing.assert_allclose(coordinates[:, :2], expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(coordinates[:, 2], track.height, rtol=0, atol=1e-3)
    variance = track.covariance[:, 0, 0] + track.covariance[:, 1, 1]
    np.testing.assert_allclose(sds, np.sqrt(variance), rtol=0, atol=1e-3)


def test_kmz_is_the_same_packed(tmp_path):
    _, track = run()
    plain = nf.write_track(track, tmp_path / "track.kml").read_bytes()
    with zipfile.ZipFile(nf.write_track(track, tmp_path / "track.kmz")) as archive:
        assert archive.namelist() == ["doc.kml"] and archive.read("doc.kml") == plain
    assert sorted(path.name for path in tmp_path.iterdir()) == ["track.kml", "track.kmz"]


def test_kml_without_utc_is_a_line_without_times(tmp_path):
    _, track = run(epoch=None)
    tree = ElementTree.parse(nf.write_track(track, tmp_path / "track.kml"))
    assert tree.find(f".//{NAMES['gx']}Track") is None
    line = tree.find(f".//{NAMES['kml']}LineString/{NAMES['kml']}coordinates").text.split()
    assert len(line) == len(track)
    np.testing.assert_allclose(float(line[-1].split(",")[1]), np.degrees(track.latitude[-1]), rtol=0, atol=1e-9)


@pytest.mark.parametrize("epoch", [EPOCH, None])
def test_gpx_is_a_track(tmp_path, epoch):
    _, track = run(epoch)
    points = list(ElementTree.parse(nf.write_track(track, tmp_path / "track.gpx")).iter(f"{GPX}trkpt"))
    assert len(points) == len(track)
    place = np.array([[point.get("lat"), point.get("lon")] for point in points], dtype=float)
    np.testing.assert_allclose(place, np.degrees([track.latitude, track.longitude]).T, rtol=0, atol=1e-9)
    height = [float(point.find(f"{GPX}ele").text) for point in points]
    np.testing.assert_allclose(height, track.height, rtol=0, atol=1e-3)
    times = [posix(time.text) - EPOCH for point in points for time in point.iter(f"{GPX}time")]
    np.testing.assert_allclose(times, track.time_s if epoch else [], rtol=0, atol=1e-3)


@pytest.mark.parametrize("suffix", [".kml", ".gpx"])
def test_names_are_text_in_xml(tmp_path, suffix):
    _, track = run()
    named = dataclasses.replace(track, mission_name='</name><script>"&\x07\x00 dive')
    text = "".join(ElementTree.parse(nf.write_track(named, tmp_path / f"track{suffix}")).getroot().itertext())
    assert '</name><script>"& dive' in text


# --- binary ---------------------------------------------------------------------------------------------------------


def sbet(path):
    """Records of an SBET by its documented layout: 17 little-endian doubles."""
    data = path.read_bytes()
    assert len(data) % 136 == 0
    return np.array(list(struct.iter_unpack("<17d", data)))


def test_sbet_is_the_track(tmp_path):
    _, track = run()
    rows = sbet(nf.write_track(track, tmp_path / "track.sbet"))
    # 2026-05-28 is a Thursday: four days and 20:26:40.25, and 18 leap seconds; UTC in float64 is good to 0.3 us
    begin = 4 * 86400 + 20 * 3600 + 26 * 60 + 40.25 + 18
    np.testing.assert_allclose(rows[:, 0] - begin, track.time_s, rtol=0, atol=1e-6)
    # float64 as they are
    np.testing.assert_array_equal(rows[:, 1], track.latitude)
    np.testing.assert_allclose(rows[:, 2], track.longitude, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(rows[:, 3], track.height)
    np.testing.assert_array_equal(rows[:, 4:7], track.velocity_n)
    np.testing.assert_array_equal(rows[:, 7:10], track.attitude)
    np.testing.assert_array_equal(rows[:, 10], 0.0)


def test_sbet_motion_leads_from_each_row_to_the_next(tmp_path):
    _, track = run()
    rows = sbet(nf.write_track(track, tmp_path / "track.sbet"))
    step = np.diff(track.time_s)[:, np.newaxis]
    turned = Rotation.from_matrix(matrix_from_euler(*track.attitude.T))
    after = turned[:-1] * Rotation.from_rotvec(rows[:-1, 14:] * step)
    np.testing.assert_allclose(after.as_matrix(), turned[1:].as_matrix(), rtol=0, atol=1e-12)
    gained = turned[:-1].apply(rows[:-1, 11:14] * step)
    np.testing.assert_allclose(gained, np.diff(track.velocity_n, axis=0), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(rows[-1, 11:], rows[-2, 11:])


def test_sbet_in_pieces_is_that_in_one(tmp_path, monkeypatch):
    from navfilter.foundation.atomic_files import pieces
    from navfilter.io.tracks import sbet as module

    _, track = run()
    whole = nf.write_track(track, tmp_path / "whole.sbet").read_bytes()
    # the last piece has one row
    monkeypatch.setattr(module, "pieces", lambda rows: pieces(rows, (len(track) - 1) // 2))
    assert (len(track) - 1) % 2 == 0
    assert nf.write_track(track, tmp_path / "pieces.sbet").read_bytes() == whole


def test_sbet_counts_on_through_the_end_of_the_week(tmp_path):
    # 2026-05-30T23:58:42Z is 60 s before the end of a GPS week
    _, track = run(epoch=datetime.datetime(2026, 5, 30, 23, 58, 42, tzinfo=datetime.UTC).timestamp())
    time_s = sbet(nf.write_track(track, tmp_path / "track.sbet"))[:, 0]
    np.testing.assert_allclose(time_s, 604740 + track.time_s, rtol=0, atol=1e-6)


@pytest.mark.parametrize(("day", "leap"), [((2008, 12, 31), 14), ((2009, 1, 1), 15), ((2016, 12, 31), 17)])
def test_sbet_knows_the_leap_seconds(tmp_path, day, leap):
    midnight = datetime.datetime(*day, tzinfo=datetime.UTC)
    _, track = run(epoch=midnight.timestamp())
    seconds = sbet(nf.write_track(track, tmp_path / "track.sbet"))[0, 0]
    # weeks begin on Sunday
    assert seconds == pytest.approx((midnight.isoweekday() % 7) * 86400 + leap + track.time_s[0], abs=1e-6)


def test_sbet_before_its_leap_seconds_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"begins at 2001-.*from 2006 on"):
        nf.write_track(run(epoch=1e9)[1], tmp_path / "track.sbet")


@pytest.mark.parametrize("epoch", [EPOCH, None])
def test_mat_is_the_track(tmp_path, epoch):
    _, track = run(epoch)
    read = loadmat(nf.write_track(track, tmp_path / "track.mat"), squeeze_me=True, struct_as_record=False)["track"]
    # float64 as they are
    np.testing.assert_array_equal(read.time_s, track.time_s)
    np.testing.assert_array_equal(read.latitude_deg, np.degrees(track.latitude))
    np.testing.assert_array_equal(read.covariance, track.covariance)
    np.testing.assert_array_equal(read.states, track.states)
    assert list(read.state_names) == list(track.state_names) and read.mission == track.mission_name
    assert hasattr(read, "posix_s") == (epoch is not None)
    if epoch is not None:
        np.testing.assert_array_equal(read.posix_s, track.time_s + EPOCH)
    sensors = {str(sensor.name): sensor for sensor in read.residuals}
    assert set(sensors) == set(track.residuals)
    for name, residuals in track.residuals.items():
        np.testing.assert_array_equal(sensors[name].nis, residuals.nis)
        np.testing.assert_array_equal(np.squeeze(sensors[name].value), np.squeeze(residuals.value))
        words = [str(read.outcomes[int(number) - 1]) for number in sensors[name].outcome]
        assert words == [OUTCOMES[code] for code in residuals.outcome]


def test_mat_that_its_format_cannot_hold_is_refused(tmp_path, monkeypatch):
    from navfilter.io.tracks import mat

    _, track = run()
    # its covariances alone, 9 x 9 float64 a row, and residuals of no reading
    own = track.covariance.nbytes
    for most, many in ((own, track), (2 * own, with_readings(track, 40_000))):
        monkeypatch.setattr(mat, "_MOST_BYTES", most)
        with pytest.raises(ValueError, match=r"holds 2 GiB, this track needs .*: lower --output-rate"):
            nf.write_track(many, tmp_path / "track.mat")
    assert list(tmp_path.iterdir()) == []


def with_readings(track, count):
    """The track with so many readings of each sensor."""
    rows = np.zeros(count, dtype=int)
    many = {
        name: dataclasses.replace(r, **{field.name: getattr(r, field.name)[rows] for field in dataclasses.fields(r)})
        for name, r in track.residuals.items()
    }
    return dataclasses.replace(track, residuals=many)


def test_mat_without_sensors_and_states(tmp_path):
    _, track = run()
    bare = dataclasses.replace(
        track, residuals={}, states=np.empty((len(track), 0)), states_sd=np.empty((len(track), 0)), state_names=(),
        state_units=(),
    )  # fmt: skip
    read = loadmat(nf.write_track(bare, tmp_path / "track.mat"))["track"]
    assert read["residuals"][0, 0].size == 0 and read["state_names"][0, 0].size == 0


def test_netcdf_is_a_cf_trajectory(tmp_path):
    netcdf = pytest.importorskip("netCDF4")
    _, track = run()
    with netcdf.Dataset(nf.write_track(track, tmp_path / "track.nc")) as file:
        assert file.Conventions == "CF-1.8" and file.featureType == "trajectory"
        assert netcdf.chartostring(file["trajectory"][:]).item() == track.mission_name
        assert file["trajectory"].cf_role == "trajectory_id"
        assert file["latitude_deg"].standard_name == "latitude" and file["latitude_deg"].units == "degrees_north"
        assert file["height_m"].positive == "up" and file["velocity_north_m_s"].units == "m s-1"
        frame = track.to_frame().drop(columns=["time_s", "time_utc"])
        for name in frame:
            # float64 as they are; of longitudes a turn more or less
            variable = file[re.sub(r"[^A-Za-z0-9]+", "_", name)]
            np.testing.assert_allclose(variable[:], frame[name], rtol=1e-15, atol=1e-13)
            assert re.fullmatch(r"1|(m|degree(_north|_east)?|degrees_\w+|m2)( s-[12])?", variable.units), variable.units
        dates = netcdf.num2date(file["time"][:], file["time"].units, file["time"].calendar)
        seconds = [date._to_real_datetime().replace(tzinfo=datetime.UTC).timestamp() for date in dates]
        # dates in microseconds
        np.testing.assert_allclose(np.array(seconds) - EPOCH, track.time_s, rtol=0, atol=1e-5)


def test_netcdf_names_and_units_of_states(tmp_path):
    netcdf = pytest.importorskip("netCDF4")
    _, track = run()
    states = {"gyro_x[0]": "rad_s", "gyro_x_0": "rad_s", "accel x": "m_s2", "7.scale": "1"}
    values = np.arange(4.0 * len(track)).reshape(-1, 4)
    odd = dataclasses.replace(
        track, states=values, states_sd=values, state_names=tuple(states), state_units=tuple(states.values())
    )
    with netcdf.Dataset(nf.write_track(odd, tmp_path / "track.nc")) as file:
        named = [name for name in file.variables if re.match("gyro|accel|state_", name) and "_sd_" not in name]
        units = {name: file[name].units for name in named}
        assert units == {
            "gyro_x_0_deg_s": "degree s-1",
            "gyro_x_0_deg_s_": "degree s-1",
            "accel_x_m_s2": "m s-2",
            "state_7_scale_1": "1",
        }
        # degrees were made of radians
        np.testing.assert_allclose(np.radians(file["gyro_x_0_deg_s_"][:]), values[:, 1], rtol=1e-15)


def test_netcdf_opens_with_dates_in_xarray(tmp_path):
    xarray = pytest.importorskip("xarray")
    _, track = run()
    with xarray.open_dataset(nf.write_track(track, tmp_path / "track.nc"), engine="scipy") as data:
        apart = data["time"].values - track.time_utc
        # a nanosecond count of a float64
        assert np.abs(apart).max() < np.timedelta64(1, "us")
        np.testing.assert_array_equal(data["height_m"].values, track.height)


def test_netcdf_without_utc_has_no_dates(tmp_path):
    netcdf = pytest.importorskip("netCDF4")
    _, track = run(epoch=None)
    with netcdf.Dataset(nf.write_track(track, tmp_path / "track.nc")) as file:
        assert file["time"].units == "s" and "unknown" in file["time"].long_name
        np.testing.assert_array_equal(file["time"][:], track.time_s)


# --- ROS ------------------------------------------------------------------------------------------------------------


def from_mcap(path):
    """Topic -> (stamps of the log [ns], messages), by Foxglove's own reader and decoder."""
    reader = pytest.importorskip("mcap.reader")
    decoder = pytest.importorskip("mcap_ros2.decoder")
    found = {}
    with path.open("rb") as file:
        whole = reader.make_reader(file, decoder_factories=[decoder.DecoderFactory()], validate_crcs=True)
        assert whole.get_header().profile == "ros2"
        for _, channel, message, decoded in whole.iter_decoded_messages():
            stamps, messages = found.setdefault(channel.topic, ([], []))
            stamps.append(message.log_time)
            messages.append(decoded)
    return found


def from_db3(folder):
    """The same of a ROS 2 bag, by SQLite and Foxglove's decoder."""
    dynamic = pytest.importorskip("mcap_ros2._dynamic")
    found = {}
    with sqlite3.connect(next(folder.glob("*.db3"))) as base:
        kinds = dict(base.execute("SELECT topic_type, encoded_message_definition FROM message_definitions"))
        topics = {number: (name, kind) for number, name, kind in base.execute("SELECT id, name, type FROM topics")}
        decoders = {kind: dynamic.generate_dynamic(kind, text)[kind] for kind, text in kinds.items()}
        for number, stamp, data in base.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id"):
            name, kind = topics[number]
            stamps, messages = found.setdefault(name, ([], []))
            stamps.append(stamp)
            messages.append(decoders[kind](data))
    return found


READERS = {".mcap": from_mcap, ".rosbag": from_db3}


@pytest.mark.parametrize("suffix", READERS)
def test_ros_messages_are_the_track(tmp_path, suffix):
    _, track = run()
    found = READERS[suffix](nf.write_track(track, tmp_path / f"track{suffix}"))
    assert set(found) == {
        "/navfilter/odometry", "/navfilter/fix", "/navfilter/depth/nis", "/navfilter/gps/nis", "/diagnostics"
    }  # fmt: skip
    stamps, fixes = found["/navfilter/fix"]
    # to the nanosecond: the epoch is a quarter of a second, the rows are whole ones
    assert stamps == [round(1e9 * t) + 1_780_000_000_250_000_000 for t in track.time_s]
    assert [fix.header.stamp.sec * 10**9 + fix.header.stamp.nanosec for fix in fixes] == stamps
    place = np.array([[fix.latitude, fix.longitude, fix.altitude] for fix in fixes])
    expected = np.column_stack([np.degrees(track.latitude), np.degrees(track.longitude), track.height])
    # a turn was added and taken off again
    np.testing.assert_allclose(place, expected, rtol=0, atol=1e-12)
    P = np.array([fix.position_covariance for fix in fixes]).reshape(-1, 3, 3)
    np.testing.assert_allclose(P[:, 0, 0], track.covariance[:, 1, 1], rtol=1e-12)
    np.testing.assert_allclose(P[:, 0, 2], -track.covariance[:, 1, 2], rtol=0, atol=1e-15)


@pytest.mark.parametrize("suffix", READERS)
def test_odometry_is_the_track_in_east_north_up(tmp_path, suffix):
    _, track = run()
    _, messages = READERS[suffix](nf.write_track(track, tmp_path / f"track{suffix}"))["/navfilter/odometry"]
    tum = np.loadtxt(nf.write_track(track, tmp_path / "track.tum"))
    at = np.array([[getattr(m.pose.pose.position, axis) for axis in "xyz"] for m in messages])
    # the text has five digits
    np.testing.assert_allclose(at, tum[:, 1:4], rtol=0, atol=1e-5)
    turned = Rotation.from_quat([[getattr(m.pose.pose.orientation, axis) for axis in "xyzw"] for m in messages])
    # forward is forward, left is minus right
    own = Rotation.from_quat(tum[:, 4:])
    np.testing.assert_allclose(turned.apply([1, 0, 0]), own.apply([1, 0, 0]), rtol=0, atol=1e-8)
    np.testing.assert_allclose(turned.apply([0, 1, 0]), own.apply([0, -1, 0]), rtol=0, atol=1e-8)
    speed = np.array([[getattr(m.twist.twist.linear, axis) for axis in "xyz"] for m in messages])
    back = turned.apply(speed)
    # over two hundred metres north turns by 2e-5 rad against the plane's
    np.testing.assert_allclose(back[:, [1, 0]], track.velocity_n[:, :2], rtol=0, atol=1e-4)
    assert {(m.header.frame_id, m.child_frame_id) for m in messages} == {("map", "base_link")}


def test_covariances_of_odometry_are_those_of_drawn_errors(tmp_path):
    """Errors drawn from the track's covariance and taken through `NavState.plus` spread as the messages say."""
    _, track = run()
    rng, row, draws = np.random.default_rng(5), len(track) // 2, 40_000
    _, messages = from_mcap(nf.write_track(track, tmp_path / "track.mcap"))["/navfilter/odometry"]
    P = track.covariance[row]
    C = matrix_from_euler(*track.attitude[row])
    place = (track.latitude[row], track.longitude[row], track.height[row])
    state = NavState(0.0, *place, track.velocity_n[row], C, P)
    flu = np.diag([1.0, -1.0, -1.0])
    velocity = []
    for error in rng.multivariate_normal(np.zeros(9), P, draws, method="cholesky"):
        true = state.plus(-error)
        velocity.append(flu @ C.T @ track.velocity_n[row] - flu @ true.C_nb.T @ true.velocity_n)
    found = np.array(messages[row].twist.covariance).reshape(6, 6)
    # a variance of so many draws is known to 0.7 %; four of that
    np.testing.assert_allclose(np.var(velocity, axis=0), np.diag(found)[:3], rtol=0.03)
    pose = np.array(messages[row].pose.covariance).reshape(6, 6)
    # east, north, up, but for the 2e-5 rad by which north turns
    chosen = [1, 0, 2, 7, 6, 8]
    sign = np.diag([1, 1, -1, 1, 1, -1])
    expected = sign @ P[np.ix_(chosen, chosen)] @ sign
    np.testing.assert_allclose(pose, expected, rtol=0, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize("suffix", READERS)
def test_nis_and_health_are_those_of_the_residuals(tmp_path, suffix):
    _, track = run()
    found = READERS[suffix](nf.write_track(track, tmp_path / f"track{suffix}"))
    for name, residuals in track.residuals.items():
        stamps, messages = found[f"/navfilter/{name}/nis"]
        judged = residuals.dof > 0
        np.testing.assert_array_equal([m.data for m in messages], (residuals.nis / residuals.dof)[judged])
        np.testing.assert_allclose(1e-9 * np.array(stamps) - EPOCH, residuals.time_s[judged], rtol=0, atol=1e-6)
    stamps, messages = found["/diagnostics"]
    assert np.diff(stamps).tolist() == [10**9] * (len(stamps) - 1)
    health = [{status.name: status for status in message.status} for message in messages]
    last = {pair.key: pair.value for pair in health[-1]["navfilter: gps"].values}
    assert last["used"] == str(track.residuals["gps"].count("used"))
    # the vehicle dives: no fix for 5 s and 8 periods is silence, which a STALE (3) says
    gps = track.residuals["gps"].time_s
    timeout = max(5.0, 8.0 / track.vehicle.sensors["gps"].rate_hz)
    now = 1e-9 * np.array(stamps) - EPOCH
    since = np.array([t - gps[gps <= t + 1e-6].max(initial=-np.inf) for t in now])
    clear = np.abs(since - timeout) > 1e-3
    stale = np.array([status["navfilter: gps"].level in (3, b"\x03") for status in health])
    assert stale.any() and not stale.all()
    np.testing.assert_array_equal(stale[clear], (since > timeout)[clear])


def test_a_bag_of_a_track_is_a_bag(tmp_path):
    """By metadata.yaml and index, as rosbags and so our own reader of logs open it."""
    highlevel = pytest.importorskip("rosbags.highlevel")
    _, track = run()
    folder = nf.write_track(track, tmp_path / "track.rosbag")
    with highlevel.AnyReader([folder]) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        assert counts["/navfilter/fix"] == counts["/navfilter/odometry"] == len(track)
    assert nf.write_track(track, folder) == folder  # again: replaced
    assert sorted(path.name for path in tmp_path.iterdir()) == ["track.rosbag"]
    (folder / "metadata.yaml").unlink()
    with pytest.raises(ValueError, match=r"no folder with a metadata\.yaml: it is not replaced"):
        nf.write_track(track, folder)


def test_ros_without_utc_has_mission_times_and_none_below_zero(tmp_path):
    _, track = run(epoch=None)
    stamps, _ = from_mcap(nf.write_track(track, tmp_path / "track.mcap"))["/navfilter/fix"]
    np.testing.assert_allclose(1e-9 * np.array(stamps), track.time_s, rtol=0, atol=1e-9)
    with pytest.raises(ValueError, match=r'stamps of ROS lie from 0.*zero_s = "first"'):
        nf.write_track(dataclasses.replace(track, time_s=track.time_s - 1000.0), tmp_path / "early.mcap")


def test_topics_have_names_that_ros_takes(tmp_path):
    _, track = run()
    renamed = {"1 gps/Nord-Süd": track.residuals["gps"], "1_gps_Nord_S_d": track.residuals["depth"]}
    sensors = {"1 gps/Nord-Süd": nf.Position(), "1_gps_Nord_S_d": nf.Depth()}
    odd = dataclasses.replace(track, residuals=renamed, vehicle=nf.Vehicle(track.vehicle.drive, sensors))
    topics = set(from_mcap(nf.write_track(odd, tmp_path / "track.mcap")))
    assert {"/navfilter/_1_gps_Nord_S_d/nis", "/navfilter/_1_gps_Nord_S_d_/nis"} <= topics


# --- what cannot be written -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_track_without_rows_is_refused(tmp_path, suffix):
    with pytest.raises(ValueError, match="has no rows"):
        nf.write_track(run()[1].keep(slice(0, 0)), tmp_path / f"track{suffix}")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_track_of_one_row_is_written(tmp_path, suffix):
    assert nf.write_track(run()[1].keep(slice(3, 4)), tmp_path / f"track{suffix}").exists()


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_a_track_that_is_nowhere(tmp_path, form):
    _, track = run()
    nowhere = dataclasses.replace(
        track, latitude=track.latitude - track.latitude[0], longitude=track.longitude - track.longitude[0]
    )
    path = tmp_path / f"track{form.suffix}"
    if form.place:
        with pytest.raises(ValueError, match="stands for nowhere: give latitude_deg"):
            nf.write_track(nowhere, path)
        return
    nf.write_track(nowhere, path)
    if form.suffix == ".mcap":
        assert "/navfilter/fix" not in from_mcap(path) and "/navfilter/odometry" in from_mcap(path)


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_a_track_without_utc(tmp_path, form):
    _, track = run(epoch=None)
    if form.utc:
        with pytest.raises(ValueError, match="does not know UTC: say at what UTC"):
            nf.write_track(track, tmp_path / f"track{form.suffix}")
    else:
        assert nf.write_track(track, tmp_path / f"track{form.suffix}").exists()


def test_unknown_endings_and_missing_packages_are_told(tmp_path, monkeypatch):
    _, track = run()
    with pytest.raises(ValueError, match=r"no format of tracks has this ending; take one of \.csv, "):
        nf.write_track(track, tmp_path / "track.xls")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r'rosbags, which is not installed: pip install "navfilter\[ros\]"'):
        nf.write_track(track, tmp_path / "track.mcap")


def long_track(rows):
    """A track of so many rows, a tenth of a second apart."""
    _, track = run()
    long = track.keep(np.arange(rows) % len(track))
    return dataclasses.replace(long, time_s=0.1 * np.arange(rows), residuals={})


@pytest.mark.parametrize("suffix", [".csv", ".kml", ".gpx", ".sbet", ".nc"])
def test_a_long_track_costs_no_second_one_in_memory(tmp_path, suffix):
    track = long_track(30_000)
    own = sum(getattr(track, name).nbytes for name in ("covariance", "states", "states_sd", "velocity_n", "attitude"))
    nf.write_track(track.keep(slice(0, 100)), tmp_path / f"first{suffix}")  # what is imported is not counted
    tracemalloc.start()
    try:
        nf.write_track(track, tmp_path / f"track{suffix}")
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 0.8 * own


# --- the command line -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def dive(tmp_path_factory):
    """A recorded mission and its vehicle, in files."""
    from navfilter.io import write_vehicle

    mission, tracks = small_run()
    folder = tmp_path_factory.mktemp("dive")
    mission.save(folder / "mission.npz")
    dataclasses.replace(mission, epoch_utc_s=EPOCH).save(folder / "dated.npz")
    write_vehicle(tracks["forward"].vehicle, folder / "vehicle.toml")
    return folder


def test_every_format_is_an_option_of_replay(dive, tmp_path, capsys):
    asked = [f"--{form.name}" for form in FORMATS if not form.always]
    arguments = ["replay", str(dive / "dated.npz"), "--vehicle", str(dive), "--out", str(tmp_path / "out")]
    assert main([*arguments, *asked, "--no-report"]) == 0
    told = capsys.readouterr().out
    beside = {"track.shx", "track.dbf", "track.prj"}  # a shapefile is several files
    assert {path.name for path in (tmp_path / "out").glob("track.*")} == {f"track{s}" for s in SUFFIXES} | beside
    assert all(f"track{suffix}" in told for suffix in SUFFIXES)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["begin_utc"] == "2026-05-28T20:26:40.250Z"


def test_what_cannot_be_written_is_refused_before_the_run(dive, tmp_path, capsys):
    arguments = ["replay", str(dive / "mission.npz"), "--vehicle", str(dive), "--out", str(tmp_path / "out"), "--sbet"]
    assert main(arguments) == 2
    assert "does not know UTC" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
