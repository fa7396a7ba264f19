"""Other runs beside a report's own, charts from tiles, circles, and no table of dashes."""

import dataclasses
import io
import sqlite3

import numpy as np
import pytest
from PIL import Image
from small_run import small_run

import navfilter as nf
from navfilter.commands.cli import main
from navfilter.io import write_vehicle
from navfilter.io.tracks.table import read_track
from navfilter.report.instrument import MOST_TILES, TILE, _tile, chart_of, check_tiles, draw_plan, plan_view
from navfilter.report.report import render_report
from navfilter.report.run_tables import headline_rows


def picture(shade):
    file = io.BytesIO()
    Image.new("RGB", (TILE, TILE), (shade, 0, 255 - shade)).save(file, "PNG")
    return file.getvalue()


def place_of(track):
    return float(np.degrees(track.latitude[0])), float(np.degrees(track.longitude[0]))


@pytest.fixture(scope="module", params=["folder", "mbtiles"])
def tiles(request, tmp_path_factory):
    """Tiles of zoom 12 and 18 around the small run: columns of alternating shade."""
    folder = tmp_path_factory.mktemp("tiles")
    latitude, longitude = place_of(small_run()[1]["smoothed"])
    made = {}
    for zoom in (12, 18):
        column, row = map(int, _tile(longitude, latitude, zoom))
        for x in range(column - 3, column + 4):
            for y in range(row - 3, row + 4):
                made[zoom, x, y] = picture(200 if x % 2 else 40)
    if request.param == "folder":
        for (zoom, x, y), data in made.items():
            file = folder / str(zoom) / str(x) / f"{y}.png"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)
        return folder
    file = sqlite3.connect(folder / "chart.mbtiles")
    file.execute("CREATE TABLE tiles (zoom_level INT, tile_column INT, tile_row INT, tile_data BLOB)")
    rows = [(zoom, x, (1 << zoom) - 1 - y, data) for (zoom, x, y), data in made.items()]
    file.executemany("INSERT INTO tiles VALUES (?,?,?,?)", rows)
    file.commit()
    file.close()
    return folder / "chart.mbtiles"


def test_a_chart_lies_where_its_tiles_do(tiles):
    path = tiles
    check_tiles(path)
    latitude, longitude = place_of(small_run()[1]["smoothed"])
    chart = chart_of(path, latitude - 2e-4, longitude - 2e-4, latitude + 2e-4, longitude + 2e-4)
    assert chart.south < latitude < chart.north and chart.west < longitude < chart.east
    rows, columns = chart.picture.shape[:2]
    for share in (0.1, 0.37, 0.5, 0.9):
        column = int(_tile(chart.west + share * (chart.east - chart.west), latitude, 18)[0])
        shade = 200 if column % 2 else 40
        assert chart.picture[rows // 2, int(share * columns), 0] == shade
    assert Image.open(io.BytesIO(chart.png)).size == (columns, rows)


def test_of_a_large_track_coarser_tiles_are_taken(tiles):
    path = tiles
    latitude, longitude = place_of(small_run()[1]["smoothed"])
    chart = chart_of(path, latitude - 0.02, longitude - 0.02, latitude + 0.02, longitude + 0.02)
    assert chart is not None and chart.picture.size <= 3 * MOST_TILES * TILE**2
    assert chart_of(path, 10.0, 10.0, 10.1, 10.1) is None


def test_a_report_says_what_the_tiles_hold(tiles, tmp_path):
    mission, tracks = small_run()
    far = tmp_path / "10" / "0"
    far.mkdir(parents=True)
    (far / "0.png").write_bytes(picture(200))
    for path, words in ((tiles, "from the tiles given"), (tmp_path, "nothing of this place is in the tiles given")):
        assert f"Chart: {words}." in render_report({"smoothed": tracks["smoothed"]}, mission, tiles=path)


def test_degrees_are_written_whole():
    """Not as what is left beside -8.01e1."""
    mission, tracks = small_run()
    figure = draw_plan(plan_view({"smoothed": tracks["smoothed"]}, mission))
    figure.savefig(io.BytesIO())
    above, right = figure.axes[0].child_axes
    latitude, longitude = place_of(tracks["smoothed"])
    for labels, place in ((above.get_xticklabels(), longitude), (right.get_yticklabels(), latitude)):
        shown = [float(label.get_text().replace("\u2212", "-")) for label in labels]
        assert np.allclose(shown, place, atol=0.1)


def test_what_holds_no_tiles_is_refused(tmp_path):
    (tmp_path / "x.mbtiles").write_text("no database")
    for path in (tmp_path, tmp_path / "x.mbtiles", tmp_path / "none"):
        with pytest.raises(ValueError, match="holds no tiles"):
            check_tiles(path)


@pytest.mark.parametrize("data", [b"", b"no picture", b"\x89PNG\r\n\x1a\n" + 40 * b"x"])
def test_a_tile_that_is_no_picture_is_blank(tmp_path, data):
    latitude, longitude = 26.0, -80.0
    column, row = map(int, _tile(longitude, latitude, 16))
    for x, content in ((column, data), (column + 1, picture(200))):
        (tmp_path / "16" / str(x)).mkdir(parents=True)
        for y in range(row - 2, row + 3):
            (tmp_path / "16" / str(x) / f"{y}.png").write_bytes(content)
    chart = chart_of(tmp_path, latitude, longitude, latitude + 1e-3, longitude + 6e-3)
    shades = set(np.unique(chart.picture[..., 0]).tolist())
    assert shades <= {200, 255} and 200 in shades


def test_a_track_is_read_back(tmp_path):
    track = small_run()[1]["smoothed"]
    nf.write_track(track, tmp_path / "track.csv")
    back = read_track(tmp_path, track.vehicle)
    assert back.label == tmp_path.name
    for name in ("time_s", "latitude", "longitude", "height", "velocity_n"):
        np.testing.assert_allclose(getattr(back, name), getattr(track, name), rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(back.covariance[:, :2, :2], track.covariance[:, :2, :2], rtol=1e-4, atol=1e-9)
    (tmp_path / "track.csv").write_text("a,b\n1,2\n")
    with pytest.raises(ValueError, match="has no time_s"):
        read_track(tmp_path, track.vehicle)


def test_circles_are_called_circles():
    mission, tracks = small_run()
    assert plan_view(tracks, mission).shape == "95 % ellipse"
    P = np.tile(np.eye(9), (len(tracks["smoothed"]), 1, 1))
    round_ones = {"smoothed": dataclasses.replace(tracks["smoothed"], covariance=P)}
    assert plan_view(round_ones, mission).shape == "95 % circle"


def test_without_a_truth_no_table_of_dashes():
    mission, tracks = small_run()
    header, rows = headline_rows(tracks, dataclasses.replace(mission, truth=None))
    assert header == ["", "NIS"] and all(len(row) == 2 for row in rows)
    assert len(headline_rows(tracks, mission)[0]) == 10


def test_the_command_shows_another_run(tmp_path, monkeypatch):
    shown = []
    monkeypatch.setattr("navfilter.report.report.render_report", lambda *given: shown.append(list(given[4])) or "")
    mission, tracks = small_run()
    mission.save(tmp_path / "m.npz")
    write_vehicle(tracks["forward"].vehicle, tmp_path / "vehicle.toml")
    arguments = ["replay", str(tmp_path / "m.npz"), "--vehicle", str(tmp_path / "vehicle.toml"), "--quiet"]
    assert main([*arguments, "--out", str(tmp_path / "one"), "--no-report"]) == 0
    two = [*arguments, "--out", str(tmp_path / "forward"), "--beside", str(tmp_path / "one")]
    assert main(two) == 0
    assert main([*arguments, "--out", str(tmp_path / "x"), "--tiles", str(tmp_path / "none")]) == 2
    assert shown == [["one"]]
