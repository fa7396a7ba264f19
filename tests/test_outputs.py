"""The files a run leaves: readable by the tools they are meant for, and true to the track."""

import dataclasses
import json

import numpy as np
import pandas as pd
import pytest
from geographiclib.geodesic import Geodesic
from scipy.spatial.transform import Rotation
from small_run import small_run

from navfilter.io.tracks import table
from navfilter.io.tracks.formats import write_track
from navfilter.io.tracks.tum import write_truth
from navfilter.io.write import labelled, summarise, write_outputs, write_summary

RUN_KEYS = [
    "position_rms_m",
    "position_max_m",
    "position_end_m",
    "position_end_pct",
    "heading_rms_deg",
    "velocity_rms_m_s",
    "nees_position",
    "nees_heading",
    "nis",
    "used",
    "rejected",
    "invalid",
    "models",
    "adopted",
    "cpu_s",
    "integrity",
]


def strict(path):
    """JSON as the standard has it: NaN and Infinity are no numbers."""

    def refuse(name):
        raise AssertionError(f"{path} holds {name}")

    return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)


def both_tum(track, truth, folder):
    """Rows of track.tum and truth.tum."""
    assert write_truth(track, folder / "truth.tum", truth)
    return np.loadtxt(write_track(track, folder / "track.tum")), np.loadtxt(folder / "truth.tum")


def test_every_file_is_written_and_nothing_else(tmp_path):
    mission, tracks = small_run()
    written = write_outputs(tracks, mission, tmp_path / "new" / "folder")
    names = ["summary.json", "track.csv", "track.geojson", "track.tum", "truth.tum"]
    assert sorted(path.name for path in written) == names
    assert sorted(path.name for path in (tmp_path / "new" / "folder").iterdir()) == names


def test_csv_is_the_frame(tmp_path):
    _, tracks = small_run()
    frame = tracks["smoothed"].to_frame()
    read = pd.read_csv(write_track(tracks["smoothed"], tmp_path / "track.csv"))
    assert list(read.columns) == list(frame.columns)
    # Ten decimals of a degree and seven digits of everything else are what the file promises.
    np.testing.assert_allclose(read["latitude_deg"], frame["latitude_deg"], rtol=0, atol=1e-10)
    np.testing.assert_allclose(read.to_numpy(), frame.to_numpy(), rtol=1e-6, atol=1e-5)


def test_tum_is_the_track_in_east_north_up(tmp_path):
    _, tracks = small_run()
    track = tracks["smoothed"]
    rows = np.loadtxt(write_track(track, tmp_path / "track.tum"))
    assert rows.shape == (len(track), 8)
    np.testing.assert_allclose(np.linalg.norm(rows[:, 4:], axis=1), 1.0, atol=1e-8)
    lat, lon = np.degrees(track.latitude), np.degrees(track.longitude)
    last = Geodesic.WGS84.Inverse(lat[0], lon[0], lat[-1], lon[-1])
    bearing = np.radians(last["azi1"])
    # Over a few hundred metres the tangent plane and the geodesic agree to a millimetre.
    np.testing.assert_allclose(rows[-1, 1:3], last["s12"] * np.array([np.sin(bearing), np.cos(bearing)]), atol=2e-3)
    np.testing.assert_allclose(rows[:, 3], track.height - track.height[0], atol=0.02)
    forward = Rotation.from_quat(rows[:, 4:]).apply([1.0, 0.0, 0.0])
    turned = np.angle(np.exp(1j * (np.arctan2(forward[:, 0], forward[:, 1]) - track.attitude[:, 2])))
    # The meridians converge by 1e-4 rad at most over this distance.
    np.testing.assert_allclose(turned, 0.0, atol=2e-4)
    down = Rotation.from_quat(rows[:, 4:]).apply([0.0, 0.0, 1.0])
    assert (down[:, 2] < -0.9).all()


def test_tum_of_track_and_truth_differ_by_the_error(tmp_path):
    mission, tracks = small_run()
    track = tracks["forward"]
    own, true = both_tum(track, mission.truth, tmp_path)
    errors = track.errors(mission.truth)
    difference = own[:, 1:4] - np.column_stack([np.interp(track.time_s, true[:, 0], true[:, i]) for i in (1, 2, 3)])
    # Truth at 20 Hz, interpolated on both sides; what is left is the rounding of the file.
    np.testing.assert_allclose(difference[:, [1, 0]], errors.position_n[:, :2], atol=2e-3)
    np.testing.assert_allclose(difference[:, 2], -errors.position_n[:, 2], atol=2e-3)


def test_what_the_truth_does_not_know_counts_as_no_error(tmp_path):
    mission, tracks = small_run()
    value = mission.truth.value.copy()
    value[:, [2, 6, 7, 8]] = np.nan
    truth = dataclasses.replace(mission.truth, value=value)
    own, true = both_tum(tracks["forward"], truth, tmp_path)
    assert np.isfinite(true).all()
    np.testing.assert_allclose(true[-1, 3], own[-1, 3], atol=0.02)


def test_geojson_has_longitude_first(tmp_path):
    mission, tracks = small_run()
    track = tracks["smoothed"]
    content = strict(write_track(track, tmp_path / "track.geojson", mission))
    assert content["type"] == "FeatureCollection"
    names = [feature["properties"]["name"] for feature in content["features"]]
    assert names == ["smoothed", "truth", "gps"]
    line = content["features"][0]
    assert line["geometry"]["type"] == "LineString" and len(line["geometry"]["coordinates"]) == len(track)
    first = line["geometry"]["coordinates"][0]
    np.testing.assert_allclose(first[:2], np.degrees([track.longitude[0], track.latitude[0]]), atol=1e-8)
    assert line["properties"]["mission"] == mission.name and line["properties"]["distance_m"] > 100


def test_geojson_is_cut_at_the_antimeridian(tmp_path):
    mission, tracks = small_run()
    track = tracks["forward"]
    moved = dataclasses.replace(track, longitude=track.longitude - track.longitude[len(track) // 2] + np.pi)
    content = strict(write_track(moved, tmp_path / "track.geojson", dataclasses.replace(mission, truth=None)))
    shape = content["features"][0]["geometry"]
    assert shape["type"] == "MultiLineString"
    for part in shape["coordinates"]:
        assert np.ptp([point[0] for point in part]) < 1.0


def test_summary_has_the_promised_keys(tmp_path):
    mission, tracks = small_run()
    content = strict(write_summary(tracks, mission, tmp_path / "summary.json"))
    assert list(content) == ["schema", "mission", "vehicle", "begin_utc", "duration_s", "distance_m", "runs"]
    assert list(content["runs"]) == ["forward", "smoothed"]
    for run in content["runs"].values():
        assert list(run) == RUN_KEYS
        assert set(run["nis"]) == set(run["used"]) == set(run["rejected"]) == set(run["invalid"]) == {"depth", "gps"}
        assert run["position_rms_m"] > 0 and run["nees_position"] > 0
    rms = np.sqrt(np.mean(tracks["forward"].errors(mission.truth).horizontal ** 2))
    assert content["runs"]["forward"]["position_rms_m"] == pytest.approx(rms, rel=1e-12)


def test_summary_without_truth_is_null_and_says_the_rest(tmp_path):
    mission, tracks = small_run()
    content = strict(write_summary(tracks, dataclasses.replace(mission, truth=None), tmp_path / "summary.json"))
    run = content["runs"]["smoothed"]
    assert all(run[key] is None for key in RUN_KEYS[:8])
    assert run["nis"]["gps"] > 0 and run["used"]["gps"] > 0


def test_summary_writes_null_for_what_is_not_finite(tmp_path):
    mission, tracks = small_run()
    broken = dataclasses.replace(tracks["forward"], cpu_s=np.float64("nan"))
    assert strict(write_summary({"forward": broken}, mission, tmp_path / "s.json"))["runs"]["forward"]["cpu_s"] is None


def test_summary_scores_the_windows_of_the_mission():
    mission, tracks = small_run()
    late = dataclasses.replace(mission, windows=((100.0, 150.0),))
    errors = tracks["forward"].errors(mission.truth)
    expected = np.sqrt(np.mean(errors.horizontal[errors.time_s >= 100.0] ** 2))
    assert summarise(tracks, late)["runs"]["forward"]["position_rms_m"] == pytest.approx(expected, rel=1e-12)


def test_an_interrupted_write_leaves_the_old_file(tmp_path, monkeypatch):
    _, tracks = small_run()
    path = tmp_path / "track.csv"
    path.write_text("old")

    def full(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(table, "text_of_rows", full)
    with pytest.raises(OSError, match="No space"):
        write_track(tracks["forward"], path)
    assert path.read_text() == "old" and [p.name for p in tmp_path.iterdir()] == ["track.csv"]


def test_labels_of_a_track():
    _, tracks = small_run()
    assert list(labelled(tracks["smoothed"])) == ["forward", "smoothed"]
    assert list(labelled(tracks["forward"])) == ["forward"]
