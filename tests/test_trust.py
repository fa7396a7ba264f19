"""Files from elsewhere: bombs, devices, missions that lead out of their folder, messages, folders that are
somebody's.
"""

import bz2
import gzip
import json
import lzma

import h5py
import numpy as np
import pytest
import scipy.io

from navfilter.commands.cli import main
from navfilter.io import read_mission, read_vehicle
from navfilter.io.containers import read_npz
from navfilter.io.inertial import read_series
from navfilter.io.logs.survey import survey
from navfilter.io.table import TableOptions, Where
from navfilter.io.text_tables import read_table
from navfilter.io.trust import Allowance, Place
from navfilter.models.mission import Mission, MissionError, Stream

SMALL = 100_000  # bytes that may be unpacked; each file below unpacks to eight times as much
TOO_MUCH = "unpacks to more than .* --max-unpacked"
NUMBERS = np.zeros(SMALL)
TEXT = b"time,depth\n" + b"1,2\n" * (2 * SMALL)


def write_hdf5(path):
    with h5py.File(path, "w") as file:
        file.create_dataset("x", data=NUMBERS, compression="gzip")


def write_claim(path):
    """An array that takes no room in the file at all."""
    with h5py.File(path, "w") as file:
        file.create_dataset("x", shape=(SMALL,), dtype="f8", chunks=(1000,))


BOMBS = {
    "a.csv.gz": lambda path: path.write_bytes(gzip.compress(TEXT)),
    "a.csv.xz": lambda path: path.write_bytes(lzma.compress(TEXT)),
    "a.csv.bz2": lambda path: path.write_bytes(bz2.compress(TEXT)),
    "a.npz": lambda path: np.savez_compressed(path, x=NUMBERS),
    "a.mat": lambda path: scipy.io.savemat(path, {"x": NUMBERS}, do_compression=True),
    "b.mat": write_hdf5,
    "c.mat": write_claim,
}


@pytest.mark.parametrize("name", BOMBS)
def test_what_files_unpack_to_is_bounded(tmp_path, name):
    path = tmp_path / name
    BOMBS[name](path)
    assert path.stat().st_size < SMALL / 8
    with pytest.raises(MissionError, match=TOO_MUCH):
        read_table(Place(path, str(path), allowance=Allowance(SMALL)))
    assert read_table(Place(path, str(path), allowance=Allowance(10 * SMALL))).columns


@pytest.mark.parametrize("where", ({"equals": "A"}, {"at_least": 0.0}))
def test_rows_that_are_chosen_are_bounded_too(tmp_path, where):
    """Where rows are chosen by a text only those are kept; the others have to be unpacked as well."""
    path = tmp_path / "a.csv.gz"
    path.write_bytes(gzip.compress(b"kind,depth\n" + b"A,1\n" + b"B,2\n" * (2 * SMALL)))
    column = "kind" if "equals" in where else "depth"
    options = TableOptions(where=(Where(column=column, **where),))
    with pytest.raises(MissionError, match=TOO_MUCH):
        read_table(Place(path, str(path), allowance=Allowance(SMALL)), options)
    assert read_table(Place(path, str(path), allowance=Allowance(10 * SMALL)), options).columns


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"a,b\n1,2\n3," + b"9" * (5 << 20), "line of more than 4 MiB"),
        (b",".join([b"a"] * 30_000) + b"\n", "has 30000 columns"),
    ],
)
def test_no_line_is_longer_and_no_table_wider_than_any_is(tmp_path, text, words):
    path = tmp_path / "a.csv.gz"
    path.write_bytes(gzip.compress(text + b"\n1\n"))
    with pytest.raises(MissionError, match=words):
        read_table(path)
    path.write_bytes(gzip.compress(b"a,b\n" + b"1,2\n" * (2 << 20)))  # as long in all
    assert len(read_table(path).columns) == 2


def test_a_compressed_log_is_bounded(tmp_path, capsys):
    path = tmp_path / "x.alog.gz"
    path.write_bytes(gzip.compress(b"%% LOGSTART 1\n" + b"0.1 DEPTH a 1.5\n" * SMALL))
    with pytest.raises(MissionError, match=TOO_MUCH):
        survey(path, SMALL)
    assert survey(path, 20 * SMALL).topics
    for command in ("mission", "check"):
        assert main([command, str(path), "--max-unpacked", "0.0001"]) == 2
        assert "--max-unpacked" in capsys.readouterr().err


@pytest.mark.parametrize("how", ["mcap zstd", "db3 message", "db3 file", "bag bz2", "bag lz4"])
def test_no_piece_of_a_bag_unpacks_to_more_than_is_allowed(tmp_path, how):
    """A chunk is unpacked whole and then forgotten, so each of them counts and not their sum."""
    rosbag1, rosbag2 = pytest.importorskip("rosbags.rosbag1"), pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    storage, _, mode = how.partition(" ")
    store = get_typestore(Stores.ROS1_NOETIC if storage == "bag" else Stores.ROS2_HUMBLE)
    path, kind = tmp_path / ("x.bag" if storage == "bag" else "x"), "std_msgs/msg/String"
    if storage == "bag":
        writer = rosbag1.Writer(path)
        writer.set_compression(writer.CompressionFormat[mode.upper()])
    else:
        plugin = rosbag2.StoragePlugin.MCAP if storage == "mcap" else rosbag2.StoragePlugin.SQLITE3
        writer = rosbag2.Writer(path, version=8, storage_plugin=plugin)
        writer.set_compression(
            {"zstd": rosbag2.CompressionMode.STORAGE, "message": rosbag2.CompressionMode.MESSAGE}.get(
                mode, rosbag2.CompressionMode.FILE
            ),
            rosbag2.CompressionFormat.ZSTD,
        )
    message = store.types[kind]("x" * (8 * SMALL))
    raw = store.serialize_ros1(message, kind) if storage == "bag" else store.serialize_cdr(message, kind)
    with writer:
        topic = writer.add_connection("/text", kind, typestore=store)
        for k in range(3):
            writer.write(topic, 10**18 + k, raw)
    pieces = [file for file in [path, *path.rglob("*")] if file.is_file()]
    assert sum(file.stat().st_size for file in pieces) < SMALL
    with pytest.raises(MissionError, match=TOO_MUCH):
        survey(path, SMALL)
    assert survey(path, 26 * SMALL).topics[0].count == 3


def test_the_bound_is_that_of_all_files_of_a_mission_and_can_be_raised(tmp_path, capsys):
    for name in ("a", "b"):
        (tmp_path / f"{name}.csv.gz").write_bytes(
            gzip.compress(b"t,z\n" + b"".join(b"%d,5.0\n" % k for k in range(5000)))
        )
    streams = "".join(
        f'[streams.{n}]\nfile = "{n}.csv.gz"\ntime = {{column = "t"}}\ndepth = {{column = "z"}}\n' for n in ("a", "b")
    )
    (tmp_path / "mission.toml").write_text(streams)
    size = len(gzip.decompress((tmp_path / "a.csv.gz").read_bytes()))
    with pytest.raises(MissionError, match=TOO_MUCH):
        read_mission(tmp_path, unpacked_bytes=2 * size - 1)
    assert list(read_mission(tmp_path, unpacked_bytes=2 * size).streams) == ["a", "b"]
    assert main(["check", str(tmp_path), "--max-unpacked", "0.00001"]) == 2 and "a.csv.gz" in capsys.readouterr().err
    assert main(["check", str(tmp_path), "--max-unpacked", "1", "--quiet"]) in (0, 1)
    with pytest.raises(MissionError, match=TOO_MUCH):
        read_series(tmp_path / "a.csv.gz", "z", rate_hz=1.0, unpacked_bytes=size - 1)


def test_missions_of_our_own_are_bounded_too(tmp_path):
    path = Mission("dive", {"depth": Stream(np.arange(SMALL), NUMBERS[:, np.newaxis], ("depth_m",))}).save(
        tmp_path / "dive.npz"
    )
    with pytest.raises(MissionError, match=TOO_MUCH):
        read_mission(path, unpacked_bytes=SMALL)
    assert "navfilter_mission" in read_npz(path)


def test_a_line_without_an_end_is_no_header(tmp_path):
    """40 lines of it would be all there is."""
    path = tmp_path / "a.csv.gz"
    path.write_bytes(gzip.compress(b"1 " * (4 * SMALL)))
    with pytest.raises(MissionError, match=TOO_MUCH):
        read_series(path, "depth", rate_hz=1.0, unpacked_bytes=SMALL)


def test_arrays_that_lie_in_other_files_are_refused(tmp_path):
    (tmp_path / "secret").write_bytes(b"12345678" * 4)
    with h5py.File(tmp_path / "a.mat", "w") as file:
        file.create_dataset("x", shape=(4,), dtype="f8", external=[(str(tmp_path / "secret"), 0, 32)])
    with pytest.raises(MissionError, match="takes its numbers from other files"):
        read_table(tmp_path / "a.mat")


@pytest.mark.parametrize(
    "arguments", [["vehicle", "--check", "F"], ["run", "--vehicle", "V", "--start", "F"], ["check", "D"]]
)
def test_what_never_ends_is_not_read_to_its_end(tmp_path, capsys, arguments):
    (tmp_path / "vehicle.toml").write_text('[drive]\ntype = "imu"\nrate_hz = 100\n')
    (tmp_path / "mission.toml").symlink_to("/dev/zero")
    places = {"F": "/dev/zero", "V": str(tmp_path), "D": str(tmp_path)}
    assert main([places.get(word, word) for word in arguments]) == 2
    assert "larger than 16 MiB" in capsys.readouterr().err


# --- missions that lead elsewhere -----------------------------------------------------------------------------------


@pytest.fixture
def foreign(tmp_path, monkeypatch):
    """A mission beside a secret: a function that makes it lead somewhere and returns its folder."""
    (tmp_path / "secret.csv").write_text("hunter2,swordfish\n1,2\n2,3\n")
    monkeypatch.setenv("PASSWORD", "opensesame")
    folder = tmp_path / "mission"
    folder.mkdir()
    (folder / "link.csv").symlink_to(tmp_path / "secret.csv")
    (folder / "own.csv").write_text("time,depth\n1,2\n2,3\n")

    def lead(file, **table):
        extra = "".join(f"{key} = {json.dumps(value)}\n" for key, value in table.items())
        text = f'[streams.d]\nfile = "{file}"\n{extra}time = {{column = "time"}}\ndepth = {{column = "depth"}}\n'
        (folder / "mission.toml").write_text(text)
        return folder

    return lead


OUTSIDE = ["../secret.csv", "link.csv", "${FOLDER}/secret.csv"]


@pytest.mark.parametrize("file", OUTSIDE)
def test_messages_quote_nothing_from_outside_the_folder(foreign, tmp_path, monkeypatch, file):
    monkeypatch.setenv("FOLDER", str(tmp_path))
    with pytest.raises(MissionError) as found:
        read_mission(foreign(file))
    assert (
        "hunter2" not in str(found.value)
        and "swordfish" not in str(found.value)
        and "2 columns, not shown" in str(found.value)
    )
    assert ("${FOLDER}" in str(found.value)) == ("$" in file)


def test_messages_quote_what_lies_in_the_folder(foreign):
    folder = foreign("own.csv")
    (folder / "own.csv").write_text("when,depth\n1,2\n")
    with pytest.raises(MissionError, match='columns: "when", "depth"'):
        read_mission(folder)


@pytest.mark.parametrize("file", ["$PASSWORD", "${PASSWORD}/x.csv", "x.$PASSWORD", "${PASSWORD}.npz"])
def test_messages_do_not_show_the_values_of_variables(foreign, tmp_path, file):
    for existing in (None, "opensesame", "x.opensesame", "opensesame.npz"):
        folder = foreign(file)
        if existing:
            (folder / existing).write_bytes(b"PK\x03\x04 no archive")
        with pytest.raises(MissionError) as found:
            read_mission(folder)
        assert "opensesame" not in str(found.value) and "PASSWORD" in str(found.value)


@pytest.mark.parametrize("file", [*OUTSIDE, "/etc/passwd", "~/x.csv", "${UNSET_HERE}/x"])
def test_a_confined_mission_stays_in_its_folder(foreign, tmp_path, monkeypatch, capsys, file):
    monkeypatch.setenv("FOLDER", str(tmp_path))
    folder = foreign(file)
    with pytest.raises(MissionError, match="--confine"):
        read_mission(folder, confine=True)
    assert main(["check", str(folder), "--confine"]) == 2 and "--confine" in capsys.readouterr().err
    assert read_mission(foreign("own.csv"), confine=True).streams["d"].value[:, 0].tolist() == [2.0, 3.0]


def test_the_log_of_a_confined_mission_is_confined_too(tmp_path):
    (tmp_path / "log.jsonl").write_bytes(b"")
    folder = tmp_path / "mission"
    folder.mkdir()
    (folder / "mission.toml").write_text('[log]\nfile = "../log.jsonl"\n')
    with pytest.raises(MissionError, match="leads out"):
        read_mission(folder, confine=True)


# --- folders that are somebody's ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def dive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dive") / "dive"
    assert main(["simulate", "reckoning", "--duration", "60", "--out", str(folder), "--quiet"]) == 0
    return folder


def test_a_folder_of_somebody_else_is_only_written_to_when_forced(dive, tmp_path, capsys):
    report = tmp_path / "mine" / "report.html"
    report.parent.mkdir()
    report.write_text("a year of work")
    replay = ["replay", str(dive / "mission.npz"), "--vehicle", str(dive), "--quiet", "--out", str(report.parent)]
    assert main(replay) == 2
    assert "navfilter did not make it" in capsys.readouterr().err
    assert report.read_text() == "a year of work" and list(report.parent.iterdir()) == [report]
    assert main([*replay, "--force"]) == 0 and report.read_text() != "a year of work"
    report.write_text("in a folder that is ours now")
    assert main(replay) == 0 and report.read_text() != "in a folder that is ours now"
    (tmp_path / "empty").mkdir()
    assert main([*replay, "--no-report"]) == 0 and not report.exists()  # none of an earlier run is left
    assert main([*replay[:-1], str(tmp_path / "empty"), "--no-report"]) == 0


@pytest.mark.parametrize("command", ["demo", "compare", "identify", "montecarlo", "simulate"])
def test_every_command_asks(dive, tmp_path, capsys, command):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "vehicle.toml").write_text("mine")
    arguments = {
        "demo": ["--duration", "60"],
        "compare": [str(dive / "mission.npz"), "--vehicle", str(dive)],
        "identify": [str(dive / "mission.npz") + ":depth"],
        "montecarlo": ["--scenario", "compass-white", "--runs", "1"],
        "simulate": ["reckoning"],
    }[command]
    assert main([command, *arguments, "--quiet", "--out", str(tmp_path)]) == 2
    assert "--force" in capsys.readouterr().err and sorted(p.name for p in tmp_path.iterdir()) == [
        "notes.txt",
        "vehicle.toml",
    ]


def test_files_of_a_simulation_are_not_replaced_unasked(tmp_path, capsys):
    (tmp_path / "dive.toml").write_text("mine")
    simulate = ["simulate", "reckoning", "--duration", "20", "--quiet", "--out", str(tmp_path / "dive.npz")]
    assert main(simulate) == 2 and "--force" in capsys.readouterr().err and not (tmp_path / "dive.npz").exists()
    assert main([*simulate, "--force"]) == 0 and read_vehicle(tmp_path / "dive.toml").sensors
