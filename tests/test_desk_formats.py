"""Shapefiles, GeoPackage, tables of a user's own, heave, and the schema of summary.json."""

import dataclasses
import json
import sqlite3
import struct

import jsonschema
import numpy as np
import pytest
import shapefile
from small_run import small_run

import navfilter as nf
from navfilter.commands.cli import main
from navfilter.io import write_vehicle
from navfilter.io.tracks.own_columns import FormatError, read_format, write_own
from navfilter.io.write import ROOM, labelled
from navfilter.models.during import During
from navfilter.simulation.scenarios import simulate_scenario
from navfilter.track.heave import heave

EPOCH = 1.78e9 + 0.25


def track_of(scenario="reckoning", epoch=EPOCH):
    return dataclasses.replace(small_run(scenario)[1]["smoothed"], epoch_utc_s=epoch)


def test_shapefiles_hold_the_line_and_its_points(tmp_path):
    track = track_of()
    nf.write_track(track, tmp_path / "t.shp")
    with shapefile.Reader(str(tmp_path / "t.shp")) as line, shapefile.Reader(str(tmp_path / "t_points.shp")) as points:
        (shape,) = line.shapes()
        np.testing.assert_allclose(shape.points, np.degrees([track.longitude, track.latitude]).T, atol=1e-12)
        np.testing.assert_allclose(shape.z, track.height, atol=1e-12)
        assert line.record(0)["mission"] == track.mission_name
        assert len(points) == len(track)
        row = points.record(7).as_dict()
        assert row["time_s"] == pytest.approx(track.time_s[7], abs=1e-3) and row["time_utc"].startswith(
            "2026-05-28T20:"
        )
        assert row["sd_north"] == pytest.approx(np.sqrt(track.covariance[7, 0, 0]), abs=1e-4)
    assert "WGS_1984" in (tmp_path / "t.prj").read_text()
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_geopackage_is_what_the_standard_says(tmp_path):
    track = track_of()
    file = sqlite3.connect(nf.write_track(track, tmp_path / "t.gpkg"))
    assert file.execute("PRAGMA application_id").fetchone() == (int.from_bytes(b"GPKG", "big"),)
    assert file.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    layers = file.execute("SELECT table_name, geometry_type_name, srs_id FROM gpkg_geometry_columns").fetchall()
    assert sorted(layers) == [("points", "POINT", 4326), ("track", "LINESTRING", 4326)]
    (blob,) = file.execute("SELECT geom FROM track").fetchone()
    assert blob[:2] == b"GP" and struct.unpack("<BBi", blob[2:8]) == (0, 1, 4326)
    order, kind, count = struct.unpack("<BII", blob[8:17])
    assert (order, kind, count) == (1, 1002, len(track))
    places = np.frombuffer(blob, "<f8", offset=17).reshape(-1, 3)
    np.testing.assert_array_equal(places[:, 2], track.height)
    np.testing.assert_allclose(places[:, 1], np.degrees(track.latitude), rtol=1e-15)
    blob, time_s, date = file.execute("SELECT geom, time_s, time_utc FROM points WHERE fid = 8").fetchone()
    np.testing.assert_array_equal(np.frombuffer(blob, "<f8", offset=13), places[7])
    assert time_s == track.time_s[7] and date.endswith("Z")
    west = file.execute("SELECT min_x FROM gpkg_contents WHERE table_name = 'track'").fetchone()[0]
    assert west == places[:, 0].min()
    file.close()


def test_across_the_antimeridian_a_line_is_cut(tmp_path):
    track = track_of()
    moved = dataclasses.replace(track, longitude=track.longitude - track.longitude[len(track) // 2] + np.pi)
    nf.write_track(moved, tmp_path / "t.shp")
    with shapefile.Reader(str(tmp_path / "t.shp")) as line:
        shape = line.shape(0)
        assert len(shape.parts) > 1
        pieces = np.split(np.array(shape.points)[:, 0], shape.parts[1:])
        assert all(np.abs(np.diff(piece)).max() < 1.0 for piece in pieces)
    file = sqlite3.connect(nf.write_track(moved, tmp_path / "t.gpkg"))
    assert file.execute("SELECT count(*) FROM track").fetchone()[0] == len(pieces)
    file.close()


FORMAT = """
file = "survey.txt"
delimiter = "tab"
decimal = ","
head = ["; made for the survey software"]
[[columns]]
name = "Date"
of = "time_utc"
format = "%d.%m.%Y %H:%M:%S"
[[columns]]
name = "Draught"
of = "depth_m"
format = ".3f"
scale = 100
offset = 2.5
[[columns]]
of = "course_deg"
format = "05.1f"
"""


def test_a_table_of_ones_own(tmp_path):
    (tmp_path / "my.toml").write_text(FORMAT)
    track = track_of()
    lines = write_own(track, tmp_path, read_format(tmp_path / "my.toml")).read_text().splitlines()
    assert lines[:2] == ["; made for the survey software", "Date\tDraught\tcourse_deg"]
    assert len(lines) == 2 + len(track)
    date, draught, course = lines[2].split("\t")
    assert date == "28.05.2026 20:26:40"
    assert float(draught.replace(",", ".")) == pytest.approx(-100.0 * track.height[0] + 2.5, abs=1e-3)
    north, east = track.velocity_n[0, :2]
    assert float(course.replace(",", ".")) == pytest.approx(np.degrees(np.arctan2(east, north)) % 360.0, abs=0.06)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('of = "depth_m"', 'of = "deep"'), 'there is no column "deep"'),
        (('file = "survey.txt"', 'file = "../survey.txt"'), "without a folder"),
        ((".3f", ".3q"), "a format of Python for a number"),
        ((".3f", "%H"), "is a number"),
        (("decimal", "decimals"), "decimals"),
    ],
)
def test_what_no_format_can_ask_for(tmp_path, change, words):
    (tmp_path / "my.toml").write_text(FORMAT.replace(*change))
    with pytest.raises(FormatError, match=words):
        write_own(track_of(), tmp_path, read_format(tmp_path / "my.toml"))
    assert not (tmp_path / "survey.txt").exists() and not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize(("columns", "mistakes"), [('[{value = "time_s"}]', 2), ("[]", 1)])
def test_nothing_is_said_but_the_mistakes(tmp_path, columns, mistakes):
    (tmp_path / "my.toml").write_text(f'file = "a.txt"\ncolumns = {columns}\n')
    with pytest.raises(FormatError) as found:
        read_format(tmp_path / "my.toml")
    assert str(found.value).count("columns") == mistakes, found.value


def test_without_utc_there_is_no_date(tmp_path):
    (tmp_path / "my.toml").write_text(FORMAT)
    with pytest.raises(FormatError, match="UTC is unknown: give epoch"):
        write_own(track_of(epoch=None), tmp_path, read_format(tmp_path / "my.toml"))


def waves(period_s, step_s=0.2):
    """A track of ten minutes that sinks by 30 m and swings by half a metre."""
    track = track_of("lawnmower")
    time_s = np.arange(0.0, 600.0, step_s)
    long = track.keep(np.arange(time_s.size) % len(track))
    height = -0.05 * time_s + 0.5 * np.sin(2.0 * np.pi * time_s / period_s)
    return dataclasses.replace(long, time_s=time_s, height=height)


@pytest.mark.parametrize(("period_s", "amplitude"), [(5.0, 0.5), (10.0, 0.5), (200.0, 0.0)])
def test_heave_is_the_fast_part_without_a_delay(period_s, amplitude):
    track = waves(period_s)
    inside = slice(300, -300)
    expected = amplitude * np.sin(2.0 * np.pi * track.time_s / period_s)
    np.testing.assert_allclose(heave(track)[inside], expected[inside], atol=0.02)


def test_heave_wants_an_inertial_unit_and_dense_rows():
    with pytest.raises(ValueError, match="inertial unit"):
        heave(track_of())
    with pytest.raises(ValueError, match="rows closer than"):
        heave(waves(5.0, 4.0))
    with pytest.raises(ValueError, match="two periods"):
        heave(waves(5.0).keep(slice(0, 100)))


def test_summary_json_keeps_to_its_schema(tmp_path):
    """Of a run with everything on: withheld fixes, control points, a run backward, constants, instructions."""
    vehicle, mission = simulate_scenario("lawnmower", 1, 200.0)
    dvl = dataclasses.replace(vehicle.sensors["dvl"], scale_sd=0.01)
    write_vehicle(dataclasses.replace(vehicle, sensors={**vehicle.sensors, "dvl": dvl}), tmp_path / "vehicle.toml")
    said = (During("depth", 50.0, 60.0, off=True),)
    dataclasses.replace(mission, during=said, epoch_utc_s=EPOCH).save(tmp_path / "m.npz")
    place = np.degrees(mission.truth.value[100, :2])
    (tmp_path / "gates.csv").write_text(f"name,latitude_deg,longitude_deg\nA,{place[0]},{place[1]}\n")
    (tmp_path / "my.toml").write_text(FORMAT)
    asked = ["--smooth", "--backward", "--withhold", "gps:all-but-first-10", "--control", str(tmp_path / "gates.csv")]
    asked += ["--format", str(tmp_path / "my.toml"), "--out", str(tmp_path / "out"), "--no-report"]
    assert main(["replay", str(tmp_path / "m.npz"), "--vehicle", str(tmp_path / "vehicle.toml"), *asked]) in (0, 1)
    schema = json.loads((ROOM / "summary.schema.json").read_text(encoding="utf-8"))
    found = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(found, schema)
    assert set(found) <= set(schema["properties"]) and {"backward", "control", "constants", "survey"} <= set(found)
    assert (tmp_path / "out" / "survey.txt").exists() and len(labelled(small_run()[1]["smoothed"])) == 2
    broken = {**found, "schema": 2}
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(broken, schema)
