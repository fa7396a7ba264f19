"""What a notebook shows of a mission, a vehicle and a track; and a replay that is given paths."""

import dataclasses
from html.parser import HTMLParser

import numpy as np
import pytest
from small_run import small_run

import navfilter as nf
from navfilter.io import write_vehicle


class Cells(HTMLParser):
    """Text of the rows of a table, and every tag in it."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.cells = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.cells += [""] if tag in ("th", "td") else []

    def handle_data(self, data):
        if self.cells:
            self.cells[-1] += data

    @property
    def rows(self):
        return dict(zip(self.cells[::2], self.cells[1::2], strict=True))


def test_a_track_shows_itself():
    _, tracks = small_run()
    track = dataclasses.replace(tracks["smoothed"], epoch_utc_s=1.7e9)
    rows = Cells(track._repr_html_()).rows
    assert rows["rows"] == str(len(track)) and rows["begins"] == "2023-11-14T22:13:20.000Z"
    assert rows["travelled"] == f"{track.distance_m:.0f} m"
    assert rows["gps"].startswith(f"{track.residuals['gps'].count('used')} used")
    assert Cells(track.keep(slice(0, 0))._repr_html_()).rows["rows"] == "0"


def test_a_mission_shows_itself():
    mission, _ = small_run()
    rows = Cells(mission._repr_html_()).rows
    assert rows["gps"].startswith("95 readings") and "latitude_rad" in rows["gps"]
    assert "1 Hz" in rows["depth"] and rows["truth"] == f"{len(mission.truth)} rows"
    assert (
        Cells(nf.Mission("empty", {"depth": nf.Stream([], np.empty((0, 1)))})._repr_html_())
        .rows["depth"]
        .startswith("0")
    )


def test_a_vehicle_shows_what_is_not_at_its_default():
    rows = Cells(small_run()[1]["forward"].vehicle._repr_html_()).rows
    assert rows["depth"] == "Depth(error=White(sd=0.05))"
    assert rows["drive"].startswith("DeadReckoning(rate_hz=4.0, attitude=Heading(rate_hz=4.0, error=GaussMarkov(")


def test_names_are_text():
    mission, tracks = small_run()
    evil = '<script>alert("x")</script>'
    shown = (
        dataclasses.replace(mission, name=evil),
        dataclasses.replace(tracks["forward"], mission_name=evil),
        dataclasses.replace(tracks["forward"].vehicle, name=evil),
    )
    for one in shown:
        found = Cells(one._repr_html_())
        assert "script" not in found.tags


def test_a_plot_is_a_picture():
    figure = small_run()[1]["smoothed"].plot()
    assert figure._repr_png_().startswith(b"\x89PNG")


def test_a_replay_takes_paths(tmp_path):
    mission, tracks = small_run()
    vehicle = tracks["forward"].vehicle
    write_vehicle(vehicle, tmp_path / "vehicle.toml")
    part = mission.between(0.0, 20.0)
    part.save(tmp_path / "dive.npz")
    expected = nf.replay(vehicle, part)
    for found in (
        nf.replay(tmp_path / "vehicle.toml", str(tmp_path / "dive.npz")),
        nf.replay(tmp_path, part),
        nf.replay(vehicle, tmp_path / "dive.npz"),
    ):
        np.testing.assert_array_equal(found.latitude, expected.latitude)
    with pytest.raises(ValueError, match="no such file"):
        nf.replay(vehicle, tmp_path / "none")
