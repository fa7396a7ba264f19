"""What a file calls its topics, streams or itself stays a name: in a TOML, in a comment, on a terminal."""

import subprocess
import sys
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from scipy.io import netcdf_file
from small_run import small_run

import navfilter as nf
from navfilter.commands.cli import main
from navfilter.commands.console import complain, speaker
from navfilter.evaluation.assessment import read_control_points
from navfilter.foundation.quoting import one_line, printable, toml_key, toml_text
from navfilter.io.toml_editing import write_learned
from navfilter.rendering.page import escape

HOSTILE = '/imu\n[streams.evil]\nfile = "/etc/hostname"\ntime = {column = "a"}\n# \x1b[2J\r\u202e\x9b\x7f"""\'\\'


@pytest.mark.parametrize("text", ["plain", HOSTILE, "\ud800", "\U0001f600", "\U000e0041", "a\tb"])
def test_quoted_text_reads_back_and_makes_nothing_else(text):
    whole = text.encode(errors="replace").decode()
    assert tomllib.loads(f"{toml_key(text)} = {toml_text(text)}  # {one_line(text)}\nz = 1") == {whole: whole, "z": 1}
    assert "".join(printable(text).split("\n")).replace("\t", "").isprintable()


def test_a_topic_cannot_write_into_the_mission(tmp_path, capsys):
    """A hostile name that is used, another one that is only listed."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    vector, nine = types["geometry_msgs/msg/Vector3"], np.zeros(9)
    kinds = {
        HOSTILE: "sensor_msgs/msg/Imu",
        "/dvl": "geometry_msgs/msg/TwistStamped",
        HOSTILE + "2": "std_msgs/msg/Int8",
    }
    with Writer(tmp_path / "bag", version=8, storage_plugin=StoragePlugin.MCAP) as writer:
        links = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()}
        for k in range(200):
            ns = 1_700_000_000_000_000_000 + 20_000_000 * k
            stamp = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="b")
            turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
            force = vector(x=0.01 * (k % 3), y=0.0, z=-9.81)
            twist = types["geometry_msgs/msg/Twist"](vector(x=1.0, y=0.0, z=0.0), vector(x=0.0, y=0.0, z=0.0))
            messages = (
                types[kinds[HOSTILE]](header, turn, nine, vector(x=0.0, y=0.001 * (k % 2), z=0.0), nine, force, nine),
                types[kinds["/dvl"]](header, twist),
                types["std_msgs/msg/Int8"](1),
            )
            for (topic, kind), message in zip(kinds.items(), messages, strict=True):
                writer.write(links[topic], ns, store.serialize_cdr(message, kind))
    assert main(["mission", str(tmp_path / "bag"), "--init", "--out", str(tmp_path / "dive")]) == 0
    written = tomllib.loads((tmp_path / "dive" / "mission.toml").read_text())
    assert set(written) <= {"name", "date", "zero_s", "start", "streams"}
    assert {name: stream["topic"] for name, stream in written["streams"].items()} == {
        "imu": HOSTILE,
        "odometry": "/dvl",
    }
    assert len(nf.read_mission(tmp_path / "dive").streams["imu"]) == 200
    said = capsys.readouterr().out
    assert "hostname" in said and said.replace("\n", "").isprintable()
    assert "[streams.evil]" not in said.splitlines()
    assert main(["check", str(tmp_path / "bag")]) in (0, 1)
    assert capsys.readouterr().out.replace("\n", "").isprintable()


def test_a_remark_is_one_line_of_comment(tmp_path):
    vehicle = nf.Vehicle(imu=nf.Imu(rate_hz=100), sensors={"compass": nf.Heading(error=nf.LearnedArma())})
    (tmp_path / "vehicle.toml").write_text(
        '[drive]\ntype = "imu"\nrate_hz = 100\n[sensors.compass]\ntype = "heading"\nerror = {model = "learned-arma"}\n'
    )
    path = write_learned(vehicle, tmp_path / "new.toml", tmp_path, {"compass": "learnt on a\nspeed = 3"})
    assert path.read_text().splitlines()[5] == "# learnt on a\\nspeed = 3"


def test_no_text_steers_the_terminal(capsys):
    speaker(False)("\x1b]0;title\x07 a\nb")
    complain("\x1b[31m")
    assert capsys.readouterr() == ("\\x1b]0;title\\x07 a\nb\n", "\\x1b[31m\n")


def test_the_log_of_a_folder_of_any_name(tmp_path):
    folder = tmp_path / 'a\n[b]\n"\x7f\U0001f600'
    vehicle = tmp_path / "vehicle.toml"
    vehicle.write_text('[drive]\ntype = "imu"\nrate_hz = 100\n')
    reading = b'{"sensor": "imu", "time_s": 1.0, "rate_b": [0,0,0], "force_b": [0,0,-9.8]}\n'
    command = [sys.executable, "-m", "navfilter", "run", "--vehicle", str(vehicle), "--log", str(folder), "--quiet"]
    assert subprocess.run(command, input=reading, capture_output=True).returncode == 0
    assert tomllib.loads((folder / "mission.toml").read_text())["name"] == folder.name


@pytest.mark.parametrize("name", ["\u00dcbung", HOSTILE, "\udcff"])
def test_a_mission_of_any_name_is_one_line_and_every_format_takes_it(name, tmp_path):
    """The second one of somebody's file, the last one of a folder whose name is no text."""
    mission, tracks = small_run()
    vehicle = next(iter(tracks.values())).vehicle
    named = nf.Vehicle(vehicle.drive, vehicle.sensors, name=name)
    track = nf.replay(named, replace(mission, name=name), output_rate_hz=1.0)
    assert track.mission_name.isprintable() and track.vehicle.name.isprintable()
    for kind in ("nc", "kml", "gpkg", "geojson", "mat", "gpx"):
        nf.write_track(track, tmp_path / f"track.{kind}", mission)
    with netcdf_file(tmp_path / "track.nc", mmap=False) as file:
        assert file.title.decode() == f"{track.mission_name}, {track.label}"


def test_a_page_shows_what_nobody_sees():
    assert escape("<\x1b[2J\u202e") == "&lt;\\x1b[2J\\u202e"


def test_a_surveyed_place_has_one_line(tmp_path):
    (tmp_path / "gates.csv").write_text('name,latitude_deg,longitude_deg\n"a\nVerdict: good",1,2\n')
    assert read_control_points(tmp_path / "gates.csv")[0].name == "a\\nVerdict: good"
