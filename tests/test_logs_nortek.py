"""Nortek .ad2cp: a real file, whose bottom track is bad throughout, and a made record with known velocities."""

import datetime
import struct

import numpy as np
import pytest

from navfilter.io.logs import Shelf, format_of

LOG = "nortek/VelEchoBT01.ad2cp"


def test_a_real_file(log_sample):
    path, shelf = log_sample(LOG), Shelf()
    assert format_of(path).module == "nortek"
    track, sensors = shelf.table(path, "bottom_track"), shelf.table(path, "sensors")
    assert track.raw("frame").tolist() == [2.0] * 159
    assert np.isnan(track.raw("velocity[0]")).all()  # on the bench: every beam is marked as bad
    assert sensors.raw("log_time").size == 319  # 160 bursts and 159 bottom tracks
    assert sensors.raw("heading")[0] == pytest.approx(272.75)
    assert sensors.raw("pressure")[0] == pytest.approx(8.083)
    began = datetime.datetime(2020, 1, 22, 4, 10, 33, tzinfo=datetime.UTC).timestamp()
    assert sensors.raw("log_time")[0] == pytest.approx(began, abs=1.0)
    assert any("1 record cut short" in note for note in track.notes)


def checksum(data):
    return (0xB58C + sum(struct.unpack(f"<{len(data) // 2}H", data[: len(data) // 2 * 2]))) & 0xFFFF


def record(velocity, second=5):
    """A bottom track of three beams in instrument axes: velocities in 1e-5 m/s, distances in mm, figures of merit."""
    data = bytearray(78)
    struct.pack_into("<BBHI", data, 0, 1, 78, (1 << 5) | (1 << 8) | (1 << 9), 4711)
    struct.pack_into("<6BH", data, 8, 124, 5, 1, 12, 0, second, 2500)
    struct.pack_into("<HhIHhh", data, 16, 15000, 1234, 20500, 9012, -150, 220)
    struct.pack_into("<H", data, 30, 3 << 12 | 1 << 10)
    struct.pack_into("<b", data, 60, -5)
    fom = [65535 if value is None else 7 for value in velocity]
    raw = struct.pack("<3i3i3H", *(0 if v is None else round(1e5 * v) for v in velocity), 12000, 12100, 12200, *fom)
    body = bytes(data) + raw
    header = struct.pack("<BBBBHH", 0xA5, 10, 0x17, 0x10, len(body), checksum(body))
    return header + struct.pack("<H", checksum(header)) + body


def test_velocities_of_a_made_file_and_its_damage(tmp_path):
    damaged = bytearray(record((9.0, 9.0, 9.0), 6))
    damaged[-3] ^= 0x10
    pieces = [record((1.5, -0.25, 0.125)), bytes(damaged), b"\xa5\x0anoise", record((1.5, None, 0.125), 7)]
    (tmp_path / "dvl.ad2cp").write_bytes(b"".join(pieces))
    track = Shelf().table(tmp_path / "dvl.ad2cp", "bottom_track")
    np.testing.assert_allclose(track.raw("velocity[0]"), [1.5, 1.5])
    np.testing.assert_allclose(track.raw("velocity[1]"), [-0.25, np.nan])
    np.testing.assert_allclose(track.raw("distance[2]"), [12.2, 12.2])
    assert track.raw("frame").tolist() == [1.0, 1.0]
    began = datetime.datetime(2024, 6, 1, 12, 0, 5, 250_000, tzinfo=datetime.UTC).timestamp()
    np.testing.assert_allclose(track.raw("log_time"), [began, began + 2.0], atol=1e-6)
    notes = " ".join(track.notes)
    assert "1 record with a wrong checksum" in notes and "7 bytes between records" in notes


@pytest.mark.parametrize("rest", [b"\0", b"\xa5", b"\xa5\x0a", b"\xa5\x0a\0"])
def test_a_few_bytes_at_the_end_are_the_end(tmp_path, rest):
    """One byte was read again and again, for ever."""
    (tmp_path / "dvl.ad2cp").write_bytes(record((1.5, -0.25, 0.125)) + rest)
    assert len(Shelf().table(tmp_path / "dvl.ad2cp", "bottom_track").raw("frame")) == 1
