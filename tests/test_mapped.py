"""Recordings that lie in files: the same results, whatever is let go of on the way."""

import errno
import io
import mmap
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from test_passage import assert_same, survey

import navfilter as nf
from navfilter.foundation.mapped_arrays import give_back, mapped
from navfilter.io import containers
from navfilter.models.mission import MissionError


def on_disk(array, path, mode):
    np.save(path, array)
    return np.load(path, mmap_mode=mode)


@pytest.mark.parametrize("mode", ["r", "r+", "c"])
def test_what_was_let_go_of_is_read_again(tmp_path, mode):
    array = on_disk(np.arange(5000.0), tmp_path / "a.npy", mode)
    if mode != "r":
        array[7] = -1.0
    kept = array.copy()
    give_back(array, array[10:].reshape(-1, 10), np.asarray(array)[::2], np.arange(3.0), None)
    np.testing.assert_array_equal(array, kept)


def test_memory_that_is_nowhere_else_is_kept():
    """A private map without a file, seen through an array."""
    private = np.frombuffer(mmap.mmap(-1, 8 * 4096, flags=mmap.MAP_PRIVATE), np.float64)
    private[:] = 1.0
    give_back(private)
    assert private.min() == 1.0


def test_a_replay_of_a_mission_in_files_is_that_of_one_in_memory(tmp_path):
    vehicle, mission = survey(20.0)
    streams = {
        name: nf.Stream(
            on_disk(stream.time_s, tmp_path / f"{name}_t.npy", "r"),
            on_disk(stream.value, tmp_path / f"{name}.npy", "r"),
            stream.columns,
        )
        for name, stream in mission.streams.items()
    }
    assert isinstance(streams["imu"].value.base, np.memmap) and isinstance(streams["imu"].time_s.base, np.memmap)
    filed = replace(mission, streams=streams)
    assert_same(nf.replay(vehicle, mission, smooth=True), nf.replay(vehicle, filed, smooth=True))


def test_a_large_array_of_a_mission_is_not_held_in_memory(tmp_path, monkeypatch):
    vehicle, mission = survey(20.0)
    path = mission.save(tmp_path / "dive.npz")
    usual = nf.read_mission(path)
    monkeypatch.setattr(containers, "_LARGE", 1000)
    filed = nf.read_mission(path)
    assert isinstance(filed.streams["imu"].value.base, np.memmap)
    for name, stream in usual.streams.items():
        np.testing.assert_array_equal(filed.streams[name].time_s, stream.time_s)
        np.testing.assert_array_equal(filed.streams[name].value, stream.value)
    assert_same(nf.replay(vehicle, usual), nf.replay(vehicle, filed))


def test_on_a_full_disk_it_is_held_in_memory(tmp_path, monkeypatch):
    _, mission = survey(20.0)
    path = mission.save(tmp_path / "dive.npz")
    monkeypatch.setattr(containers, "_LARGE", 1000)

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(containers, "mapped", full)
    held = nf.read_mission(path).streams["imu"].value
    assert not isinstance(held.base, np.memmap)
    np.testing.assert_array_equal(held, mission.streams["imu"].value)


def test_a_damaged_large_array_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(containers, "_LARGE", 1000)
    path = tmp_path / "imu.npz"
    np.savez(path, imu=np.arange(6000.0).reshape(-1, 6), names=np.array(["x" * 2000]), columns=np.zeros((60, 6)).T)
    assert containers.read_npz(path)["columns"].shape == (6, 60)
    data = bytearray(path.read_bytes())
    data[9000] ^= 1
    path.write_bytes(data)
    with pytest.raises(zipfile.BadZipFile, match="CRC"):
        containers.read_npz(path)
    member = io.BytesIO()
    np.save(member, np.zeros((1000, 6)))
    for rows in (b"(999, 6), ", b"(9999, 6),"):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("imu.npy", member.getvalue().replace(b"(1000, 6),", rows))
        with pytest.raises(MissionError, match=r"imu.npz cannot be read: it holds 48000 bytes where its header says"):
            containers.read_arrays(path)


def test_an_array_of_another_length_than_it_says_is_none():
    assert mapped(io.BytesIO(np.arange(6.0).tobytes()), (3, 2))[2, 1] == 5.0
    with pytest.raises(ValueError, match="it holds 48 bytes where its header says 40"):
        mapped(io.BytesIO(np.arange(6.0).tobytes()), (5,))
