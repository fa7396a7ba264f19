"""Damaged logs: whatever is wrong with a file, it is read as far as it goes or refused in one line."""

import lzma
import random

import pytest

from navfilter.io.logs.survey import survey, survey_text
from navfilter.models.mission import MissionError

for package, extra in (("rosbags", "ros"), ("pynmeagps", "nmea"), ("pyulog", "px4"), ("pymavlink", "ardupilot")):
    pytest.importorskip(package, reason=f'{package} is not installed: pip install "navfilter[{extra}]"')

LOGS = (
    "ros1/robot_localization_test2.bag",
    "ros2/derived_from_test2_mcap/derived_from_test2_mcap.mcap",
    "nmea/ugps_nmea_log.txt",
    "nmea/pynmeagps_pygpsdata-nmea4.log",
    "px4/sample_log_small.ulg",
    "ardupilot/ardusub_small.BIN",
    "ardupilot/ardusub_small.tlog",
    "pd0/RDI_withBT.000",
    "nortek/VelEchoBT01.ad2cp",
    "../glider-slocum-ru28/ru28_2017_113_3_1_dbd.dat.xz",
)


def damaged(data, seed):
    """A piece of a log in which bytes are overwritten and a few are lost."""
    chance = random.Random(seed)
    piece = bytearray(data[: chance.randrange(1, min(len(data), 60_000))])
    for _ in range(chance.choice([1, 20, 400])):
        piece[chance.randrange(len(piece))] = chance.randrange(256)
    lost = chance.randrange(len(piece))
    del piece[lost : lost + chance.randrange(40)]
    return bytes(piece)


@pytest.mark.parametrize("log", LOGS)
def test_damage_never_ends_in_a_traceback(log_sample, tmp_path, capfd, log):
    path = log_sample(log)
    data = lzma.decompress(path.read_bytes()) if path.suffix == ".xz" else path.read_bytes()
    target = tmp_path / path.name.removesuffix(".xz")
    for seed in range(4):
        target.write_bytes(damaged(data, seed))
        try:
            assert survey_text(survey(target))
        except MissionError as error:
            assert "\n" not in str(error)
    assert capfd.readouterr() == ("", "")  # what a library prints is counted instead
