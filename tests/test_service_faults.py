"""What must not stop a live run: readers of its outputs, its disk, terminal, cache and past, and whoever holds the
line.
"""

import contextlib
import datetime
import hashlib
import json
import math
import os
import pickle
import re
import resource
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from live_run import COMMAND, PATIENCE_S, Dive, Process, run_session, states, wait_for

import navfilter as nf
from navfilter.commands.cli import _parser, main
from navfilter.io import read_vehicle, write_vehicle
from navfilter.io.json_lines import BadLine, LineParser, Reading
from navfilter.kernels import measurement
from navfilter.models.magnetic import believable, declination
from navfilter.service import kernel_cache
from navfilter.service.disk import Disk, StateFile
from navfilter.service.log import LOG_FILE, log_items, prepare_log
from navfilter.service.loop import HealthFile, Notifier, Tally, _Run
from navfilter.service.output import Outlet
from navfilter.service.session import Options


@pytest.fixture(scope="module")
def dive(tmp_path_factory):
    return Dive(tmp_path_factory.mktemp("dive"), "lawnmower", 60.0)


def reproducible(output):
    """The lines that follow from the readings."""
    return [line for line in output if json.loads(line).get("event") not in ("notice", "resume")]


def readings_of(folder, vehicle):
    return [item.raw for item in log_items(folder / LOG_FILE, vehicle) if isinstance(item, Reading)]


def until(dive, time_s):
    """How many lines there are until a time."""
    return sum(json.loads(line)["time_s"] <= time_s for line in dive.lines)


def notices(output):
    return [event["what"] for event in states(output)[1] if event["event"] == "notice"]


# --- outputs --------------------------------------------------------------------------------------------------------


def broken_pipe():
    ours, theirs = os.pipe()
    os.close(ours)
    return theirs


def full_pipe():
    """One that nobody drains; its reading end stays open in this process."""
    _, theirs = os.pipe()
    os.set_blocking(theirs, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(theirs, b"x" * 65536)
    os.set_blocking(theirs, True)
    return theirs


@pytest.mark.parametrize(
    "stderr", [broken_pipe, full_pipe, lambda: os.open("/dev/full", os.O_WRONLY)], ids=["gone", "stuck", "full"]
)
def test_standard_error_stops_nothing(dive, tmp_path, stderr):
    """Whatever becomes of the operator's messages, and with a full disk to be told of, from a thread of its own."""
    limit, handle = 300_000, stderr()
    process = Process(
        *dive.arguments,
        "--log",
        tmp_path / "log",
        stderr=handle,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    os.close(handle)
    output = process.end(lines=dive.lines)
    assert process.code == 0 and reproducible(output) == dive.output and "disk-failed" in notices(output)


def test_a_reader_that_has_gone_stops_nothing(dive, tmp_path):
    process = Process(*dive.arguments, "--log", tmp_path / "log")
    process.process.stdout.close()
    process.send(dive.lines)
    process.process.stdin.close()
    assert "gone" in process.said("reader of the output") and process.process.wait(PATIENCE_S) == 0
    process.process.stderr.close()
    assert readings_of(tmp_path / "log", dive.vehicle) == dive.lines


def test_descriptors_that_are_closed_at_the_start_are_not_taken_by_the_log(dive, tmp_path):
    """The log would get the number 2, and the messages for the operator with it; Python sends them to standard
    output.
    """
    process = Process(*dive.arguments, "--log", tmp_path / "log", preexec_fn=lambda: os.close(2))
    rows, _ = states(process.end(lines=dive.lines[:2000]))  # and none of the messages is among the states
    parser = LineParser(dive.vehicle, notes=True)
    logged = (tmp_path / "log" / LOG_FILE).read_bytes().splitlines()
    assert process.code == 0 and rows and not any(isinstance(parser.parse(line), BadLine) for line in logged)


def test_an_output_on_a_full_disk_goes_on_when_there_is_room(monkeypatch):
    """Nothing that waits is lost, and a line that was torn is written again."""
    monkeypatch.setattr(Outlet, "RETRY_S", 0.01)
    handle = os.open("/dev/full", os.O_WRONLY)
    outlet = Outlet(handle)
    lines = [b"line %d\n" % k for k in range(200)]
    for line in lines:
        outlet.put(line, True)
    ours, theirs = os.pipe()
    os.dup2(theirs, handle)
    assert outlet.close()
    os.close(theirs)
    os.close(handle)
    with os.fdopen(ours, "rb") as reader:
        assert reader.readlines() == lines


def test_a_torn_line_is_ended_and_written_again():
    ours, theirs = os.pipe()
    outlet = Outlet(None)
    outlet._handle, writes = theirs, [3, OSError(28, "full")]

    def write(data):
        if not writes:
            return os.write(theirs, data), None
        sent, error = os.write(theirs, data[: writes[0]]), writes[1]
        writes.clear()
        return sent, error

    outlet._write = write
    lines = [b"one\n", b"two\n"]
    assert outlet._send(lines, None)[0] == 0 and outlet._send(lines, None) == (2, None)
    os.close(theirs)
    with os.fdopen(ours, "rb") as reader:
        assert reader.read() == b"one\none\ntwo\n"


# --- ends -----------------------------------------------------------------------------------------------------------


def test_hanging_up_stops_nothing(dive):
    process, cut = Process(*dive.arguments), until(dive, 5.1)
    process.send(dive.lines[:cut])
    process.read_until(5.0)
    process.process.send_signal(signal.SIGHUP)
    process.said("SIGHUP")
    process.send(dive.lines[cut:])
    output = process.end()
    assert process.code == 0 and reproducible(output) == dive.output and "hang-up" in notices(output)


def test_a_signal_during_compilation_ends_it_at_once(dive, tmp_path):
    process = Process(*dive.arguments, env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)})
    process.said("warming up")
    process.end(signal.SIGTERM)
    assert process.code == 0 and b"before the navigation began" in process.errors and b"ready (" not in process.errors


@pytest.mark.parametrize("source", ["empty", "failing", "garbage"])
def test_an_input_that_gives_nothing_is_no_ordered_end(dive, tmp_path, source):
    arguments = ["--input", tmp_path] if source == "failing" else []  # a folder can be opened, but not read
    process = Process(*dive.arguments, *arguments)
    output = process.end(lines=[b"garbage\n"] * 3 if source == "garbage" else [])
    assert process.code == 1 and f"input-{'failed' if source == 'failing' else 'empty'}" in notices(output)
    assert source != "garbage" or b"not one of its 3 lines" in process.errors


def test_a_reader_that_has_fallen_asleep_does_not_hold_up_the_end(dive, tmp_path):
    """States are dropped while it sleeps, and SIGTERM is heeded."""
    process = Process(*dive.arguments, "--rate-hz", "100", "--log", tmp_path / "log", "--quiet")
    process.send(dive.lines)
    wait_for(lambda: len(readings_of(tmp_path / "log", dive.vehicle)) == len(dive.lines))
    process.process.send_signal(signal.SIGTERM)
    assert process.process.wait(PATIENCE_S) == 0
    rows, _ = states(process.end())
    assert 0 < len(rows) < 100 * 60


def test_a_replayed_log_whose_reader_has_gone_is_no_success(dive, tmp_path):
    process = Process(*dive.arguments, "--log", tmp_path / "log", "--quiet")
    process.send(dive.lines)
    process.end()
    process = Process("--replay-log", tmp_path / "log", "--quiet")
    process.process.stdout.close()
    assert process.process.wait(PATIENCE_S) == 1


# --- the log --------------------------------------------------------------------------------------------------------


def test_a_deleted_log_is_written_anew(dive, tmp_path):
    folder = tmp_path / "log"
    process = Process(*dive.arguments, "--log", folder, "--fsync", "0.05", "--snapshot-every", "0.1")
    cut = until(dive, 5.1)
    process.send(dive.lines[:cut])
    process.read_until(5.0)
    folder.rename(tmp_path / "gone")  # a snapshot may be on its way into it
    shutil.rmtree(tmp_path / "gone")
    process.send(dive.lines[cut:])
    output = process.end()
    assert process.code == 0 and reproducible(output) == dive.output and "log-deleted" in notices(output)
    assert readings_of(folder, dive.vehicle) == dive.lines and read_vehicle(folder).sensors == dive.vehicle.sensors
    assert (folder / "snapshot").exists() and nf.read_mission(folder).duration_s > 59.0


def test_a_log_that_is_in_use_is_left_as_it_is(dive, tmp_path):
    """Its descriptions are only written by who has locked it."""
    first = prepare_log(tmp_path, dive.vehicle, dive.options, resume=None, tell=pytest.fail)
    before = (tmp_path / "vehicle.toml").read_bytes()
    with pytest.raises(ValueError, match="another process"):
        prepare_log(tmp_path, dive.vehicle.without("gps"), dive.options, resume=None, tell=pytest.fail)
    assert (tmp_path / "vehicle.toml").read_bytes() == before
    first.close()


NOT_A_FILE = {
    "pipe": lambda path, thesis: os.mkfifo(path),
    "folder": lambda path, thesis: path.mkdir(),
    "link": lambda path, thesis: path.symlink_to(thesis),
    "link to itself": lambda path, thesis: path.symlink_to(path),
    "link to nothing": lambda path, thesis: path.symlink_to("/nowhere/at/all"),
    "link to a device": lambda path, thesis: path.symlink_to("/dev/null"),
}


@pytest.mark.parametrize("kind", NOT_A_FILE)
def test_a_log_that_is_no_file_is_refused_and_on_a_restart_done_without(dive, tmp_path, capfd, kind):
    """Nothing is written to where a link leads."""
    (tmp_path / "log").mkdir()
    (tmp_path / "thesis").write_text("years\nof work")
    NOT_A_FILE[kind](tmp_path / "log" / LOG_FILE, tmp_path / "thesis")
    for more in ([], ["--resume", "strict"]):
        assert main(["run", *dive.arguments, "--log", str(tmp_path / "log"), *more, "--quiet"]) == 2
        said = capfd.readouterr().err
        assert LOG_FILE in said and said.count("\n") == 1
    (tmp_path / "lines").write_bytes(b"".join(dive.lines[:500]))
    arguments = [*dive.arguments, "--log", str(tmp_path / "log"), "--input", str(tmp_path / "lines")]
    assert main(["run", *arguments, "--resume", "--quiet"]) == 0
    said = capfd.readouterr().out
    assert "navigating without a log" in said and '"time_s":4.0' in said
    assert (tmp_path / "thesis").read_text() == "years\nof work"


@pytest.mark.parametrize("name", ["vehicle.toml", "mission.toml"])
@pytest.mark.parametrize("kind", ["file", *NOT_A_FILE])
def test_descriptions_in_the_folder_of_a_new_log_are_put_aside(dive, tmp_path, name, kind):
    folder = tmp_path / "log"
    folder.mkdir()
    (tmp_path / "thesis").write_text("years of work")
    if kind == "file":
        shutil.copy(tmp_path / "thesis", folder / name)
    else:
        NOT_A_FILE[kind](folder / name, tmp_path / "thesis")
    log = prepare_log(folder, dive.vehicle, dive.options, resume=None, tell=print)
    log.write(b"x\n")
    log.close()
    prepare_log(folder, dive.vehicle, dive.options, resume="strict", tell=print).close()
    names = {path.name for path in folder.iterdir()}
    assert names == {LOG_FILE, "vehicle.toml", "mission.toml", name.replace(".", ".before.")}
    assert (tmp_path / "thesis").read_text() == "years of work" and nf.read_vehicle(folder) == dive.vehicle


def test_garbage_does_not_fill_the_disk(dive, tmp_path):
    """Half a megabyte of the shortest lines that are none, and of several kinds, in one piece and between readings."""
    noise = [b"x\n", b"1\n", b"\xff\n"] * 60_000
    noise = b"".join(noise)
    process = Process(*dive.arguments, "--log", tmp_path / "log", "--quiet")
    process.send([*dive.lines[:2000], noise, *dive.lines[2000:4000], b"x\n" * 1000, *dive.lines[4000:]])
    output = process.end()
    rows, _ = states(output)
    assert process.code == 0 and rows[-1]["bad_lines"] == {
        "not-json": 61_000,
        "not-an-object": 60_000,
        "not-utf8": 60_000,
    }
    size = (tmp_path / "log" / LOG_FILE).stat().st_size
    assert size < sum(map(len, dive.lines)) + 20_000
    again = subprocess.run(
        [*COMMAND, "--replay-log", str(tmp_path / "log"), "--quiet"], capture_output=True, timeout=PATIENCE_S
    )
    assert again.stdout == b"".join(reproducible(output))
    assert "181000 lines were no readings" in nf.read_mission(tmp_path / "log").notes[0]


def test_many_bad_lines_are_one_note(dive):
    parser, tally = LineParser(dive.vehicle), Tally()
    items = list(tally.take(parser.parse(line) for line in [b"x", b"1"] * 500))
    assert len(items) == 2 * LineParser.QUOTED  # those that are quoted pass as they are
    last = list(tally.take([parser.parse(dive.lines[0])]))
    assert [(item.kind, item.lines) for item in last[:2]] == [("not-json", 480), ("not-an-object", 480)] and len(
        last
    ) == 3
    assert tally.due() == []
    log = LineParser(dive.vehicle, notes=True)
    assert [log.parse(item.raw) for item in last] == last
    assert log.parse(b'{"event":"bad","kind":"not-json","lines":-3}').lines == 1


# --- the past -------------------------------------------------------------------------------------------------------


@pytest.fixture
def broken_off(dive, tmp_path):
    """A log of half the dive with a snapshot."""
    folder = tmp_path / "log"
    process = Process(*dive.arguments, "--log", folder, "--quiet")
    process.send(dive.lines[:4000])
    process.end()
    return folder


def resumed(dive, folder, *arguments, lines):
    process = Process(*dive.arguments, "--log", folder, *arguments)
    process.send(lines)
    return process, process.end()


def test_a_damaged_snapshot_falls_back_to_the_log(dive, broken_off):
    snapshot = broken_off / "snapshot"
    snapshot.write_bytes(snapshot.read_bytes()[:-7] + b"garbage")
    assert main(["run", *dive.arguments, "--log", str(broken_off), "--resume=strict", "--quiet"]) == 2
    process, output = resumed(dive, broken_off, "--resume", lines=dive.lines[4000:])
    rows, events = states(output)
    assert process.code == 0 and rows[-1] == states(dive.output)[0][-1]
    told = next(event for event in events if event["event"] == "resume")
    assert told["snapshot"] is False and "snapshot is refused" in process.errors.decode()
    assert snapshot.with_name("snapshot.refused").exists() and snapshot.exists()


@pytest.mark.parametrize("what", ["device", "pipe", "huge", "folder"])
def test_a_snapshot_that_never_ends_is_not_read(dive, broken_off, what):
    """A restart would be killed for its memory, or wait for ever."""
    snapshot = broken_off / "snapshot"
    snapshot.unlink()
    if what == "device":
        snapshot.symlink_to("/dev/zero")
    elif what == "pipe":
        os.mkfifo(snapshot)
    elif what == "folder":
        snapshot.mkdir()
    else:
        with snapshot.open("wb") as file:
            file.truncate(1 << 40)
    process, output = resumed(dive, broken_off, "--resume", lines=dive.lines[4000:])
    assert process.code == 0 and states(output)[0][-1] == states(dive.output)[0][-1]
    assert "it is no snapshot" in process.errors.decode()


def test_a_log_that_is_shorter_than_its_snapshot_keeps_the_snapshot(dive, broken_off):
    log = broken_off / LOG_FILE
    log.write_bytes(b"".join(log.read_bytes().splitlines(keepends=True)[:1000]))
    assert main(["run", *dive.arguments, "--log", str(broken_off), "--resume=strict", "--quiet"]) == 2
    process, output = resumed(dive, broken_off, "--resume=best", lines=dive.lines[4000:])
    assert process.code == 0 and states(output)[0][-1] == states(dive.output)[0][-1]
    assert "shorter" in process.errors.decode()


def test_the_log_of_another_vehicle_is_never_taken_without_a_word(dive, broken_off, tmp_path, capsys):
    (broken_off / "snapshot").unlink()
    other = tmp_path / "other.toml"
    write_vehicle(dive.vehicle.without("depth"), other)
    before = (broken_off / "vehicle.toml").read_bytes()
    arguments = ["--vehicle", str(other), "--log", str(broken_off)]
    assert main(["run", *arguments, "--resume=strict", "--quiet"]) == 2
    assert "depth differs" in capsys.readouterr().err and (broken_off / "vehicle.toml").read_bytes() == before
    process = Process(*arguments, "--resume")
    process.send(dive.lines[4000:])
    rows, _ = states(process.end())
    assert process.code == 0 and "depth differs" in process.errors.decode() and "depth" not in rows[-1]["sensors"]
    assert (broken_off / "vehicle.before.toml").read_bytes() == before and "depth" not in read_vehicle(
        broken_off
    ).sensors


def test_a_log_with_a_damaged_beginning_gives_what_can_be_read(dive, broken_off):
    (broken_off / "snapshot").unlink()
    log = broken_off / LOG_FILE
    log.write_bytes(b"\0" * 100 + b"\n" + log.read_bytes().split(b"\n", 1)[1])
    assert main(["run", *dive.arguments, "--log", str(broken_off), "--resume=strict", "--quiet"]) == 2
    process, output = resumed(dive, broken_off, "--resume", lines=dive.lines[4000:])
    assert process.code == 0 and states(output)[0][-1]["latitude_deg"] == states(dive.output)[0][-1]["latitude_deg"]


def test_a_restart_navigates_also_where_no_log_can_be_written(dive, tmp_path, capsys):
    (tmp_path / "file").write_text("no folder")
    folder = tmp_path / "file" / "log"
    assert main(["run", *dive.arguments, "--log", str(folder), "--quiet"]) == 2 and "log" in capsys.readouterr().err
    process, output = resumed(dive, folder, "--resume", lines=dive.lines)
    assert process.code == 0 and states(output)[0] == states(dive.output)[0] and "disk-failed" in notices(output)


# --- the line -------------------------------------------------------------------------------------------------------


def test_a_silent_client_loses_its_place_to_one_that_comes(dive):
    """One that sends anything but readings is silent too."""
    process = Process(*dive.arguments, "--listen", "tcp://127.0.0.1:0", "--client-timeout", "0.2")
    host, port = process.said("listening").split("tcp://")[1].strip().rsplit(":", 1)
    with socket.create_connection((host, int(port)), timeout=PATIENCE_S) as silent:
        silent.sendall(b"hello\n" * 10 + b'{"half a line"')
        process.said("connected")
        answers = None
        while not answers:  # refused until the time-out is over
            client = socket.create_connection((host, int(port)), timeout=PATIENCE_S)
            with contextlib.suppress(ConnectionError):
                client.sendall(b"".join(dive.lines[:1500]))
                answers = client.makefile("rb").readline()
        while silent.recv(65536):  # it is told that it has lost its place
            pass
        rows = [json.loads(answers)]
        with client.makefile("rb") as more:
            while rows[-1].get("time_s", 0.0) < 5.0 or "event" in rows[-1]:
                rows.append(json.loads(more.readline()))
        client.close()
    process.end(signal.SIGTERM)
    assert process.code == 0 and b"put out" in process.errors
    bad = rows[-1]["bad_lines"]
    assert bad == {"not-json": 11}


# --- compiled kernels -----------------------------------------------------------------------------------------------


@pytest.fixture
def cache(tmp_path):
    """A copy of the compiled kernels, sealed, and the environment in which it is the one that is used."""
    nf.warm_up()
    own = Path(measurement.heading.stats.cache_path)
    source = Path(measurement.__file__).parent
    folder = tmp_path / "cache" / f"{source.name}_{hashlib.sha1(str(source).encode()).hexdigest()}"
    folder.mkdir(parents=True)
    for path in own.glob("*.nb[ic]"):
        shutil.copy2(path, folder)
    kernel_cache.seal(folder)
    return folder, {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}


def test_torn_kernels_are_compiled_again(dive, cache):
    """Random bytes for a file, random bytes within one, an empty one, and one without its end."""
    folder, environment = cache
    rng = np.random.default_rng(1)
    names = ("heading*.nbi", "depth*.nbc", "p*.nbi", "v*.nbi")
    index, code, empty, cut = (min(folder.glob(f"measurement.{name}")) for name in names)
    index.write_bytes(rng.bytes(1000))
    data = bytearray(code.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 500] = rng.bytes(500)
    code.write_bytes(data)
    empty.write_bytes(b"")
    cut.write_bytes(cut.read_bytes()[:-10])
    process = Process(*dive.arguments, env=environment)
    process.send(dive.lines)
    output = process.end()
    assert process.code == 0 and reproducible(output) == dive.output and b"4 damaged files" in process.errors
    assert kernel_cache.discard_damaged(folder) == 0  # they have been compiled, and are on the list again


def test_damaged_kernels_are_told_from_whole_ones(tmp_path):
    whole = {"a.nbi": pickle.dumps("0.1") + pickle.dumps(("stamp", {})), "a.1.nbc": pickle.dumps([b"code" * 100])}
    for name, data in whole.items():
        (tmp_path / name).write_bytes(data)
    assert kernel_cache.discard_damaged(tmp_path) == 0  # on no list, but whole
    rng = np.random.default_rng(2)
    for name, data in whole.items():
        for torn in (b"", data[:-1], data[: len(data) // 2], bytes(len(data)), rng.bytes(len(data))):
            (tmp_path / name).write_bytes(torn)
            assert kernel_cache.discard_damaged(tmp_path) == 1 and not (tmp_path / name).exists()
        (tmp_path / name).write_bytes(data)
    kernel_cache.seal(tmp_path)
    (tmp_path / "a.1.nbc").write_bytes(whole["a.1.nbc"].replace(b"codecode", b"codecodf"))  # still a pickle
    (tmp_path / "b.1.nbc").write_bytes(whole["a.1.nbc"])
    assert kernel_cache.discard_damaged(tmp_path) == 1 and (tmp_path / "b.1.nbc").exists()
    (tmp_path / "a.1.nbc").write_bytes(pickle.dumps("compiled again, by who writes no list"))
    (tmp_path / "a.nbi").write_bytes(pickle.dumps("0.1") + pickle.dumps(("stamp", {"signature": "a.1.nbc"})))
    assert kernel_cache.discard_damaged(tmp_path) == 0
    (tmp_path / kernel_cache.LIST).write_text("[")
    assert kernel_cache.discard_damaged(tmp_path) == 0


def test_kernels_that_cannot_be_kept_are_said_in_one_line(dive, tmp_path):
    """The package's own folder, the user's and the one asked for: none can be written."""
    package = tmp_path / "navfilter"
    shutil.copytree(Path(nf.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    (package / "kernels" / "__pycache__").write_text("no folder")
    nowhere = "/dev/null/nowhere"
    environment = {
        **os.environ,
        "PYTHONPATH": str(tmp_path),
        "NUMBA_CACHE_DIR": nowhere,
        "XDG_CACHE_HOME": nowhere,
        "HOME": nowhere,
    }
    done = subprocess.run(
        [sys.executable, "-m", "navfilter", "vehicle", "--check", str(dive.toml)],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        env=environment,
        cwd=tmp_path,
    )
    assert done.returncode == 0 and done.stderr.count("\n") == 1 and "NUMBA_CACHE_DIR" in done.stderr


def test_kernels_that_cannot_be_loaded_are_compiled_again(tmp_path, monkeypatch):
    """Whole files whose content numba cannot use."""
    (tmp_path / "a.nbi").write_bytes(b"whole")
    calls, said = [], []

    def warm_up(vehicle, smoother):
        calls.append(sorted(path.name for path in tmp_path.iterdir()))
        if len(calls) == 1:
            raise AttributeError("no such name")
        (tmp_path / "a.1.nbc").write_bytes(b"new")

    monkeypatch.setattr("navfilter.playback.warm_up.warm_up", warm_up)
    monkeypatch.setattr(kernel_cache, "_folder", lambda: tmp_path)
    kernel_cache.compile_kernels(said.append)
    assert calls == [["a.nbi"], []] and len(said) == 1 and "no such name" in said[0]
    assert list(json.loads((tmp_path / kernel_cache.LIST).read_text())) == ["a.1.nbc"]


def test_where_the_disk_is_full_kernels_are_kept_for_this_process(tmp_path):
    program = (
        "from navfilter.service import kernel_cache as k; k.ROOM = 1 << 62; k.make_usable(print); "
        "from navfilter.kernels.measurement import heading; print(heading.stats.cache_path)"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "full"), "TMPDIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=PATIENCE_S, env=environment
    )
    said, folder = done.stdout.splitlines()
    assert "is full" in said and folder.startswith(str(tmp_path / "navfilter-kernels-")) and done.stderr == ""
    assert not list(tmp_path.glob("navfilter-kernels-*"))  # nothing is left behind


def test_a_disk_that_fills_up_while_kernels_are_compiled_ends_no_start(dive, cache):
    """Those that are there are used, the others go on from memory: it was exit code 2, at every start."""
    folder, environment = cache
    for path in [*folder.glob("listen.*"), *folder.glob("measurement.heading*")]:
        path.unlink()
    before = sorted(path.name for path in folder.glob("*.nb?"))
    assert before
    process = Process(
        *dive.arguments, env=environment, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
    )
    output = process.end(lines=dive.lines)
    assert process.code == 0 and reproducible(output) == dive.output
    assert process.errors.count(b"compiled kernels cannot be kept") == 1
    assert sorted(path.name for path in folder.glob("*.nb?")) == before


# --- the clock of the computer
# ------------------------------------------------------------------------------------------


def test_a_computer_in_1970_does_not_keep_a_magnetic_compass_waiting():
    for today in (datetime.date(1970, 1, 1), datetime.date(2106, 2, 7)):
        assert math.isfinite(declination(45.0, -4.0, 0.0, believable(today)))
    assert believable(datetime.date(2026, 5, 4)) == datetime.date(2026, 5, 4)


@pytest.mark.parametrize("how", ["aligned", "given", "line"])
def test_a_run_that_is_told_1970_starts_and_says_by_which_field(how):
    imu, compass, gps = nf.Imu(rate_hz=10), nf.Heading(rate_hz=1, magnetic=True), nf.Position()
    vehicle, unset = nf.Vehicle(imu=imu, sensors={"compass": compass, "gps": gps}), datetime.date(1970, 1, 1)
    place = {"latitude_deg": 45.0, "longitude_deg": -4.0, "heading_deg": 0.0}
    rows = [{"sensor": "start", **place, "date": "1970-01-01"}] if how == "line" else []
    for k in range(200):
        rows.append({"sensor": "imu", "time_s": k / 10, "rate_b": [0.0] * 3, "force_b": [0.0, 0.0, -9.81]})
        if k % 10 == 0:
            rows.append({"sensor": "compass", "time_s": k / 10, "value": 0.1})
            rows.append({"sensor": "gps", "time_s": k / 10, "value": [0.785, -0.07, 0.0]})
    options = Options(date=unset, start=place if how == "given" else None)
    told, events = states(run_session(vehicle, [json.dumps(row).encode() + b"\n" for row in rows], options))
    warned = [event["text"] for event in events if event["event"] == "warning"]
    assert len(told) > 5 and len(warned) == 1 and "1970-01-01" in warned[0] and "2025-01-01" in warned[0]
    truly = 0.1 + declination(45.0, -4.0, 0.0, datetime.date(2025, 1, 1))
    assert math.radians(told[-1]["heading_deg"]) == pytest.approx(truly, abs=0.02)


# --- supervision ----------------------------------------------------------------------------------------------------


def test_the_health_file_says_how_the_run_is(dive, tmp_path):
    path = tmp_path / "health.json"
    process = Process(*dive.arguments, "--health-file", path, "--quiet", "--log", tmp_path / "log")
    process.send([b"nonsense\n", *dive.lines[:2000]])
    health = {}
    while health.get("phase") != "navigating" or health["readings"] < 2000:
        assert process.process.poll() is None
        with contextlib.suppress(FileNotFoundError):
            health = json.loads(path.read_bytes())  # always whole
    assert health["pid"] == process.process.pid and health["time_s"] > 5.0 and health["bad_lines"] == 1
    page = (Path(__file__).parent.parent / "docs" / "pages" / "on-board-supervision.md").read_text(encoding="utf-8")
    assert all(f"`{key}`" in page for key in health)
    assert health["internal_errors"] == health["lost_log_lines"] == 0 and health["disk_troubles"] == []
    process.end()
    assert process.code == 0 and json.loads(path.read_bytes())["phase"] == "stopped"


@pytest.mark.parametrize("flag", ["--state", "--health-file"])
def test_what_is_no_file_is_not_replaced_by_one(dive, tmp_path, capsys, flag):
    """As root it would have been the end of /dev/null."""
    (tmp_path / "device").symlink_to("/dev/null")
    (tmp_path / "link").symlink_to(tmp_path / "nothing")
    for name in ("device", "link", "folder"):
        (tmp_path / "folder").mkdir(exist_ok=True)
        assert main(["run", *dive.arguments, flag, str(tmp_path / name), "--quiet"]) == 2
        assert "no file" in capsys.readouterr().err
    assert (tmp_path / "device").is_symlink() and (tmp_path / "link").is_symlink()


@pytest.mark.parametrize("name", ["states", "/dev/stdout"])
def test_what_standard_output_is_written_to_is_not_replaced(dive, tmp_path, name):
    with (tmp_path / "states").open("wb") as out:
        process = Process(*dive.arguments, "--health-file", tmp_path / name, stdout=out)
        process.end()
    assert process.code == 2 and process.errors.count(b"\n") == 1 and os.path.islink("/dev/stdout")


@pytest.mark.parametrize("flag", ["--state", "--health-file"])
@pytest.mark.parametrize(
    "name",
    [
        *("vehicle.toml", "start.json", "lines", "log/readings.jsonl", "log/snapshot", "thesis", "../x/thesis"),
        *("log", "log/snapshot.part", "book"),  # "book.part" stands there
    ],
)
def test_no_file_of_somebody_is_written_over(dive, tmp_path, capsys, flag, name):
    folder = tmp_path / "x"
    folder.mkdir()
    shutil.copy(dive.toml, folder / "vehicle.toml")
    shutil.copy(dive.start_file, folder / "start.json")
    (folder / "lines").write_bytes(dive.lines[0])
    for text in ("thesis", "book.part"):
        (folder / text).write_text("years of work")
    before = {path: path.read_bytes() for path in folder.iterdir()}
    given = ["--vehicle", str(folder), "--start", str(folder / "start.json"), "--input", str(folder / "lines")]
    if name.startswith("log/snapshot") and flag == "--state":
        flag, given = "--state", [*given, "--health-file", str(folder / name)]
    assert main(["run", *given, "--log", str(folder / "log"), flag, str(folder / name), "--quiet"]) == 2
    said = capsys.readouterr().err
    assert "written over" in said and said.count("\n") == 1
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


def test_lines_without_a_reading_are_told_like_silence(dive, tmp_path, monkeypatch, capfd):
    """Stamps that are no number, say: nothing goes on, and each line alone is only counted."""
    monkeypatch.setattr(_Run, "SILENT_S", 0.05)
    os.mkfifo(tmp_path / "pipe")
    told = threading.Event()

    def babble():
        with (tmp_path / "pipe").open("wb", buffering=0) as pipe:
            pipe.write(dive.lines[0])
            for _ in range(2000):
                if told.wait(0.005):
                    break
                pipe.write(b'{"sensor": "imu", "time_s": NaN}\n')

    notice = _Run._notice

    def noted(run, what, **fields):
        notice(run, what, **fields)
        if what == "input-silent":
            told.set()

    monkeypatch.setattr(_Run, "_notice", noted)
    talker = threading.Thread(target=babble)
    talker.start()
    assert main(["run", *map(str, dive.arguments), "--input", str(tmp_path / "pipe"), "--quiet"]) == 0
    talker.join()
    assert "no reading among the lines for" in capfd.readouterr().out


@pytest.mark.parametrize("flag", ["--state", "--health-file"])
def test_a_place_without_a_name_is_no_file(dive, capsys, flag):
    assert main(["run", "--vehicle", str(dive.toml), flag, ".", "--quiet"]) == 2
    assert f"{flag} . is no file" in capsys.readouterr().err


def test_a_restart_puts_a_file_that_is_none_of_its_own_aside(dive, tmp_path):
    """No restart by a supervisor ends without navigation; an empty file is what a power cut leaves."""
    for name in ("state", "health"):
        (tmp_path / name).write_text("years of work")
    arguments = ["--resume", "--state", tmp_path / "state", "--health-file", tmp_path / "health"]
    for _ in range(2):
        process = Process(*dive.arguments, *arguments, "--quiet")
        process.send(dive.lines[:2000])
        process.end()
        assert process.code == 0
        assert (tmp_path / "state").read_bytes().startswith(StateFile.MAGIC)
        assert json.loads((tmp_path / "health").read_bytes())["phase"] == "stopped"
        assert {path.read_text() for path in tmp_path.glob("*.refused")} == {"years of work"}
        (tmp_path / "health").write_bytes(b"")


@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_what_is_written_beside_follows_no_link_and_waits_for_no_pipe(tmp_path, kind):
    (tmp_path / "thesis").write_text("years of work")
    for name in ("state", "health"):
        NOT_A_FILE[kind](tmp_path / f"{name}.part", tmp_path / "thesis")
    disk, health = Disk(None, tmp_path / "state", 1.0, pytest.fail), HealthFile(tmp_path / "health", pytest.fail)
    disk.snapshot(b"{}\n", b"")
    health.put({"phase": "navigating"})
    assert disk.close()
    health.close()
    assert StateFile.is_one(tmp_path / "state") and HealthFile.is_one(tmp_path / "health")
    assert (tmp_path / "thesis").read_text() == "years of work"


def test_a_health_file_that_cannot_be_written_is_said_once(dive):
    process = Process(*dive.arguments, "--health-file", "/dev/null/health")
    process.send(dive.lines)
    assert reproducible(process.end()) == dive.output
    assert process.code == 0 and process.errors.count(b"/dev/null/health") == 1


def test_systemd_hears_of_the_start_of_each_second_and_of_the_end(dive, tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as heard:
        heard.bind(str(tmp_path / "notify"))
        heard.settimeout(PATIENCE_S)
        process = Process(
            *dive.arguments, env={**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "300000"}
        )
        said = b""
        for word in (b"STATUS=compiling", b"READY=1", b"WATCHDOG=1", b"WATCHDOG=1"):
            said = heard.recv(4096)
            while word not in said:
                assert b"WATCHDOG" not in said or word != b"READY=1"
                said = heard.recv(4096)
        process.send(dive.lines[:2000])
        process.end(signal.SIGTERM)
        while b"STOPPING=1" not in said:
            said = heard.recv(4096)
    assert process.code == 0


def test_without_a_supervisor_nothing_is_sent():
    assert Notifier({}).watchdog_s is None and Notifier({"WATCHDOG_USEC": "1000000"}).watchdog_s is None
    there = {"NOTIFY_SOCKET": "/nowhere/notify", "WATCHDOG_USEC": "2000000"}
    assert Notifier(there).watchdog_s == 2.0 and Notifier({**there, "WATCHDOG_PID": "1"}).watchdog_s is None
    Notifier(there).tell(READY=1)  # nobody is there: no exception


def test_the_manual_of_supervision_is_that_of_the_program(capsys):
    """Its unit can be started as it stands, and each flag and exit code of the help is explained."""
    page = (Path(__file__).parent.parent / "docs" / "pages" / "on-board-supervision.md").read_text(encoding="utf-8")
    for command in re.findall(r"^ExecStart\w*=/usr/local/bin/navfilter (.*)$", page, flags=re.MULTILINE):
        _parser().parse_args(shlex.split(command))
    with pytest.raises(SystemExit):
        main(["run", "--help"])
    said = capsys.readouterr().out
    for word in ("--resume", "--client-timeout", "--health-file", "strict"):
        assert word in said and word in page
    codes = re.search(r"exit codes:\n(.*?)\n\n", said, flags=re.DOTALL).group(1)
    assert (
        re.findall(r"^ +(\d+) ", codes, flags=re.MULTILINE)
        == re.findall(r"^\| (\d+) \|", page, flags=re.MULTILINE)
        == ["0", "1", "2", "130"]
    )
