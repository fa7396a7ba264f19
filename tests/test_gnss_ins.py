"""The text that the benchmark against a C++ program writes and reads, without that program."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import navfilter as nf
from navfilter.io import read_mission, read_vehicle

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"
DEG = np.pi / 180.0


@pytest.fixture(scope="module")
def bench():
    sys.path.insert(0, str(BENCHMARKS))
    try:
        import gnss_ins
    finally:
        sys.path.remove(str(BENCHMARKS))
    return gnss_ins


@pytest.fixture(scope="module")
def written(bench, tmp_path_factory):
    folder = tmp_path_factory.mktemp("gnss-ins")
    mission = bench.simulated(0.5, seed=3)
    bench.write_text(mission, folder)
    return mission, folder


def test_its_states_are_those_of_the_other_program(bench, written):
    nav = nf.Navigator(bench.vehicle(), written[0].start)
    kinds = [name.split("_")[0].split(".")[0] for name in nav.errors]
    assert len(nav.errors) == 12 and kinds.count("gyro") == kinds.count("accel") == 6


def test_navfilter_reads_the_text_as_it_was_simulated(bench, written):
    mission, folder = written
    read, there = read_mission(folder), read_vehicle(folder)
    assert there.drive == bench.vehicle().drive and there.sensors == bench.vehicle().sensors
    for name in ("imu", "gnss"):
        stream, given = read.streams[name], mission.streams[name]
        assert np.allclose(stream.time_s, given.time_s, atol=1e-9)
        off = np.abs(stream.value[:, :6] - given.value[:, :6]).max(axis=0)
        # the last digits of the text: of increments a millionth of what counts, of fixes a micrometre
        assert np.all(off <= (1e-15 if name == "imu" else (1e-13, 1e-13, 1e-6)))
    assert read.start == mission.start


def test_the_first_fix_comes_after_the_first_sample(written):
    streams = written[0].streams
    assert streams["gnss"].time_s[0] > streams["imu"].time_s[0]


def test_settings_are_in_the_units_of_the_other_program(written):
    mission, folder = written
    lines = (folder / "kf-gins.yaml").read_text().splitlines()
    found = dict(line.strip().split(": ", 1) for line in lines if ": " in line)
    assert eval(found["arw"]) == pytest.approx([0.1] * 3)  # deg/sqrt(h)
    assert eval(found["vrw"]) == pytest.approx([0.1] * 3)  # m/s/sqrt(h)
    assert eval(found["gbstd"]) == pytest.approx([5.0] * 3)  # deg/h
    assert eval(found["abstd"]) == pytest.approx([100.0] * 3)  # mGal
    assert eval(found["gsstd"]) == eval(found["asstd"]) == pytest.approx([500.0] * 3)  # ppm
    assert float(found["corrtime"]) == 4.0  # h
    assert eval(found["initpos"])[0] == pytest.approx(mission.start.latitude_deg, abs=1e-9)
    assert 0.0 <= eval(found["initatt"])[2] < 360.0
    assert Path(found["outputpath"]).is_dir() and Path(found["imupath"]).is_file()


def test_an_answer_is_read_and_judged(bench, written):
    mission, folder = written
    truth = bench.truth_of(mission)
    rows = slice(20, None, 20)
    place, velocity, attitude = truth.place[rows], truth.velocity_n[rows], truth.attitude[rows]
    n = len(place)
    place = place + np.array([0.0, 0.0, 2.0])  # two metres too high
    answer = np.column_stack(
        [np.zeros(n), truth.time_s[rows], place / (DEG, DEG, 1.0), velocity, np.degrees(attitude) % 360.0]
    )
    np.savetxt(folder / bench.NAVIGATION, answer, fmt="%-15.9f")
    sds = np.tile([1.0, 1.0, 2.0, 0.1, 0.1, 0.1, 0.5, 0.5, 1.0, *12 * [1.0]], (n, 1))
    np.savetxt(folder / bench.DEVIATIONS, np.column_stack([truth.time_s[rows], sds]), fmt="%-15.9f")
    read = bench.read_answer(folder)
    assert read.sd[0, 6:] == pytest.approx([0.5 * DEG, 0.5 * DEG, DEG])
    found = bench.errors(read, truth, after_s=5.0)
    assert found["rows"] == n and found["down_m"] == pytest.approx(2.0, abs=1e-6)
    assert found["horizontal_m"] < 2e-4 and found["velocity_m_s"] < 1e-6 and found["heading_deg"] < 1e-6
    assert found["nees"] == pytest.approx(1.0 / 3.0, abs=1e-3)
