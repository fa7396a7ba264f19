"""Every log that there is, by ``mission --init``: whatever of position, heading, depth, velocity and UTC it holds is
that of an independent decode, and a replay says whether it can be judged.
"""

from __future__ import annotations

import json

import pytest
from independent_decodes import DECODES, FEW, HOW, compared

import navfilter as nf
from navfilter.commands.cli import main

for package, extra in (("rosbags", "ros"), ("pynmeagps", "nmea"), ("pyulog", "px4"), ("pymavlink", "ardupilot")):
    pytest.importorskip(package, reason=f'{package} is not installed: pip install "navfilter[{extra}]"')

#: Log -> UTC of its beginning, to the second (None: nobody knows), and the exit code of its replay: 1 a track that is
#: not to be trusted, 2 one reading is no track, 3 one that nothing judges.
TOLD = {
    "logs/ros1/robot_localization_test2.bag": (None, 0),
    "logs/ros2/derived_from_test2_db3": (None, 0),
    "logs/ros2/derived_from_test2_mcap": (None, 0),
    "logs/ardupilot/ardusub_small.BIN": (None, 3),
    "logs/ardupilot/ardusub_small.tlog": ("2023-05-04T17:15:41", 3),
    "logs/px4/sample_log_small.ulg": ("2021-04-21T06:30:58", 0),
    "logs/nmea/ugps_nmea_log.txt": ("2023-09-01T22:56:45", 3),
    "logs/nmea/pynmeagps_pygpsdata-nmea4.log": ("2021-03-06T10:36:07", 2),
    "logs/pd0/RDI_withBT.000": (None, 3),
    "logs/pd0/vmdas01_wh.ENX": ("2020-08-19T13:57:05", 3),
    "cases/beam.pd0": ("2022-08-19T20:14:23", 0),
    "cases/local_clock.pd0": ("2017-04-06T20:23:58", 0),
    "logs/nortek/VelEchoBT01.ad2cp": (None, 1),
    "glider-slocum-ru28/ru28_2017_113_3_0_dbd.dat.xz": ("2017-04-24T14:20:26", 3),
    "yacht-irene-1hz/flensburg_20130803_NMEA0004.TXT.xz": ("2013-08-03T10:07:34", 0),
    "yacht-irene-1hz/geneva_20140629_NMEA0001.TXT.xz": ("2014-06-29T09:53:33", 0),
    "yacht-psaros33-1hz/20140805_NMEA0020.TXT.xz": ("2014-08-05T13:26:47", 0),
    "yacht-psaros33-1hz/20140820_NMEA0007.TXT.xz": ("2014-08-20T16:18:16", 0),
    "yacht-csv-1hz/auckland_log-2022Oct27.csv.xz": ("2022-10-27T00:00:00", 0),
    "yacht-csv-1hz/trieste_log1Hz20170708_1239.log.xz": ("2017-07-08T12:39:06", 0),
}
#: Alarms and messages alone, none with a time.
NOTHING = ("nmea/pynmeagps_pygpsdata-maritime.log",)
#: Largest difference that rounding makes: places of ddmm.mmmm come with ten digits, all else as it is in the file.
APART = {
    "position": 1e-5,
    "heading": 1e-6,
    "depth": 1e-9,
    "pressure": 1e-6,
    "velocity": 1e-9,
    "speed": 1e-9,
    "force": 1e-6,
}
#: An hour of sentences takes seconds to read.
LONG = tuple(name for name in DECODES if name.startswith("yacht") or name.endswith(".tlog"))


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in LONG else n for n in DECODES])
def test_a_log_gives_what_it_holds(data_file, tmp_path, name):
    path = data_file(name)
    assert main(["mission", str(path), "--init", "--out", str(tmp_path), "--quiet"]) == 0
    mission = nf.read_mission(tmp_path)
    begins, code = TOLD[name]
    assert (mission.begin_utc and mission.begin_utc[:19]) == begins
    decode = DECODES[name](path)
    found = compared(mission, decode, **HOW.get(name, {}))
    assert found.keys() == decode.keys(), "a quantity that the file holds is not mapped"
    for quantity, one in found.items():
        assert one.apart < APART[quantity], (quantity, one)
        assert one.missing <= FEW * one.decoded and one.readings >= (1.0 - FEW) * one.decoded, (quantity, one)
    folder, out = str(tmp_path), tmp_path / "out"
    assert main(["replay", folder, "--vehicle", folder, "--out", str(out), "--no-report", "--quiet"]) == code
    if code == 2:
        return
    verdict = json.loads((out / "summary.json").read_text())["verdict"]
    assert verdict["trusted"] == (code == 0) and (code != 3 or not verdict["judged"])


def test_every_log_has_its_row(data_file):
    assert TOLD.keys() == DECODES.keys()
    root = data_file("logs")
    files = {path for path in root.rglob("*") if path.is_file() and path.suffix not in (".md", ".yaml")}
    files -= {root / name for name in NOTHING}
    covered = [data_file(name) for name in DECODES]
    assert [path for path in files if not any(path == one or one in path.parents for one in covered)] == []


@pytest.mark.parametrize("name", NOTHING)
def test_a_log_of_nothing_that_navigates_is_refused(data_file, tmp_path, capsys, name):
    assert main(["mission", str(data_file("logs") / name), "--init", "--out", str(tmp_path), "--quiet"]) == 2
    assert "holds no records" in capsys.readouterr().err
