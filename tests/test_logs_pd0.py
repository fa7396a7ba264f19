"""Teledyne PD0: real ensembles, their checksums, what is between them, and a hand-made one with every field known."""

import datetime
import struct

import numpy as np
import pytest

import navfilter as nf
from navfilter.io.logs import Shelf, format_of

BOTTOM, VMDAS = "pd0/RDI_withBT.000", "pd0/vmdas01_wh.ENX"


def test_bottom_track_of_a_real_file(log_sample, tmp_path):
    path = log_sample(BOTTOM)
    assert format_of(path).module == "pd0"
    shelf = Shelf()
    track = shelf.table(path, "bottom_track")
    velocity = np.column_stack([track.raw(f"velocity[{k}]") for k in range(4)])
    assert velocity.shape == (1721, 4)
    assert np.isfinite(velocity[:, 0]).sum() == 901  # the others are marked bad by the instrument
    assert np.nanmax(np.abs(velocity)) < 5.0
    assert set(track.raw("frame")) == {3.0}
    sensors = shelf.table(path, "sensors")
    assert sensors.raw("heading")[0] == pytest.approx(195.38)
    began = datetime.datetime(2017, 5, 24, 11, 50, 13, 400_000, tzinfo=datetime.UTC).timestamp()
    assert sensors.raw("log_time")[0] == pytest.approx(began, abs=1e-6)
    assert np.unique(np.diff(sensors.raw("log_time")).round(2)).tolist() == [1.5]


def test_navigation_of_a_real_file_through_a_mission(log_sample, tmp_path):
    path = log_sample(VMDAS)
    (tmp_path / "mission.toml").write_text(
        f"""
zero_s = "first"
[streams.gps]
file = "{path}"
topic = "navigation"
time = {{column = "utc"}}
position = ["latitude", "longitude"]
[streams.compass]
file = "{path}"
topic = "sensors"
time = {{column = "log_time", offset_s = 25268.69}}
heading = "heading"
"""
    )
    mission = nf.read_mission(tmp_path)
    assert [len(stream) for stream in mission.streams.values()] == [3713, 3713]
    np.testing.assert_allclose(np.degrees(mission.streams["gps"].value[0, :2]), [48.0805457, -123.0440202], atol=1e-7)
    # Within an hour the ship makes less than 10 m/s.
    north_m = 6.37e6 * np.diff(mission.streams["gps"].value[:, 0])
    assert np.abs(north_m).max() < 10.0 * np.diff(mission.streams["gps"].time_s).max()
    assert any("cut short at the end" in note for note in mission.notes)


def ensemble(number, velocity_mm_s, frame=2):
    """One ensemble with known fields: leader, variable leader, bottom track."""
    fixed = bytearray(59)
    fixed[25] = frame << 3
    variable = bytearray(65)
    struct.pack_into("<HH7B", variable, 0, 0x0080, number, 26, 6, 1, 12, 0, number % 60, 25)
    struct.pack_into("<HHHhhHh", variable, 14, 1500, 37, 27001, -150, 220, 35, 1234)
    struct.pack_into("<i", variable, 48, -41)
    variable[57:65] = bytes([20, 26, 6, 1, 12, 0, number % 60, 25])
    bottom = bytearray(81)
    struct.pack_into("<H", bottom, 0, 0x0600)
    struct.pack_into("<4H", bottom, 16, 1000, 1001, 1002, 1003)
    struct.pack_into("<4h", bottom, 24, *velocity_mm_s)
    struct.pack_into("<4h", bottom, 50, 11, -12, 13, -32768)
    bottom[77] = 1
    blocks, offset, offsets = (fixed, variable, bottom), 6 + 2 * 3, []
    for block in blocks:
        offsets.append(offset)
        offset += len(block)
    data = struct.pack("<BBHBB3H", 0x7F, 0x7F, offset, 0, 3, *offsets) + b"".join(map(bytes, blocks))
    return data + struct.pack("<H", sum(data) & 0xFFFF)


def test_every_field_of_a_made_ensemble_and_the_ship_frame(tmp_path):
    # Over ground 1.5 m/s forward, 0.2 m/s to starboard, 0.1 m/s down: what the ship frame (starboard, forward, up) of
    # the bottom relative to the instrument says.
    path = tmp_path / "dvl.pd0"
    path.write_bytes(ensemble(1, (-200, -1500, 100, 3)))
    (tmp_path / "mission.toml").write_text(
        '[streams.dvl]\nfile = "dvl.pd0"\ntopic = "bottom_track"\ntime = {column = "log_time"}\n'
        'velocity = {columns = ["velocity[0]", "velocity[1]", "velocity[2]"], axes = "-y,-x,z"}\n'
    )
    np.testing.assert_allclose(nf.read_mission(tmp_path).streams["dvl"].value[0], [1.5, 0.2, 0.1], atol=1e-12)
    shelf = Shelf()
    track, water, sensors = (shelf.table(path, name) for name in ("bottom_track", "water_track", "sensors"))
    np.testing.assert_allclose([track.raw(f"range[{k}]")[0] for k in range(4)], [665.36, 10.01, 10.02, 10.03])
    assert track.raw("frame")[0] == 2
    np.testing.assert_allclose([water.raw(f"velocity[{k}]")[0] for k in range(4)], [0.011, -0.012, 0.013, np.nan])
    found = {
        name: sensors.raw(name)[0]
        for name in ("heading", "pitch", "roll", "temperature", "transducer_depth", "pressure")
    }
    expected = {"heading": 270.01, "pitch": -1.5, "roll": 2.2, "temperature": 12.34, "transducer_depth": 3.7}
    assert found == pytest.approx(expected | {"pressure": -410.0})
    assert (
        sensors.raw("log_time")[0] == datetime.datetime(2026, 6, 1, 12, 0, 1, 250_000, tzinfo=datetime.UTC).timestamp()
    )


def test_damage_costs_one_ensemble(tmp_path):
    pieces = [ensemble(k, (0, 0, 0, 0)) for k in range(1, 6)]
    damaged = bytearray(pieces[2])
    damaged[40] ^= 0xFF
    (tmp_path / "dvl.pd0").write_bytes(
        b"noise" + pieces[0] + pieces[1] + bytes(damaged) + b"\x7f" + pieces[3] + pieces[4][:50]
    )
    table = Shelf().table(tmp_path / "dvl.pd0", "sensors")
    assert table.raw("ensemble").tolist() == [1, 2, 4]
    notes = " ".join(table.notes)
    assert "1 ensemble with a wrong checksum" in notes and "1 ensemble cut short" in notes and "bytes between" in notes
